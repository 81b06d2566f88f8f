"""Points of bent cells, whose sides are measured as straight lines, against the surface that they lie on."""

import numpy as np
import pytest
from vision_scene import FloatArray, facing, paper_rig, rotation, three_panels

from fsw.vision.blur import PIXEL_VARIANCE
from fsw.vision.bow import Bow, fit_kinks, make_bow, tilt_extents, unbend
from fsw.vision.corners import corners_and_centre, make_cells
from fsw.vision.fitting import fit_surface, make_normal
from fsw.vision.grid import CellGrid
from fsw.vision.perspective import extent_across, side_normal
from fsw.vision.prediction import BENDING, RIGID, Surface, expect, locate, make_surface, set_pose
from fsw.vision.rig import eyes_of
from fsw.vision.sides import inset_px
from fsw.vision.stereo import Points, make_points, triangulate_cells

BEND_MM, TWIST_MM, CUBIC_MM, ACROSS_MM = 30.0, 12.0, -8.0, -6.0  # factors of x2, xy, x2 y and y2
KINK_MM = 0.5  # at the first fold: what 500 N m/rad yield under this bend
BLUR_PX = 0.6


def height_mm(grid: CellGrid, xy: FloatArray, kink_mm: float = KINK_MM, hinge_mm: float = 0.0) -> FloatArray:
    x, y = xy[..., 0] / (0.5 * grid.outline_mm[0]) - 1.0, xy[..., 1] / (0.5 * grid.outline_mm[1])
    fold = (grid.folds_mm[0] + hinge_mm) / (0.5 * grid.outline_mm[0]) - 1.0
    bent = BEND_MM * x * x + TWIST_MM * x * y + CUBIC_MM * x * x * y + ACROSS_MM * y * y
    return bent + kink_mm * np.maximum(x - fold, 0.0)


def straight(px: FloatArray) -> FloatArray:
    """The straight line (3,) nearest to these points (n, 2): a u + b v + c = 0."""
    middle = px.mean(axis=0)
    normal = np.linalg.svd(px - middle)[2][1]
    return np.array([*normal, -normal @ middle])


def bows_mm(grid: CellGrid, surface: Surface, bow: Bow) -> FloatArray:
    """Bows (N, 2) along X and Y as `unbend` sees them."""
    return bow.rise @ (surface.unknowns[RIGID : RIGID + BENDING] + bow.factor[:BENDING])


def true_bows_mm(grid: CellGrid) -> FloatArray:
    side = 0.5 * (grid.corners_mm + np.roll(grid.corners_mm, -1, axis=1))
    middle, ends = height_mm(grid, grid.centre_mm), height_mm(grid, side)
    return np.stack([middle - 0.5 * (ends[:, 1] + ends[:, 3]), middle - 0.5 * (ends[:, 0] + ends[:, 2])], axis=1)


def points_at(xyz_mm: FloatArray, seen: np.ndarray) -> Points:
    points = make_points(len(seen))
    points.xyz_mm[seen], points.valid[:], points.sigma_mm[seen] = xyz_mm[seen], seen, 1e-3
    return points


def test_folds_lie_in_the_middle_between_panels() -> None:
    grid = three_panels()
    X = grid.corners_mm[..., 0]
    ends = [(X[grid.cell[:, 0] == p].min(), X[grid.cell[:, 0] == p].max()) for p in range(3)]
    assert grid.folds_mm == pytest.approx([0.5 * (ends[0][1] + ends[1][0]), 0.5 * (ends[1][1] + ends[2][0])])


@pytest.mark.parametrize("hinge_mm", [0.0, -4.0, 4.0])
def test_a_kink_at_a_fold_is_not_taken_for_curvature_wherever_in_the_gap_the_hinge_lies(hinge_mm: float) -> None:
    grid, normal = three_panels(), make_normal(three_panels().count)
    seen = (grid.centre_mm[:, 0] > 410.0) & (grid.centre_mm[:, 0] < 1020.0)  # what the paper's cameras see
    for R in (np.eye(3), rotation(20.0, -10.0, 5.0)):
        surface = make_surface(grid)
        set_pose(surface, R, np.array([0.0, 0.0, 725.0]))
        bow = make_bow(grid, surface)
        z = height_mm(grid, grid.centre_mm, 10.0 * KINK_MM, hinge_mm)
        places = np.column_stack([grid.centre_mm, z]) @ R.T + surface.translation_mm
        points = points_at(places, seen)
        fit_surface(surface, points.xyz_mm, points.sigma_mm, points.valid, 2.0, normal, np.zeros(grid.count))
        bow.factor[:] = 0.0
        rounded = np.abs(bows_mm(grid, surface, bow) - true_bows_mm(grid))[seen]
        fit_kinks(surface, points, bow)
        fitted = np.abs(bows_mm(grid, surface, bow) - true_bows_mm(grid))[seen]
        assert rounded.max() > 0.001
        assert fitted.max() < 0.1 * rounded.max()


def test_folds_out_of_view_leave_the_surface_as_it_is() -> None:
    grid, normal = three_panels(), make_normal(three_panels().count)
    seen = grid.cell[:, 0] == 1
    surface = make_surface(grid)
    set_pose(surface, np.eye(3), np.array([0.0, 0.0, 725.0]))
    bow = make_bow(grid, surface)
    places = np.column_stack([grid.centre_mm, height_mm(grid, grid.centre_mm, 0.0)]) + surface.translation_mm
    points = points_at(places, seen)
    for _ in range(3):
        fit_surface(surface, points.xyz_mm, points.sigma_mm, points.valid, 2.0, normal, np.zeros(grid.count))
    fit_kinks(surface, points, bow)
    assert np.abs(bows_mm(grid, surface, bow) - true_bows_mm(grid))[seen].max() < 1e-4
    points.valid[:] = False
    fit_kinks(surface, points, bow)
    assert (bow.factor == 0.0).all()


def test_a_twisted_cells_middle_is_that_of_its_corners() -> None:
    """Its diagonals are skew: where their images cross is off to opposite sides in the two eyes."""
    rig, grid = paper_rig(4096), three_panels()
    R, t = facing(rig, (700.0, 0.0), 725.0, rotation(2.0, -1.0, 3.0))
    surface, eyes, count = make_surface(grid), eyes_of(rig), grid.count
    set_pose(surface, R, t)
    surface.unknowns[RIGID + 3] = TWIST_MM
    corners, depth = np.zeros((2, count, 4, 2)), np.zeros((2, count, 4))
    in_view = np.zeros((2, count), np.bool_)
    expect(surface, eyes, corners, depth, np.zeros((2, count, 2)), in_view)
    still = np.zeros(4)
    for n in np.flatnonzero(in_view.all(axis=0)):
        middle = np.mean([locate(surface, n, k) for k in range(4)], axis=0)
        for eye in (0, 1):
            cells, c = make_cells(count), corners[eye, n]
            nx, ny = np.transpose([side_normal(c, k)[1:] for k in range(4)])
            corners_and_centre(c, depth[eye, n], np.array(nx), np.array(ny), still, still, still, n, cells)
            assert cells.centre_px[n] == pytest.approx(rig.project_ideal(eye, middle[None])[0], abs=1e-6)


def test_a_point_is_where_the_bent_cells_centre_is() -> None:
    rig, grid = paper_rig(4096), three_panels()
    R, t = facing(rig, (700.0, 0.0), 725.0, rotation(2.0, -1.0, 3.0))
    surface, eyes, count = make_surface(grid), eyes_of(rig), grid.count
    set_pose(surface, R, t)
    surface.unknowns[RIGID + np.array([3, 4, 5, 7])] = TWIST_MM, BEND_MM, CUBIC_MM, ACROSS_MM
    expected, centre, in_view = np.zeros((2, count, 4, 2)), np.zeros((2, count, 2)), np.zeros((2, count), np.bool_)
    expect(surface, eyes, expected, np.zeros((2, count, 4)), centre, in_view)
    seen = in_view.all(axis=0)

    def place(xy: FloatArray) -> FloatArray:
        return np.column_stack([xy, height_mm(grid, xy)]) @ R.T + t

    corners = np.full((2, count, 4, 2), np.nan)
    for n in np.flatnonzero(seen):
        for eye in (0, 1):
            lines = []
            for k in range(4):
                length = float(np.linalg.norm(expected[eye, n, (k + 1) % 4] - expected[eye, n, k]))
                inset = inset_px(length, float(np.sqrt(BLUR_PX**2 + PIXEL_VARIANCE))) / length
                share = np.linspace(inset, 1.0 - inset, 101)[:, None]
                way = (1.0 - share) * grid.corners_mm[n, k] + share * grid.corners_mm[n, (k + 1) % 4]
                lines.append(straight(rig.project_ideal(eye, place(way))))
            for k in range(4):
                u = np.cross(lines[k - 1], lines[k])
                corners[eye, n, k] = u[:2] / u[2]
    points = make_points(count)
    covariance = np.tile([2e-5, 1e-6, 1e-5], (2, count, 1))
    triangulate_cells(eyes, corners, corners.mean(axis=2), covariance, seen, (seen, seen), points)
    true = place(grid.centre_mm)
    before = np.abs(points.xyz_mm - true)[seen]
    normal, distance = make_normal(count), np.zeros(count)
    fit_surface(surface, points.xyz_mm, points.sigma_mm, points.valid, 2.0, normal, distance)
    bow = make_bow(grid, surface)
    fit_kinks(surface, points, bow)
    told, points.between_mm[seen] = points.covariance_mm2[seen], (0.0, 0.0, 0.01)
    unbend(surface, eyes, expected, covariance, np.full((2, 2), BLUR_PX), bow, points)
    assert points.covariance_mm2[seen] - told == pytest.approx(np.tile(np.diag([0.0, 0.0, 1e-4]), (seen.sum(), 1, 1)))
    assert points.sigma_mm[seen] ** 2 == pytest.approx(np.trace(told, axis1=1, axis2=2) + 1e-4)
    after = np.abs(points.xyz_mm - true)[seen]
    assert seen.sum() > 200
    assert before[:, 0].max() > 0.002 and before[:, 2].max() > 0.001
    assert after.max() < 0.05 * before.max()


def test_cells_beside_a_fold_are_expected_as_long_as_their_panel_shows_them() -> None:
    rig, grid, normal = paper_rig(4096), three_panels(), make_normal(three_panels().count)
    R, t = facing(rig, (700.0, 0.0), 725.0, rotation(2.0, -20.0, 3.0))
    surface, eyes, count = make_surface(grid), eyes_of(rig), grid.count
    set_pose(surface, R, t)
    bow = make_bow(grid, surface)
    places = np.column_stack([grid.centre_mm, height_mm(grid, grid.centre_mm, 4.0 * KINK_MM)]) @ R.T + t
    expected, centre, in_view = np.zeros((2, count, 4, 2)), np.zeros((2, count, 2)), np.zeros((2, count), np.bool_)
    expect(surface, eyes, expected, np.zeros((2, count, 4)), centre, in_view)
    seen = in_view.all(axis=0)
    points = points_at(places, seen)
    for _ in range(3):
        fit_surface(surface, points.xyz_mm, points.sigma_mm, points.valid, 2.0, normal, np.zeros(count))
    expect(surface, eyes, expected, np.zeros((2, count, 4)), centre, in_view)
    fit_kinks(surface, points, bow)
    tilted = np.zeros((2, count, 2))
    tilt_extents(surface, eyes, expected, np.ones(count, dtype=np.bool_), bow, tilted)
    corners = np.concatenate([grid.corners_mm, height_mm(grid, grid.corners_mm, 4.0 * KINK_MM)[..., None]], axis=2)
    for eye in (0, 1):
        true = rig.project_ideal(eye, (corners @ R.T + t).reshape(-1, 3)).reshape(-1, 4, 2)
        for axis in (0, 1):
            off = np.zeros((count, 2))
            for n in np.flatnonzero(seen):
                _, nx, ny = side_normal(expected[eye, n], axis)
                smooth = extent_across(expected[eye, n], axis, nx, ny)
                off[n, 0] = smooth - extent_across(true[n], axis, nx, ny)
                off[n, 1] = off[n, 0] + tilted[eye, n, axis]
            rounded, fitted = np.abs(off[seen]).max(axis=0)
            assert fitted < 0.01
            assert axis == 0 or fitted < 0.2 * rounded
