"""Maximum likelihood of modes near each other in a stationary response to white noise, from a band of its spectrum.

The envelope of a lightly damped mode is a first order process. The covariance of its Fourier coefficients over a record
of finite length is known in closed form: the expected periodogram on the diagonal, and two ranks more for the record's
two ends. With few time constants in a record the ends matter; Whittle's likelihood leaves them out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
# Step of the differences that give derivatives, as a share of the half-power width and of the decay rate.
_STEP = 1e-4


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


def envelope_covariance(
    band_hz: FloatArray, frequency_hz: FloatArray, decay_rate: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d, a, b (..., K): the covariance of a unit envelope's Fourier coefficients is diag(d) - a a^T + b b^T.

    frequency_hz, decay_rate (...). With p_k = (decay_rate + i (w_k - w)) T and c = exp((i w - decay_rate) T), the
    double integral of exp(-decay_rate |t - s|) over the record is diag(2 Re 1 / p) - 2 Re((1 - c) (1 / p) (1 / p)^T).
    """
    decay = (decay_rate * duration_s)[..., None]
    turn = 2j * np.pi * duration_s
    p = decay + turn * (band_hz - frequency_hz[..., None])
    ends = np.sqrt(2.0 * (1.0 - np.exp(turn * frequency_hz[..., None] - decay))) / p
    return 2.0 * decay / np.abs(p) ** 2, ends.real, ends.imag


def first_guess(band: Band, frequency_hz: FloatArray, decay_rate: FloatArray, shapes: FloatArray) -> Group:
    """A group with the band's power shared out along the shapes (q, m)."""
    shapes = shapes / np.maximum(np.linalg.norm(shapes, axis=0), 1e-9)
    power = np.abs(band.coefficients) ** 2
    total = float(np.mean(power, axis=0).sum()) + 1e-300
    along = np.abs(band.coefficients @ np.linalg.pinv(shapes, rcond=0.05).T) ** 2
    share = along.mean(axis=0).sum(axis=0)
    noise = float(np.quantile(power, 0.25)) + 1e-9 * total
    bounded = np.clip(decay_rate, _LEAST_DECAY / band.duration_s, _MOST_DECAY / band.duration_s)
    return scored(band, frequency_hz, bounded, total * share / share.sum(), shapes, noise)[0]


def most_likely(band: Band, start: Group) -> Group:
    """The group that makes a band most likely, by Fisher scoring from a first guess."""
    now, score = scored(band, start.frequency_hz, start.decay_rate, start.variance, start.shapes, start.noise)
    caution = 1e-3
    for _ in range(_ROUNDS):
        before = now.likelihood
        scale = np.sqrt(np.maximum(np.diag(now.information), 1e-12))
        normal = now.information / np.outer(scale, scale)
        for _ in range(_TRIALS):
            step = np.linalg.solve(normal + caution * np.eye(len(scale)), score / scale) / scale
            trial, its_score = _stepped(band, now, step)
            if trial.likelihood > now.likelihood:
                now, score = trial, its_score
                caution *= 0.1
                break
            caution = max(10.0 * caution, 1e-2)
        if now.likelihood - before < _ENOUGH:
            break
    return now


def without(group: Group, band: Band, left_out: int) -> Group:
    """The group that makes a band most likely with one of the modes left out."""
    keep = np.arange(len(group.frequency_hz)) != left_out
    variance, shapes = group.variance[keep], group.shapes[:, keep]
    fewer, _ = scored(band, group.frequency_hz[keep], group.decay_rate[keep], variance, shapes, group.noise)
    return most_likely(band, fewer)


def scored(
    band: Band,
    frequency_hz: FloatArray,
    decay_rate: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    noise: float,
) -> tuple[Group, FloatArray]:
    """A group with its log likelihood and Fisher information, and the score."""
    q = len(shapes)
    size, pieces = len(band.frequency_hz) * q, len(band.coefficients)
    y = band.coefficients.transpose(0, 2, 1).reshape(pieces, size).T
    covariance = noise * np.eye(size)
    slopes = []
    for f, a, v, shape in zip(frequency_hz, decay_rate, variance, shapes.T, strict=True):
        outer = v * np.outer(shape, shape)
        C = _covariance(band, f, a)
        h = _STEP * a
        by_frequency = (_covariance(band, f + h, a) - _covariance(band, f - h, a)) / (2.0 * h)
        by_decay = (_covariance(band, f, a + h) - _covariance(band, f, a - h)) / (2.0 * _STEP)
        own = np.kron(outer, C)
        covariance += own
        slopes += [np.kron(outer, by_frequency), np.kron(outer, by_decay), own]
        slopes += [v * np.kron(np.outer(shape, e) + np.outer(e, shape), C) for e in _tangents(shape).T]
    slopes.append(noise * np.eye(size))
    root = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(covariance)
    weighed = inverse @ y
    pulls = np.array([float(np.sum(weighed.conj() * (slope @ weighed)).real) for slope in slopes])
    turned = np.stack([inverse @ slope for slope in slopes])
    score = pulls - pieces * np.trace(turned, axis1=1, axis2=2)
    rows = turned.reshape(len(slopes), -1)
    information = pieces * rows @ turned.transpose(0, 2, 1).reshape(len(slopes), -1).T
    square = float(np.sum(y.conj() * weighed).real)
    likelihood = -2.0 * pieces * float(np.sum(np.log(np.diag(root)))) - square
    return Group(frequency_hz, decay_rate, variance, shapes, noise, likelihood, information), score


def _covariance(band: Band, frequency_hz: float, decay_rate: float) -> FloatArray:
    d, a, b = envelope_covariance(band.frequency_hz, np.array(frequency_hz), np.array(decay_rate), band.duration_s)
    return np.diag(d) - np.outer(a, a) + np.outer(b, b)


def _tangents(shape: FloatArray) -> FloatArray:
    """Orthonormal directions (q, q - 1) in which a unit shape (q,) can turn."""
    return np.linalg.svd(shape[None])[2][1:].T


def _stepped(band: Band, group: Group, step: FloatArray) -> tuple[Group, FloatArray]:
    """The group after a step in its unknowns, none of them longer than is safe."""
    q, m = group.shapes.shape
    own = step[:-1].reshape(m, q + 2)
    T = band.duration_s
    widest = _HALF_WIDTHS * np.maximum(group.decay_rate, 0.2 / T) / (2.0 * np.pi)
    grown = np.exp(np.clip(own[:, 1:3], -_LOGARITHM, _LOGARITHM))
    turns = np.clip(own[:, 3:], -_TURN, _TURN)
    shapes = group.shapes + np.stack([_tangents(group.shapes[:, j]) @ turns[j] for j in range(m)], axis=1)
    return scored(
        band,
        group.frequency_hz + np.clip(own[:, 0], -widest, widest),
        np.clip(group.decay_rate * grown[:, 0], _LEAST_DECAY / T, _MOST_DECAY / T),
        group.variance * grown[:, 1],
        shapes / np.linalg.norm(shapes, axis=0),
        group.noise * float(np.exp(np.clip(step[-1], -_LOGARITHM, _LOGARITHM))),
    )
