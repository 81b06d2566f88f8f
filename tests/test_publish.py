"""publish: buses that are off and stores that are full are counted, told and survived."""

import errno
from typing import Any

import numpy as np
import pytest

from fsw.commands.replies import Replies
from fsw.memory.displacements import Displacements
from fsw.memory.ring import Ring
from fsw.tasks.publish import Outlets, Publish
from fsw.tasks.state import Pair, State
from hal.bus import Payload
from telemetry.dictionary import BUS_DROPPED, BUS_ERRORS, DAMPING_RATIO, STORAGE_ERRORS, STORAGE_FAILED
from telemetry.events import EVENT_BY_NUMBER, STARTED


class Off:
    """A bus that may be off, and a stream that may be full."""

    def __init__(self) -> None:
        self.off = False
        self.taken = 0
        self.lines: list[bytes] = []

    def send(self, can_id: int, data: Payload, time_ns: int) -> bool:
        self.taken += not self.off
        return not self.off

    def write(self, data: bytes) -> int:
        if self.off:
            raise OSError(errno.ENOSPC, "no space left on device")
        self.lines.append(data)
        return len(data)


def flight(outlets: Outlets) -> tuple[State, Publish]:
    image = np.zeros((4, 4), np.uint8)
    state = State(None, Pair(image, image), Ring(4, (), np.int64), Displacements(4, 1))  # type: ignore[arg-type]
    publish = Publish(state, outlets, Replies())
    publish.init()
    return state, publish


def run(state: State, publish: Publish, tick: int) -> None:
    state.begin(tick, tick * 10**6)
    publish.run(tick, tick * 10**6)


def told(lines: list[bytes]) -> list[str]:
    return [str(line).split('"name": "')[1].split('"')[0] for line in lines]


@pytest.mark.requirement("WB-TLM-01")
def test_frames_that_a_bus_does_not_take_are_counted_told_and_do_not_come_later() -> None:
    bus, file = Off(), Off()
    events: Any = file
    state, publish = flight(Outlets(bus=bus, events=events))
    run(state, publish, 1)
    sent = bus.taken
    bus.off = True
    run(state, publish, 2)
    lost = state.board.get(BUS_DROPPED)
    assert lost == state.board.get(BUS_ERRORS) == sent > 0
    bus.off = False
    run(state, publish, 3)
    assert told(file.lines) == ["BUS_DROPPED"]
    assert (state.board.get(BUS_ERRORS), state.board.get(BUS_DROPPED)) == (0, lost)
    event_frames = 2 + 5
    assert bus.taken == sent + sent + event_frames


@pytest.mark.requirement("WB-TLM-02")
def test_a_full_store_is_told_once_and_again_when_it_takes_data() -> None:
    file = Off()
    events: Any = file
    state, publish = flight(Outlets(events=events))
    file.off = True
    for tick in range(1, 4):
        state.raise_event(STARTED, 1, 15.0)
        run(state, publish, tick)
        assert state.board.get(STORAGE_FAILED) == 1
    refused = state.board.get(STORAGE_ERRORS)
    assert refused >= 3
    file.off = False
    run(state, publish, 4)
    assert (state.board.get(STORAGE_FAILED), state.board.get(STORAGE_ERRORS)) == (0, refused)
    run(state, publish, 5)
    run(state, publish, 6)
    assert told(file.lines) == ["STORAGE_BACK"]
    assert state.events.suppressed == 0


@pytest.mark.requirement("WB-TLM-03")
def test_values_beyond_their_range_are_told() -> None:
    file = Off()
    events: Any = file
    state, publish = flight(Outlets(events=events))
    state.board.set(DAMPING_RATIO, 7.0)
    for tick in range(10, 16):
        run(state, publish, tick)
    assert set(told(file.lines)) == {"FIELDS_SATURATED"}
    assert EVENT_BY_NUMBER[604].name == "FIELDS_SATURATED"
