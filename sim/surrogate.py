"""Vision for the small world: what the real tasks make of real images, made of its images at a hundredth of the cost.

The tasks search, feature, match and reconstruct fill the same points, raise the same events and cause the same
transitions as the real ones; feature and reconstruct are the real ones over a tracker that reads the small world's
images. What an image does not show is not measured: eye, moment of exposure and bump are read from it, cells are found
by their contrast.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fault.modes import Cause
from fsw.executive.entry import FrameTask, LongTask
from fsw.parts import MakeVision
from fsw.tables.flight import VisionTable
from fsw.tasks.feature import Feature
from fsw.tasks.reconstruct import Reconstruct
from fsw.tasks.state import State
from fsw.vision.acquisition import Prior
from fsw.vision.gating import count, gate_residuals
from fsw.vision.grid import CellGrid
from fsw.vision.quality import comprehensive, match_quality
from fsw.vision.rig import StereoRig
from fsw.vision.tracking import Tracker, TrackingOptions
from sim.surrogate_world import SurrogateWorld, find_cells, read_header
from telemetry.dictionary import CHAR, CMP, MU, PRECISION, RECALL, FlightMode
from telemetry.events import LOCK_ACQUIRED
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]

NAN = float("nan")
LEFT, RIGHT = 0, 1
SIGMA_MM = 0.01  # of a point, in each direction
EPIPOLAR_PX, REPROJECTION_PX = 0.1, 0.05  # what noise makes of them, standard deviations
LEAST_CONTRAST = 12.0  # grey levels between ground and cell
DEPTH_PER_BUMP = 0.2  # mm of depth for a px of bump
DEPTH_PER_SKEW = 1.5  # mm of depth for a mm that the wing moved between the eyes' exposures
SCENE_CHAR = 0.9985  # as the real scene shows
TOP, BOTTOM = 0, -1


class SurrogateTracker(Tracker):
    """Measures the small world's images; each tick's noise is drawn from the seed and the moment of exposure."""

    def __init__(self, rig: StereoRig, grid: CellGrid, world: SurrogateWorld) -> None:
        super().__init__(rig, grid, TrackingOptions())
        self._world = world
        self._rest_mm, self._normal_mm = world.rest_mm, world.normal
        self._deflection_mm = np.zeros((2, grid.count))
        self._bump_px = 0.0
        self._time_ns = 0
        self._low = world.slots[:, 0] >= world.height // 2  # cells in the lower half of the images
        self.wanted[:] = True
        self.points.covariance_mm2[:] = SIGMA_MM**2 * np.eye(3)

    def measure(self, left: Image, right: Image) -> None:
        """Find the cells in both images, and where they were when each was exposed."""
        self._bump_px = 0.0
        for eye, image in ((LEFT, left), (RIGHT, right)):
            found = self.cells[eye].found
            find_cells(image, self._world.slots, LEAST_CONTRAST, found)
            for row in (TOP, BOTTOM):
                half = self._low if row == BOTTOM else ~self._low
                header = read_header(image, row)
                if header is None or header.eye != eye:
                    found[half] = False
                    continue
                self._deflection_mm[eye][half] = self._world.deflection_mm(header.time_ns)[half]
                self._bump_px += 0.5 * header.bump_px
                self._time_ns = header.time_ns

    def reconstruct(
        self, matched: NDArray[np.bool_], reprojection_gate_px: float = math.inf, epipolar_gate_px: float = math.inf
    ) -> int:
        """Points of the matched cells (N,) with noise, gated as the real ones; returns how many are valid."""
        points = self.points
        left, right = self._deflection_mm
        place(
            matched,
            self._rest_mm,
            self._normal_mm,
            left,
            right,
            self._bump_px,
            np.uint64(self._world.seed),
            np.uint64(self._time_ns),
            points.xyz_mm,
            points.sigma_mm,
            points.reprojection_px,
            points.epipolar_px,
            points.valid,
        )
        gate_residuals(points, reprojection_gate_px, epipolar_gate_px)
        points.xyz_mm[~points.valid] = NAN
        return int(count(points.valid))


class SurrogateSearch:
    """search: both images show enough cells of the right eyes; told after the latency of the real search."""

    name = "search"

    def __init__(self, state: State, table: VisionTable) -> None:
        self._state, self.table = state, table
        self._found = 0

    def init(self) -> None:
        """Nothing to make ready."""

    def take(self, tick: int) -> bool:
        """Look at the pair, if there is one and the grid is not known."""
        state = self._state
        if state.mode is not FlightMode.ACQUIRE or state.begun or not state.pair.usable:
            return False
        state.tracker.measure(state.pair.left, state.pair.right)
        self._found = state.tracker.both_found()
        return True

    def work(self) -> None:
        """All is done by `take`."""

    def deliver(self, tick: int) -> None:
        """Begin to track from what was found."""
        state = self._state
        needed = max(self.table.least_cells, 0.5 * state.tracker.expected_count)
        if state.mode is not FlightMode.ACQUIRE or self._found < needed:
            return
        state.begun = True
        state.causes |= Cause.LOCK_FOUND
        state.raise_event(LOCK_ACQUIRED, self._found)


class SurrogateMatch:
    """match: cells that both eyes found, and how good the scene is."""

    name = "match"

    def __init__(self, state: State, table: VisionTable) -> None:
        self._state, self.table = state, table
        state.matched = np.zeros(state.tracker.grid.count, np.bool_)

    def init(self) -> None:
        """Nothing to make ready."""

    def run(self, tick: int, time_ns: int) -> None:
        """Match this tick's cells."""
        state = self._state
        if not state.measured:
            state.matched.fill(False)
            for point in (CHAR, MU, CMP, PRECISION, RECALL):
                state.board.set(point, NAN)
            return
        detected = state.tracker.both_found()
        np.copyto(state.matched, state.tracker.both)
        quality = match_quality(state.tracker.expected_count, detected, detected, self.table.precision_weight)
        state.board.set(CHAR, SCENE_CHAR)
        state.board.set(MU, quality.uniqueness)
        state.board.set(CMP, comprehensive(SCENE_CHAR, quality.uniqueness))
        state.board.set(PRECISION, quality.precision)
        state.board.set(RECALL, quality.recall)


def make_surrogate_vision(world: SurrogateWorld) -> MakeVision:
    """What App takes in place of the real vision."""

    def vision(state: State, rig: StereoRig, prior: Prior, table: VisionTable) -> list[FrameTask | LongTask]:
        state.tracker.close()
        state.tracker = SurrogateTracker(rig, state.tracker.grid, world)
        return [
            SurrogateSearch(state, table),
            Feature(state, table),
            SurrogateMatch(state, table),
            Reconstruct(state, table),
        ]

    return vision


@kernel
def hashed(seed: np.uint64, moment: np.uint64, number: int) -> np.uint64:
    """Sixty-four bits that look random and depend on the three numbers alone (splitmix64)."""
    z = seed * np.uint64(0x9E3779B97F4A7C15) + moment * np.uint64(0xD1B54A32D192ED03) + np.uint64(number)
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return z


@kernel
def normal(seed: np.uint64, moment: np.uint64, number: int) -> float:
    """A standard normal number that depends on the three numbers alone (Box and Muller)."""
    first = (float(hashed(seed, moment, 2 * number) >> np.uint64(11)) + 0.5) / 9007199254740992.0
    second = (float(hashed(seed, moment, 2 * number + 1) >> np.uint64(11)) + 0.5) / 9007199254740992.0
    return math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)


@kernel
def place(
    matched: NDArray[np.bool_],
    rest_mm: FloatArray,
    normal_mm: FloatArray,
    left_mm: FloatArray,
    right_mm: FloatArray,
    bump_px: float,
    seed: np.uint64,
    moment: np.uint64,
    xyz_mm: FloatArray,
    sigma_mm: FloatArray,
    reprojection_px: FloatArray,
    epipolar_px: FloatArray,
    valid: NDArray[np.bool_],
) -> None:
    """Points (N, 3) from the cells at rest and their deflections (N,) at the two eyes' exposures, and residuals."""
    for n in range(len(matched)):
        valid[n] = matched[n]
        if not matched[n]:
            xyz_mm[n, :] = math.nan
            sigma_mm[n] = reprojection_px[n] = epipolar_px[n] = math.nan
            continue
        skew = left_mm[n] - right_mm[n]
        away = 0.5 * (left_mm[n] + right_mm[n])
        for axis in range(3):
            xyz_mm[n, axis] = rest_mm[n, axis] + away * normal_mm[axis] + SIGMA_MM * normal(seed, moment, 5 * n + axis)
        xyz_mm[n, 2] += DEPTH_PER_BUMP * bump_px + DEPTH_PER_SKEW * skew
        sigma_mm[n] = math.sqrt(3.0) * SIGMA_MM
        epipolar_px[n] = bump_px + EPIPOLAR_PX * normal(seed, moment, 5 * n + 3)
        shared = abs(epipolar_px[n]) / math.sqrt(8.0)
        reprojection_px[n] = math.hypot(shared, REPROJECTION_PX * normal(seed, moment, 5 * n + 4))
