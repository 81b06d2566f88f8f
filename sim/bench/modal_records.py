"""Synthetic records of a vibrating wing, with known modes: the bench and the tests share this one generator."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.interpolate
import scipy.linalg
import scipy.signal
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Shapes = dict[str, tuple[FloatArray, FloatArray, FloatArray]]

AMPLITUDE_MM = {"B1": 20.0, "IP": 12.0, "T1": 3.0, "B2": 2.0}
DAMPING = 0.005
_THREE = {"B1": 0.72, "T1": 3.0, "B2": 4.2}
_FOUR = {"B1": 0.73, "IP": 0.76, "T1": 3.0, "B2": 4.2}
# name: modes in Hz, duration, rate, grid of points, noise in mm (z axis only)
DECAYS = {
    "D1": ({"B1": 0.72}, 10.2, 10.0, (10, 6), 0.5),
    "D2": (_THREE, 30.0, 20.0, (5, 4), 0.2),
    "D3": (_FOUR, 60.0, 20.0, (5, 4), 0.2),
    "D4": (_THREE, 10.0, 46.0, (10, 6), 0.5),
}
AMBIENT = {
    "A1": (_THREE, 120.0, 20.0, (5, 4), 0.2),
    "A2": (_FOUR, 120.0, 20.0, (5, 4), 0.2),
}
# Samples of a steady record for one of a record that moves.
_OFTEN = 8
# The wing of 17 x 18 points x 3 axes that is followed on board, at the cameras' rate.
ON_BOARD = (_FOUR, 46.0, (17, 18), 0.5)


@dataclass(frozen=True)
class FreeDecay:
    """A record that is a sum of damped sinusoids in white noise, with all that is true of it.

    time_s (T,); clean, noisy (T, M) in mm; frequency_hz (m,); amplitude_mm, phase_rad (m,); shape (m, M), 1 at the tip.
    """

    time_s: FloatArray
    clean: FloatArray
    noisy: FloatArray
    frequency_hz: FloatArray
    amplitude_mm: FloatArray
    phase_rad: FloatArray
    shape: FloatArray
    noise_mm: float
    damping: float = DAMPING


def grid(nx: int, ny: int) -> tuple[FloatArray, FloatArray]:
    """Points x, y (nx ny,) of the wing: root at x = 0, tip at 1, y across."""
    x, y = np.meshgrid(np.linspace(0.1, 1.0, nx), np.linspace(-0.5, 0.5, ny), indexing="ij")
    return x.ravel(), y.ravel()


def shapes(x: FloatArray, y: FloatArray) -> Shapes:
    """Shapes (N,) per axis x, y, z: first and second bending, torsion, in-plane."""

    def cantilever(root: float) -> FloatArray:
        k = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))

        def w(s: FloatArray | float) -> FloatArray:
            return np.cosh(root * s) - np.cos(root * s) - k * (np.sinh(root * s) - np.sin(root * s))

        return w(x) / w(1.0)

    z1, z2, t, none = cantilever(1.87510407), cantilever(4.69409113), 2.0 * y * np.sin(np.pi * x / 2.0), 0.0 * x
    in_plane = 0.6 * z1 * np.sign(x - 0.55) + 0.5 * z1 * y
    return {
        "B1": (0.03 * z1, none, z1),
        "B2": (none, none, z2),
        "T1": (none, 0.1 * t, t),
        "IP": (none, 0.8 * z1, in_plane),
    }


def pole(frequency_hz: float, damping: float = DAMPING) -> complex:
    """Continuous pole in 1/s."""
    w = 2.0 * np.pi * frequency_hz
    return -damping * w + 1j * w * np.sqrt(1.0 - damping**2)


def free_decay(
    modes: dict[str, float],
    time_s: FloatArray,
    points: tuple[int, int],
    noise_mm: float,
    seed: int,
    change: float = 0.0,
    axes: slice = slice(2, 3),
    damping: float = DAMPING,
) -> FreeDecay:
    """A free decay seen at a grid of points, out of the plane or along all axes.

    modes: name and Hz; change: share by which the frequencies move over the record; axes: of x, y, z.
    """
    rng = np.random.default_rng(seed)
    form = shapes(*grid(*points))
    shape = np.array([np.concatenate(form[name][axes]) for name in modes])
    clean = np.zeros((len(time_s), shape.shape[1]))
    warped = time_s + change * time_s**2 / (2.0 * time_s[-1])
    phases = []
    for j, (name, f) in enumerate(modes.items()):
        s = pole(f, damping)
        phases.append(rng.uniform(0.0, 2.0 * np.pi))
        wave = np.exp(s.real * time_s) * np.cos(s.imag * warped + phases[-1])
        clean += AMPLITUDE_MM[name] * wave[:, None] * shape[j]
    return FreeDecay(
        time_s=time_s,
        clean=clean,
        noisy=clean + noise_mm * rng.standard_normal(clean.shape),
        frequency_hz=np.array(list(modes.values())),
        amplitude_mm=np.array([AMPLITUDE_MM[name] for name in modes]),
        phase_rad=np.array(phases),
        shape=shape,
        noise_mm=noise_mm,
        damping=damping,
    )


def published(case: str, seed: int, stamps: Callable[[FloatArray], FloatArray] = lambda time_s: time_s) -> FreeDecay:
    """One of DECAYS; stamps: what becomes of the even time stamps (T,), for dropped frames and jitter."""
    modes, duration_s, rate_hz, points, noise = DECAYS[case]
    time_s = stamps(np.arange(round(duration_s * rate_hz)) / rate_hz)
    return free_decay(modes, time_s, points, noise, seed)


def stationary(
    modes: dict[str, float],
    duration_s: float,
    rate_hz: float,
    points: tuple[int, int],
    noise_mm: float,
    seed: int,
    axes: slice = slice(2, 3),
) -> tuple[FloatArray, FloatArray]:
    """Displacements (T, M) of modes driven by white force, rms a fifth of the amplitudes; exactly discretised.

    axes: of x, y, z; M points of one axis after those of the other.
    """
    rng = np.random.default_rng(seed)
    form = shapes(*grid(*points))
    shape = {name: np.concatenate(form[name][axes]) for name in modes}
    count = round(duration_s * rate_hz)
    y = noise_mm * rng.standard_normal((count, len(next(iter(shape.values())))))
    for name, f in modes.items():
        w = 2.0 * np.pi * f
        A = np.array([[0.0, 1.0], [-(w**2), -2.0 * DAMPING * w]])
        force = np.diag([0.0, 1.0])
        block = scipy.linalg.expm(np.block([[-A, force], [np.zeros((2, 2)), A.T]]) / rate_hz)
        step = block[2:, 2:].T
        drive = np.linalg.cholesky(step @ block[:2, 2:])
        settled = scipy.linalg.solve_discrete_lyapunov(step, drive @ drive.T)
        pushes = np.vstack([np.linalg.cholesky(settled) @ rng.standard_normal(2), _pushes(rng, count - 1, drive)])
        q = _response(step, pushes)
        y += np.outer(q * AMPLITUDE_MM[name] / 5.0 / np.sqrt(settled[0, 0]), shape[name])
    return np.arange(count) / rate_hz, y


def moving(case: str, seed: int, change: float) -> tuple[FloatArray, FloatArray]:
    """One of AMBIENT whose frequencies move evenly by a share of themselves over the record, about their values.

    Time runs at a pace that changes, over a steady record without noise that is sampled far more often.
    """
    modes, duration_s, rate_hz, points, noise_mm = AMBIENT[case]
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    own_s = time_s + change * time_s * (time_s - duration_s) / (2.0 * duration_s)
    fine_s, clean = stationary(modes, duration_s, _OFTEN * rate_hz, points, 0.0, seed)
    y = scipy.interpolate.CubicSpline(fine_s, clean)(own_s)
    return time_s, y + noise_mm * np.random.default_rng([seed, 1]).standard_normal(y.shape)


def _pushes(rng: np.random.Generator, count: int, drive: FloatArray) -> FloatArray:
    return rng.standard_normal((count, 2)) @ drive.T


def _response(step: FloatArray, pushes: FloatArray) -> FloatArray:
    """First state (T,) of x[t] = step x[t - 1] + pushes[t], as a recursion of second order in one channel."""
    trace, determinant = float(np.trace(step)), float(np.linalg.det(step))
    # Eliminating the second state: (1 - tr q + det q^2) x1 = (1 - step22 q) w1 + step12 q w2.
    ahead = scipy.signal.lfilter([1.0, -step[1, 1]], [1.0, -trace, determinant], pushes[:, 0])
    return ahead + scipy.signal.lfilter([0.0, step[0, 1]], [1.0, -trace, determinant], pushes[:, 1])


def flight(
    ticks: int,
    seed: int,
    amplitude_mm: tuple[float, ...] = (10.0, 1.0, 1.0),
    noise_mm: float = 0.01,
    echo: float = 1e-3,
) -> tuple[FloatArray, FloatArray]:
    """What the cameras see: 255 cells x 3 axes at 15 Hz, smooth and white errors, 2 % missing, weak echoes."""
    rng = np.random.default_rng(seed)
    x, y = grid(15, 17)
    form = shapes(x, y)
    time_s = np.arange(ticks) / 15.0
    record = np.zeros((ticks, 3 * len(x)))
    for name, f, damping, a in zip(
        ("B1", "B2", "T1"), (0.7146, 2.31, 4.37), (0.006, 0.009, 0.008), amplitude_mm, strict=True
    ):
        wave = np.exp(pole(f, damping) * time_s + 1j * rng.uniform(0.0, 2.0 * np.pi)).real
        record += a * np.outer(wave, np.concatenate(form[name]))
    out_of_plane = record[:, 2 * len(x) :]
    largest = max(float(np.max(np.abs(out_of_plane))), 1e-9)
    record += echo * np.tile(out_of_plane**2 / largest + 0.3 * out_of_plane**3 / largest**2, 3)
    smooth = np.stack([np.ones_like(x), x, y, x * y, x * x])
    record += 0.5 * noise_mm * np.hstack([rng.standard_normal((ticks, 5)) @ smooth for _ in range(3)])
    record += noise_mm * np.repeat([1.0, 1.0, 3.0], len(x)) * rng.standard_normal(record.shape)
    record[rng.uniform(size=record.shape) < 0.02] = np.nan
    return time_s, record
