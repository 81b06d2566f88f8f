"""Files of a run: whole files appear at once, streams carry `.active` until they are finished."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

from wingbeat.errors import InputError

ACTIVE = ".active"


class Store(Protocol):
    """Somewhere to keep named files."""

    def write(self, name: str, data: bytes) -> None:
        """Keep a whole file: after this either the new one is there or the old one, never a part."""
        ...

    def read(self, name: str) -> bytes | None:
        """The file's content, or None if there is no such file."""
        ...

    def path(self, name: str) -> Path:
        """Where the file is, for libraries that write by themselves."""
        ...


class FileStore:
    """A folder. Raises InputError, which names the file, when the folder or a file cannot be written."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _refusal(error, self.folder) from None

    def path(self, name: str) -> Path:
        """Path of this file."""
        return self.folder / name

    def write(self, name: str, data: bytes) -> None:
        """Write the file beside its place, then move it there."""
        with self.stream(name) as file:
            file.write(data)

    def read(self, name: str) -> bytes | None:
        """Content of the file, or None."""
        try:
            return self.path(name).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"cannot read: {error.strerror}", self.path(name), "check its rights") from None

    @contextmanager
    def stream(self, name: str) -> Iterator[BinaryIO]:
        """A file to append to; it takes its name when the block ends well, else it keeps `.active`."""
        target = self.path(name)
        active = target.with_name(target.name + ACTIVE)
        try:
            file = active.open("wb")
        except OSError as error:
            raise _refusal(error, active) from None
        with file:
            yield file
        active.replace(target)


def _refusal(error: OSError, path: Path) -> InputError:
    return InputError(f"cannot write: {error.strerror}", path, "name a writable folder with space left")
