"""How a panel is bent beyond its surface, told near each cell by the points round it.

The wing's bending polynomial follows large motions, but not how a clamped root or a hinge bends a panel close by, nor
where a view ends: there it has the curvature wrong by a tenth and more, and a cell's bow with it. So a parabola is
fitted to what the points of 5 x 5 neighbouring cells lie off the surface with its kinks (least squares on a full grid,
where the two curvatures are apart from all other terms; Savitzky and Golay 1964). A cell at a border, or beside one
that is not valid, has that of the nearest full patch with it in; where so few columns or rows are seen, of 3 x 5. A
fold hands on the bending moment, and so the curvature: where fewer are seen, it is that of the cells beyond.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.grid import CellGrid
from wingbeat.kernels import tick_kernel

BEYOND = 4  # columns away that a cell's curvature may come from, at most
PATCHES = ((2, 2), (1, 2), (2, 1))  # cells from the middle, along X and along Y, in the order of preference
QUIET = 0.25  # of a point's own deviation: what its bow may be off by for the noise of the points round it


class Patches(NamedTuple):
    """The grid's panels, and working memory."""

    panel: NDArray[np.int64]  # (P, 3) first cell, columns, rows
    share: FloatArray  # (P, 2) bow along X and along Y, of so much of the parabola's factors, in squares of the pitch
    off_mm: FloatArray  # (N,) what a point lies off the surface, and
    variance: FloatArray  # (N,) that place's variance, mm2; NaN without a point
    sums: FloatArray  # (N, 4) over a patch's rows: of places, weighted for a parabola's factor, and their variances
    told: FloatArray  # (N, 4) of the patch about a cell: factors along X and along Y, and their variances
    rise_mm: FloatArray  # (N, 2) bow along X and along Y beyond the surface's


def make_patches(grid: CellGrid) -> Patches:
    """Take the memory for this grid."""
    sizes = [(panel.columns, panel.rows) for panel in grid.panels]
    first = np.cumsum([0, *(columns * rows for columns, rows in sizes[:-1])])
    panel = np.array([(n, *size) for n, size in zip(first, sizes, strict=True)], dtype=np.int64)
    # The middle of a side lies higher than its ends by the square of half of it.
    share = np.array([[-0.25 * (s / p) ** 2 for s, p in zip(q.cell_mm, q.pitch_mm, strict=True)] for q in grid.panels])
    one, four = (grid.count,), (grid.count, 4)
    return Patches(panel, share, *(np.zeros(shape) for shape in (one, one, four, four, (grid.count, 2))))


@tick_kernel
def bend_patches(patches: Patches) -> None:
    """Write rise_mm (N, 2) from off_mm and variance (N,); 0 where no patch tells it."""
    for p in range(patches.panel.shape[0]):
        first, columns, rows = patches.panel[p]
        for n in range(first, first + columns * rows):
            patches.rise_mm[n] = math.nan
        left = columns * rows
        for half_x, half_y in PATCHES:
            if left > 0 and columns > 2 * half_x and rows > 2 * half_y:
                _tell(patches, p, half_x, half_y)
                left = _take(patches, p, half_x, half_y)
    for p in range(patches.panel.shape[0]):
        first, columns, rows = patches.panel[p]
        for n in range(first, first + columns * rows):
            if not math.isnan(patches.off_mm[n]) and math.isnan(patches.rise_mm[n, 0]):
                _take_along(patches, p, n)
    for n in range(patches.rise_mm.shape[0]):
        if math.isnan(patches.rise_mm[n, 0]):
            patches.rise_mm[n] = 0.0


@tick_kernel
def _factor(half: int) -> tuple[float, float]:
    """Mean m of i2, and sum of squares of i2 - m, over i = -half .. half."""
    return (2.0, 14.0) if half == 2 else (2.0 / 3.0, 2.0 / 3.0)


@tick_kernel
def _tell(patches: Patches, p: int, half_x: int, half_y: int) -> None:
    """Write what all full patches of a panel tell, where their middles are: of others NaN."""
    first, columns, rows = patches.panel[p]
    (mean_x, squares_x), (mean_y, squares_y) = _factor(half_x), _factor(half_y)
    for column in range(columns):
        for row in range(half_y, rows - half_y):
            n = first + column * rows + row
            plain, bent, plain_variance, bent_variance = 0.0, 0.0, 0.0, 0.0
            for i in range(-half_y, half_y + 1):
                w, off, variance = (i * i - mean_y) / squares_y, patches.off_mm[n + i], patches.variance[n + i]
                plain, bent = plain + off, bent + w * off
                plain_variance, bent_variance = plain_variance + variance, bent_variance + w * w * variance
            sums = patches.sums[n]
            sums[0], sums[1], sums[2], sums[3] = plain, bent, plain_variance, bent_variance
    wide, high = 2.0 * half_x + 1.0, 2.0 * half_y + 1.0
    for column in range(half_x, columns - half_x):
        for row in range(half_y, rows - half_y):
            n = first + column * rows + row
            along, across, along_variance, across_variance = 0.0, 0.0, 0.0, 0.0
            for i in range(-half_x, half_x + 1):
                w, sums = (i * i - mean_x) / squares_x, patches.sums[n + i * rows]
                along, across = along + w * sums[0], across + sums[1]
                along_variance, across_variance = along_variance + w * w * sums[2], across_variance + sums[3]
            told = patches.told[n]
            told[0], told[1] = along / high, across / wide
            told[2], told[3] = along_variance / (high * high), across_variance / (wide * wide)


@tick_kernel
def _take(patches: Patches, p: int, half_x: int, half_y: int) -> int:
    """Write the rises that are not known, by the nearest patch that holds a cell, and is full and quiet.

    Returns how many cells have no such patch.
    """
    first, columns, rows = patches.panel[p]
    share, left = patches.share[p], 0
    for column in range(columns):
        for row in range(rows):
            n, nearest = first + column * rows + row, math.inf
            if math.isnan(patches.off_mm[n]) or not math.isnan(patches.rise_mm[n, 0]):
                continue
            for i in range(max(column - half_x, half_x), min(column + half_x, columns - 1 - half_x) + 1):
                for j in range(max(row - half_y, half_y), min(row + half_y, rows - 1 - half_y) + 1):
                    away = float((i - column) ** 2 + (j - row) ** 2)
                    if away >= nearest:
                        continue
                    told = patches.told[n + (i - column) * rows + j - row]
                    noise = max(share[0] * share[0] * told[2], share[1] * share[1] * told[3])
                    if noise <= QUIET * QUIET * patches.variance[n]:  # not so of a patch that is not full: NaN
                        nearest = away
                        patches.rise_mm[n, 0], patches.rise_mm[n, 1] = share[0] * told[0], share[1] * told[1]
            left += nearest == math.inf
    return left


@tick_kernel
def _take_along(patches: Patches, p: int, n: int) -> None:
    """Write a cell's rise by the nearest cell of its row that has one, fold or not."""
    rise, rows = patches.rise_mm, patches.panel[p, 2]
    for away in range(1, BEYOND + 1):
        for m in (n - away * rows, n + away * rows):
            for q in range(max(p - 1, 0), min(p + 2, patches.panel.shape[0])):
                first, columns, alike = patches.panel[q]
                inside = alike == rows and first <= m < first + columns * rows
                if inside and math.isnan(rise[n, 0]) and not math.isnan(rise[m, 0]):
                    rise[n, 0], rise[n, 1] = rise[m, 0], rise[m, 1]
