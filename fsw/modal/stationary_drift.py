"""Whether the frequencies of a stationary response move within the record.

A frequency that moves evenly turns the envelope by a phase that grows with the square of time. Turned back by the right
amount the envelope is that of a steady mode again, in noise that is as white as before: the likelihood of what is
turned back, over the amount, tells how far the frequency moves.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsw.modal.stationary_likelihood import half_band_hz
from fsw.modal.stationary_model import envelope
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Changes over the record that are tried, as shares of the frequency.
CHANGES = np.linspace(-0.08, 0.08, 65)
_NONE = len(CHANGES) // 2
# Twice the log likelihood ratio that says a frequency moves, the least change that matters, and the largest that is
# believed: what is likeliest towards the end of the changes is no mode that moves, but a band that one mode does not
# explain.
LEAST_DRIFT_GAIN, LEAST_DRIFT, LARGEST_DRIFT = 16.0, 0.005, 0.06
# Points over frequency, to so many widths of the peak, over the decay rate, as shares of the steady mode's, whose peak
# the drift has made broad, and over the noise beside it.
_FREQUENCIES, _WIDTHS = 25, 3.0
_DECAYS, _SLOWEST, _FASTEST = 9, 0.1, 2.0
_NOISES = np.array([0.2, 1.0, 5.0])


def drift_profile(
    signal: FloatArray, rate_hz: float, frequency_hz: float, damping_ratio: float, noise: float
) -> FloatArray:
    """Log likelihood of each of CHANGES, up to a constant, of the one mode in a signal (T,).

    noise: power of the white noise in a Fourier coefficient over that of the mode.
    """
    duration_s = len(signal) / rate_hz
    half_hz = half_band_hz(frequency_hz, damping_ratio, duration_s)
    width_hz = damping_ratio * frequency_hz + 1.0 / duration_s
    grid_hz = np.fft.rfftfreq(len(signal), 1.0 / rate_hz)
    # Twice the band is turned, so that nothing of the mode is lost at its ends.
    first = max(int((frequency_hz - 2.0 * half_hz) * duration_s), 1)
    wide = np.fft.rfft(signal)[first : int((frequency_hz + 2.0 * half_hz) * duration_s) + 1] / len(signal)
    wide_hz = grid_hz[first : first + len(wide)]
    envelope = np.fft.ifft(wide, 2 * len(wide))
    time = (np.arange(len(envelope)) + 0.5) / len(envelope) - 0.5
    turns = np.exp(-1j * np.pi * np.outer(CHANGES * frequency_hz * duration_s, time**2))
    inside = np.abs(wide_hz - frequency_hz) <= half_hz
    y = np.fft.fft(envelope * turns, axis=1)[:, : len(wide)][:, inside]
    near_hz = frequency_hz + np.linspace(-_WIDTHS, _WIDTHS, _FREQUENCIES) * width_hz
    decay_rate = 2.0 * np.pi * frequency_hz * damping_ratio * np.geomspace(_SLOWEST, _FASTEST, _DECAYS)
    band_hz, turned, power = np.ascontiguousarray(wide_hz[inside]), np.vstack([y.real, y.imag]).T, (np.abs(y) ** 2).T
    least = np.full(len(CHANGES), np.inf)
    for f in near_hz:
        weight, ends, scale = _weights(band_hz, f, decay_rate, noise * _NOISES, duration_s)
        met = (ends @ turned).reshape(len(scale), 2, 2, len(CHANGES)) ** 2
        square = weight @ power + (met[:, 0] - met[:, 1]).sum(axis=1)
        # The smallest of scale * square is the largest likelihood, whose logarithm is -K ln.
        np.minimum(least, np.min(scale[:, None] * square, axis=0), out=least)
    return np.asarray(-y.shape[1] * np.log(least), np.float64)


@kernel
def _weights(
    band_hz: FloatArray, frequency_hz: float, decay_rate: FloatArray, ratio: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What weighs a band of K coefficients y by the inverse of a mode's covariance, for n decay rates and noises.

    y^H covariance^-1 y = weight (n, K) |y|^2 + |ends_0 y|^2 - |ends_1 y|^2, ends (2 n, K) in turn; scale (n,): the K-th
    root of the covariance's determinant.
    """
    count = len(band_hz)
    points = len(decay_rate) * len(ratio)
    weight, ends, scale = np.empty((points, count)), np.empty((2 * points, count)), np.empty(points)
    point = 0
    for rate in decay_rate:
        d, a, b = envelope(band_hz, frequency_hz, rate, duration_s, False)[0]
        for noise in ratio:
            aa, bb, ab, logarithm = -1.0, 1.0, 0.0, 0.0
            for k in range(count):
                w = 1.0 / (d[k] + noise)
                weight[point, k] = w
                logarithm -= np.log(w)
                aa += a[k] * a[k] * w
                bb += b[k] * b[k] * w
                ab += a[k] * b[k] * w
            determinant = ab * ab - aa * bb
            # Woodbury's identity for the ranks - a a^T + b b^T, with squares completed.
            left, right, shift = np.sqrt(bb / determinant), np.sqrt(1.0 / bb), ab / bb
            for k in range(count):
                ends[2 * point, k] = left * (a[k] - shift * b[k]) * weight[point, k]
                ends[2 * point + 1, k] = right * b[k] * weight[point, k]
            scale[point] = np.exp((logarithm + np.log(determinant)) / count)
            point += 1
    return weight, ends, scale


def moves(profiles: Sequence[FloatArray]) -> bool:
    """Whether modes of these profiles move together, by more than matters and more than noise can feign."""
    total = np.sum(profiles, axis=0)
    best = int(np.argmax(total))
    believed = LEAST_DRIFT < abs(float(CHANGES[best])) < LARGEST_DRIFT
    return believed and bool(2.0 * (total[best] - total[_NONE]) > LEAST_DRIFT_GAIN)
