"""Matching on the tick path: the relative position descriptor of every cell in both eyes, compared between the eyes and
with the frame before, and what the comparison says of the scene. Fixed memory throughout.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray, solve
from fsw.vision.rig import norm
from wingbeat.kernels import tick_kernel

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SAME = 0.25  # of the pitch: descriptors nearer than this belong to the same cell; the next cell's is a whole pitch off
CORRECT = 0.1  # of a cell's smaller side: eta of Eq. 29; covers the bending that a homography of planes cannot follow


class Matching(NamedTuple):
    """Descriptors and working memory; taken once."""

    descriptor_mm: FloatArray  # (2, N, 2) RPD (Eq. 23): place beyond the fold or root boundary, and the lower boundary
    before_mm: FloatArray  # (2, N, 2) of the last frame, NaN where there was none
    to_wing: FloatArray  # (2, 3, 3) homographies ideal pixels -> wing plane (Eq. 13)
    left_to_right: FloatArray  # (3, 3) homography of the matched centres (Eq. 26)
    matrix: FloatArray  # (8, 8)
    right: FloatArray  # (8,)
    queue: FloatArray  # (queues, 3) number, sum and sum of squares along each row or column


def make_matching(count: int, queues: int) -> Matching:
    """Take the arrays for `count` cells in at most `queues` rows or columns."""
    nan = np.nan
    return Matching(
        np.full((2, count, 2), nan),
        np.full((2, count, 2), nan),
        np.zeros((2, 3, 3)),
        np.zeros((3, 3)),
        np.zeros((8, 8)),
        np.zeros(8),
        np.zeros((queues, 3)),
    )


@tick_kernel
def fit_homography(
    source: FloatArray, target: FloatArray, chosen: BoolArray, A: FloatArray, b: FloatArray, H: FloatArray
) -> bool:
    """H (3, 3) that maps source (N, 2) to target (N, 2) over the chosen points: least squares of Eq. 28.

    A (8, 8), b (8,): working memory. Coordinates are centred and scaled inside, so that the equations are well behaved.
    False, and H unchanged, if the points do not determine it.
    """
    mean_x, mean_y, mean_u, mean_v, count = 0.0, 0.0, 0.0, 0.0, 0
    for n in range(chosen.shape[0]):
        if chosen[n]:
            mean_x, mean_y = mean_x + source[n, 0], mean_y + source[n, 1]
            mean_u, mean_v = mean_u + target[n, 0], mean_v + target[n, 1]
            count += 1
    if count < 4:
        return False
    mean_x, mean_y, mean_u, mean_v = mean_x / count, mean_y / count, mean_u / count, mean_v / count
    size, reach = 0.0, 0.0
    for n in range(chosen.shape[0]):
        if chosen[n]:
            size = max(size, abs(source[n, 0] - mean_x), abs(source[n, 1] - mean_y))
            reach = max(reach, abs(target[n, 0] - mean_u), abs(target[n, 1] - mean_v))
    if size == 0.0 or reach == 0.0:
        return False
    A[:] = 0.0
    b[:] = 0.0
    for n in range(chosen.shape[0]):
        if not chosen[n]:
            continue
        x, y = (source[n, 0] - mean_x) / size, (source[n, 1] - mean_y) / size
        u, v = (target[n, 0] - mean_u) / reach, (target[n, 1] - mean_v) / reach
        first = (x, y, 1.0, 0.0, 0.0, 0.0, -x * u, -y * u)
        second = (0.0, 0.0, 0.0, x, y, 1.0, -x * v, -y * v)
        for i in range(8):
            b[i] += first[i] * u + second[i] * v
            for j in range(i + 1):
                A[i, j] += first[i] * first[j] + second[i] * second[j]
    if not solve(A, b, 8):
        return False
    # Undo the scaling: H = T_target^-1 h T_source.
    for i in range(3):
        h0, h1 = b[3 * i] if i < 2 else b[6], b[3 * i + 1] if i < 2 else b[7]
        h2 = b[3 * i + 2] if i < 2 else 1.0
        H[i, 0], H[i, 1] = h0 / size, h1 / size
        H[i, 2] = h2 - (h0 * mean_x + h1 * mean_y) / size
    for j in range(3):
        H[0, j] = reach * H[0, j] + mean_u * H[2, j]
        H[1, j] = reach * H[1, j] + mean_v * H[2, j]
    return True


@tick_kernel
def _apply(H: FloatArray, x: float, y: float) -> tuple[float, float]:
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    return (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w


@tick_kernel
def describe(
    centre_px: FloatArray, found: BoolArray, to_wing: FloatArray, boundary_mm: FloatArray, descriptor_mm: FloatArray
) -> None:
    """RPD (N, 2) of one eye's found cells (Eq. 23) in the equivalent view: distance from the boundaries before them."""
    for n in range(found.shape[0]):
        if found[n]:
            x, y = _apply(to_wing, centre_px[n, 0], centre_px[n, 1])
            descriptor_mm[n, 0], descriptor_mm[n, 1] = x - boundary_mm[n, 0], y - boundary_mm[n, 1]
        else:
            descriptor_mm[n] = np.nan


@tick_kernel
def match_descriptors(work: Matching, pitch_mm: FloatArray, matched: BoolArray) -> int:
    """Cells whose descriptors agree between the eyes, and with those of the frame before where there were some.

    pitch_mm (N, 2). Writes matched (N,), keeps this frame's descriptors for the next; returns the number of matches.
    """
    now, before = work.descriptor_mm, work.before_mm
    count = 0
    for n in range(matched.shape[0]):
        near = True
        for i in range(2):
            gate = SAME * pitch_mm[n, i]
            near = near and abs(now[0, n, i] - now[1, n, i]) < gate
            for eye in range(2):
                if not math.isnan(before[eye, n, i]):
                    near = near and abs(now[eye, n, i] - before[eye, n, i]) < gate
        matched[n] = near
        count += near
        for eye in range(2):
            before[eye, n, 0], before[eye, n, 1] = now[eye, n, 0], now[eye, n, 1]
    return count


@tick_kernel
def match_views(
    expected_px: FloatArray,
    flat_mm: FloatArray,
    wanted: BoolArray,
    centre_px: FloatArray,
    found: tuple[BoolArray, BoolArray],
    boundary_mm: FloatArray,
    pitch_mm: FloatArray,
    work: Matching,
    matched: BoolArray,
) -> int:
    """Describe both eyes' found cells in their equivalent views, and match them; returns the number of matches.

    expected_px (2, N, 2): centres of the wanted cells (N,), which lie at flat_mm (N, 2) on the wing: they make the
    equivalent views. centre_px (2, N, 2): as measured. The rest as for `describe` and `match_descriptors`.
    """
    for eye in range(2):
        H = work.to_wing[eye]
        fit_homography(expected_px[eye], flat_mm, wanted, work.matrix, work.right, H)
        describe(centre_px[eye], found[eye], H, boundary_mm, work.descriptor_mm[eye])
    return match_descriptors(work, pitch_mm, matched)


@tick_kernel
def count_correct(work: Matching, left_px: FloatArray, right_px: FloatArray, matched: BoolArray, side_px: float) -> int:
    """Matches that the homography of all matches confirms (Eq. 26-29), within CORRECT of a cell's smaller side."""
    if not fit_homography(left_px, right_px, matched, work.matrix, work.right, work.left_to_right):
        return 0
    count = 0
    for n in range(matched.shape[0]):
        if matched[n]:
            u, v = _apply(work.left_to_right, left_px[n, 0], left_px[n, 1])
            count += norm(u - right_px[n, 0], v - right_px[n, 1]) < CORRECT * side_px
    return count


@tick_kernel
def queue_variance(values: FloatArray, queue: IntArray, chosen: BoolArray, scale: float, sums: FloatArray) -> float:
    """Pooled variance of values (N,) * scale inside the queues (N,) they belong to; NaN without two in one queue."""
    sums[:] = 0.0
    for n in range(chosen.shape[0]):
        if chosen[n]:
            value = values[n] * scale
            sums[queue[n], 0] += 1.0
            sums[queue[n], 1] += value
    squares, freedom = 0.0, 0.0
    for n in range(chosen.shape[0]):
        if chosen[n]:
            q = queue[n]
            r = values[n] * scale - sums[q, 1] / sums[q, 0]
            squares += r * r
    for q in range(sums.shape[0]):
        freedom += max(sums[q, 0] - 1.0, 0.0)
    return squares / freedom if freedom > 0.0 else math.nan
