"""What hangs on the flight side's lines in a simulation: a controller on the bus, and the ground with its commands."""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from hal.bus import Payload
from telemetry.can_codec import decode_frame
from telemetry.declaration import Point
from telemetry.dictionary import AGE_TICKS, FLAGS, FREQUENCY_HZ, FREQUENCY_SIGMA_HZ, MODE_PACKET, VALID


class SentMode(NamedTuple):
    """One slot of a mode packet, as the controller reads it; flags and age as on the wire."""

    slot: int
    frequency_hz: float
    sigma_hz: float
    valid: bool
    flags: int
    age_ticks: int


class Heard(NamedTuple):
    """A whole mode packet: when it came (the receiver's own tick), and the slots that hold a mode."""

    at_tick: int
    modes: tuple[SentMode, ...]

    @property
    def valid(self) -> tuple[SentMode, ...]:
        """The modes that the controller may use."""
        return tuple(mode for mode in self.modes if mode.valid)


class ControllerBus:
    """A bus whose one listener is the attitude controller: it reads the mode packets, and keeps `frames` if asked to.

    off: the bus takes nothing. now: the receiver's own tick. most: packets that are known afterwards, None: all.
    uplink: frames that wait for the flight side.
    """

    def __init__(self, now: Callable[[], int] = lambda: 0, keep: bool = False, most: int | None = None) -> None:
        self._now, self._keep = now, keep
        self.off = False
        self.frames: list[tuple[int, bytes]] = []
        self.heard: deque[Heard] = deque(maxlen=most)
        self.uplink: deque[tuple[int, bytes]] = deque()
        self._packet: dict[int, bytes] = {}
        self._last = MODE_PACKET.can_id + MODE_PACKET.frame_count - 1

    def send(self, can_id: int, data: Payload, time_ns: int) -> bool:
        """Take a frame; False if the bus is off."""
        if self.off:
            return False
        if self._keep:
            self.frames.append((can_id, bytes(data)))
        if MODE_PACKET.can_id <= can_id <= self._last:
            self._listen(can_id, bytes(data))
        return True

    def receive(self) -> tuple[int, bytes] | None:
        """The next frame from the ground; None if there is none, or the bus is off."""
        return None if self.off or not self.uplink else self.uplink.popleft()

    def close(self) -> None:
        """Nothing is open."""

    def _listen(self, can_id: int, data: bytes) -> None:
        """Put a packet together; one that lacks a frame, or mixes two, is not used."""
        if can_id == MODE_PACKET.can_id:
            self._packet.clear()
        self._packet[can_id] = data
        whole = len(self._packet) == MODE_PACKET.frame_count
        if can_id == self._last and whole and len({frame[6] for frame in self._packet.values()}) == 1:
            self._read()

    def _read(self) -> None:
        slots: dict[int, dict[Point, float]] = {}
        for can_id, data in self._packet.items():
            layout, _, values = decode_frame(can_id, data)
            slots.setdefault(layout.slot, {}).update(values)
        modes = tuple(
            SentMode(
                slot,
                values[FREQUENCY_HZ],
                values[FREQUENCY_SIGMA_HZ],
                values[VALID] == 1.0,
                int(values[FLAGS]),
                int(values[AGE_TICKS]),
            )
            for slot, values in sorted(slots.items())
            if values[FREQUENCY_HZ] == values[FREQUENCY_HZ]
        )
        self.heard.append(Heard(self._now(), modes))


class MemoryLink:
    """A byte stream to and from the ground, in memory."""

    def __init__(self) -> None:
        self.uplink = bytearray()
        self.downlink = bytearray()
        self.off = False

    def receive(self) -> bytes:
        """What has come since the last call."""
        data, self.uplink = bytes(self.uplink), bytearray()
        return data

    def send(self, data: bytes) -> bool:
        """Take bytes for the ground; False if the link is down."""
        if not self.off:
            self.downlink += data
        return not self.off
