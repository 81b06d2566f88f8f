"""Blur and widths of the lines that are told wrong, or change at once: found together, and honest while they settle."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsw.geometry import make_rig, make_wing_grid
from fsw.vision.edges import BLUR, COMMON, CROSS, EACH, OWN, RIGHT
from fsw.vision.settling import LEAST_NOISE, correct, learn_noise
from fsw.vision.tracking import Tracker, TrackingOptions
from sim.bench.vision_disturbed import clear_world, light_of, pixels_of
from sim.bench.vision_stand import Truth, bench_scenario, hardware
from sim.disturbances import smear
from sim.world import World

FloatArray = NDArray[np.float64]
SCENARIO = bench_scenario(4, 2)  # 1024 x 750 pixels, lines of 3 px
SOFT_PX = 1.1


@cache
def world() -> World:
    return clear_world(SCENARIO, 4)


@cache
def pair(blur_px: float, seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """What both eyes see of the first tick through lenses that blur so much; seed: of the noise."""
    images = []
    for eye in (0, 1):
        light = light_of(world(), 0, eye)
        more = float(np.sqrt(blur_px**2 - SCENARIO.camera.psf_sigma_px**2))
        if more > 0.0:
            light = cv2.GaussianBlur(light, (0, 0), more, borderType=cv2.BORDER_REPLICATE)
        images.append(pixels_of(light, SCENARIO, 1.0, (seed, eye)))
    return images[0], images[1]


@pytest.fixture
def tracker() -> Iterator[Tracker]:
    cameras, wing = hardware(SCENARIO)
    tracker = Tracker(make_rig(cameras), make_wing_grid(wing), TrackingOptions())
    yield tracker
    tracker.close()


def start(tracker: Tracker, blur_px: float) -> int:
    pose = world().pose
    return tracker.start(pose.rotation, pose.translation_mm, *pair(blur_px, 1))


def worst_sigmas(tracker: Tracker) -> FloatArray:
    """Largest error of each valid point in an axis, in its own standard deviations."""
    valid = tracker.points.valid
    error = (tracker.points.xyz_mm - Truth(world()).centres_mm(0))[valid]
    return np.asarray(np.abs(error / np.sqrt(np.einsum("nii->ni", tracker.points.covariance_mm2[valid]))).max(axis=1))


def test_the_pooled_step_is_that_of_the_whole_normal_equations() -> None:
    rng = np.random.default_rng(2)
    J, r = rng.normal(size=(60, COMMON)), rng.normal(size=60)
    J[:30, EACH:], J[30:, :EACH] = 0.0, 0.0  # an edge lies along X or along Y, and tells nothing of the others
    A, b = J.T @ J, J.T @ r
    pooled = np.column_stack([b, A.diagonal(), np.zeros(COMMON)])
    assert (RIGHT, OWN, CROSS) == (0, 1, 2)
    for width in range(BLUR + 1, COMMON, EACH):
        pooled[width, CROSS] = A[width, width - 1]
    step = np.zeros(COMMON)
    correct(pooled, step)
    assert step == pytest.approx(np.linalg.solve(A, b))
    correct(np.zeros((COMMON, 3)), step)
    assert step.tolist() == [0.0] * COMMON


@pytest.mark.parametrize(("at_zero", "growth"), [(0.6, 0.02), (2.0, 0.0), (1e-3, 0.03)])
def test_the_noise_is_learnt_from_what_edges_leave_over(at_zero: float, growth: float) -> None:
    rng, pooled, noise = np.random.default_rng(3), np.zeros((COMMON + 2, 3)), np.zeros(2)
    grey = rng.uniform(20.0, 220.0, 20000)
    square = (at_zero + growth * grey) * rng.chisquare(1, len(grey))
    for row, value in ((COMMON, np.ones_like(square)), (COMMON + 1, square)):
        pooled[row] = [np.sum(value * grey**power) for power in range(3)]
    learn_noise(pooled, noise)
    assert noise[0] >= LEAST_NOISE and noise[1] >= 0.0
    assert noise[0] + noise[1] * 120.0 == pytest.approx(at_zero + growth * 120.0, rel=0.05)
    assert noise[1] == pytest.approx(growth, abs=0.003)
    before = noise.copy()
    learn_noise(np.zeros_like(pooled), noise)
    assert noise.tolist() == before.tolist()


def test_a_start_finds_a_blur_twice_as_wide_as_told_and_no_width_goes_along(tracker: Tracker) -> None:
    assert start(tracker, SOFT_PX) > 240
    assert tracker.blur_px == pytest.approx(np.full((2, 2), SOFT_PX), rel=0.01)
    assert np.abs(tracker.width_scale - 1.0).max() < 0.005
    assert worst_sigmas(tracker).max() < 5.0


def test_a_start_measures_every_cell_even_if_it_was_told_the_right_blur(tracker: Tracker) -> None:
    tracker.options = TrackingOptions(blur_px=SCENARIO.camera.psf_sigma_px)
    found = start(tracker, SCENARIO.camera.psf_sigma_px)
    assert found > 240 and found == tracker.both_found()


def test_a_motion_during_the_exposure_blurs_the_sides_across_it_alone(tracker: Tracker) -> None:
    smear_px = 2.0
    pose, images = world().pose, []
    for eye in (0, 1):
        light = light_of(world(), 0, eye)
        smear(light, np.array([smear_px, 0.0]))  # the wing's X is the images', to some degrees
        images.append(pixels_of(light, SCENARIO, 1.0, (8, eye)))
    assert tracker.start(pose.rotation, pose.translation_mm, images[0], images[1]) > 240
    own_px = SCENARIO.camera.psf_sigma_px
    along_x, along_y = tracker.blur_px.T
    assert along_x == pytest.approx(own_px, rel=0.05)
    assert along_y == pytest.approx(np.hypot(own_px, smear_px / np.sqrt(12.0)), rel=0.05)
    assert worst_sigmas(tracker).max() < 5.0


def test_points_stay_within_their_deviations_while_a_sudden_blur_settles(tracker: Tracker) -> None:
    sharp_px = SCENARIO.camera.psf_sigma_px
    assert start(tracker, sharp_px) > 240
    sharp_mm = float(np.nanmedian(tracker.points.sigma_mm))
    assert worst_sigmas(tracker).max() < 5.0
    for tick in range(10):
        tracker.measure(*pair(SOFT_PX, 2 + tick % 3))
        assert tracker.blur_px == pytest.approx(np.full((2, 2), SOFT_PX), rel=0.02)  # in the very tick
        tracker.both_found()
        assert tracker.reconstruct(tracker.both, 0.5, 1.0) > 240
        assert worst_sigmas(tracker).max() < 5.5  # of 7500 numbers; it was 17 before widths and blur settled together
    assert tracker.blur_px == pytest.approx(np.full((2, 2), SOFT_PX), rel=0.01)
    assert float(np.nanmedian(tracker.points.sigma_mm)) < 3.0 * sharp_mm
