"""What light that changes across a cell, and grey values that are rounded, feign of its sides."""

import math

from fsw.vision.edges import FloatArray, Quad
from fsw.vision.perspective import centre_share
from fsw.vision.settling import LEAST_NOISE
from wingbeat.kernels import tick_kernel

EVEN_LIGHT = 0.1  # part of the light by which it may change across a cell: more is a shadow's edge, or a glint
UNEVEN = 0.5  # of what light that grows across a cell shifts sides by: it may grow unevenly
STEEPER = 3.0  # times as steep as on the mean across a cell: light laid over the side that a glint is nearest to
COARSE = 0.5  # variance of a pixel, above which rounding feigns less than a part in 20 000 of a grey value
# What a cell, or a line, that reads wrong by the whole contrast moves an edge by, in deviations of the whole blur: if
# matched with templates (1.6 where it is as noisy as the line, 2.2 where less), and if fitted, the next cell alike.
ROUNDED_MATCHED, ROUNDED_FITTED = 2.0, 0.9


@tick_kernel
def correct_light(quad: Quad, k: int) -> None:
    """Take off sides k and k + 2 what light feigns: where it is brighter, as the lines' contrast tells, they shift.

    Light that is laid over grows where the cell's own grey value does so by more than the contrast: how steep it is at
    the sides themselves is not known, so they are widened.
    """
    k2, extent = k + 2, quad.extent[k]
    lit = 2.0 * (quad.bright[k] - quad.bright[k2]) / (quad.bright[k] + quad.bright[k2])
    added = STEEPER * (quad.level[k] - quad.level[k2] - 0.5 * lit * (quad.level[k] + quad.level[k2])) / extent
    for side in (k, k2):
        quad.variance[side] += (quad.by_added[side] * added) ** 2
    if abs(lit) > EVEN_LIGHT:
        return
    for side, shift in ((k, quad.by_light[k] * lit / extent), (k2, -quad.by_light[k2] * lit / extent)):
        quad.middle[side] -= shift
        quad.variance[side] += (UNEVEN * shift) ** 2


@tick_kernel
def rounding(noise: FloatArray, grey: float) -> float:
    """Deviation of the mean of many pixels, all of one grey value, from it, for all are rounded alike.

    noise (2,): see Lens. Noise dithers: what is left of the sawtooth is the characteristic function of the noise
    (Widrow and Kollar, Quantization Noise, ch. 4 and 9), of which the largest term bounds the others.
    """
    dither = noise[0] + noise[1] * max(grey, 0.0) - LEAST_NOISE
    if dither > COARSE:
        return 0.0
    return math.sqrt(LEAST_NOISE) * math.exp(-2.0 * math.pi**2 * max(dither, 0.0))


@tick_kernel
def add_rounding(quad: Quad, covariance: FloatArray) -> None:
    """Widen a centre's covariance (3,), xx, xy, yy, by what the rounding of its cell's grey value feigns.

    It moves all sides of the cell outwards, or all inwards, so that the centre stays, unless their contrasts differ: in
    a shadow whose edge lies across the cell.
    """
    x, y = 0.0, 0.0
    for k in range(4):
        gx, gy = centre_share(quad.nx, quad.ny, k)
        x, y = x + gx * quad.rounded[k], y + gy * quad.rounded[k]
    covariance[0], covariance[1], covariance[2] = covariance[0] + x * x, covariance[1] + x * y, covariance[2] + y * y
