"""The renderer against brute force, and what its images promise: no bias, true noise, the same bytes each time."""

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from hal.drivers.lockstep_clock import LockstepClock
from hal.frame import make_frames
from sim.cameras import SimulatedCamera, SimulatedTrigger
from sim.mapping import STEP_PX, centre_chords
from sim.scenario import Scenario, load_scenario
from sim.surface import heights
from sim.world import World

FloatArray = NDArray[np.float64]

OVERSAMPLE = 20
MARGIN_PX = 5
WINDOW_PX = 28
NEAR_CORNER_PX = 4.0
TICK = 3


def noiseless(scenario: Scenario) -> Scenario:
    camera = replace(scenario.camera, bits=16, full_well_e=1e9, read_noise_e=0.0)
    return replace(scenario, camera=camera, light=replace(scenario.light, background=0.05))


def image(world: World, eye: int, tick: int = TICK) -> NDArray[Any]:
    out = make_frames((world.eyes[eye].height, world.eyes[eye].width), world.dtype)
    world.render(tick, eye, out)
    return out


def reflectance(scenario: Scenario, cells: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """What is painted at wing points; NaN beside the wing. Written from the scenario's words alone."""
    out = np.full(x.shape, np.nan)
    paint, first, ends = scenario.paint, 0, []
    for p in scenario.panel:
        (x0, y0), (px, py), (wx, wy) = p.origin_mm, p.pitch_mm, p.cell_mm
        x1, y1 = x0 + (p.columns - 1) * px + wx, y0 + (p.rows - 1) * py + wy
        bx, by = paint.border_mm
        out[(x > x0 - bx) & (x < x1 + bx) & (y > y0 - by) & (y < y1 + by)] = paint.line
        ends.append((x0 - bx, x1 + bx))
        for i in range(p.columns):
            for j in range(p.rows):
                u, v = x - x0 - i * px, y - y0 - j * py
                if u.max() < 0 or u.min() > wx or v.max() < 0 or v.min() > wy:
                    continue
                out[(u > 0) & (u < wx) & (v > 0) & (v < wy)] = cells[first + i * p.rows + j]
        first += p.columns * p.rows
    for (_, left), (right, _) in pairwise(ends):
        for middle in paint.hinge_y_mm:
            over = (x > left - paint.hinge_overlap_mm) & (x < right + paint.hinge_overlap_mm)
            out[over & (np.abs(y - middle) < paint.hinge_width_mm / 2)] = paint.hinge
    return out


def brute_force(world: World, eye: int, corner: tuple[int, int], size: int) -> FloatArray:
    """Grey values of a window by supersampling; where samples lie on the wing comes from the forward projection."""
    scenario, camera = world.scenario, world.scenario.camera
    bent = world.modes.surface(world.tip_mm[TICK])

    def shape(points: FloatArray) -> FloatArray:
        flat = heights(bent, world.modes.x_mm, world.modes.y_mm, points.reshape(-1, 2))
        return flat.reshape(*points.shape[:-1], 3)

    def seen(points: FloatArray) -> FloatArray:
        wing = np.concatenate([points, shape(points)[..., :1]], axis=-1)
        return world.eyes[eye].project(world.pose.to_left(wing))

    knots = np.arange(-MARGIN_PX - 1, size + MARGIN_PX + 1.0)
    target = np.stack(np.meshgrid(corner[0] + knots, corner[1] + knots), axis=-1)
    points, h = np.full(target.shape, [700.0, 0.0]), 1e-3
    for _ in range(8):
        at = seen(points)
        jacobian = np.stack([(seen(points + step) - at) / h for step in np.eye(2) * h], axis=-1)
        points = points + np.linalg.solve(jacobian, (target - at)[..., None])[..., 0]
    assert np.abs(seen(points) - target).max() < 1e-6

    steps = (np.arange((size + 2 * MARGIN_PX) * OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5 - MARGIN_PX
    x, y = (RectBivariateSpline(knots, knots, points[..., k])(steps, steps) for k in (0, 1))
    bend = shape(np.stack([x, y], axis=-1))
    normal = np.stack([-bend[..., 1], -bend[..., 2], np.ones_like(x)], axis=-1)
    lamp, wing = scenario.light, scenario.wing
    facing = normal @ np.array(lamp.direction) / np.linalg.norm(normal, axis=-1) / lamp.direction[2]
    uneven = 1.0 + lamp.gradient[0] * (x / wing.length_mm - 0.5) + lamp.gradient[1] * y / wing.width_mm
    painted = reflectance(scenario, world.art.cells, x, y)
    level = 65535.0 * lamp.level_per_ms * camera.exposure_ms
    grey = np.where(np.isnan(painted), lamp.background, painted * facing * uneven) * level
    blurred = gaussian_filter(grey, camera.psf_sigma_px * OVERSAMPLE, truncate=5.0)
    inner = slice(MARGIN_PX * OVERSAMPLE, -MARGIN_PX * OVERSAMPLE)
    return blurred[inner, inner].reshape(size, OVERSAMPLE, size, OVERSAMPLE).mean(axis=(1, 3))


def corner_points(world: World) -> FloatArray:
    """Where lines cross or end, (P, 2) on the wing: there the blur of two edges is not the product of theirs."""
    out = []
    paint, before = world.scenario.paint, None
    for p in world.scenario.panel:
        (x0, y0), (px, py), (wx, wy) = p.origin_mm, p.pitch_mm, p.cell_mm
        x = (x0 + np.arange(p.columns)[:, None] * px + [0.0, wx]).ravel()
        y = (y0 + np.arange(p.rows)[:, None] * py + [0.0, wy]).ravel()
        outline_x = np.array([x[0] - paint.border_mm[0], x[-1] + paint.border_mm[0]])
        out.append(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
        out.append(np.stack(np.meshgrid(outline_x, [y[0] - paint.border_mm[1], y[-1] + paint.border_mm[1]]), axis=-1))
        if before is not None:
            over = paint.hinge_overlap_mm
            ends = [before - over, before, outline_x[0], outline_x[0] + over]
            sides = np.add.outer(paint.hinge_y_mm, [-paint.hinge_width_mm / 2, paint.hinge_width_mm / 2]).ravel()
            out.append(np.stack(np.meshgrid(ends, sides), axis=-1))
        before = outline_x[1]
    return np.concatenate([part.reshape(-1, 2) for part in out])


def edge_shifts(exact: FloatArray, drawn: FloatArray, corners: FloatArray, axis: int) -> FloatArray:
    """How far each edge that crosses this axis (0: x) lies off in `drawn`, px: least squares on its steepest pixels.

    corners (P, 2): places in the window, as x, y, near which no edge is looked at.
    """
    e, d = (exact, drawn) if axis == 0 else (exact.T, drawn.T)
    places = corners if axis == 0 else corners[:, ::-1]
    slope = np.gradient(e, axis=1)
    steep = np.abs(slope)
    inner = steep[:, 2:-2]
    rows, at = np.nonzero((inner >= steep[:, 1:-3]) & (inner > steep[:, 3:-1]) & (inner > 0.15 * np.ptp(e)))
    at += 2
    far = np.hypot(at[:, None] - places[:, 0], rows[:, None] - places[:, 1]).min(axis=1) > NEAR_CORNER_PX
    rows, window = rows[far, None], at[far, None] + np.arange(-1, 2)
    g = slope[rows, window]
    return -((d - e)[rows, window] * g).sum(axis=1) / (g * g).sum(axis=1)


def changed(k1: float = 0.0, psf_px: float = 0.6) -> Scenario:
    scenario = noiseless(load_scenario("small"))
    scenario = replace(scenario, camera=replace(scenario.camera, psf_sigma_px=psf_px))
    lens = (k1, -k1 / 5.0, k1 / 100.0, -k1 / 200.0, 0.0)
    return replace(
        scenario, left=replace(scenario.left, distortion=lens), right=replace(scenario.right, distortion=lens)
    )


AMID_PANEL, HINGE, LOWER_EDGE, FAR_CORNER = (0, (500, 350)), (0, (195, 160)), (0, (330, 630)), (1, (980, 125))
CASES = {
    "straight": (changed(), (AMID_PANEL, HINGE, LOWER_EDGE, FAR_CORNER)),
    "distorted": (changed(k1=-0.12), (AMID_PANEL, LOWER_EDGE, (1, (5, 300)))),
    "soft": (changed(psf_px=1.0), (AMID_PANEL, HINGE)),
}


def test_straight_lines_between_nodes_are_right_on_average() -> None:
    j, i = np.meshgrid(np.arange(97.0), np.arange(65.0))
    exact = np.stack([0.24 * j / (1.0 - 2e-4 * j - 1e-4 * i), 0.25 * i / (1.0 + 1e-4 * j - 3e-4 * i)], axis=-1)
    nodes = np.zeros((17, 25, 5))
    nodes[..., :2] = exact[::STEP_PX, ::STEP_PX]

    def off() -> FloatArray:
        ends = (np.arange(17.0) * STEP_PX, np.arange(25.0) * STEP_PX)
        drawn = [RectBivariateSpline(*ends, nodes[..., k], kx=1, ky=1)(i[:, 0], j[0]) for k in (0, 1)]
        return np.abs((np.stack(drawn, axis=-1) - exact)[:-1, :-1].mean(axis=(0, 1)))

    chords = off()
    centre_chords(nodes, *np.zeros((2, 25, 2)))
    assert (off() < 0.1 * chords).all()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.requirement("WB-SIM-01")
def test_edges_lie_where_brute_force_puts_them(case: str) -> None:
    scenario, windows = CASES[case]
    world = World(scenario)
    for eye, corner in windows:
        part = slice(corner[1], corner[1] + WINDOW_PX), slice(corner[0], corner[0] + WINDOW_PX)
        drawn = image(world, eye)[part].astype(np.float64)
        exact = brute_force(world, eye, corner, WINDOW_PX)
        on_wing = corner_points(world)
        bent = heights(world.modes.surface(world.tip_mm[TICK]), world.modes.x_mm, world.modes.y_mm, on_wing)
        places = world.eyes[eye].project(world.pose.to_left(np.column_stack([on_wing, bent[:, 0]]))) - corner
        shifts = np.concatenate([edge_shifts(exact, drawn, places, axis) for axis in (0, 1)])
        assert len(shifts) > 20
        assert np.abs(shifts).max() < 0.005
        assert abs(shifts.mean()) < 0.002
        # Where two edges meet their blurs are multiplied, which is exact for lines at right angles in the image.
        assert np.abs(drawn - exact).max() < 0.03 * np.ptp(exact)


def test_the_truth_names_each_cell_and_its_place() -> None:
    world = World(changed())
    truth, cells = world.truth(), world.art.cells
    for eye, name in enumerate(("uv_left", "uv_right")):
        drawn, uv = image(world, eye), truth[name][TICK]
        inside = (uv > 10.0).all(axis=1) & (uv < np.array(drawn.shape[::-1]) - 10.0).all(axis=1)
        u, v = uv[inside].round().astype(int).T
        light = drawn[v, u] / cells[inside]
        surface = np.column_stack([np.ones(inside.sum()), truth["cells_XY"][inside], truth["cells_XY"][inside] ** 2])
        fit = surface @ np.linalg.lstsq(surface, light, rcond=None)[0]
        assert inside.sum() > 250
        assert np.abs(light / fit - 1.0).max() < 0.01


def test_noise_is_shot_and_read_noise_and_never_the_same() -> None:
    scenario = load_scenario("small")
    still = replace(scenario, excitation=[replace(scenario.excitation[0], amplitude_mm=0.0)], duration_s=4.0)
    noisy = World(still)
    frames = np.stack([image(noisy, 0, tick)[100:300].astype(np.float64) for tick in range(50)])
    mean, variance = frames.mean(axis=0), frames.var(axis=0, ddof=1)
    electron = 255.0 / still.camera.full_well_e
    expected = mean * electron + (still.camera.read_noise_e * electron) ** 2 + 1.0 / 12.0
    for low, high in ((20, 30), (30, 45), (120, 220)):
        some = (mean > low) & (mean < high)
        assert some.sum() > 1000
        assert variance[some].mean() == pytest.approx(expected[some].mean(), rel=0.05)
    exact = World(replace(noiseless(still), light=still.light))
    level = image(exact, 0, 0)[100:300] / 65535.0 * 255.0
    assert abs((mean - level)[level > 20.0].mean()) < 0.02
    noise = (frames[:4] - mean)[:, level > 20.0]
    assert np.abs(np.corrcoef(noise) - np.eye(4)).max() < 0.04


def test_bytes_depend_on_seed_eye_and_tick_alone() -> None:
    scenario = load_scenario("small")
    first, again, other = World(scenario), World(scenario), World(scenario, seed=2)
    want = [[image(first, eye, tick) for eye in (0, 1)] for tick in (0, 1)]
    with ThreadPoolExecutor(2) as pool:
        for tick in (1, 0):
            for eye, got in enumerate(pool.map(lambda e, t=tick: image(again, e, t), (0, 1))):
                np.testing.assert_array_equal(got, want[tick][eye])
    assert not np.array_equal(image(other, 0, 0), want[0][0])


def test_a_shorter_run_begins_with_the_same_images() -> None:
    scenario = load_scenario("small")
    np.testing.assert_array_equal(image(World(replace(scenario, duration_s=1.0)), 0), image(World(scenario), 0))


@pytest.mark.parametrize("prerender", [False, True])
def test_cameras_hand_over_each_edge_s_image_once(prerender: bool) -> None:
    scenario = replace(load_scenario("small"), duration_s=0.4)
    world, same = World(scenario), World(scenario)
    trigger = SimulatedTrigger(world, LockstepClock())
    cameras = [SimulatedCamera(world, eye, trigger, prerender) for eye in (0, 1)]
    out = make_frames((750, 1024), np.uint8)
    assert cameras[0].grab(out).status == 1
    seen = 0
    while edge := trigger.wait():
        assert edge.time_ns == world.times_ns[edge.tick]
        if edge.tick != 2:  # nobody fetches this one
            for eye, camera in enumerate(cameras):
                assert tuple(camera.grab(out)) == (edge.tick, seen, edge.time_ns, 0, eye)
                np.testing.assert_array_equal(out, image(same, eye, edge.tick))
            seen += 1
            assert cameras[0].grab(out).status == 1
    assert seen == 5
    for camera in cameras:
        camera.close()
