"""ACQUIRE: find the grid in an image pair without any history, and name every cell, or say why not."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.cells import centres_of, quadrilaterals, refine
from fsw.vision.clustering import Image, local_cells
from fsw.vision.enhancement import MetricView, metric_view, visible_region
from fsw.vision.grid import CellGrid
from fsw.vision.identity import Labelling, Table, fitting, labellings, tables
from fsw.vision.lattice import Lattice, link
from fsw.vision.rig import StereoRig
from fsw.vision.surface import inside, line_contrast, predicted_inside

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

_EDGE_REACH = 3  # px of the view by which a contour may lie off a cell's edge


@dataclass(frozen=True)
class Prior:
    """Where the wing is expected: X_left = R X_wing + t, wrong by at most these tolerances, and bent by vibration."""

    rotation: FloatArray
    translation_mm: FloatArray
    tolerance_mm: float
    tolerance_deg: float


@dataclass(frozen=True)
class AcquireOptions:
    """Limits of the search; those in parts of a pitch are what separates a right assignment from one that is off by one."""

    bending_mm: float = 40.0  # greatest deflection of the wing out of its plane
    bending_deg: float = 4.0  # and its slope
    cell_tolerance: float = 0.3  # sides of a cell in the metric view, against the nominal pose's
    min_cells: int = 8  # named in both eyes
    ray_miss: float = 0.1  # median distance between the two eyes' rays, in parts of the smaller pitch
    scale_part: float = 0.35  # of the scale error that a shift by one row between the eyes brings
    scale_limits: tuple[float, float] = (0.004, 0.02)
    tolerance_slack: float = 1.15  # the prior's tolerances are taken so much wider
    contradiction_weight: int = 3  # a cell found where the wing has none, against a cell not found where it has one
    absent: float = 0.08  # a line that shows less than this part of its neighbours' contrast is not there
    margin: int = 5  # the best assignment must beat the second by so much
    max_contradicted: float = 0.1  # part of the cells


@dataclass(frozen=True)
class Acquisition:
    """What ACQUIRE found. Arrays as in the frame path; NaN and False where nothing is known.

    corners_px (2, N, 4, 2) in ideal px, seen (2, N). rotation (3, 3), translation_mm (3,): X_left = R X_wing + t of a rigid wing
    through the cells that both eyes see. ray_miss_mm: median distance between the eyes' rays; scale: measured size over
    the nominal; score: cost of the best assignment, and of the second (large if there is none).
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


@dataclass(frozen=True)
class _Eye:
    view: MetricView
    corners_mm: FloatArray  # (K, 4, 2) quadrilaterals in the view
    centre_px: FloatArray  # (K, 2) ideal
    full_scale: float


@dataclass(frozen=True)
class _Pair:
    names: tuple[Labelling, Labelling]
    rotation: FloatArray
    translation_mm: FloatArray
    ray_miss_mm: float
    scale: float
    cost: int


def acquire(
    left: Image, right: Image, rig: StereoRig, grid: CellGrid, prior: Prior, options: AcquireOptions | None = None
) -> Acquisition:
    """Find and name the wing's cells in a pair of images (h, w), 8 or 16 bits.

    Every assignment within the prior's tolerance is tried. One that the two eyes' rays, the wing's size, the prior or the cells
    found cannot rule out is scored by the cells that contradict it; the best is accepted only if it is clearly the best.
    """
    options = options or AcquireOptions()
    table = tables(grid)
    eyes: list[_Eye] = []
    names: list[list[Labelling]] = []
    dropped = 10**6
    for eye, image in enumerate((left, right)):
        which = ("left", "right")[eye]
        bound = _bound(rig, eye, grid, prior, options)
        found = _detect(image, rig, eye, grid, prior, options, bound)
        if found is None:
            return _failed(grid, f"no part of the wing is in the {which} eye's view at the nominal pose")
        lattices = _lattices(found.corners_mm, table, grid)
        if not lattices or len(lattices[0].member) < options.min_cells:
            return _failed(grid, f"too few cells in the {which} eye: {len(found.corners_mm)} found")
        labels, least = labellings(found.corners_mm, lattices, table, grid, bound)
        if not labels:
            return _failed(grid, f"the {which} eye's cells fit nowhere on the wing within the pose's tolerance")
        eyes.append(found)
        names.append(labels)
        dropped = min(dropped, least)
    pairs = _pairs(eyes, names, rig, grid, prior, options)
    if not pairs:
        return _failed(grid, "no assignment agrees with both eyes, the wing's size and the pose's tolerance")
    best = pairs[0]
    rival = min(pairs[1].cost if len(pairs) > 1 else 10**6, options.contradiction_weight * dropped)
    score = (best.cost, rival)
    if best.cost + options.margin > rival:
        return _failed(grid, f"ambiguous: {len(pairs)} assignments, costs {best.cost} and {rival}", score)
    named = sum(int((n.label >= 0).sum()) for n in best.names)
    if sum(n.contradicted for n in best.names) > options.max_contradicted * named:
        return _failed(grid, "too many cells contradict the best assignment", score)
    return _accepted(eyes, best, grid, score)


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
) -> _Eye | None:
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
    mm_per_px = float(np.clip(0.55 / resolution[1], smallest / 30.0, smallest / 12.0))
    shrink = max(1, int(mm_per_px * resolution[0]))
    view = metric_view(image, rig, eye, R, t, box, mm_per_px, shrink)
    smooth = cv2.GaussianBlur(view.pixels if grid.dark else -view.pixels, (0, 0), 0.7)
    found = []
    for cell_mm, panel in sizes.items():
        cell_px = (cell_mm[0] / mm_per_px, cell_mm[1] / mm_per_px)
        line_px = ((panel.pitch_mm[0] - cell_mm[0]) / mm_per_px, (panel.pitch_mm[1] - cell_mm[1]) / mm_per_px)
        cells, _ = local_cells(smooth, cell_px, line_px)
        cells[~view.inside] = 0
        quads = quadrilaterals(cells, cell_px, options.cell_tolerance)
        refine(quads, smooth, _EDGE_REACH)
        corners = box[0] + mm_per_px * quads
        middle = corners.mean(axis=1, keepdims=True)
        # Whoever has no image just outside a corner may be cut by the image's rim.
        outside = corners + (corners - middle) * (4.0 * mm_per_px / np.linalg.norm(corners - middle, axis=2))[..., None]
        found.append(corners[inside(view, outside).all(axis=1)])
    corners = np.concatenate(found)
    scale = float(np.iinfo(image.dtype).max)
    return _Eye(view, corners, view.ideal_px(centres_of(corners)), scale)


def _lattices(corners_mm: FloatArray, table: Sequence[Table], grid: CellGrid) -> list[Lattice]:
    """Lattices of each kind of cell that the wing has, largest first."""
    result = []
    for cell_mm in {one.cell_mm for one in table}:
        alike = [one for one in table if one.cell_mm == cell_mm]
        pitch = alike[0].pitch_mm
        gaps = {round(float(s), 3) for one in alike for s in one.step_mm} - {round(pitch[0], 3)}
        result += link(corners_mm, cell_mm, (pitch[0], *sorted(gaps)), pitch[1])
    return sorted(result, key=lambda a: -len(a.member))


def _pairs(
    eyes: Sequence[_Eye], names: Sequence[Sequence[Labelling]], rig: StereoRig, grid: CellGrid, prior: Prior,
    options: AcquireOptions,
) -> list[_Pair]:  # fmt: skip
    """Assignments of both eyes that agree in space and with the prior, best first."""
    pitch = np.array([p.pitch_mm for p in grid.panels]).min()
    scale_error = float(np.clip(options.scale_part * pitch / rig.baseline_mm, *options.scale_limits))
    found = []
    for a in names[0]:
        for b in names[1]:
            cells, i, j = np.intersect1d(a.label, b.label, return_indices=True)
            i, j, cells = i[cells >= 0], j[cells >= 0], cells[cells >= 0]
            if len(cells) < options.min_cells:
                continue
            xyz, miss = _rays(rig, eyes[0].centre_px[i], eyes[1].centre_px[j])
            ray_miss = float(np.median(miss))
            if not ray_miss <= options.ray_miss * pitch:
                continue
            R, t, scale = _rigid(grid.centre_mm[cells], xyz)
            if abs(scale - 1.0) > scale_error or not _within(R, t, grid.centre_mm[cells], prior, options):
                continue
            cost = options.contradiction_weight * (a.contradicted + b.contradicted)
            cost += _absent(eyes, (a, b), grid, options)
            found.append(_Pair((a, b), R, t, ray_miss, scale, cost))
    return sorted(found, key=lambda p: p.cost)


def _rays(rig: StereoRig, left_px: FloatArray, right_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 3) midway between the two eyes' rays, and the rays' distance (n,) in mm; NaN distance behind an eye."""
    ray = []
    for eye, px in enumerate((left_px, right_px)):
        f, c = rig.intrinsics[eye, :2], rig.intrinsics[eye, 2:]
        ray.append(np.concatenate(((px - c) / f, np.ones((len(px), 1))), axis=1) @ rig.rotation[eye])
    base = -rig.rotation[1].T @ rig.translation_mm[1]
    aa, bb, ab = (np.einsum("ni,ni->n", p, q) for p, q in ((ray[0], ray[0]), (ray[1], ray[1]), (ray[0], ray[1])))
    ac, bc = ray[0] @ base, ray[1] @ base
    det = aa * bb - ab * ab
    s, u = (ac * bb - bc * ab) / det, (ac * ab - bc * aa) / det
    p, q = s[:, None] * ray[0], base + u[:, None] * ray[1]
    miss = np.linalg.norm(p - q, axis=1)
    return 0.5 * (p + q), np.where((s > 0) & (u > 0), miss, np.inf)


def _rigid(wing_mm: FloatArray, xyz: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Rotation, translation and scale that move flat wing points (n, 2) onto points (n, 3) (Umeyama, 1991)."""
    flat = np.concatenate((wing_mm, np.zeros((len(wing_mm), 1))), axis=1)
    a, b = flat.mean(axis=0), xyz.mean(axis=0)
    U, S, Vt = np.linalg.svd((xyz - b).T @ (flat - a))
    D = np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)])
    R = U @ D @ Vt
    scale = float((S * np.diag(D)).sum() / np.sum((flat - a) ** 2))
    return R, b - R @ a, scale


def _within(R: FloatArray, t: FloatArray, wing_mm: FloatArray, prior: Prior, options: AcquireOptions) -> bool:
    """Whether a pose lies within the prior's tolerance, the wing's bending allowed for."""
    slack = options.tolerance_slack
    limit_mm, limit_deg = slack * prior.tolerance_mm, slack * prior.tolerance_deg
    turn = prior.rotation.T @ R  # from the wing as it is to the nominal wing's axes
    spin = np.rad2deg(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    tilt = np.rad2deg(np.arccos(np.clip(turn[2, 2], -1.0, 1.0)))
    if abs(spin) > limit_deg + 0.3 or tilt > limit_deg + options.bending_deg:
        return False
    # Seen from the middle of the cells in view, where bending moves the wing along its normal only.
    middle = np.append(wing_mm.mean(axis=0), 0.0)
    shift = prior.rotation.T @ (R @ middle + t - prior.translation_mm) - middle
    c, s = np.cos(np.deg2rad(spin)), np.sin(np.deg2rad(spin))
    swung = np.array([[c, -s], [s, c]]) @ middle[:2] - middle[:2]
    lift = limit_mm + np.linalg.norm(middle) * np.deg2rad(limit_deg) + options.bending_mm
    return bool(np.all(np.abs(shift[:2] - swung) <= limit_mm + 2.0) and abs(shift[2]) <= lift)


def _absent(eyes: Sequence[_Eye], names: tuple[Labelling, Labelling], grid: CellGrid, options: AcquireOptions) -> int:
    """Cells that should be seen beside those that are, and whose lines are positively not there in any eye that has them in view.

    A shadow leaves faint lines, and an occluded cell stands beside others in the other eye; the sky has none.
    """
    seen = np.zeros((2, grid.count), dtype=np.bool_)
    for eye in (0, 1):
        seen[eye, names[eye].label[names[eye].label >= 0]] = True
    there = seen.any(axis=0)
    gone = np.zeros(grid.count, dtype=np.bool_)
    for eye in (0, 1):
        view, warp = eyes[eye].view, names[eye].warp
        beside = np.append(seen[eye], False)[grid.neighbour]  # (N, 4)
        asked = np.flatnonzero(~there & beside.any(axis=1) & predicted_inside(view, warp, grid))
        if not len(asked):
            continue
        known = np.flatnonzero(seen[eye])
        every = np.ones((len(known), 4), dtype=np.bool_)
        contrast = np.full(grid.count + 1, np.nan)
        contrast[known] = line_contrast(view, warp, grid, eyes[eye].full_scale, known, every)
        near = np.where(beside[asked], contrast[grid.neighbour[asked]], np.nan)
        reference = np.nan_to_num(near, nan=-np.inf).max(axis=1)
        # The side towards a seen cell is that cell's line or border: it stands there in any case.
        own = line_contrast(view, warp, grid, eyes[eye].full_scale, asked, ~beside[asked])
        known_here = np.isfinite(own) & (reference > 0.0)
        absent = known_here & (own < options.absent * reference)
        gone[asked[absent]] = True
        there[asked[known_here & ~absent]] = True
    return int((gone & ~there).sum())


def _accepted(eyes: Sequence[_Eye], pair: _Pair, grid: CellGrid, score: tuple[int, int]) -> Acquisition:
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
