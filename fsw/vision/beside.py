"""One thread beside the caller's, one for each eye: handed work by a lock, at half the cost of a pool's futures."""

import threading
from collections.abc import Callable
from typing import Any


class Beside:
    """A thread that does one piece of work at a time while the caller does another; nothing is allocated for it."""

    def __init__(self, name: str) -> None:
        self._begin, self._ended = threading.Lock(), threading.Lock()
        self._begin.acquire()
        self._ended.acquire()
        self._work: Callable[..., None] | None = None
        self._arguments: tuple[Any, ...] = ()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)
        self._thread.start()

    def begin(self, work: Callable[..., None], *arguments: Any) -> None:
        """Start this work; `wait` must come before the next."""
        self._work, self._arguments = work, arguments
        self._begin.release()

    def wait(self) -> None:
        """Wait until the work is done; raises what it raised."""
        self._ended.acquire()
        error, self._error = self._error, None
        self._work, self._arguments = None, ()
        if error is not None:
            raise error

    def close(self) -> None:
        """End the thread, which has no work now; may be called again."""
        if self._thread.is_alive():
            self._begin.release()
            self._thread.join()

    def _loop(self) -> None:
        while True:
            self._begin.acquire()
            if self._work is None:
                return
            try:
                self._work(*self._arguments)
            except BaseException as error:  # the caller's to judge, on its own thread
                self._error = error
            self._ended.release()
