"""CAN: packets to protected classic frames, into arrays that are allocated once; and a frame back to its signals.

A frame: six bytes of signals (little endian, first signal in the lowest bits), the sequence counter of its packet's
sending, and a CRC-8 SAE J1850 over the two bytes of its identifier (low byte first) and these seven bytes.
"""

from dataclasses import dataclass

import fastcrc
import numpy as np
import numpy.typing as npt

from telemetry.board import Board, EventRecord
from telemetry.declaration import Packet, Point
from telemetry.dictionary import (
    EPOCH_US,
    EVENT_ARGUMENT_COUNT,
    EVENT_ARGUMENT_POINTS,
    EVENT_INDEX,
    EVENT_NUMBER,
    EVENT_PACKET,
    EVENT_SEVERITY,
    HEADER_FRAMES,
    PACKETS,
    PERIODIC_PACKETS,
    SATURATED,
    TICK,
    TIME_EPOCH,
    TIME_US,
)
from telemetry.events import EVENT_BY_NUMBER
from telemetry.scaling import clip, decode, encode, slot_values

FRAME_BYTES = 8
NAN = float("nan")


@dataclass(frozen=True)
class Layout:
    """Where a frame belongs: its packet, slot and name, and its signals from the lowest bit upwards."""

    packet: Packet
    slot: int
    name: str
    points: tuple[Point, ...]


def layouts() -> dict[int, Layout]:
    """Every frame of the dictionary by its identifier."""
    frames: dict[int, Layout] = {}
    for packet in PACKETS:
        groups = [(0, *frame) for frame in HEADER_FRAMES]
        groups += [(slot, *frame) for slot in range(packet.slots) for frame in packet.frames]
        for place, (slot, name, points) in enumerate(groups):
            if frames.setdefault(packet.can_id + place, layout := Layout(packet, slot, name, points)) is not layout:
                raise ValueError(f"packet {packet.name}: identifier {packet.can_id + place:#x} is taken twice")
    return frames


LAYOUTS = layouts()


def protect(can_id: int, seven: bytes) -> int:
    """The CRC of a frame's first seven bytes; its identifier takes part, so that a frame under a wrong one fails."""
    return int(fastcrc.crc8.sae_j1850(can_id.to_bytes(2, "little") + seven))


def event_on_board(board: Board, record: EventRecord) -> None:
    """Put an event on a board, where its packet's points are; arguments that it lacks are "not available"."""
    known = EVENT_BY_NUMBER.get(record.number)
    board.set(EVENT_NUMBER, record.number)
    board.set(EVENT_SEVERITY, NAN if known is None else known.severity)
    board.set(EVENT_ARGUMENT_COUNT, len(record.arguments))
    board.set(EVENT_INDEX, record.index)
    for place, point in enumerate(EVENT_ARGUMENT_POINTS):
        board.set(point, record.arguments[place] if place < len(record.arguments) else NAN)


def trigger_of(packet: Packet, board: Board, tick: int, time_ns: int) -> tuple[float, float]:
    """Tick and time in us to which a packet belongs: its own, or that of the tick that sends it."""
    if packet.tick is None or packet.time_us is None:
        return float(tick), float(time_ns // 1000)
    return board.get(packet.tick), board.get(packet.time_us)


class CanEncoder:
    """Encodes the packets that are due. ids (K,) and data (K, 8) hold the frames of the last call; saturated counts
    all clipped values since the start."""

    def __init__(self) -> None:
        capacity = sum(packet.frame_count for packet in PACKETS)
        self.ids: npt.NDArray[np.uint32] = np.zeros(capacity, np.uint32)
        self.data: npt.NDArray[np.uint8] = np.zeros((capacity, FRAME_BYTES), np.uint8)
        self.saturated = 0
        self._bytes = memoryview(self.data.reshape(-1))  # type: ignore[arg-type]  # numpy arrays are buffers
        self._sequence = dict.fromkeys(PACKETS, 0)
        self._values = [NAN] * max(len(packet.points) for packet in PACKETS)
        self._event = Board()

    def encode(self, board: Board, tick: int, time_ns: int) -> int:
        """Encode the packets that are due at this tick; return the number of frames, in rows 0 to that."""
        count = 0
        for packet in PERIODIC_PACKETS:
            if packet.due(tick):
                count = self._packet(packet, board, tick, time_ns, count)
        return count

    def encode_event(self, record: EventRecord) -> int:
        """Encode one event; return the number of frames, in rows 0 to that."""
        event_on_board(self._event, record)
        return self._packet(EVENT_PACKET, self._event, record.tick, record.time_ns, 0)

    def encode_on_demand(self, packet: Packet, board: Board, tick: int, time_ns: int) -> int:
        """Encode one packet that has no period; return the number of frames, in rows 0 to that."""
        return self._packet(packet, board, tick, time_ns, 0)

    def frame(self, row: int) -> tuple[int, bytes]:
        """Identifier and data of one encoded frame."""
        return int(self.ids[row]), bytes(self._bytes[row * FRAME_BYTES : (row + 1) * FRAME_BYTES])

    def _packet(self, packet: Packet, board: Board, tick: int, time_ns: int, row: int) -> int:
        sequence = self._sequence[packet]
        self._sequence[packet] = (sequence + 1) % 256
        clipped, at = 0, row + len(HEADER_FRAMES)
        for slot in range(packet.slots):
            clipped += slot_values(packet, board, slot, self._values)
            place = 0
            for _, points in packet.frames:
                self._frame(at, packet.can_id + at - row, points, self._values[place:], sequence)
                at, place = at + 1, place + len(points)
        header, cut = _header(*trigger_of(packet, board, tick, time_ns))
        self.saturated += clipped + cut
        header[SATURATED] = float(min(clipped + cut, int(SATURATED.maximum)))
        for place, (_, points) in enumerate(HEADER_FRAMES):
            self._frame(row + place, packet.can_id + place, points, [header[p] for p in points], sequence)
        return at

    def _frame(self, row: int, can_id: int, points: tuple[Point, ...], values: list[float], sequence: int) -> None:
        bits = shift = 0
        for point, value in zip(points, values, strict=False):
            bits |= encode(point, value) << shift
            shift += point.bits
        seven = bits.to_bytes(6, "little") + sequence.to_bytes(1, "little")
        self.ids[row] = can_id
        self._bytes[row * FRAME_BYTES : (row + 1) * FRAME_BYTES] = seven + bytes((protect(can_id, seven),))


def _header(tick: float, time_us: float) -> tuple[dict[Point, float], int]:
    """The header's values but SATURATED, and how many of them were clipped."""
    kept_tick, cut = clip(TICK, tick)
    if not time_us >= 0.0:  # not known, or before time began: a clock that went back
        return {TICK: kept_tick, TIME_EPOCH: NAN, TIME_US: NAN}, int(cut)
    epoch, rest = divmod(time_us, EPOCH_US)
    kept_epoch, outside = clip(TIME_EPOCH, epoch)
    # The last code of the 48 bits says "not available"; the us before it is one us wrong, and available.
    kept_rest, _ = clip(TIME_US, rest)
    return {TICK: kept_tick, TIME_EPOCH: kept_epoch, TIME_US: kept_rest}, cut + outside


def decode_frame(can_id: int, data: bytes) -> tuple[Layout, int, dict[Point, float]]:
    """One frame back: its layout, its sequence counter and its signals (NaN: not available).

    ValueError says why a frame is refused: unknown identifier, wrong length, wrong CRC.
    """
    layout = LAYOUTS.get(can_id)
    if layout is None:
        raise ValueError("unknown identifier")
    if len(data) != FRAME_BYTES:
        raise ValueError("wrong length")
    if protect(can_id, data[:7]) != data[7]:
        raise ValueError("wrong CRC")
    bits, values = int.from_bytes(data[:6], "little"), {}
    for point in layout.points:
        values[point] = decode(point, bits & point.unavailable)
        bits >>= point.bits
    return layout, data[6], values
