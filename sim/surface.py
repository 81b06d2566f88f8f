"""The wing's bent surface as bicubic patches: the one shape that both the images and the truth are made from."""

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

# Hermite cubic on [0, 1] as powers of u; rows: value at 0, slope at 0, value at 1, slope at 1.
_HERMITE = np.array([[1.0, 0.0, -3.0, 2.0], [0.0, 1.0, -2.0, 1.0], [0.0, 0.0, 3.0, -2.0], [0.0, 0.0, -1.0, 1.0]])


def make_patches(nodal: FloatArray, size: FloatArray) -> FloatArray:
    """Power coefficients of bicubic Hermite elements.

    nodal (..., 2, 2, 4): w, w_x, w_y, w_xy at the corners [x side, y side]; size (..., 2): element lengths in the
    unit of the slopes. Returns (..., 4, 4): w(u, v) = sum_ij c_ij u^i v^j with u, v in [0, 1].
    """
    lx, ly = size[..., 0, None, None], size[..., 1, None, None]
    scaled = nodal * np.stack([np.ones_like(lx), lx, ly, lx * ly], axis=-1)
    # Order the 16 numbers as (x end, x derivative, y end, y derivative): a product of two one-dimensional elements.
    by_axis = scaled.reshape(*scaled.shape[:-1], 2, 2)  # the last two: y derivative, x derivative
    tensor = np.moveaxis(by_axis, (-4, -3, -2, -1), (-4, -2, -1, -3)).reshape(*scaled.shape[:-3], 4, 4)
    return np.ascontiguousarray(np.einsum("ai,...ab,bj->...ij", _HERMITE, tensor, _HERMITE))


@kernel
def _interval(edges: FloatArray, value: float) -> int:
    low, high = 0, len(edges) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if value < edges[middle]:
            high = middle
        else:
            low = middle
    return low


@kernel
def height(patches: FloatArray, x_mm: FloatArray, y_mm: FloatArray, x: float, y: float) -> tuple[float, float, float]:
    """Displacement w and its slopes w_x, w_y at wing point (x, y) in mm.

    patches (ex, ey, 4, 4) on the element borders x_mm (ex + 1,), y_mm (ey + 1,). Beyond the wing the surface goes on in
    a straight line, so that the outline itself is as smooth as the inside.
    """
    xc = min(max(x, x_mm[0]), x_mm[-1])
    yc = min(max(y, y_mm[0]), y_mm[-1])
    i, j = _interval(x_mm, xc), _interval(y_mm, yc)
    lx, ly = x_mm[i + 1] - x_mm[i], y_mm[j + 1] - y_mm[j]
    u, v = (xc - x_mm[i]) / lx, (yc - y_mm[j]) / ly
    w, wu, wv = 0.0, 0.0, 0.0
    for k in range(3, -1, -1):
        c = patches[i, j, k]
        row = c[0] + v * (c[1] + v * (c[2] + v * c[3]))
        wu = wu * u + w
        w = w * u + row
        wv = wv * u + c[1] + v * (2.0 * c[2] + 3.0 * v * c[3])
    w_x, w_y = wu / lx, wv / ly
    return w + w_x * (x - xc) + w_y * (y - yc), w_x, w_y


@kernel
def heights(patches: FloatArray, x_mm: FloatArray, y_mm: FloatArray, points_mm: FloatArray) -> FloatArray:
    """w, w_x, w_y (P, 3) at wing points (P, 2); see `height`."""
    out = np.empty((len(points_mm), 3))
    for n in range(len(points_mm)):
        out[n, 0], out[n, 1], out[n, 2] = height(patches, x_mm, y_mm, points_mm[n, 0], points_mm[n, 1])
    return out
