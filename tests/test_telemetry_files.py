"""Files of a run: peers that nobody here wrote read them, `wingbeat decode` reads them, damage is counted."""

import csv
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import can
import pytest
from mcap.reader import make_reader
from telemetry_run import MODES, STEPS, TICKS_RUN, mavlink_environment, time_of, write_run
from typer.testing import CliRunner

from telemetry.decode import csv_rows, decode_file, describe
from telemetry.export import dbc_text
from telemetry.mavlink_dialect import dialect_xml
from wingbeat.cli import app
from wingbeat.errors import InputError

BIN = Path(sys.executable).parent


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    write_run(folder)
    return folder


def read(path: Path) -> tuple[list[dict], Counter]:
    problems: Counter[str] = Counter()
    return list(decode_file(path, problems)), +problems


def assert_is_the_mode(record: dict, mode: dict) -> None:
    for name, step in STEPS.items():
        assert abs(float(record[name]) - mode[name]) <= step, name


def last_modes(records: list[dict]) -> list[dict]:
    return [record for record in records if record["packet"] == "mode"][-8:]


def test_two_runs_write_the_same_bytes(run, tmp_path):
    write_run(tmp_path)
    for name in ("can.log", "mavlink.tlog", "flight.mcap"):
        assert (tmp_path / name).read_bytes() == (run / name).read_bytes(), name
    assert sorted(path.name for path in run.iterdir()) == ["can.log", "flight.mcap", "mavlink.tlog"]


def test_can_log_and_tlog_carry_the_triggers_times(run):
    times = {f"({time_of(k) // 10**9}.{time_of(k) // 1000 % 10**6:06d})" for k in range(TICKS_RUN)}
    lines = [line.split() for line in (run / "can.log").read_text().splitlines()]
    assert {line[0] for line in lines} == times
    assert all(re.fullmatch(r"[0-9A-F]{3}#[0-9A-F]{16}", line[2]) and line[1] == "can0" for line in lines)
    assert int.from_bytes((run / "mavlink.tlog").read_bytes()[:8], "big") == time_of(0) // 1000


def test_cantools_decode_reads_can_log(run, tmp_path):
    (tmp_path / "wingbeat.dbc").write_text(dbc_text())
    command = [BIN / "cantools", "decode", "--single-line", tmp_path / "wingbeat.dbc"]
    with (run / "can.log").open() as log:
        said = subprocess.run(command, stdin=log, capture_output=True, text=True, check=True).stdout
    lines = said.splitlines()
    assert len(lines) == len((run / "can.log").read_text().splitlines())
    assert not [line for line in lines if "Unknown" in line or re.search(r"\berror\b", line.lower())]

    def signal(message: str, name: str) -> str:
        found = re.findall(rf"{message}\(.*?\b{name}: ([^,)]+)", said)
        return found[-1].split()[0]

    frame_of = {name: name.split("_")[0].upper() for name in STEPS}
    for slot, mode in enumerate(MODES):
        values = {name: signal(f"MODE{slot}_{frame}", name) for name, frame in frame_of.items()}
        assert_is_the_mode(values, mode)
        assert signal(f"MODE{slot}_STATE", "valid") == ("yes" if mode["valid"] else "no")
    assert signal("MODE2_FREQUENCY", "frequency_hz") == "not_available"
    assert signal("QUALITY_STATE", "mode") == "track"


def test_mavlogdump_reads_the_tlog_with_the_exported_dialect(run, tmp_path):
    environment = mavlink_environment(tmp_path)
    command = [sys.executable, BIN / "mavlogdump.py", "--dialect", "wingbeat", "--format", "json", run / "mavlink.tlog"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    shown = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    kinds = Counter(item["meta"]["type"] for item in shown)
    assert kinds["WINGBEAT_QUALITY"] == TICKS_RUN
    assert kinds["WINGBEAT_EVENT"] == 3
    assert kinds["HEARTBEAT"] == 3
    assert "BAD_DATA" not in kinds
    assert not [kind for kind in kinds if kind.startswith("UNKNOWN")]
    modes = [item["data"] for item in shown if item["meta"]["type"] == "WINGBEAT_MODE"][-8:]
    for slot, mode in enumerate(MODES):
        assert_is_the_mode(modes[slot], mode)
        assert modes[slot]["valid"] == mode["valid"]
    assert shown[-1]["meta"]["timestamp"] == pytest.approx(time_of(TICKS_RUN - 1) / 1e9, abs=1e-5)


def test_mcap_reader_reads_the_recording_at_the_triggers_times(run):
    with (run / "flight.mcap").open("rb") as file:
        messages = list(make_reader(file, validate_crcs=True).iter_messages())
        file.seek(0)
        header = make_reader(file).get_header()
    assert header.library == "wingbeat"
    counts = Counter(schema.name for schema, _, _ in messages)
    assert counts["foxglove.PointCloud"] == counts["wingbeat.Quality"] == TICKS_RUN
    assert counts["foxglove.Log"] == 3
    times = {time_of(tick) for tick in range(TICKS_RUN)}
    assert all(message.log_time in times and message.publish_time == message.log_time for _, _, message in messages)
    mode = [json.loads(message.data) for schema, _, message in messages if schema.name == "wingbeat.Mode"][-1]
    for slot, expected in enumerate(MODES):
        for name in STEPS:
            assert mode["slots"][slot][name] == expected[name]
        assert (mode["slots"][slot]["valid"], mode["slots"][slot]["flags"]) == (expected["valid"], expected["flags"])
    assert mode["slots"][2] == {"slot": 2}
    assert mode["tick"] == 18


def test_recording_messages_follow_their_schemas(run):
    """Every property that is sent is declared, with the type that is sent."""
    kinds = {"integer": int, "number": (int, float), "string": str, "boolean": bool, "array": list, "object": dict}

    def check(value, schema):
        assert isinstance(value, kinds[schema["type"]]), (value, schema)
        if isinstance(value, dict) and "properties" in schema:
            for name, inner in value.items():
                check(inner, schema["properties"][name])
        if isinstance(value, list):
            for inner in value:
                check(inner, schema["items"])

    with (run / "flight.mcap").open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            check(json.loads(message.data), json.loads(schema.data))


@pytest.mark.parametrize("name", ["can.log", "mavlink.tlog", "flight.mcap"])
def test_decode_gives_the_modes_events_and_times_from_every_file(run, name):
    records, problems = read(run / name)
    assert problems == {}
    modes = last_modes(records)
    for slot, mode in enumerate(MODES):
        assert_is_the_mode(modes[slot], mode)
        assert (modes[slot]["valid"], modes[slot]["flags"]) == (mode["valid"], mode["flags"])
        assert (modes[slot]["tick"], modes[slot]["slot"]) == (18, slot)
        assert modes[slot]["time_s"] == pytest.approx(time_of(18) / 1e9, abs=2e-6)
    assert modes[2]["frequency_hz"] is None
    assert modes[2]["valid"] is None
    events = [record for record in records if record["packet"] == "event"]
    assert [event["name"] for event in events] == ["LOCK_ACQUIRED", "MODE_CHANGED", "LIMIT_RED"]
    assert [event["tick"] for event in events] == [4, 4, 9]
    assert events[0]["text"] == "255 cells found"
    assert events[1]["text"] == "mode ACQUIRE -> TRACK"
    assert events[1]["arguments"] == {"before": "ACQUIRE", "after": "TRACK"}
    quality = [record for record in records if record["packet"] == "quality"]
    assert len(quality) == TICKS_RUN
    assert quality[-1]["char"] == pytest.approx(0.9988, abs=2e-5)
    assert quality[-1]["mode"] == "TRACK"


@pytest.mark.parametrize("suffix", ["asc", "blf"])
def test_decode_reads_vector_logs_written_by_python_can(run, tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    with can.CanutilsLogReader(run / "can.log") as log, can.Logger(path) as writer:
        for message in log:
            message.channel = 0
            writer(message)
    records, problems = read(path)
    assert problems == {}
    assert records == read(run / "can.log")[0]


def test_decode_counts_damage_in_a_can_log(run, tmp_path):
    lines = (run / "can.log").read_text().splitlines()
    damaged = [*lines[:12], lines[12][:-1] + "x", "(0.0) can0 123#00", *lines[13:-80], "no frame at all", *lines[-79:]]
    damaged[20] = damaged[20][:-4] + ("00" if damaged[20][-4:-2] != "00" else "01") + damaged[20][-2:]
    (tmp_path / "can.log").write_text("\n".join(damaged))
    records, problems = read(tmp_path / "can.log")
    assert problems["unknown identifier"] == 1
    assert problems["line that is no frame"] == 2
    assert problems["wrong CRC"] == 1
    assert problems["incomplete packet"] == 2
    assert sum(record.get("incomplete", False) for record in records) >= 2
    assert "1 x unknown identifier" in describe(problems)


def test_decode_counts_lost_can_packets(run, tmp_path):
    lines = [line for line in (run / "can.log").read_text().splitlines() if " 21" in line]
    (tmp_path / "can.log").write_text("\n".join(lines[: 6 * 4] + lines[6 * 9 :]))
    records, problems = read(tmp_path / "can.log")
    assert problems == {"lost packet": 5}
    assert len(records) == TICKS_RUN - 5


def test_decode_finds_its_way_again_in_a_damaged_tlog(run, tmp_path):
    content = bytearray((run / "mavlink.tlog").read_bytes())
    whole = read(run / "mavlink.tlog")[0]
    content[500] ^= 0x10
    content[2000:2000] = b"\xfd garbage \xfd\x09"
    (tmp_path / "mavlink.tlog").write_bytes(content[:-5])
    records, problems = read(tmp_path / "mavlink.tlog")
    assert sum(problems.values()) - problems["lost message"] == 3
    assert len(whole) - 4 <= len(records) <= len(whole) - 2


@pytest.mark.parametrize("cut", [0.3, 0.7])
def test_decode_gives_what_is_whole_of_a_recording_cut_short(tmp_path, run, cut):
    content = (run / "flight.mcap").read_bytes()
    (tmp_path / "flight.mcap.active").write_bytes(content[: int(len(content) * cut)])
    try:
        records, problems = read(tmp_path / "flight.mcap.active")
    except InputError as error:
        assert "unreadable rest of the file" in str(error)
    else:
        assert records and problems["unreadable rest of the file"] == 1


def test_decode_passes_over_a_corrupt_chunk(tmp_path, monkeypatch):
    monkeypatch.setattr("telemetry.recorder.CHUNK_BYTES", 2048)
    write_run(tmp_path)
    content = bytearray((tmp_path / "flight.mcap").read_bytes())
    whole = read(tmp_path / "flight.mcap")[0]
    content[300] ^= 0xFF
    (tmp_path / "flight.mcap").write_bytes(content)
    records, problems = read(tmp_path / "flight.mcap")
    assert problems == {"corrupt chunk": 1}
    assert 0.5 * len(whole) < len(records) < len(whole)


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "tlog", "mcap"])
@pytest.mark.parametrize("content", [b"", bytes(range(256)) * 40, b"\xfd" * 999, b"(1.0) can0 210#0011223344556677\n"])
def test_decode_says_in_one_line_that_a_file_holds_nothing(tmp_path, suffix, content):
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no telemetry of this dictionary"):
        read(path)


def test_decode_refuses_what_it_cannot_know(tmp_path):
    reasons = {"x.pdf": "unknown kind"} | dict.fromkeys(("no.log", "no.tlog", "no.blf", "no.mcap"), "cannot read")
    for name, reason in reasons.items():
        with pytest.raises(InputError, match=reason):
            read(tmp_path / name)


def test_csv_has_one_line_a_value_with_its_unit(run):
    rows = [row for record in read(run / "can.log")[0] for row in csv_rows(record)]
    row = next(row for row in rows if row[2:5] == ("mode", 0, "frequency_hz") and row[5] is not None)
    assert row[1] == 18
    assert row[5] == pytest.approx(0.7146)
    assert row[6] == "Hz"


def test_the_commands_write_files_and_json(run, tmp_path):
    runner = CliRunner()
    out, result = tmp_path / "can.csv", tmp_path / "can.json"
    done = runner.invoke(app, ["decode", str(run / "can.log"), "--as", "csv", "--out", str(out), "--json", str(result)])
    assert done.exit_code == 0, done.output
    with out.open() as table:
        assert next(csv.reader(table)) == ["time_s", "tick", "packet", "slot", "name", "value", "unit"]
    said = json.loads(result.read_text())
    assert said["problems"] == {}
    assert last_modes(said["records"])[0]["frequency_hz"] == pytest.approx(0.7146)
    done = runner.invoke(app, ["decode", str(run / "mavlink.tlog")])
    assert [json.loads(line) for line in done.stdout.splitlines()] == read(run / "mavlink.tlog")[0]
    done = runner.invoke(app, ["export", "dbc", "--out", str(tmp_path / "w.dbc")])
    assert (tmp_path / "w.dbc").read_text() == dbc_text()
    done = runner.invoke(app, ["export", "mavlink"])
    assert done.stdout == dialect_xml()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["can.csv", "can.json", "w.dbc"]


def test_a_command_that_fails_leaves_no_file(tmp_path):
    with pytest.raises(InputError):
        CliRunner().invoke(
            app, ["decode", str(tmp_path / "no.log"), "--out", str(tmp_path / "x")], catch_exceptions=False
        )
    with pytest.raises(InputError, match="cannot write"):
        CliRunner().invoke(app, ["export", "dbc", "--out", str(tmp_path / "no" / "x")], catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []
