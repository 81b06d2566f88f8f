"""Leading singular vectors of large matrices, in a fixed number of rounds."""

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Vectors beyond those asked for, and rounds of iteration.
_OVERSAMPLING, _ROUNDS = 8, 2


def leading_singular(
    H: FloatArray, count: int, start: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Leading singular vectors and values U (M, k), s (k,), V^T (k, N) of a matrix, k >= count where there are as many.

    A large matrix is met by subspace iteration of a fixed number of rounds from a fixed start; what is of exact rank up
    to count comes out exactly. start (N, k): right vectors of a matrix much like it, which save a round. Source: Halko,
    Martinsson and Tropp, 2011, with chirps instead of random vectors.
    """
    width = count + _OVERSAMPLING
    if min(H.shape) <= 2 * width:
        return _svd(H)
    Q = _chirps(H.shape[1], width) if start is None else start
    for _ in range(_ROUNDS if start is None else 1):
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
