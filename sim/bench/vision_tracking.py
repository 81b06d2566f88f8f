"""Table `tracking`: what TRACK and ACQUIRE cost on full images, and how near to the Cramer-Rao floor the points are."""

import time
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim.bench.table import Row
from sim.bench.vision_floor import floor_covariance_mm2
from sim.bench.vision_stand import Stand, Truth, bench_scenario, cpu_ms, hardware, load, pair_of, wall_ms
from sim.world import World
from wingbeat.kernels import kernel

FloatArray = NDArray[np.float64]

PAIRS = 24  # drawn beforehand: 0.6 GB at full size
WARM = 3  # pairs before the figures begin: blur and widths of the lines settle
SEARCHES = 5


def tracking(binning: int, seed: int, at_rest: bool) -> list[Row]:
    """One row: processor time of a pair, accuracy against truth, and honesty of the covariance.

    at_rest: the wing stands still, and noise alone moves the points: what fitting and drawing of a moving wing are off
    by shows in the other row only.
    """
    scenario = bench_scenario(binning, PAIRS)
    if at_rest:
        still = [msgspec.structs.replace(e, amplitude_mm=0.0) for e in scenario.excitation]
        scenario = msgspec.structs.replace(scenario, excitation=still)
    world = World(scenario, seed)
    truth = Truth(world)
    pairs = [pair_of(world, tick) for tick in range(PAIRS)]
    stand = Stand(*hardware(scenario), pairs[0])
    searching: list[float] = []
    for left, right in pairs[:SEARCHES]:
        with cpu_ms(searching):
            found = stand.acquire(left, right)
        if not found.ok:
            raise RuntimeError(f"ACQUIRE: {found.reason}")
    stand.acquire(*pairs[0])
    beside = Stand(*hardware(scenario), pairs[0], threads=2)
    beside.acquire(*pairs[0])
    busy, busy_beside, wall, wall_beside, reading = [], [], [], [], []
    xyz = np.full((PAIRS, stand.grid.count, 3), np.nan)
    covariance = np.full((PAIRS, stand.grid.count, 3, 3), np.nan)
    for tick, (left, right) in enumerate(pairs):
        with cpu_ms(busy), wall_ms(wall):
            stand.tick(left, right)
        with cpu_ms(busy_beside), wall_ms(wall_beside):
            beside.tick(left, right)
        reading.append(_read_ms(left, right))
        points = stand.tracker.points
        xyz[tick, points.valid] = points.xyz_mm[points.valid]
        covariance[tick, points.valid] = points.covariance_mm2[points.valid]
    stand.close()
    beside.close()
    row: Row = {
        "table": "tracking",
        "method": "ours",
        "case": f"paper {world.eyes[0].width} x {world.eyes[0].height}, {'at rest' if at_rest else 'in motion'}",
        "cells_in_both": int(truth.in_view(truth.corners_px(WARM)).sum()),
        "track_cpu_ms_median": float(np.median(busy[WARM:])),
        "track_cpu_ms_p99": float(np.percentile(busy[WARM:], 99)),
        "track_wall_ms_median": float(np.median(wall[WARM:])),
        "two_threads_cpu_ms_median": float(np.median(busy_beside[WARM:])),
        "two_threads_wall_ms_median": float(np.median(wall_beside[WARM:])),
        "read_cpu_ms": float(np.median(reading[WARM:])),
        "ratio_to_reading": float(np.median(busy[WARM:]) / np.median(reading[WARM:])),
        "acquire_cpu_ms_an_eye": float(np.median(searching[1:])) / 2.0,
        "load_1min": load(),
    }
    row |= accuracy(world, truth, xyz, covariance)
    return [row]


def accuracy(world: World, truth: Truth, xyz_mm: FloatArray, covariance_mm2: FloatArray) -> dict[str, float]:
    """Errors of the displacements after WARM ticks, against the truth and against the floor.

    xyz_mm (T, N, 3), NaN where not valid; covariance_mm2 (T, N, 3, 3). In-plane and depth: axes of the left camera.
    """
    ticks = range(WARM, len(xyz_mm))
    true = np.stack([truth.centres_mm(tick) for tick in ticks])
    wanted = np.stack([truth.in_view(truth.corners_px(tick)) for tick in ticks])
    error, covariance = (xyz_mm[WARM:] - true), covariance_mm2[WARM:]
    whole = np.isfinite(error[..., 0]).all(axis=0)
    error, covariance = error[:, whole], covariance[:, whole]
    moving = error - error.mean(axis=0)
    freedom = len(ticks) / (len(ticks) - 1.0)  # each cell's mean was taken away
    rms = np.sqrt((moving**2).mean(axis=(0, 1)) * freedom)
    cells = np.flatnonzero(whole)
    floor, own = (
        np.sqrt(np.einsum("nii->ni", floor_covariance_mm2(world, truth, WARM, cells, own_edges)).mean(axis=0))
        for own_edges in (False, True)
    )
    return {
        "coverage": float(np.isfinite(xyz_mm[WARM:, :, 0])[wanted].mean()),
        "displacement_rms_x_mm": float(rms[0]),
        "displacement_rms_y_mm": float(rms[1]),
        "displacement_rms_depth_mm": float(rms[2]),
        "floor_x_mm": float(floor[0]),
        "floor_y_mm": float(floor[1]),
        "floor_depth_mm": float(floor[2]),
        "ratio_to_floor_x": float(rms[0] / floor[0]),
        "ratio_to_floor_y": float(rms[1] / floor[1]),
        "ratio_to_floor_depth": float(rms[2] / floor[2]),
        "ratio_to_own_edges_floor_x": float(rms[0] / own[0]),
        "ratio_to_own_edges_floor_y": float(rms[1] / own[1]),
        "ratio_to_own_edges_floor_depth": float(rms[2] / own[2]),
        "chi_square_displacement": chi_square(moving, covariance) * freedom,
        "chi_square_position": chi_square(error, covariance),
    }


def chi_square(error_mm: FloatArray, covariance_mm2: FloatArray) -> float:
    """Mean of e^T C^-1 e / 3 over errors (..., 3): 1 for an honest covariance."""
    solved = np.linalg.solve(covariance_mm2, error_mm[..., None])[..., 0]
    return float((error_mm * solved).sum(axis=-1).mean() / 3.0)


def _read_ms(left: NDArray[Any], right: NDArray[Any]) -> float:
    """Processor time, ms, of reading every byte of a pair once."""
    before = time.thread_time_ns()
    total = sum_bytes(left) + sum_bytes(right)
    assert total >= 0
    return (time.thread_time_ns() - before) * 1e-6


@kernel
def sum_bytes(image: NDArray[Any]) -> int:
    """Sum of all pixels (h, w)."""
    total = 0
    for i in range(image.shape[0]):
        part = 0
        for j in range(image.shape[1]):
            part += image[i, j]
        total += part
    return total
