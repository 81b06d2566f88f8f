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

from fsw.vision.blur import PIXEL_VARIANCE, look_up
from fsw.vision.hot import is_hot
from fsw.vision.strips import Strips, make_strips
from fsw.vision.templates import MOST_SEGMENTS, Templates, make_templates
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]  # uint8 or uint16, (height, width)
Point = tuple[float, float]

BIN_PX = 0.5  # fine against the blur of any lens with its pixel, coarse against the cost
BINS = 64  # 32 px: the widest window, in bins
SEGMENTS = MOST_SEGMENTS  # at most, on a side
FIT_STEPS = 6  # Gauss-Newton steps of one edge model, at most
SETTLED_PX = 2e-3  # a step shorter than this is the last but one: the next is shorter than its square
MISFIT = 3.0  # times the squares that noise leaves over: more is the model's
ALIKE = 0.1  # pixels that say that the next cell is as grey as the cell, where the image may not show it
MAX_WALK_PX = 3.5  # an edge farther from where it was expected is somebody else's

# What all edges of an eye have in common, in the order of Scratch.pooled: the blur, and the relative width of the lines
# that run along X (sides 0 and 2) and along Y (sides 1 and 3). Of one edge, in Scratch.fresh: the blur and its line's.
BLUR, WIDTH, WIDTH_ALONG_X, WIDTH_ALONG_Y, COMMON = 0, 1, 1, 2, 3
RIGHT, OWN, CROSS = 0, 1, 2  # of their normal equations: right side, diagonal, and what couples a width to the blur
# Two more rows regress the squares e of what edges leave over on the grey values y: sums of 1, y, y^2, and of e, e y.
POOLED_ROWS, FRESH_ROWS = COMMON + 2, 4


class Scratch(NamedTuple):
    """Working memory of one eye's fits, taken once."""

    total: FloatArray  # (BINS,) of the pixels in a bin: sum of grey values,
    place: FloatArray  # (BINS,) sum of distances from the expected edge, outwards positive,
    square: FloatArray  # (BINS,) and of their squares,
    number: FloatArray  # (BINS,) and how many
    normal: FloatArray  # (4, 4) normal equations
    right: FloatArray  # (4,) and their right side
    coupled: FloatArray  # (2, 4) and how BLUR and WIDTH are coupled to their unknowns
    segments: FloatArray  # (SEGMENTS, 4) place along the side (-0.5 .. 0.5), offset, variance, and that of unit noise
    fresh: FloatArray  # (FRESH_ROWS, 3) RIGHT, OWN, CROSS of BLUR and WIDTH, of the last edge fitted,
    pooled: FloatArray  # (POOLED_ROWS, 3) and of all edges that were good
    templates: Templates
    strips: Strips


def make_scratch() -> Scratch:
    """Take the working memory."""
    total, place, square, number = np.zeros((4, BINS))
    fit = total, place, square, number, np.zeros((4, 4)), np.zeros(4), np.zeros((2, 4))
    fresh, pooled = np.zeros((FRESH_ROWS, 3)), np.zeros((POOLED_ROWS, 3))
    return Scratch(*fit, np.zeros((SEGMENTS, 4)), fresh, pooled, make_templates(), make_strips())


class EdgeFit(NamedTuple):
    """One fitted edge: found at all, offset from the expected place, its variance, grey of cell and line, residual.

    expected_px2: the variance, were the noise as expected. misfit_px2: what the edge may be off by because the model
    leaves more over than noise can: by as many deviations as that is at most, if it were all along the offset.
    blur_pull, width_pull_px: by how much the offset would change if the lens blurred by 1 px more, and if the line were
    wider, per unit of relative width.
    """

    good: bool
    offset_px: float
    variance_px2: float
    expected_px2: float
    misfit_px2: float
    inside: float
    line: float
    residual: float
    blur_pull: float
    width_pull_px: float


_NO_EDGE = EdgeFit(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@kernel
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


@kernel
def fit_profile(
    scratch: Scratch, step: FloatArray, noise: FloatArray, width_px: float, blur_px: float, whole: bool
) -> EdgeFit:
    """Fit cell | line | next cell (width_px > 0) or cell | border (width_px = 0) to the gathered bins.

    step: the table of tabulate_step. noise (2,): see Lens. blur_px: the whole blur, lens and pixel. whole: whether all
    of the window was seen; if not, the next cell may not be, and is taken to be about as grey as the cell. Writes
    scratch.fresh.
    """
    total, place, count = scratch.total, scratch.place, scratch.number
    A, b, coupled, fresh = scratch.normal, scratch.right, scratch.coupled, scratch.fresh
    # Distances differ inside a bin: its mean is seen as if blurred by half their variance over the blur of the lens.
    wider, lens_px = scratch.square, math.sqrt(blur_px * blur_px - PIXEL_VARIANCE)
    n = 4 if width_px > 0.0 else 3
    used, last = 0, n - 1
    for i in range(BINS):  # gather the filled bins at the front, as means
        if count[i] > 0.0:
            c = count[i]
            total[used], place[used], count[used] = total[i] / c, place[i] / c, c
            wider[used] = max(wider[i] / c - place[used] ** 2, 0.0) / (2.0 * lens_px)
            used += 1
    if used < n + 2:
        return _NO_EDGE
    offset, inside, line, beyond = 0.0, 0.0, 0.0, 0.0
    squares, plain, previous, last_turn = 0.0, 0.0, 0.0, FIT_STEPS
    for turn in range(FIT_STEPS + 1):
        # Parameters: cell, line, (next cell,) offset. At turn 0 the offset is held: grey values alone are found.
        for i in range(n):
            b[i] = coupled[BLUR, i] = coupled[WIDTH, i] = 0.0
            for j in range(n):
                A[i, j] = 0.0
        fresh[:] = 0.0
        squares = plain = blur_num = blur_den = width_num = width_den = cross = 0.0
        for i in range(used):
            x = place[i] - offset
            s1, d1, blur1 = look_up(step, x)
            s2, d2, blur2 = 0.0, 0.0, 0.0
            if n == 4:
                s2, d2, blur2 = look_up(step, x - width_px)
            s1, s2 = s1 + wider[i] * blur1, s2 + wider[i] * blur2
            j_inside, j_line, j_beyond = 1.0 - s1, s1 - s2, s2
            j_offset = -((line - inside) * d1 + (beyond - line) * d2)
            grey = inside * j_inside + line * j_line + beyond * j_beyond
            r = total[i] - grey
            w = 1.0 / (noise[0] + noise[1] * max(grey, 0.0))
            c = count[i] * w
            squares += c * r * r
            if turn == last_turn:
                plain += count[i] * r * r
                _regress(fresh, grey, count[i] * r * r, w * w)
                j_blur = (line - inside) * blur1 + (beyond - line) * blur2
                blur_num += c * r * j_blur
                blur_den += c * j_blur * j_blur
                coupled[BLUR, 0] += c * j_blur * j_inside
                coupled[BLUR, 1] += c * j_blur * j_line
                coupled[BLUR, last] += c * j_blur * j_offset
                if n == 4:
                    coupled[BLUR, 2] += c * j_blur * j_beyond
                    j_width = -(beyond - line) * d2 * width_px  # per unit of relative width
                    width_num += c * r * j_width
                    width_den += c * j_width * j_width
                    cross += c * j_width * j_blur
                    coupled[WIDTH, 0] += c * j_width * j_inside
                    coupled[WIDTH, 1] += c * j_width * j_line
                    coupled[WIDTH, 2] += c * j_width * j_beyond
                    coupled[WIDTH, 3] += c * j_width * j_offset
            if turn == 0:
                j_offset = 0.0
            A[0, 0] += c * j_inside * j_inside
            A[1, 0] += c * j_line * j_inside
            A[1, 1] += c * j_line * j_line
            if n == 4:
                A[2, 0] += c * j_beyond * j_inside
                A[2, 1] += c * j_beyond * j_line
                A[2, 2] += c * j_beyond * j_beyond
                A[3, 2] += c * j_offset * j_beyond
                b[2] += c * r * j_beyond
            A[last, 0] += c * j_offset * j_inside
            A[last, 1] += c * j_offset * j_line
            A[last, last] += c * j_offset * j_offset
            b[0] += c * r * j_inside
            b[1] += c * r * j_line
            b[last] += c * r * j_offset
        if n == 4 and not whole:
            alike = ALIKE / (noise[0] + noise[1] * max(inside, 0.0))
            A[0, 0] += alike
            A[2, 0] -= alike
            A[2, 2] += alike
            b[0] -= alike * (inside - beyond)
            b[2] += alike * (inside - beyond)
        if turn == 0:
            A[last, last] = 1.0
        if not solve(A, b, n):
            return _NO_EDGE
        if turn == last_turn:
            for i in range(n):  # take away what the edge's own unknowns could do instead: Schur's complement
                for j in range(2):
                    for k in range(i):
                        coupled[j, i] -= A[i, k] * coupled[j, k]
                    coupled[j, i] /= A[i, i]
                blur_den -= coupled[BLUR, i] ** 2
                width_den -= coupled[WIDTH, i] ** 2
                cross -= coupled[BLUR, i] * coupled[WIDTH, i]
            unit = noise[0] + noise[1] * max(0.5 * (inside + line), 0.0)  # in grey values, as templates have it
            fresh[BLUR, RIGHT], fresh[BLUR, OWN] = unit * blur_num, unit * blur_den
            fresh[WIDTH, RIGHT], fresh[WIDTH, OWN] = unit * width_num, unit * width_den
            fresh[WIDTH, CROSS] = unit * cross
            break
        inside += b[0]
        line += b[1]
        if n == 4:
            beyond += b[2]
        previous = min(max(b[last], -blur_px), blur_px)  # a longer step would leave the slope of the edge
        offset += previous
        if turn > 0 and abs(previous) < SETTLED_PX:
            last_turn = turn + 1
        if abs(offset) > MAX_WALK_PX:
            return _NO_EDGE
    if abs(previous) > 0.05:
        return _NO_EDGE
    scale = squares / (used - n)
    for row in range(2, FRESH_ROWS):
        for k in range(3):
            fresh[row, k] /= max(scale, 1.0) ** 2  # what is no edge, or a stained one, tells little of the noise
            if row > 2:
                fresh[row, k] *= used / (used - n)
    # The offset is the last unknown, so its variance is the inverse square of the factor's last pivot.
    stiff = A[last, last]
    by_blur, by_width = -coupled[BLUR, last] / stiff, -coupled[WIDTH, last] / stiff
    residual = math.sqrt(plain / (used - n))
    misfit = max(scale - MISFIT, 0.0) * (used - n)
    variances = scale / stiff**2, 1.0 / stiff**2, misfit / stiff**2
    return EdgeFit(True, offset, *variances, inside, line, residual, by_blur, by_width)


@kernel
def _regress(fresh: FloatArray, grey: float, square: float, weight: float) -> None:
    """Add one bin's mean grey value and the square of what is left of a pixel in it."""
    fresh[2, 0] += weight
    fresh[2, 1] += weight * grey
    fresh[2, 2] += weight * grey * grey
    fresh[3, 0] += weight * square
    fresh[3, 1] += weight * square * grey


@kernel
def gather(
    image: Image,
    ends: tuple[Point, Point],
    gain: float,
    vertical: bool,
    window_px: Point,
    stride: int,
    without_hot: bool,
    scratch: Scratch,
) -> bool:
    """Sort the pixels round the image line between `ends` into bins of their distance from it.

    Pixels are taken whole, along image columns (vertical) or rows, so that no interpolation blurs or correlates them.
    gain: ideal distance from the edge per image pixel along that axis. window_px: reach inwards and outwards.
    without_hot: leave out what a hot row shows, no line here being as thin.
    Returns whether the window lay inside the image.
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
    inside = True
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
            if without_hot and is_hot(image, x, y):
                continue
            distance = (c - centre) * gain
            k = int((distance + inner_px) / BIN_PX)
            if 0 <= k < BINS:
                total[k] += image[y, x]
                place[k] += distance
                square[k] += distance * distance
                count[k] += 1.0
    return inside
