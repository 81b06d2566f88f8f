"""All cells of a wing have their size, up to what changes evenly across the view: others are not trusted.

What size a cell is seen with, the surface tells that was fitted to this tick's points, with its kinks at the folds: the
one expected before would show cells larger or smaller towards the rim of a view in motion. Where even that is not
exact, as with a blur or a scale that is a little wrong, a plane and its curvature through all sizes is no fault of any
cell. Cells at a border have one side without a line; a blur of another shape than the models' pulls it otherwise than
lines, all of them alike. What they are larger or smaller by than the rest tells so, and not which sides are wrong.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fsw.vision.corners import Cells
from fsw.vision.edges import FloatArray, solve
from fsw.vision.perspective import extent_across, side_normal
from wingbeat.kernels import tick_kernel

GATE_SIGMAS = 4.0  # a size farther from the others' than noise and their scatter explain: the centre is off by as many
ODD_PX = 0.5  # a size as odd as this is a wrong edge, whose error no sigma describes: the cell is not found
ASKEW_SIGMAS = 3.0  # so is a side's tilt against the one across, by as many px, if it is so far beyond noise as well
SLOPE = 12.0  # times the variance of an evenly seen line's middle: that of its slope
EVEN_PX = 0.25  # as much as sizes differ evenly; what is farther off has no say in what is even
STEP = 6
TERMS = 7  # 1, u, v, u2, uv, v2, and STEP: from the other cells to those at a border
USED = 4 + TERMS  # column of the working memory that says which sizes the trend is fitted to
WORK = USED + 1  # columns of the working memory,
ROWS_BEHIND = 2 * (TERMS + 1)  # and its rows behind those of the cells
_LEAST = 3 * TERMS  # cells that tell a curvature; fewer tell the mean
_ROUNDS = 5  # trend and scatter of the sizes, each time without those that are odd
_HOLD = 1e-3  # cells that hold each factor but the mean at 0, where places do not tell it


@tick_kernel
def widen_odd_sizes(
    expected_px: FloatArray,
    tilted_px: FloatArray,
    neighbour: NDArray[np.int64],
    work: FloatArray,
    out: Cells,
    odd: NDArray[np.bool_],
) -> None:
    """Widen the covariance of cells an extent of which is odd: one of its two sides is off by the difference.

    expected_px (N, 4, 2): corners by the surface fitted to this tick's points; tilted_px (N, 2): see tilt_extents.
    neighbour (N, 4): see measure_cells. work (N + ROWS_BEHIND, WORK): written. odd (N,): set where a
    covariance was widened. Which side is wrong is not known, so both may be: the centre is off by half of the
    difference for each.
    """
    cells = len(expected_px)
    for axis in range(2):
        count = _compare(expected_px, tilted_px, neighbour, axis, work, out)
        if count < 3:
            continue
        scatter, step = _even(work, cells, TERMS if count >= _LEAST else 1)
        for n in range(cells):
            if not out.found[n]:
                continue
            off, nx, ny = work[n, 0] - work[n, 3], work[n, 1], work[n, 2]
            C = out.covariance_px2[n]
            # The extent is the difference of two sides, the centre their mean: four times the variance.
            own = 4.0 * (C[0] * nx * nx + 2.0 * C[1] * nx * ny + C[2] * ny * ny)
            wrong, wider = False, 0.0
            if out.paired[n, axis]:
                tilt = _tilt(out.corners_px[n], expected_px[n], axis, nx, ny)
                wrong = tilt * tilt > max(ODD_PX * ODD_PX, ASKEW_SIGMAS * ASKEW_SIGMAS * SLOPE * own)
            if off * off > GATE_SIGMAS**2 * max(own, scatter * scatter):
                wrong, wider = wrong or abs(off) > ODD_PX, 0.5 * off * off
            if wrong:
                out.found[n] = out.whole[n] = out.paired[n, 0] = out.paired[n, 1] = False
            if work[n, 4 + STEP] > 0.0 and step * step > own:
                # Less is noise. Where a side is hidden, the centre moves by all that the other one is off by.
                wider += (0.25 if out.paired[n, axis] else 1.0) * step * step
            if wrong or wider > 0.0:
                odd[n] = True
                C[0], C[1], C[2] = C[0] + wider * nx * nx, C[1] + wider * nx * ny, C[2] + wider * ny * ny


@tick_kernel
def _tilt(c: FloatArray, expected: FloatArray, k: int, nx: float, ny: float) -> float:
    """By how much more than expected a cell of corners c (4, 2) is wider at the end of side k than at its start, px."""
    k1, k2, k3 = (k + 1) % 4, (k + 2) % 4, (k + 3) % 4
    x = c[k1, 0] - c[k2, 0] - c[k, 0] + c[k3, 0] - expected[k1, 0] + expected[k2, 0] + expected[k, 0] - expected[k3, 0]
    y = c[k1, 1] - c[k2, 1] - c[k, 1] + c[k3, 1] - expected[k1, 1] + expected[k2, 1] + expected[k, 1] - expected[k3, 1]
    return x * nx + y * ny


@tick_kernel
def _compare(
    expected_px: FloatArray,
    tilted_px: FloatArray,
    neighbour: NDArray[np.int64],
    axis: int,
    work: FloatArray,
    out: Cells,
) -> int:
    """Write to work (N, ..) how much larger than expected cells are along an axis, its normal, and their terms.

    NaN where not both sides were seen. Returns of how many they were.
    """
    count = 0
    u0, u1, v0, v1 = math.inf, -math.inf, math.inf, -math.inf
    for n in range(len(expected_px)):
        work[n, 0] = math.nan
        work[n, 4 + STEP] = (neighbour[n, axis] < 0) != (neighbour[n, axis + 2] < 0)
        if not out.found[n]:
            continue
        _, nx, ny = side_normal(expected_px[n], axis)
        work[n, 1], work[n, 2] = nx, ny
        if not out.paired[n, axis]:
            continue
        e = expected_px[n]
        work[n, 0] = extent_across(out.corners_px[n], axis, nx, ny)
        work[n, 0] -= extent_across(e, axis, nx, ny) + tilted_px[n, axis]
        u, v = 0.5 * (e[0, 0] + e[2, 0]), 0.5 * (e[0, 1] + e[2, 1])
        work[n, 5], work[n, 6] = u, v
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        count += 1
    half = max(0.5 * (u1 - u0), 0.5 * (v1 - v0), 1.0)
    for n in range(len(expected_px)):
        u, v = (work[n, 5] - 0.5 * (u0 + u1)) / half, (work[n, 6] - 0.5 * (v0 + v1)) / half
        work[n, 4], work[n, 5], work[n, 6], work[n, 7], work[n, 8], work[n, 9] = 1.0, u, v, u * u, u * v, v * v
    return count


@tick_kernel
def _even(work: FloatArray, cells: int, terms: int) -> tuple[float, float]:
    """Write to work[:, 3] what of the sizes work[:, 0] changes evenly across the view; returns the scatter, and STEP.

    The rows behind the cells' are the normal equations with their right side, and again to be solved. Sizes far from
    the trend are left out, round by round; the first one is the mean, so that a row of wrong sides at the rim does not
    bend it. Few come or go in later rounds.
    """
    scatter, limit, step = 0.0, math.inf, 0.0
    sums, A = work[cells : cells + TERMS + 1, :TERMS], work[cells + TERMS + 1 :, :TERMS]
    b = A[TERMS]
    for n in range(cells):
        work[n, 3] = 0.0
    for turn in range(_ROUNDS):
        used = 1 if turn == 0 else terms
        if turn <= 1:
            sums[:] = 0.0
            for n in range(cells):
                work[n, USED] = 0.0
        changed = turn <= 1
        for n in range(cells):
            use = abs(work[n, 0] - work[n, 3]) <= limit
            if use != (work[n, USED] > 0.0):
                _add_size(work[n], 1.0 if use else -1.0, used, sums)
                work[n, USED], changed = use, True
        if not changed:
            break  # the same sizes have the same trend
        for i in range(used):
            b[i] = sums[TERMS, i]
            for j in range(i + 1):
                A[i, j] = sums[i, j] + (_HOLD if i == j and i > 0 else 0.0)
        if A[0, 0] < 3.0 or not solve(A, b, used):
            break
        step = min(max(b[STEP], -EVEN_PX), EVEN_PX) if used > STEP else 0.0
        squares, count = 0.0, 0
        for n in range(cells):
            trend = 0.0
            for i in range(1, min(used, STEP)):
                trend += b[i] * work[n, 4 + i]
            trend = b[0] + min(max(trend, -EVEN_PX), EVEN_PX) + step * work[n, 4 + STEP]
            off = work[n, 0] - trend
            if work[n, USED] > 0.0:
                squares, count = squares + off * off, count + 1
            work[n, 3] = trend
        scatter = math.sqrt(squares / count)
        limit = min(GATE_SIGMAS * scatter, EVEN_PX)
    return scatter, step


@tick_kernel
def _add_size(size: FloatArray, share: float, terms: int, sums: FloatArray) -> None:
    """Add a size, a row of the working memory, to the normal equations; with share -1 it is taken out again."""
    for i in range(terms):
        weighed = share * size[4 + i]
        sums[TERMS, i] += weighed * size[0]
        for j in range(i + 1):
            sums[i, j] += weighed * size[4 + j]
