"""Whether the frequencies of a stationary response move within the record.

A frequency that moves evenly turns the envelope by a phase that grows with the square of time. Turned back by the right
amount the envelope is that of a steady mode again, in noise that is as white as before: the likelihood of what is
turned back, over the amount, tells how far the frequency moves.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsw.modal.stationary_likelihood import half_band_hz
from fsw.modal.stationary_posterior import weighed

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
    grids = np.meshgrid(near_hz, decay_rate, noise * _NOISES, indexing="ij")
    determinant, squares = weighed(wide_hz[inside], y, duration_s, *grids)
    likelihood = -determinant[..., None] - y.shape[1] * np.log(squares)
    return np.asarray(likelihood.max(axis=(0, 1, 2)), np.float64)


def moves(profiles: Sequence[FloatArray]) -> bool:
    """Whether modes of these profiles move together, by more than matters and more than noise can feign."""
    total = np.sum(profiles, axis=0)
    best = int(np.argmax(total))
    believed = LEAST_DRIFT < abs(float(CHANGES[best])) < LARGEST_DRIFT
    return believed and bool(2.0 * (total[best] - total[_NONE]) > LEAST_DRIFT_GAIN)
