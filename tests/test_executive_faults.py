"""Overruns, catching up, tasks that fail or are switched off, schedules that change, counters: exact, and in time."""

import threading

import pytest
from executive_parts import PERIOD_NS, WAIT_S, Busy, Frame, Long, fly, slot
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.executive.entry import Entry, TaskCounts
from hal.drivers.lockstep_clock import LockstepClock
from wingbeat.errors import InputError

P = PERIOD_NS


@pytest.mark.requirement("WB-EXE-09")
def test_the_task_that_crosses_the_end_of_its_tick_is_named_in_that_tick_with_its_lateness() -> None:
    clock, told = LockstepClock(), []
    tasks = [Busy("a", clock, {3: P // 2}), Busy("b", clock, {3: P}), Busy("c", clock, {3: 5})]
    executive = fly(
        [slot(name) for name in "abc"], tasks, range(8), clock=clock,
        on_overrun=lambda task, late_ns: told.append((task, late_ns, executive.tick)),
    )  # fmt: skip
    executive.run()
    assert told == [("b", P // 2, 3)]  # once a tick, and the next one, released late, ends in time
    assert [executive.counts(name).overruns for name in "abc"] == [0, 1, 0] and executive.overruns == 1


@pytest.mark.requirement("WB-EXE-09")
def test_a_tick_that_ends_exactly_in_time_is_no_overrun() -> None:
    clock = LockstepClock()
    executive = fly([slot("a")], [Busy("a", clock, {}, P)], range(5), clock=clock)
    executive.run()
    assert executive.overruns == 0


@pytest.mark.requirement("WB-EXE-09")
def test_a_delivery_may_cross_the_end_of_the_tick_too() -> None:
    clock, told = LockstepClock(), []

    class Slow(Long):
        def deliver(self, tick: int) -> None:
            clock.sleep_until_ns(clock.now_ns() + 2 * P)

    executive = fly(
        [slot("frame"), slot("long", 10, 0, 2)], [Busy("frame", clock, {}), Slow("long", [])], range(6), clock=clock,
        on_overrun=lambda task, late_ns: told.append((task, late_ns, executive.tick)),
    )  # fmt: skip
    executive.run()
    assert told[0] == ("long", P, 2)


@pytest.mark.requirement("WB-EXE-03")
def test_a_long_task_that_is_not_done_is_told_at_its_delivery() -> None:
    told: list[tuple[str, int]] = []
    long = Long("long", [])
    executive = fly([slot("long", 3, 0, 2)], [long], range(20), False, on_overrun=lambda *args: told.append(args))
    executive.init()
    long.hold.clear()
    for _ in range(3):
        executive.step()
    long.hold.set()
    executive.close()
    assert told == [("long", 0)]


@pytest.mark.requirement("WB-EXE-10")
@pytest.mark.parametrize(
    ("hang", "catch_up", "ran"),
    [
        (2 * P, 2, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
        (3 * P + 1, 2, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
        (4 * P, 2, [0, 1, 3, 4, 5, 6, 7, 8, 9]),
        (6 * P + 1, 2, [0, 1, 5, 6, 7, 8, 9]),
        (6 * P + 1, 0, [0, 1, 7, 8, 9]),
        (6 * P + 1, 9, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
    ],
)
def test_at_most_so_many_late_ticks_are_made_up_for_and_the_rest_is_skipped(
    hang: int, catch_up: int, ran: list[int]
) -> None:
    clock = LockstepClock()
    busy, half = Busy("busy", clock, {1: hang}), Busy("half", clock, {})
    executive = fly(
        [slot("busy"), slot("half", 2)], [busy, half], range(10), clock=clock, catch_up_ticks=catch_up
    )  # fmt: skip
    executive.run()
    assert busy.ticks == ran
    assert half.ticks == [tick for tick in ran if tick % 2 == 0]
    skipped = set(range(10)) - set(ran)
    assert (executive.skipped_ticks, executive.missed_ticks, executive.ticks) == (len(skipped), 0, len(ran))
    assert executive.counts("busy").lost == len(skipped)
    assert executive.counts("half").lost == sum(tick % 2 == 0 for tick in skipped)
    assert executive.lost == executive.counts("busy").lost + executive.counts("half").lost


@pytest.mark.requirement("WB-EXE-10")
def test_a_line_that_ends_while_ticks_are_skipped_ends_the_run() -> None:
    clock = LockstepClock()
    busy = Busy("busy", clock, {1: 50 * P})
    executive = fly([slot("busy")], [busy], range(5), clock=clock)
    executive.run()
    assert busy.ticks == [0, 1] and executive.skipped_ticks == 3


ROWS = st.lists(
    st.integers(1, 4).flatmap(lambda period: st.tuples(st.just(period), st.integers(0, period - 1))),
    min_size=1,
    max_size=3,
)
TIMES = st.lists(st.sampled_from([0, 0, 0, P // 3, P, 5 * P // 2, 7 * P]), min_size=1, max_size=7)


@pytest.mark.requirement("WB-EXE-11")
@settings(max_examples=200, deadline=None)
@given(ROWS, TIMES, st.sets(st.integers(0, 39)), st.integers(0, 3))
def test_runs_overruns_and_lost_releases_are_those_counted_one_by_one(
    rows: list[tuple[int, int]], takes: list[int], gaps: set[int], catch_up: int
) -> None:
    present = [tick for tick in range(40) if tick not in gaps]
    clock = LockstepClock()
    names = [f"task{i}" for i in range(len(rows))]
    spent = [{tick: takes[(tick + i) % len(takes)] for tick in range(40)} for i in range(len(rows))]
    tasks = [Busy(name, clock, spent[i]) for i, name in enumerate(names)]
    slots = [slot(name, period, phase) for name, (period, phase) in zip(names, rows, strict=True)]
    executive = fly(slots, tasks, present, clock=clock, catch_up_ticks=catch_up)
    executive.run()

    # The same by hand: each tick of the line in turn, then each task, with a time of its own.
    now, ran, overruns = 0, [], dict.fromkeys(names, 0)
    for tick in present:
        now = max(now, tick * P)
        if (now - tick * P) // P > catch_up:
            continue
        ran.append(tick)
        crossed = False
        for i, (period, phase) in enumerate(rows):
            if tick % period == phase:
                now += spent[i][tick]
                if now > (tick + 1) * P and not crossed:
                    crossed = True
                    overruns[names[i]] += 1
    last = max(present, default=-1)
    for name, (period, phase) in zip(names, rows, strict=True):
        turns = [tick for tick in range(last + 1) if tick % period == phase]
        runs = [tick for tick in turns if tick in ran]
        assert executive.counts(name) == TaskCounts(len(runs), overruns[name], 0, len(turns) - len(runs))
    assert executive.ticks == len(ran)
    assert executive.skipped_ticks == len(present) - len(ran)
    assert executive.missed_ticks == last + 1 - len(present)


@pytest.mark.requirement("WB-EXE-12")
def test_cpu_time_and_release_jitter_are_kept_for_each_task_and_can_be_reset() -> None:
    clock = LockstepClock()
    tasks = [Busy("a", clock, {}, P // 4), Busy("b", clock, {})]
    executive = fly([slot("a"), slot("b", 2)], tasks, range(8), clock=clock)
    executive.run()
    first, second = executive.diagnostics("a"), executive.diagnostics("b")
    assert (first.runs, first.overruns, first.over_budget, first.lost) == (8, 0, 0, 0)
    assert 0.0 <= first.min_ms <= first.mean_ms <= first.max_ms and sum(first.bins) == 8 == sum(first.jitter_bins)
    assert (first.jitter_ms, second.jitter_ms) == (0.0, 0.25)
    assert first.jitter_bins[0] == 8 and second.jitter_bins[2] == 4  # bins of an eighth of the period
    executive.missed_ticks = executive.skipped_ticks = 3
    executive.reset()
    again = executive.diagnostics("a")
    assert (again.runs, sum(again.bins), sum(again.jitter_bins)) == (0, 0, 0) and again.max_ms != again.max_ms
    assert executive.counts("a") == TaskCounts(0, 0, 0, 0)
    assert (executive.missed_ticks, executive.skipped_ticks, executive.release_jitter.runs) == (0, 0, 0)
    assert (executive.tick, executive.ticks) == (7, 8)


class Failing(Frame):
    def __init__(self, name: str, error: BaseException) -> None:
        super().__init__(name, [])
        self.error = error

    def run(self, tick: int, time_ns: int) -> None:
        super().run(tick, time_ns)
        if tick == 2:
            raise self.error


@pytest.mark.requirement("WB-EXE-13")
def test_a_task_that_fails_is_told_and_released_no_more_and_the_others_go_on() -> None:
    told: list[tuple[str, str, int]] = []
    failing, other = Failing("a", ArithmeticError("singular")), Frame("b", [])
    executive = fly(
        [slot("a"), slot("b")], [failing, other], range(6),
        on_failure=lambda task, error: told.append((task, str(error), executive.tick)),
    )  # fmt: skip
    executive.run()
    assert told == [("a", "singular", 2)]
    assert [tick for _, tick in failing.log] == [-1, 0, 1, 2] and [tick for _, tick in other.log] == [-1, *range(6)]
    assert executive.counts("a") == TaskCounts(2, 0, 0, 3)
    assert executive.switch("a", True)  # the ground may try again
    assert not executive.scheduled[0].failed


@pytest.mark.requirement("WB-EXE-13")
@pytest.mark.parametrize("latency", [0, 1])
def test_a_failure_of_a_long_task_is_told_at_its_delivery(latency: int) -> None:
    class Broken(Long):
        def work(self) -> None:
            raise ArithmeticError("singular")

    told: list[tuple[str, int]] = []
    executive = fly(
        [slot("long", 2, 0, latency)], [Broken("long", [])], range(6),
        on_failure=lambda task, error: told.append((task, executive.tick)),
    )  # fmt: skip
    executive.run()
    assert told == [("long", latency)]
    assert executive.counts("long") == TaskCounts(0, 0, 0, 2)


@pytest.mark.requirement("WB-EXE-13")
def test_a_bad_input_file_and_the_users_interrupt_end_the_run() -> None:
    for error in (InputError("is no image", "frame.png", "supply one"), KeyboardInterrupt()):
        executive = fly(
            [slot("a")], [Failing("a", error)], range(6), on_failure=lambda task, error: pytest.fail("told")
        )
        with pytest.raises(type(error)):
            executive.run()


@pytest.mark.requirement("WB-EXE-14")
def test_a_new_schedule_holds_from_the_next_tick_and_work_under_way_ends_as_planned() -> None:
    log: list[tuple[str, int]] = []
    tasks = [Frame("a", log), Frame("b", log), Long("long", log)]
    executive = fly([slot("a"), slot("long", 4, 0, 3)], tasks, range(12))
    executive.init()
    assert ("b.init", -1) in log  # a task that is not scheduled yet is made ready too
    for _ in range(2):
        executive.step()
    assert [executive.hyperperiod_ends(tick) for tick in range(5)] == [False, False, False, True, False]
    executive.apply([slot("b", 2), slot("a", 2, 1), slot("long", 2, 0, 1, 9.0)])
    assert executive.tasks == ("b", "a", "long")
    assert executive.hyperperiod_ends(1) and not executive.hyperperiod_ends(2)
    del log[:]
    while executive.step():
        pass
    executive.close()
    assert [entry for entry in log if entry[0] in "ab"] == [("b" if k % 2 == 0 else "a", k) for k in range(2, 12)]
    assert [entry for entry in log if "long" in entry[0]][:4] == [
        ("long.deliver 0", 3),  # as planned under the old schedule; busy at 2
        ("long.take", 4),
        ("long.deliver 4", 5),
        ("long.take", 6),
    ]
    assert executive.counts("long").lost == 1


@pytest.mark.requirement("WB-EXE-14")
def test_statistics_go_on_under_a_new_schedule_unless_the_budget_changes() -> None:
    executive = fly([slot("a"), slot("b")], [Frame("a", []), Frame("b", [])], range(10))
    executive.init()
    for _ in range(4):
        executive.step()
    executive.apply([slot("a", 2), slot("b", budget_ms=2.0)])
    assert [executive.timing(name)[0].runs for name in "ab"] == [4, 0]
    assert executive.counts("b").runs == 4
    executive.close()


@pytest.mark.requirement("WB-EXE-14")
def test_a_task_that_cannot_work_beside_the_ticks_gets_no_latency() -> None:
    executive = fly([slot("a")], [Frame("a", [])], range(3))
    with pytest.raises(ValueError, match="no take, work and deliver"):
        executive.apply([slot("a", 2, 0, 1)])


@pytest.mark.requirement("WB-EXE-15")
def test_a_task_that_is_switched_off_is_not_released_and_loses_nothing() -> None:
    log: list[tuple[str, int]] = []
    long = Long("long", log)
    executive = fly([slot("a"), slot("long", 3, 0, 2)], [Frame("a", log), long, Frame("c", [])], [0, 1, 2, 5, 6, 7, 8])
    executive.init()
    executive.step()
    assert executive.switch("a", False) and executive.switch("long", False)
    assert not executive.switch("c", False) and not executive.switch("ghost", True)
    for _ in range(4):  # 1, 2, 5, 6
        executive.step()
    assert executive.switch("a", True)
    while executive.step():
        pass
    executive.close()
    assert [tick for name, tick in log if name == "a"] == [0, 7, 8]
    assert ("long.deliver 0", 2) in log and ("long.take", 3) not in log
    assert (executive.counts("a").lost, executive.counts("long").lost) == (0, 0)


@pytest.mark.requirement("WB-HLT-01")
def test_a_run_that_is_done_answers_the_challenge_and_one_that_hangs_does_not() -> None:
    hangs = True

    def patience(entry: Entry) -> bool:
        return not hangs and entry.done.wait(WAIT_S)

    tasks = [Frame("a", []), Long("idle", [], idle=range(20)), Long("long", [])]
    executive = fly(
        [slot("a"), slot("idle", 2, 0, 1), slot("long", 3, 0, 2)], tasks, range(20), patience=patience
    )  # fmt: skip
    executive.init()
    for entry in executive.scheduled:
        entry.challenge = 77
    for _ in range(9):
        executive.step()
    assert [entry.answer for entry in executive.scheduled] == [77, 77, 0]
    assert [entry.progress for entry in executive.scheduled] == [9, 5, 0]
    assert executive.counts("long") == TaskCounts(0, 1, 0, 2)
    hangs = False
    executive.step()
    assert executive.scheduled[2].answer == 77 and executive.counts("long") == TaskCounts(1, 1, 1, 2)
    executive.close()


@pytest.mark.requirement("WB-HLT-07")
def test_closing_does_not_wait_for_a_worker_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsw.executive.executive.CLOSE_S", 0.05)
    long = Long("hangs", [])
    long.hold.clear()
    executive = fly([slot("hangs", 3, 0, 2)], [long], range(3), patience=lambda entry: False)
    executive.run()
    left = [thread for thread in threading.enumerate() if thread.name == "worker-hangs"]
    assert len(left) == 1 and left[0].daemon
    long.hold.set()
    left[0].join()
