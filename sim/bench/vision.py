"""The suite `vision`: its tables by name. docs/bench_vision.md tells what each column means."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import typer

from sim.bench.table import Row
from sim.bench.vision_disturbed import DISTURBANCES
from sim.bench.vision_learned import aliked_lightglue, obstacle
from sim.bench.vision_matchers import Matcher, orb, ours, paper_literal, sift
from sim.bench.vision_methods import methods, paper_scene, printed, sequence_scene
from sim.bench.vision_motion import motion, motions
from sim.bench.vision_pace import pace
from sim.bench.vision_sensors import SENSORS
from sim.bench.vision_stand import Stand
from sim.bench.vision_stress import stress
from sim.bench.vision_tracking import tracking
from wingbeat.errors import InputError

RUNS = 5
STRESS_BINNING = 2
TABLES = ("tracking", "stress", "sensors", "motion", "methods", "pace")


def cases(
    rows: str | None,
    runs: int | None,
    seed: int,
    sequence: Path | None = None,
    binning: int = STRESS_BINNING,
    pace_seconds: float = 60.0,
) -> list[Callable[[], Sequence[Row]]]:
    """What is measured, one after the other.

    rows: tables by name, separated by commas. runs: seeds a row of `stress`, `sensors`, `motion`. sequence: folder of a
    recorded sequence with its truth, for `methods`. binning: pixels a side read as one in the same tables.
    """
    wanted = list(TABLES) if rows is None else [name.strip() for name in rows.split(",")]
    for name in wanted:
        if name not in TABLES:
            raise InputError("is no table of the suite vision", name, f"choose of {', '.join(TABLES)}")
    seeds = range(seed, seed + (runs or RUNS))
    found: list[Callable[[], Sequence[Row]]] = []
    if "tracking" in wanted:
        found += [partial(tracking, 1, seed, at_rest) for at_rest in (False, True)]
    for name, disturbances in (("stress", DISTURBANCES), ("sensors", SENSORS)):
        if name in wanted:
            found += [partial(stress, name, disturbance, seeds, binning) for disturbance in disturbances]
    if "motion" in wanted:
        found += [partial(motion, case, seeds, binning) for case in motions()]
    if "methods" in wanted:
        matchers = _matchers()
        found += [printed, partial(methods, partial(paper_scene, seed), matchers)]
        if sequence is not None:
            found.append(partial(methods, partial(sequence_scene, sequence), matchers))
    if "pace" in wanted:
        found.append(partial(pace, pace_seconds, seed))
    return found


def _matchers() -> dict[str, Callable[[Stand], Matcher]]:
    """All methods that are installed; one line says which is left out."""
    found: dict[str, Callable[[Stand], Matcher]] = {
        "ours": ours,
        "paper-literal": paper_literal,
        "SIFT": lambda stand: sift,
        "ORB": lambda stand: orb,
    }
    why = obstacle()
    if why:
        typer.echo(f"ALIKED + LightGlue left out: {why} (docs/bench_vision.md)", err=True)
    else:
        found["ALIKED + LightGlue"] = lambda stand: aliked_lightglue()
    return found
