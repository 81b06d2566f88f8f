"""reconstruct: matched cells to points in space with covariance, and their displacement history."""

import numpy as np

from fault.modes import Cause
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from telemetry.dictionary import EPIPOLAR_RMS_PX, MATCHED, REPROJECTION_RMS_PX
from telemetry.events import LOCK_LOST

NAN = float("nan")


class Reconstruct:
    """Triangulates, gates, and pushes one row of the history each tick: a tick without points is a row of NaN."""

    name = "reconstruct"

    def __init__(self, state: State, table: VisionTable) -> None:
        self._state, self.table = state, table
        self._row = np.full((state.tracker.grid.count, 3), NAN)
        self._few = 0  # ticks in a row with too few cells

    def init(self) -> None:
        """The kernels run once, so that no tick compiles anything."""
        self._state.tracker.reconstruct(np.zeros(self._state.tracker.grid.count, np.bool_))
        self._state.tracker.residuals()

    def run(self, tick: int, time_ns: int) -> None:
        """Points of this tick's pair, or NaN."""
        state = self._state
        if state.measured:
            self._points()
        else:
            self._row.fill(NAN)
            for point in (MATCHED, REPROJECTION_RMS_PX, EPIPOLAR_RMS_PX):
                state.board.set(point, NAN)
        state.history_time_ns.push(time_ns)
        state.history_mm.push(self._row)

    def _points(self) -> None:
        state, table = self._state, self.table
        count = state.tracker.reconstruct(state.matched, table.reprojection_gate_px, table.epipolar_gate_px)
        # Most of the cells that should be there must be there; fewer is no lock, whatever they say.
        few = count < max(table.least_cells, 0.5 * state.tracker.expected_count)
        if few:
            state.tracker.discard()
        np.copyto(self._row, state.tracker.points.xyz_mm)
        reprojection_px, epipolar_px = state.tracker.residuals()
        state.board.set(MATCHED, count)
        state.board.set(REPROJECTION_RMS_PX, reprojection_px)
        state.board.set(EPIPOLAR_RMS_PX, epipolar_px)
        self._few = self._few + 1 if few else 0
        if self._few >= table.lost_after_ticks:
            self._few = 0
            state.causes |= Cause.LOCK_LOST
            state.raise_event(LOCK_LOST, count)
