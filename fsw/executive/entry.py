"""What the executive runs: the two kinds of tasks, and a task at run time with its row, counters and worker thread."""

import queue
import threading
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from fsw.executive.schedule import Slot
from fsw.executive.timing import Timing
from hal.clock import Clock


@runtime_checkable
class FrameTask(Protocol):
    """A task that runs within its tick."""

    name: str

    def init(self) -> None:
        """Take all memory, before the first tick."""
        ...

    def run(self, tick: int, time_ns: int) -> None:
        """Do this tick's work."""
        ...


@runtime_checkable
class LongTask(Protocol):
    """A task that works beside the ticks; its result appears at a fixed later tick (logical execution time)."""

    name: str

    def init(self) -> None:
        """Take all memory, before the first tick."""
        ...

    def take(self, tick: int) -> bool | None:
        """On the tick thread: set the inputs aside. False: there is nothing to work on this time."""
        ...

    def work(self) -> None:
        """On the worker thread: touch only what `take` set aside, and the task's own memory."""
        ...

    def deliver(self, tick: int) -> None:
        """On the tick thread, at the delivery tick: make the result visible."""
        ...


class Unscheduled(NamedTuple):
    """The row of a task that is there but has no row in the schedule."""

    task: str
    period_ticks: int = 1
    phase_ticks: int = 0
    latency_ticks: int = 0
    budget_ms: float = 0.0
    criticality: str = "optional"


class TaskCounts(NamedTuple):
    """Of one task: runs, runs not done in their slot, late results discarded, releases that never ran."""

    runs: int
    overruns: int
    discarded: int
    lost: int


class Diagnostics(NamedTuple):
    """Of one task, for the ground; times in ms, NaN before the first run; bins: see Timing."""

    runs: int
    overruns: int
    over_budget: int
    lost: int
    last_ms: float
    min_ms: float
    max_ms: float
    mean_ms: float
    deviation_ms: float
    jitter_ms: float
    bins: tuple[int, ...]
    jitter_bins: tuple[int, ...]


class Entry:
    """One task at run time.

    Health writes a challenge; a run that is done writes it back as the answer, and counts progress. enabled: by
    command. failed: it raised an exception, and is not released again.
    """

    def __init__(self, slot: Slot, task: FrameTask | LongTask, clock: Clock, period_ns: int) -> None:
        self.init = task.init
        self.long = task if isinstance(task, LongTask) else None
        self.frame = task if self.long is None and isinstance(task, FrameTask) else None
        self.cpu, self.wall, self.jitter = Timing(0.0), Timing(0.0), Timing(period_ns * 1e-6)
        self.assign(slot)
        self.runs = self.overruns = self.discarded = self.lost = 0
        self.challenge = self.answer = self.progress = 0
        self.enabled, self.failed = True, False
        self.due_tick: int | None = None  # where the result of the work under way is to appear
        self.late = False  # work is under way whose tick has passed
        self.done = threading.Event()  # no work is under way
        self.done.set()
        self.error: BaseException | None = None
        self.spent_cpu_ns = self.spent_wall_ns = 0
        self.jobs: queue.Queue[bool] = queue.Queue(maxsize=2)  # one job under way at most, and the word to end
        self._thread: threading.Thread | None = None
        self._clock = clock

    def assign(self, slot: Slot) -> None:
        """Give it this row; times are counted anew if the budget, which the bins divide, is another one.

        Raises ValueError for a latency of a task that cannot work beside the ticks.
        """
        if slot.latency_ticks > 0 and self.long is None:
            raise ValueError(f"task {slot.task} has no take, work and deliver for its latency")
        self.slot = slot
        for timing in (self.cpu, self.wall):
            timing.set_budget(slot.budget_ms)

    @property
    def busy(self) -> bool:
        """Its memory is in use by work under way."""
        return self.late or self.due_tick is not None

    def measure(self, call: Callable[[], bool | None]) -> bool | None:
        """Call, and add what it took to what this run has spent so far."""
        cpu_ns, wall_ns = self._clock.thread_cpu_ns(), self._clock.wall_ns()
        try:
            return call()
        finally:
            self.spent_cpu_ns += self._clock.thread_cpu_ns() - cpu_ns
            self.spent_wall_ns += self._clock.wall_ns() - wall_ns

    def respond(self) -> None:
        """Prove progress: a run is done, or there was nothing to do."""
        self.answer = self.challenge
        self.progress += 1

    def book(self) -> None:
        """Count one whole run."""
        self.runs += 1
        self.cpu.add(self.spent_cpu_ns)
        self.wall.add(self.spent_wall_ns)
        self.forget()
        self.respond()

    def forget(self) -> None:
        """Nothing is spent yet by the next run."""
        self.spent_cpu_ns = self.spent_wall_ns = 0

    def raise_error(self) -> None:
        """Raise what the work raised, once."""
        error, self.error = self.error, None
        if error is not None:
            raise error

    def reset(self) -> None:
        """Count from 0 again: statistics and counters; what is under way goes on."""
        self.runs = self.overruns = self.discarded = self.lost = 0
        for timing in (self.cpu, self.wall, self.jitter):
            timing.reset()

    def diagnostics(self) -> Diagnostics:
        """What is to be known about its timing."""
        cpu, jitter = self.cpu.summary(), self.jitter.summary()
        return Diagnostics(
            self.runs,
            self.overruns,
            cpu.over_budget,
            self.lost,
            *cpu[1:6],
            jitter.max_ms,
            cpu.histogram,
            jitter.histogram,
        )

    def begin_work(self, due_tick: int) -> None:
        """Hand the inputs that were taken to the worker thread."""
        self.due_tick = due_tick
        self.done.clear()
        self.jobs.put(True)

    def start(self) -> None:
        """Start the worker thread of a long task."""
        if self.long is not None:
            self._thread = threading.Thread(target=self._work, name=f"worker-{self.slot.task}", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Tell the worker to end when it is done with what it has begun."""
        if self._thread is not None:
            self.jobs.put(False)

    def join(self, seconds: float) -> None:
        """Wait so long for the worker to end; one that hangs is left behind, for it touches only its own memory."""
        if self._thread is not None:
            self._thread.join(seconds)
            self._thread = None

    def _work(self) -> None:
        while self.jobs.get():
            try:
                assert self.long is not None
                self.measure(self.long.work)
            except BaseException as error:  # looked at on the tick thread
                self.error = error
            self.done.set()
