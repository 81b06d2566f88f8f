"""Cells of a bent wing are bent: what that does to points that were measured as if cells were flat.

A wing's panels are joined by folds, at which its slope jumps. The smooth surface that all cells are expected on rounds
these kinks off, and takes up to twice the panels' curvature for it beside a fold. So the valid points are fitted once
more, by the surface's own bending functions and a kink at every fold: the bending functions then have the curvature.
What is left over is bent as well, where a panel is held: see curvature.py.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.blur import PIXEL_VARIANCE
from fsw.vision.curvature import Patches, bend_patches, make_patches
from fsw.vision.edges import FloatArray, solve
from fsw.vision.grid import CellGrid
from fsw.vision.perspective import centre_share, side_normal
from fsw.vision.prediction import BENDING, POINT_SIGMA_MM, RIGID, Surface, bending_functions, locate
from fsw.vision.rig import Eyes, project
from fsw.vision.sides import inset_px
from fsw.vision.stereo import Points
from wingbeat.kernels import tick_kernel

KINK_SIGMA_MM = 10.0  # how far a kink may move the wing half its length beyond the fold
STEP_SIGMA_MM = 0.1  # and how far a hinge that does not lie in its gap's middle makes it lie higher beyond the fold
CLOSER = 0.1  # so much closer than to the surface points may lie to one with kinks


class Bow(NamedTuple):
    """What is needed of the grid, and the working memory; K is BENDING and the number of folds."""

    basis: FloatArray  # (N, K) bending functions, kinks and steps at the cells' centres
    rise: FloatArray  # (N, 2, BENDING) of their centres above the mean of the ends, along X and along Y
    tilt: FloatArray  # (N, 2, K) of the middle of side 0 above that of side 2, and of side 1 above that of side 3
    prior: FloatArray  # (K,) weight of each factor's being 0, against a measured centre, 1 / mm2
    matrix: FloatArray  # (K, K) normal equations,
    factor: FloatArray  # (K,) their right side, then the factors beyond the surface's unknowns, mm
    work: FloatArray  # (6, 4) of one cell's sides
    patches: Patches  # what points lie off the surface with its kinks


def make_bow(grid: CellGrid, surface: Surface) -> Bow:
    """Take the memory for this grid and its surface."""
    middle = bending_functions(grid, grid.centre_mm)
    side_mm = 0.5 * (grid.corners_mm + np.roll(grid.corners_mm, -1, axis=1))
    sides = bending_functions(grid, side_mm)
    rise = np.stack([middle - 0.5 * (sides[:, 1] + sides[:, 3]), middle - 0.5 * (sides[:, 0] + sides[:, 2])], axis=1)
    basis = _with_kinks(grid, grid.centre_mm, middle)
    ends = _with_kinks(grid, side_mm, sides)
    count = basis.shape[1]
    prior = np.full(count, (CLOSER * POINT_SIGMA_MM / KINK_SIGMA_MM) ** 2)
    prior[count - len(grid.folds_mm) :] = (CLOSER * POINT_SIGMA_MM / STEP_SIGMA_MM) ** 2
    prior[:BENDING] = CLOSER**2 * surface.point_prior[RIGID : RIGID + BENDING]
    tilt = np.ascontiguousarray(ends[:, :2] - ends[:, 2:])
    equations = np.zeros((count, count)), np.zeros(count)
    return Bow(basis, np.ascontiguousarray(rise), tilt, prior, *equations, np.zeros((6, 4)), make_patches(grid))


def _with_kinks(grid: CellGrid, flat_mm: FloatArray, bending: FloatArray) -> FloatArray:
    """Bending functions (..., BENDING) at places (..., 2) on the flat wing, and the kinks and steps there.

    A kink that lies elsewhere in its gap, or two of them, are one in the middle and a step to all cells.
    """
    beyond = [flat_mm[..., 0] - fold for fold in grid.folds_mm]
    kinks = [np.maximum(x, 0.0) / (0.5 * grid.outline_mm[0]) for x in beyond]
    steps = [(x > 0.0).astype(np.float64) for x in beyond]
    return np.concatenate([bending, np.stack(kinks + steps, axis=-1)], axis=-1) if kinks else bending


@tick_kernel
def fit_kinks(surface: Surface, points: Points, bow: Bow) -> None:
    """Fit bow.factor to what the valid points lie off the surface, along its normal; zero if that cannot be done."""
    A, b, R, count = bow.matrix, bow.factor, surface.rotation, bow.factor.shape[0]
    A[:] = 0.0
    b[:] = 0.0
    for n in range(points.valid.shape[0]):
        bow.patches.off_mm[n] = math.nan
        if not points.valid[n]:
            continue
        x, y, z = locate(surface, n, 4)
        dx, dy, dz = points.xyz_mm[n, 0] - x, points.xyz_mm[n, 1] - y, points.xyz_mm[n, 2] - z
        off = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        bow.patches.off_mm[n] = off
        for i in range(count):
            here = bow.basis[n, i]
            b[i] += here * off
            for j in range(i + 1):
                A[i, j] += here * bow.basis[n, j]
    for i in range(count):
        A[i, i] += bow.prior[i]
    if not solve(A, b, count):
        b[:] = 0.0


@tick_kernel
def _bend(surface: Surface, points: Points, bow: Bow) -> None:
    """Write bow.patches.rise_mm (N, 2) of the valid points that the surface with its kinks was fitted to."""
    R, off = surface.rotation, bow.patches.off_mm
    for n in range(points.valid.shape[0]):
        if not points.valid[n] or math.isnan(off[n]):
            off[n] = bow.patches.variance[n] = math.nan
            continue
        for j in range(bow.factor.shape[0]):
            off[n] -= bow.basis[n, j] * bow.factor[j]
        C, variance = points.covariance_mm2[n], 0.0
        for i in range(3):
            for j in range(3):
                variance += R[i, 2] * C[i, j] * R[j, 2]
        bow.patches.variance[n] = variance
    bend_patches(bow.patches)


@tick_kernel
def tilt_extents(
    surface: Surface,
    eyes: Eyes,
    corners_px: FloatArray,
    chosen: NDArray[np.bool_],
    bow: Bow,
    out_px: FloatArray,
) -> None:
    """Write to out_px (2, N, 2) what the fitted kinks add to a cell's extents from side 2 to 0 and from 3 to 1.

    chosen (N,): of which cells; the others stay. corners_px (2, N, 4, 2): the surface's ideal pixels. A cell seen askew
    is seen longer or shorter as it tilts.
    """
    R, count = surface.rotation, bow.factor.shape[0]
    for n in range(bow.tilt.shape[0]):
        if not chosen[n]:
            continue
        X, Y, Z = locate(surface, n, 4)
        for axis in range(2):
            higher = 0.0
            for j in range(count):
                higher += bow.tilt[n, axis, j] * bow.factor[j]
            for eye in range(2):
                P = eyes.projection[eye]
                _, nx, ny = side_normal(corners_px[eye, n], axis)
                u, v, w = project(P, X, Y, Z)
                up = 0.0  # px that a mm along the wing's normal is, across the sides
                for i in range(3):
                    up += ((P[0, i] - u * P[2, i]) * nx + (P[1, i] - v * P[2, i]) * ny) / w * R[i, 2]
                out_px[eye, n, axis] = higher * up


@tick_kernel
def unbend(
    surface: Surface,
    eyes: Eyes,
    corners_px: FloatArray,
    covariance_px2: FloatArray,
    blur_px: FloatArray,
    bow: Bow,
    points: Points,
) -> None:
    """Move the valid points from the mean of their cells' corners to the bent cells' centres.

    surface, bow: fitted to the points. corners_px (2, N, 4, 2): the surface's ideal pixels. covariance_px2 (2, N, 3):
    of the measured centres. blur_px (2, 2): the eyes', across sides along X and along Y. A side along X is an arch,
    found above its ends by the mean of its measured part, 1 - share^2 / 3 of the bow along X, and lies at the end of
    the bow along Y; a side along Y likewise. Moving each to the height of the centre moves the centre in both images,
    and so the point, by one step of its triangulation. Then, and not before, the covariance has what lies between the
    two ways to a point (see triangulate_cells).
    """
    _bend(surface, points, bow)
    nx, ny, share, g, a = bow.work[0], bow.work[1], bow.work[2], bow.work[3], bow.work[4:]
    for n in range(points.valid.shape[0]):
        if not points.valid[n]:
            continue
        g[:] = 0.0
        bow_x, bow_y = bow.patches.rise_mm[n, 0], bow.patches.rise_mm[n, 1]
        for j in range(BENDING):
            factor = surface.unknowns[RIGID + j] + bow.factor[j]
            bow_x += factor * bow.rise[n, 0, j]
            bow_y += factor * bow.rise[n, 1, j]
        X, Y, Z = points.xyz_mm[n, 0], points.xyz_mm[n, 1], points.xyz_mm[n, 2]
        for eye in range(2):
            c, P = corners_px[eye, n], eyes.projection[eye]
            u, v, w = project(P, X, Y, Z)
            up_x, up_y = 0.0, 0.0  # px that a mm along the wing's normal is
            for i in range(3):
                a[0, i], a[1, i] = (P[0, i] - u * P[2, i]) / w, (P[1, i] - v * P[2, i]) / w
                up_x += a[0, i] * surface.rotation[i, 2]
                up_y += a[1, i] * surface.rotation[i, 2]
            for k in range(4):
                length, nx[k], ny[k] = side_normal(c, k)
                if k < 2:
                    whole = math.sqrt(blur_px[eye, k] ** 2 + PIXEL_VARIANCE)
                    share[k] = 1.0 - 2.0 * inset_px(length, whole) / length
            arch_x, arch_y = bow_y + bow_x * share[0] * share[0] / 3.0, bow_x + bow_y * share[1] * share[1] / 3.0
            dx, dy = 0.0, 0.0
            for k in range(4):
                lift = (up_x * nx[k] + up_y * ny[k]) * (arch_x if k % 2 == 0 else arch_y)
                gx, gy = centre_share(nx, ny, k)
                dx, dy = dx + lift * gx, dy + lift * gy
            xx, xy, yy = covariance_px2[eye, n]
            det = xx * yy - xy * xy
            wx, wy = (yy * dx - xy * dy) / det, (xx * dy - xy * dx) / det
            for i in range(3):
                g[i] += a[0, i] * wx + a[1, i] * wy
        C = points.covariance_mm2[n]
        for i in range(3):
            points.xyz_mm[n, i] += C[i, 0] * g[0] + C[i, 1] * g[1] + C[i, 2] * g[2]
        between, trace = points.between_mm[n], 0.0
        for i in range(3):
            for j in range(3):
                C[i, j] += between[i] * between[j]
            trace += C[i, i]
        points.sigma_mm[n] = math.sqrt(trace)
