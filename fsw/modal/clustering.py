"""Poles of many orders gathered into physical modes: the stabilisation diagram and its clusters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.modal.indicators import amplitude_coherence, modal_singular_value, shape_assurance
from fsw.modal.realisation import Realisation, continuous, frequency_and_damping, poles_of_order

# A pole is stable if the next lower order has one like it, and joins a cluster under the same limits.
FREQUENCY_TOLERANCE = 0.01
DAMPING_TOLERANCE = 0.003
DAMPING_SHARE = 0.3
SHAPE_TOLERANCE = 0.9
# Orders a mode must appear in, of those tried.
LEAST_ORDERS = 3


@dataclass(frozen=True)
class Pole:
    """One pole of one order: s in 1/s, shape (p,) in the coordinates' units, indicators, and whether it is stable."""

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
    """A cluster of poles: its member of median damping, its orders' count, medians and scatter over them."""

    pole: Pole
    count: int
    frequency_hz: float
    damping_ratio: float
    frequency_scatter_hz: float
    damping_scatter: float


def alike(a: Pole, b: Pole) -> bool:
    """Whether two poles are one mode: close in frequency, damping and shape."""
    return (
        abs(a.frequency_hz - b.frequency_hz) < FREQUENCY_TOLERANCE * a.frequency_hz
        and abs(a.damping_ratio - b.damping_ratio) < max(DAMPING_TOLERANCE, DAMPING_SHARE * abs(a.damping_ratio))
        and shape_assurance(a.shape, b.shape) > SHAPE_TOLERANCE
    )


def stabilisation(system: Realisation, rate_hz: float, columns: int, band_hz: tuple[float, float]) -> list[Pole]:
    """Poles of every even order within a band, each marked stable or not against the order below it.

    Poles that grow fast or are damped beyond 30 % are no vibration and are left out.
    """
    found: list[Pole] = []
    below: list[Pole] = []
    for order in range(2, system.order + 1, 2):
        poles = poles_of_order(system, order)
        if len(poles.z) == 0:
            below = []
            continue
        coherence = amplitude_coherence(poles, columns)
        strength = modal_singular_value(poles, columns)
        s = continuous(poles.z, rate_hz)
        frequency_hz, damping = frequency_and_damping(s)
        here = []
        for i in np.argsort(frequency_hz, kind="stable"):
            if not (band_hz[0] <= frequency_hz[i] < band_hz[1] and -0.1 < damping[i] < 0.3):
                continue
            pole = Pole(order, complex(s[i]), poles.shape[:, i], float(coherence[i]), float(strength[i]), False)
            if any(alike(pole, other) for other in below):
                pole = Pole(order, pole.s, pole.shape, pole.coherence, pole.singular_value, True)
            here.append(pole)
        found += here
        below = here
    return found


def cluster(poles: list[Pole], least: int) -> list[Candidate]:
    """Candidates for modes, strongest first: clusters of alike stable poles that appear in at least `least`
    orders.

    Poles seed clusters in order of amplitude coherence times strength, so that a split pole joins its
    dominant neighbour.
    """
    free = sorted((p for p in poles if p.stable), key=lambda p: (-p.coherence * p.singular_value, p.order))
    candidates = []
    while free:
        seed = free[0]
        members = [p for p in free if alike(seed, p)]
        free = [p for p in free if not alike(seed, p)]
        count = len({p.order for p in members})
        if count >= least:
            by_damping = sorted(members, key=lambda p: (p.damping_ratio, p.order))
            f = np.array([p.frequency_hz for p in members])
            zeta = np.array([p.damping_ratio for p in members])
            middle = by_damping[len(members) // 2]
            candidates.append(
                Candidate(middle, count, float(np.median(f)), float(np.median(zeta)), float(f.std()), float(zeta.std()))
            )
    return sorted(candidates, key=lambda c: -c.pole.singular_value)
