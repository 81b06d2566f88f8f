"""Likelihood of modes in a band of a stationary response, with its slopes, in closed form and in compiled code.

The covariance of the band's coefficients is a small matrix at each frequency, of the modes' spectra along their shapes
and of the noise, and two ranks for each mode, of the record's two ends. Its inverse is of the same form (Woodbury), and
so are its slopes: nothing as large as the band squared is ever made.
"""

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@kernel
def envelope(
    band_hz: FloatArray, frequency_hz: float, decay_rate: float, duration_s: float, slopes: bool
) -> FloatArray:
    """d, a, b (1, 3, K) of the covariance diag(d) - a a^T + b b^T of a mode's Fourier coefficients at band_hz (K,).

    With slopes (3, 3, K): these, and their slopes by frequency and by ln decay rate. With p_k = (decay_rate +
    i (w_k - w)) T and c = exp((i w - decay_rate) T), the double integral of exp(-decay_rate |t - s|) over the record is
    diag(2 Re 1 / p) - 2 Re((1 - c) (1 / p) (1 / p)^T). That is a unit envelope's. A displacement driven by white force
    has the pole at -w as well: its coefficients are 2 w / (w_k + w) times as large, steeper above the peak than below.
    """
    parts = np.empty((3 if slopes else 1, 3, len(band_hz)))
    turn, decay = 2.0 * np.pi * duration_s, decay_rate * duration_s
    c = np.exp(complex(-decay, turn * frequency_hz))
    ends = np.sqrt(2.0 * (1.0 - c))
    by_frequency, by_decay = -1j * turn * c / ends, decay * c / ends
    for k in range(len(band_hz)):
        off, far = turn * (band_hz[k] - frequency_hz), band_hz[k] + frequency_hz
        weight, slope = 2.0 * frequency_hz / far, band_hz[k] / (frequency_hz * far)
        square = decay**2 + off**2
        one = 1.0 / complex(decay, off)
        d, e = 2.0 * decay / square * weight**2, weight * ends * one
        parts[0, 0, k], parts[0, 1, k], parts[0, 2, k] = d, e.real, e.imag
        if not slopes:
            continue
        f = weight * by_frequency * one + (1j * turn * one + slope) * e
        g = (weight * by_decay - decay * e) * one
        parts[1, 0, k], parts[1, 1, k], parts[1, 2, k] = 2.0 * d * (turn * off / square + slope), f.real, f.imag
        parts[2, 0, k], parts[2, 1, k], parts[2, 2, k] = d * (1.0 - 2.0 * decay**2 / square), g.real, g.imag
    return parts


@kernel
def inverse(A: FloatArray) -> tuple[FloatArray, float]:
    """Inverse (n, n) of a small matrix and the logarithm of its determinant's size, by elimination with pivots."""
    n = len(A)
    left, right = A.copy(), np.zeros((n, n))
    for i in range(n):
        right[i, i] = 1.0
    logarithm = 0.0
    for i in range(n):
        best = i
        for j in range(i + 1, n):
            if abs(left[j, i]) > abs(left[best, i]):
                best = j
        for j in range(n):
            left[i, j], left[best, j] = left[best, j], left[i, j]
            right[i, j], right[best, j] = right[best, j], right[i, j]
        pivot = left[i, i]
        logarithm += np.log(abs(pivot))
        for j in range(n):
            left[i, j] /= pivot
            right[i, j] /= pivot
        for r in range(n):
            if r != i:
                factor = left[r, i]
                for j in range(n):
                    left[r, j] -= factor * left[i, j]
                    right[r, j] -= factor * right[i, j]
    return right, logarithm


@kernel
def tangents(shape: FloatArray) -> FloatArray:
    """Orthonormal directions (q - 1, q) in which a unit shape (q,) can turn: rows of a Householder reflection."""
    q = len(shape)
    normal = shape.copy()
    normal[0] += 1.0 if shape[0] >= 0.0 else -1.0
    square = np.sum(normal**2)
    turned = np.empty((q - 1, q))
    for t in range(q - 1):
        for i in range(q):
            turned[t, i] = (1.0 if i == t + 1 else 0.0) - 2.0 * normal[t + 1] * normal[i] / square
    return turned


@kernel
def likelihood(
    band_hz: FloatArray,
    y: ComplexArray,
    duration_s: float,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    noise: float,
) -> tuple[float, FloatArray, FloatArray]:
    """Log likelihood, its slopes (n,) and the Fisher information (n, n) of modes (m,) with unit shapes (q, m).

    y (pieces, K, q): coefficients at band_hz (K,). The n unknowns are each mode's frequency in Hz, ln decay rate, ln
    variance and turns of the shape (q - 1), mode by mode, and ln noise.
    """
    pieces, count, q = y.shape
    modes, own = len(frequency_hz), q + 2
    unknowns, ranks, columns = modes * own + 1, 2 * modes, 4 + 2 * q
    R = modes * columns
    # The slope by an unknown i is X_i at each frequency times w_i there, and two pairs of columns r, s that stand for
    # c (v_r v_s^T + v_s v_r^T); a column is a direction x times a spectrum u.
    X, w = np.zeros((unknowns, q, q)), np.ones((unknowns, count))
    pair, c = np.zeros((unknowns, 2, 2), np.int64), np.zeros((unknowns, 2))
    x, u = np.empty((R, q)), np.empty((R, count))
    ends, sign = np.empty(ranks, np.int64), np.empty(ranks)
    E = np.zeros((count, q, q))
    for j in range(modes):
        v, s, first = variance[j], shapes[:, j].copy(), j * columns
        parts, turns = envelope(band_hz, frequency_hz[j], decay_rate[j], duration_s, True), tangents(s)
        for side in range(2):
            ends[2 * j + side], sign[2 * j + side] = first + side, (2 * side - 1) * v
            for i in range(own):  # the mode's a and b, their slopes by frequency, by ln decay rate, and turned
                for a in range(q):
                    x[first + 2 * i + side, a] = s[a] if i < 3 else turns[i - 3, a]
                for k in range(count):
                    u[first + 2 * i + side, k] = parts[i if i < 3 else 0, 1 + side, k]
        for i in range(own):
            unknown = j * own + i
            part = (1, 2, 0)[i] if i < 3 else 0
            for k in range(count):
                w[unknown, k] = parts[part, 0, k]
            for side in range(2):
                other = first + 6 + 2 * (i - 3) if i >= 3 else first + 2 * part
                pair[unknown, side, 0], pair[unknown, side, 1] = first + side, other + side
                c[unknown, side] = (2 * side - 1) * v * (0.5 if i == 2 else 1.0)
            for a in range(q):
                for b in range(q):
                    X[unknown, a, b] = v * (s[a] * s[b] if i < 3 else s[a] * turns[i - 3, b] + turns[i - 3, a] * s[b])
        for k in range(count):
            for a in range(q):
                for b in range(q):
                    E[k, a, b] += v * parts[0, 0, k] * s[a] * s[b]
    for a in range(q):
        X[unknowns - 1, a, a] = noise
    determinant = 0.0
    for k in range(count):
        for a in range(q):
            E[k, a, a] += noise
        if q == 1:
            determinant += np.log(E[k, 0, 0])
            E[k, 0, 0] = 1.0 / E[k, 0, 0]
        else:
            its_inverse, logarithm = inverse(E[k])
            determinant += logarithm
            for a in range(q):
                for b in range(q):
                    E[k, a, b] = its_inverse[a, b]
    # F = E v of all columns, their products N, and the inverse Q of what the ends add.
    F, N = np.empty((R, count, q)), np.empty((R, R))
    for r in range(R):
        for k in range(count):
            for a in range(q):
                total = 0.0
                for b in range(q):
                    total += E[k, a, b] * x[r, b]
                F[r, k, a] = total * u[r, k]
    for r in range(R):
        for o in range(r + 1):
            total = 0.0
            for k in range(count):
                for a in range(q):
                    total += x[o, a] * u[o, k] * F[r, k, a]
            N[r, o] = N[o, r] = total
    inner, met = np.empty((ranks, ranks)), np.empty((ranks, R))
    for i in range(ranks):
        for r in range(R):
            met[i, r] = N[ends[i], r]
        for j in range(ranks):
            inner[i, j] = N[ends[i], ends[j]] + (1.0 / sign[i] if i == j else 0.0)
        determinant += np.log(abs(sign[i]))
    Q, logarithm = inverse(inner)
    determinant += logarithm
    # H = covariance^-1 v of all columns, their products N, and the part L of the inverse that is due to the ends.
    Z, H, L = _product(Q, met), F.copy(), np.zeros((count, q, q))
    for r in range(R):
        for i in range(ranks):
            for o in range(R):
                N[r, o] -= met[i, r] * Z[i, o]
            for k in range(count):
                for a in range(q):
                    H[r, k, a] -= Z[i, r] * F[ends[i], k, a]
    for i in range(ranks):
        for j in range(ranks):
            for k in range(count):
                for a in range(q):
                    for b in range(q):
                        L[k, a, b] += Q[i, j] * F[ends[i], k, a] * F[ends[j], k, b]
    square, score = 0.0, np.zeros(unknowns)
    weighed, along = np.empty((count, q), np.complex128), np.empty(R, np.complex128)
    for piece in range(pieces):
        for r in range(R):
            along[r] = 0.0
            for k in range(count):
                for a in range(q):
                    along[r] += H[r, k, a] * y[piece, k, a]
        for k in range(count):
            for a in range(q):
                weighed[k, a] = 0.0
                for b in range(q):
                    weighed[k, a] += E[k, a, b] * y[piece, k, b]
                for i in range(ranks):
                    weighed[k, a] -= sign[i] * F[ends[i], k, a] * along[ends[i]]
                square += (np.conj(y[piece, k, a]) * weighed[k, a]).real
        for i in range(unknowns):
            for side in range(2):
                r, s = pair[i, side]
                score[i] += 2.0 * c[i, side] * (np.conj(along[r]) * along[s]).real
            for a in range(q):
                for b in range(q):
                    if X[i, a, b] != 0.0:
                        for k in range(count):
                            score[i] += w[i, k] * X[i, a, b] * (np.conj(weighed[k, a]) * weighed[k, b]).real
    # Traces: of the slopes, and of their products.
    G, P, S = np.zeros((unknowns, ranks, ranks)), np.zeros((unknowns, count, q, q)), np.zeros((unknowns, count, q, q))
    for i in range(unknowns):
        trace = 0.0
        for side in range(2):
            trace += 2.0 * c[i, side] * N[pair[i, side, 0], pair[i, side, 1]]
        for k in range(count):
            for a in range(q):
                for b in range(q):
                    trace += w[i, k] * X[i, a, b] * (E[k, a, b] - L[k, a, b])
                    for e in range(q):
                        P[i, k, a, b] += w[i, k] * E[k, a, e] * X[i, e, b]
                        S[i, k, b, a] += w[i, k] * (E[k, a, e] - 2.0 * L[k, a, e]) * X[i, e, b]
        score[i] -= pieces * trace
        for m in range(ranks):
            for n in range(ranks):
                for k in range(count):
                    for a in range(q):
                        for b in range(q):
                            G[i, m, n] += w[i, k] * X[i, a, b] * F[ends[m], k, a] * F[ends[n], k, b]
        product = _product(Q, G[i])
        for m in range(ranks):
            for n in range(ranks):
                G[i, m, n] = product[m, n]
    information = np.empty((unknowns, unknowns))
    for i in range(unknowns):
        for j in range(i + 1):
            total = 0.0
            for m in range(ranks):
                for n in range(ranks):
                    total += G[i, m, n] * G[j, n, m]
            for k in range(count):
                for a in range(q):
                    for b in range(q):
                        total += P[i, k, a, b] * S[j, k, a, b]
            for one in range(2):
                total += 2.0 * c[j, one] * _between(H, pair[j, one], X[i], w[i])
                total += 2.0 * c[i, one] * _between(H, pair[i, one], X[j], w[j])
                for two in range(2):
                    (r, s), (o, p) = pair[i, one], pair[j, two]
                    total += 2.0 * c[i, one] * c[j, two] * (N[r, o] * N[s, p] + N[r, p] * N[s, o])
            information[i, j] = information[j, i] = pieces * total
    return -pieces * determinant - square, score, information


@kernel
def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """A B of small matrices."""
    result = np.zeros((len(A), B.shape[1]))
    for i in range(len(A)):
        for k in range(len(B)):
            for j in range(B.shape[1]):
                result[i, j] += A[i, k] * B[k, j]
    return result


@kernel
def _between(H: FloatArray, pair: NDArray[np.int64], X: FloatArray, w: FloatArray) -> float:
    """The product of two columns of H (R, K, q) through a matrix X (q, q) at each frequency, times w (K,)."""
    left, right = H[pair[0]], H[pair[1]]
    q = len(X)
    total = 0.0
    for k in range(len(w)):
        for a in range(q):
            for b in range(q):
                total += w[k] * X[a, b] * left[k, a] * right[k, b]
    return total
