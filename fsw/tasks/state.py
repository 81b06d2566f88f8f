"""What the tasks share: one place, taken once. Each part has one task that writes it."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fault.modes import Cause
from fsw.memory.ring import Ring
from fsw.modal.result import ModalResult
from fsw.vision.tracking import Tracker
from telemetry.board import Board, EventRecord
from telemetry.declaration import Event
from telemetry.dictionary import EVENT_COUNT, EVENTS_SUPPRESSED, FlightMode
from telemetry.events import HISTORY_CLEARED

EVENT_QUEUE = 64  # events that wait to be sent; full: the newest is counted and lost

NOTHING = Cause(0)


@dataclass
class Pair:
    """The pair of this tick, by acquire. usable: both eyes exposed by this trigger, and fit to measure."""

    left: NDArray[Any]
    right: NDArray[Any]
    usable: bool = False


@dataclass
class Estimate:
    """A delivered identification: the result, the cells (K,) whose x, y, z were its channels, its newest frame."""

    result: ModalResult
    cells: NDArray[np.int64]
    tick: int
    time_ns: int


@dataclass
class State:
    """The blackboard of the frame tasks."""

    tracker: Tracker
    pair: Pair
    history_time_ns: Ring  # (ticks,)
    history_xyz_mm: Ring  # (ticks, N, 3), NaN where a cell was not measured
    board: Board = field(default_factory=Board)
    tick: int = 0
    time_ns: int = 0
    mode: FlightMode = FlightMode.INIT  # by protect
    causes: Cause = NOTHING  # what the tasks found; protect takes them
    begun: bool = False  # by search: the tracker has just been told where the cells are
    measured: bool = False  # by feature: this tick's pair was measured
    matched: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))  # (N,) by match
    estimate: Estimate | None = None  # by identify: the newest one delivered
    new_estimate: bool = False
    shown: Estimate | None = None  # the one on the board: the newest, or by protect the last good one
    held: bool = False  # by protect: the board shows an older estimate than the newest one
    _events: deque[EventRecord] = field(default_factory=deque)
    _event_count: int = 0
    _suppressed: int = 0

    def begin(self, tick: int, time_ns: int) -> None:
        """Start a tick: what the frame tasks find belongs to this trigger."""
        self.tick, self.time_ns = tick, time_ns
        self.measured = False

    def clear_history(self) -> None:
        """Forget the displacements: what comes now does not belong to them."""
        count = len(self.history_time_ns)
        self.history_time_ns.clear()
        self.history_xyz_mm.clear()
        if count:
            self.raise_event(HISTORY_CLEARED, count)

    def raise_event(self, event: Event, *arguments: float) -> None:
        """Queue an event for publish; if the queue is full it is counted as suppressed."""
        self._event_count += 1
        if len(self._events) >= EVENT_QUEUE:
            self._suppressed += 1
        else:
            record = EventRecord(event.number, self.tick, self.time_ns, self._event_count, arguments)
            self._events.append(record)
        self.board.set(EVENT_COUNT, self._event_count)
        self.board.set(EVENTS_SUPPRESSED, self._suppressed)

    def take_events(self) -> Iterator[EventRecord]:
        """The queued events, oldest first; the queue is empty afterwards."""
        while self._events:
            yield self._events.popleft()
