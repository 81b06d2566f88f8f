"""Whether calibration and wing make sense together: the eyes see a common part of the wing, with cells on it."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.tables.schema import CamerasTable, Eye, PanelTable, WingTable, load_cameras, load_wing
from wingbeat.errors import InputError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CONVENTION = "X_right = R X_left + t"
# Views that share less than this share of the left one are of no use.
LEAST_OVERLAP = 0.02
_RAYS = 17  # of the left eye, in each direction


def load_hardware(cameras_path: Path | str, wing_path: Path | str) -> tuple[CamerasTable, WingTable]:
    """Read cameras.toml and wing.toml, and check that they fit each other. Raises InputError."""
    cameras, wing = load_cameras(cameras_path), load_wing(wing_path)
    check_overlap(cameras, wing, cameras_path)
    check_cells_in_view(cameras, wing, wing_path)
    return cameras, wing


def check_overlap(cameras: CamerasTable, wing: WingTable, where: Path | str = "cameras.toml") -> None:
    """The right eye sees a part of what the left eye sees in the wing's plane, within the pose's tolerance.

    Raises InputError that names the convention, and says so if a transposed rotation or an inverted
    transformation would make the views overlap. A wing that the left eye does not see at all is no fault of the
    rig: check_cells_in_view tells of it.
    """
    cells = _cells_mm(wing)
    points = _left_view_on_wing_plane(cameras.left, wing)
    if not len(points) or not _in_view(cameras.left, cells, _margin_mm(wing, cells)).any():
        return
    R, t = np.array(cameras.stereo.rotation), np.array(cameras.stereo.translation_mm)
    margin_mm = _margin_mm(wing, points)

    def overlap(rotation: FloatArray, translation_mm: FloatArray) -> float:
        return float(np.mean(_in_view(cameras.right, points @ rotation.T + translation_mm, margin_mm)))

    if overlap(R, t) >= LEAST_OVERLAP:
        return
    likely = "a transposed rotation is a likely cause"
    if overlap(R.T, t) >= LEAST_OVERLAP:
        likely = "stereo.rotation seems to be transposed: with its transpose they overlap"
    elif overlap(R.T, -R.T @ t) >= LEAST_OVERLAP:
        likely = "rotation and translation seem to be those of X_left = R X_right + t: inverted they overlap"
    raise InputError(
        "the views of the two cameras do not overlap at the wing", where, f"the convention is {CONVENTION}; {likely}"
    )


def check_cells_in_view(cameras: CamerasTable, wing: WingTable, where: Path | str = "wing.toml") -> None:
    """At least one cell may be in view of both eyes, within the pose's tolerance. Raises InputError."""
    left_mm = _cells_mm(wing)
    right_mm = left_mm @ np.array(cameras.stereo.rotation).T + np.array(cameras.stereo.translation_mm)
    margin_mm = _margin_mm(wing, left_mm)
    left, right = _in_view(cameras.left, left_mm, margin_mm), _in_view(cameras.right, right_mm, margin_mm)
    if not (left & right).any():
        raise InputError(
            f"no cell is in view of both cameras (of {len(left_mm)}, the left one may see {int(left.sum())}, "
            f"the right one {int(right.sum())})",
            where,
            "check pose (X_left = R X_wing + t) and panel",
        )


def _cells_mm(wing: WingTable) -> FloatArray:
    """Centres (cells, 3) of all cells in the left camera's frame, at the nominal pose."""
    centres = np.concatenate([_centres_mm(panel) for panel in wing.panel])
    return centres @ np.array(wing.pose.rotation).T + np.array(wing.pose.translation_mm)


def _centres_mm(panel: PanelTable) -> FloatArray:
    """Centres (cells, 3) of a panel's cells on the flat wing."""
    x, y = (
        panel.origin_mm[axis] + panel.pitch_mm[axis] * np.arange(count) + panel.cell_mm[axis] / 2.0
        for axis, count in enumerate((panel.columns, panel.rows))
    )
    X, Y = np.meshgrid(x, y, indexing="ij")
    return np.stack([X.ravel(), Y.ravel(), np.zeros(X.size)], axis=1)


def _margin_mm(wing: WingTable, left_mm: FloatArray) -> FloatArray:
    """How far each point of the wing (n, 3) may be from where the nominal pose has it."""
    lever = np.linalg.norm(left_mm - np.array(wing.pose.translation_mm), axis=1)
    return wing.pose.tolerance_mm + np.deg2rad(wing.pose.tolerance_deg) * lever


def _left_view_on_wing_plane(left: Eye, wing: WingTable) -> FloatArray:
    """Points (n, 3) where rays of the left eye meet the nominal wing's plane in front of it."""
    u, v = np.meshgrid(np.linspace(0, left.width - 1, _RAYS), np.linspace(0, left.height - 1, _RAYS))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None, :]
    flat = cv2.undistortPoints(pixels, _matrix(left), np.array(left.distortion))[:, 0, :]
    rays = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    normal = np.array(wing.pose.rotation)[:, 2]
    toward = rays @ normal
    depth = np.full(len(rays), -1.0)
    np.divide(normal @ np.array(wing.pose.translation_mm), toward, out=depth, where=np.abs(toward) > 1e-9)
    return rays[depth > 0.0] * depth[depth > 0.0, None]


def _in_view(eye: Eye, xyz_mm: FloatArray, margin_mm: FloatArray) -> BoolArray:
    """Whether points (n, 3) in the eye's frame may be in its image, if each may be off by its margin."""
    seen = xyz_mm[:, 2] > 1e-6
    x, y = (xyz_mm[seen, axis] / xyz_mm[seen, 2] for axis in (0, 1))
    # Beyond some angle the distortion polynomial runs backwards and would bring points back into the image.
    k1, k2, _, _, k3 = eye.distortion
    roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    ends = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
    proper = x * x + y * y < (ends.min() if ends.size else np.inf)
    points = np.stack([x, y, np.ones_like(x)], axis=1)
    pixels = np.full((len(x), 2), np.inf)
    if proper.any():
        zero = np.zeros(3)
        found, _ = cv2.projectPoints(points[proper], zero, zero, _matrix(eye), np.array(eye.distortion))
        pixels[proper] = found[:, 0, :]
    margin_px = margin_mm[seen] / xyz_mm[seen, 2] * max(eye.fx, eye.fy)
    inside = [
        (pixels[:, axis] > -0.5 - margin_px) & (pixels[:, axis] < size - 0.5 + margin_px)
        for axis, size in enumerate((eye.width, eye.height))
    ]
    result = np.zeros(len(xyz_mm), dtype=bool)
    result[seen] = inside[0] & inside[1]
    return result


def _matrix(eye: Eye) -> FloatArray:
    return np.array([[eye.fx, 0.0, eye.cx], [0.0, eye.fy, eye.cy], [0.0, 0.0, 1.0]])
