"""What rounded grey values and changing light feign: against exact means of rounded noise, and edges drawn anew."""

import numpy as np
import pytest
from scipy.special import ndtr
from test_vision_edges import COARSE, Profile, Sheet, make_scratch, table_of
from test_vision_strips import LEVEL, STEEP, Edge, sixteen_bits

from fsw.vision.edges import Quad, make_quad
from fsw.vision.light import COARSE as COARSE_VARIANCE
from fsw.vision.light import ROUNDED_FITTED, ROUNDED_MATCHED, STEEPER, add_rounding, correct_light, rounding
from fsw.vision.matched import match_segments
from fsw.vision.settling import LEAST_NOISE, learn_noise
from fsw.vision.templates import fill_templates

ROUNDED = 1.0 / 12.0


def mean_of_rounded(level: np.ndarray, sigma: float) -> np.ndarray:
    """Mean of a normal variable, rounded: exactly, from the probability of each whole number."""
    whole = np.arange(-2, 24)[:, None]
    share = ndtr((whole + 0.5 - level) / sigma) - ndtr((whole - 0.5 - level) / sigma)
    return np.asarray((whole * share).sum(axis=0))


@pytest.mark.parametrize("sigma", [1e-3, 0.1, 0.2, 0.3, 0.5])
def test_rounding_shifts_means_by_no_more_than_is_told(sigma: float) -> None:
    level = 4.0 + (np.arange(1000) + 0.5) / 1000
    true = (mean_of_rounded(level, sigma) - level).std()
    told = rounding(np.array([ROUNDED + sigma**2, 0.0]), 4.0)
    assert true <= told * 1.0001 <= 1.35 * true + 1e-9


def test_shot_noise_dithers_and_beyond_half_a_grey_value_nothing_is_told() -> None:
    noise = np.array([ROUNDED + 0.01, 0.02])
    assert rounding(noise, -3.0) == rounding(noise, 0.0) > rounding(noise, 5.0) > 0.0
    assert rounding(noise, 1.01 * COARSE_VARIANCE / 0.02) == 0.0
    assert rounding(np.array([ROUNDED + COARSE_VARIANCE, 0.0]), 0.0) < np.sqrt(ROUNDED) / 19000


@pytest.mark.parametrize("hot", [0.0, 0.001])
def test_matched_sides_tell_the_eyes_noise(hot: float) -> None:
    """Of cells and lines, light and dark ones; some pixels are hot."""
    rng, noise, told = np.random.default_rng(2), np.array([LEAST_NOISE, 0.0]), np.array([900.0, 12.0])
    edges = [Edge(end=end, grey=grey) for end in (LEVEL, STEEP) for grey in ((3.0, 20.0), (30.0, 175.0))]
    for _ in range(10):
        scratch = make_scratch()
        for edge in edges * 8:
            light = 100.0 * edge.light()
            image = rng.normal(light, np.sqrt(told[0] + told[1] * light))
            image[rng.random(image.shape) < hot] = 60000.0
            scratch.templates.noise[0] = 1.0, 1.0
            fill_templates(edge.lens.step, edge.lens.blur_px, 1.0, 9.0, 0, scratch.templates)
            lens = edge.lens._replace(noise=noise)
            match_segments(
                np.rint(image.clip(0)).astype(np.uint16), lens, edge.start, edge.end, edge.normal, 0.0, 0, 1.0, scratch
            )
        learn_noise(scratch.pooled, noise)
    for grey in (300.0, 17500.0):
        assert noise[0] + noise[1] * grey == pytest.approx(told[0] + told[1] * grey, rel=0.25)


@pytest.mark.parametrize("blur_px", [0.4, 0.6, 1.0, 1.6])
@pytest.mark.parametrize("ratio", [1.0, 4.0])
def test_a_cell_that_reads_brighter_shifts_a_matched_side_by_what_is_told(ratio: float, blur_px: float) -> None:
    edge, sigma = Edge(grey=(2.25, 16.5), blur_px=blur_px), 0.2
    light = edge.light()
    rounded = mean_of_rounded(light.reshape(-1), sigma).reshape(light.shape)
    (_, _, plain, *_), _ = edge.match(sixteen_bits(light), ratio, room_px=12.0)
    (_, _, moved, *_), _ = edge.match(sixteen_bits(rounded), ratio, room_px=12.0)
    reads = mean_of_rounded(np.array([2.25]), sigma)[0] - 2.25
    told = ROUNDED_MATCHED * edge.lens.blur_px * reads / 14.25
    assert moved - plain == pytest.approx(told, rel=0.25)


@pytest.mark.parametrize("width_px", [3.0, 5.0])
@pytest.mark.parametrize("blur_px", [0.4, 0.7, 1.0])
def test_and_a_fitted_edge(width_px: float, blur_px: float) -> None:
    edge, sigma = Profile(width_px=width_px, columns=60, grey=(2.25, 16.5, 4.0), blur_px=blur_px), 0.2
    light, scratch, step = edge.values(edge.places()), make_scratch(), table_of(edge.blur_px)
    plain = edge.fit(scratch, step, light).offset_px
    moved = edge.fit(scratch, step, mean_of_rounded(light, sigma)).offset_px
    reads = mean_of_rounded(np.array([2.25]), sigma)[0] - 2.25
    assert moved - plain == pytest.approx(ROUNDED_FITTED * edge.whole_px * reads / 14.25, rel=0.25)


def test_light_laid_over_shifts_a_matched_side_by_what_is_told() -> None:
    edge, grows = Edge(), 0.05
    light = edge.light()
    noise = np.random.default_rng(3).normal(0.0, 3.0, light.shape)  # so that the templates cannot see it by themselves
    far = edge._far(np.stack(np.meshgrid(*(np.arange(float(n)) for n in edge.size)), axis=-1).reshape(-1, 2))
    (_, _, plain, *_), side = edge.match(sixteen_bits(light + noise), ratio=5.0)
    laid_over = light + noise + grows * far.reshape(light.shape) + 10.0
    (_, _, moved, *_), _ = edge.match(sixteen_bits(laid_over), ratio=5.0)
    assert moved - plain == pytest.approx(100.0 * grows * side.by_added, rel=0.1)


def square(level: list[float], bright: list[float], by_added: float = 0.0) -> Quad:
    """A cell of 100 by 100 px, sides known to 1 mpx."""
    quad = make_quad()
    quad.nx[:], quad.ny[:] = [0.0, 1.0, 0.0, -1.0], [-1.0, 0.0, 1.0, 0.0]
    quad.length[:] = quad.extent[:] = 100.0
    quad.variance[:], quad.level[:], quad.bright[:], quad.by_added[:] = 1e-6, level, bright, by_added
    return quad


def test_sides_between_which_only_the_cell_grows_brighter_are_widened() -> None:
    quad = square([50.0, 26.0, 20.0, 26.0], [140.0] * 4, by_added=0.01)
    correct_light(quad, 0)
    assert quad.variance[[0, 2]] == pytest.approx(1e-6 + (0.01 * STEEPER * 0.3) ** 2)
    assert quad.variance[[1, 3]] == pytest.approx(1e-6) and (quad.middle == 0.0).all()


def test_light_that_grows_on_cell_and_line_alike_is_none_laid_over() -> None:
    quad = square([27.0, 26.0, 25.0, 26.0], [5.4 * 27.0, 140.0, 5.4 * 25.0, 140.0], by_added=0.01)
    correct_light(quad, 0)
    assert quad.variance == pytest.approx(1e-6)


def test_rounding_moves_a_centre_only_where_contrasts_differ() -> None:
    quad, told = square([2.4] * 4, [15.0] * 4), np.zeros(3)
    quad.rounded[:] = 0.01
    add_rounding(quad, told)
    assert told == pytest.approx(0.0, abs=1e-15)
    quad.rounded[2] = 0.0
    add_rounding(quad, told)
    assert told == pytest.approx([0.0, 0.0, 0.005**2])


def test_a_cell_half_in_a_deep_shadow_is_as_sure_as_it_says() -> None:
    """Eight bits: in a tenth of the light a cell's pixels nearly all read the same."""
    sheet, rng = Sheet(np.diag([2.6, 2.6, 1.0]) @ COARSE, size=(700, 500)), np.random.default_rng(8)
    corners = sheet.corners_px()
    lit = sheet.draw(np.uint16, over=8).astype(float) / 200.0
    shade = np.where(np.arange(lit.shape[0])[:, None] > corners[4, :, 1].mean(), 0.1, 1.0)
    squares, noise = [], np.array([ROUNDED + 0.01, 0.01])
    for level in np.linspace(20.0, 30.0, 40, endpoint=False):  # in the shadow, a whole grey value
        light = (level + lit - 30.0) * shade
        image = np.rint(rng.normal(light, np.sqrt(0.01 + 0.01 * np.maximum(light, 0.0)))).clip(0, 255)
        cells = sheet.measure(image.astype(np.uint8), corners, noise=noise)
        away = cells.corners_px[4].mean(axis=0) - corners[4].mean(axis=0)
        squares.append(away[1] ** 2 / cells.covariance_px2[4, 2])
    assert 0.5 < np.mean(squares) < 1.3 and max(squares) < 9.0  # without what rounding feigns 4.6, and 27
