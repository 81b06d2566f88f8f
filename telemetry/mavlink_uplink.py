"""Commands and parameters over MAVLink: what the ground asks for, from bytes; and the answers, as messages.

COMMAND_LONG carries the commands of telemetry/commands.py: `command` is COMMAND_BASE and the command's number, param1
the selector, param2 and param3 the low and the high 16 bits of the value. A table comes in WINGBEAT_TABLE_DATA. The
parameters are the numbers of the flight tables (PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET).
"""

import math
from typing import Any, NamedTuple

from telemetry.commands import Command, Piece, Request
from telemetry.dictionary import CommandResult, TableFault
from telemetry.mavlink_dialect import COMMAND_BASE, PIECE_BYTES, TABLE_DATA, dialect
from telemetry.mavlink_packet import COMPONENT_ID, LONGEST_PACKET, SYSTEM_ID, PacketFinder

PLACES = 8 * LONGEST_PACKET
"""Bytes that may wait: more than a tick's share of any line that this is made for."""


class Sender(NamedTuple):
    """Who asks, and is to be answered."""

    system: int
    component: int


class LinkCommand(NamedTuple):
    """A command, or why it is none. number: as it was asked for; again: the sender says that it asked before."""

    asked: Request | CommandResult
    number: int
    again: bool
    sender: Sender


class LinkPieces(NamedTuple):
    """Consecutive pieces of a table."""

    pieces: tuple[Piece, ...]


class ParameterRead(NamedTuple):
    """A parameter is asked for, by its place, or by its name if that is -1."""

    name: str
    place: int
    sender: Sender


class ParameterList(NamedTuple):
    """All parameters are asked for."""


class ParameterSet(NamedTuple):
    """A parameter is to have this value."""

    name: str
    value: float
    sender: Sender


class Damaged(NamedTuple):
    """Bytes that are no packet, or more of them than may wait."""

    result: CommandResult


Asked = LinkCommand | LinkPieces | ParameterRead | ParameterList | ParameterSet | Damaged


class CommandAck(NamedTuple):
    """The answer to a COMMAND_LONG."""

    number: int
    result: CommandResult
    detail: int
    sender: Sender


class ParameterValue(NamedTuple):
    """A parameter's value; to everybody."""

    name: str
    value: float
    place: int
    total: int


class ParameterError(NamedTuple):
    """Why a parameter has not been read or set."""

    name: str
    place: int
    fault: TableFault
    sender: Sender


Answered = CommandAck | ParameterValue | ParameterError


class MavlinkUplink:
    """Takes bytes as they come, and gives what is addressed to this node; everything else on the line is let pass."""

    def __init__(self) -> None:
        self._mav: Any = dialect()
        self._packets = PacketFinder(self._mav.MAVLink(None), PLACES)

    def add(self, data: bytes) -> int:
        """Take bytes; how many found no room."""
        return self._packets.add(data)

    def next(self) -> Asked | None:
        """What is asked next; None if nothing whole has come."""
        for found in self._packets:
            if isinstance(found, str):
                return Damaged(CommandResult.WRONG_CRC)
            asked = self._asked(found)
            if asked is not None:
                return asked
        return None

    def _asked(self, message: Any) -> Asked | None:
        kind = message.get_type()
        if getattr(message, "target_system", None) not in (0, SYSTEM_ID):
            return None
        if message.target_component not in (0, COMPONENT_ID):
            return None
        sender = Sender(message.get_srcSystem(), message.get_srcComponent())
        if kind == "COMMAND_LONG":
            return LinkCommand(request_of_message(message), message.command, message.confirmation > 0, sender)
        if kind == "COMMAND_INT":
            return LinkCommand(CommandResult.UNKNOWN_COMMAND, message.command, False, sender)
        if kind == TABLE_DATA:
            return LinkPieces(pieces_of(message.piece, message.count, bytes(message.data)))
        if kind == "PARAM_REQUEST_LIST":
            return ParameterList()
        if kind == "PARAM_REQUEST_READ":
            return ParameterRead(message.param_id, message.param_index, sender)
        if kind == "PARAM_SET":
            return ParameterSet(message.param_id, message.param_value, sender)
        return None


def request_of_message(message: Any) -> Request | CommandResult:
    """The command of a COMMAND_LONG; its sequence is that of the packet."""
    number = message.command - COMMAND_BASE
    if number not in Command.__members__.values():
        return CommandResult.UNKNOWN_COMMAND
    selector, low, high = (whole(value) for value in (message.param1, message.param2, message.param3))
    unused = (message.param4, message.param5, message.param6, message.param7)
    if any(value == value and value != 0.0 for value in unused):
        return CommandResult.BAD_ARGUMENT
    if not (0 <= selector < 1 << 8 and 0 <= low < 1 << 16 and 0 <= high < 1 << 16):
        return CommandResult.BAD_ARGUMENT
    return Request(number, selector, low + (high << 16), message.get_seq())


def whole(value: float) -> int:
    """A float that is a whole number; -1 for any other one. NaN is 0: "not used" in a COMMAND_LONG."""
    if value != value:
        return 0
    return int(value) if math.isfinite(value) and value == int(value) else -1


def pieces_of(first: int, count: int, data: bytes) -> tuple[Piece, ...]:
    """Pieces of four bytes, numbered from the first; none if the message claims more than it holds."""
    if not 1 <= count <= len(data) // PIECE_BYTES:
        return ()
    return tuple(Piece(first + k, data[PIECE_BYTES * k : PIECE_BYTES * (k + 1)]) for k in range(count))


def answer_message(answer: Answered) -> Any:
    """The MAVLink message of an answer."""
    mav: Any = dialect()
    if isinstance(answer, CommandAck):
        return mav.MAVLink_command_ack_message(
            command=answer.number,
            result=_results(mav).get(answer.result, mav.MAV_RESULT_DENIED),
            progress=0,
            result_param2=int(answer.result) + (answer.detail << 8),
            target_system=answer.sender.system,
            target_component=answer.sender.component,
        )
    if isinstance(answer, ParameterValue):
        return mav.MAVLink_param_value_message(
            answer.name.encode(), answer.value, mav.MAV_PARAM_TYPE_REAL32, answer.total, answer.place
        )
    return mav.MAVLink_param_error_message(
        answer.sender.system, answer.sender.component, answer.name.encode(), answer.place, _error(mav, answer.fault)
    )


def _results(mav: Any) -> dict[CommandResult, int]:
    """What MAVLink calls a result; DENIED where nothing fits better."""
    return {
        CommandResult.ACCEPTED: mav.MAV_RESULT_ACCEPTED,
        CommandResult.UNKNOWN_COMMAND: mav.MAV_RESULT_UNSUPPORTED,
        CommandResult.BUSY: mav.MAV_RESULT_TEMPORARILY_REJECTED,
        CommandResult.WRONG_MODE: mav.MAV_RESULT_TEMPORARILY_REJECTED,
        CommandResult.CAUSE_PRESENT: mav.MAV_RESULT_TEMPORARILY_REJECTED,
        CommandResult.TABLE_FAULT: mav.MAV_RESULT_FAILED,
    }


def _error(mav: Any, fault: TableFault) -> int:
    return {
        TableFault.NO_SUCH_PARAMETER: mav.MAV_PARAM_ERROR_DOES_NOT_EXIST,
        TableFault.FIXED: mav.MAV_PARAM_ERROR_READ_ONLY,
        TableFault.BUSY: mav.MAV_PARAM_ERROR_PERMISSION_DENIED,
    }.get(fault, mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)
