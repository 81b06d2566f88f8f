"""The black box: the last ticks of fault protection in a ring, as exact rows, and a copy that is frozen at a trip.

What protection decides is a function of its state, the board and a few inputs. All of these go into the row of their
tick, with what came of them: the board after it, and the events. So a row can be decided again on the ground.
"""

from collections.abc import Callable, Sequence
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fault.limits import Limit
from fault.modes import Cause
from fault.protection import Protection, Raised
from telemetry.black_box_file import ROW_EVENTS, row_type
from telemetry.board import Board
from telemetry.declaration import EVENT_ARGUMENTS

Rows = NDArray[np.void]


class Frozen(NamedTuple):
    """What a trip left: rows (ticks,), oldest first, their limits, and CPU ms of the tasks (ticks, tasks).

    trip_tick: tick of the row that was closed first after the trip.
    """

    rows: Rows
    limits: tuple[Limit, ...]
    shadow: tuple[Limit, ...]
    trip_tick: int
    spent_ms: NDArray[np.float64]


class Memory:
    """Rows of one size, and the stopwatches' readings beside them, in memory that is taken once."""

    def __init__(self, size: int, ticks: int, tasks: int) -> None:
        self._bytes = np.zeros(size, np.uint8)
        self._bytes.fill(0)  # the pages are there before the first tick
        self._most = ticks
        self.spent_ms: NDArray[np.float64] = np.full((ticks, tasks), nan)

    def shape(self, kind: np.dtype[np.void]) -> None:
        """Hold rows of this type: as many as were asked for, or as fit."""
        count = min(self._most, len(self._bytes) // kind.itemsize)
        used = self._bytes[: count * kind.itemsize]
        self.rows: Rows = used.view(kind)
        self.raw = used.reshape(count, kind.itemsize)

    def copy(self, other: "Memory", first: int, count: int) -> None:
        """Take so many rows of another one of the same shape, from this row on and around its end."""
        tail = min(count, len(other.raw) - first)
        for at, start, stop in ((0, first, first + tail), (tail, 0, count - tail)):
            np.copyto(self.raw[at : at + stop - start], other.raw[start:stop])
            np.copyto(self.spent_ms[at : at + stop - start], other.spent_ms[start:stop])


class BlackBox:
    """Keeps a row for each of the last `ticks` ticks; full: the oldest row makes room.

    A trip (any critical event, as a red limit is) freezes it after_ticks rows later: the rows are copied, and stand in
    `frozen` until `release`; the ring goes on. Trips until then belong to the same box. One that is due while another
    is still frozen waits for it. on: trips freeze; else they are ignored.
    tasks: whose CPU times stand beside the rows; stopwatch: CPU ms of the newest run of a task, by name.
    A tick takes no memory. A table with more limits makes rows longer: there is room for fewer of them then, and if
    not even for one, nothing is recorded until the next table.
    """

    def __init__(
        self,
        limits: Sequence[Limit],
        shadow: Sequence[Limit],
        ticks: int,
        after_ticks: int,
        tasks: Sequence[str] = (),
        stopwatch: Callable[[str], float] = lambda task: nan,
    ) -> None:
        self.frozen: Frozen | None = None
        self.on = True
        self.tasks, self._stopwatch, self._after_ticks = tuple(tasks), stopwatch, after_ticks
        size = row_type(Protection(limits, shadow).size).itemsize * ticks
        self._ring, self._copy = Memory(size, ticks, len(self.tasks)), Memory(size, ticks, len(self.tasks))
        self._tripped, self._since, self._trip_tick = False, -1, 0  # since: rows since the trip's, -1 before that
        self._count = self._at = 0
        self.restart(limits, shadow)

    def __len__(self) -> int:
        """Rows that it holds now."""
        return self._count

    @property
    def places(self) -> int:
        """Rows that it can hold."""
        return len(self._ring.rows)

    @property
    def newest(self) -> np.void:
        """The newest row."""
        row: np.void = self._ring.rows[self._at - 1]
        return row

    def restart(self, limits: Sequence[Limit], shadow: Sequence[Limit]) -> None:
        """Begin anew, with other limits, between two ticks. A trip that still waits for its last rows freezes now."""
        self.finish()
        self._limits, self._shadow = tuple(limits), tuple(shadow)
        self._ring.shape(row_type(Protection(limits, shadow).size))
        self._count = self._at = 0
        self._tripped = False
        rows = self._ring.rows
        self._tick, self._time_ns, self._causes = rows["tick"], rows["time_ns"], rows["causes"]
        self._new_frame, self._new_estimate, self._state = rows["new_frame"], rows["new_estimate"], rows["state"]
        self._before, self._after = rows["before"], rows["after"]
        self._raised, self._event, self._argument = rows["raised"], rows["event"], rows["argument"]

    def before(
        self,
        tick: int,
        time_ns: int,
        board: Board,
        causes: Cause,
        new_frame: bool,
        new_estimate: bool,
        protection: Protection,
    ) -> None:
        """Open this tick's row, right before protection decides on these inputs."""
        if not self.places:
            return
        at = self._at
        self._tick[at], self._time_ns[at], self._causes[at] = tick, time_ns, int(causes)
        self._new_frame[at], self._new_estimate[at] = new_frame, new_estimate
        protection.save(self._state[at])
        np.copyto(self._before[at], board.values)

    def after(self, board: Board, events: Sequence[Raised]) -> None:
        """Close the row, right after protection decided: the board as it left it, and what it raised."""
        if not self.places:
            return
        at = self._at
        np.copyto(self._after[at], board.values)
        self._raised[at] = len(events)
        self._event[at].fill(0)
        self._argument[at].fill(nan)
        for place, raised in zip(range(ROW_EVENTS), events, strict=False):
            self._event[at, place] = raised.event.number
            for column, value in zip(range(EVENT_ARGUMENTS), raised.arguments, strict=False):
                self._argument[at, place, column] = value
        for column, task in enumerate(self.tasks):
            self._ring.spent_ms[at, column] = self._stopwatch(task)
        self._close(int(self._tick[at]))

    def trip(self) -> None:
        """A critical event was raised, by anyone, at any time of a tick: it freezes the box."""
        if self.on and not self._tripped:
            self._tripped, self._since = True, -1

    def finish(self) -> None:
        """There will be no more ticks: a trip that still waits for its last rows freezes now."""
        if self._tripped and self._count:
            if self._since < 0:
                self._trip_tick = int(self.newest["tick"])
            self._freeze()

    def release(self) -> None:
        """What was frozen is of no more use."""
        self.frozen = None

    def _close(self, tick: int) -> None:
        self._at = (self._at + 1) % self.places
        self._count = min(self._count + 1, self.places)
        if not self._tripped:
            return
        self._since += 1
        if self._since == 0:
            self._trip_tick = tick
        if self._since >= min(self._after_ticks, self.places - 1) and self.frozen is None:
            self._freeze()
        elif self._since >= self.places:  # the row of the trip has left the ring while another box was in use
            self._tripped = False

    def _freeze(self) -> None:
        """Copy the ring, oldest row first; not while what was frozen before is in use."""
        self._tripped = False
        if self.frozen is not None:
            return
        self._copy.shape(self._ring.rows.dtype)
        self._copy.copy(self._ring, (self._at - self._count) % self.places, self._count)
        rows, spent_ms = self._copy.rows[: self._count], self._copy.spent_ms[: self._count]
        self.frozen = Frozen(rows, self._limits, self._shadow, self._trip_tick, spent_ms)
