"""The composition root: tables -> pools -> tasks -> schedule. The only place that knows everybody."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from fault.monitor import Monitor
from fsw.executive.entry import FrameTask, LongTask
from fsw.executive.executive import Executive
from fsw.executive.schedule import check_schedule
from fsw.geometry import make_prior, make_rig, make_wing_grid
from fsw.memory.pool import FramePool
from fsw.memory.ring import Ring
from fsw.tables.flight import FlightTable
from fsw.tables.schema import CamerasTable, WingTable
from fsw.tables.store import TableStore
from fsw.tasks.acquire import Acquire
from fsw.tasks.feature import Feature
from fsw.tasks.identify import Identify
from fsw.tasks.match import Match
from fsw.tasks.protect import Protect
from fsw.tasks.publish import Outlets, Publish
from fsw.tasks.reconstruct import Reconstruct
from fsw.tasks.search import Search
from fsw.tasks.state import Pair, State
from fsw.vision.tracking import Tracker, TrackingOptions
from hal.camera import Camera
from hal.clock import Clock
from hal.trigger import Trigger
from telemetry.dictionary import OVERRUNS, TICKS_MISSED
from telemetry.events import OVERRUN, STARTED, STOPPED, TABLE_ACTIVATED, TRIGGER_GAP
from wingbeat.errors import InputError

FLIGHT_TABLE = 1  # number of the flight table in events
FRAMES_PER_EYE = 1  # leased at a time; one measured pair is given back before the next is taken


@dataclass(frozen=True)
class Tables:
    """All that configures a flight. cameras and wing have been checked against each other (load_hardware)."""

    cameras: CamerasTable
    wing: WingTable
    flight: FlightTable


@dataclass(frozen=True)
class Drivers:
    """The hardware behind its interfaces. rate_hz: nominal rate of the trigger."""

    cameras: tuple[Camera, Camera]
    trigger: Trigger
    clock: Clock
    rate_hz: float
    outlets: Outlets = field(default_factory=Outlets)


class App:
    """The flight application. Raises InputError for a schedule that cannot hold."""

    def __init__(self, tables: Tables, drivers: Drivers, lockstep: bool = True) -> None:
        # Sums come out in the same order, and so in the same bits, whatever the machine has to offer.
        cv2.setNumThreads(1)
        self._threads = threadpool_limits(limits=1)
        rig, grid, prior = make_rig(tables.cameras), make_wing_grid(tables.wing), make_prior(tables.wing)
        self.flight_table = TableStore(tables.flight)
        flight = self.flight_table.active.table
        vision, identify = flight.vision, flight.identify
        blank = [np.zeros((c.height, c.width), c.dtype) for c in drivers.cameras]  # until the first pair comes
        pools = [FramePool(FRAMES_PER_EYE, (c.height, c.width), c.dtype) for c in drivers.cameras]
        self._rate_hz, self._rig = drivers.rate_hz, rig
        self.state = State(
            Tracker(rig, grid, TrackingOptions()),
            Pair(blank[0], blank[1]),
            Ring(identify.history_ticks, (), np.int64),
            Ring(identify.history_ticks, (grid.count, 3)),
        )
        self._acquire = Acquire(
            self.state, drivers.cameras, (pools[0], pools[1]), vision.skew_limit_us, vision.hold_after_ticks
        )
        self._search = Search(self.state, rig, prior, vision)
        self._publish = Publish(self.state, drivers.outlets)
        known: list[FrameTask | LongTask] = [
            self._acquire,
            self._search,
            Feature(self.state, vision),
            Match(self.state, vision),
            Reconstruct(self.state, vision),
            Identify(self.state, identify),
            Protect(self.state, Monitor(flight.limit)),
            self._publish,
        ]
        tasks = {task.name: task for task in known}
        schedule = flight.schedule
        if findings := check_schedule(schedule, tasks, None if lockstep else 1e3 / drivers.rate_hz):
            raise InputError(findings[0].text, "schedule", "correct the flight tables")
        self.state.tracker.place(prior.rotation, prior.translation_mm)
        self._missed = self._overruns = 0
        self.executive = Executive(
            schedule, tasks, drivers.trigger, drivers.clock, round(1e9 / drivers.rate_hz), lockstep, self.state.begin
        )

    def init(self) -> None:
        """Take all memory and compile all kernels."""
        self.state.raise_event(STARTED, self.state.tracker.grid.count, self._rate_hz)
        self.state.raise_event(TABLE_ACTIVATED, FLIGHT_TABLE, self.flight_table.active.version)
        self.executive.init()

    def step(self) -> bool:
        """One tick; False when the trigger has ended."""
        more = self.executive.step()
        self._count_lateness()
        return more

    def _count_lateness(self) -> None:
        """Show the executive's counters; what was late in this tick is told with the next one."""
        board, executive = self.state.board, self.executive
        if executive.missed_ticks > self._missed:
            self.state.raise_event(TRIGGER_GAP, executive.missed_ticks - self._missed)
        if executive.overruns > self._overruns:
            self.state.raise_event(OVERRUN, executive.overruns - self._overruns)
        self._missed, self._overruns = executive.missed_ticks, executive.overruns
        board.set(TICKS_MISSED, self._missed)
        board.set(OVERRUNS, self._overruns)

    def close(self) -> None:
        """Stop: give the frames back, end the threads, say so."""
        self.executive.close()
        self._acquire.release()
        self.state.raise_event(STOPPED, self.executive.ticks)
        self._publish.drain_events()
        self._search.close()
        self.state.tracker.close()
        self._threads.restore_original_limits()
