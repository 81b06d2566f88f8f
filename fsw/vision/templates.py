"""One side of a cell beside a wide line or a border: the edge's place in every column by matched templates.

Where the plateaus on either side of an edge are wider than the blur, the model of a few pixels across it is linear:
level, step, shift and change of blur. For each place of the edge inside a pixel the model's orthonormal basis is
tabulated once a tick, so a column of pixels costs a handful of products, and no equation is solved. The shift's
estimate is the least-squares one: its variance is the Cramer-Rao bound of those pixels.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.blur import look_up
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]

PHASES = 32  # places of an edge inside a pixel; what is left over is accounted for exactly
MAX_TAPS = 16  # pixels across an edge, at most
JUDGED = 8  # every so many columns are asked for what the model leaves over
COMMON_TAPS = 8  # of a sharp lens
MAX_COLUMNS = 256  # of a segment
STEP, SHIFT, BLURRING = 0, 1, 2  # the templates: orthogonal to a level and to each other
PROBE_PX = 0.25  # a shift as large as this calibrates how far the linear model falls short
REACH_SIGMAS, REACH_PX = 2.5, 2.0  # half the window: the blurred step, and what shows the plateaus


class Templates(NamedTuple):
    """Of the sides along X (0) and along Y (1) of one eye; taken once, filled every tick."""

    weight: NDArray[np.float32]  # (2, PHASES, 3, MAX_TAPS) what gives step, step times shift, and blurring
    scale: FloatArray  # (2, PHASES, 4) lengths of step, shift and blurring, and the shift's share along the step
    cubic: FloatArray  # (2,) a linear shift f means f + cubic f3
    taps: NDArray[np.int64]  # (2,) pixels across, 0: blur too wide for templates
    pixel: NDArray[np.float32]  # (MAX_COLUMNS, MAX_TAPS) one side's pixels, column by column,
    place: FloatArray  # (MAX_COLUMNS,) the edge's expected place inside its pixel, in phases


def make_templates() -> Templates:
    """Take the tables."""
    return Templates(
        np.zeros((2, PHASES, 3, MAX_TAPS), np.float32),
        np.zeros((2, PHASES, 4)),
        np.zeros(2),
        np.zeros(2, np.int64),
        np.zeros((MAX_COLUMNS, MAX_TAPS), np.float32),
        np.zeros(MAX_COLUMNS),
    )


@kernel
def fill_templates(step: FloatArray, blur_px: float, gain: float, row: int, out: Templates) -> None:
    """Fill the templates of one direction of sides.

    step: the table of tabulate_step. blur_px: the whole blur. gain: distance from the edge per pixel across, > 0.
    """
    half = math.ceil(REACH_SIGMAS * blur_px / gain + REACH_PX)
    if 2 * half > MAX_TAPS:
        out.taps[row] = 0
        return
    out.taps[row] = taps = 2 * half
    basis = np.empty((3, MAX_TAPS))
    probed, shifted = 0.0, np.empty(MAX_TAPS)
    for phase in range(PHASES):
        for k in range(taps):
            x = k - (half - 1) - (phase + 0.5) / PHASES
            value, slope, change = look_up(step, gain * x)
            basis[STEP, k], basis[SHIFT, k], basis[BLURRING, k] = value, -gain * slope, change
            shifted[k], _, _ = look_up(step, gain * (x - PROBE_PX))
        along = 0.0
        for i in range(3):
            mean = 0.0
            for k in range(taps):
                mean += basis[i, k] / taps
            for k in range(taps):
                basis[i, k] -= mean
            for j in range(i):
                dot = 0.0
                for k in range(taps):
                    dot += basis[i, k] * basis[j, k]
                for k in range(taps):
                    basis[i, k] -= dot * basis[j, k]
                if i == SHIFT:
                    along = dot
            squares = 0.0
            for k in range(taps):
                squares += basis[i, k] * basis[i, k]
            length = math.sqrt(squares)
            out.scale[row, phase, i] = length
            for k in range(taps):
                basis[i, k] /= length
        scale, weight = out.scale[row, phase], out.weight[row, phase]
        scale[3] = along
        for k in range(taps):
            weight[SHIFT, k] = basis[SHIFT, k] / scale[SHIFT]
            weight[STEP, k] = (basis[STEP, k] - along * weight[SHIFT, k]) / scale[STEP]
            weight[BLURRING, k] = basis[BLURRING, k]
        alpha, gamma = 0.0, 0.0
        for k in range(taps):
            alpha += basis[STEP, k] * shifted[k]
            gamma += basis[SHIFT, k] * shifted[k]
        shift = gamma / scale[SHIFT]
        probed += shift / ((alpha - shift * along) / scale[STEP]) / PHASES
    out.cubic[row] = (PROBE_PX - probed) / probed**3


@kernel
def take_pixels(
    image: Image,
    start: tuple[float, float],
    end: tuple[float, float],
    vertical: bool,
    stride: int,
    taps: int,
    pixel: NDArray[np.float32],
    place: FloatArray,
) -> tuple[int, int]:
    """Copy the pixels across a segment, column by column; returns how many there are in the image, and in all.

    start, end: image pixels. vertical: whether columns of pixels run along image columns. Copying first lets the
    memory's latencies overlap.
    """
    a0, c0, a1, c1 = (start[0], start[1], end[0], end[1]) if vertical else (start[1], start[0], end[1], end[0])
    limit_along, limit_across = (image.shape[1], image.shape[0]) if vertical else image.shape
    slope = (c1 - c0) / (a1 - a0)
    first, last = math.ceil(min(a0, a1)), math.floor(max(a0, a1))
    count, columns = 0, 0
    for a in range(first, last + 1, stride):
        columns += 1
        centre = c0 + (a - a0) * slope
        base = math.floor(centre)
        low = base - taps // 2 + 1
        if a < 0 or a >= limit_along or low < 0 or low + taps > limit_across or count == MAX_COLUMNS:
            continue
        place[count] = (centre - base) * PHASES
        if taps == COMMON_TAPS and vertical:  # loops of known length are unrolled
            for k in range(COMMON_TAPS):
                pixel[count, k] = image[low + k, a]
        elif taps == COMMON_TAPS:
            for k in range(COMMON_TAPS):
                pixel[count, k] = image[a, low + k]
        else:
            for k in range(taps):
                pixel[count, k] = image[low + k, a] if vertical else image[a, low + k]
        count += 1
    return count, columns


@kernel
def sum_columns(
    pixel: NDArray[np.float32],
    place: FloatArray,
    count: int,
    weight: NDArray[np.float32],
    scale: FloatArray,
    row: int,
    taps: int,
) -> tuple[float, float, float, float, float, float, float, float]:
    """Sums over a segment's columns of b, b2, bc, c2, where b is the step and c is b times the shift in pixels.

    And, of every JUDGED-th column: squares that the model leaves over, their degrees of freedom, numerator and
    denominator of the correction of the blur.
    """
    sb, sbb, sbc, scc = 0.0, 0.0, 0.0, 0.0
    rest, freedom, blur_num, blur_den = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        phase = min(int(place[i]), PHASES - 1)
        step, shift = np.float32(0.0), np.float32(0.0)
        if taps == COMMON_TAPS:
            for k in range(COMMON_TAPS):
                step += weight[row, phase, STEP, k] * pixel[i, k]
                shift += weight[row, phase, SHIFT, k] * pixel[i, k]
        else:
            for k in range(taps):
                step += weight[row, phase, STEP, k] * pixel[i, k]
                shift += weight[row, phase, SHIFT, k] * pixel[i, k]
        b = float(step)
        c = float(shift) - b * (place[i] - phase - 0.5) * (1.0 / PHASES)
        sb, sbb, sbc, scc = sb + b, sbb + b * b, sbc + b * c, scc + c * c
        if i % JUDGED == 0:
            level, squares, blurring = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for k in range(taps):
                p = pixel[i, k]
                level += p
                squares += p * p
                blurring += weight[row, phase, BLURRING, k] * p
            along = b * scale[row, phase, STEP] + shift * scale[row, phase, 3]
            across, size = shift * scale[row, phase, SHIFT], b * scale[row, phase, BLURRING]
            rest += squares - level * level / taps - along * along - across * across - blurring * blurring
            freedom += taps - 4.0
            blur_num += size * blurring
            blur_den += size * size
    return sb, sbb, sbc, scc, rest, freedom, blur_num, blur_den
