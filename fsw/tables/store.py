"""The copies of one table in memory: one active, one loaded beside it, one to go back to."""

from fsw.tables.image import Copy, Part
from telemetry.events import TableCopy, TableNumber


class TableStore:
    """Only whole, validated tables come in; the active one never changes in place. Versions count from 1."""

    def __init__(self, number: TableNumber, table: Part) -> None:
        self.number = number
        self.active = Copy(number, table, 1)
        self.loaded: Copy | None = None
        self.previous: Copy | None = None
        self._versions = 1

    def copy(self, which: TableCopy) -> Copy | None:
        """One of the copies; None if there is none."""
        return (self.active, self.loaded, self.previous)[which]

    def load(self, table: Part) -> Copy:
        """Put a validated table beside the active one; it replaces one that was loaded before."""
        self._versions += 1
        self.loaded = Copy(self.number, table, self._versions)
        return self.loaded

    def activate(self) -> None:
        """Make the loaded table, which must be there, the active one."""
        assert self.loaded is not None
        self.previous, self.active, self.loaded = self.active, self.loaded, None

    def roll_back(self) -> None:
        """Change places with the table before, which must be there."""
        assert self.previous is not None
        self.active, self.previous = self.previous, self.active

    def abort(self) -> None:
        """Forget the loaded table."""
        self.loaded = None

    def discard(self, which: TableCopy) -> None:
        """Forget a copy that is damaged beyond repair; in the place of the active one comes the one before."""
        if which is TableCopy.LOADED:
            self.loaded = None
        elif which is TableCopy.PREVIOUS:
            self.previous = None
        elif self.previous is not None and self.previous.intact:
            self.active, self.previous = self.previous, None
