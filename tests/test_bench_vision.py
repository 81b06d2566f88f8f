"""The vision bench: its floor against a numeric one, its judges on cases with known answers, its tables' form."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr
from typer.testing import CliRunner

from fsw.vision.stereo import make_points
from hal.frame import make_frames
from sim.bench.vision import TABLES, cases
from sim.bench.vision_disturbed import DISTURBANCES, clear_world, light_of, pixels_of
from sim.bench.vision_floor import floor_covariance_mm2, offset_information, shown_length
from sim.bench.vision_methods import printed, sequence_scene
from sim.bench.vision_motion import motions
from sim.bench.vision_sensors import SENSORS, disc
from sim.bench.vision_stand import Truth, bench_scenario
from sim.bench.vision_stress import Score, hidden_cells, stress
from sim.bench.vision_tracking import chi_square, sum_bytes
from sim.disturbances import bar, expose, glint, half_shadow, hot_rows, ramp, smear
from sim.world import World
from wingbeat.cli import app
from wingbeat.errors import InputError

SHOT, DARK = 0.025, 0.1


def bar_image(offset: float, levels: tuple[float, ...], width: float, sigma: float) -> np.ndarray:
    """A slanted bar in 60 x 40 pixels: levels inside, of the line, beyond."""
    y, x = np.mgrid[0:60, 0:40].astype(float)
    slant = 0.1
    across = (x - 15.0 - slant * y) / np.hypot(1.0, slant) - offset
    inside, line, beyond = levels
    return inside + (line - inside) * ndtr(across / sigma) + (beyond - line) * ndtr((across - width) / sigma)


@pytest.mark.parametrize("levels", [(30.0, 170.0, 40.0), (30.0, 170.0, 170.0)], ids=["bar", "step"])
def test_the_floor_is_what_finite_differences_of_an_image_give(levels: tuple[float, float, float]) -> None:
    width, sigma, h = 9.0, 0.8, 1e-3
    V = SHOT * bar_image(0.0, levels, width, sigma) + DARK
    single = levels[1] == levels[2]
    moves = [(h, (0.0, 0.0, 0.0)), (0.0, (h, 0.0, 0.0)), (0.0, (0.0, h, h if single else 0.0)), (0.0, (0.0, 0.0, h))]
    slopes = []
    for offset, change in moves[: 3 if single else 4]:
        up = bar_image(offset, tuple(np.add(levels, change)), width, sigma)
        down = bar_image(-offset, tuple(np.subtract(levels, change)), width, sigma)
        slopes.append(((up - down) / (2.0 * h)).ravel())
    F = np.array(slopes) / V.ravel() @ np.array(slopes).T
    numeric = 1.0 / np.linalg.inv(F)[0, 0]
    length = 60.0 * np.hypot(1.0, 0.1)
    # The image shows more of the levels than the floor counts on: they cost it a little less.
    assert length * offset_information(levels, width, sigma, SHOT, DARK) == pytest.approx(numeric, rel=0.03)


def test_an_edge_beside_one_that_moves_for_itself_has_what_finite_differences_give() -> None:
    levels, width, sigma, h = (30.0, 170.0, 40.0), 4.0, 0.8, 1e-3
    V = SHOT * bar_image(0.0, levels, width, sigma) + DARK
    slopes = []
    for at, step in enumerate([h, h, h, h, h]):
        q = np.array([0.0, *levels, width])
        q[at] += step
        up = bar_image(q[0], tuple(q[1:4]), q[4] - q[0], sigma)  # the far edge stays where it is
        q[at] -= 2.0 * step
        down = bar_image(q[0], tuple(q[1:4]), q[4] - q[0], sigma)
        slopes.append(((up - down) / (2.0 * h)).ravel())
    F = np.array(slopes) / V.ravel() @ np.array(slopes).T
    numeric = 1.0 / np.linalg.inv(F)[0, 0]
    length = 60.0 * np.hypot(1.0, 0.1)
    found = offset_information(levels, width, sigma, SHOT, DARK, own_edge=True)
    assert length * found == pytest.approx(numeric, rel=0.03)
    assert found < 0.6 * offset_information(levels, width, sigma, SHOT, DARK)


def test_two_far_edges_tell_twice_what_one_does() -> None:
    levels = (0.0, 100.0, 0.0)
    both = offset_information(levels, 200.0, 0.5, 0.0, 2.0)
    own = offset_information(levels, 200.0, 0.5, 0.0, 2.0, own_edge=True)
    assert both == pytest.approx(2.0 * own, rel=0.01)
    assert own == pytest.approx(100.0**2 / (2.0 * np.sqrt(np.pi) * 0.5 * 2.0), rel=0.02)


@pytest.mark.parametrize(
    ("start", "end", "shown"),
    [
        ((10.0, 10.0), (40.0, 50.0), 50.0),
        ((-30.5, 20.0), (29.5, 20.0), 30.0),  # half of it lies left of the first pixel's rim
        ((20.0, 20.0), (20.0, 139.5), 79.5),  # the last rows end at 99.5
        ((-50.0, 20.0), (-10.0, 60.0), 0.0),
        ((0.0, 150.0), (199.0, 150.0), 0.0),
        ((-30.5, -40.5), (59.5, 79.5), 100.0),  # enters in a corner
    ],
)
def test_only_the_part_of_a_side_counts_that_the_image_shows(
    start: tuple[float, float], end: tuple[float, float], shown: float
) -> None:
    for a, b in ((start, end), (end, start)):
        assert shown_length(np.array(a), np.array(b), 200, 100) == pytest.approx(shown)


def test_the_floor_of_a_cell_partly_out_of_view_is_higher() -> None:
    world = World(bench_scenario(4, 2), 1)
    truth = Truth(world)
    px = truth.corners_px(0)
    size = np.array([[eye.width, eye.height] for eye in world.eyes])[:, None] - 1.0
    centre = px.mean(axis=2)
    seen, whole = ((centre > 0.0) & (centre < size)).all(axis=(0, 2)), truth.in_view(px)
    partly, whole = np.flatnonzero(seen & ~whole), np.flatnonzero(whole)[::20]
    assert len(partly) > 0
    for own_edges in (False, True):
        deviation = [
            np.sqrt(np.einsum("nii->ni", floor_covariance_mm2(world, truth, 0, cells, own_edges)))
            for cells in (partly, whole)
        ]
        assert deviation[0][:, 0].mean() > 1.1 * deviation[1][:, 0].mean()


def test_a_sharp_step_of_known_levels_has_the_closed_form() -> None:
    # Constant variance V, levels all but known: contrast^2 / (2 sqrt(pi) sigma V) per px.
    found = offset_information((0.0, 100.0, 100.0), 500.0, 0.5, 0.0, 2.0)
    assert found == pytest.approx(100.0**2 / (2.0 * np.sqrt(np.pi) * 0.5 * 2.0), rel=0.02)


def test_the_floor_in_space_is_positive_and_deeper_than_wide() -> None:
    world = World(bench_scenario(4, 2), 1)
    truth = Truth(world)
    cells = np.flatnonzero(truth.in_view(truth.corners_px(0)))[::60]
    floor = floor_covariance_mm2(world, truth, 0, cells)
    assert (np.linalg.eigvalsh(floor) > 0.0).all()
    deviation = np.sqrt(np.einsum("nii->ni", floor))
    assert (deviation[:, 2] > deviation[:, 0]).all()
    assert (deviation < 0.01).all()


def test_chi_square_of_honest_errors_is_one() -> None:
    draw = np.random.default_rng(5)
    root = draw.standard_normal((3, 3))
    error = draw.standard_normal((20000, 3)) @ root.T
    covariance = np.broadcast_to(root @ root.T, (20000, 3, 3))
    assert chi_square(error, covariance) == pytest.approx(1.0, abs=0.03)
    assert chi_square(2.0 * error, covariance) == pytest.approx(4.0, abs=0.12)


def test_the_papers_rows_come_out_of_its_counts() -> None:
    rows = {str(row["method"]): row for row in printed()}
    assert [rows[f"{name} (printed)"]["mu"] for name in ("SIFT", "SuperGlue", "proposed")] == pytest.approx(
        [0.5499, 0.8631, 0.8389], abs=5e-5
    )
    assert rows["SIFT (printed)"]["cmp"] == pytest.approx(0.5048, abs=5e-5)


def test_every_wrong_point_counts_and_no_right_one() -> None:
    world = World(bench_scenario(4, 2), 1)
    truth = Truth(world)
    true, wanted = truth.centres_mm(0), truth.in_view(truth.corners_px(0))
    points = make_points(len(true))
    points.xyz_mm[:], points.covariance_mm2[:], points.valid[:] = true, 0.001**2 * np.eye(3), wanted
    first, second, third = np.flatnonzero(wanted)[:3]
    points.xyz_mm[first, 0] += 5.0  # 8 px
    points.xyz_mm[second, 1] += 0.01  # 10 sigma, a small part of a px
    points.xyz_mm[third, 1] += 0.002  # 2 sigma
    score = Score()
    score.add(points, true, wanted, world.eyes, "here")
    row = score.row()
    assert (row["recall"], row["off_1_px"], row["off_5_sigma"]) == (1.0, 1, 2)
    assert row["worst_mm"] == pytest.approx(5.0)
    assert row["chi_square"] == pytest.approx((5000.0**2 + 10.0**2 + 2.0**2) / (3.0 * row["valid"]))
    assert Score().row()["chi_square"] is None
    assert str(first) in score.wrong[0]
    score.miss(wanted)
    assert score.row()["recall"] == 0.5


def test_a_cell_is_hidden_when_a_quarter_of_a_side_is() -> None:
    corners = np.array([[[10.0, 10.0], [50.0, 10.0], [50.0, 30.0], [10.0, 30.0]]])
    mask = np.zeros((60, 80), np.bool_)
    mask[:, 45:60] = True  # the right side, and an eighth of the upper one
    assert hidden_cells(mask, corners, 2.0).all()
    mask[:] = False
    mask[:, 28:32] = True  # a tenth of the upper side
    assert not hidden_cells(mask, corners, 2.0).any()
    assert not hidden_cells(np.zeros((60, 80), np.bool_), corners, 2.0).any()


def test_disturbances_of_light_do_what_they_say() -> None:
    light = np.full((80, 120), 0.5, np.float32)
    ramp(light, 0.3, 0.0)
    assert light[0, 0] == pytest.approx(0.5) and light[0, -1] == pytest.approx(0.15)
    light[:] = 0.5
    half_shadow(light, 0.1, np.array([1.0, 0.0, 60.0]))
    assert light[0, 60] == pytest.approx(0.5) and light[0, 61] == pytest.approx(0.05)
    light[:] = 0.2
    where = glint(light, np.array([60.0, 40.0]), 10.0)
    assert where.sum() == pytest.approx(np.pi * 100.0, rel=0.05)
    assert light[40, 75] > 0.25 and light[0, 0] == pytest.approx(0.2)
    assert hot_rows(light, np.array([3, 7])).sum() == 240
    assert bar(light, np.array([0.0, 1.0, 40.0]), 5.0, 0.3).sum() == 11 * 120


def test_motion_blur_keeps_the_place_of_the_exposures_middle() -> None:
    light = np.zeros((40, 60), np.float32)
    light[:, 30:] = 1.0
    smear(light, np.array([4.0, 0.0]))
    row = light[20]
    # The edge lies between pixels 29 and 30: half of it on either side of 29.5.
    assert float(row.sum()) == pytest.approx(30.0, abs=0.05)
    assert 0.1 < row[28] < 0.4 and 0.6 < row[31] < 0.9


@pytest.mark.parametrize("smear_px", [1.0, 1.95, 4.0])
@pytest.mark.parametrize("place", [0.0, 0.3])
def test_motion_blur_of_an_edge_is_exact_wherever_in_a_pixel_it_lies(place: float, smear_px: float) -> None:
    sigma = 0.7
    x = np.arange(80) - 40.0 - place
    light = np.tile(ndtr(x / sigma).astype(np.float32), (40, 1))
    smear(light, np.array([smear_px, 0.0]))
    ends = [(x + sign * smear_px / 2.0) / sigma for sign in (1.0, -1.0)]
    upper, lower = (sigma * (z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)) for z in ends)
    assert light[20] == pytest.approx((upper - lower) / smear_px, abs=2e-3)  # 8e-3 by cubic interpolation


def test_noise_is_shot_and_read_noise() -> None:
    light = np.full((400, 400), 0.5, np.float32)
    for factor in (1.0, 5.0):
        pixels = expose(light, 8, 10500.0, 2.5, factor, np.random.default_rng(1)).astype(float)
        g = 255.0 / 10500.0
        wanted = factor * np.sqrt(g * 127.5 + (2.5 * g) ** 2)
        assert pixels.mean() == pytest.approx(127.5, abs=0.1)
        assert np.sqrt(pixels.var() - 1.0 / 12.0) == pytest.approx(wanted, rel=0.02)


def test_pixels_of_clear_light_are_those_of_the_world_up_to_noise() -> None:
    scenario = bench_scenario(4, 2)
    world, clear = World(scenario, 3), clear_world(scenario, 3)
    image = make_frames((750, 1024), np.uint8)
    world.render(0, 0, image)
    again = pixels_of(light_of(clear, 0, 0), scenario, 1.0, (3, 0, 0))
    difference = again.astype(float) - image
    assert abs(difference.mean()) < 0.05
    assert difference.std() < 4.0


def test_a_stress_row_at_small_size_says_what_was_measured() -> None:
    rows = stress("stress", DISTURBANCES[0], range(7, 8), 4)
    assert [row["method"] for row in rows] == ["ours, from ACQUIRE", "ours, in TRACK"]
    for row in rows:
        assert row["started"] == 1 and row["recall"] > 0.95 and row["off_1_px"] == 0


def test_a_disc_of_defocus_biases_the_cells_at_a_border_and_their_deviations_say_so() -> None:
    shares = disc(4.0)
    at = np.arange(len(shares)) - len(shares) // 2
    assert shares.sum() == pytest.approx(1.0)
    assert (shares.sum(axis=0) * at**2).sum() == pytest.approx(4.0**2 / 4.0 + 1.0 / 12.0, rel=0.01)
    assert SENSORS[0].name.startswith("defocus")
    searched, tracked = stress("sensors", SENSORS[0], range(1, 2), 2)
    assert searched["recall"] == 1.0 and searched["worst_mm"] > 0.02
    assert tracked["recall"] == 1.0  # though it comes at once
    assert searched["off_1_px"] == searched["off_5_sigma"] == tracked["off_1_px"] == tracked["off_5_sigma"] == 0


def test_the_motions_are_those_of_the_table() -> None:
    steps = {name: np.abs(np.diff(px)) for name, px in motions().items()}
    assert steps["8 px a frame"].tolist() == [8.0] * 9
    assert steps["8 px a frame, and back"].tolist() == [8.0] * 9
    assert steps["jump of 30 px"].max() == 30.0 and steps["jump of 30 px"].sum() == 30.0


def test_tables_are_chosen_by_name_and_unknown_ones_are_refused() -> None:
    assert len(cases("stress", 1, 1)) == len(DISTURBANCES)
    assert len(cases("tracking, motion", 1, 1)) == 2 + len(motions())
    assert len(cases("sensors", 1, 1)) == len(SENSORS)
    with pytest.raises(InputError, match="choose of " + ", ".join(TABLES)):
        cases("stess", 1, 1)


def test_a_folder_without_a_sequence_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        sequence_scene(tmp_path)


def test_rows_come_as_json_and_as_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim.bench.vision.methods", lambda make_scene, matchers: [])
    target = tmp_path / "rows.json"
    result = CliRunner().invoke(app, ["bench", "vision", "--rows", "methods", "--json", str(target)])
    assert result.exit_code == 0, result.output
    assert "SuperGlue (printed)" in result.output
    found = json.loads(target.read_text())
    assert found["machine"]["cores"] >= 1
    assert [row["total"] for row in found["rows"]] == [234, 234, 234]
    assert all(isinstance(value, str | int | float) for row in found["rows"] for value in row.values())


def test_reading_a_pair_reads_every_byte() -> None:
    image = np.random.default_rng(2).integers(0, 256, (37, 53), dtype=np.uint8)
    assert sum_bytes(image) == int(image.astype(np.int64).sum())
