"""Parts for tests of the executive: lines of edges, and tasks that write down when they ran."""

import threading
from collections.abc import Iterable, Sequence
from typing import Any

from fsw.executive.entry import FrameTask, LongTask
from fsw.executive.executive import Executive
from fsw.tables.flight import TaskSlot
from hal.clock import Clock
from hal.drivers.lockstep_clock import LockstepClock
from hal.trigger import Edge

PERIOD_NS = 1_000_000
WAIT_S = 10.0


class Line:
    """A trigger with edges at given times of a clock, numbered from 0 if they have no number."""

    def __init__(self, clock: Clock, times_ns: Iterable[int], ticks: Sequence[int] | None = None) -> None:
        self._clock, self._times_ns, self._ticks, self._next = clock, list(times_ns), ticks, 0

    @property
    def ended(self) -> bool:
        return self._next == len(self._times_ns)

    def wait(self, until_ns: int | None = None) -> Edge | None:
        if self.ended:
            return None
        time_ns = self._times_ns[self._next]
        if until_ns is not None and time_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self._clock.sleep_until_ns(time_ns)
        self._next += 1
        return Edge(self._next - 1 if self._ticks is None else self._ticks[self._next - 1], time_ns)


class Edges(Line):
    """A trigger with given tick numbers, each at its time."""

    def __init__(self, ticks: Iterable[int], clock: Clock | None = None) -> None:
        numbers = list(ticks)
        super().__init__(clock or LockstepClock(), [tick * PERIOD_NS for tick in numbers], numbers)


class JumpingClock(LockstepClock):
    """At a moment its mission time jumps, forward or back. `mission` is the time shown at a true moment."""

    def __init__(self, at_ns: int, jump_ns: int) -> None:
        super().__init__()
        self._at_ns, self._jump_ns = at_ns, jump_ns

    def mission(self, true_ns: int) -> int:
        return true_ns + (self._jump_ns if true_ns >= self._at_ns else 0)

    def now_ns(self) -> int:
        return self.mission(super().now_ns())

    def sleep_until_ns(self, time_ns: int) -> None:
        before = super().now_ns() < self._at_ns and time_ns < self._at_ns
        super().sleep_until_ns(time_ns if before else max(self._at_ns, time_ns - self._jump_ns))


class Frame:
    def __init__(self, name: str, log: list[tuple[str, int]]) -> None:
        self.name, self.log = name, log

    def init(self) -> None:
        self.log.append((f"{self.name}.init", -1))

    def run(self, tick: int, time_ns: int) -> None:
        assert time_ns == tick * PERIOD_NS
        self.log.append((self.name, tick))


class Busy:
    """A frame task that takes so much mission time at some ticks, or at all of them."""

    def __init__(self, name: str, clock: Clock, takes_ns: dict[int, int], otherwise_ns: int = 0) -> None:
        self.name, self._clock, self._takes_ns, self._otherwise_ns = name, clock, takes_ns, otherwise_ns
        self.ticks: list[int] = []

    def init(self) -> None: ...

    def run(self, tick: int, time_ns: int) -> None:
        self.ticks.append(tick)
        self._clock.sleep_until_ns(self._clock.now_ns() + self._takes_ns.get(tick, self._otherwise_ns))


class Long:
    """A long task; `hold` keeps its work from ending, `idle` ticks have nothing to do."""

    def __init__(self, name: str, log: list[tuple[str, int]], idle: Iterable[int] = ()) -> None:
        self.name, self.log, self.idle = name, log, set(idle)
        self.hold = threading.Event()
        self.hold.set()
        self.worked: list[tuple[int, str]] = []
        self.taken = self.result = -1

    def init(self) -> None:
        self.log.append((f"{self.name}.init", -1))

    def take(self, tick: int) -> bool | None:
        if tick in self.idle:
            return False
        self.taken = tick
        self.log.append((f"{self.name}.take", tick))
        return None

    def work(self) -> None:
        assert self.hold.wait(WAIT_S)
        self.result = self.taken
        self.worked.append((self.taken, threading.current_thread().name))

    def deliver(self, tick: int) -> None:
        self.log.append((f"{self.name}.deliver {self.result}", tick))


def slot(task: str, period: int = 1, phase: int = 0, latency: int = 0, budget_ms: float = 1.0) -> TaskSlot:
    return TaskSlot(task, budget_ms, period, phase, latency)


def fly(
    slots: Sequence[TaskSlot],
    tasks: Sequence[FrameTask | LongTask],
    ticks: Iterable[int],
    lockstep: bool = True,
    clock: LockstepClock | None = None,
    **options: Any,
) -> Executive:
    """An executive of these tasks, at real edges if it is given a clock; options: see Executive."""
    by_name = {task.name: task for task in tasks}
    trigger = Edges(ticks, clock)
    return Executive(slots, by_name, trigger, clock or LockstepClock(), PERIOD_NS, lockstep, **options)
