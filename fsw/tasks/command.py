"""command: what the ground asks for, checked, carried out and answered. The first task of a tick."""

from typing import NamedTuple

from fsw.commands.handlers import Answer, Handlers
from fsw.commands.replies import Replies
from fsw.tables.bank import TableBank
from fsw.tasks.state import State
from hal.bus import Bus
from telemetry.commands import COMMANDS, UPLINK_IDS, Command, Piece, Request, decode_uplink, fault_of
from telemetry.dictionary import COMMANDS_ACCEPTED, COMMANDS_REJECTED, CommandResult
from telemetry.events import COMMAND_ACCEPTED, COMMAND_REJECTED

A_TICK = 16
"""Frames that are taken in one tick, at most; more wait on the bus."""
NAN = float("nan")


class Armed(NamedTuple):
    """A dangerous command that may be fired up to and at this tick."""

    command: int
    value: int
    until_tick: int


class CommandTask:
    """Takes frames from the bus. Each one that is addressed to it counts once, as accepted or as rejected.

    A command has one event and one answer besides. The frame that came last, again, is answered as before, and is
    not carried out again. A rejected one changes nothing but the counters. Pieces of a table have no event and no
    answer of their own if they fit: TABLE_VALIDATE answers for all of them.
    """

    name = "command"

    def __init__(
        self, state: State, bus: Bus | None, handlers: Handlers, bank: TableBank, replies: Replies, arm_ticks: int
    ) -> None:
        self._state, self._bus, self._handlers, self._bank, self._replies = state, bus, handlers, bank, replies
        self._arm_ticks = arm_ticks
        self._armed: Armed | None = None
        self._last: tuple[Request, Answer] | None = None

    def init(self) -> None:
        """The counters start at 0."""
        for point in (COMMANDS_ACCEPTED, COMMANDS_REJECTED):
            self._state.board.set(point, 0)

    def run(self, tick: int, time_ns: int) -> None:
        """Take what waits on the bus."""
        if self._bus is None:
            return
        for _ in range(A_TICK):
            frame = self._bus.receive()
            if frame is None:
                return
            if frame[0] in UPLINK_IDS:
                self.take(*frame, tick)

    def take(self, can_id: int, data: bytes, tick: int) -> None:
        """One frame under an identifier of ours."""
        asked = decode_uplink(can_id, data)
        if isinstance(asked, CommandResult):
            self._reject(NAN, NAN, NAN, Answer(asked))
        elif isinstance(asked, Piece):
            self._piece(asked)
        else:
            self._request(asked, tick)

    def _piece(self, piece: Piece) -> None:
        if self._bank.upload.put(piece.chunk, piece.data):
            self._state.board.add(COMMANDS_ACCEPTED)
        else:
            self._reject(Command.TABLE_LOAD, NAN, NAN, Answer(CommandResult.BAD_ARGUMENT, piece.chunk))

    def _request(self, request: Request, tick: int) -> None:
        if self._last is not None and self._last[0] == request:
            answer = self._last[1]
        else:
            answer = self._carry_out(request, tick)
            self._last = request, answer
        if answer.result is not CommandResult.ACCEPTED:
            self._reject(request.number, request.selector, request.sequence, answer)
            return
        self._state.board.add(COMMANDS_ACCEPTED)
        self._state.raise_event(COMMAND_ACCEPTED, request.number, request.selector, request.value)
        self._replies.acknowledge(request.number, answer.result, request.sequence, answer.detail)

    def _carry_out(self, request: Request, tick: int) -> Answer:
        fault = fault_of(request)
        if fault is not CommandResult.ACCEPTED:
            return Answer(fault)
        command = Command(request.number)
        if command is Command.ARM:
            return self._arm(request, tick)
        if command is Command.FIRE:
            return self._fire(request, tick)
        if COMMANDS[command].dangerous:
            return Answer(CommandResult.NOT_ARMED)
        return self._handlers.run(command, request.selector, request.value)

    def _arm(self, request: Request, tick: int) -> Answer:
        """Only what is dangerous can be armed, and only as it could be fired."""
        asked = Request(request.selector, 0, request.value, request.sequence)
        if not COMMANDS[Command(request.selector)].dangerous or fault_of(asked) is not CommandResult.ACCEPTED:
            return Answer(CommandResult.BAD_ARGUMENT)
        self._armed = Armed(request.selector, request.value, tick + self._arm_ticks)
        return Answer(CommandResult.ACCEPTED)

    def _fire(self, request: Request, tick: int) -> Answer:
        armed = self._armed
        if armed is None or armed[:2] != (request.selector, request.value) or tick > armed.until_tick:
            return Answer(CommandResult.NOT_ARMED)
        self._armed = None
        return self._handlers.run(Command(armed.command), 0, armed.value)

    def _reject(self, number: float, selector: float, sequence: float, answer: Answer) -> None:
        self._state.board.add(COMMANDS_REJECTED)
        self._state.raise_event(COMMAND_REJECTED, number, selector, answer.result, answer.detail)
        self._replies.acknowledge(number, answer.result, sequence, answer.detail)
