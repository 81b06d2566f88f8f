"""A drawing of the wing at its nominal pose: something to be found, on which the search's kernels compile at INIT."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from fsw.vision.enhancement import apply_homography, plane_homography
from fsw.vision.grid import CellGrid
from fsw.vision.rig import StereoRig
from hal.frame import make_frames

FloatArray = NDArray[np.float64]

CELL, LINE = 0.15, 0.6  # of full scale; the other way round where cells are brighter than the lines
BORDER_MM = 3.0  # of the panels, round their outermost cells


def sketch(rig: StereoRig, eye: int, grid: CellGrid, R: FloatArray, t_mm: FloatArray, dtype: DTypeLike) -> NDArray[Any]:
    """Image (h, w) of the flat wing at X_left = R X_wing + t: even cells, even lines, sharp, without noise."""
    width, height = (int(n) for n in rig.size[eye])
    full = float(np.iinfo(np.dtype(dtype)).max)
    cell, line = (CELL * full, LINE * full) if grid.dark else (LINE * full, CELL * full)
    image = make_frames((height, width), dtype)
    H = plane_homography(rig, eye, R, t_mm)
    # Far outside the image the lens's polynomial folds back; so far only is drawn.
    reach = np.array([width, height])

    def draw(corners_mm: FloatArray, grey: float) -> None:
        ideal = apply_homography(H, corners_mm)
        near = np.all((ideal > -0.2 * reach) & (ideal < 1.2 * reach), axis=(1, 2))
        for corners in np.rint(rig.distort(eye, ideal[near])).astype(np.int32):
            cv2.fillConvexPoly(image, corners, grey)

    outward = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    line_mm = np.nan_to_num(grid.line_mm, nan=BORDER_MM)
    grow = np.stack((line_mm[:, [3, 1, 1, 3]], line_mm[:, [0, 0, 2, 2]]), axis=-1)
    draw(grid.corners_mm + outward * grow, line)
    draw(grid.corners_mm, cell)
    return image
