"""Cells of a binary image: the paper's centres from boundary pixels, and corners from contours."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.clustering import ByteImage, FloatArray, Image, binarise
from wingbeat.kernels import kernel

# Points nearer to a corner than this part of a side do not count for the side's line: corners are rounded by the
# lens.
_MIDDLE = 0.72
_MAX_RESIDUAL = 0.045  # rms distance of a side's points from its line, in parts of the cell's smaller size


def gradient(image: Image | ByteImage) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sobel magnitude (Eq. 10) and direction in rad (Eq. 11) of an image (h, w)."""
    dx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3)
    dy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3)
    return np.asarray(cv2.magnitude(dx, dy), np.float32), np.asarray(cv2.phase(dx, dy), np.float32)


def paper_centres(image: Image, dark: bool, area_px: tuple[float, float]) -> FloatArray:
    """Feature points (n, 2) in px as in the paper: K-means, binary image, Sobel, mean of each cell's boundary pixels.

    image (h, w), 8 or 16 bits; area_px: least and greatest area of a cell. Eq. 6-12, taken literally: one threshold
    for the whole image, and a mean that is not quite the cell's centre under perspective. Cells at the rim are left
    out.
    """
    binary = binarise(image, dark)
    magnitude, _ = gradient(binary)
    _, label, stats, _ = cv2.connectedComponentsWithStats(binary, connectivity=4)
    height, width = image.shape
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    whole = (left > 0) & (top > 0)
    whole &= (left + stats[:, cv2.CC_STAT_WIDTH] < width) & (top + stats[:, cv2.CC_STAT_HEIGHT] < height)
    area = stats[:, cv2.CC_STAT_AREA]
    chosen = whole & (area >= area_px[0]) & (area <= area_px[1])
    chosen[0] = False
    y, x = np.nonzero((magnitude > 0.0) & chosen[label])
    cell = label[y, x]
    size = np.bincount(cell, minlength=len(stats))[chosen]
    sums = [np.bincount(cell, weights, minlength=len(stats))[chosen] for weights in (x, y)]
    return np.stack(sums, axis=1) / size[:, None]


def quadrilaterals(cells: ByteImage, cell_px: tuple[float, float], tolerance: float) -> FloatArray:
    """Corners (n, 4, 2) in px of the blobs that look like a cell; corner order as in CellGrid.

    cells (h, w): blobs nonzero, their sides roughly along the axes. cell_px: expected width and height; tolerance:
    how far the sides may differ from them, relative. A line is fitted to the middle of each side; corners are their
    crossings.
    """
    contours, hierarchy = cv2.findContours(cells, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    least = 2.0 * (1.0 - tolerance) * sum(cell_px) * 0.8
    most = 2.0 * (1.0 + tolerance) * sum(cell_px) * 1.3
    blobs = [c for i, c in enumerate(contours) if least <= len(c) <= most and hierarchy[0, i, 3] < 0]
    if not blobs:
        return np.empty((0, 4, 2))
    first = np.concatenate(([0], np.cumsum([len(b) for b in blobs])))
    points = np.concatenate(blobs)[:, 0].astype(np.float64)
    size = np.array(cells.shape[::-1], dtype=np.float64)
    corners, good = _fit(points, first, np.array(cell_px), tolerance, size)
    return np.asarray(corners[good])


@kernel
def _fit(
    points: FloatArray, first: NDArray[np.int64], cell_px: FloatArray, tolerance: float, size: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Corners (n, 4, 2) and whether they make a cell (n,), of contours given by their points and first indices."""
    count = len(first) - 1
    corners = np.empty((count, 4, 2))
    good = np.zeros(count, dtype=np.bool_)
    # A contour runs through the centres of the outermost pixels: the true edge lies half a pixel further out.
    outward = np.array([-0.5, 0.5, 0.5, -0.5])
    us, vs = np.empty(len(points)), np.empty(len(points))
    for n in range(count):
        p = points[first[n] : first[n + 1]]
        low_x, high_x, low_y, high_y = p[:, 0].min(), p[:, 0].max(), p[:, 1].min(), p[:, 1].max()
        if low_x <= 0.0 or low_y <= 0.0 or high_x >= size[0] - 1.0 or high_y >= size[1] - 1.0:
            continue
        if (
            high_x - low_x > 1.5 * (1.0 + tolerance) * cell_px[0]
            or high_y - low_y > 1.8 * (1.0 + tolerance) * cell_px[1]
        ):
            continue
        middle = np.array([(low_x + high_x) / 2.0, (low_y + high_y) / 2.0])
        half = np.array([(high_x - low_x) / 2.0, (high_y - low_y) / 2.0])
        line = np.zeros((4, 2))
        fine = True
        for side in range(4):
            across = 1 if side % 2 == 0 else 0  # sides 0 and 2 run along x: y is fitted against x
            along = 1 - across
            sign = -1.0 if side == 0 or side == 3 else 1.0
            found = 0
            for q in range(len(p)):
                u, v = (p[q, along] - middle[along]) / half[along], p[q, across] - middle[across]
                if abs(u) <= _MIDDLE and v * sign > 0.0:
                    us[found], vs[found], found = u, v, found + 1
            a, b, tilt = 0.0, 0.0, np.inf
            for _ in range(3):
                s, su, suu, sv, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for q in range(found):
                    u, v = us[q], vs[q]
                    if abs(v - a - b * u) > tilt:
                        continue
                    s, su, suu = s + 1.0, su + u, suu + u * u
                    sv, suv, svv = sv + v, suv + u * v, svv + v * v
                det = s * suu - su * su
                if s < 0.5 * _MIDDLE * 2.0 * half[along] or det <= 1e-6 * s * s:
                    fine = False
                    break
                a, b = (suu * sv - su * suv) / det, (s * suv - su * sv) / det
                rms = np.sqrt(max(0.0, (svv - a * sv - b * suv) / s))
                tilt = max(2.0 * rms, 1.0)
            if not fine or rms > max(0.75, _MAX_RESIDUAL * min(cell_px[0], cell_px[1])):
                fine = False
                break
            line[side, 0], line[side, 1] = a + outward[side], b / half[along]
        if not fine:
            continue
        for k in range(4):
            row, column = (line[0], line[3]) if k == 0 else (line[0], line[1]) if k == 1 else (
                (line[2], line[1]) if k == 2 else (line[2], line[3])
            )  # fmt: skip
            x = (column[0] + column[1] * row[0]) / (1.0 - column[1] * row[1])
            corners[n, k, 0], corners[n, k, 1] = middle[0] + x, middle[1] + row[0] + row[1] * x
        c = corners[n]
        width = 0.5 * (np.hypot(c[1, 0] - c[0, 0], c[1, 1] - c[0, 1]) + np.hypot(c[2, 0] - c[3, 0], c[2, 1] - c[3, 1]))
        height = 0.5 * (np.hypot(c[3, 0] - c[0, 0], c[3, 1] - c[0, 1]) + np.hypot(c[2, 0] - c[1, 0], c[2, 1] - c[1, 1]))
        # Outside the tolerance, or a side that does not run parallel to its partner: no cell.
        skew = np.hypot(c[0, 0] - c[1, 0] + c[2, 0] - c[3, 0], c[0, 1] - c[1, 1] + c[2, 1] - c[3, 1])
        good[n] = (
            abs(width / cell_px[0] - 1.0) <= tolerance
            and abs(height / cell_px[1] - 1.0) <= tolerance
            and skew <= 0.25 * min(cell_px[0], cell_px[1])
        )
    return corners, good


@kernel
def refine(corners: FloatArray, view: NDArray[np.float32], reach: int) -> None:
    """Move corners (n, 4, 2) of dark cells to where the view (h, w) rises most steeply across each side.

    reach: px that an edge may lie off. A side with too few clear edges stays. Written in place.
    """
    samples, steps = 9, 4 * reach + 1
    offset, weight = np.empty(samples), np.empty(samples)
    profile = np.empty(steps)
    for n in range(len(corners)):
        line = np.empty((4, 3))  # a x + b y = c, outward normal (a, b)
        for side in range(4):
            x0, y0 = corners[n, side]
            x1, y1 = corners[n, (side + 1) % 4]
            length = np.hypot(x1 - x0, y1 - y0)
            a, b = (y1 - y0) / length, -(x1 - x0) / length
            found = 0
            for i in range(samples):
                along = 0.14 + 0.72 * i / (samples - 1)
                for k in range(steps):
                    d = (k - 2 * reach) * 0.5
                    x, y = x0 + along * (x1 - x0) + d * a, y0 + along * (y1 - y0) + d * b
                    m = min(max(int(x), 0), view.shape[1] - 2)
                    j = min(max(int(y), 0), view.shape[0] - 2)
                    p, q = x - m, y - j
                    profile[k] = (1 - q) * ((1 - p) * view[j, m] + p * view[j, m + 1]) + q * (
                        (1 - p) * view[j + 1, m] + p * view[j + 1, m + 1]
                    )
                best, top = 2, 0.0
                for k in range(2, steps - 2):
                    if profile[k + 1] - profile[k - 1] > top:
                        best, top = k, profile[k + 1] - profile[k - 1]
                if top <= 0.0:
                    continue
                before, after = profile[best] - profile[best - 2], profile[best + 2] - profile[best]
                bend = before - 2.0 * top + after
                peak = best + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)
                offset[found], weight[found] = (peak - 2 * reach) * 0.5, along - 0.5
                found += 1
            shift, turn = 0.0, 0.0
            if found >= samples // 2:
                middle = np.median(offset[:found])
                s, su, suu, sv, suv = 0.0, 0.0, 0.0, 0.0, 0.0
                for i in range(found):
                    if abs(offset[i] - middle) <= 1.0:
                        s, su, suu = s + 1.0, su + weight[i], suu + weight[i] ** 2
                        sv, suv = sv + offset[i], suv + weight[i] * offset[i]
                det = s * suu - su * su
                if s >= samples // 2 and det > 0.1 * s:
                    shift = (suu * sv - su * suv) / det
                    turn = (s * suv - su * sv) / det
            x0, y0 = x0 + (shift - 0.5 * turn) * a, y0 + (shift - 0.5 * turn) * b
            x1, y1 = x1 + (shift + 0.5 * turn) * a, y1 + (shift + 0.5 * turn) * b
            line[side, 0], line[side, 1] = y1 - y0, x0 - x1
            line[side, 2] = line[side, 0] * x0 + line[side, 1] * y0
        for k in range(4):
            p, q = line[(k + 3) % 4], line[k]
            det = p[0] * q[1] - p[1] * q[0]
            corners[n, k, 0] = (p[2] * q[1] - p[1] * q[2]) / det
            corners[n, k, 1] = (p[0] * q[2] - p[2] * q[0]) / det


def centres_of(corners: FloatArray) -> FloatArray:
    """Crossing of the diagonals (..., 2) of quadrilaterals (..., 4, 2): projectively the centre of a rectangle."""
    p, q = corners[..., 0, :], corners[..., 1, :]
    r, s = corners[..., 2, :] - p, corners[..., 3, :] - q
    along = ((q - p)[..., 0] * s[..., 1] - (q - p)[..., 1] * s[..., 0]) / (
        r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    )
    return np.asarray(p + along[..., None] * r)
