"""The displacement history: where points were in the last ticks, seen from where each was first."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.memory.ring import Ring


class Displacements:
    """The newest capacity positions of N points, as differences to each point's first one since the last clear.

    A difference is held in single precision: up to 128 mm its rounding is at most 4e-6 mm, a thousandth of what the
    best measurement scatters by. A position itself, 2 m from the camera, would be rounded by 1e-4 mm.
    """

    def __init__(self, capacity: int, count: int) -> None:
        self._ring = Ring(capacity, (count, 3), np.float32)
        self._first_mm: NDArray[np.float64] = np.full((count, 3), np.nan)
        self._new = np.zeros((count, 3), np.bool_)
        self._difference_mm = np.zeros((count, 3))

    def __len__(self) -> int:
        """Ticks that are there."""
        return len(self._ring)

    @property
    def nbytes(self) -> int:
        """Memory of all that is held."""
        return sum(part.nbytes for part in (self._ring, self._first_mm, self._new, self._difference_mm))

    def push(self, xyz_mm: NDArray[np.float64]) -> None:
        """Append the positions (N, 3) of one tick, NaN where a point was not measured."""
        np.isnan(self._first_mm, out=self._new)
        np.copyto(self._first_mm, xyz_mm, where=self._new)
        np.subtract(xyz_mm, self._first_mm, out=self._difference_mm)
        self._ring.push(self._difference_mm)

    def copy_latest(self, out: NDArray[Any]) -> None:
        """Copy the newest differences in mm, oldest first, as many ticks as out (ticks, N, 3) has."""
        self._ring.copy_latest(out)

    def clear(self) -> None:
        """Forget all ticks, and where the points were first."""
        self._ring.clear()
        self._first_mm.fill(np.nan)
