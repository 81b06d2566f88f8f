"""The renderer's compiled loops over pixels: what is painted where each one looks, and the sensor's noise.

They release the interpreter's lock and use one thread: two eyes may be drawn side by side, and no byte depends on it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sim.mapping import NODE_LIGHT, NODE_SHARP_X, NODE_SHARP_Y, NODE_X, NODE_Y, STEP_PX
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]
Records = NDArray[np.void]  # of artwork.PANEL or artwork.HINGE

_REACH = 5.0  # beyond this many sigma an edge is not felt: 3e-7 of its contrast
_PER_SIGMA = 256
_EDGE, _ROOT, _TIP, _BESIDE = (
    -1,
    -2,
    -3,
    -4,
)  # where a node is, if not inside a cell; two numbers a panel from _BESIDE on


def normal_table() -> FloatArray:
    """The cumulative normal distribution from -_REACH to +_REACH, as `_covered` reads it."""
    return ndtr(np.arange(-_REACH * _PER_SIGMA, _REACH * _PER_SIGMA + 2) / _PER_SIGMA)


@kernel
def _covered(sigmas: float, table: FloatArray) -> float:
    """Share of a pixel's spread that lies inside an edge that is this many sigma away (positive: pixel inside)."""
    if sigmas <= -_REACH:
        return 0.0
    if sigmas >= _REACH:
        return 1.0
    at = (sigmas + _REACH) * _PER_SIGMA
    i = int(at)
    return table[i] + (at - i) * (table[i + 1] - table[i])


@kernel
def _place(x: float, y: float, reach_x: float, reach_y: float, panels: Records) -> int:
    """Index of the cell of which (x, y) is well inside; a code below _EDGE well outside the wing; _EDGE elsewhere.

    Each place is convex, and the way from node to node is straight: both ends in one place means all of it.
    """
    if x < panels[0]["x_from"] - reach_x:
        return _ROOT
    if x > panels[-1]["x_to"] + reach_x:
        return _TIP
    for p in range(len(panels)):
        panel = panels[p]
        if x < panel["x_from"] or x > panel["x_to"]:
            continue
        if y < panel["y_from"] - reach_y:
            return _BESIDE - 2 * p
        if y > panel["y_to"] + reach_y:
            return _BESIDE - 2 * p - 1
        u, v = x - panel["first_x"], y - panel["first_y"]
        column, row = int(np.floor(u / panel["pitch_x"])), int(np.floor(v / panel["pitch_y"]))
        if 0 <= column < panel["columns"] and 0 <= row < panel["rows"]:
            u -= column * panel["pitch_x"]
            v -= row * panel["pitch_y"]
            if reach_x < u < panel["cell_x"] - reach_x and reach_y < v < panel["cell_y"] - reach_y:
                return panel["offset"] + column * panel["rows"] + row
    return _EDGE


@kernel
def _two_nearest(
    at: float, pitch: float, size: float, count: int, sharp: float, table: FloatArray
) -> tuple[int, float, int, float]:
    """The nearest cell of a queue and the next across the nearer line, each with its coverage.

    Where there is no next one, the nearest comes twice, the second time with coverage 0.
    """
    line = pitch - size
    near = min(max(int(np.floor((at + 0.5 * line) / pitch)), 0), count - 1)
    from_start = at - near * pitch
    inside = min(from_start, size - from_start)
    other = near - 1 if from_start < 0.5 * size else near + 1
    if other < 0 or other >= count:
        return near, _covered(inside * sharp, table), near, 0.0
    return near, _covered(inside * sharp, table), other, _covered(-(inside + line) * sharp, table)


@kernel
def _within(x: float, y: float, sharp_x: float, sharp_y: float, box: Any, table: FloatArray) -> float:
    """Share of the blurred point that a box covers."""
    inside_x = min(x - box["x_from"], box["x_to"] - x) * sharp_x
    inside_y = min(y - box["y_from"], box["y_to"] - y) * sharp_y
    if min(inside_x, inside_y) <= -_REACH:
        return 0.0
    return _covered(inside_x, table) * _covered(inside_y, table)


@kernel
def _paint(
    grey: NDArray[np.float32],
    at: FloatArray,
    first: int,
    last: int,
    panels: Records,
    cells: FloatArray,
    hinges: Records,
    background: float,
    table: FloatArray,
) -> None:
    """Fill the pixels from node `first` of at (columns, 5) to node `last`, each for itself."""
    for c in range(first * STEP_PX, min(last * STEP_PX, len(grey))):
        j = c // STEP_PX
        f = (c - j * STEP_PX) / STEP_PX
        x = at[j, NODE_X] + f * (at[j + 1, NODE_X] - at[j, NODE_X])
        y = at[j, NODE_Y] + f * (at[j + 1, NODE_Y] - at[j, NODE_Y])
        light = at[j, NODE_LIGHT] + f * (at[j + 1, NODE_LIGHT] - at[j, NODE_LIGHT])
        sharp_x = at[j, NODE_SHARP_X] + f * (at[j + 1, NODE_SHARP_X] - at[j, NODE_SHARP_X])
        sharp_y = at[j, NODE_SHARP_Y] + f * (at[j + 1, NODE_SHARP_Y] - at[j, NODE_SHARP_Y])
        cover, reflectance = 0.0, 0.0
        for p in range(len(panels)):
            panel = panels[p]
            inside = _within(x, y, sharp_x, sharp_y, panel, table)
            if inside == 0.0:
                continue
            line, rows = panel["line"], panel["rows"]
            cover += inside
            reflectance += inside * line
            i0, c0, i1, c1 = _two_nearest(
                x - panel["first_x"], panel["pitch_x"], panel["cell_x"], panel["columns"], sharp_x, table
            )
            j0, r0, j1, r1 = _two_nearest(y - panel["first_y"], panel["pitch_y"], panel["cell_y"], rows, sharp_y, table)
            near, beyond = panel["offset"] + i0 * rows, panel["offset"] + i1 * rows
            reflectance += c0 * (r0 * (cells[near + j0] - line) + r1 * (cells[near + j1] - line))
            reflectance += c1 * (r0 * (cells[beyond + j0] - line) + r1 * (cells[beyond + j1] - line))
        for h in range(len(hinges)):
            over = _within(x, y, sharp_x, sharp_y, hinges[h], table)
            cover += over * (1.0 - cover)
            reflectance += over * (hinges[h]["reflectance"] - reflectance)
        grey[c] = reflectance * light + (1.0 - cover) * background


@kernel
def _draw_row(
    grey: NDArray[np.float32],
    at: FloatArray,
    panels: Records,
    cells: FloatArray,
    hinges: Records,
    background: float,
    table: FloatArray,
) -> None:
    """Fill one row of noise-free grey values from its nodes at (columns, 5)."""
    here = _EDGE
    start = 0  # the first node that is not yet drawn from
    for j in range(len(at)):
        reach_x, reach_y = _REACH / at[j, NODE_SHARP_X], _REACH / at[j, NODE_SHARP_Y]
        there = _place(at[j, NODE_X], at[j, NODE_Y], reach_x, reach_y, panels)
        if here == there and here != _EDGE:
            # Pixels near edges are drawn many at a time: a call costs as much as several of them.
            if start < j - 1:
                _paint(grey, at, start, j - 1, panels, cells, hinges, background, table)
            start = j
            light, shine = at[j - 1, NODE_LIGHT], (at[j, NODE_LIGHT] - at[j - 1, NODE_LIGHT]) / STEP_PX
            for c in range((j - 1) * STEP_PX, min(j * STEP_PX, len(grey))):
                if here < _EDGE:
                    grey[c] = background
                else:
                    grey[c] = cells[here] * (light + shine * (c - (j - 1) * STEP_PX))
        here = there
    _paint(grey, at, start, len(at) - 1, panels, cells, hinges, background, table)


@kernel
def _scramble(key: np.uint64) -> np.uint64:
    """Splitmix64: a well mixed number from a key."""
    key = key + np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@kernel
def _expose_row(
    out: NDArray[Any],
    grey: NDArray[np.float32],
    noise: NDArray[np.float32],
    shot: np.float32,
    read: np.float32,
    top: np.float32,
) -> None:
    """Round grey + noise to whole grey values; variance = shot grey + read."""
    for c in range(len(out)):
        mean = grey[c]
        value = mean + noise[c] * np.sqrt(shot * mean + read) + np.float32(0.5)
        out[c] = min(max(value, np.float32(0.0)), top)


@kernel
def draw(
    out: NDArray[Any],
    nodes: FloatArray,
    at: FloatArray,
    grey: NDArray[np.float32],
    panels: Records,
    cells: FloatArray,
    hinges: Records,
    background: float,
    table: FloatArray,
    noise: NDArray[np.float32],
    key: np.uint64,
    shot: float,
    read: float,
    top: float,
) -> None:
    """Fill out (height, width) from the nodes; at (columns, 5) and grey (width,) are scratch.

    noise: standard normal numbers, many more than width; key decides from which place on each row reads them.
    shot: variance per grey value; read: variance in the dark; top: the largest grey value.
    """
    places = np.uint64(len(noise) - len(grey))
    for r in range(out.shape[0]):
        i = r // STEP_PX
        f = (r - i * STEP_PX) / STEP_PX
        for j in range(nodes.shape[1]):
            for k in range(nodes.shape[2]):
                at[j, k] = nodes[i, j, k] + f * (nodes[i + 1, j, k] - nodes[i, j, k])
        _draw_row(grey, at, panels, cells, hinges, background, table)
        place = _scramble(key + np.uint64(r)) % places
        _expose_row(
            out[r],
            grey,
            noise[place : place + np.uint64(len(grey))],
            np.float32(shot),
            np.float32(read),
            np.float32(top),
        )
