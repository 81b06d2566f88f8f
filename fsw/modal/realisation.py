"""From correlations to poles: block Hankel matrices, their singular values, and the realisation A, B, C (Eq. 33-38)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeev

from fsw.modal.subspace import Dense, leading_singular

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


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
    """Modes of one order or many, those with positive frequency only.

    order (k,) of the realisation; z (k,) discrete poles; shape (p, k) = C psi; rows (k, n) of psi^-1.
    """

    system: Realisation
    order: NDArray[np.int64]
    z: ComplexArray
    shape: ComplexArray
    rows: ComplexArray

    @cached_property
    def participation(self) -> ComplexArray:
        """psi^-1 B (k, m)."""
        return _product(self.rows, self.system.B)

    @cached_property
    def identified(self) -> ComplexArray:
        """The modal amplitudes' series psi^-1 S^1/2 V^T (k, columns * m)."""
        return _product(self.rows, self.system.controllability)

    def of(self, chosen: NDArray[np.intp]) -> "Poles":
        """Some of them."""
        return Poles(self.system, self.order[chosen], self.z[chosen], self.shape[:, chosen], self.rows[chosen])


def block_hankel(h: FloatArray, rows: int, columns: int, first: int = 0) -> FloatArray:
    """Generalised block Hankel matrix H(first) of the series h.

    h (K, p, m) with K >= first + rows + columns - 1. Returns (rows * p, columns * m): block (i, j) is
    h[first + i + j]. Source: Eq. 33.
    """
    _, p, m = h.shape
    # A row of the matrix is a stretch of one output's series.
    series = np.ascontiguousarray(h.transpose(1, 0, 2)).reshape(p, -1)[:, first * m :]
    stretches = np.lib.stride_tricks.sliding_window_view(series, columns * m, axis=1)[:, : rows * m : m]
    return stretches.transpose(1, 0, 2).reshape(rows * p, columns * m)


def realise(h: FloatArray, rows: int, columns: int, order: int) -> Realisation:
    """Balanced realisation of a series by the eigensystem realisation algorithm.

    h (K, p, m) with K >= rows + columns. The order is cut to the numerical rank of H(0). Source: Eq. 34-36.
    """
    _, p, m = h.shape
    H = block_hankel(h, rows + 1, columns)
    U, s, Vt = leading_singular(Dense(H[:-p]), order)
    n, root = _cut(s, order)
    left, right = U[:, :n] / root, Vt[:n].T / root
    A = left.T @ H[p:] @ right
    controllability = Vt[:n] * root[:, None]
    return Realisation(A, controllability[:, :m].copy(), U[:p, :n] * root, controllability)


def weighted_realisation(
    h: FloatArray, rows: int, columns: int, order: int, left: FloatArray, right: FloatArray
) -> Realisation:
    """The same of left H(0) right: weights (rows p, rows p) and (columns m, columns m), taken out again at the end."""
    _, p, m = h.shape
    U, s, Vt = leading_singular(Dense(left @ block_hankel(h, rows, columns) @ right), order)
    n, root = _cut(s, order)
    A = (U[:, :n] / root).T @ left @ block_hankel(h, rows, columns, 1) @ right @ (Vt[:n].T / root)
    observability = np.linalg.solve(left, U[:, :n] * root)
    controllability = np.linalg.solve(right.T, Vt[:n].T * root).T
    parts = (A, controllability[:, :m], observability[:p], controllability)
    return Realisation(*(np.asarray(part, np.float64) for part in parts))


def _cut(s: FloatArray, order: int) -> tuple[int, FloatArray]:
    """The order that singular values allow, and their roots."""
    rank = int(np.count_nonzero(s > s[0] * 1e-13)) if s[0] > 0.0 else 0
    n = min(order, rank)
    return n, np.sqrt(s[:n])


def poles_of_order(system: Realisation, order: int) -> Poles:
    """Eigenvalues and modal matrices of the realisation cut to an order.

    Balanced coordinates make the leading block of A the realisation of the lower order. Source: Eq. 37, 38.
    """
    return poles_of_orders(system, [order])


def poles_of_orders(
    system: Realisation, orders: Sequence[int], wanted: Callable[[ComplexArray], NDArray[np.bool_]] | None = None
) -> Poles:
    """The same of many orders, one after the other; wanted: which of the poles z (k,) to keep."""
    ends = np.cumsum(orders)
    z = np.empty(sum(orders), np.complex128)
    # Vectors of a lower order are zero beyond it: so all orders' shapes are one product.
    left, right = np.zeros((2, system.order, len(z)))
    for order, end in zip(orders, ends, strict=True):
        own = slice(end - order, end)
        z.real[own], z.imag[own], left[:order, own], right[:order, own], failed = dgeev(system.A[:order, :order])
        if failed:
            raise np.linalg.LinAlgError("the eigenvalues of a realisation do not converge")
    keep = np.flatnonzero((z.imag > 0.0) & (np.abs(z) > 1e-6))
    if wanted is not None:
        keep = keep[wanted(z[keep])]
    # LAPACK stores a conjugate pair as real and imaginary part side by side. Left vectors are rows of the inverse, but
    # for their length; of a defective matrix they stand across the right ones, and there is no such row.
    psi, inverse = right[:, keep] + 1j * right[:, keep + 1], (left[:, keep] - 1j * left[:, keep + 1]).T
    length = np.sum(inverse * psi.T, axis=1)[:, None]
    inverse /= np.where(length == 0.0, np.inf, length)
    return Poles(system, np.repeat(orders, orders)[keep], z[keep], _product(system.C, psi), inverse)


def _product(a: NDArray[Any], b: NDArray[Any]) -> ComplexArray:
    """a b, where at most one of the two is complex: the real one is not made complex for it."""
    product = np.empty((len(a), b.shape[1]), np.complex128)
    product.real, product.imag = a.real @ b.real, a.imag @ b.real if np.iscomplexobj(a) else a.real @ b.imag
    return product


def continuous(z: ComplexArray, rate_hz: float) -> ComplexArray:
    """Continuous poles s = ln(z) rate in 1/s. Source: text after Eq. 37."""
    return np.asarray(np.log(z) * rate_hz, np.complex128)


def frequency_and_damping(s: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Frequency |s| / 2 pi in Hz and damping ratio -Re(s) / |s| of poles. Source: Eq. 37, sign corrected."""
    omega = np.abs(s)
    return omega / (2.0 * np.pi), -s.real / omega
