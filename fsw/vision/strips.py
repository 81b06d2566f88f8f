"""Strips of a side: neighbouring columns of pixels summed, while the edge drifts less than half a pixel along them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.lanes import make_strip
from fsw.vision.rig import distort_point
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]
Curve = tuple[float, float, float, float]
Point = tuple[float, float]

MOST_COLUMNS = 4  # of a strip
DRIFT_PX = 0.5  # of the edge from end to end of a strip, at most
MOST_STRIPS = 256  # of a side,
LEAST_STRIPS = 24  # and at least: fewer do not tell their noise

# Products of a strip with two templates, by how many columns (or rows) of the image it has.
four_columns, two_columns, one_column = (make_strip(True, each) for each in (4, 2, 1))
four_rows, two_rows, one_row = (make_strip(False, each) for each in (4, 2, 1))


@kernel
def follow(
    start: Point, end: Point, normal: Point, intrinsics: FloatArray, distortion: FloatArray
) -> tuple[bool, float, float, float, Curve]:
    """The image of a straight line between two ideal points: (vertical, gain, begin, stop, curve).

    vertical: whether it runs along image rows, so that columns of pixels lie across it. gain: how far a step of one
    pixel across leads along the ideal normal, at its middle. begin, stop: where it starts and ends along the image. The
    lens bends it to a parabola through both ends and the middle: see `place_at`.
    """
    u, v = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    x0, y0, _, _, _, _ = distort_point(start[0], start[1], intrinsics, distortion)
    x1, y1, xx, xy, yx, yy = distort_point(u, v, intrinsics, distortion)
    x2, y2, _, _, _, _ = distort_point(end[0], end[1], intrinsics, distortion)
    across_x, across_y, det = yy * normal[0] - yx * normal[1], xx * normal[1] - xy * normal[0], xx * yy - xy * yx
    vertical = abs(across_y) > abs(across_x)
    gain = (across_y if vertical else across_x) / det
    a0, a1, a2 = (x0, x1, x2) if vertical else (y0, y1, y2)
    c0, c1, c2 = (y0, y1, y2) if vertical else (x0, x1, x2)
    before, after = (c0 - c1) / (a0 - a1), (c2 - c1) / (a2 - a1)
    bend = (after - before) / (a2 - a0)
    return vertical, gain, a0, a2, (a1, c1, after - bend * (a2 - a1), bend)


@kernel
def place_at(curve: Curve, along: float) -> float:
    """Where a curve stands across, at a place along the image."""
    t = along - curve[0]
    return curve[1] + t * (curve[2] + t * curve[3])


@kernel
def strip_columns(slope: float, columns: int) -> int:
    """Columns summed to a strip, 4, 2 or 1, of a side of this slope against the image and so many columns."""
    each = MOST_COLUMNS
    while each > 1 and (each * abs(slope) > DRIFT_PX or columns < each * LEAST_STRIPS):
        each //= 2
    return each


@kernel
def drift_variance(slope: float, each: int) -> float:
    """Variance of an edge's place over the columns of a strip, by which the strip looks more blurred."""
    return slope * slope * (each * each - 1) / 12.0
