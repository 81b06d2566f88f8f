"""Leading singular vectors of large matrices, in a fixed number of rounds."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dgesdd, dorgqr

FloatArray = NDArray[np.float64]

# Vectors beyond those asked for, and rounds of iteration.
_OVERSAMPLING, _ROUNDS = 8, 2


@dataclass(frozen=True)
class Subspace:
    """Principal directions of a record, for the next one like it to begin with.

    live (M,): channels that it knows; directions (L, k): orthonormal, of these channels divided by their scale (L,).
    """

    live: NDArray[np.bool_]
    directions: FloatArray
    scale: FloatArray

    @property
    def nbytes(self) -> int:
        """Memory of all that is held."""
        return self.live.nbytes + self.directions.nbytes + self.scale.nbytes

    def of(self, channels: NDArray[np.bool_]) -> "Subspace":
        """The same of a choice of the channels (M,)."""
        rows = channels[self.live]
        directions = self.directions[rows]
        if not rows.all():
            directions, _ = np.linalg.qr(directions)
        return Subspace(self.live[channels], directions, self.scale[rows])

    def among(self, channels: NDArray[np.bool_]) -> "Subspace":
        """The same, where its channels were a choice of more (M',)."""
        live = channels.copy()
        live[channels] = self.live
        return Subspace(live, self.directions, self.scale)

    def start(self, count: int) -> FloatArray:
        """Vectors (L, k) to begin an iteration for so many directions with: these, and others for what is new."""
        known = self.directions[:, :count]
        return np.hstack([known, _chirps(len(known), count + _OVERSAMPLING - known.shape[1])])


class Matrix(Protocol):
    """A large matrix (M, N) that is met through its products."""

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""

    def times(self, V: FloatArray, /) -> FloatArray:
        """Its product with V (N, k)."""

    def transposed_times(self, Q: FloatArray, /) -> FloatArray:
        """The product of its transpose with Q (M, k)."""

    def dense(self) -> FloatArray:
        """The whole matrix; asked for where it is small."""


@dataclass(frozen=True)
class Dense:
    """A matrix that is there as a whole."""

    values: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""
        return self.values.shape[0], self.values.shape[1]

    def times(self, V: FloatArray) -> FloatArray:
        """Its product with V (N, k)."""
        return self.values @ V

    def transposed_times(self, Q: FloatArray) -> FloatArray:
        """The product of its transpose with Q (M, k)."""
        return self.values.T @ Q

    def dense(self) -> FloatArray:
        """The values."""
        return self.values


def leading_singular(
    H: Matrix, count: int, start: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Leading singular vectors and values U (M, k), s (k,), V^T (k, N) of a matrix, k >= count where there are as many.

    A large matrix is met by subspace iteration of a fixed number of rounds from a fixed start; what is of exact rank up
    to count comes out exactly. start (N, k): what the transpose made of left vectors of a matrix much like it, with
    which the rounds are done. Source: Halko, Martinsson and Tropp, 2011, with chirps instead of random vectors.
    """
    width = count + _OVERSAMPLING
    if min(H.shape) <= 2 * width:
        return _svd(H.dense())
    if start is None:
        Q = _chirps(H.shape[1], width)
        for _ in range(_ROUNDS):
            Q = orthonormal(H.transposed_times(orthonormal(H.times(Q))))
    else:
        Q = orthonormal(start)
    U, s, W = _svd(H.times(Q))
    return U, s, W @ Q.T


@lru_cache(maxsize=8)
def _chirps(length: int, count: int) -> FloatArray:
    """Columns (length, count) that are spread over all rows and nearly at right angles to each other."""
    i = np.arange(length)[:, None] + 0.5
    chirps = np.cos(np.pi * i**2 * (2.0 * np.arange(count) + 1.0) / (2.0 * length))
    chirps.flags.writeable = False
    return chirps


def orthonormal(A: FloatArray) -> FloatArray:
    """Orthonormal columns (M, k) that span those of A. LAPACK itself: what is wrapped round it costs as much."""
    factored, tau, *_ = dgeqrf(A)
    return np.asarray(dorgqr(factored, tau)[0])


def _svd(H: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin singular value decomposition: by divide and conquer, or by the slower QR iteration where that gives up."""
    U, s, Vt, failed = dgesdd(H, full_matrices=0)
    return scipy.linalg.svd(H, full_matrices=False, lapack_driver="gesvd") if failed else (U, s, Vt)
