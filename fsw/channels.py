"""Recorded channels from .npz and .csv files, in the contract's form, with errors that say what to mend."""

import csv
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wingbeat.errors import InputError

FloatArray = NDArray[np.float64]

_KEYS = {"time_s", "rate_hz", "y", "geometry", "u"}
# What a spreadsheet writes where a sample is missing.
_MISSING = {"", "nan", "na", "n/a", "null", "none"}


@dataclass(frozen=True)
class Channels:
    """time_s (T,) increasing; y (T, M), NaN = missing; geometry (M, 3), measured inputs u (T, inputs) if there."""

    time_s: FloatArray
    y: FloatArray
    geometry: FloatArray | None = None
    u: FloatArray | None = None


def read_channels(path: str | Path, rate_hz: float | None = None) -> Channels:
    """Channels of a file: .npz with y and time_s or rate_hz, or .csv with a header line and time_s as its
    first column.

    rate_hz: for a file without time; where the file has time or a rate of its own, that is what counts.
    Raises InputError naming file, key or line and column.
    """
    file = Path(path)
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise InputError(f"the rate {rate_hz} Hz is not positive", "--rate", "give samples per second")
    if not file.is_file():
        raise InputError("there is no such file", file, "give a .npz or .csv file of recorded channels")
    suffix = file.suffix.lower()
    if suffix not in (".npz", ".csv"):
        raise InputError(f"unknown kind of file {suffix or '(no suffix)'}", file, "give a .npz or .csv file")
    try:
        return _read_npz(file, rate_hz) if suffix == ".npz" else _read_csv(file, rate_hz)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file, "check the file") from None


def _read_npz(file: Path, rate_hz: float | None) -> Channels:
    try:
        with np.load(file, allow_pickle=False) as data:
            held: dict[str, Any] = {key: data[key] for key in data.files}
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile):
        raise InputError("is not a readable .npz file", file, "write it with numpy.savez") from None
    if "y" not in held:
        found = ", ".join(sorted(held)) or "nothing"
        raise InputError(f"has no y (it has {found})", file, "store the channels as y (T, channels)")
    if unknown := sorted(set(held) - _KEYS):
        raise InputError(f"unknown key {unknown[0]}", file, f"allowed: {', '.join(sorted(_KEYS))}")
    y = _numbers(held["y"], file, "y")
    y = y[:, None] if y.ndim == 1 else y
    if y.ndim != 2:
        raise InputError(f"y has shape {y.shape}", file, "y must be (T, channels)")
    own_rate = float(_numbers(held["rate_hz"], file, "rate_hz").reshape(-1)[0]) if "rate_hz" in held else None
    if own_rate is not None and not (np.isfinite(own_rate) and own_rate > 0.0):
        raise InputError(f"rate_hz is {own_rate}", file, "it must be positive, in samples per second")
    time_s = _numbers(held["time_s"], file, "time_s") if "time_s" in held else None
    geometry = _matching(held, "geometry", y.shape[1], 3, file)
    u = _matching(held, "u", len(y), None, file)
    return Channels(_time(time_s, own_rate or rate_hz, len(y), file), _some(y, file), geometry, u)


def read_shapes(path: str | Path, channels: int) -> FloatArray:
    """Reference shapes (k, channels) of a .npz file with `shape`, as an FE model gives them; NaN = unknown.

    Raises InputError naming the file and what does not fit.
    """
    file = Path(path)
    try:
        with np.load(file, allow_pickle=False) as data:
            held = {key: data[key] for key in data.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        raise InputError("is not a readable .npz file", file, "write it with numpy.savez") from None
    if "shape" not in held:
        raise InputError("has no shape", file, "store the shapes as shape (modes, channels)")
    shapes = np.atleast_2d(_numbers(held["shape"], file, "shape"))
    if shapes.ndim != 2 or shapes.shape[1] != channels:
        raise InputError(f"shape is {shapes.shape}", file, f"it must be (modes, {channels}) to fit y")
    return shapes


def _numbers(values: NDArray[Any], file: Path, key: str) -> FloatArray:
    if not (np.issubdtype(values.dtype, np.number) or values.dtype == np.bool_) or np.iscomplexobj(values):
        raise InputError(f"{key} is not numeric (it is {values.dtype})", file, "store real numbers")
    numbers = values.astype(np.float64)
    if key != "y" and numbers.size == 0:
        raise InputError(f"{key} is empty", file, "store at least one number")
    return numbers


def _matching(held: dict[str, Any], key: str, rows: int, columns: int | None, file: Path) -> FloatArray | None:
    """An optional matrix whose number of rows (and columns) is known."""
    if key not in held:
        return None
    values = _numbers(held[key], file, key)
    values = values[:, None] if values.ndim == 1 and columns is None else values
    if values.ndim != 2 or len(values) != rows or columns not in (None, values.shape[1]):
        wanted = f"({rows}, {columns or 'inputs'})"
        raise InputError(f"{key} has shape {values.shape}", file, f"it must be {wanted} to fit y")
    return values


def _read_csv(file: Path, rate_hz: float | None) -> Channels:
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            lines = [(number, row) for number, row in enumerate(csv.reader(stream), 1) if any(map(str.strip, row))]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"is not text in CSV form ({error})", file, "write it as UTF-8 with commas") from None
    if len(lines) < 2:
        raise InputError("is empty", file, "give a header line and one line for each sample")
    header = [name.strip() for name in lines[0][1]]
    if all(_is_number(name) for name in header):
        raise InputError("has no header line", f"{file}, line 1", "begin with the channels' names")
    table = np.empty((len(lines) - 1, len(header)))
    for i, (number, row) in enumerate(lines[1:]):
        if len(row) != len(header):
            what = f"has {len(row)} cells where the header has {len(header)}"
            raise InputError(what, f"{file}, line {number}", "give each line as many cells as the header")
        for j, cell in enumerate(row):
            table[i, j] = _cell(cell, f"{file}, line {number}, column {j + 1} ({header[j]})")
    timed = header[0].lower() == "time_s"
    y = table[:, 1:] if timed else table
    return Channels(_time(table[:, 0] if timed else None, rate_hz, len(y), file), _some(y, file))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _cell(text: str, where: str) -> float:
    text = text.strip()
    if text.lower() in _MISSING:
        return np.nan
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{text!r} is not a number", where, "write a number, or nothing for a gap") from None


def _time(time_s: FloatArray | None, rate_hz: float | None, count: int, file: Path) -> FloatArray:
    """Time stamps of the samples: the file's own, or from the rate."""
    if time_s is None:
        if rate_hz is None:
            raise InputError("has neither time_s nor rate_hz", file, "give the rate with --rate HZ")
        return np.arange(count) / rate_hz
    if time_s.shape != (count,):
        raise InputError(f"time_s has shape {time_s.shape}", file, f"it must be ({count},) to fit y")
    wrong = ~np.isfinite(time_s)
    wrong[1:] |= ~(np.diff(time_s) > 0.0)
    if wrong.any():
        sample = int(np.argmax(wrong))
        what = f"time_s does not increase at sample {sample} (counted from 0)"
        raise InputError(what, file, "sort the samples by time and remove doubles")
    return time_s


def _some(y: FloatArray, file: Path) -> FloatArray:
    """The channels, if there are any samples in them; infinite values count as missing."""
    y = np.where(np.isfinite(y), y, np.nan)
    if y.size == 0 or len(y) < 2:
        raise InputError("has no samples", file, "record at least a few seconds")
    if np.isnan(y).all():
        raise InputError("has only missing samples", file, "check how it was recorded")
    return y
