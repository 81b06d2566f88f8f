"""The recorder: everything of a run into one MCAP file, under Foxglove's schema names. Every time is a trigger's."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.writer import Writer

from telemetry.board import OFFSET, Board, EventRecord
from telemetry.can_codec import trigger_of
from telemetry.declaration import Packet, Severity
from telemetry.dictionary import PERIODIC_PACKETS
from telemetry.events import EVENT_BY_NUMBER, event_json
from telemetry.logs import LogFile, log_time_ns
from telemetry.recorder_schemas import (
    LOG_LEVEL,
    LOG_SCHEMA,
    POINT_CLOUD_SCHEMA,
    POINT_FIELDS,
    POINT_TYPE,
    packet_schema,
)
from telemetry.scaling import readable

CHUNK_BYTES = 64 * 1024
"""Small chunks: after a loss of power no more than the last one is gone."""


class Recorder(LogFile):
    """flight.mcap: topics /points, /events, and one for each periodic packet of the dictionary.

    cells (N, 3) int: panel, column, row of each point, written with it. Raises OSError where path cannot be written.
    """

    def __init__(self, path: Path, cells: npt.NDArray[np.integer[Any]]) -> None:
        super().__init__(path)
        self._writer = Writer(self.stream, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="", library="wingbeat")
        self._points = self._channel("/points", "foxglove.PointCloud", POINT_CLOUD_SCHEMA)
        self._events = self._channel("/events", "foxglove.Log", LOG_SCHEMA)
        self._packets = {
            packet: self._channel(f"/{packet.name}", f"wingbeat.{packet.name.capitalize()}", packet_schema(packet))
            for packet in PERIODIC_PACKETS
        }
        self._sequence = 0
        self._cloud = np.zeros(len(cells), POINT_TYPE)
        for column, name in enumerate(("panel", "column", "row")):
            self._cloud[name] = cells[:, column]
        self._axes = [self._cloud[axis] for axis in "xyz"]

    def points(
        self, tick: int, time_ns: int, xyz_mm: npt.NDArray[np.float64], sigma_mm: npt.NDArray[np.float64]
    ) -> None:
        """Record the 3-D points of a tick: xyz_mm (N, 3) in the left camera's frame, sigma_mm (N,), NaN = invalid.

        Foxglove's unit is the metre; sigma stays in mm, as its name says.
        """
        for axis, column in enumerate(self._axes):
            np.multiply(xyz_mm[:, axis], 1e-3, out=column, casting="same_kind")
        self._cloud["sigma_mm"] = sigma_mm
        cloud = {
            "timestamp": _stamp(time_ns),
            "frame_id": "left_camera",
            "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
            "point_stride": POINT_TYPE.itemsize,
            "fields": POINT_FIELDS,
            "data": base64.b64encode(self._cloud.tobytes()).decode(),
            "tick": tick,
        }
        self._write(self._points, time_ns, cloud)

    def packets(self, board: Board, tick: int, time_ns: int) -> None:
        """Record the packets that are due at this tick, in full precision; what is not available is left out."""
        for packet in PERIODIC_PACKETS:
            if packet.due(tick):
                slots = [_slot(packet, board, slot) for slot in range(packet.slots)]
                of_tick, time_us = trigger_of(packet, board, tick, time_ns)
                message: dict[str, Any] = {"timestamp": _stamp(time_ns)}
                if of_tick == of_tick and time_us == time_us:
                    message |= {"tick": int(of_tick), "time_s": time_us / 1e6}
                message |= slots[0] if packet.slots == 1 else {"slots": slots}
                self._write(self._packets[packet], time_ns, message)

    def event(self, record: EventRecord) -> None:
        """Record one event."""
        known = EVENT_BY_NUMBER.get(record.number)
        severity = known.severity if known else Severity.WARNING
        shown = event_json(record)
        log = {
            "timestamp": _stamp(record.time_ns),
            "level": LOG_LEVEL[severity],
            "message": f"{shown['name']} {json.dumps(shown['arguments'])}",
            "file": "",
            "line": 0,
        }
        self._write(self._events, record.time_ns, log | shown)

    def close(self) -> None:
        """Write the index, finish the file and give it its name."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it untyped
        super().close()

    def _channel(self, topic: str, name: str, schema: dict[str, Any]) -> int:
        schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        return self._writer.register_channel(topic, "json", schema_id)

    def _write(self, channel: int, time_ns: int, message: dict[str, Any]) -> None:
        text = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
        self._sequence += 1
        self._writer.add_message(channel, log_time_ns(time_ns), text, log_time_ns(time_ns), self._sequence)
        # A finished chunk leaves this process at once; an unfinished one waits in the writer.
        self.stream.flush()


def _stamp(time_ns: int) -> dict[str, int]:
    seconds, rest = divmod(log_time_ns(time_ns), 1_000_000_000)
    return {"sec": seconds, "nsec": rest}


def _slot(packet: Packet, board: Board, slot: int) -> dict[str, Any]:
    shown: dict[str, Any] = {"slot": slot} if packet.slots > 1 else {}
    for point in packet.points:
        value = readable(point, board.cells[OFFSET[point.name] + (slot if point.slots > 1 else 0)])
        if value is not None:
            shown[point.name] = value
    return shown
