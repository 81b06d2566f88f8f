"""Likelihood of modes in a band of a stationary response, with its slopes, in closed form and in compiled code.

The covariance of the band's coefficients is a small matrix at each frequency, of the modes' spectra along their shapes
and of the noise, and two ranks for each mode, of the record's two ends. Its inverse is of the same form (Woodbury), and
so are its slopes: nothing as large as the band squared is ever made.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.modal.small_matrices import inverse, tangents
from fsw.modal.stationary_envelope import envelope
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Band(NamedTuple):
    """Fourier coefficients (pieces, K, q) at frequencies (K,) in Hz, of pieces of a record of duration_s each."""

    frequency_hz: FloatArray
    coefficients: ComplexArray
    duration_s: float


class Modes(NamedTuple):
    """Modes in a band: frequency_hz, decay_rate in 1/s, variance (m,), unit shapes (q, m), and the noise's variance.

    Variances are those of one Fourier coefficient.
    """

    frequency_hz: FloatArray
    decay_rate: FloatArray
    variance: FloatArray
    shapes: FloatArray
    noise: float


@kernel
def likelihood(band: Band, modes: Modes, least: float) -> tuple[float, FloatArray, FloatArray]:
    """Log likelihood of modes in a band, its slopes (n,) and the Fisher information (n, n).

    The n unknowns are each mode's frequency in Hz, ln decay rate, ln variance and turns of the shape (q - 1), mode by
    mode, and ln noise. A likelihood of no more than the least is given without slopes and information.
    """
    pieces, count, q = band.coefficients.shape
    D, V, pair, c, sign = _slopes(band, modes)
    unknowns, R, ranks, wide = len(D), len(V), len(sign), q * q * count
    # E: inverse of the small matrices at each frequency.
    E, determinant = D[unknowns - 1].copy(), np.sum(np.log(np.abs(sign)))
    for j in range(len(modes.variance)):
        E += D[j * (q + 2) + 2]
    for k in range(count):
        if q == 1:
            determinant += np.log(E[0, 0, k])
            E[0, 0, k] = 1.0 / E[0, 0, k]
        else:
            its_inverse, logarithm = inverse(E[:, :, k].copy())
            determinant += logarithm
            for a in range(q):
                for b in range(q):
                    E[a, b, k] = its_inverse[a, b]
    # F = E v of all columns, their products N, and the inverse Q of what the ends add.
    F = _through(E, V)
    flat = F.reshape(R, q * count)
    N = V.reshape(R, q * count) @ flat.T
    added = N[:ranks, :ranks].copy()
    for i in range(ranks):
        added[i, i] += 1.0 / sign[i]
    Q, logarithm = inverse(added)
    determinant += logarithm
    # H = covariance^-1 v of all columns, and their products N.
    Z = Q @ N[:ranks]
    H = (flat - Z.T @ flat[:ranks]).reshape(R, q, count)
    N -= N[:ranks].copy().T @ Z
    # Coefficients y, real parts and imaginary parts, and covariance^-1 y.
    y = np.empty((2 * pieces, q, count))
    for p in range(pieces):
        for a in range(q):
            y[2 * p, a], y[2 * p + 1, a] = band.coefficients[p, :, a].real, band.coefficients[p, :, a].imag
    along, weighed = y.reshape(2 * pieces, q * count) @ H.reshape(R, q * count).T, _through(E, y)
    for p in range(2 * pieces):
        for i in range(ranks):
            weighed[p] -= sign[i] * along[p, i] * F[i]
    square = np.sum(y.reshape(2 * pieces, q * count) * weighed.reshape(2 * pieces, q * count))
    value = -pieces * determinant - square
    if value <= least:
        return value, np.empty(0), np.empty((0, 0))
    # L: the part of the inverse that is due to the ends.
    turned, L = (Q @ flat[:ranks]).reshape(ranks, q, count), np.zeros((q, q, count))
    for i in range(ranks):
        _add_outer(L, F[i], turned[i], 1.0)
    told = (pieces * (L.reshape(wide) - E.reshape(wide))).reshape(q, q, count)
    for p in range(2 * pieces):
        _add_outer(told, weighed[p], weighed[p], 1.0)
    # Slopes; traces of the products of slopes: the small matrices D and the pairs of columns among themselves, and D
    # with the columns and with the ends.
    columns, ends = np.zeros((2 * unknowns, q, q, count)), np.zeros((ranks * ranks, q, q, count))
    for i in range(2 * unknowns):
        _add_outer(columns[i], H[pair[i, 0]], H[pair[i, 1]], 2.0 * c[i])
    for i in range(ranks * ranks):
        _add_outer(ends[i], F[i // ranks], F[i % ranks], 1.0)
    diagonal = D.reshape(unknowns, wide)
    score = diagonal @ told.reshape(wide)
    with_columns = diagonal @ columns.reshape(2 * unknowns, wide).T
    at_ends = (diagonal @ ends.reshape(ranks * ranks, wide).T).reshape(unknowns * ranks, ranks)
    with_ends = (at_ends @ Q).reshape(unknowns, ranks, ranks)
    rows = D.reshape(unknowns * q, q, count)
    other = (E.reshape(wide) - 2.0 * L.reshape(wide)).reshape(q, q, count)
    once = _turned(_through(E, rows).reshape(unknowns, q, q, count)).reshape(unknowns, wide)
    information = once @ _through(other, rows).reshape(unknowns, wide).T
    for i in range(unknowns):
        for j in range(i + 1):
            trace = np.sum(with_ends[i] * with_ends[j].T)
            information[i, j] += trace
            if j < i:
                information[j, i] += trace
    for i in range(2 * unknowns):
        r, s = pair[i]
        score[i // 2] += 2.0 * c[i] * (np.sum(along[:, r] * along[:, s]) - pieces * N[r, s])
        for j in range(unknowns):
            information[i // 2, j] += with_columns[j, i]
            information[j, i // 2] += with_columns[j, i]
        for j in range(2 * unknowns):
            o, p = pair[j]
            information[i // 2, j // 2] += 2.0 * c[i] * c[j] * (N[r, o] * N[s, p] + N[r, p] * N[s, o])
    return value, score, pieces * information


@kernel
def _slopes(band: Band, modes: Modes) -> tuple[FloatArray, FloatArray, NDArray[np.int64], FloatArray, FloatArray]:
    """The slopes of a band's covariance by its unknowns: of small matrices at each frequency, and of the ends.

    D (n, q, q, K): slopes of the small matrices; V (R, q, K): columns, the ends first; pair (2 n, 2), c (2 n,): two
    pairs of columns r, s for each unknown that stand for c (v_r v_s^T + v_s v_r^T); sign (2 m,): of the ends.
    """
    q, m = modes.shapes.shape
    count = len(band.frequency_hz)
    unknowns, own = m * (q + 2) + 1, 4 + 2 * (q - 1)
    D, V = np.zeros((unknowns, q, q, count)), np.empty((m * (2 + own), q, count))
    pair, c, sign = np.zeros((2 * unknowns, 2), np.int64), np.zeros(2 * unknowns), np.empty(2 * m)
    for j in range(m):
        v, shape, first = modes.variance[j], modes.shapes[:, j].copy(), 2 * m + j * own
        parts = envelope(band.frequency_hz, modes.frequency_hz[j], modes.decay_rate[j], band.duration_s, True)
        turns = tangents(shape)
        for i in range(q + 2):
            unknown = j * (q + 2) + i
            # The part of the envelope that it moves, and the direction in which the shape's column moves.
            part = (1, 2, 0)[i] if i < 3 else 0
            towards = shape if i < 3 else turns[i - 3]
            for a in range(q):
                for b in range(q):
                    X = shape[a] * shape[b] if i < 3 else shape[a] * towards[b] + towards[a] * shape[b]
                    D[unknown, a, b] = v * X * parts[part, 0]
            for side in range(2):
                end = 2 * j + side
                # The variance's slope is the ends themselves.
                moved = end if i == 2 else first + 2 * (i if i < 2 else i - 1) + side
                for a in range(q):
                    V[moved, a] = towards[a] * parts[part, 1 + side]
                sign[end] = (2 * side - 1) * v
                pair[2 * unknown + side] = end, moved
                c[2 * unknown + side] = sign[end] * (0.5 if i == 2 else 1.0)
    for a in range(q):
        D[unknowns - 1, a, a] = modes.noise
    return D, V, pair, c, sign


@kernel
def _through(M: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns (R, q, K) times a matrix (q, q, K) at each frequency."""
    R, q, count = columns.shape
    product = np.zeros((R, q, count))
    for r in range(R):
        for a in range(q):
            for b in range(q):
                for k in range(count):
                    product[r, a, k] += M[a, b, k] * columns[r, b, k]
    return product


@kernel
def _turned(M: FloatArray) -> FloatArray:
    """Matrices (n, q, q, K) with rows for columns. Loops: numba takes seconds to compile a transposed copy."""
    result = np.empty_like(M)
    for i in range(M.shape[0]):
        for a in range(M.shape[1]):
            for b in range(M.shape[1]):
                for k in range(M.shape[3]):
                    result[i, a, b, k] = M[i, b, a, k]
    return result


@kernel
def _add_outer(total: FloatArray, left: FloatArray, right: FloatArray, factor: float) -> None:
    """Add factor left right^T at each frequency to total (q, q, K); left, right (q, K)."""
    q, count = left.shape
    for a in range(q):
        for b in range(q):
            for k in range(count):
                total[a, b, k] += factor * left[a, k] * right[b, k]
