"""The disturbances of the table `stress`: each by name, what it does to the scenario, to the light, and to the noise.

Sizes in px are those of the full image (4096 x 3000); the bench draws fewer, larger pixels and divides by `binning`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from hal.frame import as_frame, make_frames
from sim.disturbances import (
    LightImage,
    Mask,
    bar,
    clouds,
    expose,
    glint,
    half_shadow,
    hot_rows,
    ramp,
    smear,
)
from sim.scenario import Scenario
from sim.world import World, true_pose

FloatArray = NDArray[np.float64]

SPEED_MM_S = 100.0
_CLEAR = 1e9  # electrons: light without noise
_TOP = 65535.0
_BAR_HALF_PX, _BAR_LEVEL = 90.0, 0.35
_GLINTS, _GLINT_PX = 3, 170.0
_HOT_ROWS = 20
_SHADOW_STEP_PX = 40.0  # a tick
_MOST_TURN_DEG, _MOST_SHIFT_MM = 3.0, 25.0


@dataclass(frozen=True)
class Sight:
    """What a disturbance of light is told: the world, the eye, the tick, px of the full image a pixel, its own draw.

    draw starts anew for every image of a seed's eye, so that what stands still draws the same.
    """

    world: World
    eye: int
    tick: int
    binning: int
    draw: np.random.Generator


Alter = Callable[[Scenario, np.random.Generator], Scenario]
Shine = Callable[[LightImage, Sight], Mask | None]


@dataclass(frozen=True)
class Disturbance:
    """alter: the scenario; shine: the light before noise, returns what it hides; noise: times as strong."""

    name: str
    alter: Alter | None = None
    shine: Shine | None = None
    noise: float = 1.0


def clear_world(scenario: Scenario, seed: int, background: float | None = None) -> World:
    """The world whose images are light without noise, in 65535ths of full scale."""
    camera = msgspec.structs.replace(scenario.camera, bits=16, full_well_e=_CLEAR, read_noise_e=0.0)
    lamp = scenario.light
    if background is not None:
        lamp = msgspec.structs.replace(lamp, background=background)
    return World(msgspec.structs.replace(scenario, camera=camera, light=lamp), seed)


def light_of(world: World, tick: int, eye: int) -> LightImage:
    """Light (h, w) of one image, in shares of full scale."""
    camera = world.eyes[eye]
    image = make_frames((camera.height, camera.width), world.dtype)
    world.render(tick, eye, image)
    return image.astype(np.float32) / np.float32(_TOP)


def pixels_of(light: LightImage, scenario: Scenario, noise: float, seed: tuple[int, ...]) -> NDArray[Any]:
    """What the scenario's sensor makes of the light."""
    camera = scenario.camera
    draw = np.random.default_rng([*seed, 91])
    return as_frame(expose(light, camera.bits, camera.full_well_e, camera.read_noise_e, noise, draw))


def _shadow(left: float) -> Shine:
    def shine(light: LightImage, sight: Sight) -> None:
        height, width = light.shape
        angle = sight.draw.uniform(0.0, 2.0 * np.pi)
        a, b = np.cos(angle), np.sin(angle)
        at = a * width / 2.0 + b * height / 2.0 + (sight.tick - 2) * _SHADOW_STEP_PX / sight.binning
        half_shadow(light, left, np.array([a, b, at]))

    return shine


def _gradient(light: LightImage, sight: Sight) -> None:
    ramp(light, 0.3, float(sight.draw.uniform(0.0, 2.0 * np.pi)))


def _glints(light: LightImage, sight: Sight) -> Mask:
    height, width = light.shape
    mask = np.zeros(light.shape, np.bool_)
    for _ in range(_GLINTS):
        centre = sight.draw.uniform(0.15, 0.85, 2) * (width, height)
        mask |= glint(light, centre, _GLINT_PX / sight.binning)
    return mask


def _defocus(light: LightImage, sight: Sight) -> None:
    own = sight.world.scenario.camera.psf_sigma_px
    sigma = np.sqrt(max((3.0 / sight.binning) ** 2 - own**2, 0.0))
    light[:] = cv2.GaussianBlur(light, (0, 0), float(sigma), borderType=cv2.BORDER_REPLICATE)


def _earth(light: LightImage, sight: Sight) -> None:
    world = sight.world
    dark, bright = (
        light_of(clear_world(world.scenario, world.seed, share), sight.tick, sight.eye) for share in (0.0, 1.0)
    )
    beside = bright - dark
    light[:] = dark + beside / beside.max() * clouds(light.shape, sight.draw)


def _motion(light: LightImage, sight: Sight) -> None:
    world, scenario = sight.world, sight.world.scenario
    way = np.random.default_rng([world.seed, 92]).standard_normal(3)  # the same for both eyes
    way *= SPEED_MM_S * scenario.camera.exposure_ms * 1e-3 / np.linalg.norm(way)
    middle = world.pose.to_left(np.array([*scenario.pose.point_mm, 0.0]))
    before, after = world.eyes[sight.eye].project(np.stack([middle - 0.5 * way, middle + 0.5 * way]))
    smear(light, after - before)


def _rows(light: LightImage, sight: Sight) -> Mask:
    return hot_rows(light, sight.draw.choice(len(light), _HOT_ROWS, replace=False))


def _bar(light: LightImage, sight: Sight) -> Mask:
    height, width = light.shape
    angle = sight.draw.uniform(0.0, np.pi)
    a, b = np.cos(angle), np.sin(angle)
    at = sight.draw.uniform(0.35, 0.65, 2) @ (a * width, b * height)
    return bar(light, np.array([a, b, at]), _BAR_HALF_PX / sight.binning, _BAR_LEVEL)


def _yaw(degrees: float) -> Alter:
    def alter(scenario: Scenario, draw: np.random.Generator) -> Scenario:
        turn = np.deg2rad(degrees) * draw.choice((-1.0, 1.0))
        x, _, z = true_pose(scenario).rotation.T
        pose = msgspec.structs.replace(
            scenario.pose,
            x_axis=tuple(np.cos(turn) * x + np.sin(turn) * z),
            normal=tuple(np.cos(turn) * z - np.sin(turn) * x),
        )
        return msgspec.structs.replace(scenario, pose=pose)

    return alter


def _pose_error(scenario: Scenario, draw: np.random.Generator) -> Scenario:
    shift, turn = draw.standard_normal(3), draw.standard_normal(3)
    pose = msgspec.structs.replace(
        scenario.pose,
        nominal_shift_mm=tuple(_MOST_SHIFT_MM * shift / np.linalg.norm(shift)),
        nominal_turn_deg=tuple(_MOST_TURN_DEG * turn / np.linalg.norm(turn)),
    )
    return msgspec.structs.replace(scenario, pose=pose)


DISTURBANCES = (
    Disturbance("none"),
    Disturbance("half shadow -70 %", shine=_shadow(0.3)),
    Disturbance("half shadow -90 %", shine=_shadow(0.1)),
    Disturbance("gradient 70 %", shine=_gradient),
    Disturbance("three glints", shine=_glints),
    Disturbance("blur sigma 3 px", shine=_defocus),
    Disturbance("noise x 5", noise=5.0),
    Disturbance("yaw 30 deg", alter=_yaw(30.0)),
    Disturbance("yaw 45 deg", alter=_yaw(45.0)),
    Disturbance("Earth behind", shine=_earth),
    Disturbance("motion blur 100 mm/s", shine=_motion),
    Disturbance("20 hot rows", shine=_rows),
    Disturbance("bar before the wing", shine=_bar),
    Disturbance("pose off 25 mm, 3 deg", alter=_pose_error),
)
