"""The commands `wingbeat replay` and `wingbeat identify`."""

import json
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from fsw.black_box_replay import DECISIONS, replay_black_box
from fsw.channels import read_channels, read_shapes
from fsw.modal.indicators import nearest_shape
from fsw.modal.pipeline import identify as identify_modes
from fsw.modal.result import ModalResult, Options, to_contract
from fsw.parts import Drivers, Tables
from fsw.run import SUMMARY, as_json, fly, run_folder
from fsw.tables.checks import load_hardware
from fsw.tables.flight import load_flight
from fsw.tables.schema import load_sequence
from hal.drivers.image_files import find_images
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.recorded import RecordedCamera, RecordedTrigger, Recording, open_recording
from hal.store import FileStore
from telemetry.modes_text import modes_table
from telemetry.report import write_identify_report, write_report
from wingbeat.console import progress, write_json


class Kind(StrEnum):
    """What a record holds."""

    DECAY = "decay"
    AMBIENT = "ambient"
    AUTO = "auto"


class MethodName(StrEnum):
    """How modes are found."""

    REFINED = "refined"
    PAPER = "paper"
    RDT_ERA_DC = "rdt_era_dc"
    SSI_DATA = "ssi_data"


class Weighting(StrEnum):
    """Weights of the Hankel matrix."""

    NONE = "none"
    CVA = "cva"


def replay(
    sequence: Annotated[
        Path,
        typer.Argument(help="sequence.toml: recorded stereo images, their cameras and wing; or a black box, .mcap."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results; default runs/NAME-OF-THE-FOLDER, and none for a black box."),
    ] = None,
    tables: Annotated[Path | None, typer.Option(help="Flight tables (TOML) to lay over the shipped ones.")] = None,
    json_file: Annotated[str | None, typer.Option("--json", help="The modes as JSON; - for stdout.")] = None,
) -> None:
    """Run the flight application over recorded stereo images, in lockstep; or make a black box's decisions again.

    A black box brings its own limits. Exit code 1 if a decision comes out other than it was recorded.

    Example: wingbeat replay recording/sequence.toml --out runs/recording

    Example: wingbeat replay black_box_001.mcap --out decisions
    """
    if sequence.suffix.lower() == ".mcap":
        if tables is not None or json_file is not None:
            raise typer.BadParameter("--tables and --json are for images; a black box brings its own limits")
        decide_again(sequence, out)
        return
    described = load_sequence(sequence)
    base = sequence.parent
    cameras, wing = load_hardware(base / described.cameras, base / described.wing)
    flight = load_flight(tables)
    recording = open_recording(
        find_images(base, described.left),
        find_images(base, described.right),
        ((cameras.left.width, cameras.left.height), (cameras.right.width, cameras.right.height)),
        described.rate_hz,
        base / described.timestamps if described.timestamps else None,
    )
    target = out or Path("runs") / sequence.resolve().parent.name
    with run_folder(target) as folder:
        with progress("replay", recording.ticks) as advance:
            figures = fly(
                Tables(cameras, wing, flight), _drivers(recording, described.rate_hz), folder, each_tick=advance
            )
        FileStore(folder).write(SUMMARY, as_json({"sequence": sequence.name} | figures))
        write_report(folder, f"Replay of {sequence.resolve().parent.name}")
    modes = json.loads((target / "modes.json").read_text())
    if json_file is not None:
        write_json(modes, json_file)
    if json_file != "-":
        typer.echo(modes_table(modes))
        typer.echo(f"files in {target}, start with {target / 'report.html'}")


def decide_again(black_box: Path, out: Path | None) -> None:
    """Say whether all decisions of a black box come out again as they were recorded; exit code 1 if not."""
    replayed = replay_black_box(black_box, out)
    if out is not None:
        typer.echo(f"decisions in {out / DECISIONS}")
    if replayed.difference:
        typer.echo(replayed.difference)
        raise typer.Exit(1)
    typer.echo(f"{len(replayed.decisions)} ticks: every decision reproduced")


def _drivers(recording: Recording, rate_hz: float) -> Drivers:
    clock = LockstepClock()
    eyes = (RecordedCamera(recording, 0), RecordedCamera(recording, 1))
    return Drivers(eyes, RecordedTrigger(recording, clock), clock, rate_hz)


def identify(
    file: Annotated[Path, typer.Argument(help="Recorded channels: .npz or .csv.")],
    rate: Annotated[float | None, typer.Option(help="Sampling rate in Hz, if the file does not say it.")] = None,
    kind: Annotated[Kind, typer.Option(help="Free decay, response to noise, or decided from the data.")] = Kind.AUTO,
    method: Annotated[
        MethodName, typer.Option(help="Maximum likelihood, the paper's fusion, or one of the two that it joins.")
    ] = MethodName.REFINED,
    weighting: Annotated[
        Weighting, typer.Option(help="Of the Hankel matrix, for the paper's methods.")
    ] = Weighting.NONE,
    shapes: Annotated[
        Path | None, typer.Option(help="Reference shapes to compare with: .npz with shape (modes, channels).")
    ] = None,
    json_file: Annotated[str | None, typer.Option("--json", help="The modes as JSON; - for stdout.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page with the diagrams to this file.")] = None,
) -> None:
    """Find the modes of recorded channels, with their uncertainty.

    A file with measured inputs (u) gives the modes of the plant alone, though a control loop is closed round it.

    Example: wingbeat identify record.csv --rate 100 --json modes.json
    """
    channels = read_channels(file, rate)
    reference = None if shapes is None else read_shapes(shapes, channels.y.shape[1]).astype(np.complex128)
    with threadpool_limits(limits=1):  # small matrices: more threads only wait for each other
        result: ModalResult = identify_modes(
            channels.time_s, channels.y, kind.value, Options(method=method.value, weighting=weighting.value), channels.u
        )
    modes = to_contract(result)
    if reference is not None:
        for row, mode in zip(modes["modes"], result.modes, strict=True):
            row["reference_shape"], row["shape_assurance"] = nearest_shape(mode.shape, reference)
    if report is not None:
        found = np.array([mode.shape for mode in result.modes]).reshape(len(result.modes), -1)
        write_identify_report(report, f"Modes of {file.name}", modes, asdict(result.diagram) | {"shape": found})
    if json_file is not None:
        write_json(modes, json_file)
    if json_file != "-":
        typer.echo(modes_table(modes))
        for row in modes["modes"] if reference is not None else ():
            like = f"like reference shape {row['reference_shape']}, assurance {row['shape_assurance']:.4f}"
            typer.echo(f"{row['frequency_hz']:.4g} Hz: {like}")
