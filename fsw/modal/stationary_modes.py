"""Modes of a stationary response to unknown noise: clusters of subspace poles, weighed against the periodogram."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.ambient import Peak, weigh_peak
from fsw.modal.candidates import Correlation, subspace_candidates
from fsw.modal.clustering import Candidate, Pole
from fsw.modal.coordinates import Coordinates, even_grid
from fsw.modal.gates import ambient_flags, common_flags
from fsw.modal.indicators import shape_assurance
from fsw.modal.result import Mode, Options, normalised
from fsw.modal.uncertainty import au_law

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Coordinates kept: random response needs averaging more than many channels.
_COORDINATES = 6
# Block rows: long lags tell near peaks apart, but are badly known in a short record; and the matrix stays
# this small.
_ROWS_OF_SAMPLES, _MOST_ROWS, _HANKEL_SIZE = 16, 60, 240
# Modes nearer than this share of their frequency are told apart by their shapes.
_NEIGHBOUR = 0.2
_SAME_SHAPE = 0.8
# Beside a mode, poles with less than this share of its singular value are its fragments, and those of the very shape.
_FRAGMENT = 0.15
_VERY_SHAPE = 0.95
# The subspace method spends so much more variance than the uncertainty law's least.
_EFFICIENCY = 1.3
# A damping below this cannot be told from a steady line, in units of 1 / (2 pi f T).
_LEAST_DECAY = 0.1


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
    found = _without_doubles([c for c in found if c.frequency_hz * duration_s > 2.0], duration_s)
    modes = []
    for candidate in found:
        series = signals @ modal_filter(candidate, found)
        zeta = max(candidate.damping_ratio, _LEAST_DECAY / (2.0 * np.pi * candidate.frequency_hz * duration_s))
        peak = weigh_peak(series, rate_hz, candidate.frequency_hz, zeta)
        if peak is not None and peak.gain > 0.0:
            split = _overlaps(candidate, found, duration_s)
            modes.append(_mode(candidate, peak, zeta, split, basis, coordinates, duration_s, options))
    return sorted(modes, key=lambda mode: -mode.amplitude)[: options.most_modes], diagram


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
    """Weights (p,) that pass one mode's real shape and stop those of its neighbours in frequency."""
    near = [
        c
        for c in found
        if c is not candidate
        and not _same_shape(c, candidate)
        and abs(c.frequency_hz - candidate.frequency_hz) < _NEIGHBOUR * candidate.frequency_hz
    ]
    shapes = np.stack([real_shape(c.pole.shape) for c in [candidate, *near]], axis=1)
    return np.linalg.pinv(shapes, rcond=0.05)[0]


def real_shape(shape: ComplexArray) -> FloatArray:
    """Unit real shape nearest to a complex one: rotated so that its real part is as long as it can be."""
    angle = 0.5 * np.angle(np.sum(shape**2))
    real = (shape * np.exp(-1j * angle)).real
    return real / max(float(np.linalg.norm(real)), 1e-300)


def _overlaps(candidate: Candidate, found: list[Candidate], duration_s: float) -> bool:
    """Whether a candidate is a piece of a stronger one near it: of its shape, or much weaker."""
    for other in found:
        apart_hz = abs(other.frequency_hz - candidate.frequency_hz)
        width_hz = abs(other.damping_ratio) * other.frequency_hz + abs(candidate.damping_ratio) * candidate.frequency_hz
        strength, stronger = candidate.pole.singular_value, other.pole.singular_value
        before = (other.count, stronger) > (candidate.count, strength)
        alike = shape_assurance(other.pole.shape, candidate.pole.shape) > _VERY_SHAPE
        if before and alike and 0.0 < apart_hz < width_hz + 3.0 / duration_s:
            return True
        if strength < _FRAGMENT * stronger and apart_hz < 3.0 * (width_hz + 1.0 / duration_s):
            return True
    return False


def _mode(
    candidate: Candidate,
    peak: Peak,
    damping_ratio: float,
    split: bool,
    basis: FloatArray,
    coordinates: Coordinates,
    duration_s: float,
    options: Options,
) -> Mode:
    pole, f = candidate.pole, candidate.frequency_hz
    law_frequency, law_damping = au_law(f, damping_ratio, duration_s)
    frequency_sigma_hz = float(np.hypot(_EFFICIENCY**0.5 * law_frequency * f, candidate.frequency_scatter_hz))
    damping_sigma = float(np.hypot(_EFFICIENCY**0.5 * law_damping * damping_ratio, candidate.damping_scatter))
    flags = common_flags(f, frequency_sigma_hz, damping_ratio, pole.coherence, coordinates.rate_hz, duration_s)
    flags += ambient_flags(
        candidate.damping_ratio, damping_sigma, peak.gain, peak.rise, peak.line_share, candidate.count
    )
    if split:
        flags.append("split")
    shape = (basis @ real_shape(pole.shape)).astype(np.complex128)
    amplitude = float(np.sqrt(2.0 * peak.variance) * np.max(np.abs(shape)))
    if amplitude < options.minimum_amplitude:
        flags.append("weak")
    return Mode(
        frequency_hz=f,
        frequency_sigma_hz=frequency_sigma_hz,
        damping_ratio=damping_ratio,
        damping_ratio_sigma=damping_sigma,
        amplitude=amplitude,
        amplitude_coherence=pole.coherence,
        singular_value=pole.singular_value,
        shape=normalised(shape, coordinates.live),
        valid=not flags,
        flags=sorted(set(flags)),
    )
