"""A side beside a wide line or a border, matched strip by strip with the templates of its direction."""

import math

import numpy as np

from fsw.vision.ahead import ask
from fsw.vision.blur import PIXEL_VARIANCE
from fsw.vision.edges import BLUR, EACH, OWN, RIGHT, SEGMENTS, Image, Scratch
from fsw.vision.lanes import LANES
from fsw.vision.profile import MISFIT
from fsw.vision.rig import norm
from fsw.vision.settling import tell_noise
from fsw.vision.sides import CLIPPED_SHARE, MIN_CONTRAST, NOISE_GATE, Lens, Side, inset_px, is_settled
from fsw.vision.stains import UNSURE, feigned_alike, is_clipped, is_even, least_noise, take_off_light
from fsw.vision.straight import NOISIER, share_noise
from fsw.vision.strips import Point, Way, column_of, drift_variance, follow, read_strips, way_along
from fsw.vision.templates import (
    ACROSS,
    BB,
    BC,
    BENDS,
    BLUR_DEN,
    BLUR_NUM,
    BLURRING,
    BY_BENDING,
    BY_RISING,
    CC,
    CELL,
    COLUMNS,
    COUNT,
    CUT,
    INSIDE,
    JUDGES,
    LINE,
    OFF,
    OFF_VARIANCE,
    PHASES,
    PROBE_PX,
    REST,
    RISES,
    SHIFT,
    STEP,
    SUMS,
    B,
    table_of,
)
from fsw.vision.weighing import TAKEN, add_strips, weigh_others, weigh_strips
from wingbeat.kernels import inline_kernel

SEGMENT_STRIPS = 4  # that a segment has at least
JUDGED = 16  # one of so many strips is asked for what the model leaves over


@inline_kernel
def match_strips(
    image: Image, way: Way, row: int, pieces: int, judged_each: int, most: float, scratch: Scratch
) -> None:
    """Match the strips of a side with the templates of this row, and add them up piece by piece to their sums.

    judged_each: of so many strips side by side one is judged. most: squares that the model of a judged one may leave
    over. Adds to the noise of their pixels. With each piece, the image is asked for more of what is ahead.
    """
    strips, weight, own = scratch.strips, scratch.templates.weight, scratch.templates.pixel_weight
    scale, noise, sums = scratch.templates.scale, scratch.templates.noise, scratch.templates.sums
    lines, starts, product, last = strips.lines, strips.start, strips.product, way.taps - 1
    table = np.uintp(table_of(row, way.outwards))
    for i in range(0, way.strips, LANES):
        weigh_strips(lines, starts, weight, table, strips.phase, strips.rest, product, np.uintp(i))
    ended = 0
    for piece in range(pieces):
        ask(image, scratch.ahead)
        begun, ended = ended, way.strips * (piece + 1) // pieces
        judged, rest, blur_num, blur_den, cell = 0, 0.0, 0.0, 0.0, 0.0
        rises, bends, off, off_variance = 0.0, 0.0, 0.0, 0.0
        for first in range(begun, ended, judged_each):
            i, stop = first, min(first + judged_each, ended)
            while i < stop and product[TAKEN, i] == 0.0:
                i += 1
            if i == stop:
                continue
            s = np.uintp(i)
            start, b = starts[s], product[STEP, s]
            shift = product[SHIFT, s] + b * strips.rest[s]
            at, p = np.uintp(start), np.uintp(strips.phase[s])
            blurring, level, rise, bend, squares = weigh_others(lines, s, at, weight, own, table, p)
            step = b * scale[row, p, STEP] + shift * scale[row, p, ACROSS]
            across, size = shift * scale[row, p, SHIFT], b * scale[row, p, BLURRING]
            left = squares - level * level - step * step - across * across - blurring * blurring
            left = left / scale[row, p, SHIFT] ** 2 - rise * rise - bend * bend  # as noisy as the shift's product
            if left > most:
                product[STEP, s] = product[SHIFT, s] = product[TAKEN, s] = 0.0
                continue
            rest += left
            blur_num += size * blurring
            blur_den += size * size
            low, high = lines[i, start + 1] - lines[i, start], lines[i, start + last] - lines[i, start + last - 1]
            noise[row, INSIDE] += low * low if way.outwards else high * high
            noise[row, LINE] += high * high if way.outwards else low * low
            cell += lines[i, start] if way.outwards else lines[i, start + last]
            by_rise, by_bend = scale[row, p, BY_RISING], scale[row, p, BY_BENDING]
            rises, bends, off = rises + rise, bends + bend, off + by_rise * rise + by_bend * bend
            off_variance += by_rise * by_rise + by_bend * by_bend
            judged += 1
        count, sb, sbb, sbc, scc = add_strips(product, np.uintp(begun), np.uintp(ended))
        sums[piece, COUNT], sums[piece, B], sums[piece, BB], sums[piece, BC], sums[piece, CC] = count, sb, sbb, sbc, scc
        sums[piece, JUDGES], sums[piece, REST] = judged, rest
        sums[piece, BLUR_NUM], sums[piece, BLUR_DEN], sums[piece, CELL] = blur_num, blur_den, cell
        sums[piece, RISES], sums[piece, BENDS] = rises, bends
        sums[piece, OFF], sums[piece, OFF_VARIANCE] = off, off_variance


@inline_kernel
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
) -> Side:
    """As fit_segments, by the templates of one direction of sides, if plateaus are wide enough.

    lean_px: see inset_px.
    """
    intrinsics, distortion, pooled, segments = lens.intrinsics, lens.distortion, scratch.pooled, scratch.segments
    scale, sums, taps = scratch.templates.scale, scratch.templates.sums, scratch.templates.taps[row]
    noise = scratch.templates.noise
    square, cube = scratch.templates.bent[row, 0], scratch.templates.bent[row, 1]
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = norm(dx, dy)
    inset = inset_px(length, lens.blur_px, lean_px) / length
    near, far = (start[0] + inset * dx, start[1] + inset * dy), (end[0] - inset * dx, end[1] - inset * dy)
    vertical, gain, begin, stop, curve = follow(near, far, normal, intrinsics, distortion)
    way = way_along(vertical, gain > 0.0, begin, stop, curve[2], taps)
    count, each = way.strips, way.each
    pieces = min(SEGMENTS, max(2, count // SEGMENT_STRIPS))
    # A strip along which the edge drifts looks more blurred, and so does an edge more askew to the pixels than the
    # templates; an edge more blurred looks shifted, and its shift smaller.
    lens_px = math.sqrt(lens.blur_px**2 - PIXEL_VARIANCE)
    whole2, mean2 = lens.blur_px**2, scratch.templates.gain[row] ** 2
    wider = (mean2 * (whole2 / (gain * gain) + drift_variance(curve[2], each)) - whole2) / (2.0 * lens_px)
    seeming, slowed = scratch.templates.blurred[row] * wider, 1.0 + scratch.templates.slowed[row] * wider
    read_strips(image, curve, way, scratch.strips)
    lit_cell, lit_line = scratch.templates.lit[row, INSIDE], scratch.templates.lit[row, LINE]
    full, product2 = float(scratch.full[0]), scale[row, PHASES // 2, SHIFT] ** 2
    even, doubtful, most = True, False, math.inf
    for judged_each in (JUDGED, 1):
        cell_noise, line_noise, judged = -noise[row, INSIDE], -noise[row, LINE], 0.0
        match_strips(image, way, row, pieces, judged_each, most, scratch)
        found, contrast, level, by_light, inverse, blur_num, blur_den = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        scatter, rests, freedoms, stiff = 0.0, 0.0, 0.0, 0.0
        ended = 0
        for piece in range(pieces):
            begun, ended, judged = ended, way.strips * (piece + 1) // pieces, judged + sums[piece, JUDGES]
            count, b, bb, bc = sums[piece, COUNT], sums[piece, B], sums[piece, BB], sums[piece, BC]
            if count < SEGMENT_STRIPS or 2.0 * count < ended - begun or sign * b <= MIN_CONTRAST * count * each:
                continue
            step = abs(b) / (count * each)
            rest, freedom = sums[piece, REST], sums[piece, JUDGES] * (taps - COLUMNS)
            if rest * product2 > freedom * each * (NOISE_GATE * step) ** 2:
                continue
            shift = bc / bb
            # A few strips may agree by luck: what no template explains across them tells the same noise.
            squares = sums[piece, CC] - shift * bc + rest
            variance = squares / ((count - 1.0 + freedom) * bb)
            scatter, stiff = scatter + (squares - rest) / (count - 1.0), stiff + bb / count
            rests, freedoms = rests + rest, freedoms + freedom
            shift = (shift - seeming) / slowed
            shift = shift * (1.0 + square * shift + cube * shift * shift)
            away = abs(gain) * shift
            middle = 0.5 * (column_of(way, begun) + column_of(way, ended - 1) + each - 1)
            segments[found, 0] = (1.0 - 2.0 * inset) * ((middle - begin) / (stop - begin) - 0.5)
            segments[found, 1] = min(max(away, -lens.blur_px), lens.blur_px)
            segments[found, 2] = gain * gain * max(variance, 0.0)
            cell = sums[piece, CELL] / (max(sums[piece, JUDGES], 1.0) * each)
            # Of a pixel as bright as the edge's middle: where light is laid over, there is more noise.
            brightness = max(cell + 0.5 * sign * step, 0.0)
            segments[found, 3] = gain * gain / bb * (lens.noise[0] + lens.noise[1] * brightness)
            clipped = is_clipped(scratch.strips, way, begun, full) or is_clipped(scratch.strips, way, ended - 1, full)
            if abs(away) < PROBE_PX and not clipped:
                # To second order a shift looks like blur: the change with blur is blur times the second derivative.
                off = away * away / (2.0 * lens_px) + wider
                blur_num += (sums[piece, BLUR_NUM] - sums[piece, BLUR_DEN] * off) / each
                blur_den += sums[piece, BLUR_DEN] / each
            by_light += abs(gain) * (lit_cell * cell / (sign * step) + lit_line * (1.0 + cell / (sign * step))) - whole2
            contrast, level, inverse = contrast + step, level + cell, inverse + sign / step
            sums[piece, CUT] = lens.blur_px * CLIPPED_SHARE if clipped else 0.0
            for k in range(SUMS if found < piece else 0):
                sums[found, k] = sums[piece, k]
            found += 1
        share_noise(segments, found)
        doubtful = doubtful or not is_even(segments, sums, found, gain)
        even = even and not (doubtful and is_settled(blur_num, blur_den))
        if even:
            pooled[EACH * row + BLUR, RIGHT] += blur_num
            pooled[EACH * row + BLUR, OWN] += blur_den
            if found > 0:
                differences = 2.0 * each * judged  # of neighbouring pixels, each a sum of columns
                cell, line = level / found, (level + sign * contrast) / found
                tell_noise(pooled, lens.noise, cell, (cell_noise + noise[row, INSIDE]) / differences, judged)
                tell_noise(pooled, lens.noise, line, (line_noise + noise[row, LINE]) / differences, judged)
            break
        # Every strip is asked, and none that shows a stain or a glint's rim is taken.
        most = NOISIER * (taps - COLUMNS) * least_noise(segments, sums, found, gain)
    alike = feigned_alike(segments, sums, found, gain) if doubtful else 0.0
    if not even:
        take_off_light(segments, sums, found, gain)
        alike, by_light = UNSURE * alike, 0.0
    for i in range(found):
        segments[i, 2] += sums[i, CUT] ** 2
    good = max(found, 1)
    # What no template explains across all strips, beyond noise, may shift them all alike.
    misfit = rests / max(freedoms, 1.0) - MISFIT * scatter / good
    alike2 = alike * alike + (gain * gain * misfit * good / stiff if misfit > 0.0 and stiff > 0.0 else 0.0)
    # Templates blurred by 1 px more would show the edge shifted.
    by_blur = -scratch.templates.gain[row] * scratch.templates.blurred[row]
    by_added = abs(gain) * (lit_cell + lit_line) * inverse / good
    return Side(pieces, found, contrast / good, level / good, by_light / good, by_added, by_blur, 0.0, alike2)
