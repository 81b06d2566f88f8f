"""Cells seen in one eye, linked to integer lattices by what lies one pitch away."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from fsw.vision.cells import centres_of
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A neighbour lies within this part of a pitch from where a cell's own sides expect it.
_REACH = 0.17


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
    links = [(np.flatnonzero(to >= 0), to[to >= 0], step) for to, step in ((right, (1, 0)), (above, (0, 1)))]
    place, label = _places(len(centre), links)
    ratio_x = _ratios(centre, right)
    lattices = []
    for component in np.argsort(-np.bincount(label), kind="stable"):
        member = np.flatnonzero(label == component)
        member = member[_consistent(member, place, links)]
        if len(member):
            at = place[member] - place[member].min(axis=0)
            lattices.append(Lattice(member, at, ratio_x[member]))
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


def _places(n: int, links: list[tuple[IntArray, IntArray, tuple[int, int]]]) -> tuple[IntArray, IntArray]:
    """Integer place (n, 2) by walking the links from one cell of each component, and the component (n,)."""
    tail, head = (np.concatenate([k[i] for k in links]) for i in (0, 1))
    graph = coo_array((np.ones(len(tail)), (tail, head)), shape=(n, n)).tocsr()
    _, label = connected_components(graph, directed=False)
    onward, steps = np.full((len(links), n), -1), np.array([step for _, _, step in links])
    for to, (one, other, _) in zip(onward, links, strict=True):
        to[one] = other
    place = np.zeros((n, 2), dtype=np.int64)
    _, roots = np.unique(label, return_index=True)
    for root in roots:
        order, parent = breadth_first_order(graph, int(root), directed=False)
        _walk(order, parent, onward, steps, place)
    return place, label.astype(np.int64)


@kernel
def _walk(
    order: NDArray[np.int32], parent: NDArray[np.int32], onward: IntArray, steps: IntArray, place: IntArray
) -> None:
    """Place (n, 2) of one component's cells, in the order of their walk, from that of the cell each was reached from.

    onward (links, n): the cell that a link leads to; steps (links, 2): what it changes the place by.
    """
    for node in order[1:]:
        up = parent[node]
        for i in range(len(steps)):
            forth = onward[i, up] == node
            if forth or onward[i, node] == up:
                sign = 1 if forth else -1
                place[node, 0], place[node, 1] = place[up, 0] + sign * steps[i, 0], place[up, 1] + sign * steps[i, 1]


def _consistent(
    member: IntArray, place: IntArray, links: list[tuple[IntArray, IntArray, tuple[int, int]]]
) -> NDArray[np.bool_]:
    """Which members have a place of their own, and no link that contradicts it."""
    _, inverse, count = np.unique(place[member], axis=0, return_inverse=True, return_counts=True)
    good = count[inverse.reshape(-1)] == 1
    bad = np.zeros(len(place), dtype=np.bool_)
    for tail, head, step in links:
        wrong = np.any(place[head] - place[tail] != np.array(step), axis=1)
        bad[tail[wrong]] = bad[head[wrong]] = True
    return np.asarray(good & ~bad[member])


def _ratios(centre: FloatArray, right: IntArray) -> FloatArray:
    """Distance (n,) to the next column's cell over that to the last one's; NaN where one is missing."""
    n = len(centre)
    left = np.full(n, -1, dtype=np.int64)
    left[right[right >= 0]] = np.flatnonzero(right >= 0)
    ahead, behind = (np.linalg.norm(centre[to] - centre, axis=1) for to in (right, left))
    return np.where((right >= 0) & (left >= 0), ahead, np.nan) / np.where(behind > 0.0, behind, np.nan)
