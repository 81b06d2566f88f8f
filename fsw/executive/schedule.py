"""The schedule: which task runs at which ticks, and the reasons to refuse a schedule that cannot hold."""

from collections.abc import Collection, Sequence
from enum import IntEnum
from math import lcm
from typing import NamedTuple, Protocol

# Share of a tick that may be planned; the rest is for jitter, the collector and the operating system.
LARGEST_LOAD = 0.8
LONGEST_HYPERPERIOD_TICKS = 3600


class Slot(Protocol):
    """One row of the schedule table: the task runs at ticks phase, phase + period, phase + 2 period, ...

    latency_ticks 0: it runs within its tick. Else it runs beside the ticks, and its result appears at exactly
    that many ticks later. budget_ms: processor time a run. Rows stand in the order in which tasks run.
    """

    @property
    def task(self) -> str: ...
    @property
    def period_ticks(self) -> int: ...
    @property
    def phase_ticks(self) -> int: ...
    @property
    def latency_ticks(self) -> int: ...
    @property
    def budget_ms(self) -> float: ...
    @property
    def criticality(self) -> str: ...


class Refusal(IntEnum):
    """Why a schedule is refused; the numbers are sent."""

    EMPTY = 1
    UNKNOWN_TASK = 2
    TASK_TWICE = 3
    BAD_PERIOD = 4
    BAD_PHASE = 5
    BAD_LATENCY = 6
    BAD_BUDGET = 7
    HYPERPERIOD = 8
    OVERLOAD = 9
    WORKER_OVERLOAD = 10
    MISSING_TASK = 11


class Finding(NamedTuple):
    """One reason against a schedule: its code, the task it concerns, and what is wrong in words."""

    refusal: Refusal
    task: str
    text: str


def check_schedule(
    schedule: Sequence[Slot],
    known: Collection[str],
    tick_ms: float | None = None,
    required: Collection[str] = (),
    within_tick: Collection[str] = (),
) -> list[Finding]:
    """All reasons to refuse this schedule; none if it is good.

    known: names of the tasks that there are. tick_ms: length of a tick at real pace; None leaves the load
    unchecked, as in lockstep, where a tick takes as long as it takes. required: tasks that must have a row.
    within_tick: tasks that cannot work beside the ticks, and so have no latency.
    """
    if not schedule:
        return [Finding(Refusal.EMPTY, "", "no task is scheduled")]
    findings = [finding for slot in schedule for finding in _check_slot(slot, known, within_tick)]
    names = [slot.task for slot in schedule]
    findings += [
        Finding(Refusal.TASK_TWICE, name, f"task {name} has {names.count(name)} rows, one is allowed")
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    findings += [
        Finding(Refusal.MISSING_TASK, name, f"task {name} has no row, the flight needs it")
        for name in required
        if name not in names
    ]
    if findings:
        return findings
    length = hyperperiod(schedule)
    if length > LONGEST_HYPERPERIOD_TICKS:
        text = f"the schedule repeats after {length} ticks, at most {LONGEST_HYPERPERIOD_TICKS} are allowed"
        return [Finding(Refusal.HYPERPERIOD, "", text)]
    return [] if tick_ms is None else _check_load(schedule, tick_ms)


def hyperperiod(schedule: Sequence[Slot]) -> int:
    """Ticks after which the schedule repeats."""
    return lcm(*(slot.period_ticks for slot in schedule))


def releases(slot: Slot, first: int, last: int) -> int:
    """How many ticks from first to last, both included, release this task."""

    def up_to(tick: int) -> int:
        return max(0, (tick - slot.phase_ticks) // slot.period_ticks + 1)

    return up_to(last) - up_to(first - 1)


def _check_slot(slot: Slot, known: Collection[str], within_tick: Collection[str]) -> list[Finding]:
    findings = []
    if slot.task not in known:
        text = f"no task is called {slot.task}; there are {', '.join(sorted(known))}"
        findings.append(Finding(Refusal.UNKNOWN_TASK, slot.task, text))
    if slot.period_ticks < 1:
        text = f"period_ticks of {slot.task} is {slot.period_ticks}, at least 1 is allowed"
        return [*findings, Finding(Refusal.BAD_PERIOD, slot.task, text)]
    if not 0 <= slot.phase_ticks < slot.period_ticks:
        text = f"phase_ticks of {slot.task} is {slot.phase_ticks}, 0 to {slot.period_ticks - 1} is allowed"
        findings.append(Finding(Refusal.BAD_PHASE, slot.task, text))
    # A task's result must be out before it starts again: it has one place to work in.
    if not 0 <= slot.latency_ticks <= slot.period_ticks:
        text = f"latency_ticks of {slot.task} is {slot.latency_ticks}, 0 to its period is allowed"
        findings.append(Finding(Refusal.BAD_LATENCY, slot.task, text))
    elif slot.latency_ticks > 0 and slot.task in within_tick:
        text = f"latency_ticks of {slot.task} is {slot.latency_ticks}, 0 is allowed: it works within its tick"
        findings.append(Finding(Refusal.BAD_LATENCY, slot.task, text))
    if not 0.0 < slot.budget_ms < float("inf"):
        text = f"budget_ms of {slot.task} is {slot.budget_ms:g}, more than 0 is allowed"
        findings.append(Finding(Refusal.BAD_BUDGET, slot.task, text))
    return findings


def _check_load(schedule: Sequence[Slot], tick_ms: float) -> list[Finding]:
    """The fullest tick against its share of a tick, and each long task, on its own thread, against its latency."""
    findings = []
    within = [slot for slot in schedule if slot.latency_ticks == 0]
    beside = [slot for slot in schedule if slot.latency_ticks > 0]
    loads = [
        sum(slot.budget_ms for slot in within if releases(slot, tick, tick)) for tick in range(hyperperiod(schedule))
    ]
    if max(loads) > LARGEST_LOAD * tick_ms:
        text = (
            f"tick {loads.index(max(loads))} plans {max(loads):.1f} ms, "
            f"{LARGEST_LOAD * tick_ms:.1f} of {tick_ms:.1f} ms are allowed"
        )
        findings.append(Finding(Refusal.OVERLOAD, "", text))
    findings += [
        Finding(
            Refusal.WORKER_OVERLOAD,
            slot.task,
            f"{slot.task} plans {slot.budget_ms:.1f} ms, "
            f"{LARGEST_LOAD * slot.latency_ticks * tick_ms:.1f} ms of its latency are allowed",
        )
        for slot in beside
        if slot.budget_ms > LARGEST_LOAD * slot.latency_ticks * tick_ms
    ]
    return findings
