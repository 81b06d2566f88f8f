"""The scenario `small` with motion, light and cameras that may fail: for flights through the whole chain of vision.

Motion and scene are those of the small world; here they act on images that the renderer draws.
"""

from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim.disturbances import dim, glare, shift, speckle
from sim.scenario import load_scenario
from sim.surrogate_flap import Flap
from sim.surrogate_motion import ModalMotion
from sim.surrogate_world import IN_SHADOW, Scene
from sim.world import World

FloatArray = NDArray[np.float64]


class WholeWorld:
    """As SurrogateWorld, with real images: times_ns (T,), motion, scene, flap. bits: of a grey value."""

    def __init__(self, seconds: float, seed: int, bits: int = 8) -> None:
        small = load_scenario("small")
        camera = msgspec.structs.replace(small.camera, bits=bits)
        self.scenario = msgspec.structs.replace(small, duration_s=seconds, camera=camera)
        world = World(self.scenario, seed)
        self.period_ns, self.times_ns = round(1e9 / self.scenario.rate_hz), world.times_ns
        self.scene = Scene()
        self.motion = ModalMotion(world.motion)
        self.flap: Flap | None = None
        self.height, self.width, self.dtype = world.eyes[0].height, world.eyes[0].width, world.dtype
        self._world = world
        moving = [e.mode - 1 for e in self.scenario.excitation]
        self._shapes = (world.modes.patches[moving].T / world.modes.tip[moving]).T
        self._hinged = hinged_surface(world.modes.x_mm, self.scenario.fold_lines_mm[-1], self._shapes.shape[2])
        self._tip = np.zeros(self.motion.count)

    def render(self, number: int, time_ns: int, eye: int, out: NDArray[Any]) -> None:
        """Fill out (height, width) with what an eye (0 left, 1 right) sees; number: of the exposure, for its noise."""
        time_s, scene = time_ns * 1e-9, self.scene
        self.motion.tip_mm(time_s, self._tip)
        bent = np.tensordot(self._tip, self._shapes, axes=1)
        if self.flap is not None:
            bent += self.flap.tip_mm(time_s) * self._hinged
        self._world.render_bent(number, eye, bent, out)
        if eye == 1 and scene.bump_px:
            shift(out, scene.bump_px)
        if scene.shadow > 0.0:
            columns = round(scene.shadow * self.width)
            dim(out[:, :columns] if scene.pattern % 2 else out[:, self.width - columns :], IN_SHADOW)
        if scene.glint > 0.0 and eye == 0:
            glare(out, scene.glint, scene.pattern)
        if scene.gain != 1.0:
            dim(out, scene.gain)
        if scene.grain > 0.0:
            speckle(out, scene.grain, (self._world.seed, number, eye))


def hinged_surface(x_mm: FloatArray, fold_mm: float, rows: int) -> FloatArray:
    """Patches (ex, rows, 4, 4) of a wing that is turned about a fold line alone, its end by 1 mm."""
    surface = np.zeros((len(x_mm) - 1, rows, 4, 4))
    beyond = x_mm[:-1] >= fold_mm - 1e-6
    span = x_mm[-1] - fold_mm
    surface[beyond, :, 0, 0] = ((x_mm[:-1] - fold_mm) / span)[beyond, None]
    surface[beyond, :, 1, 0] = (np.diff(x_mm) / span)[beyond, None]
    return surface
