"""protect: fault protection over the board, once a tick; the only task that may call a mode valid."""

from collections.abc import Iterable

from fault.protection import Protection, Raised
from fsw.black_box import BlackBox
from fsw.tasks.state import NOTHING, Estimate, State
from telemetry.declaration import Severity
from telemetry.dictionary import ESTIMATE_TICK, OVERRUN


class Protect:
    """Hands a tick's causes to the protection, raises its events, and follows what it shows on the board.

    All that a decision depends on, and what came of it, goes into the black box.
    """

    name = "protect"

    def __init__(self, state: State, protection: Protection, box: BlackBox) -> None:
        self._state, self.protection, self._box = state, protection, box
        self._critical = 0  # critical events that the black box knows of
        self._good: Estimate | None = None  # the newest estimate that the protection took for good

    def init(self) -> None:
        """Nothing is valid yet; the search begins at the first tick."""
        self._follow(self.protection.begin(self._state.board))

    def run(self, tick: int, time_ns: int) -> None:
        """Decide this tick; commands of mode stand among the causes."""
        state, protection = self._state, self.protection
        causes, state.causes = state.causes, NOTHING
        self._box.before(tick, time_ns, state.board, causes, state.measured, state.new_estimate, protection)
        events = protection.step(state.board, tick, causes, state.measured, state.new_estimate)
        decided = any(raised.event.severity is Severity.CRITICAL for raised in events)
        if decided or state.events.critical != self._critical:
            self._box.trip()
        self._box.after(state.board, events)
        self._follow(events)
        self._critical = state.events.critical
        state.board.set(OVERRUN, 0)  # it was seen; the next one sets it again
        if state.new_estimate and state.estimate is not None:
            if protection.good_tick == state.estimate.tick:
                self._good = state.estimate
            newest = state.board.get(ESTIMATE_TICK) == state.estimate.tick
            state.shown = state.estimate if newest else self._good

    def _follow(self, events: Iterable[Raised]) -> None:
        state, protection = self._state, self.protection
        state.mode, state.held = protection.mode, protection.held
        for event, arguments in events:
            state.raise_event(event, *arguments)
