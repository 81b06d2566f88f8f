"""Pools lease and take back, rings keep the newest rows, displacements keep them finely enough."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.memory.displacements import Displacements
from fsw.memory.pool import FramePool, Lease
from fsw.memory.ring import Ring


@pytest.mark.requirement("WB-MEM-01")
@given(st.integers(1, 5), st.lists(st.integers(0, 9), max_size=60))
def test_a_pool_never_leases_a_frame_twice_and_counts_what_it_denies(count: int, actions: list[int]) -> None:
    pool = FramePool(count, (2, 3), np.uint8)
    out: list[np.ndarray] = []
    denied = high = 0
    for action in actions:
        if action < 6:
            frame = pool.lease("test", 3)
            if frame is None:
                denied += 1
                assert len(out) == count
            else:
                assert not any(np.shares_memory(frame, other) for other in out)
                out.append(frame)
        elif out:
            assert pool.release(out.pop(action % len(out)))
        high = max(high, len(out))
        assert (pool.leased, pool.denied, pool.high_water) == (len(out), denied, high)
        assert pool.owners() == [Lease("test", 3)] * len(out)


@pytest.mark.requirement("WB-MEM-02")
def test_a_second_or_foreign_release_is_counted_and_changes_nothing() -> None:
    pool = FramePool(2, (4,), np.uint8)
    frame = pool.lease("test", 0)
    assert frame is not None
    for count, foreign in enumerate((np.zeros(4, np.uint8), frame[:2], frame.view()), 1):
        assert not pool.release(foreign)
        assert (pool.violations, pool.leased) == (count, 1)
    assert pool.release(frame)
    assert not pool.release(frame)
    assert (pool.violations, pool.leased, len(pool.owners())) == (4, 0, 0)
    assert pool.lease("a", 1) is not pool.lease("b", 1) and pool.lease("c", 1) is None


@pytest.mark.requirement("WB-MEM-03")
@given(st.integers(1, 7), st.lists(st.floats(-1e6, 1e6), max_size=30), st.data())
def test_a_ring_is_the_tail_of_what_was_pushed(capacity: int, values: list[float], data: st.DataObject) -> None:
    ring = Ring(capacity, (2,))
    for value in values:
        ring.push((value, -value))
    kept = values[-capacity:]
    assert len(ring) == len(kept)
    assert ring.overwritten == len(values) - len(kept)
    newest = np.full((data.draw(st.integers(0, len(kept))), 2), np.nan)
    ring.copy_latest(newest)
    assert newest[:, 0].tolist() == kept[len(kept) - len(newest) :]
    assert newest[:, 1].tolist() == [-value for value in newest[:, 0]]


def test_a_ring_refuses_other_shapes_and_more_than_it_has() -> None:
    ring = Ring(3, (2, 2))
    with pytest.raises(ValueError, match="shape"):
        ring.push(np.zeros(2))
    ring.push(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="2 rows asked for, 1 are there"):
        ring.copy_latest(np.zeros((2, 2, 2)))
    ring.clear()
    assert len(ring) == 0


@given(st.integers(0, 1000))
def test_displacements_are_rounded_far_below_the_noise_and_gaps_stay_gaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ticks, count = 40, 6
    xyz = rng.uniform(-2500.0, 2500.0, (count, 3)) + rng.uniform(-60.0, 60.0, (ticks, count, 3))
    xyz[rng.uniform(size=(ticks, count)) < 0.3] = np.nan
    held = Displacements(25, count)
    for row in xyz:
        held.push(row)
    kept = np.zeros((25, count, 3), np.float32)
    held.copy_latest(kept)
    assert np.array_equal(np.isnan(kept), np.isnan(xyz[-25:]))
    # What a record is looked at for is how each point moves: its place at rest is taken out.
    moved = kept - np.nanmean(kept, axis=0, dtype=np.float64) - (xyz[-25:] - np.nanmean(xyz[-25:], axis=0))
    assert np.nanmax(np.abs(moved)) < 2e-5  # mm; the best measurement of a cell scatters by 0.004


def test_displacements_begin_anew_where_a_point_is_first_after_a_clear() -> None:
    held = Displacements(4, 2)
    held.push(np.full((2, 3), 1000.0))
    assert held.nbytes >= 4 * 2 * 3 * 4
    held.clear()
    assert len(held) == 0
    held.push(np.array([[5.0, 6.0, 7.0], [np.nan] * 3]))
    held.push(np.array([[6.0, 6.0, 6.0], [1.0, 2.0, 3.0]]))
    kept = np.zeros((2, 2, 3))
    held.copy_latest(kept)
    assert kept[:, 0].tolist() == [[0.0, 0.0, 0.0], [1.0, 0.0, -1.0]]
    assert np.isnan(kept[0, 1]).all() and kept[1, 1].tolist() == [0.0, 0.0, 0.0]


def test_use_leaves_no_new_array_memory() -> None:
    numpy_domain = 389047
    pool, ring, row = FramePool(2, (100, 100), np.uint8), Ring(50, (300, 3)), np.zeros((300, 3))
    held, out = Displacements(50, 300), np.zeros((50, 300, 3), np.float32)
    tracemalloc.start()
    try:
        for _ in range(200):
            frame = pool.lease("test", 0)
            assert frame is not None
            ring.push(row)
            held.push(row)
            held.copy_latest(out[: len(held)])
            pool.release(frame)
        trace = tracemalloc.take_snapshot().filter_traces([tracemalloc.DomainFilter(True, numpy_domain)])
        assert sum(stat.size for stat in trace.statistics("filename")) == 0
    finally:
        tracemalloc.stop()
