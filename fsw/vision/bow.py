"""Cells of a bent wing are bent: what that does to points that were measured as if cells were flat."""

import math

import numpy as np

from fsw.vision.blur import PIXEL_VARIANCE
from fsw.vision.edges import FloatArray
from fsw.vision.perspective import centre_share
from fsw.vision.prediction import BENDING, RIGID, Surface
from fsw.vision.rig import Eyes, project
from fsw.vision.sides import inset_px
from fsw.vision.stereo import Points
from wingbeat.kernels import kernel


@kernel
def unbend(
    surface: Surface,
    eyes: Eyes,
    corners_px: FloatArray,
    covariance_px2: FloatArray,
    blur_px: FloatArray,
    points: Points,
) -> None:
    """Move the valid points from the mean of their cells' corners to the bent cells' centres.

    surface: fitted to the points. corners_px (2, N, 4, 2): its ideal pixels. covariance_px2 (2, N, 3): of the measured
    centres. blur_px (2,): the lens's. The wing bends along X: a side along X is an arch, found above its ends by the
    mean of its measured part, 1 - share^2 / 3 of the bow, and a side along Y lies at the ends. Moving each to the
    height of the centre moves the centre in both images, and so the point, by one step of its triangulation.
    """
    nx, ny, g, a = np.zeros(4), np.zeros(4), np.zeros(3), np.zeros((2, 3))
    for n in range(points.valid.shape[0]):
        if not points.valid[n]:
            continue
        g[:] = 0.0
        bow_mm = 0.0
        for j in range(BENDING):
            b = surface.basis[n, :, j]
            bow_mm += surface.unknowns[RIGID + j] * (b[4] - 0.25 * (b[0] + b[1] + b[2] + b[3]))
        X, Y, Z = points.xyz_mm[n, 0], points.xyz_mm[n, 1], points.xyz_mm[n, 2]
        for eye in range(2):
            c, P = corners_px[eye, n], eyes.projection[eye]
            whole = math.sqrt(blur_px[eye] * blur_px[eye] + PIXEL_VARIANCE)
            u, v, w = project(P, X, Y, Z)
            bow_x, bow_y = 0.0, 0.0
            for i in range(3):
                a[0, i], a[1, i] = (P[0, i] - u * P[2, i]) / w, (P[1, i] - v * P[2, i]) / w
                bow_x += a[0, i] * surface.rotation[i, 2] * bow_mm
                bow_y += a[1, i] * surface.rotation[i, 2] * bow_mm
            share = 0.0
            for k in range(4):
                ex, ey = c[(k + 1) % 4, 0] - c[k, 0], c[(k + 1) % 4, 1] - c[k, 1]
                length = math.hypot(ex, ey)
                nx[k], ny[k] = ey / length, -ex / length
                if k == 0:
                    share = 1.0 - 2.0 * inset_px(length, whole) / length
            dx, dy = 0.0, 0.0
            for k in range(4):
                lift = bow_x * nx[k] + bow_y * ny[k]
                if k % 2 == 0:
                    lift *= share * share / 3.0
                gx, gy = centre_share(nx, ny, k)
                dx, dy = dx + lift * gx, dy + lift * gy
            xx, xy, yy = covariance_px2[eye, n]
            det = xx * yy - xy * xy
            wx, wy = (yy * dx - xy * dy) / det, (xx * dy - xy * dx) / det
            for i in range(3):
                g[i] += a[0, i] * wx + a[1, i] * wy
        C = points.covariance_mm2[n]
        for i in range(3):
            points.xyz_mm[n, i] += C[i, 0] * g[0] + C[i, 1] * g[1] + C[i, 2] * g[2]
