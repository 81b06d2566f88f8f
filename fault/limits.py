"""Limits on telemetry points: plain state in, plain state out.

A value beyond red or yellow trips after `set_after` samples in a row, and clears after `clear_after` samples in a
row that lie inside by the hysteresis. NaN is a violation. A sample that is stale or does not apply counts for
nothing: it neither sets nor clears, and it breaks no row.
"""

from enum import IntEnum
from math import inf, isnan
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, Struct

from telemetry.dictionary import POINT_BY_NAME, ModeFlag

Samples = Annotated[int, Meta(ge=1, le=10_000, description="number of samples in a row")]
Name = Annotated[str, Meta(min_length=1, max_length=40)]


class Level(IntEnum):
    """How bad it is."""

    GREEN = 0
    YELLOW = 1
    RED = 2


class Limit(Struct, frozen=True, forbid_unknown_fields=True):
    """One row of the limit table.

    point: name in the dictionary; a point of several slots is watched slot by slot. per: when there is a new
    sample: each tick, each measured frame, or each estimate. requires: points that must be known and not 0 for
    the limit to apply (of the same slot, where they have slots). response: of a red limit: only report it,
    invalidate the mode of this slot (all modes, for a point without slots), or degrade the flight mode too.
    flag: name of the ModeFlag that tells the controller why.
    """

    point: Name
    per: Literal["tick", "frame", "estimate"]
    set_after: Samples
    clear_after: Samples
    low_red: float | None = None
    low_yellow: float | None = None
    high_yellow: float | None = None
    high_red: float | None = None
    hysteresis: Annotated[float, Meta(ge=0.0, description="in the point's unit")] = 0.0
    requires: tuple[Name, ...] = ()
    response: Literal["report", "invalidate", "degrade"] = "report"
    flag: Name | None = None


class Trip(NamedTuple):
    """One threshold pair: tripped or not, and how many samples in a row speak for the other state."""

    tripped: bool = False
    contrary: int = 0


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
    known = ", ".join(POINT_BY_NAME)
    for name in (limit.point, *limit.requires):
        if name not in POINT_BY_NAME:
            return f"no point is called {name}; there are {known}"
    for name in limit.requires:
        if POINT_BY_NAME[name].slots not in (1, POINT_BY_NAME[limit.point].slots):
            return f"{limit.point} cannot require {name}: it has other slots"
    thresholds = [limit.low_red, limit.low_yellow, limit.high_yellow, limit.high_red]
    given = [value for value in thresholds if value is not None]
    if not given:
        return "one of low_red, low_yellow, high_yellow, high_red is needed"
    if given != sorted(given):
        return "low_red <= low_yellow < high_yellow <= high_red is needed"
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


def _margin(limit: Limit, trip: Trip) -> float:
    return limit.hysteresis if trip.tripped else 0.0


def _step(limit: Limit, trip: Trip, bad: bool) -> Trip:
    if bad == trip.tripped:
        return Trip(trip.tripped, 0)
    contrary = trip.contrary + 1
    needed = limit.clear_after if trip.tripped else limit.set_after
    return Trip(not trip.tripped, 0) if contrary >= needed else Trip(trip.tripped, contrary)
