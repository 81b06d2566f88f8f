"""A run against the truth that its world knows: errors of points, displacements and modes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.vision.grid import CellGrid

FloatArray = NDArray[np.float64]


def true_modes(truth: dict[str, NDArray[Any]]) -> list[dict[str, float]]:
    """Frequency and damping of the modes that move, by frequency."""
    order = np.argsort(truth["fn_hz"])
    return [
        {"frequency_hz": float(truth["fn_hz"][i]), "damping_ratio": float(truth["zeta"][i])}
        for i in order
        if truth["amp_mm"][i] > 0.0
    ]


def compare_points(folder: Path, truth: dict[str, NDArray[Any]], grid: CellGrid) -> dict[str, float]:
    """Errors of points.npz in mm, per axis of the left camera's frame, and how long each cell was followed.

    Position: the distance from where the cell is. Displacement: the same after each cell's mean error is taken away,
    as a vibration is seen. Cells are compared under the place in the grid that the flight application gave them.
    """
    with np.load(folder / "points.npz") as points:
        cell, xyz, sigma = points["cell"], points["xyz_mm"], points["sigma_mm"]
    if len(cell) == 0:
        return {"cells": 0}
    index = [grid.index(*(int(i) for i in place)) for place in cell]
    ticks = len(xyz)
    error = xyz - truth["X_left"][:ticks, index]
    measured = np.isfinite(error[..., 0])
    count = measured.sum(axis=0)
    mean = np.where(count[:, None] > 0, np.nansum(error, axis=0) / np.maximum(count, 1)[:, None], 0.0)
    residual = (error - mean)[measured]
    first = int(np.argmax(measured.any(axis=1)))
    position, displacement = _rms(error[measured]), _rms(residual)
    return {
        "cells": len(cell),
        "first_measured_tick": first,
        "share_of_ticks_median": float(np.median(measured[first:].mean(axis=0))),
        "position_rms_x_mm": position[0],
        "position_rms_y_mm": position[1],
        "position_rms_z_mm": position[2],
        "displacement_rms_x_mm": displacement[0],
        "displacement_rms_y_mm": displacement[1],
        "displacement_rms_z_mm": displacement[2],
        "displacement_rms_mm": float(np.sqrt((residual**2).mean())),
        "displacement_max_mm": float(np.abs(residual).max()),
        "sigma_median_mm": float(np.nanmedian(sigma)),
    }


def _rms(values: FloatArray) -> list[float]:
    """Root mean square over the rows (n, 3), for each axis."""
    return [float(v) for v in np.sqrt((values**2).mean(axis=0))]
