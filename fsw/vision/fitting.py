"""The surface brought to what was seen: to sighted lines, or to measured centres. Both problems are linear."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray, solve
from fsw.vision.prediction import UNKNOWNS, Surface, derive, distance_from, locate
from fsw.vision.rig import Eyes, project
from fsw.vision.search import SIDES_SEARCHED, Sightings
from fsw.vision.stereo import Points
from wingbeat.kernels import tick_kernel

BoolArray = NDArray[np.bool_]

# Which of the unknowns move a point along the wing's X, Y and Z.
ALONG_X, ALONG_Y, ALONG_Z = (0, 2, 15, 16, 17), (1, 2, 18, 19), (3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14)

TURNS = 6  # of the robust fit, at most; the gate shrinks from turn to turn ...
SETTLED = 0.02  # ... until it changes by less than this part

LEAST_POINTS = 8  # fewer do not move the surface
FIT_TURNS = 4
GATE_MEDIANS = 8.0  # a centre lies off the surface from so many times the median distance ...
GATE_SIGMAS = 6.0  # ... and from so many of its own standard deviations


class Normal(NamedTuple):
    """Normal equations of the unknowns; taken once."""

    matrix: FloatArray  # (UNKNOWNS, UNKNOWNS)
    right: FloatArray  # (UNKNOWNS,)
    factor: FloatArray  # (UNKNOWNS, UNKNOWNS) of the matrix,
    step: FloatArray  # (UNKNOWNS,) and the solution
    rows: FloatArray  # (4 N, UNKNOWNS) equations, one a sighted line,
    values: FloatArray  # (4 N,) and their right sides
    sorted: FloatArray  # (N,) distances in order, for their median
    used: BoolArray  # (N,) centres that are in the equations


def make_normal(count: int) -> Normal:
    """Take the working memory for `count` cells."""
    n, lines = UNKNOWNS, 4 * count
    rows, values = np.zeros((lines, n)), np.zeros(lines)
    matrix, right, factor, step = np.zeros((n, n)), np.zeros(n), np.zeros((n, n)), np.zeros(n)
    return Normal(matrix, right, factor, step, rows, values, np.zeros(count), np.zeros(count, dtype=np.bool_))


@tick_kernel
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
        for j in range(unknowns):
            step[j] = b[j]
    for j in range(unknowns):
        surface.unknowns[j] += step[j]
    return count, scale


@tick_kernel
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


@tick_kernel
def add_equation(
    matrix: FloatArray, right: FloatArray, row: FloatArray, value: float, weight: float, unknowns: int
) -> None:
    """Add one weighted equation row . x = value in so many unknowns to the normal equations (lower triangle)."""
    for i in range(unknowns):
        right[i] += weight * row[i] * value
        for j in range(i + 1):
            matrix[i, j] += weight * row[i] * row[j]


@tick_kernel
def _add_along(
    matrix: FloatArray, right: FloatArray, row: FloatArray, value: float, weight: float, unknowns: tuple[int, ...]
) -> None:
    """Add a weighted equation that some of the unknowns, in rising order, take part in."""
    for a in range(len(unknowns)):
        i = unknowns[a]
        right[i] += weight * row[i] * value
        for b in range(a + 1):
            matrix[i, unknowns[b]] += weight * row[i] * row[unknowns[b]]


@tick_kernel
def _add_centre(surface: Surface, n: int, xyz_mm: FloatArray, weight: float, normal: Normal) -> None:
    """Add cell n's centre, measured at xyz_mm (3,), to the equations; with weight -1 it is taken out again."""
    R, t, A, b, row = surface.rotation, surface.translation_mm, normal.matrix, normal.right, normal.rows[0]
    X, Y, basis = surface.flat_mm[n, 4, 0], surface.flat_mm[n, 4, 1], surface.basis[n, 4]
    x, y, z = xyz_mm[0] - t[0], xyz_mm[1] - t[1], xyz_mm[2] - t[2]
    # Along the wing's own axes few unknowns take part in an equation.
    derive(surface, X, Y, basis, 1.0, 0.0, 0.0, row)
    _add_along(A, b, row, R[0, 0] * x + R[1, 0] * y + R[2, 0] * z - X, weight, ALONG_X)
    derive(surface, X, Y, basis, 0.0, 1.0, 0.0, row)
    _add_along(A, b, row, R[0, 1] * x + R[1, 1] * y + R[2, 1] * z - Y, weight, ALONG_Y)
    derive(surface, X, Y, basis, 0.0, 0.0, 1.0, row)
    _add_along(A, b, row, R[0, 2] * x + R[1, 2] * y + R[2, 2] * z, weight, ALONG_Z)


@tick_kernel
def fit_surface(
    surface: Surface,
    xyz_mm: FloatArray,
    sigma_mm: FloatArray,
    valid: BoolArray,
    widest_mm: float,
    normal: Normal,
    distance_mm: FloatArray,
) -> float:
    """Fit the surface to measured centres, leaving out what lies off it; returns the gate, in mm, of the last turn.

    xyz_mm (N, 3), sigma_mm (N,), valid (N,). Writes distance_mm (N,): of each centre from the surface, NaN where there
    is none. What lies off is judged by the other cells, whose distances show how well the surface can follow this
    wing; widest_mm is as far as any cell may lie. With too few points the surface stays as it is.
    """
    A, b, factor, unknowns = normal.matrix, normal.right, normal.factor, normal.step
    A[:] = 0.0
    b[:] = 0.0
    normal.used[:] = False
    for j in range(UNKNOWNS):
        A[j, j] = surface.point_prior[j]
    gate, used = math.inf, 0
    for turn in range(FIT_TURNS):
        changed = 0
        for n in range(xyz_mm.shape[0]):
            use = valid[n] and (turn == 0 or distance_mm[n] <= max(gate, GATE_SIGMAS * sigma_mm[n]))
            if use != normal.used[n]:
                change = 1 if use else -1
                _add_centre(surface, n, xyz_mm[n], float(change), normal)
                normal.used[n] = use
                used, changed = used + change, changed + 1
        if turn > 0 and changed == 0:
            break  # the equations are linear: the same centres give the same surface
        if used >= LEAST_POINTS:
            for i in range(UNKNOWNS):
                unknowns[i] = b[i]
                for j in range(UNKNOWNS):
                    factor[i, j] = A[i, j]
            if solve(factor, unknowns, UNKNOWNS):
                for j in range(UNKNOWNS):
                    surface.unknowns[j] = unknowns[j]
        gate = min(widest_mm, GATE_MEDIANS * _distances(surface, xyz_mm, valid, normal.sorted, distance_mm))
    return gate


@tick_kernel
def _distances(
    surface: Surface, xyz_mm: FloatArray, valid: BoolArray, work: FloatArray, distance_mm: FloatArray
) -> float:
    """Write the distance (N,) of each valid centre from the surface, and return their median."""
    count = 0
    for n in range(xyz_mm.shape[0]):
        distance_mm[n] = np.nan
        if valid[n]:
            distance_mm[n] = distance_from(surface, n, xyz_mm[n])
            work[count] = distance_mm[n]
            count += 1
    return _of_rank(work, count, count // 2) if count > 0 else math.inf


@tick_kernel
def _of_rank(values: FloatArray, count: int, rank: int) -> float:
    """The value that `rank` of the first `count` ones are smaller than; they are put in another order (Hoare 1961)."""
    low, high = 0, count - 1
    while low < high:
        middle, i, j = values[rank], low, high
        while i <= j:
            while values[i] < middle:
                i += 1
            while middle < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < rank:
            low = i
        if rank < i:
            high = j
    return float(values[rank])


@tick_kernel
def measure_distance(surface: Surface, points: Points, chosen: NDArray[np.bool_], distance_mm: FloatArray) -> None:
    """Write the distance (N,) from the surface of the chosen points (N,)."""
    for n in range(chosen.shape[0]):
        if chosen[n]:
            distance_mm[n] = distance_from(surface, n, points.xyz_mm[n])
