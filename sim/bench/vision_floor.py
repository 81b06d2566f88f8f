"""The Cramer-Rao floor of a cell's place, from the scenario alone: sensor noise, blur, levels, lengths of edges.

One side of a cell is the edge of a bar: cell (level a), line of known width w (level b), next cell (level c). Across
the side, at distance x from the middle of the bar's near edge, the blurred profile is

    I(x) = a + (b - a) Phi((x - d) / s) + (c - b) Phi((x - d - w) / s),

with s^2 the lens's and the pixel's variance. A pixel's variance is V(I) = g I + r^2 + 1/12 grey^2: shot noise (g grey
values an electron), read noise, and rounding to whole grey values. Pixels lie one a square px, so a side of length L
gives, for the unknowns q = (d, a, b, c), the Fisher information

    F = L integral (dI/dq) (dI/dq)^T / V(I) dx,

of which d keeps, the levels being unknown, the Schur complement J = F_dd - F_dl F_ll^-1 F_ld. The four sides with
normals n_k give an eye's information on the cell's place in the image, sum_k J_k n_k n_k^T; the two eyes' are carried
to space by the projections' Jacobians A: F_xyz = sum_eyes A^T (sum_k J_k n_k n_k^T) A, and the floor is F_xyz^-1.

It is a floor: size and shape of the cell and the width of the line are taken as known, a side counts with all of its
length that the image shows, its neighbours with no unknown but their levels. Nothing of the flight side is used.

Two floors differ by what is known of the neighbours. With all edges, the line's far edge moves with the near one, and
tells of the cell as much as its own does: no method can be better, but only a wing whose cells do not move against each
other yields so much. With its own edges alone, every cell moves for itself, as the covariance of a single point has
it: the far edge's place is one more unknown of the bar, w in q = (d, w, a, b, c). (Kay, Fundamentals of
Statistical Signal Processing I, ch. 3.)
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sim.bench.vision_stand import Truth
from sim.world import World

FloatArray = NDArray[np.float64]

PIXEL_VARIANCE_PX2 = 1.0 / 12.0  # of the average over a square pixel, along any direction
ROUNDING_VARIANCE = 1.0 / 12.0  # of a whole grey value
_REACH = 6.0  # sigmas beyond the outer edges, where levels alone are seen
_LEVEL = 3.0  # line widths of pixels that tell a level
_STEP_SIGMAS = 1.0 / 16.0  # of the integral
_STEP_MM = 1e-3


def offset_information(
    levels: tuple[float, float, float],
    width_px: float,
    sigma_px: float,
    shot: float,
    dark: float,
    own_edge: bool = False,
) -> float:
    """Information on the offset of a bar's edge, per px of its length, in 1/px^2; the levels are unknown.

    levels: grey values inside, of the line, beyond; beyond equal to the line's: a single step. width_px: of the line;
    sigma_px: of the whole blur; shot: variance per grey value; dark: variance of a black pixel. own_edge: whether the
    line's far edge moves for itself.
    """
    inside, line, beyond = levels
    single = beyond == line
    reach = _REACH * sigma_px
    # Cells and borders are many line widths across: their own pixels tell their levels.
    end = reach + (1.0 - single + _LEVEL) * width_px
    x = np.arange(-reach - _LEVEL * width_px, end, _STEP_SIGMAS * sigma_px)
    first, second = ndtr(x / sigma_px), ndtr((x - width_px) / sigma_px)
    bell = np.exp(-0.5 * (x / sigma_px) ** 2) / (sigma_px * np.sqrt(2.0 * np.pi))
    later = np.exp(-0.5 * ((x - width_px) / sigma_px) ** 2) / (sigma_px * np.sqrt(2.0 * np.pi))
    image = inside + (line - inside) * first + (beyond - line) * second
    slope = -(line - inside) * bell - (beyond - line) * later
    gradients = [slope, 1.0 - first, first] if single else [slope, 1.0 - first, first - second, second]
    if own_edge and not single:
        gradients.append(-(beyond - line) * later)
    weight = np.gradient(x) / (shot * np.maximum(image, 0.0) + dark)
    g = np.array(gradients)
    F = (g * weight) @ g.T
    return float(F[0, 0] - F[0, 1:] @ np.linalg.solve(F[1:, 1:], F[1:, 0]))


def shown_length(start_px: FloatArray, end_px: FloatArray, width: int, height: int) -> float:
    """Length in px of the part of a straight edge that an image of this size shows (Liang and Barsky, 1984)."""
    first, last = 0.0, 1.0
    for at, step, size in zip(start_px, end_px - start_px, (width, height), strict=True):
        for room, speed in ((at + 0.5, -step), (size - 0.5 - at, step)):
            if speed == 0.0:
                last = last if room >= 0.0 else first
            elif speed > 0.0:
                last = min(last, room / speed)
            else:
                first = max(first, room / speed)
    return max(last - first, 0.0) * float(np.hypot(*(end_px - start_px)))


def floor_covariance_mm2(
    world: World, truth: Truth, tick: int, cells: NDArray[np.int64], own_edges: bool = False
) -> FloatArray:
    """The least covariance (n, 3, 3) of the centres of these cells (n,) in the left camera's frame."""
    corners, centres = truth.corners_px(tick), truth.centres_mm(tick)
    return np.stack([np.linalg.inv(_information(world, corners[:, n], centres[n], int(n), own_edges)) for n in cells])


def _information(world: World, corners_px: FloatArray, centre_mm: FloatArray, cell: int, own_edges: bool) -> FloatArray:
    """Information (3, 3) on one cell's centre; corners_px (2, 4, 2)."""
    F = np.zeros((3, 3))
    for eye, camera in enumerate(world.eyes):
        steps = centre_mm + _STEP_MM * np.concatenate([np.eye(3), -np.eye(3)])
        px = camera.project(steps)
        A = ((px[:3] - px[3:]) / (2.0 * _STEP_MM)).T
        F += A.T @ _eye_information(world, eye, corners_px[eye], cell, own_edges) @ A
    return F


def _eye_information(world: World, eye: int, corners_px: FloatArray, cell: int, own_edges: bool) -> FloatArray:
    """Information (2, 2) on the cell's place in one image, from what it shows of the four sides."""
    camera, paint = world.scenario.camera, world.scenario.paint
    top = float((1 << camera.bits) - 1)
    shot, dark = top / camera.full_well_e, (camera.read_noise_e * top / camera.full_well_e) ** 2 + ROUNDING_VARIANCE
    sigma = float(np.sqrt(camera.psf_sigma_px**2 + PIXEL_VARIANCE_PX2))
    light = _light(world, cell)
    panel, column, row = _place(world, cell)
    table = world.scenario.panel[panel]
    beside = ((column, row - 1), (column + 1, row), (column, row + 1), (column - 1, row))
    extent = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
    F = np.zeros((2, 2))
    for side, (c, r) in enumerate(beside):
        along = corners_px[(side + 1) % 4] - corners_px[side]
        length = float(np.hypot(*along))
        normal = np.array([along[1], -along[0]]) / length
        axis = 1 - side % 2  # sides 0 and 2 lie across Y, 1 and 3 across X
        across = 0.5 * (extent[(side + 1) % 4] + extent[(side + 3) % 4])
        width = float(across * (table.pitch_mm[axis] - table.cell_mm[axis]) / table.cell_mm[axis])
        whole = 0 <= c < table.columns and 0 <= r < table.rows
        line = paint.line * light
        inside = world.art.cells[cell] * light
        neighbour = cell + (c - column) * table.rows + (r - row)
        beyond = world.art.cells[neighbour] * light if whole else line
        shown = shown_length(
            corners_px[side], corners_px[(side + 1) % 4], world.eyes[eye].width, world.eyes[eye].height
        )
        J = shown * offset_information((inside, line, beyond), width, sigma, shot, dark, own_edges)
        F += J * np.outer(normal, normal)
    return F


def _light(world: World, cell: int) -> float:
    """Grey value of a white surface at this cell of the flat wing."""
    camera, lamp, wing = world.scenario.camera, world.scenario.light, world.scenario.wing
    x, y = world.cells_mm[cell]
    uneven = 1.0 + lamp.gradient[0] * (x / wing.length_mm - 0.5) + lamp.gradient[1] * y / wing.width_mm
    return float(lamp.level_per_ms * camera.exposure_ms * ((1 << camera.bits) - 1) * max(uneven, 0.0))


def _place(world: World, cell: int) -> tuple[int, int, int]:
    """Panel, column and row of a cell."""
    for panel, table in enumerate(world.scenario.panel):
        count = table.columns * table.rows
        if cell < count:
            return panel, cell // table.rows, cell % table.rows
        cell -= count
    raise IndexError(cell)
