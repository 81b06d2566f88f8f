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
# Of a side that is steeper than 45 degrees, along image rows; of others, along the cache's lines in a row: what is to
# be asked for next, the last, and how many at once. And where it is across: PLACE + SLOPE px for each px along.
NEXT, LAST, EACH, STEEP, PLACE, SLOPE = range(6)


def make_ahead() -> FloatArray:
    """Take the memory (6,); nothing is to be asked for."""
    ahead = np.zeros(6)
    ahead[LAST] = -1.0
    return ahead


@tick_kernel
def next_wanted(order: NDArray[np.int64], wanted: NDArray[np.bool_], place: int) -> int:
    """The wanted cell that comes next in order; the same one, if none does."""
    for later in range(place + 1, len(order)):
        if wanted[order[later]]:
            return order[later]
    return order[place]


@tick_kernel
def look_ahead(image: Image, start: FloatArray, end: FloatArray, ahead: FloatArray) -> None:
    """Begin to ask for a side that is expected from one place (2,) in the image to another."""
    steep = abs(end[1] - start[1]) > abs(end[0] - start[0])
    a0, a1 = (start[1], end[1]) if steep else (start[0], end[0])
    c0, c1 = (start[0], end[0]) if steep else (start[1], end[1])
    if not abs(a1 - a0) > 0.0:  # or not a number
        ahead[NEXT], ahead[LAST] = 0.0, -1.0
        return
    each, size = (1.0, image.shape[0]) if steep else (LINE / image.itemsize, image.shape[1])
    first, last = math.floor(max(min(a0, a1), 0.0) / each), math.floor(min(max(a0, a1), size - 1.0) / each)
    slope = (c1 - c0) / (a1 - a0)
    ahead[NEXT], ahead[LAST], ahead[EACH] = first, last, (last - first) // PARTS + 1
    ahead[STEEP], ahead[PLACE], ahead[SLOPE] = steep, c0 - slope * a0, slope


@tick_kernel
def ask(image: Image, ahead: FloatArray) -> None:
    """Ask for the next part of the side."""
    begun, until = int(ahead[NEXT]), int(min(ahead[NEXT] + ahead[EACH], ahead[LAST] + 1.0))
    ahead[NEXT] = until
    place, slope, size = ahead[PLACE], ahead[SLOPE], image.itemsize
    low, right = image.shape[0] - 1.0, image.shape[1] - 1.0
    if ahead[STEEP]:
        for row in range(begun, until):
            x = place + slope * row
            for edge in (x - MARGIN_PX, x + MARGIN_PX):
                prefetch(image, row, int(min(max(edge, 0.0), right)) * size)
        return
    each = LINE / size
    reach = MARGIN_PX + 0.5 * abs(slope) * each
    for line in range(begun, until):
        y = place + slope * (line + 0.5) * each
        for row in range(int(max(y - reach, 0.0)), int(min(y + reach, low)) + 1):
            prefetch(image, row, line * LINE)
