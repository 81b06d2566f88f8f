"""From checked tables to the arrays that the algorithms take: the rig, the grid of cells, where the wing should be."""

import numpy as np

from fsw.tables.schema import CamerasTable, WingTable
from fsw.vision.acquisition import Prior
from fsw.vision.grid import CellGrid, Panel, make_grid
from fsw.vision.rig import StereoRig


def make_rig(cameras: CamerasTable) -> StereoRig:
    """The stereo rig of cameras.toml."""
    eyes = (cameras.left, cameras.right)
    return StereoRig(
        size=np.array([[eye.width, eye.height] for eye in eyes], dtype=np.int64),
        intrinsics=np.array([[eye.fx, eye.fy, eye.cx, eye.cy] for eye in eyes], dtype=np.float64),
        distortion=np.array([eye.distortion for eye in eyes], dtype=np.float64),
        rotation=np.stack([np.eye(3), np.array(cameras.stereo.rotation)]),
        translation_mm=np.stack([np.zeros(3), np.array(cameras.stereo.translation_mm, dtype=np.float64)]),
    )


def make_wing_grid(wing: WingTable) -> CellGrid:
    """All cells of wing.toml."""
    panels = [Panel(p.origin_mm, p.columns, p.rows, p.pitch_mm, p.cell_mm) for p in wing.panel]
    return make_grid(panels, (wing.wing.length_mm, wing.wing.width_mm), wing.surface.cells_are == "dark")


def make_prior(wing: WingTable) -> Prior:
    """The nominal pose of wing.toml, and how wrong it may be."""
    pose = wing.pose
    return Prior(np.array(pose.rotation), np.array(pose.translation_mm), pose.tolerance_mm, pose.tolerance_deg)
