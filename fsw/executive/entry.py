"""What the executive runs: the two kinds of tasks, and one row of the schedule at run time with its worker thread."""

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


class TaskCounts(NamedTuple):
    """Of one task: runs, overruns at delivery, late results discarded, releases lost (edge missed or busy)."""

    runs: int
    overruns: int
    discarded: int
    lost: int


class Entry:
    """One row of the schedule at run time."""

    def __init__(self, slot: Slot, task: FrameTask | LongTask, clock: Clock) -> None:
        self.slot, self.init = slot, task.init
        self.long = task if isinstance(task, LongTask) else None
        self.frame = task if self.long is None and isinstance(task, FrameTask) else None
        if self.long is None and (self.frame is None or slot.latency_ticks > 0):
            raise ValueError(f"task {slot.task} has no take, work and deliver for its latency")
        self.cpu, self.wall = Timing(slot.budget_ms), Timing(slot.budget_ms)
        self.runs = self.overruns = self.discarded = self.lost = 0
        self.due_tick: int | None = None  # where the result of the work under way is to appear
        self.late = False  # work is under way whose tick has passed
        self.done = threading.Event()  # no work is under way
        self.done.set()
        self.error: BaseException | None = None
        self.spent_cpu_ns = self.spent_wall_ns = 0
        self.jobs: queue.Queue[bool] = queue.Queue(maxsize=2)  # one job under way at most, and the word to end
        self._thread: threading.Thread | None = None
        self._clock = clock

    def measure(self, call: Callable[[], bool | None]) -> bool | None:
        """Call, and add what it took to what this run has spent so far."""
        cpu_ns, wall_ns = self._clock.thread_cpu_ns(), self._clock.wall_ns()
        result = call()
        self.spent_cpu_ns += self._clock.thread_cpu_ns() - cpu_ns
        self.spent_wall_ns += self._clock.wall_ns() - wall_ns
        return result

    def start(self) -> None:
        """Start the worker thread of a long task."""
        self._thread = threading.Thread(target=self._work, name=f"worker-{self.slot.task}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Let the worker end what it has begun."""
        if self._thread is not None:
            self.jobs.put(False)
            self._thread.join()
            self._thread = None

    def _work(self) -> None:
        while self.jobs.get():
            try:
                assert self.long is not None
                self.measure(self.long.work)
            except BaseException as error:  # raised again on the tick thread, where somebody listens
                self.error = error
            self.done.set()
