"""Sides matched by templates: right, honest about their scatter, near the bound, and the same edge as the full fit."""

from typing import Any

import numpy as np
import pytest
from test_vision_edges import LEVEL, MIRRORED, TILTED, UPSIDE_DOWN, Sheet, table_of

from fsw.vision.blur import STEP_ROWS, tabulate_step
from fsw.vision.templates import BLURRING, MAX_TAPS, PHASES, SHIFT, STEP, fill_templates, make_templates, sum_columns

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
WIDE: dict[str, Any] = {"pitch_mm": (47.0, 27.0), "border_mm": 9.0, "size": (300, 230)}


@pytest.mark.parametrize("H", [LEVEL, UPSIDE_DOWN, MIRRORED], ids=["level", "turned", "mirrored"])
@pytest.mark.parametrize("shift", [(0.1, -0.1), (0.4, -0.3), (-1.4, 1.1)])
@pytest.mark.parametrize("blur_px", [0.5, 0.7])
def test_wide_lines_are_measured_to_a_hundredth_of_a_pixel(H: FloatArray, shift: FloatArray, blur_px: float) -> None:
    sheet = Sheet(H, blur_px=blur_px, **WIDE)
    cells = sheet.measure(sheet.draw(), sheet.corners_px() + shift)
    inside = ((sheet.corners_px() > 8.0) & (sheet.corners_px() < np.array(sheet.size) - 9.0)).all(axis=(1, 2))
    assert inside.sum() >= 4 and cells.whole[inside].all()
    assert np.abs(cells.corners_px - sheet.corners_px())[inside].max() < 0.012


def test_a_side_on_the_next_line_is_not_found() -> None:
    sheet = Sheet(LEVEL, **WIDE)
    away = sheet.corners_px() + np.array([0.0, 9.0])
    assert not sheet.measure(sheet.draw(), away).found.any()


@pytest.mark.parametrize("H", [LEVEL, TILTED], ids=["level", "tilted"])
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


@pytest.mark.parametrize("blur_px", [0.4, 0.6, 1.0])
def test_templates_give_the_shift_of_any_edge_and_reach_the_bound(blur_px: float) -> None:
    rng, step, templates = np.random.default_rng(4), np.zeros((STEP_ROWS, 3)), make_templates()
    tabulate_step(blur_px, step)
    whole = float(np.sqrt(blur_px**2 + 1.0 / 12.0))
    fill_templates(step, whole, 1.0, 0, templates)
    taps, noise, columns = int(templates.taps[0]), 3.0, 200
    assert 0 < taps <= MAX_TAPS
    table = table_of(blur_px)
    grid = np.arange(len(table)) / 64.0 - 8.0
    shifts, variances, bounds = [], [], []
    for _ in range(150):
        templates.place[:columns] = rng.uniform(0.0, PHASES, columns)
        x = np.arange(taps) - (taps // 2 - 1) - templates.place[:columns, None] / PHASES
        edge = np.interp(x - 0.1, grid, table[:, 0])
        templates.pixel[:columns, :taps] = 40.0 + 150.0 * edge + rng.normal(0.0, noise, edge.shape)
        sb, sbb, sbc, scc, *_ = sum_columns(
            templates.pixel, templates.place, columns, templates.weight, templates.scale, 0, taps
        )
        shift = sbc / sbb
        variances.append((scc - shift * sbc) / ((columns - 1) * sbb))
        shifts.append(shift + templates.cubic[0] * shift**3)
        slope = -150.0 * np.interp(x - 0.1, grid, table[:, 1])
        J = np.stack([np.ones(x.size), edge.ravel(), slope.ravel()])
        bounds.append(np.linalg.inv(J @ J.T)[2, 2] * noise**2)
        assert sb / columns == pytest.approx(150.0, rel=0.02)
    assert np.mean(shifts) == pytest.approx(0.1, abs=0.002)
    assert np.mean(variances) / np.var(shifts) == pytest.approx(1.0, abs=0.35)
    assert np.mean(variances) / np.mean(bounds) < 1.15


def test_templates_are_orthogonal_to_a_level_and_to_each_other() -> None:
    step, templates = np.zeros((STEP_ROWS, 3)), make_templates()
    tabulate_step(0.6, step)
    fill_templates(step, 0.67, 0.95, 1, templates)
    weight = templates.weight[1].astype(float)
    assert np.abs(weight.sum(axis=2)).max() < 1e-6
    for one, other in ((STEP, SHIFT), (STEP, BLURRING), (SHIFT, BLURRING)):
        if one != STEP or other != SHIFT:
            assert np.abs(np.einsum("pk,pk->p", weight[:, one], weight[:, other])).max() < 1e-5
    fill_templates(step, 3.5, 1.0, 1, templates)
    assert templates.taps[1] == 0  # too blurred: the full fit takes over
