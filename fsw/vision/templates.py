"""Templates of an edge beside a wide line or a border: its step, shift and blur from the pixels across it.

Where the plateaus on either side of an edge are wider than the blur, the model of a few pixels across it is linear:
level, step, shift and change of blur. For each place of the edge inside a pixel the model's orthonormal basis is
tabulated once a tick, so that pixels cost a handful of products, and no equation is solved. Photons are counted, so a
bright pixel has more noise than a dark one: pixels weigh by the inverse of their variance, whose ratio on the two
plateaus the pixels themselves tell. The shift's estimate is then the best linear one (Gauss and Markov), and its
variance the Cramer-Rao bound of those pixels (Kay, Fundamentals of Statistical Signal Processing I, ch. 4 and 6).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.blur import look_up
from fsw.vision.lanes import TAPS
from wingbeat.kernels import tick_kernel

FloatArray = NDArray[np.float64]

PHASES = 32  # places of an edge inside a pixel; what is left over is accounted for exactly
STEP, SHIFT, BLURRING, LEVEL = 0, 1, 2, 3  # the templates, each blind to the others,
RISING, BENDING = 4, 5  # and to them two that tell light laid over cell and line alike, rising and bending across them
COLUMNS = 6
ACROSS = 3  # in Templates.scale: the shift's share along the step
BY_RISING, BY_BENDING = 4, 5  # and what the last two templates say that the shift is off by
PROBE_PX = 0.25  # shifts as large as this, to either side, calibrate how far the linear model falls short
NEAR_PX = 1.0 / 16.0  # over which slopes of the tabulated step are taken
REACH_SIGMAS, REACH_PX = 2.5, 2.0  # half the least window: the blurred step, and what shows the plateaus,
LEAST_HALF = 4  # and as many pixels beyond the four unknowns as tell what these leave over
WIDER_PX = 2  # plateau that tells the levels better, where the line is as wide
NOISE_RANGE = 12.0  # times as much variance on one plateau as on the other, at most
INSIDE, LINE = 0, 1  # in Templates.noise
MOST_SEGMENTS, SUMS = 6, 15
# Columns of Templates.sums, over a segment's strips: how many there are, the step b and c, b times the shift in pixels;
COUNT, B, BB, BC, CC = 0, 1, 2, 3, 4
# and of every JUDGED-th: how many, squares that no template explains, the correction of the blur and its weight, and
# the cell's grey value, products with the templates of light laid over the edge, what they say that c is off by, and
# that one's variance over c's.
JUDGES, REST, BLUR_NUM, BLUR_DEN, CELL, RISES, BENDS, OFF, OFF_VARIANCE = 5, 6, 7, 8, 9, 10, 11, 12, 13
CUT = 14  # deviation by light that is cut off at full scale


class Templates(NamedTuple):
    """Of the sides along X (0) and along Y (1) of one eye; taken once, filled every tick.

    Tables: the rows for pixels taken outwards (0, 1) and inwards (2, 3), see `table_of`. Pixels beyond taps weigh 0.
    """

    weight: NDArray[np.float32]  # (4, PHASES, COLUMNS, TAPS) what gives step, step times shift, blurring, level, ...
    pixel_weight: NDArray[np.float32]  # (4, PHASES, TAPS) of each pixel's square, 1 on the mean
    scale: FloatArray  # (2, PHASES, COLUMNS) lengths of step, shift and blurring, and what ACROSS ... BENDING name
    bent: FloatArray  # (2, 2) a linear shift f means f + bent[0] f2 + bent[1] f3
    blurred: FloatArray  # (2,) and what an edge blurred by 1 px more seems shifted by
    slowed: FloatArray  # (2,) and by what part of itself its shift seems larger
    gain: FloatArray  # (2,) distance from the edge per pixel across
    lit: FloatArray  # (2, 2) and by light that grows by its whole per px, on cell and line, for line - cell = 1
    taps: NDArray[np.int64]  # (2,) pixels across, 0: blur too wide for templates
    noise: FloatArray  # (2, 2) of the last tick: squared differences of neighbouring pixels on cell and line
    sums: FloatArray  # (MOST_SEGMENTS, SUMS) of the segments of the side being matched
    work: FloatArray  # (COLUMNS + 3, TAPS) templates, an edge shifted to either side, and pixels' weights, being filled
    share: FloatArray  # (COLUMNS, COLUMNS) of one column along another, see _orthonormal


def make_templates() -> Templates:
    """Take the tables."""
    return Templates(
        np.zeros((4, PHASES, COLUMNS, TAPS), np.float32),
        np.zeros((4, PHASES, TAPS), np.float32),
        np.zeros((2, PHASES, COLUMNS)),
        np.zeros((2, 2)),
        np.zeros(2),
        np.zeros(2),
        np.zeros(2),
        np.zeros((2, 2)),
        np.zeros(2, np.int64),
        np.zeros((2, 2)),
        np.zeros((MOST_SEGMENTS, SUMS)),
        np.zeros((COLUMNS + 3, TAPS)),
        np.zeros((COLUMNS, COLUMNS)),
    )


@tick_kernel
def table_of(row: int, outwards: bool) -> int:
    """Which table serves a side whose pixels, in the image's order, are taken outwards or inwards."""
    return row if outwards else row + 2


@tick_kernel
def choose_taps(blur_px: float, gain: float, room_px: float) -> int:
    """Pixels across an edge: more, where lines leave room_px of them on either side; 0 if the blur is too wide."""
    least = max(math.ceil(REACH_SIGMAS * blur_px / gain + REACH_PX), LEAST_HALF)
    half = min(max(math.floor(min(room_px, TAPS)), least), least + WIDER_PX, TAPS // 2)
    return 2 * half if half >= least else 0


@tick_kernel
def noise_ratio(noise: FloatArray) -> float:
    """Variance of a pixel on the line over that of one on the cell; 1 before any has told it."""
    if noise[INSIDE] <= 0.0:
        return 1.0
    return min(max(noise[LINE] / noise[INSIDE], 1.0 / NOISE_RANGE), NOISE_RANGE)


@tick_kernel
def fill_templates(step: FloatArray, blur_px: float, gain: float, room_px: float, row: int, out: Templates) -> None:
    """Fill the templates of one direction of sides, by the noise that the last tick's pixels had there.

    step: the table of tabulate_step. blur_px: the whole blur. gain: distance from the edge per pixel across, > 0.
    room_px: what the narrowest line leaves on either side of an edge.
    """
    ratio = noise_ratio(out.noise[row])
    out.noise[row] = 0.0
    out.gain[row] = gain
    out.taps[row] = taps = choose_taps(blur_px, gain, room_px)
    if taps == 0:
        return
    for table in (row, row + 2):
        out.weight[table] = 0.0
        out.pixel_weight[table] = 0.0
    half = taps // 2
    basis, share = out.work[:COLUMNS], out.share
    ahead, behind, pixel = out.work[COLUMNS], out.work[COLUMNS + 1], out.work[COLUMNS + 2]
    probed_ahead, probed_behind, blurred, slowed, lit_cell, lit_line = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for phase in range(PHASES):
        total = 0.0
        for k in range(taps):
            x = gain * (k - (half - 1) - (phase + 0.5) / PHASES)
            value, slope, change = look_up(step, x)
            basis[STEP, k], basis[SHIFT, k], basis[BLURRING, k], basis[LEVEL, k] = value, -gain * slope, change, 1.0
            basis[RISING, k], basis[BENDING, k] = x, x * x
            ahead[k], _, _ = look_up(step, x - gain * PROBE_PX)
            behind[k], _, _ = look_up(step, x + gain * PROBE_PX)
            pixel[k] = 1.0 / (1.0 + (ratio - 1.0) * value)
            total += pixel[k]
        scale, weight = out.scale[row, phase], out.weight[row, phase]
        for k in range(taps):
            pixel[k] *= taps / total
            out.pixel_weight[row, phase, k] = pixel[k]
        _orthonormal(basis, pixel, taps, share)
        for i in range(BLURRING + 1):
            scale[i] = share[i, i]
        scale[ACROSS] = along = share[SHIFT, STEP]
        # What the light laid over the edge adds to the shift's product, in terms of what it adds to the two templates.
        rising = share[RISING, SHIFT] / share[RISING, RISING]
        scale[BY_BENDING] = (share[BENDING, SHIFT] - rising * share[BENDING, RISING]) / share[BENDING, BENDING]
        scale[BY_RISING] = rising
        for k in range(taps):
            weight[SHIFT, k] = pixel[k] * basis[SHIFT, k] / scale[SHIFT]
            weight[STEP, k] = (pixel[k] * basis[STEP, k] - along * weight[SHIFT, k]) / scale[STEP]
            weight[BLURRING, k] = pixel[k] * basis[BLURRING, k]
            weight[LEVEL, k] = pixel[k] * basis[LEVEL, k]
            weight[RISING, k] = pixel[k] * basis[RISING, k] / scale[SHIFT]  # as noisy as the shift's product
            weight[BENDING, k] = pixel[k] * basis[BENDING, k] / scale[SHIFT]
        for k in range(taps):
            out.pixel_weight[row + 2, phase, taps - 1 - k] = pixel[k]
            x = gain * (k - (half - 1) - (phase + 0.5) / PHASES)
            value, _, _ = look_up(step, x)
            _, _, sooner = look_up(step, x - NEAR_PX)
            _, _, later = look_up(step, x + NEAR_PX)
            slowed += weight[SHIFT, k] * gain * (sooner - later) / (2.0 * NEAR_PX) / PHASES
            lit_cell += weight[SHIFT, k] * x * (1.0 - value) / PHASES
            lit_line += weight[SHIFT, k] * x * value / PHASES
            for i in range(COLUMNS):
                out.weight[row + 2, phase, i, taps - 1 - k] = weight[i, k]
        probed_ahead += _probe(weight, ahead, taps) / PHASES
        probed_behind += _probe(weight, behind, taps) / PHASES
        blurred += share[BLURRING, SHIFT] / scale[SHIFT] / PHASES
    # Two probes, two unknowns.
    p, q = probed_ahead, probed_behind
    det = p * p * q**3 - q * q * p**3
    out.bent[row, 0] = ((PROBE_PX - p) * q**3 - (-PROBE_PX - q) * p**3) / det
    out.bent[row, 1] = (p * p * (-PROBE_PX - q) - q * q * (PROBE_PX - p)) / det
    out.slowed[row] = slowed
    out.blurred[row], out.lit[row, INSIDE], out.lit[row, LINE] = blurred, lit_cell, lit_line


@tick_kernel
def _orthonormal(basis: FloatArray, pixel: FloatArray, taps: int, share: FloatArray) -> None:
    """Make the columns orthonormal under the pixels' weights, LEVEL first (Gram and Schmidt).

    Writes share (COLUMNS, COLUMNS): of column i along an earlier one j, and on the diagonal what is left of it.
    """
    for n in range(COLUMNS):
        i = LEVEL if n == 0 else n - 1 if n <= LEVEL else n
        for m in range(n):
            j = LEVEL if m == 0 else m - 1 if m <= LEVEL else m
            dot = 0.0
            for k in range(taps):
                dot += pixel[k] * basis[i, k] * basis[j, k]
            for k in range(taps):
                basis[i, k] -= dot * basis[j, k]
            share[i, j] = dot
        squares = 0.0
        for k in range(taps):
            squares += pixel[k] * basis[i, k] * basis[i, k]
        share[i, i] = math.sqrt(squares)
        for k in range(taps):
            basis[i, k] /= share[i, i]


@tick_kernel
def _probe(weight: NDArray[np.float32], edge: FloatArray, taps: int) -> float:
    """Linear shift that the templates make of an edge's pixels."""
    step, shift = 0.0, 0.0
    for k in range(taps):
        step += weight[STEP, k] * edge[k]
        shift += weight[SHIFT, k] * edge[k]
    return shift / step
