"""Which edges of a trigger line are ticks: a phase lock as a state machine of times, without a clock of its own."""

from collections import deque
from collections.abc import Iterator

from hal.trigger import Edge
from telemetry.declaration import Event
from telemetry.events import (
    CLOCK_JUMP,
    EDGE_DOUBLE,
    EDGE_EARLY,
    EDGE_LATE,
    FREE_WHEELING,
    TRIGGER_LOCKED,
)

Notice = tuple[Event, tuple[float, ...]]

MOST_NOTICES = 16
"""Notices that wait to be taken; further ones are lost, the counters are not."""

JUMP_PERIODS = 4
"""When mission time is this many periods past an edge that did not come, it is the time that is wrong."""

LONG_AGO_NS = 1 << 62


class PhaseLock:
    """Times of edges and of their absence in, ticks out.

    Locked, an edge is a tick within a window round one period after the last good one. After free_wheel_after periods
    in a row without such an edge ticks are made at the times at which edges are due (free), until lock_after edges in
    a row came one period apart; their phase is taken over. Ticks count periods: one that had no good edge is skipped.

    missing: periods without a good edge. early, late, double: edges that were no ticks. jumps: of mission time against
    the trigger. rephased: how often the times of ticks before and after belong to different time lines.
    """

    def __init__(self, period_ns: int, window_share: float, free_wheel_after: int, lock_after: int) -> None:
        self._period_ns, self._window_ns = period_ns, int(window_share * period_ns)
        self._free_wheel_after, self._lock_after = free_wheel_after, lock_after
        self.free = False
        self.missing = self.early = self.late = self.double = self.jumps = self.rephased = 0
        self._tick = -1
        self._due_ns = 0  # time of the next tick
        self._edge_ns: int | None = None  # the latest edge, doubles left out
        self._run = 0  # edges in a row that came one period apart
        self._bad = 0  # periods in a row without a good edge
        self._jumped_from_ns: int | None = None  # mission time jumped; here the edge was due that has not come yet
        self._notices: deque[Notice] = deque(maxlen=MOST_NOTICES)

    def begin(self, now_ns: int) -> None:
        """Before the first edge: whenever it comes within the next periods, it is the first tick."""
        self._due_ns = now_ns + self._free_wheel_after * self._period_ns

    @property
    def deadline_ns(self) -> int:
        """Time at which something is to be decided if no edge came until then."""
        return self._due_ns if self.free else self._due_ns + self._window_ns

    def notices(self) -> Iterator[Notice]:
        """What is to be told, oldest first; taken when read."""
        while self._notices:
            yield self._notices.popleft()

    def edge(self, time_ns: int) -> Edge | None:
        """An edge came, not after the deadline; the tick that it makes, if it does."""
        before_ns = self._edge_ns
        if self._jumped_from_ns is not None:
            return self._start_over(time_ns, time_ns - self._jumped_from_ns)
        if before_ns is None and not self.free:
            return self._good(time_ns)
        since_ns = LONG_AGO_NS if before_ns is None else time_ns - before_ns
        if since_ns < -self._window_ns:
            self.rephased += 1
            return self._start_over(time_ns, time_ns - self._due_ns)
        if not self.free and abs(time_ns - self._due_ns) <= self._window_ns:
            return self._good(time_ns)
        if since_ns <= self._window_ns:
            self.double += 1
            self._tell(EDGE_DOUBLE, since_ns * 1e-3)
            return None
        self._edge_ns = time_ns
        self._run = self._run + 1 if abs(since_ns - self._period_ns) <= self._window_ns else 1
        if self.free:
            return self._relock(time_ns) if self._run >= self._lock_after else None
        self._off(time_ns)
        return None

    def nothing(self, now_ns: int) -> Edge | None:
        """No edge came until the deadline, and it is now_ns; the tick that the clock makes, if it does."""
        if now_ns - self.deadline_ns > JUMP_PERIODS * self._period_ns:
            self._time_jumped(now_ns)
            return None
        if self.free:
            self._jumped_from_ns = None
            return self._make_tick(self._due_ns)
        if self._edge_ns is None:  # there never was a trigger
            self._go_free()
            return None
        self.missing += 1
        self._bad += 1
        self._tick += 1
        self._due_ns += self._period_ns
        if self._bad >= self._free_wheel_after:
            self._go_free()
        return None

    def _good(self, time_ns: int) -> Edge:
        self._edge_ns, self._run, self._bad = time_ns, 1, 0
        return self._make_tick(time_ns)

    def _make_tick(self, time_ns: int) -> Edge:
        self._tick += 1
        self._due_ns = time_ns + self._period_ns
        return Edge(self._tick, time_ns, self.free)

    def _off(self, time_ns: int) -> None:
        """An edge off its time is late for the period before, if that had none, or early for the next."""
        until_due_ns = self._due_ns - time_ns
        if self._bad and 2 * until_due_ns > self._period_ns:
            self.late += 1
            self._tell(EDGE_LATE, (self._period_ns - until_due_ns) * 1e-3)
        else:
            self.early += 1
            self._tell(EDGE_EARLY, -until_due_ns * 1e-3)

    def _go_free(self) -> None:
        if not self.free:
            self.free = True
            self._tell(FREE_WHEELING)

    def _relock(self, time_ns: int) -> Edge | None:
        """Follow the trigger again; this edge is a tick unless the clock has just made the one that it belongs to."""
        off_ns = time_ns - self._due_ns
        made = self._tick >= 0 and 2 * off_ns < -self._period_ns
        if made:
            off_ns += self._period_ns
        if self._tick >= 0 and abs(off_ns) > self._window_ns:
            self.rephased += 1
            self._tell_jump(off_ns)
        self.free = False
        self._tell(TRIGGER_LOCKED)
        self._edge_ns, self._bad = time_ns, 0
        if not made:
            return self._make_tick(time_ns)
        self._due_ns = time_ns + self._period_ns
        return None

    def _time_jumped(self, now_ns: int) -> None:
        """Mission time is far ahead. How far, the next edge will tell; ticks go on from now."""
        self._jumped_from_ns = self._due_ns if self._edge_ns is not None else None
        self.rephased += 1
        self._due_ns = now_ns + self._period_ns
        self._go_free()

    def _start_over(self, time_ns: int, jump_ns: int) -> Edge:
        """Mission time jumped: what came before says nothing, ticks go by this edge until others agree with it."""
        self._tell_jump(jump_ns)
        self._jumped_from_ns = None
        self._go_free()
        self._edge_ns, self._run = time_ns, 1
        return self._make_tick(time_ns)

    def _tell_jump(self, jump_ns: int) -> None:
        self.jumps += 1
        self._tell(CLOCK_JUMP, jump_ns * 1e-6)

    def _tell(self, event: Event, *arguments: float) -> None:
        if len(self._notices) < MOST_NOTICES:
            self._notices.append((event, arguments))
