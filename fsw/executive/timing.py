"""How long a task took: statistics in fixed arrays, updated without allocation."""

from math import sqrt
from typing import NamedTuple

import numpy as np

BINS = 16
# Bins are eighths of the budget: the first eight are within it, the last one is open.
BINS_PER_BUDGET = 8


class Summary(NamedTuple):
    """Statistics of one measure, milliseconds; NaN before the first run. histogram: bins of budget / 8."""

    runs: int
    last_ms: float
    min_ms: float
    max_ms: float
    mean_ms: float
    deviation_ms: float
    over_budget: int
    histogram: tuple[int, ...]


class Timing:
    """Last, least, greatest, mean, variance (Welford's recurrence) and a histogram of one measure of one task."""

    _LAST, _MIN, _MAX, _MEAN, _SQUARES = range(5)

    def __init__(self, budget_ms: float) -> None:
        self.budget_ns = round(budget_ms * 1e6)
        self.runs = 0
        self.over_budget = 0
        self._values = np.zeros(5)
        self._histogram = np.zeros(BINS, np.int64)
        self.reset()

    def reset(self) -> None:
        """Forget all runs."""
        self.runs = 0
        self.over_budget = 0
        self._values.fill(0.0)
        self._values[self._MIN] = np.inf
        self._values[self._MAX] = -np.inf
        self._histogram.fill(0)

    def set_budget(self, budget_ms: float) -> None:
        """Measure against another budget; the runs so far are forgotten, for they stand in bins of the old one."""
        budget_ns = round(budget_ms * 1e6)
        if budget_ns != self.budget_ns:
            self.budget_ns = budget_ns
            self.reset()

    def add(self, elapsed_ns: int) -> None:
        """Count one run."""
        values = self._values
        self.runs += 1
        self.over_budget += elapsed_ns > self.budget_ns
        values[self._LAST] = elapsed_ns
        values[self._MIN] = min(values[self._MIN], elapsed_ns)
        values[self._MAX] = max(values[self._MAX], elapsed_ns)
        from_old_mean = elapsed_ns - values[self._MEAN]
        values[self._MEAN] += from_old_mean / self.runs
        values[self._SQUARES] += from_old_mean * (elapsed_ns - values[self._MEAN])
        place = elapsed_ns * BINS_PER_BUDGET // self.budget_ns if self.budget_ns else BINS - 1
        self._histogram[min(max(place, 0), BINS - 1)] += 1

    @property
    def last_ms(self) -> float:
        """The newest run; NaN before the first."""
        return float(self._values[self._LAST]) * 1e-6 if self.runs else float("nan")

    def summary(self) -> Summary:
        """The statistics so far."""
        histogram = tuple(int(count) for count in self._histogram)
        if not self.runs:
            nan = float("nan")
            return Summary(0, nan, nan, nan, nan, nan, 0, histogram)
        last, least, most, mean, squares = (float(value) for value in self._values)
        variance = squares / (self.runs - 1) if self.runs > 1 else 0.0
        ms = 1e-6
        return Summary(
            self.runs,
            last * ms,
            least * ms,
            most * ms,
            mean * ms,
            sqrt(variance) * ms,
            self.over_budget,
            histogram,
        )

    def percentile_ms(self, share: float) -> float:
        """Upper edge of the bin in which this share (0..1) of the runs is reached; the maximum in the open bin."""
        if not self.runs:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self._histogram), share * self.runs))
        most = float(self._values[self._MAX])
        edge = most if place >= BINS - 1 else (place + 1) * self.budget_ns / BINS_PER_BUDGET
        return min(edge, most) * 1e-6
