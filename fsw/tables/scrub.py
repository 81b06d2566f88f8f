"""The scrub: one copy of one table is checked a tick, and a damaged one made good."""

from typing import NamedTuple

from fsw.tables.bank import TableBank
from telemetry.events import TableCopy, TableNumber

PLACES = [(number, which) for number in TableNumber for which in TableCopy]


class Damage(NamedTuple):
    """A damaged copy. repaired: all copies of this table are good again. in_use: the table in use was replaced."""

    number: TableNumber
    which: TableCopy
    repaired: bool
    in_use: bool


class Scrub:
    """Goes round through all copies of all tables: at 15 Hz a flipped bit is found within 1.2 s."""

    def __init__(self, bank: TableBank) -> None:
        self._bank, self._at = bank, 0
        self.beyond_repair: set[TableNumber] = set()

    def step(self) -> Damage | None:
        """Check the next copy. Damage beyond repair is told once, and while it lasts stands in beyond_repair."""
        number, which = PLACES[self._at]
        self._at = (self._at + 1) % len(PLACES)
        copy = self._bank.stores[number].copy(which)
        if copy is None or copy.intact:
            if which is TableCopy.ACTIVE:
                self.beyond_repair.discard(number)
            return None
        table_whole = copy.table_whole
        if copy.repair():
            return Damage(number, which, True, which is TableCopy.ACTIVE and not table_whole)
        return self._give_up(number, which)

    def _give_up(self, number: TableNumber, which: TableCopy) -> Damage | None:
        """No copy of this one is left: without it, or with the table before."""
        store = self._bank.stores[number]
        before = store.active
        store.discard(which)
        if which is not TableCopy.ACTIVE or store.active is not before:
            return Damage(number, which, True, store.active is not before)
        if number in self.beyond_repair:
            return None
        self.beyond_repair.add(number)
        return Damage(number, which, False, False)
