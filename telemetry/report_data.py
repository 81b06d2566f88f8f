"""What a run left in its folder, read for the report. Whatever is absent reads as empty: the page then says so."""

import csv
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from numpy.typing import NDArray

from telemetry.dictionary import MODE_PACKET
from wingbeat.errors import InputError

FloatArray = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]

_QUALITY_TEXT = "mode"  # the one column of quality.csv that is no number
_NO_POINTS: Arrays = {
    "time_s": np.zeros(0),
    "cell": np.zeros((0, 3), np.int64),
    "xyz_mm": np.zeros((0, 0, 3)),
    "sigma_mm": np.zeros((0, 0)),
    "centre_px": np.zeros((2, 0, 0, 2)),
}


@dataclass(frozen=True)
class Picture:
    """A PNG file as bytes, with its size in its own pixels."""

    png: bytes
    width: int
    height: int


@dataclass(frozen=True)
class Run:
    """A run's files. points, quality and diagram hold arrays by the contract's names; empty where there is no file.

    estimates: one entry a mode and a published estimate: the slot of /mode with the estimate's tick and time_s.
    pictures: left and right, as far as there are any.
    """

    modes: dict[str, Any]
    summary: dict[str, Any]
    points: Arrays
    quality: Arrays
    events: list[dict[str, Any]]
    estimates: list[dict[str, Any]]
    diagram: Arrays
    pictures: dict[str, Picture] = field(default_factory=dict)

    @property
    def start_s(self) -> float:
        """Time of the first trigger, from which the page counts."""
        times = self.quality["time_s"] if "time_s" in self.quality else self.points["time_s"]
        return float(times[0]) if len(times) else 0.0


def read_run(folder: Path) -> Run:
    """Read a run's folder. InputError: it is no run, or a file in it is damaged."""
    if not (folder / "modes.json").is_file():
        raise InputError("no modes.json: this is no run", folder, "name the folder that a run has written")
    try:
        return Run(
            modes=_json(folder / "modes.json"),
            summary=_json(folder / "summary.json"),
            points=_NO_POINTS | _arrays(folder / "points.npz"),
            quality=_quality(folder / "quality.csv"),
            events=_events(folder / "events.jsonl"),
            estimates=_estimates(folder / "flight.mcap"),
            diagram=_arrays(folder / "diagram.npz"),
            pictures={eye: picture for eye in ("left", "right") if (picture := _picture(folder / f"{eye}.png"))},
        )
    except (ValueError, KeyError, McapError) as error:
        raise InputError(f"a file of the run is damaged ({error})", folder, "run it again") from None


def _json(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text())) if path.is_file() else {}


def _arrays(path: Path) -> Arrays:
    if not path.is_file():
        return {}
    with np.load(path) as file:
        return {name: file[name] for name in file}


def _quality(path: Path) -> Arrays:
    """Columns of quality.csv; an empty field is NaN."""
    if not path.is_file():
        return {}
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    columns = zip(*rows, strict=True) if rows else [()] * len(header)
    return {
        name: np.array(texts, dtype=np.str_)
        if name == _QUALITY_TEXT
        else np.array([float(text or "nan") for text in texts])
        for name, texts in zip(header, columns, strict=True)
    }


def _events(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text().splitlines() if line]


def _estimates(path: Path) -> list[dict[str, Any]]:
    """The modes that were sent, each estimate once, although it is sent again until the next one comes."""
    if not path.is_file():
        return []
    sent: dict[int, list[dict[str, Any]]] = {}
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(topics=[f"/{MODE_PACKET.name}"]):
            shown = json.loads(message.data)
            if "tick" in shown:
                at = {"tick": shown["tick"], "time_s": shown["time_s"]}
                sent.setdefault(shown["tick"], [at | slot for slot in shown["slots"] if "frequency_hz" in slot])
    return [mode for tick in sorted(sent) for mode in sent[tick]]


def _picture(path: Path) -> Picture | None:
    if not path.is_file():
        return None
    png = path.read_bytes()
    if png[:8] != b"\x89PNG\r\n\x1a\n" or len(png) < 24:
        raise ValueError(f"{path.name} is no PNG image")
    return Picture(png, *struct.unpack(">II", png[16:24]))
