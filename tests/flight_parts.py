"""The real flight application before images of the simulated world that were drawn first; its cameras may fail."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from fsw.app import App
from fsw.parts import Drivers, Tables
from fsw.tables.checks import load_hardware
from fsw.tables.flight import FlightTable, load_flight
from fsw.tasks.publish import Outlets
from hal.camera import FrameStamp, FrameStatus
from hal.drivers.lockstep_clock import LockstepClock
from hal.frame import make_frames
from hal.store import Store
from hal.trigger import Edge
from sim.flight_files import flight_files
from sim.scenario import Scenario, load_scenario
from sim.world import World
from telemetry.logs import CanLog, MavlinkLog
from telemetry.recorder import Recorder

Image = NDArray[Any]
Fault = Callable[[Image, FrameStamp], FrameStamp]  # changes an image in place, and its stamp


def small(seconds: float, **changes: Any) -> Scenario:
    """The scenario `small` for so long; changes: fields of the scenario."""
    return msgspec.structs.replace(load_scenario("small"), duration_s=seconds, **changes)


class Footage:
    """Images (2, T, height, width) of a world, shown from first to last, and back, and so on: motion without jumps."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.world = scenario, World(scenario)
        count, eye = len(self.world.times_ns), self.world.eyes[0]
        self.images = make_frames((2, count, eye.height, eye.width), self.world.dtype)
        for i in range(count):
            for k in (0, 1):
                self.world.render(i, k, self.images[k, i])

    def place(self, tick: int) -> int:
        """Which image is shown at this tick."""
        last = self.images.shape[1] - 1
        return last - abs(last - tick % (2 * last))


class Edges:
    """A trigger of so many edges, at the scenario's rate; edges in `gaps` never come."""

    def __init__(self, clock: LockstepClock, rate_hz: float, count: int, gaps: frozenset[int] = frozenset()) -> None:
        self._clock, self._period_ns, self._count, self._gaps = clock, round(1e9 / rate_hz), count, gaps
        self.tick = -1

    @property
    def time_ns(self) -> int:
        """Time of the latest edge."""
        return self.tick * self._period_ns

    @property
    def ended(self) -> bool:
        return self._next() >= self._count

    def _next(self) -> int:
        tick = self.tick + 1
        while tick in self._gaps:
            tick += 1
        return tick

    def wait(self, until_ns: int | None = None) -> Edge | None:
        tick = self._next()
        if tick >= self._count:
            return None
        if until_ns is not None and tick * self._period_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self.tick = tick
        self._clock.sleep_until_ns(self.time_ns)
        return Edge(self.tick, self.time_ns)


class FootageCamera:
    """One eye; faults: what happens to the frame of a tick."""

    def __init__(self, footage: Footage, eye: int, edges: Edges, faults: dict[int, Fault]) -> None:
        self._eye = eye
        self._images, self._place, self._edges, self._faults = footage.images[eye], footage.place, edges, faults
        self.height, self.width = self._images.shape[1:]
        self.dtype = self._images.dtype

    def grab(self, out: Image) -> FrameStamp:
        tick = self._edges.tick
        np.copyto(out, self._images[self._place(tick)])
        stamp = FrameStamp(tick, tick, self._edges.time_ns, int(FrameStatus.OK), self._eye)
        fault = self._faults.get(tick)
        return stamp if fault is None else fault(out, stamp)


def shipped(**changes: Any) -> FlightTable:
    """The shipped flight tables with other values: vision={...}, identify={...}, schedule={task: {...}}."""
    table = load_flight()
    rows = changes.pop("schedule", {})
    schedule = [msgspec.structs.replace(row, **rows.get(row.task, {})) for row in table.schedule]
    parts = {part: msgspec.structs.replace(getattr(table, part), **values) for part, values in changes.items()}
    return msgspec.structs.replace(table, schedule=schedule, **parts)


@contextmanager
def logging(footage: Footage, folder: Path) -> Iterator[Outlets]:
    """All outlets of a run, into files of this folder."""
    panels = enumerate(footage.scenario.panel)
    cells = np.array([(p, c, r) for p, panel in panels for c in range(panel.columns) for r in range(panel.rows)])
    with ExitStack() as stack:
        yield Outlets(
            can_log=stack.enter_context(CanLog(folder / "can.log")),
            mavlink_log=stack.enter_context(MavlinkLog(folder / "mavlink.tlog")),
            recorder=stack.enter_context(Recorder(folder / "flight.mcap", cells)),
            events=stack.enter_context((folder / "events.jsonl").open("wb")),
        )


@contextmanager
def flying(
    footage: Footage,
    folder: Path,
    ticks: int,
    faults: tuple[dict[int, Fault], dict[int, Fault]] = ({}, {}),
    gaps: frozenset[int] = frozenset(),
    flight: FlightTable | None = None,
    outlets: Outlets | None = None,
    store: Store | None = None,
) -> Iterator[App]:
    """The flight application after INIT, in lockstep; faults: by eye and tick."""
    cameras, wing = load_hardware(*flight_files(footage.scenario, folder))
    clock = LockstepClock()
    edges = Edges(clock, footage.scenario.rate_hz, ticks, gaps)
    left, right = (FootageCamera(footage, eye, edges, faults[eye]) for eye in (0, 1))
    drivers = Drivers((left, right), edges, clock, footage.scenario.rate_hz, outlets or Outlets(), store=store)
    app = App(Tables(cameras, wing, flight or load_flight()), drivers)
    try:
        app.init()
        yield app
    finally:
        app.close()
