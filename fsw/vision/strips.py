"""Strips of a side: neighbouring columns of pixels summed, while the edge drifts less than half a pixel along them."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.lanes import LANES, ROWS, make_column_reader, make_row_reader
from fsw.vision.rig import distort_point
from wingbeat.kernels import inline_kernel, tick_kernel

FloatArray = NDArray[np.float64]
Image = NDArray[Any]
Curve = tuple[float, float, float, float]
Point = tuple[float, float]

MOST_COLUMNS = 4  # of a strip
DRIFT_PX = 0.5  # of the edge from end to end of a strip, at most
MOST_STRIPS = 256  # of a side,
LEAST_STRIPS = 24  # and at least: fewer do not tell their noise
LINE_PX = 5 * ROWS  # read across a side at once: LANES, and what it drifts over as many strips

# Read LANES strips, or one, by how many columns (or rows) of the image a strip has.
_four_columns, _two_columns, _one_column = (make_column_reader(each) for each in (4, 2, 1))
_four_rows, _two_rows, _one_row = (make_row_reader(each) for each in (4, 2, 1))


class Strips(NamedTuple):
    """Strips of the side being measured; taken once."""

    lines: NDArray[np.float32]  # (MOST_STRIPS + LANES, LINE_PX) their pixels, along the image
    start: NDArray[np.int64]  # (MOST_STRIPS,) where in its line a strip's window begins, < 0: not in the image
    place: FloatArray  # (MOST_STRIPS,) of the edge behind the pixel before the window's middle, outwards, 0 .. 1


def make_strips() -> Strips:
    """Take the memory."""
    lines = np.zeros((MOST_STRIPS + LANES, LINE_PX), np.float32)
    return Strips(lines, np.zeros(MOST_STRIPS, np.int64), np.zeros(MOST_STRIPS))


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
    """Read the strips of a side that the image shows."""
    across, along = image.shape if way.vertical else image.shape[::-1]
    limit = across - way.taps
    for strip in range(0, way.strips, LANES):
        _find_windows(curve, way, strip, along, out)
        if way.vertical:
            _read_columns(image, way, strip, limit, out)
        else:
            _read_rows(image, way, strip, limit, out)


@inline_kernel
def _find_windows(curve: Curve, way: Way, strip: int, along: int, out: Strips) -> None:
    """Where LANES strips begin across the side. Places are counted outwards, as the templates are."""
    half, sign = way.taps // 2, 1.0 if way.outwards else -1.0
    column, middle = column_of(way, strip), 0.5 * (way.each - 1)
    for i in range(strip, min(strip + LANES, way.strips)):
        centre = sign * place_at(curve, column + middle)
        base = math.floor(centre)
        out.place[i] = centre - base
        if column < 0 or column + way.each > along:
            out.start[i] = -1
        else:
            out.start[i] = base - half + 1 if way.outwards else -base - half
        column += way.each


@inline_kernel
def _read_columns(image: Image, way: Way, strip: int, limit: int, out: Strips) -> None:
    """Read LANES strips that lie side by side along image rows."""
    end = min(strip + LANES, way.strips)
    column = column_of(way, strip)
    # Nothing may be read before the image's first pixel, nor behind its last.
    pitch, last = image.strides[0] // image.itemsize, image.shape[0] - 1
    before, beyond = -column, column + LANES * way.each - image.shape[1]
    least = 1 + (before - 1) // pitch if before > 0 else 0
    if beyond > 0:
        shorter = 1 + (beyond - 1) // pitch
        last, limit = last - shorter, limit - shorter
    row, stop = last + 1, 0
    for i in range(strip, end):
        if least <= out.start[i] <= limit:
            row, stop = min(row, out.start[i]), max(stop, out.start[i] + way.taps)
    for i in range(strip, end):
        inside = least <= out.start[i] <= min(limit, row + LINE_PX - LANES)
        out.start[i] = out.start[i] - row if inside else -1
    x, z, s = np.uintp(column), np.uintp(last), np.uintp(strip)
    for place in range(0, min(stop - row, LINE_PX), ROWS):
        y, p = np.uintp(row + place), np.uintp(place)
        if way.each == 4:
            _four_columns(image, y, x, z, out.lines, s, p)
        elif way.each == 2:
            _two_columns(image, y, x, z, out.lines, s, p)
        else:
            _one_column(image, y, x, z, out.lines, s, p)


@inline_kernel
def _read_rows(image: Image, way: Way, strip: int, limit: int, out: Strips) -> None:
    """Read LANES strips that lie one below the other."""
    none = np.uintp(0)
    row = column_of(way, strip) - way.each
    for i in range(strip, min(strip + LANES, way.strips)):
        row, column = row + way.each, out.start[i]
        # Lanes beyond the taps must not lie behind the image.
        inside = 0 <= column <= limit and (row + way.each < image.shape[0] or column + LANES <= image.shape[1])
        out.start[i] = 0 if inside else -1
        if not inside:
            continue
        y, x, s = np.uintp(row), np.uintp(column), np.uintp(i)
        if way.each == 4:
            _four_rows(image, y, x, none, out.lines, s, none)
        elif way.each == 2:
            _two_rows(image, y, x, none, out.lines, s, none)
        else:
            _one_row(image, y, x, none, out.lines, s, none)
