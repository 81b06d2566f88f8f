"""What the camera's rate asks for: 918 channels at 46 Hz, identified on the newest seconds of the history."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from fsw.memory.ring import Ring
from fsw.modal.pipeline import identify
from sim.bench.modal_bounds import cramer_rao
from sim.bench.modal_records import ON_BOARD, free_decay
from sim.bench.modal_scores import Found, Score
from sim.bench.table import Row

_DURATIONS_S = (6.0, 10.0)


def cases(runs: int, seed: int) -> list[Callable[[], Sequence[Row]]]:
    """One case a length of the history, and one of what each frame costs."""
    lengths: list[Callable[[], Sequence[Row]]] = [
        lambda d=duration_s: _identified(d, range(seed, seed + runs)) for duration_s in _DURATIONS_S
    ]
    return [*lengths, lambda: [_frames(seed)]]


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


def _frames(seed: int) -> Row:
    """Processor time of taking a frame into the history, and the history's size."""
    modes, rate_hz, points, noise_mm = ON_BOARD
    time_s = np.arange(round(_DURATIONS_S[-1] * rate_hz)) / rate_hz
    record = free_decay(modes, time_s, points, noise_mm, seed, axes=slice(0, 3))
    ring = Ring(len(time_s), (record.noisy.shape[1],), np.float64)
    costs = []
    for row in record.noisy:
        start = time.thread_time()
        ring.push(row)
        costs.append(time.thread_time() - start)
    return {
        "table": "on_board",
        "method": "wingbeat",
        "case": "a frame into the history",
        "cpu_ms": 1e3 * float(np.median(costs)),
        "history_mib": 2 * record.noisy.nbytes / 2**20,
    }
