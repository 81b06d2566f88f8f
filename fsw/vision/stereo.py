"""Triangulation with covariance: from a cell's corners in both eyes to its centre in space."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.rig import Eyes, project
from wingbeat.kernels import kernel

BoolArray = NDArray[np.bool_]

FARTHEST_MM = 1e5  # a wing is not so far away: rays that are all but parallel meet nowhere

_STEPS = 2  # Gauss-Newton steps from the linear start; the problem is nearly linear


class Points(NamedTuple):
    """All N cells in space, in the left camera's frame; taken once, written every tick."""

    xyz_mm: FloatArray  # (N, 3) centre: mean of the four corners
    covariance_mm2: FloatArray  # (N, 3, 3)
    sigma_mm: FloatArray  # (N,) root of the covariance's trace
    reprojection_px: FloatArray  # (N,) rms of the centre over both eyes
    epipolar_px: FloatArray  # (N,) distance of the right centre from the left one's epipolar line, signed
    valid: BoolArray  # (N,)


def make_points(count: int) -> Points:
    """Take the arrays for `count` cells."""
    nan = np.nan
    return Points(
        np.full((count, 3), nan),
        np.full((count, 3, 3), nan),
        np.full(count, nan),
        np.full(count, nan),
        np.full(count, nan),
        np.zeros(count, dtype=np.bool_),
    )


@kernel
def triangulate(
    P: FloatArray, pixel: FloatArray, weight: FloatArray, N: FloatArray, g: FloatArray, xyz: FloatArray
) -> float:
    """Point of least weighted reprojection error, and that error.

    P (2, 3, 4). pixel (2, 2): ideal pixels in the two eyes. weight (2, 3): inverse covariance xx, xy, yy in each.
    N (3, 3), g (3,): working memory; N is left as the information matrix (inverse covariance) of the point.
    Writes xyz (3,), and returns the rms reprojection error in pixels over the four coordinates.
    """
    # Linear start: each pixel coordinate is a plane through its eye.
    N[:] = 0.0
    g[:] = 0.0
    for eye in range(2):
        for row in range(2):
            a = P[eye, row] - pixel[eye, row] * P[eye, 2]
            for i in range(3):
                g[i] -= a[i] * a[3]
                for j in range(3):
                    N[i, j] += a[i] * a[j]
    _solve3(N, g)
    xyz[:] = g
    squares = 0.0
    for step in range(_STEPS + 1):
        N[:] = 0.0
        g[:] = 0.0
        squares = 0.0
        for eye in range(2):
            u, v, w = project(P[eye], xyz[0], xyz[1], xyz[2])
            ru, rv = pixel[eye, 0] - u, pixel[eye, 1] - v
            squares += ru * ru + rv * rv
            for i in range(3):
                ui, vi = (P[eye, 0, i] - u * P[eye, 2, i]) / w, (P[eye, 1, i] - v * P[eye, 2, i]) / w
                wu, wv = weight[eye, 0] * ui + weight[eye, 1] * vi, weight[eye, 1] * ui + weight[eye, 2] * vi
                g[i] += wu * ru + wv * rv
                for j in range(3):
                    uj, vj = (P[eye, 0, j] - u * P[eye, 2, j]) / w, (P[eye, 1, j] - v * P[eye, 2, j]) / w
                    N[i, j] += wu * uj + wv * vj
        if step == _STEPS:
            break
        _solve3(N, g)
        for i in range(3):
            xyz[i] += g[i]
    return math.sqrt(squares / 4.0)


@kernel
def _invert3(A: FloatArray, out: FloatArray) -> None:
    """Inverse of a symmetric 3 x 3 matrix; infinite where it has none."""
    a, b, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    if det == 0.0:
        out[:] = np.inf
        return
    out[0, 0], out[1, 1], out[2, 2] = (d * f - e * e) / det, (a * f - c * c) / det, (a * d - b * b) / det
    out[0, 1] = out[1, 0] = (c * e - b * f) / det
    out[0, 2] = out[2, 0] = (b * e - c * d) / det
    out[1, 2] = out[2, 1] = (b * c - a * e) / det


@kernel
def _solve3(A: FloatArray, b: FloatArray) -> None:
    """Solve the symmetric 3 x 3 system A x = b; x replaces b, infinite where there is none."""
    a, p, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]
    det = a * (d * f - e * e) - p * (p * f - c * e) + c * (p * e - c * d)
    if det == 0.0:
        b[:] = np.inf
        return
    x, y, z = b[0], b[1], b[2]
    b[0] = ((d * f - e * e) * x + (c * e - p * f) * y + (p * e - c * d) * z) / det
    b[1] = ((c * e - p * f) * x + (a * f - c * c) * y + (p * c - a * e) * z) / det
    b[2] = ((p * e - c * d) * x + (p * c - a * e) * y + (a * d - p * p) * z) / det


@kernel
def triangulate_cells(
    eyes: Eyes,
    corners_px: FloatArray,
    centre_px: FloatArray,
    covariance_px2: FloatArray,
    matched: BoolArray,
    work: FloatArray,
    out: Points,
) -> None:
    """Triangulate the matched cells: corners one by one, their mean is the centre.

    corners_px (2, N, 4, 2), centre_px (2, N, 2), covariance_px2 (2, N, 3): ideal pixels in both eyes. matched (N,).
    work (7, 3): working memory. Results go to `out`.

    The mean of the corners has no perspective bias; its covariance is that of the centre's pixels.
    """
    pixel, weight, N, g = work[0:2, 0:2], work[2:4], work[4:7], np.empty(3)
    xyz = np.empty(3)
    P, F = eyes.projection, eyes.fundamental
    for n in range(matched.shape[0]):
        out.valid[n] = False
        out.xyz_mm[n] = np.nan
        out.covariance_mm2[n] = np.nan
        out.sigma_mm[n] = out.reprojection_px[n] = out.epipolar_px[n] = np.nan
        if not matched[n]:
            continue
        for eye in range(2):
            a, b, c = covariance_px2[eye, n]
            det = a * c - b * b
            weight[eye, 0], weight[eye, 1], weight[eye, 2] = c / det, -b / det, a / det
        mean_x, mean_y, mean_z = 0.0, 0.0, 0.0
        for k in range(4):
            for eye in range(2):
                pixel[eye, 0], pixel[eye, 1] = corners_px[eye, n, k, 0], corners_px[eye, n, k, 1]
            triangulate(P, pixel, weight, N, g, xyz)
            mean_x, mean_y, mean_z = mean_x + 0.25 * xyz[0], mean_y + 0.25 * xyz[1], mean_z + 0.25 * xyz[2]
        for eye in range(2):
            pixel[eye, 0], pixel[eye, 1] = centre_px[eye, n, 0], centre_px[eye, n, 1]
        out.reprojection_px[n] = triangulate(P, pixel, weight, N, g, xyz)
        out.xyz_mm[n, 0], out.xyz_mm[n, 1], out.xyz_mm[n, 2] = mean_x, mean_y, mean_z
        C = out.covariance_mm2[n]
        _invert3(N, C)
        out.sigma_mm[n] = math.sqrt(C[0, 0] + C[1, 1] + C[2, 2])
        u, v, x, y = centre_px[0, n, 0], centre_px[0, n, 1], centre_px[1, n, 0], centre_px[1, n, 1]
        la = F[0, 0] * u + F[0, 1] * v + F[0, 2]
        lb = F[1, 0] * u + F[1, 1] * v + F[1, 2]
        lc = F[2, 0] * u + F[2, 1] * v + F[2, 2]
        out.epipolar_px[n] = (la * x + lb * y + lc) / math.hypot(la, lb)
        depth = min(project(P[0], xyz[0], xyz[1], xyz[2])[2], project(P[1], xyz[0], xyz[1], xyz[2])[2])
        out.valid[n] = math.isfinite(out.sigma_mm[n]) and 0.0 < depth < FARTHEST_MM
