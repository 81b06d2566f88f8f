"""What the executive and the trigger found, as points and events: overruns, failures, edges that were no ticks."""

from collections.abc import Callable
from typing import Protocol

from fsw.executive.lock import TriggerLock
from fsw.tasks.state import State
from telemetry.dictionary import (
    CLOCK_JUMPS,
    EDGES_DOUBLE,
    EDGES_EARLY,
    EDGES_LATE,
    FREE_WHEEL,
    OVERRUN,
    OVERRUNS,
    SLOTS_LOST,
    TICKS_MISSED,
)
from telemetry.events import OVERRUN as TASK_OVERRUN
from telemetry.events import SLOTS_SKIPPED, TASK_FAILED, TRIGGER_GAP, TaskNumber

MOST_FAILURES = 8  # exceptions that are kept for people; the events tell of all


class Counted(Protocol):
    """What the executive counts."""

    missed_ticks: int
    skipped_ticks: int

    @property
    def overruns(self) -> int: ...
    @property
    def lost(self) -> int: ...


class Lateness:
    """Told by the executive in the slot in which it happens; shown on the board when the next tick begins."""

    def __init__(self, state: State, executive: Callable[[], Counted], lock: TriggerLock | None) -> None:
        """executive: called at each tick, for it is made after this. lock: None for a trigger that is established."""
        self._state, self._executive, self._lock = state, executive, lock
        self._missed = self._skipped = self._rephased = 0
        self.failures: list[tuple[str, BaseException]] = []

    def init(self) -> None:
        """Nothing was late yet, and the trigger is trusted."""
        counters = (TICKS_MISSED, OVERRUNS, OVERRUN, SLOTS_LOST, FREE_WHEEL)
        for point in (*counters, EDGES_EARLY, EDGES_LATE, EDGES_DOUBLE, CLOCK_JUMPS):
            self._state.board.set(point, 0)

    def overrun(self, task: str, late_ns: int) -> None:
        """A task was not done in its slot."""
        self._state.board.set(OVERRUN, 1)
        self._state.raise_event(TASK_OVERRUN, TaskNumber[task.upper()], late_ns * 1e-6)

    def failure(self, task: str, error: BaseException) -> None:
        """A task raised an exception."""
        self._state.raise_event(TASK_FAILED, TaskNumber[task.upper()])
        if len(self.failures) < MOST_FAILURES:
            self.failures.append((task, error))

    def tell(self) -> None:
        """A tick begins: tell what the trigger did, and show the counters."""
        state, executive = self._state, self._executive()
        if executive.missed_ticks > self._missed:
            state.raise_event(TRIGGER_GAP, executive.missed_ticks - self._missed)
        if executive.skipped_ticks > self._skipped:
            state.raise_event(SLOTS_SKIPPED, executive.skipped_ticks - self._skipped)
        self._missed, self._skipped = executive.missed_ticks, executive.skipped_ticks
        state.board.set(TICKS_MISSED, executive.missed_ticks)
        state.board.set(OVERRUNS, executive.overruns)
        state.board.set(SLOTS_LOST, executive.lost)
        if self._lock is not None:
            self._follow(self._lock)

    def _follow(self, lock: TriggerLock) -> None:
        state, phase = self._state, lock.phase
        for event, arguments in lock.notices():
            state.raise_event(event, *arguments)
        counts = ((FREE_WHEEL, phase.free), (EDGES_EARLY, phase.early), (EDGES_LATE, phase.late))
        for point, value in (*counts, (EDGES_DOUBLE, phase.double), (CLOCK_JUMPS, phase.jumps)):
            state.board.set(point, value)
        if phase.rephased != self._rephased:  # times before and after do not belong together
            self._rephased = phase.rephased
            state.clear_history()
