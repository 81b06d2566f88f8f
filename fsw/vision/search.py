"""The quick look: find the lines near where they are expected, and move the surface to meet them in both eyes."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray, Image, solve
from fsw.vision.prediction import Normal, Surface, add_equation, derive, locate
from fsw.vision.rig import Eyes, image_point, project
from fsw.vision.sides import MIN_CONTRAST
from wingbeat.kernels import kernel

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SEARCH = 0.4  # of a cell's extent: how far the quick update looks for a line; half would reach the next line
SEARCH_PX = 256  # at most
FLANK_PX = 8  # beside a line, at most, that it is compared with: each pixel of a column is another line of the cache
SEARCH_LINES = 3  # profiles summed along a side
FIXED = 16  # bits after the point of the places at which profiles are taken
TURNS = 6  # of the robust fit, at most; the gate shrinks from turn to turn ...
SETTLED = 0.02  # ... until it changes by less than this part

SIDES_SEARCHED = (1, 2)  # each inner line once: +X and +Y sides


class Sightings(NamedTuple):
    """Lines found by the quick look, and its working memory; taken once."""

    offset_px: FloatArray  # (2, N, 2) of the lines across SIDES_SEARCHED, NaN where none was found
    normal: FloatArray  # (2, N, 2, 2) outward normals of those sides
    middle_px: FloatArray  # (2, N, 2, 2) and their middles, where they were expected when looked at
    profile: IntArray  # (2, 2 * SEARCH_PX) one row an eye


def make_sightings(count: int) -> Sightings:
    """Take the arrays for `count` cells."""
    normal, middle = np.zeros((2, 2, count, 2, 2))
    return Sightings(np.full((2, count, 2), np.nan), normal, middle, np.zeros((2, 2 * SEARCH_PX), dtype=np.int64))


@kernel
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
    length = math.hypot(b[0] - a[0], b[1] - a[1])
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
    way = (nx, ny, before, count)
    inside_a, x0, y0, dx0, dy0 = _walk(eyes, eye, a, b, 0.25, way)
    inside_b, x1, y1, dx1, dy1 = _walk(eyes, eye, a, b, 0.5, way)
    inside_c, x2, y2, dx2, dy2 = _walk(eyes, eye, a, b, 0.75, way)
    if not (inside_a and inside_b and inside_c):
        return False, 0.0, nx, ny
    for i in range(count):
        # All three at once: the memory's latencies overlap.
        value = image[y0 >> FIXED, x0 >> FIXED] + image[y1 >> FIXED, x1 >> FIXED] + image[y2 >> FIXED, x2 >> FIXED]
        profile[i] = value
        x0, x1, x2, y0, y1, y2 = x0 + dx0, x1 + dx1, x2 + dx2, y0 + dy0, y1 + dy1, y2 + dy2
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
    # The window's middle is the line's; its first pixel lies half a pixel behind the edge.
    offset = where - before + 0.5 * (width - 1 - line_ratio * extent)
    if flank < where < flank + 2 * reach:
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


@kernel
def _walk(
    eyes: Eyes, eye: int, a: FloatArray, b: FloatArray, share: float, way: tuple[float, float, int, int]
) -> tuple[bool, int, int, int, int]:
    """Across the side from a to b, at a share of it: whether all in the image, first pixel and step in fixed point.

    way: outward normal, pixels before the side, pixels in all.
    """
    nx, ny, before, count = way
    u, v = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
    # The lens bends so short a line by less than a pixel: its two ends are enough.
    first, x0, y0 = image_point(eyes, eye, u - before * nx, v - before * ny)
    last, x1, y1 = image_point(eyes, eye, u + (count - 1 - before) * nx, v + (count - 1 - before) * ny)
    one = float(1 << FIXED)
    dx, dy = round((x1 - x0) * one / (count - 1)), round((y1 - y0) * one / (count - 1))
    return first and last, int((x0 + 0.5) * one), int((y0 + 0.5) * one), dx, dy


@kernel
def _both_steps(left: int, inner: int, right: int, of_inner: float, of_flank: float) -> float:
    """How much the line stands out against both windows together."""
    return 2.0 * of_inner * inner - of_flank * (left + right)


@kernel
def look(
    image: Image,
    eyes: Eyes,
    eye: int,
    corners_px: FloatArray,
    in_view: BoolArray,
    line_ratio: FloatArray,
    bordering: BoolArray,
    sign: float,
    step: int,
    within_px: float,
    seen: Sightings,
) -> int:
    """Look for the lines on the +X and +Y side of every cell in view of one eye; returns how many were found.

    corners_px (N, 4, 2): expected ideal pixels. in_view (N,). line_ratio, bordering (N, 4): as for measure_cells.
    step: look at every so many cells. within_px: and no farther from where a line is expected.
    """
    found = 0
    seen.offset_px[eye] = np.nan
    for n in range(0, corners_px.shape[0], step):
        for i in range(2):
            side = SIDES_SEARCHED[i]
            if not in_view[n] or bordering[n, side]:
                continue
            good, offset, nx, ny = find_line(
                image, eyes, eye, corners_px[n], side, line_ratio[n, side], sign, within_px, seen.profile[eye]
            )
            if good:
                seen.offset_px[eye, n, i] = offset
                seen.normal[eye, n, i, 0], seen.normal[eye, n, i, 1] = nx, ny
                a, b = corners_px[n, side], corners_px[n, side + 1]
                seen.middle_px[eye, n, i, 0], seen.middle_px[eye, n, i, 1] = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])
                found += 1
    return found


@kernel
def settle(surface: Surface, eyes: Eyes, seen: Sightings, unknowns: int, normal: Normal) -> tuple[int, float]:
    """Move the surface so that its lines meet the sighted ones in both eyes: robust least squares.

    unknowns: how many of the surface's may move, FEW or UNKNOWNS. Returns the number of sightings and their weighted
    rms distance left, in pixels.
    """
    A, b, step = normal.matrix, normal.right, normal.step
    count = _equations(surface, eyes, seen, normal)
    scale = 0.0
    step[:] = 0.0
    for turn in range(TURNS + 1):
        A[:] = 0.0
        b[:] = 0.0
        squares, weights = 0.0, 0.0
        for i in range(count):
            row, value = normal.rows[i], normal.values[i]
            residual = value
            for j in range(unknowns):
                residual -= row[j] * step[j]
            # Cauchy's weights: a line that was mistaken for its neighbour's loses its say.
            weight = 1.0 if turn == 0 else 1.0 / (1.0 + (residual / scale) ** 2)
            squares += weight * residual * residual
            weights += weight
            add_equation(A, b, row, value, weight, unknowns)
        before, scale = scale, max(0.5, math.sqrt(squares / max(weights, 1.0)))
        settled = turn > 1 and abs(scale - before) < SETTLED * before
        if turn == TURNS or settled or count < 2 * unknowns:
            break
        for j in range(unknowns):
            A[j, j] += surface.line_prior[j]
            b[j] -= surface.line_prior[j] * surface.unknowns[j]
        if not solve(A, b, unknowns):
            break
        step[:unknowns] = b[:unknowns]
    for j in range(unknowns):
        surface.unknowns[j] += step[j]
    return count, scale


@kernel
def _equations(surface: Surface, eyes: Eyes, seen: Sightings, normal: Normal) -> int:
    """One equation for each sighted line: what moves its middle outwards, and how far it is off; returns how many."""
    R, count = surface.rotation, 0
    for eye in range(2):
        P = eyes.projection[eye]
        for n in range(seen.offset_px.shape[1]):
            for i in range(2):
                offset = seen.offset_px[eye, n, i]
                if math.isnan(offset):
                    continue
                k, k1 = SIDES_SEARCHED[i], SIDES_SEARCHED[i] + 1
                x0, y0, z0 = locate(surface, n, k)
                x1, y1, z1 = locate(surface, n, k1)
                u, v, w = project(P, 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1))
                X = 0.5 * (surface.flat_mm[n, k, 0] + surface.flat_mm[n, k1, 0])
                Y = 0.5 * (surface.flat_mm[n, k, 1] + surface.flat_mm[n, k1, 1])
                nx, ny = seen.normal[eye, n, i]
                gx = (nx * (P[0, 0] - u * P[2, 0]) + ny * (P[1, 0] - v * P[2, 0])) / w
                gy = (nx * (P[0, 1] - u * P[2, 1]) + ny * (P[1, 1] - v * P[2, 1])) / w
                gz = (nx * (P[0, 2] - u * P[2, 2]) + ny * (P[1, 2] - v * P[2, 2])) / w
                x = R[0, 0] * gx + R[1, 0] * gy + R[2, 0] * gz
                y = R[0, 1] * gx + R[1, 1] * gy + R[2, 1] * gz
                z = R[0, 2] * gx + R[1, 2] * gy + R[2, 2] * gz
                derive(surface, X, Y, surface.basis[n, k], x, y, z, normal.rows[count])
                normal.values[count] = offset
                count += 1
    return count
