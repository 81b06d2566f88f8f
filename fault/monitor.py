"""The monitor: the limit table over the telemetry points, once a tick; says which modes may be used, and why not."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from fault.limits import GREEN, Level, Limit, LimitState, crossed, step
from fault.modes import Cause, may_be_valid
from telemetry.declaration import Event
from telemetry.dictionary import MODE_SLOTS, OBSERVABLE, POINT_BY_NAME, POINT_NUMBER, FlightMode, ModeFlag
from telemetry.events import LIMIT_CLEARED, LIMIT_RED, LIMIT_YELLOW
from telemetry.events import NOT_OBSERVABLE as QUIET
from telemetry.events import OBSERVABLE as MOVING


class Points(Protocol):
    """Where the monitor reads: values of points by name; NaN is not available."""

    def get(self, point: str, slot: int = 0, /) -> float:
        """Value of one slot of a point."""
        ...


class Raised(NamedTuple):
    """An event to raise, with its arguments."""

    event: Event
    arguments: tuple[float, ...] = ()


class Verdict(NamedTuple):
    """What the monitor says at a tick.

    usable[slot]: no gate of the monitor forbids to mark this mode valid. flags[slot]: bits of ModeFlag that tell
    why not. observable: the wing moves enough. cause: LIMIT_RED or LIMITS_CLEAR, for the mode machine.
    """

    usable: tuple[bool, ...]
    flags: tuple[ModeFlag, ...]
    observable: bool
    cause: Cause
    events: tuple[Raised, ...]


class Monitor:
    """Keeps the state of each limit, slot by slot."""

    def __init__(self, limits: Sequence[Limit]) -> None:
        self._limits = tuple(limits)
        self._slots = tuple(POINT_BY_NAME[limit.point].slots for limit in limits)
        self._flags = tuple(ModeFlag[limit.flag.upper()] if limit.flag else ModeFlag(0) for limit in limits)
        self._states: list[list[LimitState]] = [[GREEN] * slots for slots in self._slots]
        self._observable: bool | None = None

    def level(self, point: str, slot: int = 0) -> Level:
        """The worst level of the limits on this point."""
        levels = [
            states[slot].level for limit, states in zip(self._limits, self._states, strict=True) if limit.point == point
        ]
        return max(levels, default=Level.GREEN)

    def step(self, points: Points, mode: FlightMode, new_frame: bool, new_estimate: bool) -> Verdict:
        """Evaluate the limits.

        new_frame: this tick's pair was measured, so that the quality points are new. new_estimate: an estimate
        was delivered at this tick. What is not new neither sets nor clears anything.
        """
        fresh = {"tick": True, "frame": new_frame, "estimate": new_estimate}
        events: list[Raised] = []
        for index, limit in enumerate(self._limits):
            if fresh[limit.per]:
                for slot in range(self._slots[index]):
                    self._step_slot(points, index, limit, slot, events)
        observable = points.get(OBSERVABLE.name) == 1.0
        if new_estimate:
            if self._observable is not None and observable != self._observable:
                events.append(Raised(MOVING if observable else QUIET))
            self._observable = observable
        return self._judge(mode, observable, tuple(events))

    def _step_slot(self, points: Points, index: int, limit: Limit, slot: int, events: list[Raised]) -> None:
        before = self._states[index][slot]
        value = points.get(limit.point, slot)
        after = step(limit, before, value, applies=_applies(points, limit, slot))
        self._states[index][slot] = after
        if after.level is not before.level:
            event = (LIMIT_CLEARED, LIMIT_YELLOW, LIMIT_RED)[after.level]
            threshold = crossed(limit, after.level or before.level, value)
            events.append(Raised(event, (POINT_NUMBER[limit.point], slot, value, threshold)))

    def _judge(self, mode: FlightMode, observable: bool, events: tuple[Raised, ...]) -> Verdict:
        common = ModeFlag(0) if observable else ModeFlag.NOT_OBSERVABLE
        each = [ModeFlag(0)] * MODE_SLOTS
        allowed = [observable and may_be_valid(mode)] * MODE_SLOTS
        degraded = False
        for limit, flag, states in zip(self._limits, self._flags, self._states, strict=True):
            for slot, state in enumerate(states):
                if not state.red.tripped or limit.response == "report":
                    continue
                degraded |= limit.response == "degrade"
                for hit in (slot,) if len(states) > 1 else range(MODE_SLOTS):
                    allowed[hit] = False
                    each[hit] |= flag
        cause = Cause.LIMIT_RED if degraded else Cause.LIMITS_CLEAR
        return Verdict(tuple(allowed), tuple(flag | common for flag in each), observable, cause, events)


def _applies(points: Points, limit: Limit, slot: int) -> bool:
    """Whether the points that the limit requires are known and not 0."""
    for name in limit.requires:
        value = points.get(name, slot if POINT_BY_NAME[name].slots > 1 else 0)
        if not abs(value) > 0.0:
            return False
    return True
