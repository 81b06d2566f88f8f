"""A record that breaks: the piece of it that tells most of its modes.

Nothing is known beforehand here: the record predicts itself (`autoregression.py`), whatever the amplitudes are, before
and after a break alike. At the break, and there alone, the prediction fails.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.modal.autoregression import Predicted

FloatArray = NDArray[np.float64]

# Rounds of finding the errors' covariance, each without the largest tenth.
_ROUNDS, _REGULAR = 3, 0.9
# The energy of so many errors in a row is no noise's if noise exceeds it with this chance.
_TOGETHER, _CHANCE = 4, 1e-12
# A motion that is disturbed more often is driven by it: there is nothing to cut.
_MOST_BREAKS = 3


def telling_piece(predicted: Predicted | None) -> tuple[float, float] | None:
    """Begin and end of the piece between breaks that tells most of the modes; None if there is no break, or if no model
    could predict the record.

    In s on the coordinates' time, half a period away from the samples.
    """
    if predicted is None:
        return None
    grid, lags = predicted.grid, predicted.lags
    failed = predicted.judged[_unpredicted(predicted)]
    breaks = [stretch for stretch in np.split(failed, np.flatnonzero(np.diff(failed) > lags) + 1) if len(stretch)]
    if not 1 <= len(breaks) <= _MOST_BREAKS:
        return None
    # A small break may show some samples late, but no later than it is among those that are looked at together.
    edges = [0, *(edge for stretch in breaks for edge in (stretch[0] - lags - _TOGETHER, stretch[-1] + 1)), len(grid)]
    pieces = [(a, b) for a, b in zip(edges[0::2], edges[1::2], strict=True) if b > a]
    begin, end = max(pieces, key=lambda piece: _telling(grid[slice(*piece)]))
    return (begin - 0.5) / predicted.rate_hz, (end - 0.5) / predicted.rate_hz


def _telling(signals: FloatArray) -> float:
    """How much a piece (T, p) tells of a frequency: Fisher's information grows with energy and duration squared."""
    return float(np.sum(np.var(signals, axis=0))) * len(signals) ** 3


def _unpredicted(predicted: Predicted) -> NDArray[np.bool_]:
    """Which of the samples judged (k,) the model fails to predict, together with those before."""
    width = predicted.errors.shape[1]
    regular = np.ones(len(predicted.errors), np.bool_)
    for _ in range(_ROUNDS):
        squares = predicted.squares(regular)
        regular = squares <= np.partition(squares, last := int(_REGULAR * (len(squares) - 1)))[last]
    unit = float(np.median(squares)) / float(chdtri(width, 0.5))
    energy = np.convolve(squares, np.ones(_TOGETHER))[: len(squares)]
    return energy > unit * float(chdtri(_TOGETHER * width, _CHANCE))
