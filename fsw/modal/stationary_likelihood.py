"""Maximum likelihood of modes near each other in a stationary response to white noise, from a band of its spectrum.

The envelope of a lightly damped mode is a first order process. The covariance of its Fourier coefficients over a record
of finite length is known in closed form: the expected periodogram on the diagonal, and two ranks more for the record's
two ends. With few time constants in a record the ends matter; Whittle's likelihood leaves them out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.small_matrices import inverse, pseudo_inverse, tangents
from fsw.modal.stationary_model import Band, Modes, likelihood
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Half width of a band: so many half-power widths, at most this share of the frequency, for the force is not white far
# and wide; but at least so many 1 / T.
_WIDTHS, _SHARE, _BINS = 10.0, 0.06, 16.0
# With more coefficients than this in all signals a record is cut in pieces that count as independent.
_MOST_COEFFICIENTS = 128
# Rounds of Fisher scoring, and trials of a step in each. A round that gains less than this is the last. Where a goal is
# all that matters, so is one that gains little beyond it, or so little that as much in all rounds would not reach it.
_ROUNDS, _TRIALS, _ENOUGH = 14, 4, 1e-4
_LITTLE, _HOPELESS = 0.05, 40.0
# The longest step: in the logarithms, in a shape, and in half-power widths of frequency.
_LOGARITHM, _TURN, _HALF_WIDTHS = 1.0, 0.5, 2.0
# Bounds of a mode's decay over the record, as its logarithm, from a steady line to nothing that rings.
_LEAST_DECAY, _MOST_DECAY = 0.03, 1e4


@dataclass(frozen=True)
class Group:
    """Modes with the log likelihood of a band and the Fisher information.

    information: of each mode's frequency in Hz, ln decay rate, ln variance and shape (q - 1), mode by mode, and of ln
    noise.
    """

    modes: Modes
    likelihood: float
    information: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations (m, q + 2) of each mode's unknowns."""
        q, m = self.modes.shapes.shape
        variance = np.diagonal(pseudo_inverse(self.information, 1e-12))[:-1]
        return np.sqrt(np.maximum(variance, 0.0)).reshape(m, q + 2)


def half_band_hz(frequency_hz: float, damping_ratio: float, duration_s: float) -> float:
    """How far a mode's band reaches to either side."""
    return max(min(_WIDTHS * damping_ratio, _SHARE) * frequency_hz, _BINS / duration_s)


def band_of(
    signals: FloatArray, rate_hz: float, low_hz: float, high_hz: float, spectrum: ComplexArray | None = None
) -> Band:
    """Fourier coefficients of signals (T, q) from low_hz to high_hz, of the whole record or of pieces of it.

    spectrum (K, q): of the whole record, if it is known.
    """
    unknowns = (high_hz - low_hz) * len(signals) / rate_hz * signals.shape[1]
    pieces = max(int(np.ceil(unknowns / _MOST_COEFFICIENTS)), 1)
    count = len(signals) // pieces
    grid_hz = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_hz), np.float64)
    inside = (
        (grid_hz >= low_hz) & (grid_hz <= high_hz) & (grid_hz > 0.5 * rate_hz / count) & (grid_hz < 0.499 * rate_hz)
    )
    if spectrum is None or pieces > 1:
        spectrum = np.fft.rfft(signals[: pieces * count].reshape(pieces, count, -1), axis=1)
    coefficients = spectrum.reshape(pieces, len(grid_hz), -1)[:, inside] / count
    return Band(grid_hz[inside], np.ascontiguousarray(coefficients), count / rate_hz)


def first_guess(band: Band, frequency_hz: FloatArray, decay_rate: FloatArray, shapes: FloatArray) -> Modes:
    """Modes with the band's power shared out along the shapes (q, m)."""
    shapes = shapes / np.maximum(np.linalg.norm(shapes, axis=0), 1e-9)
    y = band.coefficients.reshape(-1, len(shapes))
    power = y.real**2 + y.imag**2
    total = float(np.sum(power)) / len(band.coefficients) + 1e-300
    share = np.sum(np.abs(y @ pseudo_inverse(shapes, 0.05).T) ** 2, axis=0)
    bounded = np.clip(decay_rate, _LEAST_DECAY / band.duration_s, _MOST_DECAY / band.duration_s)
    noise = float(np.partition(power, power.size // 4, axis=None)[power.size // 4]) + 1e-9 * total
    return Modes(frequency_hz.copy(), bounded, total * share / share.sum(), np.ascontiguousarray(shapes), noise)


def most_likely(band: Band, start: Modes) -> Group:
    """The modes that make a band most likely, by Fisher scoring from a first guess."""
    return Group(*_search(band, start, np.nan))


def without(group: Group, band: Band, left_out: int, goal: float = np.nan) -> Group:
    """The modes that make a band most likely with one of a group left out.

    goal: log likelihood, if all that matters is whether it is reached; the modes are then not quite the best.
    """
    f, a, v, shapes, noise = group.modes
    keep = np.arange(len(f)) != left_out
    start = Modes(f[keep], a[keep], v[keep], np.ascontiguousarray(shapes[:, keep]), noise)
    return Group(*_search(band, start, goal))


@kernel
def _search(band: Band, start: Modes, goal: float) -> tuple[Modes, float, FloatArray]:
    """Modes, log likelihood and information where Fisher scoring arrives. goal: as of without, or NaN."""
    modes = start
    now, score, information = likelihood(band, modes, -np.inf)
    caution = 1e-3
    for _ in range(_ROUNDS):
        before = now
        for _ in range(_TRIALS):
            trial = _stepped(modes, _step(information, score, caution), band)
            its_now, its_score, its_information = likelihood(band, trial, now)
            if its_now > now:
                modes, now, score, information = trial, its_now, its_score, its_information
                caution *= 0.1
                break
            caution = max(10.0 * caution, 1e-2)
        gain = now - before
        if gain < _ENOUGH or goal - now > _HOPELESS * gain or (now > goal and gain < _LITTLE):
            break
    return modes, now, information


@kernel
def _step(information: FloatArray, score: FloatArray, caution: float) -> FloatArray:
    """Step of scoring in the unknowns (n,), shorter with more caution, from the slopes (n,) and information (n, n)."""
    n = len(score)
    scale, normal, step = np.empty(n), np.empty((n, n)), np.zeros(n)
    for i in range(n):
        scale[i] = np.sqrt(max(information[i, i], 1e-12))
    for i in range(n):
        for j in range(n):
            normal[i, j] = information[i, j] / (scale[i] * scale[j]) + (caution if i == j else 0.0)
    curvature = inverse(normal)[0]
    for i in range(n):
        for j in range(n):
            step[i] += curvature[i, j] * score[j] / (scale[i] * scale[j])
    return step


@kernel
def _stepped(modes: Modes, step: FloatArray, band: Band) -> Modes:
    """The modes after a step in the unknowns, none of it longer than is safe, and no mode beyond the band."""
    duration_s = band.duration_s
    f, a, v, unit = modes.frequency_hz.copy(), modes.decay_rate.copy(), modes.variance.copy(), modes.shapes.copy()
    q = len(unit)
    own = q + 2
    for j in range(len(f)):
        first = j * own
        widest = _HALF_WIDTHS * max(a[j], 0.2 / duration_s) / (2.0 * np.pi)
        f[j] += min(max(step[first], -widest), widest)
        f[j] = min(max(f[j], band.frequency_hz[0]), band.frequency_hz[-1])
        grown = a[j] * np.exp(min(max(step[first + 1], -_LOGARITHM), _LOGARITHM))
        a[j] = min(max(grown, _LEAST_DECAY / duration_s), _MOST_DECAY / duration_s)
        v[j] *= np.exp(min(max(step[first + 2], -_LOGARITHM), _LOGARITHM))
        turns = tangents(modes.shapes[:, j].copy())
        square = 0.0
        for i in range(q):
            for t in range(q - 1):
                unit[i, j] += min(max(step[first + 3 + t], -_TURN), _TURN) * turns[t, i]
            square += unit[i, j] ** 2
        for i in range(q):
            unit[i, j] /= np.sqrt(square)
    noise = modes.noise * np.exp(min(max(step[-1], -_LOGARITHM), _LOGARITHM))
    return Modes(f, a, v, unit, noise)
