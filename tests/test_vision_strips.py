"""Sides matched by strips: sums of pixels exact; places without bias, at the bound of all pixels, and honest."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from test_vision_edges import table_of

from fsw.vision.edges import BLUR, OWN, RIGHT, Scratch, make_scratch
from fsw.vision.lanes import LANES, ROWS, TAPS, make_column_reader, make_row_reader, make_window_finder
from fsw.vision.matched import match_segments
from fsw.vision.rig import distort_points, undistort_points
from fsw.vision.sides import UNSETTLED_PX, Lens, Side, fit_segments, inset_px
from fsw.vision.straight import share_noise, straight_side
from fsw.vision.strips import (
    MOST_STRIPS,
    Way,
    column_of,
    follow,
    make_strips,
    place_at,
    read_strips,
    strip_columns,
    way_along,
)
from fsw.vision.templates import COLUMNS, fill_templates
from fsw.vision.weighing import FIRST, OTHERS, PRODUCTS, add_strips, weigh_others, weigh_strips
from hal.frame import as_frame
from wingbeat.kernels import kernel

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
BLUR_PX = 0.6
ONE_COLUMN, TWO_COLUMNS, FOUR_COLUMNS = (make_column_reader(each) for each in (1, 2, 4))
ONE_ROW, TWO_ROWS, FOUR_ROWS = (make_row_reader(each) for each in (1, 2, 4))
WINDOWS = make_window_finder(32)
STRAIGHT, BARREL = np.zeros(5), np.array([-0.12, 0.03, 1e-3, -2e-3, 0.0])


@kernel
def read_at(
    image: np.ndarray[Any, Any],
    kind: int,
    row: int,
    columns: np.ndarray[Any, np.dtype[np.int32]],
    lines: np.ndarray[Any, np.dtype[np.float32]],
) -> None:
    """LANES strips of one of three kinds of columns, or of one of three kinds of rows."""
    y, x, s, p = np.uintp(row), np.uintp(columns[2]), np.uintp(2), np.uintp(3)
    if kind == 0:
        ONE_COLUMN(image, y, x, lines, s, p)
    elif kind == 1:
        TWO_COLUMNS(image, y, x, lines, s, p)
    elif kind == 2:
        FOUR_COLUMNS(image, y, x, lines, s, p)
    elif kind == 3:
        ONE_ROW(image, y, columns, lines, s)
    elif kind == 4:
        TWO_ROWS(image, y, columns, lines, s)
    else:
        FOUR_ROWS(image, y, columns, lines, s)


@kernel
def windows_at(
    curve: tuple[float, float, float, float],
    sign: int,
    starts: np.ndarray[Any, np.dtype[np.int32]],
    phases: np.ndarray[Any, np.dtype[np.int32]],
    rests: FloatArray,
) -> tuple[int, int]:
    """Windows of LANES strips of 4 columns from 21.5 on."""
    return WINDOWS(curve, 21.5, 4.0, sign, -5, starts, phases, rests, np.uintp(2))


@kernel
def products_at(
    lines: np.ndarray[Any, np.dtype[np.float32]],
    starts: np.ndarray[Any, np.dtype[np.int32]],
    phases: np.ndarray[Any, np.dtype[np.int32]],
    rests: FloatArray,
    weight: np.ndarray[Any, np.dtype[np.float32]],
    own: np.ndarray[Any, np.dtype[np.float32]],
    products: np.ndarray[Any, np.dtype[np.float32]],
) -> tuple[float, float, float, float, float]:
    """Products of LANES strips from the second on with table 1; of the third one, those with the other templates."""
    one, two = np.uintp(1), np.uintp(2)
    weigh_strips(lines, starts, weight, one, phases, rests, products, one)
    return weigh_others(lines, two, np.uintp(starts[2]), weight, own, one, np.uintp(phases[2]))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("kind", range(6))
def test_strips_are_exact_sums_of_pixels(dtype: type, kind: int) -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, np.iinfo(dtype).max + 1, (60, 90)).astype(dtype)
    image[20:28, 20:40] = np.iinfo(dtype).max  # the largest sums fit
    each, columns = (1, 2, 4)[kind % 3], kind < 3
    for row, column in ((18, 19), (60 - (ROWS if columns else LANES * each), 90 - (each * LANES if columns else TAPS))):
        lines = np.full((LANES + 4, ROWS + TAPS), -1.0, np.float32)
        first = np.full(LANES + 4, column, np.int32)
        first[3:] -= np.arange(LANES + 1, dtype=np.int32)  # strips of rows may begin anywhere
        read_at(image, kind, row, first, lines)
        if columns:
            part = image[row : row + ROWS, column : column + each * LANES].astype(np.int64)
            true = part.reshape(ROWS, LANES, each).sum(axis=2).T
        else:
            strips = [image[row + i * each : row + (i + 1) * each, first[2 + i] :][:, :TAPS] for i in range(LANES)]
            true = np.stack([strip.sum(axis=0, dtype=np.int64) for strip in strips])
        place = 3 if columns else 0
        high, wide = true.shape
        assert (lines[2 : 2 + high, place : place + wide] == true).all()
        lines[2 : 2 + high, place : place + wide] = -1.0
        assert (lines == -1.0).all()  # and nothing else is written


@pytest.mark.parametrize("sign", [1, -1])
def test_windows_begin_where_the_curve_stands(sign: int) -> None:
    curve = (30.25, 101.37, 0.11, 2e-4)
    starts, phases = np.full((2, LANES + 3), -7, np.int32)
    rests = np.full(LANES + 3, -7.0)
    ends = windows_at(curve, sign, starts, phases, rests)
    place = sign * np.array([place_at(curve, 21.5 + 4.0 * i) for i in range(LANES)])
    pixel = np.floor(place)
    part = np.floor(32.0 * (place - pixel))
    assert (starts[2:-1] == sign * pixel - 5).all() and (phases[2:-1] == part).all()
    assert rests[2:-1] == pytest.approx(place - pixel - (part + 0.5) / 32.0, abs=1e-12)
    assert ends == (starts[2:-1].min(), starts[2:-1].max())
    assert (starts[[0, 1, -1]] == -7).all() and (rests[[0, 1, -1]] == -7.0).all()  # and nothing else is written


def test_products_are_of_what_a_strip_differs_by_from_its_first_pixel() -> None:
    rng = np.random.default_rng(4)
    lines, weight = (rng.normal(size=n).astype(np.float32) for n in ((LANES + 2, TAPS + 5), (2, 3, COLUMNS, TAPS)))
    own, products = weight[:, :, 3].copy(), np.full((PRODUCTS, LANES + 2), -7.0, np.float32)
    starts, phases = rng.integers(0, 5, LANES + 2).astype(np.int32), rng.integers(0, 3, LANES + 2).astype(np.int32)
    rests = rng.uniform(-0.02, 0.02, LANES + 2)
    starts[4] = -1  # not in the image
    others = products_at(lines, starts, phases, rests, weight, own, products)
    for i in range(1, LANES + 1):
        at = max(starts[i], 0)
        true = (lines[i, at : at + TAPS] - lines[i, at]).astype(float)
        step, shift = weight[1, phases[i], :FIRST] @ true
        wanted = [0.0, 0.0, 0.0] if i == 4 else [step, shift - step * rests[i], 1.0]
        assert products[:, i] == pytest.approx(wanted, rel=1e-5, abs=1e-5)
        if i == 2:
            assert others[:OTHERS] == pytest.approx(weight[1, phases[2], FIRST:] @ true, rel=1e-5, abs=1e-5)
            assert others[OTHERS] == pytest.approx(own[1, phases[2]] @ true**2, rel=1e-5, abs=1e-5)
    assert (products[:, [0, -1]] == -7.0).all()  # and nothing else is written


@kernel
def sums_of(
    products: np.ndarray[Any, np.dtype[np.float32]], begun: int, ended: int
) -> tuple[float, float, float, float, float]:
    """Sums over a part of the strips."""
    return add_strips(products, np.uintp(begun), np.uintp(ended))


@pytest.mark.parametrize(("begun", "ended"), [(0, 8), (3, 4), (5, 21), (7, 30), (11, 11)])
def test_sums_are_of_a_segments_own_strips(begun: int, ended: int) -> None:
    products = np.random.default_rng(5).normal(size=(PRODUCTS, 30 + LANES)).astype(np.float32)
    b, c, taken = products[:, begun:ended].astype(float)
    true = [taken.sum(), b.sum(), (b * b).sum(), (b * c).sum(), (c * c).sum()]
    assert sums_of(products, begun, ended) == pytest.approx(true, rel=1e-5, abs=1e-5)


@dataclass(frozen=True)
class Edge:
    """A straight edge in ideal pixels, cell | line, as a lens with distortion shows it."""

    start: tuple[float, float] = (60.3, 81.2)
    end: tuple[float, float] = (260.9, 90.7)
    outwards: float = 1.0  # the line lies on the side of the normal (ey, -ex), or on the other one
    distortion: Any = None
    grey: tuple[float, float] = (30.0, 175.0)
    size: tuple[int, int] = (320, 300)
    blur_px: float = BLUR_PX

    @property
    def lens(self) -> Lens:
        whole = float(np.sqrt(self.blur_px**2 + 1.0 / 12.0))
        distortion = STRAIGHT if self.distortion is None else self.distortion
        return Lens(
            np.array([400.0, 400.0, 160.0, 150.0]), distortion, whole, table_of(self.blur_px), np.array([1.0, 0.0])
        )

    @property
    def normal(self) -> tuple[float, float]:
        e = np.subtract(self.end, self.start) / np.hypot(*np.subtract(self.end, self.start))
        return float(self.outwards * e[1]), float(-self.outwards * e[0])

    def light(self, away_px: float = 0.0, grows: float = 0.0) -> FloatArray:
        """Grey values, the edge moved outwards: the lens's blur along the normal, the pixel's by integration.

        grows: relative growth of the light per px outwards.
        """
        width, height = self.size
        middle = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1).reshape(-1, 2)
        total = self._grey(middle, away_px, grows)
        # A pixel that is farther away than the blur reaches has the same light all over, or light that grows evenly.
        near = np.abs(self._far(middle)) < 10.0 * self.blur_px + 1.0 + abs(away_px)
        total[near] = 0.0
        for (p, wp), (q, wq) in product(zip(NODES, WEIGHTS, strict=True), repeat=2):
            total[near] += 0.25 * wp * wq * self._grey(middle[near] + 0.5 * np.array([p, q]), away_px, grows)
        return total.reshape(height, width)

    def _far(self, at: FloatArray) -> FloatArray:
        """Distances of image points from the edge, outwards."""
        lens = self.lens
        ideal = undistort_points(at, lens.intrinsics, lens.distortion) if lens.distortion.any() else at
        return (ideal - np.array(self.start)) @ np.array(self.normal)

    def _grey(self, at: FloatArray, away_px: float, grows: float) -> FloatArray:
        far = self._far(at) - away_px
        blur, step = self.blur_px, self.grey[1] - self.grey[0]
        slope = step * np.exp(-0.5 * (far / blur) ** 2) / (blur * np.sqrt(2.0 * np.pi))
        # The light falls before the lens blurs what it shows.
        return (self.grey[0] + step * ndtr(far / blur)) * (1.0 + grows * far) + grows * blur**2 * slope

    def measure(
        self, image: Any, ratio: float = 1.0, room_px: float = 9.0, gain: float | None = None, grows: float = 0.0
    ) -> tuple[bool, float, float]:
        """Whether the side is found, how far outwards, and its variance.

        gain: the templates', if not this edge's own; grows: of the light, as the tracker is told.
        """
        (good, _, middle, _, variance, _), side = self.match(image, ratio, room_px, gain)
        return good, middle - side.by_light * grows, variance

    def match(
        self,
        image: Any,
        ratio: float = 1.0,
        room_px: float = 9.0,
        gain: float | None = None,
        scratch: Scratch | None = None,
    ) -> tuple[tuple[bool, bool, float, float, float, float], Side]:
        """The straight line through its segments, and what these say together."""
        scratch, lens = scratch or make_scratch(), self.lens
        scratch.templates.noise[0] = 1.0, ratio
        across = np.abs(np.subtract(self.end, self.start)).max() / np.hypot(*np.subtract(self.end, self.start))
        fill_templates(lens.step, lens.blur_px, gain or float(across), room_px, 0, scratch.templates)
        sign = 1.0 if self.grey[1] > self.grey[0] else -1.0
        side = match_segments(image, lens, self.start, self.end, self.normal, 0.0, 0, sign, scratch)
        return straight_side(scratch.segments, side.found, side.pieces), side


LEVEL, STEEPER, STEEP = (260.9, 90.7), (250.2, 112.9), (210.4, 171.8)  # strips of 4, 2 and 1 columns


def turned(end: tuple[float, float], quarter: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Start and end of an edge, turned by so many quarters about (160, 140)."""
    points = []
    for x, y in ((60.3, 81.2), end):
        for _ in range(quarter):
            x, y = 160.0 - (y - 140.0), 140.0 + (x - 160.0)
        points.append((x, y))
    return points[0], points[1]


@pytest.mark.parametrize(("end", "each"), [(LEVEL, 4), (STEEPER, 2), (STEEP, 1)])
def test_strips_have_as_many_columns_as_the_edges_drift_allows(end: tuple[float, float], each: int) -> None:
    (x0, y0), (x1, y1) = turned(end, 0)
    assert strip_columns((y1 - y0) / (x1 - x0), round(x1 - x0)) == each
    assert strip_columns(0.0, 30) == 1  # too few pixels for wider ones


@pytest.mark.parametrize(("begin", "stop"), [(60.4, 240.9), (240.9, 60.4), (30.2, 2990.1), (-40.0, 200.0)])
def test_strips_cover_a_side_evenly(begin: float, stop: float) -> None:
    way = way_along(True, True, begin, stop, 0.01, 12)
    columns = np.array([column_of(way, i) for i in range(way.strips)])
    low, high = min(begin, stop), max(begin, stop)
    assert (np.diff(columns) >= way.each).all() and low <= columns[0] and columns[-1] + way.each - 1 <= high
    assert abs((columns[0] - low) - (high - columns[-1] - way.each + 1)) <= 2.0
    if high - low > 1100.0:
        assert MOST_STRIPS - LANES <= way.strips <= MOST_STRIPS
    else:
        assert high - low - way.strips * way.each < way.each


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("outwards", [1.0, -1.0])
@pytest.mark.parametrize("end", [LEVEL, STEEPER, STEEP])
def test_an_edge_is_found_without_bias_whichever_way_it_lies(
    end: tuple[float, float], outwards: float, quarter: int
) -> None:
    start, end = turned(end, quarter)
    edge = Edge(start, end, outwards)
    for away in (0.0, 0.08, -0.2):
        image = np.round(100.0 * edge.light(away)).astype(np.uint16)
        for ratio in (1.0, 6.0):
            good, middle, _ = edge.measure(image, ratio)
            assert good and middle == pytest.approx(away, abs=0.003 if away else 0.0015)


@pytest.mark.parametrize("outwards", [1.0, -1.0])
def test_a_lens_bends_the_side_and_the_strips_follow(outwards: float) -> None:
    edge = Edge((30.0, 70.0), (290.0, 80.0), outwards, BARREL)
    good, middle, _ = edge.measure(np.round(100.0 * edge.light()).astype(np.uint16))
    assert good and abs(middle) < 0.003


def test_the_parabola_keeps_to_the_distorted_line() -> None:
    start, end = (30.0, 70.0), (290.0, 80.0)
    edge = Edge(start, end, distortion=BARREL)
    lens = edge.lens
    vertical, gain, begin, stop, curve = follow(start, end, edge.normal, lens.intrinsics, lens.distortion)
    share = np.linspace(0.0, 1.0, 41)[:, None]
    x, y = distort_points(np.array(start) + share * np.subtract(end, start), lens.intrinsics, lens.distortion).T
    assert (begin, stop) == pytest.approx((x[0], x[-1]))
    bend = np.abs(y - np.interp(x, x[[0, -1]], y[[0, -1]])).max()
    off = np.abs([place_at(curve, a) for a in x] - y).max()
    assert vertical and bend > 0.5 and off < 0.02 * bend
    at = distort_points(np.array([[160.0, 75.0]]), lens.intrinsics, lens.distortion)
    (above,), (below,) = (
        undistort_points(at + np.array([[0.0, h]]), lens.intrinsics, lens.distortion) for h in (0.5, -0.5)
    )
    assert gain == pytest.approx(float((above - below) @ np.array(edge.normal)), rel=1e-5)


@pytest.mark.parametrize("bright", [True, False])
@pytest.mark.parametrize(("end", "quarter"), [(LEVEL, 0), (LEVEL, 1), (STEEPER, 0), (STEEP, 3)])
def test_photon_noise_scatters_the_side_as_told_and_near_the_bound_of_its_pixels(
    end: tuple[float, float], quarter: int, bright: bool
) -> None:
    """White noise of variance 0.05 grey: as many photons as a sensor counts."""
    start, end = turned(end, quarter)
    edge = Edge(start, end, grey=(20.0, 200.0) if bright else (200.0, 20.0))
    clean, rng, draws = edge.light(), np.random.default_rng(8), 300
    variance = 0.05 * clean
    found, told = [], []
    for _ in range(draws):
        noisy = np.round(16.0 * (clean + rng.normal(size=clean.shape) * np.sqrt(variance))).astype(np.uint16)
        good, middle, own = edge.measure(noisy, 10.0 if bright else 0.1)
        assert good
        found.append(middle)
        told.append(own)
    spread = np.var(found, ddof=1)
    # A mean of the told variances would be that of the few sides which seem to be bent.
    errors = np.array(found) - np.mean(found)
    assert np.mean(errors**2 / np.array(told)) == pytest.approx(1.0, abs=0.3)
    # The bound of the columns' pixels that lie within the window, level and step unknown for each column.
    vertical = quarter % 2 == 0
    image, noise = (clean, variance) if vertical else (clean.T, variance.T)
    ahead, behind = ((i if vertical else i.T) for i in (edge.light(0.01), edge.light(-0.01)))
    (a0, c0), (a1, c1) = sorted((p if vertical else p[::-1]) for p in (start, end))
    inset = inset_px(float(np.hypot(a1 - a0, c1 - c0)), edge.lens.blur_px) / np.hypot(a1 - a0, c1 - c0)
    information = 0.0
    for a in range(round(a0 + inset * (a1 - a0)), round(a1 - inset * (a1 - a0))):
        low = int(np.floor(c0 + (a - a0) * (c1 - c0) / (a1 - a0))) - 5
        window = slice(low, low + 12)
        profile = (image[window, a] - edge.grey[0]) / (edge.grey[1] - edge.grey[0])
        J = np.stack([np.ones(12), profile, (ahead - behind)[window, a] / 0.02], axis=1)
        information += 1.0 / np.linalg.inv(J.T @ (J / noise[window, a][:, None]))[2, 2]
    assert 0.75 < spread * information < 1.45


def test_a_short_side_tells_its_noise_with_little_luck() -> None:
    """Six segments of four strips: 18 degrees of freedom along the side, and 36 in the pixels across it."""
    edge = Edge(end=(120.3, 83.0), size=(180, 120))
    clean, rng = edge.light(), np.random.default_rng(3)
    found, told = [], []
    for _ in range(300):
        noisy = np.round(16.0 * (clean + rng.normal(size=clean.shape) * np.sqrt(0.05 * clean))).astype(np.uint16)
        good, middle, own = edge.measure(noisy, 6.0)
        assert good
        found.append(middle)
        told.append(own)
    level = np.median(told)
    assert np.median(np.abs(told / level - 1.0)) / 0.6745 < np.sqrt(2.0 / 36.0)
    assert np.mean((np.array(found) - np.mean(found)) ** 2) == pytest.approx(level, rel=0.25)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pixels_tell_the_ratio_of_their_noise(dtype: type) -> None:
    edge, rng = Edge(), np.random.default_rng(2)
    clean = edge.light()
    scratch, lens = make_scratch(), edge.lens
    sigma = np.where(clean > 100.0, 4.0, 2.0)
    scale = 1.0 if dtype is np.uint8 else 200.0
    noise = np.zeros(2)
    for _ in range(40):
        image = np.round(scale * (clean + rng.normal(size=clean.shape) * sigma)).astype(dtype)
        fill_templates(lens.step, lens.blur_px, 1.0, 9.0, 0, scratch.templates)
        match_segments(image, lens, edge.start, edge.end, edge.normal, 0.0, 0, 1.0, scratch)
        noise += scratch.templates.noise[0]
    assert noise[1] / noise[0] == pytest.approx(4.0, rel=0.25)


def test_a_hot_row_across_the_strips_moves_the_side_by_less_than_its_sigma() -> None:
    """Along image rows a hot row runs through one strip: a constant, to which the templates are blind."""
    start, end = turned(LEVEL, 1)
    edge, rng = Edge(start, end), np.random.default_rng(5)
    image = np.clip(edge.light() + rng.normal(0.0, 1.5, (300, 320)), 0, 255).astype(np.uint8)
    _, before, variance = edge.measure(image)
    image[150] = 255
    good, after, _ = edge.measure(image)
    assert good and abs(after - before) < np.sqrt(variance)


def test_what_is_no_edge_or_outside_the_image_is_not_found() -> None:
    edge = Edge()
    image = np.full((300, 320), 80, np.uint8)
    assert not edge.measure(image)[0]
    inverse = Edge(grey=(175.0, 30.0))
    assert not edge.measure(np.round(inverse.light()).astype(np.uint8))[0]
    light = np.round(edge.light()).astype(np.uint8)
    assert edge.measure(light)[0]
    for cut in (light[:84], light[78:], light[:, :120], np.ascontiguousarray(light[:, 200:])):
        assert not edge.measure(np.ascontiguousarray(cut))[0]


@pytest.mark.parametrize("quarter", range(4))
def test_at_the_images_rim_nothing_beyond_it_is_read(quarter: int) -> None:
    """The image is the end of a larger one, whose rest is bright: results are those of the image alone."""
    start, end = turned(LEVEL, quarter)
    edge = Edge(start, end)
    light = np.round(edge.light()).astype(np.uint8)
    low, high = np.minimum(start, end).astype(int) - 7, np.maximum(start, end).astype(int) + 8
    shown = light[: high[1], : high[0]]
    whole = np.full((high[1] + 40) * high[0], 255, np.uint8)
    whole[: shown.size] = shown.ravel()
    assert edge.measure(whole[: shown.size].reshape(shown.shape)) == edge.measure(np.ascontiguousarray(shown))
    assert low.min() > 0


@pytest.mark.parametrize(
    ("row", "column"),
    [(-1, 20), (0, -30), (0, 20), (1, -30), (60, -30), (288, 200), (289, 200), (286, 300), (100, 300)],
)
def test_strips_beyond_the_images_rim_are_left_out(row: int, column: int) -> None:
    """The image is the middle of a larger one, whose rest is bright: none of it comes into a strip."""
    whole = np.full(302 * 320, 255, np.uint8)
    image = whole[320:-320].reshape(300, 320)
    image[:] = np.random.default_rng(6).integers(0, 200, image.shape)
    strips, way = make_strips(), Way(True, True, column, 40, 2, 2 * LANES, 12)
    read_strips(image, (0.0, row + 5.3, 0.0, 0.0), way, strips)
    for i in range(40):
        first = column_of(way, i)
        start = strips.start[i]
        if first < 0 or first + 2 > 320 or row < 0 or row + 12 > 300:
            assert start < 0
        else:
            true = image[row : row + 12, first : first + 2].sum(axis=1, dtype=float)
            assert (strips.lines[i, start : start + 12] == true).all()


def test_a_noisy_segment_keeps_its_noise_and_the_others_share_theirs() -> None:
    segments = np.zeros((6, 4))
    segments[:, 2], segments[:, 3] = [1.0, 1.4, 0.6, 1.0, 40.0, 1.0], 0.5
    share_noise(segments, 6)
    assert segments[[0, 1, 2, 3, 5], 2] == pytest.approx(np.full(5, 1.0))
    assert segments[4, 2] == pytest.approx(40.0)


def sixteen_bits(light: FloatArray) -> Any:
    """An image that rounding leaves all but exact."""
    return np.rint(100.0 * light).astype(np.uint16)


def test_a_side_more_askew_than_its_templates_is_not_taken_for_a_shifted_one() -> None:
    edge = Edge(end=STEEPER)
    image = sixteen_bits(edge.light())
    own = edge.measure(image, ratio=6.0)[1]
    for gain in (1.0, 0.96):
        assert abs(edge.measure(image, ratio=6.0, gain=gain)[1] - own) < 5e-4


@pytest.mark.parametrize("outwards", [1.0, -1.0])
def test_light_that_grows_across_a_side_shifts_it_by_what_is_told(outwards: float) -> None:
    edge, grows = Edge(outwards=outwards), 2e-3
    light = edge.light()
    noise = np.random.default_rng(3).normal(0.0, 3.0, light.shape)  # so that the templates cannot see it by themselves
    still = edge.measure(sixteen_bits(light + noise), ratio=5.0)[1]
    image = sixteen_bits(edge.light(grows=grows) + noise)
    assert edge.measure(image, ratio=5.0)[1] - still > 2.0 * grows
    assert abs(edge.measure(image, ratio=5.0, grows=grows)[1] - still) < 0.2 * grows


def test_a_side_far_more_blurred_than_expected_asks_for_blur_and_is_not_taken_for_a_stained_one() -> None:
    edge, sharper = Edge(), 0.5 * BLUR_PX
    lens = edge.lens._replace(blur_px=float(np.sqrt(sharper**2 + 1.0 / 12.0)), step=table_of(sharper))
    scratch = make_scratch()
    scratch.templates.noise[0] = 1.0, 5.0
    fill_templates(lens.step, lens.blur_px, 1.0, 9.0, 0, scratch.templates)
    side = edge.start, edge.end, edge.normal
    told = match_segments(sixteen_bits(edge.light()), lens, *side, 0.0, 0, 1.0, scratch)
    assert told.found == told.pieces
    assert scratch.pooled[BLUR, RIGHT] / scratch.pooled[BLUR, OWN] > UNSETTLED_PX


def test_light_laid_over_a_side_is_taken_off_it() -> None:
    edge = Edge()
    light = edge.light()
    across = np.arange(light.shape[0])[:, None] - 0.5 * light.shape[0]
    shifts = []
    for laid_over in (0.0, 0.002 * across**2):
        good, shift, variance = edge.measure(sixteen_bits(light + laid_over), ratio=5.0)
        assert good
        shifts.append((shift, variance))
    (plain, _), (stained, variance) = shifts
    assert abs(stained - plain) < 3.0 * np.sqrt(variance)


def test_a_line_cut_off_at_full_scale_tells_nothing_of_the_blur() -> None:
    whole, cut = (Edge(grey=(30.0, line)) for line in (200.0, 320.0))
    for edge, told in ((whole, True), (cut, False)):
        image, scratch = eight_bits(edge.light()), make_scratch()
        scratch.full[0] = 255
        edge.match(image, scratch=scratch)
        assert (scratch.pooled[BLUR, OWN] > 0.0) == told
        scratch.pooled[:] = 0.0
        fit_segments(
            image, edge.lens, edge.start, edge.end, edge.normal, (4.0, 4.0), (0.0, 0.0), 0.0, 0, 1.0, 1, scratch
        )
        assert (scratch.pooled[BLUR, OWN] > 0.0) == told


def test_a_finger_beside_a_side_leaves_it_as_unsure_as_it_is_off() -> None:
    """It lies beside all segments alike, so that their number makes nothing surer."""
    edge, rng = Edge(), np.random.default_rng(3)
    middle = np.stack(np.meshgrid(np.arange(320.0), np.arange(300.0)), axis=-1).reshape(-1, 2)
    finger = 40.0 * np.exp(-0.5 * ((edge._far(middle) + 3.3) / 0.7) ** 2).reshape(300, 320)
    noise = rng.normal(size=finger.shape)
    _, clean = edge.match(eight_bits(edge.light() + noise))
    (good, _, off, _, variance, _), side = edge.match(eight_bits(edge.light() + finger + noise))
    assert good and clean.alike_px2 == 0.0
    assert abs(off) > 5.0 * np.sqrt(variance)
    assert abs(off) < 4.0 * np.sqrt(variance + side.alike_px2)


def eight_bits(light: FloatArray) -> Any:
    """Rounded to 8 bits, in memory as a camera leaves it."""
    return as_frame(np.clip(np.rint(light), 0.0, 255.0).astype(np.uint8))
