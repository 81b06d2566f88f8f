"""The suite `wingbeat bench modal`: frequency and damping of known modes, by every method, on the same records."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from fsw.modal.pipeline import identify
from sim.bench import modal_loop, modal_on_board, modal_robust
from sim.bench.modal_beside import beside
from sim.bench.modal_bounds import cramer_rao, uncertainty_law
from sim.bench.modal_oracle import oracle
from sim.bench.modal_peers import peers
from sim.bench.modal_records import AMBIENT, DECAYS, FloatArray, published, stationary
from sim.bench.modal_scores import Found, Score, cover_percent
from sim.bench.table import Row
from wingbeat.errors import InputError

# Seeds a row if the command does not say.
RUNS = 40
Method = Callable[[FloatArray, FloatArray], list[Found]]
Case = Callable[[], Sequence[Row]]


def cases(rows: str | None, runs: int | None, seed: int) -> list[Case]:
    """What is measured, one after the other; rows: tables by name, separated by commas."""
    count = runs or RUNS
    tables: dict[str, list[Case]] = {
        "decay": _decay_cases(count, seed),
        "ambient": [lambda case=case: _ambient(case, count, seed) for case in AMBIENT],
        "robust": modal_robust.cases(count, seed),
        "loop": modal_loop.cases(count, seed),
        "on_board": modal_on_board.cases(count, seed),
    }
    wanted = list(tables) if rows is None else rows.split(",")
    if unknown := [name for name in wanted if name not in tables]:
        raise InputError("is no table of this suite", unknown[0], f"choose of {', '.join(tables)}")
    return [case for name in wanted for case in tables[name]]


def ours(time_s: FloatArray, y: FloatArray) -> list[Found]:
    """The valid modes that the flight software finds."""
    return [
        Found(mode.frequency_hz, mode.damping_ratio, mode.frequency_sigma_hz, mode.damping_ratio_sigma)
        for mode in identify(time_s, y).valid_modes
    ]


def timed(method: Method, time_s: FloatArray, y: FloatArray) -> tuple[list[Found], float]:
    """What a method finds, and the processor time in s that it took with one thread."""
    with threadpool_limits(limits=1):
        start = time.thread_time()
        found = method(time_s, y)
        return found, time.thread_time() - start


def _decay_cases(runs: int, seed: int) -> list[Case]:
    deviations: list[FloatArray] = []

    def measured(case: str) -> list[Row]:
        rows, own = _score("decay", case, runs, seed)
        deviations.extend(own.deviations)
        return rows

    def pooled() -> list[Row]:
        every = np.concatenate([errors.ravel() for errors in deviations])
        return [{"table": "decay", "method": "wingbeat", "case": "pooled", "cover_percent": cover_percent(every)}]

    return [*(lambda case=case: measured(case) for case in DECAYS), pooled]


def _ambient(case: str, runs: int, seed: int) -> list[Row]:
    return _score("ambient", case, runs, seed)[0]


def _score(table: str, case: str, runs: int, seed: int) -> tuple[list[Row], Score]:
    """Rows of every method on the same records, and the own method's score."""
    modes = (DECAYS | AMBIENT)[case][0]
    frequency_hz = list(modes.values())
    others = peers(table, len(modes))
    methods: dict[str, Method] = {"wingbeat": ours, **others, "oracle": lambda time_s, y: oracle(case, time_s, y)}
    scores = {name: Score(frequency_hz) for name in methods}
    for run in range(runs):
        time_s, y, bound = _record(table, case, seed + run)
        for name, method in methods.items():
            found, cpu_s = timed(method, time_s, y)
            scores[name].add(found, bound, cpu_s)
    rows = [row for name, score in scores.items() for row in score.rows(table, name, case)]
    rows += beside(table, case, scores["wingbeat"], {name: scores[name] for name in others}, scores["oracle"])
    return rows, scores["wingbeat"]


def _record(table: str, case: str, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time stamps, channels, and the bound (m, 2) of the record."""
    if table == "decay":
        record = published(case, seed)
        return record.time_s, record.noisy, cramer_rao(record)
    modes, duration_s, rate_hz, points, noise_mm = AMBIENT[case]
    time_s, y = stationary(modes, duration_s, rate_hz, points, noise_mm, seed)
    return time_s, y, np.array([uncertainty_law(f, duration_s) for f in modes.values()])
