"""The tick loop: deliver what is due, then run each task that the schedule releases, in the table's order.

A deterministic cyclic executive with detected and bounded overruns; it promises no hard real time.
"""

from collections.abc import Callable, Mapping, Sequence

from fsw.executive.dispatch import Dispatch, look_if_done, raise_failure, wait_until_done
from fsw.executive.entry import Diagnostics, Entry, FrameTask, LongTask, TaskCounts, Unscheduled
from fsw.executive.schedule import Slot, hyperperiod, releases
from fsw.executive.timing import Timing
from hal.clock import Clock
from hal.trigger import Edge, Trigger

CLOSE_S = 2.0
"""How long to wait for workers at the end; one that hangs must not hold up a restart."""


class Executive:
    """Runs tasks tick by tick until the trigger ends.

    lockstep: wait at the delivery tick for a long task that is not done. Otherwise that is an overrun: counted,
    and its result is discarded when it comes. Either way results appear at the same ticks, at any speed. patience:
    the same choice as a function, True when the work is done. begin: told each tick and its time before anything
    runs. period_ns: length of a tick. catch_up_ticks: whole periods that a tick may be late and still run; later ones
    are skipped. on_overrun: told the task that was not done in its slot, and by how many ns, in the same tick.
    on_failure: told the task that raised an exception, and the exception; the task is not released again. An
    InputError, of a file that cannot be read, ends the run as without on_failure every exception does.
    Raises KeyError for a task that is not there, ValueError for a latency that a task cannot have.
    """

    def __init__(
        self,
        schedule: Sequence[Slot],
        tasks: Mapping[str, FrameTask | LongTask],
        trigger: Trigger,
        clock: Clock,
        period_ns: int,
        lockstep: bool = True,
        begin: Callable[[int, int], None] = lambda tick, time_ns: None,
        *,
        patience: Callable[[Entry], bool] | None = None,
        catch_up_ticks: int = 2,
        on_overrun: Callable[[str, int], None] = lambda task, late_ns: None,
        on_failure: Callable[[str, BaseException], None] = raise_failure,
    ) -> None:
        # All tasks are made ready, so that a later schedule may take in those that this one leaves out.
        self._entries = {name: Entry(Unscheduled(name), task, clock, period_ns) for name, task in tasks.items()}
        self._trigger, self._clock, self._period_ns, self._begin = trigger, clock, period_ns, begin
        self._catch_up_ticks = catch_up_ticks
        patience = patience or (wait_until_done if lockstep else look_if_done)
        self._dispatch = Dispatch(clock, period_ns, patience, on_overrun, on_failure)
        self.tick = -1
        self.ticks = self.missed_ticks = self.skipped_ticks = self.repeated_edges = 0
        self.release_jitter = Timing(period_ns * 1e-6)
        self.apply(schedule)

    def apply(self, schedule: Sequence[Slot]) -> None:
        """From the next tick on, release by this schedule, which was checked; work under way ends as it was planned.

        Statistics go on where the budget stays. Raises KeyError, ValueError as the constructor.
        """
        scheduled = tuple(self._entries[slot.task] for slot in schedule)
        for entry, slot in zip(scheduled, schedule, strict=True):
            entry.assign(slot)
        self.scheduled = scheduled
        self._hyperperiod = hyperperiod(schedule)

    def hyperperiod_ends(self, tick: int) -> bool:
        """The schedule begins again after this tick."""
        return (tick + 1) % self._hyperperiod == 0

    def switch(self, task: str, on: bool) -> bool:
        """Release a task again, even one that failed, or no longer; False if the schedule has no such task."""
        entry = next((entry for entry in self.scheduled if entry.slot.task == task), None)
        if entry is None:
            return False
        entry.enabled = on
        entry.failed = entry.failed and not on
        return True

    def init(self) -> None:
        """Initialise the tasks, scheduled ones first in their order, and start a worker thread for each long one."""
        entries = tuple(dict.fromkeys((*self.scheduled, *self._entries.values())))
        for entry in entries:
            entry.init()
        for entry in entries:
            entry.start()

    def prepare(self, task: str) -> None:
        """Initialise one task alone, which is then not run."""
        self._entries[task].init()

    def step(self) -> bool:
        """Wait for the next edge and run its tick; False when the trigger has ended."""
        edge = self._next_edge()
        if edge is None:
            return False
        if edge.tick <= self.tick:
            self.repeated_edges += 1
            return True
        self._advance(edge.tick)
        self.ticks += 1
        self.release_jitter.add(self._since(edge))
        self._dispatch.begin(edge)
        self._begin(edge.tick, edge.time_ns)
        for entry in self._entries.values():
            self._dispatch.deliver_if_due(entry)
        for entry in self.scheduled:
            if entry.enabled and releases(entry.slot, edge.tick, edge.tick):
                self._dispatch.release(entry)
        return True

    def run(self) -> None:
        """Initialise, run to the end of the trigger, and close."""
        try:
            self.init()
            while self.step():
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Let the workers end what they have begun, for a while; a result whose tick never came is not delivered."""
        for entry in self._entries.values():
            entry.end()
        end_ns = self._clock.wall_ns() + round(CLOSE_S * 1e9)
        for entry in self._entries.values():
            entry.join(max(0, end_ns - self._clock.wall_ns()) * 1e-9)

    def reset(self) -> None:
        """Count from 0 again; `tick` and `ticks`, which number the ticks, go on."""
        self.missed_ticks = self.skipped_ticks = self.repeated_edges = 0
        self.release_jitter.reset()
        for entry in self._entries.values():
            entry.reset()

    @property
    def overruns(self) -> int:
        """Runs of tasks that were not done in their slot: at their delivery, or at the end of their tick."""
        return sum(entry.overruns for entry in self._entries.values())

    @property
    def lost(self) -> int:
        """Releases that never ran: edge missed, tick skipped, task busy or failed."""
        return sum(entry.lost for entry in self._entries.values())

    @property
    def tasks(self) -> tuple[str, ...]:
        """Names of the scheduled tasks, in the order in which they run."""
        return tuple(entry.slot.task for entry in self.scheduled)

    def timing(self, task: str) -> tuple[Timing, Timing]:
        """Thread-CPU time and wall time of a task's runs."""
        return self._entries[task].cpu, self._entries[task].wall

    def counts(self, task: str) -> TaskCounts:
        """What happened to a task so far."""
        entry = self._entries[task]
        return TaskCounts(entry.runs, entry.overruns, entry.discarded, entry.lost)

    def diagnostics(self, task: str) -> Diagnostics:
        """Timing of a task, for the ground."""
        return self._entries[task].diagnostics()

    def _next_edge(self) -> Edge | None:
        """The next edge that is not too late to run; those before it are skipped."""
        edge = self._trigger.wait()
        if edge is None:
            return None
        for _ in range(self._since(edge) // self._period_ns - self._catch_up_ticks):
            if self._since(edge) // self._period_ns <= self._catch_up_ticks:
                break
            if edge.tick > self.tick:
                self._advance(edge.tick)
                self.skipped_ticks += 1
                self._lose(edge.tick, edge.tick)
            edge = self._trigger.wait()
            if edge is None:
                return None
        return edge

    def _since(self, edge: Edge) -> int:
        return max(0, self._clock.now_ns() - edge.time_ns)

    def _advance(self, tick: int) -> None:
        """Go on to this tick; count edges that never came."""
        self.missed_ticks += tick - self.tick - 1
        self._lose(self.tick + 1, tick - 1)
        self.tick = tick

    def _lose(self, first: int, last: int) -> None:
        """Count the releases of these ticks, which nobody will run."""
        for entry in self.scheduled:
            if entry.enabled:
                entry.lost += releases(entry.slot, first, last)
