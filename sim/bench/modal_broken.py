"""Records that break: in the middle the wing is struck, stopped or held, or all channels jump to another level."""

from dataclasses import dataclass

import numpy as np
import scipy.signal

from fsw.modal.result import ModalResult
from sim.bench.modal_records import AMBIENT, AMPLITUDE_MM, DAMPING, DECAYS, FloatArray, grid, pole, shapes

BREAKS = ("struck", "stopped", "held", "jump")
"""Struck: each mode gets a velocity. Stopped: each mode keeps a share of its motion. Held: the wing stands still from
then on, where it was or at rest. Jump: each channel goes on about another level.
"""
MISLEADING_SIGMAS, MISLEADING_SHARE = 4.0, 5e-4
"""A valid mode misleads if its frequency or damping is off by more than so many of its sigmas and such a share."""
# Duration of a decay, where it breaks as a share of it, and sizes: of a blow as a share of the first amplitudes (powers
# of ten), what a stop leaves, and of a jump in mm (powers of ten).
_DURATION_S = (30.0, 120.0)
_PLACE, _BLOW, _LEFT, _JUMP_MM = (0.2, 0.8), (-1.0, 0.3), (0.0, 0.5), (-0.5, 1.3)


@dataclass(frozen=True)
class Broken:
    """A record (T,), (T, M) in mm; its modes (m,) in Hz, of the damping of all records; when it breaks, if it does."""

    time_s: FloatArray
    y: FloatArray
    frequency_hz: FloatArray
    break_s: float


def broken(kind: str, motion: str, seed: int) -> Broken:
    """A record of D2's and D3's modes in turn, in "decay" or "ambient" motion, that breaks; kind: of BREAKS, or "none".

    The place, the size and the decay's length are random. A driven mode is a first-order complex envelope.
    """
    draw = np.random.default_rng([seed, *map(ord, kind + motion)])
    table, case = (DECAYS, ("D2", "D3")[seed % 2]) if motion == "decay" else (AMBIENT, ("A1", "A2")[seed % 2])
    modes, duration_s, rate_hz, points, noise_mm = table[case]
    duration_s = float(draw.uniform(*_DURATION_S)) if motion == "decay" else duration_s
    count = round(duration_s * rate_hz)
    place = float(draw.uniform(*_PLACE)) * count
    first = int(place) + 1
    left = float(draw.uniform(*_LEFT)) if kind == "stopped" else 1.0
    form = shapes(*grid(*points))
    clean = np.zeros((count, points[0] * points[1]))
    for name, hz in modes.items():
        amplitude_mm = AMPLITUDE_MM[name]
        step = np.exp(pole(hz) / rate_hz)
        drive = draw.standard_normal((2, count)).T @ (1.0, 1j)
        if motion == "decay":
            drive = np.where(np.arange(count) == 0, amplitude_mm * drive / abs(drive[0]), 0.0)
        else:
            amplitude_mm /= 5.0
            drive *= amplitude_mm * np.where(np.arange(count) == 0, 1.0, np.sqrt(1.0 - abs(step) ** 2))
        if kind == "struck":
            blow_mm = amplitude_mm * 10.0 ** draw.uniform(*_BLOW) * draw.choice((-1.0, 1.0))
            drive[first] += 1j * blow_mm * step ** (first - place)
        before = scipy.signal.lfilter([1.0], [1.0, -step], drive[:first])
        after, _ = scipy.signal.lfilter([1.0], [1.0, -step], drive[first:], zi=[left * step * before[-1]])
        clean += np.outer(np.concatenate([before, after]).real, form[name][2])
    if kind == "held":
        clean[first:] = clean[first - 1] * float(draw.integers(2))
    if kind == "jump":
        clean[first:] += 10.0 ** draw.uniform(*_JUMP_MM) * draw.standard_normal(clean.shape[1])
    y = clean + noise_mm * draw.standard_normal(clean.shape)
    return Broken(np.arange(count) / rate_hz, y, np.array(list(modes.values())), place / rate_hz)


def misleads(frequency_hz: FloatArray, found: ModalResult) -> bool:
    """Whether a valid mode's frequency or damping is off by far more than its interval says.

    frequency_hz (m,): those of the true modes.
    """
    for mode in found.valid_modes:
        hz = frequency_hz[np.argmin(np.abs(frequency_hz - mode.frequency_hz))]
        off, truth = np.abs([mode.frequency_hz - hz, mode.damping_ratio - DAMPING]), np.array([hz, DAMPING])
        sigmas = np.array([mode.frequency_sigma_hz, mode.damping_ratio_sigma])
        if np.any(off > np.maximum(MISLEADING_SIGMAS * sigmas, MISLEADING_SHARE * truth)):
            return True
    return False
