"""Pools lease and take back, rings keep the newest rows in one piece."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
    count = data.draw(st.integers(0, len(kept)))
    view = ring.latest(count)
    assert view.flags.c_contiguous and view.shape == (count, 2)
    assert view[:, 0].tolist() == kept[len(kept) - count :]
    assert ring.latest()[:, 1].tolist() == [-value for value in kept]


@given(st.integers(2, 8), st.integers(0, 20), st.data())
def test_a_view_holds_still_for_the_pushes_it_promises(capacity: int, before: int, data: st.DataObject) -> None:
    ring = Ring(capacity)
    for value in range(before):
        ring.push(float(value))
    count = data.draw(st.integers(0, len(ring)))
    view = ring.latest(count)
    expected = view.copy()
    for value in range(capacity - count):
        ring.push(-1.0 - value)
        assert np.array_equal(view, expected)


def test_a_ring_refuses_other_shapes_and_more_than_it_has() -> None:
    ring = Ring(3, (2, 2))
    with pytest.raises(ValueError, match="shape"):
        ring.push(np.zeros(2))
    ring.push(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="2 rows asked for, 1 are there"):
        ring.latest(2)
    with pytest.raises(ValueError):
        ring.latest()[:] = 1.0
    ring.clear()
    assert len(ring) == 0 and ring.latest().shape == (0, 2, 2)


def test_use_leaves_no_new_array_memory() -> None:
    numpy_domain = 389047
    pool, ring, row = FramePool(2, (100, 100), np.uint8), Ring(50, (300, 3)), np.zeros((300, 3))
    tracemalloc.start()
    try:
        for _ in range(200):
            frame = pool.lease("test", 0)
            assert frame is not None
            ring.push(row)
            ring.latest(min(20, len(ring)))
            pool.release(frame)
        trace = tracemalloc.take_snapshot().filter_traces([tracemalloc.DomainFilter(True, numpy_domain)])
        assert sum(stat.size for stat in trace.statistics("filename")) == 0
    finally:
        tracemalloc.stop()
