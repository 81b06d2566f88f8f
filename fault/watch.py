"""A watch keeps one limit over all slots of its point; a bank keeps the watches of a table."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fault.limits import GREEN, Level, Limit, LimitState, Trip, clear, step
from telemetry.board import OFFSET
from telemetry.dictionary import AGE_TICKS, POINT_BY_NAME, CommandResult, ModeFlag

FloatArray = NDArray[np.float64]

STATE_SIZE = 6  # numbers of a LimitState: two trips of three


class Change(NamedTuple):
    """A limit went from one level to another in a slot, at this value."""

    limit: Limit
    slot: int
    before: Level
    after: Level
    value: float


class Watch:
    """One limit over the slots of its point.

    A watch that is switched off goes on as before, but has no response: its level, its events and its counts stay
    true, and it can be switched on again without being blind.
    """

    def __init__(self, limit: Limit) -> None:
        slots = POINT_BY_NAME[limit.point].slots
        self.limit = limit
        self.flag = ModeFlag[limit.flag.upper()] if limit.flag else ModeFlag(0)
        self.states: list[LimitState] = [GREEN] * slots
        self.on = True
        self._clearing = False  # a command to clear was granted, and is done at the next step
        self._places = range(OFFSET[limit.point], OFFSET[limit.point] + slots)
        self._required = [_places(name, slots) for name in limit.requires]
        self._excluded = [_places(name, slots) for name in limit.excludes]

    @property
    def size(self) -> int:
        """Numbers that its state takes."""
        return 2 + STATE_SIZE * len(self.states)

    def step(self, cells: Sequence[float], fresh: bool, changes: list[Change]) -> None:
        """Judge every slot; a stale sample (not fresh) changes nothing. Appends what changes its level."""
        if not (fresh or self._clearing):
            return
        for slot, place in enumerate(self._places):
            before, value = self.states[slot], cells[place]
            state = clear(self.limit, before)[0] if self._clearing else before
            after = step(self.limit, state, value, fresh, self._applies(cells, slot))
            self.states[slot] = after
            if after.level is not before.level:
                changes.append(Change(self.limit, slot, before.level, after.level, value))
        self._clearing = False

    def clear(self) -> CommandResult:
        """Clear the limit in all its slots, or in none: refused while the cause is there in one of them."""
        if all(clear(self.limit, state)[1] for state in self.states):
            self._clearing = True
            return CommandResult.ACCEPTED
        permanent = self.limit.latch == "permanent"
        return CommandResult.NOT_CLEARABLE if permanent else CommandResult.CAUSE_PRESENT

    @property
    def responds(self) -> bool:
        """Whether it is red, and on, and does more than report."""
        return self.on and self.limit.response != "report" and any(state.red.tripped for state in self.states)

    def red(self, slot: int) -> bool:
        """Whether it is red for a mode of vibration; a point without slots speaks for all of them."""
        return self.states[slot if len(self.states) > 1 else 0].red.tripped

    def count(self, level: Level) -> int:
        """In how many slots it is at this level."""
        return sum(state.level is level for state in self.states)

    def take_over(self, other: "Watch") -> None:
        """Go on where another watch of the same limit stands."""
        self.states, self.on, self._clearing = other.states, other.on, other._clearing

    def save(self, into: FloatArray, at: int) -> int:
        """Write what is not as it was at first from this place on, into zeros; gives the place after it."""
        into[at], into[at + 1] = not self.on, self._clearing
        for start, state in enumerate(self.states):
            if state is not GREEN:
                place = at + 2 + STATE_SIZE * start
                into[place : place + STATE_SIZE] = (*state.yellow, *state.red)
        return at + self.size

    def restore(self, values: FloatArray, at: int) -> int:
        """Read the state from this place on; gives the place after it."""
        off, clearing, *trips = values[at : at + self.size].tolist()
        self.on, self._clearing = not off, bool(clearing)
        self.states = [_state(trips[i : i + STATE_SIZE]) for i in range(0, len(trips), STATE_SIZE)]
        return at + self.size

    def _applies(self, cells: Sequence[float], slot: int) -> bool:
        required = all(abs(cells[places[slot]]) > 0.0 for places in self._required)  # NaN is not known
        return required and all(cells[places[slot]] == 0.0 for places in self._excluded)


class Bank:
    """The watches of a table, in its order; those on the age of what is shown stand apart, for they are judged last."""

    def __init__(self, limits: Sequence[Limit]) -> None:
        self.watches = tuple(Watch(limit) for limit in limits)
        self.ages = tuple(watch for watch in self.watches if watch.limit.point == AGE_TICKS.name)
        self.others = tuple(watch for watch in self.watches if watch.limit.point != AGE_TICKS.name)
        self.size = sum(watch.size for watch in self.watches)

    def find(self, number: int) -> Watch | None:
        """The watch of the limit with this number."""
        return next((watch for watch in self.watches if watch.limit.number == number), None)

    def take_over(self, other: "Bank") -> None:
        """Go on where another bank stands, with each limit that is the same in both."""
        for watch in self.watches:
            before = other.find(watch.limit.number)
            if before is not None and before.limit == watch.limit:
                watch.take_over(before)

    def save(self, into: FloatArray, at: int) -> int:
        """Write the state of all watches from this place on, into zeros; gives the place after it."""
        for watch in self.watches:
            at = watch.save(into, at)
        return at

    def restore(self, values: FloatArray, at: int) -> int:
        """Read the state of all watches from this place on; gives the place after it."""
        for watch in self.watches:
            at = watch.restore(values, at)
        return at


def _places(name: str, slots: int) -> Sequence[int]:
    """Where a point lies on the board, for each slot of another point."""
    start = OFFSET[name]
    return range(start, start + slots) if POINT_BY_NAME[name].slots == slots else (start,) * slots


def _state(numbers: list[float]) -> LimitState:
    yellow, red = (Trip(bool(tripped), int(count), int(good)) for tripped, count, good in (numbers[:3], numbers[3:]))
    return LimitState(yellow, red)
