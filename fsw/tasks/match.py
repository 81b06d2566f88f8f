"""match: which cell of the left image is which of the right one and of the frame before, and how good the scene is."""

import numpy as np

from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.descriptor import describe as rpd
from fsw.vision.descriptor import find_borders
from fsw.vision.descriptor import match as match_by_rpd
from fsw.vision.enhancement import char
from fsw.vision.matching import (
    SAME,
    count_correct,
    make_matching,
    match_views,
    queue_variance,
)
from fsw.vision.quality import comprehensive, match_quality
from telemetry.dictionary import CHAR, CMP, MU, PRECISION, RECALL

NAN = float("nan")
LEFT, RIGHT = 0, 1


class Match:
    """Descriptors in the equivalent view (Eq. 13, 21-23), matches, and char, P, R, MU, CMP (Eq. 15-30)."""

    name = "match"

    def __init__(self, state: State, table: VisionTable) -> None:
        self._state, self.table = state, table
        grid = state.tracker.grid
        panel, _, row = grid.cell.T
        panels = grid.panels
        self._pitch_mm = np.array([panels[p].pitch_mm for p in panel])
        # The boundary before a cell: where its panel begins along X (root or fold gap), and the lower one along Y.
        self._boundary_mm = np.array([panels[p].origin_mm for p in panel])
        rows = np.cumsum([0, *(p.rows for p in panels)])
        self._column, self._row = grid.column, rows[panel] + row
        self._work = make_matching(grid.count, int(max(grid.column[-1] + 1, rows[-1])))
        self._flat_mm = np.ascontiguousarray(grid.centre_mm)
        state.matched = np.zeros(grid.count, np.bool_)

    def init(self) -> None:
        """The kernels run once, so that no tick compiles anything."""
        self._measure()
        self._work.before_mm.fill(NAN)

    def run(self, tick: int, time_ns: int) -> None:
        """Match this tick's cells; without a measured pair there is nothing to compare with in the next frame."""
        if self._state.measured:
            self._measure()
            return
        self._work.before_mm.fill(NAN)
        self._state.matched.fill(False)
        for point in (CHAR, MU, CMP, PRECISION, RECALL):
            self._state.board.set(point, NAN)

    def _measure(self) -> None:
        state, work, tracker = self._state, self._work, self._state.tracker
        expected = tracker.expected_centre_px, self._flat_mm, tracker.wanted
        found = tracker.cells[LEFT].found, tracker.cells[RIGHT].found
        on_wing = self._boundary_mm, self._pitch_mm
        match_views(*expected, tracker.centre_px, found, *on_wing, work, state.matched)
        detected = tracker.both_found()
        if self.table.method == "paper":
            self._as_printed()
        side_px = tracker.cell_side_px(RIGHT)
        correct = count_correct(work, tracker.centre_px[LEFT], tracker.centre_px[RIGHT], state.matched, side_px)
        self._judge(correct, detected, tracker.expected_count)

    def _as_printed(self) -> None:
        """Match by the paper's own descriptor: boundaries from the statistics of the points in view of each eye."""
        grid, matched = self._state.tracker.grid, self._state.matched
        places, described = [], []
        for eye in (LEFT, RIGHT):
            index = np.flatnonzero(self._state.tracker.cells[eye].found)
            xy = self._work.descriptor_mm[eye][index] + self._boundary_mm[index]
            borders = find_borders(xy, grid.panels[0].pitch_mm)
            if borders is None:
                matched.fill(False)
                return
            places.append(index)
            described.append(rpd(xy, borders))
        pairs = match_by_rpd(described[LEFT], described[RIGHT], SAME * float(self._pitch_mm.min()))
        left, right = places[LEFT][pairs[:, 0]], places[RIGHT][pairs[:, 1]]
        both = matched.copy()
        matched.fill(False)
        matched[left[left == right]] = True
        matched &= both

    def _judge(self, correct: int, detected: int, total: int) -> None:
        """Eq. 15-30; detected: cells found in both eyes; total: cells whose centres both eyes should see."""
        state, work = self._state, self._work
        quality = match_quality(total, detected, correct, self.table.precision_weight)
        scale = state.tracker.px_per_mm(LEFT)
        left = work.descriptor_mm[LEFT]
        in_column = queue_variance(left[:, 0], self._column, state.matched, scale, work.queue)
        in_row = queue_variance(left[:, 1], self._row, state.matched, scale, work.queue)
        scene = char(in_column, in_row)
        state.board.set(CHAR, scene)
        state.board.set(MU, quality.uniqueness)
        state.board.set(CMP, comprehensive(scene, quality.uniqueness))
        state.board.set(PRECISION, quality.precision)
        state.board.set(RECALL, quality.recall)
