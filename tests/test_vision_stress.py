"""Tracking and search where the wing moves far, stands askew, or hardly shows its lines: right, or not valid."""

import numpy as np
import pytest
from numpy.typing import NDArray
from vision_scene import Scene, facing, paper_rig, rotation, three_panels

from fsw.vision.acquisition import Prior, acquire
from fsw.vision.fitting import fit_surface, make_normal
from fsw.vision.gating import gate_columns, gate_points
from fsw.vision.prediction import make_surface, set_pose
from fsw.vision.stereo import make_points
from fsw.vision.tracking import Tracker, TrackingOptions

FloatArray = NDArray[np.float64]
GRID = three_panels()
COUNT = GRID.count
WIDEST_MM = 2.2


def bent(tip_mm: float, x: FloatArray, y: FloatArray) -> FloatArray:
    """A cantilever whose tip stands so far out of its plane, twisted a little, and curved across as along (Poisson)."""
    s = x / 1600.0
    curvature = tip_mm * 3.0 * (1.0 - s) / 1600.0**2
    return tip_mm * (3.0 * s**2 - s**3) / 2.0 + 0.01 * y * s - 0.165 * curvature * y**2


def wing(tip_mm: float) -> FloatArray:
    """Centres (N, 3) of the bent wing's cells."""
    x, y = GRID.centre_mm.T
    return np.stack((x, y, bent(tip_mm, x, y)), axis=1)


def fitted(xyz: FloatArray, reference: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which points (N, 3) stand, and their distances (N,), for a reference pose laid through other ones."""
    middle = reference.mean(axis=0)
    U, _, Vt = np.linalg.svd((reference - middle).T @ (wing(0.0) - wing(0.0).mean(axis=0)))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    surface, normal, points = make_surface(GRID), make_normal(COUNT), make_points(COUNT)
    set_pose(surface, R, middle - R @ wing(0.0).mean(axis=0))
    points.xyz_mm[:], points.sigma_mm[:], points.valid[:] = xyz, 0.01, np.isfinite(xyz[:, 0])
    distance = np.full(COUNT, np.nan)
    gate = 0.0
    for _ in range(3):
        gate = fit_surface(surface, points.xyz_mm, points.sigma_mm, points.valid, WIDEST_MM, normal, distance)
    gate_points(points, distance, gate, WIDEST_MM)
    gate_columns(points, distance, GRID.column, np.zeros((GRID.column.max() + 1, 3)))
    return points.valid, distance


@pytest.mark.parametrize("seen", [(0.0, 1600.0), (0.0, 600.0), (1000.0, 1600.0)])
def test_one_surface_follows_a_wing_that_swings_from_side_to_side(seen: tuple[float, float]) -> None:
    xyz = wing(-60.0)
    x = GRID.centre_mm[:, 0]
    hidden = (x < seen[0]) | (x > seen[1])
    xyz[hidden] = np.nan
    stands, distance = fitted(xyz, wing(60.0))
    assert stands[~hidden].all()
    assert distance[~hidden].max() < 0.3


def test_a_centre_pulled_aside_does_not_stand_and_its_neighbours_do() -> None:
    xyz = wing(20.0) + np.random.default_rng(3).normal(0.0, 0.01, (COUNT, 3))
    pulled = np.arange(40, COUNT, 97)
    xyz[pulled, 2] += 0.5
    stands, _ = fitted(xyz, wing(0.0))
    assert not stands[pulled].any()
    assert stands.sum() >= COUNT - len(pulled) - 2


def test_columns_that_one_eye_took_a_row_off_do_not_stand() -> None:
    # From 2 m a row for the next means a depth wrong by 5 %: all of the column is that much larger.
    xyz = wing(10.0)
    off = GRID.centre_mm[:, 0] > 1200.0
    eye = np.array([800.0, 0.0, 2000.0])
    xyz[off] = eye + 1.05 * (xyz[off] - eye)
    stands, _ = fitted(xyz, wing(0.0))
    assert not stands[off].any()
    assert stands[~off].mean() > 0.9


def scene(tip_mm: float = 0.0, **changes: object) -> Scene:
    """The paper's cameras look at the middle of the wing, whose tip stands so far out of its plane."""
    rig = paper_rig(1024)
    R, t = facing(rig, (900.0, 0.0), 720.0, rotation(5, -7, 3))
    return Scene(rig, GRID, R, t, bend=lambda x, y: bent(tip_mm, x, y), over=2).but(**changes)


def test_a_swing_by_more_than_a_row_between_two_frames_is_bridged_under_the_right_names() -> None:
    before, after = scene(45.0), scene(-25.0)
    moved = np.linalg.norm(after.truth_px(0) - before.truth_px(0), axis=-1)[before.visible(0)]
    assert moved.max() > 1.2 * np.linalg.norm(before.truth_px(0)[:, 3] - before.truth_px(0)[:, 0], axis=-1).min()
    left, right = before.image(0), before.image(1)
    found = acquire(left, right, before.rig, GRID, Prior(before.R, before.t, 25.0, 3.0))
    tracker = Tracker(before.rig, GRID, TrackingOptions())
    tracker.start(found.rotation, found.translation_mm, left, right)
    left, right = after.image(0), after.image(1)
    tracker.measure(left, right)
    tracker.both_found()
    count = tracker.reconstruct(tracker.both, 0.5, 1.0)
    tracker.close()
    visible = after.visible(0) & after.visible(1)
    assert count > 0.95 * visible.sum()
    true = wing(-25.0) @ after.R.T + after.t
    valid = tracker.points.valid
    assert np.linalg.norm(tracker.points.xyz_mm[valid] - true[valid], axis=1).max() < 1.0


def test_cells_nearly_as_bright_as_their_lines_are_found_beside_a_black_sky() -> None:
    faint = scene(gloss=lambda x, y: 0.3 + 0.0 * x, spread=0.2)
    found = acquire(faint.image(0), faint.image(1), faint.rig, GRID, Prior(faint.R, faint.t, 25.0, 3.0))
    assert found.ok, found.reason
    both = faint.visible(0) & faint.visible(1)
    assert found.seen.all(axis=0)[both].mean() > 0.8


def test_a_nominal_pose_may_be_turned_about_any_point_of_the_wing() -> None:
    here = scene()
    middle = np.array([900.0, 0.0, 0.0])
    R = here.R @ rotation(1.5, -1.5, 2.0)
    t = here.t + here.R @ middle - R @ middle + np.array([12.0, -14.0, 12.0])
    assert np.linalg.norm(t - here.t) > 30.0  # at the wing's root the pose is off by more than its tolerance
    found = acquire(here.image(0), here.image(1), here.rig, GRID, Prior(R, t, 25.0, 3.0))
    assert found.ok, found.reason
    true = here.truth_px(0)
    assert np.linalg.norm(found.corners_px[0] - true, axis=-1)[found.seen[0]].max() < 3.0
