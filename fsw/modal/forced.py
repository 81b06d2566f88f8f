"""Modes of a system whose inputs are measured: its own poles, also while a control loop is closed round it.

A loop's torque is an input like any other once it is measured: what is left between torque and displacement is the
plant alone, whose pole a notch filter needs. OKID finds the plant's Markov parameters, ERA its poles, and least squares
of free decay plus response to the input refine them. Source: Juang, Phan, Horta and Longman, 1993 (OKID).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.clustering import LEAST_ORDERS, Pole, cluster, stabilisation
from fsw.modal.coordinates import Coordinates, even_grid
from fsw.modal.gates import LARGEST_DECAY_FREQUENCY_SIGMA, common_flags
from fsw.modal.realisation import realise
from fsw.modal.result import Mode, Options, normalised
from fsw.modal.uncertainty import pole_to_modal
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Coordinates kept: the observer has two unknown matrices for each of its lags.
_COORDINATES = 4
# Samples for each unknown of the observer, at least.
_SAMPLES_OF_AN_UNKNOWN = 4
# Steps of the refinement and trials of each; how far a pole moves in one, and steps of its differences, in 1 / T.
_STEPS, _TRIALS, _LONGEST, _DIFFERENCE = 40, 5, 1.5, 1e-4
_LEAST_CAUTION = 1e-8
# Relative fall of the cost below which the search has arrived.
_ARRIVED = 1e-10
# Poles of the free record begin here, and only where the observer found none within this share of the frequency.
_STARTING_DAMPING, _SAME = 0.01, 0.05
# What is left of the signals, against the floor of its own spectrum, when the model explains them.
_LARGEST_LEFT = 2.0
# A mode must explain this share of what the record holds, beyond noise in so many deviations.
_DEVIATIONS = 6.0


@dataclass(frozen=True)
class _Start:
    """Where the refinement of a pole begins, 1/s, and the indicators of where it came from."""

    s: complex
    coherence: float
    singular_value: float


@dataclass(frozen=True)
class _Driven:
    """Poles (m,) 1/s of least squares; covariance (2 m, 2 m) of (Re, Im); weights of all columns; statistic (m,);
    left: mean square of the residual over its floor, 1 where only white noise is left.
    """

    poles: ComplexArray
    covariance: FloatArray
    weights: FloatArray
    significance: FloatArray
    left: float


def identify_forced(
    coordinates: Coordinates, u: FloatArray, free: Sequence[Mode], options: Options
) -> tuple[list[Mode], list[Pole]]:
    """Modes of the plant between measured inputs u (T, inputs) and the channels; poles for the diagram.

    u: at the coordinates' time stamps, held from each to the next. free: modes of the same record without inputs, from
    which the search begins as well: the loop has moved them, but not far.
    """
    rate_hz = coordinates.rate_hz
    signals = even_grid(coordinates.time_s, coordinates.signals[:, :_COORDINATES], rate_hz)
    torque = even_grid(coordinates.time_s, u, rate_hz)
    torque = torque / np.maximum(np.std(torque, axis=0), 1e-300)
    rows = min(options.block_rows, len(signals) // (_SAMPLES_OF_AN_UNKNOWN * (signals.shape[1] + torque.shape[1])))
    if rows < 3:
        return [], []
    system = realise(markov_parameters(signals, torque, rows), rows, rows, options.order)
    poles = stabilisation(system, rate_hz, rows, (0.0, 0.5 * rate_hz))
    found = [_Start(c.pole.s, c.pole.coherence, c.pole.singular_value) for c in cluster(poles, LEAST_ORDERS)]
    for mode in free:
        s = 2.0 * np.pi * mode.frequency_hz * (-_STARTING_DAMPING + 1j)
        if not any(abs(s.imag - other.s.imag) < _SAME * s.imag for other in found):
            found.append(_Start(s, mode.amplitude_coherence, mode.singular_value))
    found = [start for start in found if start.s.imag * len(signals) / rate_hz > 4.0 * np.pi][: options.most_modes]
    while found:
        driven = _refine(signals, torque, rate_hz, np.array([start.s for start in found]), options.drift_degree)
        weakest = int(np.argmin(driven.significance))
        if driven.significance[weakest] > _DEVIATIONS:
            return [_mode(j, start, driven, coordinates) for j, start in enumerate(found)], poles
        found = found[:weakest] + found[weakest + 1 :]
    return [], poles


def markov_parameters(y: FloatArray, u: FloatArray, lags: int) -> FloatArray:
    """Pulse response (2 lags, p, m) of outputs y (T, p) to inputs u (T, m), through an observer of so many lags.

    The observer forgets the initial state after its lags, and the least squares are exact without noise.
    """
    p, m = y.shape[1], u.shape[1]
    count = len(y) - lags
    past = [np.hstack([y[lags - k : lags - k + count], u[lags - k : lags - k + count]]) for k in range(1, lags + 1)]
    regressor = np.hstack([u[lags:], *past, np.ones((count, 1))])
    solution = np.linalg.lstsq(regressor, y[lags:], rcond=1e-12)[0].T
    direct = solution[:, :m]
    observer = solution[:, m : m + lags * (p + m)].reshape(p, lags, p + m)
    pulse = [direct]
    for k in range(1, 2 * lags + 1):
        now = observer[:, k - 1, p:] if k <= lags else np.zeros((p, m))
        pulse.append(now + sum(observer[:, i - 1, :p] @ pulse[k - i] for i in range(1, min(k, lags) + 1)))
    return np.stack(pulse[1:])


def _columns(poles: ComplexArray, u: FloatArray, rate_hz: float, drift_degree: int) -> FloatArray:
    """The linear model (T, n): per pole its free decay and its response to each input, then drift."""
    step = np.arange(len(u))
    columns = []
    for s in poles:
        waves = [np.exp(s * step / rate_hz)]
        waves += [_driven(np.exp(s / rate_hz), u[:, i].copy()) for i in range(u.shape[1])]
        columns += [part for wave in waves for part in (wave.real, wave.imag)]
    drift = np.polynomial.legendre.legvander(2.0 * step / max(len(u) - 1, 1) - 1.0, drift_degree)
    return np.hstack([np.stack(columns, axis=1), drift])


@kernel
def _driven(step: complex, u: FloatArray) -> ComplexArray:
    """Response (T,) to an input u (T,), at rest before: x[k + 1] = step x[k] + u[k]."""
    x = np.zeros(len(u), np.complex128)
    for k in range(len(u) - 1):
        x[k + 1] = step * x[k] + u[k]
    return x


def _refine(y: FloatArray, u: FloatArray, rate_hz: float, poles: ComplexArray, drift_degree: int) -> _Driven:
    """Steps of Levenberg and Marquardt by variable projection, with differences for the Jacobian."""
    duration_s = len(y) / rate_hz
    difference = _DIFFERENCE / duration_s

    def left(values: FloatArray) -> FloatArray:
        Q, _ = np.linalg.qr(_columns(values[0::2] + 1j * values[1::2], u, rate_hz, drift_degree))
        return (y - Q @ (Q.T @ y)).ravel()

    values = np.stack([poles.real, poles.imag], axis=1).ravel()
    residual = left(values)
    J = np.zeros((len(residual), len(values)))
    caution = _LEAST_CAUTION
    for _ in range(_STEPS):
        for k in range(len(values)):
            moved = values.copy()
            moved[k] += difference
            J[:, k] = (left(moved) - residual) / difference
        # Each pole has a limit of its own: one that is hardly known must not hold up the others.
        scale = np.sqrt(np.sum(J**2, axis=0)) + 1e-300
        unit = J / scale
        normal, pull = unit.T @ unit, -unit.T @ residual
        before = float(residual @ residual)
        for _ in range(_TRIALS):
            step = np.linalg.solve(normal + caution * np.eye(len(scale)), pull) / scale
            step /= np.maximum(np.abs(step[0::2] + 1j * step[1::2]) * duration_s / _LONGEST, 1.0).repeat(2)
            trial = left(values + step)
            if float(trial @ trial) < before:
                values, residual, caution = values + step, trial, max(0.1 * caution, _LEAST_CAUTION)
                break
            caution = max(10.0 * caution, 1e-4)
        if before - float(residual @ residual) <= _ARRIVED * before:
            break
    basis = _columns(values[0::2] + 1j * values[1::2], u, rate_hz, drift_degree)
    # Columns of one length: what falls or grows fast would else make all of them look alike to rounding.
    length = np.linalg.norm(basis, axis=0) + 1e-300
    basis = basis / length
    weights = np.linalg.lstsq(basis, y, rcond=1e-12)[0]
    freedom = max(y.size - weights.size - len(values), 1)
    noise = float(residual @ residual) / freedom
    spread = np.linalg.pinv(basis.T @ basis, rcond=1e-14, hermitian=True)
    wide = 2 * (1 + u.shape[1])
    significance = np.empty(len(poles))
    for j in range(len(poles)):
        part = slice(wide * j + 2, wide * (j + 1))  # what the input drives: the free decay alone tells no plant
        inverse = np.linalg.pinv(spread[part, part], hermitian=True)
        energy = float(np.sum(weights[part] * (inverse @ weights[part])))
        significance[j] = (energy / max(noise, 1e-300) / weights[part].size) ** 0.5
    covariance = noise * np.linalg.pinv(J.T @ J, rcond=1e-14, hermitian=True)
    return _Driven(
        values[0::2] + 1j * values[1::2],
        np.asarray(covariance, np.float64),
        np.asarray(weights / length[:, None], np.float64),
        significance,
        noise / _floor(residual.reshape(y.shape)),
    )


def _floor(residual: FloatArray) -> float:
    """Mean square of the white noise whose periodogram has the same median."""
    power = np.abs(np.fft.rfft(residual, axis=0)) ** 2 / len(residual)
    return max(float(np.mean(np.median(power, axis=0))) / float(np.log(2.0)), 1e-300)


def _mode(j: int, start: _Start, driven: _Driven, coordinates: Coordinates) -> Mode:
    s = complex(driven.poles[j])
    slope = pole_to_modal(s)
    spread = slope @ driven.covariance[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] @ slope.T
    sigma_hz, sigma_damping = (float(value) for value in np.sqrt(np.diag(spread)))
    f, damping = abs(s) / (2.0 * np.pi), -s.real / abs(s)
    coherence = start.coherence
    flags = common_flags(f, sigma_hz, damping, coherence, coordinates.rate_hz, float(coordinates.time_s[-1]))
    if not sigma_hz < LARGEST_DECAY_FREQUENCY_SIGMA * f:
        flags.append("imprecise")
    if damping <= 0.0:
        flags.append("growing")
    if driven.left > _LARGEST_LEFT:
        flags.append("not_exponential")
    wide = len(driven.weights) // len(driven.poles)
    free = driven.weights[wide * j] - 1j * driven.weights[wide * j + 1]
    basis = coordinates.basis[:, : len(free)]
    return Mode(
        frequency_hz=f,
        frequency_sigma_hz=sigma_hz,
        damping_ratio=damping,
        damping_ratio_sigma=sigma_damping,
        amplitude=float(np.max(np.abs(basis @ free))),
        amplitude_coherence=coherence,
        singular_value=start.singular_value,
        shape=normalised(basis @ free, coordinates.live),
        valid=not flags,
        flags=sorted(set(flags)),
    )
