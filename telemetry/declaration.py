"""The forms of which the dictionary is made: point, packet, event; and the checks of a declaration."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag, StrEnum

FRAME_BITS = 48
"""Bits of signals in one CAN frame: eight bytes less the sequence counter and the CRC."""

EVENT_ARGUMENTS = 4
"""Arguments that an event can carry."""


class Kind(StrEnum):
    """How a point's value is to be read."""

    QUANTITY = "quantity"  # a physical quantity: fixed point on CAN, float on MAVLink
    COUNT = "count"  # a whole number
    FLAG = "flag"  # no (0) or yes (1)
    CHOICE = "choice"  # one of the point's choices
    BITS = "bits"  # any set of the point's choices
    REAL = "real"  # a number of any size: IEEE 754, 32 bits
    RAW = "raw"  # bits of data: every code is a value, none says "not available"


@dataclass(frozen=True, eq=False)
class Point:
    """One telemetry point. Values beyond minimum or maximum are clipped to it, and that is counted."""

    name: str
    unit: str
    minimum: float
    maximum: float
    scale: float
    bits: int
    meaning: str
    kind: Kind = Kind.QUANTITY
    choices: type[IntEnum] | type[IntFlag] | None = None
    slots: int = 1
    symbol: str = ""  # its name on the buses, where the name itself is a reserved word of C

    def __post_init__(self) -> None:
        object.__setattr__(self, "symbol", self.symbol or self.name)
        if self.kind in (Kind.REAL, Kind.RAW):
            return
        highest = (self.maximum - self.minimum) / self.scale
        if round(highest) > self.unavailable - 1:
            raise ValueError(f"point {self.name}: {self.maximum} does not fit in {self.bits} bits")
        if (self.kind in (Kind.CHOICE, Kind.BITS)) != (self.choices is not None):
            raise ValueError(f"point {self.name}: choices belong to the kinds choice and bits, and only there")

    @property
    def unavailable(self) -> int:
        """The code that says "signal not available": all ones."""
        return (1 << self.bits) - 1


@dataclass(frozen=True, eq=False)
class Packet:
    """Points that are sent together, once every period_ticks (0: when an event happens).

    frames lists the points of each CAN frame, from its lowest bit upwards, for one slot; a packet of several
    slots repeats them for every slot. Two frames with tick and time come first: can_id and can_id + 1.
    tick and time_us name the points with the packet's trigger; None: the trigger of the tick that sends.
    """

    name: str
    can_id: int
    mavlink_id: int
    period_ticks: int
    phase_ticks: int
    meaning: str
    frames: tuple[tuple[str, tuple[Point, ...]], ...]
    tick: Point | None = None
    time_us: Point | None = None
    slots: int = 1

    def __post_init__(self) -> None:
        for frame, points in self.frames:
            used = sum(point.bits for point in points)
            if used > FRAME_BITS:
                raise ValueError(f"packet {self.name}, frame {frame}: {used} bits, only {FRAME_BITS} fit")
            for point in points:
                if point.slots not in (1, self.slots):
                    raise ValueError(f"packet {self.name}: {point.name} has {point.slots} slots, not {self.slots}")

    @property
    def points(self) -> tuple[Point, ...]:
        """All points of one slot, in the order of their frames."""
        return tuple(point for _, points in self.frames for point in points)

    @property
    def frame_count(self) -> int:
        """How many CAN frames one sending takes."""
        return 2 + self.slots * len(self.frames)

    def due(self, tick: int) -> bool:
        """Whether the packet is to be sent at this tick."""
        return self.period_ticks > 0 and tick % self.period_ticks == self.phase_ticks


class Severity(IntEnum):
    """How much an event matters."""

    DIAGNOSTIC = 0
    INFO = 1
    WARNING = 2
    CRITICAL = 3


class Source(IntEnum):
    """Which part raises an event: the hundreds of the event's number. Each has a token bucket of its own."""

    APPLICATION = 0
    CAMERA = 1
    EXECUTIVE = 2
    VISION = 3
    MODAL = 4
    LIMITS = 5
    OUTLETS = 6
    COMMANDS = 7
    TABLES = 8
    MEMORY = 9
    HEALTH = 10
    BLACK_BOX = 11


@dataclass(frozen=True, eq=False)
class Argument:
    """One argument of an event: a name, its unit and, where it is a choice, the numbers' names."""

    name: str
    unit: str = "1"
    choices: Mapping[int, str] | None = None


@dataclass(frozen=True, eq=False)
class Event:
    """One numbered event. The text is a template over the arguments, and is made on the ground only."""

    number: int
    name: str
    severity: Severity
    arguments: tuple[Argument, ...]
    text: str

    def __post_init__(self) -> None:
        if len(self.arguments) > EVENT_ARGUMENTS:
            raise ValueError(f"event {self.name}: {len(self.arguments)} arguments, at most {EVENT_ARGUMENTS} fit")
        self.text.format(**{argument.name: 0.0 for argument in self.arguments})

    @property
    def source(self) -> Source:
        """The part that raises it."""
        return Source(self.number // 100)
