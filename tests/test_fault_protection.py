"""Protection withdraws what may mislead, tells quiet from bad, holds what was good, and can be taken up anywhere."""

from math import nan

import pytest
from fault_parts import Flight, limit, put_estimate

from fault.limits import Level
from fault.modes import Cause
from fault.protection import Protection
from telemetry import dictionary as d
from telemetry import events
from telemetry.board import Board
from telemetry.dictionary import MODE_SLOTS, CommandResult, FlightMode, ModeFlag

NO_FLAG = ModeFlag(0)


@pytest.fixture
def flight() -> Flight:
    """A flight with the shipped limits that has had one good estimate of three modes."""
    flight = Flight()
    flight.estimate()
    return flight


def test_at_first_nothing_is_valid_and_the_search_begins() -> None:
    board = Board()
    protection = Protection([limit()])
    assert protection.mode is FlightMode.INIT and protection.good_tick != protection.good_tick
    assert protection.begin(board) == [(events.MODE_CHANGED, (FlightMode.INIT, FlightMode.ACQUIRE))]
    assert protection.mode is FlightMode.ACQUIRE and board.get(d.MODE) == FlightMode.ACQUIRE
    assert board.slots(d.VALID).tolist() == [0.0] * MODE_SLOTS
    for point in (d.TICKS, d.SHADOW_TRIPS, d.VALIDITY, d.LIMITS_YELLOW, d.LIMITS_RED, d.LIMITS_DISABLED):
        assert board.get(point) == 0.0


@pytest.mark.requirement("WB-FLT-06")
def test_when_all_is_well_every_identified_mode_is_valid_and_told_once() -> None:
    flight = Flight()
    assert flight.estimate() == ["MODE_VALID"] * 3
    assert [raised.arguments for raised in flight.raised] == [(0, 0.7), (1, 1.4), (2, pytest.approx(2.1))]
    assert flight.valid == [0, 1, 2] and flight.board.get(d.VALIDITY) == 1.0
    assert flight.slots(d.VALID)[3:] == [0.0] * 5
    assert flight.flags == [NO_FLAG] * 3 + [None] * 5
    assert flight.slots(d.AGE_TICKS)[:3] == [5.0] * 3 and all(age != age for age in flight.slots(d.AGE_TICKS)[3:])
    for _ in range(5):
        assert flight.run(9) == flight.estimate() == []
    assert flight.valid == [0, 1, 2] and flight.mode is FlightMode.TRACK
    assert flight.board.get(d.TICKS) == flight.tick and not flight.protection.held


@pytest.mark.requirement("WB-FLT-06")
def test_a_mode_that_the_identification_flags_is_not_valid_and_says_why() -> None:
    flight = Flight()
    put_estimate(flight.board, 0)
    flight.set(d.IDENTIFIED_FLAGS, float(ModeFlag.HARMONIC | ModeFlag.SPLIT), 1)
    assert flight.run(new_estimate=True) == ["MODE_VALID"] * 2
    assert flight.valid == [0, 2] and flight.flags[:3] == [NO_FLAG, ModeFlag.HARMONIC | ModeFlag.SPLIT, NO_FLAG]


@pytest.mark.requirement("WB-FLT-06")
@pytest.mark.parametrize(
    ("causes", "mode"),
    [
        (Cause.INHIBIT, FlightMode.INHIBITED),
        (Cause.LOCK_LOST, FlightMode.ACQUIRE),
        (Cause.FRAMES_GONE, FlightMode.HOLD),
    ],
)
def test_outside_of_track_nothing_is_valid(flight: Flight, causes: Cause, mode: FlightMode) -> None:
    assert flight.run(causes=causes) == ["MODE_CHANGED"] + ["MODE_INVALID"] * 3
    assert flight.raised[0].arguments == (FlightMode.TRACK, mode)
    assert flight.raised[1].arguments == (0, 0) and flight.raised[3].arguments == (2, 0)
    assert flight.mode is mode and flight.board.get(d.MODE) == mode
    assert flight.valid == [] and flight.board.get(d.VALIDITY) == 0.0
    flight.estimate()
    assert flight.valid == [] and flight.protection.held


@pytest.mark.requirement("WB-FLT-01", "WB-FLT-06")
@pytest.mark.parametrize("value", [0.3, nan])
def test_a_bad_scene_withdraws_all_modes_after_its_persistence_and_returns_them_after_its_own(
    flight: Flight, value: float
) -> None:
    flight.set(d.CMP, value)
    assert flight.run(2) == [] and flight.valid == [0, 1, 2]
    assert flight.run() == ["LIMIT_RED", "MODE_CHANGED"] + ["MODE_INVALID"] * 3
    number, slot, told, threshold = flight.raised[0].arguments
    assert d.POINTS[int(number)] is d.CMP and (slot, threshold) == (0, 0.7) and (told == value or told != told)
    assert flight.mode is FlightMode.DEGRADED and flight.valid == []
    assert flight.flags == [ModeFlag.POOR_SCENE] * 3 + [None] * 5
    assert flight.board.get(d.LIMITS_RED) == 1 and flight.board.get(d.LIMITS_YELLOW) == 0
    assert flight.protection.level(111) is Level.RED
    flight.set(d.CMP, 0.995)
    assert flight.run(14) == []
    assert flight.run() == ["LIMIT_CLEARED", "MODE_CHANGED"] + ["MODE_VALID"] * 3
    assert flight.raised[0].arguments == (d.POINT_NUMBER["cmp"], 0, 0.995, 0.7)
    assert flight.mode is FlightMode.TRACK and flight.board.get(d.LIMITS_RED) == 0


@pytest.mark.requirement("WB-FLT-03")
def test_frames_and_estimates_that_do_not_come_neither_trip_nor_clear(flight: Flight) -> None:
    flight.set(d.CMP, 0.3)
    flight.set(d.AMPLITUDE_COHERENCE, 0.3, 1)
    assert flight.run(20, frame=False) == []
    flight.run(3)
    flight.set(d.CMP, 0.995)
    assert flight.run(50, frame=False)[:1] != ["LIMIT_CLEARED"]
    assert flight.mode is FlightMode.DEGRADED


@pytest.mark.requirement("WB-FLT-07")
def test_in_darkness_the_scene_is_not_judged(flight: Flight) -> None:
    for value in (0.0, nan):
        flight.set(d.ILLUMINATED, value)
        for point in (d.CMP, d.RECALL, d.MATCHED, d.REPROJECTION_RMS_PX, d.EPIPOLAR_RMS_PX, d.DROP_RATE):
            flight.set(point, nan)
        assert flight.run(18) == []


@pytest.mark.requirement("WB-FLT-07")
def test_a_quiet_wing_is_not_observable_and_not_bad(flight: Flight) -> None:
    put_estimate(flight.board, flight.tick)
    flight.set(d.OBSERVABLE, 0.0)
    flight.set(d.AMPLITUDE_COHERENCE, 0.1, 0)
    assert flight.run(new_estimate=True) == ["NOT_OBSERVABLE"] + ["MODE_INVALID"] * 3
    assert flight.run(9) == []
    assert flight.valid == [] and flight.flags[:3] == [ModeFlag.NOT_OBSERVABLE | ModeFlag.HELD] * 3
    assert flight.protection.level(381) is Level.GREEN and flight.mode is FlightMode.TRACK
    put_estimate(flight.board, flight.tick)
    flight.set(d.OBSERVABLE, nan)
    assert flight.run(new_estimate=True) == []  # not known is not observable either
    assert flight.estimate() == ["OBSERVABLE"] + ["MODE_VALID"] * 3


def test_the_first_estimate_tells_nothing_about_quiet() -> None:
    flight = Flight()
    put_estimate(flight.board, 0)
    flight.set(d.OBSERVABLE, 0.0)
    assert flight.run(new_estimate=True) == []
    assert not flight.protection.held and flight.flags[0] is ModeFlag.NOT_OBSERVABLE


@pytest.mark.requirement("WB-FLT-06")
def test_low_coherence_withdraws_its_own_mode_at_once_and_it_must_earn_its_return(flight: Flight) -> None:
    put_estimate(flight.board, flight.tick)
    flight.set(d.AMPLITUDE_COHERENCE, 0.5, 1)
    assert flight.run(new_estimate=True) == ["LIMIT_RED", "MODE_INVALID"]
    assert flight.raised[0].arguments == (d.POINT_NUMBER["amplitude_coherence"], 1, 0.5, 0.8)
    assert flight.raised[1].arguments == (1, ModeFlag.LOW_COHERENCE)
    assert flight.valid == [0, 2] and flight.flags[:3] == [NO_FLAG, ModeFlag.LOW_COHERENCE, NO_FLAG]
    assert flight.mode is FlightMode.TRACK  # the scene is good: the flight mode has no reason to change
    assert [flight.protection.level(381, slot) for slot in range(3)] == [Level.GREEN, Level.RED, Level.GREEN]
    flight.set(d.AMPLITUDE_COHERENCE, 0.99, 1)
    assert flight.run(20) == []  # the same estimate does not count again
    assert flight.estimate() == []
    assert flight.estimate() == ["LIMIT_CLEARED", "MODE_VALID"] and flight.valid == [0, 1, 2]


def test_a_mode_that_is_flagged_already_trips_no_limit_of_its_own(flight: Flight) -> None:
    put_estimate(flight.board, flight.tick)
    for point, value in ((d.AMPLITUDE_COHERENCE, 0.1), (d.DAMPING_RATIO, -1.0), (d.FREQUENCY_JUMP, 0.5)):
        flight.set(point, value, 1)
    flight.set(d.IDENTIFIED_FLAGS, float(ModeFlag.WEAK), 1)
    assert flight.run(new_estimate=True) == ["MODE_INVALID"]


@pytest.mark.parametrize(
    ("point", "value", "flag"),
    [
        (d.FREQUENCY_JUMP, 0.0051, ModeFlag.TIME_VARYING),
        (d.FREQUENCY_UNCERTAINTY, 0.011, ModeFlag.IMPRECISE),
        (d.DAMPING_RATIO, -0.001, ModeFlag.OVERDAMPED),
        (d.DAMPING_RATIO, 0.21, ModeFlag.OVERDAMPED),
    ],
)
@pytest.mark.requirement("WB-FLT-06")
def test_an_estimate_that_cannot_be_is_withdrawn(flight: Flight, point: d.Point, value: float, flag: ModeFlag) -> None:
    put_estimate(flight.board, flight.tick)
    flight.set(point, value, 2)
    assert flight.run(new_estimate=True) == ["LIMIT_RED", "MODE_INVALID"]
    assert flight.valid == [0, 1] and flight.flags[2] is flag


@pytest.mark.parametrize(
    ("point", "ticks", "flag"),
    [
        (d.FREE_WHEEL, 1, ModeFlag.LATE),
        (d.TABLES_CORRUPT, 1, ModeFlag.OTHER),
        (d.TASKS_SILENT, 1, ModeFlag.LATE),
        (d.OVERRUN, 3, ModeFlag.LATE),
        (d.DROP_RATE, 15, ModeFlag.POOR_SCENE),
    ],
)
@pytest.mark.requirement("WB-FLT-06")
def test_a_flight_that_cannot_be_trusted_withdraws_all_modes(
    flight: Flight, point: d.Point, ticks: int, flag: ModeFlag
) -> None:
    flight.set(point, 1.0)
    assert flight.run(ticks - 1) == []
    assert flight.run() == ["LIMIT_RED"] + ["MODE_INVALID"] * 3
    assert flight.flags[:3] == [flag] * 3 and flight.mode is FlightMode.TRACK


@pytest.mark.requirement("WB-FLT-11")
def test_an_estimate_without_a_usable_mode_leaves_the_last_good_one_with_its_age(flight: Flight) -> None:
    good_tick = flight.tick - 1 - 5
    flight.run(9)
    assert flight.protection.good_tick == good_tick
    assert flight.estimate(flags=int(ModeFlag.NOT_EXPONENTIAL), hz=0.9, modes=4) == ["MODE_INVALID"] * 3
    assert flight.raised[0].arguments == (0, ModeFlag.HELD)
    assert flight.protection.held and flight.protection.good_tick == good_tick
    assert flight.board.get(d.ESTIMATE_TICK) == good_tick and flight.board.get(d.MODE_COUNT) == 3
    assert flight.slots(d.FREQUENCY_HZ)[0] == 0.7 and flight.slots(d.IDENTIFIED_FLAGS)[0] == 0.0
    assert flight.slots(d.AGE_TICKS)[0] == flight.tick - 1 - good_tick
    assert flight.flags == [ModeFlag.HELD] * 3 + [None] * 5
    assert flight.board.get(d.OBSERVABLE) == 1.0
    flight.run()
    assert flight.slots(d.AGE_TICKS)[0] == flight.tick - 1 - good_tick
    assert flight.estimate(hz=0.69) == ["MODE_VALID"] * 3
    assert not flight.protection.held and flight.slots(d.FREQUENCY_HZ)[0] == 0.69


@pytest.mark.requirement("WB-FLT-11")
def test_a_good_estimate_ends_the_hold_even_when_what_is_shown_is_stale(flight: Flight) -> None:
    for _ in range(9):
        flight.run(9)
        flight.estimate(flags=int(ModeFlag.WEAK))
    assert flight.protection.level(231, 0) is Level.RED
    assert flight.flags[0] == ModeFlag.STALE | ModeFlag.HELD
    assert flight.estimate() == []  # it is good, and must show that it is not stale
    assert not flight.protection.held and flight.flags[0] is ModeFlag.STALE
    assert flight.run() == ["LIMIT_CLEARED"] * 3 + ["MODE_VALID"] * 3


@pytest.mark.requirement("WB-FLT-11")
def test_an_estimate_that_is_not_renewed_is_withdrawn_as_stale(flight: Flight) -> None:
    raised = [flight.run() for _ in range(71)]
    assert [tick for tick, names in enumerate(raised) if names] == [40, 70]
    assert raised[40] == ["LIMIT_YELLOW"] * 3 and flight.slots(d.AGE_TICKS)[:3] == [76.0] * 3
    assert flight.board.get(d.LIMITS_YELLOW) == 0  # red now
    assert raised[70] == ["LIMIT_RED"] * 3 + ["MODE_INVALID"] * 3
    assert flight.flags[0] is ModeFlag.STALE and flight.board.get(d.LIMITS_RED) == 3


def test_before_the_first_good_estimate_the_newest_is_shown_though_not_valid() -> None:
    flight = Flight()
    assert flight.estimate(flags=int(ModeFlag.WEAK), hz=0.9) == []
    assert not flight.protection.held and flight.slots(d.FREQUENCY_HZ)[0] == 0.9
    assert flight.valid == [] and flight.flags[0] is ModeFlag.WEAK


def test_a_slot_without_a_frequency_is_never_valid() -> None:
    flight = Flight([])
    put_estimate(flight.board, 0, modes=2)
    flight.set(d.FREQUENCY_HZ, nan, 1)
    flight.run(new_estimate=True)
    assert flight.valid == [0] and flight.flags[1] is None


def test_a_mode_whose_flags_are_not_known_is_not_valid() -> None:
    flight = Flight([])
    put_estimate(flight.board, 0, modes=2)
    flight.set(d.IDENTIFIED_FLAGS, nan, 1)
    flight.run(new_estimate=True)
    assert flight.valid == [0] and flight.flags[1] is NO_FLAG


def test_a_limit_that_only_reports_withdraws_nothing() -> None:
    flight = Flight([limit(low_red=0.9, low_yellow=0.95, high_red=None, flag="poor_scene")])
    flight.estimate()
    levels = []
    for value in (0.93, 0.5, 0.93, 0.99):
        flight.set(d.CMP, value)
        levels += flight.run()
        assert flight.valid == [0, 1, 2] and flight.flags[0] is NO_FLAG
        assert flight.board.get(d.LIMITS_YELLOW) == float(value == 0.93)
    assert levels == ["LIMIT_YELLOW", "LIMIT_RED", "LIMIT_YELLOW", "LIMIT_CLEARED"]


def test_clearing_judges_no_stale_value() -> None:
    flight = Flight([limit(d.CMP, per="frame", latch="latched", set_after=2)])
    flight.set(d.CMP, 1.5)
    flight.run(2)
    flight.set(d.CMP, 0.5)
    flight.run()
    flight.set(d.CMP, 1.5)  # never measured: no frame comes
    assert flight.protection.clear_fault(1) is CommandResult.ACCEPTED
    assert flight.run(frame=False) == ["LIMIT_CLEARED"]
    assert flight.run() == [] and flight.run() == ["LIMIT_RED"]  # it takes two, as at first


@pytest.mark.requirement("WB-FLT-05", "WB-FLT-06")
def test_a_limit_that_inhibits_stops_the_flight_until_it_is_clear_and_enabled() -> None:
    flight = Flight([limit(d.TABLES_CORRUPT, high_red=0.5, response="inhibit", flag="other")])
    flight.estimate()
    flight.set(d.TABLES_CORRUPT, 1.0)
    assert flight.run() == ["LIMIT_RED", "MODE_CHANGED"] + ["MODE_INVALID"] * 3
    assert flight.mode is FlightMode.INHIBITED and flight.flags[0] is ModeFlag.OTHER
    assert flight.run(causes=Cause.ENABLE) == [] and flight.mode is FlightMode.INHIBITED
    flight.set(d.TABLES_CORRUPT, 0.0)
    assert flight.run() == ["LIMIT_CLEARED"] and flight.mode is FlightMode.INHIBITED
    assert flight.run(causes=Cause.ENABLE) == ["MODE_CHANGED"] and flight.mode is FlightMode.ACQUIRE


@pytest.mark.requirement("WB-FLT-06")
def test_of_two_red_limits_each_gives_its_flag_and_the_stronger_response_counts() -> None:
    flight = Flight(
        [
            limit(d.OVERRUN, 1, high_red=0.5, response="degrade", flag="late"),
            limit(d.FREE_WHEEL, 2, high_red=0.5, response="invalidate", flag="other"),
            limit(d.STORAGE_FAILED, 3, high_red=0.5, response="inhibit"),
        ]
    )
    flight.estimate()
    flight.set(d.OVERRUN, 1.0)
    flight.set(d.FREE_WHEEL, 1.0)
    flight.run()
    assert flight.mode is FlightMode.DEGRADED and flight.flags[0] == ModeFlag.LATE | ModeFlag.OTHER
    assert flight.board.get(d.LIMITS_RED) == 2
    flight.set(d.STORAGE_FAILED, 1.0)
    flight.run()
    assert flight.mode is FlightMode.INHIBITED


@pytest.mark.requirement("WB-FLT-09")
def test_a_limit_switched_off_is_told_but_has_no_response(flight: Flight) -> None:
    protection = flight.protection
    assert protection.switch(999, False) is CommandResult.NO_SUCH_ITEM
    assert protection.switch(111, False) is CommandResult.ACCEPTED
    flight.set(d.CMP, 0.3)
    assert flight.run(5) == ["LIMIT_RED"]
    assert flight.mode is FlightMode.TRACK and flight.valid == [0, 1, 2] and flight.flags[0] is NO_FLAG
    assert flight.board.get(d.LIMITS_DISABLED) == 1 and flight.board.get(d.LIMITS_RED) == 1
    assert protection.switch(111, True) is CommandResult.ACCEPTED
    assert flight.run() == ["MODE_CHANGED"] + ["MODE_INVALID"] * 3
    assert flight.board.get(d.LIMITS_DISABLED) == 0


@pytest.mark.requirement("WB-FLT-04")
def test_a_latched_fault_is_cleared_by_command_once_its_cause_is_gone(flight: Flight) -> None:
    protection = flight.protection
    assert protection.clear_fault(999) is CommandResult.NO_SUCH_ITEM
    assert protection.clear_fault(311) is CommandResult.ACCEPTED and flight.run() == []
    flight.set(d.POOL_VIOLATIONS, 1.0)
    assert flight.run() == ["LIMIT_RED"]
    assert protection.clear_fault(311) is CommandResult.CAUSE_PRESENT
    assert flight.run(5) == [] and protection.level(311) is Level.RED
    flight.set(d.POOL_VIOLATIONS, 0.0)
    assert flight.run(5) == [] and protection.level(311) is Level.RED
    assert protection.clear_fault(311) is CommandResult.ACCEPTED
    assert protection.level(311) is Level.RED  # done at the next step, and told there
    assert flight.run() == ["LIMIT_CLEARED"] and protection.level(311) is Level.GREEN
    assert flight.raised[0].arguments == (d.POINT_NUMBER["pool_violations"], 0, 0.0, 0.5)
    flight.set(d.POOL_VIOLATIONS, 1.0)
    assert flight.run(3) == ["LIMIT_RED"]


@pytest.mark.requirement("WB-FLT-04")
def test_a_permanent_fault_cannot_be_cleared() -> None:
    flight = Flight([limit(latch="permanent")])
    flight.set(d.CMP, 1.5)
    flight.run()
    flight.set(d.CMP, 0.5)
    assert flight.run(9) == [] and flight.protection.clear_fault(1) is CommandResult.NOT_CLEARABLE
    assert flight.protection.level(1) is Level.RED


@pytest.mark.requirement("WB-FLT-04")
def test_a_fault_in_one_slot_keeps_the_limit_from_being_cleared_in_any() -> None:
    flight = Flight([limit(d.FREQUENCY_HZ, per="estimate", latch="latched", response="invalidate")])
    flight.estimate(modes=2, hz=2.0)  # both red
    put_estimate(flight.board, flight.tick, modes=2, hz=0.9)
    flight.run(new_estimate=True)  # the second still is
    assert flight.protection.clear_fault(1) is CommandResult.CAUSE_PRESENT
    assert flight.estimate(modes=2, hz=0.4) == [] and flight.valid == []
    assert flight.protection.clear_fault(1) is CommandResult.CAUSE_PRESENT  # slots without a mode are bad: NaN
    put_estimate(flight.board, flight.tick, modes=8, hz=0.1)
    flight.run(new_estimate=True)
    assert flight.protection.clear_fault(1) is CommandResult.ACCEPTED
    assert flight.run() == ["LIMIT_CLEARED"] * 8 + ["MODE_VALID"] * 8  # though no estimate came


@pytest.mark.requirement("WB-FLT-08")
def test_a_shadow_limit_counts_what_it_would_have_done_and_does_nothing() -> None:
    shadow = [
        limit(d.CMP, 1, low_red=0.7, low_yellow=0.85, high_red=None, response="inhibit", flag="other"),
        limit(d.AGE_TICKS, 2, high_red=7.0, response="invalidate", flag="stale", requires=("frequency_hz",)),
    ]
    flight = Flight([], shadow)
    flight.estimate()
    flight.set(d.CMP, 0.8)
    assert flight.run() == []
    flight.set(d.CMP, 0.3)
    assert flight.run() == ["SHADOW_RED"] and flight.board.get(d.SHADOW_TRIPS) == 1
    assert flight.raised[0].arguments == (d.POINT_NUMBER["cmp"], 0, 0.3, 0.7)
    assert flight.run() == ["SHADOW_RED"] * 3 and flight.board.get(d.SHADOW_TRIPS) == 4
    assert flight.run() == [] and flight.board.get(d.SHADOW_TRIPS) == 4
    flight.set(d.CMP, 0.99)
    assert flight.run() == []
    flight.set(d.CMP, 0.3)
    assert flight.run() == ["SHADOW_RED"] and flight.board.get(d.SHADOW_TRIPS) == 5
    assert flight.valid == [0, 1, 2] and flight.flags[0] is NO_FLAG and flight.mode is FlightMode.TRACK
    assert flight.board.get(d.LIMITS_RED) == 0 and flight.protection.level(1) is Level.GREEN
    assert flight.protection.switch(1, False) is CommandResult.NO_SUCH_ITEM


@pytest.mark.requirement("WB-FLT-13")
def test_with_a_new_table_a_limit_that_stays_the_same_goes_on_where_it_was() -> None:
    same = limit(d.OVERRUN, 1, high_red=0.5, set_after=2, clear_after=9, response="invalidate", flag="late")
    other = limit(d.FREE_WHEEL, 2, high_red=0.5, clear_after=9, response="invalidate", flag="other")
    shadow = limit(d.CMP, 3, high_red=0.5, clear_after=9)
    flight = Flight([same, other], [shadow])
    flight.estimate()
    for point in (d.OVERRUN, d.FREE_WHEEL):
        flight.set(point, 1.0)
    assert flight.run() == ["LIMIT_RED"] + ["MODE_INVALID"] * 3  # the first has one of its two samples
    flight.protection.switch(1, False)
    for point in (d.OVERRUN, d.FREE_WHEEL):
        flight.set(point, 0.4)
    changed = limit(d.FREE_WHEEL, 2, high_red=0.6, clear_after=9, response="invalidate", flag="other")
    flight.protection.renew([changed, same], [shadow])
    assert [flight.protection.level(number) for number in (1, 2)] == [Level.GREEN, Level.GREEN]
    assert flight.run() == ["MODE_VALID"] * 3 and flight.board.get(d.SHADOW_TRIPS) == 1
    flight.set(d.OVERRUN, 1.0)
    assert flight.run(2) == ["LIMIT_RED"] and flight.valid == [0, 1, 2]
    assert flight.board.get(d.LIMITS_DISABLED) == 1
    flight.protection.renew([changed], [])
    flight.run()
    assert flight.board.get(d.LIMITS_DISABLED) == flight.board.get(d.LIMITS_RED) == 0
    assert flight.protection.level(1) is Level.GREEN and flight.protection.clear_fault(1) is CommandResult.NO_SUCH_ITEM
    assert flight.mode is FlightMode.TRACK and flight.protection.good_tick == -4.0
