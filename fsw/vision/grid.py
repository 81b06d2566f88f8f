"""The wing's grid of cells as arrays: which cells there are, and where their corners lie on the flat wing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A cell's corners in units of its size, from the first corner; side k runs from corner k to corner k + 1.
CORNER_OFFSETS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
SIDES = 4


@dataclass(frozen=True)
class Panel:
    """One rigid panel: the first cell's outer corner, number of columns (X) and rows (Y), pitch and cell size in mm."""

    origin_mm: tuple[float, float]
    columns: int
    rows: int
    pitch_mm: tuple[float, float]
    cell_mm: tuple[float, float]


@dataclass(frozen=True)
class CellGrid:
    """All N cells of the wing, panel by panel from the root, column by column, row by row.

    cell (N, 3): panel, column, row. corners_mm (N, 4, 2) and centre_mm (N, 2): on the flat wing. neighbour (N, 4): the
    cell across side k, or -1 at a panel's border. line_mm (N, 4): width of the line across side k, NaN at a border.
    dark: whether cells are darker than the lines between them. outline_mm (2,): length and width of the wing.
    """

    panels: tuple[Panel, ...]
    outline_mm: tuple[float, float]
    dark: bool
    cell: IntArray
    corners_mm: FloatArray
    centre_mm: FloatArray
    neighbour: IntArray
    line_mm: FloatArray

    @property
    def count(self) -> int:
        """Number of cells N."""
        return len(self.cell)

    @property
    def column(self) -> IntArray:
        """Column (N,) of each cell, counted from the root through all panels."""
        before = np.cumsum([0, *(panel.columns for panel in self.panels)])
        return np.asarray(before[self.cell[:, 0]] + self.cell[:, 1], dtype=np.int64)

    @property
    def folds_mm(self) -> list[float]:
        """X of the folds: the middles of the gaps between panels."""
        ends = [p.origin_mm[0] + (p.columns - 1) * p.pitch_mm[0] + p.cell_mm[0] for p in self.panels]
        return [0.5 * (end + after.origin_mm[0]) for end, after in zip(ends, self.panels[1:], strict=False)]

    def index(self, panel: int, column: int, row: int) -> int:
        """Index n of the cell at this place."""
        first = sum(p.columns * p.rows for p in self.panels[:panel])
        return first + column * self.panels[panel].rows + row


def line_ratios(grid: CellGrid) -> FloatArray:
    """Width of the line across each side over the cell's extent across it (N, 4); at a border the usual line's."""
    pitch = np.array([panel.pitch_mm for panel in grid.panels])[grid.cell[:, 0]]
    size = np.array([panel.cell_mm for panel in grid.panels])[grid.cell[:, 0]]
    ratio = (pitch - size) / size
    return np.ascontiguousarray(ratio[:, [1, 0, 1, 0]])


def make_grid(panels: Sequence[Panel], outline_mm: tuple[float, float], dark: bool) -> CellGrid:
    """Lay out the cells of these panels."""
    cell: list[tuple[int, int, int]] = []
    corners: list[FloatArray] = []
    neighbour: list[list[int]] = []
    line: list[list[float]] = []
    for p, panel in enumerate(panels):
        first = len(cell)
        pitch, size = np.array(panel.pitch_mm), np.array(panel.cell_mm)
        gap_x, gap_y = pitch - size
        for c in range(panel.columns):
            for r in range(panel.rows):
                cell.append((p, c, r))
                corners.append(np.array(panel.origin_mm) + pitch * (c, r) + size * CORNER_OFFSETS)
                beside = ((c, r - 1), (c + 1, r), (c, r + 1), (c - 1, r))
                inside = [0 <= i < panel.columns and 0 <= j < panel.rows for i, j in beside]
                neighbour.append(
                    [first + i * panel.rows + j if k else -1 for (i, j), k in zip(beside, inside, strict=True)]
                )
                widths = (gap_y, gap_x, gap_y, gap_x)
                line.append([w if k else np.nan for w, k in zip(widths, inside, strict=True)])
    corners_mm = np.array(corners)
    return CellGrid(
        panels=tuple(panels),
        outline_mm=outline_mm,
        dark=dark,
        cell=np.array(cell, dtype=np.int64),
        corners_mm=corners_mm,
        centre_mm=corners_mm.mean(axis=1),
        neighbour=np.array(neighbour, dtype=np.int64),
        line_mm=np.array(line),
    )
