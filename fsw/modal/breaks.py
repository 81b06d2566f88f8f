"""Where a record breaks: the wing was kicked, struck or held, or the cameras moved, and what was before says no more.

Known poles predict a free motion from a short window to the next sample, whatever its amplitudes are. At a break the
prediction fails by far more than it does elsewhere.
"""

from bisect import insort
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsw.modal.channels import Channels, blocks

FloatArray = NDArray[np.float64]

WINDOW = 3
"""Samples of a window for each unknown of the motion in it."""
LEAST_ERRORS = 12
"""Predictions that must have been made before one is called wrong."""
FAILED = 10.0
"""An error this many times the median one is no noise: of one normal number that is 6.7 standard deviations."""
_CHANNELS_AT_ONCE = 128


def last_break(time_s: FloatArray, y: Channels, poles: Sequence[complex]) -> int:
    """Index of the first sample after the newest break; 0 if there is none.

    time_s (T,) increasing, gaps allowed; y (T, M), NaN = missing; poles in 1/s, one of each conjugate pair, of the
    motion before.
    """
    length = WINDOW * (2 * len(poles) + 1)
    predicted = _prediction_errors(time_s, y, poles, length)
    start = 0
    errors: list[float] = []  # in order of size
    i = length
    while i < len(time_s):
        error, count = float(predicted[i - length]), len(errors)
        if count >= LEAST_ERRORS and error > FAILED * 0.5 * (errors[(count - 1) // 2] + errors[count // 2]):
            start, errors = i, []
            i += length
            continue
        if np.isfinite(error):
            insort(errors, error)
        i += 1
    return start


def _prediction_errors(time_s: FloatArray, y: Channels, poles: Sequence[complex], length: int) -> FloatArray:
    """Of each sample after the first length ones: rms over the channels of what the window of as many samples before it
    predicts wrongly, in units of what noise of unit variance makes of it; NaN if no channel is whole.
    """
    count = len(time_s) - length
    if count <= 0:
        return np.zeros(0)
    windows = np.lib.stride_tricks.sliding_window_view(time_s, length + 1)
    since = windows - windows[:, -1:]
    waves = [np.exp(s * since) for s in poles]
    X = np.stack([np.ones(since.shape), *(part for wave in waves for part in (wave.real, wave.imag))], axis=2)
    weights = (X[:, -1:] @ np.linalg.pinv(X[:, :-1]))[:, 0]
    prediction = np.zeros((count, len(time_s)))
    prediction[np.arange(count)[:, None], np.arange(count)[:, None] + np.arange(length)] = weights
    total, channels = np.zeros(count), np.zeros(count)
    for part in blocks(y.shape[1], _CHANNELS_AT_ONCE):
        present = np.isfinite(y[:, part])
        missing = np.cumsum(~present, axis=0)
        before = np.vstack([np.zeros_like(missing[:1]), missing[: count - 1]])
        whole = missing[length:] == before
        there = np.where(present, y[:, part], 0.0)
        wrong = there[length:] - prediction @ there
        total += np.sum(np.where(whole, wrong**2, 0.0), axis=1)
        channels += np.count_nonzero(whole, axis=1)
    channels[channels == 0.0] = np.nan
    return np.sqrt(total / channels / (1.0 + np.sum(weights**2, axis=1)))
