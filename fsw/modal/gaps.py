"""Missing samples of a record: a first guess in time, then through the record's own principal coordinates."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.channels import Channels, Scaled
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Share of a direction that must be seen at a tick for the tick to speak for it.
_UNTOLD = 0.03


def fill_in_time(stamps: FloatArray, y: Channels, present: NDArray[np.bool_]) -> None:
    """First guess, into y (T, L): linear in time, channel by channel; at the ends the nearest sample.

    stamps (T,) increasing; present (T, L): each channel has a sample.
    """
    _interpolate(stamps, y, present, np.full(y.shape[1], -1, np.int64))


def fill_through(scaled: Scaled, gaps: NDArray[np.int32], signals: FloatArray, V: FloatArray) -> None:
    """Fill the gaps of scaled.y through its signals (T, r) = scaled V, which are corrected as well.

    gaps (G,): places in scaled.y (T, L), counted tick by tick, where no sample is; V (L, r) orthonormal.
    Least squares on the channels that are there, tick by tick: (V^T W V) da = V^T W (y - V a). A direction that only
    missing channels could tell keeps its value from the fill before.
    """
    basis = V * scaled.scale[:, None]
    _correct(scaled.y, gaps, scaled.scale, V, signals)
    # Each channel's mean was taken with the guess in its gaps: what is there says how far it is off, and a channel
    # that is off would step at the ends of its gaps.
    wrong = -(basis @ signals.sum(axis=0))
    _take_out_mean(scaled.y, gaps, basis, signals, wrong)
    _put_in(scaled.y, gaps, basis, signals)


@kernel
def _interpolate(stamps: FloatArray, y: Channels, present: NDArray[np.bool_], last: NDArray[np.int64]) -> None:
    """last (L,): -1."""
    count, width = y.shape
    for t in range(count):
        for c in range(width):
            if not present[t, c]:
                continue
            for i in range(last[c] + 1, t):
                if last[c] < 0:
                    y[i, c] = y[t, c]
                else:
                    share = (stamps[i] - stamps[last[c]]) / (stamps[t] - stamps[last[c]])
                    y[i, c] = y[last[c], c] * (1.0 - share) + y[t, c] * share
            last[c] = t
    for c in range(width):
        for i in range(last[c] + 1, count):
            y[i, c] = y[last[c], c]


@kernel
def _correct(y: Channels, gaps: NDArray[np.int32], scale: FloatArray, V: FloatArray, signals: FloatArray) -> None:
    """Add da to the signals. V is orthonormal and a = V^T y: so V^T W V is 1 less what the gaps take from it, and what
    is there pulls by what the gaps do not.
    """
    width, rank = V.shape
    A, b = np.empty((rank, rank)), np.empty(rank)
    i = 0
    while i < len(gaps):
        t = gaps[i] // width
        b[:] = 0.0
        A[:] = 0.0
        for k in range(rank):
            A[k, k] = 1.0 + _UNTOLD
        while i < len(gaps) and gaps[i] // width == t:
            c = gaps[i] % width
            wrong, direction = y[t, c] / scale[c], V[c]
            for k in range(rank):
                wrong -= direction[k] * signals[t, k]
            for k in range(rank):
                share, row = direction[k], A[k]
                b[k] -= share * wrong
                for j in range(rank):  # whole rows go several numbers at a time
                    row[j] -= share * direction[j]
            i += 1
        _solve(A, b)
        for k in range(rank):
            signals[t, k] += b[k]


@kernel
def _solve(A: FloatArray, b: FloatArray) -> None:
    """Solve A x = b, A positive definite and given below its diagonal, by Cholesky; x replaces b, A is used up."""
    for k in range(len(b)):
        for i in range(k + 1):
            total = A[k, i]
            for j in range(i):
                total -= A[k, j] * A[i, j]
            A[k, i] = np.sqrt(total) if i == k else total / A[i, i]
    for k in range(len(b)):
        for j in range(k):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]
    for k in range(len(b) - 1, -1, -1):
        for j in range(k + 1, len(b)):
            b[k] -= A[j, k] * b[j]
        b[k] /= A[k, k]


@kernel
def _take_out_mean(
    y: Channels, gaps: NDArray[np.int32], basis: FloatArray, signals: FloatArray, wrong: FloatArray
) -> None:  # fmt: skip
    """Take from y the mean of y - signals basis^T where samples are. wrong (L,): less the sums of signals basis^T."""
    count, width = y.shape
    samples = np.full(width, count)
    for t in range(count):
        for c in range(width):
            wrong[c] += y[t, c]
    for place in gaps:
        t, c = place // width, place % width
        value = np.float64(y[t, c])
        for k in range(basis.shape[1]):
            value -= basis[c, k] * signals[t, k]
        wrong[c] -= value
        samples[c] -= 1
    for c in range(width):
        wrong[c] /= max(samples[c], 1)
    for t in range(count):
        for c in range(width):
            y[t, c] -= wrong[c]


@kernel
def _put_in(y: Channels, gaps: NDArray[np.int32], basis: FloatArray, signals: FloatArray) -> None:
    """Gaps of y become signals basis^T."""
    for place in gaps:
        t, c = place // len(basis), place % len(basis)
        value = 0.0
        for k in range(basis.shape[1]):
            value += basis[c, k] * signals[t, k]
        y[t, c] = value
