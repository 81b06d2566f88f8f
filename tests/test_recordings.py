"""Recorded data that nobody made for these tests: a ray-traced wing, a slab, a laboratory frame."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import wingbeat


@pytest.fixture(scope="module")
def replayed(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recorded sequence, flown."""
    folder = tmp_path_factory.mktemp("replay") / "close"
    wingbeat("replay", recordings / "wing_close" / "sequence.toml", "--out", folder)
    return folder


@pytest.mark.requirement("WB-VIS-05")
def test_nearly_all_cells_are_measured_under_their_right_names(recordings: Path, replayed: Path) -> None:
    truth = np.load(recordings / "wing_close" / "truth.npz")
    points = np.load(replayed / "points.npz")
    place = points["cell"] @ [234, 18, 1]
    xyz, true = points["xyz_mm"], truth["X_left"][:, place]
    measured = np.isfinite(xyz[..., 0])
    assert np.abs(xyz - true)[measured].max() < 1.0  # a wrong name is off by a pitch, 20 mm
    in_view = np.ones(truth["uv_left"].shape[:2], bool)
    for eye in ("uv_left", "uv_right"):
        u, v = truth[eye][..., 0], truth[eye][..., 1]
        in_view &= (u >= 0) & (u <= 2047) & (v >= 0) & (v <= 1499)
    seen = measured & in_view[:, place]
    assert seen[5:].sum() >= 0.99 * in_view[5:].sum()  # the search takes five ticks
    assert seen.sum() >= 0.92 * in_view.sum()
    error = np.where(measured[..., None], xyz - true, np.nan)
    moving = error - np.nanmean(error, axis=0)
    assert np.sqrt(np.nanmean(moving**2)) < 0.005


def test_modes_are_right_after_five_seconds(recordings: Path, replayed: Path) -> None:
    truth = np.load(recordings / "wing_close" / "truth.npz")
    valid = [mode for mode in json.loads((replayed / "modes.json").read_text())["modes"] if mode["valid"]]
    assert [m["frequency_hz"] for m in valid] == pytest.approx(truth["fn_hz"], rel=1e-3)
    assert [m["damping_ratio"] for m in valid] == pytest.approx(truth["zeta"], rel=0.05)


@pytest.mark.requirement("WB-MOD-05")
def test_the_slab_has_its_mode(recordings: Path) -> None:
    done = wingbeat("identify", recordings / "records" / "slab.npz", "--json", "-")
    valid = [mode["frequency_hz"] for mode in json.loads(done.stdout)["modes"] if mode["valid"]]
    assert any(17.6 <= f <= 18.1 for f in valid)


@pytest.mark.requirement("WB-MOD-05")
def test_forced_lines_are_no_modes(recordings: Path) -> None:
    done = wingbeat("identify", recordings / "records" / "shear_frame.npz", "--json", "-")
    for mode in json.loads(done.stdout)["modes"]:
        forced = any(abs(mode["frequency_hz"] - line) < 0.02 for line in (0.275, 0.55))
        assert not (forced and mode["valid"])
