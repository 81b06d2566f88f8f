"""TRACK: from a pair of images, and what was known before, to all cells in space. All memory is taken at the start."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.vision.approach import Approach
from fsw.vision.bow import make_bow
from fsw.vision.bridging import step_of
from fsw.vision.corners import view_cells
from fsw.vision.edges import COMMON, FloatArray, Image
from fsw.vision.fitting import make_normal
from fsw.vision.gating import Slip, count, mean_sides, rms
from fsw.vision.grid import CellGrid
from fsw.vision.prediction import make_surface, set_pose
from fsw.vision.reconstruction import make_pair, reconstruct_points
from fsw.vision.rig import StereoRig, eyes_of
from fsw.vision.settling import LEAST_NOISE
from fsw.vision.standing_in import SHAPE_SIGMA, drop_unseen, forget_size
from fsw.vision.stereo import Points, make_points
from fsw.vision.view import View, make_view, measure_view

ADAPTATION = 0.5  # share of a measured correction of blur and line width that is taken over in a tick
SETTLING_CELLS = 100  # that a blur which has jumped is settled with, about: part of the wing is out of view
START_PASSES = 8  # measurements that a start takes, at most, until they are settled: corrections taken over whole,
SETTLED = 2e-3  # the last one's smaller than this, in px of blur and relative width


@dataclass(frozen=True)
class TrackingOptions:
    """stride: the full fit takes every so many image columns of a long side.

    widest: a centre farther from the surface than this part of the smallest pitch is no cell, however much the others
    scatter: a view that took one row for the next would scatter more. blur_px: the lens's blur to start from
    (Gaussian standard deviation, without the pixel). threads: two measure the eyes side by side, a third sooner; one
    costs a quarter less processor time, for it need not be woken, with cold caches, in the middle of every tick.
    """

    stride: int = 2
    widest: float = 0.1
    blur_px: float = 0.7
    threads: int = 1


class Tracker:
    """State of the tracking between ticks: surface, blur, widths of the lines, and what each cell deviates by."""

    def __init__(self, rig: StereoRig, grid: CellGrid, options: TrackingOptions) -> None:
        count = grid.count
        self.rig, self.grid, self.options, self.eyes = rig, grid, options, eyes_of(rig)
        self.surface = make_surface(grid)
        self._normal = make_normal(count)
        self._bow = make_bow(grid, self.surface)
        self._approach = Approach(grid, self.eyes, self.surface, self._normal, options.threads)
        self.expected_px, self.expected_centre_px = self._approach.expected_px, self._approach.expected_centre_px
        self.in_view, self.wanted = self._approach.in_view, self._approach.wanted
        self.deviation_px = self._approach.deviation_px
        self.both = np.zeros(count, dtype=np.bool_)
        self.corners_px = np.full((2, count, 4, 2), np.nan)
        self.centre_px = np.full((2, count, 2), np.nan)
        self.covariance_px2 = np.full((2, count, 3), np.nan)
        pixels = self.corners_px, self.centre_px, self.covariance_px2
        self.cells = view_cells(0, *pixels), view_cells(1, *pixels)
        self.points: Points = make_points(count)
        self.blur_px = np.full((2, 2), options.blur_px)
        self.width_scale = np.ones((2, 2))
        self.noise, self.cell_size = np.zeros((2, 2)), np.zeros((2, 2, 2))
        self._forget_sizes()
        self._correction = np.zeros((2, COMMON))
        self._views = self._view(0), self._view(1)
        expected = self.expected_px, self.deviation_px, self.blur_px, self._approach.depth_mm
        self._pair = make_pair(self.cells, pixels, expected, grid.neighbour, grid.column)
        self._slip = Slip(grid, self.surface)
        self._widest_mm = options.widest * min(min(panel.pitch_mm) for panel in grid.panels)
        self._adaptation = ADAPTATION
        self._order = np.lexsort((grid.column, grid.cell[:, 2]))  # row by row
        self._few = np.ascontiguousarray(self._order[self._order % step_of(grid, SETTLING_CELLS) == 0])

    def place(self, rotation: FloatArray, translation_mm: FloatArray) -> None:
        """Expect the wing, flat and at rest, in this pose."""
        set_pose(self.surface, rotation, translation_mm)
        self._slip.forget()
        self._approach.forget()

    def start(self, rotation: FloatArray, translation_mm: FloatArray, left: Image, right: Image) -> int:
        """Begin from the wing's pose: bring surface, blur and widths of the lines near; returns the points found."""
        self.place(rotation, translation_mm)
        self.blur_px[:] = self.options.blur_px
        self.width_scale[:] = 1.0
        self._forget_sizes()
        found = 0
        self._adaptation = 1.0
        for one in range(START_PASSES):
            self.measure(left, right, sparse=one == 0)  # enough to begin with
            self.both_found()
            found = self.reconstruct(self.both)
            if one > 0 and np.abs(self._correction).max() < SETTLED:
                break
        self._adaptation = ADAPTATION
        self._slip.start()
        self.cell_size[:, :, 1] = SHAPE_SIGMA**2  # one pair does not show what they scatter by from tick to tick
        return found

    def adopt(self, scout: "Tracker") -> None:
        """Take over what another tracker of the same wing has settled: surface, blur, widths of the lines."""
        set_pose(self.surface, scout.surface.rotation, scout.surface.translation_mm)
        self.surface.unknowns[:] = scout.surface.unknowns
        self._slip.adopt(scout._slip)
        self._approach.adopt(scout._approach)
        self.blur_px[:] = scout.blur_px
        self.width_scale[:] = scout.width_scale
        self.cell_size[:] = scout.cell_size
        self.noise[:] = scout.noise

    def _view(self, eye: int) -> View:
        """One eye's share of the arrays."""
        expected = self.expected_px[eye], self.deviation_px[eye], self._approach.depth_mm[eye]
        lines = self._approach.line_ratio, self.grid.neighbour
        learnt = self.width_scale[eye], self.cell_size[eye], self.blur_px[eye], self.noise[eye], self._correction[eye]
        return make_view(expected, lines, learnt, self.cells[eye])

    def _forget_sizes(self) -> None:
        for eye in (0, 1):
            forget_size(self.cell_size[eye])
            self.noise[eye] = LEAST_NOISE, 0.0

    def measure(self, left: Image, right: Image, sparse: bool = False) -> None:
        """Find all cells, or a sparse part of them, near where they are expected in both images."""
        self._approach.bridge(left, right)
        if sparse:
            self._approach.thin()
        self._approach.both_eyes(self._measure, left, right)
        drop_unseen(*self.cells)

    def reconstruct(
        self, matched: NDArray[np.bool_], reprojection_gate_px: float = math.inf, epipolar_gate_px: float = math.inf
    ) -> int:
        """Triangulate the matched cells (N,), fit the surface, drop what lies off it; returns how many stay valid.

        None does once the surface has slipped: no wing moves half a cell in its plane, but a grid looks the same there.
        """
        stand = reconstruct_points(
            self.eyes,
            self.surface,
            self._normal,
            self._bow,
            self._pair,
            matched,
            self.wanted,
            reprojection_gate_px,
            epipolar_gate_px,
            self._widest_mm,
            self.points,
        )
        if self._slip.far():
            self.discard()
            return 0
        return int(stand)

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
        """End the thread of the right eye, if it has one."""
        self._approach.close()

    def _measure(self, eye: int, image: Image) -> None:
        cells = self.wanted, self._order, self._few
        fit = self.grid.dark, self.options.stride, self._adaptation
        measure_view(image, self.eyes, eye, self._views[eye], *cells, *fit)
