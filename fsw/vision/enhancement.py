"""Characteristic enhancement: the equivalent view at right angles to the wing, and the scene's `char` (Eq. 13-20)."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.clustering import FloatImage, Image
from fsw.vision.rig import StereoRig
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIZE_FACTOR = 1e4  # C of Eq. 16
_NODE_STEP = 16  # pixels of the view between two exact points of its mapping; between them it is interpolated


@dataclass(frozen=True)
class MetricView:
    """An eye's image seen at right angles to the wing's nominal plane.

    pixels (h, w) float32, NaN-free; pixel (u, v) shows wing point origin_mm + mm_per_px * (u, v). inside (h, w)
    bool: where the image has it. to_px (3, 3): homography from wing-plane mm to ideal px of the eye.
    """

    pixels: FloatImage
    inside: NDArray[np.bool_]
    origin_mm: FloatArray
    mm_per_px: float
    to_px: FloatArray

    def ideal_px(self, xy_mm: FloatArray) -> FloatArray:
        """Ideal pixels (..., 2) of points (..., 2) of the view in mm."""
        return apply_homography(self.to_px, xy_mm)

    def pixel(self, xy_mm: FloatArray) -> FloatArray:
        """Pixels (..., 2) of the view of points (..., 2) in mm."""
        return (xy_mm - self.origin_mm) / self.mm_per_px


def apply_homography(H: FloatArray, xy: FloatArray) -> FloatArray:
    """Points (..., 2) mapped by a homography (3, 3)."""
    w = xy @ H[2, :2] + H[2, 2]
    return (xy @ H[:2, :2].T + H[:2, 2]) / w[..., None]


def plane_homography(rig: StereoRig, eye: int, R: FloatArray, t_mm: FloatArray) -> FloatArray:
    """Homography (3, 3) from the wing's plane (X, Y in mm) to the eye's ideal px, for X_left = R X_wing + t.

    Its inverse is the equivalent view: the full form of Eq. 13, under which the optical axis becomes the normal
    (Eq. 14).
    """
    Re = rig.rotation[eye] @ R
    te = rig.rotation[eye] @ t_mm + rig.translation_mm[eye]
    return rig.matrix(eye) @ np.column_stack((Re[:, 0], Re[:, 1], te))


def enhance_points(H: FloatArray, ideal_px: FloatArray) -> FloatArray:
    """Points (..., 2) in ideal px, moved to the equivalent view in mm: the inverse of plane_homography's H."""
    return apply_homography(np.linalg.inv(H).astype(np.float64), ideal_px)


def visible_region(
    rig: StereoRig, eye: int, R: FloatArray, t_mm: FloatArray, box_mm: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """The part of a box on the wing's plane that the eye sees, and the image's resolution there.

    box_mm (2, 2): lower and upper corner (X, Y). Returns the part's box (2, 2) in mm, and the least and the mean
    resolution (2,) in px per mm; None if nothing is seen.
    """
    x, y = (np.linspace(box_mm[0, k], box_mm[1, k], n) for k, n in ((0, 97), (1, 49)))
    nodes = np.stack(np.meshgrid(x, y), axis=-1)
    seen = _seen(rig, eye, R, t_mm, nodes)
    if not seen.any():
        return None
    margin = np.array([x[1] - x[0], y[1] - y[0]])
    low, high = nodes[seen].min(axis=0) - margin, nodes[seen].max(axis=0) + margin
    part = np.stack((np.maximum(low, box_mm[0]), np.minimum(high, box_mm[1])))
    jacobian = _px_per_mm(plane_homography(rig, eye, R, t_mm), nodes[seen])
    scale = np.linalg.svd(np.median(jacobian, axis=0), compute_uv=False)
    return part, np.array([scale[1], np.sqrt(scale[0] * scale[1])])


def metric_view(
    image: Image,
    rig: StereoRig,
    eye: int,
    R: FloatArray,
    t_mm: FloatArray,
    box_mm: FloatArray,
    mm_per_px: float,
    shrink: int = 1,
) -> MetricView:
    """Resample an image of this eye (lens distortion included) onto the wing's plane; box_mm (2, 2): corners.

    shrink: greatest factor by which the image may be averaged down first, where the view is coarser than the image.
    """
    small, shrink = _halved(image, shrink)
    width, height = (int(n) for n in np.ceil((box_mm[1] - box_mm[0]) / mm_per_px) + 1)
    cells = [(n + _NODE_STEP - 1) // _NODE_STEP + 1 for n in (width, height)]
    x, y = (box_mm[0, k] + mm_per_px * _NODE_STEP * np.arange(cells[k]) for k in (0, 1))
    nodes = np.stack(np.meshgrid(x, y), axis=-1)
    seen = _seen(rig, eye, R, t_mm, nodes, margin=0.2)
    ideal = apply_homography(plane_homography(rig, eye, R, t_mm), nodes)
    ideal[~seen] = -1e6
    # Averaging puts the centre of small pixel i at (i + 0.5) * shrink - 0.5 of the image.
    at = np.where(seen[..., None], (rig.distort(eye, ideal) + 0.5) / shrink - 0.5, -1e6)
    pixels = np.zeros((height, width), dtype=np.float32)
    inside = np.zeros((height, width), dtype=np.bool_)
    _resample(small, np.ascontiguousarray(at), pixels, inside)
    return MetricView(pixels, inside, box_mm[0].copy(), mm_per_px, plane_homography(rig, eye, R, t_mm))


def _halved(image: Image, most: int) -> tuple[Image, int]:
    """Mean of blocks, and their side: a power of two, which averages fastest, up to the one given.

    What is left over at the right and lower edge is dropped.
    """
    small: NDArray[Any] = image
    side = 1
    while 2 * side <= most:
        height, width = (n // 2 for n in small.shape)
        small = cv2.resize(small[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
        side *= 2
    return np.ascontiguousarray(small), side  # rows of a frame are apart: the kernel is compiled for one layout


def _seen(
    rig: StereoRig, eye: int, R: FloatArray, t_mm: FloatArray, nodes: FloatArray, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Which points (..., 2) of the wing's plane lie in the image (or near it)."""
    size = rig.size[eye].astype(np.float64)
    # Far outside the image the distortion's polynomial folds back: keep to what the image's rim spans when
    # undistorted.
    s = np.linspace(0.0, 1.0, 33)
    rim = np.concatenate([np.stack(p, axis=-1) for p in ((s, 0 * s), (s, 0 * s + 1), (0 * s, s), (0 * s + 1, s))])
    ideal_rim = rig.undistort(eye, rim * (size - 1.0))
    spread = margin * size
    low, high = ideal_rim.min(axis=0) - spread, ideal_rim.max(axis=0) + spread
    H = plane_homography(rig, eye, R, t_mm)
    depth = nodes @ H[2, :2] + H[2, 2]
    front = depth > 1e-3 * np.linalg.norm(t_mm)
    safe = np.where(front, depth, 1.0)
    px = (nodes @ H[:2, :2].T + H[:2, 2]) / safe[..., None]
    within = (px[..., 0] >= low[0]) & (px[..., 0] <= high[0]) & (px[..., 1] >= low[1]) & (px[..., 1] <= high[1])
    return np.asarray(front & within)


def _px_per_mm(H: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Resolution (n, 2, 2) at points (n, 2) of the wing's plane: the homography's Jacobian."""
    depth = points_mm @ H[2, :2] + H[2, 2]
    px = (points_mm @ H[:2, :2].T + H[:2, 2]) / depth[..., None]
    return np.asarray((H[:2, :2] - px[..., None] * H[2, None, :2]) / depth[..., None, None])


@kernel
def _resample(image: Image, at: FloatImage, pixels: FloatImage, inside: NDArray[np.bool_]) -> None:
    """Bilinear samples of the image at positions `at` (nodes _NODE_STEP apart), where the image has all four pixels."""
    height, width = image.shape
    last_x, last_y = width - 1.0, height - 1.0
    for v in range(pixels.shape[0]):
        j, b = v // _NODE_STEP, (v % _NODE_STEP) / _NODE_STEP
        for i in range(at.shape[1] - 1):
            x0 = (1.0 - b) * at[j, i, 0] + b * at[j + 1, i, 0]
            y0 = (1.0 - b) * at[j, i, 1] + b * at[j + 1, i, 1]
            x1 = (1.0 - b) * at[j, i + 1, 0] + b * at[j + 1, i + 1, 0]
            y1 = (1.0 - b) * at[j, i + 1, 1] + b * at[j + 1, i + 1, 1]
            if min(x0, x1) < -1e5 or max(x0, x1) < 0.0 or max(y0, y1) < 0.0:
                continue
            if min(x0, x1) >= last_x or min(y0, y1) >= last_y:
                continue
            dx, dy = (x1 - x0) / _NODE_STEP, (y1 - y0) / _NODE_STEP
            row, within = pixels[v, i * _NODE_STEP :], inside[v, i * _NODE_STEP :]
            for u in range(min(_NODE_STEP, len(row))):
                x, y = x0 + u * dx, y0 + u * dy
                if x < 0.0 or y < 0.0 or x >= last_x or y >= last_y:
                    continue
                m, n = int(x), int(y)
                p, q = np.float32(x - m), np.float32(y - n)
                m0, n0 = np.uintp(m), np.uintp(n)
                m1, n1 = np.uintp(m + 1), np.uintp(n + 1)
                left, right = np.float32(image[n0, m0]), np.float32(image[n0, m1])
                top = left + p * (right - left)
                left, right = np.float32(image[n1, m0]), np.float32(image[n1, m1])
                row[u] = top + q * (left + p * (right - left) - top)
                within[u] = True


def char(variance_x: float, variance_y: float, size_factor: float = SIZE_FACTOR) -> float:
    """Scene characteristic (Eq. 15-20) of two variances in px^2: near 1 for straight, distinct queues, 0 for none."""

    def normal(value: float) -> float:
        return math.atan(value) * 2.0 / math.pi

    x, y = (normal(size_factor * (1.0 - normal(max(v, 0.0)))) for v in (variance_x, variance_y))
    return math.sqrt(x * y)


def queue_variances(xy: FloatArray, column: IntArray, row: IntArray) -> tuple[float, float]:
    """Pooled variance of x inside columns and of y inside rows (Eq. 18, 19 on one queue each), in xy's unit squared.

    xy (n, 2); column, row (n,): the queue that each point stands in. NaN where no queue has two points.
    """

    def pooled(value: FloatArray, queue: IntArray) -> float:
        _, member = np.unique(queue, return_inverse=True)
        size = np.bincount(member)
        mean = np.bincount(member, value) / size
        freedom = len(value) - len(size)
        return float(np.sum((value - mean[member]) ** 2) / freedom) if freedom > 0 else float("nan")

    return pooled(xy[:, 0], column), pooled(xy[:, 1], row)
