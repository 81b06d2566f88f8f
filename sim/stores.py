"""Where the flight side writes in a simulation: events that are read as they come, logs, files; all may be full."""

import errno
import json
import math
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from hal.store import FileStore
from telemetry.declaration import Severity
from telemetry.events import EVENT_BY_NUMBER


class Told(NamedTuple):
    """An event as it was written: the receiver's own tick, number, name, and arguments, choices by their number."""

    at_tick: int
    number: int
    name: str
    arguments: tuple[float, ...]


class EventStore:
    """The stream of events.jsonl. full: it refuses to write; what it was asked to write is known all the same.

    now: the receiver's own tick. keep: the lines are kept. most: events that are known afterwards, None: all.
    alarms: critical events so far.
    """

    def __init__(self, now: Callable[[], int] = lambda: 0, keep: bool = False, most: int | None = None) -> None:
        self._now, self._keep = now, keep
        self.full, self.alarms = False, 0
        self.told: deque[Told] = deque(maxlen=most)
        self.lines = bytearray()

    def write(self, data: bytes) -> int:
        """Take a line. Raises OSError when it is full."""
        event: dict[str, Any] = json.loads(data)
        self.alarms += EVENT_BY_NUMBER[event["event"]].severity is Severity.CRITICAL
        self.told.append(Told(self._now(), event["event"], event["name"], _numbers(event)))
        refuse(self.full)
        if self._keep:
            self.lines += data
        return len(data)


class SteadyLog:
    """A log that is written in every tick. full: it refuses to write."""

    full = False

    def write(self, *_: object) -> None:
        """Take it. Raises OSError when it is full."""
        refuse(self.full)


class FillingStore(FileStore):
    """Named files in a folder. full: it refuses to write."""

    full = False

    def path(self, name: str) -> Path:
        """Where to write a file. Raises OSError when the store is full."""
        refuse(self.full)
        return super().path(name)

    def read(self, name: str) -> bytes | None:
        """Content of the file, or None; a full disk can be read."""
        file = self.folder / name
        return file.read_bytes() if file.exists() else None


def refuse(full: bool) -> None:
    """Raise what the operating system raises on a full disk."""
    if full:
        raise OSError(errno.ENOSPC, "no space left on device")


def _numbers(event: dict[str, Any]) -> tuple[float, ...]:
    """An event's arguments as they were raised."""
    numbers = []
    for argument in EVENT_BY_NUMBER[event["event"]].arguments:
        value = event["arguments"][argument.name]
        if isinstance(value, str):
            value = next(number for number, name in (argument.choices or {}).items() if name == value)
        numbers.append(math.nan if value is None else float(value))
    return tuple(numbers)
