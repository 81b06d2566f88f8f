"""Restarts: an application that cannot go on is closed and made anew, so often and no more; the count is kept."""

import json
import zlib
from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar

from hal.store import Store
from telemetry.events import RestartCause
from wingbeat.errors import InputError

COUNT_FILE = "restarts.json"


class Start(NamedTuple):
    """How an application starts.

    restarts: by itself so far, this one included. inhibited: they are spent; it is to send nothing as valid, and
    will not be restarted but by command. count_damaged: the count could not be read, and counts as spent.
    """

    restarts: int = 0
    cause: RestartCause = RestartCause.POWER_ON
    inhibited: bool = False
    count_damaged: bool = False


class Restartable(Protocol):
    """An application; restart_cause: after a step, why it wants to be made anew, or None."""

    @property
    def restart_cause(self) -> RestartCause | None: ...
    def init(self) -> None: ...
    def step(self) -> bool: ...
    def close(self) -> None: ...


A = TypeVar("A", bound=Restartable)


class Supervisor(Generic[A]):
    """Steps the application that `make` makes, and makes another one when it asks for it.

    A restart by itself is counted in the store before the new one begins, so the count outlives the process. A
    commanded restart sets it to 0: the ground has taken over. count_lost: the store did not take the count.
    """

    def __init__(self, make: Callable[[Start], A], store: Store, most_restarts: int) -> None:
        self._make, self._store, self._most = make, store, most_restarts
        kept = read_count(store)
        damaged = kept is None
        self.restarts = most_restarts + 1 if kept is None else kept
        self.count_lost = False
        if damaged:
            self._keep()
        self.app = self._begin(RestartCause.POWER_ON, damaged)

    @property
    def inhibited(self) -> bool:
        """All restarts by itself are spent."""
        return self.restarts > self._most

    def init(self) -> None:
        """Initialise the first application."""
        self.app.init()

    def step(self) -> bool:
        """One tick, and a restart if it is asked for; False when the trigger has ended."""
        if not self.app.step():
            return False
        cause = self.app.restart_cause
        if cause is not None and (cause is RestartCause.COMMAND or not self.inhibited):
            self._restart(cause)
        return True

    def run(self) -> None:
        """Initialise, run to the end of the trigger, and close."""
        try:
            self.init()
            while self.step():
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Close the application."""
        self.app.close()

    def clear(self) -> None:
        """Count restarts from 0 again."""
        self.restarts = 0
        self._keep()

    def _restart(self, cause: RestartCause) -> None:
        self.app.close()
        self.restarts = 0 if cause is RestartCause.COMMAND else self.restarts + 1
        self._keep()
        self.app = self._begin(cause, False)
        self.app.init()

    def _begin(self, cause: RestartCause, damaged: bool) -> A:
        return self._make(Start(self.restarts, cause, self.inhibited, damaged))

    def _keep(self) -> None:
        try:
            self._store.write(COUNT_FILE, count_bytes(self.restarts))
            self.count_lost = False
        except (OSError, InputError):
            self.count_lost = True


def count_bytes(restarts: int) -> bytes:
    """Content of the count's file."""
    return json.dumps({"restarts": restarts, "crc32": _crc(restarts)}).encode()


def read_count(store: Store) -> int | None:
    """Restarts kept in this store; 0 if none ever was, None if what is there is damaged."""
    try:
        content = store.read(COUNT_FILE)
        if content is None:
            return 0
        kept = json.loads(content)
        restarts, crc = kept["restarts"], kept["crc32"]
    except (OSError, InputError, ValueError, KeyError, TypeError, RecursionError):
        return None
    good = isinstance(restarts, int) and restarts >= 0 and crc == _crc(restarts)
    return restarts if good else None


def _crc(restarts: int) -> int:
    return zlib.crc32(f"restarts {restarts}".encode())
