"""The trigger lock: only edges at their time are ticks, ticks go on without them, and the phase is found again."""

from itertools import pairwise

import pytest
from executive_parts import JumpingClock, Line
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fsw.executive.lock import MOST_EDGES, TriggerLock
from fsw.executive.phase_lock import JUMP_PERIODS, MOST_NOTICES, PhaseLock
from hal.drivers.lockstep_clock import LockstepClock
from hal.trigger import Edge

P = 1000  # period, ns
W = 200  # window
WINDOW_SHARE, FREE_WHEEL_AFTER, LOCK_AFTER = 0.2, 2, 5


def lock(clock: LockstepClock, times_ns: list[int]) -> TriggerLock:
    return TriggerLock(Line(clock, times_ns), clock, P, WINDOW_SHARE, FREE_WHEEL_AFTER, LOCK_AFTER)


def listen(times_ns: list[int]) -> tuple[TriggerLock, list[Edge], list[str]]:
    """All ticks of a line with edges at these times, and the names of the events."""
    trigger = lock(LockstepClock(), times_ns)
    ticks = []
    while (edge := trigger.wait()) is not None:
        ticks.append(edge)
    assert trigger.ended and trigger.wait() is None
    return trigger, ticks, [event.name for event, _ in trigger.notices()]


def counts(trigger: TriggerLock) -> tuple[int, int, int, int, int]:
    phase = trigger.phase
    return phase.missing, phase.early, phase.late, phase.double, phase.jumps


def steady(count: int, first: int = 0, phase: int = 0) -> list[int]:
    return [k * P + phase for k in range(first, first + count)]


@pytest.mark.requirement("WB-EXE-05")
def test_each_edge_of_a_steady_line_is_a_tick_with_its_time() -> None:
    trigger, ticks, events = listen(steady(50))
    assert ticks == [Edge(k, k * P) for k in range(50)]
    assert counts(trigger) == (0, 0, 0, 0, 0) and events == [] and not trigger.phase.free


@pytest.mark.requirement("WB-EXE-05")
@given(st.lists(st.integers(-W // 2, W // 2), min_size=2, max_size=40))
def test_jitter_within_the_window_is_no_fault(jitter_ns: list[int]) -> None:
    times = [P + k * P + off for k, off in enumerate(jitter_ns)]
    trigger, ticks, events = listen(times)
    assert [edge.time_ns for edge in ticks] == times
    assert counts(trigger) == (0, 0, 0, 0, 0) and events == []


@pytest.mark.requirement("WB-EXE-05")
@pytest.mark.parametrize(
    ("change", "expected", "event"),
    [
        pytest.param({6: []}, (1, 0, 0, 0, 0), None, id="missing"),
        pytest.param({6: [6 * P - W - 1]}, (1, 1, 0, 0, 0), "EDGE_EARLY", id="early"),
        pytest.param({6: [5 * P + P // 2]}, (1, 1, 0, 0, 0), "EDGE_EARLY", id="half-a-period-early"),
        pytest.param({6: [6 * P + W + 1]}, (1, 0, 1, 0, 0), "EDGE_LATE", id="late"),
        pytest.param({6: [6 * P, 6 * P + W]}, (0, 0, 0, 1, 0), "EDGE_DOUBLE", id="double"),
        pytest.param({6: [6 * P, 6 * P + W + 1]}, (0, 1, 0, 0, 0), "EDGE_EARLY", id="one-too-many"),
        pytest.param({6: [6 * P - W]}, (0, 0, 0, 0, 0), None, id="first-of-the-window"),
        pytest.param({6: [6 * P + W]}, (0, 0, 0, 0, 0), None, id="last-of-the-window"),
    ],
)
def test_one_bad_edge_is_counted_by_its_kind_and_is_no_tick(
    change: dict[int, list[int]], expected: tuple[int, ...], event: str | None
) -> None:
    times = [time for k in range(12) for time in change.get(k, [k * P])]
    trigger, ticks, events = listen(times)
    assert counts(trigger) == expected
    assert events == ([] if event is None else [event])
    bad = change[6][0] if change[6] else 0
    lost = {6} if expected[0] else set()
    assert [edge.tick for edge in ticks] == [k for k in range(12) if k not in lost]
    assert [edge.time_ns for edge in ticks] == [
        bad if k == 6 and abs(bad - 6 * P) <= W else k * P for k in range(12) if k not in lost
    ]
    assert not any(edge.free for edge in ticks)


@pytest.mark.requirement("WB-EXE-05")
def test_the_arguments_of_notices_are_distances_in_microseconds() -> None:
    trigger = lock(LockstepClock(), [0, P, P + 50, 2 * P - 300, 2 * P, 3 * P + 300, 4 * P])
    while trigger.wait() is not None:
        pass
    told = {event.name: arguments for event, arguments in trigger.notices()}
    assert told == {"EDGE_DOUBLE": (0.05,), "EDGE_EARLY": (-0.3,), "EDGE_LATE": (0.3,)}


@pytest.mark.requirement("WB-EXE-06")
def test_after_two_bad_periods_ticks_go_by_the_clock_and_after_five_good_edges_by_the_trigger() -> None:
    trigger, ticks, events = listen([*steady(10), *steady(20, 20)])
    assert [edge.tick for edge in ticks] == [*range(10), *range(12, 40)]
    assert [edge.time_ns for edge in ticks] == [edge.tick * P for edge in ticks]
    # The fifth edge since the gap, number 24, is the first to be trusted again.
    assert [edge.tick for edge in ticks if edge.free] == list(range(12, 24))
    assert events == ["FREE_WHEELING", "TRIGGER_LOCKED"]
    assert counts(trigger) == (2, 0, 0, 0, 0) and trigger.phase.rephased == 0


@pytest.mark.requirement("WB-EXE-06")
def test_one_bad_period_at_a_time_never_ends_the_lock() -> None:
    trigger, ticks, events = listen([k * P for k in range(60) if k % 2 == 0])
    assert trigger.phase.missing == 29 and events == []
    assert not any(edge.free for edge in ticks)


@pytest.mark.requirement("WB-EXE-06")
def test_edges_that_do_not_keep_the_period_are_never_trusted() -> None:
    wrong = [10 * P + k * (P + W + 1) for k in range(40)]
    trigger, ticks, _ = listen([*steady(10), *wrong])
    assert trigger.phase.free and all(edge.free for edge in ticks[11:])


@pytest.mark.requirement("WB-EXE-06")
def test_a_trigger_that_never_comes_is_replaced_by_the_clock_and_followed_when_it_does() -> None:
    _, ticks, events = listen(steady(20, 30))
    assert ticks[0].free and ticks[0].time_ns < 5 * P
    assert events == ["FREE_WHEELING", "TRIGGER_LOCKED"]
    assert not ticks[-1].free and ticks[-1].time_ns == 49 * P


@pytest.mark.requirement("WB-EXE-06")
@pytest.mark.parametrize("phase", [W - 1, W + 1, P // 2 - 1, P // 2 + 1, P - W - 1, P - W + 1])
def test_a_new_phase_is_taken_over_and_told_as_a_jump_beyond_the_window(phase: int) -> None:
    trigger, ticks, events = listen([*steady(10), *steady(30, 15, phase)])
    off = phase if phase <= P // 2 else phase - P
    assert ("CLOCK_JUMP" in events) == (abs(off) > W) == (trigger.phase.rephased == 1)
    assert ticks[-1] == Edge(ticks[-1].tick, 44 * P + phase)
    assert 44 <= ticks[-1].tick <= 45
    since = [b.time_ns - a.time_ns for a, b in pairwise(ticks[12:])]
    assert min(since) >= P // 2 and max(since) < 2 * P


@pytest.mark.requirement("WB-EXE-07")
@pytest.mark.parametrize("jump", [150 * P + 333, -150 * P - 333, (JUMP_PERIODS + 3) * P, -3 * P // 2, -7 * P])
def test_a_jump_of_the_clock_is_told_with_its_size_and_ticks_go_on(jump: int) -> None:
    clock = JumpingClock(9 * P + 100 if jump > 0 else 9 * P + 1, jump)
    line = [clock.mission(time) for time in steady(40)]
    trigger = lock(clock, line)
    ticks = []
    while (edge := trigger.wait()) is not None:
        ticks.append(edge)
    told = [(event.name, arguments) for event, arguments in trigger.notices()]
    assert sorted(told) == [("CLOCK_JUMP", (jump * 1e-6,)), ("FREE_WHEELING", ()), ("TRIGGER_LOCKED", ())]
    assert trigger.phase.jumps == trigger.phase.rephased == 1
    assert [edge.tick for edge in ticks] == list(range(40))
    assert [edge.time_ns for edge in ticks] == line
    assert [edge.tick for edge in ticks if edge.free] == [10, 11, 12, 13]


@pytest.mark.requirement("WB-EXE-07")
def test_ticks_go_on_from_a_jump_of_the_clock_without_any_trigger() -> None:
    clock = JumpingClock(5 * P + 1, 100 * P)
    trigger = lock(clock, [*steady(6), 300 * P])
    edges = [edge for edge in (trigger.wait() for _ in range(12)) if edge is not None]
    assert [edge.tick for edge in edges] == list(range(12))
    assert all(b.time_ns - a.time_ns == P for a, b in pairwise(edges[6:]))
    assert edges[6].free and edges[6].time_ns > 105 * P
    assert trigger.phase.jumps == 0 and trigger.phase.rephased == 1


@pytest.mark.requirement("WB-EXE-07")
def test_edges_that_wait_for_a_slow_reader_are_no_jump() -> None:
    clock = LockstepClock()
    trigger = lock(clock, [*steady(5), *steady(20, 7)])
    for _ in range(5):
        trigger.wait()
    clock.sleep_until_ns(20 * P)
    edges = [edge for edge in (trigger.wait() for _ in range(22)) if edge is not None]
    assert trigger.phase.jumps == 0 and trigger.phase.missing == 2
    assert [edge.time_ns for edge in edges] == [edge.tick * P for edge in edges] and edges[-1].tick == 26


@pytest.mark.requirement("WB-EXE-05")
def test_a_line_in_a_storm_is_read_so_far_and_no_further() -> None:
    storm = [5 * P + k for k in range(250, 250 + 4 * MOST_EDGES)]
    trigger, ticks, _ = listen([*steady(6), *storm, *steady(20, 6)])
    assert trigger.phase.double + trigger.phase.early == pytest.approx(4 * MOST_EDGES, abs=40)
    assert ticks[-1].time_ns == 25 * P
    assert all(b.time_ns > a.time_ns for a, b in pairwise(ticks))


def test_waiting_can_be_limited_like_that_of_any_trigger() -> None:
    clock = LockstepClock()
    trigger = lock(clock, steady(3))
    assert trigger.wait(5) == Edge(0, 0)
    assert trigger.wait(P // 2) is None and clock.now_ns() == P // 2
    assert trigger.wait(P) == Edge(1, P)


def test_notices_that_nobody_takes_are_lost_but_counted() -> None:
    trigger, _, events = listen([time for k in range(40) for time in (k * P, k * P + 10)])
    assert trigger.phase.double == 40 and len(events) == MOST_NOTICES


KINDS = st.sampled_from(["good", "good", "good", "good", "missing", "early", "late", "double", "noise"])


def edges_of(kinds: list[str], noise: list[int]) -> list[int]:
    times = set()
    for k, kind in enumerate(kinds):
        at = k * P
        if kind in ("good", "double", "noise"):
            times.add(at)
        times |= {
            "early": {at - 300},
            "late": {at + 300},
            "double": {at + 20},
            "noise": {at + noise[k % len(noise)]},
        }.get(kind, set())
    return sorted(time for time in times if time >= 0)


@pytest.mark.requirement("WB-EXE-08")
@settings(max_examples=300, deadline=None)
@given(st.lists(KINDS, max_size=40), st.lists(st.integers(0, P - 1), min_size=1, max_size=5))
@example(["good", "late", "late", "late", "late", "late", "late"], [0])
def test_whatever_comes_ticks_count_periods_and_the_lock_is_found_again(kinds: list[str], noise: list[int]) -> None:
    calm = 2 * LOCK_AFTER + FREE_WHEEL_AFTER
    trigger, ticks, _ = listen([*edges_of(["good", *kinds], noise), *steady(calm, len(kinds) + 2)])
    pairs = list(pairwise(ticks))
    assert all(b.time_ns - a.time_ns >= P // 2 for a, b in pairs)
    for a, b in pairs:  # a tick a period, give or take a change of phase
        assert abs((b.time_ns - a.time_ns) - (b.tick - a.tick) * P) <= P // 2
        assert b.tick > a.tick
    assert not trigger.phase.free
    last = len(kinds) + 1 + calm
    assert [edge.time_ns for edge in ticks[-LOCK_AFTER:]] == [k * P for k in range(last - LOCK_AFTER + 1, last + 1)]
    assert sum(b.tick - a.tick - 1 for a, b in pairs) == trigger.phase.missing


@pytest.mark.requirement("WB-EXE-08")
@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(-50 * P, 50 * P)), max_size=80))
def test_no_sequence_of_times_stops_the_ticks_or_turns_them_back(steps: list[tuple[bool, int]]) -> None:
    core = PhaseLock(P, WINDOW_SHARE, FREE_WHEEL_AFTER, LOCK_AFTER)
    core.begin(0)
    tick, now = -1, 0
    for is_edge, off in steps:
        now = max(0, now + off) if is_edge else core.deadline_ns + max(0, off)
        made = core.edge(min(now, core.deadline_ns)) if is_edge else core.nothing(now)
        if made is not None:
            assert made.tick > tick
            tick = made.tick
    # A steady line is followed again, wherever it begins.
    start = core.deadline_ns - P
    ticks = []
    for k in range(LOCK_AFTER + FREE_WHEEL_AFTER + 4):
        time = start + k * P + 7
        while core.deadline_ns < time:
            ticks.append(core.nothing(core.deadline_ns))
        ticks.append(core.edge(time))
    assert not core.free and ticks[-1] is not None and not ticks[-1].free
