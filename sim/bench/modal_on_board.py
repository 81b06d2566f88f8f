"""What the camera's rate asks for: 918 channels at 46 Hz, identified on the newest seconds of the history."""

import time
import tracemalloc
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from fsw.memory.displacements import Displacements
from fsw.modal.pipeline import identify
from fsw.modal.result import Kind
from sim.bench.modal_bounds import cramer_rao
from sim.bench.modal_broken import misleads
from sim.bench.modal_records import ON_BOARD, FloatArray, free_decay, stationary
from sim.bench.modal_scores import Found, Score
from sim.bench.table import Row

_DURATIONS_S = (6.0, 10.0)
_MISSING = (0.0, 0.02)
# Identifications after the first in a flight, and flights at most.
_SECONDS, _FLIGHTS = 4, 8


def cases(runs: int, seed: int) -> list[Callable[[], Sequence[Row]]]:
    """One case a length of the history, and what is kept in memory, with all cells measured and with some missing."""
    lengths: list[Callable[[], Sequence[Row]]] = [
        lambda d=duration_s: _identified(d, range(seed, seed + runs)) for duration_s in _DURATIONS_S
    ]
    flights = range(seed, seed + min(runs, _FLIGHTS))
    flown: list[Callable[[], Sequence[Row]]] = [
        lambda kind=kind, d=duration_s, share=share: [_each_second(kind, d, share, flights)]
        for kind in ("decay", "ambient")
        for duration_s in _DURATIONS_S
        for share in _MISSING
    ]
    return [*lengths, *flown, *(lambda share=share: [kept(seed, share)] for share in _MISSING)]


def _identified(duration_s: float, seeds: Sequence[int]) -> list[Row]:
    modes, rate_hz, points, noise_mm = ON_BOARD
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    score = Score(list(modes.values()))
    for seed in seeds:
        record = free_decay(modes, time_s, points, noise_mm, seed, axes=slice(0, 3))
        with threadpool_limits(limits=1):
            start = time.thread_time()
            valid = identify(time_s, record.noisy).valid_modes
            cpu_s = time.thread_time() - start
        found = [Found(m.frequency_hz, m.damping_ratio, m.frequency_sigma_hz, m.damping_ratio_sigma) for m in valid]
        score.add(found, cramer_rao(record), cpu_s)
    return score.rows("on_board", "wingbeat", f"{duration_s:.0f} s")


def _each_second(kind: Kind, duration_s: float, missing: float, seeds: Sequence[int]) -> Row:
    """Processor time of an identification as it flies: the newest seconds, in single precision, begun with what the one
    a second before knew.
    """
    rate_hz = ON_BOARD[1]
    frequency_hz = np.array(list(ON_BOARD[0].values()))
    length = round(duration_s * rate_hz)
    costs, valid, wrong = [], [], []
    for seed in seeds:
        time_s, noisy = _flown(kind, duration_s + _SECONDS, seed)
        hidden = np.random.default_rng(seed).uniform(size=(len(time_s), noisy.shape[1] // 3)) < missing
        noisy[np.tile(hidden, 3)] = np.nan
        known = None
        for k in range(_SECONDS + 1):
            begin = round(k * rate_hz)
            piece = noisy[begin : begin + length].astype(np.float32)
            with threadpool_limits(limits=1):
                start = time.thread_time()
                result = identify(time_s[:length], piece, overwrite=True, whole=True, known=known)
                costs.append(time.thread_time() - start)
            known = result.subspace
            valid.append(len(result.valid_modes))
            wrong.append(misleads(frequency_hz, result))
    return {
        "table": "on_board",
        "method": "wingbeat",
        "case": f"{kind}, {duration_s:.0f} s, each second, {100.0 * missing:.0f} % of the cells missing",
        "records": len(costs),
        "all_valid_percent": 100.0 * float(np.mean(np.equal(valid, len(frequency_hz)))),
        "valid_a_record": float(np.mean(valid)),
        "misleading": int(np.count_nonzero(wrong)),
        "cpu_ms": 1e3 * float(np.median(costs)),
    }


def _flown(kind: Kind, duration_s: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Time stamps (T,) and displacements (T, M) of the wing on board, struck or driven."""
    modes, rate_hz, points, noise_mm = ON_BOARD
    axes = slice(0, 3)
    if kind == "ambient":
        return stationary(modes, duration_s, rate_hz, points, noise_mm, seed, axes)
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    return time_s, free_decay(modes, time_s, points, noise_mm, seed, axes=axes).noisy


def kept(seed: int, missing: float) -> Row:
    """Processor time of taking a frame into the history, and all memory of history and identification.

    missing: share of the cells that are not measured in a tick.
    """
    modes, rate_hz, points, noise_mm = ON_BOARD
    time_s = np.arange(round(_DURATIONS_S[-1] * rate_hz)) / rate_hz
    record = free_decay(modes, time_s, points, noise_mm, seed, axes=slice(0, 3))
    xyz = np.moveaxis(record.noisy.reshape(len(time_s), 3, -1), 1, 2).copy()
    xyz[np.random.default_rng(seed).uniform(size=xyz.shape[:2]) < missing] = np.nan
    history = Displacements(*xyz.shape[:2])
    costs = []
    for row in xyz:
        start = time.thread_time()
        history.push(row)
        costs.append(time.thread_time() - start)
    # What the task identify sets aside, and uses up.
    copy = np.zeros(xyz.shape, np.float32)
    history.copy_latest(copy)
    y = copy.reshape(len(copy), -1)
    with threadpool_limits(limits=1):
        known = identify(time_s, y.copy(), overwrite=True, whole=True).subspace
        tracemalloc.start()
        try:
            identify(time_s, y, overwrite=True, whole=True, known=known)
            work = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    subspace = known.nbytes if known is not None else 0
    return {
        "table": "on_board",
        "method": "wingbeat",
        "case": f"memory, {100.0 * missing:.0f} % of the cells missing",
        "push_cpu_ms": 1e3 * float(np.median(costs)),
        "history_mb": history.nbytes / 1e6,
        "copy_mb": copy.nbytes / 1e6,
        "subspace_mb": subspace / 1e6,
        "work_peak_mb": work / 1e6,
        "state_mb": (history.nbytes + copy.nbytes + subspace + work) / 1e6,
    }
