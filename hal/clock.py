"""The one source of time for flight code."""

from typing import Protocol


class Clock(Protocol):
    """Mission time, in which the tick loop lives, and two stopwatches for statistics only."""

    def now_ns(self) -> int:
        """Mission time; it never runs backwards."""
        ...

    def sleep_until_ns(self, time_ns: int) -> None:
        """Return at this mission time, at once if it has passed."""
        ...

    def thread_cpu_ns(self) -> int:
        """Processor time that the calling thread has used; only differences mean anything."""
        ...

    def wall_ns(self) -> int:
        """A steady stopwatch; only differences mean anything."""
        ...
