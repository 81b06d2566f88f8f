"""Light laid over a side that is matched with templates, or cut off at full scale: told from noise, and taken off."""

import math

from fsw.vision.edges import FloatArray
from fsw.vision.sides import is_noise
from fsw.vision.strips import Strips, Way
from fsw.vision.templates import BB, BENDS, COUNT, JUDGES, OFF, OFF_VARIANCE, PROBE_PX, RISES, B
from wingbeat.kernels import tick_kernel

UNSURE = 0.5  # of what light laid over a side feigns, for it need be no parabola
CLIPPED = 0.98  # of full scale: a mean of pixels whose noise reaches it
CLIPPED_PX = 3  # of the line in a strip, any of which tells


@tick_kernel
def is_clipped(strips: Strips, way: Way, strip: int, full: float) -> bool:
    """Whether the line reads full scale in a strip, where light may be cut off."""
    start = strips.start[strip]
    outermost = start + way.taps - 1 if way.outwards else start
    inwards = -1 if way.outwards else 1
    for k in range(CLIPPED_PX if start >= 0 else 0):
        if strips.lines[strip, outermost + k * inwards] >= CLIPPED * full * way.each:
            return True
    return False


@tick_kernel
def is_even(segments: FloatArray, sums: FloatArray, found: int, gain: float) -> bool:
    """Whether what the segments (found, 4) show of light laid over the edge, sums (found, SUMS), is noise.

    An edge far from where the templates expect it shows more than they know; it is matched again where it was found.
    """
    chi2, near = 0.0, 0
    for i in range(found):
        if abs(segments[i, 1]) > PROBE_PX:
            continue
        near += 1
        noise = segments[i, 2] * sums[i, BB] / (gain * gain)
        chi2 += (sums[i, RISES] ** 2 + sums[i, BENDS] ** 2) / (sums[i, JUDGES] * noise)
    return is_noise(chi2, 2 * near)


@tick_kernel
def least_noise(segments: FloatArray, sums: FloatArray, found: int, gain: float) -> float:
    """Noise of a strip's shift product in the quietest of the segments (found, 4)."""
    least = math.inf
    for i in range(found):
        least = min(least, segments[i, 2] * sums[i, BB] / (gain * gain))
    return least


@tick_kernel
def feigned_alike(segments: FloatArray, sums: FloatArray, found: int, gain: float) -> float:
    """Mean of what light laid over the edge feigns in the segments (found, 4), px: what a finger beside all of it does.

    What all segments have alike no mean over them lessens.
    """
    alike, near = 0.0, 0
    for i in range(found):
        if abs(segments[i, 1]) <= PROBE_PX:
            alike, near = alike + _feigned(sums, i, gain), near + 1
    return alike / max(near, 1)


@tick_kernel
def take_off_light(segments: FloatArray, sums: FloatArray, found: int, gain: float) -> None:
    """Take off the segments' offsets (found, 4) what light laid over the edge feigns, and widen them by its noise."""
    for i in range(found):
        if abs(segments[i, 1]) > PROBE_PX:
            continue
        feigned = _feigned(sums, i, gain)
        segments[i, 1] -= feigned
        judged, step = sums[i, JUDGES], sums[i, B] / sums[i, COUNT]
        noise2 = segments[i, 2] * sums[i, BB] * sums[i, OFF_VARIANCE] / (judged * step) ** 2
        segments[i, 2] += noise2 + (UNSURE * feigned) ** 2


@tick_kernel
def _feigned(sums: FloatArray, i: int, gain: float) -> float:
    """What the light laid over segment i feigns, px."""
    return abs(gain) * sums[i, OFF] * sums[i, COUNT] / (sums[i, JUDGES] * sums[i, B])
