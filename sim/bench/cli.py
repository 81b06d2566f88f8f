"""The command `wingbeat bench`: the suites by name, the table for people and the rows for programs."""

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from sim.bench.machine import this_machine
from sim.bench.table import Row, table_text
from wingbeat.console import progress, write_json

# Each module has `cases(runs, seed)`: what is measured, one after the other; a case returns rows.
SUITES = {"vision": "sim.bench.vision", "modal": "sim.bench.modal"}


def bench(
    suite: Annotated[str, typer.Argument(help=f"{', '.join(SUITES)} or all.")],
    runs: Annotated[int | None, typer.Option(min=1, help="Seeds a row; default: what the suite's page names.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 1,
    rows: Annotated[str | None, typer.Option(help="Tables by name, separated by commas; default: all.")] = None,
    sequence: Annotated[
        Path | None, typer.Option(help="vision: a recorded sequence's folder with its truth.npz, for `methods`.")
    ] = None,
    binning: Annotated[
        int, typer.Option(min=1, help="vision: pixels a side read as one in simulated tables; 1: full images.")
    ] = 2,
    pace_seconds: Annotated[float, typer.Option(min=1.0, help="vision: duration of `pace`, at real pace.")] = 60.0,
    json_file: Annotated[str | None, typer.Option("--json", help="The rows as JSON; - for stdout.")] = None,
) -> None:
    """Measure every method on the same data in one run: accuracy, honesty and processor time, beside the limits.

    Example: wingbeat bench modal --json modal.json
    """
    if suite != "all" and suite not in SUITES:
        raise typer.BadParameter(f"{suite} is no suite; choose one of {', '.join(SUITES)} or all", param_hint="suite")
    names = list(SUITES) if suite == "all" else [suite]
    own: dict[str, dict[str, Any]] = {
        "vision": {"sequence": sequence, "binning": binning, "pace_seconds": pace_seconds}
    }
    cases = [
        case for name in names for case in import_module(SUITES[name]).cases(rows, runs, seed, **own.get(name, {}))
    ]
    found: list[Row] = []
    with progress(f"bench {suite}", len(cases)) as advance:
        for case in cases:
            found.extend(case())
            advance()
    if json_file is not None:
        write_json({"machine": this_machine(), "rows": found}, json_file)
    if json_file != "-":
        typer.echo(table_text(found))


Case = Callable[[], Sequence[Row]]
