"""Where each cell is expected: one surface of the wing, shared by both eyes.

The wing is its flat grid at a reference pose, moved in its plane as a rigid body and bent out of its plane by a
low-order polynomial. A few numbers hold all of it, so both eyes and all cells move together: none can slip alone.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.grid import CellGrid
from fsw.vision.rig import Eyes, image_point, project
from wingbeat.kernels import inline_kernel, tick_kernel

BoolArray = NDArray[np.bool_]

# Unknowns, in mm. Rigid in the plane: shift along X and Y, turn. Bending: the polynomial 1, x, y, xy, x2, x2 y, x3 of
# first bending and torsion, and y2, x y2, x3 y, x4, x5 of what large motions show besides (the curvature across that
# comes with one along, second modes). Lean: x, x2, xy along X and x, x2 along Y, by which a wing that bends away from
# a reference pose that was itself bent moves in that pose's plane. Nothing stretches it across: a view that took one
# row for the next would need that, and cannot be explained.
RIGID, BENDING, LEAN = 3, 12, 5
FEW = RIGID + 7  # the unknowns of a quick look, which must not bend to follow a mistaken line
UNKNOWNS = RIGID + BENDING + LEAN

# How large they may be, as standard deviations at the wing's end.
_SIGMA_MM = [50.0] * RIGID + [100.0] * 5 + [30.0] * 2 + [3.0, 3.0, 10.0, 20.0, 10.0] + [5.0] * LEAN
POINT_SIGMA_MM = 0.1  # what a measured centre's distance from this surface is, at most
_LINE_SIGMA_PX = 0.5  # and a sighted line's


class Surface(NamedTuple):
    """The wing's surface: reference pose, basis at corners and centres, and the current unknowns."""

    rotation: FloatArray  # (3, 3) X_left = rotation (X_wing + d) + translation
    translation_mm: FloatArray  # (3,)
    flat_mm: FloatArray  # (N, 5, 2) four corners and the centre on the flat wing
    basis: FloatArray  # (N, 5, BENDING) bending polynomial there
    half_mm: float  # half the wing's length: the turn in the plane is counted in mm there, like all else
    unknowns: FloatArray  # (UNKNOWNS,) mm
    point_prior: FloatArray  # (UNKNOWNS,) weight of each unknown's being 0, against a measured centre, 1 / mm2
    line_prior: FloatArray  # (UNKNOWNS,) and against a sighted line, px2 / mm2


def make_surface(grid: CellGrid) -> Surface:
    """A flat surface at rest, pose unset."""
    flat = np.concatenate([grid.corners_mm, grid.centre_mm[:, None]], axis=1)
    sigma = np.array(_SIGMA_MM)
    return Surface(
        np.eye(3),
        np.zeros(3),
        flat,
        bending_functions(grid, flat),
        0.5 * grid.outline_mm[0],
        np.zeros(UNKNOWNS),
        (POINT_SIGMA_MM / sigma) ** 2,
        (_LINE_SIGMA_PX / sigma) ** 2,
    )


def bending_functions(grid: CellGrid, flat_mm: FloatArray) -> FloatArray:
    """The bending polynomial's terms (..., BENDING) at places (..., 2) on the flat wing."""
    x, y = flat_mm[..., 0] / (0.5 * grid.outline_mm[0]) - 1.0, flat_mm[..., 1] / (0.5 * grid.outline_mm[1])
    one = np.ones_like(x)
    terms = [one, x, y, x * y, x * x, x * x * y, x**3, y * y, x * y * y, x**3 * y, x**4, x**5]
    return np.ascontiguousarray(np.stack(terms, axis=-1))


def set_pose(surface: Surface, rotation: FloatArray, translation_mm: FloatArray) -> None:
    """Lay the reference pose, flat and at rest."""
    surface.rotation[:] = rotation
    surface.translation_mm[:] = translation_mm
    surface.unknowns[:] = 0.0


@inline_kernel
def derive(
    surface: Surface, X: float, Y: float, basis: FloatArray, x: float, y: float, z: float, row: FloatArray
) -> None:
    """Derivative (UNKNOWNS,) of a point's place along a direction x, y, z of the wing's axes.

    X, Y, basis (BENDING,): of the point on the flat wing.
    """
    row[0], row[1], row[2] = x, y, (y * X - x * Y) / surface.half_mm
    for j in range(BENDING):
        row[RIGID + j] = z * basis[j]
    i = RIGID + BENDING
    row[i], row[i + 1], row[i + 2] = x * basis[1], x * basis[4], x * basis[3]
    row[i + 3], row[i + 4] = y * basis[1], y * basis[4]


@inline_kernel
def locate(surface: Surface, n: int, k: int) -> tuple[float, float, float]:
    """Place of corner k (or of the centre, k = 4) of cell n in the left camera's frame, in mm."""
    R, t, q, b = surface.rotation, surface.translation_mm, surface.unknowns, surface.basis
    X, Y = surface.flat_mm[n, k, 0], surface.flat_mm[n, k, 1]
    i = RIGID + BENDING
    x = X + q[0] - q[2] * Y / surface.half_mm + q[i] * b[n, k, 1] + q[i + 1] * b[n, k, 4] + q[i + 2] * b[n, k, 3]
    y = Y + q[1] + q[2] * X / surface.half_mm + q[i + 3] * b[n, k, 1] + q[i + 4] * b[n, k, 4]
    z = 0.0
    for j in range(BENDING):
        z += q[RIGID + j] * b[n, k, j]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@tick_kernel
def distance_from(surface: Surface, n: int, xyz_mm: FloatArray) -> float:
    """Distance of a point (3,) from the centre of cell n, in mm."""
    x, y, z = locate(surface, n, 4)
    return math.sqrt((xyz_mm[0] - x) ** 2 + (xyz_mm[1] - y) ** 2 + (xyz_mm[2] - z) ** 2)


@tick_kernel
def expect(
    surface: Surface,
    eyes: Eyes,
    corners_px: FloatArray,
    depth_mm: FloatArray,
    centre_px: FloatArray,
    in_view: BoolArray,
    step: int = 1,
) -> None:
    """Expected ideal pixels of corners (2, N, 4, 2), their depths (2, N, 4), centres (2, N, 2), and whether a centre is
    in the image (2, N).

    step: of every so many cells; the others stay. Corners of cells in view of neither eye stay as well.
    """
    for n in range(0, surface.flat_mm.shape[0], step):
        x, y, z = locate(surface, n, 4)
        for eye in range(2):
            u, v, depth = project(eyes.projection[eye], x, y, z)
            centre_px[eye, n, 0], centre_px[eye, n, 1] = u, v
            inside, _, _ = image_point(eyes, eye, u, v)
            in_view[eye, n] = inside and depth > 0.0
        if in_view[0, n] or in_view[1, n]:
            _expect_corners(surface, eyes, n, corners_px, depth_mm)


@tick_kernel
def expect_again(surface: Surface, eyes: Eyes, chosen: BoolArray, corners_px: FloatArray, depth_mm: FloatArray) -> None:
    """As `expect`, of the corners (2, N, 4, 2) of the chosen cells (N,) alone: the others stay."""
    for n in range(chosen.shape[0]):
        if chosen[n]:
            _expect_corners(surface, eyes, n, corners_px, depth_mm)


@inline_kernel
def _expect_corners(surface: Surface, eyes: Eyes, n: int, corners_px: FloatArray, depth_mm: FloatArray) -> None:
    for k in range(4):
        x, y, z = locate(surface, n, k)
        for eye in range(2):
            u, v, depth_mm[eye, n, k] = project(eyes.projection[eye], x, y, z)
            corners_px[eye, n, k, 0], corners_px[eye, n, k, 1] = u, v
