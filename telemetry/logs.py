"""Files that a run writes as it goes: NAME.active until they are finished; the CAN log and the MAVLink log."""

import struct
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from telemetry.can_codec import CanEncoder


def log_time_ns(time_ns: int) -> int:
    """The time under which a record stands in a log; logs begin at 0, and a clock that went back beyond has none."""
    return max(time_ns, 0)


class LogFile:
    """A file that is NAME.active while it is written, and NAME once it is complete.

    With `with` an error leaves the .active file as it is, so that nothing unfinished looks complete.
    Raises OSError where path cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._active = path.with_name(path.name + ".active")
        self.stream: BinaryIO = self._active.open("wb")

    def close(self) -> None:
        """Finish the file and give it its name."""
        self.stream.close()
        self._active.replace(self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.stream.close()


class CanLog(LogFile):
    """CAN frames as text, as `candump -L` writes it: (seconds.micro) can0 ID#DATA."""

    def write(self, time_ns: int, encoder: CanEncoder, count: int) -> None:
        """Append the encoder's first count frames under the trigger's time."""
        seconds, rest = divmod(log_time_ns(time_ns) // 1000, 1_000_000)
        for row in range(count):
            can_id, data = encoder.frame(row)
            self.stream.write(f"({seconds}.{rest:06d}) can0 {can_id:03X}#{data.hex().upper()}\n".encode())


class MavlinkLog(LogFile):
    """MAVLink packets as a tlog: the trigger's time in us (8 bytes, big-endian) before each."""

    def write(self, time_ns: int, packets: Iterable[bytes]) -> None:
        """Append packets under the trigger's time."""
        for packet in packets:
            self.stream.write(struct.pack(">Q", log_time_ns(time_ns) // 1000) + packet)
