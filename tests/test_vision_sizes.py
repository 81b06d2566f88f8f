"""A cell that is larger or smaller than the others says so in its covariance."""

import numpy as np

from fsw.vision.corners import make_cells
from fsw.vision.sizes import EVEN_PX, ODD_PX, ROWS_BEHIND, WORK, widen_odd_sizes

COUNT, VARIANCE = 60, 1e-6


def widened(
    shift: np.ndarray,
    scale: float = 1.0,
    at_border: np.ndarray | None = None,
    tilt: np.ndarray | float = 0.0,
    variance: np.ndarray | float = VARIANCE,
    askew: np.ndarray | None = None,
) -> np.ndarray:
    """Covariances (N, 3) of cells whose upper side is measured `shift` (N,) px too far out; at_border: which cells.

    tilt (N,): px by which that side is tilted, about its middle; askew (N,): by too much. variance (N,): of a centre.
    """
    draw = np.random.default_rng(5)
    place = 50.0 * np.stack(np.divmod(np.arange(COUNT), 10), axis=1)
    square = np.array([[0.0, 0.0], [40.0, 3.0], [37.0, 33.0], [-3.0, 30.0]])
    expected = place[:, None] + square
    cells, upwards = make_cells(COUNT), np.array([-3.0, 40.0]) / np.hypot(3.0, 40.0)
    middle = expected.mean(axis=1, keepdims=True)
    cells.corners_px[:] = middle + scale * (expected - middle) + draw.normal(0.0, 1e-3, (COUNT, 1, 1))
    cells.corners_px[:, 2:] += (shift + draw.normal(0.0, 1e-3, COUNT))[:, None, None] * upwards
    turn = np.array([0.5, -0.5])[:, None] * upwards
    cells.corners_px[:, 2:] += np.broadcast_to(tilt, COUNT)[:, None, None] * turn
    cells.covariance_px2[:, 0] = cells.covariance_px2[:, 2] = variance
    cells.covariance_px2[:, 1] = 0.0
    cells.whole[:] = cells.found[:] = cells.paired[:] = True
    odd = np.zeros(COUNT, np.bool_)
    # The surface is 0.1 px shorter than its kinks say.
    expected[:, 2:] -= 0.1 * upwards
    tilted = np.tile([0.1, 0.0], (COUNT, 1))
    neighbour = np.zeros((COUNT, 4), np.int64)
    if at_border is not None:
        neighbour[at_border, 2] = -1
    widen_odd_sizes(expected, tilted, neighbour, np.zeros((COUNT + ROWS_BEHIND, WORK)), cells, odd)
    askew = np.broadcast_to(abs(np.asarray(tilt)) > ODD_PX, COUNT) if askew is None else askew
    assert (odd == (askew | (cells.covariance_px2[:, [0, 2]].max(axis=1) > variance))).all()
    assert (cells.found == (~askew & (abs(shift - np.median(shift)) < ODD_PX))).all()
    return cells.covariance_px2


def test_a_side_that_is_off_widens_its_own_direction_until_sigma_tells_the_truth() -> None:
    shift = np.zeros(COUNT)
    shift[[7, 31, 50]] = 0.06, -0.3, 0.8  # the last is no cell
    C = widened(shift)
    for n in (7, 31):
        sigma = np.sqrt(C[n, 2])
        assert 1.0 < sigma / (0.5 * abs(shift[n])) < 2.0
        assert C[n, 0] < 0.05 * C[n, 2]
    others = np.delete(C[:, 2], [7, 31, 50])
    assert (others == VARIANCE).mean() > 0.95


def test_a_cell_whose_opposite_sides_are_askew_to_each_other_is_not_found() -> None:
    tilt = np.zeros(COUNT)
    tilt[[3, 31, 50]] = 0.3, 0.6, -1.8  # the first is noise's, as far as anyone knows
    assert (widened(np.zeros(COUNT), tilt=tilt)[[3, 31, 50], 2] == VARIANCE).all()
    unsure = np.full(COUNT, 0.05**2)  # of the centre: sides to 0.07 px, slopes against each other to 0.35 px
    widened(np.zeros(COUNT), tilt=np.where(tilt > 0.5, 0.9, tilt), variance=unsure, askew=tilt < -1.0)


def test_what_all_cells_have_in_common_is_no_fault_of_any() -> None:
    assert (widened(np.full(COUNT, 0.2), 1.01)[:, 2] == VARIANCE).mean() > 0.95


def test_what_grows_evenly_towards_the_rim_is_no_fault_of_any_and_hides_none() -> None:
    column, row = np.divmod(np.arange(COUNT), 10)
    shift = 0.1 * ((column - 2.5) / 2.5) ** 2 + 0.02 * (row - 4.5) / 4.5
    assert (widened(shift)[:, 2] == VARIANCE).mean() > 0.95
    shift[[7, 31]] += 0.06, -0.3
    C = widened(shift)
    assert (C[[7, 31], 2] > (0.4 * np.array([0.06, 0.3])) ** 2).all()
    assert (np.delete(C[:, 2], [7, 31]) == VARIANCE).mean() > 0.95


def test_a_whole_row_of_wrong_sides_at_the_rim_does_not_pass_for_the_wings_bending() -> None:
    shift = np.zeros(COUNT)
    shift[:10] = 2.0 * EVEN_PX
    assert (widened(0.9 * shift)[:10, 2] > 0.1**2).all()


def test_what_cells_at_a_border_differ_by_from_the_rest_widens_them_and_no_other() -> None:
    rows = np.arange(COUNT) % 10
    border = np.flatnonzero((rows == 9) | (rows == 4))  # of two panels
    shift = np.zeros(COUNT)
    shift[border] = 0.02
    C = widened(shift, at_border=border)[:, 2]
    assert (np.sqrt(C[border]) > 0.8 * 0.01).all() and (np.sqrt(C[border]) < 1.5 * 0.01).all()
    assert (np.delete(C, border) == VARIANCE).mean() > 0.95
    # Without a difference nothing is widened, and one odd cell of them is still odd.
    shift[border] = 0.0
    shift[border[3]] = 0.3
    C = widened(shift, at_border=border)[:, 2]
    assert (C == VARIANCE).mean() > 0.9 and C[border[3]] > 0.14**2
