"""How the coordinates of a record are weighed against each other: by their noise, as far as the record can tell it."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dsyevd

from fsw.modal.refinement import Fit

FloatArray = NDArray[np.float64]

# Noise is never finer than rounding of the signals, as a share of them.
ROUNDING = 1e-9
# Correlations of noise below so many of their deviations are taken for chance.
_CHANCE = 2.0
# A direction with less of its noise than this part of what chance leaves the quietest is quiet by something in common.
_QUIET = 0.5


def whitening(fit: Fit, least: float) -> tuple[FloatArray, int]:
    """Inverse root (p, p) of the noise's covariance, of which no coordinate has less than `least`.

    And how many coordinates are coupled with one by their noise, itself included, at most. In a short record most
    correlations are chance, and weights that followed them would cost as much as p further unknowns. So each
    correlation r is shrunk by what it scatters by, (1 - r^2) / sqrt(T): the non-negative garrote (Breiman 1995), entry
    by entry. Where some direction has less noise than chance leaves it (half of the lower edge of Marchenko and Pastur
    1967), the coordinates have something in common, and all correlations stay as they are.
    """
    count, width = fit.residual.shape
    freedom = max(count - len(fit.triangle) - 2 * len(fit.poles) / width, 1.0)
    products = fit.residual.T @ fit.residual / freedom
    deviation = np.sqrt(np.maximum(np.diagonal(products), least))
    seen = products / np.outer(deviation, deviation)
    values, vectors, _ = dsyevd(seen)
    coupled = width
    if values[0] > _QUIET * (1.0 - min(np.sqrt(width / freedom), 1.0)) ** 2:
        squares = seen**2
        scatter = (1.0 - squares) ** 2 / count
        shrunk = np.maximum(1.0 - _CHANCE**2 * scatter / np.maximum(squares, 1e-300), 0.0) * seen
        np.fill_diagonal(shrunk, 1.0)
        values, vectors, _ = dsyevd(shrunk)
        coupled = int(np.max(np.count_nonzero(shrunk, axis=1)))
    root = (vectors / np.sqrt(np.maximum(values, ROUNDING**2))) @ vectors.T
    return root / deviation[:, None], coupled


def weighting_loss(samples: float, coordinates: int) -> float:
    """Factor of a variance that was computed with weights from the same noise: n^2 / ((n - p) (n - p - 1)).

    The inverse of a covariance (p, p) estimated from n samples is too large by n / (n - p - 1) in the mean, and
    estimates weighted with it scatter n / (n - p) more than with the true one. Source: inverse Wishart distribution.
    """
    free = max(samples - coordinates, 2.0)
    return samples**2 / (free * (free - 1.0)) if samples > coordinates + 2.0 else np.inf
