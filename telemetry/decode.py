"""Telemetry files to records for people and programs; what cannot be read is counted, never lost in silence."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from telemetry.decode_can import read_asc, read_blf, read_candump
from telemetry.decode_mavlink import read_tlog
from telemetry.decode_mcap import read_mcap
from telemetry.dictionary import POINT_BY_NAME
from wingbeat.errors import InputError

Record = dict[str, Any]
"""packet, time_s, tick, slot where a packet has several, and its points by name; None: not available."""

READERS: dict[str, Callable[[Path, Counter[str]], Iterator[Record]]] = {
    ".log": read_candump,
    ".asc": read_asc,
    ".blf": read_blf,
    ".tlog": read_tlog,
    ".mcap": read_mcap,
}
CSV_HEADER = ("time_s", "tick", "packet", "slot", "name", "value", "unit")


def decode_file(path: Path, problems: Counter[str]) -> Iterator[Record]:
    """The records of a telemetry file, told by its suffix; a file still called .active is read as far as it goes.

    problems counts what could not be read, by reason. InputError: no such file, unknown suffix, nothing readable.
    """
    known = path.with_suffix("") if path.suffix == ".active" else path
    reader = READERS.get(known.suffix.lower())
    if reader is None:
        raise InputError("unknown kind of telemetry file", path, f"give a file named *{', *'.join(READERS)}")
    found = False
    try:
        for record in reader(path, problems):
            found = True
            yield record
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot read: {reason}", path, "name a readable telemetry file") from None
    if not found:
        said = describe(problems) or "it is empty"
        raise InputError(f"no telemetry of this dictionary ({said})", path, "check that a wingbeat node wrote it")


def describe(problems: Counter[str]) -> str:
    """Problems as one phrase: `2 x wrong CRC, 1 x unknown identifier`; empty if there are none."""
    return ", ".join(f"{count} x {reason}" for reason, count in sorted(problems.items()) if count)


def csv_rows(record: Record) -> Iterator[tuple[Any, ...]]:
    """One row a value, as CSV_HEADER names them: packets differ in their points, so each value has its own line."""
    head = tuple(record.get(name) for name in CSV_HEADER[:4])
    for name, value in record.items():
        if name not in CSV_HEADER[:4]:
            unit = POINT_BY_NAME[name].unit if name in POINT_BY_NAME else ""
            yield (*head, name, _cell(value), unit)


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, list):
        return "|".join(str(_cell(item)) for item in value)
    if isinstance(value, dict):
        return "|".join(f"{key}={_cell(item)}" for key, item in value.items())
    return value
