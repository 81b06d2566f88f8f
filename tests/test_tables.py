"""Tables accept the contract's files, and refuse anything else in one line that names file, key, value and remedy."""

from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from fsw.tables.checks import check_cells_in_view, check_overlap, load_hardware
from fsw.tables.flight import FlightTable, load_flight
from fsw.tables.schema import CamerasTable, Eye, Pose, Stereo, WingTable, load_cameras, load_sequence, load_wing
from wingbeat.errors import InputError

# The paper's rig (Table 2, Eq. 42 as corrected) at half size, and a wing where the axes cross.
EYE = """
width = 2048
height = 1500
fx = 2351.9
fy = 2351.4
cx = 1039.4
cy = 737.5
distortion = [0, 0, 0, 0, 0]
"""
ROTATION = "[[0.991631, -0.117638, -0.053191], [0.126302, 0.798573, 0.588497], [-0.026752, -0.590290, 0.806748]]"
CAMERAS = f"""
[left]{EYE}
[right]{EYE}
[stereo]
rotation = {ROTATION}
translation_mm = [16.59488, -425.66317, 138.84437]
"""
WING = """
[wing]
length_mm = 1600.0
width_mm = 400.0
[[panel]]
origin_mm = [3.0, -196.0]
columns = 13
rows = 18
pitch_mm = [40.8, 21.8]
cell_mm = [39.0, 20.0]
[[panel]]
origin_mm = [536.0, -196.0]
columns = 13
rows = 18
pitch_mm = [40.8, 21.8]
cell_mm = [39.0, 20.0]
[surface]
cells_are = "dark"
[pose]
rotation = [[0.992495, -0.033933, 0.117481], [-0.070873, -0.942538, 0.326497], [0.099651, -0.332373, -0.937869]]
translation_mm = [-669.8, 47.9, 654.8]
tolerance_mm = 25.0
tolerance_deg = 3.0
"""
SEQUENCE = """
rate_hz = 15.0
left = "left/*.png"
right = "right/*.png"
cameras = "cameras.toml"
wing = "wing.toml"
"""
LOADERS = {"cameras": (CAMERAS, load_cameras), "wing": (WING, load_wing), "sequence": (SEQUENCE, load_sequence)}


@pytest.fixture
def hardware(tmp_path: Path) -> tuple[CamerasTable, WingTable]:
    (tmp_path / "cameras.toml").write_text(CAMERAS)
    (tmp_path / "wing.toml").write_text(WING)
    return load_hardware(tmp_path / "cameras.toml", tmp_path / "wing.toml")


def test_the_contracts_files_are_read(hardware: tuple[CamerasTable, WingTable], tmp_path: Path) -> None:
    cameras, wing = hardware
    assert (cameras.left.width, cameras.right.fy) == (2048, 2351.4)
    assert [panel.origin_mm for panel in wing.panel] == [(3.0, -196.0), (536.0, -196.0)]
    (tmp_path / "sequence.toml").write_text(SEQUENCE + 'timestamps = "timestamps.csv"\n')
    assert load_sequence(tmp_path / "sequence.toml").timestamps == "timestamps.csv"


def test_a_rotation_of_few_digits_is_made_exact(hardware: tuple[CamerasTable, WingTable]) -> None:
    for rows in (hardware[0].stereo.rotation, hardware[1].pose.rotation):
        R = np.array(rows)
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
        assert np.linalg.det(R) == pytest.approx(1.0)
    assert np.abs(np.array(hardware[0].stereo.rotation)[0] - [0.991631, -0.117638, -0.053191]).max() < 1e-5


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("cameras", "fx = 2351.9", "fx = 0", "left.fx = 0; expected float > 0.0"),
        ("cameras", "fx = 2351.9", "fx = -5.0", "left.fx = -5.0"),
        ("cameras", "fx = 2351.9", 'fx = "2351"', "left.fx = '2351'; expected float, got text"),
        ("cameras", "fx = 2351.9", "fx = nan", "left.fx = nan; a finite number"),
        ("cameras", "fx = 2351.9\n", "", r"missing key fx in \[left\]"),
        ("cameras", "width = 2048", "width = -2048", "left.width = -2048"),
        ("cameras", "width = 2048", "width = 2048.5", "left.width = 2048.5; expected int"),
        ("cameras", "cx = 1039.4", "cx = 1e6", r"left.cx = 1e\+06; -4096 to 6144"),
        ("cameras", "distortion = [0, 0, 0, 0, 0]", "distortion = [0, 0, 0, 0]", "length 5, got 4"),
        ("cameras", "distortion = [0, 0, 0, 0, 0]\n", "", "missing key distortion"),
        ("cameras", "[stereo]", "[sterio]", "unknown key sterio; did you mean stereo"),
        ("cameras", "cy = 737.5", "cyy = 737.5", r"unknown key cyy in \[left\]; did you mean cy\? allowed: width"),
        ("cameras", "0.991631,", "0.891631,", "stereo.rotation is no rotation"),
        ("cameras", "[[0.991631, -0.117638, -0.053191]", "[[-0.991631, 0.117638, 0.053191]", "is a reflection"),
        ("cameras", "[16.59488, -425.66317, 138.84437]", "[0, 0, 0]", "need a distance"),
        ("cameras", "translation_mm = [16.59488", "translation_mm = [16.59488 16", "is no TOML"),
        ("wing", "rows = 18", "rows = 0", r"panel\[0\].rows = 0; expected int >= 1"),
        ("wing", "pitch_mm = [40.8, 21.8]", "pitch_mm = [38.0, 21.8]", r"pitch_mm\[0\] = 38; at least the cell's"),
        ("wing", "pitch_mm = [40.8, 21.8]", "pitch_mm = [40.8, -1]", r"panel\[0\].pitch_mm\[1\] = -1"),
        ("wing", "origin_mm = [536.0", "origin_mm = [500.0", r"panel\[1\].origin_mm\[0\] = 500 lies on panel\[0\]"),
        ("wing", "length_mm = 1600.0", "length_mm = 1000.0", r"panel\[1\] covers X 536 to 1064"),
        ("wing", "width_mm = 400.0", "width_mm = 390.0", r"cells lie on the wing"),
        ("wing", '"dark"', '"grey"', "surface.cells_are = 'grey'; allowed: bright, dark"),
        ("wing", '[surface]\ncells_are = "dark"\n', "", "missing key surface"),
        ("wing", "tolerance_deg = 3.0", "tolerance_deg = 300.0", "pose.tolerance_deg = 300.0"),
        ("wing", "tolerance_mm", "tolerance", "unknown key tolerance in"),
        ("wing", WING[WING.index("[[panel]]") : WING.index("[surface]")], "panel = []\n", "panel"),
        ("sequence", "rate_hz = 15.0", "rate_hz = -15.0", "rate_hz = -15.0"),
        ("sequence", "rate_hz = 15.0", "rate_hz = inf", "rate_hz = inf; a finite"),
        ("sequence", "rate_hz = 15.0", "rate_hz = true", "rate_hz = True; expected float, got bool"),
        ("sequence", 'wing = "wing.toml"', 'wings = "wing.toml"', "unknown key wings; did you mean wing"),
        ("sequence", 'left = "left/*.png"', 'left = ""', "left = ''"),
    ],
)
def test_a_wrong_file_is_one_clear_line(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    text, load = LOADERS[file]
    assert old in text
    path = tmp_path / f"{file}.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        load(path)
    assert f"{file}.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_files_that_are_not_there_or_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read this file"):
        load_cameras(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot read this file"):
        load_cameras(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no text in UTF-8"):
        load_wing(tmp_path / "binary.toml")


def rig(cameras: CamerasTable, R: np.ndarray, t: np.ndarray) -> CamerasTable:
    x, y, z = (tuple(row) for row in R.tolist())
    return msgspec.structs.replace(cameras, stereo=Stereo((x, y, z), tuple(t.tolist())))


def moved(wing: WingTable, translation_mm: tuple[float, float, float]) -> WingTable:
    pose: Pose = msgspec.structs.replace(wing.pose, translation_mm=translation_mm)
    return msgspec.structs.replace(wing, pose=pose)


def test_a_transposed_rotation_is_found_and_named(hardware: tuple[CamerasTable, WingTable]) -> None:
    cameras, wing = hardware
    R, t = np.array(cameras.stereo.rotation), np.array(cameras.stereo.translation_mm)
    with pytest.raises(InputError, match=r"do not overlap.*X_right = R X_left \+ t.*with its transpose they overlap"):
        check_overlap(rig(cameras, R.T, t), wing, "cameras.toml")


def test_an_inverted_rig_is_found_and_named(hardware: tuple[CamerasTable, WingTable]) -> None:
    cameras, wing = hardware
    R, t = cv2.Rodrigues(np.array([-0.25, -0.29, 0.14]))[0], np.array([777.0, -453.0, 1013.0])
    check_overlap(rig(cameras, R, t), wing)
    with pytest.raises(InputError, match=r"X_left = R X_right \+ t: inverted they overlap"):
        check_overlap(rig(cameras, R.T, -R.T @ t), wing)


def test_eyes_that_look_apart_whatever_is_transposed_are_refused(
    hardware: tuple[CamerasTable, WingTable],
) -> None:
    cameras, wing = hardware
    with pytest.raises(InputError, match=r"do not overlap.*a transposed rotation is a likely cause"):
        check_overlap(rig(cameras, np.eye(3), np.array([90_000.0, 0.0, 0.0])), wing)


@pytest.mark.parametrize("away_mm", [(0.0, 0.0, -700.0), (5000.0, 0.0, 700.0), (-3000.0, 48.0, 655.0)])
def test_a_wing_out_of_view_is_refused_by_the_wing_and_not_by_the_rig(
    hardware: tuple[CamerasTable, WingTable], away_mm: tuple[float, float, float]
) -> None:
    cameras, wing = hardware
    check_overlap(cameras, moved(wing, away_mm))
    with pytest.raises(InputError, match=r"wing\.toml: no cell is in view of both cameras \(of 468"):
        check_cells_in_view(cameras, moved(wing, away_mm))


def test_a_wing_that_the_tolerance_may_bring_into_view_passes(hardware: tuple[CamerasTable, WingTable]) -> None:
    cameras, wing = hardware
    visible_x = -669.8
    for x in np.arange(visible_x, -3000.0, -5.0):
        try:
            check_cells_in_view(cameras, moved(wing, (float(x), 47.9, 654.8)))
        except InputError:
            break
    sharp = msgspec.structs.replace(wing, pose=msgspec.structs.replace(wing.pose, tolerance_mm=0.0, tolerance_deg=0.0))
    just_in = (float(x) + 10.0, 47.9, 654.8)
    check_cells_in_view(cameras, moved(wing, just_in))
    with pytest.raises(InputError):
        check_cells_in_view(cameras, moved(sharp, just_in))


def test_distortion_that_folds_back_does_not_bring_far_cells_into_view(
    hardware: tuple[CamerasTable, WingTable],
) -> None:
    cameras, wing = hardware
    bent: Eye = msgspec.structs.replace(cameras.left, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="left one may see 0"):
        # At 61 degrees off the axis r (1 - 0.3 r^2) is back near 0: the polynomial alone would see these cells.
        check_cells_in_view(msgspec.structs.replace(cameras, left=bent), moved(wing, (900.0, 48.0, 655.0)), "wing.toml")


def test_the_shipped_flight_tables_are_good_and_every_number_is_described() -> None:
    table = load_flight()
    assert table.schedule[0].task == "command"
    schema = msgspec.json.schema(FlightTable)["$defs"]
    for part in ("VisionTable", "IdentifyTable", "TaskSlot"):
        for name, entry in schema[part]["properties"].items():
            if name not in ("criticality",):
                assert "description" in entry or "description" in entry.get("anyOf", [{}])[0], (part, name)


def test_a_flight_file_replaces_only_what_it_gives(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text("[identify]\nhistory_ticks = 300\n")
    table, shipped = load_flight(path), load_flight()
    assert table.identify == msgspec.structs.replace(shipped.identify, history_ticks=300)
    assert (table.schedule, table.vision, table.limit) == (shipped.schedule, shipped.vision, shipped.limit)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[identify]\nhistory = 3\n", r"unknown key history in \[identify\]; did you mean history_ticks"),
        ("[identify]\nleast_ticks = 5000\n", "identify.least_ticks = 5000; at most history_ticks"),
        ('[vision]\nmethod = "magic"\n', "vision.method = 'magic'; allowed: edges, paper"),
        ("identify = 3\n", "identify = 3; expected table, got int"),
        ("schedule = []\n", "schedule = "),
        (
            '[[schedule]]\ntask = "x"\nbudgt_ms = 1.0\n',
            r"unknown key budgt_ms in \[schedule\[0\]\]; did you mean budget_ms",
        ),
        ('[[schedule]]\ntask = "x"\nbudget_ms = 1.0\ncriticality = "vital"\n', "'vital'; allowed: critical, normal"),
        (
            '[[limit]]\nnumber = 1\npoint = "cmpp"\nper = "frame"\nset_after = 1\nclear_after = 1\nlow_red = 1.0\n',
            "no point is called",
        ),
        (
            '[[limit]]\nnumber = 1\npoint = "cmp"\nper = "frame"\nset_after = 0\nclear_after = 1\n',
            r"limit\[0\].set_after = 0",
        ),
    ],
)
def test_a_wrong_flight_file_is_one_clear_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_flight(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
