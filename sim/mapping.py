"""Where each pixel looks on the bent wing: the exact inverse mapping, on a grid of nodes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.surface import height
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

STEP_PX = 4  # spacing of the nodes: straight lines between them stay within 0.002 px of the true mapping, and
# Of what a curve turns by at a node: a straight line between nodes on it is off by so much on average.
CHORD = 1.0 / 12.0
NODE_X, NODE_Y, NODE_LIGHT, NODE_SHARP_X, NODE_SHARP_Y = range(5)  # what a node holds


class View(NamedTuple):
    """An eye in the wing's frame: intrinsics (4,), distortion (5,), centre (3,), axes (3, 3) of its rays."""

    intrinsics: FloatArray
    distortion: FloatArray
    centre_mm: FloatArray
    axes: FloatArray


class Light(NamedTuple):
    """What falls on the wing, in grey values of a white surface; level: on a flat wing's middle.

    gradient (2,): relative change over the wing's length and width; middle_mm, extent_mm (2,): of the wing; direction
    (3,): towards the light, a unit vector in the wing's frame.
    """

    level: float
    gradient: FloatArray
    middle_mm: FloatArray
    extent_mm: FloatArray
    direction: FloatArray


@kernel
def _undistort(x: float, y: float, d: FloatArray) -> tuple[float, float]:
    """The undistorted ray of a distorted one (normalised coordinates), by Newton's method."""
    u, v = x, y
    for _ in range(8):
        r2 = u * u + v * v
        radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
        slope = 2.0 * (d[0] + r2 * (2.0 * d[1] + r2 * 3.0 * d[4]))
        ex = u * radial + 2.0 * d[2] * u * v + d[3] * (r2 + 2.0 * u * u) - x
        ey = v * radial + d[2] * (r2 + 2.0 * v * v) + 2.0 * d[3] * u * v - y
        a = radial + u * u * slope + 2.0 * d[2] * v + 6.0 * d[3] * u
        b = u * v * slope + 2.0 * d[2] * u + 2.0 * d[3] * v
        c = radial + v * v * slope + 6.0 * d[2] * v + 2.0 * d[3] * u
        det = a * c - b * b
        u -= (c * ex - b * ey) / det
        v -= (a * ey - b * ex) / det
    return u, v


@kernel
def map_nodes(
    nodes: FloatArray, view: View, light: Light, patches: FloatArray, x_mm: FloatArray, y_mm: FloatArray
) -> None:
    """Fill NODE_X, NODE_Y, NODE_LIGHT of nodes (rows, columns, 5): the exact inverse mapping at every STEP_PX-th pixel.

    A ray meets the bent wing where o_z + s d_z = w(o_x + s d_x, o_y + s d_y); Newton's method in s, which starts from
    the neighbour's displacement and so needs few steps.
    """
    fx, fy, cx, cy = view.intrinsics
    bent_lens = np.any(view.distortion != 0.0)
    o, A = view.centre_mm, view.axes
    for i in range(nodes.shape[0]):
        w = 0.0
        for j in range(nodes.shape[1]):
            a, b = (j * STEP_PX - cx) / fx, (i * STEP_PX - cy) / fy
            if bent_lens:
                a, b = _undistort(a, b, view.distortion)
            dx = A[0, 0] * a + A[0, 1] * b + A[0, 2]
            dy = A[1, 0] * a + A[1, 1] * b + A[1, 2]
            dz = A[2, 0] * a + A[2, 1] * b + A[2, 2]
            s = (w - o[2]) / dz
            steps = 5 if j == 0 else 2
            w_x, w_y = 0.0, 0.0
            for _ in range(steps):
                w, w_x, w_y = height(patches, x_mm, y_mm, o[0] + s * dx, o[1] + s * dy)
                s -= (o[2] + s * dz - w) / (dz - w_x * dx - w_y * dy)
            x, y = o[0] + s * dx, o[1] + s * dy
            nodes[i, j, NODE_X] = x
            nodes[i, j, NODE_Y] = y
            facing = (light.direction[2] - w_x * light.direction[0] - w_y * light.direction[1]) / np.sqrt(
                1.0 + w_x * w_x + w_y * w_y
            )
            uneven = 1.0
            uneven += light.gradient[0] * (x - light.middle_mm[0]) / light.extent_mm[0]
            uneven += light.gradient[1] * (y - light.middle_mm[1]) / light.extent_mm[1]
            nodes[i, j, NODE_LIGHT] = light.level * max(0.0, uneven) * max(0.0, facing / light.direction[2])


@kernel
def centre_chords(nodes: FloatArray, turn: FloatArray, above: FloatArray) -> None:
    """Move NODE_X, NODE_Y off the mapping so that straight lines between nodes are right on average, not at the nodes.

    Chords of a curve all lie on one side of it: edges would be drawn a few ten-thousandths of a pixel to that side.
    turn, above (columns, 2): scratch.
    """
    rows, columns = nodes.shape[0], nodes.shape[1]
    for i in range(rows):
        for k in (NODE_X, NODE_Y):
            left, along = 0.0, 0.0
            for j in range(columns):
                here = nodes[i, j, k]
                if j == 0:
                    along = here - 2.0 * nodes[i, 1, k] + nodes[i, 2, k]
                elif j < columns - 1:
                    along = left - 2.0 * here + nodes[i, j + 1, k]
                if i == 0:
                    turn[j, k] = here - 2.0 * nodes[1, j, k] + nodes[2, j, k]
                elif i < rows - 1:
                    turn[j, k] = above[j, k] - 2.0 * here + nodes[i + 1, j, k]
                left = above[j, k] = here
                nodes[i, j, k] = here - CHORD * (along + turn[j, k])


@kernel
def spread_nodes(nodes: FloatArray, sigma_px: float) -> None:
    """Fill NODE_SHARP_X, NODE_SHARP_Y: 1 / sigma, per mm, of a round blur of sigma_px across lines of constant X, Y."""
    rows, columns = nodes.shape[0], nodes.shape[1]
    for i in range(rows):
        up, down = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(columns):
            left, right = max(j - 1, 0), min(j + 1, columns - 1)
            for k in range(2):
                across = (nodes[i, right, k] - nodes[i, left, k]) / ((right - left) * STEP_PX)
                along = (nodes[down, j, k] - nodes[up, j, k]) / ((down - up) * STEP_PX)
                nodes[i, j, NODE_SHARP_X + k] = 1.0 / (sigma_px * np.sqrt(across * across + along * along))
