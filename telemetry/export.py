"""The dictionary as a DBC file, for CAN tools."""

from collections import OrderedDict
from enum import IntFlag

from cantools.database.can.database import Database
from cantools.database.can.formats.dbc.dbc_specifics import DbcSpecifics
from cantools.database.can.message import Message
from cantools.database.can.node import Node
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

from telemetry.can_codec import FRAME_BYTES, LAYOUTS, Layout
from telemetry.declaration import FRAME_BITS, Kind, Point

NODE = "WINGBEAT"
_SEQUENCE_COMMENT = "counts the sendings of this packet, modulo 256; the frames of one sending share it"
_CRC_COMMENT = (
    "CRC-8 SAE J1850 (polynomial 0x1D, start 0xFF, final XOR 0xFF) over the identifier "
    "(two bytes, low one first) and bytes 0 to 6"
)


def choice_names(point: Point) -> dict[int, str]:
    """What single codes of a point mean, "not_available" included."""
    names: dict[int, str] = {}
    if point.kind is Kind.FLAG:
        names = {0: "no", 1: "yes"}
    elif point.choices is not None:
        none = {0: "none"} if issubclass(point.choices, IntFlag) else {}
        names = none | {int(choice): (choice.name or "").lower() for choice in point.choices}
    if point.kind not in (Kind.REAL, Kind.RAW):
        names[point.unavailable] = "not_available"
    return names


def message_name(layout: Layout) -> str:
    """The name of a frame in the DBC file: packet, slot where it has several, frame."""
    slot = str(layout.slot) if layout.packet.slots > 1 and layout.name not in ("tick", "time") else ""
    return f"{layout.packet.name}{slot}_{layout.name}".upper()


def can_database() -> Database:
    """The CAN dictionary as a cantools database."""
    messages = [_message(can_id, layout) for can_id, layout in LAYOUTS.items()]
    return Database(messages, nodes=[Node(NODE)], version="", dbc_specifics=DbcSpecifics())


def dbc_text() -> str:
    """The DBC file."""
    text: str = can_database().as_dbc_string()
    return text.replace("\r\n", "\n")


def _message(can_id: int, layout: Layout) -> Message:
    signals, start = [], 0
    for point in layout.points:
        signals.append(_signal(point, start))
        start += point.bits
    signals.append(_plain("sequence", FRAME_BITS, _SEQUENCE_COMMENT))
    signals.append(_plain("crc", FRAME_BITS + 8, _CRC_COMMENT))
    period = layout.packet.period_ticks
    when = f"every {'tick' if period == 1 else f'{period} ticks'}" if period else "when an event happens"
    comment = f"{layout.packet.meaning}; {when}"
    return Message(can_id, message_name(layout), FRAME_BYTES, signals, comment=comment, senders=[NODE])


def _signal(point: Point, start: int) -> Signal:
    names = choice_names(point)
    real = point.kind is Kind.REAL
    conversion = BaseConversion.factory(
        scale=1 if real else point.scale,
        offset=0 if real else point.minimum,
        choices=OrderedDict(sorted(names.items())) if names else None,
        is_float=real,
    )
    return Signal(
        point.symbol,
        start,
        point.bits,
        is_signed=real,
        conversion=conversion,
        minimum=point.minimum,
        maximum=point.maximum,
        unit=point.unit if point.unit not in ("", "1") else None,
        comment=point.meaning,
    )


def _plain(name: str, start: int, comment: str) -> Signal:
    return Signal(name, start, 8, minimum=0, maximum=255, comment=comment)
