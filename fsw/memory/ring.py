"""The last so many rows of a series, always in one piece."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


class Ring:
    """capacity rows of one shape and type; a new row overwrites the oldest, and that is counted.

    Each row is written twice, capacity apart, so that the newest n rows are one slice of memory: no copy.
    """

    def __init__(self, capacity: int, shape: tuple[int, ...] = (), dtype: DTypeLike = np.float64) -> None:
        if capacity < 1:
            raise ValueError(f"a ring needs at least one row, not {capacity}")
        self.capacity = capacity
        self.pushed = 0
        self._rows: NDArray[Any] = np.empty((2 * capacity, *shape), dtype)
        self._rows.fill(0)

    def __len__(self) -> int:
        """Rows that are there."""
        return min(self.pushed, self.capacity)

    @property
    def overwritten(self) -> int:
        """Rows that are gone."""
        return max(0, self.pushed - self.capacity)

    def push(self, row: ArrayLike) -> None:
        """Append one row of the ring's shape. Raises ValueError for another shape."""
        if np.shape(row) != self._rows.shape[1:]:
            raise ValueError(f"a row has shape {self._rows.shape[1:]}, not {np.shape(row)}")
        place = self.pushed % self.capacity
        self._rows[place] = row
        self._rows[place + self.capacity] = row
        self.pushed += 1

    def latest(self, count: int | None = None) -> NDArray[Any]:
        """The newest rows, oldest first, (count, *shape): a read-only view. All rows unless count is given.

        The view's rows stay as they are during the next capacity - count pushes. Raises ValueError beyond len.
        """
        rows = len(self) if count is None else count
        if not 0 <= rows <= len(self):
            raise ValueError(f"{rows} rows asked for, {len(self)} are there")
        end = (self.pushed - 1) % self.capacity + 1 + self.capacity
        view = self._rows[end - rows : end]
        view.flags.writeable = False
        return view

    def clear(self) -> None:
        """Forget all rows and the count."""
        self.pushed = 0
