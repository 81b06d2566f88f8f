"""publish: what the board and the event queue hold, to the buses and the files. The last task of a tick."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import BinaryIO, ParamSpec

from fsw.commands.replies import Replies
from fsw.tasks.state import State
from hal.bus import Bus
from hal.link import Link
from telemetry.board import EventRecord
from telemetry.can_codec import CanEncoder
from telemetry.dictionary import BUS_DROPPED, BUS_ERRORS, STORAGE_ERRORS, STORAGE_FAILED
from telemetry.events import BUS_DROPPED as FRAMES_DROPPED
from telemetry.events import FIELDS_SATURATED, STORAGE_BACK, event_json
from telemetry.events import STORAGE_FAILED as WRITES_REFUSED
from telemetry.logs import CanLog, MavlinkLog
from telemetry.mavlink_codec import MavlinkEncoder
from telemetry.recorder import Recorder

P = ParamSpec("P")


@dataclass
class Outlets:
    """Where telemetry goes; None: nowhere."""

    bus: Bus | None = None
    can_log: CanLog | None = None
    link: Link | None = None
    mavlink_log: MavlinkLog | None = None
    recorder: Recorder | None = None
    events: BinaryIO | None = None


class Publish:
    """Encodes what is due at this tick, and sends it in the dictionary's order.

    Frames that the bus refuses and writes that the store refuses are counted and told, and lost; the flight goes on,
    and every tick tries again. recording: packets and points go to the recorder; its events always do.
    """

    name = "publish"

    def __init__(self, state: State, outlets: Outlets, replies: Replies) -> None:
        self._state, self._outlets, self._replies = state, outlets, replies
        self._can, self._mavlink = CanEncoder(), MavlinkEncoder()
        self.recording = True
        self._dropped = self._refused = 0  # frames and writes since the start
        self._saturated = 0

    def init(self) -> None:
        """The counters start at 0."""
        for point in (BUS_DROPPED, BUS_ERRORS, STORAGE_ERRORS, STORAGE_FAILED):
            self._state.board.set(point, 0)

    def run(self, tick: int, time_ns: int) -> None:
        """Events first, then answers to commands, then the packets that are due, then the points."""
        state, outlets = self._state, self._outlets
        dropped, refused = self._dropped, self._refused
        self.drain_events()
        self._answer(tick, time_ns)
        self._send_can(self._can.encode(state.board, tick, time_ns), time_ns)
        self._send_mavlink(self._mavlink.encode(state.board, tick, time_ns), time_ns)
        if outlets.recorder is not None and self.recording:
            self._keep(outlets.recorder.packets, state.board, tick, time_ns)
            if state.measured:
                points = state.tracker.points
                self._keep(outlets.recorder.points, tick, time_ns, points.xyz_mm, points.sigma_mm)
        state.new_estimate = False
        self._tell(self._dropped - dropped, self._refused - refused)

    def drain_events(self) -> None:
        """Send all queued events."""
        for record in self._state.take_events():
            self._send_event(record)

    def reset(self) -> None:
        """Count from 0 again."""
        self._dropped = self._refused = 0

    def _answer(self, tick: int, time_ns: int) -> None:
        for packet, board in self._replies.due():
            self._send_can(self._can.encode_on_demand(packet, board, tick, time_ns), time_ns)
            self._send_mavlink(self._mavlink.encode_on_demand(packet, board, tick, time_ns), time_ns)
        for answer in self._replies.answers():
            self._send_mavlink([self._mavlink.encode_answer(answer)], time_ns)

    def _send_event(self, record: EventRecord) -> None:
        outlets = self._outlets
        self._send_can(self._can.encode_event(record), record.time_ns)
        self._send_mavlink(self._mavlink.encode_event(record), record.time_ns)
        if outlets.recorder is not None:
            self._keep(outlets.recorder.event, record)
        if outlets.events is not None:
            self._keep(outlets.events.write, json.dumps(event_json(record)).encode() + b"\n")

    def _send_can(self, count: int, time_ns: int) -> None:
        outlets = self._outlets
        if outlets.bus is not None:
            for row in range(count):
                can_id, data = self._can.frame(row)
                self._dropped += not outlets.bus.send(can_id, data, time_ns)
        if outlets.can_log is not None:
            self._keep(outlets.can_log.write, time_ns, self._can, count)

    def _send_mavlink(self, messages: Sequence[bytes], time_ns: int) -> None:
        outlets = self._outlets
        if outlets.link is not None:
            for message in messages:
                self._dropped += not outlets.link.send(message)
        if outlets.mavlink_log is not None:
            self._keep(outlets.mavlink_log.write, time_ns, messages)

    def _keep(self, write: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> None:
        """Write to a file; a store that is full or gone is no reason to stop flying."""
        try:
            write(*args, **kwargs)
        except OSError:
            self._refused += 1

    def _tell(self, dropped: int, refused: int) -> None:
        """Of this tick: the limits and the ground see it at the next one."""
        state, board = self._state, self._state.board
        failed = board.get(STORAGE_FAILED) == 1.0
        board.set(BUS_DROPPED, self._dropped)
        board.set(BUS_ERRORS, dropped)
        board.set(STORAGE_ERRORS, self._refused)
        board.set(STORAGE_FAILED, refused > 0)
        if dropped:
            state.raise_event(FRAMES_DROPPED, dropped)
        if refused and not failed:
            state.raise_event(WRITES_REFUSED, refused)
        elif failed and not refused:
            state.raise_event(STORAGE_BACK)
        if clipped := self._can.saturated - self._saturated:
            self._saturated = self._can.saturated
            state.raise_event(FIELDS_SATURATED, clipped)
