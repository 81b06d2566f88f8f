"""CAN through python-can: any bus that it knows; `virtual` stays inside the process."""

from typing import Any

import can

from hal.bus import Payload
from wingbeat.errors import InputError

_LARGEST_STANDARD_ID = 0x7FF


def _message(can_id: int, data: Payload, time_ns: int) -> can.Message:
    return can.Message(
        timestamp=time_ns / 1e9,
        arbitration_id=can_id,
        is_extended_id=can_id > _LARGEST_STANDARD_ID,
        is_rx=False,
        data=bytes(data),
        check=True,
    )


class PythonCanBus:
    """One channel of an interface of python-can; counts what it sent and what the bus refused."""

    def __init__(self, interface: str = "virtual", channel: str = "wingbeat", bitrate: int | None = None) -> None:
        settings: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}
        self.sent = 0
        self.refused = 0
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **settings)
        except (can.CanError, OSError, ImportError, ValueError, TypeError) as error:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise InputError(
                f"cannot open the CAN bus: {error}",
                f"interface {interface}, channel {channel}",
                f"check the wiring and the driver; python-can knows {known}",
            ) from None

    def send(self, can_id: int, data: Payload, time_ns: int) -> bool:
        """Hand the frame to the driver without waiting; False, and counted, if its queue is full or it failed."""
        try:
            self._bus.send(_message(can_id, data, time_ns), timeout=0)
        except (can.CanError, OSError):
            self.refused += 1
            return False
        self.sent += 1
        return True

    def receive(self) -> tuple[int, bytes] | None:
        """The oldest data frame that came; None if there is none, or the driver failed."""
        try:
            message = self._bus.recv(timeout=0)
        except (can.CanError, OSError):
            return None
        if message is None or message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            return None
        return message.arbitration_id, bytes(message.data)

    def close(self) -> None:
        """Release the channel."""
        self._bus.shutdown()
