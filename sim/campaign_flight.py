"""One flight of the fault campaign: the real application, a fault at a known moment, and what became of it."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fault.fmea import Fault
from fsw.app import App
from fsw.executive.entry import Entry, FrameTask, LongTask
from fsw.supervisor import Start, Supervisor
from fsw.tables.flight import VisionTable
from fsw.tasks.state import State
from fsw.vision.acquisition import Prior
from fsw.vision.rig import StereoRig
from sim.campaign_judge import Findings, judge
from sim.campaign_stage import FlightStage
from sim.injection import FaultyEyes, Injection
from sim.injections import INJECTIONS

WARM_UP_TICKS = (130, 160)  # until the fault: modes have been valid for a while
KICK_TICKS = 1800  # from manoeuvre to manoeuvre in a flight without a fault
KICK_MM = (20.0, 2.5, 3.0)
AFTER_TICKS = 10  # that a flight goes on after the latest moment at which the fault must be known


@dataclass(frozen=True)
class Order:
    """What to fly. fault: None for a nominal flight of so many ticks. whole: with real images and real vision.

    A flight of the whole chain ends when the fault must be known; the others go on until they must have recovered.
    """

    fault: Fault | None
    run: int
    seed: int
    whole: bool = False
    ticks: int = 0

    @property
    def name(self) -> str:
        """The row's name."""
        return self.fault.name if self.fault else "nominal"


def fly_order(order: Order) -> Findings:
    """Fly it and judge it."""
    with tempfile.TemporaryDirectory() as folder:
        stage, injection = flown(order, Path(folder))
        told, heard, ticks = stage.events.told, stage.bus.heard, len(stage.world.times_ns)
        return judge(order, injection, ticks, told, heard, stage.world.motion, stage.period_ns)


def flown(order: Order, folder: Path, keep: bool = False) -> tuple[FlightStage, Injection]:
    """The flight when it is over, and what was injected. keep: frames and lines are kept."""
    number = order.fault.number if order.fault else 0
    draw = np.random.default_rng(np.random.SeedSequence([order.seed, number, order.run, order.whole]))
    first = int(draw.integers(*WARM_UP_TICKS))
    if order.fault is None:
        injection, ticks = Injection(order.ticks, draw), order.ticks
    else:
        injection = INJECTIONS[order.name](first, draw)
        ticks = flight_ticks(order, injection)
    stage = FlightStage(ticks, int(draw.integers(1 << 31)), folder, order.whole, keep)
    if order.fault is None:
        manoeuvre(stage, ticks, draw)
    injection.prepare(stage)
    fly(stage, injection)
    return stage, injection


def flight_ticks(order: Order, injection: Injection) -> int:
    """How long to fly."""
    assert order.fault is not None
    known = injection.first + order.fault.latency_ticks + AFTER_TICKS
    if order.fault.part == "trigger":  # a line without a further edge has ended
        known = max(known, injection.end + AFTER_TICKS)
    return known if order.whole else max(known, injection.end + injection.RECOVERY)


def manoeuvre(stage: FlightStage, ticks: int, draw: np.random.Generator) -> None:
    """Thrusters kick the wing now and then; otherwise it would come to rest."""
    for tick in range(KICK_TICKS, ticks, KICK_TICKS):
        stage.world.motion.kick(stage.time_s(tick), [mm * float(draw.uniform(0.5, 1.0)) for mm in KICK_MM])


def fly(stage: FlightStage, injection: Injection, lockstep: bool = True) -> None:
    """Fly to the end of the trigger; lockstep: or at the pace of the stage's clock."""
    for _ in steps(stage, injection, lockstep):
        pass


def steps(stage: FlightStage, injection: Injection, lockstep: bool = True) -> Iterator[None]:
    """The same tick by tick."""
    eyes = FaultyEyes(stage.drivers.cameras, stage, injection, stage.now)
    watchdog = stage.drivers.watchdog

    def patience(entry: Entry) -> bool:
        return injection.patience(entry, stage.now())

    def vision(state: State, rig: StereoRig, prior: Prior, table: VisionTable) -> Sequence[FrameTask | LongTask]:
        return injection.tasks(stage.vision(state, rig, prior, table), stage.now)

    drivers = replace(stage.drivers, cameras=eyes.ports, patience=patience if lockstep else None)

    def make(start: Start) -> App:
        watchdog.arm()
        return App(stage.tables, drivers, lockstep, vision, start)

    stage.supervisor = supervisor = Supervisor(make, stage.store, stage.tables.flight.executive.most_restarts)
    try:
        supervisor.init()
        while True:
            injection.before(stage, stage.now() + 1)
            if not supervisor.step():
                return
            yield
    finally:
        supervisor.close()
