"""Table `motion`: a wing that moves fast, or jumps: is a cell taken for its neighbour, and how soon is TRACK back."""

import numpy as np
from numpy.typing import NDArray

from fault.modes import Cause
from hal.frame import make_frames
from sim.bench.table import Row
from sim.bench.vision_stand import Stand, Truth, bench_scenario, hardware
from sim.bench.vision_stress import Score
from sim.world import World

FloatArray = NDArray[np.float64]

TICKS = 10
JUMP_TICK = 3
BACK = 0.95  # of the cells in view: so many valid ones are TRACK again


def motions() -> dict[str, FloatArray]:
    """How far (TICKS,) the whole wing is moved, in px of the left image, for each case."""
    tick = np.arange(TICKS)
    return {
        "8 px a frame": 8.0 * tick,
        "8 px a frame, and back": 8.0 * np.abs((tick + 2) % 8 - 4),
        "jump of 30 px": np.where(tick >= JUMP_TICK, 30.0, 0.0),
        "jump of -30 px": np.where(tick >= JUMP_TICK, -30.0, 0.0),
    }


def motion(case: str, seeds: range, binning: int) -> list[Row]:
    """One row: the wing is moved along its Z as a whole, so far that the image of its middle moves by the case's px."""
    score, late, lost = Score(), [], 0
    for seed in seeds:
        ticks, drops = _one_seed(motions()[case], seed, binning, score)
        late.append(ticks)
        lost += drops
    row: Row = {"table": "motion", "method": "ours", "case": case, "seeds": len(seeds)}
    return [row | {"ticks_until_track_max": max(late), "locks_lost": lost} | score.row()]


def _one_seed(moved_px: FloatArray, seed: int, binning: int, score: Score) -> tuple[int, int]:
    """Ticks from the first disturbed one to the last without enough valid cells, and the locks lost on the way."""
    scenario = bench_scenario(binning, TICKS)
    world = World(scenario, seed)
    truth = Truth(world)
    away_mm = moved_px / _px_per_mm(world)
    shape = world.modes.patches.shape[1:]
    stand: Stand | None = None
    begun, late, lost = False, 0, 0
    for tick in range(TICKS):
        images = [make_frames((eye.height, eye.width), world.dtype) for eye in world.eyes]
        bent = np.tensordot(world.modal_mm(tick), world.modes.patches, axes=1).reshape(shape)
        bent[..., 0, 0] += away_mm[tick]
        for eye in (0, 1):
            world.render_bent(tick, eye, bent, images[eye])
        if stand is None:
            stand = Stand(*hardware(scenario), (images[0], images[1]))
        wanted = truth.in_view(truth.corners_px(tick, away_mm[tick]))
        if not begun:
            begun = stand.acquire(images[0], images[1]).ok
        if begun:
            stand.tick(images[0], images[1])
            score.add(
                stand.tracker.points, truth.centres_mm(tick, away_mm[tick]), wanted, world.eyes, f"seed {seed}, {tick}"
            )
            enough = (stand.tracker.points.valid & wanted).sum() >= BACK * wanted.sum()
            if stand.state.causes & Cause.LOCK_LOST:
                stand.state.causes &= ~Cause.LOCK_LOST
                begun, lost = False, lost + 1
        else:
            score.miss(wanted)
            enough = False
        if not enough:
            late = max(0, tick - JUMP_TICK) + 1
    if stand is not None:
        stand.close()
    return late, lost


def _px_per_mm(world: World) -> float:
    """How far the image of the wing's middle moves in the left eye for 1 mm along the wing's Z."""
    x, y = world.scenario.pose.point_mm
    ends = world.pose.to_left(np.array([[x, y, -0.5], [x, y, 0.5]]))
    px = world.eyes[0].project(ends)
    return float(np.linalg.norm(px[1] - px[0]))
