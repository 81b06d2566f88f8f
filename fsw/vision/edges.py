"""Cell edges to a few thousandths of a pixel: the four sides of each cell, fitted near where they are expected.

A side is cut into short segments. The pixels of a segment are sorted by their distance from the expected edge into fine
bins, and one model of an edge is fitted to the bins: cell | line | next cell, or cell | border, blurred by the lens. A
straight line through the segments is the side; sides that meet give the corners. Everything is measured in ideal
pixels, so a straight side is straight whatever the lens does.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.ahead import make_ahead
from fsw.vision.hot import is_hot
from fsw.vision.strips import Strips, make_strips
from fsw.vision.templates import MOST_SEGMENTS, Templates, make_templates
from wingbeat.kernels import tick_kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]  # uint8 or uint16, (height, width)
Point = tuple[float, float]

BIN_PX = 0.5  # fine against the blur of any lens with its pixel, coarse against the cost
BINS = 64  # 32 px: the widest window, in bins
SEGMENTS = MOST_SEGMENTS  # at most, on a side
CUT_OFF = 0.02  # part of a segment's pixels that may be stuck at full scale
MAX_WALK_PX = 3.5  # an edge farther from where it was expected is somebody else's

# What all edges along X (sides 0 and 2) of an eye have in common, and what all along Y (sides 1 and 3): the blur, which
# a motion during the exposure makes different across them, and the relative width of the lines, in Scratch.pooled from
# row EACH * direction on. Of one edge, in Scratch.fresh: its own.
BLUR, WIDTH, EACH = 0, 1, 2
COMMON = 2 * EACH
LIGHT, ADDED = 2, 3  # in Scratch.coupled: light that grows by its whole per px outwards, and by a grey value laid over
RIGHT, OWN, CROSS = 0, 1, 2  # of their normal equations: right side, diagonal, and what couples a width to the blur
# Two more rows regress the squares e of what edges leave over on the grey values y: sums of 1, y, y^2, and of e, e y.
POOLED_ROWS, FRESH_ROWS = COMMON + 2, 4
# Of a direction's extents: cells, sum and squares of their shares beyond the known one, variance that noise explains.
SIZE_SUMS = 4


class Quad(NamedTuple):
    """The cell being measured, side by side; taken once."""

    nx: FloatArray  # (4,) outward normals,
    ny: FloatArray  # (4,)
    length: FloatArray  # (4,) px
    extent: FloatArray  # (4,) px, of the cell from each side to the one across
    middle: FloatArray  # (4,) where the side's middle was found, px outwards of where it was expected,
    slope: FloatArray  # (4,) from its start to its end,
    variance: FloatArray  # (4,) of the middle
    by_blur: FloatArray  # (4,) px that 1 px more blur, and a line wider by its whole, would move it by
    by_width: FloatArray  # (4,)
    weight: FloatArray  # (4,) what it adds to OWN and CROSS of its width
    cross: FloatArray  # (4,)
    bright: FloatArray  # (4,) contrast,
    level: FloatArray  # (4,) and the cell's grey value beside it
    by_light: FloatArray  # (4,) px2 that it is off by, where light grows by its whole per px outwards,
    by_added: FloatArray  # (4,) and by a grey value laid over cell and line
    rounded: FloatArray  # (4,) px that it may be off by, because the cell's pixels are rounded all alike
    flat: FloatArray  # (4, 2) corners, without what was measured of them
    agreed: FloatArray  # (POOLED_ROWS, 3) what was pooled before the cell
    seen: FloatArray  # (6, 2) corners in the image, and both of the next cell's first side


def make_quad() -> Quad:
    """Take the memory."""
    shapes = [(4,)] * 16 + [(4, 2), (POOLED_ROWS, 3), (6, 2)]
    return Quad(*(np.zeros(shape) for shape in shapes))


class Scratch(NamedTuple):
    """Working memory of one eye's fits, taken once."""

    total: FloatArray  # (BINS,) of the pixels in a bin: sum of grey values,
    place: FloatArray  # (BINS,) sum of distances from the expected edge, outwards positive,
    square: FloatArray  # (BINS,) and of their squares,
    number: FloatArray  # (BINS,) and how many
    normal: FloatArray  # (4, 4) normal equations
    right: FloatArray  # (4,) and their right side
    coupled: FloatArray  # (4, 4) and how BLUR, WIDTH, LIGHT and ADDED are coupled to their unknowns
    segments: FloatArray  # (SEGMENTS, 4) place along the side (-0.5 .. 0.5), offset, variance, and that of unit noise
    misfit: FloatArray  # (SEGMENTS,) variance by what the model leaves over beyond noise,
    feigned2: FloatArray  # (SEGMENTS,) and by what light laid over the edge may feign
    fresh: FloatArray  # (FRESH_ROWS, 3) RIGHT, OWN, CROSS of BLUR and WIDTH, of the last edge fitted,
    pooled: FloatArray  # (POOLED_ROWS, 3) and of all edges that were good
    templates: Templates
    strips: Strips
    ahead: NDArray[np.int64]  # (7,) see `look_ahead`
    quad: Quad
    sizes: FloatArray  # (2, SIZE_SUMS) of the whole cells' extents, see standing_in
    full: NDArray[np.int64]  # (1,) value at which the image is cut off, see shown_full_scale


def make_scratch() -> Scratch:
    """Take the working memory."""
    total, place, square, number = np.zeros((4, BINS))
    fit = total, place, square, number, np.zeros((4, 4)), np.zeros(4), np.zeros((4, 4))
    side = np.zeros((SEGMENTS, 4)), np.zeros(SEGMENTS), np.zeros(SEGMENTS)
    pooled = np.zeros((FRESH_ROWS, 3)), np.zeros((POOLED_ROWS, 3))
    sizes = np.zeros((2, SIZE_SUMS))
    return Scratch(
        *fit, *side, *pooled, make_templates(), make_strips(), make_ahead(), make_quad(), sizes, np.full(1, 65535)
    )


@tick_kernel
def solve(A: FloatArray, b: FloatArray, n: int) -> bool:
    """Solve the symmetric A x = b in place by Cholesky; A keeps its factor, b becomes x. False if A is not definite."""
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i == j:
                if s <= 1e-12 * (1.0 + abs(A[i, i])):
                    return False
                A[i, i] = math.sqrt(s)
            else:
                A[i, j] = s / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]
    return True


@tick_kernel
def gather(
    image: Image,
    ends: tuple[Point, Point],
    gain: float,
    vertical: bool,
    window_px: Point,
    stride: int,
    without_hot: bool,
    scratch: Scratch,
) -> tuple[bool, bool]:
    """Sort the pixels round the image line between `ends` into bins of their distance from it.

    Pixels are taken whole, along image columns (vertical) or rows, so that no interpolation blurs or correlates them.
    gain: ideal distance from the edge per image pixel along that axis. window_px: reach inwards and outwards.
    without_hot: leave out what a hot row shows, no line here being as thin.
    Returns whether the window lay inside the image, and whether it shows light cut off at full scale.
    """
    total, place, square, count = scratch.total, scratch.place, scratch.square, scratch.number
    inner_px, outer_px = window_px
    total[:] = 0.0
    place[:] = 0.0
    square[:] = 0.0
    count[:] = 0.0
    e0, e1 = ends
    along, across = (0, 1) if vertical else (1, 0)
    limit_along, limit_across = (image.shape[1], image.shape[0]) if vertical else image.shape
    a0, a1 = e0[along], e1[along]
    slope = (e1[across] - e0[across]) / (a1 - a0)
    lo, hi = (a0, a1) if a0 < a1 else (a1, a0)
    reach_in, reach_out = inner_px / abs(gain), outer_px / abs(gain)
    before, after = (reach_in, reach_out) if gain > 0 else (reach_out, reach_in)
    inside, full, taken, cut_off = True, scratch.full[0], 0, 0
    for a in range(math.ceil(lo), math.floor(hi) + 1, stride):
        if a < 0 or a >= limit_along:
            inside = False
            continue
        centre = e0[across] + (a - a0) * slope
        start, stop = math.ceil(centre - before), math.floor(centre + after)
        if start < 0 or stop >= limit_across:
            inside = False
            start, stop = max(start, 0), min(stop, limit_across - 1)
        for c in range(start, stop + 1):
            x, y = (a, c) if vertical else (c, a)
            if without_hot and is_hot(image, x, y, full):
                continue
            distance = (c - centre) * gain
            k = int((distance + inner_px) / BIN_PX)
            if 0 <= k < BINS:
                taken += 1
                cut_off += image[y, x] >= full
                total[k] += image[y, x]
                place[k] += distance
                square[k] += distance * distance
                count[k] += 1.0
    return inside, cut_off > CUT_OFF * taken
