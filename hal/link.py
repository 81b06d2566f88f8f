"""The link to the ground: a stream of bytes in both directions."""

from typing import Protocol


class Link(Protocol):
    """A radio, a serial line, a socket."""

    def receive(self) -> bytes:
        """What has come since the last call, without waiting; empty if there is nothing."""
        ...

    def send(self, data: bytes) -> bool:
        """Hand over bytes without waiting; False if the link did not take them."""
        ...
