"""The suite `vision`: its tables by name. docs/bench_vision.md tells what each column means."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from sim.bench.table import Row
from sim.bench.vision_disturbed import DISTURBANCES
from sim.bench.vision_stress import stress
from sim.bench.vision_tracking import tracking
from wingbeat.errors import InputError

RUNS = 5
STRESS_BINNING = 2
TABLES = ("tracking", "stress")


def cases(
    rows: str | None,
    runs: int | None,
    seed: int,
    sequence: Path | None = None,
    binning: int = STRESS_BINNING,
    pace_seconds: float = 60.0,
) -> list[Callable[[], Sequence[Row]]]:
    """What is measured, one after the other.

    rows: tables by name, separated by commas. runs: seeds a row of `stress` and `motion`. sequence: folder of a
    recorded sequence with its truth, for `methods`. binning: pixels a side read as one in `stress` and `motion`.
    """
    wanted = list(TABLES) if rows is None else [name.strip() for name in rows.split(",")]
    for name in wanted:
        if name not in TABLES:
            raise InputError("is no table of the suite vision", name, f"choose of {', '.join(TABLES)}")
    seeds = range(seed, seed + (runs or RUNS))
    found: list[Callable[[], Sequence[Row]]] = []
    if "tracking" in wanted:
        found += [partial(tracking, 1, seed, at_rest) for at_rest in (False, True)]
    if "stress" in wanted:
        found += [partial(stress, disturbance, seeds, binning) for disturbance in DISTURBANCES]
    return found
