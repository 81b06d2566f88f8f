"""The machine's own clock. No flight file outside the drivers reads time."""

import time

from hal.drivers.absolute_sleep import sleep_until_monotonic_ns


def thread_cpu_ns() -> int:
    """Processor time of the calling thread."""
    return time.thread_time_ns()


def wall_ns() -> int:
    """A steady stopwatch."""
    return time.perf_counter_ns()


class RealtimeClock:
    """Mission time that runs with the machine's monotonic clock from a given start."""

    def __init__(self, start_ns: int = 0) -> None:
        self._origin_ns = time.monotonic_ns() - start_ns

    def now_ns(self) -> int:
        """Mission time: start_ns at construction, then real time."""
        return time.monotonic_ns() - self._origin_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        """Sleep to this mission time; late by what the operating system takes to wake a thread."""
        sleep_until_monotonic_ns(time_ns + self._origin_ns)

    def thread_cpu_ns(self) -> int:
        """Processor time of the calling thread."""
        return thread_cpu_ns()

    def wall_ns(self) -> int:
        """A steady stopwatch."""
        return wall_ns()
