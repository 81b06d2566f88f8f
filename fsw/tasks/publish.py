"""publish: what the board and the event queue hold, to the buses and the recorder. The last task of a tick."""

import json
from dataclasses import dataclass
from typing import BinaryIO

from fsw.tasks.state import State
from hal.bus import Bus
from telemetry.board import EventRecord
from telemetry.can_codec import CanEncoder
from telemetry.dictionary import BUS_DROPPED
from telemetry.events import event_json
from telemetry.logs import CanLog, MavlinkLog
from telemetry.mavlink_codec import MavlinkEncoder
from telemetry.recorder import Recorder


@dataclass
class Outlets:
    """Where telemetry goes; None: nowhere."""

    bus: Bus | None = None
    can_log: CanLog | None = None
    mavlink_log: MavlinkLog | None = None
    recorder: Recorder | None = None
    events: BinaryIO | None = None


class Publish:
    """Encodes what is due at this tick, and sends it in the dictionary's order. Frames the bus refuses are counted."""

    name = "publish"

    def __init__(self, state: State, outlets: Outlets) -> None:
        self._state, self._outlets = state, outlets
        self._can, self._mavlink = CanEncoder(), MavlinkEncoder()
        self._dropped = 0

    def init(self) -> None:
        """The counter starts at 0."""
        self._state.board.set(BUS_DROPPED, 0)

    def run(self, tick: int, time_ns: int) -> None:
        """Events first, then the packets that are due, then the points."""
        state, outlets = self._state, self._outlets
        self.drain_events()
        self._send_can(self._can.encode(state.board, tick, time_ns), time_ns)
        messages = self._mavlink.encode(state.board, tick, time_ns)
        if outlets.mavlink_log is not None:
            outlets.mavlink_log.write(time_ns, messages)
        if outlets.recorder is not None:
            outlets.recorder.packets(state.board, tick, time_ns)
            if state.measured:
                points = state.tracker.points
                outlets.recorder.points(tick, time_ns, points.xyz_mm, points.sigma_mm)
        state.new_estimate = False

    def drain_events(self) -> None:
        """Send all queued events."""
        for record in self._state.take_events():
            self._send_event(record)

    def _send_event(self, record: EventRecord) -> None:
        outlets = self._outlets
        self._send_can(self._can.encode_event(record), record.time_ns)
        messages = self._mavlink.encode_event(record)
        if outlets.mavlink_log is not None:
            outlets.mavlink_log.write(record.time_ns, messages)
        if outlets.recorder is not None:
            outlets.recorder.event(record)
        if outlets.events is not None:
            outlets.events.write(json.dumps(event_json(record)).encode() + b"\n")

    def _send_can(self, count: int, time_ns: int) -> None:
        outlets = self._outlets
        if outlets.bus is not None:
            for row in range(count):
                can_id, data = self._can.frame(row)
                self._dropped += not outlets.bus.send(can_id, data, time_ns)
            self._state.board.set(BUS_DROPPED, self._dropped)
        if outlets.can_log is not None:
            outlets.can_log.write(time_ns, self._can, count)
