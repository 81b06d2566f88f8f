"""Tables in memory: one active, one loaded beside it, one to go back to; each with version and CRC-32."""

import zlib
from typing import Generic, NamedTuple, TypeVar

import msgspec

T = TypeVar("T", bound=msgspec.Struct)


class Image(NamedTuple, Generic[T]):
    """A validated table, its encoded bytes, their CRC-32, and its version, counted from 1."""

    table: T
    data: bytes
    crc32: int
    version: int


def make_image(table: T, version: int) -> Image[T]:
    """Freeze a table: the same table gives the same bytes."""
    data = msgspec.json.encode(table, order="deterministic")
    return Image(table, data, zlib.crc32(data), version)


class TableStore(Generic[T]):
    """The copies of one table. Only whole, validated tables come in; the active one never changes in place."""

    def __init__(self, table: T) -> None:
        self.active = make_image(table, 1)
        self.loaded: Image[T] | None = None
        self.previous: Image[T] | None = None
        self._versions = 1

    def load(self, table: T) -> Image[T]:
        """Put a validated table beside the active one; it replaces one that was loaded before."""
        self._versions += 1
        self.loaded = make_image(table, self._versions)
        return self.loaded

    def activate(self) -> bool:
        """Make the loaded table the active one; False, and nothing changes, if there is none or it is damaged."""
        if self.loaded is None or not intact(self.loaded):
            return False
        self.previous, self.active, self.loaded = self.active, self.loaded, None
        return True

    def abort(self) -> None:
        """Forget the loaded table."""
        self.loaded = None

    def roll_back(self) -> bool:
        """Return to the table before; False, and nothing changes, if there is none or it is damaged."""
        if self.previous is None or not intact(self.previous):
            return False
        self.active, self.previous = self.previous, self.active
        return True

    def intact(self) -> bool:
        """Whether the active table is still what was validated."""
        return intact(self.active)


def intact(image: Image[T]) -> bool:
    """Whether the bytes have their CRC, and the table in use still encodes to them."""
    return (
        zlib.crc32(image.data) == image.crc32 and msgspec.json.encode(image.table, order="deterministic") == image.data
    )
