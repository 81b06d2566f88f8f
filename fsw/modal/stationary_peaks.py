"""Peaks of a stationary response that the subspace method did not see as what they are.

It may take two modes for one, where only the direction of their motion tells.
With few time constants in a record the peak of one mode may fall in two by chance, and then each order puts its poles
elsewhere under it, too far from each other to make a cluster. That they lie under it, with its shape, is as good a
sign of a mode.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from fsw.modal.ambient import weigh_peak
from fsw.modal.clustering import Candidate, Pole
from fsw.modal.gates import LEAST_CYCLES, LEAST_GAIN, LEAST_ORDERS, LEAST_RISE
from fsw.modal.stationary_likelihood import half_band_hz

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Modes that are refined together at most, and coefficients that a band must hold.
MOST, LEAST_COEFFICIENTS = 3, 5
# Damping that a search starts from, and the most that makes a band wider.
LEAST_DAMPING, MOST_DAMPING = 5e-4, 0.15
# A direction of a band's motion has at least so much more power than the least.
CLEAR = 4.0
# A direction holds a mode of its own if its tallest coefficient is so many times the middle one, and if the others
# explain less than this share of it.
_TALLEST, _IN_STEP = 3.0, 0.5
# A peak is the tallest within so many 1 / T to either side, and so many times the middle of the spectrum there.
_NEAR, _TALL = 16, 10.0
# Poles are under a peak within so many of its widths, if their shapes are so much alike.
_WIDTHS, _ALIKE = 3.0, 0.8


def reach(
    frequency_hz: FloatArray, damping: FloatArray, signals: FloatArray, rate_hz: float
) -> tuple[float, float, slice]:
    """Ends in Hz of the band of some modes, and where it is in the signals' spectrum."""
    half_hz = [reach_hz(f, z, signals, rate_hz) for f, z in zip(frequency_hz, damping, strict=True)]
    low_hz, high_hz = float(np.min(frequency_hz - half_hz)), float(np.max(frequency_hz + half_hz))
    bins = len(signals) / rate_hz
    return low_hz, high_hz, slice(max(int(np.ceil(low_hz * bins)), 0), int(high_hz * bins) + 1)


def reach_hz(frequency_hz: float, damping_ratio: float, signals: FloatArray, rate_hz: float) -> float:
    """How far a mode's band reaches to either side."""
    damping = float(np.clip(damping_ratio, 0.0, MOST_DAMPING))
    return half_band_hz(frequency_hz, damping, len(signals) / rate_hz)


def hidden(members: list[Candidate], signals: FloatArray, spectrum: ComplexArray, rate_hz: float) -> list[Candidate]:
    """The mode that the subspace method took for one with the members, if there is one.

    Their band then moves in one direction more than there are members, with a peak there. What moves in step with the
    members is no mode of its own: their shapes are not quite real.
    """
    first, count = members[0], len(members)
    hz, damping = np.array([(c.frequency_hz, c.damping_ratio) for c in members]).T
    inside = reach(hz, damping, signals, rate_hz)[2]
    X = spectrum[inside]
    if len(X) < LEAST_COEFFICIENTS or not count < min(MOST, X.shape[1]):
        return []
    power, axes = directions(X)
    along, across = X @ axes[:, :count], X @ axes[:, count]
    tall = np.max(np.abs(across)) > _TALLEST * np.median(np.abs(across))
    if power[count] < CLEAR * power[-1] or not tall:
        return []
    in_step = along @ np.linalg.lstsq(along, across)[0]
    if np.linalg.norm(in_step) ** 2 > _IN_STEP * np.linalg.norm(across) ** 2:
        return []
    peak_hz = (inside.start + int(np.argmax(np.abs(across)))) * rate_hz / len(signals)
    zeta = float(np.clip(first.damping_ratio, LEAST_DAMPING, MOST_DAMPING))
    peak = weigh_peak(signals @ axes[:, count], rate_hz, peak_hz, zeta)
    if peak is None or peak.gain < LEAST_GAIN or peak.rise < LEAST_RISE:
        return []
    strength = first.pole.singular_value * float(np.sqrt(power[count] / power[0]))
    pole = replace(first.pole, shape=axes[:, count].astype(np.complex128), singular_value=strength)
    return [Candidate(pole, LEAST_ORDERS, peak_hz, zeta)]


def directions(X: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Power (p,) and orthonormal directions (p, p) of the motion in a band of a spectrum (K, p), strongest first."""
    power, axes = np.linalg.eigh((X.conj().T @ X).real)
    return power[::-1], axes[:, ::-1]


@dataclass(frozen=True)
class Seen:
    """Poles of all orders (k,), and what they are looked up by: order, frequency in Hz (k,), unit shapes (k, p)."""

    poles: list[Pole]
    order: NDArray[np.int64]
    frequency_hz: FloatArray
    shapes: ComplexArray

    def under(self, frequency_hz: float, within_hz: float, shape: FloatArray) -> NDArray[np.intp]:
        """Places of those near a peak of this shape (p,), which has unit length."""
        near = np.abs(self.frequency_hz - frequency_hz) < within_hz
        return np.flatnonzero(near & (np.abs(self.shapes @ shape) ** 2 > _ALIKE))

    def orders_under(self, candidate: Candidate, duration_s: float) -> int:
        """Orders with a pole under a candidate's peak, whether they make a cluster or not."""
        within_hz = _WIDTHS * width_hz(candidate, duration_s)
        return len(set(self.order[self.under(candidate.frequency_hz, within_hz, candidate.pole.shape.real)].tolist()))


def seen(poles: list[Pole], width: int) -> Seen:
    """Poles of a stabilisation diagram, in so many coordinates."""
    shapes = np.array([pole.shape for pole in poles], np.complex128).reshape(len(poles), width)
    order, hz = np.array([pole.order for pole in poles], np.int64), np.abs([pole.s for pole in poles]) / (2.0 * np.pi)
    return Seen(poles, order, hz, shapes / np.maximum(np.linalg.norm(shapes, axis=1, keepdims=True), 1e-300))


def width_hz(candidate: Candidate, duration_s: float) -> float:
    """Half the width of a candidate's peak, never below 1 / T."""
    return max(candidate.damping_ratio, 0.0) * candidate.frequency_hz + 1.0 / duration_s


def overlooked(
    found: list[Candidate], diagram: Seen, signals: FloatArray, spectrum: ComplexArray, rate_hz: float
) -> list[Candidate]:
    """A candidate for each peak that none of those found is near, but poles of enough orders are.

    signals (T, p) of noise that is alike in all, without their mean; spectrum (K, p): of them.
    """
    duration_s = len(signals) / rate_hz
    power = np.sum(spectrum.real**2 + spectrum.imag**2, axis=1)
    tall = power == maximum_filter1d(power, 2 * _NEAR + 1)
    tall[: int(LEAST_CYCLES) + 1] = False
    candidates = []
    for place in map(int, np.flatnonzero(tall)):
        hz = place / duration_s
        about = slice(max(place - _NEAR, 0), place + _NEAR + 1)
        if power[place] < _TALL * np.median(power[about]) or any(
            abs(c.frequency_hz - hz) < _WIDTHS * width_hz(c, duration_s) for c in found
        ):
            continue
        direction = directions(spectrum[about])[1][:, 0]
        poles = [diagram.poles[i] for i in diagram.under(hz, _WIDTHS / duration_s, direction)]
        count = len({pole.order for pole in poles})
        stable = sorted((p for p in poles if p.stable), key=lambda p: (p.damping_ratio, p.order))
        if count < LEAST_ORDERS or not stable:
            continue
        middle = stable[len(stable) // 2]
        damping = max(middle.damping_ratio, 1.0 / (hz * duration_s))
        peak = weigh_peak(signals @ direction, rate_hz, hz, damping)
        if peak is not None and peak.gain > LEAST_GAIN and peak.rise > LEAST_RISE:
            candidates.append(Candidate(middle, count, hz, damping))
    return candidates
