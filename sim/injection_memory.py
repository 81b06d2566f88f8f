"""Faults of memory, of tables and of the outlets."""

import struct
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from sim.injection import Injection, Stage
from telemetry.events import TableNumber

WHO = "defect"  # owner of a lease that nobody gives back


class BusOff(Injection):
    LASTS = (1, 60)

    def before(self, stage: Stage, tick: int) -> None:
        stage.bus.off = self.active(tick)


class StorageFull(Injection):
    LASTS = (60, 120)

    def before(self, stage: Stage, tick: int) -> None:
        stage.events.full = stage.log.full = stage.store.full = self.active(tick)


class MomentFault(Injection):
    """Something happens once, before its first tick."""

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        super().__init__(first, draw)
        self.done = False

    def before(self, stage: Stage, tick: int) -> None:
        """Let it happen when its time has come."""
        if tick >= self.first and not self.done:
            self.done = True
            self.happen(stage, tick)

    def happen(self, stage: Stage, tick: int) -> None:
        """What happens."""


class BitFlipTable(MomentFault):
    """Any bit of the image of any active table."""

    def happen(self, stage: Stage, tick: int) -> None:
        stores = stage.app.tables.stores
        image = stores[TableNumber(self.draw.choice(list(TableNumber)))].active.image
        bit = int(self.draw.integers(8 * len(image)))
        image[bit // 8] ^= 1 << bit % 8


class BitFlipStruct(MomentFault):
    """Any bit of any number of any active table."""

    def happen(self, stage: Stage, tick: int) -> None:
        stores = stage.app.tables.stores
        places = [place for number in TableNumber for place in numbers_in(stores[number].active.table)]
        row, field, value = places[int(self.draw.integers(len(places)))]
        msgspec.structs.force_setattr(row, field, flipped(value, self.draw))


def numbers_in(table: Any) -> list[tuple[msgspec.Struct, str, int | float]]:
    """Where numbers stand in a table, a Struct or rows of them: the Struct, the field, the number."""
    rows: Sequence[Any] = [table] if isinstance(table, msgspec.Struct) else table
    return [
        (row, name, value)
        for row in rows
        for name in row.__struct_fields__
        if type(value := getattr(row, name)) in (int, float)
    ]


def flipped(value: int | float, draw: np.random.Generator) -> int | float:
    """A number with one bit changed: of the 16 low ones of an integer, or any of a floating-point number's."""
    if isinstance(value, int):
        return value ^ (1 << int(draw.integers(16)))
    (bits,) = struct.unpack("<Q", struct.pack("<d", value))
    changed: float = struct.unpack("<d", struct.pack("<Q", bits ^ (1 << int(draw.integers(64)))))[0]
    return changed


class LeaseLeak(MomentFault):
    """A frame that is never given back."""

    def happen(self, stage: Stage, tick: int) -> None:
        stage.app.pools[int(self.draw.integers(2))].lease(WHO, tick)


class DoubleRelease(MomentFault):
    """A frame given back twice, or to the other eye's pool."""

    def happen(self, stage: Stage, tick: int) -> None:
        eye = int(self.draw.integers(2))
        pools = stage.app.pools
        frame = pools[eye].lease(WHO, tick)
        if frame is None:
            return
        if self.draw.integers(2):
            pools[1 - eye].release(frame)
        pools[eye].release(frame)
        pools[eye].release(frame)
