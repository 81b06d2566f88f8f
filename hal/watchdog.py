"""The watchdog: it resets the processor unless it is served in time, by an oscillator of its own."""

from typing import Protocol


class Watchdog(Protocol):
    """Serve it once a tick, and only while everything that matters makes progress."""

    def serve(self) -> None:
        """Start its time again."""
        ...

    def expired(self) -> bool:
        """Its time ran out. Only one that cannot reset the processor lives to say so."""
        ...


class Unwatched:
    """No watchdog: nobody resets the processor."""

    def serve(self) -> None:
        """Nothing to start again."""

    def expired(self) -> bool:
        """Never."""
        return False
