"""How the coordinates of a record are weighed against each other: by their noise, as far as the record can tell it."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.refinement import Fit

FloatArray = NDArray[np.float64]

# Noise is never finer than rounding of the signals, as a share of them.
ROUNDING = 1e-9
# Correlations of noise below so many of their deviations are taken for chance.
_CHANCE = 2.0


def whitening(fit: Fit, least: float) -> tuple[FloatArray, int]:
    """Inverse root (p, p) of the noise's covariance, of which no coordinate has less than `least`.

    And how many coordinates are coupled with one by their noise, itself included, at most. In a short record most
    correlations are chance, and weights that followed them would cost as much as p further unknowns. So each
    correlation r is shrunk by what it scatters by, (1 - r^2) / sqrt(T): small ones vanish, strong ones stay. Source:
    the non-negative garrote (Breiman 1995), entry by entry.
    """
    count, width = fit.residual.shape
    freedom = max(count - len(fit.triangle) - 2 * len(fit.poles) / width, 1.0)
    deviation = np.sqrt(np.maximum(np.sum(fit.residual**2, axis=0) / freedom, least))
    unit = fit.residual / deviation
    seen = unit.T @ unit / freedom
    squares = np.minimum(seen**2, 1.0)
    kept = np.maximum(1.0 - _CHANCE**2 * (1.0 - squares) ** 2 / (count * np.maximum(squares, 1e-300)), 0.0)
    shrunk = kept * seen
    np.fill_diagonal(shrunk, 1.0)
    values, vectors = np.linalg.eigh(shrunk)
    # Shrinking one by one can take what a direction has away; it never had less than this.
    floor = max(float(np.linalg.eigvalsh(seen)[0]), ROUNDING)
    root = (vectors / np.sqrt(np.maximum(values, floor))) @ vectors.T
    return root / deviation[:, None], int(np.max(np.count_nonzero(shrunk, axis=1)))


def weighting_loss(samples: float, coordinates: float) -> float:
    """Factor of a variance that was computed with weights from the same noise: n^2 / ((n - p) (n - p - 1)).

    The inverse of a covariance (p, p) estimated from n samples is too large by n / (n - p - 1) in the mean, and
    estimates weighted with it scatter n / (n - p) more than with the true one. Source: inverse Wishart distribution.
    """
    free = max(samples - coordinates, 2.0)
    return samples**2 / (free * (free - 1.0)) if samples > coordinates + 2.0 else np.inf
