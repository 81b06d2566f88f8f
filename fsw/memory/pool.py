"""A fixed number of frames, taken once and leased: nothing is allocated after the first tick."""

from typing import Any, NamedTuple

from numpy.typing import DTypeLike, NDArray

from hal.frame import make_frames


class Lease(NamedTuple):
    """Who holds a frame, and since which tick."""

    owner: str
    tick: int


class FramePool:
    """count frames of one shape and type.

    Full: `lease` says no and counts it (denied); it never waits and never grows. A frame that is given back twice, or
    that is not of this pool, is a defect: it is counted (violations), and the pool stays as it is.
    """

    def __init__(self, count: int, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        if count < 1:
            raise ValueError(f"a pool needs at least one frame, not {count}")
        self._frames = tuple(make_frames((count, *shape), dtype))
        self._place = {id(frame): place for place, frame in enumerate(self._frames)}
        self._lease: list[Lease | None] = [None] * count
        self._free = list(range(count - 1, -1, -1))
        self.high_water = 0
        self.denied = 0
        self.violations = 0

    def reset(self) -> None:
        """Count what was denied and violated from 0 again."""
        self.denied = self.violations = 0

    @property
    def count(self) -> int:
        """Frames in the pool."""
        return len(self._frames)

    @property
    def leased(self) -> int:
        """Frames that are out now."""
        return self.count - len(self._free)

    def owners(self) -> list[Lease]:
        """Who holds a frame now, one entry a lease."""
        return [lease for lease in self._lease if lease is not None]

    def lease(self, owner: str, tick: int) -> NDArray[Any] | None:
        """A frame whose content means nothing yet; None, and counted, if all are out."""
        if not self._free:
            self.denied += 1
            return None
        place = self._free.pop()
        self._lease[place] = Lease(owner, tick)
        self.high_water = max(self.high_water, self.leased)
        return self._frames[place]

    def release(self, frame: NDArray[Any]) -> bool:
        """Give back exactly the array that was leased; False, and counted, if it is not out or not of this pool."""
        place = self._place.get(id(frame))
        if place is None or self._lease[place] is None:
            self.violations += 1
            return False
        self._lease[place] = None
        self._free.append(place)
        return True
