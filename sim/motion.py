"""How the wing moves: each mode a damped oscillator, in free decay or driven by white force; both solved exactly."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Oscillator:
    """One mode's motion at the wing's tip.

    amplitude_mm: of a decay at time 0, or the rms of a stationary random motion; phase_rad: of the decay's cosine.
    """

    frequency_hz: float
    damping_ratio: float
    amplitude_mm: float
    kind: Literal["decay", "random"]
    phase_rad: float = 0.0


def free_decay(mode: Oscillator, time_s: FloatArray) -> FloatArray:
    """Tip displacement in mm at times (T,): a exp(-zeta w t) cos(w sqrt(1 - zeta^2) t + phase)."""
    omega = 2.0 * np.pi * mode.frequency_hz
    damped = omega * np.sqrt(1.0 - mode.damping_ratio**2)
    return mode.amplitude_mm * np.exp(-mode.damping_ratio * omega * time_s) * np.cos(damped * time_s + mode.phase_rad)


def stationary_random(mode: Oscillator, step_s: float, count: int, draw: np.random.Generator) -> FloatArray:
    """Tip displacement in mm (count,) under white force, stationary from the first sample.

    The exact discrete solution: with the transition matrix F of one step and the stationary covariance P of (x, v), the
    step's noise has covariance P - F P F^T (Lyapunov). No time step is too long for it.
    """
    omega, zeta = 2.0 * np.pi * mode.frequency_hz, mode.damping_ratio
    transition = scipy.linalg.expm(np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]) * step_s)
    stationary = mode.amplitude_mm**2 * np.diag([1.0, omega**2])
    step_noise = np.linalg.cholesky(stationary - transition @ stationary @ transition.T)
    noise = draw.standard_normal((count, 2))
    state = np.sqrt(np.diag(stationary)) * noise[0]
    out = np.empty(count)
    out[0] = state[0]
    for k in range(1, count):
        state = transition @ state + step_noise @ noise[k]
        out[k] = state[0]
    return out


def tip_motion(modes: Sequence[Oscillator], times_ns: NDArray[np.int64], seed: int) -> FloatArray:
    """Tip displacement in mm (T, M) of modes at evenly spaced times (T,), each with a random stream of its own."""
    time_s: FloatArray = times_ns.astype(np.float64) * 1e-9
    step_s = float(time_s[-1] - time_s[0]) / max(1, len(time_s) - 1)
    columns = []
    for number, mode in enumerate(modes):
        draw = np.random.default_rng([seed, number])
        decay = mode.kind == "decay"
        columns.append(free_decay(mode, time_s) if decay else stationary_random(mode, step_s, len(time_s), draw))
    return np.stack(columns, axis=1)
