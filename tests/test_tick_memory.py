"""After INIT the tick path takes no array memory, gives every frame back, and the process does not grow.

The tick path is `App.step` on the thread that calls it. Not on it, because they work beside the ticks on threads of
their own: the searches, and identify, whose results differ in size from one estimate to the next. What they set aside
and what they deliver is on the tick path. The right eye has a thread too, but runs the same lines as the left one.
"""

import ctypes
import sys
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_parts import Footage, flying, logging, shipped, small
from numba.core.runtime import _nrt_python, rtsys
from numpy._core import _multiarray_umath

from fsw.app import App
from fsw.tables.schema import PanelTable
from telemetry.dictionary import MATCHED, FlightMode

NUMPY_DOMAIN = 389047
SCALAR_BYTES = 16  # numpy makes an array of a number, or of a pair, when it is given one: no data, gone at once
TICKS = 200
PAIRS = 20


@pytest.fixture(scope="module")
def footage() -> Footage:
    """Twenty pairs of `small`."""
    return Footage(small(PAIRS / 15.0))


@pytest.fixture(scope="module")
def coarse() -> Footage:
    """The same with large cells, which cost less a tick: for many ticks."""
    panels = [PanelTable((x, -190.0), 5, 7, (104.0, 55.0), (100.0, 50.0)) for x in (4.5, 540.9, 1077.3)]
    return Footage(small(PAIRS / 15.0, panel=panels))


_Take = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_TakeClear = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
_Resize = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_Give = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)


class _Handler(ctypes.Structure):
    """PyDataMem_Handler of numpy's C interface (NEP 49)."""

    _fields_ = (
        ("name", ctypes.c_char * 127),
        ("version", ctypes.c_uint8),
        ("context", ctypes.c_void_p),
        ("malloc", _Take),
        ("calloc", _TakeClear),
        ("realloc", _Resize),
        ("free", _Give),
    )


class ArrayWatch:
    """Sees every array that numpy takes memory for on one thread, even for a moment: (bytes, file:line)."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, str]] = []
        libc = ctypes.CDLL(None)
        for take in (libc.malloc, libc.calloc, libc.realloc):
            take.restype = ctypes.c_void_p
        size_t, pointer = ctypes.c_size_t, ctypes.c_void_p

        def malloc(_: int, size: int) -> Any:
            self._note(size)
            return libc.malloc(size_t(size))

        def calloc(_: int, count: int, size: int) -> Any:
            self._note(count * size)
            return libc.calloc(size_t(count), size_t(size))

        def realloc(_: int, old: int, size: int) -> Any:
            self._note(size)
            return libc.realloc(pointer(old), size_t(size))

        def free(_: int, old: int, __: int) -> None:
            libc.free(pointer(old))

        handler = _Handler(b"watch", 1, None, _Take(malloc), _TakeClear(calloc), _Resize(realloc), _Give(free))
        name = ctypes.create_string_buffer(b"mem_handler")
        for kept in (handler, name):  # an array that outlives the test is freed through them: keep them for good
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))
        wrap = ctypes.PYFUNCTYPE(ctypes.py_object, pointer, pointer, pointer)(("PyCapsule_New", ctypes.pythonapi))
        unwrap = ctypes.PYFUNCTYPE(pointer, ctypes.py_object, pointer)(("PyCapsule_GetPointer", ctypes.pythonapi))
        api = ctypes.cast(unwrap(_multiarray_umath._ARRAY_API, None), ctypes.POINTER(pointer))
        # PyDataMem_SetHandler; it holds for the calling thread only.
        self._set = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(api[304])
        self._capsule = wrap(ctypes.addressof(handler), ctypes.addressof(name), None)

    def _note(self, size: int) -> None:
        frame = sys._getframe(2)
        while frame.f_back is not None and "site-packages" in frame.f_code.co_filename:
            frame = frame.f_back
        self.seen.append((size, f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"))

    @contextmanager
    def watching(self) -> Iterator[None]:
        before = self._set(self._capsule)
        try:
            yield
        finally:
            self._set(before)


def resident_mib() -> float:
    """Memory of this process that is in the machine's."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def arrays() -> tracemalloc.Snapshot:
    """All memory of arrays that was taken since tracemalloc started and is still there."""
    return tracemalloc.take_snapshot().filter_traces([tracemalloc.DomainFilter(True, NUMPY_DOMAIN)])


def leases(app: App) -> list[int]:
    """Frames that are out, by eye."""
    return [pool.leased for pool in app._acquire._pools]


def test_the_watch_sees_arrays_that_live_for_a_moment() -> None:
    watch, a = ArrayWatch(), np.ones(1000)
    with watch.watching():
        a += 1.0
        (a + 1.0).sum()
    b = a + 1.0
    assert [size for size, _ in watch.seen if size > SCALAR_BYTES] == [8000]
    assert watch.seen[0][1].startswith("test_tick_memory.py:") and b[0] == 3.0


@pytest.mark.requirement("WB-APP-05")
def test_no_array_is_taken_on_the_tick_path_not_even_for_a_moment(footage: Footage, tmp_path: Path) -> None:
    watch = ArrayWatch()
    with logging(footage, tmp_path) as outlets, flying(footage, tmp_path, TICKS, outlets=outlets) as app:
        with watch.watching():
            while app.step():
                assert leases(app) == [0, 0]
        assert app.executive.ticks == TICKS and app.state.mode is FlightMode.TRACK
        assert app.state.shown is not None  # the way through search, identify and all outlets was gone
    assert leases(app) == [0, 0]
    assert Counter(entry for entry in watch.seen if entry[0] > SCALAR_BYTES) == {}


@pytest.mark.requirement("WB-APP-05")
def test_tracemalloc_sees_no_array_that_stays(footage: Footage, tmp_path: Path) -> None:
    # The search is over before the first look, and the next identification begins after the second one.
    flight = shipped(schedule={"identify": {"period_ticks": 400, "phase_ticks": 399}})
    with (
        logging(footage, tmp_path) as outlets,
        flying(footage, tmp_path, 20 + TICKS, outlets=outlets, flight=flight) as app,
    ):
        tracemalloc.start()
        try:
            for _ in range(20):
                app.step()
            assert app.state.mode is FlightMode.TRACK
            before = arrays()
            while app.step():
                pass
            after = arrays()
        finally:
            tracemalloc.stop()
        assert app.executive.ticks == 20 + TICKS and app.state.mode is FlightMode.TRACK
    assert [str(line) for line in after.compare_to(before, "lineno") if line.size_diff] == []


@pytest.mark.requirement("WB-APP-05")
def test_kernels_give_back_what_they_take(footage: Footage, tmp_path: Path) -> None:
    _nrt_python.memsys_enable_stats()
    with flying(footage, tmp_path, 60) as app:
        held = []
        while app.step():
            stats = rtsys.get_allocation_stats()
            held.append(stats.alloc - stats.free)
    # An identification that is at work on its own thread may hold something; what a tick kept would add up.
    assert min(held[20:40]) == min(held[40:]), held


@pytest.mark.requirement("WB-APP-05")
def test_the_process_does_not_grow_over_two_thousand_ticks(coarse: Footage, tmp_path: Path) -> None:
    # The record is full, and so the identification at its largest, before the warm-up ends.
    flight = shipped(identify={"history_ticks": 100}, schedule={"identify": {"period_ticks": 20}})
    warm_up, ticks = 200, 2000
    with (
        logging(coarse, tmp_path) as outlets,
        flying(coarse, tmp_path, warm_up + ticks, flight=flight, outlets=outlets) as app,
    ):
        for _ in range(warm_up):
            app.step()
        before = highest = resident_mib()
        while app.step():
            highest = max(highest, resident_mib())
            assert leases(app) == [0, 0]
        assert app.executive.ticks == warm_up + ticks and app.state.mode is FlightMode.TRACK
        assert app.state.board.get(MATCHED) >= 30 and app.state.held is not None
    assert highest - before < 2.0
