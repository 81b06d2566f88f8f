"""The simulated world: a wing that moves as its scenario says, and what two cameras see of it at each trigger edge."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.artwork import cell_centres, make_artwork
from sim.mapping import Light
from sim.motion import Oscillator, tip_motion
from sim.renderer import Renderer, Sensor, noise_table
from sim.rig import Eye, Pose, nearest_rotation, pose_at
from sim.scenario import Scenario
from sim.structure import Plate, solve_modes
from sim.truth import wing_truth

FloatArray = NDArray[np.float64]

# Each part of the world draws from a stream of its own, so that a change in one leaves the others as they were.
_MOTION, _PAINT, _NOISE, _FRAMES = range(4)


class World:
    """One run. Rendering one eye is for one thread at a time; the two eyes may be rendered side by side.

    times_ns (T,): the trigger edges; eyes: the true cameras (left, right); pose: the wing's true one; cells_mm (N, 2):
    centres on the flat wing; art: its paint; modes: all computed; motion: those that move; tip_mm (T, M):
    displacement of the tip in each of them.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        """seed: takes the place of the scenario's."""
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self.times_ns = np.round(np.arange(scenario.ticks) * 1e9 / scenario.rate_hz).astype(np.int64)
        self.eyes, self.pose = true_eyes(scenario), true_pose(scenario)
        self.cells_mm = cell_centres(scenario)
        self.modes = solve_modes(true_plate(scenario), max(e.mode for e in scenario.excitation))
        self.motion = [
            Oscillator(
                frequency_hz=float(self.modes.frequency_hz[e.mode - 1]),
                damping_ratio=e.damping_ratio,
                amplitude_mm=e.amplitude_mm,
                kind=e.kind,
                phase_rad=float(np.deg2rad(e.phase_deg)),
            )
            for e in scenario.excitation
        ]
        self.tip_mm = tip_motion(self.motion, self.times_ns, self._seed(_MOTION))
        every = np.zeros((len(self.times_ns), len(self.modes.tip)))
        every[:, [e.mode - 1 for e in scenario.excitation]] = self.tip_mm
        self._modal = every / self.modes.tip
        self._patches = self.modes.patches.reshape(len(self.modes.tip), -1)
        self._bent = np.zeros((2, *self.modes.patches.shape[1:]))
        self._renderers = self._make_renderers()
        frames = np.random.SeedSequence([self.seed, _FRAMES])
        self._keys = frames.generate_state(2 * len(self.times_ns), np.uint64).reshape(-1, 2).tolist()

    def render(self, tick: int, eye: int, out: NDArray[Any]) -> None:
        """Fill out (height, width) with what this eye (0 left, 1 right) sees at this edge."""
        bent = self._bent[eye]
        np.dot(self.modal_mm(tick), self._patches, out=bent.reshape(-1))
        self.render_bent(tick, eye, bent, out)

    def modal_mm(self, tick: int) -> FloatArray:
        """Factors (M,) of all computed modes' shapes at this edge."""
        return self._modal[tick]

    def render_bent(self, tick: int, eye: int, bent: FloatArray, out: NDArray[Any]) -> None:
        """The same with the wing bent otherwise: bent, its surface in patches (ex, ey, 4, 4) in mm."""
        modes = self.modes
        self._renderers[eye].render(out, bent, modes.x_mm, modes.y_mm, self._keys[tick][eye])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a pixel."""
        return self._renderers[0].sensor.dtype

    def displacement_mm(self, points_mm: FloatArray) -> FloatArray:
        """Displacement (T, P) along the wing's Z of wing points (P, 2)."""
        return self._modal @ self.modes.shapes(points_mm)[:, :, 0]

    def truth(self) -> dict[str, NDArray[Any]]:
        """The arrays of truth.npz."""
        displacement = self.displacement_mm(self.cells_mm)
        return wing_truth(self.times_ns, self.cells_mm, displacement, self.motion, self.eyes, self.pose)

    def _seed(self, stream: int) -> int:
        return int(np.random.SeedSequence([self.seed, stream]).generate_state(1)[0])

    def _make_renderers(self) -> tuple[Renderer, Renderer]:
        camera, lamp = self.scenario.camera, self.scenario.light
        sensor = Sensor(camera.bits, camera.psf_sigma_px, camera.full_well_e, camera.read_noise_e)
        level = lamp.level_per_ms * camera.exposure_ms * sensor.top
        wing, direction = self.scenario.wing, np.array(lamp.direction)
        light = Light(
            level=level,
            gradient=np.array(lamp.gradient),
            middle_mm=np.array([wing.length_mm / 2.0, 0.0]),
            extent_mm=np.array([wing.length_mm, wing.width_mm]),
            direction=direction / np.linalg.norm(direction),
        )
        self.art = make_artwork(self.scenario, np.random.default_rng([self.seed, _PAINT]))
        noise = noise_table(max(eye.width for eye in self.eyes), self._seed(_NOISE))
        left, right = (
            Renderer(eye, self.pose, self.art, light, sensor, level * lamp.background, noise) for eye in self.eyes
        )
        return left, right


def true_eyes(scenario: Scenario) -> tuple[Eye, Eye]:
    """The scenario's cameras (left, right) after binning."""
    rotation = nearest_rotation(scenario.stereo.rotation)
    places = ((np.eye(3), np.zeros(3)), (rotation, np.array(scenario.stereo.translation_mm)))
    left, right = (
        Eye(e.width, e.height, np.array([e.fx, e.fy, e.cx, e.cy]), np.array(e.distortion), *place).binned(
            scenario.camera.binning
        )
        for e, place in zip((scenario.left, scenario.right), places, strict=True)
    )
    return left, right


def true_pose(scenario: Scenario) -> Pose:
    """Where the scenario's wing truly stands."""
    pose = scenario.pose
    return pose_at(pose.point_mm, pose.at_mm, pose.x_axis, pose.normal)


def true_plate(scenario: Scenario) -> Plate:
    """The scenario's wing as a plate with fold lines."""
    s = scenario.structure
    return Plate(
        length_mm=scenario.wing.length_mm,
        width_mm=scenario.wing.width_mm,
        thickness_mm=s.thickness_mm,
        folds_mm=scenario.fold_lines_mm,
        youngs_gpa=s.youngs_gpa,
        density_kg_m3=s.density_kg_m3,
        poisson=s.poisson,
        hinge_nm_per_rad=s.hinge_nm_per_rad,
    )
