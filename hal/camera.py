"""The camera as the flight application sees it: it fills a buffer and stamps what it put there."""

from enum import IntFlag
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class FrameStatus(IntFlag):
    """What is wrong with a frame; 0 is a good one."""

    OK = 0
    MISSING = 1
    CORRUPT = 2


class FrameStamp(NamedTuple):
    """Which frame this is.

    trigger: number of the edge that exposed it; frame: the camera's own count, -1 if there is no frame;
    time_ns: time of exposure; status: bits of FrameStatus; eye: which camera exposed it, 0 left, 1 right, -1 if the
    driver cannot tell.
    """

    trigger: int
    frame: int
    time_ns: int
    status: int
    eye: int = -1


class Camera(Protocol):
    """One eye. Call `grab` once for each trigger edge."""

    @property
    def width(self) -> int:
        """Columns of the image."""
        ...

    @property
    def height(self) -> int:
        """Rows of the image."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a pixel: uint8 or uint16."""
        ...

    def grab(self, out: NDArray[Any]) -> FrameStamp:
        """Fill out (height, width) with the next trigger's image; out means nothing if status is not OK.

        Rows of out are farther apart than they are long: see `make_frames`.
        """
        ...
