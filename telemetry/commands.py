"""Commands: declared once, with the frames that carry them on CAN.

A command frame, identifier 0x180: number (8 bits), selector (8), value (32, little endian), sequence (8), CRC-8. A
piece of a table, identifier 0x181: number of the piece (16), four bytes, sequence, CRC-8. The CRC is the one of the
telemetry frames, with the identifier in it.
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from telemetry.can_codec import FRAME_BYTES, protect
from telemetry.dictionary import CommandResult, FlightMode
from telemetry.events import TableNumber, TaskNumber

COMMAND_ID, TABLE_DATA_ID = 0x180, 0x181
UPLINK_IDS = (COMMAND_ID, TABLE_DATA_ID)
LARGEST_VALUE = 0xFFFFFFFF


class Command(IntEnum):
    """Number of each command."""

    NOOP = 1
    RESET_COUNTERS = 2
    SET_MODE = 3
    ENABLE_TASK = 4
    DISABLE_TASK = 5
    ENABLE_LIMIT = 6
    DISABLE_LIMIT = 7
    CLEAR_FAULT = 8
    TABLE_LOAD = 9
    TABLE_VALIDATE = 10
    TABLE_ACTIVATE = 11
    TABLE_ROLL_BACK = 12
    TABLE_ABORT = 13
    TABLE_DUMP = 14
    DUMP_DIAGNOSTICS = 15
    ARM = 16
    FIRE = 17
    START_RECORDING = 18
    STOP_RECORDING = 19
    RESTART = 20


class CommandMode(IntEnum):
    """What SET_MODE can ask for, by the numbers of the flight modes."""

    ACQUIRE = FlightMode.ACQUIRE
    INHIBITED = FlightMode.INHIBITED
    TEST = FlightMode.TEST


class Spec(NamedTuple):
    """One command. selector: what it may be; empty: 0. value: least and most. dangerous: by ARM and FIRE only."""

    meaning: str
    selector: Mapping[int, str] = {}
    value: tuple[int, int] = (0, 0)
    dangerous: bool = False


def _names(choices: type[IntEnum]) -> dict[int, str]:
    return {int(choice): choice.name for choice in choices}


_TABLES, _TASKS = _names(TableNumber), _names(TaskNumber)
_ANY = (0, LARGEST_VALUE)
_LIMIT = (1, 999)
_SET = (1, (1 << len(TableNumber)) - 1)

COMMANDS: dict[Command, Spec] = {
    Command.NOOP: Spec("do nothing, and say so"),
    Command.RESET_COUNTERS: Spec("count from 0 again: pairs, executive, buses, files, memory"),
    Command.SET_MODE: Spec("go to this mode; TEST out of INHIBITED only", _names(CommandMode)),
    Command.ENABLE_TASK: Spec("release a task again", _TASKS),
    Command.DISABLE_TASK: Spec("release a task no longer; not one that the flight needs", _TASKS),
    Command.ENABLE_LIMIT: Spec("give the limit with this number its response", value=_LIMIT),
    Command.DISABLE_LIMIT: Spec("take the limit's response away", value=_LIMIT, dangerous=True),
    Command.CLEAR_FAULT: Spec("clear what this limit tripped; refused while the cause is there", value=_LIMIT),
    Command.TABLE_LOAD: Spec("expect so many bytes of a table", _TABLES, (1, 65535)),
    Command.TABLE_VALIDATE: Spec("check what came; value: its CRC-32", _TABLES, _ANY),
    Command.TABLE_ACTIVATE: Spec("go by these loaded tables, bit n - 1 for table n", value=_SET),
    Command.TABLE_ROLL_BACK: Spec("go by the tables before, bit n - 1 for table n", value=_SET),
    Command.TABLE_ABORT: Spec("forget the upload and the loaded table", _TABLES),
    Command.TABLE_DUMP: Spec("send the active table's image", _TABLES),
    Command.DUMP_DIAGNOSTICS: Spec("send a task's timing", _TASKS),
    Command.ARM: Spec("make this command with this value ready to fire", _names(Command), _ANY),
    Command.FIRE: Spec("do what was armed", _names(Command), _ANY),
    Command.START_RECORDING: Spec("record packets and points"),
    Command.STOP_RECORDING: Spec("record events only"),
    Command.RESTART: Spec("start the application anew, and count its restarts from 0", dangerous=True),
}


class Request(NamedTuple):
    """What a command frame asks for."""

    number: int
    selector: int
    value: int
    sequence: int


class Piece(NamedTuple):
    """Four bytes of a table."""

    chunk: int
    data: bytes


def encode_command(request: Request) -> bytes:
    """The frame under COMMAND_ID. Raises OverflowError for a number that has no place in it."""
    number, selector, value, sequence = request
    return _seal(COMMAND_ID, bytes((number, selector)) + value.to_bytes(4, "little"), sequence)


def encode_piece(piece: Piece, sequence: int) -> bytes:
    """The frame under TABLE_DATA_ID."""
    return _seal(TABLE_DATA_ID, piece.chunk.to_bytes(2, "little") + piece.data, sequence)


def decode_uplink(can_id: int, data: bytes) -> Request | Piece | CommandResult:
    """A frame under one of the UPLINK_IDS back; or why it is refused."""
    if len(data) != FRAME_BYTES:
        return CommandResult.WRONG_LENGTH
    if protect(can_id, data[:7]) != data[7]:
        return CommandResult.WRONG_CRC
    if can_id == TABLE_DATA_ID:
        return Piece(int.from_bytes(data[:2], "little"), data[2:6])
    return Request(data[0], data[1], int.from_bytes(data[2:6], "little"), data[6])


def fault_of(request: Request) -> CommandResult:
    """What is wrong with a request, whatever the state of the flight; ACCEPTED: nothing."""
    if request.number not in COMMANDS:
        return CommandResult.UNKNOWN_COMMAND
    spec = COMMANDS[Command(request.number)]
    known = request.selector in spec.selector if spec.selector else request.selector == 0
    least, most = spec.value
    return CommandResult.ACCEPTED if known and least <= request.value <= most else CommandResult.BAD_ARGUMENT


def _seal(can_id: int, six: bytes, sequence: int) -> bytes:
    seven = six + bytes((sequence,))
    return seven + bytes((protect(can_id, seven),))
