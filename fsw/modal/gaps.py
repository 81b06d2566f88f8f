"""Missing samples of a record: a first guess in time, then through the record's own principal coordinates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.channels import Channels
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# What is left of the equations is no more than this part of the noise.
_ARRIVED = 1e-3
_FACTOR = 2.0


@dataclass(frozen=True)
class Samples:
    """Where a record's samples are: how many in each tick (T,) and in each channel (L,), and which channels move."""

    of_tick: NDArray[np.int64]
    of_channel: NDArray[np.int64]
    moves: NDArray[np.bool_]


def samples_of(y: Channels) -> Samples:
    """Where samples are, of channels (T, L) in which NaN stands for none."""
    of_tick, of_channel = np.zeros(len(y), np.int64), np.zeros(y.shape[1], np.int64)
    least, most = np.full(y.shape[1], np.inf, y.dtype), np.full(y.shape[1], -np.inf, y.dtype)
    _count(y, of_tick, of_channel, least, most)
    return Samples(of_tick, of_channel, most > least)


@dataclass(frozen=True)
class Filled:
    """A record without its mean, with guesses where no sample is, and what is kept up while the guesses get better.

    y (T, L); gaps (G,): places in y, counted tick by tick, where no sample is; channelwise (G,): their order channel by
    channel; samples (L,): of each channel; total, energy (L,): sum and sum of squares of each channel of y.
    """

    y: Channels
    gaps: NDArray[np.int32]
    channelwise: NDArray[np.int64]
    samples: NDArray[np.int64]
    total: FloatArray
    energy: FloatArray

    def through(self, scale: FloatArray, signals: FloatArray, V: FloatArray) -> None:
        """Fill the gaps through signals (T, r) = (y / scale) V, which become those of what is filled.

        V (L, r) orthonormal; scale (L,): each channel's noise. A gap is told by what its tick's samples make of the
        signals (`_tell_gaps`). Then each channel's mean, which was taken with the guesses, becomes that of its samples
        less what the signals tell: a channel that is off would step at the ends of its gaps.
        """
        if len(self.gaps) == 0:
            return
        ticks, channels = np.divmod(self.gaps, self.y.shape[1])
        told = self.y[ticks, channels] / scale[channels]
        _tell_gaps(ticks, channels, V, self._doubt(scale, ticks, channels, V, signals, told), signals, told)
        told *= scale[channels]
        beyond = self.total - scale * (V @ signals.sum(axis=0))
        np.subtract.at(beyond, channels, self.y[ticks, channels] - told)
        _shift(self.y, beyond / np.maximum(self.samples, 1), self.total, self.energy)
        _put(self.y, self.gaps, told, self.total, self.energy)

    def through_channels(self, scale: FloatArray, seen: FloatArray, Q: FloatArray) -> None:
        """Fill the gaps through seen (L, r) = (y / scale)^T Q, which becomes that of what is filled.

        Q (T, r) orthonormal. A gap is told by what its channel's samples make of the directions: the other half of
        alternating least squares. Directions from an analysis of what is filled would forget a guess slowly, and not at
        all where only one tick's gaps tell of them.
        """
        if len(self.gaps) == 0:
            return
        order = self.channelwise
        ticks, channels = np.divmod(self.gaps[order], self.y.shape[1])
        told = self.y[ticks, channels] / scale[channels]
        _tell_gaps(channels, ticks, Q, self._doubt(scale, channels, ticks, Q, seen, told), seen, told)
        _put(self.y, self.gaps[order], told * scale[channels], self.total, self.energy)

    def _doubt(
        self, scale: FloatArray, rows: NDArray[np.int32], columns: NDArray[np.int32],
        V: FloatArray, signals: FloatArray, told: FloatArray,
    ) -> FloatArray:
        """Noise over signal (r,) of each direction, in the samples and beyond what noise alone would show.
        """
        (count, width), rank = self.y.shape, V.shape[1]
        in_gaps = np.zeros(rank)
        missed = _in_gaps(rows, columns, V, signals, told, in_gaps)
        square = np.sum(signals**2, axis=0)
        rest = max(float(np.sum(self.energy / scale**2) - np.sum(square)) - missed, 0.0)
        noise = rest / max((count - rank) * (width - rank) - len(told), 1)
        beyond = square - in_gaps - _FACTOR * noise * (np.sqrt(count) + np.sqrt(width)) ** 2
        return noise * len(signals) / np.maximum(beyond, 1e-9 * noise + 1e-300)


def filled(stamps: FloatArray, y: Channels) -> Filled:
    """The record y (T, L), which is changed: where it is NaN a first guess, and no mean.

    The guess is linear in time (stamps (T,), increasing), channel by channel; at the ends it is the nearest sample.
    """
    count, width = y.shape
    gaps = np.flatnonzero(np.isnan(y)).astype(np.int32)
    _interpolate(stamps, y, gaps)
    total, energy = np.empty(width), np.empty(width)
    _shift(y, y.mean(axis=0, dtype=np.float64), total, energy)
    channels = gaps % width
    samples = count - np.bincount(channels, minlength=width)
    return Filled(y, gaps, np.argsort(channels, kind="stable"), samples, total, energy)


@kernel
def _count(
    y: Channels, of_tick: NDArray[np.int64], of_channel: NDArray[np.int64], least: Channels, most: Channels
) -> None:  # fmt: skip
    for t in range(y.shape[0]):
        samples = 0
        for c in range(y.shape[1]):
            value = y[t, c]
            there = not np.isnan(value)
            samples += there
            of_channel[c] += there
            least[c] = value if value < least[c] else least[c]
            most[c] = value if value > most[c] else most[c]
        of_tick[t] = samples


@kernel
def _interpolate(stamps: FloatArray, y: Channels, gaps: NDArray[np.int32]) -> None:
    count, width = y.shape
    for place in gaps:
        t, c = place // width, place % width
        if not np.isnan(y[t, c]):  # with the first of its gap
            continue
        after = t + 1
        while after < count and np.isnan(y[after, c]):
            after += 1
        for i in range(t, after):
            if after == count or t == 0:
                y[i, c] = y[after, c] if after < count else y[t - 1, c]
            else:
                share = (stamps[i] - stamps[t - 1]) / (stamps[after] - stamps[t - 1])
                y[i, c] = y[t - 1, c] * (1.0 - share) + y[after, c] * share


@kernel
def _shift(y: Channels, off: FloatArray, total: FloatArray, energy: FloatArray) -> None:
    """Take a constant (L,) from each channel of y, whose sums become total, energy (L,)."""
    total[:] = 0.0
    energy[:] = 0.0
    for t in range(y.shape[0]):
        for c in range(y.shape[1]):
            y[t, c] -= off[c]
            value = np.float64(y[t, c])
            total[c] += value
            energy[c] += value * value


@kernel
def _tell_gaps(
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    V: FloatArray,
    doubt: FloatArray,
    signals: FloatArray,
    told: FloatArray,
) -> None:
    """Fill the gaps of a matrix Y (M, N) of unit noise, row by row, by what the row's samples make of its signals.

    rows, columns (G,): places of the gaps, row by row; told (G,): what was filled in, becomes what is; V (N, r)
    orthonormal; signals (M, r) = Y V, become those of what is filled; doubt (r,): 1 / P, one over each one's mean
    square. By least squares, (V^T W V + 1 / P) a = V^T W y with W = 1 at samples and 0 at gaps: nothing stays of the
    guess before, nor does a direction that the samples hardly tell of follow their noise.
    Source: Tipping and Bishop, 1999, probabilistic principal component analysis.

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
        _tell(G, a, n, at_gaps)
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
            _tell(G, p, n, at_gaps)
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
        _tell(G, a, n, at_gaps)
        for k in range(rank):
            for i in range(n):
                signals[row, k] += G[k, i] * at_gaps[i]
        told[first : first + n] = at_gaps[:n]
        first += n


@kernel
def _in_gaps(
    rows: NDArray[np.int32], columns: NDArray[np.int32], V: FloatArray, signals: FloatArray, told: FloatArray,
    energy: FloatArray,
) -> float:
    """Energy (r,) of each direction in the gaps, and what is filled in beyond them all."""
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
def _tell(G: FloatArray, a: FloatArray, count: int, at_gaps: FloatArray) -> None:
    """What coordinates a (r,) tell of the first gaps, of directions G (r, L)."""
    at_gaps[:count] = 0.0
    for k in range(len(a)):
        for i in range(count):
            at_gaps[i] += G[k, i] * a[k]


@kernel
def _put(
    y: Channels, gaps: NDArray[np.int32], told: FloatArray, total: FloatArray, energy: FloatArray
) -> None:  # fmt: skip
    """Put what is told (G,) in the gaps of y, and what that changes in each channel's sum and sum of squares."""
    width = y.shape[1]
    for i in range(len(gaps)):
        t, c = gaps[i] // width, gaps[i] % width
        before = np.float64(y[t, c])
        y[t, c] = told[i]
        now = np.float64(y[t, c])
        total[c] += now - before
        energy[c] += now * now - before * before
