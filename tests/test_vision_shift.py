"""Cells that one eye takes for their neighbours: no point leaves the frame tasks."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hal.frame import as_frame
from sim.bench.vision_stand import Stand, Truth, bench_scenario, hardware, pair_of
from sim.world import World

Pair = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]

RIGHT_MM = 0.5  # a right point is no farther off, a cell's pitch is 20 to 40 mm


@pytest.fixture
def tracking() -> Iterator[tuple[Stand, list[Pair]]]:
    """The paper's wing at 1024 x 750, found and tracked for two ticks; the third tick's images are next."""
    scenario = bench_scenario(4, 4)
    world = World(scenario, 1)
    pairs = [pair_of(world, tick) for tick in range(4)]
    stand = Stand(*hardware(scenario), pairs[0])
    assert stand.acquire(*pairs[0]).ok
    for tick in (0, 1):
        stand.tick(*pairs[tick])
    points, true_mm = stand.tracker.points, Truth(world).centres_mm(1)
    assert points.valid.sum() > 200
    assert np.linalg.norm(points.xyz_mm - true_mm, axis=1)[points.valid].max() < RIGHT_MM
    yield stand, pairs
    stand.close()


@pytest.mark.parametrize("rows", [1, -1])
@pytest.mark.parametrize("eye", [0, 1])
def test_a_shift_in_one_eye_lets_no_point_stand(tracking: tuple[Stand, list[Pair]], eye: int, rows: int) -> None:
    """One eye's image is moved along its columns by a row of cells: each cell is seen where its neighbour was."""
    stand, pairs = tracking
    centre, valid = stand.tracker.centre_px[eye], stand.tracker.points.valid
    pairs_of_rows = [n for n in range(stand.grid.count - 1) if valid[n] and valid[n + 1] and n % 18 < 17]
    step = float(np.median([centre[n + 1, 1] - centre[n, 1] for n in pairs_of_rows]))
    moved = list(pairs[2])
    moved[eye] = as_frame(np.roll(moved[eye], round(rows * step), axis=0))
    stand.tick(moved[0], moved[1])
    assert not stand.tracker.points.valid.any()


@pytest.mark.parametrize("cells", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_shift_in_both_eyes_lets_no_point_stand(tracking: tuple[Stand, list[Pair]], cells: tuple[int, int]) -> None:
    """The surface slips by a cell along one axis: all lines are met, and every name is wrong."""
    stand, pairs = tracking
    stand.tracker.surface.unknowns[:2] += np.array(cells) * stand.grid.panels[0].pitch_mm
    for tick in (2, 3):
        stand.tick(*pairs[tick])
        assert not stand.tracker.points.valid.any()
