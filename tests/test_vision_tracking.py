"""Following the wing: the surface that both eyes share, the quick look, and the tracker on rendered pairs."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from flight_parts import Footage, small
from vision_scene import FloatArray, facing, paper_rig, rotation, three_panels

from fsw.geometry import make_rig, make_wing_grid
from fsw.tables.checks import load_hardware
from fsw.vision.fitting import fit_surface, make_normal, settle
from fsw.vision.grid import CellGrid
from fsw.vision.prediction import FEW, Surface, expect, locate, make_surface, set_pose
from fsw.vision.rig import StereoRig, eyes_of
from fsw.vision.search import SIDES_SEARCHED, Sightings, make_sightings
from fsw.vision.tracking import Tracker, TrackingOptions
from hal.frame import make_frames
from sim.flight_files import flight_files

SHIFT_X, SHIFT_Y, TURN, OFFSET, TILT_X, TILT_Y, TWIST, BEND = range(8)  # the first unknowns, mm


class Wing:
    """The paper's rig before the wing at its range, and a surface that may be moved."""

    def __init__(self, distortion: tuple[float, ...] = (0.0,) * 5) -> None:
        self.rig: StereoRig = paper_rig(1024, distortion)
        self.grid: CellGrid = three_panels()
        self.R, self.t = facing(self.rig, (560.0, 0.0), 720.0, rotation(5.0, 12.0, 3.0))
        self.eyes = eyes_of(self.rig)

    def surface(self, **unknowns: float) -> Surface:
        surface = make_surface(self.grid)
        set_pose(surface, self.R, self.t)
        for name, value in unknowns.items():
            surface.unknowns[globals()[name]] = value
        return surface

    def centres(self, surface: Surface) -> FloatArray:
        return np.array([locate(surface, n, 4) for n in range(self.grid.count)])

    def expected(self, surface: Surface) -> tuple[FloatArray, FloatArray, FloatArray]:
        count = self.grid.count
        corners, centre, in_view = np.zeros((2, count, 4, 2)), np.zeros((2, count, 2)), np.zeros((2, count), bool)
        expect(surface, self.eyes, corners, np.zeros((2, count, 4)), centre, in_view)
        return corners, centre, in_view

    def sightings(self, guess: Surface, truth: Surface) -> Sightings:
        """How far the true lines lie from the guessed ones, along the guessed sides' outward normals."""
        here, _, in_view = self.expected(guess)
        there, _, _ = self.expected(truth)
        seen = make_sightings(self.grid.count)
        for i, side in enumerate(SIDES_SEARCHED):
            a, b = here[:, :, side], here[:, :, side + 1]
            normal = np.stack([b[..., 1] - a[..., 1], a[..., 0] - b[..., 0]], axis=-1)
            length = np.linalg.norm(normal, axis=-1, keepdims=True)
            normal /= np.where(length > 0.0, length, 1.0)  # corners out of view are not known
            middle = 0.5 * (a + b)
            outwards = np.sum((middle - here.mean(axis=2)) * normal, axis=-1)
            normal *= np.sign(outwards)[..., None]
            moved = 0.5 * (there[:, :, side] + there[:, :, side + 1]) - middle
            seen.offset_px[:, :, i] = np.where(in_view.all(axis=0), np.sum(moved * normal, axis=-1), np.nan)
            seen.normal[:, :, i] = normal
        return seen


@pytest.fixture(scope="module")
def wing() -> Wing:
    return Wing()


def distances(wing: Wing, one: Surface, other: Surface) -> FloatArray:
    """Distance of all cells that both eyes see, mm."""
    seen = wing.expected(other)[2].all(axis=0)
    assert seen.sum() > 100
    return np.linalg.norm(wing.centres(one) - wing.centres(other), axis=1)[seen]


MOTIONS = [
    {"SHIFT_X": 4.0, "SHIFT_Y": -3.0},
    {"OFFSET": 6.0},
    {"TURN": 3.0},
    {"TILT_X": 5.0, "TILT_Y": -2.0},
    {"OFFSET": 3.0, "TILT_X": 5.0, "BEND": 3.0, "TWIST": 2.0},
]


@pytest.mark.parametrize("motion", MOTIONS, ids=["shift", "offset", "turn", "tilt", "bend"])
def test_a_surface_settles_on_its_lines(wing: Wing, motion: dict[str, float]) -> None:
    guess, truth = wing.surface(), wing.surface(**motion)
    for _ in range(2):  # the offsets are measured anew: the view is not quite linear
        count, left_px = settle(guess, wing.eyes, wing.sightings(guess, truth), FEW, make_normal(wing.grid.count))
    assert count > 400 and left_px <= 0.5
    assert distances(wing, guess, truth).max() < 0.02


@pytest.mark.parametrize("motion", MOTIONS, ids=["shift", "offset", "turn", "tilt", "bend"])
def test_one_line_in_five_mistaken_does_not_move_the_surface(wing: Wing, motion: dict[str, float]) -> None:
    rng = np.random.default_rng(9)
    guess, truth = wing.surface(), wing.surface(**motion)
    for _ in range(3):
        seen = wing.sightings(guess, truth)
        offset = seen.offset_px
        offset += rng.normal(0.0, 0.3, offset.shape)
        wrong = rng.random(offset.shape) < 0.2
        offset[wrong] += rng.choice([-1.0, 1.0], wrong.sum()) * rng.uniform(4.0, 12.0, wrong.sum())
        settle(guess, wing.eyes, seen, FEW, make_normal(wing.grid.count))
    # 1 px is 0.6 mm here; the view's depth is known several times worse than its place in the image.
    assert np.sqrt(np.mean(distances(wing, guess, truth) ** 2)) < 0.35


def test_without_lines_the_surface_stays(wing: Wing) -> None:
    surface = wing.surface(OFFSET=2.0)
    before = surface.unknowns.copy()
    assert settle(surface, wing.eyes, make_sightings(wing.grid.count), FEW, make_normal(wing.grid.count))[0] == 0
    assert surface.unknowns.tolist() == before.tolist()


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.2, 0.04, 1e-3, -1e-3, 0.0)])
def test_expected_pixels_and_the_view_agree_with_the_rig(lens: tuple[float, ...]) -> None:
    wing = Wing(lens)
    surface = wing.surface(OFFSET=3.0, BEND=5.0, TILT_Y=2.0, TURN=1.0)
    corners, centre, in_view = wing.expected(surface)
    xyz = wing.centres(surface)
    for eye in (0, 1):
        ideal = wing.rig.project_ideal(eye, xyz)
        assert centre[eye] == pytest.approx(ideal, abs=1e-8)
        # By brute force: the undistorted pixels of all the image, and of nothing else.
        px = wing.rig.distort(eye, ideal)
        back = wing.rig.undistort(eye, np.clip(px, -50.0, wing.rig.size[eye] + 50.0))
        real = np.abs(back - ideal).max(axis=1) < 1e-6  # not folded back by the polynomial
        inside = real & ((px >= 0.0) & (px <= wing.rig.size[eye] - 1.0)).all(axis=1)
        assert in_view[eye].tolist() == inside.tolist() and 50 < inside.sum() < wing.grid.count
    n = int(np.flatnonzero(in_view.all(axis=0))[0])
    for k in range(4):
        corner = np.array(locate(surface, n, k))
        assert corners[1, n, k] == pytest.approx(wing.rig.project_ideal(1, corner), abs=1e-8)


def test_nothing_behind_the_eyes_is_in_view(wing: Wing) -> None:
    surface = wing.surface()
    set_pose(surface, wing.R, -wing.t)
    assert not wing.expected(surface)[2].any()


def test_a_moved_surface_is_rigid_in_its_plane(wing: Wing) -> None:
    flat, moved = wing.centres(wing.surface()), wing.centres(wing.surface(SHIFT_X=5.0, SHIFT_Y=-2.0, TURN=4.0))
    pairs = np.random.default_rng(1).integers(0, wing.grid.count, (200, 2)).T
    before = np.linalg.norm(flat[pairs[0]] - flat[pairs[1]], axis=1)
    after = np.linalg.norm(moved[pairs[0]] - moved[pairs[1]], axis=1)
    assert after == pytest.approx(before, rel=1e-4, abs=1e-6)


def test_a_surface_fits_measured_centres_and_tells_what_lies_off(wing: Wing) -> None:
    rng, count = np.random.default_rng(3), wing.grid.count
    truth, surface = wing.surface(OFFSET=4.0, TILT_X=6.0, BEND=3.0, SHIFT_X=1.0), wing.surface()
    xyz = wing.centres(truth) + rng.normal(0.0, 0.01, (count, 3))
    valid = rng.random(count) < 0.6
    wrong = rng.choice(np.flatnonzero(valid), 20, replace=False)
    xyz[wrong] += rng.choice([-1.0, 1.0], (20, 3)) * 8.0
    distance = np.zeros(count)
    fit_surface(surface, xyz, np.full(count, 0.02), valid, 2.0, make_normal(count), distance)
    right = valid.copy()
    right[wrong] = False
    assert np.isnan(distance[~valid]).all()
    assert distance[right].max() < 0.1 and distance[wrong].min() > 5.0
    assert np.linalg.norm(wing.centres(surface) - wing.centres(truth), axis=1).max() < 0.1


def test_a_few_centres_do_not_move_the_surface(wing: Wing) -> None:
    count, surface = wing.grid.count, wing.surface(OFFSET=1.0)
    before, xyz = surface.unknowns.copy(), wing.centres(surface) + 3.0
    fit_surface(surface, xyz, np.full(count, 0.02), np.arange(count) < 5, 2.0, make_normal(count), np.zeros(count))
    assert surface.unknowns.tolist() == before.tolist()


TICKS = 8


@pytest.fixture(scope="module")
def footage() -> Footage:
    return Footage(small(TICKS / 15.0))


@pytest.fixture
def tracker(footage: Footage, tmp_path: Path) -> Iterator[Tracker]:
    """A tracker of the wing of `small`, told its true pose."""
    cameras, table = load_hardware(*flight_files(footage.scenario, tmp_path))
    tracker = Tracker(make_rig(cameras), make_wing_grid(table), TrackingOptions())
    tracker.place(footage.world.pose.rotation, footage.world.pose.translation_mm)
    yield tracker
    tracker.close()


def follow(tracker: Tracker, footage: Footage, tick: int) -> int:
    left, right = footage.images[:, tick]
    tracker.measure(left, right)
    tracker.both_found()
    return tracker.reconstruct(tracker.both, 0.5, 1.0)


def test_displacements_are_as_good_as_their_covariance_says(footage: Footage, tracker: Tracker) -> None:
    truth = footage.world.truth()["X_left"]
    measured, covariance, seen = [], [], []
    for tick in (0, 0, 0, *range(1, TICKS)):  # blur and widths of the lines settle on the first pair
        follow(tracker, footage, tick)
        measured.append(tracker.points.xyz_mm.copy())
        covariance.append(tracker.points.covariance_mm2.copy())
        seen.append(tracker.points.valid.copy())
    first, last = 2, len(measured) - 1
    both = seen[first] & seen[last]
    assert both.sum() > 240
    error = (measured[last] - measured[first] - truth[TICKS - 1] + truth[0])[both]
    spread = (covariance[last] + covariance[first])[both]
    chi2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(spread), error) / 3.0
    # Below 1 by the floor for lens and model, which is the same in both frames and cancels in part.
    assert 0.15 < np.median(chi2) < 1.3 and np.mean(chi2 > 4.0) < 0.05
    assert np.sqrt(np.mean(error**2)) < 0.02 and np.abs(error).max() < 0.15
    assert np.abs((measured[last] - truth[TICKS - 1])[both]).max() < 1.0  # each cell under its own name


def test_tracking_is_the_same_to_the_last_bit_twice(footage: Footage, tracker: Tracker) -> None:
    seen = []
    for _ in range(2):
        tracker.start(footage.world.pose.rotation, footage.world.pose.translation_mm, *footage.images[:, 0])
        for tick in range(3):
            follow(tracker, footage, tick)
        seen.append((tracker.points.xyz_mm.copy(), tracker.centre_px.copy(), tracker.blur_px.copy()))
    for one, other in zip(*seen, strict=True):
        assert np.array_equal(one, other, equal_nan=True)


def test_a_thread_for_each_eye_gives_the_same_bits_as_one_for_both(footage: Footage, tracker: Tracker) -> None:
    threads = threading.active_count()
    beside = Tracker(tracker.rig, tracker.grid, TrackingOptions(threads=2))
    assert threading.active_count() == threads + 1
    for each in (tracker, beside):
        each.start(footage.world.pose.rotation, footage.world.pose.translation_mm, *footage.images[:, 0])
        for tick in range(3):
            follow(each, footage, tick)
    beside.close()
    assert threading.active_count() == threads
    for own, other in zip(tracker.points, beside.points, strict=True):
        assert np.array_equal(own, other, equal_nan=True)


def test_a_tracker_that_adopts_a_scout_goes_on_as_the_scout_would(
    footage: Footage, tracker: Tracker, tmp_path: Path
) -> None:
    scout = Tracker(tracker.rig, tracker.grid, TrackingOptions())
    try:
        scout.start(footage.world.pose.rotation, footage.world.pose.translation_mm, *footage.images[:, 0])
        tracker.adopt(scout)
        assert tracker.surface.unknowns is not scout.surface.unknowns
        for tick in (1, 2):
            assert follow(tracker, footage, tick) == follow(scout, footage, tick) > 240
            assert np.array_equal(tracker.points.xyz_mm, scout.points.xyz_mm, equal_nan=True)
    finally:
        scout.close()


def test_a_black_image_leaves_no_point_and_the_surface_in_place(footage: Footage, tracker: Tracker) -> None:
    assert follow(tracker, footage, 0) > 240
    before = tracker.surface.unknowns.copy()
    left, right = footage.images[:, 0]
    black = make_frames(right.shape, right.dtype)
    for pair in ((black, black), (left, black)):
        tracker.measure(*pair)
        assert tracker.both_found() == 0 and tracker.detected()[1] == 0
        assert tracker.reconstruct(tracker.both) == 0
        assert not tracker.points.valid.any() and np.isnan(tracker.points.xyz_mm).all()
        assert all(np.isnan(value) for value in tracker.residuals())
    assert np.abs(tracker.surface.unknowns - before).max() < 10.0
    tracker.place(footage.world.pose.rotation, footage.world.pose.translation_mm)
    assert follow(tracker, footage, 0) > 240


def test_an_image_that_is_the_other_eyes_gives_no_valid_point(footage: Footage, tracker: Tracker) -> None:
    follow(tracker, footage, 0)
    left, right = footage.images[:, 1]
    tracker.measure(right, left)
    tracker.both_found()
    assert tracker.reconstruct(tracker.both, 0.5, 1.0) < 12  # least_cells: no lock
