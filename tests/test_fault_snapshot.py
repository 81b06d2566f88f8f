"""A protection can be saved at any tick and taken up again: the same inputs give the same board and events."""

from dataclasses import dataclass
from math import isnan, nan

import numpy as np
import pytest
from fault_parts import GOOD, NOTHING, limit, put_estimate
from hypothesis import given, settings
from hypothesis import strategies as st

from fault.fmea import shipped_limits
from fault.limits import Limit
from fault.modes import Cause
from fault.protection import Protection
from telemetry import dictionary as d
from telemetry.board import Board
from telemetry.declaration import Point
from telemetry.dictionary import CommandResult, ModeFlag

SCENE = (d.CMP, d.MATCHED, d.OVERRUN, d.FREE_WHEEL, d.POOL_VIOLATIONS, d.TABLES_CORRUPT, d.ILLUMINATED)
LIMITS = [
    *shipped_limits(),
    limit(d.TABLES_CORRUPT, 1, high_red=0.5, response="inhibit"),
    limit(d.CMP, 2, high_red=None, low_red=0.5, latch="latched", response="degrade", set_after=2, flag="other"),
]
SHADOW = [limit(d.CMP, 1, high_red=None, low_red=0.9), limit(d.AGE_TICKS, 2, high_red=8.0, response="inhibit")]


@dataclass(frozen=True)
class Inputs:
    """What a tick brings: changed points, causes, a command, and what is new."""

    points: dict[Point, float]
    causes: Cause
    command: tuple[str, int] | None
    new_frame: bool
    new_estimate: bool
    identified: int
    modes: int


INPUTS = st.builds(
    Inputs,
    st.dictionaries(st.sampled_from(SCENE), st.sampled_from([0.0, 0.6, 1.0, 30.0, nan]), max_size=3),
    st.sampled_from([NOTHING, Cause.LOCK_FOUND, Cause.LOCK_LOST, Cause.FRAMES_GONE, Cause.FRAMES_BACK, Cause.ENABLE]),
    st.none() | st.tuples(st.sampled_from(["clear", "on", "off"]), st.sampled_from([1, 2, 111, 311, 381, 999])),
    st.booleans(),
    st.booleans(),
    st.sampled_from([0, 0, int(ModeFlag.WEAK)]),
    st.integers(0, 4),
)


def begun(limits: list[Limit], shadow: list[Limit]) -> tuple[Protection, Board]:
    board, protection = Board(), Protection(limits, shadow)
    for point, value in GOOD.items():
        board.set(point, value)
    protection.begin(board)
    protection.step(board, 0, Cause.LOCK_FOUND, True, False)
    return protection, board


def take(protection: Protection, board: Board, tick: int, inputs: Inputs) -> list[tuple[int, str]]:
    """One tick with these inputs; gives its events, NaN made comparable."""
    for point, value in inputs.points.items():
        board.set(point, value)
    if inputs.new_estimate:
        put_estimate(board, tick - 3, inputs.modes, inputs.identified)
        board.set(d.AMPLITUDE_COHERENCE, 0.5 if inputs.modes == 3 else 0.99, 1 if inputs.modes > 1 else 0)
    if inputs.command is not None:
        verb, number = inputs.command
        if verb == "clear":
            protection.clear_fault(number)
        else:
            protection.switch(number, verb == "on")
    raised = protection.step(board, tick, inputs.causes, inputs.new_frame, inputs.new_estimate)
    return [(event.number, repr(arguments)) for event, arguments in raised]


@pytest.mark.requirement("WB-FLT-10")
@settings(max_examples=150, deadline=None)
@given(st.lists(INPUTS, min_size=1, max_size=40), st.data())
def test_from_any_tick_the_saved_state_and_the_same_inputs_give_the_same_decisions(
    flight: list[Inputs], data: st.DataObject
) -> None:
    protection, board = begun(LIMITS, SHADOW)
    cut = data.draw(st.integers(0, len(flight) - 1))
    for tick, inputs in enumerate(flight[:cut]):
        take(protection, board, tick, inputs)
    saved = np.full(protection.size, 7.0)
    protection.save(saved)
    other, other_board = Protection(LIMITS, SHADOW), Board()
    other.restore(saved)
    other_board.values[:] = board.values
    for tick, inputs in enumerate(flight[cut:], cut):
        assert take(protection, board, tick, inputs) == take(other, other_board, tick, inputs)
        assert board.values.tobytes() == other_board.values.tobytes()
        assert (other.mode, other.held) == (protection.mode, protection.held)
    states = np.zeros((2, protection.size))
    protection.save(states[0])
    other.save(states[1])
    assert states[0].tobytes() == states[1].tobytes()


@pytest.mark.requirement("WB-FLT-08")
@settings(max_examples=100, deadline=None)
@given(st.lists(INPUTS, min_size=1, max_size=40))
def test_shadow_limits_change_no_decision(flight: list[Inputs]) -> None:
    alone, board = begun(LIMITS, [])
    watched, watched_board = begun(LIMITS, SHADOW)
    for tick, inputs in enumerate(flight):
        raised = take(watched, watched_board, tick, inputs)
        assert take(alone, board, tick, inputs) == [event for event in raised if event[0] != 504]
        assert (watched.mode, watched.held) == (alone.mode, alone.held)
    watched_board.set(d.SHADOW_TRIPS, 0)
    assert watched_board.values.tobytes() == board.values.tobytes()


@pytest.mark.requirement("WB-FLT-06")
@settings(max_examples=100, deadline=None)
@given(st.lists(INPUTS, min_size=1, max_size=40))
def test_what_is_valid_is_tracked_observable_unflagged_and_newest(flight: list[Inputs]) -> None:
    protection, board = begun(LIMITS, [])
    for tick, inputs in enumerate(flight):
        take(protection, board, tick, inputs)
        valid = [slot for slot in range(d.MODE_SLOTS) if board.get(d.VALID, slot) == 1.0]
        assert board.get(d.VALIDITY) == float(bool(valid))
        for slot in valid:
            assert protection.mode is d.FlightMode.TRACK and not protection.held
            assert board.get(d.OBSERVABLE) == 1.0 and board.get(d.IDENTIFIED_FLAGS, slot) == 0.0
            assert board.get(d.FLAGS, slot) == 0.0 and not isnan(board.get(d.FREQUENCY_HZ, slot))
            assert board.get(d.AGE_TICKS, slot) <= 75


def test_the_state_says_what_it_holds() -> None:
    rule = limit(d.CMP, 1, low_yellow=0.9, low_red=0.5, high_red=None, set_after=2, clear_after=4)
    protection, board = begun([rule, limit(d.AGE_TICKS, 2, high_red=100.0, requires=("frequency_hz",))], [rule])
    assert protection.size == 3 + 5 + 9 * 8 + (2 + 6) + (2 + 48) + (2 + 6)
    state = np.full(protection.size, 7.0)
    protection.save(state)
    assert state[:2].tolist() == [d.FlightMode.TRACK, 0.0] and np.isnan(state[2:80]).all()
    assert not state[80:].any()
    put_estimate(board, 1)
    board.set(d.CMP, 0.6)
    protection.switch(2, False)
    protection.step(board, 4, NOTHING, True, True)
    protection.step(board, 5, NOTHING, True, False)
    protection.clear_fault(2)
    protection.save(state)
    assert state[2] == 1.0 and state[3:6].tolist() == [1.0, 1000.0, 3.0]
    assert state[80:90].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]
    assert state[138:].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.requirement("WB-FLT-10")
def test_a_run_of_good_samples_and_a_granted_clearing_are_taken_up_where_they_were() -> None:
    rule = limit(d.CMP, 1, low_red=0.5, high_red=None, clear_after=3, latch="latched")
    protection, board = begun([rule], [])
    state = np.zeros(protection.size)

    def go_on(value: float) -> list[str]:
        nonlocal protection
        protection.save(state)
        protection = Protection([rule])
        protection.restore(state)
        board.set(d.CMP, value)
        return [event.name for event, _ in protection.step(board, 1, NOTHING, True, False)]

    assert go_on(0.1) == ["LIMIT_RED"]
    for _ in range(3):
        assert protection.clear_fault(1) is CommandResult.CAUSE_PRESENT
        assert go_on(0.9) == []
    assert protection.clear_fault(1) is CommandResult.ACCEPTED
    assert go_on(0.9) == ["LIMIT_CLEARED"] and go_on(0.9) == []
    assert protection.save(state) is None and not state[-8:].any()
