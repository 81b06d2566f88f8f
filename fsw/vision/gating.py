"""Which points stand, and what is counted over cells: kernels without memory of their own."""

import math

import numpy as np
from numpy.typing import NDArray

from fsw.vision.corners import Cells
from fsw.vision.edges import FloatArray
from fsw.vision.grid import IntArray
from fsw.vision.prediction import GATE_SIGMAS, Surface, locate
from fsw.vision.stereo import Points
from wingbeat.kernels import kernel


@kernel
def count(mask: NDArray[np.bool_]) -> int:
    """How many are set; np.count_nonzero would make a temporary of some masks."""
    count = 0
    for n in range(mask.shape[0]):
        count += mask[n]
    return count


@kernel
def mean_sides(corners_px: FloatArray, wanted: NDArray[np.bool_]) -> tuple[float, float]:
    """Mean length of the sides along X and along Y of the wanted cells; 0 without any."""
    along_x, along_y, count = 0.0, 0.0, 0
    for n in range(wanted.shape[0]):
        if wanted[n]:
            c = corners_px[n]
            along_x += math.hypot(c[1, 0] - c[0, 0], c[1, 1] - c[0, 1])
            along_y += math.hypot(c[3, 0] - c[0, 0], c[3, 1] - c[0, 1])
            count += 1
    return along_x / max(count, 1), along_y / max(count, 1)


@kernel
def rms(values: FloatArray, valid: NDArray[np.bool_]) -> float:
    squares, count = 0.0, 0
    for n in range(values.shape[0]):
        if valid[n]:
            squares += values[n] * values[n]
            count += 1
    return math.sqrt(squares / count) if count else math.nan


@kernel
def gate_residuals(points: Points, reprojection_px: float, epipolar_px: float) -> None:
    """Take validity from points that the two eyes do not agree on."""
    for n in range(points.valid.shape[0]):
        if points.valid[n]:
            near = points.reprojection_px[n] <= reprojection_px and abs(points.epipolar_px[n]) <= epipolar_px
            points.valid[n] = near


@kernel
def measure_distance(surface: Surface, points: Points, chosen: NDArray[np.bool_], distance_mm: FloatArray) -> None:
    """Write the distance (N,) from the surface of the chosen points (N,)."""
    for n in range(chosen.shape[0]):
        if chosen[n]:
            x, y, z = locate(surface, n, 4)
            dx, dy, dz = points.xyz_mm[n, 0] - x, points.xyz_mm[n, 1] - y, points.xyz_mm[n, 2] - z
            distance_mm[n] = math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def gate_points(points: Points, distance_mm: FloatArray, gate_mm: float, widest_mm: float) -> None:
    """Take validity from points off the surface."""
    for n in range(points.valid.shape[0]):
        gate = min(max(gate_mm, GATE_SIGMAS * points.sigma_mm[n]), widest_mm)
        points.valid[n] = points.valid[n] and distance_mm[n] <= gate


@kernel
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


@kernel
def deviate(cells: Cells, expected_px: FloatArray, valid: NDArray[np.bool_], out_px: FloatArray) -> None:
    """What each whole cell's corners deviate from the surface by.

    Zero for the others: a side that stood in for a hidden one would confirm itself from tick to tick and drift away.
    """
    for n in range(valid.shape[0]):
        if valid[n] and cells.whole[n]:
            out_px[n] = cells.corners_px[n] - expected_px[n]
        else:
            out_px[n] = 0.0
