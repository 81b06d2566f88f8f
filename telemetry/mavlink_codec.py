"""MAVLink 2: packets that are due to messages in bytes, and bytes back to messages. No clock takes part."""

from collections.abc import Iterator
from typing import Any

from telemetry.board import Board, EventRecord
from telemetry.can_codec import event_on_board, trigger_of
from telemetry.declaration import Packet
from telemetry.dictionary import (
    EVENT_PACKET,
    HEARTBEAT_PERIOD_TICKS,
    MODE,
    PERIODIC_PACKETS,
    SATURATED,
    TICK,
    FlightMode,
)
from telemetry.mavlink_dialect import MESSAGES, dialect, unavailable, wire_type
from telemetry.mavlink_packet import (
    COMPONENT_ID,
    NO_PACKET,
    SYSTEM_ID,
    decode_packet,
    is_unknown,
    packet_length,
)
from telemetry.mavlink_uplink import Answered, answer_message
from telemetry.scaling import clip, slot_values

_UINT64_MAX = (1 << 64) - 1


class MavlinkEncoder:
    """Encodes the packets that are due, and a HEARTBEAT; saturated counts all clipped values since the start."""

    def __init__(self, system_id: int = SYSTEM_ID, component_id: int = COMPONENT_ID) -> None:
        self._dialect: Any = dialect()
        self._link = self._dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._messages = {p: self._dialect.mavlink_map[p.mavlink_id] for p in MESSAGES}
        self._event = Board()
        self.saturated = 0

    def encode(self, board: Board, tick: int, time_ns: int) -> list[bytes]:
        """The messages that are due at this tick, each a complete MAVLink 2 packet."""
        due = [self._heartbeat(board)] if tick % HEARTBEAT_PERIOD_TICKS == 0 else []
        for packet in PERIODIC_PACKETS:
            if packet.due(tick):
                due += self._packet(packet, board, tick, time_ns)
        return due

    def encode_event(self, record: EventRecord) -> list[bytes]:
        """The message of one event."""
        event_on_board(self._event, record)
        return self._packet(EVENT_PACKET, self._event, record.tick, record.time_ns)

    def encode_on_demand(self, packet: Packet, board: Board, tick: int, time_ns: int) -> list[bytes]:
        """The message of one packet that has no period."""
        return self._packet(packet, board, tick, time_ns)

    def encode_answer(self, answer: Answered) -> bytes:
        """The message that answers the ground."""
        return self._pack(answer_message(answer))

    def _packet(self, packet: Packet, board: Board, tick: int, time_ns: int) -> list[bytes]:
        of_tick, time_us = trigger_of(packet, board, tick, time_ns)
        kept_tick, cut = clip(TICK, of_tick)
        head: dict[str, Any] = {
            "time_usec": int(time_us) if time_us >= 0.0 else _UINT64_MAX,
            TICK.symbol: int(unavailable(TICK) if kept_tick != kept_tick else kept_tick),
        }
        messages, values = [], [0.0] * len(packet.points)
        for slot in range(packet.slots):
            clipped = slot_values(packet, board, slot, values) + cut
            self.saturated += clipped
            fields = dict(head)
            if packet.slots > 1:
                fields["slot"] = slot
            for point, value in zip(packet.points, values, strict=True):
                sent = unavailable(point) if value != value else value
                fields[point.symbol] = sent if wire_type(point) == "float" else round(sent)
            fields[SATURATED.symbol] = min(clipped, int(SATURATED.maximum))
            messages.append(self._pack(self._messages[packet](**fields)))
        return messages

    def _heartbeat(self, board: Board) -> bytes:
        """HEARTBEAT of the common dialect, so that an ordinary ground station sees the node."""
        mav, mode = self._dialect, board.get(MODE)
        states = {
            FlightMode.INIT: mav.MAV_STATE_BOOT,
            FlightMode.ACQUIRE: mav.MAV_STATE_CALIBRATING,
            FlightMode.TRACK: mav.MAV_STATE_ACTIVE,
            FlightMode.DEGRADED: mav.MAV_STATE_CRITICAL,
        }
        known = mode == mode
        return self._pack(
            mav.MAVLink_heartbeat_message(
                type=mav.MAV_TYPE_ONBOARD_CONTROLLER,
                autopilot=mav.MAV_AUTOPILOT_INVALID,
                base_mode=mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED if known else 0,
                custom_mode=int(mode) if known else 0,
                system_status=states.get(FlightMode(int(mode)), mav.MAV_STATE_STANDBY) if known else 0,
                mavlink_version=3,
            )
        )

    def _pack(self, message: Any) -> bytes:
        packed: bytes = message.pack(self._link)
        self._link.seq = (self._link.seq + 1) % 256
        return packed


def parse_tlog(content: bytes) -> Iterator[Any]:
    """Messages of a tlog (8-byte big-endian us and a packet, repeated), each as its pymavlink object.

    Where bytes are no message, the reason stands in its place as a str; one corrupt stretch counts once, however
    many bytes the search for the next packet takes.
    """
    link, at, lost = dialect().MAVLink(None), 0, False
    while at < len(content):
        length = packet_length(content, at + 8)
        whole = length is not None and at + 8 + length <= len(content)
        found = decode_packet(link, content[at + 8 : at + 8 + length]) if whole and length is not None else NO_PACKET
        # The CRC of an unknown message cannot be checked: within a corrupt stretch it is no message at all.
        if length is not None and not isinstance(found, str) and not (lost and is_unknown(found)):
            yield "unknown message" if is_unknown(found) else found
            at, lost = at + 8 + length, False
        else:
            if not lost:
                yield found
            at, lost = at + 1, True
