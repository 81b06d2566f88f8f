"""Points of bent cells, whose sides are measured as straight lines, against the surface that they lie on."""

import numpy as np
from vision_scene import FloatArray, facing, paper_rig, rotation, three_panels

from fsw.vision.blur import PIXEL_VARIANCE
from fsw.vision.bow import unbend
from fsw.vision.grid import CellGrid
from fsw.vision.prediction import RIGID, expect, make_surface, set_pose
from fsw.vision.rig import eyes_of
from fsw.vision.sides import inset_px
from fsw.vision.stereo import make_points, triangulate_cells

BEND_MM, TWIST_MM, CUBIC_MM = 30.0, 12.0, -8.0  # factors of x2, xy and x2 y
BLUR_PX = 0.6


def height_mm(grid: CellGrid, X: FloatArray, Y: FloatArray) -> FloatArray:
    x, y = X / (0.5 * grid.outline_mm[0]) - 1.0, Y / (0.5 * grid.outline_mm[1])
    return BEND_MM * x * x + TWIST_MM * x * y + CUBIC_MM * x * x * y


def straight(px: FloatArray) -> FloatArray:
    """The straight line (3,) nearest to these points (n, 2): a u + b v + c = 0."""
    middle = px.mean(axis=0)
    normal = np.linalg.svd(px - middle)[2][1]
    return np.array([*normal, -normal @ middle])


def test_a_point_is_where_the_bent_cells_centre_is() -> None:
    rig, grid = paper_rig(4096), three_panels()
    R, t = facing(rig, (700.0, 0.0), 725.0, rotation(2.0, -1.0, 3.0))
    surface, eyes, count = make_surface(grid), eyes_of(rig), grid.count
    set_pose(surface, R, t)
    surface.unknowns[RIGID + np.array([3, 4, 5])] = TWIST_MM, BEND_MM, CUBIC_MM
    expected, centre, in_view = np.zeros((2, count, 4, 2)), np.zeros((2, count, 2)), np.zeros((2, count), np.bool_)
    expect(surface, eyes, expected, centre, in_view)
    seen = in_view.all(axis=0)

    def place(xy: FloatArray) -> FloatArray:
        return np.column_stack([xy, height_mm(grid, xy[:, 0], xy[:, 1])]) @ R.T + t

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
    triangulate_cells(eyes, corners, corners.mean(axis=2), covariance, seen, points)
    true = place(grid.centre_mm)
    before = np.abs(points.xyz_mm - true)[seen]
    unbend(surface, eyes, expected, covariance, np.full(2, BLUR_PX), points)
    after = np.abs(points.xyz_mm - true)[seen]
    assert seen.sum() > 200
    assert before[:, 0].max() > 0.002 and before[:, 2].max() > 0.001
    assert after.max() < 0.1 * before.max()
