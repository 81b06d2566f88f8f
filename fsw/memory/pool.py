"""A fixed number of frames, taken once and leased: nothing is allocated after the first tick."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class PoolError(Exception):
    """A frame was given back that was not out, or is not of this pool: a defect of the program, never an input."""


class FramePool:
    """count frames of one shape and type. Full: `lease` says no and counts it; it never waits and never grows."""

    def __init__(self, count: int, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        if count < 1:
            raise ValueError(f"a pool needs at least one frame, not {count}")
        block: NDArray[Any] = np.empty((count, *shape), dtype)
        block.fill(0)  # touch every page now: the operating system hands out memory at the first write
        self._frames = tuple(block)
        self._place = {id(frame): place for place, frame in enumerate(self._frames)}
        self._owner: list[str | None] = [None] * count
        self._free = list(range(count - 1, -1, -1))
        self.high_water = 0
        self.denied = 0

    @property
    def count(self) -> int:
        """Frames in the pool."""
        return len(self._frames)

    @property
    def leased(self) -> int:
        """Frames that are out now."""
        return self.count - len(self._free)

    def owners(self) -> list[str]:
        """Who holds a frame now, one entry a lease."""
        return [owner for owner in self._owner if owner is not None]

    def lease(self, owner: str = "") -> NDArray[Any] | None:
        """A frame whose content means nothing yet; None, and counted, if all are out."""
        if not self._free:
            self.denied += 1
            return None
        place = self._free.pop()
        self._owner[place] = owner
        self.high_water = max(self.high_water, self.leased)
        return self._frames[place]

    def release(self, frame: NDArray[Any]) -> None:
        """Give back exactly the array that was leased. Raises PoolError for a second or a foreign release."""
        place = self._place.get(id(frame))
        if place is None:
            raise PoolError("this array was not leased from this pool (a view of a frame is not the frame)")
        if self._owner[place] is None:
            raise PoolError(f"frame {place} was released twice")
        self._owner[place] = None
        self._free.append(place)
