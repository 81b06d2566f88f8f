"""Mission time that jumps to where it is asked to be: as fast as the machine can, and the same on any machine."""

from hal.drivers import realtime_clock


class LockstepClock:
    """Nothing waits: to sleep is to move the time on. The stopwatches stay real."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Mission time: the latest that anybody slept to."""
        return self._now_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        """Move mission time on to this; never back."""
        self._now_ns = max(self._now_ns, time_ns)

    def thread_cpu_ns(self) -> int:
        """Processor time of the calling thread."""
        return realtime_clock.thread_cpu_ns()

    def wall_ns(self) -> int:
        """A steady stopwatch."""
        return realtime_clock.wall_ns()
