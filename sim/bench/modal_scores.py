"""How good the modes of a record are: errors against truth and bound, what was missed, what was made up, coverage."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.bench.modal_records import DAMPING
from sim.bench.table import Row

FloatArray = NDArray[np.float64]

# A mode within this share of a true frequency is that mode; the close pair lies twice as far apart.
_SAME_MODE = 0.02
# 95 % of a normal variable lie within so many standard deviations; its median magnitude is this many.
WITHIN, MEDIAN = 1.96, 0.6745
NAMES = ("frequency", "damping")


@dataclass(frozen=True)
class Found:
    """A mode that a method reports as real; sigmas NaN where the method gives none."""

    frequency_hz: float
    damping_ratio: float
    frequency_sigma_hz: float = np.nan
    damping_ratio_sigma: float = np.nan


@dataclass
class Score:
    """Errors of one method over the records of one case.

    errors, deviations: lists over records of (m, 2) arrays of frequency in Hz and damping ratio, NaN where the mode was
    missed: error, and error over the method's own sigma. spurious, cpu_s: one value a record.
    """

    frequency_hz: Sequence[float]
    errors: list[FloatArray] = field(default_factory=list)
    bounds: list[FloatArray] = field(default_factory=list)
    deviations: list[FloatArray] = field(default_factory=list)
    spurious: list[int] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)

    def add(self, found: Sequence[Found], bound: FloatArray, cpu_s: float) -> None:
        """One record's modes, its bound (m, 2) as standard deviations, and the processor time it took."""
        error = np.full((len(self.frequency_hz), 2), np.nan)
        sigma = np.full_like(error, np.nan)
        taken: set[int] = set()
        for j, f in enumerate(self.frequency_hz):
            near = [
                (abs(mode.frequency_hz - f), i)
                for i, mode in enumerate(found)
                if i not in taken and abs(mode.frequency_hz - f) < _SAME_MODE * f
            ]
            if near:
                i = min(near)[1]
                taken.add(i)
                error[j] = found[i].frequency_hz - f, found[i].damping_ratio - DAMPING
                sigma[j] = found[i].frequency_sigma_hz, found[i].damping_ratio_sigma
        self.errors.append(error)
        self.bounds.append(bound)
        self.deviations.append(error / sigma)
        self.spurious.append(len(found) - len(taken))
        self.cpu_s.append(cpu_s)

    def over_bound(self) -> FloatArray:
        """Magnitudes of the errors in standard deviations at the bound (records, m, 2), NaN where missed."""
        return np.abs(np.array(self.errors)) / np.array(self.bounds)

    def rows(self, table: str, method: str, case: str) -> list[Row]:
        """One row a mode, and one for the record as a whole, of the errors of all its modes."""
        errors, over_bound = np.abs(np.array(self.errors)), self.over_bound()
        deviations = np.array(self.deviations)
        rows: list[Row] = []
        for j, f in enumerate(self.frequency_hz):
            percent = 100.0 * errors[:, j] / [f, DAMPING]
            row: Row = {"table": table, "method": method, "case": f"{case} {f:.2f} Hz", "records": len(errors)}
            for k, name in enumerate(NAMES):
                row[f"{name}_error_median_percent"] = quantile(percent[:, k], 0.5)
                row[f"{name}_error_p95_percent"] = quantile(percent[:, k], 0.95)
                row[f"{name}_over_bound"] = quantile(over_bound[:, j, k], 0.5, MEDIAN)
                row[f"{name}_cover_percent"] = cover_percent(deviations[:, j, k])
            row["missed"] = int(np.count_nonzero(np.isnan(errors[:, j, 0])))
            rows.append(row)
        whole: Row = {"table": table, "method": method, "case": f"{case} whole", "records": len(errors)}
        for k, name in enumerate(NAMES):
            whole[f"{name}_over_bound"] = quantile(over_bound[..., k], 0.5, MEDIAN)
            whole[f"{name}_cover_percent"] = cover_percent(deviations[..., k])
        whole["missed"] = int(np.count_nonzero(np.isnan(errors[:, :, 0])))
        whole["spurious_a_record"] = float(np.mean(self.spurious))
        whole["cpu_ms"] = 1e3 * float(np.median(self.cpu_s))
        return [*rows, whole]


def cover_percent(deviations: FloatArray) -> float | None:
    """Share of errors within the 95 % interval, in per cent; None where there are no intervals."""
    told = deviations[np.isfinite(deviations)]
    return 100.0 * float(np.mean(np.abs(told) < WITHIN)) if told.size else None


def quantile(values: FloatArray, share: float, unit: float = 1.0) -> float | None:
    """Quantile of those values that are not NaN, in a unit; None if there are none."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) / unit if known.size else None
