"""Tables `stress` and `sensors`: bad light, lenses, sensors and poses: how many cells are measured, is any wrong."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.stereo import Points
from sim.bench.table import Row
from sim.bench.vision_disturbed import Disturbance, Sight, clear_world, light_of, pixels_of
from sim.bench.vision_stand import Stand, Truth, bench_scenario, hardware
from sim.bench.vision_tracking import chi_square
from sim.rig import Eye

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

TICKS = 4  # the first without the disturbance
MOST_HIDDEN = 0.25  # of a side: with more of it under a mask, in either eye, the cell counts as hidden
BAND_PX = 3.0  # of the full image: an edge is hidden where its neighbourhood is
OFF_PX, OFF_SIGMA = 1.0, 5.0
_SAMPLES = 64


@dataclass
class Score:
    """What became of the cells over seeds and ticks; off_px, off_sigma: valid points off by more than the limits."""

    wanted: int = 0
    measured: int = 0
    valid: int = 0
    off_px: int = 0
    off_sigma: int = 0
    worst_px: float = 0.0
    worst_sigma: float = 0.0
    worst_mm: float = 0.0
    squares: float = 0.0  # of valid points' errors, normalised, per axis
    started: int = 0
    least_recall: float = 1.0
    wrong: list[str] = field(default_factory=list)  # seed, tick and cells, for whoever looks for the cause

    def add(self, points: Points, true_mm: FloatArray, wanted: Mask, eyes: Iterable[Eye], where: str) -> None:
        """Judge one tick's points (N,) against truth (N, 3); wanted (N,): in view and not hidden."""
        valid = points.valid
        error = points.xyz_mm - true_mm
        px = np.zeros(len(valid))
        for eye in eyes:
            px = np.fmax(px, np.linalg.norm(eye.project(points.xyz_mm) - eye.project(true_mm), axis=1))
        sigma = np.abs(error / np.sqrt(np.einsum("nii->ni", points.covariance_mm2))).max(axis=1)
        far, unlikely = valid & ~(px <= OFF_PX), valid & ~(sigma <= OFF_SIGMA)
        self.wanted += int(wanted.sum())
        self.measured += int((valid & wanted).sum())
        self.least_recall = min(self.least_recall, float((valid & wanted).sum() / max(1, wanted.sum())))
        self.valid += int(valid.sum())
        self.off_px += int(far.sum())
        self.off_sigma += int(unlikely.sum())
        if valid.any():
            self.worst_px = max(self.worst_px, float(px[valid].max()))
            self.worst_sigma = max(self.worst_sigma, float(sigma[valid].max()))
            self.worst_mm = max(self.worst_mm, float(np.linalg.norm(error[valid], axis=1).max()))
            self.squares += chi_square(error[valid], points.covariance_mm2[valid]) * float(valid.sum())
        if far.any():
            self.wrong.append(f"{where}: cells {np.flatnonzero(far).tolist()}, px {np.round(px[far], 1).tolist()}")

    def miss(self, wanted: Mask) -> None:
        """Nothing was found in this tick."""
        self.wanted += int(wanted.sum())
        self.least_recall = 0.0

    def row(self) -> Row:
        """The figures."""
        return {
            "cells": self.wanted,
            "recall": self.measured / max(1, self.wanted),
            "least_recall": self.least_recall,
            "valid": self.valid,
            "off_1_px": self.off_px,
            "off_5_sigma": self.off_sigma,
            "worst_px": self.worst_px,
            "worst_sigma": self.worst_sigma,
            "worst_mm": self.worst_mm,
            "chi_square": self.squares / self.valid if self.valid else None,
        }


def stress(table: str, disturbance: Disturbance, seeds: range, binning: int) -> list[Row]:
    """Two rows: searched in a disturbed image and then tracked, and tracked after a search in a good one."""
    names = {"ours, from ACQUIRE": Score(), "ours, in TRACK": Score()}
    for seed in seeds:
        _one_seed(disturbance, seed, binning, *names.values())
    return [
        {"table": table, "method": name, "case": disturbance.name, "seeds": len(seeds), "started": score.started}
        | score.row()
        for name, score in names.items()
    ]


def _one_seed(disturbance: Disturbance, seed: int, binning: int, searched: Score, tracked: Score) -> None:
    scenario = bench_scenario(binning, TICKS)
    if disturbance.alter is not None:
        scenario = disturbance.alter(scenario, np.random.default_rng([seed, 90]))
    world = clear_world(scenario, seed)
    truth = Truth(world)
    good = [pixels_of(light_of(world, 0, eye), scenario, 1.0, (seed, 0, eye)) for eye in (0, 1)]
    stands = [Stand(*hardware(scenario), (good[0], good[1])) for _ in range(2)]
    begun = [False, stands[1].acquire(good[0], good[1]).ok]
    for tick in range(1, TICKS):
        images, hidden = [], np.zeros(len(world.cells_mm), np.bool_)
        corners, true_mm = truth.corners_px(tick), truth.centres_mm(tick)
        for eye in (0, 1):
            light = light_of(world, tick, eye)
            if disturbance.shine is not None:
                draw = np.random.default_rng([seed, eye, 93])
                mask = disturbance.shine(light, Sight(world, eye, tick, binning, draw))
                if mask is not None:
                    hidden |= hidden_cells(mask, corners[eye], BAND_PX / binning)
            images.append(pixels_of(light, scenario, disturbance.noise, (seed, tick, eye)))
        wanted = truth.in_view(corners) & ~hidden
        if tick == 1:
            begun[0] = stands[0].acquire(images[0], images[1]).ok
            searched.started += begun[0]
            tracked.started += begun[1]
        for stand, score, ready in zip(stands, (searched, tracked), begun, strict=True):
            if not ready:
                score.miss(wanted)
                continue
            stand.tick(images[0], images[1])
            score.add(stand.tracker.points, true_mm, wanted, world.eyes, f"seed {seed}, tick {tick}")
    for stand in stands:
        stand.close()


def hidden_cells(mask: NDArray[Any], corners_px: FloatArray, band_px: float) -> Mask:
    """Cells (N,) of which more than MOST_HIDDEN of a side's neighbourhood lies under a mask (h, w)."""
    height, width = mask.shape
    start, end = corners_px, np.roll(corners_px, -1, axis=1)
    along = end - start
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.linalg.norm(along, axis=-1, keepdims=True)
    share = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    hit = np.zeros((*corners_px.shape[:2], _SAMPLES), np.bool_)
    for off in (-band_px, 0.0, band_px):
        px = start[:, :, None] + share[:, None] * along[:, :, None] + off * normal[:, :, None]
        x, y = np.rint(px[..., 0]), np.rint(px[..., 1])
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        at = np.where(inside, y, 0).astype(np.int64), np.where(inside, x, 0).astype(np.int64)
        hit |= inside & mask[at]
    return np.asarray((hit.mean(axis=2) > MOST_HIDDEN).any(axis=1))
