"""Scenarios, the rig that they describe, the files that the flight side gets, and the truth."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from fsw.tables.schema import load_cameras, load_wing
from hal.drivers.lockstep_clock import LockstepClock
from sim.cameras import SimulatedCamera, SimulatedTrigger, WorldClock
from sim.flight_files import flight_files
from sim.rig import Eye, nearest_rotation, rotation_matrix
from sim.scenario import SHIPPED, load_scenario
from sim.truth import write_truth
from sim.world import World, true_eyes, true_pose
from wingbeat.errors import InputError

GIVEN_TRUTH = Path(__file__).parents[2] / "shared" / "data" / "wing_close" / "truth.npz"


@pytest.fixture(scope="module")
def world() -> World:
    return World(load_scenario("small"))


@pytest.mark.requirement("WB-SIM-04")
def test_the_paper_s_rig_has_its_baseline_and_its_axes_cross_in_front() -> None:
    _, right = true_eyes(load_scenario("paper"))
    np.testing.assert_allclose(right.rotation @ right.rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.norm(right.translation_mm) == pytest.approx(448.04, abs=0.01)
    centre, axis = -right.rotation.T @ right.translation_mm, right.rotation[2]
    np.testing.assert_allclose(centre, [41.0, 423.8, 139.4], atol=0.05)
    along = np.linalg.lstsq(np.column_stack([[0.0, 0.0, 1.0], -axis]), centre, rcond=None)[0]
    assert along[0] == pytest.approx(719.0, abs=1.5)


def test_projection_agrees_with_opencv() -> None:
    draw = np.random.default_rng(1)
    rotation = rotation_matrix(draw.normal(0.0, 0.4, 3))
    lens = np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01])
    eye = Eye(800, 600, np.array([900.0, 880.0, 401.0, 299.0]), lens, rotation, np.array([5.0, -3.0, 40.0]))
    points = draw.uniform([-200, -200, 500], [200, 200, 900], (50, 3))
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], eye.translation_mm, eye.matrix, lens)
    np.testing.assert_allclose(eye.project(points), expected[:, 0], atol=1e-9)
    assert np.isnan(eye.project(np.array([0.0, 0.0, -500.0]) @ rotation)).all()


def test_binned_pixels_are_the_means_of_theirs() -> None:
    full, binned = (true_eyes(load_scenario(name))[0] for name in ("paper", "small"))
    assert (binned.width, binned.height) == (1024, 750)
    points = np.array([[-100.0, 50.0, 700.0], [30.0, -80.0, 720.0]])
    # The four pixels 4 k ... 4 k + 3 have their middle at 4 k + 1.5.
    np.testing.assert_allclose(binned.project(points) * 4.0 + 1.5, full.project(points), atol=1e-9)


def test_the_wing_stands_where_the_paper_says() -> None:
    scenario = load_scenario("paper")
    pose, eyes = true_pose(scenario), true_eyes(scenario)
    assert np.linalg.norm(pose.to_left(np.array([700.0, 0.0, 0.0]))) == pytest.approx(720.0, abs=8.0)
    across = np.array([[700.0, -200.0, 0.0], [700.0, 200.0, 0.0]])
    for eye in eyes:
        uv = eye.project(pose.to_left(across))
        assert (uv > 0.0).all() and (uv < [4096.0, 3000.0]).all()
        along = np.diff(eye.project(pose.to_left(np.array([[600.0, 0.0, 0.0], [800.0, 0.0, 0.0]]))), axis=0)[0]
        assert along[0] > 10.0 * abs(along[1]) * 0.9
        gaps = eye.project(pose.to_left(np.array([[x, 0.0, 0.0] for x in scenario.fold_lines_mm])))[:, 0]
        assert ((gaps > 0.0) & (gaps < 4096.0)).sum() == 1


def test_flight_files_are_the_contract_s_and_wrong_as_the_scenario_says(tmp_path: Path) -> None:
    scenario = load_scenario("small")
    cameras, wing = flight_files(scenario, tmp_path)
    read, given = load_cameras(cameras), load_wing(wing)
    left, right = true_eyes(scenario)
    assert (read.left.fx, read.left.cx, read.right.cy) == (left.intrinsics[0], left.intrinsics[2], right.intrinsics[3])
    np.testing.assert_allclose(read.stereo.rotation, right.rotation, atol=1e-15)
    assert given.panel == scenario.panel and given.surface.cells_are == "dark"
    pose, point = true_pose(scenario), np.array([*scenario.pose.point_mm, 0.0])
    rotation = np.array(given.pose.rotation)
    np.testing.assert_allclose(
        rotation @ point + given.pose.translation_mm - pose.to_left(point), scenario.pose.nominal_shift_mm, atol=1e-9
    )
    turn = np.rad2deg(np.arccos((np.trace(rotation @ pose.rotation.T) - 1.0) / 2.0))
    assert turn == pytest.approx(np.linalg.norm(scenario.pose.nominal_turn_deg), abs=1e-6)


def test_a_calibration_can_be_wrong_on_purpose(tmp_path: Path) -> None:
    scenario = load_scenario("small")
    wrong = replace(scenario.calibration, turn_deg=(0.0, 0.01, 0.0), focal_scale=1.001)
    read = load_cameras(flight_files(replace(scenario, calibration=wrong), tmp_path)[0])
    _, right = true_eyes(scenario)
    off = np.array(read.stereo.rotation) @ right.rotation.T
    assert np.rad2deg(np.arcsin(off[0, 2])) == pytest.approx(0.01)
    assert read.right.fx == pytest.approx(right.intrinsics[0] * 1.001)


def test_rotation_matrix_agrees_with_opencv() -> None:
    for vector in ([0.0, 0.0, 0.0], [0.3, -1.0, 2.0], [1e-9, 0.0, 0.0]):
        np.testing.assert_allclose(rotation_matrix(vector), cv2.Rodrigues(np.array(vector))[0], atol=1e-12)
        np.testing.assert_allclose(
            nearest_rotation(rotation_matrix(vector) * 1.0001), rotation_matrix(vector), atol=1e-12
        )


def test_truth_is_consistent_and_has_the_keys_of_recorded_ones(world: World, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.npz", world.truth())
    with np.load(tmp_path / "truth.npz") as truth:
        if GIVEN_TRUTH.is_file():
            with np.load(GIVEN_TRUTH) as given:
                assert set(truth) == set(given)
                assert {k: truth[k].ndim for k in truth} == {k: given[k].ndim for k in given}
        assert truth["X_left"].shape == (300, 702, 3)
        right = truth["X_left"] @ truth["R_lr"].T + truth["t_lr"]
        uv = right[..., :2] / right[..., 2:] * np.diag(truth["K_right"])[:2] + truth["K_right"][:2, 2]
        np.testing.assert_allclose(uv, truth["uv_right"], atol=1e-8)
        wing = (truth["X_left"] - truth["t_wing_to_left"]) @ truth["R_wing_to_left"]
        np.testing.assert_allclose(wing[..., :2], np.broadcast_to(truth["cells_XY"], wing[..., :2].shape), atol=1e-9)
        np.testing.assert_allclose(truth["cells_XY"][18 + 2], [4.5 + 40.0 + 19.1, -195.3 + 2 * 21.8 + 10.0])


def test_the_tip_moves_by_the_sum_of_the_modes(world: World) -> None:
    corner = np.array([[1600.0, -200.0], [1600.0, 200.0]])
    signs = np.sign(world.modes.shapes(corner)[:, :, 0])
    torsion = world.motion[2].frequency_hz
    assert signs[2, 0] == -signs[2, 1] and torsion == pytest.approx(5.806, abs=0.01)
    spread = np.abs(np.diff(world.displacement_mm(corner), axis=1)).max()
    assert 2.0 * 4.0 * 0.9 < spread < 2.0 * 4.0


def test_seeds_change_noise_and_random_motion_but_no_free_decay() -> None:
    scenario = load_scenario("small")
    np.testing.assert_array_equal(World(scenario, 5).tip_mm, World(scenario, 6).tip_mm)
    shaken = replace(scenario, excitation=[replace(e, kind="random") for e in scenario.excitation])
    assert not np.array_equal(World(shaken, 5).tip_mm, World(shaken, 6).tip_mm)


def test_at_real_pace_edges_have_the_times_of_lockstep(world: World) -> None:
    short = World(replace(world.scenario, duration_s=0.2))
    paced, lockstep = SimulatedTrigger(short, clock := WorldClock()), SimulatedTrigger(short, LockstepClock())
    assert clock.now_ns() == 0
    edges = [(paced.wait(), lockstep.wait()) for _ in range(4)]
    assert all(a == b for a, b in edges) and edges[3] == (None, None)
    assert clock.now_ns() >= short.times_ns[-1]


def test_too_many_images_beforehand_are_refused() -> None:
    long = World(replace(load_scenario("small"), duration_s=200.0))
    with pytest.raises(InputError, match="GB"):
        SimulatedCamera(long, 0, SimulatedTrigger(long, LockstepClock()), prerender=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("[camera]\nbinnig = 2", ("unknown key binnig", "binning")),
        ("[camera]\nbinning = 3", ("camera.binning = 3", "divisor")),
        ("rate_hz = -1.0", ("rate_hz = -1.0",)),
        ("duration_s = 0.01", ("duration_s", "at least")),
        ("[camera]\nbits = 20", ("camera.bits",)),
        ("[light]\ndirection = [1.0, 0.0, 0.0]", ("light.direction",)),
        ("[pose]\nx_axis = [0.0141, 0.3105, -0.9505]", ("pose.x_axis",)),
        ("[paint]\nborder_mm = [6.0, 4.7]", ("origin_mm",)),
        ("[paint]\nhinge_overlap_mm = 5.0", ("hinge_overlap_mm", "4.5")),
        ("[paint]\nhinge_y_mm = [190.0]", ("hinge",)),
        ("excitation = []", ("excitation",)),
        ("seed = 1.5", ("seed",)),
        ('extends = "nowhere"', ("no such scenario", "paper")),
        ('extends = "mine.toml"', ("leads back to itself",)),
        ("seed = ", ("TOML",)),
    ],
)
def test_a_bad_scenario_is_refused_in_one_line(tmp_path: Path, change: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(change if change.startswith("extends") else f'extends = "paper"\n{change}\n')
    with pytest.raises(InputError) as refusal:
        load_scenario(path)
    line = str(refusal.value)
    assert "\n" not in line
    assert all(word in line for word in words), line


def test_every_shipped_scenario_loads() -> None:
    for path in SHIPPED.glob("*.toml"):
        assert load_scenario(path.stem) == load_scenario(path)
    with pytest.raises(InputError, match="paper"):
        load_scenario("unheard-of")
