"""The task protect follows the protection; the task identify puts on the board what the limits on estimates need."""

import numpy as np
import pytest
from fault_parts import GOOD, limit

from fault.limits import Limit
from fault.modes import Cause
from fault.protection import Protection
from fsw.black_box import BlackBox
from fsw.memory.displacements import Displacements
from fsw.memory.ring import Ring
from fsw.modal.result import ModalResult, Mode, Record
from fsw.run import published_modes
from fsw.tasks.estimate_board import frequency_jump, predecessors, show
from fsw.tasks.protect import Protect
from fsw.tasks.state import NOTHING, Estimate, Pair, State
from telemetry import dictionary as d
from telemetry.dictionary import FlightMode, ModeFlag


def mode(hz: float, sigma_hz: float = 1e-4, flags: tuple[str, ...] = ()) -> Mode:
    return Mode(hz, sigma_hz, 0.005, 1e-4, 5.0, 0.99, 1.0, np.ones(3, np.complex128), not flags, list(flags))


def estimate(tick: int, *modes: Mode, slots: tuple[int, ...] | None = None) -> Estimate:
    result = ModalResult(list(modes), [], Record(10.0, 150, 15.0), "decay")
    return Estimate(result, np.arange(1), tick, tick * 10**6, slots or tuple(range(len(modes))))


def blank_state() -> State:
    image = np.zeros((4, 4), np.uint8)
    state = State(None, Pair(image, image), Ring(4, (), np.int64), Displacements(4, 1))  # type: ignore[arg-type]
    for point, value in GOOD.items():
        state.board.set(point, value)
    return state


def deliver(state: State, new: Estimate) -> None:
    """What identify does at the delivery of an estimate."""
    before, state.estimate, state.new_estimate = state.estimate, new, True
    show(state, new, before)


def protect(state: State, limits: list[Limit]) -> Protect:
    return Protect(state, Protection(limits), BlackBox(limits, (), ticks=3, after_ticks=0))


def run(task: Protect, state: State, tick: int, causes: Cause = NOTHING) -> list[int]:
    state.begin(tick, tick * 10**6)
    state.causes |= causes
    task.run(tick, tick * 10**6)
    state.new_estimate = False
    return [record.number for record in state.take_events()]


def test_the_task_raises_what_the_protection_says_and_tells_mode_and_hold() -> None:
    state = blank_state()
    task = protect(state, [limit(d.CMP, high_red=None, low_red=0.5, response="invalidate")])
    task.init()
    assert state.mode is FlightMode.ACQUIRE and [record.number for record in state.take_events()] == [3]
    assert run(task, state, 0, Cause.LOCK_FOUND) == [3]
    assert state.mode is FlightMode.TRACK and state.causes == NOTHING and state.shown is None
    first = estimate(2, mode(0.7), mode(3.0))
    deliver(state, first)
    assert run(task, state, 5) == [401, 401] and state.shown is first and not state.held
    state.board.set(d.CMP, 0.3)
    assert run(task, state, 6) == [502, 402, 402]


@pytest.mark.requirement("WB-FLT-11")
def test_the_estimate_that_is_shown_is_the_one_on_the_board() -> None:
    state = blank_state()
    task = protect(state, [])
    task.init()
    run(task, state, 0, Cause.LOCK_FOUND)
    bad, good = estimate(2, mode(0.7, flags=("weak",))), estimate(12, mode(0.7))
    deliver(state, bad)
    run(task, state, 5)
    assert state.shown is bad and not state.held
    deliver(state, good)
    run(task, state, 15)
    assert state.shown is good and not state.held
    deliver(state, estimate(22, mode(0.7, flags=("weak",))))
    run(task, state, 25)
    assert state.shown is good and state.held and state.board.get(d.ESTIMATE_TICK) == 12
    run(task, state, 26)
    assert state.shown is good and state.held
    newer = estimate(32, mode(0.71))
    deliver(state, newer)
    run(task, state, 35)
    assert state.shown is newer and not state.held


@pytest.mark.requirement("WB-FLT-14")
@pytest.mark.parametrize(
    ("now", "before", "jump"),
    [
        (mode(1.0), [], 0.0),
        (mode(1.0), [mode(1.0)], 0.0),
        (mode(1.0, 0.0), [mode(0.97, 0.0)], 0.03),
        (mode(1.0, 0.0), [mode(1.03, 0.0)], 0.03),
        (mode(2.0, 0.0), [mode(1.94, 0.0)], 0.03),
        (mode(1.0, 0.003), [mode(0.97, 0.004)], 0.015),
        (mode(1.0, 0.006), [mode(0.97, 0.008)], 0.0),
        (mode(1.0, 0.0), [mode(1.11, 0.0), mode(0.89, 0.0)], 0.0),
        (mode(1.0, 0.0), [mode(0.91, 0.0)], 0.09),
        (mode(1.0, 0.0), [mode(0.95, 0.0), mode(1.02, 0.0)], 0.02),
        (mode(1.0, float("nan")), [mode(0.97, 0.0)], 0.0),
    ],
)
def test_a_jump_is_the_change_that_no_uncertainty_explains(now: Mode, before: list[Mode], jump: float) -> None:
    assert frequency_jump(now, before) == pytest.approx(jump, abs=1e-12)


@pytest.mark.requirement("WB-FLT-14")
def test_the_board_says_how_far_a_mode_jumped_how_sure_it_is_and_what_was_found_against_it() -> None:
    state = blank_state()
    deliver(state, estimate(2, mode(0.7, 0.0), mode(2.0, 0.0, ("weak",))))
    assert [state.board.get(d.FREQUENCY_JUMP, slot) for slot in (0, 1)] == [0.0, 0.0]
    assert state.board.get(d.IDENTIFIED_FLAGS, 0) == 0.0
    assert state.board.get(d.IDENTIFIED_FLAGS, 1) == ModeFlag.WEAK
    deliver(state, estimate(12, mode(0.714, 0.0), mode(2.04, 0.001)))
    jumps = [state.board.get(d.FREQUENCY_JUMP, slot) for slot in range(8)]
    assert jumps[0] == pytest.approx(0.014 / 0.714) and jumps[1] == 0.0  # a flagged mode is no reference
    assert state.board.get(d.FREQUENCY_UNCERTAINTY, 1) == pytest.approx(0.001 / 2.04)
    for point in (d.FREQUENCY_JUMP, d.FREQUENCY_UNCERTAINTY, d.IDENTIFIED_FLAGS):
        assert all(np.isnan(state.board.get(point, slot)) for slot in range(2, 8))
    assert state.shown is state.estimate


@pytest.mark.requirement("WB-FLT-14")
def test_a_jump_is_taken_from_the_mode_that_held_the_slot_or_from_those_that_are_gone() -> None:
    a, b = mode(0.73, 0.0), mode(0.76, 0.0)
    before = estimate(2, a, b, slots=(1, 0))
    after = estimate(12, mode(0.745, 0.0), mode(0.7675, 0.0), slots=(0, 1))  # they crossed
    assert predecessors(0, after, before) == [b] and predecessors(1, after, before) == [a]
    lost = estimate(12, mode(0.75, 0.0), slots=(3,))
    assert predecessors(3, lost, before) == [a, b]  # a new slot is no way round the limit
    assert predecessors(3, estimate(12, b, mode(0.8), slots=(0, 3)), before) == [a]
    doubtful = estimate(2, mode(0.73, flags=("weak",)), b)
    assert predecessors(0, estimate(12, a, b), doubtful) == [] and predecessors(0, before, None) == []


@pytest.mark.requirement("WB-MOD-08")
def test_a_candidate_that_appears_below_and_a_mode_that_is_lost_disturb_no_other_slot() -> None:
    state = blank_state()
    task = protect(state, [])
    task.init()
    run(task, state, 0, Cause.LOCK_FOUND)
    deliver(state, estimate(2, mode(0.7), mode(3.0)))
    assert run(task, state, 5) == [401, 401]
    deliver(state, estimate(12, mode(0.4, flags=("weak",)), mode(0.7), mode(3.0), slots=(2, 0, 1)))
    assert run(task, state, 15) == []
    assert [state.board.get(d.FREQUENCY_HZ, slot) for slot in range(3)] == [0.7, 3.0, 0.4]
    assert [state.board.get(d.AGE_TICKS, slot) for slot in range(3)] == [3, 3, 3]
    assert [sent["valid"] for sent in published_modes(state)["modes"]] == [False, True, True]
    deliver(state, estimate(22, mode(3.0), slots=(1,)))
    assert run(task, state, 25) == [402]
    assert np.isnan(state.board.get(d.FREQUENCY_HZ, 0)) and np.isnan(state.board.get(d.AGE_TICKS, 0))
    assert state.board.get(d.VALID, 1) == 1.0 and state.board.get(d.MODE_COUNT) == 1
