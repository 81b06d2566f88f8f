"""From correlations to poles: block Hankel matrices, their singular values, and the realisation A, B, C (Eq. 33-38)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Subspace iteration: vectors beyond those asked for, and rounds.
_OVERSAMPLING, _POWER_ROUNDS = 8, 2


@dataclass(frozen=True)
class Realisation:
    """The balanced realisation of the highest order; lower orders are its leading blocks.

    A (n, n), B (n, m), C (p, n); controllability (n, columns * m) is S^1/2 V^T.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    controllability: FloatArray

    @property
    def order(self) -> int:
        """Number of states n."""
        return len(self.A)


@dataclass(frozen=True)
class Poles:
    """Modes of one order, those with positive frequency only.

    z (k,) discrete poles; shape (p, k) = C psi; participation (k, m) = psi^-1 B; identified (k, columns *
    m): the modal amplitudes' series psi^-1 S^1/2 V^T.
    """

    z: ComplexArray
    shape: ComplexArray
    participation: ComplexArray
    identified: ComplexArray


def block_hankel(h: FloatArray, rows: int, columns: int, first: int = 0) -> FloatArray:
    """Generalised block Hankel matrix H(first) of the series h.

    h (K, p, m) with K >= first + rows + columns - 1. Returns (rows * p, columns * m): block (i, j) is
    h[first + i + j]. Source: Eq. 33.
    """
    _, p, m = h.shape
    index = first + np.arange(rows)[:, None] + np.arange(columns)
    return h[index].transpose(0, 2, 1, 3).reshape(rows * p, columns * m)


def leading_singular(H: FloatArray, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Leading singular vectors and values U (M, k), s (k,), V^T (k, N) of a matrix, k >= count where there are as many.

    A large matrix is met by subspace iteration of a fixed number of rounds from a fixed start; what is of exact rank up
    to count comes out exactly. Source: Halko, Martinsson and Tropp, 2011, with chirps instead of random vectors.
    """
    width = count + _OVERSAMPLING
    if min(H.shape) <= 2 * width:
        return _svd(H)
    Q = _chirps(H.shape[1], width)
    for _ in range(_POWER_ROUNDS):
        Q, _ = np.linalg.qr(H @ Q)
        Q, _ = np.linalg.qr(H.T @ Q)
    U, s, W = _svd(H @ Q)
    return U, s, W @ Q.T


def _chirps(length: int, count: int) -> FloatArray:
    """Columns (length, count) that are spread over all rows and nearly at right angles to each other."""
    i = np.arange(length)[:, None] + 0.5
    return np.cos(np.pi * i**2 * (2.0 * np.arange(count) + 1.0) / (2.0 * length))


def _svd(H: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin singular value decomposition: by divide and conquer, or by the slower QR iteration where that gives up."""
    try:
        return scipy.linalg.svd(H, full_matrices=False, lapack_driver="gesdd")
    except np.linalg.LinAlgError:
        return scipy.linalg.svd(H, full_matrices=False, lapack_driver="gesvd")


def realise(h: FloatArray, rows: int, columns: int, order: int) -> Realisation:
    """Balanced realisation of a series by the eigensystem realisation algorithm.

    h (K, p, m) with K >= rows + columns. The order is cut to the numerical rank of H(0). Source: Eq. 34-36.
    """
    _, p, m = h.shape
    U, s, Vt = leading_singular(block_hankel(h, rows, columns), order)
    rank = int(np.count_nonzero(s > s[0] * 1e-13)) if s[0] > 0.0 else 0
    n = min(order, rank)
    root = np.sqrt(s[:n])
    left, right = U[:, :n] / root, Vt[:n].T / root
    A = left.T @ block_hankel(h, rows, columns, 1) @ right
    controllability = Vt[:n] * root[:, None]
    return Realisation(A, controllability[:, :m].copy(), U[:p, :n] * root, controllability)


def poles_of_order(system: Realisation, order: int) -> Poles:
    """Eigenvalues and modal matrices of the realisation cut to an order.

    Balanced coordinates make the leading block of A the realisation of the lower order. Source: Eq. 37, 38.
    """
    z, psi = np.linalg.eig(system.A[:order, :order])
    keep = np.flatnonzero((z.imag > 0.0) & (np.abs(z) > 1e-6))
    inverse = _inverse(psi)[keep]
    return Poles(
        z=z[keep].astype(np.complex128),
        shape=(system.C[:, :order] @ psi[:, keep]).astype(np.complex128),
        participation=(inverse @ system.B[:order]).astype(np.complex128),
        identified=(inverse @ system.controllability[:order]).astype(np.complex128),
    )


def _inverse(psi: ComplexArray) -> NDArray[Any]:
    """Inverse of the eigenvectors; of a defective matrix the pseudo-inverse."""
    try:
        return np.linalg.inv(psi)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(psi)


def continuous(z: ComplexArray, rate_hz: float) -> ComplexArray:
    """Continuous poles s = ln(z) rate in 1/s. Source: text after Eq. 37."""
    return np.asarray(np.log(z) * rate_hz, np.complex128)


def frequency_and_damping(s: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Frequency |s| / 2 pi in Hz and damping ratio -Re(s) / |s| of poles. Source: Eq. 37, sign corrected."""
    omega = np.abs(s)
    return omega / (2.0 * np.pi), -s.real / omega
