"""What really happened in a run: where every cell was, and which modes moved it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.motion import Oscillator
from sim.rig import Eye, Pose
from wingbeat.errors import InputError

FloatArray = NDArray[np.float64]


def wing_truth(
    times_ns: NDArray[np.int64],
    cells_mm: FloatArray,
    displacement_mm: FloatArray,
    motion: Sequence[Oscillator],
    eyes: Sequence[Eye],
    pose: Pose,
) -> dict[str, NDArray[Any]]:
    """The arrays of truth.npz.

    times_ns (T,); cells_mm (N, 2): centres on the flat wing; displacement_mm (T, N) along the wing's Z. Returns times
    (T,) in s, X_left (T, N, 3) in mm, uv_left and uv_right (T, N, 2) in image pixels, in view or not, and constants.
    """
    flat = np.broadcast_to(cells_mm, (*displacement_mm.shape, 2))
    xyz = pose.to_left(np.concatenate([flat, displacement_mm[..., None]], axis=-1))
    left, right = eyes
    return {
        "times": times_ns * 1e-9,
        "X_left": xyz,
        "uv_left": left.project(xyz),
        "uv_right": right.project(xyz),
        "cells_XY": cells_mm,
        "fn_hz": np.array([mode.frequency_hz for mode in motion]),
        "zeta": np.array([mode.damping_ratio for mode in motion]),
        "amp_mm": np.array([mode.amplitude_mm for mode in motion]),
        "K_left": left.matrix,
        "K_right": right.matrix,
        "R_lr": right.rotation,
        "t_lr": right.translation_mm,
        "R_wing_to_left": pose.rotation,
        "t_wing_to_left": pose.translation_mm,
    }


def write_truth(path: Path | str, truth: dict[str, NDArray[Any]]) -> None:
    """Write truth.npz. Raises InputError when the file cannot be written."""
    try:
        np.savez(path, **truth)  # type: ignore[arg-type]  # numpy's stub takes the keys for its own options
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", path, "name a file in a writable folder") from None
