"""What a band of one signal tells of the one mode in it: frequency and decay rate with honest deviations, or a line.

With few time constants in a record the likelihood is skew, and its curvature at the top says too little: mean and
standard deviation of the whole posterior are taken instead. Jeffreys' prior of the decay rate is a^-1/2.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.stationary_likelihood import Band, Group, scored
from fsw.modal.stationary_model import envelope
from fsw.modal.uncertainty import au_law
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Points over frequency, decay rate and noise; how far they reach in standard deviations.
_FREQUENCIES, _DECAYS, _NOISES = 25, 31, 7
_REACH, _NOISE_REACH = 5.0, 2.0
# Deviations of the logarithms that a grid is made for, of the decay rate and of the noise; a decay rate less well known
# than _VAGUE may be anything down to a line's.
_LEAST_SPREAD, _MOST_SPREAD, _VAGUE, _MOST_NOISE_SPREAD = 0.05, 0.7, 0.3, 1.5
_SLOWEST = 0.03
# Exponents by which a sinusoid that is steady, and one that is not, fall over the record; zooms on them and on its
# frequency.
_STEADY, _FALLING = np.array([1e-3]), np.geomspace(0.25, 32.0, 7)
_ZOOMS, _ZOOM = 6, 0.3


@dataclass(frozen=True)
class Estimate:
    """Frequency in Hz and decay rate in 1/s with deviations.

    line_gain: 2 ln of the likelihood over a steady line's; fall_gain: over that of any sinusoid that falls.
    """

    frequency_hz: float
    frequency_sigma_hz: float
    decay_rate: float
    decay_rate_sigma: float
    line_gain: float
    fall_gain: float


def posterior(band: Band, group: Group, mode: int, filtered: FloatArray) -> Estimate:
    """Posterior of one mode of the most likely group; filtered (q,): weights of the signals that let it alone pass."""
    own = Band(band.frequency_hz, band.coefficients @ filtered[:, None], band.duration_s)
    one = slice(mode, mode + 1)
    noise = group.noise * float(filtered @ filtered)
    alone = scored(own, group.frequency_hz[one], group.decay_rate[one], group.variance[one], np.ones((1, 1)), noise)
    f, decay, ratio = _grid(own, alone)
    likelihood = _likelihood(own, f, decay, ratio)
    top = float(np.max(likelihood))
    # The grid is even in ln a: a density a^-1/2 weighs as a^1/2.
    weight = np.sum(np.exp(likelihood - top), axis=2) * decay**0.5
    weight /= np.sum(weight)
    f_mean, f_sigma = _moments(f, weight.sum(axis=1))
    a_mean, a_sigma = _moments(decay, weight.sum(axis=0))
    steady, falling = (_wave(own, f_mean, falls) for falls in (_STEADY, _FALLING))
    return Estimate(f_mean, f_sigma, a_mean, a_sigma, 2.0 * (top - steady), 2.0 * (top - max(steady, falling)))


def _moments(values: FloatArray, weight: FloatArray) -> tuple[float, float]:
    mean = float(values @ weight)
    return mean, float(np.sqrt((values - mean) ** 2 @ weight))


def _grid(band: Band, mode: Group) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies, decay rates, even in the logarithm, and ratios of noise to the mode's variance."""
    T = band.duration_s
    f, a = float(mode.frequency_hz[0]), float(mode.decay_rate[0])
    sigmas = mode.sigmas[0]
    # The curvature may be less than the uncertainty law allows, where the noise has taken the peak's flanks.
    law_f, law_damping = au_law(f, a / (2.0 * np.pi * f), T * len(band.coefficients))
    f_sigma = max(float(sigmas[0]), law_f * f, 0.1 / T)
    spread = max(float(sigmas[1]), law_damping)
    reach = _REACH * float(np.clip(spread, _LEAST_SPREAD, _MOST_SPREAD))
    slowest = np.log(a) - reach if spread < _VAGUE else min(np.log(a) - reach, np.log(_SLOWEST / T))
    noise_reach = _NOISE_REACH * min(float(np.hypot(sigmas[1], sigmas[2])), _MOST_NOISE_SPREAD)
    return (
        f + f_sigma * np.linspace(-_REACH, _REACH, _FREQUENCIES),
        np.exp(np.linspace(slowest, np.log(a) + reach, _DECAYS)),
        mode.noise / float(mode.variance[0]) * np.exp(noise_reach * np.linspace(-1.0, 1.0, _NOISES)),
    )


def _wave(band: Band, frequency_hz: float, falls: FloatArray) -> float:
    """Largest log likelihood of a sinusoid near a frequency that falls by about one of these exponents, in white noise.

    Up to the same constant. The coefficients of a sinusoid are along u_k = 1 / (fall + i (w_k - w) T). Of their power S
    it explains at most P; its own share t, for which S - P t makes them most likely, is known in closed form.
    """
    y, count = band.coefficients[:, :, 0], len(band.frequency_hz)
    S = float(np.sum(np.abs(y) ** 2))
    reach_hz, most = 1.0 / band.duration_s, 0.0
    for _ in range(_ZOOMS):
        near_hz = frequency_hz + reach_hz * np.linspace(-1.0, 1.0, 11)
        u = 1.0 / (falls[:, None, None] + 2j * np.pi * band.duration_s * (band.frequency_hz - near_hz[:, None]))
        P = np.sum(np.abs(u.conj() @ y.T) ** 2, axis=2) / np.sum(np.abs(u) ** 2, axis=2)
        i, j = np.unravel_index(np.argmax(P), P.shape)
        most = max(most, float(P[i, j]))
        frequency_hz, reach_hz = float(near_hz[j]), _ZOOM * reach_hz
        falls = falls[i] * (falls / falls[len(falls) // 2]) ** _ZOOM
    t = min(max((count * most - S) / (most * (count - 1)), 0.0), 1.0 - 1e-12)
    return len(y) * float(np.log(1.0 - t) - count * np.log(S - most * t))


def _likelihood(band: Band, frequency_hz: FloatArray, decay_rate: FloatArray, ratio: FloatArray) -> FloatArray:
    """Log likelihood (F, D, N) of a band of one signal, up to a constant, at frequencies (F,), decay rates (D,) and
    ratios (N,) of noise to the mode; its scale integrated out.
    """
    y = np.ascontiguousarray(band.coefficients[:, :, 0])
    return _on_grid(np.ascontiguousarray(band.frequency_hz), y, band.duration_s, frequency_hz, decay_rate, ratio)


@kernel
def _on_grid(
    band_hz: FloatArray,
    y: ComplexArray,
    duration_s: float,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    ratio: FloatArray,
) -> FloatArray:
    """The same of coefficients y (n, K) at band_hz (K,), by Woodbury's identity for the two ranks - a a^T + b b^T."""
    pieces, count = y.shape
    power = np.zeros(count)
    for piece in range(pieces):
        for k in range(count):
            power[k] += y[piece, k].real ** 2 + y[piece, k].imag ** 2
    values = np.empty((len(frequency_hz), len(decay_rate), len(ratio)))
    weight = np.empty(count)
    for i in range(len(frequency_hz)):
        for j in range(len(decay_rate)):
            d, a, b = envelope(band_hz, frequency_hz[i], decay_rate[j], duration_s, False)[0]
            for n in range(len(ratio)):
                aa, bb, ab, square = -1.0, 1.0, 0.0, 0.0
                logarithm, product = 0.0, 1.0
                for k in range(count):
                    w = 1.0 / (d[k] + ratio[n])
                    weight[k] = w
                    square += power[k] * w
                    aa += a[k] * a[k] * w
                    bb += b[k] * b[k] * w
                    ab += a[k] * b[k] * w
                    product *= w
                    if product < 1e-150 or product > 1e150:  # a logarithm costs more than all the rest
                        logarithm += np.log(product)
                        product = 1.0
                logarithm += np.log(product)
                determinant = aa * bb - ab * ab
                for piece in range(pieces):
                    ar, ai, br, bi = 0.0, 0.0, 0.0, 0.0
                    for k in range(count):
                        real, imaginary = weight[k] * y[piece, k].real, weight[k] * y[piece, k].imag
                        ar += a[k] * real
                        ai += a[k] * imaginary
                        br += b[k] * real
                        bi += b[k] * imaginary
                    cross = (ar**2 + ai**2) * bb + (br**2 + bi**2) * aa - 2.0 * (ar * br + ai * bi) * ab
                    square -= cross / determinant
                values[i, j, n] = -pieces * (np.log(-determinant) - logarithm) - pieces * count * np.log(square)
    return values
