"""What the operating system can do for real pace: priority, memory that stays, no collector; says what it granted."""

import ctypes
import errno
import gc
import os
import resource

LOCK_PRESENT, LOCK_FUTURE, LOCK_ON_USE = 1, 2, 4  # MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT
GRANTED = "yes"


def become_realtime(priority: int = 50) -> dict[str, str]:
    """Give the calling thread a real-time priority (1 to 99), keep all memory in place, stop the collector.

    Threads that it starts run at normal priority. Returns "yes", or why not, for scheduler, memory and collector;
    what was refused is left as it was.
    """
    return {"scheduler": _take_priority(priority), "memory": _lock_memory(), "collector": _stop_collector()}


def restore() -> None:
    """Back to normal priority, memory and collector; what was never granted stays as it is."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    ctypes.CDLL(None).munlockall()
    gc.unfreeze()
    gc.enable()


def _take_priority(priority: int) -> str:
    try:
        # Reset on fork: long tasks beside the ticks must not hold the processor against them.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return "not permitted"
    except OSError as error:
        return error.strerror or "refused"
    return GRANTED


def _lock_memory() -> str:
    # Under a limit, memory taken later would be refused when it is needed, rather than paged.
    limited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] != resource.RLIM_INFINITY
    library = ctypes.CDLL(None, use_errno=True)
    what = LOCK_PRESENT if limited and os.geteuid() != 0 else LOCK_PRESENT | LOCK_FUTURE
    # On use: the system need not fetch all pages of what a long task takes and gives back; that cost it 80 ms a search.
    if library.mlockall(what | LOCK_ON_USE) == 0:
        return GRANTED
    error = ctypes.get_errno()
    return "not permitted" if error in (errno.EPERM, errno.ENOMEM) else os.strerror(error)


def _stop_collector() -> str:
    """What lives now is looked at no more, and nothing new is: reference counts free all that has no circles."""
    gc.collect()
    gc.freeze()
    gc.disable()
    return GRANTED
