"""From one frame to the next: both eyes look for lines, and the surface goes where they confirm it."""

import math
from collections.abc import Callable

import numpy as np

from fsw.vision.beside import Beside
from fsw.vision.bridging import (
    AS_BEFORE,
    CONFIRMED,
    LOOKED_CELLS,
    MET_PX,
    MOST_STEPS,
    NEAR_PX,
    STILL_PX,
    SURPRISE,
    SWING_MM,
    TRIED_CELLS,
    step_of,
    swing,
    swing_step_mm,
)
from fsw.vision.edges import FloatArray, Image
from fsw.vision.fitting import Normal
from fsw.vision.grid import CellGrid, line_ratios
from fsw.vision.meeting import Lines, expect_lines, meet_lines, see_lines, try_place
from fsw.vision.prediction import FEW, UNKNOWNS, Surface
from fsw.vision.rig import Eyes
from fsw.vision.search import make_sightings


class Approach:
    """Where the cells are expected, and how the surface is brought there; one thread for each eye, or one for both.

    expected_px (2, N, 4, 2), expected_centre_px (2, N, 2): ideal pixels. depth_mm (2, N, 4): of the corners. in_view
    (2, N). wanted (N,): cells whose centres both eyes should see. deviation_px (2, N, 4, 2): of the measured corners
    from the surface, last tick.
    """

    def __init__(self, grid: CellGrid, eyes: Eyes, surface: Surface, normal: Normal, threads: int) -> None:
        count = grid.count
        self.expected_px, self.deviation_px = np.zeros((2, 2, count, 4, 2))
        self.expected_centre_px = np.zeros((2, count, 2))
        self.in_view = np.zeros((2, count), dtype=np.bool_)
        self.wanted = np.zeros(count, dtype=np.bool_)
        self.surface, self.eyes, self._normal = surface, eyes, normal
        self.line_ratio = line_ratios(grid)
        self.depth_mm = np.ones((2, count, 4))
        expected = self.expected_px, self.depth_mm, self.expected_centre_px, self.in_view, self.wanted
        self.lines = Lines(*expected, self.deviation_px, self.line_ratio, grid.neighbour, make_sightings(count))
        self._sign = 1.0 if grid.dark else -1.0
        self._before = np.zeros(UNKNOWNS)  # the surface of the frame before this one's
        self._origin, self._trial, self._best = np.zeros(UNKNOWNS), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
        self._share = 1.0  # of the lines, by which the last frame confirmed the surface
        self._moved_px = NEAR_PX  # how far the lines moved since the frame before, at most
        self._swing = swing()
        self._tried_step, self._looked_step = step_of(grid, TRIED_CELLS), step_of(grid, LOOKED_CELLS)
        self._chequered = grid.cell.sum(axis=1) % 2 == 0
        self._right = Beside("right-eye") if threads > 1 else None

    def forget(self) -> None:
        """Take the surface as it is, without a history."""
        self._before[:] = 0.0
        self._share = 1.0
        self._moved_px = NEAR_PX
        self.deviation_px[:] = 0.0

    def adopt(self, other: "Approach") -> None:
        """Take over another one's history, as if the surface had stood still."""
        self._before[:] = other.surface.unknowns
        self._share, self._moved_px = other._share, other._moved_px
        self.deviation_px[:] = other.deviation_px

    def close(self) -> None:
        """End the thread of the right eye, if it has one."""
        if self._right is not None:
            self._right.close()

    def both_eyes(self, work: Callable[[int, Image], None], left: Image, right: Image) -> None:
        """Do the same work for both eyes, each on its thread, or one after the other."""
        if self._right is None:
            work(0, left)
            work(1, right)
            return
        self._right.begin(work, 1, right)
        try:
            work(0, left)
        finally:
            self._right.wait()

    def bridge(self, left: Image, right: Image) -> None:
        """Bring the surface to where the lines confirm it, from the place before; unconfirmed, to the best found."""
        now = self.surface.unknowns
        self._origin[:] = now
        enough = max(CONFIRMED, AS_BEFORE * self._share)
        near_px = min(STILL_PX + SURPRISE * self._moved_px, NEAR_PX)
        best = self._try(now, left, right, -1.0, enough, self._looked_step, near_px)
        found = best >= enough
        if not found:
            best = self._search(left, right, best, enough)
        # What the few unknowns of a trial cannot follow, all of them do, now that every line is the right one.
        if not found or self._moved_px > MET_PX:
            within_px = NEAR_PX if best < enough else MET_PX
            step = self._looked_step
            see_lines(left, right, self.surface, self.eyes, self.lines, self._sign, step, within_px)
        meet_lines(self.surface, self.eyes, self.lines, UNKNOWNS, self._normal)
        if not found:
            self._moved_px = NEAR_PX  # whatever the trials moved it by
        self._before[:] = self._origin
        self._share = best

    def thin(self) -> None:
        """Want every other cell only, as on a chessboard: half of them tell of blur and widths well enough."""
        np.logical_and(self.wanted, self._chequered, out=self.wanted)

    def _search(self, left: Image, right: Image, best: float, enough: float) -> float:
        """Bring the surface, which is not where it was, to where enough of the lines confirm it, or to the best found.

        Returns by which share of the lines.
        """
        now, step = self.surface.unknowns, self._tried_step
        for within_px in (NEAR_PX, math.inf):
            if best < enough:
                best = self._try(self._origin, left, right, best, enough, step, within_px)
        if best < enough:
            np.multiply(self._origin, 2.0, out=self._trial)
            np.subtract(self._trial, self._before, out=self._trial)
            best = self._try(self._trial, left, right, best, enough, step)
        if best < enough:
            now[:] = self._origin
            expect_lines(self.surface, self.eyes, self.lines)
            step_mm = swing_step_mm(self.surface, self.eyes, self.expected_px, self.wanted, self._swing)
            steps = int(min(SWING_MM / step_mm, MOST_STEPS)) if step_mm > 0.0 else 0
            for i in range(1, steps + 1):
                for away_mm in (i * step_mm, -i * step_mm):
                    np.multiply(self._swing, away_mm, out=self._trial)
                    np.add(self._trial, self._origin, out=self._trial)
                    best = self._try(self._trial, left, right, best, enough, step)
                if best >= enough:
                    break
        now[:] = self._best
        return best

    def _try(
        self,
        trial: FloatArray,
        left: Image,
        right: Image,
        best: float,
        enough: float,
        step: int,
        within_px: float = math.inf,
    ) -> float:
        """Share of the lines that confirm a place of the surface, or the best so far; the better place is kept.

        enough: less, and the lines are looked for again from where the first look has moved the surface to.
        """
        self.surface.unknowns[:] = trial
        where = self.surface, self.eyes, self.lines
        share, self._moved_px = try_place(left, right, *where, self._sign, step, FEW, within_px, enough, self._normal)
        if share > best:
            self._best[:] = self.surface.unknowns
            return float(share)
        return best
