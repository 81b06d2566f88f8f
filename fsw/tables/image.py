"""A table in memory: its image, as it is dumped and scrubbed, and the table in use beside it."""

import hashlib
import struct
import zlib
from functools import cache
from typing import Any

import msgspec

from fault.limits import Limit
from fsw.tables.flight import ExecutiveTable, FlightTable, IdentifyTable, TaskSlot, VisionTable
from telemetry.events import TableNumber

Part = Any
"""What a table holds: a Struct, or a list of rows."""

MAGIC = b"WBTB"
HEADER = struct.Struct("<4sBxH4sII")
"""Magic, number of the table, version, first bytes of the schema's hash, length of the payload, CRC-32 of all else."""

FIELDS: dict[TableNumber, str] = {
    TableNumber.SCHEDULE: "schedule",
    TableNumber.VISION: "vision",
    TableNumber.IDENTIFY: "identify",
    TableNumber.LIMITS: "limit",
    TableNumber.SHADOW: "shadow",
    TableNumber.EXECUTIVE: "executive",
}
"""Each table's place in FlightTable, and its key in TOML."""

KINDS: dict[TableNumber, Any] = {
    TableNumber.SCHEDULE: list[TaskSlot],
    TableNumber.VISION: VisionTable,
    TableNumber.IDENTIFY: IdentifyTable,
    TableNumber.LIMITS: list[Limit],
    TableNumber.SHADOW: list[Limit],
    TableNumber.EXECUTIVE: ExecutiveTable,
}


def part_of(flight: FlightTable, number: TableNumber) -> Part:
    """One table of them."""
    return getattr(flight, FIELDS[number])


@cache
def schema_hash(number: TableNumber) -> bytes:
    """What keys a table has, of which type and range, in four bytes: an image of another software does not fit."""
    schema = msgspec.json.encode(msgspec.json.schema(KINDS[number]), order="deterministic")
    return hashlib.sha256(schema).digest()[:4]


def payload_of(table: Part) -> bytes:
    """A table's bytes: the same table gives the same ones."""
    return msgspec.json.encode(table, order="deterministic")


def encode_image(number: TableNumber, payload: bytes, version: int) -> bytearray:
    """The image of a table."""
    head = (MAGIC, number, version % 65536, schema_hash(number), len(payload))
    crc32 = zlib.crc32(payload, zlib.crc32(HEADER.pack(*head, 0)))
    return bytearray(HEADER.pack(*head, crc32) + payload)


def is_whole(number: TableNumber, image: bytes | bytearray) -> bool:
    """Whether these bytes are an image of this table, every bit as it was."""
    if len(image) < HEADER.size:
        return False
    magic, of, version, schema, length, crc32 = HEADER.unpack_from(image)
    head = (MAGIC, number, version, schema_hash(number), len(image) - HEADER.size)
    known = (magic, of, version, schema, length) == head and image[5] == 0
    return known and zlib.crc32(memoryview(image)[HEADER.size :], zlib.crc32(HEADER.pack(*head, 0))) == crc32


class Copy:
    """A validated table with its version: `image` to check and to dump, `table` to use.

    A flipped bit in either of them is found, and made good from the other one.
    """

    def __init__(self, number: TableNumber, table: Part, version: int) -> None:
        self.number, self.table, self.version = number, table, version
        payload = payload_of(table)
        self.image = encode_image(number, payload, version)
        self._crc32 = zlib.crc32(payload)

    @property
    def intact(self) -> bool:
        """Whether image and table are what was validated."""
        return self.image_whole and self.table_whole

    @property
    def image_whole(self) -> bool:
        """Whether the image is what was validated."""
        return is_whole(self.number, self.image)

    @property
    def table_whole(self) -> bool:
        """Whether the table in use is what was validated."""
        return _crc32_of(self.table) == self._crc32

    def repair(self) -> bool:
        """Make the damaged one good from the other one; False if both are damaged."""
        if self.image_whole:
            payload = memoryview(self.image)[HEADER.size :]
            self.table = msgspec.json.decode(payload, type=KINDS[self.number])
            self._crc32 = zlib.crc32(payload)
            return True
        if self.table_whole:
            self.image[:] = encode_image(self.number, payload_of(self.table), self.version)
            return True
        return False


def _crc32_of(table: Part) -> int | None:
    """CRC-32 of a table's bytes; None for one so damaged that it has none."""
    try:
        return zlib.crc32(payload_of(table))
    except (TypeError, ValueError, OverflowError, UnicodeError):
        return None
