"""Whether a stationary response begins as one, or with a blow before the record: a free decay over what is driven.

A driven mode begins somewhere in its own stationary distribution. One that was struck begins far outside of it, and a
likelihood that knows no blow can only make that likely by a large variance and a slow decay: the damping comes out far
too low, with a small deviation.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.modal.stationary_envelope import envelope, woodbury
from fsw.modal.stationary_likelihood import band_of, half_band_hz

FloatArray = NDArray[np.float64]

# Decay rates and ratios of noise to the mode, times those found without a blow: what a blow feigns is slower and
# stronger than the mode.
_DECAYS, _RATIOS = np.exp([-0.5, 0.3, 1.1, 1.9, 2.7]), np.exp([-0.5, 0.5, 2.0, 4.0])
# Chance that the modes of a stationary response, or one of them, gain so much by a blow, and degrees of freedom of a
# gain: amplitude and phase of a free decay, and what a better decay rate and noise gain with it.
_CHANCE, _FREEDOMS = 3e-5, 3


def start_gain(signal: FloatArray, rate_hz: float, frequency_hz: float, damping_ratio: float, noise: float) -> float:
    """Twice the log likelihood ratio of a mode that begins anywhere against one that begins as it goes on.

    signal (T,) in which the mode stands alone; noise: variance of the noise in a Fourier coefficient over that of the
    mode's envelope, as for drift_profile. Amplitude and phase of the free decay are what is most likely, and so are the
    decay rate and the noise, with it and without. A free decay from the start on has coefficients along a + i b, where
    the covariance of the response is diag(d) - a a^T + b b^T.
    """
    reach_hz = half_band_hz(frequency_hz, damping_ratio, len(signal) / rate_hz)
    band = band_of(signal[:, None], rate_hz, frequency_hz - reach_hz, frequency_hz + reach_hz)
    y = band.coefficients[:, :, 0]  # of a record in pieces the first one holds the start
    pieces, values = len(y), y.size
    stationary = struck = -np.inf
    for decay_rate in 2.0 * np.pi * frequency_hz * damping_ratio * _DECAYS:
        parts = envelope(band.frequency_hz, frequency_hz, decay_rate, band.duration_s, False)[0]
        met = np.concatenate([parts[1] * y, parts[2] * y])
        others = np.vstack([np.sum(y.real**2 + y.imag**2, axis=0), met.real, met.imag]).T
        _, logarithm, products = woodbury(parts, noise * _RATIOS, others)
        a, b, mixed = products[:, 0], products[:, 1], products[:, 2]
        determinant = (a * b - mixed**2)[:, None]
        by_a, by_b = np.split(products[:, 4 : 4 + 2 * pieces] + 1j * products[:, 4 + 2 * pieces :], 2, axis=1)
        # The inverse of the ends' two by two, times what they meet of the coefficients.
        of_a = (b[:, None] * by_a - mixed[:, None] * by_b) / determinant
        of_b = (a[:, None] * by_b - mixed[:, None] * by_a) / determinant
        square = products[:, 3] - np.sum((by_a.conj() * of_a + by_b.conj() * of_b).real, axis=1)
        explained = np.abs(of_a[:, 0] + 1j * of_b[:, 0]) ** 2 / (-(a + b) / determinant[:, 0])
        left = np.maximum(square - explained, 1e-12 * square)
        stationary = max(stationary, float(np.max(-pieces * logarithm - values * np.log(square))))
        struck = max(struck, float(np.max(-pieces * logarithm - values * np.log(left))))
    return 2.0 * (struck - stationary)


def begin_with_a_blow(gains: Sequence[float]) -> bool:
    """Whether modes with these gains were struck, all together or one of them.

    Without a blow each gains like a chi-square.
    """
    count = len(gains)
    return bool(sum(gains) > chdtri(_FREEDOMS * count, _CHANCE) or max(gains) > chdtri(_FREEDOMS, _CHANCE / count))
