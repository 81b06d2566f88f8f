"""Whether a frame is fit to be measured: what is no wing is refused, and what may be one is not."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from flight_parts import small
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsw.vision import frames
from fsw.vision.frames import KNOWN_FRAMES, STAGGER, FrameCheck, Unfit
from fsw.vision.hot import is_full_scale, shown_full_scale
from hal.frame import make_frames
from sim.world import World

SHAPE = (320, 480)
Image = NDArray[Any]


def check(dtype: Any = np.uint8, shape: tuple[int, int] = SHAPE) -> FrameCheck:
    made = FrameCheck(shape, np.dtype(dtype), black_levels=4.0, saturated_share=0.5)
    made.init(np.zeros(shape, dtype))
    return made


def scene(noise: float = 1.5, seed: int = 0, top: float = 200.0, phase: float = 0.0, dtype: Any = np.uint8) -> Image:
    """Dark cells between bright lines with soft edges, moved by `phase` px, with noise."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    lines = np.maximum(np.cos((x + phase) * np.pi / 12.0), np.cos((y + phase) * np.pi / 10.0))
    grey = top * (0.15 + 0.85 / (1.0 + np.exp(-20.0 * (lines - 0.9))))
    grey += noise * np.random.default_rng(seed).standard_normal(SHAPE)
    return np.clip(np.rint(grey), 0, np.iinfo(dtype).max).astype(dtype)


def shown(images: Iterator[Image] | list[Image], dtype: Any = np.uint8) -> list[Unfit]:
    """The verdicts on these images, one after the other."""
    checked = check(dtype)
    return [checked.look(image) for image in images]


@pytest.mark.requirement("WB-PAI-02")
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("level", [0, 1, 7])
@pytest.mark.parametrize("after", [[], [scene()]])
def test_darkness_is_black_with_and_without_noise(dtype: Any, level: int, after: list[Image]) -> None:
    draw = np.random.default_rng(level)
    noisy = (level + draw.integers(0, 3, SHAPE)).astype(dtype)
    images = [*(image.astype(dtype) for image in after), np.full(SHAPE, level, dtype), noisy]
    assert shown(images, dtype)[-2:] == [Unfit.BLACK, Unfit.BLACK]


@pytest.mark.requirement("WB-PAI-03")
def test_a_dim_wing_is_no_darkness_even_with_a_glint() -> None:
    assert shown([scene(noise=0.5, top=14.0)]) == [Unfit.FIT]
    image = scene(noise=4.0, top=120.0, dtype=np.uint16)
    image[:16, :16] = 65535
    assert shown([image], np.uint16) == [Unfit.FIT]


@pytest.mark.requirement("WB-PAI-02")
@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535), (np.uint16, 4095), (np.uint16, 65520)])
def test_a_frame_at_full_scale_is_saturated_whatever_its_depth(dtype: Any, top: int) -> None:
    checked = check(dtype)
    assert checked.look(scene(top=0.4 * top, dtype=dtype)) is Unfit.FIT
    image = scene(top=0.4 * top, seed=1, dtype=dtype)
    image[:, : int(0.6 * SHAPE[1])] = top
    assert checked.look(image) is Unfit.SATURATED
    assert checked.share_at_top == pytest.approx(0.6, abs=0.02)
    assert checked.look(np.full(SHAPE, top, dtype)) is Unfit.SATURATED


@pytest.mark.requirement("WB-PAI-03")
@pytest.mark.parametrize("share", [0.1, 0.45])
def test_earth_or_glints_over_less_than_half_of_the_frame_are_no_saturation(share: float) -> None:
    image = scene()
    image[:, : int(share * SHAPE[1])] = 255
    assert shown([image]) == [Unfit.FIT]


@pytest.mark.requirement("WB-PAI-03")
@pytest.mark.parametrize("grey", [90, 180, 240, 254])
def test_bright_cells_that_all_have_one_grey_are_not_saturated(grey: int) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert shown([np.where((x % 24 < 4) | (y % 20 < 4), 20, grey).astype(np.uint8)]) == [Unfit.FIT]


def test_full_scale_is_all_ones_of_eight_bits_or_more_at_either_end_of_the_word() -> None:
    ones = {((1 << bits) - 1) << shift for bits in range(8, 17) for shift in range(17 - bits)}
    assert {value for value in range(1, 65536) if is_full_scale(value)} == ones


@pytest.mark.requirement("WB-PAI-02")
def test_the_same_pixels_again_are_stuck_until_they_change() -> None:
    images = [scene(seed=min(k, 10)) for k in range(14)] + [scene(seed=20)]
    assert shown(images) == [Unfit.FIT] * 11 + [Unfit.STUCK] * 3 + [Unfit.FIT]


@pytest.mark.requirement("WB-PAI-02")
def test_a_frozen_frame_is_stuck_in_a_fast_swing_without_noise_too() -> None:
    images = [scene(noise=0.0, phase=3.0 * min(k, 10)) for k in range(12)]
    assert shown(images) == [Unfit.FIT] * 11 + [Unfit.STUCK]


@pytest.mark.requirement("WB-PAI-03")
def test_a_still_wing_without_noise_is_not_stuck() -> None:
    assert set(shown([scene(noise=0.0)] * 30)) == {Unfit.FIT}


@pytest.mark.requirement("WB-PAI-03")
def test_a_wing_without_noise_may_come_to_rest() -> None:
    swing = [6.0 * np.exp(-0.15 * k) * np.sin(0.3 * k) for k in range(80)]
    assert set(shown(scene(noise=0.0, phase=phase) for phase in [*swing, *[swing[-1]] * 10])) == {Unfit.FIT}


def tear(image: Image, before: Image, first: int, last: int) -> Image:
    image = image.copy()
    image[first:last] = before[first:last]
    return image


@pytest.mark.requirement("WB-PAI-02")
@pytest.mark.parametrize(("first", "last"), [(0, 60), (100, 170), (200, 320)])
@pytest.mark.parametrize(("known", "verdict"), [(KNOWN_FRAMES - 1, Unfit.FIT), (KNOWN_FRAMES, Unfit.TORN)])
def test_a_part_of_the_frame_before_is_torn_once_the_camera_is_known_to_be_noisy(
    first: int, last: int, known: int, verdict: Unfit
) -> None:
    images = [scene(seed=seed) for seed in range(known + 1)]  # the first one has nothing before it
    torn = tear(scene(seed=99), images[-1], first, last)
    assert shown([*images, torn, scene(seed=100)]) == [Unfit.FIT] * len(images) + [verdict, Unfit.FIT]


@pytest.mark.requirement("WB-PAI-03")
@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("start", [0.0, 0.15, 1.0])
def test_a_swing_without_noise_is_never_torn_nor_stuck(noise: float, start: float) -> None:
    images = []
    for k in range(60):  # root at rest in the upper half, the tip swings through its turning points in the lower one
        image = scene(noise=noise, seed=k)
        image[160:] = scene(noise=noise, seed=k, phase=6.0 * np.cos(0.3 * k + start))[160:]
        images.append(image)
    assert set(shown(images)) == {Unfit.FIT}


@pytest.mark.requirement("WB-PAI-03")
def test_black_sky_and_clipped_light_say_nothing() -> None:
    images = [scene(seed=k) for k in range(60)]
    for k, image in enumerate(images):
        image[:120] = 0
        if k > 20:  # Earth rises over the wing's lower part, with a sharp limb against black sky
            image[200:] = 0
            image[200:, :300] = 255
    assert set(shown(images)) == {Unfit.FIT}


@pytest.mark.requirement("WB-PAI-03")
@pytest.mark.parametrize("quantum", [1, 16])
@pytest.mark.parametrize("still", [False, True])
def test_the_simulated_wing_is_always_fit(quantum: int, still: bool) -> None:
    count = 45
    scenario = small(count / 15.0)
    rest = [type(e)(e.mode, 0.0, e.damping_ratio, e.kind, e.phase_deg) for e in scenario.excitation]
    world = World(small(count / 15.0, excitation=rest) if still else scenario)
    eye = world.eyes[0]
    shape = eye.height, eye.width
    checked, image = check(world.dtype, shape), make_frames(shape, world.dtype)
    for tick in range(count):
        world.render(tick, 0, image)
        assert checked.look(image // quantum * quantum) is Unfit.FIT, tick


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), dtype=st.sampled_from([np.uint8, np.uint16]), rows=st.integers(1, 400))
def test_the_figures_are_those_of_the_sample(seed: int, dtype: Any, rows: int) -> None:
    draw = np.random.default_rng(seed)
    shape, top = (rows, 300), int(np.iinfo(dtype).max)
    images = [draw.integers(0, draw.integers(2, top), shape).astype(dtype) for _ in range(2)]
    images[1][: rows // 2] = images[0][: rows // 2]
    checked = check(dtype, shape)
    for image in images:
        checked.look(image)
    step = max(1, min(rows, 300) // 64)
    y, x = np.mgrid[: rows // step, : 300 // step]
    at = y * step + STAGGER * x % step, x * step + STAGGER * y % step
    before, now = images[0][at].astype(float), images[1][at].astype(float)
    inside = (now > now.min()) & (now < now.max())
    dark, median, bright = np.quantile(now, [0.01, 0.5, 0.99], method="inverted_cdf")
    assert checked.figures[frames.SPREAD] == bright - dark and checked.figures[frames.MEDIAN] == median
    assert checked.figures[frames.MIDDLE] == (dark + bright) / 2 and checked.figures[frames.TOP] == now.max()
    assert checked.figures[frames.TOP_SHARE] == pytest.approx((now == now.max()).mean())
    assert checked.figures[frames.REPEATED] == pytest.approx((now == before).mean())
    expected = (now == before)[inside].mean() if inside.any() else 1.0
    assert checked.figures[frames.REPEATED_INSIDE] == pytest.approx(expected)


def test_the_brightest_pixels_tell_at_which_value_light_is_cut_off() -> None:
    image = np.full((64, 48), 700, np.uint16)
    assert shown_full_scale(image) == 65535
    image[20:30, 10:20] = 4095  # a converter of 12 bits
    assert shown_full_scale(image) == 4095
    image[20:30, 10:20] = 4095 << 4  # and one that fills its word from above
    assert shown_full_scale(image) == 4095 << 4
    image[40, 3] = 4000  # what is brightest is no converter's end
    image[20:30, 10:20] = 4000
    assert shown_full_scale(image) == 65535
    assert shown_full_scale(np.full((8, 8), 30, np.uint8)) == 255
