"""Edges, sides and cells against numerical integration, noise drawn anew, the Cramer-Rao bound and a brute renderer."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from fsw.vision.blur import STEP_PER_PX, STEP_REACH_PX, STEP_ROWS, tabulate_step
from fsw.vision.corners import Cells, make_cells
from fsw.vision.edges import (
    BIN_PX,
    BINS,
    BLUR,
    CROSS,
    OWN,
    RIGHT,
    WIDTH,
    Scratch,
    gather,
    make_scratch,
    solve,
)
from fsw.vision.hot import shown_full_scale
from fsw.vision.profile import EdgeFit, fit_profile
from fsw.vision.quads import measure_cells
from fsw.vision.rig import Eyes, StereoRig, eyes_of
from fsw.vision.sides import Lens
from fsw.vision.standing_in import forget_size
from hal.frame import as_frame

FloatArray = np.ndarray[Any, np.dtype[np.float64]]

PIXEL_VARIANCE = 1.0 / 12.0
QUIET = np.array([PIXEL_VARIANCE, 0.0])  # noise of rounding alone
NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)


def seen_step(x: FloatArray, blur_px: float) -> FloatArray:
    """A unit step at 0 blurred by the lens, averaged over a pixel at x: by numerical integration."""
    return np.sum(ndtr((x[..., None] + 0.5 * NODES) / blur_px) * 0.5 * WEIGHTS, axis=-1)


def eyes(shape: tuple[int, ...]) -> Eyes:
    """Two eyes without distortion, of images of this shape (height, width); what they see in space does not matter."""
    size, intrinsics = np.tile(shape[::-1], (2, 1)), np.tile([1000.0, 1000.0, 100.0, 80.0], (2, 1))
    return eyes_of(StereoRig(size, intrinsics, np.zeros((2, 5)), np.stack([np.eye(3)] * 2), np.zeros((2, 3))))


def told_size() -> FloatArray:
    """Size of the cells before any was measured."""
    size = np.zeros((2, 2))
    forget_size(size)
    return size


def table_of(blur_px: float) -> FloatArray:
    table = np.zeros((STEP_ROWS, 3))
    tabulate_step(blur_px, table)
    return table


@pytest.mark.parametrize("blur_px", [0.3, 0.7, 2.0, 4.0])
def test_the_table_is_the_integral_of_a_blurred_step_over_a_pixel(blur_px: float) -> None:
    x = np.arange(STEP_ROWS) / STEP_PER_PX - STEP_REACH_PX
    value, slope, change = table_of(blur_px).T
    h = 1e-4
    assert value == pytest.approx(seen_step(x, blur_px), abs=1e-9)
    assert value[0] < 1e-4 and value[-1] > 1.0 - 1e-4  # nothing of it is cut off
    assert slope == pytest.approx((seen_step(x + h, blur_px) - seen_step(x - h, blur_px)) / (2 * h), abs=1e-6)
    assert change == pytest.approx((seen_step(x, blur_px + h) - seen_step(x, blur_px - h)) / (2 * h), abs=1e-6)


@settings(deadline=None)  # the first call compiles
@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_solve_agrees_with_numpy_and_refuses_what_is_not_definite(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n)) + 3.0 * np.eye(n)
    A, b = root @ root.T, rng.normal(size=n)
    lower, x = np.tril(A), b.copy()
    assert solve(lower, x, n)
    assert x == pytest.approx(np.linalg.solve(A, b), rel=1e-6, abs=1e-9)
    assert not solve(np.tril(-A), b.copy(), n)
    A[-1], A[:, -1] = 0.0, 0.0
    assert not solve(np.tril(A), b.copy(), n)


@dataclass(frozen=True)
class Profile:
    """Columns of pixels across an edge at offset_px: cell | line (| next cell), seen with this blur."""

    offset_px: float = 0.1
    width_px: float = 3.0  # 0: a step, no next cell
    blur_px: float = 0.7
    slope: float = 0.13  # of the edge against the rows
    grey: tuple[float, float, float] = (40.0, 180.0, 46.0)
    columns: int = 14

    @property
    def reach_px(self) -> tuple[float, float]:
        reach = 4.0 * self.whole_px + 2.0
        return reach, (self.width_px + reach if self.width_px else reach)

    @property
    def whole_px(self) -> float:
        return float(np.sqrt(self.blur_px**2 + PIXEL_VARIANCE))

    def places(self) -> FloatArray:
        """Distances of all pixels in the window from the expected edge."""
        inner, outer = self.reach_px
        row = np.arange(-40, 41.0)[None, :]
        distance = (row - self.slope * np.arange(self.columns)[:, None]) / np.hypot(1.0, self.slope)
        return distance[(distance > -inner) & (distance < outer)]

    def values(self, x: FloatArray, parameters: FloatArray | None = None) -> FloatArray:
        """Grey values at distances x; parameters: cell, line, (next cell,) offset."""
        default = np.array([*self.grey[: 3 if self.width_px else 2], self.offset_px])
        *grey, offset = default if parameters is None else parameters
        first = seen_step(x - offset, self.blur_px)
        if not self.width_px:
            return grey[0] * (1.0 - first) + grey[1] * first
        second = seen_step(x - offset - self.width_px, self.blur_px)
        return grey[0] * (1.0 - first) + grey[1] * (first - second) + grey[2] * second

    def bound_px2(self, noise: float) -> float:
        """Cramer-Rao bound of the offset's variance for white noise, with all grey values unknown too."""
        x = self.places()
        at = np.array([*self.grey[: 3 if self.width_px else 2], self.offset_px])
        h = 1e-4
        J = np.stack([(self.values(x, at + h * e) - self.values(x, at - h * e)) / (2 * h) for e in np.eye(len(at))])
        return float(np.linalg.inv(J @ J.T / noise**2)[-1, -1])

    def fit(self, scratch: Scratch, step: FloatArray, values: FloatArray) -> EdgeFit:
        """Sort the pixels into bins, and fit."""
        x = self.places()
        place = ((x + self.reach_px[0]) / BIN_PX).astype(int)
        assert place.max() < BINS
        for sums, weights in (
            (scratch.total, values),
            (scratch.place, x),
            (scratch.square, x * x),
            (scratch.number, np.ones_like(x)),
        ):
            sums[:] = np.bincount(place, weights, BINS)
        return fit_profile(scratch, step, QUIET, self.width_px, self.whole_px, True)


def test_an_edge_is_found_without_bias() -> None:
    rng, errors = np.random.default_rng(11), []
    for _ in range(600):
        blur_px = rng.uniform(0.3, 2.0)
        width_px = rng.choice([0.0, max(1.5, 1.2 * blur_px), 3.0, 5.0, 9.0])
        grey = [(40.0, 180.0, 46.0), (900.0, 30000.0, 700.0), (200.0, 60.0, 190.0)][rng.integers(3)]
        profile = Profile(rng.uniform(-0.9, 0.9), width_px, blur_px, rng.uniform(0.02, 0.6), grey)
        fit = profile.fit(make_scratch(), table_of(blur_px), profile.values(profile.places()))
        assert fit.good
        assert (fit.inside, fit.line) == pytest.approx(grey[:2], abs=0.03 * abs(grey[1] - grey[0]))
        errors.append(abs(fit.offset_px - profile.offset_px))
    # The largest stand at slopes such as 1/2, where few columns repeat the same distances.
    assert np.median(errors) < 0.0005 and np.percentile(errors, 95) < 0.0025 and max(errors) < 0.012


@pytest.mark.parametrize("width_px", [0.0, 2.0, 6.0])
@pytest.mark.parametrize("blur_px", [0.4, 0.7, 1.5])
def test_its_variance_is_honest_and_near_the_cramer_rao_bound(width_px: float, blur_px: float) -> None:
    profile, noise, draws = Profile(width_px=width_px, blur_px=blur_px), 6.0, 500
    rng, scratch, step = np.random.default_rng(7), make_scratch(), table_of(blur_px)
    clean = profile.values(profile.places())
    fits = [profile.fit(scratch, step, clean + rng.normal(0.0, noise, len(clean))) for _ in range(draws)]
    assert all(fit.good for fit in fits)
    spread = np.var([fit.offset_px for fit in fits])
    assert 0.8 < np.mean([fit.variance_px2 for fit in fits]) / spread < 1.25
    assert 0.8 < spread / profile.bound_px2(noise) < 1.3


@pytest.mark.parametrize(("blur_px", "width_px"), [(0.8, 3.0), (0.7, 2.85), (0.76, 3.06), (0.74, 2.0)])
def test_blur_and_width_are_corrected_together_whatever_the_edges_own_unknowns_do(
    blur_px: float, width_px: float
) -> None:
    """Told 0.7 px and 3 px (2 px), the pooled step leads to the true ones, up to its square."""
    told = 3.0 if width_px > 2.5 else 2.0
    seen, scratch = Profile(width_px=width_px, blur_px=blur_px), make_scratch()
    guess = Profile(width_px=told, blur_px=0.7)
    fit = guess.fit(scratch, table_of(0.7), seen.values(guess.places()))
    fresh = scratch.fresh
    matrix = np.array([[fresh[BLUR, OWN], fresh[WIDTH, CROSS]], [fresh[WIDTH, CROSS], fresh[WIDTH, OWN]]])
    by_blur, by_width = np.linalg.solve(matrix, fresh[[BLUR, WIDTH], RIGHT])
    true = np.array([blur_px - 0.7, width_px / told - 1.0])
    assert np.abs([by_blur, by_width] - true).max() < 0.003 + 0.25 * np.abs(true).max()
    moved = fit.offset_px + fit.blur_pull * by_blur + fit.width_pull_px * by_width
    assert abs(moved - seen.offset_px) < 0.003 + 0.1 * np.abs(true).max()


def test_what_is_no_edge_is_not_fitted() -> None:
    profile = Profile(width_px=0.0)
    x = profile.places()
    assert not profile.fit(make_scratch(), table_of(0.7), np.full_like(x, 80.0)).good
    far = Profile(offset_px=5.0, width_px=0.0)
    assert not far.fit(make_scratch(), table_of(0.7), far.values(x)).good
    empty = make_scratch()
    assert not fit_profile(empty, table_of(0.7), QUIET, 0.0, 0.76, True).good


def test_pixels_are_gathered_whole_and_only_those_in_the_image() -> None:
    image = np.arange(40 * 30, dtype=np.uint16).reshape(40, 30)
    scratch = make_scratch()
    assert gather(image, ((5.0, 20.0), (14.0, 20.0)), 1.0, True, (3.0, 4.0), 1, True, scratch) == (True, False)
    columns, rows = np.arange(5, 15), np.arange(17, 25)
    assert scratch.number.sum() == len(columns) * len(rows)
    assert scratch.total.sum() == image[np.ix_(rows, columns)].sum()
    assert scratch.place.sum() == pytest.approx(len(columns) * (rows - 20).sum())
    assert gather(image, ((5.0, 38.0), (14.0, 38.0)), 1.0, True, (3.0, 4.0), 1, True, scratch) == (False, False)
    assert scratch.number.sum() == len(columns) * 5  # rows 35 to 39
    assert gather(image, ((-90.0, 20.0), (-80.0, 20.0)), 1.0, True, (3.0, 4.0), 1, True, scratch) == (False, False)
    assert scratch.number.sum() == 0
    image[17:25, 5] = 65535
    assert gather(image, ((5.0, 20.0), (14.0, 20.0)), 1.0, True, (3.0, 4.0), 1, True, scratch) == (True, True)


_SEEN: dict[Any, np.ndarray[Any, Any]] = {}  # drawings that several tests look at


@dataclass(frozen=True)
class Sheet:
    """3 x 3 cells with lines between them and a border round them, seen by one eye through a plane's homography."""

    H: FloatArray  # sheet (mm) -> image pixels
    cell_mm: tuple[float, float] = (40.0, 20.0)
    pitch_mm: tuple[float, float] = (42.0, 22.0)
    border_mm: float = 6.0
    blur_px: float = 0.7
    size: tuple[int, int] = (260, 190)
    covered_mm: tuple[tuple[float, float, float, float], ...] = ()  # x0, x1, y0, y1: as dark as a cell
    bend: float = 0.0  # by which the scale along X grows per mm, as on a sheet that is bent and seen askew

    def lit(self, X: FloatArray, Y: FloatArray) -> FloatArray:
        """1 on lines and border, 0 on cells and beside the sheet."""
        x, y = (A - p * np.clip(np.floor(A / p), 0, 2) for A, p in zip((X, Y), self.pitch_mm, strict=True))
        on = (x > 0) & (x < self.cell_mm[0]) & (y > 0) & (y < self.cell_mm[1])
        for x0, x1, y0, y1 in self.covered_mm:
            on |= (x0 < X) & (x1 > X) & (y0 < Y) & (y1 > Y)
        end = [2 * p + c + self.border_mm for p, c in zip(self.pitch_mm, self.cell_mm, strict=True)]
        inside = (-self.border_mm < X) & (end[0] > X) & (-self.border_mm < Y) & (end[1] > Y)
        return (inside & ~on).astype(np.float32)

    def draw(self, dtype: type = np.uint8, dark: bool = True, over: int = 12) -> np.ndarray[Any, Any]:
        """Grey values, from 30 to 180 where the type is uint8."""
        key = (over, self.H.tobytes(), *(value for name, value in vars(self).items() if name != "H"))
        if key not in _SEEN:
            _SEEN[key] = self._seen(over)
        seen = _SEEN[key]
        grey = np.clip(30.0 + 150.0 * (seen if dark else 1.0 - seen), 0.0, 255.0)
        return np.round(grey * (1.0 if dtype is np.uint8 else 200.0)).astype(dtype)

    def _seen(self, over: int) -> np.ndarray[Any, Any]:
        """How much of each pixel is lit, by brute force: over x over samples a pixel, blurred as finely."""
        width, height = self.size
        u = (np.arange(width * over) + 0.5) / over - 0.5
        v = (np.arange(height * over) + 0.5) / over - 0.5
        G = np.linalg.inv(self.H)
        w = G[2, 0] * u + G[2, 1] * v[:, None] + G[2, 2]
        X, Y = ((G[i, 0] * u + G[i, 1] * v[:, None] + G[i, 2]) / w for i in (0, 1))
        X = X + 0.5 * self.bend * (X - 62.0) ** 2
        sigma = self.blur_px * over
        seen = cv2.GaussianBlur(self.lit(X, Y), (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return cv2.resize(seen, self.size, interpolation=cv2.INTER_AREA)

    def corners_px(self) -> FloatArray:
        """(9, 4, 2), column by column."""
        offsets = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * self.cell_mm
        flat = np.array([np.array(self.pitch_mm) * (i, j) + offsets for i in range(3) for j in range(3)])
        if self.bend:
            flat[..., 0] = 62.0 + (np.sqrt(1.0 + 2.0 * self.bend * (flat[..., 0] - 62.0)) - 1.0) / self.bend
        return cv2.perspectiveTransform(flat.reshape(1, -1, 2), self.H).reshape(9, 4, 2)

    def depths(self) -> FloatArray:
        """Of the corners (9, 4)."""
        return 1.0 / (np.concatenate([self.corners_px(), np.ones((9, 4, 1))], axis=2) @ np.linalg.inv(self.H)[2])

    def centres_px(self) -> FloatArray:
        flat = [np.array(self.pitch_mm) * (i, j) + 0.5 * np.array(self.cell_mm) for i in range(3) for j in range(3)]
        return cv2.perspectiveTransform(np.array(flat).reshape(1, -1, 2), self.H)[0]

    def measure(
        self,
        image: np.ndarray[Any, Any],
        expected: FloatArray,
        dark: bool = True,
        wanted: Any = True,
        noise: FloatArray = QUIET,
    ) -> Cells:
        cells, scratch = make_cells(9), make_scratch()
        scratch.full[0] = shown_full_scale(image)
        whole = float(np.sqrt(self.blur_px**2 + PIXEL_VARIANCE))
        seen = eyes(image.shape)
        lens = Lens(seen.intrinsics[0], seen.distortion[0], whole, table_of(self.blur_px), noise)
        ratio = np.array([(p - c) / c for p, c in zip(self.pitch_mm, self.cell_mm, strict=True)])
        beside = [((i, j - 1), (i + 1, j), (i, j + 1), (i - 1, j)) for i in range(3) for j in range(3)]
        neighbour = np.array([[3 * i + j if {i, j} <= {0, 1, 2} else -1 for i, j in four] for four in beside])
        measure_cells(
            as_frame(image), seen, 0, (lens, lens), np.ascontiguousarray(expected), np.zeros((9, 4, 2)), self.depths(),
            np.broadcast_to(wanted, 9).copy(), np.arange(9), np.tile(ratio[[1, 0, 1, 0]], (9, 1)), neighbour,
            np.ones(2), told_size(), dark, 1, scratch, cells,
        )  # fmt: skip
        return cells


LEVEL = np.array([[1.5, 0.06, 22.3], [-0.05, 1.6, 26.4], [0.0, 0.0, 1.0]])
TILTED = np.array([[1.55, 0.35, 18.3], [-0.2, 1.7, 44.4], [2e-4, 1.5e-4, 1.0]])
STEEP = np.array([[1.65, 0.35, 18.3], [-0.25, 1.9, 50.4], [7e-4, 5e-4, 1.0]])  # 3 % of scale across a cell
UPSIDE_DOWN = np.array([[-1.5, 0.06, 215.0], [-0.05, -1.6, 140.0], [0.0, 0.0, 1.0]])
COARSE = np.array([[2.1, 0.06, 32.3], [-0.02, 2.5, 30.6], [0.0, 0.0, 1.0]])
MIRRORED = np.array([[-1.5, 0.06, 212.0], [0.05, 1.6, 20.0], [0.0, 0.0, 1.0]])
MIDDLE = 4


@pytest.mark.parametrize(
    ("H", "limit_px"),
    [
        pytest.param(LEVEL, 0.01, id="level"),
        pytest.param(UPSIDE_DOWN, 0.01, id="turned"),
        pytest.param(MIRRORED, 0.01, id="mirrored"),
        pytest.param(TILTED, 0.01, id="tilted"),
        pytest.param(STEEP, 0.01, id="steep"),
    ],
)
@pytest.mark.parametrize("blur_px", [0.5, 1.0])
def test_all_corners_are_measured_to_a_hundredth_of_a_pixel(H: FloatArray, limit_px: float, blur_px: float) -> None:
    sheet = Sheet(H, blur_px=blur_px)
    truth = sheet.corners_px()
    cells = sheet.measure(sheet.draw(), truth + np.array([0.4, -0.3]))
    assert cells.found.all() and cells.whole.all()
    assert np.abs(cells.corners_px - truth).max() < limit_px
    assert np.abs(cells.centre_px - sheet.centres_px()).max() < limit_px


def test_what_lies_beyond_a_border_does_not_bleed_into_its_side() -> None:
    wide: dict[str, Any] = {"pitch_mm": (46.0, 26.0), "border_mm": 12.0, "blur_px": 2.5, "size": (300, 230)}
    hinge = (2 * 46.0 + 40.0 + 8.0, 200.0, -50.0, 200.0)
    plain, covered = Sheet(LEVEL, **wide), Sheet(LEVEL, **wide, covered_mm=(hinge,))
    truth, beside = plain.corners_px(), slice(6, 9)
    still, moved = (sheet.measure(sheet.draw(), truth).corners_px[beside] for sheet in (plain, covered))
    assert np.abs(moved - still).max() < 0.05  # it was 0.2 where the fit went on to as far as a line is wide
    assert np.abs(moved - truth[beside]).max() < 0.05


def test_a_cell_expected_one_per_cent_too_large_is_measured_the_same() -> None:
    """The width of the lines beside it is expected as much too large, and must not pull the sides."""
    sheet = Sheet(LEVEL)
    truth, image = sheet.corners_px(), sheet.draw(np.uint16)
    centre = truth[MIDDLE].mean(axis=0)
    right, large = (sheet.measure(image, centre + scale * (truth - centre)).corners_px for scale in (1.0, 1.01))
    assert np.abs((large - right)[MIDDLE]).max() < 0.002


@pytest.mark.parametrize("bend", [5e-4, -5e-4])
def test_lines_beside_a_bent_cell_are_as_wide_as_where_the_next_cell_begins(bend: float) -> None:
    """Seen askew, the cell's own scale is right in its middle: the one line is wider, the other one narrower."""
    sheet = Sheet(LEVEL, bend=bend)
    truth = sheet.corners_px()
    cells = sheet.measure(sheet.draw(np.uint16), truth)
    assert cells.whole.all()
    assert np.abs(cells.corners_px - truth)[MIDDLE].max() < 0.003


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("dark", [True, False])
def test_bright_cells_and_sixteen_bits_measure_the_same(dtype: type, dark: bool) -> None:
    sheet = Sheet(TILTED)
    cells = sheet.measure(sheet.draw(dtype, dark), sheet.corners_px() + 0.3, dark)
    assert cells.whole.all()
    assert np.abs(cells.centre_px - sheet.centres_px()).max() < 0.02
    assert cells.contrast == pytest.approx(np.full(9, 150.0 if dtype is np.uint8 else 30000.0), rel=0.05)
    assert not sheet.measure(sheet.draw(dtype, dark), sheet.corners_px(), not dark).found.any()


def hide(sides: tuple[int, ...]) -> tuple[tuple[float, float, float, float], ...]:
    """Covers over the lines along these sides of the middle cell."""
    x0, y0, x1, y1 = 42.0, 22.0, 82.0, 42.0
    every = ((x0, x1, y0 - 2, y0), (x1, x1 + 2, y0, y1), (x0, x1, y1, y1 + 2), (x0 - 2, x0, y0, y1))
    return tuple(every[side] for side in sides)


@pytest.mark.parametrize("side", range(4))
def test_one_hidden_side_is_put_where_the_cells_size_says_with_a_wider_variance(side: int) -> None:
    plain, sheet = Sheet(TILTED), Sheet(TILTED, covered_mm=hide((side,)))
    shift = np.array([0.35, -0.25])
    whole = plain.measure(plain.draw(), plain.corners_px() + shift)
    cells = sheet.measure(sheet.draw(), sheet.corners_px() + shift)
    assert cells.found[MIDDLE] and not cells.whole[MIDDLE]
    error = np.abs(cells.corners_px[MIDDLE] - sheet.corners_px()[MIDDLE])
    assert error.max() < 0.03
    opened = cells.covariance_px2[MIDDLE, [0, 2]] / whole.covariance_px2[MIDDLE, [0, 2]]
    across = 1 if side % 2 == 0 else 0  # image rows for sides along X
    assert opened[across] > 1.5
    away = [n for n in range(9) if n not in (1, 3, 4, 5, 7)]
    assert cells.whole[away].all()


@pytest.mark.parametrize("sides", [(0, 2), (1, 3), (0, 1), (0, 1, 2, 3)])
def test_a_cell_with_two_hidden_sides_is_not_found(sides: tuple[int, ...]) -> None:
    sheet = Sheet(TILTED, covered_mm=hide(sides))
    cells = sheet.measure(sheet.draw(), sheet.corners_px())
    assert not cells.found[MIDDLE] and not cells.whole[MIDDLE]
    assert np.isnan(cells.centre_px[MIDDLE]).all() and np.isnan(cells.covariance_px2[MIDDLE]).all()


@pytest.mark.parametrize(("hidden", "found"), [((), True), ((1,), False), ((2,), False)])
def test_half_a_side_is_believed_only_where_nothing_covers_another(hidden: tuple[int, ...], found: bool) -> None:
    half = (66.0, 82.0, 20.0, 22.0)
    sheet = Sheet(TILTED, covered_mm=(half, *hide(hidden)))
    cells = sheet.measure(sheet.draw(), sheet.corners_px())
    assert cells.found[MIDDLE] == cells.whole[MIDDLE] == found
    assert cells.paired[MIDDLE].tolist() == [found, found]
    if found:
        assert np.abs(cells.corners_px - sheet.corners_px())[MIDDLE].max() < 0.05


@pytest.mark.parametrize("shift", [(-60.0, 0.0), (0.0, -45.0), (150.0, 0.0), (0.0, 95.0), (900.0, -900.0)])
def test_cells_at_and_beyond_the_rim_are_right_or_not_found(shift: tuple[float, float]) -> None:
    move = np.eye(3)
    move[:2, 2] = shift
    sheet = Sheet(move @ LEVEL)
    truth = sheet.corners_px()
    centre, rim = sheet.centres_px(), np.array(sheet.size) - 1.0
    wanted = ((centre >= 0.0) & (centre <= rim)).all(axis=1)
    cells = sheet.measure(sheet.draw(over=6), truth + 0.2, wanted=wanted)
    inside = ((truth > 4.0) & (truth < np.array(sheet.size) - 5.0)).all(axis=(1, 2))
    assert cells.found[inside].all() and not cells.found[~wanted].any()
    found = cells.found
    assert not found.any() or np.abs(cells.centre_px - sheet.centres_px())[found].max() < 0.05
    assert np.isnan(cells.corners_px[~found]).all()


@pytest.mark.parametrize("hot", [(82,), (83,), (84,), (85, 86), (88,), (90,)])
def test_hot_rows_along_a_side_do_not_pull_it(hot: tuple[int, ...]) -> None:
    """The middle cell's upper side rises from row 84 to row 83, its line is 5 px wide; rows 86 to 90 cross others."""
    sheet = Sheet(COARSE, size=(330, 220))
    truth, image = sheet.corners_px(), sheet.draw()
    image[list(hot)] = 255
    cells = sheet.measure(image, truth + 0.2)
    assert cells.whole[MIDDLE]
    assert np.abs(cells.corners_px - truth)[MIDDLE].max() < 0.02


def test_a_line_that_is_saturated_all_over_is_not_taken_for_hot_rows() -> None:
    sheet = Sheet(LEVEL)
    image = np.clip(1.6 * sheet.draw(np.uint16) / 200.0, 0.0, 255.0).astype(np.uint8)
    assert (image == 255).mean() > 0.05
    cells = sheet.measure(image, sheet.corners_px() + 0.2)
    assert cells.whole.all()
    assert np.abs(cells.centre_px - sheet.centres_px())[MIDDLE].max() < 0.02


@pytest.mark.parametrize("beyond_px", [1.5, 2.0, 2.5, 3.0, 4.0])
def test_a_side_whose_line_the_rim_cuts_is_not_pulled(beyond_px: float) -> None:
    sheet = Sheet(LEVEL)
    truth, image = sheet.corners_px(), sheet.draw(np.uint16)
    rim = int(np.ceil(truth[MIDDLE, 1:3, 0].max() + beyond_px))
    wanted = np.arange(9) < 6
    cells = sheet.measure(image[:, :rim], truth, wanted=wanted)
    assert cells.whole[MIDDLE]
    assert np.abs(cells.centre_px - sheet.centres_px())[MIDDLE].max() < 0.01


def test_only_wanted_cells_are_measured_and_results_do_not_linger() -> None:
    sheet = Sheet(LEVEL)
    image, expected = sheet.draw(over=6), sheet.corners_px()
    wanted = np.arange(9) % 2 == 0
    assert sheet.measure(image, expected, wanted=wanted).found.tolist() == wanted.tolist()


@pytest.fixture(scope="module")
def scatter() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean of the corners and crossing of the diagonals (draws, 9, 2), and what is told of them (9, 3), under noise."""
    sheet, rng = Sheet(LEVEL), np.random.default_rng(5)
    clean, expected = sheet.draw(np.uint16).astype(float), sheet.corners_px()
    means, centres, told = [], [], []
    for _ in range(120):
        noisy = np.clip(clean + rng.normal(0.0, 600.0, clean.shape), 0, 65535).astype(np.uint16)
        cells = sheet.measure(noisy, expected, noise=np.array([600.0**2, 0.0]))
        means.append(cells.corners_px.mean(axis=1))
        centres.append(cells.centre_px)
        told.append(cells.covariance_px2)
    return np.array(means), np.array(centres), np.mean(told, axis=0)


def test_the_covariance_tells_the_scatter_of_the_corners_mean(
    scatter: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    means, _, told = scatter
    ratio = told[:, [0, 2]].mean(axis=0) / means.var(axis=0, ddof=1).mean(axis=0)
    # The floor for lens and model, which no noise shows, stands on top.
    assert ((ratio > 0.8) & (ratio < 2.0)).all(), ratio


def test_the_covariance_tells_the_scatter_of_the_centre(
    scatter: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    _, centres, told = scatter
    ratio = told[:, [0, 2]].mean(axis=0) / centres.var(axis=0, ddof=1).mean(axis=0)
    assert ((ratio > 0.8) & (ratio < 2.0)).all(), ratio
