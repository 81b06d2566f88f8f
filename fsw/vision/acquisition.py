"""ACQUIRE: find the grid in an image pair without any history, and name every cell, or say why not."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.agreement import MOST_COST, AcquireOptions, EyeCells, Pair, Prior, agreeing
from fsw.vision.cells import centres_of, quadrilaterals, refine
from fsw.vision.clustering import Image
from fsw.vision.enhancement import metric_view, visible_region
from fsw.vision.grid import CellGrid
from fsw.vision.hot import shown_full_scale
from fsw.vision.identity import Assignment, Table, assignments, fitting, tables
from fsw.vision.lattice import Lattice, link
from fsw.vision.ridges import local_cells
from fsw.vision.rig import StereoRig
from fsw.vision.surface import inside

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

__all__ = ["AcquireOptions", "Acquisition", "Prior", "acquire"]

# Pixels of the view on a cell's smaller side: fewer do not show its lines, more only cost time. Edges are measured in
# the whole image later, by the tracker.
_LEAST_PX, _MOST_PX = 12.0, 20.0
_MEAN_PX = 16.0  # is enough where each is the mean of _MEAN_OF by _MEAN_OF of the image: no thin line falls between
_MEAN_OF = 4
_EDGE_REACH = 3  # px of the view by which a contour may lie off a cell's edge


@dataclass(frozen=True)
class Acquisition:
    """What ACQUIRE found. Arrays as in the frame path; NaN and False where nothing is known.

    corners_px (2, N, 4, 2) in ideal px, seen (2, N). rotation (3, 3), translation_mm (3,): X_left = R X_wing + t of
    a rigid wing through the cells that both eyes see. ray_miss_mm: median distance between the eyes' rays; scale:
    measured size over the nominal; score: cost of the best assignment, and at least that of the second (large if there
    is none).
    """

    ok: bool
    reason: str
    corners_px: FloatArray
    seen: BoolArray
    rotation: FloatArray
    translation_mm: FloatArray
    ray_miss_mm: float = float("nan")
    scale: float = float("nan")
    score: tuple[int, int] = (0, 0)


def acquire(
    left: Image, right: Image, rig: StereoRig, grid: CellGrid, prior: Prior, options: AcquireOptions | None = None
) -> Acquisition:
    """Find and name the wing's cells in a pair of images (h, w), 8 or 16 bits.

    Every assignment within the prior's tolerance is tried. One that the two eyes' rays, the wing's size, the prior
    or the cells found cannot rule out is scored by the cells that contradict it; the best is accepted only if it is
    clearly the best.
    """
    options = options or AcquireOptions()
    table = tables(grid)
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="right-eye") as beside:
        other = beside.submit(_name, right, rig, 1, grid, prior, options, table)
        sights = (_name(left, rig, 0, grid, prior, options, table), other.result())
    for sight in sights:
        if isinstance(sight, str):
            return _failed(grid, sight)
    eyes = [sight.found for sight in sights if not isinstance(sight, str)]
    names = [sight.names for sight in sights if not isinstance(sight, str)]
    dropped = min(sight.dropped for sight in sights if not isinstance(sight, str))
    agreed, others = agreeing(eyes, names, rig, grid, prior, options)
    pairs = [p for p in agreed if p.within]
    if not pairs:
        return _failed(grid, "no assignment agrees with both eyes, the wing's size and the pose's tolerance")
    best = pairs[0]
    second = pairs[1].cost if len(pairs) > 1 else MOST_COST
    rival = min(second, others, options.contradiction_weight * dropped)
    score = (best.cost, rival)
    if best.cost + options.margin > rival:
        return _failed(grid, f"ambiguous: {len(pairs)} assignments, costs {best.cost} and {rival}", score)
    # Where the wing stands beyond the tolerance, the best of the wrong assignments within it would be left over.
    if any(p.cost < best.cost for p in agreed):
        return _failed(grid, "the assignment that fits best lies outside the pose's tolerance", score)
    named = sum(int((n.label >= 0).sum()) for n in best.names)
    if sum(n.contradicted for n in best.names) > options.max_contradicted * named:
        return _failed(grid, "too many cells contradict the best assignment", score)
    return _accepted(eyes, best, grid, score)


class _Sight(NamedTuple):
    """What one eye says: its cells, the ways to name them, and what the best of the names left out would have cost."""

    found: EyeCells
    names: list[Assignment]
    dropped: int


def _name(
    image: Image,
    rig: StereoRig,
    eye: int,
    grid: CellGrid,
    prior: Prior,
    options: AcquireOptions,
    table: list[Table],
) -> _Sight | str:
    """Find one eye's cells and all ways to name them, or say why there are none."""
    which = ("left", "right")[eye]
    bound = _bound(rig, eye, grid, prior, options)
    found = _detect(image, rig, eye, grid, prior, options, bound)
    if found is None:
        return f"no part of the wing is in the {which} eye's view at the nominal pose"
    lattices = _lattices(found.corners_mm, table, grid)
    if not lattices or len(lattices[0].member) < options.min_cells:
        return f"too few cells in the {which} eye: {len(found.corners_mm)} found"
    names, dropped = assignments(found.corners_mm, lattices, table, grid, bound)
    if not names:
        return f"the {which} eye's cells fit nowhere on the wing within the pose's tolerance"
    return _Sight(found, names, dropped)


def _bound(rig: StereoRig, eye: int, grid: CellGrid, prior: Prior, options: AcquireOptions) -> FloatArray:
    """How far (2,) in mm along X and Y the wing may stand from its nominal place in this eye's metric view."""
    length, width = grid.outline_mm
    turn = np.deg2rad(prior.tolerance_deg * options.tolerance_slack)
    reach = prior.tolerance_mm * options.tolerance_slack
    R = rig.rotation[eye] @ prior.rotation
    eye_mm = -R.T @ (rig.rotation[eye] @ prior.translation_mm + rig.translation_mm[eye])
    height = max(abs(eye_mm[2]), 1e-6)
    slant = np.maximum(np.abs(np.array([0.0, -width / 2]) - eye_mm[:2]), np.abs([length, width / 2] - eye_mm[:2]))
    lift = reach + turn * length + options.bending_mm
    return np.asarray(reach + turn * np.array([width / 2, length]) + lift * np.minimum(slant / height, 1.5))


def _detect(
    image: Image, rig: StereoRig, eye: int, grid: CellGrid, prior: Prior, options: AcquireOptions, bound: FloatArray
) -> EyeCells | None:
    """Quadrilaterals of a cell's size in this eye's metric view; None if the wing cannot be in view."""
    length, width = grid.outline_mm
    # Half of the bound on either side: a wing at the bound's very end keeps enough cells in the box.
    box = np.array([[0.0, -width / 2], [length, width / 2]]) + np.array([[-0.75], [0.75]]) * bound
    R, t = prior.rotation, prior.translation_mm
    region = visible_region(rig, eye, R, t, box)
    if region is None:
        return None
    box, resolution = region
    sizes = {p.cell_mm: p for p in grid.panels}
    smallest = min(min(cell) for cell in sizes)
    most = _MEAN_PX if resolution[0] * smallest / _MEAN_PX >= _MEAN_OF else _MOST_PX
    mm_per_px = float(np.clip(0.55 / resolution[1], smallest / most, smallest / _LEAST_PX))
    shrink = max(1, int(mm_per_px * resolution[0]))
    view = metric_view(image, rig, eye, R, t, box, mm_per_px, shrink)
    dark = view.pixels if grid.dark else -view.pixels
    smooth = np.asarray(cv2.GaussianBlur(dark, (0, 0), 0.7), dtype=np.float32)
    found = []
    for cell_mm, panel in sizes.items():
        cell_px = (cell_mm[0] / mm_per_px, cell_mm[1] / mm_per_px)
        line_px = ((panel.pitch_mm[0] - cell_mm[0]) / mm_per_px, (panel.pitch_mm[1] - cell_mm[1]) / mm_per_px)
        cells = local_cells(smooth, cell_px, line_px) * view.inside
        quads = quadrilaterals(cells, cell_px, options.cell_tolerance)
        refine(quads, smooth, _EDGE_REACH)
        corners = box[0] + mm_per_px * quads
        middle = corners.mean(axis=1, keepdims=True)
        # Whoever has no image just outside a corner may be cut by the image's rim.
        outside = corners + (corners - middle) * (4.0 * mm_per_px / np.linalg.norm(corners - middle, axis=2))[..., None]
        found.append(corners[inside(view, outside).all(axis=1)])
    corners = np.concatenate(found)
    return EyeCells(view, corners, view.ideal_px(centres_of(corners)), float(shown_full_scale(image)))


def _lattices(corners_mm: FloatArray, table: Sequence[Table], grid: CellGrid) -> list[Lattice]:
    """Lattices of each kind of cell that the wing has, largest first."""
    result = []
    for cell_mm in {one.cell_mm for one in table}:
        alike = [one for one in table if one.cell_mm == cell_mm]
        pitch = alike[0].pitch_mm
        gaps = {round(float(s), 3) for one in alike for s in one.step_mm} - {round(pitch[0], 3)}
        result += link(corners_mm, cell_mm, (pitch[0], *sorted(gaps)), pitch[1])
    return sorted(result, key=lambda a: -len(a.member))


def _accepted(eyes: Sequence[EyeCells], pair: Pair, grid: CellGrid, score: tuple[int, int]) -> Acquisition:
    corners = np.full((2, grid.count, 4, 2), np.nan)
    seen = np.zeros((2, grid.count), dtype=np.bool_)
    for eye in (0, 1):
        name, found = pair.names[eye], eyes[eye]
        good = fitting(name.label, found.corners_mm, name.warp, grid)
        corners[eye, name.label[good]] = found.view.ideal_px(found.corners_mm[good])
        seen[eye, name.label[good]] = True
    return Acquisition(True, "", corners, seen, pair.rotation, pair.translation_mm, pair.ray_miss_mm, pair.scale, score)


def _failed(grid: CellGrid, reason: str, score: tuple[int, int] = (0, 0)) -> Acquisition:
    nan = np.nan
    return Acquisition(
        False, reason, np.full((2, grid.count, 4, 2), nan), np.zeros((2, grid.count), dtype=np.bool_),
        np.full((3, 3), nan), np.full(3, nan), score=score,
    )  # fmt: skip
