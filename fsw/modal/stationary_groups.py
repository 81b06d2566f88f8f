"""Candidates of a stationary response refined by likelihood: those near each other together, the needless dropped."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsw.modal.ambient import weigh_peak
from fsw.modal.clustering import Candidate
from fsw.modal.gates import LEAST_FALL_GAIN, LEAST_GAIN, LEAST_LINE_GAIN, LEAST_ORDERS, LEAST_RISE
from fsw.modal.indicators import shape_assurance
from fsw.modal.stationary_likelihood import Group, band_of, first_guess, half_band_hz, most_likely, without
from fsw.modal.stationary_model import Band
from fsw.modal.stationary_posterior import Estimate, posterior
from fsw.modal.uncertainty import au_law

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Modes that are refined together at most, and coefficients that a band must hold.
_MOST, _LEAST_COEFFICIENTS = 3, 5
# Damping that a search starts from, and the most that makes a band wider.
_LEAST_DAMPING, _MOST_DAMPING = 5e-4, 0.15
# A candidate in so many orders is one whatever the likelihood says: a second peak of one shape may be the force's.
_OFTEN = 8
# Of modes of the very shape in a band each must gain so much: the peak of one mode falls in two by chance, with a gain
# of 16 in one case of 200 (chi-square of some four degrees).
VERY_SHAPE, _PIECE_GAIN = 0.95, 30.0
# Of candidates that can do without each other, the likelihoods without them differ by less than this.
_TIE = 0.5
# A direction of a band's motion has at least so much more power than the least.
_CLEAR = 4.0
# A direction holds a mode of its own if its tallest coefficient is so many times the middle one, and if the others
# explain less than this share of it.
_TALL, _IN_STEP = 3.0, 0.5
# Filters that would amplify more than the inverse of this let neighbours pass.
_FLAT = 0.1
# A candidate that moves by more than so many widths, from itself or from a dropped piece of its peak, was another
# mode's.
_FAR = 3.0


@dataclass(frozen=True)
class Refined:
    """A candidate with frequency, damping and shape by likelihood, their deviations, the gains over a steady line and
    over a free decay, and whether it may be a piece of another's peak.
    """

    candidate: Candidate
    frequency_sigma_hz: float
    damping_sigma: float
    line_gain: float
    fall_gain: float
    piece: bool


def real_shape(shape: ComplexArray) -> FloatArray:
    """Unit real shape nearest to a complex one: rotated so that its real part is as long as it can be."""
    angle = 0.5 * np.angle(np.sum(shape**2))
    real = (shape * np.exp(-1j * angle)).real
    return real / max(float(np.linalg.norm(real)), 1e-300)


def refined(found: list[Candidate], signals: FloatArray, rate_hz: float) -> list[Refined]:
    """Candidates by likelihood. One that its neighbours explain as well is left out.

    signals (T, p) of noise that is alike in all, without their mean.
    """
    done: list[Refined] = []
    spectrum = np.fft.rfft(np.ascontiguousarray(signals.T)).T
    waiting = sorted(found, key=lambda c: (c.count < LEAST_ORDERS, -c.pole.singular_value))
    while waiting:
        first, *waiting = waiting
        reach_hz = _reach_hz(first.frequency_hz, first.damping_ratio, signals, rate_hz)
        known = [entry.candidate for entry in done]
        least = min(first.count, LEAST_ORDERS)
        near = [
            c for c in [*known, *waiting] if abs(c.frequency_hz - first.frequency_hz) < reach_hz and c.count >= least
        ]
        near = sorted(near, key=lambda c: abs(c.frequency_hz - first.frequency_hz))[: _MOST - 1]
        fresh = [first, *(c for c in waiting if any(c is n for n in near))]
        done += _settled(fresh, [c for c in known if any(c is n for n in near)], signals, spectrum, rate_hz)
        waiting = [c for c in waiting if not any(c is n for n in near)]
    return done


def _settled(
    fresh: list[Candidate], known: list[Candidate], signals: FloatArray, spectrum: ComplexArray, rate_hz: float
) -> list[Refined]:
    """The fresh candidates that are needed beside each other and the known ones; spectrum: of the signals."""
    hidden = _hidden([*fresh, *known], signals, spectrum, rate_hz)
    fresh = [*fresh, *hidden]
    members = [*fresh, *known]
    frequency_hz = np.array([c.frequency_hz for c in members])
    damping = np.array([c.damping_ratio for c in members])
    shapes = np.stack([real_shape(c.pole.shape) for c in members], axis=1)
    for _ in range(2):
        # The band depends on the damping: a second round has the better one.
        low_hz, high_hz, inside = _reach(frequency_hz, damping, signals, rate_hz)
        basis = _span(spectrum[inside], len(members))
        band = band_of(signals @ basis, rate_hz, low_hz, high_hz, spectrum @ basis)
        if len(band.frequency_hz) < _LEAST_COEFFICIENTS:
            return []
        decay_rate = 2.0 * np.pi * frequency_hz * np.clip(damping, _LEAST_DAMPING, _MOST_DAMPING)
        group = most_likely(band, first_guess(band, frequency_hz, decay_rate, basis.T @ shapes))
        frequency_hz, damping = group.modes.frequency_hz, group.modes.decay_rate / (2.0 * np.pi * frequency_hz)
        shapes = basis @ group.modes.shapes
    members, group = _needed(members, len(fresh), band, group)
    needed = members[: len(members) - len(known)]
    entries = [
        _refined(c, _estimate(band, group, j), basis @ group.modes.shapes[:, j], _is_piece(members, band, group, j))
        for j, c in enumerate(needed)
    ]
    if hidden:  # a pole that stood for two modes lay between them, or at the other one
        return entries
    dropped = [c for c in fresh if not any(c is n for n in needed)]
    return [
        entry
        for old, entry in zip(needed, entries, strict=True)
        if any(
            _arrives(entry, c, rate_hz / len(signals))
            for c in [old, *(c for c in dropped if shape_assurance(c.pole.shape, old.pole.shape) > VERY_SHAPE)]
        )
    ]


def _reach(
    frequency_hz: FloatArray, damping: FloatArray, signals: FloatArray, rate_hz: float
) -> tuple[float, float, slice]:
    """Ends in Hz of the band of some modes, and where it is in the signals' spectrum."""
    reach_hz = [_reach_hz(f, z, signals, rate_hz) for f, z in zip(frequency_hz, damping, strict=True)]
    low_hz, high_hz = float(np.min(frequency_hz - reach_hz)), float(np.max(frequency_hz + reach_hz))
    bins = len(signals) / rate_hz
    return low_hz, high_hz, slice(max(int(np.ceil(low_hz * bins)), 0), int(high_hz * bins) + 1)


def _reach_hz(frequency_hz: float, damping_ratio: float, signals: FloatArray, rate_hz: float) -> float:
    damping = float(np.clip(damping_ratio, 0.0, _MOST_DAMPING))
    return half_band_hz(frequency_hz, damping, len(signals) / rate_hz)


def _hidden(members: list[Candidate], signals: FloatArray, spectrum: ComplexArray, rate_hz: float) -> list[Candidate]:
    """The mode that the subspace method took for one with the members, if there is one.

    Their band then moves in one direction more than there are members, with a peak there. What moves in step with the
    members is no mode of its own: their shapes are not quite real.
    """
    first, count = members[0], len(members)
    hz, damping = np.array([(c.frequency_hz, c.damping_ratio) for c in members]).T
    inside = _reach(hz, damping, signals, rate_hz)[2]
    X = spectrum[inside]
    if len(X) < _LEAST_COEFFICIENTS or not count < min(_MOST, X.shape[1]):
        return []
    power, directions = _directions(X)
    along, across = X @ directions[:, :count], X @ directions[:, count]
    tall = np.max(np.abs(across)) > _TALL * np.median(np.abs(across))
    if power[count] < _CLEAR * power[-1] or not tall:
        return []
    in_step = along @ np.linalg.lstsq(along, across)[0]
    if np.linalg.norm(in_step) ** 2 > _IN_STEP * np.linalg.norm(across) ** 2:
        return []
    peak_hz = (inside.start + int(np.argmax(np.abs(across)))) * rate_hz / len(signals)
    zeta = float(np.clip(first.damping_ratio, _LEAST_DAMPING, _MOST_DAMPING))
    peak = weigh_peak(signals @ directions[:, count], rate_hz, peak_hz, zeta)
    if peak is None or peak.gain < LEAST_GAIN or peak.rise < LEAST_RISE:
        return []
    strength = first.pole.singular_value * float(np.sqrt(power[count] / power[0]))
    pole = replace(first.pole, shape=directions[:, count].astype(np.complex128), singular_value=strength)
    return [Candidate(pole, LEAST_ORDERS, peak_hz, zeta, 0.0, 0.0)]


def _arrives(entry: Refined, start: Candidate, resolution_hz: float) -> bool:
    """Whether a refined mode is where a candidate was, within some of its widths."""
    width_hz = max(start.damping_ratio, 0.0) * start.frequency_hz + resolution_hz
    return abs(entry.candidate.frequency_hz - start.frequency_hz) < _FAR * width_hz


def _directions(X: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Power (p,) and orthonormal directions (p, p) of the motion in a band of a spectrum (K, p), strongest first."""
    power, directions = np.linalg.eigh((X.conj().T @ X).real)
    return power[::-1], directions[:, ::-1]


def _span(X: ComplexArray, most: int) -> FloatArray:
    """Directions (p, q) of the motion in a band of a spectrum (K, p): at most so many, and those that stand out."""
    power, directions = _directions(X)
    clear = int(np.count_nonzero(power > _CLEAR * power[-1])) if len(power) > most else len(power)
    return directions[:, : max(min(clear, most), 1)]


def _needed(members: list[Candidate], fresh: int, band: Band, group: Group) -> tuple[list[Candidate], Group]:
    """The members, the first of them fresh, without those that the others explain as well; and their group."""
    members = list(members)
    doubted = [j < fresh and c.count < _OFTEN for j, c in enumerate(members)]
    while any(doubted) and len(members) > 1:
        fewer = {j: without(group, band, j) for j, doubt in enumerate(doubted) if doubt}
        excess = {j: 2.0 * (group.likelihood - other.likelihood) - _asked(group, j) for j, other in fewer.items()}
        if min(excess.values()) > 0.0:
            break
        ties = [j for j in fewer if excess[j] < min(excess.values()) + 2.0 * _TIE]
        least = min(ties, key=lambda j: (members[j].count, members[j].pole.singular_value))
        group = fewer[least]
        del members[least], doubted[least]
    return members, group


def _asked(group: Group, mode: int) -> float:
    """Gain that a mode of a group is asked for: more beside another one of its shape."""
    return _PIECE_GAIN if np.count_nonzero(_alike(group, mode)) > 1 else LEAST_GAIN


def _alike(group: Group, mode: int) -> NDArray[np.bool_]:
    """Which modes (m,) of a group have the very shape of one of them."""
    return np.asarray((group.modes.shapes[:, mode] @ group.modes.shapes) ** 2 > VERY_SHAPE)


def _is_piece(members: list[Candidate], band: Band, group: Group, mode: int) -> bool:
    """Whether a mode has the shape of one seen oftener or stronger, and both gain no more than chance does over one."""
    # It stays in the group all the same, for it may stand for what the force is not white by.
    seen = [(c.count, c.pole.singular_value) for c in members]
    before = any(seen[int(j)] > seen[mode] for j in np.flatnonzero(_alike(group, mode)))
    return before and 2.0 * (group.likelihood - without(group, band, mode).likelihood) < _PIECE_GAIN


def _estimate(band: Band, group: Group, mode: int) -> Estimate:
    frequency_hz, rates, _, shapes, _ = group.modes
    q, m = shapes.shape
    if m <= q:
        weights = np.linalg.pinv(shapes, rcond=_FLAT)[mode]
        alone = posterior(band, group.modes, mode, weights / float(weights @ shapes[:, mode]))
        # Alone and in its group a mode has one frequency, to hundredths of sigma. Where the filter lets another mode
        # through, or the band holds a second peak, it has not, and the difference is part of what is not known.
        off_hz = alone.frequency_hz - float(frequency_hz[mode])
        return replace(alone, frequency_sigma_hz=float(np.hypot(alone.frequency_sigma_hz, off_hz)))
    # Modes of one shape cannot be filtered apart: the curvature of their common likelihood must do, down to what the
    # uncertainty law allows; and whether one is a line is left to what a line explains.
    f, rate, sigma = float(frequency_hz[mode]), float(rates[mode]), group.sigmas[mode]
    law = au_law(f, rate / (2.0 * np.pi * f), band.duration_s * len(band.coefficients))
    f_sigma, rate_sigma = max(float(sigma[0]), law[0] * f), max(float(sigma[1]), law[1]) * rate
    return Estimate(f, f_sigma, rate, rate_sigma, LEAST_LINE_GAIN, LEAST_FALL_GAIN)


def _refined(candidate: Candidate, estimate: Estimate, shape: FloatArray, piece: bool) -> Refined:
    s = complex(-estimate.decay_rate, 2.0 * np.pi * estimate.frequency_hz)
    pole = replace(candidate.pole, s=s, shape=shape.astype(np.complex128))
    better = replace(candidate, pole=pole, frequency_hz=pole.frequency_hz, damping_ratio=pole.damping_ratio)
    # What the subspace method sees no decay of is a line unless the likelihood is sure.
    decays = candidate.damping_ratio > 0.0 or estimate.line_gain > LEAST_GAIN
    line_gain, damping_sigma = estimate.line_gain if decays else 0.0, estimate.decay_rate_sigma / abs(s)
    return Refined(better, estimate.frequency_sigma_hz, damping_sigma, line_gain, estimate.fall_gain, piece)
