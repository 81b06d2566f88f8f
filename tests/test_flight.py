"""The whole chain, from simulated images to files: right, complete, the same bytes every time, and read by peers."""

import csv
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from conftest import wingbeat, wingbeat_here
from mcap.reader import make_reader
from telemetry_run import mavlink_environment

from telemetry.dictionary import (
    AMPLITUDE_COHERENCE,
    AMPLITUDE_MM,
    DAMPING_RATIO,
    DAMPING_RATIO_SIGMA,
    FREQUENCY_HZ,
    FREQUENCY_SIGMA_HZ,
    VALID,
)
from telemetry.export import dbc_text

LOCK = 5  # the search begins at tick 0, and its result appears so many ticks later

SENT = (
    FREQUENCY_HZ,
    FREQUENCY_SIGMA_HZ,
    DAMPING_RATIO,
    DAMPING_RATIO_SIGMA,
    AMPLITUDE_MM,
    AMPLITUDE_COHERENCE,
    VALID,
)


def read_modes(folder: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((folder / "modes.json").read_text())
    return loaded


def payloads(path: Path) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as file:
        return [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]


@pytest.mark.requirement("WB-APP-01")
def test_the_true_modes_are_found_and_no_other_one_is_valid(small_run: Path) -> None:
    summary = json.loads((small_run / "summary.json").read_text())
    valid = [mode for mode in read_modes(small_run)["modes"] if mode["valid"]]
    assert len(valid) == len(summary["true_modes"]) == 3
    for mode, true, tolerance in zip(valid, summary["true_modes"], (2e-4, 1e-3, 1e-3), strict=True):
        assert mode["frequency_hz"] == pytest.approx(true["frequency_hz"], rel=tolerance)
        assert mode["damping_ratio"] == pytest.approx(true["damping_ratio"], rel=0.03)


@pytest.mark.requirement("WB-VIS-04")
def test_every_cell_is_followed_to_a_hundredth_of_a_millimetre(small_run: Path) -> None:
    against = json.loads((small_run / "summary.json").read_text())["against_truth"]
    assert against["cells"] >= 250
    assert against["first_measured_tick"] == LOCK
    assert against["share_of_ticks_median"] >= 0.99
    assert against["displacement_rms_mm"] < 0.01
    assert against["displacement_max_mm"] < 0.1  # no cell under another's name: that would be 20 mm


def test_quality_is_near_one_in_every_tick(small_run: Path) -> None:
    rows = list(csv.DictReader((small_run / "quality.csv").open()))
    assert [int(row["tick"]) for row in rows] == list(range(120))
    assert [row["mode"] for row in rows] == ["ACQUIRE"] * LOCK + ["TRACK"] * (len(rows) - LOCK)
    assert all(float(row["cmp"]) >= 0.99 and float(row["precision"]) == 1.0 for row in rows[LOCK:])


def test_the_folder_holds_what_the_contract_says(small_run: Path) -> None:
    names = {path.name for path in small_run.iterdir()}
    contract = {"flight.mcap", "can.log", "mavlink.tlog", "events.jsonl", "modes.json", "points.npz", "quality.csv"}
    assert contract | {"summary.json", "report.html"} <= names
    assert not any(name.endswith(".active") for name in names)
    with np.load(small_run / "points.npz") as points:
        ticks, cells = points["xyz_mm"].shape[:2]
        assert points["time_s"].shape == (ticks,) and points["cell"].shape == (cells, 3)
        assert points["sigma_mm"].shape == (ticks, cells) and points["centre_px"].shape == (2, ticks, cells, 2)


def assert_same_bytes(one: Path, two: Path) -> None:
    for name in ("can.log", "mavlink.tlog", "modes.json", "events.jsonl", "quality.csv"):
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    assert payloads(one / "flight.mcap") == payloads(two / "flight.mcap")
    with np.load(one / "points.npz") as first, np.load(two / "points.npz") as second:
        assert all(np.array_equal(first[key], second[key], equal_nan=True) for key in first.files)


@pytest.mark.requirement("WB-APP-02")
def test_another_process_sends_the_same_bytes(small_run: Path, tmp_path: Path) -> None:
    wingbeat("sil", "small", "--duration", "8", "--out", tmp_path / "again")
    assert_same_bytes(tmp_path / "again", small_run)


@pytest.mark.alone
@pytest.mark.requirement("WB-APP-02")
def test_real_pace_sends_the_same_bytes_as_lockstep(tmp_path: Path) -> None:
    wingbeat("sil", "small", "--duration", "4", "--out", tmp_path / "lockstep")
    assert any(mode["valid"] for mode in read_modes(tmp_path / "lockstep")["modes"])
    for attempt in range(3):
        run = tmp_path / f"real{attempt}"
        wingbeat("sil", "small", "--duration", "4", "--out", run, "--pace", "real")
        if json.loads((run / "summary.json").read_text())["overruns"] == 0:
            assert_same_bytes(run, tmp_path / "lockstep")
            return
    pytest.skip("this machine was too busy to keep real pace three times; what was late was counted as such")


def test_another_seed_sends_other_bytes(small_run: Path, tmp_path: Path) -> None:
    done = wingbeat_here("sil", "small", "--duration", "1", "--seed", "77", "--out", tmp_path / "other")
    assert done.returncode == 0, done.stderr
    ours = (small_run / "quality.csv").read_text().splitlines()[1:16]
    assert (tmp_path / "other" / "quality.csv").read_text().splitlines()[1:16] != ours


@pytest.mark.requirement("WB-APP-04")
def test_cantools_reads_the_log_and_agrees_with_modes_json(small_run: Path, tmp_path: Path) -> None:
    dbc = tmp_path / "wingbeat.dbc"
    dbc.write_text(dbc_text())
    command = [sys.executable, "-m", "cantools", "decode", "--single-line", str(dbc)]
    with (small_run / "can.log").open() as log:
        done = subprocess.run(command, stdin=log, capture_output=True, text=True, timeout=120, check=True)
    assert "Unknown frame" not in done.stdout and "ERROR" not in done.stdout
    database = cantools.database.load_string(dbc_text(), "dbc")
    last: dict[str, dict[str, Any]] = {}
    for line in (small_run / "can.log").read_text().splitlines():
        frame_id, data = line.split()[2].split("#")
        message = database.get_message_by_frame_id(int(frame_id, 16))
        last[message.name] = message.decode(bytes.fromhex(data), decode_choices=False)
    signals = {name: value for decoded in last.values() for name, value in decoded.items()}
    per_slot = [
        {key: value for name, decoded in last.items() if f"{slot}" in name for key, value in decoded.items()}
        for slot in range(8)
    ]
    assert signals
    for slot, mode in enumerate(read_modes(small_run)["modes"]):
        for point in SENT:
            found = [v for k, v in per_slot[slot].items() if k == point.name or k.startswith(f"{point.name}_")]
            exact = [v for k, v in per_slot[slot].items() if k.removesuffix(f"_{slot}") == point.name]
            value = (exact or found)[0]
            assert value == pytest.approx(float(mode[point.name]), abs=point.scale), (slot, point.name)


@pytest.mark.requirement("WB-APP-04")
def test_mavlogdump_reads_the_log_and_agrees_with_modes_json(small_run: Path, tmp_path: Path) -> None:
    environment = mavlink_environment(tmp_path)
    command = [sys.executable, "-m", "pymavlink.tools.mavlogdump", "--dialect=wingbeat", "--format=json"]
    done = subprocess.run(
        [*command, str(small_run / "mavlink.tlog")], capture_output=True, text=True, timeout=120, env=environment,
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    messages = [json.loads(line) for line in done.stdout.splitlines()]
    last = {m["data"]["slot"]: m["data"] for m in messages if m["meta"]["type"] == "WINGBEAT_MODE"}
    for slot, mode in enumerate(read_modes(small_run)["modes"]):
        for point in SENT:
            assert last[slot][point.name] == pytest.approx(float(mode[point.name]), rel=1e-6, abs=point.scale)


@pytest.mark.requirement("WB-APP-04")
def test_the_mcap_reader_reads_the_recording_and_agrees_with_modes_json(small_run: Path) -> None:
    records = payloads(small_run / "flight.mcap")
    slots = json.loads([data for topic, _, data in records if topic == "/mode"][-1])["slots"]
    for slot, mode in enumerate(read_modes(small_run)["modes"]):
        for point in SENT:
            assert math.isclose(slots[slot][point.name], float(mode[point.name]), rel_tol=0, abs_tol=point.scale)
    assert sum(topic == "/points" for topic, _, _ in records) == 120 - LOCK


def test_the_papers_own_centres_can_be_chosen_and_are_worse(small_run: Path, tmp_path: Path) -> None:
    tables = tmp_path / "paper.toml"
    tables.write_text('[vision]\nmethod = "paper"\n')
    done = wingbeat_here("sil", "small", "--duration", "2", "--tables", tables, "--out", tmp_path / "paper")
    assert done.returncode == 0, done.stderr
    printed = json.loads((tmp_path / "paper" / "summary.json").read_text())["against_truth"]
    fitted = json.loads((small_run / "summary.json").read_text())["against_truth"]
    assert printed["cells"] > 200
    assert 10.0 * fitted["displacement_rms_mm"] < printed["displacement_rms_mm"] < 0.5
