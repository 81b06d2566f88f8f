"""Cells of a metric view in uneven light: lines are ridges, judged by the ridges near by."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import rank_filter

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
_SPARSE = 101  # of all pixels of the view, every so many tell their median


def local_cells(view: FloatImage, cell_px: tuple[float, float], line_px: tuple[float, float]) -> ByteImage:
    """Cells 255, all else 0, in a metric view whose cells are DARK and lie along its axes; for any smooth light.

    view (h, w); cell_px, line_px: width and height of cells, and of the lines across x and across y. Lines are ridges
    against what lies within a third of a cell (top-hat along x and along y), judged by the ridges near by; borders
    wider than that, and a bright background, rise above the cells' local level.
    """
    reach = 0.3 * min(cell_px)
    span = [int(2 * np.ceil((1.5 * line + reach) / 2.0) + 1) for line in line_px]
    tile = (max(4, round(1.15 * (cell_px[0] + line_px[0]))), max(4, round(1.15 * (cell_px[1] + line_px[1]))))
    over_x, over_y = (int(np.ceil(n / t)) for n, t in zip(view.shape[::-1], tile, strict=True))
    hats = [_top_hat(view, np.ones(shape, np.uint8)) for shape in ((1, span[0]), (span[1], 1))]
    base = np.zeros((over_y, over_x), dtype=np.float32)
    levels, weight, weighted = np.zeros((2, over_y, over_x), np.float32), np.zeros_like(base), np.zeros_like(base)
    _judge_tiles(view, hats[0], hats[1], tile, levels, weight, weighted, base)
    contrast = np.zeros_like(base)
    cells = np.full(view.shape, 255, dtype=np.uint8)
    for along in (0, 1):
        # One bright tile (a glint) does not count; a dark one (a shadow's edge, the sky) only down to a part.
        around = _near(levels[along], 6)
        level = np.clip(levels[along], _SHADE * around, around)
        floor = _NOISE * float(np.median(hats[along].ravel()[::_SPARSE]))
        contrast = np.maximum(contrast, level)
        cells &= _not_above(hats[along], _RIDGE * np.maximum(level, floor), tile)
    # A dark background beside the wing lies far below the cells: they reach up to the lines' level less a part.
    bright = np.maximum(_near(base, 2) + _PLATEAU * contrast, _near(weighted / weight, 4) - _BELOW * contrast)
    return cells & _not_above(view, bright, tile)


def _not_above(pixels: FloatImage, limit: FloatImage, tile: tuple[int, int]) -> ByteImage:
    """255 where pixels (h, w) reach up to a limit at most that is told at the tiles' centres, linear between them."""
    height, width = pixels.shape
    size = limit.shape[1] * tile[0], limit.shape[0] * tile[1]
    everywhere = cv2.resize(limit, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    return np.asarray(cv2.compare(pixels, everywhere, cv2.CMP_LE), np.uint8)


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
    highest, squares, bright = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    grey = np.empty(tile[0] * tile[1], np.float32)
    for j in range(base.shape[0]):
        top, bottom = j * tile[1], min((j + 1) * tile[1], height)
        highest[:], squares[:], bright[:] = 0.0, 0.0, 0.0
        for y in range(top, bottom):
            ridge_x, ridge_y, pixel = hat_x[y], hat_y[y], view[y]
            for x in range(width):
                both = ridge_x[x] * ridge_x[x] + ridge_y[x] * ridge_y[x]
                highest[x] = max(highest[x], ridge_y[x])
                squares[x] += both
                bright[x] += both * pixel[x]
            for i in range(base.shape[1]):
                levels[0, j, i] += ridge_x[i * tile[0] : (i + 1) * tile[0]].max()
        for i in range(base.shape[1]):
            left, right = i * tile[0], min((i + 1) * tile[0], width)
            levels[0, j, i] /= np.float32(bottom - top)
            levels[1, j, i] = highest[left:right].mean()
            weight[j, i], weighted[j, i] = np.float32(1e-6) + squares[left:right].sum(), bright[left:right].sum()
            count = 0
            for y in range(top, bottom, 3):
                for x in range(left, right, 3):
                    grey[count] = view[y, x]
                    count += 1
            base[j, i] = np.median(grey[:count])


def _near(level: FloatImage, rank: int) -> FloatImage:
    """The rank-th of the nine values round each tile (0 is the least)."""
    return np.asarray(rank_filter(level, rank, size=3, mode="nearest"), np.float32)
