"""The relative position descriptor names points by their distance to gap and border; char rewards straight queues."""

import numpy as np
import pytest
from vision_scene import facing, paper_rig, rotation, three_panels

from fsw.vision.descriptor import describe, find_borders, fold_gaps, gap_threshold, match
from fsw.vision.enhancement import apply_homography, char, enhance_points, plane_homography, queue_variances


def _view() -> tuple[np.ndarray, np.ndarray]:
    grid = three_panels()
    part = (grid.centre_mm[:, 0] > 380) & (grid.centre_mm[:, 0] < 900)
    return grid.centre_mm[part], grid.cell[part]


def test_the_gap_is_found_where_columns_stand_wider_than_a_pitch() -> None:
    xy, cell = _view()
    gaps = fold_gaps(xy[:, 0], 39.6, gap_threshold(39.6, 59.6))
    left, right = xy[cell[:, 0] == 0, 0].max(), xy[cell[:, 0] == 1, 0].min()
    assert gaps == pytest.approx(np.array([[left, right]]))
    assert find_borders(xy[cell[:, 0] == 1], (39.6, 21.8)) is None


def test_points_match_by_descriptor_though_one_eye_lacks_some_and_stands_elsewhere() -> None:
    xy, _ = _view()
    rng = np.random.default_rng(5)
    a = xy + rng.normal(0, 0.3, xy.shape)
    order = rng.permutation(len(xy))[20:]
    b = xy[order] + (107.0, -31.0) + rng.normal(0, 0.3, (len(order), 2))
    rpd = [describe(p, find_borders(p, (39.6, 21.8))) for p in (a, b)]
    pairs = match(*rpd, limit=6.0)
    assert len(pairs) == len(order)
    assert np.array_equal(order[pairs[:, 1]], pairs[:, 0])
    assert match(rpd[0], np.empty((0, 2)), 6.0).shape == (0, 2)


def test_enhancement_straightens_queues_and_raises_char() -> None:
    rig = paper_rig(4096)
    R, t = facing(rig, (640.0, 0.0), 720.0, rotation(6, -9, 5))
    xy, cell = _view()
    H = plane_homography(rig, 0, R, t)
    px = apply_homography(H, xy)
    assert enhance_points(H, px) == pytest.approx(xy, abs=1e-8)
    column, row = 100 * cell[:, 0] + cell[:, 1], cell[:, 2]
    before, after = (char(*queue_variances(p, column, row)) for p in (px, 6.5 * enhance_points(H, px)))
    assert before < 0.9 < after


@pytest.mark.requirement("WB-VIS-06")
def test_char_gives_the_papers_values_for_the_variances_that_they_need() -> None:
    assert char(914.0, 914.0) == pytest.approx(0.9091, abs=2e-4)
    assert char(7070.0, 7070.0) == pytest.approx(0.4665, abs=3e-4)
    assert char(0.0, 0.0) > 0.9999


def test_queue_variances_are_those_inside_queues_only() -> None:
    xy = np.array([[0.0, 0.0], [1.0, 10.0], [50.0, 0.0], [53.0, 10.0]])
    x, y = queue_variances(xy, np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]))
    assert (x, y) == (pytest.approx((0.5 + 4.5) / 2), 0.0)
    assert np.isnan(queue_variances(xy[:1], np.array([0]), np.array([0]))[0])
