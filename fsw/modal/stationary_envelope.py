"""The covariance of one mode's Fourier coefficients over a record of finite length, and what its inverse is made of."""

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]


@kernel
def envelope(
    band_hz: FloatArray, frequency_hz: float, decay_rate: float, duration_s: float, slopes: bool
) -> FloatArray:
    """d, a, b (1, 3, K) of the covariance diag(d) - a a^T + b b^T of a mode's Fourier coefficients at band_hz (K,).

    With slopes (3, 3, K): these, and their slopes by frequency and by ln decay rate. With p_k = (decay_rate +
    i (w_k - w)) T and c = exp((i w - decay_rate) T), the double integral of exp(-decay_rate |t - s|) over the record is
    diag(2 Re 1 / p) - 2 Re((1 - c) (1 / p) (1 / p)^T). That is a unit envelope's. A displacement driven by white force
    has the pole at -w as well: its coefficients are 2 w / (w_k + w) times as large, steeper above the peak than below.
    """
    count = len(band_hz)
    parts = np.empty((3 if slopes else 1, 3, count))
    turn, decay = 2.0 * np.pi * duration_s, decay_rate * duration_s
    c = np.exp(complex(-decay, turn * frequency_hz))
    ends = np.sqrt(2.0 * (1.0 - c))
    for k in range(count):
        off = turn * (band_hz[k] - frequency_hz)
        weight, square = 2.0 * frequency_hz / (band_hz[k] + frequency_hz), decay**2 + off**2
        parts[0, 0, k] = 2.0 * decay / square * weight**2
        parts[0, 1, k] = weight * (ends.real * decay + ends.imag * off) / square
        parts[0, 2, k] = weight * (ends.imag * decay - ends.real * off) / square
    if not slopes:
        return parts
    by_frequency, by_decay = -1j * turn * c / ends, decay * c / ends
    for k in range(count):
        off, far = turn * (band_hz[k] - frequency_hz), band_hz[k] + frequency_hz
        weight, slope = 2.0 * frequency_hz / far, band_hz[k] / (frequency_hz * far)
        square = decay**2 + off**2
        d, e, one = parts[0, 0, k], complex(parts[0, 1, k], parts[0, 2, k]), complex(decay / square, -off / square)
        f = weight * by_frequency * one + (1j * turn * one + slope) * e
        g = (weight * by_decay - decay * e) * one
        parts[1, 0, k], parts[1, 1, k], parts[1, 2, k] = 2.0 * d * (turn * off / square + slope), f.real, f.imag
        parts[2, 0, k], parts[2, 1, k], parts[2, 2, k] = d * (1.0 - 2.0 * decay**2 / square), g.real, g.imag
    return parts


@kernel
def woodbury(parts: FloatArray, noise: FloatArray, others: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What inverts diag(d + noise) - a a^T + b b^T, for parts d, a, b (3, K) and several noises (n,).

    Returns weights 1 / (d + noise) (n, K), the logarithm (n,) of the covariance's determinant, and products (n, 3 + o)
    under the weights: a^T a - 1, b^T b + 1, a^T b, then the sums of others (K, o). Source: Woodbury's identity.
    """
    d, a, b = parts
    count = len(d)
    weights, features = np.empty((len(noise), count)), np.empty((count, 3 + others.shape[1]))
    for k in range(count):
        features[k, 0], features[k, 1], features[k, 2] = a[k] * a[k], b[k] * b[k], a[k] * b[k]
        for o in range(others.shape[1]):
            features[k, 3 + o] = others[k, o]
    for n in range(len(noise)):
        for k in range(count):
            weights[n, k] = 1.0 / (d[k] + noise[n])
    products = weights @ features
    logarithm = np.empty(len(noise))
    for n in range(len(noise)):
        products[n, 0] -= 1.0
        products[n, 1] += 1.0
        logarithm[n] = log_of_product(products[n, 2] ** 2 - products[n, 0] * products[n, 1], d, noise[n])
    return weights, logarithm, products


@kernel
def log_of_product(product: float, d: FloatArray, noise: float) -> float:
    """Logarithm of a product with all d + noise (K,)."""
    logarithm, eights = 0.0, len(d) - len(d) % 8
    for k in range(0, eights, 8):  # one after the other they would wait for each other
        first = ((d[k] + noise) * (d[k + 1] + noise)) * ((d[k + 2] + noise) * (d[k + 3] + noise))
        second = ((d[k + 4] + noise) * (d[k + 5] + noise)) * ((d[k + 6] + noise) * (d[k + 7] + noise))
        product *= first * second
        if product < 1e-150 or product > 1e150:  # a logarithm costs more than all the rest
            logarithm += np.log(product)
            product = 1.0
    for k in range(eights, len(d)):
        product *= d[k] + noise
    return logarithm + np.log(product)
