"""The MAVLink 2 dialect: XML from the dictionary, and the Python module that mavgen makes of it."""

import contextlib
import functools
import importlib.util
import io
import shutil
import tempfile
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pymavlink
from pymavlink.generator import mavgen, mavparse

from telemetry.commands import COMMANDS, Spec
from telemetry.declaration import Kind, Packet, Point
from telemetry.dictionary import PACKETS, SATURATED, TICK

NAME = "wingbeat"
MESSAGES = {packet: f"WINGBEAT_{packet.name.upper()}" for packet in PACKETS}
"""A packet's message; one of several slots is sent as so many messages, each with its slot."""

COMMAND_BASE = 54000
"""A command's number in COMMAND_LONG, less its number in telemetry/commands.py."""
TABLE_DATA, TABLE_DATA_MESSAGE_ID = "WINGBEAT_TABLE_DATA", 54900
PIECE_BYTES, PIECES = 4, 32

_SHIPPED = Path(pymavlink.__file__).parent / "dialects" / "v20"
_INCLUDED = ("common.xml", "standard.xml", "minimal.xml")
_UNITS = {"1": "", "tick": "", "px": "pix", "": ""}


def wire_type(point: Point) -> str:
    """The MAVLink type of a point: float for quantities, else the smallest unsigned integer."""
    if point.kind in (Kind.QUANTITY, Kind.REAL):
        return "float"
    return next(f"uint{size}_t" for size in (8, 16, 32, 64) if point.bits <= size)


def unavailable(point: Point) -> float:
    """The value of a field that says "not available": NaN, or the type's largest integer."""
    kind = wire_type(point)
    return float("nan") if kind == "float" else (1 << int(kind[4:-2])) - 1


def dialect_xml() -> str:
    """The dialect's XML. It includes common.xml, as every MAVLink tool has it, for HEARTBEAT and the commands."""
    root = ElementTree.Element("mavlink")
    ElementTree.SubElement(root, "include").text = "common.xml"
    enums = ElementTree.SubElement(root, "enums")
    choices = {p.choices: p for packet in PACKETS for p in packet.points if p.choices is not None}
    for enum in choices:
        _enum(enums, enum)
    _commands(enums)
    messages = ElementTree.SubElement(root, "messages")
    for packet in sorted(PACKETS, key=lambda packet: packet.mavlink_id):
        _message(messages, packet)
    _table_data(messages)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def enum_name(choices: type[IntEnum] | type[IntFlag]) -> str:
    """FlightMode becomes WINGBEAT_FLIGHT_MODE."""
    return "WINGBEAT_" + "".join(f"_{c}" if c.isupper() else c for c in choices.__name__).strip("_").upper()


def _enum(parent: ElementTree.Element, choices: type[IntEnum] | type[IntFlag]) -> None:
    enum = ElementTree.SubElement(parent, "enum", name=enum_name(choices))
    if issubclass(choices, IntFlag):
        enum.set("bitmask", "true")
    ElementTree.SubElement(enum, "description").text = (choices.__doc__ or "").strip()
    for choice in choices:
        name = f"{enum_name(choices)}_{choice.name}"
        entry = ElementTree.SubElement(enum, "entry", value=str(int(choice)), name=name)
        ElementTree.SubElement(entry, "description").text = (choice.name or "").lower().replace("_", " ")


def _commands(parent: ElementTree.Element) -> None:
    """The commands, as further entries of MAV_CMD."""
    enum = ElementTree.SubElement(parent, "enum", name="MAV_CMD")
    for command, spec in COMMANDS.items():
        name = f"WINGBEAT_CMD_{command.name}"
        entry = ElementTree.SubElement(enum, "entry", value=str(COMMAND_BASE + command), name=name)
        ElementTree.SubElement(entry, "description").text = f"wingbeat: {spec.meaning}"
        for index, text in enumerate(_parameters(spec), 1):
            ElementTree.SubElement(entry, "param", index=str(index)).text = text


def _parameters(spec: Spec) -> Iterator[str]:
    """Meaning of a command's seven parameters."""
    yield "selector: " + (", ".join(f"{number} {name}" for number, name in spec.selector.items()) or "0")
    yield f"low 16 bits of the value, which may be {spec.value[0]} to {spec.value[1]}"
    yield "high 16 bits of the value"
    yield from ["0"] * 4


def _table_data(parent: ElementTree.Element) -> None:
    """The one message of ours that goes up: pieces of a table."""
    message = ElementTree.SubElement(parent, "message", id=str(TABLE_DATA_MESSAGE_ID), name=TABLE_DATA)
    text = "wingbeat: consecutive pieces of the table that TABLE_LOAD announced"
    ElementTree.SubElement(message, "description").text = text
    for kind, name, meaning in (
        ("uint8_t", "target_system", "system that is to take them"),
        ("uint8_t", "target_component", "component that is to take them"),
        ("uint16_t", "piece", f"number of the first piece of {PIECE_BYTES} bytes, counted from 0"),
        ("uint8_t", "count", "pieces in this message"),
        (f"uint8_t[{PIECE_BYTES * PIECES}]", "data", "their bytes"),
    ):
        ElementTree.SubElement(message, "field", type=kind, name=name).text = meaning


def _message(parent: ElementTree.Element, packet: Packet) -> None:
    message = ElementTree.SubElement(parent, "message", id=str(packet.mavlink_id), name=MESSAGES[packet])
    ElementTree.SubElement(message, "description").text = f"wingbeat: {packet.meaning}"
    time = ElementTree.SubElement(message, "field", type="uint64_t", name="time_usec", units="us")
    time.set("invalid", "UINT64_MAX")
    time.text = "time of the packet's trigger"
    _field(message, TICK)
    if packet.slots > 1:
        slot = ElementTree.SubElement(message, "field", type="uint8_t", name="slot", instance="true")
        slot.text = "place in the packet, from 0"
    for point in (*packet.points, SATURATED):
        _field(message, point)


def _field(message: ElementTree.Element, point: Point) -> None:
    kind = wire_type(point)
    field = ElementTree.SubElement(message, "field", type=kind, name=point.symbol)
    if units := _UNITS.get(point.unit, point.unit):
        field.set("units", units)
    if point.choices is not None:
        field.set("enum", enum_name(point.choices))
        if point.kind is Kind.BITS:
            field.set("display", "bitmask")
    field.set("invalid", "NaN" if kind == "float" else f"{kind[:-2].upper()}_MAX")
    field.text = point.meaning


@functools.cache
def dialect() -> ModuleType:
    """The dialect as a Python module under a private name; made once a process, at INIT, in a folder that is
    removed again. ValueError if mavgen refuses the XML."""
    with tempfile.TemporaryDirectory() as folder:
        for name in _INCLUDED:
            shutil.copy(_SHIPPED / name, folder)
        source, module = Path(folder, f"{NAME}.xml"), Path(folder, f"{NAME}.py")
        source.write_text(dialect_xml())
        options = mavgen.Opts(str(module), mavparse.PROTOCOL_2_0, "Python3", validate=False)
        with contextlib.redirect_stdout(io.StringIO()) as said:
            done = mavgen.mavgen(options, [str(source)])
        if not done:
            raise ValueError(f"mavgen refuses the dialect: {said.getvalue()}")
        spec = importlib.util.spec_from_file_location("telemetry._mavlink_dialect", module)
        if spec is None or spec.loader is None:
            raise ValueError("the dialect's module cannot be loaded")
        made = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(made)
    return made
