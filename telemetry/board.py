"""The board: the values of all telemetry points at run time, in one array that is allocated once."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import nan

import numpy as np
import numpy.typing as npt

from telemetry.declaration import Point
from telemetry.dictionary import POINT_BY_NAME, POINTS

_STARTS = (0, *accumulate(point.slots for point in POINTS))
OFFSET = {point.name: start for point, start in zip(POINTS, _STARTS, strict=False)}
"""Where a point's first slot lies on the board."""


class Board:
    """Current values of the points. NaN: not available; so starts every point.

    cells and values are the same memory: cells reads and writes one float fastest, values is for bulk work.
    Counts, flags, choices and bits are whole numbers in doubles, exact up to 2^53.
    """

    def __init__(self) -> None:
        self.cells = array("d", [nan]) * _STARTS[-1]
        self.values: npt.NDArray[np.float64] = np.frombuffer(self.cells, np.float64)

    def set(self, point: Point, value: float, slot: int = 0) -> None:
        """Set one slot of a point; value in the point's unit, NaN = not available."""
        if not 0 <= slot < point.slots:
            raise IndexError(f"point {point.name} has {point.slots} slots, not slot {slot}")
        self.cells[OFFSET[point.name] + slot] = value

    def get(self, point: Point | str, slot: int = 0) -> float:
        """Value of one slot of a point, given itself or by name; NaN = not available."""
        known = POINT_BY_NAME[point] if isinstance(point, str) else point
        if not 0 <= slot < known.slots:
            raise IndexError(f"point {known.name} has {known.slots} slots, not slot {slot}")
        return float(self.cells[OFFSET[known.name] + slot])

    def add(self, point: Point, increment: int = 1) -> None:
        """Count up; a counter that was never set starts at 0."""
        place = OFFSET[point.name]
        value = self.cells[place]
        self.cells[place] = increment if value != value else value + increment

    def slots(self, point: Point) -> npt.NDArray[np.float64]:
        """The slots of a point (slots,), as a view to read and write in bulk."""
        start = OFFSET[point.name]
        return self.values[start : start + point.slots]


@dataclass(frozen=True)
class EventRecord:
    """One event that happened: its number in the dictionary, its trigger, its count so far, its arguments."""

    number: int
    tick: int
    time_ns: int
    index: int
    arguments: Sequence[float] = ()
