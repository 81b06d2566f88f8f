"""One tick's dispatch: what a release and a delivery do to a task, and what becomes of it when it is late or fails."""

from collections.abc import Callable

from fsw.executive.entry import Entry
from hal.clock import Clock
from hal.trigger import Edge
from wingbeat.errors import InputError


def wait_until_done(entry: Entry) -> bool:
    """Patience in lockstep: however long it takes."""
    return entry.done.wait()


def look_if_done(entry: Entry) -> bool:
    """Patience at real pace: none."""
    return entry.done.is_set()


def raise_failure(task: str, error: BaseException) -> None:
    """Nobody is there to go on without the task."""
    raise error


class Dispatch:
    """Releases tasks and delivers their results in a tick. The arguments are those of Executive."""

    def __init__(
        self,
        clock: Clock,
        period_ns: int,
        patience: Callable[[Entry], bool],
        on_overrun: Callable[[str, int], None],
        on_failure: Callable[[str, BaseException], None],
    ) -> None:
        self._clock, self._period_ns, self._patience = clock, period_ns, patience
        self._on_overrun, self._on_failure = on_overrun, on_failure
        self._edge = Edge(-1, 0)
        self._in_slot = True  # no task of this tick has crossed its end yet

    def begin(self, edge: Edge) -> None:
        """A tick begins."""
        self._edge, self._in_slot = edge, True

    def release(self, entry: Entry) -> None:
        """Run the task, or take its inputs; lost if it is busy or has failed."""
        if entry.failed or entry.busy:
            entry.lost += 1
            return
        entry.jitter.add(max(0, self._late_ns()))
        self._guarded(entry, self._run)
        self._watch_slot(entry)

    def deliver_if_due(self, entry: Entry) -> None:
        """Make the result visible whose tick this is, and discard one that comes after its tick."""
        if entry.late and self._patience(entry):
            entry.late = False
            entry.discarded += 1
            self._guarded(entry, self._discard)
        if entry.due_tick is None or self._edge.tick < entry.due_tick:
            return
        entry.due_tick = None
        if self._patience(entry):
            self._guarded(entry, self._deliver)
            self._watch_slot(entry)
        else:
            entry.overruns += 1
            entry.late = True
            self._on_overrun(entry.slot.task, max(0, self._late_ns()))

    def _run(self, entry: Entry) -> None:
        tick, time_ns = self._edge.tick, self._edge.time_ns
        frame, task = entry.frame, entry.long
        if frame is not None:
            entry.measure(lambda: frame.run(tick, time_ns))
            entry.book()
        elif task is not None:
            if entry.measure(lambda: task.take(tick)) is False:
                entry.forget()
                entry.respond()
            elif entry.slot.latency_ticks == 0:
                entry.measure(task.work)
                entry.measure(lambda: task.deliver(tick))
                entry.book()
            else:
                entry.begin_work(tick + entry.slot.latency_ticks)

    def _deliver(self, entry: Entry) -> None:
        task = entry.long
        entry.raise_error()
        if task is not None:
            entry.measure(lambda: task.deliver(self._edge.tick))
        entry.book()

    def _discard(self, entry: Entry) -> None:
        entry.raise_error()
        entry.book()

    def _guarded(self, entry: Entry, call: Callable[[Entry], None]) -> None:
        """A task that raises is out; an input file that cannot be read, or the user's interrupt, ends the run."""
        try:
            call(entry)
        except InputError:
            raise
        except Exception as error:
            entry.failed = True
            entry.forget()
            self._on_failure(entry.slot.task, error)

    def _watch_slot(self, entry: Entry) -> None:
        """The first task that ends after the tick's end was not done in its slot."""
        late_ns = self._late_ns() - self._period_ns
        if self._in_slot and late_ns > 0:
            self._in_slot = False
            entry.overruns += 1
            self._on_overrun(entry.slot.task, late_ns)

    def _late_ns(self) -> int:
        return self._clock.now_ns() - self._edge.time_ns
