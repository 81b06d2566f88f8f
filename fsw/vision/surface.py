"""The wing's surface in one eye's metric view: a smooth displacement field, and the lines that show where cells are."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.vision.clustering import FloatImage
from fsw.vision.enhancement import MetricView
from fsw.vision.grid import SIDES, CellGrid
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

_UNIT = 0.2  # unit of length of the field's polynomial, in parts of the wing's length
# Prior sigma of the coefficients, in units: displacement, tilt and scale, perspective and bending, change of bending.
_SIGMA = np.array([1.0, 0.2, 0.2, 0.04, 0.04, 0.04, 0.013, 0.013])
_DATA_MM = 0.5  # what a centre's position is worth
_OUTLIER = 5.0  # medians
_ALONG = np.linspace(0.15, 0.85, 12)  # where a line is sampled, in parts of the side
_DEPTH = 0.25  # how far inside the cell it is compared, in parts of the cell's smaller size
_SATURATED = 0.98  # of full scale


@dataclass(frozen=True)
class Warp:
    """Displacement field from the flat wing (X, Y in mm) to a metric view (mm): a cubic that a prior keeps tame."""

    middle_mm: FloatArray
    unit_mm: float
    coefficient: FloatArray

    def __call__(self, xy_mm: FloatArray) -> FloatArray:
        """View positions (..., 2) in mm of wing points (..., 2)."""
        flat = np.ascontiguousarray(xy_mm).reshape(-1, 2)
        return _displaced(flat, self.middle_mm, self.unit_mm, self.coefficient).reshape(xy_mm.shape)


def _basis(xy: FloatArray) -> FloatArray:
    x, y = xy[..., 0], xy[..., 1]
    return np.stack((np.ones_like(x), x, y, x * y, x * x, y * y, x * x * x, x * x * y), axis=-1)


@kernel
def _displace(X: float, Y: float, middle: FloatArray, unit: float, c: FloatArray) -> tuple[float, float]:
    """One point of the field: the sum of the terms of _basis."""
    x, y = (X - middle[0]) / unit, (Y - middle[1]) / unit
    terms = (1.0, x, y, x * y, x * x, y * y, x * x * x, x * x * y)
    for k in range(8):
        X += terms[k] * c[k, 0]
        Y += terms[k] * c[k, 1]
    return X, Y


@kernel
def _displaced(xy_mm: FloatArray, middle: FloatArray, unit: float, coefficient: FloatArray) -> FloatArray:
    out = np.empty_like(xy_mm)
    for n in range(len(xy_mm)):
        out[n, 0], out[n, 1] = _displace(xy_mm[n, 0], xy_mm[n, 1], middle, unit, coefficient)
    return out


def fit_warp(grid: CellGrid, wing_mm: FloatArray, view_mm: FloatArray) -> tuple[Warp, FloatArray]:
    """Field through wing points (n, 2) seen at (n, 2), by regularised least squares; and the residuals (n,) in mm."""
    unit = _UNIT * grid.outline_mm[0]
    middle = wing_mm.mean(axis=0)
    A = _basis((wing_mm - middle) / unit)
    shift = view_mm - wing_mm
    use = np.ones(len(A), dtype=np.bool_)
    coefficient: FloatArray = np.zeros((A.shape[1], 2))
    residual: FloatArray = np.zeros(len(A))
    for _ in range(2):
        normal = A[use].T @ A[use] / _DATA_MM**2 + np.diag(1.0 / (_SIGMA * unit) ** 2)
        coefficient = np.asarray(np.linalg.solve(normal, A[use].T @ shift[use] / _DATA_MM**2), dtype=np.float64)
        residual = np.asarray(np.linalg.norm(A @ coefficient - shift, axis=1), dtype=np.float64)
        use = residual <= max(_OUTLIER * float(np.median(residual)), 1.0)
    return Warp(middle, unit, coefficient), residual


def predicted_inside(view: MetricView, warp: Warp, grid: CellGrid, cells: IntArray) -> BoolArray:
    """Which of the cells (m,) lie wholly in the eye's image, with the lines round them."""
    line = np.nan_to_num(grid.line_mm[cells], nan=float(np.nanmax(grid.line_mm, initial=1.0)))
    grow = np.stack((line[:, [3, 1, 1, 3]], line[:, [0, 0, 2, 2]]), axis=-1)
    outward = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.asarray(inside(view, warp(grid.corners_mm[cells] + outward * (grow + view.mm_per_px))).all(axis=1))


def inside(view: MetricView, xy_mm: FloatArray) -> BoolArray:
    """Whether points (..., 2) in mm lie where the view has an image."""
    at = np.round(np.nan_to_num(view.pixel(xy_mm), nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(np.int64)
    good = np.all((at >= 0) & (at < view.inside.shape[::-1]), axis=-1)
    at = np.where(good[..., None], at, 0)
    return np.asarray(good & view.inside[at[..., 1], at[..., 0]])


def line_contrast(
    view: MetricView, warp: Warp, grid: CellGrid, full_scale: float, cells: IntArray, usable: BoolArray
) -> FloatArray:
    """How much the lines round cells (m,) stand out, positive for lines; NaN where that cannot be seen.

    usable (m, 4): sides to look at; those at a panel's border have no line of known width and never count. Each
    side's line is looked for a little to the left and right of its place. Saturated cells tell nothing.
    """
    field = (warp.middle_mm, warp.unit_mm, warp.coefficient)
    place = (view.pixels, view.origin_mm, view.mm_per_px)
    sign = 1.0 if grid.dark else -1.0
    return _contrasts(*place, field, grid.corners_mm[cells], grid.line_mm[cells], usable, sign, _SATURATED * full_scale)


@kernel
def _contrasts(
    pixels: FloatImage,
    origin_mm: FloatArray,
    mm_per_px: float,
    field: tuple[FloatArray, float, FloatArray],
    corner: FloatArray,
    line_mm: FloatArray,
    usable: BoolArray,
    sign: float,
    saturated: float,
) -> FloatArray:
    """Contrast (m,) of the usable lines (m, 4) of known width round cells of these corners (m, 4, 2)."""
    out = np.empty(len(corner))
    for n in range(len(corner)):
        total, count, c = 0.0, 0, corner[n]
        lengths = [math.hypot(c[(k + 1) % 4, 0] - c[k, 0], c[(k + 1) % 4, 1] - c[k, 1]) for k in range(SIDES)]
        depth = _DEPTH * min(lengths)
        for k in range(SIDES):
            width = line_mm[n, k]
            if not usable[n, k] or math.isnan(width):
                continue
            slack, line = max(0.4 * width, mm_per_px), -np.inf
            within = _mean_along(pixels, origin_mm, mm_per_px, field, c, k, -depth)
            for i in range(3):
                value = sign * _mean_along(pixels, origin_mm, mm_per_px, field, c, k, 0.5 * width + (i - 1) * slack)
                line = value if math.isnan(value) else max(line, value)
                if math.isnan(line):
                    break
            if within < saturated and not math.isnan(line):
                total += line - sign * within
                count += 1
        out[n] = total / count if count > 0 else np.nan
    return out


@kernel
def _mean_along(
    pixels: FloatImage,
    origin_mm: FloatArray,
    mm_per_px: float,
    field: tuple[FloatArray, float, FloatArray],
    corner: FloatArray,
    side: int,
    outwards_mm: float,
) -> float:
    """Mean of the view's nearest pixels along a side moved outwards; NaN where the view does not have all of it."""
    middle, unit, coefficient = field
    a, b = corner[side], corner[(side + 1) % SIDES]
    away_x, away_y = ((0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))[side]
    total = 0.0
    for along in _ALONG:
        X, Y = a[0] + along * (b[0] - a[0]) + outwards_mm * away_x, a[1] + along * (b[1] - a[1]) + outwards_mm * away_y
        x, y = _displace(X, Y, middle, unit, coefficient)
        u, v = np.rint((x - origin_mm[0]) / mm_per_px), np.rint((y - origin_mm[1]) / mm_per_px)
        if not (0.0 <= u < pixels.shape[1] and 0.0 <= v < pixels.shape[0]):
            return np.nan
        total += pixels[int(v), int(u)]
    return total / len(_ALONG)
