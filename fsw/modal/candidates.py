"""Candidates for modes: correlations, Hankel matrix, realisation and clusters, octave by octave."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fsw.modal.clustering import LEAST_ORDERS, Candidate, Pole, cluster, stabilisation
from fsw.modal.coordinates import octaves
from fsw.modal.realisation import realise

FloatArray = NDArray[np.float64]
Correlation = Callable[[FloatArray, int], FloatArray]


def subspace_candidates(
    signals: FloatArray, rate_hz: float, correlation: Correlation, block_rows: int, order: int, per_row: int = 4
) -> tuple[list[Candidate], list[Pole]]:
    """Candidates, strongest first, and all poles for the stabilisation diagram.

    signals (T, p) evenly sampled. Each octave is searched at the rate that resolves it, with at most
    block_rows block rows and at least per_row samples for each.
    """
    candidates: list[Candidate] = []
    diagram: list[Pole] = []
    for level in octaves(signals, rate_hz):
        rows = min(block_rows, len(level.signals) // per_row)
        if rows < 3:
            continue
        h = correlation(level.signals, 2 * rows)
        scale = float(np.max(np.abs(h)))
        if scale <= 0.0:
            continue
        system = realise(h / scale, rows, rows, order)
        poles = stabilisation(system, level.rate_hz, rows, level.band_hz)
        candidates += cluster(poles, LEAST_ORDERS)
        diagram += poles
    return sorted(candidates, key=lambda c: -c.pole.singular_value), diagram
