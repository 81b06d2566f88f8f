"""A panel that has come loose: it swings about its hinge between two stops, and each blow shakes the wing."""

import math
from collections.abc import Iterator

import numpy as np

from sim.surrogate_motion import ModalMotion

CROSSING_S = (0.15, 0.8)  # from stop to stop: shortest and longest
MASS_SHARE = 0.1  # of a mode's mass, that the blow of the loose panel counts


class Flap:
    """The panel's end in mm: straight lines between the stops, in times that are never the same.

    from_s, to_s: while it is loose, of the times of the flight. stop_mm: how far it can move to either side.
    """

    def __init__(self, from_s: float, to_s: float, stop_mm: float, seed: int) -> None:
        draw = np.random.default_rng([seed, 77])
        count = math.ceil((to_s - from_s) / CROSSING_S[0])
        times = from_s + np.cumsum(draw.uniform(*CROSSING_S, count))
        times = times[times < to_s]
        sides = stop_mm * np.where(np.arange(len(times)) % 2, -1.0, 1.0)
        self._times_s = np.concatenate([[from_s], times, [to_s]])
        self._tip_mm = np.concatenate([[0.0], sides, [0.0]])

    def tip_mm(self, time_s: float) -> float:
        """Displacement of the panel's end at a moment."""
        return float(np.interp(time_s, self._times_s, self._tip_mm, 0.0, 0.0))

    def blows(self) -> Iterator[tuple[float, float]]:
        """Time in s, and change of the speed of the panel's end in mm/s, of each blow."""
        speed = np.diff(self._tip_mm) / np.diff(self._times_s)
        yield from zip(self._times_s[1:-1].tolist(), np.diff(speed).tolist(), strict=True)

    def shake(self, motion: ModalMotion) -> None:
        """Let each blow act on all modes of the wing."""
        for time_s, change in self.blows():
            motion.kick(
                time_s, [-MASS_SHARE * change / (2.0 * math.pi * hz) for hz in motion.frequencies_hz(time_s, time_s)]
            )
