"""Strips of a side: neighbouring columns of pixels summed, while the edge drifts less than half a pixel along them."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.lanes import LANES, ROWS, TAPS, make_column_reader, make_row_reader, make_window_finder
from fsw.vision.rig import distort_point
from fsw.vision.templates import PHASES
from fsw.vision.weighing import PRODUCTS
from wingbeat.kernels import inline_kernel, tick_kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]
Curve = tuple[float, float, float, float]
Point = tuple[float, float]

MOST_COLUMNS = 4  # of a strip
DRIFT_PX = 0.5  # of the edge from end to end of a strip, at most
MOST_STRIPS = 256  # of a side,
LEAST_STRIPS = 24  # and at least: fewer do not tell their noise
LINE_PX = 4 * ROWS  # read across a side at once: TAPS, and what it drifts over LANES strips

_find_windows = make_window_finder(PHASES)
# Read LANES strips, by how many columns (or rows) of the image a strip has.
_four_columns, _two_columns, _one_column = (make_column_reader(each) for each in (4, 2, 1))
_four_rows, _two_rows, _one_row = (make_row_reader(each) for each in (4, 2, 1))


class Strips(NamedTuple):
    """Strips of the side being measured; taken once."""

    lines: NDArray[np.float32]  # (MOST_STRIPS + 1, LINE_PX) their pixels, along the image
    start: NDArray[np.int32]  # (MOST_STRIPS,) where in its line a strip's window begins, < 0: not in the image
    phase: NDArray[np.int32]  # (MOST_STRIPS,) of the edge in the pixel behind the window's middle, outwards: the part
    rest: FloatArray  # (MOST_STRIPS,) of that pixel, and px beyond that part's middle
    product: NDArray[np.float32]  # (PRODUCTS, MOST_STRIPS + LANES) see `weigh_strips`


def make_strips() -> Strips:
    """Take the memory."""
    lines = np.zeros((MOST_STRIPS + 1, LINE_PX), np.float32)
    start, phase = np.zeros((2, MOST_STRIPS), np.int32)
    return Strips(lines, start, phase, np.zeros(MOST_STRIPS), np.zeros((PRODUCTS, MOST_STRIPS + LANES), np.float32))


class Way(NamedTuple):
    """How a side is read: along image columns or rows, and how wide its strips are.

    outwards: whether the image's pixels are numbered outwards, too. first: column of the first of so many strips of
    `each` columns. LANES strips lie side by side, and begin `span` columns from the LANES before. taps: pixels across.
    """

    vertical: bool
    outwards: bool
    first: int
    strips: int
    each: int
    span: int
    taps: int


@inline_kernel
def follow(
    start: Point, end: Point, normal: Point, intrinsics: FloatArray, distortion: FloatArray
) -> tuple[bool, float, float, float, Curve]:
    """The image of a straight line between two ideal points: (vertical, gain, begin, stop, curve).

    vertical: whether it runs along image rows, so that columns of pixels lie across it. gain: how far a step of one
    pixel across leads along the ideal normal, at its middle. begin, stop: where it starts and ends along the image. The
    lens bends it to a parabola through both ends and the middle: see `place_at`.
    """
    u, v = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    x0, y0, _, _, _, _ = distort_point(start[0], start[1], intrinsics, distortion)
    x1, y1, xx, xy, yx, yy = distort_point(u, v, intrinsics, distortion)
    x2, y2, _, _, _, _ = distort_point(end[0], end[1], intrinsics, distortion)
    across_x, across_y, det = yy * normal[0] - yx * normal[1], xx * normal[1] - xy * normal[0], xx * yy - xy * yx
    vertical = abs(across_y) > abs(across_x)
    gain = (across_y if vertical else across_x) / det
    a0, a1, a2 = (x0, x1, x2) if vertical else (y0, y1, y2)
    c0, c1, c2 = (y0, y1, y2) if vertical else (x0, x1, x2)
    before, after = (c0 - c1) / (a0 - a1), (c2 - c1) / (a2 - a1)
    bend = (after - before) / (a2 - a0)
    return vertical, gain, a0, a2, (a1, c1, after - bend * (a2 - a1), bend)


@tick_kernel
def place_at(curve: Curve, along: float) -> float:
    """Where a curve stands across, at a place along the image."""
    t = along - curve[0]
    return curve[1] + t * (curve[2] + t * curve[3])


@tick_kernel
def strip_columns(slope: float, columns: int) -> int:
    """Columns summed to a strip, 4, 2 or 1, of a side of this slope against the image and so many columns."""
    each = MOST_COLUMNS
    while each > 1 and (each * abs(slope) > DRIFT_PX or columns < each * LEAST_STRIPS):
        each //= 2
    return each


@tick_kernel
def drift_variance(slope: float, each: int) -> float:
    """Variance of an edge's place over the columns of a strip, by which the strip looks more blurred."""
    return slope * slope * (each * each - 1) / 12.0


@inline_kernel
def way_along(vertical: bool, outwards: bool, begin: float, stop: float, slope: float, taps: int) -> Way:
    """Cut a side from `begin` to `stop` along the image into strips."""
    first = math.ceil(min(begin, stop))
    columns = math.floor(max(begin, stop)) - first + 1
    each = strip_columns(slope, columns)
    span = LANES * each * (1 + columns // (each * MOST_STRIPS))  # a huge cell's columns need not all be read
    blocks = columns // span
    strips = LANES * blocks + min((columns - blocks * span) // each, LANES)
    way = Way(vertical, outwards, first, strips, each, span, taps)
    first += (first + columns - column_of(way, strips - 1) - each) // 2
    return Way(vertical, outwards, first, strips, each, span, taps)


@tick_kernel
def column_of(way: Way, strip: int) -> int:
    """First column of a strip."""
    return way.first + strip // LANES * way.span + strip % LANES * way.each


@inline_kernel
def read_strips(image: Image, curve: Curve, way: Way, out: Strips) -> None:
    """Read the strips of a side that the image shows. Places are counted outwards, as the templates are."""
    across, along = image.shape if way.vertical else image.shape[::-1]
    half = way.taps // 2
    sign, first = (1, 1 - half) if way.outwards else (-1, -half)
    for strip in range(0, way.strips, LANES):
        column, s = column_of(way, strip), np.uintp(strip)
        middle = column + 0.5 * (way.each - 1)
        low, high = _find_windows(curve, middle, way.each, sign, first, out.start, out.phase, out.rest, s)
        # Rows of the image that are read, a few at once.
        count = (high - low + way.taps + ROWS - 1) // ROWS * ROWS if way.vertical else TAPS
        whole = 0 <= column <= along - LANES * way.each and low >= 0 and high + way.taps <= across
        if not whole or count > min(LINE_PX, across):
            _read_rim(image, way, strip, out)
        elif way.vertical:
            _read_columns(image, way, strip, min(low, across - count), count, out)
        else:
            _read_rows(image, way, strip, out)


@inline_kernel
def _read_columns(image: Image, way: Way, strip: int, row: int, rows: int, out: Strips) -> None:
    """Read LANES strips that lie side by side along image rows."""
    x, s = np.uintp(column_of(way, strip)), np.uintp(strip)
    for place in range(0, rows, ROWS):
        y, p = np.uintp(row + place), np.uintp(place)
        if way.each == 4:
            _four_columns(image, y, x, out.lines, s, p)
        elif way.each == 2:
            _two_columns(image, y, x, out.lines, s, p)
        else:
            _one_column(image, y, x, out.lines, s, p)
    for i in range(strip, strip + LANES):
        out.start[i] -= row


@inline_kernel
def _read_rows(image: Image, way: Way, strip: int, out: Strips) -> None:
    """Read LANES strips that lie one below the other."""
    y, s = np.uintp(column_of(way, strip)), np.uintp(strip)
    if way.each == 4:
        _four_rows(image, y, out.start, out.lines, s)
    elif way.each == 2:
        _two_rows(image, y, out.start, out.lines, s)
    else:
        _one_row(image, y, out.start, out.lines, s)
    for i in range(strip, strip + LANES):
        out.start[i] = 0


@tick_kernel
def _read_rim(image: Image, way: Way, strip: int, out: Strips) -> None:
    """Read those of LANES strips that the image shows, pixel by pixel."""
    across, along = image.shape if way.vertical else image.shape[::-1]
    for i in range(strip, strip + LANES):
        column, start = column_of(way, i), out.start[i]
        if not (0 <= column <= along - way.each and 0 <= start <= across - way.taps):
            out.start[i] = -1
            continue
        out.start[i] = 0
        for k in range(way.taps):
            total = 0
            for each in range(way.each):
                x, y = (column + each, start + k) if way.vertical else (start + k, column + each)
                total += image[y, x]
            out.lines[i, k] = total
