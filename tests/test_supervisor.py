"""Restarts: so many and no more, the count outlives the process, a hung worker does not hold them up."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from executive_parts import PERIOD_NS, Edges, Long
from hypothesis import given
from hypothesis import strategies as st

from fsw.executive.executive import Executive
from fsw.supervisor import COUNT_FILE, Start, Supervisor, count_bytes, read_count
from fsw.tables.flight import TaskSlot
from fsw.tasks.health import Health
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.soft_watchdog import SoftWatchdog
from hal.store import FileStore
from telemetry.board import Board
from telemetry.events import RestartCause
from wingbeat.errors import InputError

POWER_ON, COMMAND, DEAD = RestartCause.POWER_ON, RestartCause.COMMAND, RestartCause.TASK_DEAD


class App:
    """Asks for what it is told to at each step; None: nothing, False: the trigger has ended."""

    def __init__(self, script: list[RestartCause | None], log: list[str]) -> None:
        self.script, self.log = script, log
        self.restart_cause: RestartCause | None = None

    def init(self) -> None:
        self.log.append("init")

    def step(self) -> bool:
        if not self.script:
            return False
        self.restart_cause = self.script.pop(0)
        return True

    def close(self) -> None:
        self.log.append("close")


def supervised(
    folder: Path, script: list[RestartCause | None], most: int = 3
) -> tuple[Supervisor, list[Start], list[str]]:
    starts: list[Start] = []
    log: list[str] = []

    def make(start: Start) -> App:
        starts.append(start)
        log.append("make")
        return App(script, log)

    return Supervisor(make, FileStore(folder), most), starts, log


@pytest.mark.requirement("WB-HLT-04")
def test_after_the_last_restart_one_more_application_flies_inhibited_and_stays(tmp_path: Path) -> None:
    supervisor, starts, log = supervised(tmp_path, [None, DEAD, DEAD, RestartCause.WATCHDOG, DEAD, DEAD, None, DEAD])
    supervisor.run()
    assert starts == [
        Start(0, POWER_ON, False, False),
        Start(1, DEAD, False, False),
        Start(2, DEAD, False, False),
        Start(3, RestartCause.WATCHDOG, False, False),
        Start(4, DEAD, True, False),
    ]
    assert log == ["make", "init", *["close", "make", "init"] * 4, "close"]


@pytest.mark.requirement("WB-HLT-04")
def test_the_count_outlives_the_process(tmp_path: Path) -> None:
    supervised(tmp_path, [DEAD, DEAD])[0].run()
    again, starts, _ = supervised(tmp_path, [DEAD, DEAD, DEAD])
    again.run()
    assert [start.restarts for start in starts] == [2, 3, 4]
    assert starts[0] == Start(2, POWER_ON, False, False) and starts[-1].inhibited
    third, starts, _ = supervised(tmp_path, [DEAD])
    third.run()
    assert starts == [Start(4, POWER_ON, True, False)]


@pytest.mark.requirement("WB-HLT-04")
def test_the_count_is_kept_before_the_next_application_begins(tmp_path: Path) -> None:
    kept: list[int | None] = []

    def make(start: Start) -> App:
        kept.append(read_count(FileStore(tmp_path)))
        return App([DEAD] if start.restarts < 2 else [], [])

    Supervisor(make, FileStore(tmp_path), 3).run()
    assert kept == [0, 1, 2]


@pytest.mark.requirement("WB-HLT-06")
def test_a_commanded_restart_is_always_granted_and_sets_the_count_to_0(tmp_path: Path) -> None:
    supervisor, starts, _ = supervised(tmp_path, [DEAD, DEAD, DEAD, DEAD, DEAD, COMMAND, COMMAND, DEAD])
    supervisor.run()
    assert [(start.restarts, start.inhibited) for start in starts][4:] == [
        (4, True),
        (0, False),
        (0, False),
        (1, False),
    ]
    supervisor.clear()
    assert read_count(FileStore(tmp_path)) == 0


@pytest.mark.requirement("WB-HLT-05")
def test_a_damaged_count_counts_as_spent_and_is_told_once(tmp_path: Path) -> None:
    FileStore(tmp_path).write(COUNT_FILE, count_bytes(1)[:-3])
    supervised(tmp_path, [DEAD])
    supervisor, starts, _ = supervised(tmp_path, [DEAD, COMMAND])
    FileStore(tmp_path).write(COUNT_FILE, b"{}")
    _, damaged, _ = supervised(tmp_path, [])
    assert damaged == [Start(4, POWER_ON, True, True)]
    assert starts == [Start(4, POWER_ON, True, False)]  # kept as spent since the first look
    supervisor.run()
    assert starts[1:] == [Start(0, COMMAND, False, False)]


@pytest.mark.requirement("WB-HLT-05")
@given(st.integers(0, 300), st.data())
def test_no_flipped_bit_changes_the_count_that_is_read(restarts: int, data: st.DataObject) -> None:
    content = bytearray(count_bytes(restarts))
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    content[bit // 8] ^= 1 << bit % 8
    assert read_count(Shelf(lambda: bytes(content))) in (None, restarts)


class Shelf:
    """A store that gives what it is told to, and takes nothing."""

    def __init__(self, give: Callable[[], bytes | None]) -> None:
        self._give = give

    def read(self, name: str) -> bytes | None:
        return self._give()

    def write(self, name: str, data: bytes) -> None:
        raise InputError("cannot write: no space left on device", name, "make room")

    def path(self, name: str) -> Path:
        return Path(name)


def refuse() -> bytes:
    raise OSError("no such device")


@pytest.mark.requirement("WB-HLT-05")
@pytest.mark.parametrize(
    "content",
    [b"", b"\xff", b"[]", b"3", b'{"restarts": 1}', b'{"restarts": -1, "crc32": 0}', b'{"restarts": "1", "crc32": 0}',
     b'{"restarts": 1, "crc32": 2}', b"[" * 100_000],
)  # fmt: skip
def test_each_kind_of_damage_is_seen(content: bytes) -> None:
    assert read_count(Shelf(lambda: content)) is None


@pytest.mark.requirement("WB-HLT-05")
def test_a_store_that_fails_does_not_end_the_flight() -> None:
    assert read_count(Shelf(refuse)) is None and read_count(Shelf(lambda: None)) == 0
    starts: list[Start] = []

    def make(start: Start) -> App:
        starts.append(start)
        return App([DEAD] if len(starts) < 2 else [], [])

    supervisor = Supervisor(make, Shelf(lambda: None), 3)
    assert not supervisor.count_lost
    supervisor.run()
    assert supervisor.count_lost and [start.restarts for start in starts] == [0, 1]


class SmallApp:
    """The real executive and health, one critical long task; `hold` never comes, so its worker hangs."""

    def __init__(self, clock: LockstepClock, ticks: range, hang: bool) -> None:
        self.board, self.log = Board(), []
        self.task = Long("search", self.log)
        self.hang = hang
        if hang:
            self.task.hold.clear()
        self.watchdog = SoftWatchdog(clock, 100 * PERIOD_NS)
        self.health = Health(
            lambda: self.executive, self.watchdog, self.board, lambda *args: None, 2, 5, ("search", "health")
        )  # fmt: skip
        rows = [TaskSlot("search", 1.0, 3, 0, 2, "critical"), TaskSlot("health", 1.0)]
        self.executive = Executive(
            rows, {"search": self.task, "health": self.health}, Edges(ticks, clock), clock, PERIOD_NS,
            patience=lambda entry: not self.hang and entry.done.wait(10.0),
        )  # fmt: skip

    @property
    def restart_cause(self) -> RestartCause | None:
        return self.health.restart_cause

    def init(self) -> None:
        self.executive.init()

    def step(self) -> bool:
        return self.executive.step()

    def close(self) -> None:
        self.executive.close()


@pytest.mark.requirement("WB-HLT-07")
def test_a_worker_that_hangs_is_left_behind_and_the_new_application_begins_with_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsw.executive.executive.CLOSE_S", 0.05)
    clock = LockstepClock()
    apps: list[SmallApp] = []

    def make(start: Start) -> SmallApp:
        first = 0 if not apps else apps[-1].executive.tick + 1
        apps.append(SmallApp(clock, range(first, 60), hang=not apps))
        return apps[-1]

    supervisor = Supervisor(make, FileStore(tmp_path), 3)
    supervisor.run()
    old, new = apps
    assert old.executive.tick == 5 + 5 + 1 and supervisor.restarts == 1
    assert new.executive.ticks == 60 - 12 and new.restart_cause is None
    assert [tick for name, tick in new.log if "deliver" in name] == list(range(14, 60, 3))
    taken = len(new.log)
    old.task.hold.set()
    for thread in threading.enumerate():
        if thread.name == "worker-search":
            thread.join()
    # What the old worker did after all reached nobody.
    assert len(new.log) == taken and not any("deliver" in name for name, _ in old.log)
