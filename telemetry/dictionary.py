"""The one dictionary: every telemetry point, packet and event, declared once.

From it come the CAN frames and the DBC file, the MAVLink dialect, the recorder's schemas, the decoders and
docs/telemetry.md. Identifiers stand here and nowhere else.
"""

from collections.abc import Iterable
from enum import IntEnum, IntFlag

from telemetry.declaration import EVENT_ARGUMENTS, Kind, Packet, Point, Severity

MODE_SLOTS = 8
"""How many modes an estimate can carry; a slot without a mode is "not available"."""

EPOCH_US = 1 << 48
"""The time on CAN is time_us + time_epoch * EPOCH_US, so that it holds for mission time and for Unix time."""

FLAG_BITS = 24
"""Room for the flags of a mode; all ones is "not available"."""

HEARTBEAT_PERIOD_TICKS = 15
"""MAVLink's HEARTBEAT: about once a second."""


class FlightMode(IntEnum):
    """What the flight application is doing."""

    INIT = 0
    ACQUIRE = 1
    TRACK = 2
    DEGRADED = 3
    HOLD = 4
    INHIBITED = 5
    TEST = 6


class ModeFlag(IntFlag):
    """Why a mode, or the whole estimate, deserves care. The lower-case names are the flags of modes.json."""

    HARMONIC = 1 << 0
    TIME_VARYING = 1 << 1
    NEAR_NYQUIST = 1 << 2
    NOT_OBSERVABLE = 1 << 3
    SHORT_RECORD = 1 << 4
    INCOHERENT = 1 << 5
    WEAK = 1 << 6
    IMPRECISE = 1 << 7
    OVERDAMPED = 1 << 8
    GROWING = 1 << 9
    NOT_EXPONENTIAL = 1 << 10
    COMBINATION = 1 << 11
    SPLIT = 1 << 12
    CLOSE_PAIR = 1 << 13
    # What fault protection, the tasks and the codecs add to the identification's.
    LOW_COHERENCE = 1 << 16
    POOR_SCENE = 1 << 17
    STALE = 1 << 18
    LATE = 1 << 19
    HELD = 1 << 20
    SATURATED = 1 << 21
    OTHER = 1 << 22
    UNCONFIRMED = 1 << 23


class CommandResult(IntEnum):
    """What became of a command."""

    ACCEPTED = 0
    UNKNOWN_COMMAND = 1
    BAD_ARGUMENT = 2
    WRONG_MODE = 3
    NOT_ARMED = 4
    CAUSE_PRESENT = 5
    NOT_CLEARABLE = 6
    NO_SUCH_ITEM = 7
    TABLE_FAULT = 8
    NOTHING_LOADED = 9
    BUSY = 10
    CRITICAL_TASK = 11
    WRONG_LENGTH = 12
    WRONG_CRC = 13
    UNAVAILABLE = 14


class TableFault(IntEnum):
    """Why a table is refused; from SCHEDULE_EMPTY on the reasons against a schedule (fsw/executive/schedule.py)."""

    NONE = 0
    TOO_LONG = 1
    NOTHING_UPLOADED = 2
    GAP = 3
    CRC = 4
    NOT_TOML = 5
    OTHER_TABLE = 6
    BAD_VALUE = 7
    INCONSISTENT = 8
    FIXED = 9
    NOTHING_LOADED = 10
    DAMAGED = 11
    BUSY = 12
    NO_SUCH_PARAMETER = 13
    SCHEDULE_EMPTY = 33
    SCHEDULE_UNKNOWN_TASK = 34
    SCHEDULE_TASK_TWICE = 35
    SCHEDULE_BAD_PERIOD = 36
    SCHEDULE_BAD_PHASE = 37
    SCHEDULE_BAD_LATENCY = 38
    SCHEDULE_BAD_BUDGET = 39
    SCHEDULE_HYPERPERIOD = 40
    SCHEDULE_OVERLOAD = 41
    SCHEDULE_WORKER_OVERLOAD = 42
    SCHEDULE_MISSING_TASK = 43


def flag_bits(names: Iterable[str]) -> int:
    """The bits of flags given by their names in modes.json; an unknown name sets OTHER: none is lost."""
    bits = 0
    for name in names:
        bits |= ModeFlag.__members__.get(name.upper(), ModeFlag.OTHER)
    return int(bits)


def _quantity(name: str, unit: str, low: float, high: float, scale: float, bits: int, meaning: str) -> Point:
    return Point(name, unit, low, high, scale, bits, meaning)


def _modal(name: str, unit: str, low: float, high: float, scale: float, bits: int, meaning: str) -> Point:
    return Point(name, unit, low, high, scale, bits, meaning, slots=MODE_SLOTS)


def _share(name: str, meaning: str, symbol: str = "") -> Point:
    return Point(name, "1", 0.0, 1.0, 2e-5, 16, meaning, symbol=symbol)


def _count(name: str, meaning: str, bits: int = 16, slots: int = 1, unit: str = "1") -> Point:
    return Point(name, unit, 0, (1 << bits) - 2, 1, bits, meaning, Kind.COUNT, slots=slots)


def _flag(name: str, meaning: str, slots: int = 1) -> Point:
    return Point(name, "1", 0, 1, 1, 2, meaning, Kind.FLAG, slots=slots)


def _flags(name: str, meaning: str, slots: int = 1) -> Point:
    return Point(name, "1", 0, (1 << FLAG_BITS) - 2, 1, FLAG_BITS, meaning, Kind.BITS, ModeFlag, slots)


# The header of every packet. It is filled by the codecs and has no place on the board.
TICK = _count("tick", "number of the trigger edge to which the packet belongs, from 0", 32, unit="tick")
TIME_US = _count("time_us", "time of that trigger, less time_epoch periods of 2^48 us", 48, unit="us")
TIME_EPOCH = _count("time_epoch", "whole periods of 2^48 us in the trigger's time", 8)
SATURATED = _count("saturated", "signals of this packet that were clipped to their range", 8)
HEADER_FRAMES: tuple[tuple[str, tuple[Point, ...]], ...] = (
    ("tick", (TICK, TIME_EPOCH, SATURATED)),
    ("time", (TIME_US,)),
)

# One mode. Damping may come out negative from noise; it is sent as it is, and such a mode is not valid.
FREQUENCY_HZ = _modal("frequency_hz", "Hz", 0, 160, 1e-5, 24, "natural frequency |s| / 2 pi")
FREQUENCY_SIGMA_HZ = _modal("frequency_sigma_hz", "Hz", 0, 16, 1e-6, 24, "its standard deviation")
DAMPING_RATIO = _modal("damping_ratio", "1", -1, 1, 1e-6, 24, "damping over critical damping, -Re(s) / |s|")
DAMPING_RATIO_SIGMA = _modal("damping_ratio_sigma", "1", 0, 16, 1e-6, 24, "its standard deviation")
AMPLITUDE_MM = _modal("amplitude_mm", "mm", 0, 16_000, 0.001, 24, "largest amplitude of any measured point")
AMPLITUDE_COHERENCE = _modal(
    "amplitude_coherence", "1", 0, 1, 1e-4, 16, "modal amplitude coherence of ERA (the MAC of the paper)"
)
VALID = _flag("valid", "1 only if every gate agrees: the controller may use this mode", MODE_SLOTS)
FLAGS = _flags("flags", "why the mode deserves care", MODE_SLOTS)
AGE_TICKS = _count("age_ticks", "ticks since the last frame of the data behind this mode", 16, MODE_SLOTS, "tick")

# The estimate as a whole.
ESTIMATE_TICK = _count("estimate_tick", "trigger of the newest frame in the estimate", 32, unit="tick")
ESTIMATE_TIME_US = Point(
    "estimate_time_us", "us", 0, 2**53 - 2, 1, 64, "time of that trigger", Kind.COUNT
)  # to 2^53: whole numbers are exact in the board's doubles as far as there
MODE_COUNT = _count("mode_count", "modes in the estimate, valid or not", 4)
ESTIMATE_FLAGS = _flags("estimate_flags", "what holds for the whole estimate")
RECORD_SAMPLES = _count("record_samples", "frames in the record behind the estimate")

# The scene and the match, each tick.
CHAR = _share("char", "scene characteristic: how straight the queues of centres are (Eq. 20)", "scene_char")
MU = _share("mu", "matching uniqueness: F-measure of precision and recall, b = 20 (Eq. 24)")
CMP = _share("cmp", "comprehensive matching parameter of char and mu (Eq. 30)")
PRECISION = _share("precision", "right matches over detected matches")
RECALL = _share("recall", "right matches over all cells in view")
MATCHED = _count("points", "cells matched in both eyes and accepted")
DETECTED_LEFT = _count("detected_left", "cells detected by the left eye")
DETECTED_RIGHT = _count("detected_right", "cells detected by the right eye")
REPROJECTION_RMS_PX = _quantity(
    "reprojection_rms_px", "px", 0, 65, 0.001, 16, "rms distance of centres from their reprojected 3-D points"
)
EPIPOLAR_RMS_PX = _quantity(
    "epipolar_rms_px",
    "px",
    0,
    65,
    0.001,
    16,
    "rms distance of right centres from the left ones' epipolar lines",
)

# Health.
MODE = Point("mode", "1", 0, 254, 1, 8, "mode of the flight application", Kind.CHOICE, FlightMode)
OBSERVABLE = _flag("observable", "the wing moves enough to be identified; 0 is quiet, not bad")
VALIDITY = _flag("validity", "at least one mode is valid and no limit forbids its use")
TICKS = _count("ticks", "trigger edges since the start", 32)
TICKS_MISSED = _count("ticks_missed", "trigger edges that never reached the executive")
EDGES_EARLY = _count("edges_early", "trigger edges before their window, not used")
EDGES_LATE = _count("edges_late", "trigger edges after their window, not used")
EDGES_DOUBLE = _count("edges_double", "second edges of one trigger, not used")
CLOCK_JUMPS = _count("clock_jumps", "jumps of mission time against the trigger", 8)
FREE_WHEEL = _flag("free_wheel", "ticks come from the clock alone: the trigger cannot be trusted")
OVERRUNS = _count("overruns", "runs of tasks that were not done in their slot")
OVERRUN = _flag("overrun", "a task was not done in its slot since the last tick")
SLOTS_LOST = _count("slots_lost", "releases of tasks that never ran: edge missed, task busy, or skipped to catch up")
ILLUMINATED = _flag("illuminated", "at least one eye sees light; 0 is eclipse, not a fault")
DROPS_MISSING = _count("drops_missing", "pairs dropped: an eye's frame did not come")
DROPS_DUPLICATE = _count("drops_duplicate", "pairs dropped: a frame came a second time, by the camera's count")
DROPS_SKEW = _count("drops_skew", "pairs dropped: the eyes' exposures differ by more than the limit")
DROPS_CORRUPT = _count("drops_corrupt", "pairs dropped: a frame was marked or found corrupt")
DROPS_STUCK = _count("drops_stuck", "pairs dropped: a frame's pixels repeat the one before")
DROPS_SWAPPED = _count("drops_swapped", "pairs dropped: a frame of the other eye")
DROPS_LATE = _count("drops_late", "pairs dropped: a frame of another trigger than this tick's")
DROPS_BLACK = _count("drops_black", "pairs dropped: a frame shows nothing but darkness")
DROPS_SATURATED = _count("drops_saturated", "pairs dropped: most of a frame is at its brightest value")
DROPS_TORN = _count("drops_torn", "pairs dropped: a part of a frame repeats the one before")
DROPS_MEMORY = _count("drops_memory", "pairs dropped: no frame memory was free")
DROP_RATE = _share("drop_rate", "pairs dropped over pairs wanted, of the last 60 ticks with light")
BUS_DROPPED = _count("bus_dropped", "frames that the bus did not take")
BUS_ERRORS = _count("bus_errors", "frames that the bus did not take in the tick before", 8)
STORAGE_ERRORS = _count("storage_errors", "writes that the store refused since the start")
STORAGE_FAILED = _flag("storage_failed", "the store refused a write in the tick before")
EVENT_COUNT = _count("event_count", "events raised since the start")
EVENTS_SUPPRESSED = _count("events_suppressed", "events not sent: their source's bucket or the queue was full")
COMMANDS_ACCEPTED = _count("commands_accepted", "commands accepted since the start")
COMMANDS_REJECTED = _count("commands_rejected", "commands rejected since the start")
TABLES_CORRUPT = _count("tables_corrupt", "copies of tables that are damaged now", 8)
TABLE_REPAIRS = _count("table_repairs", "damaged copies of tables that were made good", 8)
POOL_VIOLATIONS = _count("pool_violations", "frames given back twice or to a foreign pool", 8)
LEASES_OUTSTANDING = _count("leases_outstanding", "frames still leased at the end of the last hyperperiod", 8)
TASKS_SILENT = _count("tasks_silent", "critical tasks that show no progress now", 8)
RESTARTS = _count("restarts", "restarts by itself since the counter was last cleared", 8)
LIMITS_YELLOW = _count("limits_yellow", "limits that are yellow now", 8)
LIMITS_RED = _count("limits_red", "limits that are red now", 8)
LIMITS_DISABLED = _count("limits_disabled", "limits switched off by command", 8)
SHADOW_TRIPS = _count("shadow_trips", "times that a shadow limit would have gone red")

# Of the estimate; on the board only, for the limits.
IDENTIFIED_FLAGS = _flags("identified_flags", "flags of the mode as the identification raised them", MODE_SLOTS)
FREQUENCY_UNCERTAINTY = _modal("frequency_uncertainty", "1", 0, 1, 1e-5, 24, "standard deviation over frequency")
FREQUENCY_JUMP = _modal(
    "frequency_jump", "1", 0, 1, 1e-5, 24, "change against the last estimate beyond 3 sigma of both, over frequency"
)

# An event, an acknowledgement, a piece of a dumped table, a task's timing: these points live in the encoder.
EVENT_NUMBER = _count("event_number", "number of the event in the dictionary")
EVENT_SEVERITY = Point("severity", "1", 0, 254, 1, 8, "how much it matters", Kind.CHOICE, Severity)
EVENT_ARGUMENT_COUNT = _count("argument_count", "arguments that the event has", 8)
EVENT_INDEX = _count("event_index", "count of events since the start, this one included")
EVENT_ARGUMENT_POINTS = tuple(
    Point(f"argument_{i}", "", -3.4e38, 3.4e38, 0, 32, f"argument {i} of the event", Kind.REAL)
    for i in range(EVENT_ARGUMENTS)
)

# The answer to a command.
ACK_COMMAND = _count("ack_command", "number of the command that is answered", 8)
ACK_RESULT = Point("ack_result", "1", 0, 254, 1, 8, "what became of it", Kind.CHOICE, CommandResult)
ACK_SEQUENCE = _count("ack_sequence", "sequence counter of the command that is answered", 8)
ACK_DETAIL = _count("ack_detail", "more about a refusal: a table's error, or the place of a missing chunk", 16)

# A piece of a dumped table: 48 bytes from an offset.
DUMP_TABLE = _count("dump_table", "number of the table", 8)
DUMP_OFFSET = _count("dump_offset", "place of the first byte in the table's image", 16)
DUMP_SIZE = _count("dump_size", "bytes of the whole image", 16)
DUMP_WORDS = tuple(
    Point(f"dump_word_{i}", "1", 0, (1 << 48) - 1, 1, 48, f"bytes {6 * i} to {6 * i + 5}, little endian", Kind.RAW)
    for i in range(8)
)

# The timing of one task, on command.
TIMING_TASK = _count("timing_task", "number of the task", 8)
TIMING_RUNS = _count("timing_runs", "whole runs", 24)
TIMING_OVERRUNS = _count("timing_overruns", "runs that were not done in their slot")
TIMING_OVER_BUDGET = _count("timing_over_budget", "runs over the budget of thread-CPU time")
TIMING_LOST = _count("timing_lost", "releases that never ran")
TIMING_LAST_MS, TIMING_MIN_MS, TIMING_MAX_MS, TIMING_MEAN_MS, TIMING_DEVIATION_MS, TIMING_JITTER_MS = (
    _quantity(f"timing_{name}_ms", "ms", 0, 16_000, 0.001, 24, meaning)
    for name, meaning in (
        ("last", "thread-CPU time of the last run"),
        ("min", "least thread-CPU time of a run"),
        ("max", "greatest thread-CPU time of a run"),
        ("mean", "mean thread-CPU time"),
        ("deviation", "standard deviation of the thread-CPU time"),
        ("jitter", "greatest delay of a release after its trigger"),
    )
)
TIMING_BINS = tuple(
    _count(f"timing_bin_{i}", f"runs in bin {i} of the histogram, bins of an eighth of the budget") for i in range(16)
)

MODE_PACKET = Packet(
    "mode", 0x240, 54000, 5, 0, "the identified modes, each in the slot that it keeps", (
        ("frequency", (FREQUENCY_HZ, FREQUENCY_SIGMA_HZ)),
        ("damping", (DAMPING_RATIO, DAMPING_RATIO_SIGMA)),
        ("amplitude", (AMPLITUDE_MM, AMPLITUDE_COHERENCE)),
        ("state", (AGE_TICKS, VALID, FLAGS)),
    ), ESTIMATE_TICK, ESTIMATE_TIME_US, MODE_SLOTS,
)  # fmt: skip
ESTIMATE_PACKET = Packet(
    "estimate", 0x230, 54001, 5, 0, "the estimate as a whole", (
        ("record", (MODE_COUNT, OBSERVABLE, VALIDITY, ESTIMATE_FLAGS, RECORD_SAMPLES)),
    ), ESTIMATE_TICK, ESTIMATE_TIME_US,
)  # fmt: skip
QUALITY_PACKET = Packet(
    "quality", 0x210, 54002, 1, 0, "the scene and the match of this tick", (
        ("scene", (CHAR, MU, CMP)),
        ("match", (PRECISION, RECALL, MATCHED)),
        ("residual", (REPROJECTION_RMS_PX, EPIPOLAR_RMS_PX)),
        ("state", (DETECTED_LEFT, DETECTED_RIGHT, MODE, OBSERVABLE, VALIDITY)),
    ),
)  # fmt: skip
HEALTH_PACKET = Packet(
    "health", 0x220, 54003, 15, 7, "mode and counters of the flight application", (
        ("state", (MODE, OBSERVABLE, VALIDITY, FREE_WHEEL, ILLUMINATED, EVENTS_SUPPRESSED, EVENT_COUNT)),
        ("ticks", (TICKS, TICKS_MISSED)),
        ("slots", (OVERRUNS, SLOTS_LOST, BUS_DROPPED)),
        ("drops", (DROPS_MISSING, DROPS_SKEW, DROPS_CORRUPT)),
        ("repeats", (DROPS_STUCK, DROPS_DUPLICATE, DROPS_SWAPPED)),
        ("images", (DROPS_BLACK, DROPS_SATURATED, DROPS_TORN)),
        ("pairs", (DROPS_LATE, DROPS_MEMORY, DROP_RATE)),
        ("trigger", (EDGES_EARLY, EDGES_LATE, EDGES_DOUBLE)),
        ("memory", (CLOCK_JUMPS, POOL_VIOLATIONS, LEASES_OUTSTANDING, TABLES_CORRUPT, TABLE_REPAIRS, RESTARTS)),
        ("commands", (COMMANDS_ACCEPTED, COMMANDS_REJECTED, STORAGE_ERRORS)),
        ("limits", (LIMITS_YELLOW, LIMITS_RED, LIMITS_DISABLED, TASKS_SILENT, SHADOW_TRIPS)),
    ),
)  # fmt: skip
EVENT_PACKET = Packet(
    "event", 0x200, 54004, 0, 0, "one event", (
        ("number", (EVENT_NUMBER, EVENT_SEVERITY, EVENT_ARGUMENT_COUNT, EVENT_INDEX)),
        *((point.name, (point,)) for point in EVENT_ARGUMENT_POINTS),
    ),
)  # fmt: skip
ACK_PACKET = Packet(
    "ack", 0x208, 54005, 0, 0, "the answer to a command", (
        ("answer", (ACK_COMMAND, ACK_RESULT, ACK_SEQUENCE, ACK_DETAIL)),
    ),
)  # fmt: skip
DUMP_PACKET = Packet(
    "dump", 0x280, 54006, 0, 0, "48 bytes of a table's image, on command", (
        ("place", (DUMP_TABLE, DUMP_OFFSET, DUMP_SIZE)),
        *((point.name.removeprefix("dump_"), (point,)) for point in DUMP_WORDS),
    ),
)  # fmt: skip
TIMING_PACKET = Packet(
    "timing", 0x290, 54007, 0, 0, "timing of one task, on command", (
        ("runs", (TIMING_TASK, TIMING_RUNS, TIMING_OVERRUNS)),
        ("counts", (TIMING_OVER_BUDGET, TIMING_LOST)),
        ("last", (TIMING_LAST_MS, TIMING_MIN_MS)),
        ("spread", (TIMING_MAX_MS, TIMING_MEAN_MS)),
        ("deviation", (TIMING_DEVIATION_MS, TIMING_JITTER_MS)),
        *((f"bins_{i}", TIMING_BINS[i : i + 3]) for i in range(0, 16, 3)),
    ),
)  # fmt: skip

PACKETS = (
    EVENT_PACKET, ACK_PACKET, QUALITY_PACKET, HEALTH_PACKET, ESTIMATE_PACKET, MODE_PACKET, DUMP_PACKET, TIMING_PACKET
)  # fmt: skip
PERIODIC_PACKETS = tuple(packet for packet in PACKETS if packet.period_ticks)

ON_DEMAND_PACKETS = tuple(packet for packet in PACKETS if not packet.period_ticks)
INTERNAL = (OVERRUN, BUS_ERRORS, STORAGE_FAILED, IDENTIFIED_FLAGS, FREQUENCY_UNCERTAINTY, FREQUENCY_JUMP)
"""Points that no packet carries: they are there for the limits."""

POINTS: tuple[Point, ...] = tuple(
    dict.fromkeys(
        (
            ESTIMATE_TICK,
            ESTIMATE_TIME_US,
            *(point for packet in reversed(PERIODIC_PACKETS) for point in packet.points),
            *INTERNAL,
            *(point for packet in ON_DEMAND_PACKETS for point in packet.points),
        )
    )
)
"""Every point that the board holds. A point's number, where an event names one, is its place here."""
POINT_BY_NAME = {point.name: point for point in POINTS}
POINT_NUMBER = {point.name: number for number, point in enumerate(POINTS)}
