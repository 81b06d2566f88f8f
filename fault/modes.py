"""The mode machine: which mode follows which, for which cause. Plain state in, plain state out."""

from enum import IntFlag

from telemetry.dictionary import FlightMode

INIT, ACQUIRE, TRACK, DEGRADED, HOLD, INHIBITED, TEST = FlightMode


class Cause(IntFlag):
    """What may change the mode. Several may hold in a tick; they stand in order of priority, first one first.

    Conditions are given in each tick in which they hold, commands once.
    """

    INHIBIT = 1 << 0  # command, or a red limit with this response: measure nothing, say nothing
    ENABLE = 1 << 1  # command: go back to work
    TEST_BEGIN = 1 << 2  # command, out of INHIBITED only: nobody may be relying on the output
    TEST_END = 1 << 3  # command
    READY = 1 << 4  # all tasks are initialised
    FRAMES_GONE = 1 << 5  # no usable pair for so long that the prediction is void: eclipse, camera, trigger
    FRAMES_BACK = 1 << 6  # usable pairs again
    LOCK_LOST = 1 << 7  # too few cells where the prediction expects them
    LOCK_FOUND = 1 << 8  # the grid was found and every cell is known by name
    LIMIT_RED = 1 << 9  # a limit with the response `degrade` is red
    LIMITS_CLEAR = 1 << 10  # no such limit is red


TRANSITIONS: dict[FlightMode, dict[Cause, FlightMode]] = {
    INIT: {Cause.INHIBIT: INHIBITED, Cause.READY: ACQUIRE},
    ACQUIRE: {Cause.INHIBIT: INHIBITED, Cause.FRAMES_GONE: HOLD, Cause.LOCK_FOUND: TRACK},
    TRACK: {
        Cause.INHIBIT: INHIBITED,
        Cause.FRAMES_GONE: HOLD,
        Cause.LOCK_LOST: ACQUIRE,
        Cause.LIMIT_RED: DEGRADED,
    },
    DEGRADED: {
        Cause.INHIBIT: INHIBITED,
        Cause.FRAMES_GONE: HOLD,
        Cause.LOCK_LOST: ACQUIRE,
        Cause.LIMITS_CLEAR: TRACK,
    },
    # What was locked before the frames went may have moved by more than a cell: search again.
    HOLD: {Cause.INHIBIT: INHIBITED, Cause.FRAMES_BACK: ACQUIRE},
    # While a limit asks to inhibit, no command gets past it.
    INHIBITED: {Cause.INHIBIT: INHIBITED, Cause.ENABLE: ACQUIRE, Cause.TEST_BEGIN: TEST},
    TEST: {Cause.INHIBIT: INHIBITED, Cause.TEST_END: INHIBITED},
}


def next_mode(mode: FlightMode, causes: Cause) -> FlightMode:
    """The mode after this tick: the first cause that this mode answers decides; one transition a tick."""
    for cause, target in TRANSITIONS[mode].items():
        if cause & causes:
            return target
    return mode


def may_be_valid(mode: FlightMode) -> bool:
    """Whether an estimate may be marked valid in this mode."""
    return mode is TRACK


def measures(mode: FlightMode) -> bool:
    """Whether cells are measured in this mode, so that the quality points mean something."""
    return mode in (TRACK, DEGRADED)
