"""Protection: what a tick decides. Limits, mode machine and validity over the board, as a machine that can be saved.

A tick's decisions are a function of the saved state, the board, and the arguments of `step`: the black box keeps these
and replays them to the byte. Only protection says that a mode of vibration is valid.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fault.good_estimate import GoodEstimate
from fault.limits import Level, Limit, crossed
from fault.modes import Cause, may_be_valid, next_mode
from fault.watch import Bank, Change, Watch
from telemetry.board import OFFSET, Board
from telemetry.declaration import Event
from telemetry.dictionary import (
    AGE_TICKS,
    ESTIMATE_TICK,
    FLAGS,
    FREQUENCY_HZ,
    IDENTIFIED_FLAGS,
    LIMITS_DISABLED,
    LIMITS_RED,
    LIMITS_YELLOW,
    MODE,
    MODE_SLOTS,
    OBSERVABLE,
    POINT_NUMBER,
    SHADOW_TRIPS,
    TICKS,
    VALID,
    VALIDITY,
    CommandResult,
    FlightMode,
    ModeFlag,
)
from telemetry.events import LIMIT_CLEARED, LIMIT_RED, LIMIT_YELLOW, MODE_CHANGED, MODE_INVALID, MODE_VALID, SHADOW_RED
from telemetry.events import NOT_OBSERVABLE as QUIET
from telemetry.events import OBSERVABLE as MOVING

NAN = float("nan")
HEADER = 3  # mode, held, observable
LEVEL_EVENTS = (LIMIT_CLEARED, LIMIT_YELLOW, LIMIT_RED)
_AGE, _FLAGS, _FREQUENCY, _IDENTIFIED, _VALID = (
    OFFSET[point.name] for point in (AGE_TICKS, FLAGS, FREQUENCY_HZ, IDENTIFIED_FLAGS, VALID)
)


class Raised(NamedTuple):
    """An event to raise, with its arguments."""

    event: Event
    arguments: tuple[float, ...] = ()


class Protection:
    """Judges every tick. While an estimate has no usable mode, the last good one stays on the board, with its age.

    limits decide; shadow limits run beside them and are counted (SHADOW_TRIPS, SHADOW_RED), and touch nothing else.
    A limit switched off goes on being judged and told, but has no response. mode: of the flight. held: the board
    shows an older estimate than the newest one.
    """

    def __init__(self, limits: Sequence[Limit], shadow: Sequence[Limit] = ()) -> None:
        self.mode = FlightMode.INIT
        self.held = False
        self._observable = NAN  # at the newest estimate; NaN before the first
        self._good = GoodEstimate()
        self._limits, self._shadow = Bank(limits), Bank(shadow)
        self._changes: list[Change] = []
        self._events: list[Raised] = []

    @property
    def good_tick(self) -> float:
        """ESTIMATE_TICK of the last good estimate; NaN: there was none."""
        return self._good.tick

    @property
    def size(self) -> int:
        """Numbers in its state."""
        return HEADER + self._good.size + self._limits.size + self._shadow.size

    def save(self, into: NDArray[np.float64]) -> None:
        """Write the whole state into an array (size,)."""
        into.fill(0.0)
        into[:HEADER] = (self.mode, self.held, self._observable)
        self._shadow.save(into, self._limits.save(into, self._good.save(into, HEADER)))

    def restore(self, values: NDArray[np.float64]) -> None:
        """Take the whole state from an array (size,) that a protection with the same limits saved."""
        self.mode, self.held, self._observable = FlightMode(int(values[0])), bool(values[1]), float(values[2])
        self._shadow.restore(values, self._limits.restore(values, self._good.restore(values, HEADER)))

    def begin(self, board: Board) -> Sequence[Raised]:
        """All tasks are initialised: nothing is valid yet, and the search may begin at the first tick."""
        self._events.clear()
        for point in (TICKS, SHADOW_TRIPS, VALIDITY):
            board.set(point, 0)
        for slot in range(MODE_SLOTS):
            board.cells[_VALID + slot] = 0.0
        self._move(board, Cause.READY)
        self._count(board)
        return self._events

    def step(self, board: Board, tick: int, causes: Cause, new_frame: bool, new_estimate: bool) -> Sequence[Raised]:
        """Decide this tick; gives the events to raise, which stand until the next step.

        causes: what the tasks and the commands found. new_frame: this tick's pair was measured, so that the quality
        points are new. new_estimate: an estimate was delivered at this tick. What is not new sets and clears nothing.
        """
        self._events.clear()
        board.add(TICKS)
        fresh = {"tick": True, "frame": new_frame, "estimate": new_estimate}
        self._watch(board, fresh, self._limits.others, self._shadow.others)
        if new_estimate:
            self._tell_quiet(board.get(OBSERVABLE))
        self._move(board, causes | self._causes())
        if new_estimate:
            self._hold(board)
        self._age(board, tick)
        # The ages are those of what is shown: an estimate that was held back shows its own to nobody.
        self._watch(board, fresh, self._limits.ages, self._shadow.ages)
        self._mark(board)
        self._count(board)
        return self._events

    def clear_fault(self, number: int) -> CommandResult:
        """Command: clear what a limit tripped, at the next step. Refused while the cause is there."""
        watch = self._limits.find(number)
        return CommandResult.NO_SUCH_ITEM if watch is None else watch.clear()

    def switch(self, number: int, on: bool) -> CommandResult:
        """Command: give a limit its response, or take it away."""
        watch = self._limits.find(number)
        if watch is None:
            return CommandResult.NO_SUCH_ITEM
        watch.on = on
        return CommandResult.ACCEPTED

    def level(self, number: int, slot: int = 0) -> Level:
        """How bad the point of a limit is; GREEN for a number that no limit has."""
        watch = self._limits.find(number)
        return Level.GREEN if watch is None else watch.states[slot].level

    def renew(self, limits: Sequence[Limit], shadow: Sequence[Limit]) -> None:
        """Go on with other tables, between two ticks; a row that is the same as before keeps its state."""
        before, self._limits = self._limits, Bank(limits)
        self._limits.take_over(before)
        before, self._shadow = self._shadow, Bank(shadow)
        self._shadow.take_over(before)

    def _watch(self, board: Board, fresh: dict[str, bool], limits: Sequence[Watch], shadow: Sequence[Watch]) -> None:
        for change in self._judged(board.cells, fresh, limits):
            self._tell(LEVEL_EVENTS[change.after], change)
        for change in self._judged(board.cells, fresh, shadow):
            if change.after is Level.RED:
                board.add(SHADOW_TRIPS)
                self._tell(SHADOW_RED, change)

    def _judged(self, cells: Sequence[float], fresh: dict[str, bool], watches: Sequence[Watch]) -> list[Change]:
        self._changes.clear()
        for watch in watches:
            watch.step(cells, fresh[watch.limit.per], self._changes)
        return self._changes

    def _tell(self, event: Event, change: Change) -> None:
        threshold = crossed(change.limit, change.after or change.before, change.value)
        number = POINT_NUMBER[change.limit.point]
        self._events.append(Raised(event, (number, change.slot, change.value, threshold)))

    def _tell_quiet(self, observable: float) -> None:
        before, self._observable = self._observable, float(observable == 1.0)
        if abs(self._observable - before) == 1.0:  # not for the first, before which it is NaN
            self._events.append(Raised(MOVING if self._observable else QUIET))

    def _causes(self) -> Cause:
        """What the red limits ask of the mode machine."""
        asked = {watch.limit.response for watch in self._limits.watches if watch.responds}
        degraded = Cause.LIMIT_RED if "degrade" in asked else Cause.LIMITS_CLEAR
        return degraded | Cause.INHIBIT if "inhibit" in asked else degraded

    def _move(self, board: Board, causes: Cause) -> None:
        before, self.mode = self.mode, next_mode(self.mode, causes)
        board.set(MODE, self.mode)
        if self.mode is not before:
            self._events.append(Raised(MODE_CHANGED, (before, self.mode)))

    def _hold(self, board: Board) -> None:
        """A new estimate with a usable mode is the good one; one without is replaced on the board by the good one."""
        cells, gates = board.cells, self._gates(board, self._limits.others)
        good = any(usable and _identified(cells, slot) for slot, (usable, _) in enumerate(gates))
        self.held = not good and self._good.tick == self._good.tick
        if good:
            self._good.keep(cells)
        elif self.held:
            self._good.show(cells)

    def _gates(self, board: Board, watches: Sequence[Watch]) -> list[tuple[bool, ModeFlag]]:
        """For each slot: whether no gate forbids its use, and the flags of those that do."""
        observable = board.get(OBSERVABLE) == 1.0
        common = ModeFlag(0) if observable else ModeFlag.NOT_OBSERVABLE
        gates = [(observable and may_be_valid(self.mode), common)] * MODE_SLOTS
        for watch in watches:
            if watch.responds:
                for slot in (slot for slot in range(MODE_SLOTS) if watch.red(slot)):
                    gates[slot] = (False, gates[slot][1] | watch.flag)
        return gates

    def _age(self, board: Board, tick: int) -> None:
        age, cells = tick - board.get(ESTIMATE_TICK), board.cells
        for slot in range(MODE_SLOTS):
            frequency_hz = cells[_FREQUENCY + slot]
            cells[_AGE + slot] = age if frequency_hz == frequency_hz else NAN

    def _mark(self, board: Board) -> None:
        """Valid only if the identification, every limit and the mode agree."""
        cells = board.cells
        held = ModeFlag.HELD if self.held else ModeFlag(0)
        for slot, (usable, flags) in enumerate(self._gates(board, self._limits.watches)):
            frequency_hz, identified = cells[_FREQUENCY + slot], cells[_IDENTIFIED + slot]
            valid = usable and not self.held and _identified(cells, slot)
            bits = int(flags | held) | (int(identified) if identified == identified else 0)
            was_valid, cells[_VALID + slot] = cells[_VALID + slot] == 1.0, float(valid)
            cells[_FLAGS + slot] = bits if frequency_hz == frequency_hz else NAN
            if valid and not was_valid:
                self._events.append(Raised(MODE_VALID, (slot, frequency_hz)))
            elif was_valid and not valid:
                self._events.append(Raised(MODE_INVALID, (slot, bits)))
        board.set(VALIDITY, 1.0 in cells[_VALID : _VALID + MODE_SLOTS])

    def _count(self, board: Board) -> None:
        watches = self._limits.watches
        board.set(LIMITS_YELLOW, sum(watch.count(Level.YELLOW) for watch in watches))
        board.set(LIMITS_RED, sum(watch.count(Level.RED) for watch in watches))
        board.set(LIMITS_DISABLED, sum(not watch.on for watch in watches))


def _identified(cells: Sequence[float], slot: int) -> bool:
    """Whether this slot holds a mode that the identification raised no flag against."""
    return cells[_FREQUENCY + slot] > 0.0 and cells[_IDENTIFIED + slot] == 0.0
