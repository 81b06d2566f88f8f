"""What perspective does to a cell and to the lines beside it, as the cell's expected corners tell it."""

import math

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.rig import norm
from wingbeat.kernels import tick_kernel

OWN_SHARE = 0.45  # of a cell's extent: what lies as near to a side is its own, not the side across's


@tick_kernel
def seen_middle(c: FloatArray, depth: FloatArray) -> tuple[float, float]:
    """Projection of the middle of four corners, seen at c (4, 2) in these depths (4,).

    The images of a flat cell's diagonals cross there, too; a twisted cell's diagonals do not meet.
    """
    whole = depth[0] + depth[1] + depth[2] + depth[3]
    x = depth[0] * c[0, 0] + depth[1] * c[1, 0] + depth[2] * c[2, 0] + depth[3] * c[3, 0]
    y = depth[0] * c[0, 1] + depth[1] * c[1, 1] + depth[2] * c[2, 1] + depth[3] * c[3, 1]
    return x / whole, y / whole


@tick_kernel
def side_normal(c: FloatArray, k: int) -> tuple[float, float, float]:
    """Length of side k of a quadrangle c (4, 2), and its unit normal: outwards where the corners turn from x to y."""
    k1 = (k + 1) % 4
    ex, ey = c[k1, 0] - c[k, 0], c[k1, 1] - c[k, 1]
    length = norm(ex, ey)
    return length, ey / length, -ex / length


@tick_kernel
def sample_lean(c: FloatArray, k: int, far: int) -> float:
    """How fast, in px for a px, samples across side k of a quadrangle c (4, 2) near the side from it to corner `far`.

    Samples run along image columns or rows, whichever is steeper on the side.
    """
    k1 = (k + 1) % 4
    tx, ty = c[k1, 0] - c[k, 0], c[k1, 1] - c[k, 1]
    near = k1 if far == (k + 2) % 4 else k
    ex, ey = c[far, 0] - c[near, 0], c[far, 1] - c[near, 1]
    # Along the side for a px across it: of the side that leads away, and of the samples.
    side = (ex * tx + ey * ty) / (ex * ty - ey * tx)
    sample = -ty / tx if abs(tx) > abs(ty) else tx / ty
    return abs(side - sample)


@tick_kernel
def extent_across(c: FloatArray, k: int, nx: float, ny: float) -> float:
    """Extent of a cell of corners c (4, 2) from side k to the side across, along side k's outward normal."""
    k1, k2, k3 = (k + 1) % 4, (k + 2) % 4, (k + 3) % 4
    x, y = c[k, 0] + c[k1, 0] - c[k2, 0] - c[k3, 0], c[k, 1] + c[k1, 1] - c[k2, 1] - c[k3, 1]
    return 0.5 * (x * nx + y * ny)


@tick_kernel
def centre_share(nx: FloatArray, ny: FloatArray, k: int) -> tuple[float, float]:
    """By how much the corners' mean moves when side k moves by 1 px along its normal; nx, ny (4,): all normals."""
    j, i = (k + 3) % 4, (k + 1) % 4
    before = nx[j] * ny[k] - ny[j] * nx[k]
    after = nx[k] * ny[i] - ny[k] * nx[i]
    return 0.25 * (ny[i] / after - ny[j] / before), 0.25 * (nx[j] / before - nx[i] / after)


@tick_kernel
def line_width(c: FloatArray, depth: FloatArray, at: int, far: int, ratio: float, nx: float, ny: float) -> float:
    """How far outwards of a side, in px, the neighbour begins, on the cell's edge from corner `far` to corner `at`.

    c (4, 2): corners. depth (4,): of the corners. ratio: of the line's width to the cell's extent, on the wing.
    """
    away = (c[at, 0] - c[far, 0]) * nx + (c[at, 1] - c[far, 1]) * ny
    return ratio * away * depth[far] / (depth[at] + ratio * (depth[at] - depth[far]))


@tick_kernel
def line_between(
    c: FloatArray, expected: FloatArray, deviation: FloatArray, k: int, nx: float, ny: float
) -> tuple[float, float]:
    """As line_width, at the start and at the end of side k of a cell c (4, 2), by where the surface has the neighbour.

    c: of the surface. expected, less deviation (4, 2): the neighbour's corners on the surface. On a bent wing the cell
    itself tells the line's slope, and with it its width in a view askew, wrong on one side as much as on the other.
    """
    k1, k2, k3 = (k + 1) % 4, (k + 2) % 4, (k + 3) % 4
    x0, y0 = expected[k3, 0] - deviation[k3, 0] - c[k, 0], expected[k3, 1] - deviation[k3, 1] - c[k, 1]
    x1, y1 = expected[k2, 0] - deviation[k2, 0] - c[k1, 0], expected[k2, 1] - deviation[k2, 1] - c[k1, 1]
    return x0 * nx + y0 * ny, x1 * nx + y1 * ny


@tick_kernel
def mean_gain(expected_px: FloatArray, wanted: NDArray[np.bool_], row: int) -> float:
    """Mean distance from an edge per pixel along the image axis across it, of the sides along X (0) or along Y (1)."""
    gain, count = 0.0, 0
    for n in range(len(expected_px)):
        if wanted[n]:
            c, k1 = expected_px[n, row], expected_px[n, row + 1]
            ex, ey = abs(k1[0] - c[0]), abs(k1[1] - c[1])
            gain += max(ex, ey) / norm(ex, ey)
            count += 1
    return gain / count if count > 0 else 1.0


@tick_kernel
def least_plateau(expected_px: FloatArray, wanted: NDArray[np.bool_], line_ratio: FloatArray, row: int) -> float:
    """Least width of the lines across the sides along X (0) or along Y (1), up to the part of a cell that is its own.

    expected_px (N, 4, 2), wanted (N,), line_ratio (N, 4): see measure_cells.
    """
    least = math.inf
    for n in range(len(expected_px)):
        if wanted[n]:
            _, nx, ny = side_normal(expected_px[n], row)
            extent = abs(extent_across(expected_px[n], row, nx, ny))
            least = min(least, extent * min(line_ratio[n, row], OWN_SHARE))
    return least
