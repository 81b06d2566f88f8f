"""Sides that stand in for hidden ones: what the other cells' size says, and how honest its variance is."""

import numpy as np
import pytest
from vision_scene import FloatArray, paper_rig

from fsw.vision.corners import make_cells
from fsw.vision.edges import SIZE_SUMS
from fsw.vision.perspective import extent_across
from fsw.vision.rig import eyes_of
from fsw.vision.standing_in import (
    LEAST_CELLS,
    LEAST_SIGMA,
    RIM,
    SHAPE_SIGMA,
    SLOPE,
    add_size,
    drop_unseen,
    forget_size,
    is_inside,
    learn_size,
    stand_in,
)


def learnt(shares: FloatArray, extent_px: float = 80.0, noise_px: float = 0.0) -> FloatArray:
    """Size (2,), along Y, after whole cells of these shares of the expected extent."""
    size, sums = np.zeros((2, 2)), np.zeros((2, SIZE_SUMS))
    forget_size(size)
    for _ in range(2):  # what the first tick finds is known in the second
        sums[:] = 0.0
        for share in shares:
            add_size(size, 0, extent_px, share * extent_px, noise_px**2, sums)
        learn_size(size, sums)
    assert size[1].tolist() == [1.0, SHAPE_SIGMA**2]  # nothing was said along X
    return size[0]


def test_the_extent_is_that_of_a_parallelogram() -> None:
    corners = np.array([[0.0, 0.0], [30.0, 10.0], [22.0, 34.0], [-8.0, 24.0]])
    along = np.array([3.0, 1.0]) / np.sqrt(10.0)
    area = 30.0 * 24.0 + 8.0 * 10.0
    assert extent_across(corners, 0, along[1], -along[0]) == pytest.approx(area / np.hypot(30.0, 10.0))
    assert extent_across(corners, 2, -along[1], along[0]) == pytest.approx(area / np.hypot(30.0, 10.0))


def test_cells_all_larger_than_expected_are_taken_at_their_size() -> None:
    share, variance = learnt(np.full(40, 1.002))
    assert share == pytest.approx(1.002) and variance == LEAST_SIGMA**2


def test_scatter_beyond_the_measurements_noise_makes_the_size_unsure() -> None:
    draw = np.random.default_rng(4)
    noise_px, spread = 0.02, 5e-4
    quiet = 1.0 + draw.standard_normal(4000) * noise_px / 80.0
    share, variance = learnt(quiet, noise_px=noise_px)
    assert share == pytest.approx(1.0, abs=2e-5) and np.sqrt(variance) < 1.5e-4
    share, variance = learnt(quiet + spread * draw.standard_normal(4000), noise_px=noise_px)
    assert np.sqrt(variance) == pytest.approx(RIM * spread, rel=0.1)


def test_few_cells_say_nothing_of_the_size() -> None:
    share, variance = learnt(np.full(LEAST_CELLS - 1, 1.002))
    assert (share, variance) == (1.0, SHAPE_SIGMA**2)


def test_the_variance_of_a_centre_between_a_side_and_its_stand_in_is_what_errors_give() -> None:
    draw = np.random.default_rng(9)
    side_px, size = 0.01, np.array([[1.001, 2e-4**2], [1.0, SHAPE_SIGMA**2]])
    expected, looked = 80.0, 80.3  # the cell was looked for a little too large
    true = draw.normal(1.001, 2e-4, 20000) * expected
    error = draw.normal(0.0, side_px, 20000)
    centres, claimed = [], 0.0
    for extent, e in zip(true, error, strict=True):
        across = 0.25 + e  # the side across lies 0.25 px farther out than looked for
        middle, variance = stand_in(size, 0, False, expected, looked, across, side_px**2, 0.0)
        centres.append(0.5 * (middle - across) - 0.5 * (extent - looked - 2.0 * 0.25))
        claimed = 0.25 * (variance + side_px**2)
    assert np.mean(centres) == pytest.approx(0.0, abs=3e-4)
    assert np.var(centres) == pytest.approx(claimed, rel=0.05)


def test_a_side_that_something_covers_is_believed_as_little_as_what_is_told() -> None:
    size = np.array([[1.001, 2e-4**2], [1.0, 2e-3**2]])
    assert stand_in(size, 0, True, 80.0, 80.0, 0.0, 1e-4, 0.0)[1] == pytest.approx(3e-4 + (SHAPE_SIGMA * 80.0) ** 2)
    assert stand_in(size, 1, True, 80.0, 80.0, 0.0, 1e-4, 0.0)[1] == pytest.approx(3e-4 + (2e-3 * 80.0) ** 2)
    assert stand_in(size, 0, False, 80.0, 80.0, 0.0, 1e-4, 0.0)[1] == pytest.approx(3e-4 + (2e-4 * 80.0) ** 2)
    askew = stand_in(size, 0, False, 80.0, 80.0, 0.0, 1e-4, 0.5)[1]
    assert askew == pytest.approx(3e-4 + (2e-4 * 80.0) ** 2 + (0.5 * SLOPE * 80.0) ** 2)


def test_a_side_that_the_distortion_alone_would_fold_back_into_the_image_is_not_in_it() -> None:
    rig = paper_rig(1024, (-0.3, 0.0, 0.0, 0.0, 0.0))
    cell = rig.intrinsics[0, 2:] + np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 40.0], [0.0, 40.0]])
    for u, inside in ((0.0, True), (2000.0, False)):
        c = cell + np.array([u, 0.0])
        image_px = rig.distort(0, c)
        assert ((image_px >= 0.0) & (image_px <= rig.size[0] - 1.0)).all()
        assert is_inside(eyes_of(rig), 0, c, 2) is inside


def test_a_cell_that_neither_eye_sees_from_side_to_side_is_measured_by_nobody() -> None:
    left, right = make_cells(5), make_cells(5)
    for eye in (left, right):
        eye.found[:] = True
    left.paired[:] = [[True, True], [True, False], [False, True], [True, False], [True, True]]
    right.paired[:] = [[True, True], [True, False], [True, False], [True, True], [False, True]]
    drop_unseen(left, right)
    for eye in (left, right):
        assert eye.found.tolist() == [True, False, True, True, True]
        assert not eye.paired[1].any()
