"""What the tasks share: one place, taken once. Each part has one task that writes it."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fault.modes import Cause
from fsw.memory.displacements import Displacements
from fsw.memory.ring import Ring
from fsw.modal.result import ModalResult, Mode
from fsw.tasks.event_queue import EventQueue
from fsw.vision.tracking import Tracker
from telemetry.board import Board, EventRecord
from telemetry.declaration import Event
from telemetry.dictionary import EVENT_COUNT, EVENTS_SUPPRESSED, FlightMode
from telemetry.events import HISTORY_CLEARED

NOTHING = Cause(0)


@dataclass
class Pair:
    """The pair of this tick, by acquire. usable: both eyes exposed by this trigger, and fit to measure."""

    left: NDArray[Any]
    right: NDArray[Any]
    usable: bool = False


@dataclass
class Estimate:
    """A delivered identification: the result, the cells (K,) whose x, y, z were its channels, its newest frame.

    slots: of each of its modes; a mode keeps its slot from one estimate to the next.
    """

    result: ModalResult
    cells: NDArray[np.int64]
    tick: int
    time_ns: int
    slots: tuple[int, ...]

    def in_slot(self, slot: int) -> Mode | None:
        """The mode in a slot; None if that is empty."""
        return self.result.modes[self.slots.index(slot)] if slot in self.slots else None


@dataclass
class State:
    """The blackboard of the frame tasks."""

    tracker: Tracker
    pair: Pair
    history_time_ns: Ring  # (ticks,)
    history_mm: Displacements  # (ticks, N, 3), NaN where a cell was not measured
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
    events: EventQueue = field(default_factory=lambda: EventQueue(20, 5))

    def begin(self, tick: int, time_ns: int) -> None:
        """Start a tick: what the frame tasks find belongs to this trigger."""
        self.tick, self.time_ns = tick, time_ns
        self.measured = self.pair.usable = False

    def clear_history(self) -> None:
        """Forget the displacements: what comes now does not belong to them."""
        count = len(self.history_time_ns)
        self.history_time_ns.clear()
        self.history_mm.clear()
        if count:
            self.raise_event(HISTORY_CLEARED, count)

    def raise_event(self, event: Event, *arguments: float) -> None:
        """Queue an event of this tick for publish; see EventQueue for what becomes of too many."""
        self.events.raise_event(event, self.tick, self.time_ns, arguments)
        self._count_events()

    def take_events(self) -> Iterator[EventRecord]:
        """The events that wait, oldest first."""
        yield from self.events.take(self.tick, self.time_ns)
        self._count_events()

    def _count_events(self) -> None:
        self.board.set(EVENT_COUNT, self.events.raised)
        self.board.set(EVENTS_SUPPRESSED, self.events.suppressed)
