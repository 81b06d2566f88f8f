"""Faults as the campaign injects them: one small class for each row of the failure list, by the row's name.

A fault is there from its first tick to before its last one. It acts where the real one would: on frames as they come
from the cameras, on the edges of the trigger line, on mission time, on the scene or the motion, on an outlet, or on the
application's memory. Moment, eye and size are drawn from the run's seed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fsw.app import App
from fsw.executive.entry import Entry, FrameTask, LongTask
from hal.camera import Camera, FrameStamp
from hal.frame import make_frames
from sim.edges import Exposure, MissionClock
from sim.lines import ControllerBus
from sim.stores import EventStore, FillingStore, SteadyLog
from sim.surrogate_flap import Flap
from sim.surrogate_motion import ModalMotion
from sim.surrogate_world import Scene


class FaultyWorld(Protocol):
    """What moves and shines."""

    motion: ModalMotion
    scene: Scene
    flap: Flap | None


class Stage(Protocol):
    """All of a flight that a fault can get at."""

    world: FaultyWorld
    edges: list[Exposure]
    clock: MissionClock
    bus: ControllerBus
    events: EventStore
    log: SteadyLog
    store: FillingStore
    period_ns: int

    @property
    def app(self) -> App: ...
    def time_s(self, tick: int) -> float: ...


@dataclass
class Shot:
    """A frame as a camera handed it over: faults change both."""

    image: NDArray[Any]
    stamp: FrameStamp


Shots = tuple[Shot, Shot]


class Injection:
    """A fault that does nothing. Subclasses say how long it lasts (ticks, from and to), and what it does."""

    LASTS = (1, 1)
    """Ticks that the fault lasts: least and most."""
    RECOVERY = 150
    """Ticks that the flight needs to measure again after its end, at most."""

    def __init__(self, first: int, draw: np.random.Generator) -> None:
        least, most = self.LASTS
        self.first, self.end = first, first + int(draw.integers(least, most + 1))
        self.draw = draw

    def active(self, tick: int) -> bool:
        """Whether the fault is there at this tick."""
        return self.first <= tick < self.end

    def prepare(self, stage: Stage) -> None:
        """Before the flight: what can be laid down beforehand."""

    def before(self, stage: Stage, tick: int) -> None:
        """Before each tick."""

    def frames(self, stage: Stage, tick: int, now: Shots, last: Shots) -> None:
        """As the cameras hand over the frames of a tick; last: what they handed over before."""

    def tasks(self, tasks: Sequence[FrameTask | LongTask], tick: "Now") -> Sequence[FrameTask | LongTask]:
        """The vision tasks as they are made."""
        return tasks

    def patience(self, entry: Entry, tick: int) -> bool:
        """Whether to wait for a long task."""
        return entry.done.wait()


class Now(Protocol):
    """The present tick."""

    def __call__(self) -> int: ...


class FaultyEyes:
    """Both cameras behind ports; what they hand over goes through the injection first."""

    def __init__(self, cameras: tuple[Camera, Camera], stage: Stage, injection: Injection, now: Now) -> None:
        self.cameras, self._stage, self._injection, self._now = cameras, stage, injection, now
        self._shots, self._last = self._blank(), self._blank()
        self._exposed = 0
        self.ports = (Port(self, 0), Port(self, 1))

    def shot(self, eye: int, fetched: int) -> tuple[Shot, int]:
        """The newest frame of an eye that has fetched so many, and the number of this one."""
        if fetched == self._exposed:
            self._expose()
        return self._shots[eye], self._exposed

    def _blank(self) -> Shots:
        left, right = (
            Shot(make_frames((camera.height, camera.width), camera.dtype), FrameStamp(-1, -1, 0, 0, eye))
            for eye, camera in enumerate(self.cameras)
        )
        return left, right

    def _expose(self) -> None:
        self._exposed += 1
        self._shots, self._last = self._last, self._shots
        for shot, camera in zip(self._shots, self.cameras, strict=True):
            shot.stamp = camera.grab(shot.image)
        tick = self._now()
        if self._injection.active(tick):
            self._injection.frames(self._stage, tick, self._shots, self._last)


class Port:
    """One eye of them, as the flight side sees it."""

    def __init__(self, eyes: FaultyEyes, eye: int) -> None:
        camera = eyes.cameras[eye]
        self.height, self.width, self.dtype = camera.height, camera.width, camera.dtype
        self._eyes, self._eye, self._fetched = eyes, eye, 0

    def grab(self, out: NDArray[Any]) -> FrameStamp:
        """Hand over the frame of the latest edge."""
        shot, self._fetched = self._eyes.shot(self._eye, self._fetched)
        np.copyto(out, shot.image)
        return shot.stamp
