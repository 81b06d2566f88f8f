"""What is measured of all cells in one eye, and corners and centre of a cell from its sides."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import COMMON, FloatArray
from fsw.vision.perspective import centre_share, seen_middle
from wingbeat.kernels import tick_kernel


class Cells(NamedTuple):
    """What is measured of all N cells in one eye, in ideal pixels; taken once, written every tick."""

    corners_px: FloatArray  # (N, 4, 2)
    centre_px: FloatArray  # (N, 2) projection of the middle of its corners, see corners_and_centre
    covariance_px2: FloatArray  # (N, 3) of the centre: xx, xy, yy
    pull: FloatArray  # (N, COMMON, 2) what more blur, and wider lines, would move the centre by, per px and their width
    residual_px: FloatArray  # (N,) rms of the segments about their straight sides
    contrast: FloatArray  # (N,) line minus cell, grey values
    found: NDArray[np.bool_]  # (N,)
    whole: NDArray[np.bool_]  # (N,) found, and with all four sides seen
    paired: NDArray[np.bool_]  # (N, 2) found, and with both sides along X, along Y seen


def make_cells(count: int) -> Cells:
    """Take the arrays for `count` cells."""
    nan = np.nan
    return Cells(
        np.full((count, 4, 2), nan),
        np.full((count, 2), nan),
        np.full((count, 3), nan),
        np.zeros((count, COMMON, 2)),
        np.full(count, nan),
        np.full(count, nan),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
        np.zeros((count, 2), dtype=np.bool_),
    )


def view_cells(eye: int, corners_px: FloatArray, centre_px: FloatArray, covariance_px2: FloatArray) -> Cells:
    """One eye's results, whose pixels are views of the arrays (2, N, ..) of both eyes."""
    own = make_cells(corners_px.shape[1])
    return own._replace(corners_px=corners_px[eye], centre_px=centre_px[eye], covariance_px2=covariance_px2[eye])


@tick_kernel
def add_pull(pull: FloatArray, x: float, y: float) -> None:
    """Add to what moves a centre."""
    pull[0] += x
    pull[1] += y


@tick_kernel
def corners_and_centre(
    c: FloatArray,
    depth: FloatArray,
    nx: FloatArray,
    ny: FloatArray,
    middle: FloatArray,
    slope: FloatArray,
    variance: FloatArray,
    n: int,
    out: Cells,
) -> None:
    """Corners as crossings of neighbouring sides, the projection of the cell's centre, and its covariance."""
    corners = out.corners_px[n]
    vxx, vxy, vyy = 0.0, 0.0, 0.0
    for k in range(4):
        # Sides j and k meet at corner k. Each is the expected side, moved along its normal by middle + slope * place.
        j = (k + 3) % 4
        ax, ay = (
            c[j, 0] + (middle[j] - 0.5 * slope[j]) * nx[j],
            c[j, 1] + (middle[j] - 0.5 * slope[j]) * ny[j],
        )
        bx, by = (
            c[k, 0] + (middle[j] + 0.5 * slope[j]) * nx[j],
            c[k, 1] + (middle[j] + 0.5 * slope[j]) * ny[j],
        )
        k1 = (k + 1) % 4
        px, py = (
            c[k, 0] + (middle[k] - 0.5 * slope[k]) * nx[k],
            c[k, 1] + (middle[k] - 0.5 * slope[k]) * ny[k],
        )
        qx, qy = (
            c[k1, 0] + (middle[k] + 0.5 * slope[k]) * nx[k],
            c[k1, 1] + (middle[k] + 0.5 * slope[k]) * ny[k],
        )
        dx, dy, fx, fy = bx - ax, by - ay, qx - px, qy - py
        t = ((px - ax) * fy - (py - ay) * fx) / (dx * fy - dy * fx)
        corners[k, 0], corners[k, 1] = ax + t * dx, ay + t * dy
        gx, gy = centre_share(nx, ny, k)
        vxx += variance[k] * gx * gx
        vxy += variance[k] * gx * gy
        vyy += variance[k] * gy * gy
    out.covariance_px2[n, 0], out.covariance_px2[n, 1], out.covariance_px2[n, 2] = vxx, vxy, vyy
    # The crossing of the measured diagonals would swing with the slopes of the long sides. Perspective moves the centre
    # off the corners' mean by a small amount that the expected shape knows well enough.
    x, y = seen_middle(c, depth)
    out.centre_px[n, 0] = x + 0.25 * (corners[:, 0].sum() - c[:, 0].sum())
    out.centre_px[n, 1] = y + 0.25 * (corners[:, 1].sum() - c[:, 1].sum())
