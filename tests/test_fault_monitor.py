"""The monitor withdraws what may mislead, tells quiet from bad, and says so once."""

from math import nan

import pytest

from fault.limits import Level, Limit
from fault.modes import Cause
from fault.monitor import Monitor, Verdict
from fsw.tables.flight import load_flight
from telemetry import dictionary as d
from telemetry import events
from telemetry.board import Board
from telemetry.dictionary import MODE_SLOTS, FlightMode, ModeFlag

ALL = (True,) * MODE_SLOTS
NONE = (False,) * MODE_SLOTS


def good_board(modes: int = 3) -> Board:
    board = Board()
    for point, value in (
        (d.CMP, 0.995),
        (d.MATCHED, 250.0),
        (d.REPROJECTION_RMS_PX, 0.02),
        (d.EPIPOLAR_RMS_PX, 0.03),
        (d.OBSERVABLE, 1.0),
    ):
        board.set(point, value)
    for slot in range(modes):
        board.set(d.FREQUENCY_HZ, 0.7 * (slot + 1), slot)
        board.set(d.AMPLITUDE_COHERENCE, 0.99, slot)
        board.set(d.AGE_TICKS, 12.0, slot)
    return board


@pytest.fixture
def monitor() -> Monitor:
    return Monitor(load_flight().limit)


def run(monitor: Monitor, board: Board, ticks: int = 1, frame: bool = True, estimate: bool = False) -> list[Verdict]:
    return [monitor.step(board, FlightMode.TRACK, frame, estimate) for _ in range(ticks)]


def names(verdicts: list[Verdict]) -> list[str]:
    return [raised.event.name for verdict in verdicts for raised in verdict.events]


def test_all_good_is_usable_and_silent(monitor: Monitor) -> None:
    verdicts = run(monitor, good_board(), 100, estimate=True)
    assert {verdict.usable for verdict in verdicts} == {ALL}
    assert names(verdicts) == []
    assert verdicts[-1].cause is Cause.LIMITS_CLEAR
    assert set(verdicts[-1].flags) == {ModeFlag(0)}


@pytest.mark.parametrize("mode", [mode for mode in FlightMode if mode is not FlightMode.TRACK])
def test_outside_of_track_nothing_is_usable(monitor: Monitor, mode: FlightMode) -> None:
    assert monitor.step(good_board(), mode, True, True).usable == NONE


@pytest.mark.parametrize(("value", "expected"), [(0.3, "cmp"), (nan, "cmp")])
def test_a_bad_scene_withdraws_all_modes_after_its_persistence_and_returns_them_after_its_own(
    monitor: Monitor, value: float, expected: str
) -> None:
    board = good_board()
    run(monitor, board, estimate=True)
    board.set(d.CMP, value)
    verdicts = run(monitor, board, 3)
    assert [verdict.usable for verdict in verdicts] == [ALL, ALL, NONE]
    assert verdicts[2].cause is Cause.LIMIT_RED
    assert set(verdicts[2].flags) == {ModeFlag.POOR_SCENE}
    (raised,) = verdicts[2].events
    assert raised.event is events.LIMIT_RED
    assert d.POINTS[int(raised.arguments[0])].name == expected
    assert raised.arguments[3] == 0.7
    board.set(d.CMP, 0.995)
    verdicts = run(monitor, board, 15)
    assert [verdict.usable for verdict in verdicts] == [NONE] * 14 + [ALL]
    assert names(verdicts) == ["LIMIT_CLEARED"]


def test_frames_that_do_not_come_neither_trip_nor_clear(monitor: Monitor) -> None:
    board = good_board()
    board.set(d.CMP, 0.3)
    assert names(run(monitor, board, 50, frame=False)) == []
    run(monitor, board, 3)
    board.set(d.CMP, 0.995)
    assert {verdict.usable for verdict in run(monitor, board, 50, frame=False)} == {NONE}


def test_low_coherence_withdraws_its_own_mode_at_once_and_it_must_earn_its_return(monitor: Monitor) -> None:
    board = good_board()
    run(monitor, board, estimate=True)
    board.set(d.AMPLITUDE_COHERENCE, 0.5, 1)
    (verdict,) = run(monitor, board, estimate=True)
    assert verdict.usable == (True, False, *ALL[2:])
    assert verdict.flags[1] is ModeFlag.LOW_COHERENCE and verdict.flags[0] is ModeFlag(0)
    assert verdict.cause is Cause.LIMITS_CLEAR  # the scene is good: the flight mode has no reason to change
    assert verdict.events[0].arguments[1:] == (1.0, 0.5, 0.8)
    board.set(d.AMPLITUDE_COHERENCE, 0.99, 1)
    assert not run(monitor, board, 20, estimate=False)[-1].usable[1]  # the same estimate does not count again
    assert [v.usable[1] for v in run(monitor, board, 2, estimate=True)] == [False, True]


def test_a_quiet_wing_is_not_observable_and_not_bad(monitor: Monitor) -> None:
    board = good_board()
    run(monitor, board, estimate=True)
    board.set(d.OBSERVABLE, 0.0)
    board.set(d.AMPLITUDE_COHERENCE, 0.1, 0)
    verdicts = run(monitor, board, 1, estimate=True) + run(monitor, board, 9)
    assert {verdict.usable for verdict in verdicts} == {NONE}
    assert set(verdicts[-1].flags) == {ModeFlag.NOT_OBSERVABLE}
    assert names(verdicts) == ["NOT_OBSERVABLE"]
    assert monitor.level("amplitude_coherence") is Level.GREEN
    assert verdicts[-1].cause is Cause.LIMITS_CLEAR
    board.set(d.OBSERVABLE, 1.0)
    board.set(d.AMPLITUDE_COHERENCE, 0.99, 0)
    assert names(run(monitor, board, 1, estimate=True)) == ["OBSERVABLE"]


def test_what_was_never_measured_is_not_usable_and_raises_nothing_before_it_is_due(monitor: Monitor) -> None:
    verdicts = run(monitor, Board(), 20, frame=False)
    assert {verdict.usable for verdict in verdicts} == {NONE}
    assert names(verdicts) == []


def test_slots_without_a_mode_raise_nothing(monitor: Monitor) -> None:
    assert names(run(monitor, good_board(modes=1), 5, estimate=True)) == []


def test_an_old_estimate_is_withdrawn_as_stale(monitor: Monitor) -> None:
    board = good_board()
    board.set(d.AGE_TICKS, 76.0, 0)
    (verdict,) = run(monitor, board, frame=False)
    assert verdict.usable == (False, *ALL[1:])
    assert verdict.flags[0] is ModeFlag.STALE


def test_a_limit_that_only_reports_withdraws_nothing() -> None:
    monitor = Monitor([Limit("cmp", "tick", 1, 1, low_red=0.9, low_yellow=0.95)])
    board = good_board()
    board.set(d.CMP, 0.93)
    assert names(run(monitor, board)) == ["LIMIT_YELLOW"]
    board.set(d.CMP, 0.5)
    verdicts = run(monitor, board)
    assert names(verdicts) == ["LIMIT_RED"] and verdicts[0].usable == ALL
    board.set(d.CMP, 0.93)
    assert names(run(monitor, board)) == ["LIMIT_YELLOW"]
    assert monitor.level("cmp") is Level.YELLOW and monitor.level("points") is Level.GREEN
