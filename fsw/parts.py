"""What a flight application is made of: its tables, the hardware it drives, and the tasks from images to points."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from fsw.executive.entry import Entry, FrameTask, LongTask
from fsw.tables.flight import FlightTable, VisionTable
from fsw.tables.schema import CamerasTable, WingTable
from fsw.tasks.feature import Feature
from fsw.tasks.match import Match
from fsw.tasks.publish import Outlets
from fsw.tasks.reconstruct import Reconstruct
from fsw.tasks.search import Search
from fsw.tasks.state import State
from fsw.vision.acquisition import Prior
from fsw.vision.rig import StereoRig
from hal.camera import Camera
from hal.clock import Clock
from hal.store import Store
from hal.trigger import Trigger
from hal.watchdog import Unwatched, Watchdog


class MakeVision(Protocol):
    """Makes the tasks search, feature, match and reconstruct over the shared state."""

    def __call__(
        self, state: State, rig: StereoRig, prior: Prior, table: VisionTable
    ) -> Sequence[FrameTask | LongTask]: ...


def make_vision(state: State, rig: StereoRig, prior: Prior, table: VisionTable) -> Sequence[FrameTask | LongTask]:
    """The tasks from images to points."""
    return Search(state, rig, prior, table), Feature(state, table), Match(state, table), Reconstruct(state, table)


@dataclass(frozen=True)
class Tables:
    """All that configures a flight. cameras and wing have been checked against each other (load_hardware)."""

    cameras: CamerasTable
    wing: WingTable
    flight: FlightTable


@dataclass(frozen=True)
class Drivers:
    """The hardware behind its interfaces.

    rate_hz: nominal rate of the trigger. raw_line: the trigger is a line whose edges may be missing, doubled or off
    their time; otherwise its ticks are established. patience: how long to wait for a long task (see Executive).
    """

    cameras: tuple[Camera, Camera]
    trigger: Trigger
    clock: Clock
    rate_hz: float
    outlets: Outlets = field(default_factory=Outlets)
    raw_line: bool = False
    watchdog: Watchdog = field(default_factory=Unwatched)
    store: Store | None = None
    patience: Callable[[Entry], bool] | None = None
