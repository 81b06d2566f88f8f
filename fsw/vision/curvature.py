"""How a panel is bent beyond its surface, told near each cell by the points round it.

The wing's bending polynomial follows large motions, but not how a clamped root or a hinge bends a panel close by: there
it has the curvature wrong by a tenth and more, and a cell's bow with it. So a parabola is fitted to what the points of
SPAN x SPAN neighbouring cells lie off the surface with its kinks (least squares on a full grid, where the two
curvatures are apart from all other terms; Savitzky and Golay 1964). A cell at a border, or beside one that is not
valid, has that of the nearest full patch with it in.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.grid import CellGrid
from wingbeat.kernels import tick_kernel

HALF = 2
SPAN = 2 * HALF + 1
_SQUARES = 70.0  # of SPAN x SPAN numbers i2 - 2 with i = -2 .. 2
QUIET = 0.25  # of a point's own deviation: what its bow may be off by for the noise of the points round it


class Patches(NamedTuple):
    """The grid's panels, and working memory."""

    panel: NDArray[np.int64]  # (P, 3) first cell, columns, rows
    share: FloatArray  # (P, 2) bow along X and along Y, of so much of the parabola's factors, in squares of the pitch
    off_mm: FloatArray  # (N,) what a point lies off the surface, NaN without one, and
    variance: FloatArray  # (N,) that place's variance, mm2
    columns: FloatArray  # (N, 4) sums over SPAN rows: of places, of places by i2 - 2, and their variances
    told: FloatArray  # (N, 4) of the patch about a cell: factors along X and along Y, and their variances; NaN if none
    rise_mm: FloatArray  # (N, 2) bow along X and along Y beyond the surface's


def make_patches(grid: CellGrid) -> Patches:
    """Take the memory for this grid."""
    sizes = [(panel.columns, panel.rows) for panel in grid.panels]
    first = np.cumsum([0, *(columns * rows for columns, rows in sizes[:-1])])
    panel = np.array([(n, *size) for n, size in zip(first, sizes, strict=True)], dtype=np.int64)
    # Half the second derivative, times the square of half a side.
    share = np.array([[-0.25 * (s / p) ** 2 for s, p in zip(q.cell_mm, q.pitch_mm, strict=True)] for q in grid.panels])
    one, four = (grid.count,), (grid.count, 4)
    return Patches(panel, share, *(np.zeros(shape) for shape in (one, one, four, four, (grid.count, 2))))


@tick_kernel
def bend_patches(patches: Patches) -> None:
    """Write rise_mm (N, 2) from off_mm and variance (N,)."""
    patches.rise_mm[:] = 0.0
    for p in range(patches.panel.shape[0]):
        first, columns, rows = patches.panel[p]
        if columns < SPAN or rows < SPAN:
            continue
        _add_rows(patches, first, columns, rows)
        _add_columns(patches, first, columns, rows)
        for column in range(columns):
            for row in range(rows):
                n = first + column * rows + row
                if patches.off_mm[n] == patches.off_mm[n]:
                    _take_nearest(patches, p, n, column, row)


@tick_kernel
def _weight(i: int) -> float:
    """Of a place i cells from the middle, in the parabola's factor."""
    return float(i * i - HALF)


@tick_kernel
def _add_rows(patches: Patches, first: int, columns: int, rows: int) -> None:
    for column in range(columns):
        for row in range(HALF, rows - HALF):
            n = first + column * rows + row
            plain, bent, plain_variance, bent_variance = 0.0, 0.0, 0.0, 0.0
            for i in range(-HALF, HALF + 1):
                w, off, variance = _weight(i), patches.off_mm[n + i], patches.variance[n + i]
                plain, bent = plain + off, bent + w * off
                plain_variance, bent_variance = plain_variance + variance, bent_variance + w * w * variance
            sums = patches.columns[n]
            sums[0], sums[1], sums[2], sums[3] = plain, bent, plain_variance, bent_variance


@tick_kernel
def _add_columns(patches: Patches, first: int, columns: int, rows: int) -> None:
    for column in range(HALF, columns - HALF):
        for row in range(HALF, rows - HALF):
            n = first + column * rows + row
            along, across, along_variance, across_variance = 0.0, 0.0, 0.0, 0.0
            for i in range(-HALF, HALF + 1):
                w, sums = _weight(i), patches.columns[n + i * rows]
                along, across = along + w * sums[0], across + sums[1]
                along_variance, across_variance = along_variance + w * w * sums[2], across_variance + sums[3]
            told = patches.told[n]
            told[0], told[1] = along / _SQUARES, across / _SQUARES
            told[2], told[3] = along_variance / _SQUARES**2, across_variance / _SQUARES**2


@tick_kernel
def _take_nearest(patches: Patches, p: int, n: int, column: int, row: int) -> None:
    """Write a cell's rise by the nearest patch that holds it, and is full and quiet; without one it stays 0."""
    _, columns, rows = patches.panel[p]
    share, best = patches.share[p], math.inf
    for i in range(max(column - HALF, HALF), min(column + HALF, columns - 1 - HALF) + 1):
        for j in range(max(row - HALF, HALF), min(row + HALF, rows - 1 - HALF) + 1):
            away = float((i - column) ** 2 + (j - row) ** 2)
            if away >= best:
                continue
            told = patches.told[n + (i - column) * rows + j - row]
            noise = max(share[0] * share[0] * told[2], share[1] * share[1] * told[3])
            if noise <= QUIET * QUIET * patches.variance[n]:  # not so without a full patch: NaN
                best = away
                patches.rise_mm[n, 0], patches.rise_mm[n, 1] = share[0] * told[0], share[1] * told[1]
