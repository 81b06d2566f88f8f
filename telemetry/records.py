"""What all decoders share: a packet's values as one record."""

from collections.abc import Mapping
from typing import Any

from telemetry.board import EventRecord
from telemetry.declaration import Packet, Point
from telemetry.dictionary import (
    EVENT_ARGUMENT_COUNT,
    EVENT_ARGUMENT_POINTS,
    EVENT_INDEX,
    EVENT_NUMBER,
    EVENT_PACKET,
)
from telemetry.events import event_json, event_text
from telemetry.scaling import readable


def packet_record(
    packet: Packet, slot: int, tick: float, time_us: float, values: Mapping[Point, float], **more: Any
) -> dict[str, Any]:
    """One slot of a packet as a record; a point that is missing from values, or NaN, is None."""
    if packet is EVENT_PACKET:
        return {"packet": packet.name, **_event(tick, time_us, values), **more}
    record: dict[str, Any] = {
        "packet": packet.name,
        "time_s": time_us / 1e6 if time_us == time_us else None,
        "tick": int(tick) if tick == tick else None,
    }
    if packet.slots > 1:
        record["slot"] = slot
    for point in packet.points:
        record[point.name] = readable(point, values.get(point, float("nan")))
    return record | more


def _event(tick: float, time_us: float, values: Mapping[Point, float]) -> dict[str, Any]:
    """An event as events.jsonl has it, and its text; -1 stands for a number that did not arrive."""
    count, number, index = (
        int(value) if (value := values.get(point, -1.0)) == value else -1
        for point in (EVENT_ARGUMENT_COUNT, EVENT_NUMBER, EVENT_INDEX)
    )
    arguments = [values.get(point, float("nan")) for point in EVENT_ARGUMENT_POINTS[: max(count, 0)]]
    arrived = tick == tick and time_us == time_us
    at = EventRecord(number, int(tick) if arrived else -1, int(time_us) * 1000 if arrived else -1, index, arguments)
    shown = event_json(at)
    if not arrived:
        shown |= {"tick": None, "time_s": None}
    return shown | {"text": event_text(number, arguments)}
