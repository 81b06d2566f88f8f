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
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

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
    decay_rate = 2.0 * np.pi * frequency_hz * damping_ratio * _DECAYS
    return _gain(band.frequency_hz, np.ascontiguousarray(y), frequency_hz, decay_rate, noise * _RATIOS, band.duration_s)


@kernel
def _gain(
    band_hz: FloatArray,
    y: ComplexArray,
    frequency_hz: float,
    decay_rates: FloatArray,
    ratios: FloatArray,
    duration_s: float,
) -> float:
    """The same of coefficients y (pieces, K), over decay rates (D,) and ratios (N,) of noise to the mode."""
    pieces, count = y.shape
    stationary = struck = -np.inf
    others = np.empty((count, 1 + 4 * pieces))
    for decay_rate in decay_rates:
        parts = envelope(band_hz, frequency_hz, decay_rate, duration_s, False)[0]
        for k in range(count):
            others[k, 0] = 0.0
            for p in range(pieces):
                real, imag = y[p, k].real, y[p, k].imag
                others[k, 0] += real**2 + imag**2
                others[k, 1 + 4 * p], others[k, 2 + 4 * p] = parts[1, k] * real, parts[1, k] * imag
                others[k, 3 + 4 * p], others[k, 4 + 4 * p] = parts[2, k] * real, parts[2, k] * imag
        _, logarithm, products = woodbury(parts, ratios, others)
        for n in range(len(ratios)):
            a, b, mixed, square = products[n, :4]
            determinant, explained = a * b - mixed**2, 0.0
            for p in range(pieces):
                by_a = complex(products[n, 4 + 4 * p], products[n, 5 + 4 * p])
                by_b = complex(products[n, 6 + 4 * p], products[n, 7 + 4 * p])
                # The inverse of the ends' two by two, times what they meet of the coefficients.
                of_a, of_b = (b * by_a - mixed * by_b) / determinant, (a * by_b - mixed * by_a) / determinant
                square -= (by_a.conjugate() * of_a + by_b.conjugate() * of_b).real
                if p == 0:
                    explained = -(abs(of_a + 1j * of_b) ** 2) * determinant / (a + b)
            left = max(square - explained, 1e-12 * square)
            stationary = max(stationary, -pieces * (logarithm[n] + count * np.log(square)))
            struck = max(struck, -pieces * (logarithm[n] + count * np.log(left)))
    return 2.0 * (struck - stationary)


def begin_with_a_blow(gains: Sequence[float]) -> bool:
    """Whether modes with these gains were struck, all together or one of them.

    Without a blow each gains like a chi-square.
    """
    count = len(gains)
    return bool(sum(gains) > chdtri(_FREEDOMS * count, _CHANCE) or max(gains) > chdtri(_FREEDOMS, _CHANCE / count))
