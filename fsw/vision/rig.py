"""The stereo rig as arrays, and the pinhole camera with lens distortion (OpenCV's conventions)."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import inline_kernel, kernel, tick_kernel

FloatArray = NDArray[np.float64]

# Newton steps of the inverse distortion; each gains several digits for |k1| <= 0.3, so this reaches rounding error.
_UNDISTORT_STEPS = 8


@dataclass(frozen=True)
class StereoRig:
    """Two calibrated eyes (0 left, 1 right); X_right = R X_left + t.

    size (2, 2) int: width, height. intrinsics (2, 4): fx, fy, cx, cy. distortion (2, 5): k1 k2 p1 p2 k3.
    rotation (2, 3, 3), translation_mm (2, 3): from the left camera's frame into each eye's (identity for the left).
    """

    size: NDArray[np.int64]
    intrinsics: FloatArray
    distortion: FloatArray
    rotation: FloatArray
    translation_mm: FloatArray

    @property
    def baseline_mm(self) -> float:
        """Distance between the eyes."""
        return float(np.linalg.norm(self.translation_mm[1]))

    def into_eye(self, eye: int, xyz_mm: FloatArray) -> FloatArray:
        """Points (..., 3) of the left camera's frame in the frame of this eye."""
        return xyz_mm @ self.rotation[eye].T + self.translation_mm[eye]

    def project_ideal(self, eye: int, xyz_mm: FloatArray) -> FloatArray:
        """Ideal (undistorted) pixels (..., 2) of points (..., 3) in the left camera's frame; NaN behind the eye."""
        p = self.into_eye(eye, xyz_mm)
        depth = np.where(p[..., 2:] > 0.0, p[..., 2:], np.nan)
        return p[..., :2] / depth * self.intrinsics[eye, :2] + self.intrinsics[eye, 2:]

    def distort(self, eye: int, ideal_px: FloatArray) -> FloatArray:
        """Image pixels (..., 2) of ideal pixels (..., 2)."""
        flat = np.ascontiguousarray(ideal_px, dtype=np.float64).reshape(-1, 2)
        return distort_points(flat, self.intrinsics[eye], self.distortion[eye]).reshape(ideal_px.shape)

    def undistort(self, eye: int, image_px: FloatArray) -> FloatArray:
        """Ideal pixels (..., 2) of image pixels (..., 2)."""
        flat = np.ascontiguousarray(image_px, dtype=np.float64).reshape(-1, 2)
        return undistort_points(flat, self.intrinsics[eye], self.distortion[eye]).reshape(image_px.shape)

    def fundamental(self) -> FloatArray:
        """F (3, 3) with x_right^T F x_left = 0 for homogeneous ideal pixels."""
        R, (x, y, z) = self.rotation[1], self.translation_mm[1]
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.linalg.inv(self.matrix(1)).T @ cross @ R @ np.linalg.inv(self.matrix(0))

    def matrix(self, eye: int) -> FloatArray:
        """Camera matrix K (3, 3) of this eye."""
        fx, fy, cx, cy = self.intrinsics[eye]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


class Eyes(NamedTuple):
    """The rig as the kernels take it."""

    projection: FloatArray  # (2, 3, 4) from the left camera's frame to ideal pixels
    intrinsics: FloatArray  # (2, 4) fx, fy, cx, cy
    distortion: FloatArray  # (2, 5) k1 k2 p1 p2 k3
    size: NDArray[np.int64]  # (2, 2) width, height
    bounds: FloatArray  # (2, 4) least and greatest ideal u, least and greatest ideal v of the image
    fundamental: FloatArray  # (3, 3) x_right^T F x_left = 0


def eyes_of(rig: StereoRig) -> Eyes:
    """Kernel form of the rig."""
    pose = np.concatenate([rig.rotation, rig.translation_mm[:, :, None]], axis=2)
    projection = np.stack([rig.matrix(eye) @ pose[eye] for eye in (0, 1)])
    view = np.empty((2, 4))
    for eye in (0, 1):
        width, height = rig.size[eye]
        u, v = np.meshgrid(np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33))
        ideal = rig.undistort(eye, np.stack([u, v], axis=-1))
        view[eye] = ideal[..., 0].min(), ideal[..., 0].max(), ideal[..., 1].min(), ideal[..., 1].max()
    return Eyes(projection, rig.intrinsics, rig.distortion, rig.size, view, rig.fundamental())


@inline_kernel
def image_point(eyes: Eyes, eye: int, u: float, v: float) -> tuple[bool, float, float]:
    """Image pixel of an ideal pixel, and whether it lies in the image.

    Far outside the view the distortion's polynomial turns back on itself: such points are not in the image.
    """
    low_u, high_u, low_v, high_v = eyes.bounds[eye]
    if not (low_u <= u <= high_u and low_v <= v <= high_v):
        return False, u, v
    x, y, _, _, _, _ = distort_point(u, v, eyes.intrinsics[eye], eyes.distortion[eye])
    inside = 0.0 <= x <= eyes.size[eye, 0] - 1.0 and 0.0 <= y <= eyes.size[eye, 1] - 1.0
    return inside, x, y


@tick_kernel
def norm(x: float, y: float) -> float:
    """Length of a vector in the plane. The library's guards against overflow, at ten times the cost."""
    return math.sqrt(x * x + y * y)


@tick_kernel
def project(P: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Pixel and depth of a point."""
    w = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
    over = 1.0 / w
    u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) * over
    v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) * over
    return u, v, w


@tick_kernel
def distort_point(
    u: float, v: float, intrinsics: FloatArray, k: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Image pixel of the ideal pixel (u, v), and the Jacobian d(image)/d(ideal) as (x, y, xu, xv, yu, yv)."""
    x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]))
    xd = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x)
    yd = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
    xx = radial + x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
    xy = x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
    yy = radial + y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
    aspect = intrinsics[0] / intrinsics[1]
    return (
        xd * intrinsics[0] + intrinsics[2],
        yd * intrinsics[1] + intrinsics[3],
        xx,
        xy * aspect,
        xy / aspect,
        yy,
    )


@tick_kernel
def undistort_point(u: float, v: float, intrinsics: FloatArray, k: FloatArray) -> tuple[float, float]:
    """Ideal pixel of the image pixel (u, v), by Newton's method on distort_point."""
    x, y = u, v
    for _ in range(_UNDISTORT_STEPS):
        xd, yd, xx, xy, yx, yy = distort_point(x, y, intrinsics, k)
        ex, ey = u - xd, v - yd
        det = xx * yy - xy * yx
        x += (yy * ex - xy * ey) / det
        y += (xx * ey - yx * ex) / det
        if ex * ex + ey * ey < 1e-20:
            break
    return x, y


@kernel
def distort_points(ideal_px: FloatArray, intrinsics: FloatArray, distortion: FloatArray) -> FloatArray:
    """Image pixels (n, 2) of ideal pixels (n, 2)."""
    out = np.empty_like(ideal_px)
    for i in range(len(ideal_px)):
        x, y, _, _, _, _ = distort_point(ideal_px[i, 0], ideal_px[i, 1], intrinsics, distortion)
        out[i, 0], out[i, 1] = x, y
    return out


@kernel
def undistort_points(image_px: FloatArray, intrinsics: FloatArray, distortion: FloatArray) -> FloatArray:
    """Ideal pixels (n, 2) of image pixels (n, 2)."""
    out = np.empty_like(image_px)
    for i in range(len(image_px)):
        out[i, 0], out[i, 1] = undistort_point(image_px[i, 0], image_px[i, 1], intrinsics, distortion)
    return out
