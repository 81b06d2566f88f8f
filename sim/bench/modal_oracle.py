"""What a method could make of a record if it knew all but frequency and damping: the chance that is in the record.

The median error of a few records scatters about the bound's, and no method can undo that. The oracle begins at the
truth and has no function of the flight software. Of a stationary response it knows shapes and noise, and takes the
exact likelihood of the sampled record (Kalman filter) for every mode by itself; of a decay it knows how many modes
there are, and that the noise is white.
"""

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from sim.bench.modal_bounds import uncertainty_law
from sim.bench.modal_records import AMBIENT, AMPLITUDE_MM, DAMPING, DECAYS, grid, pole, shapes
from sim.bench.modal_scores import Found
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Step of the second differences in units of the uncertainty law, and points of the posterior to so many deviations.
_STEP, _POINTS, _REACH, _REACH_UP = 0.3, (13, 21, 13), 4.0, 6.0
# Unit of the force's logarithm.
_FORCE = 0.05


def oracle(case: str, time_s: FloatArray, y: FloatArray) -> list[Found]:
    """Modes of one of DECAYS or AMBIENT, from its stamps (T,) and channels (T, M)."""
    return _of_decay(case, time_s, y) if case in DECAYS else _of_response(case, y)


def _of_decay(case: str, time_s: FloatArray, y: FloatArray) -> list[Found]:
    """Least squares over frequencies and dampings, amplitudes and phases eliminated."""
    frequency_hz = np.array(list(DECAYS[case][0].values()))
    scale = np.column_stack([frequency_hz, np.full(len(frequency_hz), DAMPING)]).ravel()

    def left(unknown: FloatArray) -> FloatArray:
        values = (unknown * scale).reshape(-1, 2)
        waves = np.exp(np.multiply.outer(time_s, [pole(f, damping) for f, damping in values]))
        Q, _ = np.linalg.qr(np.hstack([waves.real, waves.imag]))
        return np.asarray((y - Q @ (Q.T @ y)).ravel())

    found = scipy.optimize.least_squares(left, np.ones(len(scale)), x_scale=np.tile([1e-5, 1e-2], len(frequency_hz)))
    return [Found(float(f), float(damping)) for f, damping in (found.x * scale).reshape(-1, 2)]


def _of_response(case: str, y: FloatArray) -> list[Found]:
    modes, _, rate_hz, points, noise_mm = AMBIENT[case]
    form = shapes(*grid(*points))
    shape = np.stack([form[name][2] for name in modes], axis=1)
    noise = noise_mm**2 * np.diag(np.linalg.inv(shape.T @ shape))
    signals = y @ np.linalg.pinv(shape).T
    return [
        _posterior(np.ascontiguousarray(signals[:, j]), rate_hz, f, (AMPLITUDE_MM[name] / 5.0) ** 2, noise[j])
        for j, (name, f) in enumerate(modes.items())
    ]


def _posterior(signal: FloatArray, rate_hz: float, frequency_hz: float, variance: float, noise: float) -> Found:
    """Mean and deviation of frequency and damping, with Jeffreys' prior of the damping; the force is unknown."""
    law = uncertainty_law(frequency_hz, len(signal) / rate_hz)

    def likelihood(unknown: FloatArray) -> float:
        f, damping, force = _values(unknown)
        step, push, settled = _system(
            f, damping, force * variance * (DAMPING / damping) * (frequency_hz / f) ** 3, rate_hz
        )
        return _kalman(signal, step, push, settled, noise)

    def _values(unknown: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        a, b, c = unknown
        return frequency_hz + a * law[0], DAMPING * np.exp(b * law[1] / DAMPING), np.exp(c * _FORCE)

    start = np.vstack([np.zeros(3), np.eye(3)])
    top = scipy.optimize.minimize(
        lambda u: -likelihood(u),
        np.zeros(3),
        method="Nelder-Mead",
        options={"initial_simplex": start, "xatol": 0.01, "fatol": 0.005},
    ).x
    e = _STEP * np.eye(3)
    curvature = [[sum(s * t * likelihood(top + s * a + t * b) for s in (-1, 1) for t in (-1, 1)) for b in e] for a in e]
    axes = np.linalg.cholesky(np.linalg.inv(-np.array(curvature) / (4.0 * _STEP**2)))
    ends = [(-_REACH, _REACH), (-_REACH, _REACH_UP), (-_REACH, _REACH)]
    along = np.meshgrid(*(np.linspace(*end, count) for end, count in zip(ends, _POINTS, strict=True)), indexing="ij")
    unknown = top[:, None] + axes @ np.reshape(along, (3, -1))
    logarithm = np.array([likelihood(u) for u in unknown.T])
    f, damping, _ = _values(unknown)
    # The points are even in ln damping: a density damping^-1/2 weighs as damping^1/2.
    weight = np.exp(logarithm - logarithm.max()) * np.sqrt(damping)
    weight /= weight.sum()
    f_mean, d_mean = float(weight @ f), float(weight @ damping)
    return Found(
        f_mean, d_mean, float(weight @ (f - f_mean) ** 2) ** 0.5, float(weight @ (damping - d_mean) ** 2) ** 0.5
    )


def _system(
    frequency_hz: float, damping: float, variance: float, rate_hz: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Step (2, 2) of displacement and velocity from sample to sample, covariance of what force adds, and of all."""
    s = pole(frequency_hz, damping)
    omega = 2.0 * np.pi * frequency_hz
    fall, turn = np.exp(s.real / rate_hz), s.imag / rate_hz
    along, across = fall * np.cos(turn), fall * np.sin(turn) / s.imag
    step = np.array([[along - s.real * across, across], [-(omega**2) * across, along + s.real * across]])
    settled = variance * np.diag([1.0, omega**2])
    return step, settled - step @ settled @ step.T, settled


@kernel
def _kalman(signal: FloatArray, step: FloatArray, push: FloatArray, settled: FloatArray, noise: float) -> float:
    """Log likelihood of a signal (T,): the first state, from its stationary distribution on, in white noise."""
    x, v, total = 0.0, 0.0, 0.0
    xx, xv, vv = settled[0, 0], settled[0, 1], settled[1, 1]
    (a, b), (c, d) = step
    for measured in signal:
        innovation, variance = measured - x, xx + noise
        total -= 0.5 * (innovation**2 / variance + np.log(variance))
        gain, its_gain = xx / variance, xv / variance
        x, v = x + gain * innovation, v + its_gain * innovation
        vv, xv, xx = vv - its_gain * xv, xv * (1.0 - gain), xx * (1.0 - gain)
        x, v = a * x + b * v, c * x + d * v
        left, right = a * xx + b * xv, a * xv + b * vv
        vv = c * (c * xx + d * xv) + d * (c * xv + d * vv) + push[1, 1]
        xx, xv = left * a + right * b + push[0, 0], left * c + right * d + push[0, 1]
    return total
