"""The commands `wingbeat decode`, `wingbeat export` and `wingbeat command`."""

import csv
import json
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TextIO

import typer

from telemetry.commands import COMMANDS, Command
from telemetry.decode import CSV_HEADER, Record, csv_rows, decode_file, describe
from telemetry.export import dbc_text
from telemetry.mavlink_dialect import dialect_xml
from telemetry.page import page_text
from telemetry.uplink import frames_of, request_of, upload_of
from wingbeat.console import track, write_json
from wingbeat.errors import InputError


class Form(StrEnum):
    """How decoded telemetry is written."""

    JSONL = "jsonl"
    CSV = "csv"


class Format(StrEnum):
    """What the dictionary is exported to."""

    DBC = "dbc"
    MAVLINK = "mavlink"
    PAGE = "page"


_EXPORTS = {Format.DBC: dbc_text, Format.MAVLINK: dialect_xml, Format.PAGE: page_text}


def decode(
    file: Annotated[Path, typer.Argument(help="A candump .log, .asc, .blf, .tlog or .mcap file.")],
    form: Annotated[Form, typer.Option("--as", help="One JSON object a packet, or one line a value.")] = Form.JSONL,
    out: Annotated[Path | None, typer.Option(help="Write to this file instead of stdout.")] = None,
    json_file: Annotated[
        str | None, typer.Option("--json", help="Records and problems as one JSON object; - for stdout.")
    ] = None,
) -> None:
    """Turn recorded telemetry into text; what cannot be read is counted on stderr.

    Example: wingbeat decode run/can.log --as csv --out can.csv
    """
    problems: Counter[str] = Counter()
    records: Iterable[Record] = decode_file(file, problems)
    if json_file is not None:
        records = list(records)
        write_json({"file": str(file), "records": records, "problems": +problems}, json_file)
    if json_file is None or out is not None:
        with _target(out) as stream:
            _write(track(records, f"decoding {file.name}") if out else records, form, stream)
    if said := describe(problems):
        print(f"wingbeat decode: {file}: {said}", file=sys.stderr)


def export(
    format: Annotated[Format, typer.Argument(help="dbc: CAN tools; mavlink: dialect XML; page: Markdown.")],
    out: Annotated[Path | None, typer.Option(help="Write to this file instead of stdout.")] = None,
) -> None:
    """Write the telemetry dictionary in another tool's format.

    Example: wingbeat export dbc --out wingbeat.dbc
    """
    text = _EXPORTS[format]()
    with _target(out) as stream:
        stream.write(text)


_COMMAND_HELP = "; ".join(f"{command.name}: {COMMANDS[command].meaning}" for command in Command)


def command(
    name: Annotated[str, typer.Argument(help=_COMMAND_HELP)],
    selector: Annotated[str, typer.Argument(help="What it acts on, by name or number; see docs/telemetry.md.")] = "0",
    value: Annotated[int, typer.Argument(help="Its value.")] = 0,
    table: Annotated[Path | None, typer.Option(help="With TABLE_LOAD: send this TOML file, and validate it.")] = None,
    sequence: Annotated[int, typer.Option(min=0, max=255, help="Counter of the first frame.")] = 0,
    at: Annotated[float, typer.Option(min=0.0, help="Time of the frames, s.")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="Write to this file instead of stdout.")] = None,
) -> None:
    """Make the CAN frames of a command, as candump writes them.

    Example: wingbeat command SET_MODE INHIBITED | canplayer vcan0=can0
    """
    if table is None:
        frames = frames_of([request_of(name, selector, value)], sequence)
    else:
        frames = upload_of(name, selector, table, sequence)
    with _target(out) as stream:
        for can_id, data in frames:
            stream.write(f"({at:.6f}) can0 {can_id:03X}#{data.hex().upper()}\n")


def _write(records: Iterable[Record], form: Form, stream: TextIO) -> None:
    if form is Form.JSONL:
        for record in records:
            stream.write(json.dumps(record, allow_nan=False) + "\n")
        return
    table = csv.writer(stream, lineterminator="\n")
    first = True
    for record in records:
        if first:  # the header waits for the first record: a file that cannot be read leaves no table
            table.writerow(CSV_HEADER)
            first = False
        table.writerows(csv_rows(record))


@contextmanager
def _target(out: Path | None) -> Iterator[TextIO]:
    """stdout, or a file that is there only when it is complete; a reader that stops early (`| head`) is no error."""
    if out is None:
        try:
            yield sys.stdout
            sys.stdout.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return
    active = out.with_name(out.name + ".active")
    try:
        stream = active.open("w", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", out, "name a file in a writable folder") from None
    try:
        with stream:
            yield stream
    except BaseException:
        active.unlink()
        raise
    active.replace(out)
