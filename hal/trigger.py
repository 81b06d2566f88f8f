"""The camera trigger, heartbeat of the flight application."""

from typing import NamedTuple, Protocol


class Edge(NamedTuple):
    """One trigger edge: its number, counted from 0 by the source, and its time.

    free: the clock made it, because no edge came that could be trusted.
    """

    tick: int
    time_ns: int
    free: bool = False


class Trigger(Protocol):
    """The line that fires both cameras at once. An edge waits until it is fetched, with the time at which it came."""

    @property
    def ended(self) -> bool:
        """There will be no further edge."""
        ...

    def wait(self, until_ns: int | None = None) -> Edge | None:
        """Block until the next edge and return it; None when the source has ended.

        until_ns: mission time until which to wait, None for as long as it takes. An edge that came later than that
        stays for the next call, and this one returns None.
        """
        ...
