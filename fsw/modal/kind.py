"""Free decay or random response: what falling exponentials must explain of a record to be believed."""

import numpy as np
from numpy.typing import NDArray

from fsw.modal.coordinates import Coordinates, even_grid, octaves
from fsw.modal.correlation import fixed_window
from fsw.modal.decay import onset
from fsw.modal.gates import LARGEST_DEPARTURE
from fsw.modal.realisation import continuous, poles_of_order, realise
from fsw.modal.refinement import Fit, project
from fsw.modal.remainder import tallest
from fsw.modal.result import Mode, Options
from fsw.modal.uncertainty import in_stretches

FloatArray = NDArray[np.float64]

# A mode matters with this share of the strongest one's energy, and the fit must explain so much about its frequency; a
# decay leaves no peak above this share of the record's tallest.
_MATTERS, _EXPLAINED = 0.05, 0.9
_LEFT_OVER = 0.1
# One mode of a random response may fall by chance as if it were free, but then others go on. A fit of so many cycles
# that explains less than this about its own frequencies, or in some stretch leaves so much of a mode's amplitude at the
# start, must not leave a peak elsewhere as it was: farther away than this share of each frequency, so high over the
# median, with this share left, and with at least so much of its energy in each of so many parts of the record.
_MANY_CYCLES, _WHOLE, _TORN = 50.0, 0.95, 0.2
_ELSEWHERE, _HIGH, _AS_IT_WAS = 0.1, 30.0, 0.5
_PARTS, _THERE = 3, 0.1
# A record is looked at before it is fitted, in so many coordinates: in none of its stretches must exponentials leave
# more than this share of the largest amplitude at the frequency of a tall peak, half as much again as a steady decay
# may leave there.
_GLANCE, _PLAINLY_RANDOM = 4, 1.5 * LARGEST_DEPARTURE
# Noise alone is so many times its mean in the worst stretch in 1 case of 10 000.
_BY_CHANCE = 5.0
# A peak of fewer cycles than this is slow; two peaks are as many apart.
_FEW_CYCLES = 5
# A gap of more of a period than this is bridged too badly for a look.
_BRIDGED = 0.25
# Drift that walks at random is so much stronger at half a frequency; exponentials take some of it.
_RED = 1.25


def may_fall_freely(coordinates: Coordinates, options: Options) -> bool:
    """Whether a record is worth fitting as a free decay; False only of one whose two tallest peaks are plainly random.

    One alone may be a lamp's, and what drifts says nothing of a mode. Where the tallest of all has few cycles, the two
    tallest of more are looked at, and it must be plainly random as well.
    """
    rate_hz, start = coordinates.rate_hz, onset(coordinates.time_s, coordinates.signals)
    even = even_grid(coordinates.time_s[start:], coordinates.signals[start:], rate_hz)
    still = even - even.mean(axis=0)
    power = _spectrum(still)
    slow, least = int(np.argmax(power.sum(axis=1))), _FEW_CYCLES
    if slow < _FEW_CYCLES:
        # The tallest that is not slow tells more: a few cycles are soon explained.
        least += slow
        power = _spectrum(still * np.hanning(len(still))[:, None])
        power[:least] = 0.0
    total = power.sum(axis=1)
    cycles = int(np.argmax(total))
    hz, slow_hz = (place * rate_hz / len(even) for place in (cycles, slow))
    stands_out = slow == cycles or float(total[cycles]) > _HIGH * float(np.median(total))
    if not stands_out or float(np.max(np.diff(coordinates.time_s))) * hz > _BRIDGED:
        return True
    loud = np.argsort(-power[cycles], kind="stable")[:_GLANCE]
    level = next(level for level in octaves(even[:, loud], rate_hz) if level.band_hz[0] <= hz)
    rows = min(options.block_rows, len(level.signals) // 4)
    system = realise(fixed_window(level.signals, 2 * rows), rows, rows, options.order)
    s = continuous(poles_of_order(system, system.order).z, level.rate_hz)
    s = np.minimum(s.real, 0.0) + 1j * s.imag
    time_s = np.arange(len(level.signals)) / level.rate_hz
    left = project(time_s, level.signals, s, options.drift_degree).residual
    still = level.signals - level.signals.mean(axis=0)
    noise = float(np.sum(np.median(_spectrum(left), axis=0))) / (np.log(2.0) * len(left))
    if any(_falls(time_s, still, left, noise, f) for f in {hz, slow_hz}) or _drifts(time_s, left, hz):
        return True
    second_hz = _second_hz(still, hz, level.rate_hz, least)
    return second_hz is not None and _falls(time_s, still, left, noise, second_hz)


def _drifts(time_s: FloatArray, left: FloatArray, hz: float) -> bool:
    """Whether what exponentials leave (T, p) is drift: stronger at half a frequency than at it."""
    slow, own = (np.abs(in_stretches(time_s, left, 2.0 * np.pi * f)[0]) ** 2 for f in (0.5 * hz, hz))
    return own.size > 0 and float(np.mean(slow)) > _RED * float(np.mean(own))


def _second_hz(signals: FloatArray, hz: float, rate_hz: float, least: int) -> float | None:
    """Frequency of the tallest peak of so many cycles or more, well apart from a taller one at hz, if it stands out."""
    duration_s = len(signals) / rate_hz
    power = _spectrum(signals * np.hanning(len(signals))[:, None]).sum(axis=1)
    cycles = np.arange(len(power))
    apart = max(float(_FEW_CYCLES), _ELSEWHERE * hz * duration_s)
    power[(np.abs(cycles - hz * duration_s) <= apart) | (cycles < least)] = 0.0
    place = int(np.argmax(power))
    return place / duration_s if power[place] > _HIGH * float(np.median(power)) else None


def _falls(time_s: FloatArray, signals: FloatArray, left: FloatArray, noise: float, hz: float) -> bool:
    """Whether exponentials leave little of signals (T, p) at a frequency, in any stretch.

    left (T, p): what they leave; noise: variance of what is noise in it, over all coordinates.
    """
    (before, _), (after, samples) = (in_stretches(time_s, y, 2.0 * np.pi * hz) for y in (signals, left))
    largest = float(np.max(np.sum(np.abs(before) ** 2, axis=1), initial=0.0))
    beyond = np.sum(np.abs(after) ** 2, axis=1) - _BY_CHANCE * 4.0 * noise / samples
    return float(np.max(beyond, initial=0.0)) <= _PLAINLY_RANDOM**2 * largest


def random_may_fall(modes: list[Mode], coordinates: Coordinates) -> bool:
    """Whether modes of a decay, none of them valid, may be of a random response that fell by chance.

    A record of so many cycles tells a random response from what is no steady decay: it is worth a look as such.
    """
    strongest = max(modes, key=lambda mode: mode.amplitude, default=None)
    return strongest is None or strongest.frequency_hz * float(coordinates.time_s[-1]) > _MANY_CYCLES


def _spectrum(signals: FloatArray) -> FloatArray:
    """Power (K, p) of signals (N, p)."""
    X = np.fft.rfft(np.ascontiguousarray(signals.T))
    return (X.real**2 + X.imag**2).T


def convincing(
    time_s: FloatArray,
    signals: FloatArray,
    rate_hz: float,
    fit: Fit,
    coherence: FloatArray,
    departure: FloatArray,
    falling: NDArray[np.bool_],
) -> bool:
    """Whether a record is a free decay: falling exponentials explain the modes that matter, and leave no peak like
    theirs.

    signals (T, p) before whitening; coherence, departure, falling (m,): the fit's share of the energy about each mode,
    the share of its amplitude that it leaves in one stretch, and whether it decays.
    """
    modes = len(fit.poles)
    if modes == 0:
        return False
    plain = fit.span.fit(signals)
    parts = [plain.triangle[:, 2 * j : 2 * j + 2] @ plain.coefficients[2 * j : 2 * j + 2] for j in range(modes)]
    energy = np.array([float(np.sum(part**2)) for part in parts])
    matters = energy > _MATTERS * float(np.max(energy))
    if not np.all(coherence[matters] > _EXPLAINED) or not np.any(falling & matters):
        return False
    moving = fit.span.of(fit.poles[:0]).fit(signals).residual
    left, whole = (even_grid(time_s, series, rate_hz) for series in (plain.residual, moving))
    hz = fit.poles.imag / (2.0 * np.pi)
    doubtful = bool(np.any(coherence[matters] < _WHOLE))
    doubtful |= bool(np.any(departure[matters] > _TORN))
    many = float(np.max(hz)) * float(time_s[-1]) > _MANY_CYCLES
    if many and doubtful and _others_go_on(left, whole, hz, rate_hz):
        return False
    return tallest(left) < _LEFT_OVER * tallest(whole)


def _others_go_on(left: FloatArray, whole: FloatArray, hz: FloatArray, rate_hz: float) -> bool:
    """Whether the tallest peak away from the frequencies hz (m,) is left as it was, and in each part of the record.

    left, whole (N, p): even grids. What a second blow starts is left as well, but dies out.
    """
    # Hann's window: leakage of the strong mode must not bury the others.
    window = np.hanning(len(whole))[:, None]
    before, after = (_spectrum(y * window).sum(axis=1) for y in (whole, left))
    grid_hz = np.fft.rfftfreq(len(whole), 1.0 / rate_hz)
    apart = np.all(np.abs(grid_hz[:, None] - hz) > _ELSEWHERE * hz, axis=1) & (grid_hz > _ELSEWHERE * float(np.max(hz)))
    peak = int(np.argmax(np.where(apart, before, 0.0)))
    high = bool(apart[peak] and before[peak] > _HIGH * float(np.median(before)))
    if not high or after[peak] <= _AS_IT_WAS * before[peak]:
        return False
    X = np.fft.rfft(left, axis=0)
    X[np.abs(grid_hz - grid_hz[peak]) > _ELSEWHERE * grid_hz[peak]] = 0.0
    parts = [float(np.sum(part**2)) for part in np.array_split(np.fft.irfft(X, len(left), axis=0), _PARTS)]
    return min(parts) > _THERE * sum(parts)
