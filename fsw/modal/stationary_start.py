"""Whether a stationary response begins as one, or with a blow before the record: a free decay over what is driven.

A driven mode begins somewhere in its own stationary distribution. One that was struck begins far outside of it, and a
likelihood that knows no blow can only make that likely by a large variance and a slow decay: the damping comes out far
too low, with a small deviation.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.modal.stationary_envelope import envelope
from fsw.modal.stationary_likelihood import band_of, half_band_hz

FloatArray = NDArray[np.float64]

# Decay rates and ratios of noise to the mode, times those found without a blow: what a blow feigns is slower and
# stronger than the mode.
_DECAYS, _RATIOS = np.exp([-0.5, 0.3, 1.1, 1.9, 2.7]), np.exp([-0.5, 0.5, 2.0, 4.0])
# Chance that the modes of a stationary response, or one of them, gain so much by a blow.
_CHANCE = 3e-4
_SIGNS = np.diag([-1.0, 1.0])


def start_gain(signal: FloatArray, rate_hz: float, frequency_hz: float, damping_ratio: float, noise: float) -> float:
    """Twice the log likelihood ratio of a mode that begins anywhere against one that begins as it goes on.

    signal (T,) in which the mode stands alone; noise: variance of the noise in a Fourier coefficient over that of the
    mode's envelope, as for drift_profile. Amplitude and phase of the free decay are what is most likely, and so are the
    decay rate and the noise, with it and without. The covariance diag(d) - a a^T + b b^T of the response is inverted by
    Woodbury's identity; the coefficients of a free decay from the start on are along a + i b.
    """
    reach_hz = half_band_hz(frequency_hz, damping_ratio, len(signal) / rate_hz)
    band = band_of(signal[:, None], rate_hz, frequency_hz - reach_hz, frequency_hz + reach_hz)
    y = band.coefficients[:, :, 0].T
    stationary = struck = -np.inf
    for decay_rate in 2.0 * np.pi * frequency_hz * damping_ratio * _DECAYS:
        d, a, b = envelope(band.frequency_hz, frequency_hz, decay_rate, band.duration_s, False)[0]
        ends = np.stack([a, b], axis=1)
        for ratio in noise * _RATIOS:
            weight = 1.0 / (d + ratio)
            weighted = weight[:, None] * ends
            gram = ends.T @ weighted
            inverse = np.linalg.inv(gram + _SIGNS)
            whitened = weight[:, None] * y - weighted @ (inverse @ (weighted.T @ y))
            square = float(np.sum((y.conj() * whitened).real))
            met = ends.T @ whitened[:, 0]
            explained = abs(met[0] - 1j * met[1]) ** 2 / float(np.trace(gram - gram @ inverse @ gram))
            # Of a record in pieces the first one holds the start.
            volume = y.shape[1] * float(np.sum(np.log(weight)) + np.log(abs(np.linalg.det(inverse))))
            stationary = max(stationary, volume - y.size * np.log(square))
            struck = max(struck, volume - y.size * np.log(max(square - explained, 1e-12 * square)))
    return float(2.0 * (struck - stationary))


def begin_with_a_blow(gains: Sequence[float]) -> bool:
    """Whether modes with these gains were struck, all together or one of them.

    Without a blow each gains like a chi-square of two degrees of freedom: amplitude and phase of a free decay.
    """
    count = len(gains)
    return bool(sum(gains) > chdtri(2 * count, _CHANCE) or max(gains) > chdtri(2, _CHANCE / count))
