"""All that a flight of the campaign stands on: a world, its clock and trigger, and what hangs on the lines."""

from pathlib import Path

import msgspec

from fsw.app import App
from fsw.parts import Drivers, MakeVision, Tables, make_vision
from fsw.supervisor import Supervisor
from fsw.tables.checks import load_hardware
from fsw.tables.flight import FlightTable, load_flight
from fsw.tasks.publish import Outlets
from hal.camera import Camera
from hal.clock import Clock
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.soft_watchdog import SoftWatchdog
from sim.edges import EdgeLine, Exposure, MissionClock
from sim.flight_files import flight_files
from sim.lines import ControllerBus
from sim.stores import EventStore, FillingStore, SteadyLog
from sim.surrogate import make_surrogate_vision
from sim.surrogate_camera import SurrogateCamera
from sim.surrogate_world import SurrogateWorld
from sim.whole_world import WholeWorld

RATE_HZ = 15.0
WATCHDOG_NS = 2_000_000_000
FEW_CELLS = {"coordinates": 6, "order": 16, "most_modes": 4}  # of a small wing need no more, and cost a third


class FlightStage:
    """What a fault can get at, and the drivers in front of it. whole: real images, of so many bits, and real vision.

    keep: the bus keeps its frames and the store its lines. most: mode packets and events that are known afterwards;
    None: all.
    """

    def __init__(
        self,
        ticks: int,
        seed: int,
        folder: Path,
        whole: bool = False,
        keep: bool = False,
        most: int | None = None,
        oscillator: Clock | None = None,
        bits: int = 8,
    ) -> None:
        self.clock = MissionClock(oscillator or LockstepClock())
        self.world: SurrogateWorld | WholeWorld
        self.vision: MakeVision
        if whole:
            self.world, self.vision = WholeWorld(ticks / RATE_HZ, seed, bits), make_vision
        else:
            self.world = SurrogateWorld(ticks / RATE_HZ, seed)
            self.vision = make_surrogate_vision(self.world)
        self.period_ns = self.world.period_ns
        self.edges = [Exposure(int(time_ns), picture) for picture, time_ns in enumerate(self.world.times_ns)]
        self.bus, self.events = ControllerBus(self.now, keep, most), EventStore(self.now, keep, most)
        self.log, self.store = SteadyLog(), FillingStore(folder)
        cameras, wing = load_hardware(*flight_files(self.world.scenario, folder))
        self.tables = Tables(cameras, wing, flight_tables(whole))
        line = EdgeLine(self.edges, self.clock)
        eyes: tuple[Camera, Camera] = (SurrogateCamera(self.world, 0, line), SurrogateCamera(self.world, 1, line))
        outlets = Outlets(bus=self.bus, can_log=self.log, events=self.events)  # type: ignore[arg-type]  # they write
        self.drivers = Drivers(
            eyes,
            line,
            self.clock,
            self.world.scenario.rate_hz,
            outlets,
            raw_line=True,
            watchdog=SoftWatchdog(self.clock.oscillator, WATCHDOG_NS),
            store=self.store,
        )
        self.supervisor: Supervisor[App] | None = None

    @property
    def app(self) -> App:
        """The application that flies now."""
        assert self.supervisor is not None
        return self.supervisor.app

    def now(self) -> int:
        """The present tick, by the oscillator."""
        return (self.clock.oscillator.now_ns() + self.period_ns // 10) // self.period_ns

    def time_s(self, tick: int) -> float:
        """True moment of an edge, of one after the flight's end too."""
        return round(tick * 1e9 / RATE_HZ) * 1e-9


def flight_tables(whole: bool) -> FlightTable:
    """The shipped tables; a wing of few cells needs few coordinates, and identification is most of a flight's cost.

    Made anew for each flight: a fault may change them where they lie.
    """
    shipped = load_flight()
    if whole:
        return shipped
    return msgspec.structs.replace(shipped, identify=msgspec.structs.replace(shipped.identify, **FEW_CELLS))
