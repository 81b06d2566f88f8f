"""One run of the flight application into a folder: what it sends, what it measured, and the run in figures.

The folder grows under the name NAME.partial and takes its own name when the run is complete.
"""

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.app import App, Drivers, Tables
from fsw.modal.result import to_contract
from fsw.tasks.publish import Outlets
from fsw.tasks.state import State
from hal.bus import Bus
from telemetry.dictionary import (
    CHAR,
    CMP,
    DETECTED_LEFT,
    DETECTED_RIGHT,
    DROPS_CORRUPT,
    DROPS_MISSING,
    DROPS_SKEW,
    DROPS_STUCK,
    EVENT_COUNT,
    FLAGS,
    MATCHED,
    MODE_SLOTS,
    MU,
    PRECISION,
    RECALL,
    REPROJECTION_RMS_PX,
    VALID,
    ModeFlag,
)
from telemetry.logs import CanLog, MavlinkLog
from telemetry.recorder import Recorder
from wingbeat.errors import InputError

SUMMARY = "summary.json"  # written last: a folder that has it is a complete run
QUALITY_HEADER = (
    "tick", "time_s", "mode", "detected_left", "detected_right", "matched", "char", "mu", "cmp", "precision", "recall",
    "reprojection_rms_px",
)  # fmt: skip
_QUALITY_POINTS = (DETECTED_LEFT, DETECTED_RIGHT, MATCHED, CHAR, MU, CMP, PRECISION, RECALL, REPROJECTION_RMS_PX)
DROPS = (DROPS_MISSING, DROPS_SKEW, DROPS_CORRUPT, DROPS_STUCK)
_WHOLE = {DETECTED_LEFT, DETECTED_RIGHT, MATCHED}


@contextmanager
def run_folder(out: Path) -> Iterator[Path]:
    """A folder to fill, which becomes `out` when the block ends well, and vanishes when it does not.

    An `out` that is a complete run is replaced; one that is anything else is refused. Raises InputError.
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
) -> dict[str, Any]:
    """Fly until the trigger ends, and leave the files of the contract in `folder`, but for summary.json and the report.

    Returns the run in figures. each_tick is called after every tick, for progress.
    """
    with ExitStack() as stack:
        cells = np.array([(p, c, r) for p, panel in enumerate(tables.wing.panel)
                          for c in range(panel.columns) for r in range(panel.rows)])  # fmt: skip
        outlets = Outlets(
            bus=bus,
            can_log=stack.enter_context(CanLog(folder / "can.log")),
            mavlink_log=stack.enter_context(MavlinkLog(folder / "mavlink.tlog")),
            recorder=stack.enter_context(Recorder(folder / "flight.mcap", cells)),
            events=stack.enter_context((folder / "events.jsonl").open("wb")),
        )
        log = stack.enter_context(RunLog(folder, cells))
        app = App(tables, replace(drivers, outlets=outlets), lockstep)
        try:
            app.init()
            while app.step():
                log.add(app.state)
                each_tick()
        finally:
            app.close()
        modes = published_modes(app.state)
        (folder / "modes.json").write_text(json.dumps(modes, indent=2, allow_nan=False) + "\n")
        return log.figures() | _figures(app, modes)


def published_modes(state: State) -> dict[str, Any]:
    """modes.json: the estimate on the board, with the validity and the flags that were sent with it."""
    if state.shown is None:
        return {"modes": [], "flags": [], "record": {"duration_s": 0.0, "samples": 0, "rate_hz": None}}
    modes = to_contract(state.shown.result)
    for slot, mode in enumerate(modes["modes"][:MODE_SLOTS]):
        mode["valid"] = state.board.get(VALID, slot) == 1.0
        sent = ModeFlag(int(state.board.get(FLAGS, slot)))
        names = [flag.name.lower() for flag in sent if flag.name]
        mode["flags"] = sorted({*mode["flags"], *names})
    modes["estimate"] = {"tick": state.shown.tick, "time_s": state.shown.time_ns * 1e-9, "held": state.held}
    return modes


class RunLog:
    """points.npz and quality.csv. Rows go to disk as they come, so that a long run does not fill the memory."""

    def __init__(self, folder: Path, cells: NDArray[np.integer[Any]]) -> None:
        self._folder, self._cells = folder, cells
        self._row = np.dtype(
            [("time_s", "f8"), ("xyz_mm", "f8", (len(cells), 3)), ("sigma_mm", "f8", len(cells)),
             ("centre_px", "f8", (2, len(cells), 2))]
        )  # fmt: skip
        self._buffer = np.zeros(1, self._row)
        self._rows_path = folder / "points.active"
        self._seen = np.zeros(len(cells), np.bool_)
        self.ticks = self.tracked = 0

    def __enter__(self) -> "RunLog":
        self._rows = self._rows_path.open("wb")
        self._quality = (self._folder / "quality.csv").open("w", newline="")
        self._csv = csv.writer(self._quality, lineterminator="\n")
        self._csv.writerow(QUALITY_HEADER)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._rows.close()
        self._quality.close()
        if kind is None:
            self._write_points()
        self._rows_path.unlink()

    def add(self, state: State) -> None:
        """Log one tick."""
        row, tracker = self._buffer[0], state.tracker
        row["time_s"] = state.time_ns * 1e-9
        for name in ("xyz_mm", "sigma_mm", "centre_px"):
            row[name] = np.nan
        if state.measured:
            valid = tracker.points.valid
            self._seen |= valid
            row["xyz_mm"], row["sigma_mm"] = tracker.points.xyz_mm, tracker.points.sigma_mm
            for eye in (0, 1):
                row["centre_px"][eye] = tracker.rig.distort(eye, tracker.centre_px[eye])
            row["centre_px"][:, ~valid] = np.nan
            self.tracked += 1
        self._buffer.tofile(self._rows)
        values = (state.board.get(point) for point in _QUALITY_POINTS)
        shown = (
            "" if value != value else int(value) if point in _WHOLE else f"{value:.6f}"
            for point, value in zip(_QUALITY_POINTS, values, strict=True)
        )
        self._csv.writerow([state.tick, f"{state.time_ns * 1e-9:.9f}", state.mode.name, *shown])
        self.ticks += 1

    def figures(self) -> dict[str, Any]:
        """How much of the run was measured."""
        return {"ticks": self.ticks, "ticks_measured": self.tracked, "cells_measured": int(self._seen.sum())}

    def _write_points(self) -> None:
        """The cells that were ever measured, all ticks."""
        rows = np.fromfile(self._rows_path, self._row)
        np.savez_compressed(
            self._folder / "points.npz",
            time_s=rows["time_s"],
            cell=self._cells[self._seen],
            xyz_mm=rows["xyz_mm"][:, self._seen],
            sigma_mm=rows["sigma_mm"][:, self._seen],
            centre_px=np.ascontiguousarray(rows["centre_px"].swapaxes(0, 1)[:, :, self._seen]),
        )


def _figures(app: App, modes: dict[str, Any]) -> dict[str, Any]:
    """Counters and timing of a finished run."""
    executive, board = app.executive, app.state.board
    drops = {point.name.removeprefix("drops_"): board.get(point) for point in DROPS}
    return {
        "ticks_missed": executive.missed_ticks,
        "drops": {cause: 0 if count != count else int(count) for cause, count in drops.items()},
        "overruns": executive.overruns,
        "events": int(board.get(EVENT_COUNT)),
        "valid_modes": sum(mode["valid"] for mode in modes["modes"]),
        "cpu_ms": {task: _timing(app, task) for task in executive.tasks},
    }


def _timing(app: App, task: str) -> dict[str, float | int | None]:
    """Thread-CPU time of a task's runs, in ms."""
    cpu, _ = app.executive.timing(task)
    figures = cpu.summary()
    return {
        "runs": figures.runs,
        "mean": _known(figures.mean_ms),
        "p50": _known(cpu.percentile_ms(0.5)),
        "p99": _known(cpu.percentile_ms(0.99)),
        "max": _known(figures.max_ms),
    }


def _known(value: float) -> float | None:
    return round(value, 3) if value == value else None
