"""Matching on the tick path: homographies are exact, and a shift by one row or column is never a match."""

from itertools import product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vision_scene import FloatArray, facing, paper_rig, rotation, three_panels

from fsw.vision.grid import CellGrid, Panel, line_ratios, make_grid
from fsw.vision.matching import (
    CORRECT,
    Matching,
    count_correct,
    describe,
    fit_homography,
    make_matching,
    match_descriptors,
    queue_variance,
)

panels = st.lists(
    st.tuples(st.integers(1, 5), st.integers(1, 6), st.floats(5.0, 60.0), st.floats(5.0, 60.0), st.floats(0.0, 9.0)),
    min_size=1,
    max_size=4,
)


def grid_of(parts: list[tuple[int, int, float, float, float]]) -> CellGrid:
    """Panels of (columns, rows, cell length, cell width, line) one after the other."""
    made, x = [], 3.0
    for columns, rows, length, width, line in parts:
        pitch = (length + line, width + 0.5 * line)
        made.append(Panel((x, -100.0), columns, rows, pitch, (length, width)))
        x += columns * pitch[0] + 20.0
    return make_grid(made, (x, 400.0), True)


@settings(deadline=None)  # the first call compiles
@given(panels)
def test_any_grid_counts_names_and_lays_out_its_cells(parts: list[tuple[int, int, float, float, float]]) -> None:
    grid = grid_of(parts)
    places = [(p, c, r) for p, part in enumerate(parts) for c in range(part[0]) for r in range(part[1])]
    assert grid.cell.tolist() == [list(place) for place in places] and grid.count == len(places)
    assert [grid.index(*place) for place in places] == list(range(grid.count))
    for n, (p, c, r) in enumerate(places):
        panel = grid.panels[p]
        first = np.array(panel.origin_mm) + np.array(panel.pitch_mm) * (c, r)
        length, width = panel.cell_mm
        expected = first + np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])
        assert grid.corners_mm[n] == pytest.approx(expected)
    assert grid.centre_mm == pytest.approx(grid.corners_mm.mean(axis=1))


@settings(deadline=None)  # the first call compiles
@given(panels)
def test_neighbours_know_each_other_across_their_line(parts: list[tuple[int, int, float, float, float]]) -> None:
    grid = grid_of(parts)
    ratio = line_ratios(grid)
    for n, side in product(range(grid.count), range(4)):
        other = grid.neighbour[n, side]
        extent = grid.panels[grid.cell[n, 0]].cell_mm[1 if side % 2 == 0 else 0]
        if other < 0:
            assert np.isnan(grid.line_mm[n, side])
            continue
        assert grid.neighbour[other, (side + 2) % 4] == n and grid.cell[other, 0] == grid.cell[n, 0]
        step = grid.centre_mm[other] - grid.centre_mm[n]
        assert step[0 if side % 2 == 0 else 1] == pytest.approx(0.0, abs=1e-9)
        assert step[1 if side % 2 == 0 else 0] * (-1.0 if side in (0, 3) else 1.0) > 0.0
        assert np.abs(step).sum() - extent == pytest.approx(grid.line_mm[n, side], abs=1e-9)
        assert ratio[n, side] * extent == pytest.approx(grid.line_mm[n, side], abs=1e-9)


def homography(source: FloatArray, target: FloatArray, chosen: FloatArray | None = None) -> tuple[bool, FloatArray]:
    H = np.zeros((3, 3))
    mask = np.ones(len(source), bool) if chosen is None else chosen
    return fit_homography(source, target, mask, np.zeros((8, 8)), np.zeros(8), H), H


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 2**32 - 1))
def test_a_homography_without_noise_is_found_exactly_from_the_chosen_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = np.array([[1.0, 0.0, 400.0], [0.0, 1.0, -300.0], [0.0, 0.0, 1.0]])
    H[:2, :2] += rng.uniform(-0.5, 0.5, (2, 2))
    H[2, :2] = rng.uniform(-2e-4, 2e-4, 2)
    source = rng.uniform(0.0, 1000.0, (40, 2))
    target = cv2.perspectiveTransform(source[None], H)[0]
    chosen = np.arange(40) < 30
    target[~chosen] += 500.0
    good, found = homography(source, target, chosen)
    assert good
    back = cv2.perspectiveTransform(source[None], found)[0]
    assert back[chosen] == pytest.approx(target[chosen], abs=1e-5)


def test_points_that_do_not_decide_a_homography_are_refused() -> None:
    line = np.column_stack([np.arange(10.0), 2.0 * np.arange(10.0)])
    square = np.random.default_rng(1).uniform(0.0, 10.0, (10, 2))
    assert not homography(line, square)[0]
    assert not homography(square, square, np.arange(10) < 3)[0]
    assert not homography(np.ones((10, 2)), square)[0]


@pytest.fixture
def seen() -> tuple[CellGrid, FloatArray, Matching]:
    """The wing in both eyes, bent a little: grid, centres (2, N, 2), and the descriptors' memory."""
    rig, grid = paper_rig(2048), three_panels()
    R, t = facing(rig, (560.0, 0.0), 720.0, rotation(4.0, 10.0, 2.0))
    x, y = grid.centre_mm.T
    xyz = np.column_stack([x, y, 8.0 * (x / 1600.0) ** 2]) @ R.T + t
    centre = np.stack([rig.project_ideal(eye, xyz) for eye in (0, 1)])
    work = make_matching(grid.count, 80)
    for eye in (0, 1):
        assert fit_homography(
            centre[eye], grid.centre_mm, np.ones(grid.count, bool), work.matrix, work.right, work.to_wing[eye]
        )
    return grid, centre, work


def pitch_of(grid: CellGrid) -> FloatArray:
    return np.array([grid.panels[p].pitch_mm for p in grid.cell[:, 0]])


def matches(
    grid: CellGrid, work: Matching, centre: FloatArray, names: tuple[FloatArray, FloatArray] | None = None
) -> FloatArray:
    """Match one frame; names: for each eye, the cell under whose name each centre stands (-1: not found)."""
    matched = np.zeros(grid.count, bool)
    boundary = np.array([grid.panels[p].origin_mm for p in grid.cell[:, 0]])
    for eye in (0, 1):
        name = np.arange(grid.count) if names is None else names[eye]
        found = name >= 0
        px = np.where(found[:, None], centre[eye][name], np.nan)
        describe(px, found, work.to_wing[eye], boundary, work.descriptor_mm[eye])
    count = match_descriptors(work, pitch_of(grid), matched)
    assert count == matched.sum()
    return matched


def shifted(grid: CellGrid, columns: int, rows: int) -> FloatArray:
    """Under each cell's name its neighbour so many columns and rows on; -1 where there is none."""
    table = {tuple(place): n for n, place in enumerate(grid.cell.tolist())}
    return np.array([table.get((p, c + columns, r + rows), -1) for p, c, r in grid.cell.tolist()])


def test_cells_under_their_own_names_match(seen: tuple[CellGrid, FloatArray, Matching]) -> None:
    grid, centre, work = seen
    for _ in range(2):
        assert matches(grid, work, centre).all()


@pytest.mark.parametrize(("columns", "rows"), [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1)])
@pytest.mark.parametrize("eye", [0, 1])
def test_a_shift_by_one_row_or_column_in_one_eye_is_no_match(
    seen: tuple[CellGrid, FloatArray, Matching], eye: int, columns: int, rows: int
) -> None:
    grid, centre, work = seen
    names = [np.arange(grid.count), np.arange(grid.count)]
    names[eye] = shifted(grid, columns, rows)
    assert not matches(grid, work, centre, (names[0], names[1])).any()


@pytest.mark.parametrize(("columns", "rows"), [(1, 0), (0, -1)])
def test_a_shift_in_both_eyes_from_one_frame_to_the_next_is_no_match(
    seen: tuple[CellGrid, FloatArray, Matching], columns: int, rows: int
) -> None:
    grid, centre, work = seen
    assert matches(grid, work, centre).all()
    names = shifted(grid, columns, rows)
    assert not matches(grid, work, centre, (names, names)).any()


def test_cells_that_one_eye_does_not_see_are_no_matches(seen: tuple[CellGrid, FloatArray, Matching]) -> None:
    grid, centre, work = seen
    names = np.arange(grid.count)
    some = np.where(names % 3 == 0, -1, names)
    assert matches(grid, work, centre, (names, some)).tolist() == (some >= 0).tolist()


def test_correct_matches_are_those_that_the_homography_of_all_confirms() -> None:
    rng, work = np.random.default_rng(6), make_matching(300, 20)
    left = rng.uniform(0.0, 1000.0, (300, 2))
    H = np.array([[0.9, 0.1, 20.0], [-0.1, 1.0, 5.0], [1e-4, 5e-5, 1.0]])
    right = cv2.perspectiveTransform(left[None], H)[0]
    matched = np.arange(300) < 250
    side_px = 20.0
    assert count_correct(work, left, right, matched, side_px) == 250
    wrong = rng.choice(250, 3, replace=False)
    right[wrong] += 5.0 * CORRECT * side_px
    assert count_correct(work, left, right, matched, side_px) == 247
    assert count_correct(work, left, right, np.arange(300) < 3, side_px) == 0


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 5.0))
def test_the_variance_inside_queues_is_numpys(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    queue, chosen = rng.integers(0, 6, 60), rng.random(60) < 0.8
    values = 100.0 * queue + rng.normal(size=60)
    groups = [scale * values[chosen & (queue == q)] for q in range(6)]
    squares = sum(len(g) * np.var(g) for g in groups if len(g))
    freedom = sum(len(g) - 1 for g in groups if len(g))
    assert queue_variance(values, queue, chosen, scale, np.ones((9, 3))) == pytest.approx(squares / freedom)


def test_queues_of_single_cells_have_no_variance() -> None:
    assert np.isnan(queue_variance(np.arange(4.0), np.arange(4), np.ones(4, bool), 1.0, np.zeros((5, 3))))
