"""Limits trip, hold and clear exactly as their truth table says."""

from math import inf, nan

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fault.limits import GREEN, Level, Limit, LimitState, Trip, crossed, fault_in, outside, step

G, Y, R = Level
# low red 10, low yellow 20, high yellow 80, high red 90; hysteresis 2; 2 samples to set, 3 to clear.
BAND = Limit("points", "tick", 2, 3, 10.0, 20.0, 80.0, 90.0, 2.0)
QUICK = msgspec.structs.replace(BAND, set_after=1, clear_after=1)
LOW = Limit("cmp", "frame", 1, 1, low_red=0.5, low_yellow=0.7, hysteresis=0.05)
HIGH = Limit("age_ticks", "tick", 1, 1, high_red=75.0)
IN_YELLOW = LimitState(Trip(True), Trip(False))
IN_RED = LimitState(Trip(True), Trip(True))
STALE, CLOSED = "stale", "closed"

# limit, state before, samples, level after them
TRUTH: list[tuple[Limit, LimitState, list[float | str], Level]] = [
    # One sample decides: each side of each threshold, and the threshold itself.
    (QUICK, GREEN, [50.0], G),
    (QUICK, GREEN, [20.0], G),
    (QUICK, GREEN, [19.999], Y),
    (QUICK, GREEN, [10.0], Y),
    (QUICK, GREEN, [9.999], R),
    (QUICK, GREEN, [80.0], G),
    (QUICK, GREEN, [80.001], Y),
    (QUICK, GREEN, [90.0], Y),
    (QUICK, GREEN, [90.001], R),
    (QUICK, GREEN, [nan], R),
    (QUICK, GREEN, [inf], R),
    (QUICK, GREEN, [-inf], R),
    # Hysteresis on the way back: out of yellow at 22 and 78, out of red at 12 and 88.
    (QUICK, IN_YELLOW, [20.0], Y),
    (QUICK, IN_YELLOW, [21.999], Y),
    (QUICK, IN_YELLOW, [22.0], G),
    (QUICK, IN_YELLOW, [78.001], Y),
    (QUICK, IN_YELLOW, [78.0], G),
    (QUICK, IN_RED, [10.0], R),
    (QUICK, IN_RED, [11.999], R),
    (QUICK, IN_RED, [12.0], Y),
    (QUICK, IN_RED, [22.0], G),
    (QUICK, IN_RED, [88.001], R),
    (QUICK, IN_RED, [88.0], Y),
    (QUICK, IN_RED, [nan], R),
    # One-sided limits.
    (LOW, GREEN, [1e9], G),
    (LOW, GREEN, [0.69], Y),
    (LOW, GREEN, [0.49], R),
    (LOW, GREEN, [nan], R),
    (HIGH, GREEN, [-1e9], G),
    (HIGH, GREEN, [75.0], G),
    (HIGH, GREEN, [75.1], R),
    (HIGH, GREEN, [nan], R),
    # Persistence to set: two in a row; one good sample between breaks the row.
    (BAND, GREEN, [5.0], G),
    (BAND, GREEN, [5.0, 5.0], R),
    (BAND, GREEN, [5.0, 50.0, 5.0], G),
    (BAND, GREEN, [5.0, 15.0], Y),
    (BAND, GREEN, [5.0, 15.0, 5.0], Y),
    (BAND, GREEN, [nan, 95.0], R),
    # Persistence to clear: three in a row, inside by the hysteresis.
    (BAND, IN_RED, [50.0, 50.0], R),
    (BAND, IN_RED, [50.0, 50.0, 50.0], G),
    (BAND, IN_RED, [50.0, 50.0, 9.0, 50.0, 50.0], R),
    (BAND, IN_RED, [50.0, 50.0, 11.0, 50.0, 50.0], R),
    (BAND, IN_RED, [15.0, 15.0, 15.0], Y),
    (BAND, IN_YELLOW, [50.0, 50.0, 5.0, 5.0], R),
    # Stale samples and a closed gate count for nothing: they clear nothing, set nothing, and break no row.
    (BAND, IN_RED, [STALE] * 9, R),
    (BAND, IN_RED, [CLOSED] * 9, R),
    (BAND, IN_RED, [50.0, 50.0, STALE, STALE], R),
    (BAND, IN_RED, [50.0, STALE, 50.0, CLOSED, 50.0], G),
    (BAND, GREEN, [STALE] * 9, G),
    (BAND, GREEN, [5.0, STALE, 5.0], R),
    (BAND, GREEN, [5.0, STALE, CLOSED], G),
    (BAND, GREEN, [STALE, 5.0, STALE, STALE, STALE, 5.0], R),
    (BAND, GREEN, [5.0, CLOSED, 50.0, 5.0], G),
]


def follow(limit: Limit, state: LimitState, samples: list[float | str]) -> LimitState:
    for sample in samples:
        if isinstance(sample, str):
            # A stale value may be anything, even a violation.
            state = step(limit, state, nan, fresh=sample != STALE, applies=sample != CLOSED)
        else:
            state = step(limit, state, sample)
    return state


@pytest.mark.parametrize(("limit", "state", "samples", "level"), TRUTH)
def test_truth_table(limit: Limit, state: LimitState, samples: list[float | str], level: Level) -> None:
    assert follow(limit, state, samples).level is level


@given(st.lists(st.floats(allow_nan=True), max_size=30), st.integers(1, 4), st.integers(1, 4))
def test_red_trips_exactly_when_that_many_in_a_row_are_bad(values: list[float], to_set: int, to_clear: int) -> None:
    limit = Limit("cmp", "tick", to_set, to_clear, low_red=0.5, hysteresis=0.1)
    state, tripped, row = GREEN, False, 0
    for value in values:
        state = step(limit, state, value)
        contrary = value >= 0.6 if tripped else not value >= 0.5
        row = row + 1 if contrary else 0
        if row == (to_clear if tripped else to_set):
            tripped, row = not tripped, 0
        assert state.red.tripped is tripped
        assert (state.level is R) is tripped


def test_nothing_is_outside_of_no_threshold() -> None:
    assert not outside(nan, -inf, inf)
    assert not outside(inf, -inf, inf)


def test_the_threshold_named_is_the_one_that_was_crossed() -> None:
    assert [crossed(BAND, R, value) for value in (5.0, 95.0, nan)] == [10.0, 90.0, 10.0]
    assert [crossed(BAND, Y, value) for value in (15.0, 85.0)] == [20.0, 80.0]
    assert crossed(HIGH, R, nan) == 75.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, ""),
        ({"point": "no_such"}, "no point is called no_such"),
        ({"requires": ("no_such",)}, "no point is called no_such"),
        ({"requires": ("frequency_hz",)}, "cannot require frequency_hz"),
        ({"low_red": 30.0}, "low_red <= low_yellow"),
        ({"low_red": None, "low_yellow": None, "high_yellow": None, "high_red": None}, "is needed"),
        ({"hysteresis": 31.0}, "leaves nothing"),
        ({"low_red": None, "high_red": None, "response": "degrade"}, "needs a red threshold"),
        ({"flag": "no_such"}, "no flag is called no_such"),
        ({"flag": "poor_scene", "response": "degrade"}, ""),
    ],
)
def test_a_row_that_cannot_work_is_explained(changes: dict[str, object], message: str) -> None:
    problem = fault_in(msgspec.structs.replace(BAND, **changes))
    assert problem == "" if message == "" else message in problem
