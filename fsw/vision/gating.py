"""Which points stand, whether the wing's names do, and what is counted over cells."""

import math

import numpy as np
from numpy.typing import NDArray

from fsw.vision.corners import Cells
from fsw.vision.edges import FloatArray
from fsw.vision.fitting import GATE_SIGMAS
from fsw.vision.grid import CellGrid, IntArray
from fsw.vision.prediction import Surface
from fsw.vision.rig import norm
from fsw.vision.stereo import Points
from wingbeat.kernels import tick_kernel

SLIP = 0.5  # of the pitch: a wing that has moved farther in its plane since it was named may be one cell off


class Slip:
    """How far the wing may move in its plane from where it was when its cells were named."""

    def __init__(self, grid: CellGrid, surface: Surface) -> None:
        pitch = [panel.pitch_mm for panel in grid.panels]
        self._most_mm = tuple(SLIP * min(p[axis] for p in pitch) for axis in (0, 1))
        self._surface = surface
        self._named_mm: tuple[float, float] | None = None  # where it was

    def _now_mm(self) -> tuple[float, float]:
        return float(self._surface.unknowns[0]), float(self._surface.unknowns[1])

    def forget(self) -> None:
        """Nobody has named the cells."""
        self._named_mm = None

    def start(self) -> None:
        """The cells have just been named."""
        self._named_mm = self._now_mm()

    def adopt(self, other: "Slip") -> None:
        """Take over where the wing was named by another one's surface of the same pose."""
        self._named_mm = other._named_mm

    def far(self) -> bool:
        """Whether it has moved so far that the names may be one cell off."""
        if self._named_mm is None:
            return False
        moved = zip(self._now_mm(), self._named_mm, self._most_mm, strict=True)
        return any(abs(now - named) > most for now, named, most in moved)


@tick_kernel
def count(mask: NDArray[np.bool_]) -> int:
    """How many are set; np.count_nonzero would make a temporary of some masks."""
    count = 0
    for n in range(mask.shape[0]):
        count += mask[n]
    return count


@tick_kernel
def mean_sides(corners_px: FloatArray, wanted: NDArray[np.bool_]) -> tuple[float, float]:
    """Mean length of the sides along X and along Y of the wanted cells; 0 without any."""
    along_x, along_y, count = 0.0, 0.0, 0
    for n in range(wanted.shape[0]):
        if wanted[n]:
            c = corners_px[n]
            along_x += norm(c[1, 0] - c[0, 0], c[1, 1] - c[0, 1])
            along_y += norm(c[3, 0] - c[0, 0], c[3, 1] - c[0, 1])
            count += 1
    return along_x / max(count, 1), along_y / max(count, 1)


@tick_kernel
def rms(values: FloatArray, valid: NDArray[np.bool_]) -> float:
    """Root mean square of the valid values; NaN without any."""
    squares, count = 0.0, 0
    for n in range(values.shape[0]):
        if valid[n]:
            squares += values[n] * values[n]
            count += 1
    return math.sqrt(squares / count) if count else math.nan


@tick_kernel
def gate_residuals(points: Points, reprojection_px: float, epipolar_px: float) -> None:
    """Take validity from points that the two eyes do not agree on."""
    for n in range(points.valid.shape[0]):
        if points.valid[n]:
            near = points.reprojection_px[n] <= reprojection_px and abs(points.epipolar_px[n]) <= epipolar_px
            points.valid[n] = near


@tick_kernel
def gate_points(points: Points, distance_mm: FloatArray, gate_mm: float, widest_mm: float) -> None:
    """Take validity from points off the surface."""
    for n in range(points.valid.shape[0]):
        gate = min(max(gate_mm, GATE_SIGMAS * points.sigma_mm[n]), widest_mm)
        points.valid[n] = points.valid[n] and distance_mm[n] <= gate


@tick_kernel
def gate_columns(points: Points, distance_mm: FloatArray, column: IntArray, work: FloatArray) -> int:
    """Take validity from columns most of whose points lie off the surface; returns how many points stay.

    distance_mm (N,), NaN where no point was measured; column (N,): from the root. work (columns, 2 or more).

    Where one eye took a row for the next, the column stands at a wrong depth, and so is longer or shorter than the
    wing's: its ends lie off the surface, but not its middle. Erases the values of all points that are not valid.
    """
    work[:] = 0.0
    for n in range(column.shape[0]):
        work[column[n], 0] += points.valid[n]
        work[column[n], 1] += not math.isnan(distance_mm[n])
    count = 0
    for n in range(column.shape[0]):
        if points.valid[n] and 2.0 * work[column[n], 0] > work[column[n], 1]:
            count += 1
        else:
            points.valid[n] = False
            points.xyz_mm[n] = np.nan
            points.sigma_mm[n] = np.nan
    return count


@tick_kernel
def deviate(cells: Cells, expected_px: FloatArray, valid: NDArray[np.bool_], out_px: FloatArray) -> None:
    """What each whole cell's corners deviate from the surface by.

    Zero for the others: a side that stood in for a hidden one would confirm itself from tick to tick and drift away.
    """
    for n in range(valid.shape[0]):
        take = valid[n] and cells.whole[n]
        for k in range(4):
            for i in range(2):
                out_px[n, k, i] = cells.corners_px[n, k, i] - expected_px[n, k, i] if take else 0.0
