"""The report page: what a person reads there is what the run's files say, whatever is missing."""

import json
import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import plotly.offline
import pytest
from hypothesis import given
from hypothesis import strategies as st
from telemetry_run import CELLS, MODES, TICKS_RUN, time_of, write_run

from telemetry.dictionary import ModeFlag
from telemetry.modes_text import INTERVAL
from telemetry.report import write_identify_report, write_report
from telemetry.report_data import read_run
from telemetry.report_figures import thin
from telemetry.report_modal import real_shape, tracking_figure
from telemetry.report_text import FLAG_WORDS, error, interval, modes_rows, verdict
from telemetry.report_wing import displacement_mm, spread_cells, steady_points
from wingbeat.errors import InputError

FIGURES = ("picture-left", "picture-right", "wing", "histories", "spectrum", "shapes", "tracking", "quality")
OPTIONAL = ("points.npz", "summary.json", "quality.csv", "events.jsonl", "flight.mcap", "diagram.npz", "left.png")
TRUE_MODES = [{"frequency_hz": 0.7146, "damping_ratio": 0.006}, {"frequency_hz": 5.5, "damping_ratio": 0.01}]


def modes_json(*modes: dict[str, Any], flags: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "modes": [{"singular_value": 1.0} | mode for mode in modes],
        "flags": list(flags),
        "record": {"duration_s": 1.2, "samples": 19, "rate_hz": 15.0},
        "estimate": {"tick": 18, "time_s": time_of(18) * 1e-9, "held": False},
    }


def diagram() -> dict[str, Any]:
    shape = np.ones((2, len(CELLS), 3)) * np.exp(0.4j)
    shape[:, -1] = np.nan
    return {
        "order": np.array([2, 4]), "frequency_hz": np.array([0.71, 0.72]), "damping_ratio": np.array([0.006, 0.007]),
        "stable": np.array([True, False]), "spectrum_hz": np.arange(8.0), "spectrum": np.arange(1.0, 9.0),
        "shape": shape, "shape_cell": CELLS,
    }  # fmt: skip


def small_run(folder: Path) -> Path:
    """All files of a run that found one valid mode of two; the last cell was never measured."""
    write_run(folder)
    time_s = np.array([time_of(tick) for tick in range(TICKS_RUN)]) * 1e-9
    rest = np.array([(40.0 * c, 20.0 * r, 720.0 + 3.0 * c) for _, c, r in CELLS])
    xyz = rest + np.sin(4.5 * np.arange(TICKS_RUN) / 15)[:, None, None] * [0.0, 0.0, 5.0]
    xyz[:, -1] = np.nan
    centre = np.tile(rest[:, :2], (2, TICKS_RUN, 1, 1))
    np.savez(folder / "points.npz", time_s=time_s, cell=CELLS, xyz_mm=xyz, sigma_mm=xyz[..., 0], centre_px=centre)
    np.savez(folder / "diagram.npz", **diagram())
    rows = [f"{tick},{time:.9f},TRACK,6,6,5,.99,1,.99,1,.9,.01" for tick, time in enumerate(time_s)]
    rows[0] = f"0,{time_s[0]:.9f},ACQUIRE,,,,,,,,,"
    header = "tick,time_s,mode,detected_left,detected_right,matched,char,mu,cmp,precision,recall,reprojection_rms_px"
    (folder / "quality.csv").write_text("\n".join([header, *rows]) + "\n")
    event = {"tick": 3, "time_s": time_s[3], "event": 41, "index": 1, "name": "MODE_INVALID", "severity": "WARNING",
             "arguments": {"slot": 0, "flags": int(ModeFlag.HARMONIC)}}  # fmt: skip
    (folder / "events.jsonl").write_text(json.dumps(event) + "\n")
    summary = {
        "ticks": TICKS_RUN, "ticks_measured": TICKS_RUN - 1, "drops": {"missing": 2},
        "preview": {"tick": 5, "scale": 4},
        "true_modes": TRUE_MODES, "against_truth": {"cells": 6, "displacement_rms_mm": 0.0042},
        "cpu_ms": {"feature": {"runs": 31, "mean": 1.5, "p50": 1.4, "p99": 2.0, "max": None}},
    }  # fmt: skip
    (folder / "summary.json").write_text(json.dumps(summary))
    for eye in ("left", "right"):
        (folder / f"{eye}.png").write_bytes(cv2.imencode(".png", np.zeros((15, 20), np.uint8))[1].tobytes())
    (folder / "modes.json").write_text(json.dumps(modes_json(*MODES)))
    return folder


def own_text(page: Path) -> str:
    """The page without the figures' library and data."""
    text = page.read_text().replace(plotly.offline.get_plotlyjs(), "")
    return re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)


def test_the_page_shows_the_verdict_the_truth_the_paper_and_every_figure(tmp_path: Path) -> None:
    text = own_text(write_report(small_run(tmp_path), "A run"))
    assert "1 valid mode, at 0.714603 ± 0.000042 Hz (+0.0004 % from the truth)." in text
    assert "Not found: the true mode at 5.5000 Hz." in text
    assert "no true mode near it" in text
    assert all(figure in text for figure in ("0.937 mm", "2.82 %", "0.0042 mm rms"))
    assert "pairs dropped: 2 missing" in text
    assert "(forced line: almost no damping)" in text
    assert re.findall(r'<div id="([a-z-]+)"', text) == list(FIGURES)


def test_the_page_is_complete_in_itself_small_and_always_the_same(tmp_path: Path) -> None:
    page = write_report(small_run(tmp_path), "A run")
    first = page.read_bytes()
    assert len(first) < 7_000_000
    assert not re.search(r"<link|@import|src=|href=|url\(", own_text(page))
    assert write_report(tmp_path, "A run").read_bytes() == first


@pytest.mark.parametrize("name", OPTIONAL)
def test_a_missing_file_leaves_a_page_that_stands(tmp_path: Path, name: str) -> None:
    (small_run(tmp_path) / name).unlink()
    assert "1 valid mode" in own_text(write_report(tmp_path, "A run"))


def test_a_run_that_never_locked_has_a_page_that_says_so(tmp_path: Path) -> None:
    nothing = {"modes": [], "flags": [], "record": {"duration_s": 0.0, "samples": 0, "rate_hz": None}}
    (tmp_path / "modes.json").write_text(json.dumps(nothing))
    (tmp_path / "summary.json").write_text(json.dumps({"ticks": 2, "ticks_measured": 0, "true_modes": TRUE_MODES}))
    (tmp_path / "quality.csv").write_text("tick,time_s,mode,char,mu,cmp\n")
    empty = np.zeros((2, 0, 3))
    np.savez(
        tmp_path / "points.npz", time_s=np.arange(2.0), cell=CELLS[:0], xyz_mm=empty, centre_px=np.zeros((2, 2, 0, 2))
    )
    text = own_text(write_report(tmp_path, "A run"))
    assert "No valid mode: the wing was not measured in any tick." in text
    assert "Not found: the true modes at 0.7146 Hz, 5.5000 Hz." in text
    assert text.count("<div id=") == 0
    for reason in (
        "No cell was measured in any tick",
        "No estimate was made",
        "No estimate was sent",
        "kept no images",
    ):
        assert reason in text


def test_a_mode_that_is_not_valid_never_reads_as_valid(tmp_path: Path) -> None:
    invalid = modes_json(MODES[1])
    assert verdict(invalid, {}, 30).startswith("No valid mode: 1 found, none passes all gates (forced line")
    table = modes_rows(invalid["modes"], {}, "mm")
    assert table.quiet == {0}
    assert table.rows[0][-1].startswith("not valid: forced line")


def test_a_held_estimate_is_called_held() -> None:
    modes = modes_json(MODES[0]) | {"estimate": {"tick": 1, "time_s": 0.1, "held": True}}
    assert verdict(modes, {}, 30).endswith("held from an earlier estimate.")


def test_every_flag_has_words() -> None:
    assert {flag.name.lower() for flag in ModeFlag if flag.name} == set(FLAG_WORDS)


@given(st.floats(0.01, 100.0), st.floats(1e-9, 1.0))
def test_the_printed_interval_is_never_narrower_than_the_real_one(value: float, sigma: float) -> None:
    shown, half = (float(part) for part in interval(value, sigma).split("±"))
    assert half >= INTERVAL * sigma * (1.0 - 1e-9)
    assert half <= max(INTERVAL * sigma * 1.11, 1.000_001e-6)
    assert abs(shown - value) <= 0.5 * half


def test_errors_are_said_with_two_digits_or_as_less_than_a_bound() -> None:
    assert error(1.0282, 1.0) == "+2.8 %"
    assert error(0.99988, 1.0) == "-0.012 %"
    assert error(1.0 + 1e-8, 1.0) == "< 0.0001 %"


@given(st.lists(st.one_of(st.just(math.nan), st.floats(-1e6, 1e6)), min_size=1, max_size=300), st.integers(2, 50))
def test_thinning_keeps_the_extremes_and_the_limit(values: list[float], most: int) -> None:
    y = np.array(values)
    x, kept = thin(np.arange(float(len(y))), y, most)
    assert len(x) == len(kept) <= most
    assert np.all(np.diff(x) > 0)
    if np.isfinite(y).any():
        assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(y), np.nanmax(y))


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_displacement_is_along_the_normal_of_a_tilted_wing(pitch: float, yaw: float) -> None:
    turn = cv2.Rodrigues(np.array([pitch, yaw, 0.0]))[0]
    flat = np.array([(40.0 * c, 20.0 * r, 0.0) for c in range(6) for r in range(4)])
    moved = np.zeros((2, len(flat), 3))
    moved[0, :, 2], moved[1, :, 2] = -1.5, 1.5
    found = displacement_mm((flat + moved) @ turn.T + [0.0, 0.0, 700.0])
    np.testing.assert_allclose(found, -moved[..., 2], atol=1e-9)  # towards the cameras is positive


def test_cells_of_the_histories_lie_far_apart_and_were_measured_well() -> None:
    xyz = np.array([(40.0 * c, 20.0 * r, 700.0) for c in range(6) for r in range(4)]) + np.zeros((20, 24, 3))
    xyz[:, -1, 2] += np.sin(np.arange(20))
    xyz[4:, 0] = np.nan  # a corner that was hardly seen
    chosen = spread_cells(xyz, displacement_mm(xyz), 3)
    place = xyz[0, chosen, :2]
    distance = np.linalg.norm(place[:, None] - place, axis=-1)
    assert 0 not in chosen and 23 in chosen
    assert distance[~np.eye(3, dtype=bool)].min() > 90.0


def test_cells_that_were_hardly_measured_are_left_out_of_the_motion() -> None:
    xyz = np.zeros((10, len(CELLS), 3))
    xyz[3:, 2] = np.nan
    kept = steady_points({"time_s": np.arange(10.0), "cell": CELLS, "xyz_mm": xyz})
    assert kept["cell"].tolist() == np.delete(CELLS, 2, axis=0).tolist()


@given(st.floats(0.0, 6.3))
def test_a_shape_is_real_up_to_its_phase(phase: float) -> None:
    true = np.array([0.1, -0.5, np.nan, 1.0])
    np.testing.assert_allclose(real_shape(0.3 * true * np.exp(1j * phase)), true, atol=1e-12)


def test_each_estimate_is_drawn_once_hollow_unless_valid(tmp_path: Path) -> None:
    run = read_run(small_run(tmp_path))
    assert [(e["tick"], e["slot"], e["valid"]) for e in run.estimates] == [(18, 0, True), (18, 1, False)]
    figure = tracking_figure(run.modes["modes"], run.estimates, {}, run.start_s)
    marks = [trace for trace in figure.data if trace.mode == "lines+markers"]
    assert [list(trace.x) for trace in marks] == [[pytest.approx(18 / 15, abs=1e-5)]] * 4
    assert [trace.marker.color[0] == "rgba(0,0,0,0)" for trace in marks] == [False, False, True, True]


def test_an_identification_has_its_page(tmp_path: Path) -> None:
    arrays = diagram() | {"shape": diagram()["shape"][..., 0]}
    text = own_text(write_identify_report(tmp_path / "a.html", "<b>Slab</b> & co", modes_json(*MODES), arrays))
    assert "&lt;b&gt;Slab&lt;/b&gt; &amp; co" in text
    assert re.findall(r'<div id="([a-z-]+)"', text) == ["spectrum", "shapes"]


def test_a_folder_that_is_no_run_or_is_damaged_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no modes\.json"):
        write_report(tmp_path, "A run")
    (small_run(tmp_path) / "left.png").write_bytes(b"GIF89a")
    with pytest.raises(InputError, match=r"left\.png is no PNG image"):
        write_report(tmp_path, "A run")
    with pytest.raises(InputError, match="cannot write"):
        write_identify_report(tmp_path / "absent" / "a.html", "", modes_json(), diagram())
