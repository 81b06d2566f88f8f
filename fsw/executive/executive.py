"""The tick loop: deliver what is due, then run each task that the schedule releases, in the table's order.

A deterministic cyclic executive with detected and bounded overruns; it promises no hard real time.
"""

from collections.abc import Callable, Mapping, Sequence

from fsw.executive.entry import Entry, FrameTask, LongTask, TaskCounts
from fsw.executive.schedule import Slot, releases
from fsw.executive.timing import Timing
from hal.clock import Clock
from hal.trigger import Edge, Trigger


class Executive:
    """Runs tasks tick by tick until the trigger ends.

    lockstep: wait at the delivery tick for a long task that is not done. Otherwise that is an overrun: counted,
    and its result is discarded when it comes. Either way results appear at the same ticks, at any speed.
    begin: told each tick and its time before anything runs. period_ns: length of a tick, to count ticks that took
    longer. Raises KeyError for a task that is not there.
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
    ) -> None:
        self._entries = {slot.task: Entry(slot, tasks[slot.task], clock) for slot in schedule}
        self._trigger, self._clock, self._lockstep = trigger, clock, lockstep
        self._period_ns, self._begin = period_ns, begin
        self.tick = -1
        self.ticks = self.missed_ticks = self.repeated_edges = self.tick_overruns = 0
        self.release_jitter = Timing(period_ns * 1e-6)

    @property
    def overruns(self) -> int:
        """Long tasks not done at their delivery, and ticks that took longer than a period."""
        return self.tick_overruns + sum(entry.overruns for entry in self._entries.values())

    def init(self) -> None:
        """Initialise the tasks in the order of the schedule, and start a worker thread for each long one."""
        for entry in self._entries.values():
            entry.init()
        for entry in self._entries.values():
            if entry.slot.latency_ticks > 0:
                entry.start()

    def step(self) -> bool:
        """Wait for the next edge and run its tick; False when the trigger has ended."""
        edge = self._trigger.wait()
        if edge is None:
            return False
        if edge.tick <= self.tick:
            self.repeated_edges += 1
            return True
        self._count_gap(edge.tick)
        self.tick = edge.tick
        self.ticks += 1
        self.release_jitter.add(max(0, self._clock.now_ns() - edge.time_ns))
        self._begin(edge.tick, edge.time_ns)
        for entry in self._entries.values():
            self._deliver_if_due(entry, edge.tick)
        for entry in self._entries.values():
            if releases(entry.slot, edge.tick, edge.tick):
                self._release(entry, edge)
        self.tick_overruns += self._clock.now_ns() - edge.time_ns > self._period_ns
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
        """Let the workers end what they have begun; a result whose tick never came is not delivered."""
        for entry in self._entries.values():
            entry.stop()

    @property
    def tasks(self) -> tuple[str, ...]:
        """Names of the scheduled tasks, in the order in which they run."""
        return tuple(self._entries)

    def timing(self, task: str) -> tuple[Timing, Timing]:
        """Thread-CPU time and wall time of a task's runs."""
        return self._entries[task].cpu, self._entries[task].wall

    def counts(self, task: str) -> TaskCounts:
        """What happened to a task so far."""
        entry = self._entries[task]
        return TaskCounts(entry.runs, entry.overruns, entry.discarded, entry.lost)

    def _count_gap(self, tick: int) -> None:
        """Count edges that never came, and the releases that were lost with them."""
        gap = tick - self.tick - 1
        if gap > 0:
            self.missed_ticks += gap
            for entry in self._entries.values():
                entry.lost += releases(entry.slot, self.tick + 1, tick - 1)

    def _release(self, entry: Entry, edge: Edge) -> None:
        frame, task = entry.frame, entry.long
        if frame is not None:
            entry.measure(lambda: frame.run(edge.tick, edge.time_ns))
            self._book(entry)
        if task is None:
            return
        if entry.late:  # its memory is still in use
            entry.lost += 1
            return
        if entry.measure(lambda: task.take(edge.tick)) is False:
            self._forget(entry)
        elif entry.slot.latency_ticks == 0:
            entry.measure(task.work)
            entry.measure(lambda: task.deliver(edge.tick))
            self._book(entry)
        else:
            entry.due_tick = edge.tick + entry.slot.latency_ticks
            entry.done.clear()
            entry.jobs.put(True)

    def _deliver_if_due(self, entry: Entry, tick: int) -> None:
        if entry.late and entry.done.is_set():
            entry.late = False
            entry.discarded += 1
            self._book(entry)
        if entry.due_tick is None or tick < entry.due_tick:
            return
        entry.due_tick = None
        if self._lockstep:
            entry.done.wait()
        if not entry.done.is_set():
            entry.overruns += 1
            entry.late = True
            return
        task = entry.long
        if task is not None and entry.error is None:
            entry.measure(lambda: task.deliver(tick))
        self._book(entry)

    def _book(self, entry: Entry) -> None:
        """Count one whole run, on the tick thread."""
        if entry.error is not None:
            raise entry.error
        entry.runs += 1
        entry.cpu.add(entry.spent_cpu_ns)
        entry.wall.add(entry.spent_wall_ns)
        self._forget(entry)

    @staticmethod
    def _forget(entry: Entry) -> None:
        entry.spent_cpu_ns = entry.spent_wall_ns = 0
