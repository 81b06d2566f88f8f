"""Whether the frequencies of a stationary response move within the record.

A frequency that moves evenly turns the envelope by a phase that grows with the square of time. Turned back by the right
amount the envelope is that of a steady mode again, in noise that is as white as before: the likelihood of what is
turned back, over the amount, tells how far the frequency moves.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsw.modal.beside import turning
from fsw.modal.stationary_envelope import envelope, woodbury
from fsw.modal.stationary_likelihood import half_band_hz
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Changes over the record that are tried, as shares of the frequency.
CHANGES = np.linspace(-0.08, 0.08, 65)
_NONE, _FIRST_AND_STEP = len(CHANGES) // 2, np.array([CHANGES[0], CHANGES[1] - CHANGES[0]])
# Twice the log likelihood ratio that says a frequency moves, which chance gains in 1 case of 10 000; the least change
# that matters, and the largest that is believed: what is likeliest towards the end of the changes is no mode that
# moves, but a band that one mode does not explain.
LEAST_DRIFT_GAIN, LEAST_DRIFT, LARGEST_DRIFT = 22.0, 0.005, 0.06
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
    first_hz, step_hz = -0.5 * frequency_hz * duration_s * _FIRST_AND_STEP
    turns = turning(time**2, first_hz, step_hz, len(CHANGES))
    inside = np.abs(wide_hz - frequency_hz) <= half_hz
    y = np.fft.fft(envelope * (turns[0] + 1j * turns[1]), axis=1)[:, : len(wide)][:, inside]
    near_hz = frequency_hz + np.linspace(-_WIDTHS, _WIDTHS, _FREQUENCIES) * width_hz
    decay_rate = 2.0 * np.pi * frequency_hz * damping_ratio * np.geomspace(_SLOWEST, _FASTEST, _DECAYS)
    band_hz, turned = np.ascontiguousarray(wide_hz[inside]), np.ascontiguousarray(np.vstack([y.real, y.imag]).T)
    return _profile(band_hz, turned, near_hz, decay_rate, noise * _NOISES, duration_s)


@kernel
def _profile(
    band_hz: FloatArray,
    turned: FloatArray,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    noise: FloatArray,
    duration_s: float,
) -> FloatArray:
    """Largest log likelihood (C,) over frequencies, decay rates and noises of each of C bands, up to a constant.

    turned (K, 2 C): real parts, then imaginary parts of the coefficients at band_hz (K,). The scale is integrated out.
    """
    count, changes, points = len(turned), turned.shape[1] // 2, len(decay_rate) * len(noise)
    power, least, none = (
        turned[:, :changes] ** 2 + turned[:, changes:] ** 2,
        np.full(changes, np.inf),
        np.empty((count, 0)),
    )
    weights, ends, scale = np.empty((points, count)), np.empty((2 * points, count)), np.empty(points)
    for f in frequency_hz:
        for i in range(len(decay_rate)):
            parts = envelope(band_hz, f, decay_rate[i], duration_s, False)[0]
            here = slice(i * len(noise), (i + 1) * len(noise))
            weights[here], logarithm, products = woodbury(parts, noise, none)
            # The smallest of scale * square is the largest likelihood, whose logarithm is -K ln.
            scale[here] = np.exp(logarithm / count)
            for n in range(len(noise)):
                point, (aa, bb, ab) = here.start + n, products[n]
                # Squares completed: the ranks - a a^T + b b^T add one square and take another.
                left, right, shift = np.sqrt(bb / (ab * ab - aa * bb)), np.sqrt(1.0 / bb), ab / bb
                for k in range(count):
                    ends[2 * point, k] = left * (parts[1, k] - shift * parts[2, k]) * weights[point, k]
                    ends[2 * point + 1, k] = right * parts[2, k] * weights[point, k]
        met, square = ends @ turned, weights @ power
        for point in range(points):
            one, two = met[2 * point], met[2 * point + 1]
            for i in range(changes):
                ended = one[i] ** 2 + one[changes + i] ** 2 - two[i] ** 2 - two[changes + i] ** 2
                least[i] = min(least[i], scale[point] * (square[point, i] + ended))
    return -count * np.log(least)


def moves(profiles: Sequence[FloatArray]) -> bool:
    """Whether modes of these profiles move together, by more than matters and more than noise can feign."""
    total = np.sum(profiles, axis=0)
    best = int(np.argmax(total))
    believed = LEAST_DRIFT < abs(float(CHANGES[best])) < LARGEST_DRIFT
    return believed and bool(2.0 * (total[best] - total[_NONE]) > LEAST_DRIFT_GAIN)
