"""The ground's side of commands: from names to frames."""

import difflib
import zlib
from collections.abc import Iterable
from pathlib import Path

from telemetry.commands import (
    COMMAND_ID,
    COMMANDS,
    TABLE_DATA_ID,
    Command,
    Piece,
    Request,
    encode_command,
    encode_piece,
    fault_of,
)
from telemetry.dictionary import CommandResult
from wingbeat.errors import InputError

Frame = tuple[int, bytes]


def request_of(name: str, selector: str = "0", value: int = 0) -> Request:
    """A command by its names; its sequence is 0.

    Raises InputError: no such command or selector, a selector or value out of range.
    """
    command = _command(name)
    spec = COMMANDS[command]
    numbers = {choice: number for number, choice in spec.selector.items()}
    number = numbers.get(selector.upper(), int(selector) if selector.isdecimal() else -1)
    request = Request(command, number, value, 0)
    if fault_of(request) is not CommandResult.ACCEPTED:
        least, most = spec.value
        allowed = ", ".join(spec.selector.values()) or "0"
        raise InputError(
            f"{selector}, {value}", f"command {command.name}", f"selectors: {allowed}; values: {least} to {most}"
        )
    return request


def frames_of(requests: Iterable[Request], sequence: int = 0) -> list[Frame]:
    """Their frames, numbered from this sequence on."""
    return [
        (COMMAND_ID, encode_command(request._replace(sequence=(sequence + place) % 256)))
        for place, request in enumerate(requests)
    ]


def upload_of(name: str, selector: str, path: Path, sequence: int = 0) -> list[Frame]:
    """The frames that bring a table up and validate it: TABLE_LOAD, its pieces, TABLE_VALIDATE.

    Raises InputError: another command, no such table, a file that cannot be read, is empty or too long.
    """
    if _command(name) is not Command.TABLE_LOAD:
        raise InputError(f"command {name} takes no file", "--table", "use TABLE_LOAD")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read this file: {error.strerror}", path, "check its name and rights") from None
    load = request_of(name, selector, len(content))
    check = request_of(Command.TABLE_VALIDATE.name, selector, zlib.crc32(content))
    frames = frames_of([load], sequence)
    for chunk in range(-(-len(content) // 4)):
        piece = Piece(chunk, content[4 * chunk : 4 * chunk + 4].ljust(4, b"\0"))
        frames.append((TABLE_DATA_ID, encode_piece(piece, (sequence + 1 + chunk) % 256)))
    return frames + frames_of([check], sequence + len(frames))


def _command(name: str) -> Command:
    try:
        return Command[name.upper()]
    except KeyError:
        known = [command.name for command in Command]
        near = difflib.get_close_matches(name.upper(), known, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise InputError(f"no command {name}", "command", f"{hint}there are {', '.join(known)}") from None
