"""docs/telemetry.md: the dictionary as a page for people."""

from collections.abc import Iterable, Iterator
from enum import IntEnum, IntFlag

from telemetry.commands import COMMAND_ID, COMMANDS, TABLE_DATA_ID
from telemetry.declaration import Kind, Packet, Point
from telemetry.dictionary import (
    HEADER_FRAMES,
    HEARTBEAT_PERIOD_TICKS,
    PACKETS,
    CommandResult,
    FlightMode,
    ModeFlag,
    TableFault,
)
from telemetry.events import EVENTS
from telemetry.mavlink_dialect import COMMAND_BASE, MESSAGES, PIECES, TABLE_DATA
from telemetry.mavlink_packet import COMPONENT_ID, SYSTEM_ID

_HEAD = f"""\
# Telemetry

This page is made from the dictionary (`telemetry/dictionary.py`, `telemetry/events.py`) by
`wingbeat export page --out docs/telemetry.md`; a test compares the two. The same dictionary gives
`wingbeat export dbc` and `wingbeat export mavlink`.

## Rules
- Each packet carries the number and the time of its **trigger**: for `mode` and `estimate` that of the newest frame
  in the estimate, for the others that of the tick that sends them.
- **Not available** is said, never guessed: all ones on CAN, NaN or the largest integer on MAVLink, no property in MCAP.
- A value outside its range is sent as the nearest end of the range, and `saturated` counts it. A mode with such a value
  is sent with `valid` = 0 and the flag `saturated`.
- **CAN**: classic frames of 8 bytes, 11-bit identifiers. Bytes 0-5: signals, little endian; byte 6: sequence counter,
  the same in all frames of one sending; byte 7: CRC-8 SAE J1850 over the identifier (two bytes, low one first) and
  bytes 0-6. The first two frames of a packet are its header. Time is `time_us + time_epoch * 2^48` us.
- **MAVLink 2**: system {SYSTEM_ID}, component {COMPONENT_ID}; one message a packet, and one a slot for `mode`;
  HEARTBEAT each {HEARTBEAT_PERIOD_TICKS} ticks, its `custom_mode` is `mode`. Quantities are float: finer or coarser
  than on CAN by less than one CAN step.
- **MCAP**: the topics `/points` (foxglove.PointCloud, metres, left camera's frame), `/events` (foxglove.Log), and one
  for each periodic packet with full precision.
- `amplitude_coherence` is ERA's modal amplitude coherence, which the paper calls MAC; it is not the modal assurance
  criterion.
"""

_UPLINK = f"""\
Identifier 0x{COMMAND_ID:03X}: byte 0 number, byte 1 selector, bytes 2-5 value, byte 6 sequence, byte 7 CRC as above. A
table goes up in pieces of four bytes under 0x{TABLE_DATA_ID:03X}: bytes 0-1 number of the piece, bytes 2-5 the bytes,
byte 6 sequence, byte 7 CRC. Each command has one event and one `ack` packet. The frame that came last, again, is
answered as before and not carried out again. `wingbeat command` makes these frames.

On **MAVLink** the same commands come as COMMAND_LONG to system {SYSTEM_ID}, component {COMPONENT_ID} (0: to all):
`command` is {COMMAND_BASE} and the number, param1 the selector, param2 and param3 the low and the high 16 bits of the
value, the others 0 or NaN. COMMAND_ACK answers; its `result_param2` is the result below and, times 256, the detail of
the `ack` packet. A `confirmation` above 0 says that the sender asked before: the command that came last, again, is
answered as before and not carried out again. Pieces of a table come in {TABLE_DATA}, {PIECES} of them at most. The
numbers of the tables VISION, IDENTIFY and EXECUTIVE are **parameters** (PARAM_REQUEST_LIST, PARAM_REQUEST_READ,
PARAM_SET; type REAL32): a table's first letter, `_`, and the first letters of the key. A value that is set becomes
active at the end of the hyperperiod, and is answered with PARAM_VALUE; a refusal with PARAM_ERROR, and PARAM_VALUE with
the value that stays. `wingbeat export mavlink` describes all of it to other tools."""

_REQUIREMENTS = (
    (
        "A value is sent to half a step, clipped at its range, never wrapped",
        "300 in eight bits must not become 44",
        "`test_telemetry_codecs.py`: round trip and saturation over all points",
    ),
    (
        "A mode with a clipped value is not valid",
        "a wrong frequency marked valid is the worst failure",
        "`test_a_clipped_mode_is_never_sent_as_valid`",
    ),
    (
        "What is not available reads as not available in every format",
        "an empty slot must not look like 0 Hz",
        "`test_not_available_stays_not_available` and the peers' tests",
    ),
    (
        "A damaged or misaddressed CAN frame is refused",
        "a bus has bit errors",
        "`test_every_single_bit_flip_in_a_frame_is_refused`",
    ),
    (
        "Frames of two sendings are never mixed",
        "half of an old estimate with half of a new one is wrong",
        "`test_frames_of_one_sending_share_the_counter...`, `test_decode_counts_lost_can_packets`",
    ),
    (
        "The same run gives the same bytes; every time is a trigger's",
        "replay and comparison",
        "`test_two_runs_write_the_same_bytes`, golden bytes",
    ),
    (
        "Tools that nobody here wrote read everything",
        "the user has cantools, MAVLink and Foxglove already",
        "`test_telemetry_files.py`: cantools, mavlogdump, mcap",
    ),
    (
        "What a decoder cannot read is counted and said",
        "nothing is lost in silence",
        "`test_decode_counts_damage...` and those after it",
    ),
    (
        "Encoding allocates no array",
        "fixed memory after INIT",
        "`test_encoding_allocates_no_array_data`",
    ),
)


def page_text() -> str:
    """The page in Markdown."""
    lines = [_HEAD, "## Requirements", ""]
    lines += _table(("requirement", "why", "verified by"), _REQUIREMENTS)
    lines += ["", "## Packets", ""]
    lines += _table(
        ("packet", "CAN ids", "MAVLink", "every", "what"),
        (
            (p.name, _ids(p), f"{p.mavlink_id} {MESSAGES[p]}", _when(p), p.meaning)
            for p in sorted(PACKETS, key=lambda packet: packet.can_id)
        ),
    )
    lines += ["", "### Header of each packet on CAN", ""]
    lines += _frames(HEADER_FRAMES)
    for packet in PACKETS:
        slots = f" (for each of {packet.slots} slots)" if packet.slots > 1 else ""
        lines += ["", f"### {packet.name}{slots}", ""]
        lines += _frames(packet.frames)
    lines += ["", "## Choices", ""]
    lines += _choices("mode", FlightMode)
    lines += ["", *_choices("flags", ModeFlag)]
    lines += ["", *_choices("result", CommandResult)]
    lines += ["", *_choices("table fault", TableFault)]
    lines += ["", "## Commands", "", _UPLINK, ""]
    lines += _table(
        ("number", "command", "selector", "value", "what"),
        (
            (
                str(int(command)),
                command.name,
                ", ".join(f"{number} {name}" for number, name in spec.selector.items()) or "0",
                f"{spec.value[0]} to {spec.value[1]}" if spec.value[1] else "0",
                spec.meaning + ("; by ARM and FIRE only" if spec.dangerous else ""),
            )
            for command, spec in COMMANDS.items()
        ),
    )
    lines += ["", "## Events", "", "The text is made on the ground. `point` in an event is a point's name.", ""]
    lines += _table(
        ("number", "name", "severity", "arguments", "text"),
        ((str(e.number), e.name, e.severity.name, ", ".join(a.name for a in e.arguments), e.text) for e in EVENTS),
    )
    return "\n".join(lines) + "\n"


def _ids(packet: Packet) -> str:
    return f"0x{packet.can_id:03X}-0x{packet.can_id + packet.frame_count - 1:03X}"


def _when(packet: Packet) -> str:
    if packet.period_ticks == 0:
        return "event"
    return "tick" if packet.period_ticks == 1 else f"{packet.period_ticks} ticks"


def _frames(frames: Iterable[tuple[str, tuple[Point, ...]]]) -> Iterator[str]:
    rows = [(frame, point) for frame, points in frames for point in points]
    return _table(
        ("frame", "point", "unit", "range", "step", "bits", "meaning"),
        (
            (frame, point.name, point.unit, _range(point), _step(point), str(point.bits), point.meaning)
            for frame, point in rows
        ),
    )


def _range(point: Point) -> str:
    if point.kind is Kind.FLAG:
        return "no, yes"
    if point.kind in (Kind.CHOICE, Kind.BITS, Kind.REAL):
        return point.kind.value
    return f"{point.minimum:.15g} to {point.maximum:.15g}"


def _step(point: Point) -> str:
    return f"{point.scale:g}" if point.kind is Kind.QUANTITY else ""


def _choices(name: str, choices: type[IntEnum] | type[IntFlag]) -> Iterator[str]:
    return _table((name, "meaning"), ((str(int(c)), (c.name or "").lower()) for c in choices))


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield f"|{'---|' * len(head)}"
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', '&#124;') for cell in row)} |"
