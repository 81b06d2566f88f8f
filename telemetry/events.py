"""The dictionary's events: number, severity, arguments, and the text that the ground makes of them."""

import math
from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any

from telemetry.board import EventRecord
from telemetry.declaration import Argument, Event, Severity, Source
from telemetry.dictionary import POINTS, CommandResult, FlightMode, TableFault


class Eye(IntEnum):
    """Which camera."""

    LEFT = 0
    RIGHT = 1


class TableNumber(IntEnum):
    """The flight tables that can be loaded, each by itself."""

    SCHEDULE = 1
    VISION = 2
    IDENTIFY = 3
    LIMITS = 4
    SHADOW = 5
    EXECUTIVE = 6


class TableCopy(IntEnum):
    """The copies of a table in memory."""

    ACTIVE = 0
    LOADED = 1
    PREVIOUS = 2


class TaskNumber(IntEnum):
    """The tasks of the flight application, by the numbers that commands and events use."""

    COMMAND = 0
    ACQUIRE = 1
    SEARCH = 2
    FEATURE = 3
    MATCH = 4
    RECONSTRUCT = 5
    IDENTIFY = 6
    HEALTH = 7
    HOUSEKEEPING = 8
    PROTECT = 9
    BLACK_BOX = 10
    PUBLISH = 11


class RestartCause(IntEnum):
    """Why the application starts again."""

    POWER_ON = 0
    COMMAND = 1
    TASK_DEAD = 2
    TASK_FAILED = 3
    WATCHDOG = 4


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
_TASK = Argument("task", choices=_names(TaskNumber))
_TABLE = Argument("table", choices=_names(TableNumber))
_COPY = Argument("copy", choices=_names(TableCopy))
_LIMIT = (Argument("point", choices=_POINTS), _SLOT, Argument("value"), Argument("limit"))
_COMMAND = Argument("command")

# Application.
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

# Cameras: why a pair was dropped.
FRAME_MISSING = _event(101, "FRAME_MISSING", _WARNING, "no frame from the {eye} eye", _EYE)
FRAME_DUPLICATE = _event(102, "FRAME_DUPLICATE", _WARNING, "the {eye} eye's frame came a second time", _EYE)
FRAME_SKEW = _event(
    103,
    "FRAME_SKEW",
    _WARNING,
    "eyes exposed {skew_us:.0f} us apart, limit {limit_us:.0f} us",
    Argument("skew_us", "us"),
    Argument("limit_us", "us"),
)
FRAME_CORRUPT = _event(104, "FRAME_CORRUPT", _WARNING, "corrupt frame from the {eye} eye", _EYE)
FRAME_STUCK = _event(105, "FRAME_STUCK", _WARNING, "the {eye} eye repeats its frame", _EYE)
FRAME_SWAPPED = _event(106, "FRAME_SWAPPED", _WARNING, "the {eye} eye's place holds the other eye's frame", _EYE)
FRAME_LATE = _event(
    107,
    "FRAME_LATE",
    _WARNING,
    "the {eye} eye's frame is {late_us:.0f} us off its trigger",
    _EYE,
    Argument("late_us", "us"),
)
FRAME_BLACK = _event(108, "FRAME_BLACK", _WARNING, "the {eye} eye's frame is black", _EYE)
FRAME_SATURATED = _event(
    109, "FRAME_SATURATED", _WARNING, "{share:.2f} of the {eye} eye's frame is saturated", _EYE, Argument("share")
)
FRAME_TORN = _event(110, "FRAME_TORN", _WARNING, "a part of the {eye} eye's frame is the frame before", _EYE)
DARKNESS = _event(111, "DARKNESS", _INFO, "both eyes are in darkness")
LIGHT = _event(112, "LIGHT", _INFO, "light again")

# Executive and trigger.
OVERRUN = _event(
    201,
    "OVERRUN",
    _WARNING,
    "task {task} was not done in its slot, {late_ms:.1f} ms late",
    _TASK,
    Argument("late_ms", "ms"),
)
TRIGGER_GAP = _event(202, "TRIGGER_GAP", _WARNING, "{count:.0f} trigger edges missed", _COUNT)
EDGE_EARLY = _event(
    203, "EDGE_EARLY", _WARNING, "a trigger edge came {off_us:.0f} us off its time", Argument("off_us", "us")
)
EDGE_LATE = _event(
    204, "EDGE_LATE", _WARNING, "a trigger edge came {off_us:.0f} us off its time", Argument("off_us", "us")
)
EDGE_DOUBLE = _event(
    205,
    "EDGE_DOUBLE",
    _WARNING,
    "a second trigger edge {after_us:.0f} us after the first",
    Argument("after_us", "us"),
)
FREE_WHEELING = _event(206, "FREE_WHEELING", _WARNING, "no trigger to trust: ticks by the clock alone")
TRIGGER_LOCKED = _event(207, "TRIGGER_LOCKED", _INFO, "ticks follow the trigger")
CLOCK_JUMP = _event(
    208,
    "CLOCK_JUMP",
    _WARNING,
    "mission time jumped by {jump_ms:.1f} ms against the trigger",
    Argument("jump_ms", "ms"),
)
SLOTS_SKIPPED = _event(209, "SLOTS_SKIPPED", _WARNING, "{count:.0f} ticks skipped to catch up", _COUNT)
TASK_FAILED = _event(210, "TASK_FAILED", _CRITICAL, "task {task} failed", _TASK)

# Vision.
LOCK_ACQUIRED = _event(301, "LOCK_ACQUIRED", _INFO, "{count:.0f} cells found", _COUNT)
LOCK_LOST = _event(302, "LOCK_LOST", _WARNING, "lock lost, {count:.0f} cells left", _COUNT)
HISTORY_CLEARED = _event(303, "HISTORY_CLEARED", _INFO, "displacement history of {count:.0f} frames cleared", _COUNT)

# Modes of vibration.
MODE_VALID = _event(
    401,
    "MODE_VALID",
    _INFO,
    "slot {slot:.0f} valid: {frequency_hz:.5f} Hz",
    _SLOT,
    Argument("frequency_hz", "Hz"),
)
MODE_INVALID = _event(
    402,
    "MODE_INVALID",
    _WARNING,
    "slot {slot:.0f} no longer valid, flags {flags:.0f}",
    _SLOT,
    Argument("flags"),
)
NOT_OBSERVABLE = _event(403, "NOT_OBSERVABLE", _INFO, "the wing is quiet: nothing to identify")
OBSERVABLE = _event(404, "OBSERVABLE", _INFO, "the wing moves enough to be identified")
IDENTIFICATION_FAILED = _event(
    405, "IDENTIFICATION_FAILED", _WARNING, "no modes could be computed from {count:.0f} samples", _COUNT
)

# Limits.
LIMIT_YELLOW = _event(501, "LIMIT_YELLOW", _WARNING, "{point}[{slot:.0f}] = {value:g} beyond yellow {limit:g}", *_LIMIT)
LIMIT_RED = _event(502, "LIMIT_RED", _CRITICAL, "{point}[{slot:.0f}] = {value:g} beyond red {limit:g}", *_LIMIT)
LIMIT_CLEARED = _event(503, "LIMIT_CLEARED", _INFO, "{point}[{slot:.0f}] = {value:g} back within {limit:g}", *_LIMIT)
SHADOW_RED = _event(
    504, "SHADOW_RED", _DIAGNOSTIC, "shadow: {point}[{slot:.0f}] = {value:g} beyond red {limit:g}", *_LIMIT
)

# Buses and files.
BUS_DROPPED = _event(601, "BUS_DROPPED", _WARNING, "the bus did not take {count:.0f} frames", _COUNT)
STORAGE_FAILED = _event(602, "STORAGE_FAILED", _WARNING, "the store refused {count:.0f} writes", _COUNT)
STORAGE_BACK = _event(603, "STORAGE_BACK", _INFO, "the store takes data again")
FIELDS_SATURATED = _event(604, "FIELDS_SATURATED", _WARNING, "{count:.0f} values clipped to their range", _COUNT)
EVENTS_SUPPRESSED = _event(
    605,
    "EVENTS_SUPPRESSED",
    _WARNING,
    "{count:.0f} events of {source} suppressed",
    Argument("source", choices=_names(Source)),
    _COUNT,
)

# Commands: exactly one of the two for each command.
COMMAND_ACCEPTED = _event(
    701,
    "COMMAND_ACCEPTED",
    _INFO,
    "command {command:.0f} ({selector:.0f}, {value:.0f}) accepted",
    _COMMAND,
    Argument("selector"),
    Argument("value"),
)
COMMAND_REJECTED = _event(
    702,
    "COMMAND_REJECTED",
    _WARNING,
    "command {command:.0f} ({selector:.0f}) rejected: {result}, {detail:.0f}",
    _COMMAND,
    Argument("selector"),
    Argument("result", choices=_names(CommandResult)),
    Argument("detail"),
)
PARAMETER_SET = _event(
    703, "PARAMETER_SET", _INFO, "parameter {parameter:.0f} set to {value:g}", Argument("parameter"), Argument("value")
)
PARAMETER_REFUSED = _event(
    704,
    "PARAMETER_REFUSED",
    _WARNING,
    "parameter {parameter:.0f} not read or set to {value:g}: {error}",
    Argument("parameter"),
    Argument("value"),
    Argument("error", choices=_names(TableFault)),
)
PARAMETERS_READ = _event(
    705, "PARAMETERS_READ", _INFO, "parameter {parameter:.0f} read (none: all)", Argument("parameter")
)

# Tables.
TABLE_ACTIVATED = _event(
    801, "TABLE_ACTIVATED", _INFO, "table {table} active, version {version:.0f}", _TABLE, Argument("version")
)
TABLE_REJECTED = _event(
    802,
    "TABLE_REJECTED",
    _WARNING,
    "table {table} not activated: {error}",
    _TABLE,
    Argument("error", choices=_names(TableFault)),
)
TABLE_CORRUPT = _event(803, "TABLE_CORRUPT", _CRITICAL, "table {table}: the {copy} copy is damaged", _TABLE, _COPY)
TABLE_REPAIRED = _event(804, "TABLE_REPAIRED", _INFO, "table {table}: the {copy} copy is good again", _TABLE, _COPY)

# Memory.
POOL_VIOLATION = _event(
    901,
    "POOL_VIOLATION",
    _CRITICAL,
    "the {eye} eye's pool: a frame given back twice, or foreign",
    _EYE,
)
LEASES_OUTSTANDING = _event(902, "LEASES_OUTSTANDING", _WARNING, "{count:.0f} frames were not given back", _COUNT)
POOL_DENIED = _event(903, "POOL_DENIED", _WARNING, "no free frame for the {eye} eye", _EYE)

# Health.
TASK_SILENT = _event(
    1001, "TASK_SILENT", _WARNING, "task {task} shows no progress for {ticks:.0f} ticks", _TASK,
    Argument("ticks", "tick"),
)  # fmt: skip
TASK_DEAD = _event(
    1002, "TASK_DEAD", _CRITICAL, "task {task} is dead after {ticks:.0f} ticks", _TASK, Argument("ticks", "tick")
)
TASK_BACK = _event(1003, "TASK_BACK", _INFO, "task {task} makes progress again", _TASK)
RESTARTED = _event(
    1004,
    "RESTARTED",
    _WARNING,
    "restart {count:.0f} for {cause}",
    _COUNT,
    Argument("cause", choices=_names(RestartCause)),
)
RESTARTS_SPENT = _event(
    1005, "RESTARTS_SPENT", _CRITICAL, "{count:.0f} restarts are spent: inhibited until commanded", _COUNT
)

# Black box.
BLACK_BOX_FROZEN = _event(
    1101, "BLACK_BOX_FROZEN", _INFO, "black box {number:.0f} holds {count:.0f} ticks", Argument("number"), _COUNT
)
BLACK_BOX_WRITTEN = _event(1102, "BLACK_BOX_WRITTEN", _INFO, "black box {number:.0f} is written", Argument("number"))
BLACK_BOX_FAILED = _event(
    1103, "BLACK_BOX_FAILED", _WARNING, "black box {number:.0f} could not be written", Argument("number")
)

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
