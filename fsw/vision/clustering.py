"""Grey values into classes: exact one-dimensional K-means, and a local threshold for uneven light."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteImage = NDArray[np.uint8]
Image = NDArray[np.uint8] | NDArray[np.uint16]
FloatImage = NDArray[np.float32]

CLASSES = 3  # K of the paper: background, cells, lines
# A pixel belongs to a line where its ridge reaches this part of the ridges around it: below one half, so that a
# line which the lens has blurred still separates two cells beside a broad bright border.
_RIDGE = 0.45
# Lines beside a shadow's edge are looked for down to this part of the lit ones' ridge.
_SHADE = 0.3
# A pixel above the cells' level by this part of a line's contrast is no cell (borders, bright background).
_PLATEAU = 0.75
# Cells lie below the brightness of the lines near by, at least by this part of a line's contrast.
_BELOW = 0.35
# Ridges smaller than this many times the median ridge (which is noise: most pixels lie on no line) are noise.
_NOISE = 5.0


@kernel
def histogram(image: Image, levels: int, row_step: int) -> IntArray:
    """Count (levels,) of each grey value in every row_step-th row of an image."""
    count = np.zeros(levels, dtype=np.int64)
    for y in range(0, image.shape[0], row_step):
        for x in range(image.shape[1]):
            count[image[y, x]] += 1
    return count


@kernel
def _split(values: FloatArray, weights: FloatArray, classes: int) -> IntArray:
    """First index of each class (classes + 1,) in the partition of sorted values with the least sum of squares."""
    n = len(values)
    origin = values[n // 2]
    s0, s1, s2 = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    for i in range(n):
        v = values[i] - origin
        s0[i + 1] = s0[i] + weights[i]
        s1[i + 1] = s1[i] + weights[i] * v
        s2[i + 1] = s2[i] + weights[i] * v * v
    best = np.empty((classes, n + 1))
    start = np.zeros((classes, n + 1), dtype=np.int64)
    for j in range(n + 1):
        best[0, j] = s2[j] - s1[j] * s1[j] / s0[j] if j else 0.0
    stack = np.empty((4 * n + 8, 4), dtype=np.int64)
    for k in range(1, classes):
        best[k, :] = np.inf
        # The best start of the last class moves only upwards with the end: halve the range of ends, then of starts.
        stack[0] = (k + 1, n, k, n - 1)
        top = 1
        while top:
            top -= 1
            low, high, first, last = stack[top]
            end = (low + high) // 2
            for i in range(first, min(end - 1, last) + 1):
                total, mean = s0[end] - s0[i], s1[end] - s1[i]
                cost = best[k - 1, i] + s2[end] - s2[i] - mean * mean / total
                if cost < best[k, end]:
                    best[k, end] = cost
                    start[k, end] = i
            if low < end:
                stack[top] = (low, end - 1, first, start[k, end])
                top += 1
            if end < high:
                stack[top] = (end + 1, high, start[k, end], last)
                top += 1
    bounds = np.empty(classes + 1, dtype=np.int64)
    bounds[classes] = n
    for k in range(classes - 1, -1, -1):
        bounds[k] = start[k, bounds[k + 1]] if k else 0
    return bounds


def kmeans(count: IntArray, classes: int = CLASSES) -> tuple[FloatArray, IntArray]:
    """Exact K-means of grey values from their histogram (Eq. 6-9), by dynamic programming.

    count (levels,). Returns centres (K,), rising, and thresholds (K - 1,): the highest grey value of each lower
    class. K is at most the number of different grey values: with fewer, fewer classes come back.
    """
    values = np.flatnonzero(count)
    classes = min(classes, len(values))
    if classes == 0:
        return np.empty(0), np.empty(0, dtype=np.int64)
    weights = count[values].astype(np.float64)
    bounds = _split(values.astype(np.float64), weights, classes)
    centres = np.add.reduceat(values * weights, bounds[:-1]) / np.add.reduceat(weights, bounds[:-1])
    return centres, values[bounds[1:-1] - 1]


def binarise(image: Image, dark: bool, classes: int = CLASSES, row_step: int = 4) -> ByteImage:
    """Cells 255, all else 0, split where K-means sees the greatest step between neighbouring classes.

    image (h, w), 8 or 16 bits. One threshold for the whole image, as in the paper: it fails under a shadow or
    gradient.
    """
    count = histogram(image, int(np.iinfo(image.dtype).max) + 1, row_step)
    centres, thresholds = kmeans(count, classes)
    if len(centres) < 2:
        return np.zeros(image.shape, dtype=np.uint8)
    level = int(thresholds[np.argmax(np.diff(centres))])
    cells = cv2.inRange(image, 0, level) if dark else cv2.inRange(image, level + 1, int(np.iinfo(image.dtype).max))
    return np.asarray(cells, dtype=np.uint8)


def local_cells(
    view: FloatImage, cell_px: tuple[float, float], line_px: tuple[float, float]
) -> tuple[ByteImage, float]:
    """Cells 255, all else 0, in a metric view whose cells are DARK and lie along its axes; for any smooth light.

    view (h, w); cell_px, line_px: width and height of cells, and of the lines across x and across y. Also returns
    the typical contrast of a line. Lines are ridges against what lies within a third of a cell (top-hat along x and
    along y), judged by the ridges near by; borders wider than that, and a bright background, rise above the cells'
    local level.
    """
    height, width = view.shape
    reach = 0.3 * min(cell_px)
    span = [int(2 * np.ceil((1.5 * line + reach) / 2.0) + 1) for line in line_px]
    tile = [max(4, round(1.15 * (c + line))) for c, line in zip(cell_px, line_px, strict=True)]
    over = [int(np.ceil(n / t)) for n, t in zip((width, height), tile, strict=True)]
    ridge = np.zeros(view.shape, dtype=bool)
    contrast = np.zeros((over[1], over[0]), dtype=np.float32)
    weight, weighted = np.full_like(contrast, 1e-6), np.zeros_like(contrast)
    for along, shape in enumerate((np.ones((1, span[0]), np.uint8), np.ones((span[1], 1), np.uint8))):
        top = cv2.morphologyEx(view, cv2.MORPH_TOPHAT, shape, borderType=cv2.BORDER_REPLICATE)
        hat = np.asarray(top, dtype=np.float32)
        tiles = _tiles(hat, tile, over)
        # The highest ridge across a tile, averaged along it: a hot pixel or a hinge counts little.
        level = tiles.max(axis=3).mean(axis=1) if along == 0 else tiles.max(axis=1).mean(axis=2)
        # One bright tile (a glint) does not count; a dark one (a shadow's edge, the sky) only down to a part.
        around = _rank(level, 6)
        level = np.clip(level, _SHADE * around, around)
        floor = _NOISE * float(np.median(hat[::3, ::3]))
        contrast = np.maximum(contrast, level)
        weight += np.square(tiles).sum(axis=(1, 3))
        weighted += (np.square(tiles) * _tiles(view, tile, over)).sum(axis=(1, 3))
        ridge |= hat > _spread(_RIDGE * np.maximum(level, floor), tile, view.shape)
    base = np.median(_tiles(view, tile, over)[:, ::3, :, ::3], axis=(1, 3)).astype(np.float32)
    # A dark background beside the wing lies far below the cells: they reach up to the lines' level less a part.
    ceiling_at = np.maximum(_rank(base, 2) + _PLATEAU * contrast, _rank(weighted / weight, 4) - _BELOW * contrast)
    ceiling = _spread(ceiling_at, tile, view.shape)
    cells = np.where(ridge | (view > ceiling), np.uint8(0), np.uint8(255))
    return cells, float(np.percentile(contrast, 75.0))


def _tiles(view: FloatImage, tile: list[int], over: list[int]) -> FloatImage:
    """View as (tile row, y in it, tile column, x in it); the last ones are filled by repeating the edge."""
    pad = (over[1] * tile[1] - view.shape[0], over[0] * tile[0] - view.shape[1])
    filled = cv2.copyMakeBorder(view, 0, pad[0], 0, pad[1], cv2.BORDER_REPLICATE)
    return np.asarray(filled, dtype=np.float32).reshape(over[1], tile[1], over[0], tile[0])


def _rank(level: FloatImage, rank: int) -> FloatImage:
    """The rank-th of the nine values round each tile (0 is the least)."""
    wide = np.pad(level, 1, mode="edge")
    near = np.stack([wide[y : y + level.shape[0], x : x + level.shape[1]] for y in range(3) for x in range(3)])
    return np.partition(near, rank, axis=0)[rank]


def _spread(level: FloatImage, tile: list[int], shape: tuple[int, ...]) -> FloatImage:
    """Values at the tiles' centres, interpolated to every pixel."""
    full = cv2.resize(level, (level.shape[1] * tile[0], level.shape[0] * tile[1]), interpolation=cv2.INTER_LINEAR)
    return np.asarray(full, dtype=np.float32)[: shape[0], : shape[1]]
