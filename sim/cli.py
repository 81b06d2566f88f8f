"""The command `wingbeat sil`: the flight application in front of a simulated world."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from fsw.geometry import make_wing_grid
from fsw.parts import Drivers, Tables
from fsw.run import SUMMARY, as_json, fly, run_folder
from fsw.tables.checks import load_hardware
from fsw.tables.flight import load_flight
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.pymavlink_link import PymavlinkLink
from hal.drivers.python_can import PythonCanBus
from hal.drivers.realtime_process import become_realtime, restore
from hal.store import FileStore
from sim.cameras import SimulatedCamera, SimulatedTrigger, WorldClock
from sim.compare import compare_points, true_modes
from sim.flight_files import flight_files
from sim.scenario import check_scenario, load_scenario
from sim.truth import write_truth
from sim.world import World
from telemetry.modes_text import modes_table
from telemetry.report import write_report
from wingbeat.console import progress, write_json
from wingbeat.errors import InputError


class Pace(StrEnum):
    """How time runs: as fast as the machine can, or as in flight."""

    LOCKSTEP = "lockstep"
    REAL = "real"


def sil(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")] = "paper",
    duration: Annotated[float | None, typer.Option(help="Seconds to fly; default: the scenario's.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the world; default: the scenario's.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results; default runs/SCENARIO.")] = None,
    pace: Annotated[Pace, typer.Option(help="lockstep, or real: all images are drawn first.")] = Pace.LOCKSTEP,
    tables: Annotated[Path | None, typer.Option(help="Flight tables (TOML) to lay over the shipped ones.")] = None,
    can: Annotated[str, typer.Option(help="CAN bus, INTERFACE:CHANNEL of python-can.")] = "virtual:wingbeat",
    mavlink: Annotated[str | None, typer.Option(help="MAVLink line, such as udpout:127.0.0.1:14550.")] = None,
    json_file: Annotated[str | None, typer.Option("--json", help="modes and summary as JSON; - for stdout.")] = None,
) -> None:
    """Fly software in the loop: simulated wing, cameras and trigger, the real flight application, telemetry on files.

    Commands may come over both lines; when they do, and in which tick, only --pace real makes a question of time.

    Example: wingbeat sil small --duration 10 --seed 3 --out runs/first
    """
    chosen = load_scenario(scenario)
    if duration is not None:
        chosen = msgspec.structs.replace(chosen, duration_s=duration)
        check_scenario(chosen, f"{scenario} with --duration {duration:g}")
    flight = load_flight(tables)
    target = out or Path("runs") / Path(scenario).stem
    with run_folder(target) as folder:
        cameras, wing = load_hardware(*flight_files(chosen, folder))
        world = World(chosen, seed)
        clock = WorldClock() if pace is Pace.REAL else LockstepClock()
        trigger = SimulatedTrigger(world, clock)
        eyes = tuple(SimulatedCamera(world, eye, trigger, prerender=pace is Pace.REAL) for eye in (0, 1))
        bus = PythonCanBus(*bus_names(can))
        link = None if mavlink is None else PymavlinkLink(mavlink)
        drivers = Drivers((eyes[0], eyes[1]), trigger, clock, chosen.rate_hz, raw_line=True)
        try:
            with progress(f"sil {target.name}", chosen.ticks) as advance, _at_pace(pace) as granted:
                figures = fly(
                    Tables(cameras, wing, flight), drivers, folder, pace is Pace.LOCKSTEP, bus, advance, link=link
                )
        finally:
            bus.close()
            if link is not None:
                link.close()
            for eye in eyes:
                eye.close()
        truth = world.truth()
        write_truth(folder / "truth.npz", truth)
        against = compare_points(folder, truth, make_wing_grid(wing))
        known = true_modes(truth)
        summary = {"scenario": scenario, "seed": world.seed, "pace": pace.value, "realtime": granted} | figures
        summary |= {"true_modes": known, "against_truth": against}
        FileStore(folder).write(SUMMARY, as_json(summary))
        write_report(folder, f"Software in the loop: {scenario}")
    modes = json.loads((target / "modes.json").read_text())
    if json_file is not None:
        write_json({"modes": modes, "summary": summary}, json_file)
    if json_file != "-":
        typer.echo(modes_table(modes, known))
        if against["cells"]:
            typer.echo(
                f"{against['cells']} cells in {figures['ticks']} ticks; displacement error "
                f"{against['displacement_rms_mm']:.4f} mm rms (position {against['position_rms_z_mm']:.4f} mm in depth)"
            )
        typer.echo(f"files in {target}, start with {target / 'report.html'}")


def bus_names(can: str) -> tuple[str, str]:
    """Interface and channel. Raises InputError."""
    interface, colon, channel = can.partition(":")
    if not (interface and colon and channel):
        raise InputError("is no bus", f"--can {can}", "name INTERFACE:CHANNEL, such as socketcan:vcan0")
    return interface, channel


@contextmanager
def _at_pace(pace: Pace) -> Iterator[dict[str, str]]:
    """At real pace what the operating system can do for it; yields what was granted, and why not where it was not."""
    if pace is not Pace.REAL:
        yield {}
        return
    try:
        yield become_realtime()
    finally:
        restore()
