"""Every mode with every cause, alone and together."""

from itertools import combinations

import pytest

from fault.modes import TRANSITIONS, Cause, may_be_valid, measures, next_mode
from telemetry.dictionary import FlightMode

INIT, ACQUIRE, TRACK, DEGRADED, HOLD, INHIBITED, TEST = FlightMode
COLUMNS = tuple(FlightMode)

# A row for each cause, a column for each mode before; the mode after.
TABLE: dict[Cause, tuple[FlightMode, ...]] = {
    #                   INIT       ACQUIRE    TRACK      DEGRADED   HOLD       INHIBITED  TEST
    Cause.INHIBIT:      (INHIBITED, INHIBITED, INHIBITED, INHIBITED, INHIBITED, INHIBITED, INHIBITED),
    Cause.ENABLE:       (INIT,      ACQUIRE,   TRACK,     DEGRADED,  HOLD,      ACQUIRE,   TEST),
    Cause.TEST_BEGIN:   (INIT,      ACQUIRE,   TRACK,     DEGRADED,  HOLD,      TEST,      TEST),
    Cause.TEST_END:     (INIT,      ACQUIRE,   TRACK,     DEGRADED,  HOLD,      INHIBITED, INHIBITED),
    Cause.READY:        (ACQUIRE,   ACQUIRE,   TRACK,     DEGRADED,  HOLD,      INHIBITED, TEST),
    Cause.FRAMES_GONE:  (INIT,      HOLD,      HOLD,      HOLD,      HOLD,      INHIBITED, TEST),
    Cause.FRAMES_BACK:  (INIT,      ACQUIRE,   TRACK,     DEGRADED,  ACQUIRE,   INHIBITED, TEST),
    Cause.LOCK_LOST:    (INIT,      ACQUIRE,   ACQUIRE,   ACQUIRE,   HOLD,      INHIBITED, TEST),
    Cause.LOCK_FOUND:   (INIT,      TRACK,     TRACK,     DEGRADED,  HOLD,      INHIBITED, TEST),
    Cause.LIMIT_RED:    (INIT,      ACQUIRE,   DEGRADED,  DEGRADED,  HOLD,      INHIBITED, TEST),
    Cause.LIMITS_CLEAR: (INIT,      ACQUIRE,   TRACK,     TRACK,     HOLD,      INHIBITED, TEST),
}  # fmt: skip


@pytest.mark.requirement("WB-FLT-05")
@pytest.mark.parametrize("cause", Cause)
@pytest.mark.parametrize("mode", FlightMode)
def test_every_mode_with_every_cause(mode: FlightMode, cause: Cause) -> None:
    assert next_mode(mode, cause) is TABLE[cause][COLUMNS.index(mode)]


@pytest.mark.requirement("WB-FLT-05")
@pytest.mark.parametrize("mode", FlightMode)
def test_of_several_causes_the_first_that_the_mode_answers_decides(mode: FlightMode) -> None:
    column = COLUMNS.index(mode)
    for causes in (pair for count in (0, 2, 3) for pair in combinations(Cause, count)):
        targets = [TABLE[cause][column] for cause in causes if cause in TRANSITIONS[mode]]
        expected = targets[0] if targets else mode
        union = Cause(0)
        for cause in causes:
            union |= cause
        assert next_mode(mode, union) is expected


def test_rows_of_the_table_stand_in_order_of_priority() -> None:
    for row in TRANSITIONS.values():
        assert list(row) == sorted(row)


def test_every_mode_can_be_reached_and_left() -> None:
    reached = {INIT}
    while more := {t for mode in reached for t in TRANSITIONS[mode].values()} - reached:
        reached |= more
    assert reached == set(FlightMode)
    assert all(TRANSITIONS[mode] for mode in FlightMode)


@pytest.mark.requirement("WB-FLT-05")
def test_no_command_gets_past_a_limit_that_inhibits() -> None:
    for command in (Cause.ENABLE, Cause.TEST_BEGIN, Cause.TEST_END):
        for mode in FlightMode:
            assert next_mode(mode, Cause.INHIBIT | command) is INHIBITED


@pytest.mark.requirement("WB-FLT-06")
def test_an_estimate_may_be_valid_while_tracking_only() -> None:
    assert [mode for mode in FlightMode if may_be_valid(mode)] == [TRACK]
    assert [mode for mode in FlightMode if measures(mode)] == [TRACK, DEGRADED]
