"""search: lost in space. Finds the grid in a whole pair and names every cell, beside the ticks (ACQUIRE)."""

import numpy as np

from fault.modes import Cause
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.acquisition import Prior, acquire
from fsw.vision.rig import StereoRig
from fsw.vision.sketch import sketch
from fsw.vision.tracking import Tracker
from hal.frame import make_frames
from telemetry.dictionary import FlightMode
from telemetry.events import LOCK_ACQUIRED


class Search:
    """Sets a pair aside, searches it on the worker thread, and hands what it found to the tracker.

    The scout is a tracker of its own: it settles surface, blur and line widths on the pair that was searched. The
    wing has moved on when the result is delivered; the tracker's first look at the newest pair bridges that, or loses
    the lock.
    """

    name = "search"

    def __init__(self, state: State, rig: StereoRig, prior: Prior, table: VisionTable) -> None:
        self._state, self._rig, self._prior, self.table = state, rig, prior, table
        self._left, self._right = (make_frames(p.shape, p.dtype) for p in (state.pair.left, state.pair.right))
        self._scout = Tracker(rig, state.tracker.grid, state.tracker.options)
        self._found = 0

    def init(self) -> None:
        """All kernels of the search run once on a drawing of the wing, so that no tick compiles anything."""
        grid, pose = self._scout.grid, (self._prior.rotation, self._prior.translation_mm)
        images = [sketch(self._rig, eye, grid, *pose, self._left.dtype) for eye in (0, 1)]
        acquire(images[0], images[1], self._rig, grid, self._prior)
        self._scout.start(*pose, images[0], images[1])

    def take(self, tick: int) -> bool:
        """Copy the pair, if there is one and the grid is not known."""
        state = self._state
        if state.mode is not FlightMode.ACQUIRE or state.begun or not state.pair.usable:
            return False
        np.copyto(self._left, state.pair.left)
        np.copyto(self._right, state.pair.right)
        return True

    def work(self) -> None:
        """Find the grid and name the cells; nothing is found unless that is sure."""
        self._found = 0
        found = acquire(self._left, self._right, self._rig, self._scout.grid, self._prior)
        if found.ok:
            self._found = self._scout.start(found.rotation, found.translation_mm, self._left, self._right)

    def deliver(self, tick: int) -> None:
        """Begin to track from what was found."""
        state = self._state
        if state.mode is not FlightMode.ACQUIRE or self._found < self.table.least_cells:
            return
        state.tracker.adopt(self._scout)
        state.begun = True
        state.causes |= Cause.LOCK_FOUND
        state.raise_event(LOCK_ACQUIRED, self._found)

    def close(self) -> None:
        """End the scout's thread."""
        self._scout.close()
