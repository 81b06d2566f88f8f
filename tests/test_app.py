"""The flight application as one: real tasks before simulated images, and cameras that fail in every way they can."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_parts import Fault, Footage, Image, flying, shipped, small

from fsw.app import App
from fsw.tasks.acquire import DROPS
from hal.camera import FrameStamp, FrameStatus
from telemetry.board import EventRecord
from telemetry.declaration import Point
from telemetry.dictionary import (
    AGE_TICKS,
    CMP,
    DETECTED_LEFT,
    DROP_RATE,
    DROPS_BLACK,
    DROPS_CORRUPT,
    DROPS_DUPLICATE,
    DROPS_LATE,
    DROPS_MISSING,
    DROPS_SATURATED,
    DROPS_SKEW,
    DROPS_STUCK,
    DROPS_SWAPPED,
    DROPS_TORN,
    FLAGS,
    FREQUENCY_HZ,
    FREQUENCY_SIGMA_HZ,
    ILLUMINATED,
    MATCHED,
    OBSERVABLE,
    TICKS_MISSED,
    VALID,
    VALIDITY,
    FlightMode,
    ModeFlag,
)
from telemetry.events import EVENT_BY_NUMBER

ACQUIRE, TRACK, HOLD = FlightMode.ACQUIRE, FlightMode.TRACK, FlightMode.HOLD
FAULT_TICK = 15
SKEW_NS = 500_001  # a nanosecond beyond the shipped limit


class Recorded(list[EventRecord]):
    """Events as they are raised, by name."""

    def of(self, name: str) -> list[EventRecord]:
        return [record for record in self if EVENT_BY_NUMBER[record.number].name == name]


def listen(app: App) -> Recorded:
    """All events that the application raises from now on."""
    heard, raise_event = Recorded(), app.state.raise_event

    def both(event: Any, *arguments: float) -> None:
        heard.append(EventRecord(event.number, app.state.tick, app.state.time_ns, len(heard), arguments))
        raise_event(event, *arguments)

    app.state.raise_event = both  # type: ignore[method-assign]
    return heard


def newest_mm(app: App) -> np.ndarray:
    """The newest row of the displacement history."""
    row = np.zeros((1, app.state.tracker.grid.count, 3))
    app.state.history_mm.copy_latest(row)
    return row


@pytest.fixture(scope="module")
def footage() -> Footage:
    """Twenty pairs of `small`."""
    return Footage(small(20 / 15.0))


@pytest.fixture(scope="module")
def still() -> Footage:
    """The same wing at rest."""
    scenario = small(20 / 15.0)
    quiet = [type(e)(e.mode, 0.0, e.damping_ratio, e.kind, e.phase_deg) for e in scenario.excitation]
    return Footage(small(20 / 15.0, excitation=quiet))


def missing(image: Image, stamp: FrameStamp) -> FrameStamp:
    """No frame came: what the buffer holds means nothing."""
    image[:] = 255
    return stamp._replace(frame=-1, status=int(FrameStatus.MISSING))


def corrupt(image: Image, stamp: FrameStamp) -> FrameStamp:
    image[::2] = 0
    return stamp._replace(status=int(FrameStatus.CORRUPT))


def late(image: Image, stamp: FrameStamp) -> FrameStamp:
    return stamp._replace(time_ns=stamp.time_ns + SKEW_NS)


def early(image: Image, stamp: FrameStamp) -> FrameStamp:
    return stamp._replace(time_ns=stamp.time_ns - SKEW_NS)


def of_the_edge_before(image: Image, stamp: FrameStamp) -> FrameStamp:
    return stamp._replace(trigger=stamp.trigger - 1)


def stuck(image: Image, stamp: FrameStamp) -> FrameStamp:
    return stamp._replace(frame=stamp.frame - 1)


def black(image: Image, stamp: FrameStamp) -> FrameStamp:
    """Nothing to see but the sensor's noise."""
    image[:] = np.random.default_rng(stamp.trigger).integers(0, 3, image.shape)
    return stamp


def no_wing(image: Image, stamp: FrameStamp) -> FrameStamp:
    """Light, and nothing of the wing in it."""
    image[:] = np.random.default_rng(stamp.trigger).integers(20, 60, image.shape)
    return stamp


def saturated(image: Image, stamp: FrameStamp) -> FrameStamp:
    """Far too much light: all but the darkest is at the brightest value."""
    image[image > 10] = 255
    return stamp


def swapped(image: Image, stamp: FrameStamp) -> FrameStamp:
    """The other camera's frame, and it says so."""
    return stamp._replace(eye=1 - stamp.eye)


def of_the_edge_long_before(image: Image, stamp: FrameStamp) -> FrameStamp:
    """What lay in the driver's queue since the trigger before."""
    return stamp._replace(trigger=stamp.trigger - 1, time_ns=stamp.time_ns - 66_666_667)


class Torn:
    """A part of the image is still that of the frame before."""

    def __init__(self, footage: Footage, eye: int) -> None:
        self._images, self._place = footage.images[eye], footage.place

    def __call__(self, image: Image, stamp: FrameStamp) -> FrameStamp:
        third = len(image) // 3
        image[third : 2 * third] = self._images[self._place(stamp.trigger - 1), third : 2 * third]
        return stamp


def one_eye(eye: int, ticks: range, fault: Fault) -> tuple[dict[int, Fault], dict[int, Fault]]:
    faults: tuple[dict[int, Fault], dict[int, Fault]] = ({}, {})
    faults[eye].update(dict.fromkeys(ticks, fault))
    return faults


def both_eyes(ticks: range, fault: Fault) -> tuple[dict[int, Fault], dict[int, Fault]]:
    return dict.fromkeys(ticks, fault), dict.fromkeys(ticks, fault)


CAUSES = [
    pytest.param(missing, DROPS_MISSING, "FRAME_MISSING", id="missing"),
    pytest.param(corrupt, DROPS_CORRUPT, "FRAME_CORRUPT", id="corrupt"),
    pytest.param(late, DROPS_SKEW, "FRAME_SKEW", id="late"),
    pytest.param(early, DROPS_SKEW, "FRAME_SKEW", id="early"),
    pytest.param(of_the_edge_before, DROPS_SKEW, "FRAME_SKEW", id="other-trigger"),
    pytest.param(stuck, DROPS_DUPLICATE, "FRAME_DUPLICATE", id="duplicate"),
    pytest.param(swapped, DROPS_SWAPPED, "FRAME_SWAPPED", id="swapped"),
    pytest.param(of_the_edge_long_before, DROPS_LATE, "FRAME_LATE", id="late-by-a-trigger"),
    pytest.param(black, DROPS_BLACK, "FRAME_BLACK", id="black"),
    pytest.param(saturated, DROPS_SATURATED, "FRAME_SATURATED", id="saturated"),
    pytest.param(Torn, DROPS_TORN, "FRAME_TORN", id="torn"),
]


@pytest.mark.requirement("WB-PAI-01")
@pytest.mark.parametrize("eye", [0, 1])
@pytest.mark.parametrize(("fault", "counter", "event"), CAUSES)
def test_a_bad_frame_is_counted_by_its_cause_told_and_never_measured(
    footage: Footage, tmp_path: Path, fault: Fault, counter: Point, event: str, eye: int
) -> None:
    fault = Torn(footage, eye) if fault is Torn else fault
    with flying(footage, tmp_path, FAULT_TICK + 2, one_eye(eye, range(FAULT_TICK, FAULT_TICK + 1), fault)) as app:
        heard, board = listen(app), app.state.board
        for _ in range(FAULT_TICK):
            app.step()
        assert app.state.measured and app.state.mode is TRACK
        assert [board.get(point) for point in DROPS] == [0] * len(DROPS)
        app.step()
        assert not app.state.measured and app.state.mode is TRACK
        assert np.isnan(newest_mm(app)).all()
        assert all(np.isnan(board.get(point)) for point in (DETECTED_LEFT, MATCHED, CMP))
        app.step()
        assert app.state.measured and board.get(MATCHED) > 250
        assert [board.get(point) for point in DROPS] == [float(point is counter) for point in DROPS]
    (told,) = [record for record in heard if EVENT_BY_NUMBER[record.number].name.startswith("FRAME_")]
    assert EVENT_BY_NUMBER[told.number].name == event and told.tick == FAULT_TICK
    if event == "FRAME_SKEW":
        assert abs(told.arguments[0]) == pytest.approx(0.0 if fault is of_the_edge_before else SKEW_NS / 1000.0)
    else:
        assert told.arguments[0] == eye


def test_a_skew_at_the_limit_is_no_skew(footage: Footage, tmp_path: Path) -> None:
    def at_the_limit(_: Image, stamp: FrameStamp) -> FrameStamp:
        return stamp._replace(time_ns=stamp.time_ns + SKEW_NS - 1)

    with flying(footage, tmp_path, 8, one_eye(1, range(8), at_the_limit)) as app:
        while app.step():
            assert app.state.pair.usable


def test_edges_that_never_came_are_counted_and_the_history_keeps_true_times(footage: Footage, tmp_path: Path) -> None:
    with flying(footage, tmp_path, 24, gaps=frozenset({12, 13, 17})) as app:
        heard = listen(app)
        while app.step():
            pass
        assert app.state.board.get(TICKS_MISSED) == 3 and app.executive.ticks == 21
        ticks = [t for t in range(24) if t not in (12, 13, 17)]
        times = np.zeros(len(ticks), np.int64)
        app.state.history_time_ns.copy_latest(times)
        assert times.tolist() == [t * round(1e9 / 15.0) for t in ticks]
    assert [(r.tick, r.arguments) for r in heard.of("TRIGGER_GAP")] == [(14, (2,)), (18, (1,))]


def test_frames_that_stay_away_lead_to_hold_and_back_to_track(footage: Footage, tmp_path: Path) -> None:
    gone = range(12, 22)
    with flying(footage, tmp_path, 45, one_eye(1, gone, missing)) as app:
        modes: dict[int, FlightMode] = {}
        while app.step():
            modes[app.state.tick] = app.state.mode
            assert not (app.state.measured and app.state.tick in gone)
        assert app.state.board.get(DROPS_MISSING) == len(gone)
        assert app.state.measured and app.state.board.get(MATCHED) > 250
    assert [modes[t] for t in (11, 15, 16, 21)] == [TRACK, TRACK, HOLD, HOLD]  # the fifth tick in a row
    assert modes[22] is ACQUIRE and modes[44] is TRACK
    path = list(dict.fromkeys(zip([*modes.values()][:-1], [*modes.values()][1:], strict=True)))
    assert [step for step in path if step[0] is not step[1]] == [
        (ACQUIRE, TRACK),
        (TRACK, HOLD),
        (HOLD, ACQUIRE),
    ]


@pytest.mark.requirement("WB-VIS-07")
def test_the_lock_is_lost_when_the_wing_leaves_and_nothing_is_made_up(footage: Footage, tmp_path: Path) -> None:
    with flying(footage, tmp_path, 30, both_eyes(range(12, 30), no_wing)) as app:
        heard = listen(app)
        modes = []
        while app.step():
            modes.append(app.state.mode)
            if app.state.tick >= 12:
                assert not np.isfinite(newest_mm(app)).any()
        assert modes[11] is TRACK and modes[14] is ACQUIRE and modes[-1] is ACQUIRE
        assert app.state.board.get(DROPS_MISSING) == 0
    (lost,) = heard.of("LOCK_LOST")
    assert (lost.tick, lost.arguments) == (14, (0,))


@pytest.mark.requirement("WB-PAI-04")
def test_darkness_is_told_once_holds_the_flight_and_is_no_fault(footage: Footage, tmp_path: Path) -> None:
    with flying(footage, tmp_path, 45, both_eyes(range(12, 24), black)) as app:
        heard, board, modes = listen(app), app.state.board, {}
        while app.step():
            modes[app.state.tick] = app.state.mode
            assert board.get(ILLUMINATED) == (0 if 12 <= app.state.tick < 24 else 1)
            assert board.get(DROP_RATE) == 0.0
        assert board.get(DROPS_BLACK) == 12 and board.get(MATCHED) > 250
    assert [modes[t] for t in (15, 16, 23, 24, 44)] == [TRACK, HOLD, HOLD, ACQUIRE, TRACK]
    assert [(r.tick, EVENT_BY_NUMBER[r.number].name) for r in heard if 100 <= r.number < 200] == [
        (12, "DARKNESS"),
        (24, "LIGHT"),
    ]
    assert not heard.of("LIMIT_RED") and not heard.of("LIMIT_YELLOW")


@pytest.mark.requirement("WB-VIS-07")
def test_a_wing_that_was_lost_is_found_again(footage: Footage, tmp_path: Path) -> None:
    with flying(footage, tmp_path, 40, both_eyes(range(12, 20), no_wing)) as app:
        while app.step():
            pass
        assert app.state.mode is TRACK and app.state.board.get(MATCHED) > 250


@pytest.mark.requirement("WB-APP-06")
def test_the_last_good_value_stays_marked_not_valid_with_its_age_when_the_images_go_dark(tmp_path: Path) -> None:
    dark = 105
    footage = Footage(small(dark / 15.0))
    with flying(footage, tmp_path, 150, both_eyes(range(dark, 150), no_wing)) as app:
        heard, board, state = listen(app), app.state.board, app.state
        for _ in range(dark):
            app.step()
        assert board.get(VALIDITY) == 1 and [board.get(VALID, slot) for slot in range(4)] == [1, 1, 1, 0]
        before = [board.get(FREQUENCY_HZ, slot) for slot in range(3)]
        true = sorted(mode.frequency_hz for mode in footage.world.motion)
        assert before == pytest.approx(true, rel=2e-3)
        ages = []
        while app.step():
            ages.append(board.get(AGE_TICKS, 0))
            if state.tick >= dark + 3:  # three ticks in a row without the wing, and the lock is lost
                assert board.get(VALIDITY) == 0 and not any(board.get(VALID, slot) for slot in range(8))
            assert board.get(FREQUENCY_HZ, 0) == pytest.approx(before[0], rel=1e-3)
        assert ages[-1] == state.tick - state.shown.tick >= 40
        assert set(np.diff(ages)) <= {1.0, -9.0}  # one a tick, but for the delivery that was under way
    assert heard.of("LOCK_LOST") and {r.arguments[0] for r in heard.of("MODE_INVALID")} >= {0, 1, 2}


def test_an_identification_that_fails_is_told_and_the_flight_goes_on(
    footage: Footage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    with flying(footage, tmp_path, 70) as app:
        heard = listen(app)
        monkeypatch.setattr("fsw.tasks.identify.identify", fail)  # after INIT, which tries it
        while app.step():
            pass
        assert app.executive.ticks == 70 and app.state.mode is TRACK and app.state.estimate is None
        assert app.state.board.get(VALIDITY) == 0
    assert heard.of("IDENTIFICATION_FAILED")


@dataclass
class Shown:
    """The board's modes after one tick."""

    tick: int
    validity: float
    observable: float
    held: bool
    frequency_hz: list[float]
    sigma_hz: list[float]
    valid: list[float]
    age: list[float]
    flags: list[ModeFlag | None]


def look(app: App) -> Shown:
    def slots(point: Point) -> list[float]:
        return [app.state.board.get(point, slot) for slot in range(8)]

    flags = [None if np.isnan(value) else ModeFlag(int(value)) for value in slots(FLAGS)]
    state, board = app.state, app.state.board
    return Shown(
        state.tick, board.get(VALIDITY), board.get(OBSERVABLE), state.held, slots(FREQUENCY_HZ),
        slots(FREQUENCY_SIGMA_HZ), slots(VALID), slots(AGE_TICKS), flags,
    )  # fmt: skip


STOP = 105
TRUE_HZ = (0.7146, 4.427073, 5.806468)


@pytest.fixture(scope="module")
def stopped(still: Footage, tmp_path_factory: pytest.TempPathFactory) -> list[Shown]:
    """A wing that swings for seven seconds, and is then brought to rest at once; records of 100 frames."""
    footage = Footage(small(STOP / 15.0))

    def at_rest(eye: int) -> Fault:
        def show(image: Image, stamp: FrameStamp) -> FrameStamp:
            image[:] = still.images[eye, still.place(stamp.trigger)]
            return stamp

        return show

    left, right = (dict.fromkeys(range(STOP, 260), at_rest(eye)) for eye in (0, 1))
    rows = []
    tables = shipped(identify={"history_ticks": 100})
    with flying(footage, tmp_path_factory.mktemp("stopped"), 260, (left, right), flight=tables) as app:
        while app.step():
            rows.append(look(app))
        assert app.state.mode is TRACK
    return rows


@pytest.mark.requirement("WB-APP-06")
def test_an_estimate_without_a_valid_mode_leaves_the_last_good_one_held_and_ageing(stopped: list[Shown]) -> None:
    assert stopped[STOP].validity == 1 and not stopped[STOP].held
    # While the record still holds some of the motion, a mode may be good again; once it holds none, nothing is.
    first = 1 + max(row.tick for row in stopped if not row.held)
    held = stopped[first:]
    for before, row in pairwise(held):
        assert row.held and row.validity == 0 and not any(row.valid)
        assert row.frequency_hz == pytest.approx(before.frequency_hz, nan_ok=True)
        assert row.age[0] == before.age[0] + 1
        assert all(f is None or f & ModeFlag.HELD for f in row.flags) and row.flags[0] is not None
    assert len(held) > 60
    assert held[-1].observable == 0  # first the motion fits no decay; in the end there is none


@pytest.mark.requirement("WB-APP-06")
def test_a_held_estimate_that_is_stale_stays_stale(stopped: list[Shown]) -> None:
    stale = [bool((row.flags[0] or ModeFlag(0)) & ModeFlag.STALE) for row in stopped if row.held]
    assert any(stale) and all(stale[stale.index(True) :])


@pytest.mark.requirement("WB-APP-07")
def test_no_mode_that_is_marked_valid_is_wrong_when_the_motion_ends_inside_the_record(stopped: list[Shown]) -> None:
    for row in stopped:
        for slot in (slot for slot in range(8) if row.valid[slot]):
            error = min(abs(row.frequency_hz[slot] - true) for true in TRUE_HZ)
            # What misleads is off by more than matters, and by more than it owns to.
            assert error < 0.005 * row.frequency_hz[slot] or error < 3.0 * row.sigma_hz[slot], row


def test_an_image_that_repeats_under_new_frame_numbers_is_stuck(footage: Footage, tmp_path: Path) -> None:
    def frozen(eye: int) -> Fault:
        def show(image: Image, stamp: FrameStamp) -> FrameStamp:
            image[:] = footage.images[eye, 3]
            return stamp

        return show

    left, right = (dict.fromkeys(range(12, 16), frozen(eye)) for eye in (0, 1))
    with flying(footage, tmp_path, 16, (left, right)) as app:
        while app.step():
            pass
        assert app.state.board.get(DROPS_STUCK) >= 3


def test_a_quiet_wing_is_not_observable_and_nothing_is_wrong_with_it(still: Footage, tmp_path: Path) -> None:
    with flying(still, tmp_path, 75) as app:
        heard, board = listen(app), app.state.board
        while app.step():
            assert board.get(VALIDITY) == 0
        assert app.state.mode is TRACK and app.state.estimate is not None
        assert board.get(OBSERVABLE) == 0 and board.get(CMP) > 0.99 and board.get(MATCHED) > 250
        assert "not_observable" in app.state.estimate.result.flags
        shown = [board.get(FLAGS, slot) for slot in range(8)]
        assert all(np.isnan(flags) or int(flags) & ModeFlag.NOT_OBSERVABLE for flags in shown)
    assert not [r for r in heard if EVENT_BY_NUMBER[r.number].name in ("LIMIT_RED", "LOCK_LOST", "MODE_VALID")]
