"""Where commands of all lines end: carried out or refused, counted once, and told by one event."""

from typing import NamedTuple

from fsw.commands.handlers import Answer, Handlers
from fsw.tasks.state import State
from telemetry.commands import COMMANDS, Command, Request, fault_of
from telemetry.dictionary import COMMANDS_ACCEPTED, COMMANDS_REJECTED, CommandResult
from telemetry.events import COMMAND_ACCEPTED, COMMAND_REJECTED


class Armed(NamedTuple):
    """A dangerous command that may be fired up to and at this tick."""

    command: int
    value: int
    until_tick: int


class Desk:
    """What is armed by one line may be fired by another one: there is one ground."""

    def __init__(self, state: State, handlers: Handlers, arm_ticks: int) -> None:
        self._state, self._handlers, self._arm_ticks = state, handlers, arm_ticks
        self.armed: Armed | None = None

    def init(self) -> None:
        """The counters start at 0."""
        for point in (COMMANDS_ACCEPTED, COMMANDS_REJECTED):
            self._state.board.set(point, 0)

    def carry_out(self, request: Request, tick: int) -> Answer:
        """Do what is asked for, or say why not."""
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

    def accept(self, request: Request) -> None:
        """Count and tell a command that was carried out."""
        self.count(accepted=True)
        self._state.raise_event(COMMAND_ACCEPTED, request.number, request.selector, request.value)

    def reject(self, number: float, selector: float, answer: Answer) -> None:
        """Count and tell what was refused; NaN: not known."""
        self.count(accepted=False)
        self._state.raise_event(COMMAND_REJECTED, number, selector, answer.result, answer.detail)

    def count(self, accepted: bool) -> None:
        """Count what is told otherwise: parameters by events of their own, pieces of a table by TABLE_VALIDATE."""
        self._state.board.add(COMMANDS_ACCEPTED if accepted else COMMANDS_REJECTED)

    def _arm(self, request: Request, tick: int) -> Answer:
        """Only what is dangerous can be armed, and only as it could be fired."""
        asked = Request(request.selector, 0, request.value, request.sequence)
        if not COMMANDS[Command(request.selector)].dangerous or fault_of(asked) is not CommandResult.ACCEPTED:
            return Answer(CommandResult.BAD_ARGUMENT)
        self.armed = Armed(request.selector, request.value, tick + self._arm_ticks)
        return Answer(CommandResult.ACCEPTED)

    def _fire(self, request: Request, tick: int) -> Answer:
        armed = self.armed
        if armed is None or armed[:2] != (request.selector, request.value) or tick > armed.until_tick:
            return Answer(CommandResult.NOT_ARMED)
        self.armed = None
        return self._handlers.run(Command(armed.command), 0, armed.value)
