"""Grey values into classes: exact one-dimensional K-means, and one threshold for the whole image, as in the paper."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteImage = NDArray[np.uint8]
Image = NDArray[np.uint8] | NDArray[np.uint16]
FloatImage = NDArray[np.float32]

CLASSES = 3  # K of the paper: background, cells, lines


@kernel
def histogram(image: Image, levels: int, row_step: int) -> IntArray:
    """Count (levels,) of each grey value in every row_step-th row of an image."""
    count = np.zeros(levels, dtype=np.int64)
    for y in range(0, image.shape[0], row_step):
        for x in range(image.shape[1]):
            count[image[y, x]] += 1
    return count


@kernel
def _split(values: FloatArray, weights: FloatArray, classes: int) -> IntArray:
    """First index of each class (classes + 1,) in the partition of sorted values with the least sum of squares."""
    n = len(values)
    origin = values[n // 2]
    s0, s1, s2 = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    for i in range(n):
        v = values[i] - origin
        s0[i + 1] = s0[i] + weights[i]
        s1[i + 1] = s1[i] + weights[i] * v
        s2[i + 1] = s2[i] + weights[i] * v * v
    best = np.empty((classes, n + 1))
    start = np.zeros((classes, n + 1), dtype=np.int64)
    for j in range(n + 1):
        best[0, j] = s2[j] - s1[j] * s1[j] / s0[j] if j else 0.0
    stack = np.empty((4 * n + 8, 4), dtype=np.int64)
    for k in range(1, classes):
        best[k, :] = np.inf
        # The best start of the last class moves only upwards with the end: halve the range of ends, then of starts.
        stack[0] = (k + 1, n, k, n - 1)
        top = 1
        while top:
            top -= 1
            low, high, first, last = stack[top]
            end = (low + high) // 2
            for i in range(first, min(end - 1, last) + 1):
                total, mean = s0[end] - s0[i], s1[end] - s1[i]
                cost = best[k - 1, i] + s2[end] - s2[i] - mean * mean / total
                if cost < best[k, end]:
                    best[k, end] = cost
                    start[k, end] = i
            if low < end:
                stack[top] = (low, end - 1, first, start[k, end])
                top += 1
            if end < high:
                stack[top] = (end + 1, high, start[k, end], last)
                top += 1
    bounds = np.empty(classes + 1, dtype=np.int64)
    bounds[classes] = n
    for k in range(classes - 1, -1, -1):
        bounds[k] = start[k, bounds[k + 1]] if k else 0
    return bounds


def kmeans(count: IntArray, classes: int = CLASSES) -> tuple[FloatArray, IntArray]:
    """Exact K-means of grey values from their histogram (Eq. 6-9), by dynamic programming.

    count (levels,). Returns centres (K,), rising, and thresholds (K - 1,): the highest grey value of each lower
    class. K is at most the number of different grey values: with fewer, fewer classes come back.
    """
    values = np.flatnonzero(count)
    classes = min(classes, len(values))
    if classes == 0:
        return np.empty(0), np.empty(0, dtype=np.int64)
    weights = count[values].astype(np.float64)
    bounds = _split(values.astype(np.float64), weights, classes)
    centres = np.add.reduceat(values * weights, bounds[:-1]) / np.add.reduceat(weights, bounds[:-1])
    return centres, values[bounds[1:-1] - 1]


def binarise(image: Image, dark: bool, classes: int = CLASSES, row_step: int = 4) -> ByteImage:
    """Cells 255, all else 0, split where K-means sees the greatest step between neighbouring classes.

    image (h, w), 8 or 16 bits. One threshold for the whole image, as in the paper: it fails under a shadow or
    gradient.
    """
    count = histogram(image, int(np.iinfo(image.dtype).max) + 1, row_step)
    centres, thresholds = kmeans(count, classes)
    if len(centres) < 2:
        return np.zeros(image.shape, dtype=np.uint8)
    level = int(thresholds[np.argmax(np.diff(centres))])
    cells = cv2.inRange(image, 0, level) if dark else cv2.inRange(image, level + 1, int(np.iinfo(image.dtype).max))
    return np.asarray(cells, dtype=np.uint8)
