"""The trigger as the executive sees it: only edges at their time are ticks, and ticks go on without them."""

from collections.abc import Iterator

from fsw.executive.phase_lock import Notice, PhaseLock
from hal.clock import Clock
from hal.trigger import Edge, Trigger

MOST_EDGES = 64
"""A line with more edges in a period than this is not read on; the period has no good edge."""


class TriggerLock:
    """A trigger made of a raw line of edges: see PhaseLock, whose counters are in `phase`."""

    def __init__(
        self,
        line: Trigger,
        clock: Clock,
        period_ns: int,
        window_share: float,
        free_wheel_after: int,
        lock_after: int,
    ) -> None:
        """window_share: of a period, before and after the time at which an edge is due."""
        self.phase = PhaseLock(period_ns, window_share, free_wheel_after, lock_after)
        self._line, self._clock = line, clock
        self._held: Edge | None = None  # came after the deadline that is still to be decided upon
        self._begun = False

    @property
    def ended(self) -> bool:
        """The line has ended, and with it the ticks."""
        return self._line.ended and self._held is None

    def notices(self) -> Iterator[Notice]:
        """Events and their arguments since the last call."""
        return self.phase.notices()

    def wait(self, until_ns: int | None = None) -> Edge | None:
        """Block until the next tick; None when the line has ended, or at until_ns if no tick came until then."""
        if not self._begun:
            self._begun = True
            self.phase.begin(self._clock.now_ns())
        edges = 0
        while not self.ended:
            deadline_ns = self.phase.deadline_ns
            limit_ns = deadline_ns if until_ns is None else min(until_ns, deadline_ns)
            edge = self._fetch(limit_ns, edges)
            if edge is not None:
                edges += 1
                tick = self.phase.edge(edge.time_ns)
            elif self.ended or limit_ns < deadline_ns:
                return None
            else:
                edges = 0
                tick = self.phase.nothing(self._look())
            if tick is not None:
                return tick
        return None

    def _fetch(self, limit_ns: int, edges: int) -> Edge | None:
        """The next edge until the limit, unless there were too many of them."""
        if edges >= MOST_EDGES:
            self._clock.sleep_until_ns(limit_ns)
            return None
        if self._held is None:
            return self._line.wait(limit_ns)
        if self._held.time_ns > limit_ns:
            return None
        edge, self._held = self._held, None
        return edge

    def _look(self) -> int:
        """How far time is known to have gone without an edge: to the next one, if it waits already, else to now."""
        if self._held is None:
            now_ns = self._clock.now_ns()
            self._held = self._line.wait(now_ns)
            return now_ns if self._held is None else self._held.time_ns
        return self._held.time_ns
