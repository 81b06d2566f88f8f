"""Real pace: absolute sleep, what the operating system grants, and the watchdog's device."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from hal.drivers import absolute_sleep
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.realtime_clock import RealtimeClock
from hal.drivers.soft_watchdog import SoftWatchdog
from hal.drivers.watchdog_device import WatchdogDevice
from wingbeat.errors import InputError

MS = 1_000_000


@pytest.mark.requirement("WB-EXE-16")
@pytest.mark.parametrize("kernel", [True, False])
def test_sleep_ends_at_its_time_never_before_and_at_once_if_that_has_passed(
    kernel: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not kernel:
        monkeypatch.setattr(absolute_sleep, "_sleep", absolute_sleep._relative_sleep)
    clock = RealtimeClock(start_ns=5_000 * MS)
    start = clock.now_ns()
    assert start >= 5_000 * MS
    for after_ms in (3, 6, 9, 40):
        clock.sleep_until_ns(start + after_ms * MS)
        assert clock.now_ns() >= start + after_ms * MS
    before = time.monotonic_ns()
    clock.sleep_until_ns(start)
    assert time.monotonic_ns() - before < 1000 * MS


@pytest.mark.requirement("WB-EXE-16")
def test_other_threads_run_while_one_sleeps() -> None:
    clock = RealtimeClock()
    woken: list[int] = []
    thread = threading.Thread(target=lambda: woken.append(clock.now_ns()))
    thread.start()
    clock.sleep_until_ns(clock.now_ns() + 50 * MS)
    thread.join()
    assert woken[0] < clock.now_ns()


ASK = """
import gc, os, threading, resource
from hal.drivers.realtime_process import become_realtime, restore
{before}
granted = become_realtime(7)
policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
workers = []
thread = threading.Thread(target=lambda: workers.append(os.sched_getscheduler(0)))
thread.start()
thread.join()
locked = int(next(line for line in open("/proc/self/status") if line.startswith("VmLck")).split()[1])
assert sorted(granted) == ["collector", "memory", "scheduler"]
assert (policy == os.SCHED_FIFO) == (granted["scheduler"] == "yes"), granted
assert (locked > 0) == (granted["memory"] == "yes"), granted
assert workers == [os.SCHED_OTHER]
assert not gc.isenabled() and gc.get_freeze_count() > 0 and granted["collector"] == "yes"
restore()
assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
assert gc.isenabled() and gc.get_freeze_count() == 0
print(granted)
"""
AS_NOBODY = "resource.setrlimit(resource.RLIMIT_MEMLOCK, (4096, 4096)); os.setuid(65534)"


@pytest.mark.requirement("WB-EXE-16")
@pytest.mark.parametrize("before", ["", AS_NOBODY], ids=["as-we-are", "as-nobody"])
def test_what_the_system_grants_is_taken_and_what_it_refuses_is_said(before: str) -> None:
    if before and subprocess.run(["id", "-u"], capture_output=True, check=True).stdout.strip() != b"0":
        pytest.skip("only root can become somebody who is granted nothing")
    done = subprocess.run([sys.executable, "-c", ASK.format(before=before)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if before:
        assert "'scheduler': 'not permitted', 'memory': 'not permitted'" in done.stdout


@pytest.mark.requirement("WB-HLT-02")
def test_the_watchdogs_device_gets_a_byte_each_time_and_is_disarmed_at_a_clean_end(tmp_path: Path) -> None:
    path = tmp_path / "watchdog"
    path.touch()
    watchdog = WatchdogDevice(path)
    for _ in range(3):
        watchdog.serve()
    assert path.read_bytes() == b"\0\0\0" and not watchdog.expired()
    watchdog.close()
    assert path.read_bytes() == b"\0\0\0V" and watchdog.refused == 0


@pytest.mark.requirement("WB-HLT-02")
def test_a_device_that_refuses_is_counted_and_one_that_is_missing_is_named(tmp_path: Path) -> None:
    watchdog = WatchdogDevice(Path("/dev/full"))
    watchdog.serve()
    assert watchdog.refused == 1
    with pytest.raises(InputError, match="watchdog7"):
        WatchdogDevice(tmp_path / "watchdog7")


@pytest.mark.requirement("WB-HLT-02")
def test_a_watchdog_that_was_served_too_late_stays_expired_until_it_is_armed_again() -> None:
    clock = LockstepClock(50)
    watchdog = SoftWatchdog(clock, 100)
    clock.sleep_until_ns(150)
    assert not watchdog.expired()
    clock.sleep_until_ns(151)
    assert watchdog.expired()
    watchdog.serve()
    assert watchdog.expired()
    watchdog.arm()
    assert not watchdog.expired()
    clock.sleep_until_ns(251)
    watchdog.serve()
    clock.sleep_until_ns(351)
    assert not watchdog.expired()
