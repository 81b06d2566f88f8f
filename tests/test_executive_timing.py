"""Timing statistics agree with numpy, and take no memory."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.executive.timing import BINS, Timing


@pytest.mark.requirement("WB-EXE-12")
@given(st.lists(st.integers(0, 50_000_000), min_size=2, max_size=60))
def test_statistics_are_those_of_numpy(elapsed_ns: list[int]) -> None:
    timing = Timing(budget_ms=8.0)
    for value in elapsed_ns:
        timing.add(value)
    ms = np.array(elapsed_ns) * 1e-6
    summary = timing.summary()
    assert summary.runs == len(ms)
    assert (summary.last_ms, summary.min_ms, summary.max_ms) == pytest.approx((ms[-1], ms.min(), ms.max()))
    assert summary.mean_ms == pytest.approx(ms.mean(), abs=1e-9)
    assert summary.deviation_ms == pytest.approx(ms.std(ddof=1), rel=1e-9, abs=1e-6)
    assert summary.over_budget == int((ms > 8.0).sum())
    edges = [*range(BINS), np.inf]
    assert list(summary.histogram) == np.histogram(np.array(elapsed_ns) // 1_000_000, edges)[0].tolist()
    assert ms.max() >= timing.percentile_ms(0.5) >= np.sort(ms)[(len(ms) - 1) // 2] - 1e-9


def test_before_the_first_run_and_after_a_reset_nothing_is_known() -> None:
    timing = Timing(1.0)
    assert np.isnan(timing.summary().mean_ms) and np.isnan(timing.percentile_ms(0.5))
    timing.add(5)
    timing.reset()
    assert timing.summary().runs == 0 and np.isnan(timing.summary().max_ms)
    assert sum(timing.summary().histogram) == 0


def test_percentiles_are_upper_edges_of_their_bins() -> None:
    timing = Timing(budget_ms=8.0)
    for ms in (0.5, 1.5, 2.5, 3.5):
        timing.add(int(ms * 1e6))
    assert [timing.percentile_ms(p) for p in (0.25, 0.5, 0.75, 1.0)] == [1.0, 2.0, 3.0, 3.5]
