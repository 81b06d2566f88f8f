"""MAVLink 2 packets in a stream of bytes: where they begin, whether they are whole, and what is noise."""

from collections.abc import Iterator
from typing import Any

from telemetry.mavlink_dialect import dialect

SYSTEM_ID = 1
COMPONENT_ID = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: a payload computer beside the spacecraft's own."""

MAGIC = 0xFD
HEADER_BYTES, CHECKSUM_BYTES, SIGNATURE_BYTES = 10, 2, 13
LONGEST_PACKET = HEADER_BYTES + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
NO_PACKET = "no packet or a truncated one"


def packet_length(content: bytes | bytearray, start: int) -> int | None:
    """Length of the packet whose header stands there, by its own word; None if it is no header, or not a whole one."""
    if start + HEADER_BYTES > len(content) or content[start] != MAGIC:
        return None
    signed = SIGNATURE_BYTES if content[start + 2] & 1 else 0
    return HEADER_BYTES + content[start + 1] + CHECKSUM_BYTES + signed


def decode_packet(link: Any, packet: bytes | bytearray) -> Any:
    """The message of a whole packet as its pymavlink object, or why it is none as a str."""
    try:
        return link.decode(bytearray(packet))
    except dialect().MAVError:
        return "wrong CRC"


def is_unknown(message: Any) -> bool:
    """Whether the dialect has no such message; its CRC cannot be checked then."""
    return not isinstance(message, str) and message.get_type().startswith("UNKNOWN")


class PacketFinder:
    """Finds packets in bytes that come piece by piece, in memory of a fixed size.

    Iterating gives messages, and a str for each stretch of bytes that is none; messages that the dialect does not have
    are let pass. The beginning of a packet waits for its end.
    """

    def __init__(self, link: Any, places: int) -> None:
        """link: a MAVLink of the dialect; places: bytes that may wait, at least a packet."""
        self._link, self._places = link, places
        self._waiting = bytearray()
        self._lost = False  # within a stretch that is no packet, and was told already

    @property
    def room(self) -> int:
        """Bytes that can be taken now."""
        return self._places - len(self._waiting)

    def add(self, data: bytes) -> int:
        """Take bytes; how many found no room."""
        taken = data[: self.room]
        self._waiting += taken
        return len(data) - len(taken)

    def __iter__(self) -> Iterator[Any]:
        while self._waiting:
            start = self._waiting.find(MAGIC)
            if start != 0:
                if self._skip(len(self._waiting) if start < 0 else start):
                    yield NO_PACKET
                continue
            length = packet_length(self._waiting, 0)
            if length is None or length > len(self._waiting):
                return
            found = decode_packet(self._link, self._waiting[:length])
            if isinstance(found, str) or (self._lost and is_unknown(found)):
                if self._skip(1):
                    yield found
                continue
            del self._waiting[:length]
            self._lost = False
            if not is_unknown(found):
                yield found

    def _skip(self, count: int) -> bool:
        """Drop bytes that are no packet; whether this is the first time in a row."""
        del self._waiting[:count]
        told, self._lost = self._lost, True
        return not told
