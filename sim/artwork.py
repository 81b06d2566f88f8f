"""What is painted on the wing: panels, cells, lines and hinges as arrays that the renderer's loops read."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fsw.tables.schema import panel_span_mm
from sim.scenario import Scenario

FloatArray = NDArray[np.float64]


# Records, because compiled loops read their fields by name and fast. X and Y in mm of the wing's frame.
PANEL = np.dtype(
    [(name, np.float64) for name in ("x_from", "x_to", "y_from", "y_to", "line")]
    + [(name, np.float64) for name in ("first_x", "first_y", "pitch_x", "pitch_y", "cell_x", "cell_y")]
    + [(name, np.int64) for name in ("columns", "rows", "offset")]
)
HINGE = np.dtype([(name, np.float64) for name in ("x_from", "x_to", "y_from", "y_to", "reflectance")])


@dataclass(frozen=True)
class Artwork:
    """The painted wing.

    panels (P,) of PANEL: outline, reflectance of lines and borders, grid, index of the first cell; cells (N,):
    reflectances; hinges (H,) of HINGE: they lie over all else.
    """

    panels: NDArray[np.void]
    cells: FloatArray
    hinges: NDArray[np.void]


def make_artwork(scenario: Scenario, draw: np.random.Generator) -> Artwork:
    """Paint the scenario's wing; each cell's reflectance differs by a share of it that `draw` decides."""
    paint = scenario.paint
    border_x, border_y = paint.border_mm
    panels, number = [], 0
    for p in scenario.panel:
        (x0, x1), (y0, y1) = panel_span_mm(p)
        outline = (x0 - border_x, x1 + border_x, y0 - border_y, y1 + border_y)
        panels.append((*outline, paint.line, *p.origin_mm, *p.pitch_mm, *p.cell_mm, p.columns, p.rows, number))
        number += p.columns * p.rows
    half, over = paint.hinge_width_mm / 2.0, paint.hinge_overlap_mm
    hinges = [
        (before[1] - over, after[0] + over, y - half, y + half, paint.hinge)
        for before, after in pairwise(panels)
        for y in paint.hinge_y_mm
    ]
    spread = draw.uniform(-paint.cell_spread, paint.cell_spread, number)
    return Artwork(
        panels=np.array(panels, dtype=PANEL),
        cells=np.minimum(paint.cell * (1.0 + spread), 1.0),
        hinges=np.array(hinges, dtype=HINGE),
    )


def cell_centres(scenario: Scenario) -> FloatArray:
    """Centres (N, 2) of all cells on the flat wing: panel by panel, column by column, row by row."""
    centres = []
    for panel in scenario.panel:
        column, row = np.mgrid[: panel.columns, : panel.rows]
        first = np.array(panel.origin_mm) + 0.5 * np.array(panel.cell_mm)
        centres.append(first + np.stack([column.ravel(), row.ravel()], axis=1) * panel.pitch_mm)
    return np.concatenate(centres)
