"""Contours give a quadrilateral's corners; the paper's centre is the mean of its boundary."""

import cv2
import numpy as np
import pytest

from fsw.vision.cells import centres_of, gradient, paper_centres, quadrilaterals, refine


def _blob(corners: np.ndarray, shape: tuple[int, int] = (80, 120), over: int = 16) -> np.ndarray:
    """Dark quadrilateral on bright ground, supersampled; pixel centres at whole numbers."""
    big = np.full((shape[0] * over, shape[1] * over), 200, np.uint8)
    cv2.fillConvexPoly(big, np.round((corners + 0.5) * over - 0.5).astype(np.int32), 40)
    return cv2.resize(big, shape[::-1], interpolation=cv2.INTER_AREA)


QUAD = np.array([[30.3, 20.2], [88.6, 24.9], [86.1, 56.3], [28.4, 51.7]])


def test_corners_come_back_within_a_fraction_of_a_pixel() -> None:
    view = _blob(QUAD).astype(np.float32)
    found = quadrilaterals((view < 120).astype(np.uint8), (58.0, 31.5), 0.2)
    assert found.shape == (1, 4, 2)
    assert np.abs(found[0] - QUAD).max() < 0.6
    refine(found, view, 3)
    assert np.abs(found[0] - QUAD).max() < 0.25


def test_what_is_no_cell_is_left_out() -> None:
    mask = np.zeros((100, 200), np.uint8)
    mask[10:40, 10:68] = 1  # a cell
    mask[50:95, 10:68] = 1  # too high
    mask[10:40, 190:] = 1  # cut by the rim
    cv2.circle(mask, (130, 30), 22, 1, -1)  # round
    found = quadrilaterals(mask, (58.0, 30.0), 0.25)
    assert len(found) == 1
    assert found[0] == pytest.approx(np.array([[9.5, 9.5], [67.5, 9.5], [67.5, 39.5], [9.5, 39.5]]), abs=0.05)
    assert quadrilaterals(np.zeros((20, 20), np.uint8), (5.0, 5.0), 0.2).shape == (0, 4, 2)


def test_diagonals_cross_at_the_projected_centre() -> None:
    H = np.array([[1.0, 0.2, 5.0], [0.1, 0.9, 3.0], [0.002, -0.001, 1.0]])
    square = np.array([[-20.0, -10.0], [20.0, -10.0], [20.0, 10.0], [-20.0, 10.0], [0.0, 0.0]])
    seen = cv2.perspectiveTransform(square[None], H)[0]
    assert centres_of(seen[:4]) == pytest.approx(seen[4], abs=1e-9)


def test_paper_centres_are_the_boundary_means_of_whole_cells() -> None:
    image = np.full((120, 200), 180, np.uint8)
    image[20:40, 30:70] = 40
    image[60:80, 100:140] = 30
    image[50:90, 170:] = 30  # cut by the rim
    centres = paper_centres(image, dark=True, area_px=(500.0, 1200.0))
    assert centres == pytest.approx(np.array([[49.5, 29.5], [119.5, 69.5]]), abs=1e-9)
    assert paper_centres(255 - image, dark=False, area_px=(500.0, 1200.0)) == pytest.approx(centres)


def test_gradient_points_up_a_ramp() -> None:
    ramp = np.tile(np.arange(0, 100, 5, dtype=np.uint8), (10, 1))
    magnitude, direction = gradient(ramp)
    assert magnitude[5, 5] == pytest.approx(40.0)  # Sobel weighs a slope of 5 by 8
    assert direction[5, 5] == pytest.approx(0.0, abs=1e-3)
