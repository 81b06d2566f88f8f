"""A trigger line with any edges, and a clock whose mission time may jump: where faults of time are put in."""

from collections.abc import Sequence
from typing import NamedTuple

from hal.clock import Clock
from hal.trigger import Edge


class Exposure(NamedTuple):
    """An edge of the line: the true moment, and the picture that it takes; -1: the cameras are still busy."""

    time_ns: int
    picture: int


class Jump(NamedTuple):
    """At this true moment mission time jumps by so much, forward or back."""

    at_ns: int
    by_ns: int


NO_JUMP = Jump(1 << 62, 0)


class MissionClock:
    """Mission time over an oscillator that runs true."""

    def __init__(self, oscillator: Clock, jump: Jump = NO_JUMP) -> None:
        self.oscillator, self.jump = oscillator, jump

    def mission_ns(self, true_ns: int) -> int:
        """What mission time shows at a true moment."""
        return true_ns + (self.jump.by_ns if true_ns >= self.jump.at_ns else 0)

    def now_ns(self) -> int:
        """Mission time."""
        return self.mission_ns(self.oscillator.now_ns())

    def sleep_until_ns(self, time_ns: int) -> None:
        """Sleep until mission time shows at least this."""
        at_ns, by_ns = self.jump
        before = self.oscillator.now_ns() < at_ns and time_ns < at_ns
        self.oscillator.sleep_until_ns(time_ns if before else max(at_ns, time_ns - by_ns))

    def thread_cpu_ns(self) -> int:
        """Processor time of the calling thread."""
        return self.oscillator.thread_cpu_ns()

    def wall_ns(self) -> int:
        """A steady stopwatch."""
        return self.oscillator.wall_ns()


class EdgeLine:
    """The raw trigger line; an edge waits until it is fetched, and is stamped with mission time.

    tick, time_ns, true_ns: picture, mission time and true moment of the latest exposure; -1 and 0 before the first.
    """

    def __init__(self, edges: Sequence[Exposure], clock: MissionClock) -> None:
        """edges: in order of time."""
        self._edges, self._clock, self._next = edges, clock, 0
        self.tick, self.time_ns, self.true_ns = -1, 0, 0

    @property
    def ended(self) -> bool:
        """There will be no further edge."""
        return self._next == len(self._edges)

    def wait(self, until_ns: int | None = None) -> Edge | None:
        """Block until the next edge and return it; None at the line's end, or at until_ns if it comes later."""
        if self.ended:
            return None
        edge = self._edges[self._next]
        time_ns = self._clock.mission_ns(edge.time_ns)
        if until_ns is not None and time_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self._clock.oscillator.sleep_until_ns(edge.time_ns)
        self._next += 1
        if edge.picture >= 0:
            self.tick, self.time_ns, self.true_ns = edge.picture, time_ns, edge.time_ns
        return Edge(self._next - 1, time_ns)
