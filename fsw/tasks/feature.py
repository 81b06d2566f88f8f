"""feature: the cells of this tick's pair. Searches the whole image in ACQUIRE, looks near the prediction in TRACK."""

import numpy as np

from fault.modes import Cause, measures
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.acquisition import Prior, acquire
from fsw.vision.cells import paper_centres
from fsw.vision.rig import StereoRig
from telemetry.dictionary import DETECTED_LEFT, DETECTED_RIGHT, FlightMode
from telemetry.events import LOCK_ACQUIRED

NAN = float("nan")


class Feature:
    """Fills the tracker's cells; says LOCK_FOUND when a search has named every cell."""

    name = "feature"

    def __init__(self, state: State, rig: StereoRig, prior: Prior, table: VisionTable) -> None:
        self._state, self._rig, self._prior, self._table = state, rig, prior, table

    def init(self) -> None:
        """The kernels of both ways run once on dark images, so that no tick compiles anything."""
        left, right = (np.zeros_like(image) for image in (self._state.pair.left, self._state.pair.right))
        acquire(left, right, self._rig, self._state.tracker.grid, self._prior)
        self._state.tracker.start(self._prior.rotation, self._prior.translation_mm, left, right)
        if self._table.method == "paper":
            self._paper_centres()

    def run(self, tick: int, time_ns: int) -> None:
        """Measure the pair, if there is one and the mode says so."""
        state = self._state
        detected = (NAN, NAN)
        if state.pair.usable:
            if state.mode is FlightMode.ACQUIRE:
                state.measured = self._search()
            elif measures(state.mode):
                state.tracker.measure(state.pair.left, state.pair.right)
                state.measured = True
        if state.measured:
            if self._table.method == "paper":
                self._paper_centres()
            detected = state.tracker.detected()
        state.board.set(DETECTED_LEFT, detected[0])
        state.board.set(DETECTED_RIGHT, detected[1])

    def _search(self) -> bool:
        """Lost in space: find the grid, name the cells, begin to track. False if that failed or is not sure."""
        state, tracker, pair = self._state, self._state.tracker, self._state.pair
        found = acquire(pair.left, pair.right, self._rig, tracker.grid, self._prior)
        if not found.ok:
            return False
        count = tracker.start(found.rotation, found.translation_mm, pair.left, pair.right)
        if count < self._table.least_cells:
            return False
        state.causes |= Cause.LOCK_FOUND
        state.raise_event(LOCK_ACQUIRED, count)
        return True

    def _paper_centres(self) -> None:
        """Put the means of boundary pixels (Eq. 12) in the place of the fitted centres."""
        tracker = self._state.tracker
        for eye, image in enumerate((self._state.pair.left, self._state.pair.right)):
            tracker.replace_centres(eye, paper_centres(image, tracker.grid.dark, tracker.cell_area_px(eye)))
