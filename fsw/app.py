"""The composition root: tables -> pools -> tasks -> schedule. The only place that knows everybody."""

from collections.abc import Sequence

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from fault.modes import Cause
from fault.protection import Protection
from fsw.black_box import BlackBox
from fsw.commands.handlers import Handlers
from fsw.commands.replies import Replies
from fsw.executive.entry import FrameTask, LongTask
from fsw.executive.executive import Executive
from fsw.executive.lock import TriggerLock
from fsw.executive.schedule import Finding, check_schedule
from fsw.geometry import make_prior, make_rig, make_wing_grid
from fsw.memory.displacements import Displacements
from fsw.memory.pool import FramePool
from fsw.memory.ring import Ring
from fsw.parts import Drivers, MakeVision, Tables, make_vision
from fsw.supervisor import Start
from fsw.tables.bank import TableBank
from fsw.tables.flight import TaskSlot
from fsw.tasks.acquire import Acquire
from fsw.tasks.black_box import WriteBlackBox
from fsw.tasks.command import CommandTask
from fsw.tasks.event_queue import EventQueue
from fsw.tasks.health import Health
from fsw.tasks.housekeeping import Housekeeping
from fsw.tasks.identify import Identify
from fsw.tasks.lateness import Lateness
from fsw.tasks.protect import Protect
from fsw.tasks.publish import Publish
from fsw.tasks.search import Search
from fsw.tasks.state import Pair, State
from fsw.vision.tracking import Tracker, TrackingOptions
from hal.frame import make_frames
from telemetry.dictionary import RESTARTS
from telemetry.events import RESTARTED, RESTARTS_SPENT, STARTED, STOPPED, RestartCause, TableNumber
from wingbeat.errors import InputError

FRAMES_PER_EYE = 2  # one is leased at a time; a lost one must not end the measuring
REQUIRED = (
    "command", "acquire", "search", "feature", "match", "reconstruct", "identify", "health", "housekeeping", "protect",
    "publish",
)  # fmt: skip


class App:
    """The flight application. Raises InputError for a schedule that cannot hold."""

    def __init__(
        self,
        tables: Tables,
        drivers: Drivers,
        lockstep: bool = True,
        vision: MakeVision = make_vision,
        start: Start = Start(),  # noqa: B008  # it cannot change
    ) -> None:
        # Sums come out in the same order, and so in the same bits, whatever the machine has to offer.
        cv2.setNumThreads(1)
        self._threads = threadpool_limits(limits=1)
        self._drivers, self._start, self._restarting = drivers, start, False
        rig, grid, prior = make_rig(tables.cameras), make_wing_grid(tables.wing), make_prior(tables.wing)
        flight, settings = tables.flight, tables.flight.executive
        self.tables = TableBank(flight, self._refusal)
        blank = [make_frames((c.height, c.width), c.dtype) for c in drivers.cameras]  # until the first pair comes
        self.pools = [FramePool(FRAMES_PER_EYE, (c.height, c.width), c.dtype) for c in drivers.cameras]
        self.state = State(
            Tracker(rig, grid, TrackingOptions(threads=settings.eye_threads)),
            Pair(blank[0], blank[1]),
            Ring(flight.identify.history_ticks, (), np.int64),
            Displacements(flight.identify.history_ticks, grid.count),
            events=EventQueue(settings.event_burst, settings.event_refill_ticks),
        )
        self.state.tracker.place(prior.rotation, prior.translation_mm)
        self.protection = Protection(flight.limit, flight.shadow)
        self._acquire = Acquire(self.state, drivers.cameras, (self.pools[0], self.pools[1]), flight.vision)
        replies = Replies()
        self._publish = Publish(self.state, drivers.outlets, replies)
        self._vision = vision(self.state, rig, prior, flight.vision)
        self.black_box = BlackBox(
            flight.limit,
            flight.shadow,
            settings.black_box_ticks,
            settings.black_box_after_ticks,
            tuple(slot.task for slot in flight.schedule),
            lambda task: self.executive.timing(task)[0].last_ms,
        )
        self._write_box = WriteBlackBox(self.black_box, drivers.store, settings.black_boxes, self.state.raise_event)
        self._identify = Identify(self.state, flight.identify)
        self._housekeeping = Housekeeping(self.state, self.tables, self.pools, self._go_by)
        handlers = Handlers(
            self.state,
            lambda: self.executive,
            self.protection,
            self.tables,
            replies,
            self._reset,
            self._record,
            self._restart,
        )
        bus, link = drivers.outlets.bus, drivers.outlets.link
        self._command = CommandTask(self.state, bus, handlers, self.tables, replies, settings.arm_ticks, link)
        known: list[FrameTask | LongTask] = [
            self._command,
            self._acquire,
            *self._vision,
            self._identify,
            Protect(self.state, self.protection, self.black_box),
            self._write_box,
            self._housekeeping,
            self._publish,
        ]
        names = (*(task.name for task in known), Health.name)
        self._health = Health(
            lambda: self.executive,
            drivers.watchdog,
            self.state.board,
            self.state.raise_event,
            settings.silent_after_ticks,
            settings.dead_after_ticks,
            names,
        )
        tasks = {task.name: task for task in (*known, self._health)}
        beside = {task.name for task in known if isinstance(task, LongTask)}
        self._tick_ms = None if lockstep else 1e3 / drivers.rate_hz
        self._known, self._within_tick = tuple(tasks), tasks.keys() - beside
        if findings := self._check_schedule(flight.schedule):
            raise InputError(findings[0].text, "schedule", "correct the flight tables")
        period_ns = round(1e9 / drivers.rate_hz)
        trigger, lock = drivers.trigger, None
        if drivers.raw_line:
            trigger = lock = TriggerLock(
                drivers.trigger,
                drivers.clock,
                period_ns,
                settings.edge_window_share,
                settings.free_wheel_after,
                settings.lock_after,
            )
        self._lateness = Lateness(self.state, lambda: self.executive, lock)
        self.executive = Executive(
            flight.schedule,
            tasks,
            trigger,
            drivers.clock,
            period_ns,
            lockstep,
            self._begin,
            patience=drivers.patience,
            catch_up_ticks=settings.catch_up_ticks,
            on_overrun=self._lateness.overrun,
            on_failure=self._lateness.failure,
        )

    def init(self) -> None:
        """Take all memory and compile all kernels."""
        state, start = self.state, self._start
        state.board.set(RESTARTS, start.restarts)
        self._lateness.init()
        state.raise_event(STARTED, state.tracker.grid.count, self._drivers.rate_hz)
        if start.cause is not RestartCause.POWER_ON:
            state.raise_event(RESTARTED, start.restarts, start.cause)
        if start.inhibited:
            state.raise_event(RESTARTS_SPENT, start.restarts)
            state.causes |= Cause.INHIBIT
        self.executive.init()

    def step(self) -> bool:
        """One tick; False when the trigger has ended."""
        more = self.executive.step()
        self._acquire.release()
        self._housekeeping.tick_ends(self.executive.hyperperiod_ends(self.executive.tick))
        return more

    @property
    def restart_cause(self) -> RestartCause | None:
        """Why the application wants to be made anew; None: it does not."""
        if self._drivers.watchdog.expired():
            return RestartCause.WATCHDOG
        return RestartCause.COMMAND if self._restarting else self._health.restart_cause

    @property
    def failures(self) -> Sequence[tuple[str, BaseException]]:
        """Tasks that failed, with what they raised."""
        return self._lateness.failures

    def _reset(self) -> None:
        for part in (self.executive, self._acquire, self._publish, self._housekeeping):
            part.reset()

    def _record(self, on: bool) -> None:
        self._publish.recording = on

    def _restart(self) -> None:
        self._restarting = True

    def _check_schedule(self, schedule: Sequence[TaskSlot]) -> list[Finding]:
        """What forbids a schedule."""
        return check_schedule(schedule, self._known, self._tick_ms, REQUIRED, self._within_tick)

    def _refusal(self, schedule: Sequence[TaskSlot]) -> int:
        """Number of the first reason against a schedule; 0: there is none."""
        return next((int(finding.refusal) for finding in self._check_schedule(schedule)), 0)

    def _go_by(self, numbers: Sequence[TableNumber]) -> None:
        """Between two ticks: let the tasks go by these active tables from now on."""
        flight = self.tables.flight
        if TableNumber.SCHEDULE in numbers:
            self.executive.apply(flight.schedule)
        if TableNumber.VISION in numbers:
            for task in (self._acquire, *self._vision):
                task.table = flight.vision  # type: ignore[union-attr]  # all vision tasks have one
        if TableNumber.IDENTIFY in numbers:
            self._identify.table = flight.identify
        if TableNumber.LIMITS in numbers or TableNumber.SHADOW in numbers:
            self.protection.renew(flight.limit, flight.shadow)
            self.black_box.restart(flight.limit, flight.shadow)

    def _begin(self, tick: int, time_ns: int) -> None:
        """A tick begins: what was late before is known now."""
        self.state.begin(tick, time_ns)
        self._lateness.tell()

    def close(self) -> None:
        """Stop: give the frames back, end the threads, say so."""
        self.executive.close()
        self._acquire.release()
        self._write_box.close(self.executive.tick)
        self.state.raise_event(STOPPED, self.executive.ticks)
        self._publish.drain_events()
        for task in self._vision:
            if isinstance(task, Search):
                task.close()
        self.state.tracker.close()
        self._threads.restore_original_limits()
