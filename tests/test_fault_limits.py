"""Limits trip, hold, forgive and clear exactly as their truth table says."""

from math import inf, nan

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fault.fmea import shipped_limits
from fault.limits import GREEN, Level, Limit, LimitState, Trip, clear, crossed, fault_in, faults_in, outside, step

G, Y, R = Level


def limit(number: int = 1, point: str = "points", set_after: int = 2, clear_after: int = 3, **fields: object) -> Limit:
    return Limit(
        number=number, point=point, per="tick", set_after=set_after, clear_after=clear_after, **fields  # type: ignore[arg-type]
    )  # fmt: skip


# low red 10, low yellow 20, high yellow 80, high red 90; hysteresis 2; 2 samples to set, 3 to clear, 4 to forgive.
BAND = limit(low_red=10.0, low_yellow=20.0, high_yellow=80.0, high_red=90.0, hysteresis=2.0)
QUICK = msgspec.structs.replace(BAND, set_after=1, clear_after=1)
LATCHED = msgspec.structs.replace(BAND, latch="latched")
PERMANENT = msgspec.structs.replace(BAND, latch="permanent")
LONG = msgspec.structs.replace(BAND, clear_after=20)
HARSH = msgspec.structs.replace(LONG, forgive=9)
STRICT = msgspec.structs.replace(BAND, forgive=1)
LOW = limit(point="cmp", set_after=1, clear_after=1, low_red=0.5, low_yellow=0.7, hysteresis=0.05)
HIGH = limit(point="age_ticks", set_after=1, clear_after=1, high_red=75.0)
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
    # Persistence to set: two in a row; a bad sample is forgiven by four good ones, not by fewer.
    (BAND, GREEN, [5.0], G),
    (BAND, GREEN, [5.0, 5.0], R),
    (BAND, GREEN, [nan, 95.0], R),
    (BAND, GREEN, [5.0, 50.0, 5.0], G),
    (BAND, GREEN, [5.0, 50.0, 5.0, 50.0, 5.0], R),
    (BAND, GREEN, [5.0, 50.0, 50.0, 50.0, 5.0, 50.0, 5.0], R),
    (BAND, GREEN, [5.0, 50.0, 50.0, 50.0, 5.0, 50.0, 50.0, 5.0], G),
    (BAND, GREEN, [5.0, 50.0, 50.0, 50.0, 5.0, 50.0, 50.0, 5.0, 5.0], R),
    (LONG, GREEN, [5.0, 50.0, 50.0, 50.0, 50.0] * 9, G),
    (LONG, GREEN, [5.0, 50.0, 50.0, 50.0] * 9, R),
    (BAND, GREEN, [50.0] * 9 + [5.0], G),
    (HARSH, GREEN, ([5.0] + [50.0] * 9) * 9, G),
    (HARSH, GREEN, ([5.0] + [50.0] * 8) * 10, R),
    (STRICT, GREEN, [5.0, 50.0] * 9, G),
    (STRICT, GREEN, [5.0, 5.0], R),
    # Red and yellow count apart.
    (BAND, GREEN, [5.0, 15.0], Y),
    (BAND, GREEN, [5.0, 15.0, 5.0], Y),
    (BAND, GREEN, [5.0, 15.0, 5.0, 15.0, 5.0], R),
    # Persistence to clear: three in a row, inside by the hysteresis; a bad one begins the row anew.
    (BAND, IN_RED, [50.0, 50.0], R),
    (BAND, IN_RED, [50.0, 50.0, 50.0], G),
    (BAND, IN_RED, [50.0, 50.0, 9.0, 50.0, 50.0], R),
    (BAND, IN_RED, [50.0, 50.0, 11.0, 50.0, 50.0], R),
    (BAND, IN_RED, [50.0, 50.0, 9.0, 50.0, 50.0, 50.0], G),
    (BAND, IN_RED, [15.0, 15.0, 15.0], Y),
    (BAND, IN_YELLOW, [50.0, 50.0, 5.0, 5.0], R),
    (BAND, IN_RED, [50.0, 50.0, 50.0, 5.0], G),
    # Stale samples and a closed gate count for nothing: they clear nothing, set nothing, forgive nothing.
    (BAND, IN_RED, [STALE] * 9, R),
    (BAND, IN_RED, [CLOSED] * 9, R),
    (BAND, IN_RED, [50.0, 50.0, STALE, STALE], R),
    (BAND, IN_RED, [50.0, STALE, 50.0, CLOSED, 50.0], G),
    (BAND, GREEN, [STALE] * 9, G),
    (BAND, GREEN, [CLOSED] * 9, G),
    (BAND, GREEN, [5.0, STALE, 5.0], R),
    (BAND, GREEN, [5.0, STALE, 5.0, STALE], R),
    (BAND, GREEN, [5.0, STALE, CLOSED], G),
    (BAND, GREEN, [STALE, 5.0, STALE, STALE, STALE, 5.0], R),
    (BAND, GREEN, [5.0, *[CLOSED] * 9, 5.0], R),
    (BAND, GREEN, [5.0, CLOSED, 50.0, 5.0], G),
    # Latches: good samples alone clear nothing.
    (LATCHED, GREEN, [5.0, 5.0, *[50.0] * 20], R),
    (LATCHED, IN_YELLOW, [50.0] * 20, Y),
    (PERMANENT, GREEN, [5.0, 5.0, *[50.0] * 20], R),
]


def follow(limit: Limit, state: LimitState, samples: list[float | str]) -> LimitState:
    for sample in samples:
        if isinstance(sample, str):
            # A stale value may be anything, even a violation.
            state = step(limit, state, nan, fresh=sample != STALE, applies=sample != CLOSED)
        else:
            state = step(limit, state, sample)
    return state


@pytest.mark.requirement("WB-FLT-01", "WB-FLT-02", "WB-FLT-03", "WB-FLT-04")
@pytest.mark.parametrize(("limit", "state", "samples", "level"), TRUTH)
def test_truth_table(limit: Limit, state: LimitState, samples: list[float | str], level: Level) -> None:
    assert len(TRUTH) >= 40
    assert follow(limit, state, samples).level is level


@pytest.mark.requirement("WB-FLT-03")
@given(st.lists(st.floats(allow_nan=True), max_size=30), st.lists(st.sampled_from([STALE, CLOSED]), max_size=30))
def test_samples_that_count_for_nothing_may_stand_anywhere(values: list[float], idle: list[str]) -> None:
    mixed: list[float | str] = list(values)
    for i, sample in enumerate(idle):
        mixed.insert(i * 7 % (len(mixed) + 1), sample)
    assert follow(BAND, GREEN, mixed) == follow(BAND, GREEN, list(values))


@pytest.mark.requirement("WB-FLT-01", "WB-FLT-02")
@given(
    st.lists(st.floats(allow_nan=True), max_size=40), st.integers(1, 4), st.integers(1, 4), st.integers(1, 6)
)  # fmt: skip
def test_red_trips_when_the_bad_outweigh_the_good_and_clears_after_so_many_good_in_a_row(
    values: list[float], to_set: int, to_clear: int, forgive: int
) -> None:
    rule = limit(point="cmp", set_after=to_set, clear_after=to_clear, forgive=forgive, low_red=0.5, hysteresis=0.1)
    state, tripped, weight, row = GREEN, False, 0.0, 0
    for value in values:
        state = step(rule, state, value)
        if tripped:
            row = row + 1 if value >= 0.6 else 0
            tripped = row < to_clear
            weight = 0.0
        else:
            weight = weight + 1.0 if not value >= 0.5 else max(0.0, weight - 1.0 / forgive)
            tripped, row = weight > to_set - 0.5 / forgive, 0
        assert state.red.tripped is tripped
        assert (state.level is R) is tripped
        assert 0 <= state.red.debt < to_set * forgive and 0 <= state.red.good <= to_clear


@pytest.mark.requirement("WB-FLT-02")
@pytest.mark.parametrize("forgive", [1, 4, 19])
def test_a_fault_that_comes_and_goes_trips_if_more_than_one_sample_in_forgive_and_one_is_bad(forgive: int) -> None:
    rule = msgspec.structs.replace(BAND, set_after=3, clear_after=30, forgive=forgive)
    rare: list[float | str] = [5.0, *[50.0] * forgive]
    assert follow(rule, GREEN, rare * 200).level is G
    assert follow(rule, GREEN, rare[:-1] * 200).level is R


def test_a_trip_counts_what_speaks_for_the_other_state() -> None:
    assert follow(BAND, GREEN, [5.0]) == (Trip(False, 4, 0), Trip(False, 4, 0))
    assert follow(BAND, GREEN, [5.0, 15.0]) == (Trip(True, 0, 0), Trip(False, 3, 0))
    assert follow(BAND, GREEN, [5.0, *[50.0] * 9]) == GREEN
    assert follow(BAND, IN_RED, [50.0, 50.0]) == (Trip(True, 0, 2), Trip(True, 0, 2))
    assert follow(BAND, IN_RED, [50.0, 5.0]) == IN_RED
    assert follow(BAND, IN_RED, [50.0] * 3) == GREEN
    assert follow(LATCHED, IN_RED, [50.0] * 9) == (Trip(True, 0, 3), Trip(True, 0, 3))


@pytest.mark.requirement("WB-FLT-04")
@pytest.mark.parametrize(
    ("limit", "samples", "granted", "level"),
    [
        (LATCHED, [], True, G),
        (LATCHED, [5.0], True, G),
        (LATCHED, [5.0, 5.0], False, R),
        (LATCHED, [5.0, 5.0, 50.0, 50.0], False, R),
        (LATCHED, [5.0, 5.0, 50.0, 50.0, 50.0], True, G),
        (LATCHED, [5.0, 5.0, 50.0, 50.0, 50.0, 50.0], True, G),
        (LATCHED, [5.0, 5.0, 50.0, 50.0, 50.0, 5.0], False, R),
        (LATCHED, [5.0, 5.0, *[STALE] * 9], False, R),
        (LATCHED, [5.0, 5.0, 15.0, 15.0, 15.0], True, Y),
        (LATCHED, [15.0, 15.0, 15.0], False, Y),
        (LATCHED, [15.0, 15.0, 50.0, 50.0, 50.0], True, G),
        (PERMANENT, [], True, G),
        (PERMANENT, [5.0, 5.0, *[50.0] * 9], False, R),
        (PERMANENT, [15.0, 15.0, *[50.0] * 9], False, Y),
        (BAND, [5.0, 5.0, 50.0, 50.0], False, R),
        (BAND, [15.0, 15.0, 50.0, 50.0], False, Y),
    ],
)
def test_a_command_clears_only_what_is_good_again(
    limit: Limit, samples: list[float | str], granted: bool, level: Level
) -> None:
    before = follow(limit, GREEN, samples)
    after, said = clear(limit, before)
    assert said is granted and after.level is level
    if not granted or before.level is G:
        assert after is before
    elif level is G:
        assert after == GREEN


def test_what_was_cleared_starts_from_nothing() -> None:
    state, _ = clear(LATCHED, follow(LATCHED, GREEN, [5.0, 5.0, 50.0, 50.0, 50.0]))
    assert follow(LATCHED, state, [5.0]).level is G
    assert follow(LATCHED, state, [5.0, 5.0]).level is R


def test_nothing_is_outside_of_no_threshold() -> None:
    assert not outside(nan, -inf, inf)
    assert not outside(inf, -inf, inf)
    assert outside(nan, 0.0, inf) and outside(nan, -inf, 0.0)


def test_the_threshold_named_is_the_one_that_was_crossed() -> None:
    assert [crossed(BAND, R, value) for value in (5.0, 95.0, nan)] == [10.0, 90.0, 10.0]
    assert [crossed(BAND, Y, value) for value in (15.0, 85.0)] == [20.0, 80.0]
    assert crossed(BAND, R, 50.0) == 10.0
    assert crossed(HIGH, R, nan) == 75.0


@pytest.mark.requirement("WB-FLT-15")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, ""),
        ({"point": "no_such"}, "no point is called no_such; there are estimate_tick, estimate_time_us, "),
        ({"requires": ("no_such",)}, "no point is called no_such; there are "),
        ({"excludes": ("no_such",)}, "no point is called no_such; there are "),
        ({"requires": ("frequency_hz",)}, "points cannot depend on frequency_hz: it has other slots"),
        ({"excludes": ("frequency_hz",)}, "points cannot depend on frequency_hz: it has other slots"),
        ({"point": "frequency_hz", "requires": ("damping_ratio",), "excludes": ("observable",)}, ""),
        ({"low_red": 30.0}, "low_red <= low_yellow <= high_yellow <= high_red is needed"),
        ({"low_yellow": 80.0, "hysteresis": 0.0}, ""),
        (
            {"low_red": None, "low_yellow": None, "high_yellow": None, "high_red": None},
            "one of low_red, low_yellow, high_yellow, high_red is needed",
        ),
        ({"hysteresis": 30.0}, ""),
        ({"hysteresis": 31.5}, "hysteresis 31.5 leaves nothing between 20 and 80 to clear in"),
        (
            {"low_yellow": None, "high_yellow": None, "hysteresis": 41.0},
            "hysteresis 41 leaves nothing between 10 and 90 to clear in",
        ),
        ({"low_red": None, "high_red": None, "response": "degrade"}, "response degrade needs a red threshold"),
        ({"low_red": None, "high_red": None}, ""),
        ({"low_red": None, "response": "inhibit"}, ""),
        ({"high_red": None, "response": "invalidate"}, ""),
        ({"flag": "no_such"}, "no flag is called no_such; there are harmonic, time_varying, "),
        ({"flag": "poor_scene", "response": "degrade"}, ""),
    ],
)
def test_a_row_that_cannot_work_is_explained(changes: dict[str, object], message: str) -> None:
    problem = fault_in(msgspec.structs.replace(BAND, **changes))
    assert problem == "" if message == "" else problem.startswith(message)


@pytest.mark.requirement("WB-FLT-15")
def test_a_table_that_cannot_work_is_explained_by_its_first_bad_row() -> None:
    good, other = BAND, msgspec.structs.replace(LOW, number=2)
    bad = msgspec.structs.replace(other, number=3, flag="no_such")
    assert faults_in([]) == faults_in([good, other]) == ""
    assert faults_in([good, other, LOW]) == "limit[2] on cmp: number 1 is limit[0] already"
    assert faults_in([good, bad, bad]).startswith("limit[1] on cmp: no flag is called no_such")
    assert faults_in(shipped_limits()) == ""


@pytest.mark.requirement("WB-FLT-15")
@pytest.mark.parametrize(
    "changes", [{"number": 0}, {"number": 1000}, {"forgive": 0}, {"set_after": 0}, {"latch": "never"}, {"per": "day"}]
)
def test_a_row_outside_of_its_ranges_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({**msgspec.structs.asdict(BAND), **changes}, Limit)
