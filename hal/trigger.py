"""The camera trigger, heartbeat of the flight application."""

from typing import NamedTuple, Protocol


class Edge(NamedTuple):
    """One trigger edge: its number, counted from 0 by the source, and its time."""

    tick: int
    time_ns: int


class Trigger(Protocol):
    """The line that fires both cameras at once."""

    def wait(self) -> Edge | None:
        """Block until the next edge and return it; None when the source has ended."""
        ...
