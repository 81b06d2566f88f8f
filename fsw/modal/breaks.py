"""Where a record breaks: the wing was kicked, struck or held, or the cameras moved, and what was before says no more.

Known poles predict a free motion from a short window to the next sample, whatever its amplitudes are. At a break the
prediction fails by far more than it does elsewhere.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsw.modal.channels import Channels

FloatArray = NDArray[np.float64]

WINDOW = 3
"""Samples of a window for each unknown of the motion in it."""
LEAST_ERRORS = 12
"""Predictions that must have been made before one is called wrong."""
FAILED = 10.0
"""An error this many times the median one is no noise: of one normal number that is 6.7 standard deviations."""


def last_break(time_s: FloatArray, y: Channels, poles: Sequence[complex]) -> int:
    """Index of the first sample after the newest break; 0 if there is none.

    time_s (T,) increasing, gaps allowed; y (T, M), NaN = missing; poles in 1/s, one of each conjugate pair, of the
    motion before.
    """
    unknowns = 2 * len(poles) + 1
    length = WINDOW * unknowns
    start = 0
    errors: list[float] = []
    i = length
    while i < len(time_s):
        error = _prediction_error(time_s[i - length : i + 1], y[i - length : i + 1], poles)
        if len(errors) >= LEAST_ERRORS and error > FAILED * float(np.median(errors)):
            start, errors = i, []
            i += length
            continue
        if np.isfinite(error):
            errors.append(error)
        i += 1
    return start


def _prediction_error(time_s: FloatArray, y: Channels, poles: Sequence[complex]) -> float:
    """Rms over the channels of what a window (all rows but the last) predicts wrongly of the last row, in units of
    what noise of unit variance makes of it; NaN if no channel is whole.
    """
    whole = np.isfinite(y).all(axis=0)
    if not whole.any():
        return float("nan")
    since = time_s - time_s[-1]
    waves = [np.exp(s * since) for s in poles]
    X = np.column_stack([np.ones(len(since)), *(part for wave in waves for part in (wave.real, wave.imag))])
    weights = X[-1] @ np.linalg.pinv(X[:-1])
    wrong = y[-1, whole] - weights @ y[:-1, whole]
    return float(np.sqrt(np.mean(wrong**2) / (1.0 + weights @ weights)))
