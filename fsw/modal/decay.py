"""A free decay: subspace candidates, maximum likelihood refinement, and a second look at what is left over."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.modal.beside import REACH, noise_beside
from fsw.modal.candidates import Correlation, subspace_candidates
from fsw.modal.clustering import Candidate, Pole
from fsw.modal.coordinates import even_grid
from fsw.modal.indicators import shape_assurance
from fsw.modal.refinement import Fit, moved, project, refined, significance
from fsw.modal.remainder import may_hold_a_mode
from fsw.modal.result import Options
from fsw.modal.weighting import ROUNDING, whitening

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Fewer samples than this hold no mode.
LEAST_SAMPLES = 24
# Looks at the residual. Each can only add modes that the likelihood asks for. A motion of which the first two leave
# more than this share of the energy is no sum of decays, and further ones would but patch it.
_PASSES, _SURE_PASSES, _PATCHED = 4, 2, 0.02
# Most rounds of refining poles and noise in turn, beyond the first. Each moves the poles by the same small share of
# what the one before did: they stand once the next would move them by less than so many of their deviations.
_REFINEMENTS, _STANDING = 3, 0.01
# A mode takes two unknowns of each coordinate and two of its own: no more modes than the samples can tell.
_SAMPLES_OF_A_MODE = 6
# Chance that noise alone passes for a mode, before the search over frequencies.
_FALSE_ALARM = 1e-9
# Coordinates with so much more power than the quietest are searched first, but so many at least.
_LOUD, _LEAST_LOUD = 2.0, 4
# Poles of one shape nearer than this many 1 / T are one mode, split.
_SPLIT = 2.0
_SAME_SHAPE = 0.9
# The noise beside a mode is a mean, and has never been more than half of this share of the tallest there.
_TALLEST = 0.5
# Of modes so many cycles over the record apart, those that have less than this share of what a mode must have can be
# dropped together: none of them can be needed when another is gone.
_FAR_BELOW, _APART = 0.5, 6.0


class Settled(NamedTuple):
    """A fit in whitened coordinates, its modes as they were found, and how many coordinates its whitening couples."""

    fit: Fit
    known: list[Candidate]
    coupled: int


def find_decay(
    time_s: FloatArray, signals: FloatArray, rate_hz: float, correlation: Correlation, options: Options
) -> tuple[Settled, list[Pole]]:
    """Damped sinusoids that the likelihood asks for, refined together, and poles for the stabilisation diagram.

    time_s (T,) true stamps from 0, signals (T, p). The noise's covariance between the coordinates is
    estimated on the way.
    """
    degree = options.drift_degree
    most = min(options.most_modes, (len(time_s) - degree) // _SAMPLES_OF_A_MODE)
    diagram: list[Pole] = []
    # At first the fit is the drift alone, of signals as they are: the whitening is known once modes are.
    settled = Settled(project(time_s, signals, np.zeros(0, np.complex128), degree), [], 1)
    still = settled.fit.cost
    for look in range(_PASSES):
        fit, known, _coupled = settled
        if look >= _SURE_PASSES and fit.span.fit(signals).cost > _PATCHED * still:
            break
        left = even_grid(time_s, fit.residual, rate_hz)
        if known and not may_hold_a_mode(left, fit, _least_statistic(left.shape[1])):
            break
        searched = left if known else left[:, _loud(left)]
        found, poles = subspace_candidates(searched, rate_hz, correlation, options.block_rows, options.order)
        diagram = diagram or poles
        fresh = [c for c in found if c.pole.frequency_hz * float(time_s[-1]) > 1.0 and not _near(c.pole, fit, time_s)]
        fresh = fresh[: max(most - len(known), 0)]
        if not fresh:
            break
        settled = _settle(time_s, signals, settled, fresh)
        if len(settled.known) <= len(known):
            break
    return settled, diagram


def _loud(signals: FloatArray) -> NDArray[np.int64]:
    """Coordinates that stand out of the quietest, in their order: the first search looks there, for a mode that it
    misses is left over in all of them.
    """
    power = np.mean(signals**2, axis=0)
    loud = np.argsort(-power, kind="stable")
    count = int(np.count_nonzero(power > _LOUD * float(np.min(power))))
    return np.sort(loud[: max(count, _LEAST_LOUD)])


def _settle(time_s: FloatArray, signals: FloatArray, settled: Settled, fresh: list[Candidate]) -> Settled:
    """Refine poles and noise in turn, dropping the modes that the noise explains as well.

    settled: with the modes known so far. It is given back if no fresh one is needed.
    """
    before, known = settled.known, [*settled.known, *fresh]
    span = settled.fit.span.of(np.concatenate([settled.fit.poles, [c.pole.s for c in fresh]]))
    searched = False
    rounds, step = 0, 0.0
    least = ROUNDING**2 * float(np.max(signals.var(axis=0))) + 1e-300
    while True:
        plain = span.fit(signals)
        weights, coupled = whitening(plain, least)
        start = plain.weighed(weights)
        fit = refined(start, signals @ weights) if searched else start
        last, step = step, moved(fit, start)
        needless = _needless(time_s, fit)
        if needless:
            keep = ~np.isin(np.arange(len(fit.poles)), needless)
            known = [c for c, k in zip(known, keep, strict=True) if k]
            if before and not searched and [id(c) for c in known] == [id(c) for c in before]:
                return settled
            span = fit.span.of(fit.poles[keep])
        else:
            standing = step**2 < _STANDING * last
            if rounds == _REFINEMENTS or (searched and (standing or len(fit.poles) == 0)):
                return Settled(fit, known, coupled)
            rounds += int(searched)
            searched, span = True, fit.span


def _needless(time_s: FloatArray, fit: Fit) -> list[int]:
    """Modes to drop next: one of a split pair, or those that noise explains as well; none if all are needed."""
    if len(fit.poles) == 0:
        return []
    values = significance(fit)
    apart = _cycles_apart(time_s, fit, fit.poles[:, None])
    crowded = np.count_nonzero(apart < _SPLIT, axis=1) > 1
    for j in (int(j) for j in np.argsort(values, kind="stable") if crowded[j]):
        near = map(int, np.flatnonzero(apart[j] < _SPLIT))
        stronger = [i for i in near if values[i] > values[j] or (values[i] == values[j] and i < j)]
        if any(_split(fit, j, i, float(apart[j, i])) for i in stronger):
            return [j]
    # What is no vibration goes first: no frequency left, or gone within a fraction of a cycle.
    cycles = fit.poles.imag / (2.0 * np.pi) * float(time_s[-1])
    gone = (cycles < 1.0) | (np.abs(fit.poles.real) > 0.35 * np.abs(fit.poles.imag))
    if gone.any():
        return [int(np.argmax(gone))]
    excess = values / _least_statistic(fit.residual.shape[1])
    ceiling = _most_noise(time_s, fit)
    own = np.full(len(excess), np.inf)
    for j in map(int, np.argsort(excess, kind="stable")):
        if excess[j] < ceiling[j] * max(min(1.0, float(np.min(own))), _FAR_BELOW):
            own[j] = float(excess[j]) / max(float(noise_beside(time_s, fit, [j])[0]), 1.0)
    if not np.min(own) < 1.0:
        return []
    dropped = [int(np.argmin(own))]
    for j in map(int, np.flatnonzero(own < _FAR_BELOW)):
        # What two modes hold between them, each seems not to need.
        if np.min(apart[j, dropped]) > _APART:
            dropped.append(j)
    return dropped


def _most_noise(time_s: FloatArray, fit: Fit) -> FloatArray:
    """What noise_beside says of each mode (m,), at most, but 1 at least: what is so strong needs no closer look."""
    spectrum = scipy.fft.rfft(fit.residual, axis=0)
    power = np.sum(spectrum.real**2 + spectrum.imag**2, axis=1) / len(fit.residual)
    place = np.abs(fit.poles) / (2.0 * np.pi) * float(time_s[-1])
    beside = [np.max(power[max(k - REACH, 0) : k + REACH + 2], initial=0.0) for k in place.astype(np.int64)]
    return np.maximum(_TALLEST * np.array(beside), 1.0)


@lru_cache
def _least_statistic(coordinates: int) -> float:
    """What a mode's amplitudes in so many coordinates of white noise exceed by chance alone in one case of many."""
    return float(chdtri(2 * coordinates, _FALSE_ALARM))


def complex_shape(fit: Fit, mode: int) -> ComplexArray:
    """Shape (p,) of a mode in the fit's coordinates: amplitude and phase at time 0."""
    return fit.coefficients[2 * mode] - 1j * fit.coefficients[2 * mode + 1]


def _cycles_apart(time_s: FloatArray, fit: Fit, s: complex | ComplexArray) -> FloatArray:
    """How many cycles over the record each mode (m,) is apart from a pole, or from each of more (k, 1)."""
    return np.asarray(np.abs(fit.poles.imag - s.imag) / (2.0 * np.pi) * float(time_s[-1]))


def _split(fit: Fit, a: int, b: int, apart: float) -> bool:
    """Whether two modes so many cycles apart are one."""
    return bool(
        apart < 0.05 or (apart < _SPLIT and shape_assurance(complex_shape(fit, a), complex_shape(fit, b)) > _SAME_SHAPE)
    )


def _near(pole: Pole, fit: Fit, time_s: FloatArray) -> bool:
    """Whether a fresh pole only repeats one that is fitted already, in frequency and shape."""
    apart = _cycles_apart(time_s, fit, pole.s)
    return any(
        apart[j] < 0.05 or shape_assurance(pole.shape, complex_shape(fit, int(j))) > _SAME_SHAPE
        for j in np.flatnonzero(apart < 0.3)
    )


def onset(time_s: FloatArray, signals: FloatArray) -> int:
    """Index at which a free decay starts: 0, or just after the strike if the record is much quieter before
    it.

    The record is cut in 40 pieces. The piece that changes most is the strike, if it is four times as loud as
    what came before.
    """
    pieces = min(40, max(len(signals) // 8, 1))
    size, longer = divmod(len(signals), pieces)
    begins = size * np.arange(pieces) + np.minimum(np.arange(pieces), longer)
    change = np.zeros(len(signals))
    change[1:] = np.sum(np.diff(signals, axis=0) ** 2, axis=1)
    loud = np.add.reduceat(change, begins) / np.diff(begins, append=len(signals))
    strike = int(np.argmax(loud))
    before = float(np.median(loud[: strike + 1]))
    if strike == 0 or loud[strike] < 16.0 * before or strike > 0.7 * pieces:
        return 0
    start = int(begins[min(strike + 1, pieces - 1)])
    return start if len(signals) - start >= LEAST_SAMPLES else 0
