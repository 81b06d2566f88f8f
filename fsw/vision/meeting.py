"""A trial of a place of the surface, whole: expect the lines there, look for them, move the surface to meet them.

Each is one kernel, as `view.py`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.bridging import NEAR_PX, carry, confirmed
from fsw.vision.edges import FloatArray, Image
from fsw.vision.fitting import Normal, settle
from fsw.vision.grid import IntArray
from fsw.vision.prediction import Surface, expect
from fsw.vision.rig import Eyes
from fsw.vision.search import Sightings, look
from wingbeat.kernels import tick_kernel

BoolArray = NDArray[np.bool_]


class Lines(NamedTuple):
    """Where both eyes expect the lines of N cells, and where the last look has found them."""

    expected_px: FloatArray  # (2, N, 4, 2) ideal pixels of the corners: the surface's, and what they deviate by
    depth_mm: FloatArray  # (2, N, 4) of the corners
    centre_px: FloatArray  # (2, N, 2)
    in_view: BoolArray  # (2, N)
    wanted: BoolArray  # (N,) in view of both
    deviation_px: FloatArray  # (2, N, 4, 2) of the measured corners from the surface, last tick
    line_ratio: FloatArray  # (N, 4)
    neighbour: IntArray  # (N, 4)
    seen: Sightings


@tick_kernel
def expect_lines(surface: Surface, eyes: Eyes, lines: Lines, step: int = 1) -> None:
    """Expect every step-th cell where the surface is, and as its corners deviate from it."""
    expect(surface, eyes, lines.expected_px, lines.depth_mm, lines.centre_px, lines.in_view, step)
    for n in range(0, len(lines.wanted), step):
        lines.wanted[n] = lines.in_view[0, n] and lines.in_view[1, n]
        if lines.in_view[0, n] or lines.in_view[1, n]:  # the others stay
            for eye in range(2):
                for k in range(4):
                    for i in range(2):
                        lines.expected_px[eye, n, k, i] += lines.deviation_px[eye, n, k, i]


@tick_kernel
def see_lines(
    left: Image, right: Image, surface: Surface, eyes: Eyes, lines: Lines, sign: float, step: int, within_px: float
) -> None:
    """Expect every step-th cell where the surface is, and look for its lines, no farther than within_px from there.

    sign: +1 for cells darker than lines.
    """
    expect_lines(surface, eyes, lines, step)
    _look(left, right, eyes, lines, sign, step, within_px)


@tick_kernel
def _look(left: Image, right: Image, eyes: Eyes, lines: Lines, sign: float, step: int, within_px: float) -> None:
    expected = lines.expected_px, lines.wanted, lines.line_ratio, lines.neighbour
    look(left, right, eyes, *expected, sign, step, within_px, lines.seen)


@tick_kernel
def try_place(
    left: Image,
    right: Image,
    surface: Surface,
    eyes: Eyes,
    lines: Lines,
    sign: float,
    step: int,
    unknowns: int,
    within_px: float,
    enough: float,
    normal: Normal,
) -> tuple[float, float]:
    """See the lines, and move so many unknowns of the surface to meet them.

    Returns which share of the lines confirms it then, and how far the farthest was moved, px. enough: less, and the
    lines are looked for again from where the first look has moved the surface to.
    """
    see_lines(left, right, surface, eyes, lines, sign, step, within_px)
    settle(surface, eyes, lines.seen, unknowns, normal)
    expect_lines(surface, eyes, lines, step)
    moved_px = carry(lines.seen, lines.expected_px)
    share = confirmed(lines.seen, lines.expected_px, lines.wanted, lines.neighbour, step)
    if share < enough:
        _look(left, right, eyes, lines, sign, step, NEAR_PX)
        share = confirmed(lines.seen, lines.expected_px, lines.wanted, lines.neighbour, step)
    return share, moved_px


@tick_kernel
def meet_lines(surface: Surface, eyes: Eyes, lines: Lines, unknowns: int, normal: Normal) -> None:
    """Move so many unknowns of the surface to meet the lines that were seen, and expect all cells there."""
    settle(surface, eyes, lines.seen, unknowns, normal)
    expect_lines(surface, eyes, lines)
