"""What commands say to a person or a program: progress on a terminal, JSON on request."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from wingbeat.errors import InputError

T = TypeVar("T")


@contextmanager
def progress(description: str, total: int | None) -> Iterator[Callable[[], None]]:
    """A progress bar on stderr while that is a terminal, silence otherwise; call what it yields once for each step."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(description, total=total)
        yield lambda: bar.advance(task)


def track(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Pass items on, with a progress bar."""
    with progress(description, total) as advance:
        for item in items:
            yield item
            advance()


def write_json(result: Any, target: str) -> None:
    """Write result as JSON to the file `target`, or to stdout if it is "-"."""
    text = json.dumps(result, indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    try:
        Path(target).write_text(text)
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", target, "name a file in a writable folder") from None
