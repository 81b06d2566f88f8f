"""The next side's pixels, asked for while this one's are worked on.

Memory is far away, and only a few of the cache's lines can be waited for at once. What is asked for early, a few lines
at a time, is there when its turn comes; asked for much earlier, it would be driven out again.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.lanes import prefetch
from fsw.vision.rig import FloatArray
from hal.frame import LINE
from wingbeat.kernels import tick_kernel

Image = NDArray[Any]

MARGIN_PX = 6.5  # to either side of the expected side: half a window of 12 pixels, and what it drifts
PARTS = 6  # in which a side is asked for: it has no more segments
FIXED = 16  # bits after the point of a place
MOST_PX = 1e6  # that a side may lie beyond the image
# Of a side that is steeper than 45 degrees, along image rows; of others, along the cache's lines in a row: what is to
# be asked for next, the last, and how many at once. And what each needs across: from where on, at the first of all and
# by how much it grows from one to the next, in fixed point, and over how many pixels more.
NEXT, LAST, EACH, STEEP, PLACE, SLOPE, MORE = range(7)


def make_ahead() -> NDArray[np.int64]:
    """Take the memory (7,); nothing is to be asked for."""
    ahead = np.zeros(7, np.int64)
    ahead[LAST] = -1
    return ahead


@tick_kernel
def next_wanted(order: NDArray[np.int64], wanted: NDArray[np.bool_], place: int) -> int:
    """The wanted cell that comes next in order; the same one, if none does."""
    for later in range(place + 1, len(order)):
        if wanted[order[later]]:
            return order[later]
    return order[place]


@tick_kernel
def look_ahead(image: Image, start: FloatArray, end: FloatArray, ahead: NDArray[np.int64]) -> None:
    """Begin to ask for a side that is expected from one place (2,) in the image to another."""
    steep = abs(end[1] - start[1]) > abs(end[0] - start[0])
    a0, a1 = (start[1], end[1]) if steep else (start[0], end[0])
    c0, c1 = (start[0], end[0]) if steep else (start[1], end[1])
    if not (abs(a1 - a0) > 0.0 and abs(a0) + abs(a1) + abs(c0) + abs(c1) < MOST_PX):  # or not a number
        ahead[NEXT], ahead[LAST] = 0, -1
        return
    each, size = (1.0, image.shape[0]) if steep else (LINE / image.itemsize, image.shape[1])
    first, last = math.floor(max(min(a0, a1), 0.0) / each), math.floor(min(max(a0, a1), size - 1.0) / each)
    slope = (c1 - c0) / (a1 - a0)
    # A line in a row is asked for as far as the side drifts along it.
    middle, reach = (0.0, MARGIN_PX) if steep else (0.5 * each, MARGIN_PX + 0.5 * abs(slope) * each)
    one = float(1 << FIXED)
    ahead[NEXT], ahead[LAST], ahead[EACH] = first, last, (last - first) // PARTS + 1
    ahead[STEEP], ahead[PLACE] = steep, math.floor((c0 + slope * (middle - a0) - reach) * one)
    ahead[SLOPE], ahead[MORE] = math.floor(slope * each * one), math.ceil(2.0 * reach)


@tick_kernel
def ask(image: Image, ahead: NDArray[np.int64]) -> None:
    """Ask for the next part of the side."""
    begun, until = ahead[NEXT], min(ahead[NEXT] + ahead[EACH], ahead[LAST] + 1)
    ahead[NEXT] = until
    place, slope, more = ahead[PLACE] + begun * ahead[SLOPE], ahead[SLOPE], ahead[MORE]
    low, right, size = image.shape[0] - 1, image.shape[1] - 1, image.itemsize
    if ahead[STEEP]:
        for row in range(begun, until):
            x = place >> FIXED
            for edge in (x, x + more):
                prefetch(image, row, min(max(edge, 0), right) * size)
            place += slope
        return
    for line in range(begun, until):
        y = place >> FIXED
        for row in range(max(y, 0), min(y + more, low) + 1):
            prefetch(image, row, line * LINE)
        place += slope
