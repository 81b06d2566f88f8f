"""Whether an eye sees what it is said to see: the geometry under the check of calibration and wing, and its words."""

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from test_tables import CAMERAS, WING, moved, rig

from fsw.tables import checks
from fsw.tables.checks import check_cells_in_view, check_overlap, load_hardware
from fsw.tables.schema import CamerasTable, Eye, WingTable
from wingbeat.errors import InputError

EYE = Eye(width=200, height=100, fx=300.0, fy=250.0, cx=90.0, cy=40.0, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.fixture
def hardware(tmp_path: Path) -> tuple[CamerasTable, WingTable]:
    (tmp_path / "cameras.toml").write_text(CAMERAS)
    (tmp_path / "wing.toml").write_text(WING)
    return load_hardware(tmp_path / "cameras.toml", tmp_path / "wing.toml")


def at_pixel(u: float, v: float, depth_mm: float = 500.0) -> list[float]:
    return [(u - 90.0) / 300.0 * depth_mm, (v - 40.0) / 250.0 * depth_mm, depth_mm]


def seen(points: list[list[float]], margin_mm: float = 0.0, eye: Eye = EYE) -> list[bool]:
    return [bool(inside) for inside in checks._in_view(eye, np.array(points), np.full(len(points), margin_mm))]


@pytest.mark.requirement("WB-TAB-09")
def test_a_point_is_in_view_up_to_the_outer_edges_of_the_outer_pixels() -> None:
    inside = [(-0.49, 50.0), (199.49, 50.0), (50.0, -0.49), (50.0, 99.49)]
    outside = [(-0.51, 50.0), (199.51, 50.0), (50.0, -0.51), (50.0, 99.51)]
    assert all(seen([at_pixel(*pixel) for pixel in inside]))
    assert not any(seen([at_pixel(*pixel) for pixel in outside]))
    assert not any(seen([at_pixel(50.0, 50.0, -500.0), at_pixel(50.0, 50.0, 0.0)]))
    assert all(seen([at_pixel(50.0, 50.0, 0.9)]))


@pytest.mark.requirement("WB-TAB-09")
def test_a_margin_widens_the_view_by_what_it_spans_in_pixels() -> None:
    # 5 mm at 500 mm are 3 px of the longer focal length.
    assert seen([at_pixel(-3.4, 50.0), at_pixel(-3.6, 50.0), at_pixel(202.4, 50.0), at_pixel(202.6, 50.0)], 5.0) == [
        True, False, True, False,
    ]  # fmt: skip
    # Each point has its own margin.
    points = np.array([at_pixel(-3.4, 50.0), at_pixel(50.0, 50.0, -1.0), at_pixel(-3.4, 50.0)])
    assert checks._in_view(EYE, points, np.array([5.0, 5.0, 0.0])).tolist() == [True, False, False]


@pytest.mark.requirement("WB-TAB-09")
@pytest.mark.parametrize(
    ("distortion", "turns_at"),
    [
        # Where d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6) is 0.
        ((-0.3, 0.0, 0.0, 0.0, 0.0), np.sqrt(1.0 / 0.9)),
        ((0.0, -0.2, 0.0, 0.0, 0.0), 1.0),
        ((0.0, 0.0, 0.0, 0.0, -1.0 / 7.0), 1.0),
        ((0.5, -0.5, 0.0, 0.0, 0.0), 1.0),
        ((-0.1, 0.0, 0.0, 0.0, -0.1), 1.0),
    ],
)
def test_beyond_where_the_distortion_turns_back_nothing_is_in_view(
    distortion: tuple[float, float, float, float, float], turns_at: float
) -> None:
    eye = msgspec.structs.replace(EYE, width=4000, height=4000, cx=2000.0, cy=2000.0, distortion=distortion)
    directions = np.array([[0.6, 0.8], [-0.6, 0.8], [0.8, -0.6], [1.0, 0.0], [0.0, 1.0]])
    k1, k2, _, _, k3 = distortion
    slope = [1.0, 0.0, 3.0 * k1, 0.0, 5.0 * k2, 0.0, 7.0 * k3]
    assert np.polynomial.polynomial.polyval(turns_at, slope) == pytest.approx(0.0, abs=1e-9)
    for factor, expected in ((0.98, True), (1.02, False)):
        points = np.column_stack([factor * turns_at * directions, np.ones(5)]) * 700.0
        assert seen(points.tolist(), eye=eye) == [expected] * 5, factor


@pytest.mark.requirement("WB-TAB-09")
def test_distortion_moves_a_point_out_of_view() -> None:
    bent = msgspec.structs.replace(EYE, distortion=(0.3, 0.0, 0.0, 0.0, 0.0))
    point = at_pixel(198.0, 40.0)
    assert seen([point]) == [True] and seen([point], eye=bent) == [False]


@pytest.mark.requirement("WB-TAB-09")
def test_the_left_view_is_spread_over_the_wings_plane(hardware: tuple[CamerasTable, WingTable]) -> None:
    cameras, wing = hardware
    left = msgspec.structs.replace(cameras.left, distortion=(-0.08, 0.02, 0.001, -0.001, 0.0))
    points = checks._left_view_on_wing_plane(left, wing)
    R, t = np.array(wing.pose.rotation), np.array(wing.pose.translation_mm)
    assert len(points) == 17 * 17 and np.abs((points - t) @ R[:, 2]).max() < 1e-9
    matrix = np.array([[left.fx, 0.0, left.cx], [0.0, left.fy, left.cy], [0.0, 0.0, 1.0]])
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(left.distortion))[0][:, 0]
    u, v = np.meshgrid(np.linspace(0.0, 2047.0, 17), np.linspace(0.0, 1499.0, 17))
    assert np.abs(pixels - np.column_stack([u.ravel(), v.ravel()])).max() < 0.01


@pytest.mark.requirement("WB-TAB-09")
def test_rays_along_or_away_from_the_plane_meet_nothing(hardware: tuple[CamerasTable, WingTable]) -> None:
    _, wing = hardware
    edge_on = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # its normal is the eye's y
    x, y, z = (tuple(row) for row in edge_on.tolist())
    eye = msgspec.structs.replace(EYE, width=181, height=81)  # the middle row of rays lies along the plane
    turned = msgspec.structs.replace(wing, pose=msgspec.structs.replace(wing.pose, rotation=(x, y, z)))
    points = checks._left_view_on_wing_plane(eye, moved(turned, (0.0, 0.4, 0.9)))
    assert points.shape == (17 * 8, 3) and np.allclose(points[:, 1], 0.4) and (points[:, 2] > 0.0).all()


@pytest.mark.requirement("WB-TAB-09")
def test_centres_and_their_lever_are_those_of_the_flat_wing(hardware: tuple[CamerasTable, WingTable]) -> None:
    _, wing = hardware
    centres = checks._centres_mm(wing.panel[1])
    assert centres.shape == (234, 3) and not centres[:, 2].any()
    assert np.allclose(centres[0], [555.5, -186.0, 0.0]) and np.allclose(centres[1], [555.5, -164.2, 0.0])
    assert np.allclose(centres[-1], [555.5 + 12 * 40.8, -186.0 + 17 * 21.8, 0.0])
    t = np.array(wing.pose.translation_mm)
    near_and_far = t + np.array([[0.0, 0.0, 0.0], [0.0, 1000.0, 0.0]])
    assert np.allclose(checks._margin_mm(wing, near_and_far), [25.0, 25.0 + 1000.0 * np.pi / 60.0])


def refusal(check: object, *arguments: object) -> tuple[str, str, str]:
    with pytest.raises(InputError) as caught:
        check(*arguments)  # type: ignore[operator]
    return caught.value.what, caught.value.where, caught.value.remedy


@pytest.mark.requirement("WB-TAB-09")
def test_each_refusal_says_what_where_and_why(hardware: tuple[CamerasTable, WingTable], tmp_path: Path) -> None:
    cameras, wing = hardware
    R, t = np.array(cameras.stereo.rotation), np.array(cameras.stereo.translation_mm)
    apart = "the views of the two cameras do not overlap at the wing"
    convention = "the convention is X_right = R X_left + t; "
    assert refusal(check_overlap, rig(cameras, R.T, t), wing) == (
        apart, "cameras.toml", convention + "stereo.rotation seems to be transposed: with its transpose they overlap",
    )  # fmt: skip
    away = rig(cameras, np.eye(3), np.array([90_000.0, 0.0, 0.0]))
    assert refusal(check_overlap, away, wing, "c.toml") == (
        apart, "c.toml", convention + "a transposed rotation is a likely cause",
    )  # fmt: skip
    R2, t2 = cv2.Rodrigues(np.array([-0.25, -0.29, 0.14]))[0], np.array([777.0, -453.0, 1013.0])
    assert refusal(check_overlap, rig(cameras, R2.T, -R2.T @ t2), wing)[2] == (
        f"{convention}rotation and translation seem to be those of X_left = R X_right + t: inverted they overlap"
    )
    out = moved(wing, (5000.0, 0.0, 700.0))
    assert refusal(check_cells_in_view, cameras, out) == (
        "no cell is in view of both cameras (of 468, the left one may see 0, the right one 0)",
        "wing.toml", "check pose (X_left = R X_wing + t) and panel",
    )  # fmt: skip
    # The left eye alone sees cells.
    what, where, _ = refusal(check_cells_in_view, away, wing, "w.toml")
    assert where == "w.toml" and "the right one 0" in what and "may see 0" not in what
    x, y, z = (list(row) for row in R.T.tolist())
    (tmp_path / "turned.toml").write_text(
        CAMERAS.split("[stereo]")[0] + (f"[stereo]\nrotation = [{x}, {y}, {z}]\ntranslation_mm = {t.tolist()}\n")
    )
    (tmp_path / "away.toml").write_text(WING.replace("[-669.8, 47.9, 654.8]", "[5000.0, 0.0, 700.0]"))
    good = (tmp_path / "cameras.toml", tmp_path / "wing.toml")
    assert refusal(load_hardware, tmp_path / "turned.toml", good[1])[1] == str(tmp_path / "turned.toml")
    assert refusal(load_hardware, good[0], tmp_path / "away.toml")[1] == str(tmp_path / "away.toml")
