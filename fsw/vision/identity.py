"""Which cell is which in one eye: every assignment of a lattice to the wing that the eye cannot rule out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsw.vision.cells import centres_of
from fsw.vision.grid import CellGrid
from fsw.vision.lattice import Lattice
from fsw.vision.surface import Warp, fit_warp
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A column's two steps, whose ratio differs from the wing's by more than this, contradict the assignment: 0.4 of
# what the wing's narrowest fold gap makes, within these limits (perspective alone brings 1-2 %)...
_STEP = (0.03, 0.12)
_STEP_ROWS = 2  # ...if at least so many rows show it
_AT = 0.2  # a cell stands within this part of a pitch from its place on the surface
_CORNER = 0.08  # its corners likewise, in parts of the cell's smaller size
_CROWD = 4  # so many linked cells are no accident: the wing must explain them
_HOPELESS = (8, 0.12)  # an assignment that contradicts more cells than this, and this part of them, is dropped at once
_REACHES = (
    2.5,
    5.0,
    10.0,
)  # pitches from known cells at which further ones are looked for, the next only after the last


@dataclass(frozen=True)
class Table:
    """Panels whose rows run on: cell (G, R) by column from the root and by row; step_mm (G - 1,) between columns."""

    cell: IntArray
    step_mm: FloatArray
    pitch_mm: tuple[float, float]
    cell_mm: tuple[float, float]


@dataclass(frozen=True)
class Labelling:
    """One assignment in one eye. label (K,): cell of each quadrilateral, or -1; contradicted: cells against it."""

    label: IntArray
    contradicted: int
    warp: Warp


@dataclass(frozen=True)
class Assignment:
    """One way to name the largest lattice in one eye.

    label (K,): as of a Labelling, the lattice's own cells only. wrong: how many cells contradict it at least; off: how
    many of the lattice's lie off the wing. centre_mm (K, 2), crowd (K,): of the quadrilaterals, and whether each is
    one of many that are linked.
    """

    label: IntArray
    wrong: int
    off: int
    centre_mm: FloatArray
    crowd: NDArray[np.bool_]
    grid: CellGrid

    @cached_property
    def whole(self) -> Labelling:
        """All cells named, when it is first asked for: most ways to name a wing need no closer look."""
        label = self.label.copy()
        warp = _take_in(label, self.centre_mm, self.grid)
        unexplained = int((self.crowd & (label < 0)).sum()) - self.off
        return Labelling(label, self.wrong + max(unexplained, 0), warp)


def tables(grid: CellGrid) -> list[Table]:
    """The wing's panels as tables: neighbours that share rows, pitch and cell size in one, others apart."""
    result: list[Table] = []
    first = 0
    for p, panel in enumerate(grid.panels):
        cell = first + np.arange(panel.columns * panel.rows).reshape(panel.columns, panel.rows)
        first += cell.size
        before = grid.panels[p - 1]
        alike = p > 0 and (before.rows, before.pitch_mm, before.cell_mm) == (panel.rows, panel.pitch_mm, panel.cell_mm)
        if alike and abs(before.origin_mm[1] - panel.origin_mm[1]) < 0.05 * panel.pitch_mm[1]:
            cell = np.concatenate((result.pop().cell, cell))
        step = np.diff(grid.centre_mm[cell[:, 0], 0])
        result.append(Table(cell, step, panel.pitch_mm, panel.cell_mm))
    return result


def assignments(
    corners_mm: FloatArray, lattices: Sequence[Lattice], table: Sequence[Table], grid: CellGrid, bound_mm: FloatArray
) -> tuple[list[Assignment], int]:
    """Assignments of the largest lattice to the wing.

    corners_mm (K, 4, 2): quadrilaterals in the metric view; lattices: theirs, largest first. bound_mm (2,): how far
    the view may displace a cell. Also returns how many cells contradict the least wrong assignment that was dropped.
    """
    centre = centres_of(corners_mm)
    main = lattices[0]
    hopeless = max(_HOPELESS[0], int(_HOPELESS[1] * len(main.member)))
    crowd = np.zeros(len(centre), dtype=np.bool_)
    for lattice in lattices:
        crowd[lattice.member] = len(lattice.member) >= _CROWD
    wide, high = (int(n) for n in main.place.max(axis=0) + 1)
    held = np.zeros((wide + 1, high + 1), dtype=np.int64)
    held[main.place[:, 0] + 1, main.place[:, 1] + 1] = 1
    held = held.cumsum(axis=0).cumsum(axis=1)
    ratios = _column_ratios(main)
    found = []
    dropped = len(main.member)
    for one in table:
        columns, rows = one.cell.shape
        g, r = np.arange(1 - wide, columns), np.arange(1 - high, rows)
        left, right = held[np.maximum(-g, 0)], held[np.minimum(columns - g, wide)]
        low, top = np.maximum(-r, 0), np.minimum(rows - r, high)
        on_wing = right[:, top] - left[:, top] - right[:, low] + left[:, low]
        off = len(main.member) - on_wing
        wrong = off + _false_steps(ratios, one, g)[:, None]
        open_ = (wrong <= hopeless) & (on_wing >= _CROWD)
        dropped = min(dropped, int(np.min(wrong[~open_], initial=dropped)))
        for i, j in np.argwhere(open_):
            label = np.full(len(centre), -1, dtype=np.int64)
            shift_mm = _lay(main.member, main.place, (g[i], r[j]), one.cell, centre, grid.centre_mm, label)
            if np.all(np.abs(shift_mm) <= bound_mm):
                found.append(Assignment(label, int(wrong[i, j]), int(off[i, j]), centre, crowd, grid))
    return found, dropped


@kernel
def _lay(
    member: IntArray,
    place: IntArray,
    first: tuple[int, int],
    cell: IntArray,
    centre_mm: FloatArray,
    wing_mm: FloatArray,
    label: IntArray,
) -> FloatArray:
    """Name a lattice's members, laid on a table's cells (G, R) from its place `first`; returns their mean shift (2,).

    centre_mm (K, 2): of the quadrilaterals; wing_mm (N, 2): of the cells. Members beside the table stay without a name.
    """
    shift, count = np.zeros(2), 0
    for m in range(len(member)):
        column, row = place[m, 0] + first[0], place[m, 1] + first[1]
        if 0 <= column < cell.shape[0] and 0 <= row < cell.shape[1]:
            n = label[member[m]] = cell[column, row]
            shift += centre_mm[member[m]] - wing_mm[n]
            count += 1
    return shift / count


class _Ratios(NamedTuple):
    """Of each column between two others: its number, how many rows show its two steps' ratio, and their median."""

    column: IntArray
    rows: IntArray
    ratio: FloatArray


def _column_ratios(lattice: Lattice) -> _Ratios:
    has = np.isfinite(lattice.ratio_x)
    order = np.lexsort((lattice.ratio_x[has], lattice.place[has, 0]))
    ratio = lattice.ratio_x[has][order]
    column, first, rows = np.unique(lattice.place[has, 0][order], return_index=True, return_counts=True)
    median = 0.5 * (ratio[first + (rows - 1) // 2] + ratio[first + rows // 2])
    enough = rows >= _STEP_ROWS
    return _Ratios(column[enough], rows[enough], median[enough])


def _false_steps(ratios: _Ratios, table: Table, first: IntArray) -> IntArray:
    """Number of cells (n,) at fold gaps that should not be there, or without those that should.

    first (n,): the table's column that the lattice's column 0 would be.
    """
    step = table.step_mm
    gaps = np.abs(step / table.pitch_mm[0] - 1.0)
    gaps = gaps[gaps > _STEP[0]]
    limit = np.clip(0.4 * gaps.min(), *_STEP) if len(gaps) else _STEP[1]
    between = first[:, None] + ratios.column - 1
    # Whatever lies beyond the table has no ratio, and contradicts nothing.
    expected = np.concatenate((step[1:] / step[:-1], [np.nan]))
    expected = expected[np.where((between >= 0) & (between < len(expected)), between, -1)]
    return np.asarray((np.abs(ratios.ratio / expected - 1.0) > limit) @ ratios.rows)


def _take_in(label: IntArray, centre: FloatArray, grid: CellGrid) -> Warp:
    """Give further quadrilaterals the cell at whose place they stand, nearest first.

    Writes label (K,); returns the surface's field.
    """
    pitch = np.array([p.pitch_mm for p in grid.panels]).min(axis=0)
    warp, _ = fit_warp(grid, grid.centre_mm[label[label >= 0]], centre[label >= 0])
    reach = 0
    while reach < len(_REACHES):
        open_ = np.flatnonzero(label < 0)
        free = np.setdiff1d(np.arange(grid.count), label)
        if not len(open_) or not len(free):
            break
        near, _ = cKDTree(centre[label >= 0] / pitch).query(centre[open_] / pitch)
        open_ = open_[near <= _REACHES[reach]]
        before = int((label >= 0).sum())
        if len(open_):
            miss, nearest = cKDTree(warp(grid.centre_mm[free]) / pitch).query(centre[open_] / pitch)
            order = np.argsort(miss, kind="stable")
            cells, first = np.unique(free[nearest[order]], return_index=True)
            taken = order[first]
            good = miss[taken] <= _AT
            label[open_[taken[good]]] = cells[good]
        if int((label >= 0).sum()) > before:
            warp, _ = fit_warp(grid, grid.centre_mm[label[label >= 0]], centre[label >= 0])
            reach = 0
        else:
            reach += 1
    return warp


def fitting(label: IntArray, corners_mm: FloatArray, warp: Warp, grid: CellGrid) -> NDArray[np.bool_]:
    """Quadrilaterals (K,) whose corners, and not only their centre, lie where the surface has those of their cell."""
    good = label >= 0
    off = corners_mm[good] - warp(grid.corners_mm[label[good]])
    corners = grid.corners_mm[label[good]]
    size = np.minimum(corners[:, 1, 0] - corners[:, 0, 0], corners[:, 3, 1] - corners[:, 0, 1])
    good[good] = np.linalg.norm(off, axis=2).max(axis=1) <= np.maximum(_CORNER * size, 1.0)
    return good
