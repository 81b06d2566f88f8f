"""Sides matched by templates: right, honest about their scatter, near the bound, and the same edge as the full fit."""

from typing import Any

import numpy as np
import pytest
from test_vision_edges import LEVEL as STRAIGHT
from test_vision_edges import MIRRORED, TILTED, UPSIDE_DOWN, Sheet, table_of

from fsw.vision.blur import STEP_PER_PX, STEP_REACH_PX, STEP_ROWS
from fsw.vision.templates import (
    BLURRING,
    LEAST_HALF,
    LEVEL,
    NOISE_RANGE,
    PHASES,
    SHIFT,
    STEP,
    Templates,
    fill_templates,
    make_templates,
    noise_ratio,
)

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
WIDE: dict[str, Any] = {"pitch_mm": (47.0, 27.0), "border_mm": 9.0, "size": (300, 230)}


@pytest.mark.parametrize("H", [STRAIGHT, UPSIDE_DOWN, MIRRORED], ids=["level", "turned", "mirrored"])
@pytest.mark.parametrize("shift", [(0.1, -0.1), (0.4, -0.3), (-1.4, 1.1)])
@pytest.mark.parametrize("blur_px", [0.5, 0.7])
def test_wide_lines_are_measured_to_a_hundredth_of_a_pixel(H: FloatArray, shift: FloatArray, blur_px: float) -> None:
    sheet = Sheet(H, blur_px=blur_px, **WIDE)
    cells = sheet.measure(sheet.draw(), sheet.corners_px() + shift)
    inside = ((sheet.corners_px() > 8.0) & (sheet.corners_px() < np.array(sheet.size) - 9.0)).all(axis=(1, 2))
    assert inside.sum() >= 4 and cells.whole[inside].all()
    assert np.abs(cells.corners_px - sheet.corners_px())[inside].max() < 0.012


def test_a_side_on_the_next_line_is_not_found() -> None:
    sheet = Sheet(STRAIGHT, **WIDE)
    away = sheet.corners_px() + np.array([0.0, 9.0])
    assert not sheet.measure(sheet.draw(), away).found.any()


@pytest.mark.parametrize("H", [STRAIGHT, TILTED], ids=["level", "tilted"])
@pytest.mark.parametrize("noise", [300.0, 1200.0])
def test_the_normalised_error_of_the_centre_is_a_chi_square(H: FloatArray, noise: float) -> None:
    sheet, rng, chi2 = Sheet(H, **WIDE), np.random.default_rng(17), []
    clean, expected = sheet.draw(np.uint16).astype(float), sheet.corners_px()
    centres, told = [], []
    for _ in range(150):
        noisy = np.clip(clean + rng.normal(0.0, noise, clean.shape), 0, 65535).astype(np.uint16)
        cells = sheet.measure(noisy, expected)
        centres.append(cells.centre_px.copy())
        told.append(cells.covariance_px2.copy())
    away, covariance = np.array(centres), np.array(told)
    whole = np.isfinite(away).all(axis=(0, 2))
    assert whole.sum() >= 6
    away = (away - away.mean(axis=0))[:, whole] * np.sqrt(150.0 / 149.0)
    xx, xy, yy = np.moveaxis(covariance[:, whole], -1, 0)
    chi2 = (yy * away[..., 0] ** 2 - 2.0 * xy * away[..., 0] * away[..., 1] + xx * away[..., 1] ** 2) / (
        xx * yy - xy * xy
    )
    assert np.mean(chi2) / 2.0 == pytest.approx(1.0, abs=0.1)


def filled(blur_px: float, gain: float = 1.0, room_px: float = 0.0, ratio: float = 1.0) -> Templates:
    """Templates along X, for this ratio of a pixel's variance on the line to that on the cell."""
    templates = make_templates()
    templates.noise[0] = 1.0, ratio
    fill_templates(table_of(blur_px), float(np.sqrt(blur_px**2 + 1.0 / 12.0)), gain, room_px, 0, templates)
    return templates


@pytest.mark.parametrize("ratio", [0.2, 1.0, 6.0])
@pytest.mark.parametrize("blur_px", [0.4, 0.6, 1.0])
def test_templates_are_the_weighted_least_squares_of_the_linear_model(blur_px: float, ratio: float) -> None:
    templates, table = filled(blur_px, ratio=ratio), table_of(blur_px)
    taps, grid = int(templates.taps[0]), np.arange(STEP_ROWS) / STEP_PER_PX - STEP_REACH_PX
    for phase in (0, 13, PHASES - 1):
        x = np.arange(taps) - (taps // 2 - 1) - (phase + 0.5) / PHASES
        value, slope = (np.interp(x, grid, table[:, i]) for i in (0, 1))
        J, W = np.stack([np.ones(taps), value, -slope], axis=1), 1.0 / (1.0 + (ratio - 1.0) * value)
        best = np.linalg.solve(J.T @ (W[:, None] * J), J.T * W)
        weight = templates.weight[0, phase].astype(float)
        assert weight[STEP, :taps] == pytest.approx(best[1], abs=1e-5)
        assert weight[SHIFT, :taps] == pytest.approx(best[2], abs=1e-5)
        assert (weight[:, taps:] == 0.0).all()
        mirrored = templates.weight[2, phase, :, :taps][:, ::-1]
        assert (mirrored == templates.weight[0, phase, :, :taps]).all()


@pytest.mark.parametrize("ratio", [1.0, 6.0])
def test_shifts_to_either_side_are_calibrated(ratio: float) -> None:
    blur_px = 0.6
    templates, table = filled(blur_px, ratio=ratio), table_of(blur_px)
    grid = np.arange(STEP_ROWS) / STEP_PER_PX - STEP_REACH_PX
    taps, square, cube = int(templates.taps[0]), *templates.bent[0]
    for shift in (-0.25, -0.1, 0.03, 0.2):
        found = []
        for phase in range(PHASES):
            x = np.arange(taps) - (taps // 2 - 1) - (phase + 0.5) / PHASES
            step, off = templates.weight[0, phase, :2, :taps] @ np.interp(x - shift, grid, table[:, 0])
            found.append(off / step)
        linear = float(np.mean(found))
        assert linear + square * linear**2 + cube * linear**3 == pytest.approx(shift, abs=5e-4)


def test_an_edge_more_blurred_seems_shifted_as_told() -> None:
    templates, grid = filled(0.6, ratio=6.0), np.arange(STEP_ROWS) / STEP_PER_PX - STEP_REACH_PX
    taps, table, found = int(templates.taps[0]), table_of(0.61), []
    for phase in range(PHASES):
        x = np.arange(taps) - (taps // 2 - 1) - (phase + 0.5) / PHASES
        step, off = templates.weight[0, phase, :2, :taps] @ np.interp(x, grid, table[:, 0])
        found.append(off / step)
    assert np.mean(found) == pytest.approx(0.01 * templates.blurred[0], rel=0.05)
    assert abs(filled(0.6, ratio=1.0).blurred[0]) < 0.01


@pytest.mark.parametrize("ratio", [1.0, 5.0])
def test_templates_are_blind_to_a_level_and_to_each_other(ratio: float) -> None:
    templates = filled(0.6, 0.95, ratio=ratio)
    taps = int(templates.taps[0])
    weight, own = templates.weight[0, :, :, :taps].astype(float), templates.pixel_weight[0, :, :taps].astype(float)
    assert own.mean(axis=1) == pytest.approx(np.ones(PHASES), abs=1e-6)
    assert np.abs(weight[:, (STEP, SHIFT, BLURRING)].sum(axis=2)).max() < 1e-5
    for one, other in ((SHIFT, BLURRING), (STEP, BLURRING), (LEVEL, BLURRING), (LEVEL, SHIFT)):
        assert np.abs(np.einsum("pk,pk->p", weight[:, one], weight[:, other] / own)).max() < 1e-5


def test_the_window_is_as_wide_as_lines_leave_room_and_none_for_strong_blur() -> None:
    assert filled(0.6).taps[0] == 8
    assert filled(0.6, room_px=5.4).taps[0] == 10
    assert filled(0.6, room_px=90.0).taps[0] == 12
    assert filled(0.2).taps[0] == 2 * LEAST_HALF
    assert filled(3.5).taps[0] == 0  # the full fit takes over


def test_the_ratio_of_the_noise_is_bounded_and_even_before_any_is_known() -> None:
    assert noise_ratio(np.array([0.0, 0.0])) == 1.0
    assert noise_ratio(np.array([2.0, 9.0])) == 4.5
    assert noise_ratio(np.array([1.0, 1e9])) == NOISE_RANGE
    assert noise_ratio(np.array([1e9, 0.0])) == 1.0 / NOISE_RANGE
