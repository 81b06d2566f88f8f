"""The quick look: find the lines near where they are expected, in both eyes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.ahead import FIXED
from fsw.vision.edges import FloatArray, Image
from fsw.vision.rig import Eyes, image_point, norm
from fsw.vision.sides import MIN_CONTRAST
from wingbeat.kernels import inline_kernel, tick_kernel

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SEARCH = 0.4  # of a cell's extent: how far the quick update looks for a line; half would reach the next line
SEARCH_PX = 256  # at most
FLANK_PX = 8  # beside a line, at most, that it is compared with: each pixel of a column is another line of the cache
SEARCH_LINES = 3  # profiles summed, side by side in the middle of a side
APART_PX = 4  # from one to the next: across a row of the image, all are in the same line of the cache

SIDES_SEARCHED = (1, 2)  # each inner line once: +X and +Y sides


class Sightings(NamedTuple):
    """Lines found by the quick look, and its working memory; taken once."""

    offset_px: FloatArray  # (2, N, 2) of the lines across SIDES_SEARCHED, NaN where none was found
    normal: FloatArray  # (2, N, 2, 2) outward normals of those sides
    middle_px: FloatArray  # (2, N, 2, 2) and their middles, where they were expected when looked at
    profile: IntArray  # (2 * SEARCH_PX,) of the line that is looked for


def make_sightings(count: int) -> Sightings:
    """Take the arrays for `count` cells."""
    normal, middle = np.zeros((2, 2, count, 2, 2))
    return Sightings(np.full((2, count, 2), np.nan), normal, middle, np.zeros(2 * SEARCH_PX, dtype=np.int64))


@tick_kernel
def find_line(
    image: Image,
    eyes: Eyes,
    eye: int,
    corners: FloatArray,
    side: int,
    line_ratio: float,
    sign: float,
    within_px: float,
    profile: IntArray,
) -> tuple[bool, float, float, float]:
    """Look across one side for the line nearest to where it is expected.

    corners (4, 2): expected ideal pixels of the cell. line_ratio: the line's width over the cell's extent.
    sign: +1 for cells darker than lines. within_px: look no farther than so. profile (2 * SEARCH_PX,): working memory.
    Returns (found, offset of the line outwards in ideal pixels, outward normal).
    """
    a, b, c, d = corners[side], corners[(side + 1) % 4], corners[(side + 2) % 4], corners[(side + 3) % 4]
    length = norm(b[0] - a[0], b[1] - a[1])
    nx, ny = (b[1] - a[1]) / length, -(b[0] - a[0]) / length
    extent = 0.5 * ((a[0] + b[0] - c[0] - d[0]) * nx + (a[1] + b[1] - c[1] - d[1]) * ny)
    if extent < 0.0:
        nx, ny, extent = -nx, -ny, -extent
    reach = int(min(SEARCH * extent, within_px, float(SEARCH_PX - 40)))
    width = max(1, round(line_ratio * extent))
    flank = min(max(2, width), FLANK_PX)
    before = reach + flank
    count = 2 * reach + 2 * flank + width
    if count > 2 * SEARCH_PX or reach < 2:
        return False, 0.0, nx, ny
    inside, x, y, dx, dy, ahead = _walk(eyes, eye, a, b, (nx, ny, before, count))
    if not inside:
        return False, 0.0, nx, ny
    along_x, along_y = round(-ny * APART_PX), round(nx * APART_PX)
    for i in range(count):
        u, v = x >> FIXED, y >> FIXED
        profile[i] = image[v - along_y, u - along_x] + image[v, u] + image[v + along_y, u + along_x]
        x, y = x + dx, y + dy
    best, where, peak = 0.0, 0, (0, 0, 0)
    left, inner, right = 0, 0, 0  # sums over the windows before, on and behind the line, moved pixel by pixel
    for i in range(flank):
        left += profile[i]
        right += profile[flank + width + i]
    for i in range(width):
        inner += profile[flank + i]
    of_inner, of_flank = sign / width, sign / flank
    for start in range(flank, flank + 2 * reach + 1):
        # The weaker of the two steps counts: a border or a shadow's edge has one step only.
        score = min(of_inner * inner - of_flank * left, of_inner * inner - of_flank * right)
        if score > best:
            best, where, peak = score, start, (left, inner, right)
        if start < flank + 2 * reach:
            left += profile[start] - profile[start - flank]
            inner += profile[start + width] - profile[start]
            right += profile[start + width + flank] - profile[start + width]
    if best <= MIN_CONTRAST * SEARCH_LINES:
        return False, 0.0, nx, ny
    whole = flank < where < flank + 2 * reach
    if not whole and reach < int(SEARCH * extent):
        return False, 0.0, nx, ny  # no line, but the flank of one that lies farther off
    # The window's middle is the line's; its first pixel lies half a pixel behind the edge.
    offset = where - before + ahead + 0.5 * (width - 1 - line_ratio * extent)
    if whole:
        a, b, c, d = where - flank, where, where + width, where + width + flank
        # Both steps together fall off evenly to either side of the line's place: the crossing of the two slopes.
        p, q, r, s = profile[a - 1], profile[b - 1], profile[c - 1], profile[d - 1]
        back = _both_steps(peak[0] + p - q, peak[1] + q - r, peak[2] + r - s, of_inner, of_flank)
        p, q, r, s = profile[a], profile[b], profile[c], profile[d]
        ahead = _both_steps(peak[0] - p + q, peak[1] - q + r, peak[2] - r + s, of_inner, of_flank)
        fall = _both_steps(peak[0], peak[1], peak[2], of_inner, of_flank) - min(back, ahead)
        if fall > 0.0:
            offset += min(max(0.5 * (ahead - back) / fall, -0.5), 0.5)
    return True, offset, nx, ny


@inline_kernel
def _walk(
    eyes: Eyes, eye: int, a: FloatArray, b: FloatArray, way: tuple[float, float, int, int]
) -> tuple[bool, int, int, int, int, float]:
    """Across the middle of the side from a to b: whether all in the image, first pixel and step in fixed point.

    way: outward normal, pixels before the side, pixels in all. All are moved on by the last value returned, so that at
    the side they lie on pixels' middles: else all would be off by what the first place is rounded by.
    """
    nx, ny, before, count = way
    u, v = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])
    # The lens bends so short a line by less than a pixel: its two ends are enough.
    first, x0, y0 = image_point(eyes, eye, u - before * nx, v - before * ny)
    last, x1, y1 = image_point(eyes, eye, u + (count - 1 - before) * nx, v + (count - 1 - before) * ny)
    rim = APART_PX + 2.0  # of the image, which no profile reaches: the outer ones are apart, and all are moved on
    right, low = eyes.size[eye, 0] - 1.0 - rim, eyes.size[eye, 1] - 1.0 - rim
    inside = min(x0, x1) >= rim and max(x0, x1) <= right and min(y0, y1) >= rim and max(y0, y1) <= low
    dx, dy = (x1 - x0) / (count - 1), (y1 - y0) / (count - 1)
    x, y = x0 + before * dx, y0 + before * dy
    ahead = (round(x) - x) / dx if abs(dx) > abs(dy) else (round(y) - y) / dy
    one = float(1 << FIXED)
    x, y = (x0 + ahead * dx + 0.5) * one, (y0 + ahead * dy + 0.5) * one
    return first and last and inside, int(x), int(y), round(dx * one), round(dy * one), ahead


@tick_kernel
def _both_steps(left: int, inner: int, right: int, of_inner: float, of_flank: float) -> float:
    """How much the line stands out against both windows together."""
    return 2.0 * of_inner * inner - of_flank * (left + right)


@tick_kernel
def look(
    left: Image,
    right: Image,
    eyes: Eyes,
    corners_px: FloatArray,
    in_view: BoolArray,
    line_ratio: FloatArray,
    neighbour: IntArray,
    sign: float,
    step: int,
    within_px: float,
    seen: Sightings,
) -> None:
    """Look for the lines on the +X and +Y side of every cell in view, in both eyes.

    corners_px (2, N, 4, 2): expected ideal pixels. in_view (N,). line_ratio, neighbour (N, 4): as for measure_cells.
    step: look at every so many cells. within_px: and no farther from where a line is expected.
    """
    seen.offset_px[:] = np.nan
    for eye in range(2):
        image = left if eye == 0 else right
        for n in range(0, in_view.shape[0], step):
            if not in_view[n]:
                continue
            c = corners_px[eye, n]
            for i in range(2):
                side = SIDES_SEARCHED[i]
                if neighbour[n, side] < 0:
                    continue
                good, offset, nx, ny = find_line(
                    image, eyes, eye, c, side, line_ratio[n, side], sign, within_px, seen.profile
                )
                if good:
                    seen.offset_px[eye, n, i] = offset
                    seen.normal[eye, n, i, 0], seen.normal[eye, n, i, 1] = nx, ny
                    seen.middle_px[eye, n, i, 0] = 0.5 * (c[side, 0] + c[side + 1, 0])
                    seen.middle_px[eye, n, i, 1] = 0.5 * (c[side, 1] + c[side + 1, 1])
