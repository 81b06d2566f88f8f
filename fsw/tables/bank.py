"""All flight tables in memory: upload, validation, activation of several at once, the way back."""

import tomllib
import zlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec

from fsw.tables.flight import FlightTable, TaskSlot, check_flight
from fsw.tables.image import FIELDS, KINDS, Part, part_of
from fsw.tables.reading import convert_table
from fsw.tables.store import TableStore
from fsw.tables.upload import Upload
from telemetry.dictionary import TableFault
from telemetry.events import TableNumber
from wingbeat.errors import InputError

CheckSchedule = Callable[[Sequence[TaskSlot]], int]
"""Number of the first reason against a schedule (Refusal); 0: there is none."""

FIXED: dict[TableNumber, tuple[str, ...]] = {
    TableNumber.VISION: ("drop_window_ticks",),
    TableNumber.IDENTIFY: ("history_ticks",),
}
"""Values that size memory. The executive's table is taken in at the start as a whole."""


class Pending(NamedTuple):
    """What is to happen at the next boundary: a set of tables, and whether they go back instead of on."""

    numbers: tuple[TableNumber, ...]
    back: bool


class TableBank:
    """The stores of all tables. What is refused changes nothing; every refusal has its code."""

    def __init__(self, flight: FlightTable, check: CheckSchedule) -> None:
        self.stores = {number: TableStore(number, part_of(flight, number)) for number in TableNumber}
        self.upload = Upload()
        self.pending: Pending | None = None
        self._check = check

    @property
    def flight(self) -> FlightTable:
        """The active tables."""
        return self._flight({})

    def validate(self, number: TableNumber, crc32: int) -> TableFault:
        """Take in what was uploaded for this table: TOML that holds what differs from the active one.

        A list of rows is replaced whole. A table that is good stands beside the active one.
        """
        upload = self.upload
        if upload.number is not number:
            return TableFault.NOTHING_UPLOADED
        if upload.missing >= 0:
            return TableFault.GAP
        content = upload.content
        if zlib.crc32(content) != crc32:
            return TableFault.CRC
        fault = self.load(number, content)
        if fault is TableFault.NONE:
            upload.end()
        return fault

    def load(self, number: TableNumber, content: bytes) -> TableFault:
        """Check TOML, and put the table beside the active one."""
        try:
            document = tomllib.loads(content.decode())
        except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
            return TableFault.NOT_TOML
        key = FIELDS[number]
        if document.keys() != {key}:
            return TableFault.OTHER_TABLE
        given = document[key]
        active = self.stores[number].active.table
        if isinstance(active, msgspec.Struct) and isinstance(given, dict):
            given = msgspec.to_builtins(active) | given
        return self.offer(number, given)

    def offer(self, number: TableNumber, given: Any) -> TableFault:
        """Check a whole table in plain values, and put it beside the active one."""
        key = FIELDS[number]
        try:
            table = convert_table({key: given}, _ALONE[number], key)
        except (InputError, RecursionError):
            return TableFault.BAD_VALUE
        part = getattr(table, key)
        fault = self._judge({number: part})
        if fault is TableFault.NONE:
            self.stores[number].load(part)
        return fault

    def activate(self, numbers: Sequence[TableNumber]) -> TableFault:
        """Let the loaded tables of this set become active at the next boundary: all of them, or none."""
        return self._plan(Pending(tuple(numbers), back=False))

    def roll_back(self, numbers: Sequence[TableNumber]) -> TableFault:
        """Let the tables before become active again at the next boundary: all of them, or none."""
        return self._plan(Pending(tuple(numbers), back=True))

    def abort(self, number: TableNumber) -> None:
        """Forget what was uploaded and loaded for this table, and an activation that it takes part in."""
        if self.upload.number is number:
            self.upload.end()
        self.stores[number].abort()
        if self.pending is not None and number in self.pending.numbers:
            self.pending = None

    def at_boundary(self) -> tuple[tuple[TableNumber, ...], TableFault]:
        """A hyperperiod ends: do what was planned. Gives the tables that changed, or the fault that forbids it."""
        planned, self.pending = self.pending, None
        if planned is None:
            return (), TableFault.NONE
        if fault := self._fault(planned):
            return (), fault
        for number in planned.numbers:
            store = self.stores[number]
            store.roll_back() if planned.back else store.activate()
        return planned.numbers, TableFault.NONE

    def _plan(self, planned: Pending) -> TableFault:
        fault = self._fault(planned)
        if fault is TableFault.NONE:
            self.pending = planned
        return fault

    def _fault(self, planned: Pending) -> TableFault:
        parts: dict[TableNumber, Part] = {}
        for number in planned.numbers:
            store = self.stores[number]
            copy = store.previous if planned.back else store.loaded
            if copy is None:
                return TableFault.NOTHING_LOADED
            if not copy.intact:
                return TableFault.DAMAGED
            parts[number] = copy.table
        return self._judge(parts)

    def _judge(self, parts: dict[TableNumber, Part]) -> TableFault:
        """What forbids these tables, together with the other active ones."""
        for number, part in parts.items():
            active = self.stores[number].active.table
            if any(getattr(part, key) != getattr(active, key) for key in FIXED.get(number, ())):
                return TableFault.FIXED
            if number is TableNumber.EXECUTIVE and part != active:
                return TableFault.FIXED
        flight = self._flight(parts)
        try:
            check_flight(flight, "tables")
        except InputError:
            return TableFault.INCONSISTENT
        refusal = self._check(flight.schedule)
        return TableFault(TableFault.SCHEDULE_EMPTY - 1 + refusal) if refusal else TableFault.NONE

    def _flight(self, parts: dict[TableNumber, Part]) -> FlightTable:
        values: dict[str, Any] = {FIELDS[n]: parts.get(n, store.active.table) for n, store in self.stores.items()}
        return FlightTable(**values)


_ALONE: dict[TableNumber, Any] = {
    number: msgspec.defstruct(key, [(key, KINDS[number])], forbid_unknown_fields=True) for number, key in FIELDS.items()
}
"""The type of a document that holds one table alone, under its key."""
