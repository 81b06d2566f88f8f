"""Synthetic records of a vibrating wing, for the tests of modal identification."""

import numpy as np
import scipy.linalg

AMPLITUDE_MM = {"B1": 20.0, "IP": 12.0, "T1": 3.0, "B2": 2.0}
# name: modes in Hz, duration, rate, grid of points, noise in mm (z axis only)
DECAYS = {
    "D1": ({"B1": 0.72}, 10.2, 10.0, (10, 6), 0.5),
    "D2": ({"B1": 0.72, "T1": 3.0, "B2": 4.2}, 30.0, 20.0, (5, 4), 0.2),
    "D3": ({"B1": 0.73, "IP": 0.76, "T1": 3.0, "B2": 4.2}, 60.0, 20.0, (5, 4), 0.2),
}
DAMPING = 0.005


def grid(nx, ny):
    x, y = np.meshgrid(np.linspace(0.1, 1.0, nx), np.linspace(-0.5, 0.5, ny), indexing="ij")
    return x.ravel(), y.ravel()


def shapes(x, y):
    """Shapes per axis: first and second bending, torsion, in-plane."""

    def cantilever(root):
        k = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))

        def w(s):
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


def pole(frequency_hz, damping=DAMPING):
    w = 2.0 * np.pi * frequency_hz
    return -damping * w + 1j * w * np.sqrt(1.0 - damping**2)


def free_decay(modes, time_s, points, noise_mm, seed, change=0.0):
    """Clean and noisy displacements (T, points); change: share by which frequencies move over the record."""
    rng = np.random.default_rng(seed)
    form = shapes(*grid(*points))
    clean = np.zeros((len(time_s), points[0] * points[1]))
    warped = time_s + change * time_s**2 / (2.0 * time_s[-1])
    for name, f in modes.items():
        s = pole(f)
        phase = rng.uniform(0.0, 2.0 * np.pi)
        wave = np.exp(s.real * time_s) * np.cos(s.imag * warped + phase)
        clean += AMPLITUDE_MM[name] * wave[:, None] * form[name][2]
    return clean, clean + noise_mm * rng.standard_normal(clean.shape)


def published(case, seed):
    """time_s, clean, noisy, poles and noise of one of DECAYS."""
    modes, duration_s, rate_hz, points, noise = DECAYS[case]
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    clean, noisy = free_decay(modes, time_s, points, noise, seed)
    return time_s, clean, noisy, np.array([pole(f) for f in modes.values()]), noise


def stationary(modes, duration_s, rate_hz, points, noise_mm, seed):
    """Displacements (T, points) of modes driven by white force, rms a fifth of the amplitudes; exactly discretised."""
    rng = np.random.default_rng(seed)
    form = shapes(*grid(*points))
    count = round(duration_s * rate_hz)
    y = noise_mm * rng.standard_normal((count, points[0] * points[1]))
    for name, f in modes.items():
        w = 2.0 * np.pi * f
        A = np.array([[0.0, 1.0], [-(w**2), -2.0 * DAMPING * w]])
        force = np.diag([0.0, 1.0])
        block = scipy.linalg.expm(np.block([[-A, force], [np.zeros((2, 2)), A.T]]) / rate_hz)
        step = block[2:, 2:].T
        drive = np.linalg.cholesky(step @ block[:2, 2:])
        settled = scipy.linalg.solve_discrete_lyapunov(step, drive @ drive.T)
        state = np.linalg.cholesky(settled) @ rng.standard_normal(2)
        q = np.empty(count)
        for k in range(count):
            q[k] = state[0]
            state = step @ state + drive @ rng.standard_normal(2)
        y += np.outer(q * AMPLITUDE_MM[name] / 5.0 / np.sqrt(settled[0, 0]), form[name][2])
    return np.arange(count) / rate_hz, y


def flight(ticks, seed, amplitude_mm=(10.0, 1.0, 1.0), noise_mm=0.01, echo=1e-3):
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
