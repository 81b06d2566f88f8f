"""The true cameras: pinholes with lens distortion (OpenCV's conventions), and how the right one stands to the left one.

Written apart from the flight side's camera model on purpose: what one of them gets wrong, the other shows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Eye:
    """One camera: image size, fx, fy, cx, cy in pixels, distortion k1 k2 p1 p2 k3, and X_eye = R X_left + t."""

    width: int
    height: int
    intrinsics: FloatArray
    distortion: FloatArray
    rotation: FloatArray
    translation_mm: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix K (3, 3)."""
        fx, fy, cx, cy = self.intrinsics
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(self, xyz_left_mm: FloatArray) -> FloatArray:
        """Image pixels (..., 2) of points (..., 3) in the left camera's frame; NaN behind the camera."""
        x, y, z = np.moveaxis(xyz_left_mm @ self.rotation.T + self.translation_mm, -1, 0)
        z = np.where(z > 0.0, z, np.nan)
        x, y = x / z, y / z
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        fx, fy, cx, cy = self.intrinsics
        u = fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx
        v = fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + cy
        return np.stack([u, v], axis=-1)

    def binned(self, factor: int) -> "Eye":
        """The same camera with factor x factor pixels read as one; pixel centres stay at whole numbers."""
        fx, fy, cx, cy = self.intrinsics
        return Eye(
            self.width // factor,
            self.height // factor,
            np.array([fx / factor, fy / factor, (cx + 0.5) / factor - 0.5, (cy + 0.5) / factor - 0.5]),
            self.distortion,
            self.rotation,
            self.translation_mm,
        )


@dataclass(frozen=True)
class Pose:
    """Where the wing's frame stands: X_left = R X_wing + t."""

    rotation: FloatArray
    translation_mm: FloatArray

    def to_left(self, xyz_wing_mm: FloatArray) -> FloatArray:
        """Points (..., 3) of the wing's frame in the left camera's."""
        return xyz_wing_mm @ self.rotation.T + self.translation_mm

    def moved(self, shift_mm: ArrayLike, turn_deg: ArrayLike, about_wing_mm: ArrayLike) -> "Pose":
        """This pose shifted, and turned by a rotation vector in the left camera's frame about a point of the wing."""
        turn = rotation_matrix(np.deg2rad(turn_deg))
        pivot = self.to_left(np.asarray(about_wing_mm, dtype=np.float64))
        translation = turn @ (self.translation_mm - pivot) + pivot + np.asarray(shift_mm, dtype=np.float64)
        return Pose(nearest_rotation(turn @ self.rotation), translation)


def rotation_matrix(vector_rad: ArrayLike) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (3,) (Rodrigues)."""
    x, y, z = np.asarray(vector_rad, dtype=np.float64)
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # sinc keeps both factors exact at angle 0.
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.eye(3) + first * cross + second * cross @ cross


def nearest_rotation(matrix: ArrayLike) -> FloatArray:
    """The rotation nearest to a matrix (3, 3) of few printed digits (polar decomposition)."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def pose_at(point_mm: ArrayLike, at_mm: ArrayLike, x_axis: ArrayLike, normal: ArrayLike) -> Pose:
    """Pose that puts wing point (X, Y) at a place in the left camera's frame.

    normal (3,): direction of the wing's Z; x_axis (3,): of its X, made square to the normal.
    """
    z = np.asarray(normal, dtype=np.float64) / np.linalg.norm(normal)
    x = np.asarray(x_axis, dtype=np.float64)
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    rotation = np.column_stack([x, np.cross(z, x), z])
    return Pose(rotation, np.asarray(at_mm, dtype=np.float64) - rotation[:, :2] @ np.asarray(point_mm))
