"""Sleep to a point of the machine's monotonic clock, by the kernel's own timer."""

import ctypes
import os
import time
from collections.abc import Callable

_TIMER_ABSTIME = 1
_CLOCK_MONOTONIC = 1
_SECOND_NS = 1_000_000_000


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


def _kernel_sleep() -> Callable[[int], None] | None:
    """Sleep until monotonic time, ns; None where the C library has no such call."""
    nanosleep = getattr(ctypes.CDLL(None), "clock_nanosleep", None) if os.name == "posix" else None
    if nanosleep is None:
        return None
    nanosleep.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_Timespec), ctypes.c_void_p)

    def sleep(until_ns: int) -> None:
        at = _Timespec(until_ns // _SECOND_NS, until_ns % _SECOND_NS)
        nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(at), None)

    return sleep


def _relative_sleep(until_ns: int) -> None:
    time.sleep(max(0, until_ns - time.monotonic_ns()) * 1e-9)


_sleep = _kernel_sleep() or _relative_sleep


def sleep_until_monotonic_ns(until_ns: int) -> None:
    """Return at this monotonic time, at once if it has passed; a signal that wakes the thread does not end the sleep.

    Time that passes between reading the clock and falling asleep does not lengthen it, as it does a relative sleep.
    """
    while time.monotonic_ns() < until_ns:
        _sleep(until_ns)
