"""The command `wingbeat faults`: the fault campaign, and the soak."""

import json
import os
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from sim.campaign import chosen_faults, fly_all, orders_for
from sim.campaign_report import campaign_document, campaign_table
from sim.soak import soak, soak_text
from wingbeat.console import progress, write_json
from wingbeat.errors import InputError


def faults(
    runs: Annotated[int, typer.Option(min=0, help="Flights with a fault; the rows of the failure list in turn.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Moments, sizes and noise are drawn from it.")] = 1,
    rows: Annotated[str | None, typer.Option(help="Rows by name, separated by commas; default: all.")] = None,
    nominal_hours: Annotated[float, typer.Option(min=0.0, help="Hours to fly without a fault.")] = 1.0,
    surrogate_only: Annotated[bool, typer.Option(help="No flight through the whole chain of vision.")] = False,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes; default: one for each core.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the table and what each flight showed.")] = None,
    json_file: Annotated[str | None, typer.Option("--json", help="The figures as JSON; - for stdout.")] = None,
    soak_ticks: Annotated[int, typer.Option(min=0, help="Instead: fly so many ticks and watch the memory.")] = 0,
) -> None:
    """Inject each failure of the list into simulated flights, and measure how soon the flight side finds it.

    Ends with 1 if a fault was missed or found late, a message misled, a false alarm was raised, or a flight that must
    measure again did not. Most flights are flown with a fast surrogate of the vision chain, the first of each row
    through the whole chain. The figures depend on the seed alone, not on --jobs.

    Example: wingbeat faults --runs 500 --json faults.json
    """
    if soak_ticks:
        _soak(soak_ticks, seed, json_file)
        return
    orders = orders_for(chosen_faults(rows), runs, seed, surrogate_only, nominal_hours)
    if not orders:
        raise InputError("there is nothing to fly", "--runs 0", "ask for runs or for nominal hours")
    with progress("faults", len(orders)) as advance:
        findings = fly_all(orders, jobs or os.cpu_count() or 1, advance)
    document, table = campaign_document(findings, seed), campaign_table(findings)
    if out is not None:
        _write(out, table, [msgspec.to_builtins(flight) for flight in findings])
    if json_file is not None:
        write_json(document, json_file)
    if json_file != "-":
        typer.echo(table)
    if not document["good"]:
        raise typer.Exit(1)


def _soak(ticks: int, seed: int, json_file: str | None) -> None:
    with progress("soak", ticks) as advance:
        figures = soak(ticks, seed, advance)
    if json_file is not None:
        write_json(msgspec.to_builtins(figures) | {"good": figures.good}, json_file)
    if json_file != "-":
        typer.echo(soak_text(figures))
    if not figures.good:
        raise typer.Exit(1)


def _write(folder: Path, table: str, flights: list[dict[str, object]]) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "table.txt").write_text(table + "\n", encoding="utf-8")
        (folder / "flights.json").write_text(json.dumps(flights, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", folder, "name a writable folder with --out") from None
