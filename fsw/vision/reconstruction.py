"""Both eyes' part of a tick in TRACK, whole: from their cells to points on the surface, each with its validity.

One kernel, as `view.py`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.bow import Bow, fit_kinks, tilt_extents, unbend
from fsw.vision.corners import Cells
from fsw.vision.edges import FloatArray
from fsw.vision.fitting import Normal, fit_surface, measure_distance
from fsw.vision.gating import count, deviate, gate_columns, gate_points, gate_residuals
from fsw.vision.prediction import Surface, expect_again
from fsw.vision.rig import Eyes
from fsw.vision.sizes import ROWS_BEHIND, WORK, widen_odd_sizes
from fsw.vision.stereo import Points, retriangulate_cells, triangulate_cells
from wingbeat.kernels import tick_kernel

BoolArray = NDArray[np.bool_]


class Pair(NamedTuple):
    """What both eyes expect and have measured of N cells, the tracker's arrays, and working memory."""

    cells: tuple[Cells, Cells]
    corners_px: FloatArray  # (2, N, 4, 2) the cells' pixels, of both eyes together
    centre_px: FloatArray  # (2, N, 2)
    covariance_px2: FloatArray  # (2, N, 3)
    expected_px: FloatArray  # (2, N, 4, 2)
    deviation_px: FloatArray  # (2, N, 4, 2)
    blur_px: FloatArray  # (2, 2)
    depth_mm: FloatArray  # (2, N, 4)
    neighbour: NDArray[np.int64]  # (N, 4)
    column: NDArray[np.int64]  # (N,) from the root
    distance_mm: FloatArray  # (N,) of the points from the surface
    tilted_px: FloatArray  # (2, N, 2)
    odd: BoolArray  # (N,)
    sizes: FloatArray  # (2, N + ROWS_BEHIND, WORK)
    stand: FloatArray  # (columns, 2)


def make_pair(
    cells: tuple[Cells, Cells],
    pixels: tuple[FloatArray, FloatArray, FloatArray],
    expected: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    neighbour: NDArray[np.int64],
    column: NDArray[np.int64],
) -> Pair:
    """Take the memory. pixels: corners, centres and covariances; expected: expected_px to depth_mm."""
    count = len(column)
    memory = np.full(count, np.nan), np.zeros((2, count, 2)), np.zeros(count, np.bool_)
    sizes, stand = np.zeros((2, count + ROWS_BEHIND, WORK)), np.zeros((int(column[-1]) + 1, 2))
    return Pair(cells, *pixels, *expected, neighbour, column, *memory, sizes, stand)


@tick_kernel
def reconstruct_points(
    eyes: Eyes,
    surface: Surface,
    normal: Normal,
    bow: Bow,
    pair: Pair,
    matched: BoolArray,
    wanted: BoolArray,
    reprojection_gate_px: float,
    epipolar_gate_px: float,
    widest_mm: float,
    points: Points,
) -> int:
    """Triangulate the matched cells (N,), fit the surface, drop what lies off it; returns how many stay valid.

    wanted (N,): cells that both eyes should see. widest_mm: a point farther off the surface is none.
    """
    whole = (pair.cells[0].whole, pair.cells[1].whole)
    triangulate_cells(eyes, pair.corners_px, pair.centre_px, pair.covariance_px2, matched, whole, points)
    gate_residuals(points, reprojection_gate_px, epipolar_gate_px)
    xyz, sigma = points.xyz_mm, points.sigma_mm
    gate_mm = fit_surface(surface, xyz, sigma, points.valid, widest_mm, normal, pair.distance_mm)
    stand = _gate(points, pair, gate_mm, widest_mm)
    expect_again(surface, eyes, wanted, pair.expected_px, pair.depth_mm)
    fit_kinks(surface, points, bow)
    if _find_odd(eyes, surface, bow, pair, matched, wanted):
        retriangulate_cells(eyes, pair.corners_px, pair.centre_px, pair.covariance_px2, pair.odd, whole, points)
        for n in range(len(matched)):
            points.valid[n] = points.valid[n] and pair.cells[0].found[n] and pair.cells[1].found[n]
        gate_residuals(points, reprojection_gate_px, epipolar_gate_px)
        measure_distance(surface, points, pair.odd, pair.distance_mm)
        stand = _gate(points, pair, gate_mm, widest_mm)
    unbend(surface, eyes, pair.expected_px, pair.covariance_px2, pair.blur_px, bow, points)
    for eye in range(2):
        deviate(pair.cells[eye], pair.expected_px[eye], points.valid, pair.deviation_px[eye])
    return stand


@tick_kernel
def _gate(points: Points, pair: Pair, gate_mm: float, widest_mm: float) -> int:
    """Take validity from what lies off the surface, points and whole columns; returns how many points stand."""
    gate_points(points, pair.distance_mm, gate_mm, widest_mm)
    return gate_columns(points, pair.distance_mm, pair.column, pair.stand)


@tick_kernel
def _find_odd(eyes: Eyes, surface: Surface, bow: Bow, pair: Pair, matched: BoolArray, wanted: BoolArray) -> bool:
    """Widen cells of odd sizes; those that are matched, too, are pair.odd (N,). Returns whether there are any."""
    tilt_extents(surface, eyes, pair.expected_px, wanted, bow, pair.tilted_px)
    pair.odd[:] = False
    for eye in range(2):
        expected, tilted = pair.expected_px[eye], pair.tilted_px[eye]
        widen_odd_sizes(expected, tilted, pair.neighbour, pair.sizes[eye], pair.cells[eye], pair.odd)
    for n in range(len(matched)):
        pair.odd[n] = pair.odd[n] and matched[n]
    return count(pair.odd) > 0
