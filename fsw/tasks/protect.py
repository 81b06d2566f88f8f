"""protect: limits and mode machine over the telemetry points; the only task that may call a mode valid."""

from fault.modes import Cause, next_mode
from fault.monitor import Monitor, Verdict
from fsw.tasks.identify import show
from fsw.tasks.state import NOTHING, Estimate, State
from telemetry.dictionary import (
    AGE_TICKS,
    FLAGS,
    MODE,
    MODE_SLOTS,
    OBSERVABLE,
    TICKS,
    VALID,
    VALIDITY,
    ModeFlag,
    flag_bits,
)
from telemetry.events import MODE_CHANGED, MODE_INVALID, MODE_VALID

NAN = float("nan")


class Protect:
    """Judges every tick. When an estimate has no valid mode, the last good one stays on the board, with its age."""

    name = "protect"

    def __init__(self, state: State, monitor: Monitor) -> None:
        self._state, self._monitor = state, monitor
        self._good: Estimate | None = None  # the newest estimate with a valid mode
        self._was_valid = [False] * MODE_SLOTS
        self._ticks = 0

    def init(self) -> None:
        """Nothing is valid yet; the search begins at the first tick."""
        board = self._state.board
        board.set(VALIDITY, 0)
        self._move(Cause.READY)
        for slot in range(MODE_SLOTS):
            board.set(VALID, 0, slot)

    def run(self, tick: int, time_ns: int) -> None:
        """Step the limits, then the mode, then the validity of every mode."""
        state = self._state
        self._ticks += 1
        state.board.set(TICKS, self._ticks)
        self._age(tick)
        verdict = self._monitor.step(state.board, state.mode, state.measured, state.new_estimate)
        for event, arguments in verdict.events:
            state.raise_event(event, *arguments)
        self._move(state.causes | verdict.cause)
        state.causes = NOTHING
        self._keep_good(verdict, tick)
        self._mark(verdict)

    def _age(self, tick: int) -> None:
        shown = self._state.shown
        count = len(shown.result.modes) if shown else 0
        for slot in range(MODE_SLOTS):
            self._state.board.set(AGE_TICKS, tick - shown.tick if shown and slot < count else NAN, slot)

    def _move(self, causes: Cause) -> None:
        state = self._state
        before, state.mode = state.mode, next_mode(state.mode, causes)
        state.board.set(MODE, state.mode)
        if state.mode is not before:
            state.raise_event(MODE_CHANGED, before, state.mode)

    def _keep_good(self, verdict: Verdict, tick: int) -> None:
        """A new estimate with a valid mode is the good one; one without is replaced on the board by the good one."""
        state, estimate = self._state, self._state.estimate
        if not state.new_estimate or estimate is None:
            return
        valid = any(m.valid and verdict.usable[s] for s, m in enumerate(estimate.result.modes))
        if valid or self._good is None:
            self._good = estimate if valid else self._good
            state.held = False
        else:
            state.held = True
            observable = state.board.get(OBSERVABLE)
            show(state, self._good)
            state.board.set(OBSERVABLE, observable)  # that belongs to now, not to then
            self._age(tick)

    def _mark(self, verdict: Verdict) -> None:
        """Valid only if the identification, every limit and the mode agree."""
        state = self._state
        modes = state.shown.result.modes if state.shown else []
        any_valid = False
        for slot in range(MODE_SLOTS):
            mode = modes[slot] if slot < len(modes) else None
            valid = mode is not None and mode.valid and verdict.usable[slot] and not state.held
            flags = verdict.flags[slot] | (flag_bits(mode.flags) if mode else 0) | (ModeFlag.HELD if state.held else 0)
            state.board.set(VALID, int(valid), slot)
            state.board.set(FLAGS, int(flags) if mode else NAN, slot)
            any_valid |= valid
            if valid != self._was_valid[slot]:
                self._was_valid[slot] = valid
                if valid and mode is not None:
                    state.raise_event(MODE_VALID, slot, mode.frequency_hz)
                else:
                    state.raise_event(MODE_INVALID, slot, int(flags))
        state.board.set(VALIDITY, int(any_valid))
