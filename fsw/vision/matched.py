"""A side beside a wide line or a border, matched strip by strip with the templates of its direction."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.blur import PIXEL_VARIANCE
from fsw.vision.edges import BLUR, OWN, RIGHT, SEGMENTS, FloatArray, Image, Scratch
from fsw.vision.lanes import LANES
from fsw.vision.sides import MIN_CONTRAST, NOISE_GATE, Lens, inset_px, share_noise
from fsw.vision.strips import (
    MOST_STRIPS,
    Curve,
    Point,
    drift_variance,
    follow,
    four_columns,
    four_rows,
    one_column,
    one_row,
    place_at,
    strip_columns,
    two_columns,
    two_rows,
)
from fsw.vision.templates import ACROSS, BLURRING, INSIDE, LEVEL, LINE, PHASES, PROBE_PX, SHIFT, STEP, table_of
from wingbeat.kernels import kernel

SEGMENT_STRIPS = 4  # that a segment has at least
JUDGED = 16  # every so many strips are asked for what the model leaves over


class Way(NamedTuple):
    """How a side is read: along image columns or rows, how many columns a strip has, and from strip to strip.

    outwards: whether the image's pixels are numbered outwards, too. row, table, taps: see Templates.
    """

    vertical: bool
    outwards: bool
    each: int
    apart: int
    row: int
    table: int
    taps: int


# Columns of sums over a segment's strips: how many there are, the step b and c, which is b times the shift in pixels;
COUNT, B, BB, BC, CC = 0, 1, 2, 3, 4
# and of every JUDGED-th: how many, squares that the model leaves over, the correction of the blur and its weight.
JUDGES, REST, BLUR_NUM, BLUR_DEN = 5, 6, 7, 8


@kernel
def match_strips(
    image: Image,
    curve: Curve,
    way: Way,
    first: int,
    strips: int,
    pieces: int,
    weight: NDArray[np.float32],
    own: NDArray[np.float32],
    scale: FloatArray,
    noise: FloatArray,
    pixel: NDArray[np.float32],
    sums: FloatArray,
) -> None:
    """Match the strips of a side, from column `first` on, and add them up piece by piece to sums (pieces, SUMS).

    weight, own (pixel_weight), scale, noise, pixel, sums: of Templates. Adds to the noise of their pixels.
    """
    vertical, each, apart, row = way.vertical, way.each, way.apart, way.row
    limit_along, limit_across = (image.shape[1], image.shape[0]) if vertical else image.shape
    half, sign = way.taps // 2, 1.0 if way.outwards else -1.0
    taps, table = np.uintp(way.taps), np.uintp(way.table)
    for piece in range(pieces):
        count, judged, sb, sbb, sbc, scc = 0, 0, 0.0, 0.0, 0.0, 0.0
        rest, blur_num, blur_den = 0.0, 0.0, 0.0
        for i in range(strips * piece // pieces, strips * (piece + 1) // pieces):
            along = first + i * apart
            # Places are counted outwards, as the templates are.
            centre = sign * place_at(curve, along + 0.5 * (each - 1))
            base = math.floor(centre)
            least = base - half + 1 if way.outwards else -base - half
            if along < 0 or along + each > limit_along or least < 0 or least + way.taps > limit_across:
                continue
            if not vertical and along + each == limit_along and least + LANES > limit_across:
                continue  # lanes beyond the taps would lie behind the image
            place = (centre - base) * PHASES
            phase = min(int(place), PHASES - 1)
            # Indices without a sign need no look at the array's other end.
            a, n, p = np.uintp(along), np.uintp(least), np.uintp(phase)
            if vertical and each == 4:
                b, shift = four_columns(image, n, a, taps, weight, table, p, pixel)
            elif vertical and each == 2:
                b, shift = two_columns(image, n, a, taps, weight, table, p, pixel)
            elif vertical:
                b, shift = one_column(image, n, a, taps, weight, table, p, pixel)
            elif each == 4:
                b, shift = four_rows(image, a, n, taps, weight, table, p, pixel)
            elif each == 2:
                b, shift = two_rows(image, a, n, taps, weight, table, p, pixel)
            else:
                b, shift = one_row(image, a, n, taps, weight, table, p, pixel)
            c = shift - b * (place - phase - 0.5) * (1.0 / PHASES)
            sb, sbb, sbc, scc = sb + b, sbb + b * b, sbc + b * c, scc + c * c
            if count % JUDGED == 0:
                squares, level, blurring = 0.0, 0.0, 0.0
                for k in range(way.taps):
                    grey = float(pixel[k] - pixel[0])
                    squares += own[table, p, k] * grey * grey
                    level += weight[table, p, LEVEL, k] * grey
                    blurring += weight[table, p, BLURRING, k] * grey
                step = b * scale[row, p, STEP] + shift * scale[row, p, ACROSS]
                across, size = shift * scale[row, p, SHIFT], b * scale[row, p, BLURRING]
                rest += squares - level * level - step * step - across * across - blurring * blurring
                blur_num += size * blurring
                blur_den += size * size
                low, high = float(pixel[1] - pixel[0]), float(pixel[way.taps - 1] - pixel[way.taps - 2])
                noise[row, INSIDE] += low * low if way.outwards else high * high
                noise[row, LINE] += high * high if way.outwards else low * low
                judged += 1
            count += 1
        sums[piece, COUNT], sums[piece, B], sums[piece, BB], sums[piece, BC], sums[piece, CC] = count, sb, sbb, sbc, scc
        sums[piece, JUDGES], sums[piece, REST] = judged, rest
        sums[piece, BLUR_NUM], sums[piece, BLUR_DEN] = blur_num, blur_den


@kernel
def match_segments(
    image: Image,
    lens: Lens,
    start: Point,
    end: Point,
    normal: Point,
    lean_px: float,
    row: int,
    sign: float,
    scratch: Scratch,
) -> tuple[int, int, float]:
    """As fit_segments, by the templates of one direction of sides, where both plateaus are wide enough.

    lean_px: see inset_px.
    """
    # Arrays are taken out of their tuples once: each time costs two atomic counts.
    intrinsics, distortion, pooled, segments = lens.intrinsics, lens.distortion, scratch.pooled, scratch.segments
    weight, own, scale = scratch.templates.weight, scratch.templates.pixel_weight, scratch.templates.scale
    noise, pixel, taps = scratch.templates.noise, scratch.templates.pixel, scratch.templates.taps[row]
    square, cube = scratch.templates.bent[row, 0], scratch.templates.bent[row, 1]
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    inset = inset_px(length, lens.blur_px, lean_px) / length
    near, far = (start[0] + inset * dx, start[1] + inset * dy), (end[0] - inset * dx, end[1] - inset * dy)
    vertical, gain, begin, stop, curve = follow(near, far, normal, intrinsics, distortion)
    first = math.ceil(min(begin, stop))
    columns = math.floor(max(begin, stop)) - first + 1
    each = strip_columns(curve[2], columns)
    apart = each * (1 + columns // (each * MOST_STRIPS))  # a huge cell's columns need not all be read
    way = Way(vertical, gain > 0.0, each, apart, row, table_of(row, gain > 0.0), taps)
    strips = columns // apart
    first += (columns - strips * apart) // 2
    pieces = min(SEGMENTS, max(2, strips // SEGMENT_STRIPS))
    # A strip along which the edge drifts looks more blurred, and so does an edge more askew to the pixels than the
    # templates; an edge more blurred looks shifted.
    lens_px = math.sqrt(lens.blur_px**2 - PIXEL_VARIANCE)
    whole2, mean2 = lens.blur_px**2, scratch.templates.gain[row] ** 2
    wider = (mean2 * (whole2 / (gain * gain) + drift_variance(curve[2], each)) - whole2) / (2.0 * lens_px)
    seeming = scratch.templates.blurred[row] * wider
    sums = scratch.templates.sums
    match_strips(image, curve, way, first, strips, pieces, weight, own, scale, noise, pixel, sums)
    found, contrast = 0, 0.0
    for piece in range(pieces):
        begun, ended = strips * piece // pieces, strips * (piece + 1) // pieces
        count, b, bb, bc = sums[piece, COUNT], sums[piece, B], sums[piece, BB], sums[piece, BC]
        if count < SEGMENT_STRIPS or 2.0 * count < ended - begun or sign * b <= MIN_CONTRAST * count * each:
            continue
        step = abs(b) / (count * each)
        if sums[piece, REST] > sums[piece, JUDGES] * (taps - 4.0) * each * (NOISE_GATE * step) ** 2:
            continue
        shift = bc / bb
        variance = (sums[piece, CC] - shift * bc) / ((count - 1.0) * bb)
        shift = shift * (1.0 + square * shift + cube * shift * shift) - seeming
        away = abs(gain) * shift
        middle = first + 0.5 * (begun + ended) * apart - 0.5
        segments[found, 0] = (1.0 - 2.0 * inset) * ((middle - begin) / (stop - begin) - 0.5)
        segments[found, 1] = min(max(away, -lens.blur_px), lens.blur_px)
        segments[found, 2] = gain * gain * max(variance, 0.0)
        segments[found, 3] = gain * gain / bb
        if abs(away) < PROBE_PX:
            # To second order a shift looks like blur: the change with blur is blur times the second derivative.
            off = away * away / (2.0 * lens_px) + wider
            pooled[BLUR, RIGHT] += (sums[piece, BLUR_NUM] - sums[piece, BLUR_DEN] * off) / each
            pooled[BLUR, OWN] += sums[piece, BLUR_DEN] / each
        contrast += step
        found += 1
    share_noise(segments, found)
    return pieces, found, contrast / max(found, 1)
