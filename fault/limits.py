"""Limits on telemetry points: plain state in, plain state out.

A bad sample lies beyond a threshold, or is NaN; every other one is good. Yellow and red trip apart, each by a leaky
count, its debt: a bad sample adds `forgive` and a good one takes 1 away. It trips at `set_after` times `forgive`: after
`set_after` bad samples in a row, and also when more than one sample in `forgive` + 1 is bad for long, so that a fault
that comes and goes is found. What tripped clears after `clear_after` good samples in a row, inside by the hysteresis.
A sample that is stale or does not apply counts for nothing: it sets nothing, clears nothing and forgives nothing.
"""

from collections.abc import Sequence
from enum import IntEnum
from math import inf, isnan
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, Struct

from telemetry.dictionary import POINT_BY_NAME, ModeFlag

Number = Annotated[int, Meta(ge=1, le=999, description="its number, by which commands address it")]
Samples = Annotated[int, Meta(ge=1, le=10_000, description="number of samples")]
Name = Annotated[str, Meta(min_length=1, max_length=40)]


class Level(IntEnum):
    """How bad it is."""

    GREEN = 0
    YELLOW = 1
    RED = 2


class Limit(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One row of the limit table.

    number: no other row of the table has it. point: name in the dictionary; a point of several slots is watched slot
    by slot. per: when there is a new sample: each tick, each measured frame, or each estimate. forgive: good samples
    that forgive a bad one. requires: points that must be known and not 0 for the limit to apply; excludes: points that
    must be known and 0 (both of the same slot, where they have slots). response: of a red limit: only report it,
    invalidate the mode of this slot (all modes, for a point without slots), degrade the flight mode too, or inhibit
    the flight. latch: what clears it: good samples (auto), a command once it is good again (latched), or nothing
    (permanent). flag: name of the ModeFlag that tells the controller why.
    """

    number: Number
    point: Name
    per: Literal["tick", "frame", "estimate"]
    set_after: Samples
    clear_after: Samples
    forgive: Samples = 4
    low_red: float | None = None
    low_yellow: float | None = None
    high_yellow: float | None = None
    high_red: float | None = None
    hysteresis: Annotated[float, Meta(ge=0.0, description="in the point's unit")] = 0.0
    requires: tuple[Name, ...] = ()
    excludes: tuple[Name, ...] = ()
    response: Literal["report", "invalidate", "degrade", "inhibit"] = "report"
    latch: Literal["auto", "latched", "permanent"] = "auto"
    flag: Name | None = None


class Trip(NamedTuple):
    """One threshold pair: tripped or not; the debt of bad samples until it trips; good samples in a row since then."""

    tripped: bool = False
    debt: int = 0
    good: int = 0


class LimitState(NamedTuple):
    """State of a limit: its two threshold pairs."""

    yellow: Trip = Trip()
    red: Trip = Trip()

    @property
    def level(self) -> Level:
        """The worse of the two."""
        if self.red.tripped:
            return Level.RED
        return Level.YELLOW if self.yellow.tripped else Level.GREEN


GREEN = LimitState()


def step(limit: Limit, state: LimitState, value: float, fresh: bool = True, applies: bool = True) -> LimitState:
    """The state after one sample. fresh: the value is new; applies: the limit's gate is open."""
    if not (fresh and applies):
        return state
    yellow = _step(limit, state.yellow, outside(value, *pair(limit, Level.YELLOW), _margin(limit, state.yellow)))
    red = _step(limit, state.red, outside(value, *pair(limit, Level.RED), _margin(limit, state.red)))
    return LimitState(yellow, red)


def clear(limit: Limit, state: LimitState) -> tuple[LimitState, bool]:
    """The state after a command to clear, and whether that is granted.

    It is refused while the cause of the worst trip is there, and for a permanent limit; a trip whose cause is there
    stays (yellow, say, when red is cleared). A limit that is not tripped is granted, and nothing changes.
    """
    if state.level is Level.GREEN:
        return state, True
    if not _clearable(limit, state.red if state.red.tripped else state.yellow):
        return state, False
    return LimitState(*(Trip() if _clearable(limit, trip) else trip for trip in state)), True


def outside(value: float, low: float, high: float, margin: float = 0.0) -> bool:
    """Whether the value is not inside low + margin to high - margin; so is NaN, unless there is no threshold."""
    return not low + margin <= value <= high - margin and (low > -inf or high < inf)


def pair(limit: Limit, level: Level) -> tuple[float, float]:
    """Low and high threshold of a level; infinite where there is none."""
    if level is Level.RED:
        low, high = limit.low_red, limit.high_red
    else:
        low, high = limit.low_yellow, limit.high_yellow
    return (-inf if low is None else low), (inf if high is None else high)


def crossed(limit: Limit, level: Level, value: float) -> float:
    """The threshold of this level that the value lies at: the nearer one; for NaN the first that there is."""
    low, high = pair(limit, level)
    if isnan(value):
        return low if low > -inf else high
    return low if abs(value - low) <= abs(value - high) else high


def fault_in(limit: Limit) -> str:
    """What is wrong with a row of the table; empty if nothing is."""
    gates = (*limit.requires, *limit.excludes)
    for name in (limit.point, *gates):
        if name not in POINT_BY_NAME:
            return f"no point is called {name}; there are {', '.join(POINT_BY_NAME)}"
    for name in gates:
        if POINT_BY_NAME[name].slots not in (1, POINT_BY_NAME[limit.point].slots):
            return f"{limit.point} cannot depend on {name}: it has other slots"
    thresholds = [limit.low_red, limit.low_yellow, limit.high_yellow, limit.high_red]
    given = [value for value in thresholds if value is not None]
    if not given:
        return "one of low_red, low_yellow, high_yellow, high_red is needed"
    if given != sorted(given):
        return "low_red <= low_yellow <= high_yellow <= high_red is needed"
    for level in (Level.YELLOW, Level.RED):
        low, high = pair(limit, level)
        if low + limit.hysteresis > high - limit.hysteresis:
            return f"hysteresis {limit.hysteresis:g} leaves nothing between {low:g} and {high:g} to clear in"
    if limit.response != "report" and limit.low_red is None and limit.high_red is None:
        return f"response {limit.response} needs a red threshold"
    if limit.flag is not None and limit.flag.upper() not in ModeFlag.__members__:
        allowed = ", ".join(flag.lower() for flag in ModeFlag.__members__)
        return f"no flag is called {limit.flag}; there are {allowed}"
    return ""


def faults_in(limits: Sequence[Limit]) -> str:
    """What is wrong with a table: the first row that cannot work, or has another's number; empty if nothing is."""
    seen: dict[int, int] = {}
    for row, limit in enumerate(limits):
        problem = fault_in(limit)
        if limit.number in seen:
            problem = f"number {limit.number} is limit[{seen[limit.number]}] already"
        if problem:
            return f"limit[{row}] on {limit.point}: {problem}"
        seen[limit.number] = row
    return ""


def _margin(limit: Limit, trip: Trip) -> float:
    return limit.hysteresis if trip.tripped else 0.0


def _step(limit: Limit, trip: Trip, bad: bool) -> Trip:
    if trip.tripped:
        good = 0 if bad else min(trip.good + 1, limit.clear_after)
        return Trip() if limit.latch == "auto" and good == limit.clear_after else Trip(True, 0, good)
    if bad:
        debt = trip.debt + limit.forgive
        return Trip(True) if debt >= limit.set_after * limit.forgive else Trip(False, debt)
    return Trip(False, max(0, trip.debt - 1))


def _clearable(limit: Limit, trip: Trip) -> bool:
    return limit.latch != "permanent" and trip.good == limit.clear_after
