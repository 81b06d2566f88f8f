"""Missing entries of a matrix of noise and few directions, told row by row through these directions.

The rows of a record are its ticks or, transposed, its channels: in turn they are alternating least squares.
"""

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Places = NDArray[np.int32]

# What is left of the equations is no more than this part of the noise.
_ARRIVED = 1e-3
# A direction tells entries by what it holds beyond so many times the energy that noise's largest direction would.
_BEYOND_NOISE = 2.0


def tell(rows: Places, columns: Places, V: FloatArray, energy: float, signals: FloatArray, told: FloatArray) -> None:
    """Fill the gaps of a matrix Y (M, N) of even noise by what each row's samples make of its signals.

    rows, columns (G,): places of the gaps, row by row; V (N, r) orthonormal; energy: sum of squares of Y as it was
    filled; signals (M, r) = Y V, become those of what is filled; told (G,): what was filled in, becomes what is.
    By least squares, (V^T W V + noise / P) a = V^T W y with W = 1 at samples and 0 at gaps, and P each signal's mean
    square: nothing stays of the guess before, nor does a direction that the samples hardly tell of follow their noise.
    Source: Tipping and Bishop, 1999, probabilistic principal component analysis.

    P counts only samples, and what noise alone would show is taken off it: a direction made of guesses has all its
    energy in the gaps, and in the samples what it fits of their noise, sigma^2 (sqrt M + sqrt N)^2 at most. Were it
    believed for that, it would tell its own gaps again. What a spread direction of less holds is below noise in each
    entry. Source of the edge: Geman, 1980.
    """
    (count, rank), width = signals.shape, len(V)
    in_gaps = np.zeros(rank)
    rest_in_gaps = _in_gaps(rows, columns, V, signals, told, in_gaps)
    square = np.sum(signals**2, axis=0)
    free = max((count - rank) * (width - rank) - len(told), 1)
    noise = max(energy - float(np.sum(square)) - rest_in_gaps, 1e-20 * energy) / free
    edge = noise * (np.sqrt(count) + np.sqrt(width)) ** 2
    P = np.maximum(square - in_gaps - _BEYOND_NOISE * edge, 1e-9 * noise + 1e-300) / count
    _solve(rows, columns, V, noise / P, signals, told)


@kernel
def _solve(
    rows: Places,
    columns: Places,
    V: FloatArray,
    doubt: FloatArray,
    signals: FloatArray,
    told: FloatArray,
) -> None:
    """The equations of `tell`, row by row; doubt (r,): noise / P.

    V^T W V is 1 less what the gaps take from it. Where few are missing that is near 1, and conjugate gradients arrive
    in a few steps, each of them two products with the gaps' directions.
    """
    rank = V.shape[1]
    # A row's gaps side by side: their directions, and what is said of each.
    G, at_gaps = np.empty((rank, len(V))), np.empty(len(V))
    a, left, p, seen = np.empty((4, rank))
    first = 0
    while first < len(rows):
        row, n = rows[first], 0
        while first + n < len(rows) and rows[first + n] == row:
            at_gaps[n] = told[first + n]
            for k in range(rank):
                G[k, n] = V[columns[first + n], k]
            n += 1
        # The samples' part, and the equations' left sides less it, where the signals are what they were.
        a[:] = signals[row]
        for k in range(rank):
            for i in range(n):
                signals[row, k] -= G[k, i] * at_gaps[i]
        _at_gaps(G, a, n, at_gaps)
        square = 0.0
        for k in range(rank):
            left[k] = signals[row, k] - (1.0 + doubt[k]) * a[k]
            for i in range(n):
                left[k] += G[k, i] * at_gaps[i]
            p[k] = left[k] / (1.0 + doubt[k])
            square += left[k] * p[k]
        for _ in range(rank):
            if square <= _ARRIVED**2:
                break
            _at_gaps(G, p, n, at_gaps)
            curvature = 0.0
            for k in range(rank):
                along = (1.0 + doubt[k]) * p[k]
                for i in range(n):
                    along -= G[k, i] * at_gaps[i]
                curvature += p[k] * along
                seen[k] = along
            step, before, square = square / curvature, square, 0.0
            for k in range(rank):
                a[k] += step * p[k]
                left[k] -= step * seen[k]
                square += left[k] ** 2 / (1.0 + doubt[k])
            for k in range(rank):
                p[k] = left[k] / (1.0 + doubt[k]) + square / before * p[k]
        _at_gaps(G, a, n, at_gaps)
        for k in range(rank):
            for i in range(n):
                signals[row, k] += G[k, i] * at_gaps[i]
        told[first : first + n] = at_gaps[:n]
        first += n


@kernel
def _in_gaps(
    rows: Places,
    columns: Places,
    V: FloatArray,
    signals: FloatArray,
    told: FloatArray,
    energy: FloatArray,
) -> float:
    """Adds each direction's energy in the gaps to energy (r,); returns the energy that no direction tells there."""
    beyond = 0.0
    for i in range(len(rows)):
        rest = told[i]
        for k in range(V.shape[1]):
            part = signals[rows[i], k] * V[columns[i], k]
            energy[k] += part * part
            rest -= part
        beyond += rest * rest
    return beyond


@kernel
def _at_gaps(G: FloatArray, a: FloatArray, count: int, at_gaps: FloatArray) -> None:
    """What coordinates a (r,) tell of the first gaps, of directions G (r, L)."""
    at_gaps[:count] = 0.0
    for k in range(len(a)):
        for i in range(count):
            at_gaps[i] += G[k, i] * a[k]
