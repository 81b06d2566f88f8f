"""A scenario: all that decides a simulated run, read from TOML and checked. Shipped ones are in sim/scenarios/."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from fsw.tables.reading import convert_table, read_table
from fsw.tables.schema import Eye, Outline, PanelTable, Stereo, Table, Vector2, Vector3, panel_span_mm
from wingbeat.errors import InputError

SHIPPED = Path(__file__).with_name("scenarios")
_ROUNDING_MM = 0.01
_LEAST_TICKS = 2

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Positive = Annotated[float, Meta(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e9)]


class Camera(Table, frozen=True):
    """Both sensors; bits above 8 come in 16-bit pixels; binning: so many by so many of the eyes' pixels as one.

    psf_sigma_px, full_well_e and read_noise_e are those of the image's pixels.
    """

    bits: Annotated[int, Meta(ge=8, le=16)]
    binning: Annotated[int, Meta(ge=1, le=16)]
    psf_sigma_px: Annotated[float, Meta(ge=0.0, le=10.0)]
    exposure_ms: Positive
    full_well_e: Positive
    read_noise_e: NotNegative


class Paint(Table, frozen=True):
    """Reflectances, and what wing.toml does not tell: borders round the panels' cells, hinges across the fold gaps.

    cell_spread: cells differ by up to this share; border_mm along X, Y; hinge_y_mm: middles of each gap's hinges.
    """

    cell: Share
    cell_spread: Share
    line: Share
    hinge: Share
    border_mm: tuple[NotNegative, NotNegative]
    hinge_y_mm: list[float]
    hinge_width_mm: NotNegative
    hinge_overlap_mm: NotNegative


class Structure(Table, frozen=True):
    """The wing as a plate; hinge_nm_per_rad: stiffness of one whole fold line."""

    thickness_mm: Positive
    youngs_gpa: Positive
    density_kg_m3: Positive
    poisson: Annotated[float, Meta(ge=0.0, lt=0.5)]
    hinge_nm_per_rad: Positive


class Excitation(Table, frozen=True):
    """How one mode (1: the lowest) moves the tip: amplitude of a decay at time 0, rms of a random motion."""

    mode: Annotated[int, Meta(ge=1, le=12)]
    amplitude_mm: NotNegative
    damping_ratio: Annotated[float, Meta(gt=0.0, lt=1.0)]
    kind: Literal["decay", "random"]
    phase_deg: float = 0.0


class Lighting(Table, frozen=True):
    """level_per_ms: share of full scale that a white surface reaches in 1 ms; background: what lies beside the wing.

    gradient: relative change over the wing's length and width; direction: towards the light, wing frame.
    """

    level_per_ms: Positive
    background: Share
    gradient: Vector2
    direction: Vector3


class TruePose(Table, frozen=True):
    """Where the wing truly is: its point point_mm lies at at_mm in the left camera's frame, as do both axes.

    The nominal pose, which the flight side gets, is off by nominal_shift_mm, and by nominal_turn_deg about that point.
    """

    point_mm: Vector2
    at_mm: Vector3
    x_axis: Vector3
    normal: Vector3
    nominal_shift_mm: Vector3
    nominal_turn_deg: Vector3
    tolerance_mm: NotNegative
    tolerance_deg: Annotated[float, Meta(ge=0.0, le=45.0)]


class CalibrationError(Table, frozen=True):
    """How the calibration that the flight side gets differs from the true cameras; focal_scale for both eyes."""

    turn_deg: Vector3 = (0.0, 0.0, 0.0)
    shift_mm: Vector3 = (0.0, 0.0, 0.0)
    focal_scale: Annotated[float, Meta(gt=0.5, lt=2.0)] = 1.0


class Scenario(Table, frozen=True, kw_only=True):
    """One simulated run. [wing], [[panel]] as in wing.toml; the eyes as in cameras.toml, before binning."""

    seed: Annotated[int, Meta(ge=0, lt=2**32)]
    rate_hz: Annotated[float, Meta(gt=0.0, le=1000.0)]
    duration_s: Annotated[float, Meta(gt=0.0, le=86400.0)]
    camera: Camera
    left: Eye
    right: Eye
    stereo: Stereo
    wing: Outline
    panel: Annotated[list[PanelTable], Meta(min_length=1, max_length=64)]
    paint: Paint
    structure: Structure
    excitation: Annotated[list[Excitation], Meta(min_length=1, max_length=12)]
    light: Lighting
    pose: TruePose
    calibration: CalibrationError = CalibrationError()

    @property
    def ticks(self) -> int:
        """Number of trigger edges."""
        return round(self.duration_s * self.rate_hz)

    @property
    def fold_lines_mm(self) -> tuple[float, ...]:
        """X of the hinge lines: the middles of the gaps between the panels."""
        spans = [panel_span_mm(panel)[0] for panel in self.panel]
        return tuple(0.5 * (before[1] + after[0]) for before, after in pairwise(spans))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario: a file, or the name of a shipped one.

    A file may start with `extends = "other"` and then holds only what differs: tables are merged, all else is replaced.
    Raises InputError, which names the file, the key, the value and what is allowed.
    """
    path = _find(name_or_path, Path())
    scenario = convert_table(_read(path, ()), Scenario, path)
    check_scenario(scenario, path)
    return scenario


def check_scenario(scenario: Scenario, where: str | Path) -> None:
    """What the types cannot tell. Raises InputError."""

    def refuse(what: str, allowed: str) -> None:
        raise InputError(what, where, allowed)

    if scenario.ticks < _LEAST_TICKS:
        refuse(f"duration_s = {scenario.duration_s:g}", f"at least {_LEAST_TICKS / scenario.rate_hz:g} s is allowed")
    for name, eye in (("left", scenario.left), ("right", scenario.right)):
        if eye.width % scenario.camera.binning or eye.height % scenario.camera.binning:
            refuse(f"camera.binning = {scenario.camera.binning}", f"a divisor of {name}.width and height is allowed")
    numbers = [e.mode for e in scenario.excitation]
    if len(set(numbers)) < len(numbers):
        refuse(f"excitation.mode = {numbers}", "each mode may be excited once")
    for key, axis in (("pose.normal", scenario.pose.normal), ("light.direction", scenario.light.direction)):
        if not any(axis):
            refuse(f"{key} = {list(axis)}", "a direction other than zero is allowed")
    if scenario.light.direction[2] <= 0.0:
        refuse(f"light.direction[2] = {scenario.light.direction[2]:g}", "light comes from the wing's front: above 0")
    if np.linalg.norm(np.cross(scenario.pose.x_axis, scenario.pose.normal)) < _ROUNDING_MM:
        refuse(f"pose.x_axis = {list(scenario.pose.x_axis)}", "a direction across pose.normal is allowed")
    _check_panels(scenario, where)


def _check_panels(scenario: Scenario, where: str | Path) -> None:
    half, (border_x, border_y) = scenario.wing.width_mm / 2.0, scenario.paint.border_mm
    end = 0.0
    for number, panel in enumerate(scenario.panel):
        (x0, x1), (y0, y1) = panel_span_mm(panel)
        if panel.pitch_mm[0] < panel.cell_mm[0] or panel.pitch_mm[1] < panel.cell_mm[1]:
            remedy = f"at least the cell's size {list(panel.cell_mm)} is allowed"
            raise InputError(f"panel[{number}].pitch_mm = {list(panel.pitch_mm)}", where, remedy)
        if x0 - border_x < end - _ROUNDING_MM or y0 - border_y < -half - _ROUNDING_MM:
            remedy = f"with its border at least [{end + border_x:g}, {border_y - half:g}] is allowed"
            raise InputError(f"panel[{number}].origin_mm = {list(panel.origin_mm)}", where, remedy)
        end = x1 + border_x
        if end > scenario.wing.length_mm + _ROUNDING_MM or y1 + border_y > half + _ROUNDING_MM:
            remedy = f"with its border it must end within X {scenario.wing.length_mm:g}, Y {half:g} mm"
            raise InputError(f"panel[{number}] ends at X {end:g}, Y {y1 + border_y:g} mm", where, remedy)
    reach = max((abs(y) for y in scenario.paint.hinge_y_mm), default=0.0) + scenario.paint.hinge_width_mm / 2.0
    if scenario.paint.hinge_y_mm and reach > half:
        raise InputError(f"a hinge reaches Y {reach:g} mm", where, f"paint: at most {half:g} is allowed")
    if scenario.paint.hinge_overlap_mm > border_x:
        remedy = f"at most the border, {border_x:g}, is allowed"
        raise InputError(f"paint.hinge_overlap_mm = {scenario.paint.hinge_overlap_mm:g}", where, remedy)


def _find(name_or_path: str | Path, beside: Path) -> Path:
    """The file of a shipped scenario if there is one of this name, else the file itself."""
    shipped = SHIPPED / f"{name_or_path}.toml"
    if shipped.is_file():
        return shipped
    path = beside / name_or_path
    if not path.is_file():
        names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.toml")))
        raise InputError("no such scenario", name_or_path, f"name a file or one of: {names}")
    return path


def _read(path: Path, readers: tuple[Path, ...]) -> dict[str, Any]:
    """The document with all that it extends; readers: the files that led here."""
    if path.resolve() in readers:
        raise InputError(f"extends = {path.name!r} leads back to itself", path, "end the circle")
    document: dict[str, Any] = dict(read_table(path, dict))
    base = document.pop("extends", None)
    if base is None:
        return document
    if not isinstance(base, str):
        raise InputError(f"extends = {base!r}", path, "a file or the name of a shipped scenario is allowed")
    return _merged(_read(_find(base, path.parent), (*readers, path.resolve())), document)


def _merged(base: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in change.items():
        old = merged.get(key)
        merged[key] = _merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
