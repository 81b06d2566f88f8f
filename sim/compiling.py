"""The command `wingbeat compile`: all kernels of a flight, compiled before the first one, in processes side by side.

Each process does a part of what INIT and the first image do one after the other. What another process has compiled by
then it finds in the cache (`wingbeat/kernels.py`).
"""

import multiprocessing
import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from fsw.app import App
from hal.frame import make_frames
from sim.campaign import one_thread_each
from sim.campaign_stage import FlightStage
from wingbeat.console import progress
from wingbeat.kernels import FOLDER

FEATURE, IMAGE, OTHERS, SEARCH = "feature", "image", "others", "search"
PARTS = (FEATURE, IMAGE, OTHERS, SEARCH)
"""In the order in which they are best begun: feature takes long, and search calls what feature and others do, too."""


def compile_kernels(
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes; default: one for each core.")] = None,
) -> None:
    """Compile all kernels of the flight software and of the renderer now, so that no INIT need wait for them.

    They are kept for this user until a source changes. They are those of cameras with 8 bits: with more, INIT compiles.

    Example: wingbeat compile
    """
    count = min(jobs or os.cpu_count() or 1, len(PARTS))
    pool = multiprocessing.get_context("spawn").Pool
    with progress("compile", len(PARTS)) as advance, one_thread_each(), pool(count) as processes:
        for _ in processes.imap_unordered(compile_part, PARTS):
            advance()
    typer.echo(f"kernels are ready in {FOLDER}")


def compile_part(part: str) -> None:
    """Call the kernels of one of PARTS, as a flight of the scenario `small` does."""
    with tempfile.TemporaryDirectory() as folder:
        stage = FlightStage(1, 0, Path(folder), whole=True)
        if part == IMAGE:
            world = stage.world
            world.render(0, 0, 0, make_frames((world.height, world.width), world.dtype))
            return
        app = App(stage.tables, stage.drivers)
        try:
            for task in app.executive.tasks:
                if task == part or (part == OTHERS and task not in PARTS):
                    app.executive.prepare(task)
        finally:
            app.close()
