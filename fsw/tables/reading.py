"""From a TOML file to a checked Struct; a refusal names the file, the key, the value and what is allowed."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from wingbeat.errors import InputError

T = TypeVar("T")

_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>[^`]*)`")
_MISSING = re.compile(r"Object missing required field `(?P<key>[^`]*)`")
_PLACE = re.compile(r" - at `\$(?P<path>[^`]*)`$")


def read_table(path: Path | str, kind: type[T]) -> T:
    """Read a TOML file as this Struct.

    Raises InputError: no such file, no TOML, unknown or missing key, wrong type, out of range, not finite.
    """
    return convert_table(read_document(path), kind, path)


def read_document(path: Path | str) -> dict[str, Any]:
    """Read a TOML file, its keys yet unchecked. Raises InputError: no such file, no text, no TOML."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read this file: {error.strerror}", path, "check its name and rights") from None
    except UnicodeDecodeError:
        raise InputError("is no text in UTF-8", path, "save it as a TOML text file") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is no TOML: {error}", path, "correct the syntax at that place") from None


def convert_table(document: dict[str, Any], kind: type[T], where: Path | str) -> T:
    """Check a parsed document against this Struct; `where` names its source in errors. Raises InputError."""
    for key, number in _numbers(document, ""):
        if not math.isfinite(number):
            raise InputError(f"{key} = {number}", where, "a finite number is allowed")
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        what, remedy = _explain(str(error), document, kind)
        raise InputError(what, where, remedy) from None


def _numbers(node: Any, key: str) -> Iterator[tuple[str, float]]:
    if isinstance(node, dict):
        for name, value in node.items():
            yield from _numbers(value, f"{key}.{name}" if key else name)
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from _numbers(value, f"{key}[{index}]")
    elif isinstance(node, float):
        yield key, node


def _explain(message: str, document: dict[str, Any], kind: type) -> tuple[str, str]:
    """What is wrong and what is allowed, from msgspec's message and the value that it speaks of."""
    place = _PLACE.search(message)
    path = place["path"] if place else ""
    text = _PLACE.sub("", message)
    inside = f" in [{path.lstrip('.')}]" if path else ""
    if found := _UNKNOWN.match(text):
        allowed = [field.encode_name for field in _type_at(kind, path).fields]
        near = difflib.get_close_matches(found["key"], allowed, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        return f"unknown key {found['key']}{inside}", f"{hint}allowed: {', '.join(allowed)}"
    if found := _MISSING.match(text):
        return f"missing key {found['key']}{inside}", "add it"
    value = repr(_value(document, path))
    shown = value if len(value) <= 60 else value[:57] + "..."
    what = f"{path.lstrip('.')} = {shown}"
    if text.startswith("Invalid enum value"):
        return what, f"allowed: {', '.join(map(str, _type_at(kind, path).values))}"
    for ours, name in (("`", ""), ("object", "table"), ("array", "list"), ("str", "text")):
        text = text.replace(ours, name)
    return what, text[:1].lower() + text[1:]


def _steps(path: str) -> list[str]:
    return re.findall(r"[^.\[\]]+|(?<=\[)(?:\d+|\.\.\.)(?=\])", path)


def _value(document: Any, path: str) -> Any:
    for step in _steps(path):
        document = document[int(step)] if isinstance(document, list) else document[step]
    return document


def _type_at(kind: Any, path: str) -> Any:
    """Description of the type that the schema has at this path."""
    node = _bare(msgspec.inspect.type_info(kind))
    for step in _steps(path):
        if isinstance(node, msgspec.inspect.StructType):
            node = next(field.type for field in node.fields if field.encode_name == step)
        else:
            node = getattr(node, "item_type", node)
        node = _bare(node)
    return node


def _bare(node: Any) -> Any:
    """A type without its metadata."""
    while isinstance(node, msgspec.inspect.Metadata):
        node = node.type
    return node
