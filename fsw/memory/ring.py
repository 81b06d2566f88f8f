"""The last so many rows of a series, each held once."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


class Ring:
    """capacity rows of one shape and type; a new row overwrites the oldest, and that is counted."""

    def __init__(self, capacity: int, shape: tuple[int, ...] = (), dtype: DTypeLike = np.float64) -> None:
        if capacity < 1:
            raise ValueError(f"a ring needs at least one row, not {capacity}")
        self.capacity = capacity
        self.pushed = 0
        self._rows: NDArray[Any] = np.empty((capacity, *shape), dtype)
        self._rows.fill(0)

    def __len__(self) -> int:
        """Rows that are there."""
        return min(self.pushed, self.capacity)

    @property
    def nbytes(self) -> int:
        """Memory of the rows."""
        return self._rows.nbytes

    @property
    def overwritten(self) -> int:
        """Rows that are gone."""
        return max(0, self.pushed - self.capacity)

    def push(self, row: ArrayLike) -> None:
        """Append one row of the ring's shape. Raises ValueError for another shape."""
        if np.shape(row) != self._rows.shape[1:]:
            raise ValueError(f"a row has shape {self._rows.shape[1:]}, not {np.shape(row)}")
        self._rows[self.pushed % self.capacity] = row
        self.pushed += 1

    def copy_latest(self, out: NDArray[Any]) -> None:
        """Copy the newest rows, oldest first, as many as out (count, *shape) has. Raises ValueError beyond len."""
        count = len(out)
        if count > len(self):
            raise ValueError(f"{count} rows asked for, {len(self)} are there")
        begin = (self.pushed - count) % self.capacity
        before_the_seam = min(count, self.capacity - begin)
        np.copyto(out[:before_the_seam], self._rows[begin : begin + before_the_seam])
        np.copyto(out[before_the_seam:], self._rows[: count - before_the_seam])

    def clear(self) -> None:
        """Forget all rows and the count."""
        self.pushed = 0
