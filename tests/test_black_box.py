"""The black box: what protection decided is kept, frozen at a trip, written, and decided again to the bit."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from fault_parts import GOOD, limit
from flight_parts import Footage, flying, shipped, small
from typer.testing import CliRunner

from fault.limits import Limit
from fault.modes import Cause
from fault.protection import Protection
from fsw.black_box import BlackBox
from fsw.black_box_replay import DECISIONS, replay_black_box
from fsw.tasks.black_box import WriteBlackBox
from hal.store import FileStore
from telemetry.black_box_file import read_black_box, write_black_box
from telemetry.board import Board
from telemetry.declaration import Event
from telemetry.dictionary import CMP, FREQUENCY_HZ, MODE, MODE_SLOTS, TICKS
from wingbeat.cli import app
from wingbeat.errors import InputError

LIMITS = [
    limit(CMP, number=1, high_red=None, low_red=0.5, response="degrade", set_after=2),
    limit(FREQUENCY_HZ, number=2, high_yellow=5.0, high_red=6.0, response="invalidate"),
]
SHADOW = [limit(CMP, number=3, high_red=None, low_red=0.8, response="degrade")]


class Flight:
    """Protection over a board that wanders, with a black box beside it."""

    def __init__(self, ticks: int = 20, after_ticks: int = 3, seed: int = 1) -> None:
        self.protection = Protection(LIMITS, SHADOW)
        self.box = BlackBox(LIMITS, SHADOW, ticks, after_ticks, ("protect",), lambda task: 0.25)
        self.board, self.draw, self.tick = Board(), np.random.default_rng(seed), 0
        for point, value in GOOD.items():
            self.board.set(point, value)
        self.protection.begin(self.board)

    def fly(self, ticks: int, cmp: float | None = None) -> None:
        for _ in range(ticks):
            self.tick += 1
            self.board.set(CMP, self.draw.uniform(0.6, 1.0) if cmp is None else cmp)
            for slot in range(MODE_SLOTS):
                self.board.set(FREQUENCY_HZ, self.draw.uniform(4.0, 5.2), slot)
            causes = Cause.LOCK_FOUND if self.tick == 2 else Cause(0)
            self.decide(causes, self.tick % 5 == 0)

    def decide(self, causes: Cause, new_estimate: bool) -> None:
        board, protection = self.board, self.protection
        self.box.before(self.tick, self.tick * 10**6, board, causes, True, new_estimate, protection)
        events = protection.step(board, self.tick, causes, True, new_estimate)
        if any(raised.event.severity == 3 for raised in events):
            self.box.trip()
        self.box.after(board, events)


def written(folder: Path, flight: Flight) -> tuple[Path, list[tuple[Event, tuple[float, ...]]]]:
    told: list[tuple[Event, tuple[float, ...]]] = []
    writer = WriteBlackBox(flight.box, FileStore(folder), 2, lambda event, *arguments: told.append((event, arguments)))
    writer.init()
    assert writer.take(flight.tick)
    writer.work()
    writer.deliver(flight.tick + 15)
    return folder / "black_box_001.mcap", told


@pytest.mark.requirement("WB-BOX-01")
def test_a_trip_freezes_the_last_ticks_and_so_many_after_it_while_the_ring_goes_on() -> None:
    flight = Flight()
    flight.fly(30)
    assert flight.box.frozen is None
    flight.box.trip()
    flight.fly(3)
    assert flight.box.frozen is None
    flight.fly(1)
    frozen = flight.box.frozen
    assert frozen is not None
    assert frozen.rows["tick"].tolist() == list(range(15, 35))
    assert frozen.trip_tick == 31
    kept = frozen.rows.copy()
    flight.fly(40)
    assert frozen.rows.tobytes() == kept.tobytes()
    assert len(flight.box) == flight.box.places == 20


@pytest.mark.requirement("WB-BOX-02")
def test_the_decisions_of_a_written_box_come_out_again_to_the_bit(tmp_path: Path) -> None:
    flight = Flight(ticks=40)
    flight.fly(20)
    flight.protection.switch(2, False)
    flight.fly(3)
    flight.fly(4, cmp=0.2)
    flight.protection.switch(2, True)
    flight.protection.clear_fault(1)
    flight.fly(3)
    flight.box.finish()
    path, told = written(tmp_path, flight)
    assert [event.name for event, _ in told] == ["BLACK_BOX_FROZEN", "BLACK_BOX_WRITTEN"]
    replayed = replay_black_box(path, tmp_path / "again")
    assert replayed.difference == ""
    assert len((tmp_path / "again" / DECISIONS).read_text().splitlines()) == len(replayed.decisions) >= 20
    assert any(event["name"] == "LIMIT_RED" for made in replayed.decisions for event in made["events"])
    result = CliRunner().invoke(app, ["replay", str(path)])
    assert result.exit_code == 0 and "every decision reproduced" in result.stdout


@pytest.mark.requirement("WB-BOX-02")
def test_a_decision_that_was_changed_is_named_by_its_tick_and_point(tmp_path: Path) -> None:
    flight = Flight()
    flight.fly(10)
    flight.fly(5, cmp=0.2)
    flight.box.finish()
    path, _ = written(tmp_path, flight)
    header, rows = read_black_box(path)
    changed = rows.copy()
    place = int(np.flatnonzero(changed["after"][7] == changed["after"][7])[0])
    changed["after"][7, place] += 1.0
    keep = {key: header[key] for key in ("number", "trip_tick", "limits", "shadow")}
    write_black_box(tmp_path / "changed.mcap", keep, changed)
    difference = replay_black_box(tmp_path / "changed.mcap").difference
    assert f"tick {rows['tick'][7]}" in difference and "the board after it" in difference
    assert CliRunner().invoke(app, ["replay", str(tmp_path / "changed.mcap")]).exit_code == 1


@pytest.mark.requirement("WB-BOX-02")
def test_the_same_flight_leaves_the_same_bytes(tmp_path: Path) -> None:
    paths = []
    for name in ("a", "b"):
        flight = Flight()
        flight.fly(25, cmp=0.2)
        flight.box.finish()
        paths.append(written(tmp_path / name, flight)[0])
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert (tmp_path / "a" / "black_box_001_slots.csv").read_text().startswith("tick,protect_ms\n")


@pytest.mark.requirement("WB-BOX-03")
def test_a_damaged_file_is_refused_with_its_name(tmp_path: Path) -> None:
    flight = Flight()
    flight.fly(10)
    flight.fly(5, cmp=0.2)
    flight.box.finish()
    path, _ = written(tmp_path, flight)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    with pytest.raises(InputError, match=path.name):
        replay_black_box(path)
    with pytest.raises(InputError, match=r"nothing\.mcap"):
        replay_black_box(tmp_path / "nothing.mcap")


@pytest.mark.requirement("WB-BOX-04")
def test_a_store_that_refuses_costs_the_box_and_not_the_flight(tmp_path: Path) -> None:
    flight = Flight()
    flight.fly(10)
    flight.fly(5, cmp=0.2)
    flight.box.finish()
    folder = tmp_path / "gone"
    told: list[str] = []
    writer = WriteBlackBox(flight.box, FileStore(folder), 2, lambda event, *arguments: told.append(event.name))
    writer.init()
    shutil.rmtree(folder)
    writer.take(1)
    writer.work()
    writer.deliver(16)
    assert told == ["BLACK_BOX_FROZEN", "BLACK_BOX_FAILED"]
    assert flight.box.frozen is None and flight.box.on


@pytest.mark.requirement("WB-BOX-04")
def test_no_more_boxes_than_allowed_are_written_and_those_of_before_count(tmp_path: Path) -> None:
    (tmp_path / "black_box_001.mcap").write_bytes(b"of a flight before")
    flight, told = Flight(), []
    writer = WriteBlackBox(flight.box, FileStore(tmp_path), 2, lambda event, *arguments: told.append(arguments[0]))
    writer.init()
    flight.fly(3)
    flight.box.trip()
    writer.close(flight.tick)
    assert told == [2, 2]
    assert not flight.box.on
    flight.box.trip()
    flight.fly(10)
    assert flight.box.frozen is None


@pytest.mark.requirement("WB-BOX-01")
def test_without_a_store_nothing_is_frozen() -> None:
    flight = Flight()
    writer = WriteBlackBox(flight.box, None, 2, lambda event, *arguments: None)
    writer.init()
    flight.fly(10, cmp=0.1)
    assert flight.box.frozen is None and not writer.take(10)


@pytest.mark.requirement("WB-BOX-01")
def test_new_limits_begin_a_new_ring_and_longer_rows_take_more_room() -> None:
    flight = Flight()
    flight.fly(9)
    more: list[Limit] = [limit(MODE, number=10 + i, high_red=200.0) for i in range(100)]
    flight.box.restart(more, ())
    assert len(flight.box) == 0 and 0 < flight.box.places < 20


@pytest.mark.requirement("WB-BOX-02")
def test_a_red_limit_in_flight_leaves_a_box_whose_decisions_come_out_again(tmp_path: Path) -> None:
    flight = shipped(executive={"black_box_ticks": 20, "black_box_after_ticks": 4})
    flight.limit.append(limit(TICKS, number=99, high_red=24.5, response="degrade"))
    with flying(Footage(small(0.4)), tmp_path, 40, flight=flight, store=FileStore(tmp_path)) as app:
        while app.step():
            pass
    _, rows = read_black_box(tmp_path / "black_box_001.mcap")
    assert rows["tick"].tolist() == list(range(9, 29))  # TICKS counts the tick itself: 25 at tick 24
    assert replay_black_box(tmp_path / "black_box_001.mcap").difference == ""
