"""The last good estimate: a copy of its points, to be shown again while newer ones are not good."""

from array import array
from collections.abc import MutableSequence
from math import nan

import numpy as np
from numpy.typing import NDArray

from telemetry.board import OFFSET
from telemetry.dictionary import (
    AMPLITUDE_COHERENCE,
    AMPLITUDE_MM,
    DAMPING_RATIO,
    DAMPING_RATIO_SIGMA,
    ESTIMATE_FLAGS,
    ESTIMATE_TICK,
    ESTIMATE_TIME_US,
    FREQUENCY_HZ,
    FREQUENCY_JUMP,
    FREQUENCY_SIGMA_HZ,
    FREQUENCY_UNCERTAINTY,
    IDENTIFIED_FLAGS,
    MODE_COUNT,
    RECORD_SAMPLES,
)

Cells = MutableSequence[float]
FloatArray = NDArray[np.float64]

# ESTIMATE_TICK comes first: it says whether there is an estimate. OBSERVABLE is no part: it belongs to now.
ESTIMATE_POINTS = (
    ESTIMATE_TICK, ESTIMATE_TIME_US, MODE_COUNT, RECORD_SAMPLES, ESTIMATE_FLAGS, FREQUENCY_HZ, FREQUENCY_SIGMA_HZ,
    DAMPING_RATIO, DAMPING_RATIO_SIGMA, AMPLITUDE_MM, AMPLITUDE_COHERENCE, IDENTIFIED_FLAGS, FREQUENCY_UNCERTAINTY,
    FREQUENCY_JUMP,
)  # fmt: skip
_PLACES = tuple(OFFSET[point.name] + slot for point in ESTIMATE_POINTS for slot in range(point.slots))


class GoodEstimate:
    """The points of the newest estimate that had a usable mode; NaN before there was one."""

    size = len(_PLACES)

    def __init__(self) -> None:
        self._values = array("d", [nan]) * self.size

    @property
    def tick(self) -> float:
        """Trigger of its newest frame; NaN: there is none."""
        return self._values[0]

    def keep(self, cells: Cells) -> None:
        """Take what stands on the board."""
        for i, place in enumerate(_PLACES):
            self._values[i] = cells[place]

    def show(self, cells: Cells) -> None:
        """Put it on the board again."""
        for i, place in enumerate(_PLACES):
            cells[place] = self._values[i]

    def save(self, into: FloatArray, at: int) -> int:
        """Write it from this place on; gives the place after it."""
        into[at : at + self.size] = self._values
        return at + self.size

    def restore(self, values: FloatArray, at: int) -> int:
        """Read it from this place on; gives the place after it."""
        self._values = array("d", values[at : at + self.size].tolist())
        return at + self.size
