"""The event queue: bounded, told of what it suppresses, and open to critical events at all times."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.tasks.event_queue import PLACES, EventQueue
from telemetry.board import EventRecord
from telemetry.declaration import Event, Severity, Source
from telemetry.events import (
    BUS_DROPPED,
    EVENT_BY_NUMBER,
    EVENTS_SUPPRESSED,
    FRAME_MISSING,
    FRAME_STUCK,
    LIMIT_RED,
    LOCK_LOST,
    TASK_DEAD,
)

RAISED = st.sampled_from([FRAME_MISSING, FRAME_STUCK, BUS_DROPPED, LOCK_LOST, LIMIT_RED, TASK_DEAD])


def taken(queue: EventQueue, tick: int) -> list[EventRecord]:
    return list(queue.take(tick, tick * 1000))


def numbers(records: list[EventRecord]) -> list[int]:
    return [record.number for record in records]


@pytest.mark.requirement("WB-EVT-01")
def test_an_event_comes_out_once_with_its_tick_time_count_and_arguments() -> None:
    queue = EventQueue(5, 10)
    queue.raise_event(FRAME_MISSING, 3, 200, (1.0,))
    queue.raise_event(BUS_DROPPED, 4, 300, (7.0,))
    assert taken(queue, 4) == [
        EventRecord(FRAME_MISSING.number, 3, 200, 1, (1.0,)),
        EventRecord(BUS_DROPPED.number, 4, 300, 2, (7.0,)),
    ]
    assert taken(queue, 4) == [] and queue.raised == 2 and queue.suppressed == 0


@pytest.mark.requirement("WB-EVT-02")
def test_a_source_may_raise_a_burst_and_then_one_every_so_many_ticks() -> None:
    queue = EventQueue(3, 10)
    for _ in range(5):
        queue.raise_event(FRAME_MISSING, 0, 0, (0.0,))
    assert numbers(taken(queue, 0)) == [FRAME_MISSING.number] * 3 and queue.suppressed == 2
    queue.raise_event(FRAME_STUCK, 9, 0, (0.0,))  # another event of the same source, too early
    assert taken(queue, 9) == [] and queue.suppressed == 3
    queue.raise_event(FRAME_STUCK, 10, 0, (0.0,))
    assert numbers(taken(queue, 10)) == [FRAME_STUCK.number]


@pytest.mark.requirement("WB-EVT-02")
def test_one_source_takes_no_tokens_of_another() -> None:
    queue = EventQueue(1, 10)
    for event in (FRAME_MISSING, FRAME_STUCK, BUS_DROPPED):
        queue.raise_event(event, 0, 0, (0.0,))
    assert numbers(taken(queue, 0)) == [FRAME_MISSING.number, BUS_DROPPED.number]


@pytest.mark.requirement("WB-EVT-02")
def test_unused_tokens_do_not_pile_up_beyond_the_burst() -> None:
    queue = EventQueue(2, 1)
    for _ in range(4):
        queue.raise_event(FRAME_MISSING, 1000, 0, (0.0,))
    assert len(queue) == 2


@pytest.mark.requirement("WB-EVT-03")
def test_what_was_suppressed_is_told_when_the_source_may_speak_again() -> None:
    queue = EventQueue(1, 10)
    for _ in range(4):
        queue.raise_event(FRAME_MISSING, 0, 0, (0.0,))
    assert numbers(taken(queue, 9)) == [FRAME_MISSING.number]
    (told,) = taken(queue, 10)
    assert told == EventRecord(EVENTS_SUPPRESSED.number, 10, 10_000, 5, (Source.CAMERA, 3))
    assert taken(queue, 100) == [] and queue.suppressed == 3


@pytest.mark.requirement("WB-EVT-04")
def test_critical_events_are_never_suppressed_nor_displaced() -> None:
    queue = EventQueue(1000, 1)
    for _ in range(PLACES + 10):
        queue.raise_event(FRAME_MISSING, 0, 0, (0.0,))
    for _ in range(100):
        queue.raise_event(LIMIT_RED, 0, 0, (0.0,) * 4)
    out = numbers(taken(queue, 0))
    assert out[:PLACES] == [FRAME_MISSING.number] * PLACES
    assert out[PLACES : PLACES + 100] == [LIMIT_RED.number] * 100
    assert queue.suppressed == 10


@pytest.mark.requirement("WB-EVT-03", "WB-EVT-04")
@given(ticks=st.lists(st.lists(RAISED, max_size=30), max_size=40), burst=st.integers(1, 5), refill=st.integers(1, 8))
def test_everything_raised_is_sent_or_counted_and_all_that_is_critical_is_sent(
    ticks: list[list[Event]], burst: int, refill: int
) -> None:
    queue = EventQueue(burst, refill)
    sent: list[EventRecord] = []
    for tick, events in enumerate(ticks):
        for event in events:
            queue.raise_event(event, tick, 0, ())
        sent += taken(queue, tick)
    told = [record for record in sent if record.number == EVENTS_SUPPRESSED.number]
    assert queue.raised == len(sent) + queue.suppressed
    assert sum(record.arguments[1] for record in told) <= queue.suppressed
    indices = [record.index for record in sent]
    assert indices == sorted(set(indices))
    critical = [e.number for events in ticks for e in events if e.severity is Severity.CRITICAL]
    assert [n for n in numbers(sent) if EVENT_BY_NUMBER[n].severity is Severity.CRITICAL] == critical
