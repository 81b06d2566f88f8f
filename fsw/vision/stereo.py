"""Triangulation with covariance: from a cell's corners in both eyes to its centre in space."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.rig import Eyes, project
from wingbeat.kernels import tick_kernel

BoolArray = NDArray[np.bool_]
Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float]  # xx, xy, yy
Matrix = tuple[float, float, float, float, float, float]  # xx, xy, xz, yy, yz, zz
Pixels = tuple[tuple[float, float], tuple[float, float]]  # u, v in the left and in the right eye

FARTHEST_MM = 1e5  # a wing is not so far away: rays that are all but parallel meet nowhere


class Points(NamedTuple):
    """All N cells in space, in the left camera's frame; taken once, written every tick."""

    xyz_mm: FloatArray  # (N, 3) centre, see triangulate_cells
    covariance_mm2: FloatArray  # (N, 3, 3)
    sigma_mm: FloatArray  # (N,) root of the covariance's trace
    reprojection_px: FloatArray  # (N,) rms of the centre over both eyes
    epipolar_px: FloatArray  # (N,) distance of the right centre from the left one's epipolar line, signed
    between_mm: FloatArray  # (N, 3) where an eye misses a side, from the centre to the corners' mean; else 0
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
        np.full((count, 3), nan),
        np.zeros(count, dtype=np.bool_),
    )


@tick_kernel
def triangulate(P: FloatArray, pixel: Pixels, weight: tuple[Symmetric, Symmetric]) -> Vector:
    """Point of least weighted reprojection error.

    P (2, 3, 4). pixel: ideal pixel in the left and in the right eye. weight: inverse covariance xx, xy, yy in each.
    One Gauss-Newton step from where the rays come nearest: that is right to the residuals, the step to their square.
    """
    # Linear start: each pixel coordinate is a plane through its eye.
    xx, xy, xz, yy, yz, zz, gx, gy, gz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for eye in range(2):
        Q = P[eye]
        for row in range(2):
            p = pixel[eye][row]
            a, b, c = Q[row, 0] - p * Q[2, 0], Q[row, 1] - p * Q[2, 1], Q[row, 2] - p * Q[2, 2]
            d = p * Q[2, 3] - Q[row, 3]
            xx, xy, xz, gx = xx + a * a, xy + a * b, xz + a * c, gx + a * d
            yy, yz, zz, gy, gz = yy + b * b, yz + b * c, zz + c * c, gy + b * d, gz + c * d
    start = _solve3((xx, xy, xz, yy, yz, zz), (gx, gy, gz))
    information, right, _ = _linearise(P, pixel, weight, start)
    dx, dy, dz = _solve3(information, right)
    return start[0] + dx, start[1] + dy, start[2] + dz


@tick_kernel
def _linearise(
    P: FloatArray, pixel: Pixels, weight: tuple[Symmetric, Symmetric], point: Vector
) -> tuple[Matrix, Vector, float]:
    """Normal equations of a point's step: its information (inverse covariance), right side, sum of squares in px^2."""
    xx, xy, xz, yy, yz, zz, gx, gy, gz, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for eye in range(2):
        Q = P[eye]
        u, v, w = project(Q, point[0], point[1], point[2])
        over = 1.0 / w
        ru, rv = pixel[eye][0] - u, pixel[eye][1] - v
        squares += ru * ru + rv * rv
        ux, uy, uz = (Q[0, 0] - u * Q[2, 0]) * over, (Q[0, 1] - u * Q[2, 1]) * over, (Q[0, 2] - u * Q[2, 2]) * over
        vx, vy, vz = (Q[1, 0] - v * Q[2, 0]) * over, (Q[1, 1] - v * Q[2, 1]) * over, (Q[1, 2] - v * Q[2, 2]) * over
        a, b, c = weight[eye]
        pu, pv = a * ux + b * vx, b * ux + c * vx
        xx, xy, xz = xx + pu * ux + pv * vx, xy + pu * uy + pv * vy, xz + pu * uz + pv * vz
        gx += pu * ru + pv * rv
        pu, pv = a * uy + b * vy, b * uy + c * vy
        yy, yz, gy = yy + pu * uy + pv * vy, yz + pu * uz + pv * vz, gy + pu * ru + pv * rv
        pu, pv = a * uz + b * vz, b * uz + c * vz
        zz, gz = zz + pu * uz + pv * vz, gz + pu * ru + pv * rv
    return (xx, xy, xz, yy, yz, zz), (gx, gy, gz), squares


@tick_kernel
def _inverse3(A: Matrix) -> Matrix:
    """Inverse of a symmetric 3 x 3 matrix; infinite where it has none."""
    a, b, c, d, e, f = A
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    if det == 0.0:
        return math.inf, math.inf, math.inf, math.inf, math.inf, math.inf
    over = 1.0 / det
    return (
        (d * f - e * e) * over,
        (c * e - b * f) * over,
        (b * e - c * d) * over,
        (a * f - c * c) * over,
        (b * c - a * e) * over,
        (a * d - b * b) * over,
    )


@tick_kernel
def _solve3(A: Matrix, b: Vector) -> Vector:
    """Solution x of the symmetric 3 x 3 system A x = b; infinite where there is none."""
    xx, xy, xz, yy, yz, zz = _inverse3(A)
    if not math.isfinite(xx):
        return math.inf, math.inf, math.inf
    return (
        xx * b[0] + xy * b[1] + xz * b[2],
        xy * b[0] + yy * b[1] + yz * b[2],
        xz * b[0] + yz * b[1] + zz * b[2],
    )


@tick_kernel
def triangulate_cells(
    eyes: Eyes,
    corners_px: FloatArray,
    centre_px: FloatArray,
    covariance_px2: FloatArray,
    matched: BoolArray,
    whole: tuple[BoolArray, BoolArray],
    out: Points,
) -> None:
    """Triangulate the matched cells: corners one by one, their mean is the centre.

    corners_px (2, N, 4, 2), centre_px (2, N, 2), covariance_px2 (2, N, 3): ideal pixels in both eyes. matched (N,).
    whole (N,), (N,): of which cells an eye has seen all sides. Results go to `out`.

    The mean of the corners has no perspective bias, however the cell is tilted; its covariance is that of the centre's
    pixels. Where a side is hidden the corners' depths are off by a tenth of a mm, each by another amount, and
    perspective moves their mean across it: there the centre's pixels are triangulated. They hang on the tilt that the
    surface has there, which is no better known: `unbend` tells what lies between the two as uncertain.
    """
    for n in range(matched.shape[0]):
        out.valid[n] = False
        out.xyz_mm[n] = out.between_mm[n] = np.nan
        out.covariance_mm2[n] = np.nan
        out.sigma_mm[n] = out.reprojection_px[n] = out.epipolar_px[n] = np.nan
    retriangulate_cells(eyes, corners_px, centre_px, covariance_px2, matched, whole, out)


@tick_kernel
def retriangulate_cells(
    eyes: Eyes,
    corners_px: FloatArray,
    centre_px: FloatArray,
    covariance_px2: FloatArray,
    chosen: BoolArray,
    whole: tuple[BoolArray, BoolArray],
    out: Points,
) -> None:
    """As triangulate_cells, of the chosen cells (N,): the others stay as they are."""
    P, F = eyes.projection, eyes.fundamental
    for n in range(chosen.shape[0]):
        if not chosen[n]:
            continue
        weight = (_weight(covariance_px2[0, n]), _weight(covariance_px2[1, n]))
        a, b = centre_px[0, n], centre_px[1, n]
        pixel = (a[0], a[1]), (b[0], b[1])
        centre = triangulate(P, pixel, weight)
        x, y, z = 0.0, 0.0, 0.0
        for k in range(4):
            a, b = corners_px[0, n, k], corners_px[1, n, k]
            corner = triangulate(P, ((a[0], a[1]), (b[0], b[1])), weight)
            x, y, z = x + 0.25 * corner[0], y + 0.25 * corner[1], z + 0.25 * corner[2]
        information, _, squares = _linearise(P, pixel, weight, centre)
        out.reprojection_px[n] = math.sqrt(squares / 4.0)  # over the four coordinates
        mean, place, between = (x, y, z), out.xyz_mm[n], out.between_mm[n]
        both = whole[0][n] and whole[1][n]
        for i in range(3):
            place[i], between[i] = (mean[i], 0.0) if both else (centre[i], mean[i] - centre[i])
        C = out.covariance_mm2[n]
        xx, xy, xz, yy, yz, zz = _inverse3(information)
        C[0, 0], C[1, 1], C[2, 2] = xx, yy, zz
        C[0, 1] = C[1, 0] = xy
        C[0, 2] = C[2, 0] = xz
        C[1, 2] = C[2, 1] = yz
        out.sigma_mm[n] = math.sqrt(xx + yy + zz)
        (u, v), (x, y) = pixel
        la = F[0, 0] * u + F[0, 1] * v + F[0, 2]
        lb = F[1, 0] * u + F[1, 1] * v + F[1, 2]
        lc = F[2, 0] * u + F[2, 1] * v + F[2, 2]
        out.epipolar_px[n] = (la * x + lb * y + lc) / math.hypot(la, lb)
        depth = min(project(P[0], *centre)[2], project(P[1], *centre)[2])
        out.valid[n] = math.isfinite(out.sigma_mm[n]) and 0.0 < depth < FARTHEST_MM


@tick_kernel
def _weight(covariance_px2: FloatArray) -> Symmetric:
    """Inverse of a covariance xx, xy, yy."""
    a, b, c = covariance_px2[0], covariance_px2[1], covariance_px2[2]
    over = 1.0 / (a * c - b * b)
    return c * over, -b * over, a * over
