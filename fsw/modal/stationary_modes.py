"""Modes of a stationary response to unknown noise: subspace poles, refined by likelihood and weighed."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsw.modal.ambient import Peak, weigh_peak
from fsw.modal.candidates import Correlation, subspace_candidates
from fsw.modal.clustering import Candidate, Pole
from fsw.modal.coordinates import Coordinates, even_grid
from fsw.modal.gates import ambient_flags, common_flags
from fsw.modal.indicators import shape_assurance
from fsw.modal.result import Mode, Options, normalised
from fsw.modal.small_matrices import pseudo_inverse
from fsw.modal.stationary_drift import CHANGES, drift_profile, moves
from fsw.modal.stationary_flanks import with_flanks
from fsw.modal.stationary_groups import VERY_SHAPE, Refined, real_shape, refined
from fsw.modal.stationary_peaks import overlooked, seen
from fsw.modal.stationary_start import begin_with_a_blow, start_gain

FloatArray = NDArray[np.float64]

# Coordinates kept: random response needs averaging more than many channels.
_COORDINATES = 6
# Block rows: long lags tell near peaks apart, but are badly known in a short record; and the matrix stays
# this small.
_ROWS_OF_SAMPLES, _MOST_ROWS, _HANKEL_SIZE = 16, 60, 240
# Candidates of one shape nearer than a hundredth of their frequency are one mode found twice.
_SAME_SHAPE = 0.8
# Damping that a candidate may have; what grows a little may be a line.
_DAMPING = (-0.02, 0.15)
# What is found to be damped more is no vibration, and its frequency |s| / 2 pi may lie beyond the spectrum.
_NO_VIBRATION = 0.3
# Neighbours of a mode within this share of its frequency are kept out of its signal by their shapes.
_NEIGHBOUR = 0.2
# Beside a mode, poles with less than this share of its singular value are its fragments even farther off. To keep them
# out would but amplify the noise, for their shapes are like its own.
_FRAGMENT = 0.15


def identify_ambient(
    coordinates: Coordinates, correlation: Correlation, options: Options
) -> tuple[list[Mode], list[Pole]]:
    """Modes of a stationary response, and poles for the stabilisation diagram."""
    rate_hz = coordinates.rate_hz
    signals = even_grid(coordinates.time_s, coordinates.signals, rate_hz)
    signals = signals - signals.mean(axis=0)
    _, V = np.linalg.eigh(signals.T @ signals)
    V = V[:, ::-1][:, : min(_COORDINATES, options.coordinates)]
    signals, basis = signals @ V, coordinates.basis @ V
    rows = int(np.clip(_HANKEL_SIZE // signals.shape[1], options.block_rows, _MOST_ROWS))
    found, diagram = subspace_candidates(signals, rate_hz, correlation, rows, options.order, _ROWS_OF_SAMPLES)
    duration_s = len(signals) / rate_hz
    found = [c for c in found if c.frequency_hz * duration_s > 2.0 and _DAMPING[0] < c.damping_ratio < _DAMPING[1]]
    found = _without_doubles(found, duration_s)
    spectrum = np.fft.rfft(np.ascontiguousarray(signals.T)).T
    poles = seen(diagram, signals.shape[1])
    found += overlooked(found, poles, signals, spectrum, rate_hz)
    entries = [e for e in refined(found, signals, spectrum, rate_hz) if e.candidate.damping_ratio < _NO_VIBRATION]
    found = [entry.candidate for entry in entries]
    modes, profiles, gains = [], [], []
    for entry in entries:
        candidate = entry.candidate
        series = signals @ modal_filter(candidate, found)
        peak = weigh_peak(series, rate_hz, candidate.frequency_hz, candidate.damping_ratio)
        if peak is not None and peak.gain > 0.0:
            entry = with_flanks(entry, peak, series, rate_hz, found)
            split = entry.piece or _overlaps(candidate, found, duration_s)
            orders = max(candidate.count, poles.orders_under(candidate, duration_s))
            modes.append(_mode(entry, peak, orders, split, basis, coordinates, duration_s, options))
            noise = 2.0 * peak.floor / (peak.variance * duration_s)
            told = series, rate_hz, candidate.frequency_hz, candidate.damping_ratio, noise
            # A weak mode tells nothing of a drift.
            profiles.append(np.zeros(len(CHANGES)) if "weak" in modes[-1].flags else drift_profile(*told))
            if modes[-1].valid:
                gains.append(start_gain(*told))
    if gains and begin_with_a_blow(gains):
        modes = [mode.flagged("not_exponential") if mode.valid else mode for mode in modes]
    modes = _drift_flagged(modes, profiles)
    return sorted(modes, key=lambda mode: -mode.amplitude)[: options.most_modes], diagram


def _drift_flagged(modes: list[Mode], profiles: list[FloatArray]) -> list[Mode]:
    """The same modes; those that move are flagged: each by itself, or all if the valid ones move together."""
    valid = [profile for mode, profile in zip(modes, profiles, strict=True) if mode.valid]
    together = bool(valid) and moves(valid)
    return [
        replace(mode.flagged("time_varying"), damping_ratio=np.nan, damping_ratio_sigma=np.nan)
        if together or moves([profile])
        else mode
        for mode, profile in zip(modes, profiles, strict=True)
    ]


def _same_shape(a: Candidate, b: Candidate) -> bool:
    return shape_assurance(a.pole.shape, b.pole.shape) > _SAME_SHAPE


def _without_doubles(found: list[Candidate], duration_s: float) -> list[Candidate]:
    """One candidate for each mode: of two near each other with one shape, the one seen in more orders."""
    kept: list[Candidate] = []
    for candidate in sorted(found, key=lambda c: (-c.count, -c.pole.singular_value)):
        f = candidate.frequency_hz
        if not any(
            abs(f - other.frequency_hz) < max(0.01 * f, 2.0 / duration_s) and _same_shape(candidate, other)
            for other in kept
        ):
            kept.append(candidate)
    return sorted(kept, key=lambda c: -c.pole.singular_value)


def modal_filter(candidate: Candidate, found: list[Candidate]) -> FloatArray:
    """Weights (p,) that pass one mode's real shape and stop those of its neighbours in frequency.

    A neighbour of the same shape cannot be stopped: it may take nothing of the mode's own.
    """
    near = [
        c
        for c in found
        if c is not candidate
        and abs(c.frequency_hz - candidate.frequency_hz) < _NEIGHBOUR * candidate.frequency_hz
        and c.pole.singular_value > _FRAGMENT * candidate.pole.singular_value
    ]
    shapes = np.stack([real_shape(c.pole.shape) for c in [candidate, *near]], axis=1)
    weights = pseudo_inverse(shapes, 0.05)[0]
    return weights / float(weights @ shapes[:, 0])


def _overlaps(candidate: Candidate, found: list[Candidate], duration_s: float) -> bool:
    """Whether a candidate is a piece of another of its shape near it, which was seen in more orders or is stronger."""
    for other in found:
        apart_hz = abs(other.frequency_hz - candidate.frequency_hz)
        width_hz = other.damping_ratio * other.frequency_hz + candidate.damping_ratio * candidate.frequency_hz
        strength, stronger = candidate.pole.singular_value, other.pole.singular_value
        before = (other.count, stronger) > (candidate.count, strength)
        alike = shape_assurance(other.pole.shape, candidate.pole.shape) > VERY_SHAPE
        near = apart_hz < width_hz + 3.0 / duration_s
        near |= strength < _FRAGMENT * stronger and apart_hz < 3.0 * (width_hz + 1.0 / duration_s)
        if other is not candidate and before and alike and near:
            return True
    return False


def _mode(
    entry: Refined,
    peak: Peak,
    orders: int,
    split: bool,
    basis: FloatArray,
    coordinates: Coordinates,
    duration_s: float,
    options: Options,
) -> Mode:
    candidate = entry.candidate
    pole, f, zeta = candidate.pole, candidate.frequency_hz, candidate.damping_ratio
    flags = common_flags(f, entry.frequency_sigma_hz, zeta, pole.coherence, coordinates.rate_hz, duration_s)
    flags += ambient_flags(zeta, entry.damping_sigma, peak, entry.line_gain, entry.fall_gain, orders)
    if split:
        flags.append("split")
    shape = (basis @ real_shape(pole.shape)).astype(np.complex128)
    amplitude = float(np.sqrt(2.0 * peak.variance) * np.max(np.abs(shape)))
    if amplitude < options.minimum_amplitude:
        flags.append("weak")
    return Mode(
        frequency_hz=f,
        frequency_sigma_hz=entry.frequency_sigma_hz,
        damping_ratio=zeta,
        damping_ratio_sigma=entry.damping_sigma,
        amplitude=amplitude,
        amplitude_coherence=pole.coherence,
        singular_value=pole.singular_value,
        shape=normalised(shape, coordinates.live),
        valid=not flags,
        flags=sorted(set(flags)),
    )
