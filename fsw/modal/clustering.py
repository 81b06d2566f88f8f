"""Poles of many orders gathered into physical modes: the stabilisation diagram and its clusters."""

from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from fsw.modal.indicators import amplitude_coherence, modal_singular_value
from fsw.modal.realisation import Realisation, continuous, frequency_and_damping, poles_of_orders

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# A pole is stable if the next lower order has one like it, and joins a cluster under the same limits.
FREQUENCY_TOLERANCE = 0.01
DAMPING_TOLERANCE = 0.003
DAMPING_SHARE = 0.3
SHAPE_TOLERANCE = 0.9
# Orders a mode must appear in, of those tried.
LEAST_ORDERS = 3


@dataclass(frozen=True)
class Pole:
    """One pole of one order: s in 1/s, shape (p,) in the coordinates' units, and whether it is stable.

    Of one that is, the indicators coherence and singular_value; else they are 0.
    """

    order: int
    s: complex
    shape: NDArray[np.complex128]
    coherence: float
    singular_value: float
    stable: bool

    @property
    def frequency_hz(self) -> float:
        """|s| / 2 pi."""
        return abs(self.s) / (2.0 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """-Re(s) / |s|."""
        return -self.s.real / abs(self.s)


@dataclass(frozen=True)
class Candidate:
    """A cluster of poles: its member of median damping, its orders' count, medians over its members, and these."""

    pole: Pole
    count: int
    frequency_hz: float
    damping_ratio: float
    members: tuple[Pole, ...] = ()


@dataclass(frozen=True)
class _Many:
    """What poles are compared by: frequency in Hz and damping ratio (k,), unit shapes (p, k)."""

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    shapes: ComplexArray


def _many(frequency_hz: FloatArray, damping_ratio: FloatArray, shapes: ComplexArray) -> _Many:
    return _Many(frequency_hz, damping_ratio, shapes / np.maximum(np.linalg.norm(shapes, axis=0), 1e-300))


def _alike(a: _Many, b: _Many) -> NDArray[np.bool_]:
    """Whether poles (k,) and others (l,) are one mode, (k, l): close in frequency, damping and shape."""
    frequency_hz, damping = a.frequency_hz[:, None], a.damping_ratio[:, None]
    near = np.abs(frequency_hz - b.frequency_hz) < FREQUENCY_TOLERANCE * frequency_hz
    near &= np.abs(damping - b.damping_ratio) < np.maximum(DAMPING_TOLERANCE, DAMPING_SHARE * np.abs(damping))
    near &= np.abs(a.shapes.conj().T @ b.shapes) ** 2 > SHAPE_TOLERANCE
    return near


def stabilisation(system: Realisation, rate_hz: float, columns: int, band_hz: tuple[float, float]) -> list[Pole]:
    """Poles of every even order within a band, each marked stable or not against the order below it.

    Poles that grow fast or are damped beyond 30 % are no vibration and are left out.
    """

    def vibrates(z: ComplexArray) -> NDArray[np.bool_]:
        frequency_hz, damping = frequency_and_damping(continuous(z, rate_hz))
        return (frequency_hz >= band_hz[0]) & (frequency_hz < band_hz[1]) & (damping > -0.1) & (damping < 0.3)

    poles = poles_of_orders(system, range(2, system.order + 1, 2), vibrates)
    if len(poles.z) == 0:
        return []
    order = poles.order
    s = continuous(poles.z, rate_hz)
    frequency_hz, damping = frequency_and_damping(s)
    many = _many(frequency_hz, damping, poles.shape)
    stable = np.any(_alike(many, many) & (order[:, None] == order + 2), axis=1)
    chosen = np.flatnonzero(stable)
    trusted = poles.of(chosen)
    coherence, strength = np.zeros((2, len(order)))
    coherence[chosen] = amplitude_coherence(trusted, columns)
    strength[chosen] = modal_singular_value(trusted, columns)
    sequence = np.lexsort((frequency_hz, order))
    numbers = (values[sequence].tolist() for values in (order, s, coherence, strength, stable))
    return [
        Pole(of_order, its_s, shape, *indicators)
        for of_order, its_s, *indicators, shape in zip(*numbers, poles.shape.T[sequence], strict=True)
    ]


def cluster(poles: list[Pole], least: int) -> list[Candidate]:
    """Candidates for modes, strongest first: clusters of alike stable poles that appear in at least `least`
    orders.

    Poles seed clusters in order of amplitude coherence times strength, so that a split pole joins its
    dominant neighbour.
    """
    seeds = sorted((p for p in poles if p.stable), key=lambda p: (-p.coherence * p.singular_value, p.order))
    if not seeds:
        return []
    frequency_hz, damping = frequency_and_damping(np.array([p.s for p in seeds]))
    many = _many(frequency_hz, damping, np.stack([p.shape for p in seeds], axis=1))
    likeness = _alike(many, many)
    free = np.ones(len(seeds), np.bool_)
    candidates = []
    while free.any():
        chosen = np.flatnonzero(likeness[int(np.argmax(free))] & free)
        free[chosen] = False
        members = [seeds[i] for i in chosen]
        count = len({p.order for p in members})
        if count >= least:
            middle = sorted(members, key=lambda p: (p.damping_ratio, p.order))[len(members) // 2]
            medians = median(frequency_hz[chosen].tolist()), median(damping[chosen].tolist())
            candidates.append(Candidate(middle, count, *medians, tuple(members)))
    return sorted(candidates, key=lambda c: -c.pole.singular_value)
