"""An MCAP recording to records, chunk by chunk, so that a corrupt or unfinished file gives all that is whole."""

import base64
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from telemetry.declaration import Packet
from telemetry.dictionary import PERIODIC_PACKETS
from telemetry.events import named_text
from telemetry.recorder_schemas import POINT_TYPE
from telemetry.scaling import Readable

_PACKET_OF = {f"/{packet.name}": packet for packet in PERIODIC_PACKETS}


def read_mcap(path: Path, problems: Counter[str]) -> Iterator[dict[str, Any]]:
    """Records of a recording; messages of other writers are shown as they are if they are JSON."""
    with path.open("rb") as file:
        # The summary at the end repeats all channels: they are known even if their own chunk is corrupt.
        channels = {r.id: r for r in _records(file, Counter()) if isinstance(r, Channel)}
        file.seek(0)
        for record in _records(file, problems):
            for inner in _inside(record, problems):
                if isinstance(inner, Channel):
                    channels[inner.id] = inner
                elif isinstance(inner, Message):
                    yield from _message(channels.get(inner.channel_id), inner, problems)


def _records(file: BinaryIO, problems: Counter[str]) -> Iterator[McapRecord]:
    size = file.seek(0, 2)
    file.seek(0)
    reader = StreamReader(file, emit_chunks=True, record_size_limit=size)
    try:
        yield from reader.records
    except Exception:  # a corrupt file raises whatever its bytes lead to
        problems["unreadable rest of the file"] += 1


def _inside(record: McapRecord, problems: Counter[str]) -> list[McapRecord]:
    if not isinstance(record, Chunk):
        return [record] if isinstance(record, Channel | Message | Schema) else []
    try:
        return breakup_chunk(record, validate_crc=True)
    except Exception:  # see above; the next chunk is whole again
        problems["corrupt chunk"] += 1
        return []


def _message(channel: Channel | None, message: Message, problems: Counter[str]) -> Iterator[dict[str, Any]]:
    if channel is None or channel.message_encoding != "json":
        problems["message of an unknown kind"] += 1
        return
    try:
        shown = json.loads(message.data)
        packet = _PACKET_OF.get(channel.topic)
        if packet is not None:
            yield from _packet(packet, shown)
        elif channel.topic == "/points":
            yield _cloud(shown, message.log_time)
        elif channel.topic == "/events":
            yield {"packet": "event", **_event(shown)}
        else:
            yield {"packet": channel.topic, "time_s": message.log_time // 1000 / 1e6, **shown}
    except (ValueError, KeyError, TypeError):
        problems["message that is not of its schema"] += 1


def _packet(packet: Packet, shown: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for slot in shown["slots"] if packet.slots > 1 else [shown]:
        record: dict[str, Any] = {
            "packet": packet.name, "time_s": shown.get("time_s"), "tick": shown.get("tick")
        }  # fmt: skip
        if packet.slots > 1:
            record["slot"] = slot["slot"]
        values: dict[str, Readable] = {point.name: slot.get(point.name) for point in packet.points}
        yield record | values


def _event(shown: dict[str, Any]) -> dict[str, Any]:
    kept = ("tick", "time_s", "event", "index", "name", "severity", "arguments")
    return {name: shown[name] for name in kept} | {"text": named_text(shown["event"], shown["arguments"])}


def _cloud(shown: dict[str, Any], time_ns: int) -> dict[str, Any]:
    """The valid points of a tick: cell (panel, column, row), place and standard deviation in mm."""
    points = np.frombuffer(base64.b64decode(shown["data"]), POINT_TYPE)
    points = points[np.isfinite(points["x"])]
    xyz_mm = np.stack([points[axis] for axis in "xyz"], axis=1).astype(float) * 1e3
    return {
        "packet": "points",
        "time_s": time_ns // 1000 / 1e6,
        "tick": shown["tick"],
        "cell": [[int(p["panel"]), int(p["column"]), int(p["row"])] for p in points],
        "xyz_mm": np.round(xyz_mm, 5).tolist(),
        "sigma_mm": [float(str(s)) if np.isfinite(s) else None for s in points["sigma_mm"]],
    }
