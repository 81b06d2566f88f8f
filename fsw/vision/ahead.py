"""The next cell's pixels, asked for while this one's are worked on.

All rows at one column of a large image fall into one set of the nearest cache, of which a few lines can be waited for
at once: strips would wait long. What is asked for early, a few lines with each strip, is there when its turn comes.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.lanes import prefetch
from fsw.vision.rig import FloatArray, distort_point
from wingbeat.kernels import tick_kernel

Image = NDArray[Any]
Ahead = NDArray[np.int64]  # (5,) bytes: row and place in it to be asked for next, first and last place, last row

LINE = 64  # bytes that memory gives at once
LINES_A_STRIP = 5  # a cell's box has some four times as many lines as its sides have strips
MARGIN_PX = 7.0  # round the expected corners: half a window
ROW, AT, FIRST, LAST, LAST_ROW = range(5)


def make_ahead() -> Ahead:
    """Take the memory; nothing is to be asked for."""
    ahead = np.zeros(5, np.int64)
    ahead[LAST_ROW] = -1
    return ahead


@tick_kernel
def look_ahead(
    image: Image, corners_px: FloatArray, intrinsics: FloatArray, distortion: FloatArray, ahead: Ahead
) -> None:
    """Begin to ask for the box of a cell whose corners (4, 2), ideal pixels, are expected."""
    height, width = image.shape
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for k in range(4):
        x, y, _, _, _, _ = distort_point(corners_px[k, 0], corners_px[k, 1], intrinsics, distortion)
        left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
    ahead[FIRST] = ahead[AT] = int(max(left - MARGIN_PX, 0.0)) * image.itemsize
    ahead[LAST] = int(min(right + MARGIN_PX, width - 1.0)) * image.itemsize
    ahead[ROW] = int(max(top - MARGIN_PX, 0.0))
    ahead[LAST_ROW] = int(min(bottom + MARGIN_PX, height - 1.0))


@tick_kernel
def ask(image: Image, ahead: Ahead) -> None:
    """Ask for the next few lines."""
    row, at = ahead[ROW], ahead[AT]
    if row > ahead[LAST_ROW]:
        return
    for _ in range(LINES_A_STRIP):
        prefetch(image, row, at)
        at += LINE
        if at > ahead[LAST]:
            row, at = row + 1, ahead[FIRST]
    ahead[ROW], ahead[AT] = row, at
