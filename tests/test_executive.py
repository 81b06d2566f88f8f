"""The executive keeps the schedule, delivers at fixed ticks at any speed, and counts what goes wrong."""

import threading

import pytest
from executive_parts import PERIOD_NS, WAIT_S, Edges, Frame, Long, fly, slot
from hypothesis import given
from hypothesis import strategies as st

from fsw.executive.entry import FrameTask, LongTask
from fsw.executive.executive import Executive
from fsw.executive.schedule import Refusal, check_schedule, hyperperiod, releases
from fsw.tables.flight import TaskSlot, load_flight
from hal.drivers.lockstep_clock import LockstepClock


@pytest.mark.requirement("WB-EXE-01")
def test_tasks_run_at_their_ticks_in_the_order_of_the_table() -> None:
    log: list[tuple[str, int]] = []
    executive = fly([slot("b"), slot("a", 3, 1)], [Frame("a", log), Frame("b", log)], range(5))
    executive.run()
    assert log[:2] == [("b.init", -1), ("a.init", -1)]
    assert log[2:] == [("b", 0), ("b", 1), ("a", 1), ("b", 2), ("b", 3), ("b", 4), ("a", 4)]
    assert (executive.ticks, executive.missed_ticks, executive.overruns) == (5, 0, 0)


@pytest.mark.requirement("WB-EXE-02")
@pytest.mark.parametrize("latency", [0, 1, 2, 3])
@pytest.mark.parametrize("lockstep", [True, False])
def test_a_long_tasks_result_appears_exactly_at_its_tick(latency: int, lockstep: bool) -> None:
    log: list[tuple[str, int]] = []
    long = Long("long", log)
    executive = fly([slot("frame"), slot("long", 3, 1, latency)], [Frame("frame", log), long], range(9), lockstep)
    executive.init()
    while executive.step():
        if latency and not lockstep:  # a machine that is fast enough
            executive._entries["long"].done.wait(WAIT_S)
    executive.close()
    deliveries = [(name, tick) for name, tick in log if "deliver" in name]
    expected = [(f"long.deliver {k}", k + latency) for k in (1, 4, 7) if k + latency < 9]
    assert deliveries == expected
    # Delivered before the frame tasks of that tick, taken in the order of the table.
    if latency == 2:
        assert log.index(("long.deliver 1", 3)) < log.index(("frame", 3))
    assert log.index(("frame", 1)) < log.index(("long.take", 1))
    assert {name for _, name in long.worked} == {f"worker-{long.name}" if latency else "MainThread"}


@pytest.mark.requirement("WB-EXE-02")
def test_lockstep_waits_for_a_slow_worker_and_real_pace_gives_the_same_when_it_keeps_up() -> None:
    def run(lockstep: bool) -> list[tuple[str, int]]:
        log: list[tuple[str, int]] = []
        long = Long("long", log)
        executive = fly([slot("frame"), slot("long", 4, 0, 2)], [Frame("frame", log), long], range(12), lockstep)
        executive.init()
        if lockstep:
            long.hold.clear()
            threading.Timer(0.05, long.hold.set).start()
        while executive.step():
            if not lockstep:
                executive._entries["long"].done.wait(WAIT_S)
        executive.close()
        assert executive.overruns == 0
        return log

    assert run(True) == run(False)


@pytest.mark.requirement("WB-EXE-03")
def test_at_real_pace_a_late_result_is_an_overrun_and_never_used() -> None:
    log: list[tuple[str, int]] = []
    long = Long("long", log)
    executive = fly([slot("long", 3, 0, 2)], [long], range(20), lockstep=False)
    executive.init()
    long.hold.clear()
    for _ in range(4):  # taken at 0, due at 2; busy at 3
        executive.step()
    assert executive.counts("long") == (0, 1, 0, 1)
    assert executive.overruns == 1
    long.hold.set()
    executive._entries["long"].done.wait(WAIT_S)
    for _ in range(3):  # 4, 5, 6: discarded, then taken again
        executive.step()
        executive._entries["long"].done.wait(WAIT_S)
    for _ in range(2):  # 7, 8
        executive.step()
    executive.close()
    assert log == [("long.init", -1), ("long.take", 0), ("long.take", 6), ("long.deliver 6", 8)]
    assert executive.counts("long") == (2, 1, 1, 1)


@pytest.mark.requirement("WB-EXE-11")
def test_missed_edges_are_counted_with_the_releases_lost_and_results_come_at_the_next_tick() -> None:
    log: list[tuple[str, int]] = []
    tasks: list[FrameTask | LongTask] = [Frame("frame", log), Long("long", log)]
    executive = fly([slot("frame", 2), slot("long", 5, 0, 2)], tasks, [0, 1, 6, 7, 7, 6, 8])
    executive.run()
    assert executive.missed_ticks == 4  # 2 to 5
    assert executive.repeated_edges == 2
    assert executive.counts("frame").lost == 2  # 2 and 4
    assert executive.counts("long").lost == 1  # 5
    assert [(n, t) for n, t in log if n.startswith("long.")][1:] == [("long.take", 0), ("long.deliver 0", 6)]


def test_a_long_task_with_nothing_to_do_delivers_nothing() -> None:
    log: list[tuple[str, int]] = []
    executive = fly([slot("long", 2, 0, 1)], [Long("long", log, idle=[0, 4])], range(6))
    executive.run()
    assert [entry for entry in log if "deliver" in entry[0]] == [("long.deliver 2", 3)]
    assert executive.counts("long").runs == 1


def test_an_error_on_the_worker_comes_out_on_the_tick_thread_at_the_delivery() -> None:
    class Broken(Long):
        def work(self) -> None:
            raise ArithmeticError("singular")

    executive = fly([slot("broken", 2, 0, 1)], [Broken("broken", [])], range(6))
    with pytest.raises(ArithmeticError, match="singular"):
        executive.run()
    assert executive.tick == 1
    assert not any(thread.name == "worker-broken" for thread in threading.enumerate())


def test_several_long_tasks_work_side_by_side() -> None:
    log: list[tuple[str, int]] = []
    tasks: list[FrameTask | LongTask] = [Long(name, log) for name in "abc"]
    executive = fly([slot(name, 2, 0, 2) for name in "abc"], tasks, range(5))
    executive.run()
    assert [entry for entry in log if "deliver" in entry[0]] == [
        (f"{name}.deliver {tick}", tick + 2) for tick in (0, 2) for name in "abc"
    ]


def test_a_tick_that_takes_longer_than_a_period_is_an_overrun() -> None:
    clock = LockstepClock()

    class Slow(Frame):
        def run(self, tick: int, time_ns: int) -> None:
            clock.sleep_until_ns(time_ns + (3 * PERIOD_NS if tick == 1 else 1))

    executive = Executive([slot("slow")], {"slow": Slow("slow", [])}, Edges(range(3)), clock, PERIOD_NS)
    executive.run()
    assert executive.overruns == 2  # tick 1, and tick 2, which began late
    assert executive.release_jitter.summary().max_ms == 2.0


def test_a_latency_needs_a_long_task_and_a_task_must_exist() -> None:
    with pytest.raises(ValueError, match="no take, work and deliver"):
        fly([slot("frame", 2, 0, 1)], [Frame("frame", [])], [])
    with pytest.raises(KeyError):
        fly([slot("ghost")], [], [])


def test_times_are_booked_once_a_run() -> None:
    tasks: list[FrameTask | LongTask] = [Frame("frame", []), Long("long", [])]
    executive = fly([slot("frame"), slot("long", 3, 0, 1)], tasks, range(10))
    executive.run()
    assert [executive.timing("frame")[i].runs for i in (0, 1)] == [10, 10]
    assert executive.timing("long")[0].runs == 3  # taken at 0, 3, 6; 9 has no tick to deliver at


@given(st.integers(1, 9), st.integers(0, 8), st.integers(-3, 40), st.integers(0, 40))
def test_releases_counts_ticks_one_by_one(period: int, phase: int, first: int, length: int) -> None:
    row = slot("a", period, phase % period)
    brute = sum(t >= row.phase_ticks and (t - row.phase_ticks) % period == 0 for t in range(first, first + length))
    assert releases(row, first, first + length - 1) == brute


@pytest.mark.requirement("WB-EXE-04")
@pytest.mark.parametrize(
    ("slots", "refusal"),
    [
        ([], Refusal.EMPTY),
        ([slot("x")], Refusal.UNKNOWN_TASK),
        ([slot("a"), slot("a")], Refusal.TASK_TWICE),
        ([slot("a", 0)], Refusal.BAD_PERIOD),
        ([slot("a", 3, 3)], Refusal.BAD_PHASE),
        ([slot("a", 3, -1)], Refusal.BAD_PHASE),
        ([slot("a", 3, 0, 4)], Refusal.BAD_LATENCY),
        ([slot("a", 3, 0, -1)], Refusal.BAD_LATENCY),
        ([slot("a", budget_ms=0.0)], Refusal.BAD_BUDGET),
        ([slot("a", budget_ms=float("nan"))], Refusal.BAD_BUDGET),
        ([slot("a", 59), slot("b", 61), slot("c", 2)], Refusal.HYPERPERIOD),
        ([slot("a", budget_ms=30.0), slot("b", 2, 1, budget_ms=30.0)], Refusal.OVERLOAD),
        ([slot("a", 5, 0, 4, 330.0), slot("b", 5, 0, 4, 120.0)], Refusal.WORKER_OVERLOAD),
        ([slot("b")], Refusal.MISSING_TASK),
        ([slot("a"), slot("c", 4, 0, 2)], Refusal.BAD_LATENCY),
    ],
)
def test_each_reason_to_refuse_a_schedule_has_its_code(slots: list[TaskSlot], refusal: Refusal) -> None:
    required = "a" if refusal is Refusal.MISSING_TASK else ""
    findings = check_schedule(slots, "abc", tick_ms=66.7, required=required, within_tick="c")
    assert {finding.refusal for finding in findings} == {refusal}
    assert all(finding.text for finding in findings)


@pytest.mark.requirement("WB-EXE-04")
def test_load_is_judged_at_the_fullest_tick_and_only_at_real_pace() -> None:
    apart = [slot("a", 2, 0, budget_ms=50.0), slot("b", 2, 1, budget_ms=50.0)]
    together = [slot("a", 2, 0, budget_ms=50.0), slot("b", 2, 0, budget_ms=50.0)]
    assert check_schedule(apart, "ab", 66.7) == []
    assert check_schedule(together, "ab", 66.7) != []
    assert check_schedule(together, "ab") == []


def test_the_shipped_schedule_holds_at_15_fps() -> None:
    schedule = load_flight().schedule
    assert check_schedule(schedule, [row.task for row in schedule], 1000.0 / 15.0) == []
    assert hyperperiod(schedule) == 10
