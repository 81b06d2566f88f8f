"""The list of failures (FMEA): each row says what breaks, how it is found and how soon, and which limits watch for it.

Three things come from the one list in fmea.toml: the shipped limit table, docs/fmea.md, and the rows that the fault
campaign injects.
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from fault.limits import Limit
from telemetry.declaration import Event
from telemetry.events import EVENT_BY_NAME, LIMIT_RED, LIMIT_YELLOW

Text = Annotated[str, Meta(min_length=1, max_length=200)]


class Fault(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One failure.

    name: its key in the campaign. part: where it breaks. detected_by: the event that must tell of it, by name; after a
    colon the name of its first argument, where only that one counts (LIMIT_RED:cmp). or_by: another event that tells of
    it just as well, where the failure looks like another one. latency_ticks: from the first
    tick of the failure to that event, at most. recovers: when the failure ends the flight measures again by itself.
    limits: the rows of the limit table that watch for it.
    """

    number: Annotated[int, Meta(ge=1, le=99)]
    name: Annotated[str, Meta(pattern="^[a-z_]+$")]
    part: Literal[
        "camera", "trigger", "light", "structure", "vision", "modal", "executive", "memory", "tables", "bus",
        "storage", "commands", "health",
    ]  # fmt: skip
    failure: Text
    effect: Text
    detected_by: Annotated[str, Meta(pattern="^[A-Z_]+(:[A-Za-z_]+)?$")]
    or_by: Annotated[str, Meta(pattern="^[A-Z_]*$")] = ""
    response: Text
    latency_ticks: Annotated[int, Meta(ge=1, le=10_000)]
    recovers: bool = True
    limits: tuple[Limit, ...] = msgspec.field(default=(), name="limit")

    @property
    def event(self) -> Event:
        """The event that must tell of it. Raises KeyError for one that the dictionary does not have."""
        return EVENT_BY_NAME[self.detected_by.partition(":")[0]]

    def detected_in(self, number: int, arguments: Sequence[float]) -> bool:
        """Whether an event, by its number and arguments, tells of this failure; red says yellow too."""
        if self.or_by and number == EVENT_BY_NAME[self.or_by].number:
            return True
        worse = self.event is LIMIT_YELLOW and number == LIMIT_RED.number
        if number != self.event.number and not worse:
            return False
        wanted = self.detected_by.partition(":")[2]
        choices = self.event.arguments[0].choices if self.event.arguments else None
        return not wanted or (choices is not None and choices.get(int(arguments[0])) == wanted)


_DOCUMENT = tomllib.loads(Path(__file__).with_name("fmea.toml").read_text(encoding="utf-8"))
FMEA: tuple[Fault, ...] = msgspec.convert(_DOCUMENT["fault"], tuple[Fault, ...])
"""All rows, in order of their number."""
FAULT_BY_NAME = {fault.name: fault for fault in FMEA}


def shipped_limits() -> list[Limit]:
    """The limit table as shipped."""
    return [limit for fault in FMEA for limit in fault.limits]


def limit_rows() -> list[dict[str, Any]]:
    """The same table as a document: what a file of flight tables would hold under [[limit]]."""
    return [dict(row) for fault in _DOCUMENT["fault"] for row in fault.get("limit", ())]
