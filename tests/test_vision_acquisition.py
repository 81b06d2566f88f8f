"""ACQUIRE names every cell rightly under pose errors, light and grids of many kinds, or refuses."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from vision_scene import Scene, facing, paper_rig, rotation, three_panels

from fsw.vision.acquisition import Acquisition, Prior, acquire
from fsw.vision.cells import centres_of
from fsw.vision.grid import Panel, make_grid
from fsw.vision.rig import StereoRig
from fsw.vision.sketch import sketch
from hal.frame import as_frame, make_frames

SHARED = Path(__file__).parents[2] / "shared" / "data" / "wing_close"


def _scene(**changes: object) -> Scene:
    """The paper's set-up: one fold gap and both long borders in view, the wing bent and twisted by its vibration."""
    rig = paper_rig(1024)
    R, t = facing(rig, (700.0, 0.0), 700.0, rotation(5, -7, 3))
    bend = lambda x, y: 20.0 * (x / 1600) ** 2 + 3.0 * np.sin(x / 300) + 0.01 * y  # noqa: E731
    return Scene(rig, three_panels(), R, t, bend=bend, over=1).but(**changes)


def _acquire(
    scene: Scene,
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tolerance_mm: float = 25.0,
) -> Acquisition:
    prior = Prior(scene.R @ rotation(*turn_deg), scene.t + shift_mm, tolerance_mm, 3.0)
    return acquire(scene.image(0), scene.image(1), scene.rig, scene.grid, prior)


def _wrong(scene: Scene, found: Acquisition) -> int:
    """Cells whose corners lie a third of a cell from where that cell's are."""
    wrong = 0
    for eye in (0, 1):
        truth = scene.truth_px(eye)
        limit = np.linalg.norm(truth[:, 1] - truth[:, 2], axis=1) / 3
        off = np.linalg.norm(found.corners_px[eye] - truth, axis=-1).max(axis=1)
        wrong += int(np.sum(off[found.seen[eye]] > limit[found.seen[eye]]))
    return wrong


def _assert_right(scene: Scene, found: Acquisition, recall: float = 0.9) -> None:
    assert found.ok, found.reason
    assert _wrong(scene, found) == 0
    both = scene.visible(0) & scene.visible(1)
    assert np.mean(found.seen.all(axis=0)[both]) >= recall
    for eye in (0, 1):
        off = np.linalg.norm(found.corners_px[eye] - scene.truth_px(eye), axis=-1)
        # Cells are found at a level where they are no more than some 20 px wide, however large the image.
        assert np.percentile(off[found.seen[eye]], 95) < 1.5 * max(1.0, scene.rig.size[eye, 0] / 1024)
        assert not np.any(np.isfinite(found.corners_px[eye][~found.seen[eye]]))


POSES = [
    ((25.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-14.0, 14.0, -14.0), (1.7, -1.7, 1.7)),
    ((0.0, 24.9, 0.0), (0.0, 0.0, -3.0)),
    ((0.0, -24.9, 0.0), (-2.0, 2.0, 1.0)),
    ((10.0, -10.0, 20.0), (3.0, 0.0, 0.0)),
    ((-20.0, -10.0, -10.0), (0.0, 3.0, 0.0)),
]


@pytest.mark.parametrize(("shift_mm", "turn_deg"), POSES)
@pytest.mark.requirement("WB-VIS-01")
def test_every_name_is_right_though_the_pose_is_off_by_more_than_a_row(
    shift_mm: tuple[float, float, float], turn_deg: tuple[float, float, float]
) -> None:
    scene = _scene()
    found = _acquire(scene, shift_mm, turn_deg)
    _assert_right(scene, found)
    assert abs(found.scale - 1.0) < 0.003
    assert np.linalg.norm(found.rotation @ [700, 0, 0] + found.translation_mm - scene.R @ [700, 0, 0] - scene.t) < 15.0


LIGHTS = {
    "16 bits": {"bits": 16},
    "bright cells": {"grid": three_panels(dark=False)},
    "bright cells before the Earth": {"grid": three_panels(dark=False), "background": "earth"},
    "Earth behind": {"background": "earth"},
    "narrow fold gap": {"grid": three_panels(gap_mm=5.9), "border_mm": 2.9},
    "half in shadow": {"light": lambda x, y: np.where(y + 0.4 * (x - 700.0) > 30.0, 0.3, 1.0)},
    "gradient": {"light": lambda x, y: np.clip(1.0 - 0.7 * (x - 400.0) / 600.0, 0.3, 1.0)},
    "large image, halved first": {"rig": paper_rig(2048)},
    "lens distortion": {"rig": paper_rig(1024, (-0.1, 0.02, 0.001, -0.001, 0.0))},
}


@pytest.mark.parametrize("case", LIGHTS)
@pytest.mark.requirement("WB-VIS-03")
def test_light_background_and_lens_do_not_matter(case: str) -> None:
    scene = _scene(**LIGHTS[case])
    _assert_right(scene, _acquire(scene, (12.0, 15.0, -10.0), (1.0, -1.0, 1.0)), recall=0.75)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("dark", [True, False])
def test_the_drawing_that_the_kernels_compile_on_is_found(dark: bool, dtype: type) -> None:
    scene = _scene(grid=three_panels(dark=dark), bend=lambda x, y: 0.0 * x)
    images = [sketch(scene.rig, eye, scene.grid, scene.R, scene.t, dtype) for eye in (0, 1)]
    found = acquire(images[0], images[1], scene.rig, scene.grid, Prior(scene.R, scene.t, 25.0, 3.0))
    _assert_right(scene, found)


@pytest.mark.requirement("WB-VIS-01")
def test_a_row_that_one_eye_has_lost_does_not_shift_the_others() -> None:
    scene = _scene(t=_scene().t + np.array([0.0, 45.0, 0.0]))
    rows = [set(scene.grid.cell[scene.visible(eye), 2].tolist()) for eye in (0, 1)]
    assert rows[0] != rows[1]
    _assert_right(scene, _acquire(scene, (5.0, 20.0, 0.0)))


@pytest.mark.parametrize("shift_mm", [(0.0, 43.0, 0.0), (62.0, 0.0, 0.0), (0.0, -60.0, 0.0)])
def test_a_wing_beyond_the_tolerance_is_not_forced_into_it(shift_mm: tuple[float, float, float]) -> None:
    found = _acquire(_scene(), shift_mm)
    assert not found.ok
    assert not found.seen.any()


@pytest.mark.requirement("WB-VIS-03")
def test_glints_leave_holes_and_no_wrong_name() -> None:
    scene = _scene(gloss=lambda x, y: 1.5 * np.exp(-((x - 740.0) ** 2 + (y - 60.0) ** 2) / (2 * 40.0**2)))
    _assert_right(scene, _acquire(scene, (-10.0, -15.0, 5.0)), recall=0.75)


def test_the_whole_wing_of_another_grid_far_off_at_45_degrees() -> None:
    panels = [Panel((8.0 + 680.0 * p, -194.0), 8, 10, (82.0, 39.0), (79.0, 36.5)) for p in (0, 1)]
    grid = make_grid(panels, (1370.0, 400.0), True)
    rig = paper_rig(1024)
    R, t = facing(rig, (685.0, 0.0), 1700.0, rotation(4, 45, 3))
    scene = Scene(rig, grid, R, t, over=1)
    _assert_right(scene, _acquire(scene, (15.0, -15.0, 10.0), (1.0, 1.0, -1.0)), recall=0.8)


@pytest.mark.requirement("WB-VIS-02")
def test_no_border_and_no_gap_in_view_is_refused_unless_the_pose_is_known_well() -> None:
    rig = paper_rig(1024)
    narrow = rig.intrinsics * np.array([1.8, 1.8, 1.0, 1.0])
    rig = StereoRig(rig.size, narrow, rig.distortion, rig.rotation, rig.translation_mm)
    R, t = facing(rig, (805.0, 0.0), 700.0, rotation(2, 3, 2))
    scene = Scene(rig, three_panels(), R, t, over=1)
    inner = scene.visible(0) | scene.visible(1)
    assert set(scene.grid.cell[inner, 0].tolist()) == {1}
    assert not {0, 17} & set(scene.grid.cell[inner, 2].tolist())
    found = _acquire(scene, (4.0, 6.0, 0.0))
    assert not found.ok
    assert found.reason.startswith("ambiguous")
    assert not found.seen.any()
    _assert_right(scene, _acquire(scene, (2.0, 2.0, 0.0), tolerance_mm=8.0))


def test_a_hidden_border_row_is_no_border() -> None:
    """The last row lies in the umbra, the other border out of view: a guess would be wrong by one row."""
    rig = paper_rig(1024)
    R, t = facing(rig, (700.0, 120.0), 560.0, rotation(2, 3, 2))
    scene = Scene(
        rig, three_panels(), R, t, over=1, light=lambda x, y: np.where(y > 173.0 + 0.01 * (x - 700), 0.1, 1.0)
    )
    found = _acquire(scene, (0.0, 12.0, 0.0))
    assert _wrong(scene, found) == 0


def test_an_empty_sky_and_a_wing_out_of_view_are_said_to_be_so() -> None:
    scene = _scene()
    dark = make_frames((750, 1024), np.uint8)
    prior = Prior(scene.R, scene.t, 25.0, 3.0)
    assert acquire(dark, dark, scene.rig, scene.grid, prior).reason.startswith("too few cells in the left eye")
    away = Prior(scene.R, scene.t + np.array([9000.0, 0.0, 0.0]), 25.0, 3.0)
    assert "no part of the wing" in acquire(dark, dark, scene.rig, scene.grid, away).reason


@pytest.mark.requirement("WB-VIS-02")
def test_a_transposed_stereo_rotation_is_never_accepted() -> None:
    scene = _scene()
    rig = StereoRig(
        scene.rig.size, scene.rig.intrinsics, scene.rig.distortion,
        scene.rig.rotation.transpose(0, 2, 1).copy(), scene.rig.translation_mm,
    )  # fmt: skip
    prior = Prior(scene.R, scene.t, 25.0, 3.0)
    assert not acquire(scene.image(0), scene.image(1), rig, scene.grid, prior).ok


def _recorded() -> tuple[StereoRig, list[Panel], dict[str, NDArray[np.float64]]]:
    import tomllib

    cameras = tomllib.loads((SHARED / "cameras.toml").read_text())
    wing = tomllib.loads((SHARED / "wing.toml").read_text())
    eyes = [cameras["left"], cameras["right"]]
    stereo = cameras["stereo"]
    rig = StereoRig(
        np.array([[e["width"], e["height"]] for e in eyes]),
        np.array([[e[k] for k in ("fx", "fy", "cx", "cy")] for e in eyes]),
        np.array([e["distortion"] for e in eyes], dtype=np.float64),
        np.stack([np.eye(3), np.array(stereo["rotation"])]),
        np.stack([np.zeros(3), np.array(stereo["translation_mm"])]),
    )
    panels = [
        Panel(tuple(p["origin_mm"]), p["columns"], p["rows"], tuple(p["pitch_mm"]), tuple(p["cell_mm"]))
        for p in wing["panel"]
    ]
    return rig, panels, {k: np.array(wing["pose"][k]) for k in ("rotation", "translation_mm")}


@pytest.mark.skipif(not SHARED.exists(), reason="needs ../shared/data/wing_close beside the checkout")
@pytest.mark.parametrize("frame", [0, 37])
def test_the_recorded_sequence_is_named_rightly(frame: int) -> None:
    rig, panels, pose = _recorded()
    grid = make_grid(panels, (1600.0, 400.0), True)
    files = [str(SHARED / eye / f"{frame:06d}.png") for eye in ("left", "right")]
    images = [as_frame(cv2.imread(file, cv2.IMREAD_UNCHANGED)) for file in files]
    prior = Prior(pose["rotation"], pose["translation_mm"], 25.0, 3.0)
    found = acquire(images[0], images[1], rig, grid, prior)
    assert found.ok
    with np.load(SHARED / "truth.npz") as truth:
        centre = np.stack((truth["uv_left"][frame], truth["uv_right"][frame]))
    off = np.linalg.norm(centres_of(found.corners_px) - centre, axis=-1)
    assert off[found.seen].max() < 3.0
    inside = np.all((centre >= 0) & (centre <= rig.size[:, None] - 1), axis=(0, 2))
    assert found.seen.all(axis=0)[inside].mean() > 0.9
