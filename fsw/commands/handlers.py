"""What each command does. A handler acts, or says why it does not; it never raises."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from fault.modes import Cause, next_mode
from fault.protection import Protection
from fsw.commands.replies import Replies
from fsw.executive.entry import Diagnostics
from fsw.tables.bank import TableBank
from telemetry.commands import Command, CommandMode
from telemetry.dictionary import TIMING_PACKET, CommandResult, FlightMode, TableFault
from telemetry.events import TableNumber, TaskNumber

CAUSES = {
    CommandMode.ACQUIRE: Cause.ENABLE,
    CommandMode.INHIBITED: Cause.INHIBIT,
    CommandMode.TEST: Cause.TEST_BEGIN,
}


class Answer(NamedTuple):
    """What became of a command; detail: more about a refusal."""

    result: CommandResult
    detail: int = 0


DONE = Answer(CommandResult.ACCEPTED)


class Tasks(Protocol):
    """The executive, as far as commands go."""

    @property
    def tasks(self) -> tuple[str, ...]: ...
    def switch(self, task: str, on: bool) -> bool: ...
    def diagnostics(self, task: str) -> Diagnostics: ...


class Flight(Protocol):
    """What commands act on. causes: what protect takes at this tick."""

    mode: FlightMode
    causes: Cause


class Handlers:
    """One method a command; reset, record and restart: what the application does then."""

    def __init__(
        self,
        flight: Flight,
        executive: Callable[[], Tasks],
        protection: Protection,
        bank: TableBank,
        replies: Replies,
        reset: Callable[[], None],
        record: Callable[[bool], None],
        restart: Callable[[], None],
    ) -> None:
        self._flight, self._executive, self._protection, self._bank = flight, executive, protection, bank
        self._replies, self._reset, self._record, self._restart = replies, reset, record, restart

    def run(self, command: Command, selector: int, value: int) -> Answer:
        """Carry out a command whose arguments are in range; ARM and FIRE are none of its own."""
        match command:
            case Command.RESET_COUNTERS:
                self._reset()
            case Command.SET_MODE:
                return self._set_mode(CommandMode(selector))
            case Command.ENABLE_TASK | Command.DISABLE_TASK:
                return self._switch_task(TaskNumber(selector), command is Command.ENABLE_TASK)
            case Command.ENABLE_LIMIT | Command.DISABLE_LIMIT:
                return Answer(self._protection.switch(value, command is Command.ENABLE_LIMIT))
            case Command.CLEAR_FAULT:
                return Answer(self._protection.clear_fault(value))
            case Command.TABLE_LOAD:
                begun = self._bank.upload.begin(TableNumber(selector), value)
                return _table(TableFault.NONE if begun else TableFault.TOO_LONG)
            case Command.TABLE_VALIDATE:
                return _table(self._bank.validate(TableNumber(selector), value))
            case Command.TABLE_ACTIVATE:
                return _table(self._bank.activate(tables_in(value)))
            case Command.TABLE_ROLL_BACK:
                return _table(self._bank.roll_back(tables_in(value)))
            case Command.TABLE_ABORT:
                self._bank.abort(TableNumber(selector))
            case Command.TABLE_DUMP:
                image = self._bank.stores[TableNumber(selector)].active.image
                return DONE if self._replies.dump(selector, image) else Answer(CommandResult.BUSY)
            case Command.DUMP_DIAGNOSTICS:
                return self._diagnose(TaskNumber(selector))
            case Command.START_RECORDING | Command.STOP_RECORDING:
                self._record(command is Command.START_RECORDING)
            case Command.RESTART:
                self._restart()
        return DONE

    def _set_mode(self, wanted: CommandMode) -> Answer:
        """Refused where the mode machine would not follow; INHIBITED is always followed."""
        cause, mode = CAUSES[wanted], self._flight.mode
        if wanted is CommandMode.INHIBITED and mode is FlightMode.TEST:
            cause = Cause.TEST_END
        if next_mode(mode, cause) is mode and int(mode) != int(wanted):
            return Answer(CommandResult.WRONG_MODE, mode)
        self._flight.causes |= cause
        return DONE

    def _switch_task(self, task: TaskNumber, on: bool) -> Answer:
        name = task.name.lower()
        row = next((slot for slot in self._bank.flight.schedule if slot.task == name), None)
        if row is not None and row.criticality == "critical" and not on:
            return Answer(CommandResult.CRITICAL_TASK)
        return DONE if self._executive().switch(name, on) else Answer(CommandResult.NO_SUCH_ITEM)

    def _diagnose(self, task: TaskNumber) -> Answer:
        executive, name = self._executive(), task.name.lower()
        if name not in executive.tasks:
            return Answer(CommandResult.NO_SUCH_ITEM)
        d = executive.diagnostics(name)
        counts = (task, d.runs, d.overruns, d.over_budget, d.lost)
        times = (d.last_ms, d.min_ms, d.max_ms, d.mean_ms, d.deviation_ms, d.jitter_ms)
        self._replies.add(TIMING_PACKET, (*counts, *times, *d.bins))
        return DONE


def tables_in(mask: int) -> Sequence[TableNumber]:
    """The tables of a set: bit n - 1 for table n."""
    return [number for number in TableNumber if mask >> (number - 1) & 1]


def _table(fault: TableFault) -> Answer:
    if fault is TableFault.NONE:
        return DONE
    loaded = fault is not TableFault.NOTHING_LOADED
    return Answer(CommandResult.TABLE_FAULT if loaded else CommandResult.NOTHING_LOADED, fault)
