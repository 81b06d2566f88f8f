"""One side of a cell: what is told of it, and its segments, fitted one by one."""

import math
from typing import NamedTuple

from fsw.vision.blur import PIXEL_VARIANCE, tabulate_step
from fsw.vision.edges import (
    BLUR,
    COMMON,
    EACH,
    OWN,
    RIGHT,
    SEGMENTS,
    WIDTH,
    FloatArray,
    Image,
    Scratch,
    gather,
)
from fsw.vision.hot import LEAST_LINE_PX
from fsw.vision.profile import fit_profile
from fsw.vision.rig import Eyes, distort_point, norm
from fsw.vision.straight import share_noise
from wingbeat.kernels import inline_kernel, tick_kernel

SEGMENT_PX = 12.0  # a segment shorter than this has too few pixels to judge
SEGMENT_COLUMNS = 6.0  # that a segment should have, before any are left out
MIN_CONTRAST = 4.0  # grey values between cell and line, and ...
NOISE_GATE = 0.35  # ... the largest ratio of residual to contrast
UNEVEN = 4.0  # chi-square of light laid over a side above its mean, in standard deviations: more is not noise's
UNSETTLED_PX = 0.2  # a side that asks for so much more or less blur cannot tell light laid over it from that
CLIPPED_SHARE = 0.5  # of the blur, by which an edge may seem shifted where light is cut off at full scale


class Lens(NamedTuple):
    """One eye: fx, fy, cx, cy; k1 k2 p1 p2 k3; its whole blur across sides along X, or along Y, the table of a step
    so blurred, and its noise.

    noise (2,): variance of a pixel, at grey value 0 and its growth with the grey value.
    """

    intrinsics: FloatArray
    distortion: FloatArray
    blur_px: float
    step: FloatArray
    noise: FloatArray


class Side(NamedTuple):
    """The segments of a side: how many there are, how many were good; means over these, as in Quad."""

    pieces: int
    found: int
    bright: float
    level: float
    by_light: float
    by_added: float
    by_blur: float
    by_width: float
    alike_px2: float  # variance that all segments have in common, which no mean over them lessens


@tick_kernel
def lens_of(eyes: Eyes, eye: int, blur_px: float, step: FloatArray, noise: FloatArray) -> Lens:
    """An eye whose lens blurs by blur_px across sides along X, or along Y; step (STEP_ROWS, 3): written."""
    tabulate_step(blur_px, step)
    whole = math.sqrt(blur_px * blur_px + PIXEL_VARIANCE)
    return Lens(eyes.intrinsics[eye], eyes.distortion[eye], whole, step, noise)


@tick_kernel
def inset_px(length_px: float, blur_px: float, lean_px: float = 0.0) -> float:
    """How much of a side is left out at either end, where the corner's blur is seen.

    lean_px: by how much the samples across the side come nearer to a corner at their ends, as the sides there lean.
    """
    return min(0.25 * length_px, max(3.0 * blur_px + 1.0 + lean_px, 0.06 * length_px))


@tick_kernel
def is_noise(chi2: float, freedom: int) -> bool:
    """Whether a chi-square of what light laid over a side does is no larger than noise makes it."""
    return chi2 <= freedom + UNEVEN * math.sqrt(2.0 * freedom)


@tick_kernel
def is_settled(right: float, own: float) -> bool:
    """Whether a side is as blurred as expected, by its part of the normal equation of the blur."""
    return abs(right) <= UNSETTLED_PX * own


@inline_kernel
def fit_segments(
    image: Image,
    lens: Lens,
    start: tuple[float, float],
    end: tuple[float, float],
    normal: tuple[float, float],
    window_px: tuple[float, float],
    widths_px: tuple[float, float],
    lean_px: float,
    row: int,
    sign: float,
    stride: int,
    scratch: Scratch,
) -> Side:
    """Fit the segments of the side between two ideal points.

    widths_px: of the line, at both ends; 0: none. lean_px: see inset_px.
    """
    blur = lens.blur_px
    length = norm(end[0] - start[0], end[1] - start[1])
    inset = inset_px(length, blur, lean_px)
    pieces = int(min(float(SEGMENTS), max(2.0, (length - 2.0 * inset) / SEGMENT_PX)))
    # Short sides have few columns: take more of them.
    stride = int(max(1.0, min(float(stride), (length - 2.0 * inset) / (pieces * SEGMENT_COLUMNS))))
    wide = widths_px[0] == 0.0 or min(widths_px[0], widths_px[1]) > LEAST_LINE_PX
    misfit, feigned2, feigned, chi2 = scratch.misfit, scratch.feigned2, 0.0, 0.0
    found, contrast, level, by_light, by_added, by_blur, by_width = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    blur_right, blur_own = 0.0, 0.0
    for piece in range(pieces):
        f0 = (inset + (length - 2.0 * inset) * piece / pieces) / length
        f1 = (inset + (length - 2.0 * inset) * (piece + 1) / pieces) / length
        u0, v0 = start[0] + f0 * (end[0] - start[0]), start[1] + f0 * (end[1] - start[1])
        u1, v1 = start[0] + f1 * (end[0] - start[0]), start[1] + f1 * (end[1] - start[1])
        x0, y0, _, _, _, _ = distort_point(u0, v0, lens.intrinsics, lens.distortion)
        x1, y1, _, _, _, _ = distort_point(u1, v1, lens.intrinsics, lens.distortion)
        _, _, xx, xy, yx, yy = distort_point(0.5 * (u0 + u1), 0.5 * (v0 + v1), lens.intrinsics, lens.distortion)
        # How far a step of one image pixel, along x or along y, leads away from the side, in ideal pixels.
        det = xx * yy - xy * yx
        gain_x = (yy * normal[0] - yx * normal[1]) / det
        gain_y = (xx * normal[1] - xy * normal[0]) / det
        vertical = abs(gain_y) > abs(gain_x)
        gain = gain_y if vertical else gain_x
        ends = ((x0, y0), (x1, y1))
        whole, cut_off = gather(image, ends, gain, vertical, window_px, stride, wide or not vertical, scratch)
        width = widths_px[0] + 0.5 * (f0 + f1) * (widths_px[1] - widths_px[0])
        fit = fit_profile(scratch, lens.step, lens.noise, width, blur, whole)
        step = sign * (fit.line - fit.inside)
        if fit.good and step > MIN_CONTRAST and fit.residual < NOISE_GATE * step:
            scratch.segments[found, 0] = 0.5 * (f0 + f1) - 0.5
            scratch.segments[found, 1] = fit.offset_px
            scratch.segments[found, 2] = fit.variance_px2
            scratch.segments[found, 3] = fit.expected_px2
            misfit[found] = fit.misfit_px2 + ((CLIPPED_SHARE * blur) ** 2 if cut_off else 0.0)
            feigned2[found] = fit.added_px**2
            feigned += fit.added_px
            chi2 += fit.added_chi2
            contrast, level = contrast + step, level + fit.inside
            by_blur, by_width = by_blur + fit.blur_pull, by_width + fit.width_pull_px
            by_light, by_added = by_light + fit.light_pull_px2, by_added + fit.added_pull_px2
            blur_right, blur_own = blur_right + scratch.fresh[BLUR, RIGHT], blur_own + scratch.fresh[BLUR, OWN]
            if not cut_off:  # a line cut off at full scale looks wider, and its edges sharper
                _pool(scratch, row)
            found += 1
    share_noise(scratch.segments, found)
    doubtful = not is_noise(chi2, found)
    even = not doubtful or not is_settled(blur_right, blur_own)
    for i in range(found):  # what is quieter than the eye's noise is so by luck
        scratch.segments[i, 2] = max(scratch.segments[i, 2], scratch.segments[i, 3]) + misfit[i]
        if not even:
            scratch.segments[i, 2] += feigned2[i]
    good = max(found, 1)
    of_light, of_blur = (by_light / good, by_added / good), (by_blur / good, by_width / good)
    alike2 = (feigned / good) ** 2 if doubtful else 0.0
    return Side(pieces, found, contrast / good, level / good, *of_light, *of_blur, alike2)


@tick_kernel
def _pool(scratch: Scratch, row: int) -> None:
    """Add what the last edge, of the sides along X (0) or along Y (1), says of blur, width and noise to what all do."""
    for i in range(3):
        for k in (BLUR, WIDTH):
            scratch.pooled[EACH * row + k, i] += scratch.fresh[k, i]
        for k in range(2):
            scratch.pooled[COMMON + k, i] += scratch.fresh[2 + k, i]
