"""A step of brightness as the lens and the pixel show it, in a table, so that fits need no special functions."""

import math

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import tick_kernel

FloatArray = NDArray[np.float64]

# The blurred step is tabulated over +-16 px, four deviations of the widest blur, at steps of 1/64 px: straight
# interpolation is then right to 2e-5.
STEP_REACH_PX = 16.0
STEP_PER_PX = 64
STEP_ROWS = int(2 * STEP_REACH_PX * STEP_PER_PX) + 1
FAR_SIGMAS = 8.3  # of a Gaussian, beyond which no more than rounding is left
PIXEL_VARIANCE = 1.0 / 12.0  # of that average: what the sensor adds to the lens's blur


@tick_kernel
def tabulate_step(blur_px: float, out: FloatArray) -> None:
    """Fill out (STEP_ROWS, 3) with a unit step seen through lens and pixel, its slope, and its change with blur.

    The lens blurs by a Gaussian of standard deviation blur_px, the pixel averages over its width.
    """
    out[:] = 0.0
    half, middle = STEP_PER_PX // 2, STEP_ROWS // 2
    far = min(int(FAR_SIGMAS * blur_px * STEP_PER_PX) + 1, middle)
    for j in range(far + 2 * half):  # each value of the Gaussian serves both sides of the step
        z, beyond, pdf = j / STEP_PER_PX / blur_px, 0.0, 0.0
        if z < FAR_SIGMAS:
            beyond = 0.5 * math.erfc(z / math.sqrt(2.0))
            pdf = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
        _add_end(middle + j, z, 1.0 - beyond, pdf, blur_px, half, out)
        if j > 0:
            _add_end(middle - j, -z, beyond, pdf, blur_px, half, out)
    for i in range(middle + far + half, STEP_ROWS):  # no blur reaches there
        out[i, 0], out[i, 1], out[i, 2] = 1.0, 0.0, 0.0


@tick_kernel
def _add_end(j: int, z: float, cdf: float, pdf: float, blur_px: float, half: int, out: FloatArray) -> None:
    """Add to a table what lies at place j: the upper end of one pixel, and the lower end of another."""
    for i, sign in ((j - half, 1.0), (j + half, -1.0)):
        if 0 <= i < STEP_ROWS:
            out[i, 0] += sign * blur_px * (z * cdf + pdf)
            out[i, 1] += sign * cdf
            out[i, 2] += sign * pdf


@tick_kernel
def look_up(step: FloatArray, x: float) -> tuple[float, float, float]:
    """Blurred unit step, slope and change with blur at x px, from the table."""
    place = (x + STEP_REACH_PX) * STEP_PER_PX
    if place <= 0.0:
        return 0.0, 0.0, 0.0
    i = int(place)
    if i >= STEP_ROWS - 1:
        return 1.0, 0.0, 0.0
    f = place - i
    # Element by element: a row taken as an array of its own would cost more than all the rest.
    a0, a1, a2 = step[i, 0], step[i, 1], step[i, 2]
    return a0 + f * (step[i + 1, 0] - a0), a1 + f * (step[i + 1, 1] - a1), a2 + f * (step[i + 1, 2] - a2)
