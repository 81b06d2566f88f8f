"""A recorded stereo sequence as two cameras and a trigger: gaps of the recording are ticks without a frame."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hal.camera import FrameStamp, FrameStatus
from hal.clock import Clock
from hal.drivers.image_files import check_images, read_image
from hal.trigger import Edge
from wingbeat.errors import InputError

COLUMNS = ("index", "left_ns", "right_ns", "left_trigger", "right_trigger")
EYES = ("left", "right")
# A longer jump of the trigger's number is a counter that was reset or wrapped, not a gap.
LONGEST_GAP_TICKS = 10_000


class RecordedFrame(NamedTuple):
    """One image of the recording: its file, place in its eye's list, trigger number, and time."""

    path: Path
    place: int
    trigger: int
    time_ns: int


@dataclass(frozen=True)
class Recording:
    """What happened at each tick: frames[eye][tick] or None, and the tick's time; dtype and size (w, h) an eye."""

    frames: tuple[tuple[RecordedFrame | None, ...], tuple[RecordedFrame | None, ...]]
    time_ns: tuple[int, ...]
    sizes: tuple[tuple[int, int], tuple[int, int]]
    dtypes: tuple[np.dtype[Any], np.dtype[Any]]

    @property
    def ticks(self) -> int:
        """Number of trigger edges, with those that left no image."""
        return len(self.time_ns)


def open_recording(
    left: Sequence[Path],
    right: Sequence[Path],
    sizes: tuple[tuple[int, int], tuple[int, int]],
    rate_hz: float,
    timestamps: Path | None = None,
) -> Recording:
    """Check all images and lay them out on ticks: by index at the rate, or by the trigger numbers of a CSV file.

    sizes: width, height of each eye. Raises InputError: image (see check_images), unequal counts, bad timestamps.
    """
    if timestamps is None and len(left) != len(right):
        raise InputError(
            f"{len(left)} left images but {len(right)} right images",
            left[0].parent if left else "",
            "images pair by index: supply both of each pair, or a timestamps file that says what is missing",
        )
    dtypes = (check_images(left, *sizes[0]), check_images(right, *sizes[1]))
    if timestamps is None:
        stamps = [(i, i, round(i * 1e9 / rate_hz)) for i in range(len(left))]
        eyes = (_frames(left, stamps), _frames(right, stamps))
    else:
        rows = _read_timestamps(timestamps)
        eyes = (
            _frames(left, _assign(rows, 0, len(left), timestamps)),
            _frames(right, _assign(rows, 1, len(right), timestamps)),
        )
        if not {f.trigger for f in eyes[0]} & {f.trigger for f in eyes[1]}:
            remedy = "both columns count the same trigger edges"
            raise InputError("left_trigger and right_trigger share no number", timestamps, remedy)
    return _on_ticks(eyes, sizes, dtypes)


class RecordedCamera:
    """One eye of a recording; the k-th grab belongs to tick k."""

    def __init__(self, recording: Recording, eye: int) -> None:
        self.width, self.height = recording.sizes[eye]
        self.dtype = recording.dtypes[eye]
        self._frames = recording.frames[eye]
        self._time_ns = recording.time_ns
        self._decoded = np.zeros((self.height, self.width), self.dtype)  # the decoder wants rows without gaps
        self._tick = 0

    def grab(self, out: NDArray[Any]) -> FrameStamp:
        """Decode the next tick's image into out; a gap or the end of the recording gives status MISSING."""
        tick = self._tick
        self._tick += 1
        frame = self._frames[tick] if tick < len(self._frames) else None
        if frame is None:
            return FrameStamp(tick, -1, self._time_ns[min(tick, len(self._time_ns) - 1)], FrameStatus.MISSING)
        read_image(frame.path, self._decoded)
        np.copyto(out, self._decoded)
        return FrameStamp(tick, frame.place, frame.time_ns, FrameStatus.OK)


class RecordedTrigger:
    """The trigger edges of a recording, at the pace of a clock."""

    def __init__(self, recording: Recording, clock: Clock) -> None:
        self._time_ns = recording.time_ns
        self._clock = clock
        self._tick = 0

    @property
    def ended(self) -> bool:
        """All edges were fetched."""
        return self._tick == len(self._time_ns)

    def wait(self, until_ns: int | None = None) -> Edge | None:
        """The next edge at its time; None at the end of the recording, or at until_ns if it comes later."""
        if self.ended:
            return None
        edge = Edge(self._tick, self._time_ns[self._tick])
        if until_ns is not None and edge.time_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self._tick += 1
        self._clock.sleep_until_ns(edge.time_ns)
        return edge


def _frames(paths: Sequence[Path], stamps: Sequence[tuple[int, int, int]]) -> list[RecordedFrame]:
    return [RecordedFrame(paths[place], place, trigger, time_ns) for place, trigger, time_ns in stamps]


def _read_timestamps(path: Path) -> list[tuple[int, int | None, int | None, int | None, int | None]]:
    """Rows of the CSV file in the order of COLUMNS; an empty cell, where an eye has no frame, is None."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = [[cell.strip() for cell in line] for line in csv.reader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot read the timestamps: {error}", path, "supply a CSV text file") from None
    if not lines or tuple(lines[0]) != COLUMNS:
        raise InputError(
            "the header line is not that of a timestamps file", f"{path}, line 1", f"write {','.join(COLUMNS)}"
        )
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if not any(line):
            continue
        try:
            index, *rest = (int(cell) if cell else None for cell in line)
            left_ns, right_ns, left_trigger, right_trigger = rest
            if index is None or (left_ns is None) != (left_trigger is None):
                raise ValueError
            if (right_ns is None) != (right_trigger is None):
                raise ValueError
        except ValueError:
            raise InputError(
                f"{','.join(line)} is no line of timestamps",
                f"{path}, line {number}",
                "write five whole numbers; leave both cells of an eye empty where it has no frame",
            ) from None
        rows.append((index, left_ns, right_ns, left_trigger, right_trigger))
    return rows


def _assign(
    rows: Sequence[tuple[int, int | None, int | None, int | None, int | None]], eye: int, count: int, path: Path
) -> list[tuple[int, int, int]]:
    """(place of the image, trigger, time_ns) for each image of this eye that has a timestamp."""
    stamped = [
        (index, trigger, time_ns)
        for index, *cells in rows
        if (time_ns := cells[eye]) is not None and (trigger := cells[2 + eye]) is not None
    ]
    if len(stamped) == count:  # a line an image, whatever the numbers of the lines that are left
        stamped = [(place, trigger, time_ns) for place, (_, trigger, time_ns) in enumerate(stamped)]
    elif not stamped or min(i for i, *_ in stamped) < 0 or max(i for i, *_ in stamped) >= count:
        raise InputError(
            f"{len(stamped)} {EYES[eye]} timestamps for {count} {EYES[eye]} images",
            path,
            "give each image its line, with its index from 0",
        )
    for before, after in pairwise(stamped):
        gap = after[1] - before[1]
        if after[0] <= before[0] or after[2] <= before[2] or not 1 <= gap <= LONGEST_GAP_TICKS:
            raise InputError(
                f"after index {before[0]}, trigger {before[1]}, {before[2]} ns comes index {after[0]}, "
                f"trigger {after[1]}, {after[2]} ns of the {EYES[eye]} camera",
                path,
                f"index, trigger and time increase, with gaps of at most {LONGEST_GAP_TICKS} triggers",
            )
    return stamped


def _on_ticks(
    eyes: tuple[list[RecordedFrame], list[RecordedFrame]],
    sizes: tuple[tuple[int, int], tuple[int, int]],
    dtypes: tuple[np.dtype[Any], np.dtype[Any]],
) -> Recording:
    """Ticks from the first trigger to the last; a tick that no eye saw gets its time from its neighbours."""
    known = {f.trigger: f.time_ns for f in (*eyes[1], *eyes[0])}  # the left eye's time where both are there
    first, last = min(known), max(known)
    triggers = sorted(known)
    times: list[int] = []
    for here, there in zip(triggers, [*triggers[1:], last + 1], strict=True):
        step = known.get(there, known[here]) - known[here]
        times += [known[here] + step * k // (there - here) for k in range(there - here)]
    by_trigger = [{f.trigger: f for f in eye} for eye in eyes]
    left, right = (tuple(eye.get(k) for k in range(first, last + 1)) for eye in by_trigger)
    return Recording((left, right), tuple(times), sizes, dtypes)
