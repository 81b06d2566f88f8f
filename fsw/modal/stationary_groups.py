"""Candidates of a stationary response refined by likelihood: those near each other together, the needless dropped."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsw.modal.clustering import Candidate
from fsw.modal.gates import LEAST_FALL_GAIN, LEAST_GAIN, LEAST_LINE_GAIN, LEAST_ORDERS
from fsw.modal.indicators import shape_assurance
from fsw.modal.small_matrices import pseudo_inverse
from fsw.modal.stationary_likelihood import Group, band_of, first_guess, most_likely, without
from fsw.modal.stationary_model import Band
from fsw.modal.stationary_peaks import (
    CLEAR,
    LEAST_COEFFICIENTS,
    LEAST_DAMPING,
    MOST,
    MOST_DAMPING,
    directions,
    hidden,
    reach,
    reach_hz,
    width_hz,
)
from fsw.modal.stationary_posterior import Estimate, posterior
from fsw.modal.uncertainty import au_law

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# A candidate in so many orders is one whatever the likelihood says: a second peak of one shape may be the force's.
_OFTEN = 8
# Of modes of the very shape in a band each must gain so much: the peak of one mode falls in two by chance, with a gain
# of 16 in one case of 200 (chi-square of some four degrees).
VERY_SHAPE, _PIECE_GAIN = 0.95, 30.0
# Of candidates that can do without each other, the likelihoods without them differ by less than this.
_TIE = 0.5
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


def refined(found: list[Candidate], signals: FloatArray, spectrum: ComplexArray, rate_hz: float) -> list[Refined]:
    """Candidates by likelihood. One that its neighbours explain as well is left out.

    signals (T, p) of noise that is alike in all, without their mean; spectrum (K, p): of them.
    """
    done: list[Refined] = []
    waiting = sorted(found, key=lambda c: (c.count < LEAST_ORDERS, -c.pole.singular_value))
    while waiting:
        first, *waiting = waiting
        near_hz = reach_hz(first.frequency_hz, first.damping_ratio, signals, rate_hz)
        known = [entry.candidate for entry in done]
        least = min(first.count, LEAST_ORDERS)
        near = [
            c for c in [*known, *waiting] if abs(c.frequency_hz - first.frequency_hz) < near_hz and c.count >= least
        ]
        near = sorted(near, key=lambda c: abs(c.frequency_hz - first.frequency_hz))[: MOST - 1]
        fresh = [first, *(c for c in waiting if any(c is n for n in near))]
        beside = [c for c in known if any(c is n for n in near)]
        new, stay = _settled(fresh, beside, signals, spectrum, rate_hz)
        done = [e for e in done if all(e.candidate is not c for c in beside) or any(e.candidate is c for c in stay)]
        done += new
        waiting = [c for c in waiting if not any(c is n for n in near)]
    return done


def _settled(
    fresh: list[Candidate], known: list[Candidate], signals: FloatArray, spectrum: ComplexArray, rate_hz: float
) -> tuple[list[Refined], list[Candidate]]:
    """The fresh candidates that are needed beside each other and the known ones, and those of the known that stay.

    spectrum: of the signals. A known one that no cluster was seen of, but a peak, may be what a fresh one is.
    """
    more = hidden([*fresh, *known], signals, spectrum, rate_hz)
    fresh = [*fresh, *more]
    members = [*fresh, *known]
    frequency_hz = np.array([c.frequency_hz for c in members])
    damping = np.array([c.damping_ratio for c in members])
    shapes = np.stack([real_shape(c.pole.shape) for c in members], axis=1)
    before = slice(0)
    for _ in range(2):
        # The band depends on the damping: a second round has the better one, if it is another one.
        low_hz, high_hz, inside = reach(frequency_hz, damping, signals, rate_hz)
        if inside == before:
            break
        before = inside
        basis = _span(spectrum[inside], len(members))
        band = band_of(signals @ basis, rate_hz, low_hz, high_hz, spectrum @ basis)
        if len(band.frequency_hz) < LEAST_COEFFICIENTS:
            return [], known
        decay_rate = 2.0 * np.pi * frequency_hz * np.clip(damping, LEAST_DAMPING, MOST_DAMPING)
        group = most_likely(band, first_guess(band, frequency_hz, decay_rate, basis.T @ shapes))
        frequency_hz, damping = group.modes.frequency_hz, group.modes.decay_rate / (2.0 * np.pi * frequency_hz)
        shapes = basis @ group.modes.shapes
    members, group = _needed(members, len(fresh), band, group)
    needed = [c for c in members if any(c is f for f in fresh)]
    stay = [c for c in known if any(c is m for m in members)]
    pieces = np.array([_is_piece(members, band, group, j) for j in range(len(needed))])
    entries = [
        _refined(c, _estimate(band, *_whole(band, group, j, pieces)), basis @ group.modes.shapes[:, j], bool(pieces[j]))
        for j, c in enumerate(needed)
    ]
    if more:  # a pole that stood for two modes lay between them, or at the other one
        return entries, stay
    dropped = [c for c in fresh if not any(c is n for n in needed)]
    arrived = [
        entry
        for old, entry in zip(needed, entries, strict=True)
        if any(
            _arrives(entry, c, len(signals) / rate_hz)
            for c in [old, *(c for c in dropped if shape_assurance(c.pole.shape, old.pole.shape) > VERY_SHAPE)]
        )
    ]
    return arrived, stay if len(arrived) == len(needed) else known


def _arrives(entry: Refined, start: Candidate, duration_s: float) -> bool:
    """Whether a refined mode is where a candidate was, within some of its widths."""
    return abs(entry.candidate.frequency_hz - start.frequency_hz) < _FAR * width_hz(start, duration_s)


def _span(X: ComplexArray, most: int) -> FloatArray:
    """Directions (p, q) of the motion in a band of a spectrum (K, p): at most so many, and those that stand out."""
    power, axes = directions(X)
    clear = int(np.count_nonzero(power > CLEAR * power[-1])) if len(power) > most else len(power)
    return axes[:, : max(min(clear, most), 1)]


def _needed(members: list[Candidate], fresh: int, band: Band, group: Group) -> tuple[list[Candidate], Group]:
    """The members, the first of them fresh, without those that the others explain as well; and their group."""
    members = list(members)
    doubted = [c.count < _OFTEN and (j < fresh or not c.members) for j, c in enumerate(members)]
    while any(doubted) and len(members) > 1:
        goals = {j: group.likelihood - 0.5 * _asked(group, j) for j, doubt in enumerate(doubted) if doubt}
        fewer = {j: without(group, band, j, goal) for j, goal in goals.items()}
        excess = {j: 2.0 * (goals[j] - other.likelihood) for j, other in fewer.items()}
        if min(excess.values()) > 0.0:
            break
        ties = [j for j in fewer if excess[j] < min(excess.values()) + 2.0 * _TIE]
        least = min(ties, key=lambda j: (members[j].count, members[j].pole.singular_value))
        group = most_likely(band, fewer[least].modes)
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
    goal = group.likelihood - 0.5 * _PIECE_GAIN
    return before and without(group, band, mode, goal).likelihood > goal


def _whole(band: Band, group: Group, mode: int, pieces: NDArray[np.bool_]) -> tuple[Group, int]:
    """A group without the pieces into which the peak of a mode fell, and the mode's place in it.

    pieces (k,): which of the first modes are such. A broader one stands for what the force is not white by, and stays.
    """
    rates = group.modes.decay_rate
    fell = pieces & (_alike(group, mode) & (rates <= rates[mode]))[: len(pieces)]
    own = [] if pieces[mode] else np.flatnonzero(fell).tolist()
    for j in own[::-1]:
        group = without(group, band, j)
    return group, mode - sum(j < mode for j in own)


def _estimate(band: Band, group: Group, mode: int) -> Estimate:
    frequency_hz, rates, _, shapes, _ = group.modes
    q, m = shapes.shape
    if m <= q:
        weights = pseudo_inverse(shapes, _FLAT)[mode]
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
