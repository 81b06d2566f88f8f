"""Kernels: functions compiled to machine code at their first call, whose code is kept for the next process.

numba keeps compiled code for each file, and does not see when a constant or a function that it took from another file
has changed: the old code would then run on new arrays. So the folder of compiled code carries a digest of all sources.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from fcntl import LOCK_EX, flock
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from numba import config, njit
from numba.core.caching import IndexDataCacheFile

P = ParamSpec("P")
R = TypeVar("R")

PACKAGES = ("fsw", "hal", "sim", "wingbeat")  # where kernels are, what they take, and how they are compiled


def _digest() -> str:
    """Digest of all sources that kernels may be made of."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = find_spec(package)
        for folder in spec.submodule_search_locations or () if spec else ():
            for source in sorted(Path(folder).rglob("*.py")):
                digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def _folder() -> Path:
    """A folder for compiled code that can be written: the user's cache, or else the temporary folder."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for base in (home, Path(tempfile.gettempdir())):
        folder = base / "wingbeat" / f"kernels-{_digest()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="wingbeat-kernels-"))


FOLDER = _folder()
"""Where compiled code is kept."""

setattr(config, "CACHE_DIR", str(FOLDER))  # noqa: B010  # numba makes its settings at run time

_save: Callable[..., None] = IndexDataCacheFile.save


def _save_alone(file: Any, key: Any, data: Any) -> None:
    """Keep a kernel while no other process keeps one.

    numba gives the code of each signature of a function the next free number. Two processes that do so at once may give
    the same one, and the code of one signature would then be called with arrays of the other. It has no setting for
    this: its users ask for such a lock (numba's issue 10128).
    """
    with (FOLDER / "lock").open("w") as lock:
        flock(lock, LOCK_EX)
        _save(file, key, data)


setattr(IndexDataCacheFile, "save", _save_alone)  # noqa: B010  # as above

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
_TICK: dict[str, Any] = {**_OPTIONS, "_nrt": False}  # without numba's run time, which allocates and counts


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile this function with numba: free of the interpreter's lock while it runs, x / 0 is inf as in numpy."""
    return njit(**_OPTIONS)(function)


def tick_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """`kernel` that can allocate nothing, which the compiler sees to, and so need not count references to its arrays.

    Each count is an atomic instruction that waits for all reads before it. All arrays are the caller's.
    """
    return njit(**_TICK)(function)


def inline_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """`tick_kernel` that is compiled into the place of each of its calls, so that no arrays are handed over.

    For a large part of one other, or a small function of many arrays, whose 50 words cost more than what it computes.
    """
    return njit(**_TICK, forceinline=True)(function)
