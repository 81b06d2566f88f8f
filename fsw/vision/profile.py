"""One model of an edge fitted to the binned pixels across it: cell | line | next cell, or cell | border, blurred."""

import math
from typing import NamedTuple

from fsw.vision.blur import PIXEL_VARIANCE, look_up
from fsw.vision.edges import (
    ADDED,
    BINS,
    BLUR,
    CROSS,
    FRESH_ROWS,
    LIGHT,
    MAX_WALK_PX,
    OWN,
    RIGHT,
    WIDTH,
    FloatArray,
    Scratch,
    solve,
)
from wingbeat.kernels import tick_kernel

FIT_STEPS = 6  # Gauss-Newton steps of one edge model, at most
SETTLED_PX = 2e-3  # a step shorter than this is the last but one: the next is shorter than its square
MISFIT = 3.0  # times the squares that noise leaves over: more is the model's
ALIKE = 0.1  # pixels that say that the next cell is as grey as the cell, where the image may not show it


class EdgeFit(NamedTuple):
    """One fitted edge: found at all, offset from the expected place, its variance, grey of cell and line, residual.

    expected_px2: the variance, were the noise as expected. misfit_px2: what the edge may be off by because the model
    leaves more over than noise can: by as many deviations as that is at most, if it were all along the offset.
    blur_pull, width_pull_px: by how much the offset would change if the lens blurred by 1 px more, and if the line were
    wider, per unit of relative width. light_pull_px2: by how much it is off where light grows outwards, per unit of
    relative growth per px, and added_pull_px2: per grey value laid over per px. added_chi2, added_px: how far light
    laid over all of it, growing outwards, is beyond noise, and what the offset is off by for it.
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
    light_pull_px2: float
    added_pull_px2: float
    added_chi2: float
    added_px: float


_NO_EDGE = EdgeFit(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@tick_kernel
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
            b[i] = coupled[BLUR, i] = coupled[WIDTH, i] = coupled[LIGHT, i] = coupled[ADDED, i] = 0.0
            for j in range(n):
                A[i, j] = 0.0
        fresh[:] = 0.0
        squares = plain = blur_num = blur_den = width_num = width_den = cross = 0.0
        added_num = added_den = 0.0
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
                lit = c * grey * x
                coupled[LIGHT, 0] += lit * j_inside
                coupled[LIGHT, 1] += lit * j_line
                coupled[LIGHT, last] += lit * j_offset
                added_num += c * r * x
                added_den += c * x * x
                coupled[ADDED, 0] += c * x * j_inside
                coupled[ADDED, 1] += c * x * j_line
                coupled[ADDED, last] += c * x * j_offset
                if n == 4:
                    coupled[BLUR, 2] += c * j_blur * j_beyond
                    coupled[LIGHT, 2] += lit * j_beyond
                    coupled[ADDED, 2] += c * x * j_beyond
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
                for j in range(4):
                    for k in range(i):
                        coupled[j, i] -= A[i, k] * coupled[j, k]
                    coupled[j, i] /= A[i, i]
                blur_den -= coupled[BLUR, i] ** 2
                width_den -= coupled[WIDTH, i] ** 2
                cross -= coupled[BLUR, i] * coupled[WIDTH, i]
                added_den -= coupled[ADDED, i] ** 2
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
    # Light falls on the wing before the lens blurs it: a Gaussian blur of x S(x) is x S + blur2 S', a shift the less.
    by_light = coupled[LIGHT, last] / stiff - blur_px * blur_px
    by_grey = coupled[ADDED, last] / stiff
    residual = math.sqrt(plain / (used - n))
    misfit = max(scale - MISFIT, 0.0) * (used - n)
    variances = scale / stiff**2, 1.0 / stiff**2, misfit / stiff**2
    added = added_num / added_den if added_den > 0.0 else 0.0
    return EdgeFit(
        True,
        offset,
        *variances,
        inside,
        line,
        residual,
        by_blur,
        by_width,
        by_light,
        by_grey,
        added * added_num,
        by_grey * added,
    )


@tick_kernel
def _regress(fresh: FloatArray, grey: float, square: float, weight: float) -> None:
    """Add one bin's mean grey value and the square of what is left of a pixel in it."""
    fresh[2, 0] += weight
    fresh[2, 1] += weight * grey
    fresh[2, 2] += weight * grey * grey
    fresh[3, 0] += weight * square
    fresh[3, 1] += weight * square * grey
