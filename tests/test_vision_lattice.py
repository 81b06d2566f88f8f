"""Cells find their neighbours through holes, noise and fold gaps, and contradictions are left out."""

import numpy as np
import pytest

from fsw.vision.lattice import link

CELL = (38.0, 20.0)
OFFSETS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * CELL


def _cells(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    place = np.stack(np.meshgrid(np.arange(len(x)), np.arange(len(y)), indexing="ij"), axis=-1).reshape(-1, 2)
    centre = np.stack((x[place[:, 0]], y[place[:, 1]]), axis=-1)
    return centre[:, None] + OFFSETS, place


def _turned(corners: np.ndarray, degrees: float, scale: float) -> np.ndarray:
    c, s = scale * np.cos(np.deg2rad(degrees)), scale * np.sin(np.deg2rad(degrees))
    return corners @ np.array([[c, s], [-s, c]])


@pytest.mark.parametrize(("degrees", "scale"), [(0.0, 1.0), (5.0, 1.08), (-4.0, 0.93)])
def test_places_survive_rotation_scale_noise_and_holes(degrees: float, scale: float) -> None:
    rng = np.random.default_rng(3)
    corners, place = _cells(40.0 * np.arange(9), 22.0 * np.arange(7))
    keep = rng.random(len(place)) > 0.15
    noisy = _turned(corners[keep], degrees, scale) + rng.normal(0, 0.15, (int(keep.sum()), 4, 2))
    largest = link(noisy, CELL, (40.0,), 22.0)[0]
    assert len(largest.member) > 0.9 * keep.sum()
    found = largest.place - largest.place[0]
    assert np.array_equal(found, place[keep][largest.member] - place[keep][largest.member[0]])


@pytest.mark.parametrize("gap", [45.0, 60.0])
def test_a_fold_gap_is_one_step_and_shows_in_the_ratio(gap: float) -> None:
    x = np.concatenate((40.0 * np.arange(4), 120.0 + gap + 40.0 * np.arange(5)))
    corners, place = _cells(x, 22.0 * np.arange(6))
    one = link(corners * 1.05, CELL, (40.0, gap), 22.0)[0]
    assert np.array_equal(one.place, place[one.member])
    middle = [np.nanmedian(one.ratio_x[one.place[:, 0] == c]) for c in range(1, 8)]
    assert middle == pytest.approx([1, 1, gap / 40, 40 / gap, 1, 1, 1], rel=1e-6)


def test_an_unknown_gap_parts_lattices_and_a_stray_cell_does_not_join() -> None:
    x = np.concatenate((40.0 * np.arange(4), 120.0 + 60.0 + 40.0 * np.arange(5)))
    corners, _ = _cells(x, 22.0 * np.arange(6))
    stray = np.array([[150.0, 31.0]]) + OFFSETS
    sizes = [len(a.member) for a in link(np.concatenate((corners, stray[None])), CELL, (40.0,), 22.0)]
    assert sizes == [30, 24, 1]
    assert link(np.empty((0, 4, 2)), CELL, (40.0,), 22.0) == []
