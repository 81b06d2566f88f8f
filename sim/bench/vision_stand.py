"""The stand of all vision rows: rig, grid and prior as the flight side is told them, and the flight's frame tasks."""

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fsw.geometry import make_prior, make_rig, make_wing_grid
from fsw.memory.displacements import Displacements
from fsw.memory.ring import Ring
from fsw.tables.checks import load_hardware
from fsw.tables.flight import VisionTable, load_flight
from fsw.tables.schema import CamerasTable, WingTable
from fsw.tasks.feature import Feature
from fsw.tasks.match import Match
from fsw.tasks.reconstruct import Reconstruct
from fsw.tasks.state import Pair, State
from fsw.vision.acquisition import Acquisition, acquire
from fsw.vision.tracking import Tracker, TrackingOptions
from hal.frame import make_frames
from sim.flight_files import flight_files
from sim.scenario import Scenario, load_scenario
from sim.world import World
from telemetry.dictionary import FlightMode

FloatArray = NDArray[np.float64]
Image = NDArray[Any]

IN_VIEW_PX = 1.0  # a cell is in view if all its corners are so far inside both images


def bench_scenario(binning: int, ticks: int, rate_hz: float | None = None, **changes: Any) -> Scenario:
    """The scenario `paper` with so many of its pixels read as one, for so many ticks; changes: of whole tables."""
    paper = load_scenario("paper")
    rate = rate_hz or paper.rate_hz
    camera = msgspec.structs.replace(paper.camera, binning=binning)
    fields = {"camera": camera, "rate_hz": rate, "duration_s": ticks / rate, **changes}
    return msgspec.structs.replace(paper, **fields)


def hardware(scenario: Scenario) -> tuple[CamerasTable, WingTable]:
    """What the flight side is told of the scenario: calibration and nominal pose, as good as it says."""
    with tempfile.TemporaryDirectory() as folder:
        return load_hardware(*flight_files(scenario, folder))


@contextmanager
def cpu_ms(into: list[float]) -> Iterator[None]:
    """Add the processor time of all threads of this process, user and system, in ms."""
    before = time.process_time_ns()
    yield
    into.append((time.process_time_ns() - before) * 1e-6)


@contextmanager
def wall_ms(into: list[float]) -> Iterator[None]:
    """Add the time that passes, in ms."""
    before = time.perf_counter_ns()
    yield
    into.append((time.perf_counter_ns() - before) * 1e-6)


class Stand:
    """Search, and the tasks feature, match and reconstruct, with the gates and numbers of the shipped flight table."""

    def __init__(self, cameras: CamerasTable, wing: WingTable, pair: tuple[Image, Image], threads: int = 0) -> None:
        """pair: any images of the right form; the kernels compile on them. threads: for the eyes; 0: the table's."""
        cv2.setNumThreads(1)
        self._limits = threadpool_limits(limits=1)
        self.rig, self.grid, self.prior = make_rig(cameras), make_wing_grid(wing), make_prior(wing)
        flight = load_flight()
        self.table: VisionTable = flight.vision
        options = TrackingOptions(threads=threads or flight.executive.eye_threads)
        history = Ring(2, (), np.int64), Displacements(2, self.grid.count)
        self.state = State(Tracker(self.rig, self.grid, options), Pair(*pair), *history)
        self.state.mode = FlightMode.TRACK
        self.tracker = self.state.tracker
        self.tracker.place(self.prior.rotation, self.prior.translation_mm)
        feature, match = Feature(self.state, self.table), Match(self.state, self.table)
        self._tasks = (feature, match, Reconstruct(self.state, self.table))
        self._match = match
        for task in self._tasks:
            task.init()
        self.ticks = 0

    def acquire(self, left: Image, right: Image) -> Acquisition:
        """Search a pair as ACQUIRE does, and begin to track from it if it says so."""
        found = acquire(left, right, self.rig, self.grid, self.prior)
        if found.ok:
            self.tracker.start(found.rotation, found.translation_mm, left, right)
            self.state.measured = False
            self._match.run(self.ticks, 0)  # there is no frame before
        return found

    def tick(self, left: Image, right: Image) -> None:
        """One tick in TRACK: from pixels in memory to points with covariance, marked valid or not."""
        state = self.state
        state.begin(self.ticks, self.ticks)
        state.pair.left, state.pair.right, state.pair.usable = left, right, True
        for task in self._tasks:
            task.run(self.ticks, self.ticks)
        self.ticks += 1

    def close(self) -> None:
        """End the tracker's thread."""
        self.tracker.close()


class Truth:
    """Where a world's cells are at each tick, in space and in both images."""

    def __init__(self, world: World) -> None:
        self.world = world
        self._displacement = world.displacement_mm(world.cells_mm)
        size = np.array(world.scenario.panel[0].cell_mm)
        outward = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size
        self._corner_mm = (world.cells_mm[:, None] + outward).reshape(-1, 2)
        self._corner_z = world.displacement_mm(self._corner_mm)

    def centres_mm(self, tick: int, away_mm: float = 0.0) -> FloatArray:
        """Centres (N, 3) in the left camera's frame; away_mm: the whole wing moved so far along its Z."""
        z = self._displacement[tick] + away_mm
        return self.world.pose.to_left(np.column_stack([self.world.cells_mm, z]))

    def corners_px(self, tick: int, away_mm: float = 0.0) -> FloatArray:
        """Corners (2, N, 4, 2) in image pixels."""
        xyz = self.world.pose.to_left(np.column_stack([self._corner_mm, self._corner_z[tick] + away_mm]))
        return np.stack([eye.project(xyz).reshape(-1, 4, 2) for eye in self.world.eyes])

    def in_view(self, corners_px: FloatArray) -> NDArray[np.bool_]:
        """Cells (N,) that lie wholly inside both images."""
        size = np.array([[eye.width, eye.height] for eye in self.world.eyes])[:, None, None]
        inside = (corners_px > IN_VIEW_PX) & (corners_px < size - 1.0 - IN_VIEW_PX)
        return np.asarray(np.all(inside, axis=(0, 2, 3)))


def pair_of(world: World, tick: int) -> tuple[Image, Image]:
    """What both eyes see at a tick."""
    images = [make_frames((eye.height, eye.width), world.dtype) for eye in world.eyes]
    for eye, image in enumerate(images):
        world.render(tick, eye, image)
    return images[0], images[1]


def load() -> float:
    """Mean number of running processes in the last minute."""
    return round(os.getloadavg()[0], 2)
