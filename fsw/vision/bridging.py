"""From one frame to the next: where the surface may have gone to, and which of these places the lines confirm.

A wing that moves by half a cell or more between two frames shows lines where others were expected. So several places
are tried, each with a quick look at a part of the cells: where the surface was, where it goes if it moves on as it did,
and, if the lines confirm neither, wherever the wing's bending may have brought it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fsw.vision.edges import FloatArray
from fsw.vision.grid import CellGrid, IntArray
from fsw.vision.prediction import BENDING, RIGID, UNKNOWNS, Surface, locate
from fsw.vision.rig import Eyes, norm, project
from fsw.vision.search import SEARCH, SIDES_SEARCHED, Sightings
from wingbeat.kernels import tick_kernel

BoolArray = NDArray[np.bool_]

TRIED_CELLS = 100  # looked at in a trial, about
LOOKED_CELLS = 150  # looked at where it was, and once its place is confirmed, about: part of the wing is out of view
NEAR_PX = 20.0  # and how far from their places
MET_PX = 10.0  # the same where the few unknowns have met enough of the lines; needless if they moved by less
STILL_PX = 6.0  # the same at first, of a wing that did not move in the tick before, ...
SURPRISE = 2.0  # ... and so many times as far as it moved beyond that
CONFIRMED = 0.6  # least share of the lines that makes further trials needless, ...
AS_BEFORE = 0.9  # ... and of the share in the frame before: half a wing that stands still confirms the wrong place too
SWING_MM = 130.0  # of the tip, between two frames or while the search took its time
MOST_STEPS = 20  # of the range, to either side
MEETS_PX, MEETS = 1.5, 0.06  # a line meets its place within this, or this part of the cell's extent

# Static bending of a cantilever, (3 s2 - s3) / 2 with s = (x + 1) / 2, in the surface's polynomial: 1 mm at the tip.
_SWING = {0: 5.0 / 16.0, 1: 9.0 / 16.0, 4: 3.0 / 16.0, 6: -1.0 / 16.0}


def swing() -> FloatArray:
    """Change (UNKNOWNS,) of the surface that bends its tip by 1 mm."""
    change = np.zeros(UNKNOWNS)
    for term, share in _SWING.items():
        change[RIGID + term] = share
    return change


def step_of(grid: CellGrid, cells: int) -> int:
    """Step from cell to cell that takes about so many of a grid's, in every row of every panel."""
    step = max(1, grid.count // cells)
    while any(math.gcd(step, panel.rows) > 1 for panel in grid.panels):
        step += 1
    return step


@tick_kernel
def carry(seen: Sightings, corners_px: FloatArray) -> float:
    """Refer the sightings to where the surface expects their lines by now; returns how far the farthest was moved, px.

    A line that meets its place so is the one that another look from there would find: the next one is a pitch away.
    """
    farthest = 0.0
    for eye in range(2):
        for n in range(corners_px.shape[1]):
            for i in range(2):
                if math.isnan(seen.offset_px[eye, n, i]):
                    continue
                a, b = corners_px[eye, n, SIDES_SEARCHED[i]], corners_px[eye, n, SIDES_SEARCHED[i] + 1]
                normal, middle = seen.normal[eye, n, i], seen.middle_px[eye, n, i]
                x, y = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])
                moved = (x - middle[0]) * normal[0] + (y - middle[1]) * normal[1]
                seen.offset_px[eye, n, i] -= moved
                middle[0], middle[1] = x, y
                farthest = max(farthest, abs(moved))
    return farthest


@tick_kernel
def confirmed(seen: Sightings, corners_px: FloatArray, in_view: BoolArray, neighbour: IntArray, step: int) -> float:
    """Share of the lines asked for in both eyes, at every step-th cell, that lie where the surface expects them."""
    asked, near = 0, 0.0
    for n in range(0, in_view.shape[0], step):
        if not in_view[n]:
            continue
        for eye in range(2):
            c = corners_px[eye, n]
            for i in range(2):
                side = SIDES_SEARCHED[i]
                if neighbour[n, side] < 0:
                    continue
                asked += 1
                offset = seen.offset_px[eye, n, i]
                if math.isnan(offset):
                    continue
                far = 1 if side == 1 else 3
                gate = max(MEETS_PX, MEETS * norm(c[far, 0] - c[0, 0], c[far, 1] - c[0, 1]))
                near += 1.0 / (1.0 + (offset / gate) ** 2)
    return near / asked if asked > 0 else 0.0


@tick_kernel
def swing_step_mm(
    surface: Surface, eyes: Eyes, corners_px: FloatArray, in_view: BoolArray, change: FloatArray
) -> float:
    """How far the tip may swing for lines to move by what one look bridges; 0 without cells in view."""
    R = surface.rotation
    fastest = 0.0
    for n in range(in_view.shape[0]):
        if not in_view[n]:
            continue
        z = 0.0
        for j in range(RIGID, RIGID + BENDING):
            z += change[j] * surface.basis[n, 4, j - RIGID]
        x0, y0, z0 = locate(surface, n, 4)
        for eye in range(2):
            P, c = eyes.projection[eye], corners_px[eye, n]
            u0, v0, _ = project(P, x0, y0, z0)
            u1, v1, _ = project(P, x0 + R[0, 2] * z, y0 + R[1, 2] * z, z0 + R[2, 2] * z)
            # In parts of the cell: what moves along a cell's long side has farther to go.
            ax, ay, bx, by = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[3, 0] - c[0, 0], c[3, 1] - c[0, 1]
            det = ax * by - ay * bx
            along = ((u1 - u0) * by - (v1 - v0) * bx) / det
            across = (ax * (v1 - v0) - ay * (u1 - u0)) / det
            fastest = max(fastest, abs(along), abs(across))
    return SEARCH / fastest if fastest > 0.0 else 0.0
