"""Algebra of matrices so small that calling a library costs more than the work, in compiled code."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesdd

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]


def pseudo_inverse(A: FloatArray, rcond: float) -> FloatArray:
    """Pseudo-inverse (n, m) of a matrix (m, n); singular values below this share of the largest count as zero.

    LAPACK itself: what is wrapped round it costs several times as much.
    """
    U, s, Vt, failed = dgesdd(A, full_matrices=0)
    if failed:
        raise np.linalg.LinAlgError("singular values do not converge")
    return np.asarray((Vt.T / np.where(s > rcond * s[0], s, np.inf)) @ U.T)


@kernel
def inverse(A: FloatArray) -> tuple[FloatArray, float]:
    """Inverse (n, n) of a small matrix and the logarithm of its determinant's size, by elimination with pivots."""
    n = len(A)
    left, right = A.copy(), np.eye(n)
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
