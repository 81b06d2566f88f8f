"""feature: the cells of this tick's pair, near where the tracker expects them (TRACK)."""

from fault.modes import measures
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.cells import paper_centres
from telemetry.dictionary import DETECTED_LEFT, DETECTED_RIGHT

NAN = float("nan")


class Feature:
    """Fills the tracker's cells; by fitted edges, or also by the paper's means of boundary pixels."""

    name = "feature"

    def __init__(self, state: State, table: VisionTable) -> None:
        self._state, self._table = state, table

    def init(self) -> None:
        """The kernels run once on dark images, so that no tick compiles anything."""
        self._state.tracker.measure(self._state.pair.left, self._state.pair.right)
        if self._table.method == "paper":
            self._paper_centres()

    def run(self, tick: int, time_ns: int) -> None:
        """Measure the pair, if there is one and it is known where to look."""
        state = self._state
        detected = (NAN, NAN)
        if state.pair.usable and (state.begun or measures(state.mode)):
            state.tracker.measure(state.pair.left, state.pair.right)
            state.measured = True
        state.begun = False
        if state.measured:
            if self._table.method == "paper":
                self._paper_centres()
            detected = state.tracker.detected()
        state.board.set(DETECTED_LEFT, detected[0])
        state.board.set(DETECTED_RIGHT, detected[1])

    def _paper_centres(self) -> None:
        """Put the means of boundary pixels (Eq. 12) in the place of the fitted centres."""
        tracker = self._state.tracker
        for eye, image in enumerate((self._state.pair.left, self._state.pair.right)):
            tracker.replace_centres(eye, paper_centres(image, tracker.grid.dark, tracker.cell_area_px(eye)))
