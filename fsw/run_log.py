"""What a run measured, tick by tick: points.npz, quality.csv, and a picture of the first pair.

Rows go to disk as they come, so that a long run does not fill the memory.
"""

import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.tasks.state import State
from telemetry.dictionary import (
    CHAR,
    CMP,
    DETECTED_LEFT,
    DETECTED_RIGHT,
    MATCHED,
    MU,
    PRECISION,
    RECALL,
    REPROJECTION_RMS_PX,
)

POINTS = "points.npz"
PREVIEW_WIDTH = 1400
QUALITY_HEADER = (
    "tick", "time_s", "mode", "detected_left", "detected_right", "matched", "char", "mu", "cmp", "precision", "recall",
    "reprojection_rms_px",
)  # fmt: skip
_QUALITY_POINTS = (DETECTED_LEFT, DETECTED_RIGHT, MATCHED, CHAR, MU, CMP, PRECISION, RECALL, REPROJECTION_RMS_PX)
_WHOLE = {DETECTED_LEFT, DETECTED_RIGHT, MATCHED}


class RunLog:
    """points.npz and quality.csv of one run, in the given folder. cells (N, 3): panel, column, row."""

    def __init__(self, folder: Path, cells: NDArray[np.integer[Any]]) -> None:
        self._folder, self._cells = folder, cells
        self._row = np.dtype(
            [("time_s", "f8"), ("xyz_mm", "f8", (len(cells), 3)), ("sigma_mm", "f8", len(cells)),
             ("centre_px", "f8", (2, len(cells), 2))]
        )  # fmt: skip
        self._buffer = np.zeros(1, self._row)
        self._rows_path = folder / "points.active"
        self._seen = np.zeros(len(cells), np.bool_)
        self._preview: dict[str, int] | None = None
        self.ticks = self.tracked = 0

    def __enter__(self) -> "RunLog":
        self._rows = self._rows_path.open("wb")
        self._quality = (self._folder / "quality.csv").open("w", newline="")
        self._csv = csv.writer(self._quality, lineterminator="\n")
        self._csv.writerow(QUALITY_HEADER)
        return self

    def __exit__(self, *_: object) -> None:
        self._rows.close()
        self._quality.close()
        if self.ticks:
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
            if self._preview is None:
                self._preview = _write_preview(state, self._folder)
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
        return {
            "ticks": self.ticks,
            "ticks_measured": self.tracked,
            "cells_measured": int(self._seen.sum()),
            "preview": self._preview,
        }

    def _write_points(self) -> None:
        """The cells that were ever measured, all ticks."""
        rows = np.fromfile(self._rows_path, self._row)
        np.savez_compressed(
            self._folder / POINTS,
            time_s=rows["time_s"],
            cell=self._cells[self._seen],
            xyz_mm=rows["xyz_mm"][:, self._seen],
            sigma_mm=rows["sigma_mm"][:, self._seen],
            centre_px=np.ascontiguousarray(rows["centre_px"].swapaxes(0, 1)[:, :, self._seen]),
        )


def _write_preview(state: State, folder: Path) -> dict[str, int]:
    """left.png and right.png: this tick's pair, 8 bits, made smaller by a whole factor; a picture for the report."""
    scale = -(-state.pair.left.shape[1] // PREVIEW_WIDTH)
    for name, image in (("left", state.pair.left), ("right", state.pair.right)):
        size = (image.shape[1] // scale, image.shape[0] // scale)
        small = cv2.resize(image[: size[1] * scale, : size[0] * scale], size, interpolation=cv2.INTER_AREA)
        top = max(float(small.max()), 1.0)
        cv2.imwrite(str(folder / f"{name}.png"), np.rint(small * (255.0 / top)).astype(np.uint8))
    return {"tick": state.tick, "scale": scale}
