"""Cells seen in one eye, linked to integer lattices by what lies one pitch away."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsw.vision.cells import centres_of
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A neighbour lies within this part of a pitch from where a cell's own sides expect it.
_REACH = 0.17
_STEPS = np.array([[1, 0], [0, 1]])  # what a link to the right, and one upwards, changes the place by


@dataclass(frozen=True)
class Lattice:
    """Cells linked to one another. member (n,): indices of the quadrilaterals; place (n, 2): column, row from (0, 0).

    ratio_x (n,): distance to the next column's cell over that to the last one's, which shows fold gaps whatever the
    scale and the threshold; NaN where one is missing.
    """

    member: IntArray
    place: IntArray
    ratio_x: FloatArray


def link(corners: FloatArray, cell_mm: tuple[float, float], steps_x: Sequence[float], step_y: float) -> list[Lattice]:
    """Lattices of quadrilaterals (n, 4, 2) in mm, largest first; single cells too.

    cell_mm: size of a cell. steps_x: distances at which the next column may stand (the pitch first, then those
    across fold gaps); step_y: the rows' pitch. Cells whose links contradict one another are left out.
    """
    if len(corners) == 0:
        return []
    centre = centres_of(corners)
    side_x = 0.5 * (corners[:, 1] - corners[:, 0] + corners[:, 2] - corners[:, 3])
    side_y = 0.5 * (corners[:, 3] - corners[:, 0] + corners[:, 2] - corners[:, 1])
    scale = np.array([steps_x[0], step_y])
    tree = cKDTree(centre / scale)
    found = [_mutual(tree, centre, scale, side_x * (d / cell_mm[0])) for d in steps_x]
    # Nearest of the admitted distances, where several fit.
    miss = np.stack([f[1] for f in found])
    best = np.argmin(miss, axis=0)
    right = np.stack([f[0] for f in found])[best, np.arange(len(centre))]
    above = _mutual(tree, centre, scale, side_y * (step_y / cell_mm[1]))[0]
    onward = np.stack((right, above))
    place, label = _places(onward, _STEPS)
    good = _consistent(place, label, onward)
    ratio_x = _ratios(centre, right)
    lattices = []
    for component in np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1]):
        member = component[good[component]]
        if len(member):
            lattices.append(Lattice(member, place[member] - place[member].min(axis=0), ratio_x[member]))
    return sorted(lattices, key=lambda a: -len(a.member))


def _mutual(tree: cKDTree, centre: FloatArray, scale: FloatArray, step: FloatArray) -> tuple[IntArray, FloatArray]:
    """The cell one step on (n,), or -1, where that cell, one step back, finds this one; and by how far it misses."""
    n = len(centre)
    (ahead_miss, ahead), (_, back) = (
        tree.query((centre + sign * step) / scale, distance_upper_bound=_REACH) for sign in (1.0, -1.0)
    )
    back = np.append(back, n)
    mutual = (ahead < n) & (back[ahead] == np.arange(n))
    return np.where(mutual, ahead, -1), np.where(mutual, ahead_miss, np.inf)


@kernel
def _places(onward: IntArray, steps: IntArray) -> tuple[IntArray, IntArray]:
    """Integer place (n, 2) by walking the links from the first cell of each component, breadth first; component (n,).

    onward (links, n): the cell that a link leads to, or -1; steps (links, 2): what it changes the place by.
    """
    links, n = onward.shape
    back = np.full((links, n), -1)
    for i in range(links):
        for cell in range(n):
            if onward[i, cell] >= 0:
                back[i, onward[i, cell]] = cell
    place, label, queue = np.zeros((n, 2), np.int64), np.full(n, -1), np.empty(n, np.int64)
    components = 0
    for root in range(n):
        if label[root] >= 0:
            continue
        queue[0], label[root], done, known = root, components, 0, 1
        while done < known:
            cell, done = queue[done], done + 1
            for i in range(links):
                for other, sign in ((onward[i, cell], 1), (back[i, cell], -1)):
                    if other >= 0 and label[other] < 0:
                        place[other] = place[cell] + sign * steps[i]
                        label[other], queue[known], known = components, other, known + 1
        components += 1
    return place, label


def _consistent(place: IntArray, label: IntArray, onward: IntArray) -> NDArray[np.bool_]:
    """Which cells (n,) have a place of their own in their component, and no link that contradicts it."""
    low, span = place.min(axis=0), np.ptp(place, axis=0) + 1
    at = (label * span[0] + place[:, 0] - low[0]) * span[1] + place[:, 1] - low[1]
    _, inverse, count = np.unique(at, return_inverse=True, return_counts=True)
    good = count[inverse] == 1
    for to, step in zip(onward, _STEPS, strict=True):
        tail = np.flatnonzero(to >= 0)
        wrong = tail[np.any(place[to[tail]] - place[tail] != step, axis=1)]
        good[wrong] = good[to[wrong]] = False
    return np.asarray(good)


def _ratios(centre: FloatArray, right: IntArray) -> FloatArray:
    """Distance (n,) to the next column's cell over that to the last one's; NaN where one is missing."""
    n = len(centre)
    left = np.full(n, -1, dtype=np.int64)
    left[right[right >= 0]] = np.flatnonzero(right >= 0)
    ahead, behind = (np.linalg.norm(centre[to] - centre, axis=1) for to in (right, left))
    return np.where((right >= 0) & (left >= 0), ahead, np.nan) / np.where(behind > 0.0, behind, np.nan)
