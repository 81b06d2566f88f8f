"""Commands and parameters from a MAVLink line, and their answers."""

import math
from typing import NamedTuple

from fsw.commands.desk import Desk
from fsw.commands.handlers import Answer
from fsw.commands.replies import Replies
from fsw.tables.bank import TableBank
from fsw.tables.parameters import INDEX_BY_NAME, PARAMETERS, parameter_value, set_parameter
from fsw.tasks.state import State
from hal.link import Link
from telemetry.commands import Command, Request
from telemetry.dictionary import CommandResult, TableFault
from telemetry.events import PARAMETER_REFUSED, PARAMETER_SET, PARAMETERS_READ
from telemetry.mavlink_uplink import (
    CommandAck,
    LinkCommand,
    LinkPieces,
    MavlinkUplink,
    ParameterError,
    ParameterList,
    ParameterRead,
    ParameterSet,
    ParameterValue,
)

AGAIN_TICKS = 90
"""Ticks for which a command is remembered whose sender may ask again; ground stations give up sooner."""
NAN = math.nan


class Last(NamedTuple):
    """The command that came last, and what became of it."""

    request: Request
    answer: Answer
    tick: int


class GroundLink:
    """Takes what a MAVLink line brings. Each message that is addressed to this node counts once, and has one event.

    The same packet twice, or a COMMAND_LONG whose sender says that it asked before (confirmation above 0), is answered
    as before and not carried out again.
    """

    def __init__(self, state: State, link: Link | None, desk: Desk, bank: TableBank, replies: Replies) -> None:
        self._state, self._link, self._desk, self._bank, self._replies = state, link, desk, bank, replies
        self._uplink = MavlinkUplink()
        self._last: Last | None = None

    def run(self, tick: int, most: int) -> None:
        """Take at most so many messages."""
        if self._link is None:
            return
        self.add(self._link.receive())
        for _ in range(most):
            asked = self._uplink.next()
            if asked is None:
                return
            match asked:
                case LinkCommand():
                    self._command(asked, tick)
                case LinkPieces():
                    self._pieces(asked)
                case ParameterSet():
                    self._set(asked)
                case ParameterRead():
                    self._read(asked)
                case ParameterList():
                    self._list()
                case _:
                    self._desk.reject(NAN, NAN, Answer(asked.result))

    def add(self, data: bytes) -> None:
        """Take bytes; what finds no room is refused as a whole, and what is left is found to be damaged."""
        if self._uplink.add(data):
            self._desk.reject(NAN, NAN, Answer(CommandResult.WRONG_LENGTH))

    def _command(self, asked: LinkCommand, tick: int) -> None:
        if isinstance(asked.asked, CommandResult):
            answer = Answer(asked.asked)
            self._desk.reject(asked.number, NAN, answer)
        else:
            answer = self._answer(asked.asked, asked.again, tick)
            if answer.result is CommandResult.ACCEPTED:
                self._desk.accept(asked.asked)
            else:
                self._desk.reject(asked.asked.number, asked.asked.selector, answer)
        self._replies.answer(CommandAck(asked.number, answer.result, answer.detail, asked.sender))

    def _answer(self, request: Request, again: bool, tick: int) -> Answer:
        last = self._last
        if last is not None and tick - last.tick <= AGAIN_TICKS:
            same = last.request[:3] == request[:3]
            if same and (again or last.request.sequence == request.sequence):
                return last.answer
        answer = self._desk.carry_out(request, tick)
        self._last = Last(request, answer, tick)
        return answer

    def _pieces(self, asked: LinkPieces) -> None:
        """All pieces of a message, or none of them."""
        pieces, upload = asked.pieces, self._bank.upload
        if pieces and upload.expects(pieces[0].chunk) and upload.expects(pieces[-1].chunk):
            for piece in pieces:
                upload.put(piece.chunk, piece.data)
            self._desk.count(accepted=True)
        else:
            chunk = pieces[0].chunk if pieces else 0
            self._desk.reject(Command.TABLE_LOAD, NAN, Answer(CommandResult.BAD_ARGUMENT, chunk))

    def _set(self, asked: ParameterSet) -> None:
        index = INDEX_BY_NAME.get(asked.name)
        if index is None:
            self._refuse(asked.name, -1, asked.value, TableFault.NO_SUCH_PARAMETER, asked)
            return
        fault = set_parameter(self._bank, index, asked.value)
        if fault is TableFault.NONE:
            self._desk.count(accepted=True)
            self._state.raise_event(PARAMETER_SET, index, asked.value)
        else:
            self._refuse(asked.name, index, asked.value, fault, asked)
        self._show(index)

    def _read(self, asked: ParameterRead) -> None:
        index = INDEX_BY_NAME.get(asked.name, -1) if asked.place == -1 else asked.place
        if not 0 <= index < len(PARAMETERS):
            self._refuse(asked.name, asked.place, NAN, TableFault.NO_SUCH_PARAMETER, asked)
            return
        self._desk.count(accepted=True)
        self._state.raise_event(PARAMETERS_READ, index)
        self._show(index)

    def _list(self) -> None:
        self._desk.count(accepted=True)
        self._state.raise_event(PARAMETERS_READ, NAN)
        self._replies.show_all(map(self._value, range(len(PARAMETERS))))

    def _refuse(
        self, name: str, index: int, value: float, fault: TableFault, asked: ParameterSet | ParameterRead
    ) -> None:
        self._desk.count(accepted=False)
        self._state.raise_event(PARAMETER_REFUSED, index if index >= 0 else NAN, value, fault)
        self._replies.answer(ParameterError(name, index, fault, asked.sender))

    def _show(self, index: int) -> None:
        self._replies.answer(self._value(index))

    def _value(self, index: int) -> ParameterValue:
        return ParameterValue(PARAMETERS[index].name, parameter_value(self._bank, index), index, len(PARAMETERS))
