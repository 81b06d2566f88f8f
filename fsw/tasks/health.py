"""health: asks every task for proof of progress, and serves the watchdog only while all critical ones give it."""

from collections.abc import Callable, Sequence
from typing import Protocol

from fsw.executive.schedule import Slot
from hal.watchdog import Watchdog
from telemetry.board import Board
from telemetry.dictionary import TASKS_SILENT
from telemetry.events import TASK_BACK, TASK_DEAD, TASK_SILENT, RestartCause, TaskNumber

CRITICAL = "critical"
UNKNOWN_TASK = 255  # number in events of a task that the dictionary does not know
KEY_TAPS = 0xB400  # of a maximal shift register: every key but 0 comes up, none twice in a row


class Watched(Protocol):
    """A scheduled task as health sees it; a run that is done writes the challenge back as the answer."""

    challenge: int

    @property
    def slot(self) -> Slot: ...
    @property
    def answer(self) -> int: ...
    @property
    def progress(self) -> int: ...
    @property
    def enabled(self) -> bool: ...
    @property
    def failed(self) -> bool: ...


class Roster(Protocol):
    """The scheduled tasks, and how many ticks were run: skipped ones are no task's fault."""

    @property
    def scheduled(self) -> Sequence[Watched]: ...
    @property
    def ticks(self) -> int: ...


class Vigil:
    """What health knows of one task: when it was asked, what it had counted then, and what was told about it."""

    def __init__(self) -> None:
        self.asked_at: int | None = None  # ticks run when the challenge was set; None: not asked
        self.counted = 0
        self.silent = self.dead = False


class Health:
    """Each task has, from its challenge on, its period and latency for the answer; then some ticks until it is silent
    (a warning), and more until it is dead. A critical task that is dead or has failed asks for a restart, and the
    watchdog is served no more. Tasks that are switched off are not asked.
    """

    name = "health"

    def __init__(
        self,
        roster: Callable[[], Roster],
        watchdog: Watchdog,
        board: Board,
        raise_event: Callable[..., None],
        silent_after_ticks: int,
        dead_after_ticks: int,
        tasks: Sequence[str],
    ) -> None:
        """roster: called at each run, for the executive is made after its tasks. tasks: all that may be scheduled."""
        self._roster, self._watchdog, self._board, self._raise_event = roster, watchdog, board, raise_event
        self._silent_after, self._dead_after = silent_after_ticks, dead_after_ticks
        self._vigils = {task: Vigil() for task in tasks}
        self._key = 1
        self.restart_cause: RestartCause | None = None

    def init(self) -> None:
        """Nobody is silent yet."""
        self._board.set(TASKS_SILENT, 0)

    def run(self, tick: int, time_ns: int) -> None:
        """Look for answers, tell what changed, ask again, and serve the watchdog if all is well."""
        roster = self._roster()
        ticks, silent, cause = roster.ticks, 0, None
        for task in roster.scheduled:
            vigil = self._vigils[task.slot.task]
            self._look(task, vigil, ticks)
            if task.slot.criticality == CRITICAL and task.enabled:
                silent += vigil.silent
                cause = cause or _cause(task, vigil)
        self._board.set(TASKS_SILENT, silent)
        self.restart_cause = cause
        if cause is None:
            self._watchdog.serve()

    def _look(self, task: Watched, vigil: Vigil, ticks: int) -> None:
        if not task.enabled:
            vigil.asked_at, vigil.silent, vigil.dead = None, False, False
        elif vigil.asked_at is None:
            self._ask(task, vigil, ticks)
        elif task.answer == task.challenge and task.progress != vigil.counted:
            if vigil.silent:
                vigil.silent = vigil.dead = False
                self._raise_event(TASK_BACK, _number(task))
            self._ask(task, vigil, ticks)
        else:
            self._wait(task, vigil, ticks - vigil.asked_at)

    def _ask(self, task: Watched, vigil: Vigil, ticks: int) -> None:
        self._key = (self._key >> 1) ^ (KEY_TAPS if self._key & 1 else 0)
        task.challenge = self._key
        vigil.asked_at, vigil.counted = ticks, task.progress

    def _wait(self, task: Watched, vigil: Vigil, waited: int) -> None:
        over = waited - task.slot.period_ticks - task.slot.latency_ticks
        if over > self._silent_after and not vigil.silent:
            vigil.silent = True
            self._raise_event(TASK_SILENT, _number(task), waited)
        if over > self._dead_after and not vigil.dead:
            vigil.dead = True
            self._raise_event(TASK_DEAD, _number(task), waited)


def _cause(task: Watched, vigil: Vigil) -> RestartCause | None:
    if task.failed:
        return RestartCause.TASK_FAILED
    return RestartCause.TASK_DEAD if vigil.dead else None


def _number(task: Watched) -> int:
    known = TaskNumber.__members__.get(task.slot.task.upper())
    return UNKNOWN_TASK if known is None else int(known)
