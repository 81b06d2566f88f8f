"""What goes wrong with images: light, optics, sensor, and what stands before the wing.

The first part acts on light, before noise: images (h, w) of float32 in shares of full scale, altered in place; `expose`
then makes pixels of them. The second part acts on pixels.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import fftfreq, irfft2, next_fast_len, rfft2, rfftfreq

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
LightImage = NDArray[np.float32]
Mask = NDArray[np.bool_]

TILES = (6, 8)  # down and across: a glare covers one of them
_MARGIN_PX = 32  # mirrored round an image whose frequencies are altered: its far side is no neighbour
_HALO = 0.35  # of full scale, at the rim of a glint; it fades over the glint's radius


def ramp(light: LightImage, least: float, angle_rad: float) -> None:
    """Let light fall evenly from 1 to `least` across the image, along a direction."""
    height, width = light.shape
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
    along = np.cos(angle_rad) * (x - width / 2.0)[None, :] + np.sin(angle_rad) * (y - height / 2.0)[:, None]
    low, high = along.min(), along.max()
    light *= (1.0 - (1.0 - least) * (along - low) / (high - low)).astype(np.float32)


def half_shadow(light: LightImage, share_left: float, line: FloatArray) -> None:
    """Let a hard shadow fall beyond a line a x + b y > c (px), line (3,): so much of the light is left there."""
    height, width = light.shape
    a, b, c = line
    across = a * np.arange(width)[None, :] + b * np.arange(height)[:, None] - c
    light *= np.where(across > 0.0, share_left, 1.0).astype(np.float32)


def glint(light: LightImage, centre_px: FloatArray, radius_px: float) -> Mask:
    """Add a saturating disc with a halo; returns where it saturates (h, w)."""
    height, width = light.shape
    dx, dy = np.arange(width) - centre_px[0], np.arange(height) - centre_px[1]
    distance = np.sqrt(dx[None, :] ** 2 + dy[:, None] ** 2) / radius_px
    light += (_HALO * np.exp(-np.maximum(distance - 1.0, 0.0) * 3.0)).astype(np.float32) * (distance < 3.0)
    light[distance <= 1.0] = 2.0
    return np.asarray(light >= 1.0)


def bar(light: LightImage, line: FloatArray, half_px: float, level: float) -> Mask:
    """Paint a bar along a line a x + b y = c (unit normal), so wide to each side; returns where it is (h, w)."""
    height, width = light.shape
    a, b, c = line
    inside = np.abs(a * np.arange(width)[None, :] + b * np.arange(height)[:, None] - c) <= half_px
    light[inside] = level
    return np.asarray(inside)


def clouds(shape: tuple[int, int], draw: np.random.Generator) -> LightImage:
    """The Earth's sunlit clouds (h, w): bright, of all sizes, with edges."""
    height, width = shape
    out = np.full(shape, 0.55, np.float32)
    for size in (5, 17, 61):
        grain = draw.standard_normal((size, size * 4 // 3), np.float32)
        out += 0.22 * cv2.resize(grain, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(out, 0.1, 1.2)


def hot_rows(light: LightImage, rows: NDArray[np.int64]) -> Mask:
    """Let whole rows read full scale; returns where (h, w)."""
    light[rows] = 2.0
    mask = np.zeros(light.shape, np.bool_)
    mask[rows] = True
    return mask


def smear(light: LightImage, along_px: FloatArray) -> None:
    """Blur by a steady motion along_px (2,) during the exposure, the image being that of its middle.

    A uniform motion multiplies each frequency f by sinc(f . along). Between pixels, by interpolation, edges would come
    out some mpx off, by where in a pixel they lie.
    """
    height, width = light.shape
    wide = [next_fast_len(n + 2 * _MARGIN_PX, real=True) for n in light.shape]
    after = wide[0] - height - _MARGIN_PX, wide[1] - width - _MARGIN_PX
    spectrum = rfft2(np.pad(light, ((_MARGIN_PX, after[0]), (_MARGIN_PX, after[1])), mode="reflect"))
    turns = fftfreq(wide[0])[:, None] * along_px[1] + rfftfreq(wide[1]) * along_px[0]
    spectrum *= np.sinc(turns).astype(np.float32)
    inside = slice(_MARGIN_PX, _MARGIN_PX + height), slice(_MARGIN_PX, _MARGIN_PX + width)
    light[:] = irfft2(spectrum, wide)[inside]


def expose(
    light: LightImage, bits: int, full_well_e: float, read_noise_e: float, factor: float, draw: np.random.Generator
) -> NDArray[Any]:
    """Pixels (h, w) of light (h, w): shot and read noise, both `factor` times as strong, rounded and clipped."""
    top = np.float32((1 << bits) - 1)
    per_electron = top / np.float32(full_well_e)
    grey = np.minimum(light, np.float32(1.5)) * top
    deviation = np.sqrt(np.maximum(grey, 0.0) * per_electron + (np.float32(read_noise_e) * per_electron) ** 2)
    grey += np.float32(factor) * deviation * draw.standard_normal(light.shape, np.float32)
    return np.clip(np.rint(grey), 0.0, top).astype(np.uint8 if bits <= 8 else np.uint16)


def speckle(image: NDArray[Any], grain: float, seed: tuple[int, int, int]) -> None:
    """Add noise, of this standard deviation in grey levels."""
    noise = grain * np.random.default_rng(seed).standard_normal(image.shape, np.float32)
    image[:] = np.clip(image + noise, 0.0, np.iinfo(image.dtype).max)


def glare(image: NDArray[Any], share: float, pattern: int) -> None:
    """Saturate a share of the image's tiles."""
    down, across = TILES
    tall, wide = image.shape[0] // down, image.shape[1] // across
    order = np.random.default_rng([pattern, 66]).permutation(down * across)
    for tile in order[: round(share * down * across)]:
        top, left = tile // across * tall, tile % across * wide
        image[top : top + tall, left : left + wide] = np.iinfo(image.dtype).max


@kernel
def dim(image: NDArray[Any], gain: float) -> None:
    """Take light away."""
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            image[i, j] = int(min(max(image[i, j] * gain, 0.0), 255.0))


@kernel
def shift(image: NDArray[Any], by_px: float) -> None:
    """Move an image to the left by less than a pixel."""
    for i in range(image.shape[0]):
        for j in range(image.shape[1] - 1):
            image[i, j] = int((1.0 - by_px) * image[i, j] + by_px * image[i, j + 1] + 0.5)
