"""The disturbances of the table `sensors`: lenses and sensors of another make than the simulation's.

Sizes in px are those of the full image (4096 x 3000), as in `stress`. Where a lens or a sensor is the same in every
image, so is what it does here.
"""

import cv2
import numpy as np

from sim.bench.vision_disturbed import Disturbance, FloatArray, Sight
from sim.disturbances import LightImage

_DISC_PX = 8.0  # radius
_STEPS = 8  # a pixel, in which a disc is drawn
_ASKEW_PX = (2.4, 0.6)
_RIM_PX = 2.4
_VEIL, _VEIL_PX = 0.1, 12.0
_VIGNETTE = 0.5
_GAMMA = 0.8
_PIXEL_GAIN, _LINE_OFFSET, _HOT = 0.01, 0.001, 1e-4
_DARKER_EYE, _FLICKER = 0.6, 0.3


def disc(radius_px: float) -> FloatArray:
    """What a point becomes before the focus (n, n), of sum 1: a disc of even light."""
    reach = int(np.ceil(radius_px)) + 1
    side = 2 * reach + 1
    at = (np.arange(side * _STEPS) + 0.5) / _STEPS - side / 2.0
    inside = np.hypot(at[None, :], at[:, None]) <= radius_px
    shares = inside.reshape(side, _STEPS, side, _STEPS).mean(axis=(1, 3))
    return np.asarray(shares / shares.sum())


def _blur(light: LightImage, sigma_x: float, sigma_y: float) -> LightImage:
    return np.asarray(
        cv2.GaussianBlur(light, (0, 0), sigmaX=sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_REPLICATE), np.float32
    )


def _rim(light: LightImage) -> LightImage:
    """Squared distance (h, w) from the middle, 1 at the left and right rim."""
    height, width = light.shape
    x, y = np.arange(width) - 0.5 * width, np.arange(height) - 0.5 * height
    return np.asarray((x[None, :] ** 2 + y[:, None] ** 2) / (0.5 * width) ** 2, np.float32)


def _own(sight: Sight) -> np.random.Generator:
    """Draws that belong to an eye's sensor, whatever the tick."""
    return np.random.default_rng([sight.world.seed, sight.eye, 94])


def _defocus(light: LightImage, sight: Sight) -> None:
    light[:] = cv2.filter2D(light, -1, disc(_DISC_PX / sight.binning), borderType=cv2.BORDER_REPLICATE)


def _astigmatism(light: LightImage, sight: Sight) -> None:
    light[:] = _blur(light, _ASKEW_PX[0] / sight.binning, _ASKEW_PX[1] / sight.binning)


def _soft_rim(light: LightImage, sight: Sight) -> None:
    share = np.minimum(_rim(light), 1.0)
    light[:] = (1.0 - share) * light + share * _blur(light, _RIM_PX / sight.binning, _RIM_PX / sight.binning)


def _veil(light: LightImage, sight: Sight) -> None:
    wide = _VEIL_PX / sight.binning
    light[:] = (1.0 - _VEIL) * light + _VEIL * _blur(light, wide, wide)


def _vignette(light: LightImage, _: Sight) -> None:
    light *= 1.0 - _VIGNETTE * np.minimum(_rim(light), 1.0)


def _gamma(light: LightImage, _: Sight) -> None:
    light[:] = np.maximum(light, 0.0) ** _GAMMA


def _pixel_gain(light: LightImage, sight: Sight) -> None:
    light *= 1.0 + _PIXEL_GAIN * _own(sight).standard_normal(light.shape, np.float32)


def _line_offsets(light: LightImage, sight: Sight) -> None:
    draw = _own(sight)
    for shape in ((1, light.shape[1]), (light.shape[0], 1)):
        light += _LINE_OFFSET * draw.standard_normal(shape, np.float32)


def _hot_pixels(light: LightImage, sight: Sight) -> None:
    light[_own(sight).random(light.shape, np.float32) < _HOT] = 2.0


def _darker_eye(light: LightImage, sight: Sight) -> None:
    light *= np.float32(_DARKER_EYE if sight.eye == 1 else 1.0)


def _flicker(light: LightImage, sight: Sight) -> None:
    light *= np.float32(1.0 - _FLICKER * np.random.default_rng([sight.world.seed, sight.eye, sight.tick]).random())


SENSORS = (
    Disturbance("defocus, disc 8 px", shine=_defocus),
    Disturbance("astigmatism 2.4, 0.6 px", shine=_astigmatism),
    Disturbance("blur to 2.4 px at the rim", shine=_soft_rim),
    Disturbance("veil of 10 %, 12 px", shine=_veil),
    Disturbance("vignetting 50 %", shine=_vignette),
    Disturbance("response light^0.8", shine=_gamma),
    Disturbance("pixels' gain 1 %", shine=_pixel_gain),
    Disturbance("rows, columns 0.1 %", shine=_line_offsets),
    Disturbance("hot pixels, 1 in 10000", shine=_hot_pixels),
    Disturbance("right eye 40 % darker", shine=_darker_eye),
    Disturbance("lamp flickers by 30 %", shine=_flicker),
)
