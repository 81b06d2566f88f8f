"""Relative position descriptor: distance to the fold gap and the lower border, and matching by it (Eq. 21-23).

Everything here takes enhanced coordinates: points of the equivalent view, where columns run along y.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_GAP_PART = 0.2  # a gap is wider than a pitch by at least this part of it


class Borders(NamedTuple):
    """Where the descriptor is measured from: right edge b_r of the fold gap, and the lowest row b_b."""

    gap_left: float
    gap_right: float
    bottom: float


def gap_threshold(pitch: float, nearest_gap: float) -> float:
    """Threshold eta_boundary of Eq. 21: halfway between the pitch and the distance of columns across a fold."""
    return 0.5 * (pitch + nearest_gap)


def column_positions(x: FloatArray, pitch: float) -> FloatArray:
    """Mean x of each column (c,), rising, from the statistics of the points' x (n,): columns are clusters of x."""
    order = np.sort(x)
    cuts = np.flatnonzero(np.diff(order) > 0.5 * pitch) + 1
    return np.array([part.mean() for part in np.split(order, cuts)]) if len(order) else np.empty(0)


def fold_gaps(x: FloatArray, pitch: float, threshold: float | None = None) -> FloatArray:
    """Intervals (m, 2) b_l, b_r between neighbouring columns that are wider than the threshold (Eq. 21).

    x (n,): enhanced coordinate of all points. threshold: eta_boundary; by default a fifth more than the pitch. A
    column that was not detected looks like a gap too: pass a threshold and check the width where the wing's gap is
    known.
    """
    column = column_positions(x, pitch)
    limit = (1.0 + _GAP_PART) * pitch if threshold is None else threshold
    wide = np.flatnonzero(np.diff(column) > limit)
    return np.stack((column[wide], column[wide + 1]), axis=-1)


def find_borders(xy: FloatArray, pitch: tuple[float, float], threshold: float | None = None) -> Borders | None:
    """Borders of points (n, 2): the first fold gap, and the lowest row that is in view; None where no gap is in view.

    The lowest row seen stands for the wing's border only if the eye sees the border: the paper takes that for
    granted.
    """
    gaps = fold_gaps(xy[:, 0], pitch[0], threshold)
    if not len(gaps):
        return None
    rows = column_positions(xy[:, 1], pitch[1])
    return Borders(float(gaps[0, 0]), float(gaps[0, 1]), float(rows[0]))


def describe(xy: FloatArray, borders: Borders) -> FloatArray:
    """RPD (n, 2): desX, desY of points (n, 2) against the gap's right edge and the lowest row (Eq. 22, 23)."""
    return np.asarray(xy - np.array([borders.gap_right, borders.bottom]))


def match(first: FloatArray, second: FloatArray, limit: float) -> IntArray:
    """Pairs (m, 2) of indices whose RPDs (n, 2), (k, 2) lie nearest to each other, both ways, and within the limit.

    Left with right eye, or a frame with the next. Rows of the result follow the first set's order.
    """
    if not len(first) or not len(second):
        return np.empty((0, 2), dtype=np.int64)
    distance, partner = cKDTree(second).query(first)
    _, back = cKDTree(first).query(second)
    here = np.flatnonzero((distance < limit) & (back[partner] == np.arange(len(first))))
    return np.stack((here, partner[here]), axis=-1).astype(np.int64)
