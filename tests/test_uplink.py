"""The ground's side: names to frames that the flight side takes, and refusals that help."""

import zlib
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


@pytest.mark.requirement("WB-CMD-10")
def test_refusals_name_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean RESTART"):
        request_of("restrat")
    with pytest.raises(InputError, match="use TABLE_LOAD"):
        upload_of("NOOP", "0", tmp_path)
    with pytest.raises(InputError, match="cannot read"):
        upload_of("TABLE_LOAD", "VISION", tmp_path / "none.toml")
    (tmp_path / "empty.toml").write_bytes(b"")
    with pytest.raises(InputError, match="1 to 65535"):
        upload_of("TABLE_LOAD", "VISION", tmp_path / "empty.toml")


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
