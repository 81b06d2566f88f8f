"""Images of the bent wing: exact where it counts, on the edges, and quick everywhere else.

The mapping from pixel to wing is solved exactly on a grid of nodes and taken as straight between them; every edge is
blurred in closed form, with the lens's and the pixel's spread carried over to the wing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.artwork import Artwork
from sim.kernels import draw, normal_table
from sim.mapping import STEP_PX, Light, View, centre_chords, map_nodes, spread_nodes
from sim.rig import Eye, Pose

FloatArray = NDArray[np.float64]

_PIXEL_VARIANCE = 1.0 / 12.0  # of the square pixel, along any direction
_NOISE_SAMPLES = 1 << 20


@dataclass(frozen=True)
class Sensor:
    """What turns light into numbers: bits per pixel, blur of the lens, electrons at full scale, read noise."""

    bits: int
    psf_sigma_px: float
    full_well_e: float
    read_noise_e: float

    @property
    def top(self) -> int:
        """The largest grey value."""
        return (1 << self.bits) - 1

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a pixel."""
        return np.dtype(np.uint8 if self.bits <= 8 else np.uint16)


def noise_table(width: int, seed: int) -> NDArray[np.float32]:
    """The normal numbers that every frame of one width draws its noise from."""
    return np.random.default_rng(seed).standard_normal(_NOISE_SAMPLES + width, dtype=np.float32)


class Renderer:
    """One eye's view of the wing. Holds scratch memory: use one in one thread at a time."""

    def __init__(
        self,
        eye: Eye,
        pose: Pose,
        art: Artwork,
        light: Light,
        sensor: Sensor,
        background: float,
        noise: NDArray[np.float32],
    ) -> None:
        """background: grey value beside the wing; noise: see `noise_table`."""
        self.eye, self.sensor = eye, sensor
        self._art, self._light, self._background, self._noise = art, light, background, noise
        # X_eye = R (P X_wing + p) + t, so a ray of the eye points along (R P)^T ray in the wing's frame.
        axes = (eye.rotation @ pose.rotation).T
        offset = eye.rotation @ pose.translation_mm + eye.translation_mm
        self._view = View(
            eye.intrinsics, eye.distortion, np.ascontiguousarray(-axes @ offset), np.ascontiguousarray(axes)
        )
        rows, columns = (-(-(n - 1) // STEP_PX) + 2 for n in (eye.height, eye.width))
        self._nodes = np.zeros((rows, columns, 5))
        self._turn, self._above = np.zeros((2, columns, 2))
        self._at = np.zeros((columns, 5))
        self._grey = np.zeros(eye.width, dtype=np.float32)
        self._table = normal_table()
        self._spread_px = float(np.sqrt(sensor.psf_sigma_px**2 + _PIXEL_VARIANCE))

    def render(self, out: NDArray[Any], patches: FloatArray, x_mm: FloatArray, y_mm: FloatArray, key: int) -> None:
        """Fill out (height, width) with the wing bent to this surface (see `surface.height`); key decides the noise."""
        sensor = self.sensor
        per_electron = sensor.top / sensor.full_well_e
        map_nodes(self._nodes, self._view, self._light, patches, x_mm, y_mm)
        centre_chords(self._nodes, self._turn, self._above)
        spread_nodes(self._nodes, self._spread_px)
        draw(
            out,
            self._nodes,
            self._at,
            self._grey,
            self._art.panels,
            self._art.cells,
            self._art.hinges,
            self._background,
            self._table,
            self._noise,
            np.uint64(key),
            per_electron,
            (sensor.read_noise_e * per_electron) ** 2,
            float(sensor.top),
        )
