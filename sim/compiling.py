"""The command `wingbeat compile`: all kernels of a flight, compiled before the first one, in processes side by side.

Each process does a part of what INIT and the first image do one after the other. What another process has compiled by
then it finds in the cache (`wingbeat/kernels.py`).
"""

import multiprocessing
import os
import tempfile
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from fsw.app import App
from hal.frame import make_frames
from sim.campaign import one_thread_each
from sim.campaign_stage import FlightStage
from sim.surrogate_world import Scene
from wingbeat.console import progress
from wingbeat.kernels import FOLDER

FEATURE, IMAGE, OTHERS, SEARCH, SURROGATE = "feature", "image", "others", "search", "surrogate"
PARTS = (FEATURE, IMAGE, OTHERS, SEARCH, SURROGATE)
"""In the order in which they are best begun: feature takes long, and the last ones call what feature and others do."""


def compile_kernels(
    bits: Annotated[int, typer.Option(min=8, max=16, help="Of the cameras' grey values.")] = 8,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes; default: one for each core.")] = None,
) -> None:
    """Compile all kernels of the flight software and of the simulation now, so that no INIT need wait for them.

    They are kept for this user until a source changes. Cameras with more than 8 bits have some of their own: without
    `--bits`, INIT compiles them.

    Example: wingbeat compile
    """
    count = min(jobs or os.cpu_count() or 1, len(PARTS))
    pool = multiprocessing.get_context("spawn").Pool
    with progress("compile", len(PARTS)) as advance, one_thread_each(), pool(count) as processes:
        for _ in processes.imap_unordered(partial(compile_part, bits=bits), PARTS):
            advance()
    typer.echo(f"kernels are ready in {FOLDER}")


def compile_part(part: str, bits: int = 8) -> None:
    """Call the kernels of one of PARTS, as a flight of the scenario `small`, or of the fault campaign's surrogate."""
    with tempfile.TemporaryDirectory() as folder:
        stage = FlightStage(1, 0, Path(folder), whole=part != SURROGATE, bits=bits)
        if part in (IMAGE, SURROGATE):
            spoil(stage.world.scene)
            for eye in (0, 1):
                stage.world.render(0, 0, eye, make_frames((stage.world.height, stage.world.width), stage.world.dtype))
        if part == IMAGE:
            return
        app = App(stage.tables, stage.drivers, vision=stage.vision)
        try:
            for task in app.executive.tasks:
                if part in (task, SURROGATE) or (part == OTHERS and task not in PARTS):
                    app.executive.prepare(task)
        finally:
            app.close()


def spoil(scene: Scene) -> None:
    """All that faults do to a scene."""
    scene.shadow = scene.glint = scene.gain = 0.5
    scene.bump_px = scene.grain = 1.0
