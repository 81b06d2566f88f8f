"""CAN logs to records: candump, ASC and BLF through python-can; frames of one sending are put together again."""

import io
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can

from telemetry.can_codec import Layout, decode_frame
from telemetry.declaration import Packet, Point
from telemetry.dictionary import EPOCH_US, SATURATED, TICK, TIME_EPOCH, TIME_US
from telemetry.records import packet_record

NAN = float("nan")


class _Sending:
    """The frames of one packet that share a sequence counter."""

    def __init__(self, packet: Packet, sequence: int) -> None:
        self.packet, self.sequence = packet, sequence
        self.seen: set[tuple[int, str]] = set()
        self._header: dict[Point, float] = {}
        self._slots: list[dict[Point, float]] = [{} for _ in range(packet.slots)]

    def add(self, layout: Layout, values: dict[Point, float]) -> None:
        self.seen.add((layout.slot, layout.name))
        is_header = TICK in values or TIME_US in values
        (self._header if is_header else self._slots[layout.slot]).update(values)

    @property
    def complete(self) -> bool:
        return len(self.seen) == self.packet.frame_count

    def records(self) -> Iterator[dict[str, Any]]:
        head = self._header
        time_us = head.get(TIME_EPOCH, NAN) * EPOCH_US + head.get(TIME_US, NAN)
        saturated = head.get(SATURATED, NAN)
        more = {"sequence": self.sequence, "saturated": int(saturated) if saturated == saturated else None}
        if not self.complete:
            more["incomplete"] = True
        for slot, values in enumerate(self._slots):
            if values:
                yield packet_record(self.packet, slot, head.get(TICK, NAN), time_us, values, **more)


class Assembler:
    """Puts the frames of each channel together; counts refused frames, incomplete and lost packets."""

    def __init__(self, problems: Counter[str]) -> None:
        self._problems = problems
        self._open: dict[tuple[Any, Packet], _Sending] = {}
        self._last: dict[tuple[Any, Packet], int] = {}

    def add(self, channel: Any, can_id: int, data: bytes) -> Iterator[dict[str, Any]]:
        """Take one frame; yield the records that it completes or closes."""
        try:
            layout, sequence, values = decode_frame(can_id, data)
        except ValueError as reason:
            self._problems[str(reason)] += 1
            return
        key = (channel, layout.packet)
        sending = self._open.get(key)
        if sending and (sending.sequence != sequence or (layout.slot, layout.name) in sending.seen):
            yield from self._close(key)
            sending = None
        if sending is None:
            sending = self._open[key] = _Sending(layout.packet, sequence)
            if key in self._last:
                self._problems["lost packet"] += (sequence - self._last[key] - 1) % 256
            self._last[key] = sequence
        sending.add(layout, values)
        if sending.complete:
            yield from self._close(key)

    def finish(self) -> Iterator[dict[str, Any]]:
        """Yield the records of what is still open at the end."""
        for key in list(self._open):
            yield from self._close(key)

    def _close(self, key: tuple[Any, Packet]) -> Iterator[dict[str, Any]]:
        sending = self._open.pop(key)
        if not sending.complete:
            self._problems["incomplete packet"] += 1
        yield from sending.records()


def _assemble(messages: Iterator[can.Message], problems: Counter[str]) -> Iterator[dict[str, Any]]:
    assembler = Assembler(problems)
    for message in messages:
        if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            problems["foreign frame"] += 1
        else:
            yield from assembler.add(message.channel, message.arbitration_id, bytes(message.data))
    yield from assembler.finish()


def read_candump(path: Path, problems: Counter[str]) -> Iterator[dict[str, Any]]:
    """Records of a candump text log; a line that is no frame is counted."""

    def messages() -> Iterator[can.Message]:
        with path.open(encoding="ascii", errors="replace") as text:
            for line in text:
                # One reader a line: python-can's ends at the first line that it cannot read.
                try:
                    yield from can.CanutilsLogReader(io.StringIO(line))
                except ValueError:
                    problems["line that is no frame"] += 1

    return _assemble(messages(), problems)


def _read(path: Path, problems: Counter[str], reader: Callable[[str], Any]) -> Iterator[dict[str, Any]]:
    def messages() -> Iterator[can.Message]:
        path.open("rb").close()  # a missing file is an OSError here, apart from a corrupt one below
        try:
            with reader(str(path)) as log:
                yield from log
        except Exception:  # the readers raise whatever a corrupt file makes them meet
            problems["unreadable rest of the file"] += 1

    return _assemble(messages(), problems)


def read_asc(path: Path, problems: Counter[str]) -> Iterator[dict[str, Any]]:
    """Records of a Vector ASC log."""
    return _read(path, problems, can.ASCReader)


def read_blf(path: Path, problems: Counter[str]) -> Iterator[dict[str, Any]]:
    """Records of a Vector BLF log."""
    return _read(path, problems, can.BLFReader)
