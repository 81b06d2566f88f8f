"""What the flight side is told of the world: cameras.toml and wing.toml, as good or bad as the scenario says."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from sim.rig import Eye, rotation_matrix
from sim.scenario import Scenario
from sim.world import true_eyes, true_pose
from wingbeat.errors import InputError


def flight_files(scenario: Scenario, directory: Path | str) -> tuple[Path, Path]:
    """Write cameras.toml and wing.toml into a folder and return their paths. Raises InputError when that fails."""
    folder = Path(directory)
    cameras, wing = folder / "cameras.toml", folder / "wing.toml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        cameras.write_text(_cameras(scenario), encoding="utf-8")
        wing.write_text(_wing(scenario), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", folder, "name a writable folder") from None
    return cameras, wing


def _cameras(scenario: Scenario) -> str:
    error = scenario.calibration
    left, right = true_eyes(scenario)
    rotation = rotation_matrix(np.deg2rad(error.turn_deg)) @ right.rotation
    translation = right.translation_mm + np.array(error.shift_mm)
    return (
        _eye("left", left, error.focal_scale)
        + _eye("right", right, error.focal_scale)
        + f"[stereo]\nrotation = {_matrix(rotation)}\ntranslation_mm = {_list(translation)}\n"
    )


def _eye(name: str, eye: Eye, focal_scale: float) -> str:
    fx, fy, cx, cy = (float(v) for v in eye.intrinsics)
    return (
        f"[{name}]\nwidth = {eye.width}\nheight = {eye.height}\n"
        f"fx = {fx * focal_scale!r}\nfy = {fy * focal_scale!r}\ncx = {cx!r}\ncy = {cy!r}\n"
        f"distortion = {_list(eye.distortion)}\n\n"
    )


def _wing(scenario: Scenario) -> str:
    pose, paint = scenario.pose, scenario.paint
    nominal = true_pose(scenario).moved(pose.nominal_shift_mm, pose.nominal_turn_deg, (*pose.point_mm, 0.0))
    panels = "".join(
        f"[[panel]]\norigin_mm = {_list(p.origin_mm)}\ncolumns = {p.columns}\nrows = {p.rows}\n"
        f"pitch_mm = {_list(p.pitch_mm)}\ncell_mm = {_list(p.cell_mm)}\n"
        for p in scenario.panel
    )
    return (
        f"[wing]\nlength_mm = {scenario.wing.length_mm!r}\nwidth_mm = {scenario.wing.width_mm!r}\n"
        f"{panels}"
        f'[surface]\ncells_are = "{"dark" if paint.cell < paint.line else "bright"}"\n'
        f"[pose]\nrotation = {_matrix(nominal.rotation)}\ntranslation_mm = {_list(nominal.translation_mm)}\n"
        f"tolerance_mm = {pose.tolerance_mm!r}\ntolerance_deg = {pose.tolerance_deg!r}\n"
    )


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _matrix(rows: Iterable[Iterable[float]]) -> str:
    return "[" + ", ".join(_list(row) for row in rows) + "]"
