"""Where each cell is expected: one surface of the wing, shared by both eyes.

The wing is its flat grid at a reference pose, moved in its plane as a rigid body and bent out of its plane by a
low-order polynomial. Ten numbers hold all of it, so both eyes and all cells move together: none can slip alone.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray, solve
from fsw.vision.grid import CellGrid
from fsw.vision.rig import Eyes, image_point, project
from wingbeat.kernels import kernel

BoolArray = NDArray[np.bool_]

# Unknowns: shift along X and Y and turn in the plane, then the bending polynomial 1, x, y, xy, x2, x2 y, x3.
IN_PLANE, BENDING = 3, 7
UNKNOWNS = IN_PLANE + BENDING

PRIOR = 1e-6  # keeps unknowns that nothing observes at rest


class Surface(NamedTuple):
    """The wing's surface: reference pose, basis at corners and centres, and the current unknowns."""

    rotation: FloatArray  # (3, 3) X_left = rotation (X_wing + d) + translation
    translation_mm: FloatArray  # (3,)
    flat_mm: FloatArray  # (N, 5, 2) four corners and the centre on the flat wing
    basis: FloatArray  # (N, 5, BENDING) bending polynomial there
    half_mm: float  # half the wing's length: the turn in the plane is counted in mm there, like all else
    unknowns: FloatArray  # (UNKNOWNS,) mm


class Normal(NamedTuple):
    """Normal equations of the unknowns; taken once."""

    matrix: FloatArray  # (UNKNOWNS, UNKNOWNS)
    right: FloatArray  # (UNKNOWNS,)
    row: FloatArray  # (4, UNKNOWNS) equations in the making
    step: FloatArray  # (UNKNOWNS,)


def make_normal() -> Normal:
    """Take the working memory."""
    return Normal(np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.zeros((4, UNKNOWNS)), np.zeros(UNKNOWNS))


def make_surface(grid: CellGrid) -> Surface:
    """A flat surface at rest, pose unset."""
    flat = np.concatenate([grid.corners_mm, grid.centre_mm[:, None]], axis=1)
    x = flat[..., 0] / (0.5 * grid.outline_mm[0]) - 1.0
    y = flat[..., 1] / (0.5 * grid.outline_mm[1])
    one = np.ones_like(x)
    bending = [one, x, y, x * y, x * x, x * x * y, x * x * x]
    basis = np.stack(bending, axis=-1)
    return Surface(
        np.eye(3), np.zeros(3), flat, np.ascontiguousarray(basis), 0.5 * grid.outline_mm[0], np.zeros(UNKNOWNS)
    )


def set_pose(surface: Surface, rotation: FloatArray, translation_mm: FloatArray) -> None:
    """Lay the reference pose, flat and at rest."""
    surface.rotation[:] = rotation
    surface.translation_mm[:] = translation_mm
    surface.unknowns[:] = 0.0


@kernel
def shares_of(surface: Surface, X: float, Y: float, basis: FloatArray, out: FloatArray) -> None:
    """Derivative (3, UNKNOWNS) of a point's place in the left camera's frame with respect to the unknowns."""
    R = surface.rotation
    for i in range(3):
        out[i, 0] = R[i, 0]
        out[i, 1] = R[i, 1]
        out[i, 2] = (R[i, 1] * X - R[i, 0] * Y) / surface.half_mm
        for j in range(BENDING):
            out[i, IN_PLANE + j] = R[i, 2] * basis[j]


@kernel
def locate(surface: Surface, n: int, k: int) -> tuple[float, float, float]:
    """Place of corner k (or of the centre, k = 4) of cell n in the left camera's frame, in mm."""
    R, t, q, b = surface.rotation, surface.translation_mm, surface.unknowns, surface.basis[n, k]
    X, Y = surface.flat_mm[n, k]
    x = X + q[0] - q[2] * Y / surface.half_mm
    y = Y + q[1] + q[2] * X / surface.half_mm
    z = 0.0
    for j in range(BENDING):
        z += q[IN_PLANE + j] * b[j]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@kernel
def expect(surface: Surface, eyes: Eyes, corners_px: FloatArray, centre_px: FloatArray, in_view: BoolArray) -> None:
    """Expected ideal pixels of corners (2, N, 4, 2), centres (2, N, 2), and whether a centre is in the image (2, N)."""
    for n in range(surface.flat_mm.shape[0]):
        for k in range(5):
            x, y, z = locate(surface, n, k)
            for eye in range(2):
                u, v, depth = project(eyes.projection[eye], x, y, z)
                if k < 4:
                    corners_px[eye, n, k, 0], corners_px[eye, n, k, 1] = u, v
                else:
                    centre_px[eye, n, 0], centre_px[eye, n, 1] = u, v
                    inside, _, _ = image_point(eyes, eye, u, v)
                    in_view[eye, n] = inside and depth > 0.0


@kernel
def add_equation(matrix: FloatArray, right: FloatArray, row: FloatArray, value: float, weight: float) -> None:
    """Add one weighted equation row . x = value to the normal equations (lower triangle)."""
    for i in range(UNKNOWNS):
        right[i] += weight * row[i] * value
        for j in range(i + 1):
            matrix[i, j] += weight * row[i] * row[j]


@kernel
def fit_surface(
    surface: Surface,
    xyz_mm: FloatArray,
    valid: BoolArray,
    gate_mm: float,
    normal: Normal,
    distance_mm: FloatArray,
) -> int:
    """Fit the surface to measured centres, leaving out what lies farther than gate_mm; returns how many were used.

    xyz_mm (N, 3), valid (N,). Writes distance_mm (N,): of each centre from the surface, NaN where there is none.
    With too few points the surface stays as it is.
    """
    shares, A, b = normal.row[:3], normal.matrix, normal.right
    used = 0
    for turn in range(3):
        A[:] = 0.0
        b[:] = 0.0
        used = 0
        for n in range(xyz_mm.shape[0]):
            if not valid[n]:
                continue
            x, y, z = locate(surface, n, 4)
            r = (xyz_mm[n, 0] - x, xyz_mm[n, 1] - y, xyz_mm[n, 2] - z)
            # The first turn only brings the surface near; the gate means something from then on.
            if turn > 0 and r[0] * r[0] + r[1] * r[1] + r[2] * r[2] > gate_mm * gate_mm:
                continue
            used += 1
            shares_of(surface, surface.flat_mm[n, 4, 0], surface.flat_mm[n, 4, 1], surface.basis[n, 4], shares)
            for i in range(3):
                add_equation(A, b, shares[i], r[i], 1.0)
        if used < UNKNOWNS:
            break
        for j in range(UNKNOWNS):
            A[j, j] += PRIOR * (1.0 + A[0, 0])
        if not solve(A, b, UNKNOWNS):
            break
        for j in range(UNKNOWNS):
            surface.unknowns[j] += b[j]
    for n in range(xyz_mm.shape[0]):
        distance_mm[n] = np.nan
        if valid[n]:
            x, y, z = locate(surface, n, 4)
            distance_mm[n] = math.sqrt((xyz_mm[n, 0] - x) ** 2 + (xyz_mm[n, 1] - y) ** 2 + (xyz_mm[n, 2] - z) ** 2)
    return used
