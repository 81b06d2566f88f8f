"""What a band of one signal tells of the one mode in it: frequency and decay rate with honest deviations, or a line.

With few time constants in a record the likelihood is skew, and its curvature at the top says too little: mean and
standard deviation of the whole posterior are taken instead. Jeffreys' prior of the decay rate is a^-1/2. What is found
too slow by chance is told to be known too well, for the deviation grows with the decay rate: so a decay rate's reaches
at least as far up as its posterior does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.stationary_envelope import log_of_product
from fsw.modal.stationary_likelihood import Group, most_likely
from fsw.modal.stationary_model import Band, Modes, likelihood
from fsw.modal.uncertainty import au_law
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Points over frequency, decay rate and noise; how far they reach in standard deviations.
_FREQUENCIES, _DECAYS, _NOISES = 25, 31, 7
_REACH, _NOISE_REACH = 5.0, 2.0
# Deviations of the logarithms that a grid is made for, of the decay rate and of the noise; a decay rate less well known
# than _VAGUE may be anything down to a line's.
_LEAST_SPREAD, _MOST_SPREAD, _VAGUE, _MOST_NOISE_SPREAD = 0.05, 0.7, 0.3, 1.5
_SLOWEST = 0.03
# Chance of more than so many deviations above the mean, of a normal variable.
_DEVIATIONS_UP, _ABOVE = 2.0, 0.0228
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


def posterior(band: Band, modes: Modes, mode: int, filtered: FloatArray) -> Estimate:
    """Posterior of one of the most likely modes; filtered (q,): weights of the signals that let it alone pass."""
    own = Band(band.frequency_hz, np.ascontiguousarray(band.coefficients @ filtered[:, None]), band.duration_s)
    f, a, v = (values[mode : mode + 1].copy() for values in modes[:3])
    alone = Modes(f, a, v, np.ones((1, 1)), modes.noise * float(filtered @ filtered))
    f, decay, ratio = _grid(own, alone)
    likelihood = _on_grid(own, f, decay, ratio)
    top = float(np.max(likelihood))
    # The grid is even in ln a: a density a^-1/2 weighs as a^1/2.
    weight = np.sum(np.exp(likelihood - top), axis=2) * decay**0.5
    weight /= np.sum(weight)
    f_mean, f_sigma = _moments(f, weight.sum(axis=1))
    a_mean, a_sigma = _decay_rate(decay, weight.sum(axis=0))
    steady, falling = (_wave(own, f_mean, falls) for falls in (_STEADY, _FALLING))
    return Estimate(f_mean, f_sigma, a_mean, a_sigma, 2.0 * (top - steady), 2.0 * (top - max(steady, falling)))


def decay_rate_of(band: Band, start: Modes) -> tuple[float, float]:
    """Decay rate in 1/s and its deviation, of the one mode in a band of one signal that holds many of its widths.

    The frequency tells nothing of it there: it is held where it is most likely, and counts by its deviation, which
    grows as a^1/2.
    """
    alone = most_likely(band, start).modes
    _, decay, ratio = _grid(band, alone)
    likelihood = _on_grid(band, alone.frequency_hz, decay, ratio)[0]
    weight = np.sum(np.exp(likelihood - np.max(likelihood)), axis=1) * decay
    return _decay_rate(decay, weight / np.sum(weight))


def _decay_rate(decay: FloatArray, weight: FloatArray) -> tuple[float, float]:
    mean, sigma = _moments(decay, weight)
    return mean, max(sigma, (_upper_end(decay, weight) - mean) / _DEVIATIONS_UP)


def _moments(values: FloatArray, weight: FloatArray) -> tuple[float, float]:
    mean = float(values @ weight)
    return mean, float(np.sqrt((values - mean) ** 2 @ weight))


def _grid(band: Band, alone: Modes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies, decay rates, even in the logarithm, and ratios of noise to the mode's variance."""
    T = band.duration_s
    f, a = float(alone.frequency_hz[0]), float(alone.decay_rate[0])
    sigmas = Group(alone, *likelihood(band, alone, -np.inf)[::2]).sigmas[0]
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
        alone.noise / float(alone.variance[0]) * np.exp(noise_reach * np.linspace(-1.0, 1.0, _NOISES)),
    )


def _upper_end(values: FloatArray, weight: FloatArray) -> float:
    """What a variable known by its logarithm exceeds with the chance _ABOVE."""
    below = np.cumsum(weight) - 0.5 * weight
    return float(np.exp(np.interp(1.0 - _ABOVE, below, np.log(values))))


@kernel
def _wave(band: Band, frequency_hz: float, falls: FloatArray) -> float:
    """Largest log likelihood of a sinusoid near a frequency that falls by about one of these exponents, in white noise.

    Up to the same constant. The coefficients of a sinusoid are along u_k = 1 / (fall + i (w_k - w) T). Of their power S
    it explains at most P; its own share t, for which S - P t makes them most likely, is known in closed form.
    """
    y = band.coefficients[:, :, 0]
    pieces, count = y.shape
    S, most = np.sum(y.real**2 + y.imag**2), 0.0
    reach_hz = 1.0 / band.duration_s
    for _ in range(_ZOOMS):
        best, chosen, centre_hz = -1.0, 0, frequency_hz
        for i in range(len(falls)):
            for j in range(11):
                near_hz = centre_hz + (0.2 * j - 1.0) * reach_hz
                P, length = 0.0, 0.0
                for piece in range(pieces):
                    met, length = 0j, 0.0
                    for k in range(count):
                        off = 2.0 * np.pi * band.duration_s * (band.frequency_hz[k] - near_hz)
                        square = falls[i] ** 2 + off**2
                        met += complex(falls[i], off) * y[piece, k] / square
                        length += 1.0 / square
                    P += met.real**2 + met.imag**2
                if P / length > best:
                    best, chosen, frequency_hz = P / length, i, near_hz
        most, reach_hz = max(most, best), _ZOOM * reach_hz
        falls = falls[chosen] * (falls / falls[len(falls) // 2]) ** _ZOOM
    t = min(max((count * most - S) / (most * (count - 1)), 0.0), 1.0 - 1e-12)
    return pieces * (np.log(1.0 - t) - count * np.log(S - most * t))


@kernel
def _on_grid(band: Band, frequency_hz: FloatArray, decay_rate: FloatArray, ratio: FloatArray) -> FloatArray:
    """Log likelihood (F, D, N) of a band of one signal, up to a constant, at frequencies (F,), decay rates (D,) and
    ratios (N,) of noise to the mode; its scale integrated out.

    The sums are those of woodbury and the parts d, a, b those of envelope, made in place: they are all that costs.
    """
    pieces, count, _ = band.coefficients.shape
    values = np.empty((len(frequency_hz), len(decay_rate), len(ratio)))
    # Under the weights: the ends' products with each other, the power, and the ends' products with each real and
    # imaginary part of the coefficients.
    y, sums = np.empty((2 * pieces, count)), np.zeros((4 + 4 * pieces, count))
    for p in range(pieces):
        for k in range(count):
            value = band.coefficients[p, k, 0]
            y[2 * p, k], y[2 * p + 1, k] = value.real, value.imag
            sums[3, k] += value.real**2 + value.imag**2
    products = np.empty((len(ratio), len(sums)))
    off, weight, d, weights = np.empty(count), np.empty(count), np.empty(count), np.empty((len(ratio), count))
    turn = 2.0 * np.pi * band.duration_s
    for i in range(len(frequency_hz)):
        f = frequency_hz[i]
        for k in range(count):
            off[k], weight[k] = turn * (band.frequency_hz[k] - f), 2.0 * f / (band.frequency_hz[k] + f)
        for j in range(len(decay_rate)):
            decay = decay_rate[j] * band.duration_s
            ends = np.sqrt(2.0 * (1.0 - np.exp(complex(-decay, turn * f))))
            for k in range(count):
                near = weight[k] / (decay**2 + off[k] ** 2)
                d[k] = 2.0 * decay * near * weight[k]
                a, b = near * (ends.real * decay + ends.imag * off[k]), near * (ends.imag * decay - ends.real * off[k])
                sums[0, k], sums[1, k], sums[2, k] = a * a, b * b, a * b
                for p in range(2 * pieces):
                    sums[4 + 2 * p, k], sums[5 + 2 * p, k] = a * y[p, k], b * y[p, k]
            for n in range(len(ratio)):
                for k in range(count):
                    weights[n, k] = 1.0 / (d[k] + ratio[n])
            np.dot(weights, sums.T, products)
            for n in range(len(ratio)):
                aa, bb, ab, square = products[n, 0] - 1.0, products[n, 1] + 1.0, products[n, 2], products[n, 3]
                determinant = ab**2 - aa * bb
                for p in range(2 * pieces):
                    a, b = products[n, 4 + 2 * p], products[n, 5 + 2 * p]
                    square += (a**2 * bb + b**2 * aa - 2.0 * a * b * ab) / determinant
                values[i, j, n] = -pieces * (log_of_product(determinant, d, ratio[n]) + count * np.log(square))
    return values
