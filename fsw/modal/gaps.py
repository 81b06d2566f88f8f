"""Missing samples of a record: a first guess in time, then through the record's own principal directions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.channels import Channels
from fsw.modal.entries import tell
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]


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
        signals (`tell`). Then each channel's mean, which was taken with the guesses, becomes that of its samples less
        what the signals tell: a channel that is off would step at the ends of its gaps.
        """
        if len(self.gaps) == 0:
            return
        ticks, channels = np.divmod(self.gaps, self.y.shape[1])
        before = self.y[ticks, channels]
        told = before / scale[channels]
        tell(ticks, channels, V, float(np.sum(self.energy / scale**2)), signals, told)
        told *= scale[channels]
        beyond = self.total - scale * (V @ signals.sum(axis=0))
        np.subtract.at(beyond, channels, before - told)
        _shift(self.y, beyond / np.maximum(self.samples, 1), self.total, self.energy)
        _put(self.y, self.gaps, told, self.total, self.energy)

    def through_channels(self, scale: FloatArray, seen: FloatArray, Q: FloatArray) -> None:
        """Fill the gaps through seen (L, r) = (y / scale)^T Q, which becomes that of what is filled.

        Q (T, r) orthonormal. A gap is told by what its channel's samples make of the directions: the other half of
        alternating least squares. Directions of what is filled forget a guess but slowly where they lie in the gaps.
        """
        if len(self.gaps) == 0:
            return
        gaps = self.gaps[self.channelwise]
        ticks, channels = np.divmod(gaps, self.y.shape[1])
        told = self.y[ticks, channels] / scale[channels]
        tell(channels, ticks, Q, float(np.sum(self.energy / scale**2)), seen, told)
        _put(self.y, gaps, told * scale[channels], self.total, self.energy)


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
) -> None:
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
def _put(y: Channels, gaps: NDArray[np.int32], told: FloatArray, total: FloatArray, energy: FloatArray) -> None:
    """Put what is told (G,) in the gaps of y, and what that changes in each channel's sum and sum of squares."""
    width = y.shape[1]
    for i in range(len(gaps)):
        t, c = gaps[i] // width, gaps[i] % width
        before = np.float64(y[t, c])
        y[t, c] = told[i]
        now = np.float64(y[t, c])
        total[c] += now - before
        energy[c] += now * now - before * before
