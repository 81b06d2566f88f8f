"""The kernel's watchdog device: the processor is reset unless something is written in time."""

from pathlib import Path

from wingbeat.errors import InputError

DEVICE = Path("/dev/watchdog")
KEEP_ALIVE = b"\0"
DISARM = b"V"  # the kernel's "magic close": without it the time goes on after the file is closed


class WatchdogDevice:
    """Opening it starts its time. refused: writes that the device did not take; unserved, it does its work.

    Raises InputError when there is no such device, or it is in use.
    """

    def __init__(self, path: Path = DEVICE) -> None:
        try:
            self._file = path.open("r+b", buffering=0)
        except OSError as error:
            raise InputError(f"cannot open: {error.strerror}", path, "name a watchdog device that is free") from None
        self.refused = 0

    def serve(self) -> None:
        """Start its time again."""
        self._write(KEEP_ALIVE)

    def expired(self) -> bool:
        """Never: when its time runs out, nobody is there to ask."""
        return False

    def close(self) -> None:
        """Disarm it: a clean end is no hang."""
        self._write(DISARM)
        self._file.close()

    def _write(self, data: bytes) -> None:
        try:
            self._file.write(data)
        except OSError:
            self.refused += 1
