"""Values to codes and back: fixed point that saturates and says so, "not available" for NaN, and text for people."""

import math
import struct
from typing import Any

from telemetry.board import OFFSET, Board
from telemetry.declaration import Kind, Packet, Point
from telemetry.dictionary import FLAGS, VALID, ModeFlag

Readable = int | float | bool | str | list[str] | None


def clip(point: Point, value: float) -> tuple[float, bool]:
    """The value within the point's range, and whether it was clipped; NaN passes.

    A flag or choice outside its range becomes NaN: the nearest choice would say something that nobody said.
    """
    if value != value or point.minimum <= value <= point.maximum:
        return value, False
    if point.kind in (Kind.FLAG, Kind.CHOICE, Kind.BITS):
        return math.nan, True
    return (point.minimum if value < point.minimum else point.maximum), True


def encode(point: Point, value: float) -> int:
    """The code of a value within the point's range, to the nearest step; all ones for NaN."""
    if point.kind is Kind.REAL:
        code: int = struct.unpack("<I", struct.pack("<f", value))[0] if value == value else 0x7FC0_0000
        return code
    if point.kind is Kind.RAW:
        return int(value) & point.unavailable
    if value != value:
        return point.unavailable
    return round((value - point.minimum) / point.scale)


def decode(point: Point, code: int) -> float:
    """The value of a code in the point's unit; NaN for "not available" and for codes beyond the range."""
    if point.kind is Kind.REAL:
        real: float = struct.unpack("<f", struct.pack("<I", code))[0]
        return real
    if point.kind is Kind.RAW:
        return float(code)
    value = point.minimum + code * point.scale
    if code == point.unavailable or value > point.maximum + point.scale / 2:
        return math.nan
    # Twelve decimals lie far below every step; they take away the binary tail of code * scale.
    return float(round(value, 12))


def slot_values(packet: Packet, board: Board, slot: int, into: list[float]) -> int:
    """Fill into with the packet's values of one slot, clipped to their ranges; return how many were clipped.

    A mode with a clipped value is sent with valid = 0 and the flag SATURATED: its number is not what was measured.
    VALID and FLAGS come last in their packet, so that every other value is known by then.
    """
    clipped = 0
    for place, point in enumerate(packet.points):
        value, cut = clip(point, board.cells[OFFSET[point.name] + (slot if point.slots > 1 else 0)])
        clipped += cut
        if clipped and point is VALID:
            value = 0.0
        elif clipped and point is FLAGS:
            value = float((0 if value != value else int(value)) | ModeFlag.SATURATED)
        into[place] = value
    return clipped


def readable(point: Point, value: float) -> Readable:
    """The value as JSON shows it: number, bool, name of the choice, list of flags' names, None for NaN."""
    if value != value:
        return None
    if point.kind in (Kind.COUNT, Kind.RAW):
        return int(value)
    if point.kind is Kind.FLAG:
        return bool(value)
    if point.kind is Kind.CHOICE and point.choices is not None:
        return next((choice.name for choice in point.choices if choice == value), int(value))
    if point.kind is Kind.BITS and point.choices is not None:
        return [choice.name.lower() for choice in point.choices if int(value) & choice and choice.name]
    return value


def json_type(point: Point) -> dict[str, Any]:
    """The JSON schema of what `readable` returns, None aside."""
    kinds: dict[Kind, dict[str, Any]] = {
        Kind.COUNT: {"type": "integer"},
        Kind.RAW: {"type": "integer"},
        Kind.FLAG: {"type": "boolean"},
        Kind.CHOICE: {"type": "string"},
        Kind.BITS: {"type": "array", "items": {"type": "string"}},
    }
    return {**kinds.get(point.kind, {"type": "number"}), "description": f"{point.meaning} [{point.unit}]"}
