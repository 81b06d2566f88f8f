"""TRACK: from a pair of images, and what was known before, to all cells in space. All memory is taken at the start."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.vision.blur import STEP_ROWS, tabulate_step
from fsw.vision.bridging import (
    AS_BEFORE,
    CONFIRMED,
    MOST_STEPS,
    SWING_MM,
    TRIED_CELLS,
    confirmed,
    swing,
    swing_step_mm,
)
from fsw.vision.edges import FloatArray, Image, make_scratch
from fsw.vision.gating import count, deviate, gate_columns, gate_points, gate_residuals, mean_sides, rms
from fsw.vision.grid import CellGrid, line_ratios
from fsw.vision.prediction import FEW, UNKNOWNS, expect, fit_surface, make_normal, make_surface, set_pose
from fsw.vision.quads import Cells, adapt, make_cells, measure_cells
from fsw.vision.rig import StereoRig, eyes_of
from fsw.vision.search import look, make_sightings, settle
from fsw.vision.sides import Lens
from fsw.vision.stereo import Points, make_points, triangulate_cells

PIXEL_VARIANCE = 1.0 / 12.0  # of the average over one pixel: what the sensor adds to the lens's blur
ADAPTATION = 0.5  # share of a measured correction of blur and line width that is taken over in a tick
START_PASSES = 2  # measurements that a start takes to settle them, corrections taken over whole


@dataclass(frozen=True)
class TrackingOptions:
    """stride: measure every so many image columns of a long side.

    widest: a centre farther from the surface than this part of the smallest pitch is no cell, however much the others
    scatter: a view that took one row for the next would scatter more. blur_px: the lens's blur to start from
    (Gaussian standard deviation, without the pixel).
    """

    stride: int = 2
    widest: float = 0.1
    blur_px: float = 0.7


class Tracker:
    """State of the tracking between ticks: surface, blur, widths of the lines, and what each cell deviates by."""

    def __init__(self, rig: StereoRig, grid: CellGrid, options: TrackingOptions) -> None:
        count = grid.count
        self.rig, self.grid, self.options, self.eyes = rig, grid, options, eyes_of(rig)
        self.surface = make_surface(grid)
        self.line_ratio, self.bordering = line_ratios(grid), np.ascontiguousarray(grid.neighbour < 0)
        self.sightings = make_sightings(count)
        self.expected_px = np.zeros((2, count, 4, 2))
        self.expected_centre_px = np.zeros((2, count, 2))
        self.in_view = np.zeros((2, count), dtype=np.bool_)
        self.wanted = np.zeros(count, dtype=np.bool_)  # cells whose centres both eyes should see
        self.both = np.zeros(count, dtype=np.bool_)
        self.deviation_px = np.zeros((2, count, 4, 2))  # of the measured corners from the surface, last tick
        self.corners_px = np.full((2, count, 4, 2), np.nan)
        self.centre_px = np.full((2, count, 2), np.nan)
        self.covariance_px2 = np.full((2, count, 3), np.nan)
        self.cells = (self._cells(0), self._cells(1))
        self.points: Points = make_points(count)
        self.distance_mm = np.full(count, np.nan)
        self.blur_px = np.full(2, options.blur_px)
        self.width_scale = np.ones((2, 2))
        self._scratch = (make_scratch(), make_scratch())
        self._steps = np.zeros((2, STEP_ROWS, 3))
        self._normal = make_normal(count)
        self._widest_mm = options.widest * min(min(panel.pitch_mm) for panel in grid.panels)
        self._before = np.zeros(UNKNOWNS)  # the surface of the frame before this one's
        self._origin, self._trial, self._best = np.zeros(UNKNOWNS), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
        self._adaptation = ADAPTATION
        self._share = 1.0  # of the lines, by which the last frame confirmed the surface
        self._swing, self._tried_step = swing(), max(1, count // TRIED_CELLS)
        self._column = grid.column
        self._work = np.zeros((max(8, int(grid.column[-1]) + 1), 3))
        self._second = ThreadPoolExecutor(max_workers=1, thread_name_prefix="right-eye")

    def _cells(self, eye: int) -> Cells:
        """One eye's results, whose pixels are views of the arrays of both eyes."""
        own = make_cells(self.grid.count)
        return own._replace(
            corners_px=self.corners_px[eye],
            centre_px=self.centre_px[eye],
            covariance_px2=self.covariance_px2[eye],
        )

    def place(self, rotation: FloatArray, translation_mm: FloatArray) -> None:
        """Expect the wing, flat and at rest, in this pose."""
        set_pose(self.surface, rotation, translation_mm)
        self._before[:] = 0.0
        self._share = 1.0
        self.deviation_px[:] = 0.0

    def start(self, rotation: FloatArray, translation_mm: FloatArray, left: Image, right: Image) -> int:
        """Begin from the wing's pose: bring surface, blur and widths of the lines near; returns the points found."""
        self.place(rotation, translation_mm)
        self.blur_px[:] = self.options.blur_px
        self.width_scale[:] = 1.0
        found = 0
        self._adaptation = 1.0
        for _ in range(START_PASSES):
            self.measure(left, right)
            self.both_found()
            found = self.reconstruct(self.both)
        self._adaptation = ADAPTATION
        return found

    def adopt(self, scout: "Tracker") -> None:
        """Take over what another tracker of the same wing has settled: surface, blur, widths of the lines."""
        set_pose(self.surface, scout.surface.rotation, scout.surface.translation_mm)
        self.surface.unknowns[:] = self._before[:] = scout.surface.unknowns
        self._share = scout._share
        self.blur_px[:] = scout.blur_px
        self.width_scale[:] = scout.width_scale
        self.deviation_px[:] = scout.deviation_px

    def measure(self, left: Image, right: Image) -> None:
        """Find all cells near where they are expected in both images."""
        self._bridge(left, right)
        # What the few unknowns of the bridge cannot follow, all of them do, now that every line is the right one.
        self._meet(left, right, 1, UNKNOWNS)
        self._expect()
        self._both(self._measure, left, right)

    def reconstruct(
        self, matched: NDArray[np.bool_], reprojection_gate_px: float = math.inf, epipolar_gate_px: float = math.inf
    ) -> int:
        """Triangulate the matched cells (N,), fit the surface, drop what lies off it; returns how many stay valid."""
        triangulate_cells(
            self.eyes, self.corners_px, self.centre_px, self.covariance_px2, matched, self._work, self.points
        )
        points = self.points
        gate_residuals(points, reprojection_gate_px, epipolar_gate_px)
        gate_mm = fit_surface(
            self.surface,
            points.xyz_mm,
            points.sigma_mm,
            points.valid,
            self._widest_mm,
            self._normal,
            self.distance_mm,
        )
        gate_points(points, self.distance_mm, gate_mm, self._widest_mm)
        valid = gate_columns(points, self.distance_mm, self._column, self._work)
        expect(self.surface, self.eyes, self.expected_px, self.expected_centre_px, self.in_view)
        for eye in (0, 1):
            deviate(self.cells[eye], self.expected_px[eye], self.points.valid, self.deviation_px[eye])
        return int(valid)

    def discard(self) -> None:
        """Let no point of this frame stand."""
        points = self.points
        points.valid[:] = False
        points.xyz_mm[:] = points.sigma_mm[:] = np.nan

    def detected(self) -> tuple[int, int]:
        """Number of cells found in the left and in the right image."""
        return count(self.cells[0].found), count(self.cells[1].found)

    def residuals(self) -> tuple[float, float]:
        """Rms reprojection error and rms epipolar distance over the valid points, px; NaN without points."""
        points = self.points
        return rms(points.reprojection_px, points.valid), rms(points.epipolar_px, points.valid)

    @property
    def expected_count(self) -> int:
        """Number of cells whose centres both eyes should see."""
        return int(count(self.wanted))

    def both_found(self) -> int:
        """Number of cells found in both images."""
        np.logical_and(self.cells[0].found, self.cells[1].found, out=self.both)
        return int(count(self.both))

    def cell_side_px(self, eye: int) -> float:
        """Mean length of the cells' smaller sides in this eye, as expected; 0 without cells in view."""
        along_x, along_y = mean_sides(self.expected_px[eye], self.wanted)
        return float(min(along_x, along_y))

    def px_per_mm(self, eye: int) -> float:
        """Mean scale of the cells in view of this eye; 0 without."""
        along_x, along_y = mean_sides(self.expected_px[eye], self.wanted)
        size = self.grid.panels[0].cell_mm
        return float(0.5 * (along_x / size[0] + along_y / size[1]))

    def close(self) -> None:
        """End the thread of the right eye."""
        self._second.shutdown()

    def _expect(self) -> None:
        expect(self.surface, self.eyes, self.expected_px, self.expected_centre_px, self.in_view)
        np.logical_and(self.in_view[0], self.in_view[1], out=self.wanted)
        np.add(self.expected_px, self.deviation_px, out=self.expected_px)

    def _bridge(self, left: Image, right: Image) -> None:
        """Bring the surface to where the lines confirm it, from the place before; unconfirmed, to the best found."""
        now = self.surface.unknowns
        self._origin[:] = now
        enough = max(CONFIRMED, AS_BEFORE * self._share)
        best = self._try(now, left, right, -1.0)
        if best < enough:
            np.multiply(self._origin, 2.0, out=self._trial)
            np.subtract(self._trial, self._before, out=self._trial)
            best = self._try(self._trial, left, right, best)
        if best < enough:
            now[:] = self._origin
            self._expect()
            step_mm = swing_step_mm(self.surface, self.eyes, self.expected_px, self.wanted, self._swing)
            steps = int(min(SWING_MM / step_mm, MOST_STEPS)) if step_mm > 0.0 else 0
            for i in range(1, steps + 1):
                for away_mm in (i * step_mm, -i * step_mm):
                    np.multiply(self._swing, away_mm, out=self._trial)
                    np.add(self._trial, self._origin, out=self._trial)
                    best = self._try(self._trial, left, right, best)
                if best >= enough:
                    break
        self._before[:] = self._origin
        self._share = best
        now[:] = self._best

    def _try(self, trial: FloatArray, left: Image, right: Image, best: float) -> float:
        """Share of the lines that confirm a place of the surface, or the best so far; the better place is kept."""
        self.surface.unknowns[:] = trial
        step = self._tried_step
        self._meet(left, right, step, FEW)
        self._expect()
        self._both(self._look, left, right, step)
        share = confirmed(self.sightings, self.expected_px, self.wanted, self.bordering, step)
        if share > best:
            self._best[:] = self.surface.unknowns
            return float(share)
        return best

    def _meet(self, left: Image, right: Image, step: int, unknowns: int) -> None:
        """Look at every step-th cell's lines, and move so many unknowns of the surface to meet them."""
        self._expect()
        self._both(self._look, left, right, step)
        settle(self.surface, self.eyes, self.sightings, unknowns, self._normal)

    def _both(self, work: Callable[[int, Image, int], None], left: Image, right: Image, step: int = 1) -> None:
        other = self._second.submit(work, 1, right, step)
        work(0, left, step)
        other.result()

    def _look(self, eye: int, image: Image, step: int) -> None:
        sign = 1.0 if self.grid.dark else -1.0
        look(
            image,
            self.eyes,
            eye,
            self.expected_px[eye],
            self.wanted,
            self.line_ratio,
            self.bordering,
            sign,
            step,
            self.sightings,
        )

    def _measure(self, eye: int, image: Image, step: int) -> None:
        blur = float(self.blur_px[eye])
        tabulate_step(blur, self._steps[eye])
        whole = math.sqrt(blur * blur + PIXEL_VARIANCE)
        lens = Lens(self.eyes.intrinsics[eye], self.eyes.distortion[eye], whole, self._steps[eye])
        measure_cells(
            image,
            lens,
            self.expected_px[eye],
            self.wanted,
            self.line_ratio,
            self.bordering,
            self.width_scale[eye],
            self.grid.dark,
            step * self.options.stride,
            self._scratch[eye],
            self.cells[eye],
        )
        adapt(self._scratch[eye].pooled, self._adaptation, self.blur_px, self.width_scale, eye)
