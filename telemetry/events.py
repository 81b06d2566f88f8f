"""The dictionary's events: number, severity, arguments, and the text that the ground makes of them."""

import math
from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any

from telemetry.board import EventRecord
from telemetry.declaration import Argument, Event, Severity
from telemetry.dictionary import POINTS, FlightMode


class Eye(IntEnum):
    """Which camera."""

    LEFT = 0
    RIGHT = 1


def _names(choices: Iterable[IntEnum]) -> dict[int, str]:
    return {int(choice): choice.name for choice in choices}


_MODES, _EYES = _names(FlightMode), _names(Eye)
_POINTS = {number: point.name for number, point in enumerate(POINTS)}
_DIAGNOSTIC, _INFO, _WARNING, _CRITICAL = Severity


def _event(number: int, name: str, severity: Severity, text: str, *arguments: Argument) -> Event:
    return Event(number, name, severity, arguments, text)


_EYE = Argument("eye", choices=_EYES)
_SLOT = Argument("slot")
_COUNT = Argument("count")
_LIMIT = (Argument("point", choices=_POINTS), _SLOT, Argument("value"), Argument("limit"))

STARTED = _event(
    1,
    "STARTED",
    _INFO,
    "started with {cells:.0f} cells at {rate_hz:g} Hz",
    Argument("cells"),
    Argument("rate_hz", "Hz"),
)
STOPPED = _event(2, "STOPPED", _INFO, "stopped after {ticks:.0f} ticks", Argument("ticks", "tick"))
MODE_CHANGED = _event(
    3,
    "MODE_CHANGED",
    _INFO,
    "mode {before} -> {after}",
    Argument("before", choices=_MODES),
    Argument("after", choices=_MODES),
)
TABLE_ACTIVATED = _event(
    4,
    "TABLE_ACTIVATED",
    _INFO,
    "table {table:.0f} active, version {version:.0f}",
    Argument("table"),
    Argument("version"),
)
TABLE_REJECTED = _event(
    5,
    "TABLE_REJECTED",
    _WARNING,
    "table {table:.0f} rejected, error {error:.0f}",
    Argument("table"),
    Argument("error"),
)

FRAME_MISSING = _event(10, "FRAME_MISSING", _WARNING, "no frame from the {eye} eye", _EYE)
FRAME_SKEW = _event(
    11,
    "FRAME_SKEW",
    _WARNING,
    "eyes exposed {skew_us:.0f} us apart, limit {limit_us:.0f} us",
    Argument("skew_us", "us"),
    Argument("limit_us", "us"),
)
FRAME_CORRUPT = _event(12, "FRAME_CORRUPT", _WARNING, "corrupt frame from the {eye} eye", _EYE)
FRAME_STUCK = _event(13, "FRAME_STUCK", _WARNING, "the {eye} eye repeats its frame", _EYE)
TRIGGER_GAP = _event(14, "TRIGGER_GAP", _WARNING, "{count:.0f} trigger edges missed", _COUNT)

OVERRUN = _event(20, "OVERRUN", _WARNING, "{count:.0f} tasks or ticks were not done in time", _COUNT)

LOCK_ACQUIRED = _event(30, "LOCK_ACQUIRED", _INFO, "{count:.0f} cells found", _COUNT)
LOCK_LOST = _event(31, "LOCK_LOST", _WARNING, "lock lost, {count:.0f} cells left", _COUNT)

MODE_VALID = _event(
    40,
    "MODE_VALID",
    _INFO,
    "slot {slot:.0f} valid: {frequency_hz:.5f} Hz",
    _SLOT,
    Argument("frequency_hz", "Hz"),
)
MODE_INVALID = _event(
    41,
    "MODE_INVALID",
    _WARNING,
    "slot {slot:.0f} no longer valid, flags {flags:.0f}",
    _SLOT,
    Argument("flags"),
)
IDENTIFICATION_FAILED = _event(
    44, "IDENTIFICATION_FAILED", _WARNING, "no modes could be computed from {count:.0f} samples", _COUNT
)
NOT_OBSERVABLE = _event(42, "NOT_OBSERVABLE", _INFO, "the wing is quiet: nothing to identify")
OBSERVABLE = _event(43, "OBSERVABLE", _INFO, "the wing moves enough to be identified")

LIMIT_YELLOW = _event(50, "LIMIT_YELLOW", _WARNING, "{point}[{slot:.0f}] = {value:g} beyond yellow {limit:g}", *_LIMIT)
LIMIT_RED = _event(51, "LIMIT_RED", _CRITICAL, "{point}[{slot:.0f}] = {value:g} beyond red {limit:g}", *_LIMIT)
LIMIT_CLEARED = _event(52, "LIMIT_CLEARED", _INFO, "{point}[{slot:.0f}] = {value:g} back within {limit:g}", *_LIMIT)

BUS_DROPPED = _event(60, "BUS_DROPPED", _WARNING, "the bus did not take {count:.0f} frames", _COUNT)
RECORDER_FAILED = _event(
    61, "RECORDER_FAILED", _WARNING, "the recorder failed with error {error:.0f}", Argument("error")
)
FIELDS_SATURATED = _event(62, "FIELDS_SATURATED", _WARNING, "{count:.0f} values clipped to their range", _COUNT)
EVENTS_SUPPRESSED = _event(63, "EVENTS_SUPPRESSED", _WARNING, "{count:.0f} events suppressed", _COUNT)

EVENTS: tuple[Event, ...] = tuple(value for value in list(globals().values()) if isinstance(value, Event))
EVENT_BY_NUMBER = {event.number: event for event in EVENTS}
EVENT_BY_NAME = {event.name: event for event in EVENTS}


def _named_arguments(event: Event, arguments: Iterable[float]) -> dict[str, float | str | None]:
    """The arguments by name, choices by theirs; None where one is missing or not available."""
    given: dict[str, float | str | None] = {argument.name: None for argument in event.arguments}
    for argument, value in zip(event.arguments, arguments, strict=False):
        if value == value:
            choice = argument.choices.get(int(value)) if argument.choices else None
            given[argument.name] = value if choice is None else choice
    return given


def event_text(number: int, arguments: Iterable[float]) -> str:
    """The sentence for a person; on the ground only. An unknown number is said to be unknown."""
    event = EVENT_BY_NUMBER.get(number)
    return named_text(number, _named_arguments(event, arguments) if event else {})


def named_text(number: int, named: Mapping[str, float | str | None]) -> str:
    """The same sentence from arguments by name, as `event_json` shows them."""
    event = EVENT_BY_NUMBER.get(number)
    if event is None:
        return f"unknown event {number}"
    return event.text.format(**{name: math.nan if value is None else value for name, value in named.items()})


def event_json(record: EventRecord) -> dict[str, Any]:
    """An event as events.jsonl, the recorder and the decoder show it; an unknown one stays raw."""
    event = EVENT_BY_NUMBER.get(record.number)
    raw = {f"argument_{i}": value if value == value else None for i, value in enumerate(record.arguments)}
    return {
        "tick": record.tick,
        "time_s": record.time_ns // 1000 / 1e6,
        "event": record.number,
        "index": record.index,
        "name": event.name if event else "UNKNOWN",
        "severity": event.severity.name if event else "UNKNOWN",
        "arguments": _named_arguments(event, record.arguments) if event else raw,
    }
