"""Cameras on a raw trigger line: they fill the flight side's buffers as real ones would."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.camera import FrameStamp, FrameStatus
from sim.edges import EdgeLine


class Sight(Protocol):
    """What cameras see: SurrogateWorld or WholeWorld."""

    height: int
    width: int
    dtype: np.dtype[Any]

    def render(self, number: int, time_ns: int, eye: int, out: NDArray[Any]) -> None: ...


class SurrogateCamera:
    """One eye (0 left, 1 right) on a trigger line."""

    def __init__(self, world: Sight, eye: int, line: EdgeLine) -> None:
        self._world, self._eye, self._line = world, eye, line
        self.height, self.width, self.dtype = world.height, world.width, world.dtype
        self._frame = self._last = -1

    def grab(self, out: NDArray[Any]) -> FrameStamp:
        """Fill out (height, width) with the latest exposure; MISSING if there has been no new one."""
        line = self._line
        if line.tick == self._last:
            return FrameStamp(line.tick, -1, line.time_ns, int(FrameStatus.MISSING), self._eye)
        self._world.render(line.tick, line.true_ns, self._eye, out)
        self._last = line.tick
        self._frame += 1
        return FrameStamp(line.tick, self._frame, line.time_ns, int(FrameStatus.OK), self._eye)

    def close(self) -> None:
        """Nothing is open."""
