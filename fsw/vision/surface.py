"""The wing's surface in one eye's metric view: a smooth displacement field, and the lines that show where cells are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.vision.enhancement import MetricView
from fsw.vision.grid import SIDES, CellGrid

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
        return xy_mm + _basis((xy_mm - self.middle_mm) / self.unit_mm) @ self.coefficient


def _basis(xy: FloatArray) -> FloatArray:
    x, y = xy[..., 0], xy[..., 1]
    return np.stack((np.ones_like(x), x, y, x * y, x * x, y * y, x**3, x * x * y), axis=-1)


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


def predicted_inside(view: MetricView, warp: Warp, grid: CellGrid) -> BoolArray:
    """Cells (N,) that lie wholly in the eye's image, with the lines round them."""
    line = np.nan_to_num(grid.line_mm, nan=float(np.nanmax(grid.line_mm, initial=1.0)))
    grow = np.stack((line[:, [3, 1, 1, 3]], line[:, [0, 0, 2, 2]]), axis=-1)
    outward = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.asarray(inside(view, warp(grid.corners_mm + outward * (grow + view.mm_per_px))).all(axis=1))


def inside(view: MetricView, xy_mm: FloatArray) -> BoolArray:
    """Whether points (..., 2) in mm lie where the view has an image."""
    return _sample(view.inside, view.pixel(xy_mm), False).astype(np.bool_)


def _sample(pixels: NDArray[np.generic], uv: FloatArray, beyond: float) -> NDArray[np.generic]:
    """Nearest pixel's value (...) at (..., 2)."""
    at = np.round(np.nan_to_num(uv, nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(np.int64)
    good = np.all((at >= 0) & (at < pixels.shape[::-1]), axis=-1)
    at = np.where(good[..., None], at, 0)
    return np.where(good, pixels[at[..., 1], at[..., 0]], beyond)


def line_contrast(
    view: MetricView, warp: Warp, grid: CellGrid, full_scale: float, cells: IntArray, usable: BoolArray
) -> FloatArray:
    """How much the lines round cells (m,) stand out, positive for lines; NaN where that cannot be seen.

    usable (m, 4): sides to look at; those at a panel's border have no line of known width and never count. Each
    side's line is looked for a little to the left and right of its place. Saturated cells tell nothing.
    """
    corner = grid.corners_mm[cells]
    following = np.roll(corner, -1, axis=1)
    points = corner[:, :, None] + _ALONG[:, None] * (following - corner)[:, :, None]  # (m, 4, p, 2)
    outward = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])[:, None]
    width = grid.line_mm[cells]
    size = np.linalg.norm(following - corner, axis=-1).min(axis=1)
    sign = 1.0 if grid.dark else -1.0

    def mean(offset: FloatArray) -> FloatArray:
        return np.asarray(
            _sample(view.pixels, view.pixel(warp(points + offset[:, :, None, None] * outward)), np.nan).mean(axis=2)
        )

    ok = usable & np.isfinite(width)
    width = np.where(ok, width, 0.0)
    slack = np.maximum(0.4 * width, view.mm_per_px)
    within = mean(np.repeat(-_DEPTH * size[:, None], SIDES, axis=1))
    on_line = np.stack([sign * mean(0.5 * width + k * slack) for k in (-1.0, 0.0, 1.0)]).max(axis=0)
    ok &= np.isfinite(within) & np.isfinite(on_line) & (within < _SATURATED * full_scale)
    count = ok.sum(axis=1)
    total = np.where(ok, on_line - sign * within, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
