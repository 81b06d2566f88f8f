"""The next cell's pixels, asked for while this one's are worked on.

All rows at one column of a large image fall into one set of the nearest cache, of which a few lines can be waited for
at once: strips would wait long. What is asked for early, a few rows at a time, is there when its turn comes.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.lanes import prefetch
from fsw.vision.rig import FloatArray, distort_point
from wingbeat.kernels import tick_kernel

Image = NDArray[Any]
Ahead = NDArray[np.int64]  # (8,) row to be asked for next, the box, and what of it is left out, see below

LINE = 64  # bytes that memory gives at once
ROWS_AT_ONCE = 8  # asked for with each piece of a side: a cell has few more rows than its sides have strips
MARGIN_PX = 7.0  # to either side of the expected sides: half a window
# The box: first and last byte in each row, last row; inside of all sides: first row, that behind its last, bytes alike.
ROW, LAST_ROW, FIRST, LAST, INNER_ROW, OUTER_ROW, INNER, OUTER = range(8)


def make_ahead() -> Ahead:
    """Take the memory; nothing is to be asked for."""
    ahead = np.zeros(8, np.int64)
    ahead[LAST_ROW] = -1
    return ahead


@tick_kernel
def look_ahead(
    image: Image, corners_px: FloatArray, intrinsics: FloatArray, distortion: FloatArray, ahead: Ahead
) -> None:
    """Begin to ask for the sides of a cell whose corners (4, 2), ideal pixels, are expected."""
    height, width = image.shape
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    inner_left, inner_right, inner_top, inner_bottom = -math.inf, math.inf, -math.inf, math.inf
    for k in range(2):  # each diagonal spans a box: the cell lies in both together, and what both share in the cell
        u, v, _, _, _, _ = distort_point(corners_px[k, 0], corners_px[k, 1], intrinsics, distortion)
        x, y, _, _, _, _ = distort_point(corners_px[k + 2, 0], corners_px[k + 2, 1], intrinsics, distortion)
        u, x, v, y = min(u, x), max(u, x), min(v, y), max(v, y)
        left, right, top, bottom = min(left, u), max(right, x), min(top, v), max(bottom, y)
        inner_left, inner_right = max(inner_left, u), min(inner_right, x)
        inner_top, inner_bottom = max(inner_top, v), min(inner_bottom, y)
    ahead[FIRST] = _line(max(left - MARGIN_PX, 0.0) * image.itemsize)
    ahead[LAST] = _line(min(right + MARGIN_PX, width - 1.0) * image.itemsize)
    ahead[ROW], ahead[LAST_ROW] = int(max(top - MARGIN_PX, 0.0)), int(min(bottom + MARGIN_PX, height - 1.0))
    ahead[INNER_ROW], ahead[OUTER_ROW] = int(inner_top + MARGIN_PX), int(inner_bottom - MARGIN_PX)
    ahead[INNER] = _line((inner_left + MARGIN_PX) * image.itemsize) + LINE
    ahead[OUTER] = _line((inner_right - MARGIN_PX) * image.itemsize)


@tick_kernel
def _line(place: float) -> int:
    """First byte of the line in which a place lies."""
    return int(place) & -LINE


@tick_kernel
def ask(image: Image, ahead: Ahead) -> None:
    """Ask for the next few rows."""
    begun, last = ahead[ROW], ahead[LAST_ROW]
    if begun > last:
        return
    ahead[ROW] = begun + ROWS_AT_ONCE
    for row in range(begun, min(begun + ROWS_AT_ONCE, last + 1)):
        inner, outer = ahead[INNER], ahead[OUTER]
        if inner >= outer or not ahead[INNER_ROW] <= row < ahead[OUTER_ROW]:
            inner = outer = ahead[LAST] + LINE
        for at in range(ahead[FIRST], inner, LINE):
            prefetch(image, row, at)
        for at in range(outer, ahead[LAST] + 1, LINE):
            prefetch(image, row, at)
