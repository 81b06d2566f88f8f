"""A record that breaks: the piece of it that tells most of its modes.

Nothing is known beforehand here: an autoregressive model of the record itself predicts each sample from the few before
it, whatever the amplitudes are, before and after a break alike. At the break, and there alone, the prediction fails.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.modal.coordinates import Coordinates, even_grid

FloatArray = NDArray[np.float64]

# Loudest coordinates that are predicted, and from how many numbers before: half of them where many samples are missing.
_COORDINATES, _NUMBERS = 4, (64, 32)
# Predictions for each unknown of the model, at least.
_ROWS_OF_AN_UNKNOWN = 3
# Rounds of finding the errors' covariance, each without the largest tenth. It is never finer than rounding of so much.
_ROUNDS, _REGULAR, _ROUNDING = 3, 0.9, 1e-6
# The energy of so many errors in a row is no noise's if noise exceeds it with this chance.
_TOGETHER, _CHANCE = 4, 1e-12
# A motion that is disturbed more often is driven by it: there is nothing to cut.
_MOST_BREAKS = 3


def telling_piece(coordinates: Coordinates) -> tuple[float, float] | None:
    """Begin and end of the piece between breaks that tells most of the modes; None if there is no break.

    In s on the coordinates' time, half a period away from the samples.
    """
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
            break
    else:
        return None
    failed = judged[_unpredicted(grid, judged, lags)]
    breaks = [stretch for stretch in np.split(failed, np.flatnonzero(np.diff(failed) > lags) + 1) if len(stretch)]
    if not 1 <= len(breaks) <= _MOST_BREAKS:
        return None
    # A small break may show some samples late, but no later than it is among those that are looked at together.
    edges = [0, *(edge for stretch in breaks for edge in (stretch[0] - lags - _TOGETHER, stretch[-1] + 1)), len(grid)]
    pieces = [(a, b) for a, b in zip(edges[0::2], edges[1::2], strict=True) if b > a]
    begin, end = max(pieces, key=lambda piece: _telling(grid[slice(*piece)]))
    return (begin - 0.5) / rate_hz, (end - 0.5) / rate_hz


def _telling(signals: FloatArray) -> float:
    """How much a piece (T, p) tells of a frequency: Fisher's information grows with energy and duration squared."""
    return float(np.sum(np.var(signals, axis=0))) * len(signals) ** 3


def _whole_windows(time_s: FloatArray, rate_hz: float, count: int, lags: int) -> NDArray[np.bool_]:
    """Which samples of the even grid, from the lags-th on (count - lags,), were measured together with those before."""
    nearest = np.rint((time_s - time_s[0]) * rate_hz).astype(np.int64)
    measured = np.zeros(count, np.bool_)
    measured[np.clip(nearest, 0, count - 1)] = True
    return np.asarray(np.lib.stride_tricks.sliding_window_view(measured, lags + 1).all(axis=1))


def _unpredicted(signals: FloatArray, judged: NDArray[np.int64], lags: int) -> NDArray[np.bool_]:
    """Which of the samples judged (k,), of signals (T, p), the model fails to predict, together with those before."""
    windows = np.lib.stride_tricks.sliding_window_view(signals, lags, axis=0)[judged - lags]
    now, before = signals[judged], np.hstack([windows.reshape(len(judged), -1), np.ones((len(judged), 1))])
    width = signals.shape[1]
    least = (_ROUNDING**2) * float(np.max(np.var(signals, axis=0))) + 1e-300
    # What the model would have to know finer than rounding it need not know: so the normal equations will do.
    normal = before.T @ before + least * len(now) * np.eye(before.shape[1])
    errors = now - before @ np.linalg.solve(normal, before.T @ now)
    regular = np.ones(len(errors), np.bool_)
    for _ in range(_ROUNDS):
        covariance = errors[regular].T @ errors[regular] / np.count_nonzero(regular) + least * np.eye(width)
        squares = np.sum(errors * np.linalg.solve(covariance, errors.T).T, axis=1)
        regular = squares <= np.partition(squares, last := int(_REGULAR * (len(squares) - 1)))[last]
    unit = float(np.median(squares)) / float(chdtri(width, 0.5))
    energy = np.convolve(squares, np.ones(_TOGETHER))[: len(squares)]
    return energy > unit * float(chdtri(_TOGETHER * width, _CHANCE))
