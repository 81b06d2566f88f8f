"""Health: warn before fatal, a watchdog that is served only while all critical tasks make progress."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import pytest
from executive_parts import PERIOD_NS, Busy, Edges, Frame, Long, slot

from fsw.executive.entry import Entry, FrameTask, LongTask
from fsw.executive.executive import Executive
from fsw.tables.flight import TaskSlot
from fsw.tasks.health import Health
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.soft_watchdog import SoftWatchdog
from telemetry.board import Board
from telemetry.dictionary import TASKS_SILENT
from telemetry.events import RestartCause, TaskNumber

SILENT, DEAD = 5, 12
IDENTIFY, MATCH, SEARCH = (int(TaskNumber[name]) for name in ("IDENTIFY", "MATCH", "SEARCH"))


@dataclass
class Flight:
    """The real executive with health as its last task; `hung` long tasks never end."""

    slots: list[TaskSlot]
    tasks: list[FrameTask | LongTask]
    ticks: Iterable[int]
    clock: LockstepClock = field(default_factory=LockstepClock)
    hung: set[str] = field(default_factory=set)
    told: list[tuple[Any, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.board = Board()
        self.watchdog = SoftWatchdog(self.clock, 3 * PERIOD_NS)
        self.health = Health(
            lambda: self.executive, self.watchdog, self.board, self.tell, SILENT, DEAD,
            [task.name for task in self.tasks] + ["health"],
        )  # fmt: skip
        self.executive = Executive(
            [*self.slots, slot("health")],
            {task.name: task for task in [*self.tasks, self.health]},
            Edges(self.ticks, self.clock), self.clock, PERIOD_NS,
            patience=self.patience, on_failure=lambda task, error: None,
        )  # fmt: skip
        self.executive.init()

    def patience(self, entry: Entry) -> bool:
        return entry.slot.task not in self.hung and entry.done.wait(10.0)

    def tell(self, event: Any, *arguments: float) -> None:
        self.told.append((self.executive.tick, event.name, *arguments))

    def fly(self, ticks: int) -> None:
        for _ in range(ticks):
            assert self.executive.step()


class Makes(Protocol):
    def __call__(
        self,
        slots: list[TaskSlot],
        tasks: list[FrameTask | LongTask],
        ticks: Iterable[int],
        clock: LockstepClock | None = None,
    ) -> Flight: ...


@pytest.fixture
def flying() -> Iterator[Makes]:
    """Makes flights, and ends them."""
    made: list[Flight] = []

    def make(
        slots: list[TaskSlot],
        tasks: list[FrameTask | LongTask],
        ticks: Iterable[int],
        clock: LockstepClock | None = None,
    ) -> Flight:
        made.append(Flight(slots, tasks, ticks, clock or LockstepClock()))
        return made[-1]

    yield make
    for flight in made:
        flight.executive.close()


def critical(task: str, period: int = 1, latency: int = 0) -> TaskSlot:
    return TaskSlot(task, 1.0, period, 0, latency, "critical")


@pytest.mark.requirement("WB-HLT-01")
def test_tasks_that_run_or_have_nothing_to_do_are_never_called_silent(flying: Makes) -> None:
    tasks = [Frame("match", []), Long("search", [], idle=range(2000)), Long("identify", [])]
    rows = [critical("match", 7), critical("search", 5, 5), slot("identify", 10, 5, 5)]
    flight = flying(rows, tasks, range(400))
    flight.fly(400)
    assert flight.told == [] and flight.board.get(TASKS_SILENT) == 0
    assert flight.health.restart_cause is None and not flight.watchdog.expired()
    assert len({entry.challenge for entry in flight.executive.scheduled}) == 4


@pytest.mark.requirement("WB-HLT-01")
def test_a_task_that_hangs_is_silent_first_then_dead_each_told_once_and_back_when_it_moves(flying: Makes) -> None:
    flight = flying([slot("identify", 4, 0, 2)], [Long("identify", [])], range(100))
    flight.fly(8)
    flight.hung.add("identify")
    flight.fly(40)
    flight.hung.clear()
    flight.fly(10)
    # Answered at 6, when it was asked again: 4 + 2 ticks for its turn, then 5 to silence and 12 to death.
    assert flight.told == [
        (6 + 6 + SILENT + 1, "TASK_SILENT", IDENTIFY, 6 + SILENT + 1),
        (6 + 6 + DEAD + 1, "TASK_DEAD", IDENTIFY, 6 + DEAD + 1),
        (48, "TASK_BACK", IDENTIFY),
    ]


@pytest.mark.requirement("WB-HLT-02", "WB-HLT-03")
def test_a_dead_critical_task_asks_for_a_restart_and_the_watchdog_is_served_no_more(flying: Makes) -> None:
    flight = flying([critical("search", 4, 2)], [Long("search", [])], range(100))
    flight.hung.add("search")
    silent_at, dead_at = 6 + SILENT + 1, 6 + DEAD + 1
    flight.fly(silent_at)
    assert flight.board.get(TASKS_SILENT) == 0
    flight.fly(1)
    assert flight.board.get(TASKS_SILENT) == 1 and flight.health.restart_cause is None
    flight.fly(dead_at - silent_at)
    assert flight.health.restart_cause is RestartCause.TASK_DEAD
    assert [name for _, name, *_ in flight.told] == ["TASK_SILENT", "TASK_DEAD"]
    flight.fly(2)  # its time is three periods, from when it was served last
    assert not flight.watchdog.expired()
    flight.fly(1)
    assert flight.watchdog.expired()


@pytest.mark.requirement("WB-HLT-03")
def test_a_dead_task_that_is_not_critical_is_told_and_nothing_else(flying: Makes) -> None:
    flight = flying([slot("identify", 4, 0, 2)], [Long("identify", [])], range(100))
    flight.hung.add("identify")
    flight.fly(60)
    assert [name for _, name, *_ in flight.told] == ["TASK_SILENT", "TASK_DEAD"]
    assert flight.board.get(TASKS_SILENT) == 0
    assert flight.health.restart_cause is None and not flight.watchdog.expired()


class Failing(Frame):
    def run(self, tick: int, time_ns: int) -> None:
        if tick == 3:
            raise ArithmeticError("singular")


@pytest.mark.requirement("WB-HLT-03")
@pytest.mark.parametrize(
    ("row", "cause"), [(critical("match"), RestartCause.TASK_FAILED), (slot("match"), None)], ids=("critical", "normal")
)
def test_a_critical_task_that_failed_asks_for_a_restart_at_once(
    flying: Makes, row: TaskSlot, cause: RestartCause | None
) -> None:
    flight = flying([row], [Failing("match", [])], range(20))
    flight.fly(3)
    assert flight.health.restart_cause is None
    flight.fly(1)
    assert flight.health.restart_cause is cause
    flight.fly(5)
    assert flight.watchdog.expired() is (cause is not None)


@pytest.mark.requirement("WB-HLT-01")
def test_a_task_that_is_switched_off_is_not_asked_and_begins_anew_when_it_is_back(flying: Makes) -> None:
    flight = flying([critical("match")], [Frame("match", [])], range(200))
    flight.fly(3)
    assert flight.executive.switch("match", False)
    flight.fly(50)
    assert flight.executive.switch("match", True)
    flight.fly(50)
    assert flight.told == [] and flight.health.restart_cause is None


@pytest.mark.requirement("WB-HLT-01")
def test_edges_that_never_came_and_ticks_that_were_skipped_are_no_tasks_fault(flying: Makes) -> None:
    clock = LockstepClock()
    tasks = [Busy("match", clock, {150: 60 * PERIOD_NS}), Long("search", [])]
    rows = [critical("match"), critical("search", 5, 5)]
    flight = flying(rows, tasks, [*range(12), *range(100, 300)], clock)
    flight.fly(130)
    assert flight.executive.missed_ticks == 88 and flight.executive.skipped_ticks > 50
    assert flight.told == [] and flight.health.restart_cause is None
    assert flight.watchdog.expired()  # but the processor would have been reset


@dataclass
class Mute:
    """A task that counts progress, or answers, but not both."""

    slot: TaskSlot
    answers: bool
    enabled: bool = True
    failed: bool = False
    answer: int = 0
    progress: int = 0
    _challenge: int = 0

    @property
    def challenge(self) -> int:
        return self._challenge

    @challenge.setter
    def challenge(self, key: int) -> None:
        self._challenge = key
        self.answer = key if self.answers else 0


@dataclass
class Crew:
    scheduled: list[Mute]
    ticks: int = 0


@pytest.mark.requirement("WB-HLT-01")
@pytest.mark.parametrize("answers", [True, False])
def test_neither_the_key_nor_the_counter_alone_is_proof(answers: bool) -> None:
    crew, told = Crew([Mute(critical("match"), answers)]), []
    watchdog = SoftWatchdog(LockstepClock(), PERIOD_NS)
    health = Health(lambda: crew, watchdog, Board(), lambda *args: told.append(args[0].name), SILENT, DEAD, ["match"])
    for tick in range(40):
        crew.ticks += 1
        crew.scheduled[0].progress += not answers
        health.run(tick, tick * PERIOD_NS)
    assert told == ["TASK_SILENT", "TASK_DEAD"] and health.restart_cause is RestartCause.TASK_DEAD


@pytest.mark.requirement("WB-HLT-01")
def test_a_task_that_the_dictionary_does_not_know_is_told_by_a_number_of_its_own() -> None:
    crew, told = Crew([Mute(slot("guest"), False)]), []
    health = Health(
        lambda: crew, SoftWatchdog(LockstepClock(), PERIOD_NS), Board(), lambda *args: told.append(args[1]), 1, 2,
        ["guest"],
    )  # fmt: skip
    for tick in range(8):
        crew.ticks += 1
        health.run(tick, 0)
    assert told == [255, 255]
