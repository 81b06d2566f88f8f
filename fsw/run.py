"""One run of the flight application into a folder: what it sends, what it measured, and the run in figures.

The folder grows under the name NAME.partial and takes its own name when the run is complete.
"""

import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.app import App
from fsw.geometry import make_wing_grid
from fsw.modal.result import to_contract
from fsw.parts import Drivers, MakeVision, Tables, make_vision
from fsw.run_log import POINTS, RunLog
from fsw.supervisor import Start, Supervisor
from fsw.tasks.acquire import DROPS
from fsw.tasks.publish import Outlets
from fsw.tasks.state import State
from hal.bus import Bus
from hal.link import Link
from hal.store import FileStore
from telemetry.dictionary import (
    EVENT_COUNT,
    FLAGS,
    VALID,
    ModeFlag,
)
from telemetry.logs import CanLog, MavlinkLog
from telemetry.recorder import Recorder
from wingbeat.errors import InputError

SUMMARY = "summary.json"  # written last: a folder that has it is a complete run


@contextmanager
def run_folder(out: Path) -> Iterator[Path]:
    """A folder to fill, which becomes `out` when the block ends well.

    If it does not, what was measured until then stays in NAME.partial; nothing stays where nothing was measured. An
    `out` that is a complete run is replaced; one that is anything else is refused. Raises InputError.
    """
    if out.exists() and not (out / SUMMARY).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("is there already, and is no run", out, "name another folder with --out")
    partial = out.with_name(out.name + ".partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", partial, "name a writable folder with --out") from None
    try:
        yield partial
    except BaseException:
        if not (partial / POINTS).exists():
            shutil.rmtree(partial, ignore_errors=True)
        raise
    if out.exists():
        shutil.rmtree(out)
    partial.replace(out)


def fly(
    tables: Tables,
    drivers: Drivers,
    folder: Path,
    lockstep: bool = True,
    bus: Bus | None = None,
    each_tick: Callable[[], None] = lambda: None,
    vision: MakeVision = make_vision,
    link: Link | None = None,
) -> dict[str, Any]:
    """Fly until the trigger ends, and leave the files of the contract in `folder`, but for summary.json and the report.

    Returns the run in figures. each_tick is called after every tick, for progress.
    """
    store = FileStore(folder)
    with ExitStack() as stack:
        cells = make_wing_grid(tables.wing).cell
        outlets = Outlets(
            bus=bus,
            link=link,
            can_log=stack.enter_context(CanLog(folder / "can.log")),
            mavlink_log=stack.enter_context(MavlinkLog(folder / "mavlink.tlog")),
            recorder=stack.enter_context(Recorder(folder / "flight.mcap", cells)),
            events=stack.enter_context(store.stream("events.jsonl")),
        )
        log = stack.enter_context(RunLog(folder, cells))
        spent: dict[str, list[float]] = defaultdict(list)
        seen: dict[str, int] = defaultdict(int)
        flown = replace(drivers, outlets=outlets, store=store)

        def make(start: Start) -> App:
            return App(tables, flown, lockstep, vision, start)

        supervisor = Supervisor(make, store, tables.flight.executive.most_restarts)
        try:
            supervisor.init()
            while supervisor.step():
                log.add(supervisor.app.state)
                _add_spent(supervisor.app, spent, seen)
                each_tick()
        finally:
            supervisor.close()
        app = supervisor.app
        modes = published_modes(app.state)
        store.write("modes.json", as_json(modes))
        write_diagram(app.state, folder, cells)
        return log.figures() | _figures(app, modes, spent)


def as_json(content: dict[str, Any]) -> bytes:
    """A JSON file's bytes."""
    return (json.dumps(content, indent=2, allow_nan=False) + "\n").encode()


def published_modes(state: State) -> dict[str, Any]:
    """modes.json: the estimate on the board, with the validity and the flags that were sent with it."""
    if state.shown is None:
        return {"modes": [], "flags": [], "record": {"duration_s": 0.0, "samples": 0, "rate_hz": None}}
    modes = to_contract(state.shown.result)
    for slot, mode in zip(state.shown.slots, modes["modes"], strict=True):
        mode["valid"] = state.board.get(VALID, slot) == 1.0
        sent = ModeFlag(int(state.board.get(FLAGS, slot)))
        names = [flag.name.lower() for flag in sent if flag.name]
        mode["flags"] = sorted({*mode["flags"], *names})
    modes["estimate"] = {"tick": state.shown.tick, "time_s": state.shown.time_ns * 1e-9, "held": state.held}
    return modes


def write_diagram(state: State, folder: Path, cells: NDArray[np.integer[Any]]) -> None:
    """diagram.npz, for the report: stabilisation diagram, spectrum and mode shapes (modes, cells, 3) of modes.json."""
    if state.shown is None:
        return
    result, used = state.shown.result, state.shown.cells
    shapes = [mode.shape.reshape(-1, 3) for mode in result.modes]
    np.savez_compressed(
        folder / "diagram.npz",
        **asdict(result.diagram),
        shape=np.array(shapes, np.complex128).reshape(len(shapes), len(used), 3),
        shape_cell=cells[used],
    )


def _figures(app: App, modes: dict[str, Any], spent: dict[str, list[float]]) -> dict[str, Any]:
    """Counters and timing of a finished run."""
    executive, board = app.executive, app.state.board
    drops = {point.name.removeprefix("drops_"): board.get(point) for point in DROPS}
    return {
        "ticks_missed": executive.missed_ticks,
        "drops": {cause: 0 if count != count else int(count) for cause, count in drops.items()},
        "overruns": executive.overruns,
        "events": int(board.get(EVENT_COUNT)),
        "valid_modes": sum(mode["valid"] for mode in modes["modes"]),
        "cpu_ms": {task: _timing(spent[task]) for task in executive.tasks},
    }


def _add_spent(app: App, spent: dict[str, list[float]], seen: dict[str, int]) -> None:
    """Note what each task's newest run took, if there was one since the last tick."""
    for task in app.executive.tasks:
        figures = app.executive.timing(task)[0].summary()
        if figures.runs != seen[task]:
            seen[task] = figures.runs
            spent[task].append(figures.last_ms)


def _timing(spent_ms: list[float]) -> dict[str, float | int | None]:
    """Thread-CPU time of a task's runs, in ms; spent_ms: one entry a run."""
    if not spent_ms:
        return {"runs": 0, "mean": None, "p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(spent_ms, (50, 99))
    figures = {"mean": float(np.mean(spent_ms)), "p50": float(p50), "p99": float(p99), "max": max(spent_ms)}
    return {"runs": len(spent_ms)} | {name: round(value, 3) for name, value in figures.items()}
