"""The ground's side: names to frames that the flight side takes, and refusals that help."""

import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fsw.tables.bank import TableBank
from fsw.tables.flight import load_flight
from telemetry.commands import COMMANDS, Command, Piece, Request, decode_uplink
from telemetry.dictionary import TableFault
from telemetry.events import TableNumber
from telemetry.uplink import frames_of, request_of, upload_of
from wingbeat.cli import app
from wingbeat.errors import InputError

TOML = b"[vision]\nleast_cells = 20\n"


@pytest.mark.requirement("WB-CMD-10")
@pytest.mark.parametrize("command", Command)
def test_each_command_is_made_by_its_names(command: Command) -> None:
    spec = COMMANDS[command]
    number, name = next(iter(spec.selector.items()), (0, "0"))
    for selector in (name, name.lower(), str(number)):
        assert request_of(command.name.lower(), selector, spec.value[1]) == (command, number, spec.value[1], 0)
    with pytest.raises(InputError, match=command.name):
        request_of(command.name, "255", spec.value[0])
    with pytest.raises(InputError, match="values"):
        request_of(command.name, name, spec.value[1] + 1)


@pytest.mark.requirement("WB-CMD-10")
def test_an_upload_arrives_as_the_file_it_was(tmp_path: Path) -> None:
    path, bank = tmp_path / "vision.toml", TableBank(load_flight(), lambda schedule: 0)
    path.write_bytes(TOML)
    frames = upload_of("table_load", "vision", path, 250)
    assert [frame[1][6] for frame in frames] == [(250 + i) % 256 for i in range(len(frames))]
    for can_id, data in frames:
        match decode_uplink(can_id, data):
            case Request(Command.TABLE_LOAD, number, value, _):
                bank.upload.begin(TableNumber(number), value)
            case Piece(chunk, piece):
                assert bank.upload.put(chunk, piece)
            case Request(Command.TABLE_VALIDATE, number, value, _):
                assert value == zlib.crc32(TOML)
                assert bank.validate(TableNumber(number), value) is TableFault.NONE
            case other:
                pytest.fail(f"refused: {other}")
    assert bank.stores[TableNumber.VISION].loaded is not None


def refusal(make: Callable[[], object]) -> tuple[str, str, str]:
    """What, where and remedy of the refusal."""
    with pytest.raises(InputError) as caught:
        make()
    return caught.value.what, caught.value.where, caught.value.remedy


@pytest.mark.requirement("WB-CMD-10")
def test_refusals_name_what_there_is(tmp_path: Path) -> None:
    names = ", ".join(command.name for command in Command)
    hint = f"did you mean RESTART? there are {names}"
    assert refusal(lambda: request_of("restrat")) == ("no command restrat", "command", hint)
    assert refusal(lambda: request_of("xyz")) == ("no command xyz", "command", f"there are {names}")
    assert refusal(lambda: request_of("NOOP", "1", 2)) == ("1, 2", "command NOOP", "selectors: 0; values: 0 to 0")
    modes = ", ".join(COMMANDS[Command.SET_MODE].selector.values())
    what = refusal(lambda: request_of("set_mode", "nowhere"))
    assert what == ("nowhere, 0", "command SET_MODE", f"selectors: {modes}; values: 0 to 0")
    what = refusal(lambda: upload_of("NOOP", "0", tmp_path))
    assert what == ("command NOOP takes no file", "--table", "use TABLE_LOAD")
    path = tmp_path / "none.toml"
    what = refusal(lambda: upload_of("TABLE_LOAD", "VISION", path))
    assert what == ("cannot read this file: No such file or directory", str(path), "check its name and rights")
    (tmp_path / "empty.toml").write_bytes(b"")
    what = refusal(lambda: upload_of("TABLE_LOAD", "VISION", tmp_path / "empty.toml"))
    assert what[:2] == ("VISION, 0", "command TABLE_LOAD") and what[2].endswith("values: 1 to 65535")


@pytest.mark.requirement("WB-CMD-10")
def test_frames_are_numbered_from_0_unless_told_otherwise(tmp_path: Path) -> None:
    requests = [request_of("NOOP"), request_of("RESET_COUNTERS")]
    assert [frame[1][6] for frame in frames_of(requests)] == [0, 1]
    assert [frame[1][6] for frame in frames_of(requests, 255)] == [255, 0]
    (tmp_path / "vision.toml").write_bytes(TOML[:5])
    frames = upload_of("TABLE_LOAD", "VISION", tmp_path / "vision.toml")
    assert [frame[1][6] for frame in frames] == [0, 1, 2, 3]
    pieces = [decode_uplink(*frame) for frame in frames[1:3]]
    assert pieces == [Piece(0, TOML[:4]), Piece(1, TOML[4:5] + b"\0\0\0")]


@pytest.mark.requirement("WB-CMD-10")
def test_the_command_line_writes_candump_lines(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["command", "noop", "--sequence", "255", "--at", "1.5"])
    can_id, data = frames_of([request_of("NOOP")], 255)[0]
    assert result.stdout == f"(1.500000) can0 {can_id:03X}#{data.hex().upper()}\n"
    (tmp_path / "vision.toml").write_bytes(TOML)
    out = tmp_path / "upload.log"
    wanted = ["command", "TABLE_LOAD", "VISION", "--table", str(tmp_path / "vision.toml"), "--out", str(out)]
    assert CliRunner().invoke(app, wanted).exit_code == 0
    assert len(out.read_text().splitlines()) == 2 + -(-len(TOML) // 4)
