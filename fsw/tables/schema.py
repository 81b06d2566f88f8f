"""The files that describe the hardware, as checked tables: cameras.toml, wing.toml, sequence.toml."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from fsw.tables.reading import read_table
from wingbeat.errors import InputError

Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
PositiveMm = Annotated[float, Meta(gt=0.0, le=1e6, description="length, mm")]
FocalPx = Annotated[float, Meta(gt=0.0, le=1e7, description="focal length, px")]
Pixels = Annotated[int, Meta(ge=16, le=32768, description="size of the image, px")]
Count = Annotated[int, Meta(ge=1, le=10000, description="number of cells")]

# A rotation written with few digits is made exact; one further from a rotation than this is a mistake.
ROTATION_TOLERANCE = 1e-3
# Measures of a wing are written with a few digits: what touches within this does not overlap.
ROUNDING_MM = 0.01


class Table(Struct, frozen=True, forbid_unknown_fields=True):
    """A part of a table file: it cannot change, and knows all its keys."""


class Eye(Table, frozen=True):
    """One camera: pixel centres at whole numbers; distortion k1 k2 p1 p2 k3."""

    width: Pixels
    height: Pixels
    fx: FocalPx
    fy: FocalPx
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]


class Stereo(Table, frozen=True):
    """Where the right camera is: X_right = R X_left + t."""

    rotation: Matrix3
    translation_mm: Vector3


class CamerasTable(Table, frozen=True):
    """cameras.toml: the calibrated stereo rig."""

    left: Eye
    right: Eye
    stereo: Stereo


class Outline(Table, frozen=True):
    """Size of the wing: along X from the root, and across along Y."""

    length_mm: PositiveMm
    width_mm: PositiveMm


class PanelTable(Table, frozen=True):
    """One panel's cells; origin: X, Y of the first cell's outer corner."""

    origin_mm: Vector2
    columns: Count
    rows: Count
    pitch_mm: tuple[PositiveMm, PositiveMm]
    cell_mm: tuple[PositiveMm, PositiveMm]


class Surface(Table, frozen=True):
    """What the wing looks like: cells dark or bright against the lines between them."""

    cells_are: Literal["dark", "bright"]


class Pose(Table, frozen=True):
    """Where the wing is, as built: X_left = R X_wing + t, and how wrong that may be."""

    rotation: Matrix3
    translation_mm: Vector3
    tolerance_mm: Annotated[float, Meta(ge=0.0, le=1e4, description="error of the translation, mm")]
    tolerance_deg: Annotated[float, Meta(ge=0.0, le=45.0, description="error of the rotation, degrees")]


class WingTable(Table, frozen=True):
    """wing.toml: the wing's cells and its nominal pose."""

    wing: Outline
    panel: Annotated[list[PanelTable], Meta(min_length=1, max_length=64)]
    surface: Surface
    pose: Pose


class SequenceTable(Table, frozen=True):
    """sequence.toml: recorded stereo images; paths are relative to the file's folder."""

    rate_hz: Annotated[float, Meta(gt=0.0, le=10000.0, description="trigger rate, Hz")]
    left: Annotated[str, Meta(min_length=1, description="pattern of the left images")]
    right: Annotated[str, Meta(min_length=1, description="pattern of the right images")]
    cameras: Annotated[str, Meta(min_length=1)]
    wing: Annotated[str, Meta(min_length=1)]
    timestamps: Annotated[str, Meta(min_length=1)] | None = None


def load_cameras(path: Path | str) -> CamerasTable:
    """Read cameras.toml; the rotation is made exactly orthonormal. Raises InputError."""
    table = read_table(path, CamerasTable)
    for name, eye in (("left", table.left), ("right", table.right)):
        for key, centre, size in (("cx", eye.cx, eye.width), ("cy", eye.cy, eye.height)):
            # An off-axis crop may have its principal point outside of the image, but not by several images.
            if not -2 * size <= centre <= 3 * size:
                remedy = f"{-2 * size} to {3 * size} is allowed (pixels, not mm)"
                raise InputError(f"{name}.{key} = {centre:g}", path, remedy)
    if not any(table.stereo.translation_mm):
        raise InputError(
            "stereo.translation_mm = 0",
            path,
            "the two cameras need a distance (X_right = R X_left + t, in mm)",
        )
    rotation = _exact_rotation(table.stereo.rotation, path, "stereo.rotation")
    return replace(table, stereo=replace(table.stereo, rotation=rotation))


def load_wing(path: Path | str) -> WingTable:
    """Read wing.toml: panels in order from the root, none on another, all on the wing. Raises InputError."""
    table = read_table(path, WingTable)
    outline = table.wing
    half = outline.width_mm / 2.0
    end_of_last = -np.inf
    for number, panel in enumerate(table.panel):
        key = f"panel[{number}]"
        for axis in (0, 1):
            if panel.pitch_mm[axis] < panel.cell_mm[axis]:
                raise InputError(
                    f"{key}.pitch_mm[{axis}] = {panel.pitch_mm[axis]:g}",
                    path,
                    f"at least the cell's size is allowed, {panel.cell_mm[axis]:g} mm: cells may not overlap",
                )
        (x0, x1), (y0, y1) = panel_span_mm(panel)
        if x0 < end_of_last - ROUNDING_MM:
            raise InputError(
                f"{key}.origin_mm[0] = {x0:g} lies on panel[{number - 1}], which ends at {end_of_last:g}",
                path,
                "panels are listed in order from the root and do not overlap",
            )
        slack = ROUNDING_MM
        if x0 < -slack or x1 > outline.length_mm + slack or y0 < -half - slack or y1 > half + slack:
            raise InputError(
                f"{key} covers X {x0:g} to {x1:g}, Y {y0:g} to {y1:g} mm",
                path,
                f"cells lie on the wing: X 0 to {outline.length_mm:g}, Y {-half:g} to {half:g} mm",
            )
        end_of_last = x1
    rotation = _exact_rotation(table.pose.rotation, path, "pose.rotation")
    return replace(table, pose=replace(table.pose, rotation=rotation))


def load_sequence(path: Path | str) -> SequenceTable:
    """Read sequence.toml. Raises InputError."""
    return read_table(path, SequenceTable)


def panel_span_mm(panel: PanelTable) -> tuple[Vector2, Vector2]:
    """First and last X, first and last Y of a panel's cells, mm."""
    counts = (panel.columns, panel.rows)
    first = panel.origin_mm
    last = [first[a] + (counts[a] - 1) * panel.pitch_mm[a] + panel.cell_mm[a] for a in (0, 1)]
    return (first[0], last[0]), (first[1], last[1])


def _exact_rotation(rows: Matrix3, path: Path | str, key: str) -> Matrix3:
    """The rotation next to this matrix (polar decomposition). Raises InputError beyond the tolerance."""
    given: NDArray[np.float64] = np.array(rows)
    u, _, vt = np.linalg.svd(given)
    nearest = u @ vt
    error = float(np.abs(given - nearest).max())
    if error > ROTATION_TOLERANCE:
        raise InputError(
            f"{key} is no rotation: its rows are off by {error:.2g}",
            path,
            "orthonormal rows are allowed (R R^T = 1)",
        )
    if np.linalg.det(nearest) < 0.0:
        raise InputError(
            f"{key} is a reflection: its determinant is -1",
            path,
            "determinant +1 is allowed: check the sign of one axis",
        )
    x, y, z = ((float(a), float(b), float(c)) for a, b, c in nearest)
    return x, y, z
