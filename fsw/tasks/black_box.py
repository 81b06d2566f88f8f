"""black_box: what a trip froze, to a file, beside the ticks."""

import csv
import io
from collections.abc import Callable

import msgspec
import numpy as np

from fsw.black_box import BlackBox, Frozen
from hal.store import Store
from telemetry.black_box_file import write_black_box
from telemetry.declaration import Event
from telemetry.events import BLACK_BOX_FAILED, BLACK_BOX_FROZEN, BLACK_BOX_WRITTEN
from wingbeat.errors import InputError


class WriteBlackBox:
    """Writes black_box_001.mcap and so on into the store, at most so many of them; then trips are ignored.

    What the stopwatches read goes to black_box_001_slots.csv, for no two runs read the same. Files of an application
    before this one stay, and count. A box that the store does not take is given up, and its number is used again.
    """

    name = "black_box"

    def __init__(self, box: BlackBox, store: Store | None, most: int, raise_event: Callable[..., None]) -> None:
        self._box, self._store, self._most, self._raise_event = box, store, most, raise_event
        self._number = 1  # of the next file
        self._taken: Frozen | None = None
        self._written = False

    def init(self) -> None:
        """Go on after the files that there are."""
        if self._store is not None:
            while self._number <= self._most and self._store.read(_file(self._number)) is not None:
                self._number += 1
        self._arm()

    def take(self, tick: int) -> bool:
        """Say what was frozen; False if nothing was."""
        self._end()  # its result came too late to be delivered
        self._taken, self._written = self._box.frozen, False
        if self._taken is None:
            return False
        self._raise_event(BLACK_BOX_FROZEN, self._number, len(self._taken.rows))
        return True

    def work(self) -> None:
        """Write the frozen rows. A store that is full, or gone, is no reason to stop flying."""
        if self._taken is None or self._store is None:
            return
        try:
            self._store.write(_file(self._number, "_slots.csv"), slots_csv(self._taken, self._box.tasks))
            write_black_box(self._store.path(_file(self._number)), self._header(self._taken), self._taken.rows)
            self._written = True
        except (OSError, InputError):
            self._written = False

    def deliver(self, tick: int) -> None:
        """Say what became of it; the box may freeze again."""
        self._end()

    def close(self, tick: int) -> None:
        """There will be no more ticks, and nothing works beside: write what is there."""
        self._end()
        self._box.finish()
        if self.take(tick):
            self.work()
            self._end()

    def _header(self, frozen: Frozen) -> dict[str, object]:
        limits, shadow = msgspec.to_builtins((frozen.limits, frozen.shadow))
        return {"number": self._number, "trip_tick": frozen.trip_tick, "limits": limits, "shadow": shadow}

    def _end(self) -> None:
        if self._taken is None:
            return
        event: Event = BLACK_BOX_WRITTEN if self._written else BLACK_BOX_FAILED
        self._raise_event(event, self._number)
        self._number += self._written
        self._taken = None
        self._arm()
        self._box.release()

    def _arm(self) -> None:
        self._box.on = self._store is not None and self._number <= self._most


def slots_csv(frozen: Frozen, tasks: tuple[str, ...]) -> bytes:
    """Thread-CPU time of the newest run of each task at each tick, ms; empty before its first run."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("tick", *(f"{task}_ms" for task in tasks)))
    for tick, spent_ms in zip(frozen.rows["tick"].tolist(), frozen.spent_ms, strict=True):
        table.writerow((tick, *("" if np.isnan(value) else f"{value:.3f}" for value in spent_ms)))
    return text.getvalue().encode()


def _file(number: int, suffix: str = ".mcap") -> str:
    return f"black_box_{number:03d}{suffix}"
