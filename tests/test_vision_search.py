"""The quick look finds a line where it is, and takes none for found that lies beyond its reach."""

import math
from typing import Any

import numpy as np
import pytest

from fsw.vision.bridging import step_of
from fsw.vision.grid import Panel, make_grid
from fsw.vision.rig import StereoRig, eyes_of
from fsw.vision.search import look, make_sightings
from hal.frame import as_frame

SIZE, LOW, HIGH, LINE = 240, 80.0, 160.0, 8.0  # px: image, a square cell's edges, the lines beside it


def seen(offset_px: float, within_px: float) -> np.ndarray[Any, Any]:
    """Offsets (2, 2) of both eyes' +X and +Y lines, whose true ones are offset_px."""
    from_px = np.arange(SIZE) - 0.5
    edge = HIGH + offset_px
    line = np.clip(np.minimum(from_px + 1.0, edge + LINE) - np.maximum(from_px, edge), 0.0, 1.0)
    image = as_frame((50.0 + 100.0 * np.maximum(line[:, None], line[None, :])).astype(np.uint8))
    rig = StereoRig(
        np.full((2, 2), SIZE),
        np.tile([1000.0, 1000.0, 120.0, 120.0], (2, 1)),
        np.zeros((2, 5)),
        np.stack([np.eye(3)] * 2),
        np.array([[0.0, 0.0, 0.0], [-100.0, 0.0, 0.0]]),
    )
    cell = np.array([[LOW, LOW], [HIGH, LOW], [HIGH, HIGH], [LOW, HIGH]])
    sightings = make_sightings(1)
    ratio, neighbour = np.full((1, 4), LINE / (HIGH - LOW)), np.zeros((1, 4), dtype=np.int64)
    corners, in_view = np.tile(cell, (2, 1, 1, 1)), np.ones(1, dtype=np.bool_)
    look(image, image, eyes_of(rig), corners, in_view, ratio, neighbour, 1.0, 1, within_px, sightings)
    return sightings.offset_px[:, 0]


@pytest.mark.parametrize("offset_px", [-5.3, -2.0, 0.0, 0.4, 5.0])
def test_a_line_is_found_where_it_is(offset_px: float) -> None:
    assert seen(offset_px, 6.0) == pytest.approx(np.full((2, 2), offset_px), abs=0.1)


@pytest.mark.parametrize("offset_px", [-12.0, -8.0, 8.0, 12.0])
def test_a_line_beyond_the_reach_is_not_found_at_its_end(offset_px: float) -> None:
    """Its flank there would pull all lines to the same wrong place, which they would then confirm."""
    assert np.isnan(seen(offset_px, 6.0)).all()
    assert seen(offset_px, 20.0) == pytest.approx(np.full((2, 2), offset_px), abs=0.1)


@pytest.mark.parametrize(("columns", "rows"), [(39, 18), (17, 18), (3, 5), (40, 30)])
def test_the_cells_looked_at_are_in_every_row(columns: int, rows: int) -> None:
    grid = make_grid([Panel((0.0, 0.0), columns, rows, (40.0, 22.0), (38.0, 20.0))], (1600.0, 1000.0), True)
    step = step_of(grid, 150)
    assert math.gcd(step, rows) == 1
    assert grid.count // 150 <= step <= 1 + 3 * grid.count // 150
    if step <= columns:
        assert set(grid.cell[::step, 2]) == set(range(rows))
