"""Corners and centre of every cell in one image, from its four sides."""

import math

import numpy as np
from numpy.typing import NDArray

from fsw.vision.ahead import look_ahead, next_wanted
from fsw.vision.corners import Cells, add_pull, corners_and_centre
from fsw.vision.edges import (
    BIN_PX,
    BINS,
    BLUR,
    CROSS,
    EACH,
    MAX_WALK_PX,
    OWN,
    RIGHT,
    WIDTH,
    FloatArray,
    Image,
    Scratch,
)
from fsw.vision.hot import runs_along_hot_row
from fsw.vision.light import ROUNDED_FITTED, ROUNDED_MATCHED, add_rounding, correct_light, rounding
from fsw.vision.matched import match_segments
from fsw.vision.perspective import (
    OWN_SHARE,
    centre_share,
    extent_across,
    least_plateau,
    line_between,
    line_width,
    mean_gain,
    sample_lean,
    side_normal,
)
from fsw.vision.rig import Eyes, distort_point
from fsw.vision.sides import Lens, fit_segments
from fsw.vision.standing_in import add_size, is_inside, stand_in
from fsw.vision.straight import straight_side
from fsw.vision.templates import fill_templates
from wingbeat.kernels import tick_kernel

WINDOW_SIGMAS = 4.0  # the window holds the whole blurred step ...
WINDOW_PX = 2.0  # ... and this much of the plateau beyond
RECENTRE_PX = 0.35  # a side found farther off than this is measured again round where it was found
RECENTRES = 5
MATCHED_PX = 0.25  # the same for a side matched by templates, whose linear model holds as far
FAR_SIGMAS = 2.5  # the far side of a line may come so near to the templates' window
STEP_SIGMAS = 2.5  # of a step beside a border, at least
WORST_PX = 0.3  # a side less sure than this is as good as hidden
MODEL_PX = 0.0002  # what sides of images without noise are off by, at most: no side is known better


@tick_kernel
def measure_cells(
    image: Image,
    eyes: Eyes,
    eye: int,
    lenses: tuple[Lens, Lens],
    expected_px: FloatArray,
    deviation_px: FloatArray,
    depth_mm: FloatArray,
    wanted: NDArray[np.bool_],
    order: NDArray[np.int64],
    line_ratio: FloatArray,
    neighbour: NDArray[np.int64],
    width_scale: FloatArray,
    size: FloatArray,
    dark: bool,
    stride: int,
    scratch: Scratch,
    out: Cells,
) -> None:
    """Measure all wanted cells of one image.

    lenses: the eye as it sees sides along X, and along Y. expected_px (N, 4, 2): ideal pixels, right to about the blur.
    deviation_px (N, 4, 2): what of them is measured, and so has noise. depth_mm (N, 4): of the corners. wanted (N,):
    cells to look for. order (N,): in which they are taken; cells side by side share what the cache holds.
    line_ratio (N, 4): width of the line across each side over the cell's extent across that side, on the wing (at a
    border: the panel's usual line). neighbour (N, 4): the cell across each side, or -1. width_scale (2,): correction of
    the widths along X and Y. stride: take every so many columns of a side. Results go to `out`. One hidden side (out of
    view, or under a glint) is put where its opposite and the cell's size say, with a wider variance; with two, the cell
    is not found. size (2, 2): of the cells, see `standing_in`; what they tell of it is left in scratch,
    where it is known at what value the image is cut off.
    """
    sign = 1.0 if dark else -1.0
    scratch.pooled[:] = 0.0
    for row in range(2):
        gain, plateau = mean_gain(expected_px, wanted, row), least_plateau(expected_px, wanted, line_ratio, row)
        room = plateau - FAR_SIGMAS * lenses[row].blur_px - MATCHED_PX
        fill_templates(lenses[row].step, lenses[row].blur_px, gain, room, row, scratch.templates)
    scratch.sizes[:] = 0.0
    nx, ny, lengths, extents, middle, slope, variance = scratch.quad[:7]
    by_blur, by_width, weight, cross, bright, level, by_light, by_added, rounded, flat, agreed, seen = scratch.quad[7:]
    for place in range(len(order)):
        n = order[place]
        out.found[n] = out.whole[n] = out.paired[n, 0] = out.paired[n, 1] = False
        out.corners_px[n] = np.nan
        out.centre_px[n] = np.nan
        out.covariance_px2[n] = np.nan
        out.residual_px[n] = out.contrast[n] = np.nan
        if not wanted[n]:
            continue
        c, depth, following = expected_px[n], depth_mm[n], expected_px[next_wanted(order, wanted, place)]
        for k in range(6):
            x, y = (c[k, 0], c[k, 1]) if k < 4 else (following[k - 4, 0], following[k - 4, 1])
            seen[k, 0], seen[k, 1], _, _, _, _ = distort_point(x, y, eyes.intrinsics[eye], eyes.distortion[eye])
        for k in range(4):
            flat[k, 0], flat[k, 1] = c[k, 0] - deviation_px[n, k, 0], c[k, 1] - deviation_px[n, k, 1]
        hidden, which, firm, squares, contrast = 0, -1, True, 0.0, 0.0
        _copy(scratch.pooled, agreed)
        turn = (c[1, 0] - c[0, 0]) * (c[3, 1] - c[0, 1]) - (c[1, 1] - c[0, 1]) * (c[3, 0] - c[0, 0])
        hand = 1.0 if turn > 0.0 else -1.0
        for k in range(4):
            k1, row, lens = (k + 1) % 4, k % 2, lenses[k % 2]
            coming = (k + 1, (k + 2) % 4) if k < 3 else (4, 5)
            look_ahead(image, seen[coming[0]], seen[coming[1]], scratch.ahead)
            lengths[k], x, y = side_normal(c, k)
            nx[k], ny[k] = hand * x, hand * y  # outwards
            k2, k3 = (k + 2) % 4, (k + 3) % 4
            extent = extents[k] = extent_across(c, k, nx[k], ny[k])
            # Perspective makes the line wider on a cell's near side than on its far side, and a wedge along it.
            beside, ratio, scale = neighbour[n, k], line_ratio[n, k], width_scale[row]
            if beside >= 0 and wanted[beside]:
                scale *= extent / extent_across(flat, k, nx[k], ny[k])  # a cell that is nearer has a nearer line
                ahead, behind = line_between(flat, expected_px[beside], deviation_px[beside], k, nx[k], ny[k])
            else:
                ahead = line_width(c, depth, k, k3, ratio, nx[k], ny[k])
                behind = line_width(c, depth, k1, k2, ratio, nx[k], ny[k])
            ahead, behind = scale * ahead, scale * behind
            width = 0.5 * (ahead + behind)
            reach = WINDOW_SIGMAS * lens.blur_px + WINDOW_PX
            inner = min(reach, OWN_SHARE * extent)
            if beside < 0:
                # What lies beyond, as a hinge, must not bleed in, but the step must show.
                outer, bar = max(width - FAR_SIGMAS * lens.blur_px, STEP_SIGMAS * lens.blur_px), (0.0, 0.0)
                outer = min(reach, outer)
            elif width > reach + 3.0 * lens.blur_px:
                outer, bar = reach, (0.0, 0.0)  # a wide line is a plateau: its far side tells nothing
            else:
                outer, bar = width + inner, (ahead, behind)
            if inner + outer > BINS * BIN_PX:
                outer = BINS * BIN_PX - inner
            # Templates need half a window of plateau on either side.
            half = 0.5 * scratch.templates.taps[row]
            plain = half > 0.0 and half + MATCHED_PX <= min(width - FAR_SIGMAS * lens.blur_px, OWN_SHARE * extent)
            plain = plain and not runs_along_hot_row(image, seen[k], seen[k1], half + 1.0, scratch.full[0])
            settled = MATCHED_PX if plain else RECENTRE_PX
            lean = max(sample_lean(c, k, k3), sample_lean(c, k, k2))
            of_width = scratch.pooled[EACH * row + WIDTH]
            weight[k], cross[k] = of_width[OWN], of_width[CROSS]
            m, s, v, r, ok, sure = 0.0, 0.0, 0.0, 0.0, False, False
            for _ in range(RECENTRES):
                a, b = m - 0.5 * s, m + 0.5 * s
                start = (c[k, 0] + a * nx[k], c[k, 1] + a * ny[k])
                end = (c[k1, 0] + b * nx[k], c[k1, 1] + b * ny[k])
                if plain:
                    side = match_segments(image, lens, start, end, (nx[k], ny[k]), half * lean, row, sign, scratch)
                else:
                    side = fit_segments(
                        image,
                        lens,
                        start,
                        end,
                        (nx[k], ny[k]),
                        (inner, outer),
                        bar,
                        inner * lean,
                        row,
                        sign,
                        stride,
                        scratch,
                    )
                ok, sure, dm, ds, v, r = straight_side(scratch.segments, side.found, side.pieces)
                ok = ok and v < WORST_PX * WORST_PX
                if not ok:
                    break
                m, s = m + dm, s + ds
                ok = abs(m) < MAX_WALK_PX and abs(s) < MAX_WALK_PX
                if not ok or abs(dm) + 0.5 * abs(ds) < settled:
                    break
            if not ok:
                hidden, which = hidden + 1, k
                if hidden > 1:
                    break
                continue
            weight[k], cross[k] = of_width[OWN] - weight[k], of_width[CROSS] - cross[k]
            bright[k], level[k], by_light[k], by_added[k], by_blur[k], by_width[k], alike2 = side[2:]
            by_blur[k] -= scratch.templates.slowed[row] * dm if plain else 0.0  # and what it moved by larger
            moved = (ROUNDED_MATCHED if plain else ROUNDED_FITTED) * lens.blur_px / bright[k]
            rounded[k] = moved * rounding(lens.noise, level[k])
            by_line = moved * rounding(lens.noise, level[k] + sign * bright[k])
            middle[k], slope[k], variance[k] = m, s, v + alike2 + MODEL_PX * MODEL_PX + by_line * by_line
            squares, contrast, firm = squares + r * r, contrast + bright[k], firm and sure
        if hidden > 0:
            _copy(agreed, scratch.pooled)  # whatever hides a side may also lie over the others
        covered = hidden > 0 and is_inside(eyes, eye, c, which)
        if hidden > 1 or (covered and not firm):
            continue  # a bar's edge is as straight as half a side, and no side across contradicts it
        for k in range(2):
            out.paired[n, k] = hidden == 0 or which % 2 != k
            if out.paired[n, k]:
                correct_light(scratch.quad, k)
        if hidden == 0:
            # The lines were expected too narrow by as much as the cell was.
            for k in range(2):
                k2 = k + 2
                grown = (middle[k] + middle[k2]) / extents[k]
                middle[k], middle[k2] = middle[k] + by_width[k] * grown, middle[k2] + by_width[k2] * grown
                scratch.pooled[EACH * k + WIDTH, RIGHT] -= grown * (weight[k] + weight[k2])
                scratch.pooled[EACH * k + BLUR, RIGHT] -= grown * (cross[k] + cross[k2])
                measured, noise = extents[k] + middle[k] + middle[k2], variance[k] + variance[k2]
                add_size(size, k, extent_across(flat, k, nx[k], ny[k]), measured, noise, scratch.sizes)
        else:
            k, k1, k2 = which, (which + 1) % 4, (which + 2) % 4
            expected = extent_across(flat, k, nx[k], ny[k])
            away = 2.0 * (depth[k] + depth[k1] - depth[k2] - depth[(k + 3) % 4]) / depth.sum()
            tilt, across = away * eyes.intrinsics[eye, 0] / expected, (middle[k2], variance[k2])
            middle[k], variance[k] = stand_in(size, k % 2, covered, expected, extents[k], *across, tilt)
            slope[k] = slope[k2] * lengths[k] / lengths[k2]
            by_blur[k], by_width[k] = -by_blur[k2], -by_width[k2]
            rounded[k] = -rounded[k2]
        corners_and_centre(c, depth, nx, ny, middle, slope, variance, n, out)
        add_rounding(scratch.quad, out.covariance_px2[n])
        out.pull[n] = 0.0
        for k in range(4):
            gx, gy = centre_share(nx, ny, k)
            add_pull(out.pull[n, EACH * (k % 2) + BLUR], gx * by_blur[k], gy * by_blur[k])
            add_pull(out.pull[n, EACH * (k % 2) + WIDTH], gx * by_width[k], gy * by_width[k])
        out.residual_px[n], out.contrast[n] = math.sqrt(squares / (4 - hidden)), contrast / (4 - hidden)
        out.found[n], out.whole[n] = True, hidden == 0


@tick_kernel
def _copy(source: FloatArray, target: FloatArray) -> None:
    """Copy an array (n, m), element by element: a slice would make room for a second copy."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
