"""A small world for fast flights: the scenario's wing and cameras, few cells, and images that are drawn by copying.

An image carries what a measurement needs, and nothing of it is told beside the image: the eye, the moment of exposure
and how far the camera was bumped stand in its first and in its last row, and each cell is a dark block on bright
ground, which shadow, glints and darkness take away as they would in a real one.
"""

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from fsw.tables.schema import PanelTable
from sim.artwork import cell_centres
from sim.disturbances import dim, speckle
from sim.motion import Oscillator
from sim.scenario import Scenario, load_scenario
from sim.structure import Modes, solve_modes
from sim.surrogate_flap import Flap
from sim.surrogate_motion import ModalMotion
from sim.world import true_eyes, true_plate, true_pose
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]

SKY, GROUND, CELL = 4, 140, 30  # grey levels
NOISE = 2.0  # of a pixel, standard deviation in grey levels
DRAWN = 16  # noisy images that are kept of each eye; no two in a row are the same
SCENES = 4  # seeds share so many sets of them
BINNING = 8
PANEL_CELLS = (3, 4)  # columns, rows
PANEL_PITCH_MM, PANEL_CELL_MM = (173.0, 98.0), (170.0, 95.0)
HEADER = struct.Struct("<2sBqhB")  # magic, eye, time in ns, bump in 1/1000 px, check sum
MAGIC = b"\xa5\x5a"
HEADER_COLUMN = 1
IN_SHADOW = 1.0 / 128.0  # of the light: there is no air in orbit that would scatter any into a shadow
MARGIN = 16  # rows of sky above and below, and columns beside


class Header(NamedTuple):
    """What an image says of itself."""

    eye: int
    time_ns: int
    bump_px: float


@dataclass
class Scene:
    """What is wrong with the light and the cameras now; sound by default.

    gain: light, 1 as it should be. grain: further noise of a pixel, standard deviation in grey levels.
    shadow, glint: share of the cells in shadow (from one end of the wing), or under
    glints in the left eye (anywhere). pattern: which of them. bump_px: how far the right camera was turned across the
    epipolar lines.
    """

    gain: float = 1.0
    grain: float = 0.0
    shadow: float = 0.0
    glint: float = 0.0
    pattern: int = 0
    bump_px: float = 0.0


@cache
def dark_cells(count: int, share: float, pattern: int) -> NDArray[np.bool_]:
    """Cells (count,) in shadow: a share of them from one end; pattern: odd from the root, even from the tip."""
    inside = np.arange(count) < round(share * count)
    return inside if pattern % 2 else inside[::-1].copy()


@cache
def glinting_cells(count: int, share: float, pattern: int) -> NDArray[np.bool_]:
    """Cells (count,) under a glint: a share of them, anywhere."""
    under = np.zeros(count, np.bool_)
    under[np.random.default_rng([pattern, 66]).permutation(count)[: round(share * count)]] = True
    return under


def surrogate_scenario(seconds: float) -> Scenario:
    """The scenario `paper` with few large cells and coarse pixels."""
    paper = load_scenario("paper")
    columns, rows = PANEL_CELLS
    panels = [
        PanelTable(panel.origin_mm, columns, rows, PANEL_PITCH_MM, PANEL_CELL_MM)
        for panel in paper.panel
    ]  # fmt: skip
    camera = msgspec.structs.replace(paper.camera, binning=BINNING)
    return msgspec.structs.replace(paper, panel=panels, camera=camera, duration_s=seconds)


@cache
def _modes(count: int) -> Modes:
    return solve_modes(true_plate(load_scenario("paper")), count)


class SurrogateWorld:
    """The wing's motion and what the eyes see of it. cells_mm (N, 2); rest_mm (N, 3): cells at rest, left camera."""

    def __init__(self, seconds: float, seed: int) -> None:
        self.scenario, self.seed = surrogate_scenario(seconds), seed
        self.period_ns = round(1e9 / self.scenario.rate_hz)
        self.times_ns = np.round(np.arange(self.scenario.ticks) * 1e9 / self.scenario.rate_hz).astype(np.int64)
        self.scene = Scene()
        self.cells_mm = cell_centres(self.scenario)
        self.count = len(self.cells_mm)
        pose, modes = true_pose(self.scenario), _modes(max(e.mode for e in self.scenario.excitation))
        self.rest_mm = pose.to_left(np.column_stack([self.cells_mm, np.zeros(self.count)]))
        self.normal = np.ascontiguousarray(pose.rotation[:, 2])
        excitation = self.scenario.excitation
        chosen = [e.mode - 1 for e in excitation]
        self.shapes = (modes.shapes(self.cells_mm)[chosen, :, 0].T / modes.tip[chosen]).T.copy()  # (M, N)
        self.motion = ModalMotion(
            [
                Oscillator(
                    float(modes.frequency_hz[e.mode - 1]), e.damping_ratio, e.amplitude_mm, "decay",
                    float(np.deg2rad(e.phase_deg)),
                )
                for e in excitation
            ]
        )  # fmt: skip
        self.flap: Flap | None = None
        fold_mm = self.scenario.fold_lines_mm[-1]
        self._beyond_fold = np.maximum(self.cells_mm[:, 0] - fold_mm, 0.0) / (self.scenario.wing.length_mm - fold_mm)
        eye = true_eyes(self.scenario)[0]
        self.height, self.width, self.dtype = eye.height, eye.width, np.dtype(np.uint8)
        self.slots = cell_slots(self.count, self.height, self.width)
        self._drawn = [_drawn(self.count, self.height, self.width, seed % SCENES, eye) for eye in (0, 1)]
        self._tip = np.zeros(self.motion.count)
        self._deflection = np.zeros(self.count)

    def deflection_mm(self, time_ns: int) -> FloatArray:
        """Displacement (N,) of the cells along the wing's normal at a moment; the array is used again."""
        time_s = time_ns * 1e-9
        self.motion.tip_mm(time_s, self._tip)
        np.dot(self._tip, self.shapes, out=self._deflection)
        if self.flap is not None:
            self._deflection += self.flap.tip_mm(time_s) * self._beyond_fold
        return self._deflection

    def render(self, number: int, time_ns: int, eye: int, out: Image) -> None:
        """Fill out (height, width) with what an eye (0 left, 1 right) sees; number: of the exposure, for its noise."""
        drawn, scene = self._drawn[eye], self.scene
        np.copyto(out, drawn[(5 * number + eye) % DRAWN])
        if scene.gain != 1.0:
            dim(out, scene.gain)
        if scene.shadow > 0.0:
            shade(out, self.slots, dark_cells(self.count, scene.shadow, scene.pattern))
        if scene.glint > 0.0 and eye == 0:
            fill(out, self.slots, glinting_cells(self.count, scene.glint, scene.pattern), 255)
        if scene.grain > 0.0:
            speckle(out, scene.grain, (self.seed, number, eye))
        if scene.gain > 0.0:
            write_header(out, Header(eye, time_ns, scene.bump_px if eye else 0.0))


def cell_slots(count: int, height: int, width: int) -> NDArray[np.int64]:
    """Where the cells' blocks are: (N, 4) of first row, first column, rows, columns of a cell and its bright ground."""
    columns = int(np.ceil(np.sqrt(count * width / height)))
    rows = -(-count // columns)
    tall, wide = (height - 2 * MARGIN) // rows, (width - 2 * MARGIN) // columns
    number = np.arange(count)
    place = np.column_stack([MARGIN + number // columns * tall, MARGIN + number % columns * wide])
    return np.column_stack([place, np.full(count, tall), np.full(count, wide)]).astype(np.int64)


@cache
def _drawn(count: int, height: int, width: int, seed: int, eye: int) -> Image:
    """Images (DRAWN, height, width) of the sound scene, each with noise of its own."""
    slots = cell_slots(count, height, width)
    flat = np.full((height, width), float(SKY))
    for top, left, tall, wide in slots:
        flat[top : top + tall, left : left + wide] = GROUND
        flat[top + tall // 4 : top + 3 * tall // 4, left + wide // 4 : left + 3 * wide // 4] = CELL
    draw = np.random.default_rng([seed, 55, eye])
    noisy = flat + NOISE * draw.standard_normal((DRAWN, height, width))
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def write_header(out: Image, header: Header) -> None:
    """Write what an image says of itself into its first and its last row."""
    body = HEADER.pack(MAGIC, header.eye, header.time_ns, round(1000.0 * header.bump_px), 0)
    coded = np.frombuffer(body[:-1] + bytes((sum(body) % 256,)), np.uint8)
    for row in (0, -1):
        out[row, HEADER_COLUMN : HEADER_COLUMN + len(coded)] = coded


def read_header(image: NDArray[Any], row: int) -> Header | None:
    """What a row, the first (0) or the last (-1), says of the image; None if it says nothing sensible."""
    data = image[row, HEADER_COLUMN : HEADER_COLUMN + HEADER.size].tobytes()
    magic, eye, time_ns, bump, check = HEADER.unpack(data)
    if magic != MAGIC or sum(data[:-1]) % 256 != check:
        return None
    return Header(eye, time_ns, bump / 1000.0)


@kernel
def shade(image: Image, slots: NDArray[np.int64], cells: NDArray[np.bool_]) -> None:
    """Let a shadow fall on some cells."""
    for n in range(len(cells)):
        if cells[n]:
            top, left, tall, wide = slots[n]
            for i in range(top, top + tall):
                for j in range(left, left + wide):
                    image[i, j] = int(image[i, j] * IN_SHADOW)


@kernel
def fill(image: Image, slots: NDArray[np.int64], cells: NDArray[np.bool_], level: int) -> None:
    """Paint some cells over."""
    for n in range(len(cells)):
        if cells[n]:
            top, left, tall, wide = slots[n]
            image[top : top + tall, left : left + wide] = level


@kernel
def find_cells(image: NDArray[Any], slots: NDArray[np.int64], least_contrast: float, found: NDArray[np.bool_]) -> None:
    """Fill found (N,): cells that are dark against bright ground that is not saturated."""
    for n in range(len(found)):
        top, left, tall, wide = slots[n]
        dark = bright = 0.0
        for k in range(8):
            across = left + (2 * k + 1) * wide // 16
            dark += image[top + tall // 2, left + wide // 4 + (k + 1) * wide // 18] / 8.0
            bright += (0.5 * image[top + tall // 8, across] + 0.5 * image[top + 7 * tall // 8, across]) / 8.0
        found[n] = bright - dark >= least_contrast and bright < 250.0
