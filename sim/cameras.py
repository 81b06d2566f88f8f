"""The simulated trigger and cameras: drivers of the hal/ interfaces in front of a world.

Each camera draws the next image while the flight side still works on this one, in a thread of its own. What it hands
over depends on the tick alone.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.camera import FrameStamp, FrameStatus
from hal.clock import Clock
from hal.drivers.realtime_clock import RealtimeClock, thread_cpu_ns, wall_ns
from hal.frame import make_frames
from hal.trigger import Edge
from sim.world import World
from wingbeat.console import track
from wingbeat.errors import InputError

# Images drawn beforehand must leave the machine room for everything else.
PRERENDER_LIMIT_BYTES = 2_000_000_000


class WorldClock:
    """Real pace for a world: mission time stands at 0 until somebody first sleeps, then runs with the machine's clock.

    So the time that the flight side takes to start is no part of it, and edges have the same times at any pace.
    """

    def __init__(self) -> None:
        self._running: RealtimeClock | None = None

    def now_ns(self) -> int:
        """Mission time."""
        return self._running.now_ns() if self._running else 0

    def sleep_until_ns(self, time_ns: int) -> None:
        """Start mission time if it stands, and sleep to this."""
        if self._running is None:
            self._running = RealtimeClock()
        self._running.sleep_until_ns(time_ns)

    def thread_cpu_ns(self) -> int:
        """Processor time of the calling thread."""
        return thread_cpu_ns()

    def wall_ns(self) -> int:
        """A steady stopwatch."""
        return wall_ns()


class SimulatedTrigger:
    """The line that fires both cameras. tick, time_ns: of the latest edge; -1 and 0 before the first.

    An edge waits until it is fetched, as in the kernel's queue of line events: fetched late, it is late, not lost.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        """clock: the flight side's, at 0: LockstepClock for as fast as it can, WorldClock for real pace."""
        self._times_ns = world.times_ns
        self._clock = clock
        self.tick, self.time_ns = -1, 0

    @property
    def ended(self) -> bool:
        """The scenario's duration is over."""
        return self.tick + 1 >= len(self._times_ns)

    def wait(self, until_ns: int | None = None) -> Edge | None:
        """Block until the next edge and return it; None at the scenario's end, or at until_ns if it comes later."""
        if self.ended:
            return None
        time_ns = int(self._times_ns[self.tick + 1])
        if until_ns is not None and time_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self._clock.sleep_until_ns(time_ns)
        self.tick, self.time_ns = self.tick + 1, time_ns
        return Edge(self.tick, self.time_ns)


class SimulatedCamera:
    """One eye (0 left, 1 right) on a trigger's line. Close it when done."""

    def __init__(self, world: World, eye: int, trigger: SimulatedTrigger, prerender: bool = False) -> None:
        """prerender: draw all images now, for runs at real pace. Raises InputError if they are too many."""
        self._world, self._eye, self._trigger = world, eye, trigger
        self.width, self.height = world.eyes[eye].width, world.eyes[eye].height
        self.dtype = world.dtype
        self._frame = -1
        self._last_tick = -1
        self._images = self._draw_all() if prerender else None
        self._buffer = make_frames((self.height, self.width), self.dtype)
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=f"eye{eye}")
        self._ahead: tuple[int, Future[None]] | None = None
        if not prerender:
            self._draw_ahead(0)

    def grab(self, out: NDArray[Any]) -> FrameStamp:
        """Fill out (height, width) with the image of the latest edge; MISSING if there has been no new one."""
        tick = self._trigger.tick
        if tick == self._last_tick:
            return FrameStamp(tick, -1, self._trigger.time_ns, int(FrameStatus.MISSING), self._eye)
        if self._images is not None:
            np.copyto(out, self._images[tick])
        else:
            if self._ahead is None or self._ahead[0] != tick:
                self._draw_ahead(tick)
            if self._ahead is not None:
                self._ahead[1].result()
            np.copyto(out, self._buffer)
            if tick + 1 < len(self._world.times_ns):
                self._draw_ahead(tick + 1)
        self._frame += 1
        self._last_tick = tick
        return FrameStamp(tick, self._frame, self._trigger.time_ns, int(FrameStatus.OK), self._eye)

    def close(self) -> None:
        """End the drawing thread; the image that it draws is dropped."""
        self._pool.shutdown()

    def _draw_ahead(self, tick: int) -> None:
        # One thread a camera: an image that nobody fetched is finished before the next one overwrites it.
        self._ahead = tick, self._pool.submit(self._world.render, tick, self._eye, self._buffer)

    def _draw_all(self) -> NDArray[Any]:
        ticks = len(self._world.times_ns)
        size = 2 * ticks * self.width * self.height * self.dtype.itemsize
        if size > PRERENDER_LIMIT_BYTES:
            raise InputError(
                f"{ticks} pairs of {self.width} x {self.height} need {size / 1e9:.1f} GB",
                "images drawn beforehand",
                f"at most {PRERENDER_LIMIT_BYTES / 1e9:g} GB are allowed: shorten the run or use lockstep",
            )
        images = make_frames((ticks, self.height, self.width), self.dtype)
        for tick in track(range(ticks), f"drawing {('left', 'right')[self._eye]} images", ticks):
            self._world.render(tick, self._eye, images[tick])
        return images
