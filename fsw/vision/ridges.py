"""Cells of a metric view in uneven light: lines are ridges, judged by the ridges near by."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.clustering import ByteImage, FloatImage
from wingbeat.kernels import kernel

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


def local_cells(
    view: FloatImage, cell_px: tuple[float, float], line_px: tuple[float, float]
) -> tuple[ByteImage, float]:
    """Cells 255, all else 0, in a metric view whose cells are DARK and lie along its axes; for any smooth light.

    view (h, w); cell_px, line_px: width and height of cells, and of the lines across x and across y. Also returns
    the typical contrast of a line. Lines are ridges against what lies within a third of a cell (top-hat along x and
    along y), judged by the ridges near by; borders wider than that, and a bright background, rise above the cells'
    local level.
    """
    reach = 0.3 * min(cell_px)
    span = [int(2 * np.ceil((1.5 * line + reach) / 2.0) + 1) for line in line_px]
    tile = (max(4, round(1.15 * (cell_px[0] + line_px[0]))), max(4, round(1.15 * (cell_px[1] + line_px[1]))))
    over_x, over_y = (int(np.ceil(n / t)) for n, t in zip(view.shape[::-1], tile, strict=True))
    hats = [_top_hat(view, np.ones(shape, np.uint8)) for shape in ((1, span[0]), (span[1], 1))]
    base = np.zeros((over_y, over_x), dtype=np.float32)
    levels, weight, weighted = np.zeros((2, over_y, over_x), np.float32), np.zeros_like(base), np.zeros_like(base)
    _judge_tiles(view, hats[0], hats[1], tile, levels, weight, weighted, base)
    contrast, limits = np.zeros_like(base), np.zeros((3, over_y, over_x), np.float32)
    for along in (0, 1):
        # One bright tile (a glint) does not count; a dark one (a shadow's edge, the sky) only down to a part.
        around = _rank(levels[along], 6)
        level = np.clip(levels[along], _SHADE * around, around)
        floor = _NOISE * float(np.median(hats[along][::3, ::3]))
        contrast = np.maximum(contrast, level)
        limits[along] = _RIDGE * np.maximum(level, floor)
    # A dark background beside the wing lies far below the cells: they reach up to the lines' level less a part.
    limits[2] = np.maximum(_rank(base, 2) + _PLATEAU * contrast, _rank(weighted / weight, 4) - _BELOW * contrast)
    cells = np.zeros(view.shape, dtype=np.uint8)
    _classify(view, hats[0], hats[1], tile, limits, cells)
    return cells, float(np.percentile(contrast, 75.0))


def _top_hat(view: FloatImage, shape: ByteImage) -> FloatImage:
    return np.asarray(cv2.morphologyEx(view, cv2.MORPH_TOPHAT, shape, borderType=cv2.BORDER_REPLICATE), np.float32)


@kernel
def _judge_tiles(
    view: FloatImage,
    hat_x: FloatImage,
    hat_y: FloatImage,
    tile: tuple[int, int],
    levels: NDArray[np.float32],
    weight: FloatImage,
    weighted: FloatImage,
    base: FloatImage,
) -> None:
    """Of each tile: ridges along x and y, squared ridges without and with the brightness there, median brightness.

    The highest ridge across a tile is averaged along it: a hot pixel or a hinge counts little. Tiles that reach beyond
    the view are judged by what they have.
    """
    height, width = view.shape
    column, grey = np.empty(tile[0], np.float32), np.empty(tile[0] * tile[1], np.float32)
    for j in range(base.shape[0]):
        top, bottom = j * tile[1], min((j + 1) * tile[1], height)
        for i in range(base.shape[1]):
            left, right = i * tile[0], min((i + 1) * tile[0], width)
            column[:] = 0.0
            rows, squares, bright, count = np.float32(0.0), np.float32(1e-6), np.float32(0.0), 0
            for y in range(top, bottom):
                highest = np.float32(0.0)
                for x in range(left, right):
                    a, b = hat_x[y, x], hat_y[y, x]
                    highest = max(highest, a)
                    column[x - left] = max(column[x - left], b)
                    both = a * a + b * b
                    squares += both
                    bright += both * view[y, x]
                rows += highest
                if (y - top) % 3 == 0:
                    for x in range(left, right, 3):
                        grey[count] = view[y, x]
                        count += 1
            levels[0, j, i] = rows / (bottom - top)
            levels[1, j, i] = column[: right - left].mean()
            weight[j, i], weighted[j, i] = squares, bright
            base[j, i] = np.median(grey[:count])


@kernel
def _classify(
    view: FloatImage,
    hat_x: FloatImage,
    hat_y: FloatImage,
    tile: tuple[int, int],
    limits: NDArray[np.float32],
    cells: ByteImage,
) -> None:
    """Set the pixels that no limit calls a line or a border; limits (3, ...) are interpolated between tiles' centres.

    limits: of the ridge along x, of the one along y, and of the brightness.
    """
    height, width = view.shape
    last_y, last_x = limits.shape[1] - 1, limits.shape[2] - 1
    row = np.empty((3, last_x + 1), np.float32)
    for y in range(height):
        at = min(max((y + 0.5) / tile[1] - 0.5, 0.0), float(last_y))
        j = min(int(at), max(last_y - 1, 0))
        f = np.float32(at - j)
        for k in range(3):
            for i in range(last_x + 1):
                row[k, i] = limits[k, j, i] + f * (limits[k, min(j + 1, last_y), i] - limits[k, j, i])
        # Between two tiles' centres each limit is a straight line.
        for i in range(-1, last_x + 1):
            first = max(0, -(-(tile[0] * (2 * i + 1) - 1) // 2))
            stop = min(width, -(-(tile[0] * (2 * i + 3) - 1) // 2))
            m, n = max(i, 0), min(i + 1, last_x)
            a, b, c = row[0, m], row[1, m], row[2, m]
            da, db, dc = (row[0, n] - a) / tile[0], (row[1, n] - b) / tile[0], (row[2, n] - c) / tile[0]
            middle = np.float32(tile[0] * (i + 0.5) - 0.5)
            for x in range(first, stop):
                d = np.float32(x) - middle
                dark = hat_x[y, x] <= a + d * da and hat_y[y, x] <= b + d * db and view[y, x] <= c + d * dc
                cells[y, x] = 255 if dark else 0


def _rank(level: FloatImage, rank: int) -> FloatImage:
    """The rank-th of the nine values round each tile (0 is the least)."""
    wide = np.pad(level, 1, mode="edge")
    near = np.stack([wide[y : y + level.shape[0], x : x + level.shape[1]] for y in range(3) for x in range(3)])
    return np.partition(near, rank, axis=0)[rank]
