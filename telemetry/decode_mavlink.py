"""A MAVLink tlog to records."""

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from telemetry.dictionary import PACKETS, SATURATED, TICK
from telemetry.mavlink_codec import parse_tlog
from telemetry.mavlink_dialect import MESSAGES, unavailable, wire_type
from telemetry.records import packet_record

_PACKET_OF = {MESSAGES[packet]: packet for packet in PACKETS}
_NO_TIME = (1 << 64) - 1


def read_tlog(path: Path, problems: Counter[str]) -> Iterator[dict[str, Any]]:
    """Records of a tlog; messages of other dialects keep their own fields."""
    last: dict[tuple[int, int], int] = {}
    for message in parse_tlog(path.read_bytes()):
        if isinstance(message, str):
            problems[message] += 1
            continue
        sender = (message.get_srcSystem(), message.get_srcComponent())
        sequence = message.get_seq()
        if sender in last:
            problems["lost message"] += (sequence - last[sender] - 1) % 256
        last[sender] = sequence
        yield _record(message, sequence)


def _record(message: Any, sequence: int) -> dict[str, Any]:
    packet = _PACKET_OF.get(message.get_type())
    if packet is None:
        fields = {name: _plain(getattr(message, name)) for name in message.get_fieldnames()}
        return {"packet": message.get_type(), "sequence": sequence, **fields}
    values = {}
    for point in (TICK, SATURATED, *packet.points):
        sent = getattr(message, point.symbol)
        # A float32 as its shortest decimal: 0.7146, not 0.7146000266075134.
        value = float(str(np.float32(sent))) if wire_type(point) == "float" else float(sent)
        values[point] = math.nan if value == unavailable(point) else value
    time_us = math.nan if message.time_usec == _NO_TIME else float(message.time_usec)
    more = {"sequence": sequence, "saturated": int(message.saturated)}
    return packet_record(packet, getattr(message, "slot", 0), values[TICK], time_us, values, **more)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes | bytearray):
        return value.hex()
    return list(value) if isinstance(value, tuple | list) else value
