"""Assignments of both eyes that agree in space, with the prior, and with what is not there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.vision.enhancement import MetricView
from fsw.vision.grid import CellGrid
from fsw.vision.identity import Assignment, Labelling
from fsw.vision.rig import StereoRig
from fsw.vision.surface import line_contrast, predicted_inside

FloatArray = NDArray[np.float64]

MOST_COST = 10**6  # no assignment costs as much


@dataclass(frozen=True)
class Prior:
    """Where the wing is expected: X_left = R X_wing + t, wrong by at most these tolerances, and bent by vibration."""

    rotation: FloatArray
    translation_mm: FloatArray
    tolerance_mm: float
    tolerance_deg: float


@dataclass(frozen=True)
class AcquireOptions:
    """Limits of the search, set between what a right assignment shows and one that is off by one."""

    bending_mm: float = 40.0  # greatest deflection of the wing out of its plane
    bending_deg: float = 4.0  # and its slope
    cell_tolerance: float = 0.3  # sides of a cell in the metric view, against the nominal pose's
    min_cells: int = 8  # named in both eyes
    ray_miss: float = 0.1  # median distance between the two eyes' rays, in parts of the smaller pitch
    scale_part: float = 0.35  # of the scale error that a shift by one row between the eyes brings
    scale_limits: tuple[float, float] = (0.004, 0.02)
    tolerance_slack: float = 1.15  # the prior's tolerances are taken so much wider
    contradiction_weight: int = 3  # a cell found where the wing has none, against a cell not found where it has one
    absent: float = 0.02  # a line that shows less than this part of its neighbours' contrast is not there
    margin: int = 5  # the best assignment must beat the second by so much
    max_contradicted: float = 0.05  # part of the cells


@dataclass(frozen=True)
class EyeCells:
    """What one eye found: quadrilaterals of a cell's size."""

    view: MetricView
    corners_mm: FloatArray  # (K, 4, 2) quadrilaterals in the view
    centre_px: FloatArray  # (K, 2) ideal
    full_scale: float


@dataclass(frozen=True)
class Pair:
    """One assignment of both eyes, the rigid wing's pose through it, and what speaks against it."""

    names: tuple[Labelling, Labelling]
    rotation: FloatArray
    translation_mm: FloatArray
    ray_miss_mm: float
    scale: float
    cost: int
    within: bool  # the prior's tolerance


def agreeing(
    eyes: Sequence[EyeCells],
    names: Sequence[Sequence[Assignment]],
    rig: StereoRig,
    grid: CellGrid,
    prior: Prior,
    options: AcquireOptions,
) -> tuple[list[Pair], int]:
    """Assignments of both eyes that agree in space, best first; also those outside the prior's tolerance.

    Those whose contradictions alone cost too much to be the best, or a rival of it, are not looked at: also returns
    what the least of them would cost, at least.
    """
    pitch = np.array([p.pitch_mm for p in grid.panels]).min()
    scale_error = float(np.clip(options.scale_part * pitch / rig.baseline_mm, *options.scale_limits))
    weight, enough = options.contradiction_weight, MOST_COST
    ways = [(weight * (a.wrong + b.wrong), i, j) for i, a in enumerate(names[0]) for j, b in enumerate(names[1])]
    found: list[Pair] = []
    for least, left, right in sorted(ways):
        if least >= enough:
            return sorted(found, key=lambda p: p.cost), least
        a, b = names[0][left].whole, names[1][right].whole
        cells, i, j = np.intersect1d(a.label, b.label, return_indices=True)
        i, j, cells = i[cells >= 0], j[cells >= 0], cells[cells >= 0]
        if len(cells) < options.min_cells:
            continue
        xyz, miss = _rays(rig, eyes[0].centre_px[i], eyes[1].centre_px[j])
        ray_miss = float(np.median(miss))
        if not ray_miss <= options.ray_miss * pitch:
            continue
        R, t, scale = _rigid(grid.centre_mm[cells], xyz)
        if abs(scale - 1.0) > scale_error:
            continue
        cost = weight * (a.contradicted + b.contradicted) + _absent(eyes, (a, b), grid, options)
        within = _within(R, t, grid.centre_mm[cells], prior, options)
        found.append(Pair((a, b), R, t, ray_miss, scale, cost, within))
        if within:
            enough = min(enough, cost + options.margin)
    return sorted(found, key=lambda p: p.cost), MOST_COST


def _rays(rig: StereoRig, left_px: FloatArray, right_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 3) midway between the eyes' rays, and the rays' distance (n,) in mm; infinite behind an eye."""
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
    # Nobody says about which point the nominal pose is turned: the wing's root, or what the cameras look at.
    off = np.minimum(np.abs(shift[:2] - swung), np.abs(shift[:2]))
    return bool(np.all(off <= limit_mm + 2.0) and abs(shift[2]) <= lift)


def _absent(
    eyes: Sequence[EyeCells], names: tuple[Labelling, Labelling], grid: CellGrid, options: AcquireOptions
) -> int:
    """Cells that should be seen beside those that are, and whose lines no eye that has them in view shows.

    A shadow leaves faint lines, and an occluded cell stands beside others in the other eye; the sky has none.
    """
    seen = np.zeros((2, grid.count), dtype=np.bool_)
    for eye in (0, 1):
        seen[eye, names[eye].label[names[eye].label >= 0]] = True
    there = np.asarray(seen.any(axis=0))
    gone = np.zeros(grid.count, dtype=np.bool_)
    for eye in (0, 1):
        view, warp = eyes[eye].view, names[eye].warp
        beside = np.append(seen[eye], False)[grid.neighbour]  # (N, 4)
        asked = np.flatnonzero(~there & beside.any(axis=1))
        asked = asked[predicted_inside(view, warp, grid, asked)]
        if not len(asked):
            continue
        near, known = grid.neighbour[asked], np.unique(grid.neighbour[asked][beside[asked]])
        every = np.ones((len(known), 4), dtype=np.bool_)
        contrast = np.full(grid.count + 1, np.nan)
        contrast[known] = line_contrast(view, warp, grid, eyes[eye].full_scale, known, every)
        reference = np.nan_to_num(contrast[near], nan=-np.inf).max(axis=1)
        # The side towards a seen cell is that cell's line or border: it stands there in any case.
        own = line_contrast(view, warp, grid, eyes[eye].full_scale, asked, ~beside[asked])
        known_here = np.isfinite(own) & (reference > 0.0)
        absent = known_here & (own < options.absent * reference)
        gone[asked[absent]] = True
        there[asked[known_here & ~absent]] = True
    return int((gone & ~there).sum())
