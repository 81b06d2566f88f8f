"""A record told by itself: an autoregressive model predicts each sample from the few before it.

Nothing else is known of the motion. What the model fails to predict is what drives the wing, and noise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.coordinates import Coordinates, even_grid

FloatArray = NDArray[np.float64]

# Loudest coordinates that are predicted, and from how many numbers before: half of them where many samples are missing.
_COORDINATES, _NUMBERS = 4, (64, 32)
# Predictions for each unknown of the model, at least.
_ROWS_OF_AN_UNKNOWN = 3
# The errors' covariance is never finer than rounding of this share of the motion.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Predicted:
    """grid (T, p): the loudest coordinates at rate_hz. judged (k,): samples of it that were measured together with the
    lags before them; errors (k, p): what the model left of these. least: variance of rounding.
    """

    grid: FloatArray
    rate_hz: float
    lags: int
    judged: NDArray[np.int64]
    errors: FloatArray
    least: float

    def squares(self, regular: NDArray[np.bool_] | None = None) -> FloatArray:
        """Squared length (k,) of each error, in units of the covariance of the regular ones (k,), or of all."""
        some = self.errors if regular is None else self.errors[regular]
        covariance = some.T @ some / len(some) + self.least * np.eye(some.shape[1])
        return np.asarray(np.sum(self.errors * np.linalg.solve(covariance, self.errors.T).T, axis=1))


def predict(coordinates: Coordinates) -> Predicted | None:
    """Predict a record's loudest coordinates; None if it is too short, or holds too many gaps, for a model."""
    time_s, rate_hz = coordinates.time_s, coordinates.rate_hz
    width = min(coordinates.signals.shape[1], _COORDINATES)
    if width == 0 or len(time_s) < _ROWS_OF_AN_UNKNOWN * _NUMBERS[-1]:
        return None
    loud = np.argsort(-np.var(coordinates.signals, axis=0), kind="stable")[:width]
    grid = even_grid(time_s, coordinates.signals[:, np.sort(loud)], rate_hz)
    for numbers in _NUMBERS:
        lags = numbers // width
        judged = lags + np.flatnonzero(_whole_windows(time_s, rate_hz, len(grid), lags))
        if len(judged) > _ROWS_OF_AN_UNKNOWN * numbers:
            return Predicted(grid, rate_hz, lags, judged, *_errors(grid, judged, lags))
    return None


def _whole_windows(time_s: FloatArray, rate_hz: float, count: int, lags: int) -> NDArray[np.bool_]:
    """Which samples of the even grid, from the lags-th on (count - lags,), were measured together with those before."""
    nearest = np.rint((time_s - time_s[0]) * rate_hz).astype(np.int64)
    measured = np.zeros(count, np.bool_)
    measured[np.clip(nearest, 0, count - 1)] = True
    return np.asarray(np.lib.stride_tricks.sliding_window_view(measured, lags + 1).all(axis=1))


def _errors(signals: FloatArray, judged: NDArray[np.int64], lags: int) -> tuple[FloatArray, float]:
    """What a model fitted to the samples judged (k,) of signals (T, p) leaves of them (k, p); variance of rounding."""
    windows = np.lib.stride_tricks.sliding_window_view(signals, lags, axis=0)[judged - lags]
    now, before = signals[judged], np.hstack([windows.reshape(len(judged), -1), np.ones((len(judged), 1))])
    least = (_ROUNDING**2) * float(np.max(np.var(signals, axis=0))) + 1e-300
    # What the model would have to know finer than rounding it need not know: so the normal equations will do.
    normal = before.T @ before + least * len(now) * np.eye(before.shape[1])
    return now - before @ np.linalg.solve(normal, before.T @ now), least
