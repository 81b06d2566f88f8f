"""feature: the cells of this tick's pair, near where the tracker expects them (TRACK)."""

from fault.modes import measures
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.printed import use_printed_centres
from telemetry.dictionary import DETECTED_LEFT, DETECTED_RIGHT

NAN = float("nan")


class Feature:
    """Fills the tracker's cells; by fitted edges, or also by the paper's means of boundary pixels."""

    name = "feature"

    def __init__(self, state: State, table: VisionTable) -> None:
        self._state, self.table = state, table

    def init(self) -> None:
        """The kernels run once on dark images, so that no tick compiles anything."""
        self._measure()

    def run(self, tick: int, time_ns: int) -> None:
        """Measure the pair, if there is one and it is known where to look."""
        state = self._state
        state.measured = state.pair.usable and (state.begun or measures(state.mode))
        state.begun = False
        detected = (NAN, NAN)
        if state.measured:
            self._measure()
            detected = state.tracker.detected()
        state.board.set(DETECTED_LEFT, detected[0])
        state.board.set(DETECTED_RIGHT, detected[1])

    def _measure(self) -> None:
        tracker, pair = self._state.tracker, self._state.pair
        tracker.measure(pair.left, pair.right)
        if self.table.method == "paper":
            use_printed_centres(tracker, pair.left, pair.right)
