"""Whether a frame is fit to be measured, from a sparse sample of its pixels: dark, saturated, stuck, torn.

What a frame repeats of the one before is evidence only where the camera is known to be noisy: noise makes no two
images alike, but a rendering without noise, or a sky, may well show the same grey twice.
"""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.hot import is_full_scale
from wingbeat.kernels import tick_kernel

STEP = 16  # one sample in each block of so many pixels, both ways; smaller blocks where an image is small
LEAST_BLOCKS = 64  # each way
STAGGER = 13  # pixels from block to block: the sample keeps no step with the pattern of the wing
BANDS = 16  # of rows, from top to bottom
KNOWN_FRAMES = 8  # good frames in a row in which it changed, until a band, or the camera, is known to be noisy
BAND_SHARE = 0.5  # of a band's samples that may repeat in a frame that changed
FRAME_SHARE = 0.9  # the same of all samples; near a turning point without noise more of them do
LEAST_SAMPLES = 16  # a band with fewer samples says nothing
DARK_SHARE, BRIGHT_SHARE = 0.01, 0.99
SPREAD, MEDIAN, MIDDLE, TOP, TOP_SHARE, REPEATED, REPEATED_INSIDE = range(7)


class Unfit(IntEnum):
    """Why a frame is not fit; FIT is 0."""

    FIT = 0
    BLACK = 1
    SATURATED = 2
    STUCK = 3
    TORN = 4


class FrameCheck:
    """Judges the frames of one eye, one after the other; all its memory is taken here.

    black_levels: a frame whose grey levels (1st to 99th percentile) spread no further shows nothing (four times that
    for 16 bits), unless its level lies above the middle of the last good frame's. saturated_share: a frame with so many
    samples at its brightest value is saturated, if that is a converter's full scale. A tear is found where it takes a
    whole band. figures: of the frame that was looked at last, see `inspect`.
    """

    def __init__(self, shape: tuple[int, int], dtype: np.dtype[Any], black_levels: float, saturated_share: float):
        self._step = max(1, min(STEP, min(shape) // LEAST_BLOCKS))
        rows, columns = (size // self._step for size in shape)
        levels = int(np.iinfo(dtype).max) + 1
        self.black_levels, self.saturated_share = black_levels, saturated_share
        self.figures = np.zeros(7)
        self._wide = 4.0 if levels > 256 else 1.0
        self._before = np.zeros((rows, columns), dtype)
        self._histogram = np.zeros(levels, np.int32)
        self._bands = np.zeros(min(BANDS, rows))
        self._lively = np.zeros(len(self._bands), np.int64)  # good frames in a row in which each band changed
        self._changing = 0  # good frames in a row that changed
        self._seen = False  # there is a frame before
        self._middle = 0.5 * levels  # between dark and bright in the last good frame

    @property
    def share_at_top(self) -> float:
        """Share of the last frame's samples at its brightest value."""
        return float(self.figures[TOP_SHARE])

    def init(self, image: NDArray[Any]) -> None:
        """Compile the kernels on an image (height, width) that is no frame."""
        inspect(image, self._before, self._step, self._histogram, self.figures, self._bands)
        self._bands.fill(np.nan)
        learn(self._bands, self._lively)
        torn(self._bands, self._lively)

    def look(self, image: NDArray[Any]) -> Unfit:
        """Judge a frame (height, width); it becomes the one before."""
        inspect(image, self._before, self._step, self._histogram, self.figures, self._bands)
        verdict = self._judge()
        if verdict is Unfit.FIT:
            self._middle = float(self.figures[MIDDLE])
            if self._seen:
                self._changing = self._changing + 1 if self.figures[REPEATED_INSIDE] <= FRAME_SHARE else 0
                learn(self._bands, self._lively)
        self._seen = True
        return verdict

    def _judge(self) -> Unfit:
        figures = self.figures
        if figures[SPREAD] <= self.black_levels * self._wide and figures[MEDIAN] <= self._middle:
            return Unfit.BLACK
        if figures[TOP_SHARE] >= self.saturated_share and is_full_scale(int(figures[TOP])):
            return Unfit.SATURATED
        if figures[REPEATED] == 1.0 and self._changing >= KNOWN_FRAMES:
            return Unfit.STUCK
        return Unfit.TORN if torn(self._bands, self._lively) else Unfit.FIT


@tick_kernel
def inspect(
    image: NDArray[Any],
    before: NDArray[Any],
    step: int,
    histogram: NDArray[np.int32],
    figures: NDArray[np.float64],
    bands: NDArray[np.float64],
) -> None:
    """Fill figures (7,) and bands (B,) from the sparse sample of an image, and keep the sample in `before`.

    The sample has one pixel of each block of step by step pixels.

    figures: spread from the 1st to the 99th percentile, median, middle between these percentiles, brightest value,
    share of samples at it, share that repeats the frame before, and the same share of those inside, between the
    darkest and the brightest value: others may be clipped, and clipped ones have no noise. bands: the last figure for
    each band of rows, NaN where too few samples are inside. histogram: work space, a place for each value.
    """
    rows, columns = before.shape
    histogram[:] = 0
    low = high = int(image[0, 0])
    for i in range(rows):
        for j in range(columns):
            value = int(image[sample_at(i, j, step), sample_at(j, i, step)])
            low, high = min(low, value), max(high, value)
            histogram[value] += 1
    inside = repeated = repeated_inside = 0
    for band in range(len(bands)):
        here = repeated_here = 0
        for i in range(band * rows // len(bands), (band + 1) * rows // len(bands)):
            for j in range(columns):
                pixel = image[sample_at(i, j, step), sample_at(j, i, step)]
                same, within = pixel == before[i, j], low < int(pixel) < high
                before[i, j] = pixel
                repeated += same
                here += within
                repeated_here += same and within
        inside += here
        repeated_inside += repeated_here
        bands[band] = repeated_here / here if here >= LEAST_SAMPLES else np.nan
    count = rows * columns
    dark, bright = level_of(histogram, low, DARK_SHARE * count), level_of(histogram, low, BRIGHT_SHARE * count)
    figures[SPREAD], figures[MIDDLE] = bright - dark, 0.5 * (bright + dark)
    figures[MEDIAN] = level_of(histogram, low, 0.5 * count)
    figures[TOP], figures[TOP_SHARE] = high, histogram[high] / count
    figures[REPEATED] = repeated / count
    figures[REPEATED_INSIDE] = repeated_inside / inside if inside > 0 else 1.0


@tick_kernel
def sample_at(block: int, across: int, step: int) -> int:
    """Place of a block's sample along one axis; across: number of the block along the other axis."""
    return block * step + STAGGER * across % step


@tick_kernel
def level_of(histogram: NDArray[np.int32], first: int, rank: float) -> float:
    """The value, not below `first`, up to which at least `rank` samples lie."""
    value, seen = first, histogram[first]
    while seen < rank:
        value += 1
        seen += histogram[value]
    return float(value)


@tick_kernel
def learn(bands: NDArray[np.float64], lively: NDArray[np.int64]) -> None:
    """Count for each band the good frames in a row in which it changed; a band that says nothing keeps its count."""
    for band in range(len(bands)):
        if bands[band] <= BAND_SHARE:
            lively[band] += 1
        elif bands[band] > BAND_SHARE:
            lively[band] = 0


@tick_kernel
def torn(bands: NDArray[np.float64], lively: NDArray[np.int64]) -> bool:
    """Whether of the bands that are known to be noisy one repeats in every sample, and another one changed."""
    repeats = changes = False
    for band in range(len(bands)):
        if lively[band] >= KNOWN_FRAMES:
            repeats = repeats or bands[band] == 1.0
            changes = changes or bands[band] <= BAND_SHARE
    return repeats and changes
