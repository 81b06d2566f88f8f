"""Maximum likelihood of modes near each other in a stationary response to white noise, from a band of its spectrum.

The envelope of a lightly damped mode is a first order process. The covariance of its Fourier coefficients over a record
of finite length is known in closed form: the expected periodogram on the diagonal, and two ranks more for the record's
two ends. With few time constants in a record the ends matter; Whittle's likelihood leaves them out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.stationary_model import inverse, likelihood, tangents
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Half width of a band: so many half-power widths, at most this share of the frequency, for the force is not white far
# and wide; but at least so many 1 / T.
_WIDTHS, _SHARE, _BINS = 10.0, 0.06, 16.0
# With more coefficients than this in all signals a record is cut in pieces that count as independent.
_MOST_COEFFICIENTS = 128
# Rounds of Fisher scoring, and trials of a step in each. A round that gains less than this is the last.
_ROUNDS, _TRIALS, _ENOUGH = 14, 4, 1e-4
# The longest step: in the logarithms, in a shape, and in half-power widths of frequency.
_LOGARITHM, _TURN, _HALF_WIDTHS = 1.0, 0.5, 2.0
# Bounds of a mode's decay over the record, as its logarithm, from a steady line to nothing that rings.
_LEAST_DECAY, _MOST_DECAY = 0.03, 1e4


@dataclass(frozen=True)
class Band:
    """Fourier coefficients (pieces, K, q) at frequencies (K,) in Hz, of pieces of a record of duration_s each."""

    frequency_hz: FloatArray
    coefficients: ComplexArray
    duration_s: float


@dataclass(frozen=True)
class Group:
    """Modes in a band: frequency_hz, decay_rate in 1/s, variance (m,), unit shapes (q, m), and the noise's variance.

    Variances are those of one Fourier coefficient. information: Fisher information of each mode's frequency in Hz, ln
    decay rate, ln variance and shape (q - 1), mode by mode, and of ln noise.
    """

    frequency_hz: FloatArray
    decay_rate: FloatArray
    variance: FloatArray
    shapes: FloatArray
    noise: float
    likelihood: float
    information: FloatArray

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations (m, q + 2) of each mode's unknowns."""
        q, m = self.shapes.shape
        variance = np.diag(np.linalg.pinv(self.information, rcond=1e-12, hermitian=True))[:-1]
        return np.sqrt(np.maximum(variance, 0.0)).reshape(m, q + 2)


def half_band_hz(frequency_hz: float, damping_ratio: float, duration_s: float) -> float:
    """How far a mode's band reaches to either side."""
    return max(min(_WIDTHS * damping_ratio, _SHARE) * frequency_hz, _BINS / duration_s)


def band_of(signals: FloatArray, rate_hz: float, low_hz: float, high_hz: float) -> Band:
    """Fourier coefficients of signals (T, q) from low_hz to high_hz, of the whole record or of pieces of it."""
    unknowns = (high_hz - low_hz) * len(signals) / rate_hz * signals.shape[1]
    pieces = max(int(np.ceil(unknowns / _MOST_COEFFICIENTS)), 1)
    count = len(signals) // pieces
    grid_hz = np.asarray(np.fft.rfftfreq(count, 1.0 / rate_hz), np.float64)
    inside = (
        (grid_hz >= low_hz) & (grid_hz <= high_hz) & (grid_hz > 0.5 * rate_hz / count) & (grid_hz < 0.499 * rate_hz)
    )
    stacked = signals[: pieces * count].reshape(pieces, count, -1)
    return Band(grid_hz[inside], np.fft.rfft(stacked, axis=1)[:, inside] / count, count / rate_hz)


def first_guess(band: Band, frequency_hz: FloatArray, decay_rate: FloatArray, shapes: FloatArray) -> Group:
    """A group with the band's power shared out along the shapes (q, m)."""
    shapes = shapes / np.maximum(np.linalg.norm(shapes, axis=0), 1e-9)
    power = np.abs(band.coefficients) ** 2
    total = float(np.mean(power, axis=0).sum()) + 1e-300
    along = np.abs(band.coefficients @ np.linalg.pinv(shapes, rcond=0.05).T) ** 2
    share = along.mean(axis=0).sum(axis=0)
    noise = float(np.quantile(power, 0.25)) + 1e-9 * total
    bounded = np.clip(decay_rate, _LEAST_DECAY / band.duration_s, _MOST_DECAY / band.duration_s)
    return scored(band, frequency_hz, bounded, total * share / share.sum(), shapes, noise)


def most_likely(band: Band, start: Group) -> Group:
    """The group that makes a band most likely, by Fisher scoring from a first guess."""
    return _settled(band, start.frequency_hz, start.decay_rate, start.variance, start.shapes, start.noise)


def without(group: Group, band: Band, left_out: int) -> Group:
    """The group that makes a band most likely with one of the modes left out."""
    keep = np.arange(len(group.frequency_hz)) != left_out
    variance, shapes = group.variance[keep], group.shapes[:, keep]
    return _settled(band, group.frequency_hz[keep], group.decay_rate[keep], variance, shapes, group.noise)


def _settled(
    band: Band,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    noise: float,
) -> Group:
    return Group(*_search(*_arrays(band, frequency_hz, decay_rate, variance, shapes), noise))


def scored(
    band: Band,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    noise: float,
) -> Group:
    """A group with its log likelihood and Fisher information."""
    now, _, information = likelihood(*_arrays(band, frequency_hz, decay_rate, variance, shapes), noise)
    return Group(frequency_hz, decay_rate, variance, shapes, noise, now, information)


def _arrays(
    band: Band, frequency_hz: FloatArray, decay_rate: FloatArray, variance: FloatArray, shapes: FloatArray
) -> tuple[FloatArray, ComplexArray, float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """A band and modes in it as the kernels take them: each array in one piece, for which they are compiled once."""
    y = np.ascontiguousarray(band.coefficients)
    f, a, v, unit = (np.ascontiguousarray(values) for values in (frequency_hz, decay_rate, variance, shapes))
    return np.ascontiguousarray(band.frequency_hz), y, band.duration_s, f, a, v, unit


@kernel
def _search(
    band_hz: FloatArray,
    y: ComplexArray,
    duration_s: float,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    noise: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, float, FloatArray]:
    """The modes, noise, log likelihood and information where Fisher scoring from a first guess arrives."""
    f, a, v, unit = frequency_hz, decay_rate, variance, shapes
    now, score, information = likelihood(band_hz, y, duration_s, f, a, v, unit, noise)
    caution = 1e-3
    for _ in range(_ROUNDS):
        before = now
        for _ in range(_TRIALS):
            step = _step(information, score, caution)
            its_f, its_a, its_v, its_unit, its_noise = _stepped(step, duration_s, f, a, v, unit, noise)
            its_now, its_score, its_information = likelihood(
                band_hz, y, duration_s, its_f, its_a, its_v, its_unit, its_noise
            )
            if its_now > now:
                f, a, v, unit, noise = its_f, its_a, its_v, its_unit, its_noise
                now, score, information = its_now, its_score, its_information
                caution *= 0.1
                break
            caution = max(10.0 * caution, 1e-2)
        if now - before < _ENOUGH:
            break
    return f, a, v, unit, noise, now, information


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
def _stepped(
    step: FloatArray,
    duration_s: float,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    noise: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """The modes and the noise after a step in the unknowns, none of it longer than is safe."""
    f, a, v, unit = frequency_hz.copy(), decay_rate.copy(), variance.copy(), shapes.copy()
    q = len(shapes)
    own = q + 2
    for j in range(len(f)):
        first = j * own
        widest = _HALF_WIDTHS * max(a[j], 0.2 / duration_s) / (2.0 * np.pi)
        f[j] += min(max(step[first], -widest), widest)
        grown = a[j] * np.exp(min(max(step[first + 1], -_LOGARITHM), _LOGARITHM))
        a[j] = min(max(grown, _LEAST_DECAY / duration_s), _MOST_DECAY / duration_s)
        v[j] *= np.exp(min(max(step[first + 2], -_LOGARITHM), _LOGARITHM))
        turns = tangents(shapes[:, j].copy())
        square = 0.0
        for i in range(q):
            for t in range(q - 1):
                unit[i, j] += min(max(step[first + 3 + t], -_TURN), _TURN) * turns[t, i]
            square += unit[i, j] ** 2
        for i in range(q):
            unit[i, j] /= np.sqrt(square)
    return f, a, v, unit, noise * np.exp(min(max(step[-1], -_LOGARITHM), _LOGARITHM))
