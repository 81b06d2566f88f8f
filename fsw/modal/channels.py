"""Records of many channels in single or double precision: products and choices that need little memory beside them.

Products are made block by block in double precision: a record of 918 channels is never copied as a whole.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Channels = NDArray[np.floating[Any]]
Number = TypeVar("Number", bound=np.generic)

# Channels of a block, and numbers of a block of ticks: 26 ticks of 918 channels.
_BLOCK, _NUMBERS = 32, 3 << 13


def blocks(length: int, size: int = _BLOCK) -> Iterator[slice]:
    """Slices of size each that cover 0 to length."""
    for begin in range(0, length, size):
        yield slice(begin, min(begin + size, length))


def _ticks(y: Channels) -> Iterator[slice]:
    """Blocks of ticks that cover y (T, L)."""
    return blocks(len(y), max(_NUMBERS // max(y.shape[1], 1), 1))


def times(y: Channels, V: FloatArray) -> FloatArray:
    """y V (T, k) of channels (T, L) and V (L, k)."""
    product = np.empty((len(y), V.shape[1]))
    for part in _ticks(y):
        np.matmul(y[part].astype(np.float64, copy=False), V, out=product[part])
    return product


def transposed_times(y: Channels, Q: FloatArray) -> FloatArray:
    """y^T Q (L, k) of channels (T, L) and Q (T, k)."""
    product = np.zeros((Q.shape[1], y.shape[1]))
    for part in _ticks(y):
        product += Q[part].T @ y[part].astype(np.float64, copy=False)
    return product.T


@dataclass(frozen=True)
class Scaled:
    """The matrix of channels y (T, L), each divided by its scale (L,)."""

    y: Channels
    scale: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """(T, L)."""
        return len(self.y), len(self.scale)

    def times(self, V: FloatArray) -> FloatArray:
        """Its product with V (L, k)."""
        return times(self.y, V / self.scale[:, None])

    def transposed_times(self, Q: FloatArray) -> FloatArray:
        """The product of its transpose with Q (T, k)."""
        return transposed_times(self.y, Q) / self.scale[:, None]

    def dense(self) -> FloatArray:
        """The whole matrix."""
        return np.asarray(self.y / self.scale, np.float64)


def amplitude_spectrum(y: Channels) -> FloatArray:
    """Rms over the channels (T, L) of their amplitudes at frequencies 0, 1 / T, ..., under Hann's window."""
    window = np.hanning(len(y)).astype(y.dtype)[:, None]
    total = np.zeros(len(y) // 2 + 1)
    for part in blocks(y.shape[1]):
        # SciPy keeps single precision, and transforms neighbouring columns together.
        spectrum = scipy.fft.rfft(y[:, part] * window, axis=0)
        total += np.sum(spectrum.real**2 + spectrum.imag**2, axis=1)
    return np.sqrt(total / y.shape[1]) * 2.0 / float(window.sum())


def chosen(
    y: NDArray[Number], ticks: NDArray[np.bool_], channels: NDArray[np.bool_], overwrite: bool = False
) -> NDArray[Number]:
    """y[ticks][:, channels] of its own; overwrite: in the memory of y, which must be contiguous."""
    if not overwrite:
        return y[np.ix_(ticks, channels)]
    if ticks.all() and channels.all():
        return y
    count, width = np.count_nonzero(ticks), np.count_nonzero(channels)
    packed = y.reshape(-1)[: count * width].reshape(count, width)
    # A row moves towards the front, over what was moved already.
    for place, tick in enumerate(np.flatnonzero(ticks)):
        packed[place] = y[tick, channels]
    return packed
