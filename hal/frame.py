"""Memory for images, laid out so that pixels above each other are read as quickly as those side by side."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

LINE = 64  # bytes that memory gives at once: a line of the cache


def make_frames(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Take images (..., height, width), all 0, whose rows lie an odd number of the cache's lines apart.

    The low bits of an address tell in which of its 64 sets the nearest cache keeps a line. Rows a power of two apart,
    as cameras have them, would share one set: eight lines of a column of pixels are all that it holds, or waits for.
    Rows never touch, so that code compiled for one width of image is right for all.
    """
    dtype = np.dtype(dtype)
    lines = shape[-1] * dtype.itemsize // LINE + 1 | 1
    block: NDArray[Any] = np.empty((*shape[:-1], lines * LINE // dtype.itemsize), dtype)
    block.fill(0)  # touch every page now: the operating system hands out memory at the first write
    return block[..., : shape[-1]]


def as_frame(image: NDArray[Any]) -> NDArray[Any]:
    """A frame with the pixels of an image (height, width) that came otherwise."""
    frame = make_frames(image.shape, image.dtype)
    frame[:] = image
    return frame
