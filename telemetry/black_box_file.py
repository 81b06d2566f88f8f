"""black_box_NNN.mcap: a header, then one message a tick: what a person reads in it, and the exact row.

A row is what fault protection decided on at one tick, and what it decided. The file holds every bit of it, so that the
decisions can be made again elsewhere and compared; it holds nothing that differs from one run to the next.
"""

import base64
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from telemetry.board import OFFSET, EventRecord
from telemetry.declaration import EVENT_ARGUMENTS
from telemetry.decode import decode_file, describe
from telemetry.dictionary import FREQUENCY_HZ, MODE, MODE_SLOTS, POINTS, VALID, VALIDITY
from telemetry.events import event_json
from telemetry.logs import LogFile, log_time_ns
from telemetry.scaling import readable
from wingbeat import __version__
from wingbeat.errors import InputError

Header = dict[str, Any]

FORMAT = 1
ROW_EVENTS = 32
"""Events of a tick that a row has room for; `raised` counts those that did not fit too."""

BOARD_SIZE = sum(point.slots for point in POINTS)
_HEADER_TOPIC, _ROW_TOPIC = "/black_box", "/decision"
_REMEDY = "name a black_box_NNN.mcap that wingbeat wrote"


def row_type(state_size: int) -> np.dtype[np.void]:
    """One row, for a protection whose state has so many numbers; little-endian, without gaps.

    before, after: the board around the decision, each point at its place in POINTS, slots one after the other;
    event, argument: what was raised, in order, 0 and NaN where there is nothing.
    """
    return np.dtype(
        [(name, "<i8") for name in ("tick", "time_ns", "causes", "new_frame", "new_estimate")]
        + [("state", "<f8", (state_size,)), ("before", "<f8", (BOARD_SIZE,)), ("after", "<f8", (BOARD_SIZE,))]
        + [("raised", "<i8"), ("event", "<i8", (ROW_EVENTS,)), ("argument", "<f8", (ROW_EVENTS, EVENT_ARGUMENTS))]
    )


def write_black_box(path: Path, header: Mapping[str, Any], rows: NDArray[np.void]) -> None:
    """Write rows (ticks,), oldest first; header: what the reader needs besides. Raises OSError."""
    kind = rows.dtype
    size = kind["state"].shape[0]
    head = {"format": FORMAT, "software": __version__, **header, "ticks": len(rows), "state_size": size}
    with LogFile(path) as file:
        writer = Writer(file.stream)
        writer.start(profile="", library="wingbeat")
        topics = [_channel(writer, _HEADER_TOPIC), _channel(writer, _ROW_TOPIC)]
        _add(writer, topics[0], int(rows["time_ns"][0]), head | {"points": _points(), "row": _layout(kind)}, 0)
        for place, row in enumerate(rows):
            exact = base64.b64encode(row.tobytes()).decode()
            _add(writer, topics[1], int(row["time_ns"]), decision(row) | {"row": exact}, place + 1)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it untyped


def read_black_box(path: Path) -> tuple[Header, NDArray[np.void]]:
    """The header and the rows (ticks,) of a file.

    Raises InputError: no such file, damaged, no black box, or written with another dictionary of points.
    """
    problems: Counter[str] = Counter()
    records = list(decode_file(path, problems))
    if damage := describe(problems):
        raise InputError(f"is damaged: {damage}", path, "take another copy of it")
    headers = [record for record in records if record["packet"] == _HEADER_TOPIC]
    if len(headers) != 1 or headers[0].get("format") != FORMAT:
        raise InputError("is no black box of this format", path, _REMEDY)
    header = headers[0]
    if header.get("points") != _points():
        wrote = header.get("software")
        raise InputError(f"has the points of wingbeat {wrote}", path, f"use that version; this is {__version__}")
    try:
        kind = row_type(int(header["state_size"]))
        exact = [base64.b64decode(record["row"]) for record in records if record["packet"] == _ROW_TOPIC]
        rows = np.frombuffer(b"".join(exact), kind)
    except (KeyError, TypeError, ValueError):
        raise InputError("has rows of another form than its header says", path, _REMEDY) from None
    if len(rows) == 0 or len(rows) != header.get("ticks") or header.get("row") != _layout(kind):
        raise InputError("has other rows than its header says", path, _REMEDY)
    return header, rows


def decision(row: np.void) -> dict[str, Any]:
    """What a row says, for a person: trigger, mode, validity, the frequencies that are shown, events."""
    after, time_ns = row["after"], int(row["time_ns"])
    frequency, valid = OFFSET[FREQUENCY_HZ.name], OFFSET[VALID.name]
    return {
        "tick": int(row["tick"]),
        "time_s": time_ns // 1000 / 1e6,
        "mode": readable(MODE, float(after[OFFSET[MODE.name]])),
        "validity": readable(VALIDITY, float(after[OFFSET[VALIDITY.name]])),
        "valid": [slot for slot in range(MODE_SLOTS) if after[valid + slot] == 1.0],
        "frequency_hz": [_finite(value) for value in after[frequency : frequency + MODE_SLOTS].tolist()],
        "events": list(_events(row)),
    }


def _events(row: np.void) -> Iterator[dict[str, Any]]:
    tick, time_ns = int(row["tick"]), int(row["time_ns"])
    for place in range(min(int(row["raised"]), ROW_EVENTS)):
        record = EventRecord(int(row["event"][place]), tick, time_ns, place, row["argument"][place].tolist())
        shown = event_json(record)
        yield {
            "name": shown["name"],
            "arguments": {name: _finite(value) for name, value in shown["arguments"].items()},
        }


def _finite(value: float | str | None) -> float | str | None:
    """What JSON can show of it."""
    return value if not isinstance(value, float) or isfinite(value) else None


def _points() -> list[dict[str, Any]]:
    return [{"name": point.name, "offset": OFFSET[point.name], "slots": point.slots} for point in POINTS]


def _layout(kind: np.dtype[np.void]) -> list[list[Any]]:
    """Name, type, shape and byte of each part of a row."""
    fields: Mapping[str, Any] = kind.fields or {}
    return [
        [name, field[0].base.str, list(field[0].shape), field[1]]
        for name in kind.names or ()
        for field in [fields[name]]
    ]


def _channel(writer: Writer, topic: str) -> int:
    schema = writer.register_schema(f"wingbeat{topic.replace('/', '.')}", "jsonschema", b'{"type":"object"}')
    return writer.register_channel(topic, "json", schema)


def _add(writer: Writer, channel: int, time_ns: int, message: Mapping[str, Any], sequence: int) -> None:
    text = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
    writer.add_message(channel, log_time_ns(time_ns), text, log_time_ns(time_ns), sequence)
