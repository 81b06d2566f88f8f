"""Hot rows: rows of the sensor that read full scale whatever falls on them. Their pixels are no measurement.

A pixel at full scale is theirs where no more than HOT_RUN rows side by side are: a saturated line or glint is wider.
"""

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import tick_kernel

Image = NDArray[np.uint8] | NDArray[np.uint16]
FloatArray = NDArray[np.float64]

HOT_RUN = 2  # rows side by side that may be hot
FULL_SCALE = 255  # of the coarsest converter
ROWS_APART = 8  # one of so many rows tells the brightest value: what is cut off is larger
LEAST_LINE_PX = HOT_RUN + 2.0  # of a line along rows, that it should not look like hot rows itself


def is_full_scale(value: int) -> bool:
    """Whether a positive value is all ones of a converter of 8 bits or more, at either end of its word.

    Without noise many pixels may share a brightest value; that alone does not say that they are clipped.
    """
    ones = value // (value & -value)
    return ones >= FULL_SCALE and ones & (ones + 1) == 0


_is_full_scale = tick_kernel(is_full_scale)


@tick_kernel
def shown_full_scale(image: Image) -> int:
    """Value at which an image (h, w) is cut off: fewer than 16 bits may be filled, as the brightest pixels tell."""
    if image.itemsize == 1:
        return 255
    top = 1
    for y in range(0, image.shape[0], ROWS_APART):
        for x in range(image.shape[1]):
            top = max(top, int(image[y, x]))
    return top if _is_full_scale(top) else 65535


@tick_kernel
def is_hot(image: Image, x: int, y: int, full: int) -> bool:
    """Whether a pixel is a hot row's; full: see shown_full_scale."""
    if image[y, x] < full:
        return False
    run = 1
    for way in (-1, 1):
        at = y + way
        while 0 <= at < image.shape[0] and run <= HOT_RUN and image[at, x] >= full:
            run, at = run + 1, at + way
    return run <= HOT_RUN


@tick_kernel
def runs_along_hot_row(image: Image, start: FloatArray, end: FloatArray, reach_px: float, full: int) -> bool:
    """Whether a hot row lies nearer than reach_px to a side between two places (2,) in the image that runs along rows.

    A row is hot that is so in three places from end to end of the side. One that crosses a side spoils a single sample
    across it, in which no step is seen.
    """
    x0, y0, x1, y1 = start[0], start[1], end[0], end[1]
    if abs(y1 - y0) > abs(x1 - x0):
        return False
    height, width = image.shape
    first, last = int(max(min(y0, y1) - reach_px, 0.0)), int(min(max(y0, y1) + reach_px, height - 1.0))
    for y in range(first, last + 1):
        hot = True
        for share in (0.25, 0.5, 0.75):
            hot = hot and is_hot(image, int(min(max(x0 + share * (x1 - x0), 0.0), width - 1.0)), y, full)
        if hot:
            return True
    return False
