"""Bows of cells by the points round them, against parabolas and what no panel shows."""

import numpy as np
import pytest
from vision_scene import FloatArray, three_panels

from fsw.vision.curvature import BEYOND, Patches, bend_patches, make_patches
from fsw.vision.grid import CellGrid

ALONG, ACROSS, TWIST, TILT = 3e-7, -5e-7, 2e-7, 1e-4  # 1/mm: half the second derivatives, and the slope, of a panel
QUIET_MM = 1e-4


@pytest.fixture
def grid() -> CellGrid:
    return three_panels()


def bent(grid: CellGrid) -> Patches:
    """Points on a paraboloid, all as sure."""
    patches = make_patches(grid)
    x, y = (grid.centre_mm - (700.0, 0.0)).T
    patches.off_mm[:] = ALONG * x * x + ACROSS * y * y + TWIST * x * y + TILT * x
    patches.variance[:] = QUIET_MM**2
    return patches


def rises_mm(grid: CellGrid) -> FloatArray:
    """Bows (N, 2) of that paraboloid."""
    size = np.array([panel.cell_mm for panel in grid.panels])[grid.cell[:, 0]]
    return np.array([-ALONG, -ACROSS]) * (0.5 * size) ** 2


def hide(patches: Patches, cells: FloatArray) -> None:
    patches.off_mm[cells] = patches.variance[cells] = np.nan


def test_a_paraboloids_cells_have_its_bow(grid: CellGrid) -> None:
    patches = bent(grid)
    bend_patches(patches)
    assert patches.rise_mm == pytest.approx(rises_mm(grid), rel=1e-6)


def test_cells_beside_hidden_ones_have_the_bow_of_the_nearest_full_patch(grid: CellGrid) -> None:
    patches = bent(grid)
    hidden = np.array([grid.index(1, 6, 9), grid.index(0, 1, 1), grid.index(2, 12, 17)])
    hide(patches, hidden)
    bend_patches(patches)
    seen = ~np.isin(np.arange(grid.count), hidden)
    assert patches.rise_mm[seen] == pytest.approx(rises_mm(grid)[seen], rel=1e-6)
    assert (patches.rise_mm[hidden] == 0.0).all()


@pytest.mark.parametrize("columns", [3, 4])
def test_so_few_columns_tell_it_too(grid: CellGrid, columns: int) -> None:
    patches = bent(grid)
    seen = (grid.cell[:, 0] == 0) & (grid.cell[:, 1] < columns)
    hide(patches, ~seen)
    bend_patches(patches)
    assert patches.rise_mm[seen] == pytest.approx(rises_mm(grid)[seen], rel=1e-6)


def test_two_columns_beside_a_fold_have_the_bow_of_the_cells_beyond_and_alone_none(grid: CellGrid) -> None:
    patches, few = bent(grid), (grid.cell[:, 0] == 0) & (grid.cell[:, 1] >= 11)
    hide(patches, (grid.cell[:, 0] == 0) & ~few)
    bend_patches(patches)
    assert BEYOND >= 2 and patches.rise_mm[few] == pytest.approx(rises_mm(grid)[few], rel=1e-6)
    hide(patches, ~few)
    bend_patches(patches)
    assert (patches.rise_mm == 0.0).all()


def test_a_point_that_is_hardly_known_bends_no_cell_beside_it(grid: CellGrid) -> None:
    patches, wrong = bent(grid), grid.index(1, 6, 9)
    patches.off_mm[wrong] += 0.05
    patches.variance[wrong] = 0.05**2
    bend_patches(patches)
    others = np.arange(grid.count) != wrong
    assert patches.rise_mm[others] == pytest.approx(rises_mm(grid)[others], rel=1e-6)
