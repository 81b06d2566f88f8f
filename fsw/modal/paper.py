"""The paper's own identification, and the two methods that it joins, each alone (section 5, Eq. 31-41).

RDT + ERA/DC: random decrement signatures, products of them, realisation. SSI-DATA: projection of the future of the data
on its past. Their fusion: correlations, one Hankel matrix, CVA weights or none, realisation, amplitude coherence and
modal singular value. What tells its intervals is the scatter over orders alone: no likelihood, no refinement.
"""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.clustering import LEAST_ORDERS, Candidate, Pole, cluster, stabilisation
from fsw.modal.coordinates import Coordinates, even_grid
from fsw.modal.correlation import fixed_window, random_decrement, spectral
from fsw.modal.gates import common_flags
from fsw.modal.realisation import Realisation, block_hankel, frequency_and_damping, realise, weighted_realisation
from fsw.modal.result import Mode, Options, normalised

FloatArray = NDArray[np.float64]

# Samples that each block row needs.
_SAMPLES_OF_A_ROW = 4


def identify_as_paper(coordinates: Coordinates, options: Options) -> tuple[list[Mode], list[Pole]]:
    """Modes, and poles for the stabilisation diagram, by the method that the options name."""
    rate_hz = coordinates.rate_hz
    signals = even_grid(coordinates.time_s, coordinates.signals, rate_hz)
    signals = signals - signals.mean(axis=0)
    rows = min(options.block_rows, len(signals) // (2 * _SAMPLES_OF_A_ROW))
    if rows < 3:
        return [], []
    if options.method == "rdt_era_dc":
        signature = random_decrement(signals, 4 * rows)
        system = realise(fixed_window(signature, 2 * rows), rows, rows, options.order)
    elif options.method == "ssi_data":
        system = subspace_of_data(signals, rows, options.order, options.weighting == "cva")
    else:
        correlation = fixed_window if options.correlation == "fixed_window" else spectral
        system = fused(signals, correlation(signals, 2 * rows), rows, options)
    poles = stabilisation(system, rate_hz, rows, (0.0, 0.5 * rate_hz))
    found = cluster(poles, LEAST_ORDERS)[: options.most_modes]
    return [_mode(candidate, coordinates) for candidate in found], poles


def fused(signals: FloatArray, h: FloatArray, rows: int, options: Options) -> Realisation:
    """Realisation of correlations h (K, p, p), lags 1 to K, with CVA weights or none. Source: Eq. 33-36."""
    if options.weighting == "none":
        return realise(h, rows, rows, options.order)
    count = len(signals)
    # The weights take the biased correlations: their covariance matrix has no negative eigenvalue.
    shrink = (1.0 - np.arange(1, rows) / count)[:, None, None]
    lags = np.concatenate([(signals.T @ signals / count)[None], shrink * spectral(signals, rows - 1)])
    root = _inverse_root(_toeplitz(lags, rows))
    # The past runs back in time: its covariance is the transpose of the future's, block by block.
    back = _inverse_root(_toeplitz(lags.transpose(0, 2, 1), rows))
    return weighted_realisation(h, rows, rows, options.order, root, back)


def subspace_of_data(signals: FloatArray, rows: int, order: int, cva: bool) -> Realisation:
    """Realisation by projection of the future outputs on the past (SSI-DATA), weighted by CVA or not.

    signals (T, p). Source: van Overschee and De Moor, 1996; Eq. 38.
    """
    p = signals.shape[1]
    columns = len(signals) - 2 * rows + 1
    data = np.concatenate([signals[k : k + columns].T for k in range(2 * rows)]) / np.sqrt(columns)
    L = np.asarray(np.linalg.qr(data.T, mode="r"), np.float64).T
    past = rows * p
    projection, innovation = L[past:, :past], L[past:]
    root = _inverse_root(innovation @ innovation.T) if cva else np.eye(past)
    U, s, _ = np.linalg.svd(root @ projection)
    n = min(order, int(np.count_nonzero(s > 1e-13 * s[0])))
    observability = np.linalg.solve(root, U[:, :n] * np.sqrt(s[:n]))
    A = np.linalg.lstsq(observability[:-p], observability[p:], rcond=None)[0]
    # Correlations through the same states give the participation that the projection alone does not.
    h = spectral(signals, 2 * rows)
    controllability = np.linalg.lstsq(observability, block_hankel(h, rows, rows), rcond=None)[0]
    return Realisation(*map(np.asarray, (A, controllability[:, :p], observability[:p], controllability)))


def _toeplitz(lags: FloatArray, rows: int) -> FloatArray:
    """Block covariance (rows p, rows p) of a stationary series from its correlations at lags 0, 1, ..."""
    p = lags.shape[1]
    matrix = np.empty((rows * p, rows * p))
    for i in range(rows):
        for j in range(rows):
            block = lags[i - j] if i >= j else lags[j - i].T
            matrix[i * p : (i + 1) * p, j * p : (j + 1) * p] = block
    return 0.5 * (matrix + matrix.T)


def _inverse_root(matrix: FloatArray) -> FloatArray:
    """Symmetric inverse root of a covariance, bounded where it has no power."""
    values, vectors = np.linalg.eigh(matrix)
    return (vectors / np.sqrt(np.maximum(values, 1e-10 * float(values[-1]) + 1e-300))) @ vectors.T


def _mode(candidate: Candidate, coordinates: Coordinates) -> Mode:
    pole, f = candidate.pole, candidate.frequency_hz
    duration_s = float(coordinates.time_s[-1])
    hz, damping = frequency_and_damping(np.array([member.s for member in candidate.members]))
    scatter_hz = float(hz.std())
    flags = common_flags(f, scatter_hz, candidate.damping_ratio, pole.coherence, coordinates.rate_hz, duration_s)
    return Mode(
        frequency_hz=f,
        frequency_sigma_hz=scatter_hz,
        damping_ratio=candidate.damping_ratio,
        damping_ratio_sigma=float(damping.std()),
        amplitude=float("nan"),
        amplitude_coherence=pole.coherence,
        singular_value=pole.singular_value,
        shape=normalised(coordinates.basis @ pole.shape, coordinates.live),
        valid=not flags,
        flags=sorted(set(flags)),
    )
