"""The straight line through a side's segments: what noise they share, which agree, and when it is nobody's."""

import math

from fsw.vision.edges import FloatArray
from wingbeat.kernels import tick_kernel

UNEXPLAINED = 2.0  # a straight side's chi-square above its mean, in standard deviations: what is beyond is not noise's
NOISIER = 6.0  # times the variance of the middle segment: luck does not reach so far, a glint or a shadow does
NO_SAY = 36.0  # times the variance of the surest segment: one so unsure agrees with any line
LEAST_VARIANCE = 1e-8  # px2, of a segment of an image without noise
SEGMENT_GATE_PX = 0.12  # a segment farther off the straight side than this (and 4 sigma) is a glint or a stain


@tick_kernel
def share_noise(segments: FloatArray, count: int) -> None:
    """Give the segments (count, 4) of a side one noise in common, but leave those that are far noisier their own.

    A segment has too few pixels to tell its noise: what is quiet by luck would weigh too much, and seem too good.
    """
    for i in range(count):
        segments[i, 2] = segments[i, 2] / segments[i, 3] if segments[i, 3] > 0.0 else 0.0
    limit = NOISIER * _middle(segments, count)
    total, alike = 0.0, 0
    for i in range(count):
        if segments[i, 2] <= limit:
            total += segments[i, 2]
            alike += 1
    for i in range(count):
        own = total / alike if segments[i, 2] <= limit else segments[i, 2]
        segments[i, 2] = segments[i, 3] * own + LEAST_VARIANCE


@tick_kernel
def _middle(segments: FloatArray, count: int) -> float:
    """Noise, segments[:, 2], of the segment that as many are quieter than as are noisier; of two such the quieter's."""
    for i in range(count):
        quieter, alike = 0, 0
        for j in range(count):
            quieter += segments[j, 2] < segments[i, 2]
            alike += segments[j, 2] == segments[i, 2]
        if quieter <= (count - 1) // 2 < quieter + alike:
            return float(segments[i, 2])
    return 0.0


@tick_kernel
def straight_side(segments: FloatArray, count: int, pieces: int) -> tuple[bool, bool, float, float, float, float]:
    """Weighted straight line through segment offsets: good, firm, offset at the middle, slope, its variance, residual.

    Segments far off the line are dropped one by one, as long as half of all `pieces` of the side agree; it is firm if
    more than half do. One far less sure than the surest has no say in that: it would agree with any line.
    """
    limit = math.inf
    for i in range(count):
        limit = min(limit, NO_SAY * segments[i, 2])
    while True:
        s0, s1, s2, t0, t1 = 0.0, 0.0, 0.0, 0.0, 0.0
        kept, agree = 0, 0
        for i in range(count):
            if segments[i, 2] < 0.0:
                continue
            w, x, y = 1.0 / segments[i, 2], segments[i, 0], segments[i, 1]
            s0, s1, s2 = s0 + w, s1 + w * x, s2 + w * x * x
            t0, t1 = t0 + w * y, t1 + w * x * y
            kept += 1
            agree += segments[i, 2] <= limit
        det = s0 * s2 - s1 * s1
        if kept < 2 or 2 * agree < pieces or det <= 1e-9 * s0 * s0:
            return False, False, 0.0, 0.0, 0.0, 0.0
        middle, slope = (s2 * t0 - s1 * t1) / det, (s0 * t1 - s1 * t0) / det
        worst, which, squares, chi2 = 1.0, -1, 0.0, 0.0
        for i in range(count):
            if segments[i, 2] < 0.0:
                continue
            r = segments[i, 1] - middle - slope * segments[i, 0]
            squares += r * r
            chi2 += r * r / segments[i, 2]
            gate2 = max(SEGMENT_GATE_PX**2, 16.0 * segments[i, 2])
            if r * r > worst * gate2:
                worst, which = r * r / gate2, i
        if which < 0 or kept <= 2:
            break
        segments[which, 2] = -1.0
    if which >= 0:
        return False, False, 0.0, 0.0, 0.0, 0.0
    # Scatter beyond what the pixels explain is no noise that a mean would lessen: a stain or a glint bends the side.
    # Its share in the scatter grows evenly, for noise alone comes near.
    variance, freedom = s2 / det, kept - 2
    limit = freedom + UNEXPLAINED * math.sqrt(2.0 * freedom)
    if chi2 > limit:
        variance += (1.0 - limit / chi2) * squares / kept
    return True, 2 * agree > pieces, middle, slope, variance, math.sqrt(squares / kept)
