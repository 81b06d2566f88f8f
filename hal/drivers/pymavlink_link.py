"""A MAVLink line through pymavlink: UDP, TCP or a serial port, by its connection string."""

import contextlib
import os
from typing import Any

from wingbeat.errors import InputError


class PymavlinkLink:
    """udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, or DEVICE,BAUD; counts what it could not send.

    Raises InputError where it cannot be opened.
    """

    def __init__(self, url: str) -> None:
        os.environ.setdefault("MAVLINK20", "1")  # pymavlink asks when it is imported
        from pymavlink import mavutil

        self.refused = 0
        device, _, baud = url.partition(",")
        try:
            self._line: Any = mavutil.mavlink_connection(device, baud=int(baud or 57600), retries=1)
        except (OSError, ValueError, ImportError, AttributeError, IndexError) as error:
            raise InputError(
                f"cannot open the MAVLink line: {error}",
                url,
                "name udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, or DEVICE,BAUD",
            ) from None

    def receive(self) -> bytes:
        """What has come since the last call; a line that fails gives nothing."""
        try:
            return bytes(self._line.recv(4096) or b"")
        except OSError:
            return b""

    def send(self, data: bytes) -> bool:
        """Hand over bytes; False, and counted, if the line failed."""
        try:
            self._line.write(data)
        except OSError:
            self.refused += 1
            return False
        return True

    def close(self) -> None:
        """Release the line."""
        with contextlib.suppress(OSError):
            self._line.close()
