"""Assignments that one eye cannot rule out: fold gaps and borders decide, and what they leave open stays open."""

import numpy as np
import pytest
from vision_scene import three_panels

from fsw.vision.grid import CellGrid, Panel, make_grid
from fsw.vision.identity import assignments, fitting, tables
from fsw.vision.lattice import Lattice, link

BOUND = np.array([45.0, 45.0])


def _bent(xy: np.ndarray) -> np.ndarray:
    """A view of the wing: shifted by more than a row's pitch, turned, and curved by vibration."""
    x, y = xy[..., 0] - 700.0, xy[..., 1]
    return xy + np.stack((14.0 - 0.03 * y + 1e-5 * x * x, -24.0 + 0.03 * x + 2e-5 * x * y), axis=-1)


def _lattices(corners: np.ndarray, grid: CellGrid) -> list[Lattice]:
    one = tables(grid)[0]
    gaps = sorted({round(float(s), 3) for s in one.step_mm} - {round(one.pitch_mm[0], 3)})
    return link(corners, one.cell_mm, (one.pitch_mm[0], *gaps), one.pitch_mm[1])


def _labels(grid: CellGrid, cells: np.ndarray) -> list[tuple[int, np.ndarray]]:
    corners = _bent(grid.corners_mm[cells])
    found, _ = assignments(corners, _lattices(corners, grid), tables(grid), grid, BOUND)
    assert all(0 <= f.wrong <= f.whole.contradicted for f in found)  # the bound by which most are left out
    return [(f.contradicted, f.label) for f in sorted((f.whole for f in found), key=lambda f: f.contradicted)]


@pytest.mark.parametrize("gap", [5.9, 22.0, 60.0])
def test_a_gap_and_both_borders_leave_one_assignment(gap: float) -> None:
    grid = three_panels(gap_mm=gap)
    x = grid.centre_mm[:, 0]
    cells = np.flatnonzero((x > 330) & (x < 1000))
    found = _labels(grid, cells)
    assert found[0][0] == 0
    assert np.array_equal(found[0][1], cells)
    assert len(found) == 1 or found[1][0] >= 12


def test_rows_stay_open_where_no_border_row_is_in_view() -> None:
    grid = three_panels()
    x, row = grid.centre_mm[:, 0], grid.cell[:, 2]
    cells = np.flatnonzero((x > 330) & (x < 1000) & (row > 3) & (row < 14))
    found = _labels(grid, cells)
    assert sum(wrong == 0 for wrong, _ in found) > 1
    shifts = {int(grid.cell[label[0], 2] - grid.cell[cells[0], 2]) for wrong, label in found if wrong == 0}
    assert 0 in shifts
    assert all(grid.cell[label[0], 1] == grid.cell[cells[0], 1] for wrong, label in found if wrong == 0)


def test_panels_that_a_bar_parts_are_put_together() -> None:
    grid = three_panels()
    x, row = grid.centre_mm[:, 0], grid.cell[:, 2]
    cells = np.flatnonzero((x > 330) & (x < 1000) & (row != 8) & (row != 9))
    found = _labels(grid, cells)
    assert (found[0][0], len(found[0][1])) == (0, len(cells))
    assert np.array_equal(found[0][1], cells)


def test_panels_with_unlike_rows_make_tables_of_their_own() -> None:
    grid = make_grid(
        [Panel((5.0, -190.0), 8, 10, (40.0, 38.0), (38.0, 36.0)),
         Panel((340.0, -190.0), 6, 16, (40.0, 23.0), (38.0, 21.0))],
        (600.0, 400.0), True,
    )  # fmt: skip
    assert [t.cell.shape for t in tables(grid)] == [(8, 10), (6, 16)]
    assert [t.cell.shape for t in tables(three_panels())] == [(39, 18)]
    assert np.array_equal(tables(three_panels())[0].cell.ravel(), np.arange(702))


def test_a_quadrilateral_that_is_not_its_cell_does_not_fit() -> None:
    grid = three_panels()
    cells = np.flatnonzero(grid.centre_mm[:, 0] < 700)
    corners = _bent(grid.corners_mm[cells])
    corners[5, 1:3, 0] -= 6.0  # half hidden by a glint
    found, _ = assignments(corners, _lattices(corners, grid), tables(grid), grid, BOUND)
    best = min((f.whole for f in found), key=lambda f: f.contradicted)
    assert list(np.flatnonzero(~fitting(best.label, corners, best.warp, grid))) == [5]
