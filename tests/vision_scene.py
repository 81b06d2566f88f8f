"""A small renderer for tests of the search: exact rays onto a bent wing, light and faults to choose."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.grid import CellGrid, Panel, make_grid
from fsw.vision.rig import StereoRig
from hal.frame import as_frame

FloatArray = NDArray[np.float64]
Field = Callable[[FloatArray, FloatArray], FloatArray]


def paper_rig(width: int = 1024, distortion: tuple[float, ...] = (0.0,) * 5) -> StereoRig:
    """The paper's cameras (Table 2, Eq. 42 transposed), scaled to this image width."""
    k = width / 4096
    K = np.array([[4703.987, 4703.112, 2079.232, 1475.465], [4725.708, 4723.714, 2052.554, 1490.441]])
    K[:, 2:] += 0.5
    K *= k
    K[:, 2:] -= 0.5
    U, _, Vt = np.linalg.svd(
        np.array([[0.99163, 0.12630, -0.02675], [-0.11764, 0.79857, -0.59029], [-0.05319, 0.58849, 0.80674]])
    )
    size = np.tile([width, round(3000 * k)], (2, 1))
    rotation = np.stack([np.eye(3), (U @ Vt).T])
    shift = np.array([[0.0] * 3, [16.59488, -425.66317, 138.84437]])
    return StereoRig(size, K, np.tile(distortion, (2, 1)), rotation, shift)


def three_panels(dark: bool = True, gap_mm: float = 22.0) -> CellGrid:
    """3 x 13 x 18 cells on 1600 x 400 mm; gap_mm from cell to cell across a fold."""
    pitch, cell = (39.6, 21.8), (37.6, 19.8)
    span = 12 * pitch[0] + cell[0]
    origins = [(5.0 + p * (span + gap_mm), -195.0) for p in range(3)]
    return make_grid([Panel(o, 13, 18, pitch, cell) for o in origins], (1600.0, 400.0), dark)


def rotation(x_deg: float = 0.0, y_deg: float = 0.0, z_deg: float = 0.0) -> FloatArray:
    """Rotation about x, then y, then z."""
    axes = zip((x_deg, y_deg, z_deg), np.eye(3), strict=True)
    x, y, z = (cv2.Rodrigues(np.deg2rad(angle) * axis)[0] for angle, axis in axes)
    return z @ y @ x


def facing(
    rig: StereoRig, look_mm: tuple[float, float], range_mm: float, turn: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pose that shows the wing point look_mm on the line between both optical axes, at this range, turned by `turn`."""
    centre = -rig.rotation[1].T @ rig.translation_mm[1]
    aim = np.array([0.0, 0.0, 1.0]) + rig.rotation[1][2]
    aim /= np.linalg.norm(aim)
    middle = 0.5 * centre + range_mm * aim
    across = np.array([1.0, 0.0, 0.0]) - aim[0] * aim
    across /= np.linalg.norm(across)
    base = np.column_stack((across, -np.cross(aim, across), -aim))
    R = base @ turn
    return R, middle - R @ np.array([*look_mm, 0.0])


@dataclass
class Scene:
    """A wing in front of the cameras. light, gloss, bend: functions of wing X, Y in mm."""

    rig: StereoRig
    grid: CellGrid
    R: FloatArray
    t: FloatArray
    bend: Field = lambda x, y: 0.0 * x
    light: Field = lambda x, y: 1.0 + 0.0 * x
    gloss: Field = lambda x, y: 0.0 * x
    background: float | str = 0.0
    border_mm: float = 5.0
    noise: float = 0.004
    blur_px: float = 0.7
    spread: float = 0.4
    bits: int = 8
    seed: int = 1
    over: int = 3
    hidden: tuple[int, ...] = field(default_factory=tuple)

    def but(self, **changes: object) -> "Scene":
        return replace(self, **changes)  # type: ignore[arg-type]  # a test helper: any field

    def wing_points(self, eye: int, px: FloatArray) -> FloatArray:
        """Wing X, Y (..., 2) that these image pixels show."""
        ideal = self.rig.undistort(eye, px)
        K, Re, te = self.rig.matrix(eye), self.rig.rotation[eye], self.rig.translation_mm[eye]
        ray = np.concatenate([(ideal - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones((*px.shape[:-1], 1))], axis=-1)
        R, t = Re @ self.R, Re @ self.t + te
        origin, d = -R.T @ t, ray @ R
        z = np.zeros(px.shape[:-1])
        for _ in range(4):
            s = (z - origin[2]) / d[..., 2]
            xy = origin[:2] + s[..., None] * d[..., :2]
            inside = np.clip(xy, [0, -300], [self.grid.outline_mm[0], 300])
            z = self.bend(inside[..., 0], inside[..., 1])
        return np.where((s > 0)[..., None], xy, -1e4)

    def truth_px(self, eye: int) -> FloatArray:
        """Ideal pixels (N, 4, 2) of the cells' corners."""
        xy = self.grid.corners_mm
        xyz = np.concatenate([xy, self.bend(xy[..., 0], xy[..., 1])[..., None]], axis=-1)
        return self.rig.project_ideal(eye, xyz @ self.R.T + self.t)

    def visible(self, eye: int) -> NDArray[np.bool_]:
        """Cells (N,) that lie wholly in the image."""
        px = self.rig.distort(eye, self.truth_px(eye))
        return np.all((px > 1.0) & (px < self.rig.size[eye] - 2.0), axis=(1, 2))

    def image(self, eye: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        width, height = self.rig.size[eye]
        rng = np.random.default_rng(self.seed + 17 * eye)
        n = self.over
        grey = np.zeros((height, width))
        cells = 0.16 * (1.0 + self.spread * (2.0 * np.random.default_rng(self.seed).random(self.grid.count) - 1.0))
        for i in range(n):
            for j in range(n):
                u, v = np.meshgrid(np.arange(width) + (i + 0.5) / n - 0.5, np.arange(height) + (j + 0.5) / n - 0.5)
                grey += self._shade(self.wing_points(eye, np.stack([u, v], axis=-1)), cells, u, v)
        grey = cv2.GaussianBlur(grey / n**2, (0, 0), self.blur_px)
        grey += rng.normal(0.0, self.noise, grey.shape)
        top = 2**self.bits - 1
        return as_frame(np.clip(np.round(grey * top), 0, top).astype(np.uint8 if self.bits == 8 else np.uint16))

    def _shade(self, xy: FloatArray, cells: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        x, y = xy[..., 0], xy[..., 1]
        sky = 0.0 * x
        if self.background == "earth":
            sky = 0.75 + 0.25 * np.sin(u / 37.0 + np.sin(v / 23.0)) * np.sin(v / 41.0 + 2 * np.sin(u / 61.0))
        else:
            sky += float(self.background)
        grey, first = sky, 0
        line, tone = (0.6, cells) if self.grid.dark else (0.12, cells + 0.45)
        for p in self.grid.panels:
            a = (x - p.origin_mm[0]) / p.pitch_mm[0]
            b = (y - p.origin_mm[1]) / p.pitch_mm[1]
            column, row = np.floor(a).astype(int), np.floor(b).astype(int)
            on = (column >= 0) & (column < p.columns) & (row >= 0) & (row < p.rows)
            on &= ((a - column) * p.pitch_mm[0] < p.cell_mm[0]) & ((b - row) * p.pitch_mm[1] < p.cell_mm[1])
            end = np.array(p.origin_mm) + np.array(p.pitch_mm) * (p.columns - 1, p.rows - 1) + p.cell_mm
            panel = (x > p.origin_mm[0] - self.border_mm) & (x < end[0] + self.border_mm)
            panel &= (y > p.origin_mm[1] - self.border_mm) & (y < end[1] + self.border_mm)
            n = first + np.clip(column, 0, p.columns - 1) * p.rows + np.clip(row, 0, p.rows - 1)
            hidden = on & np.isin(n, self.hidden)
            shade = np.where(on & ~hidden, tone[n] + self.gloss(x, y), line) * self.light(x, y)
            grey = np.where(panel, shade, grey)
            first += p.columns * p.rows
        # Two hinges a fold, lying over the borders.
        for p, q in zip(self.grid.panels[:-1], self.grid.panels[1:], strict=True):
            fold = 0.5 * (p.origin_mm[0] + p.pitch_mm[0] * p.columns + q.origin_mm[0])
            for hinge_y in (-120.0, 130.0):
                hinge = (np.abs(x - fold) < 10.0) & (np.abs(y - hinge_y) < 10.0)
                grey = np.where(hinge, 0.4 * self.light(x, y), grey)
        return grey
