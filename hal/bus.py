"""The bus to the attitude controller."""

from typing import Any, Protocol

from numpy.typing import NDArray

Payload = bytes | bytearray | NDArray[Any]


class Bus(Protocol):
    """A CAN bus: short frames, an identifier each."""

    def send(self, can_id: int, data: Payload, time_ns: int) -> bool:
        """Queue one frame of at most 8 bytes with the trigger's time; False if the bus did not take it."""
        ...

    def receive(self) -> tuple[int, bytes] | None:
        """The oldest frame that came, identifier and data, without waiting; None if there is none."""
        ...
