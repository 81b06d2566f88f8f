"""The flight tables: schedule, vision, identify, executive, limits. Shipped: flight.toml here, and fault/fmea.toml."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from fault.fmea import limit_rows
from fault.limits import Limit, faults_in
from fsw.tables.reading import convert_table, read_document
from fsw.tables.schema import Table
from wingbeat.errors import InputError

SHIPPED = Path(__file__).with_name("flight.toml")

Ticks = Annotated[int, Meta(ge=1, le=36_000)]


class TaskSlot(Table, frozen=True):
    """One row of the schedule; rows stand in the order in which tasks run."""

    task: Annotated[str, Meta(min_length=1, max_length=40, description="name of the task")]
    budget_ms: Annotated[float, Meta(gt=0.0, le=60_000.0, description="thread-CPU time of a run, ms")]
    period_ticks: Annotated[int, Meta(ge=1, le=3600, description="ticks from run to run")] = 1
    phase_ticks: Annotated[int, Meta(ge=0, le=3599, description="tick of the first run")] = 0
    latency_ticks: Annotated[int, Meta(ge=0, le=3600, description="ticks to its result; 0: in the same tick")] = 0
    criticality: Literal["critical", "normal", "optional"] = "normal"


class VisionTable(Table, frozen=True):
    """From images to points."""

    method: Annotated[
        Literal["edges", "paper"],
        Meta(description="cell centres from fitted edges, or the mean of a cell's boundary pixels (Eq. 12)"),
    ]
    skew_limit_us: Annotated[
        float, Meta(gt=0.0, le=100_000.0, description="largest difference of the eyes' exposure times, us")
    ]
    least_cells: Annotated[int, Meta(ge=4, le=100_000, description="cells matched in both eyes that a lock needs")]
    lost_after_ticks: Annotated[Ticks, Meta(description="ticks in a row below least_cells until lock is lost")]
    hold_after_ticks: Annotated[Ticks, Meta(description="ticks in a row without a usable pair until HOLD")]
    epipolar_gate_px: Annotated[
        float, Meta(gt=0.0, le=100.0, description="largest distance of a match from its epipolar line, px")
    ]
    reprojection_gate_px: Annotated[
        float, Meta(gt=0.0, le=100.0, description="largest rms reprojection error of a point, px")
    ]
    precision_weight: Annotated[
        float, Meta(gt=0.0, le=1000.0, description="b of Eq. 24: how much more precision counts than recall")
    ]
    late_limit_us: Annotated[
        float, Meta(gt=0.0, le=1e6, description="largest difference of an exposure's time from its trigger's, us")
    ]
    black_levels: Annotated[
        float, Meta(ge=0.0, le=1000.0, description="a frame whose grey levels spread no further shows nothing")
    ]
    saturated_share: Annotated[
        float,
        Meta(gt=0.0, le=1.0, description="a frame with so many of its pixels at the brightest value is saturated"),
    ]
    drop_window_ticks: Annotated[int, Meta(ge=1, le=1000, description="ticks over which drop_rate is taken")]


class IdentifyTable(Table, frozen=True):
    """From displacements to modes."""

    history_ticks: Annotated[int, Meta(ge=16, le=100_000, description="frames in the record, at most")]
    least_ticks: Annotated[int, Meta(ge=16, le=100_000, description="frames in the record, at least")]
    kind: Annotated[
        Literal["auto", "decay", "ambient"], Meta(description="what the record holds; auto decides by itself")
    ]
    method: Annotated[
        Literal["refined", "paper", "rdt_era_dc", "ssi_data"],
        Meta(description="maximum likelihood, or the paper's fusion, or one of the two methods that it joins"),
    ]
    weighting: Annotated[Literal["none", "cva"], Meta(description="of the Hankel matrix, for the paper's methods")]
    correlation: Annotated[
        Literal["auto", "fixed_window", "spectral"],
        Meta(description="products over a fixed window suit decays, cross spectra suit stationary response"),
    ]
    coordinates: Annotated[int, Meta(ge=1, le=64, description="principal coordinates, at most")]
    block_rows: Annotated[int, Meta(ge=4, le=500, description="block rows of the Hankel matrix, at most")]
    order: Annotated[int, Meta(ge=2, le=200, description="highest order of the realisation")]
    drift_degree: Annotated[int, Meta(ge=0, le=6, description="polynomial drift under a decay")]
    most_modes: Annotated[int, Meta(ge=1, le=8, description="modes in an estimate, at most")]
    clock_tolerance_ppm: Annotated[
        float,
        Meta(ge=0.0, le=1000.0, description="what the trigger's clock may be off by; no frequency is surer, ppm"),
    ]
    minimum_amplitude_mm: Annotated[
        float, Meta(ge=0.0, le=1000.0, description="below this a mode is not observable, mm")
    ]


class ExecutiveTable(Table, frozen=True):
    """Trigger, overruns, health, commands, events, black box."""

    edge_window_share: Annotated[
        float, Meta(gt=0.0, le=0.45, description="an edge this share of a period off its time is not used")
    ]
    free_wheel_after: Annotated[int, Meta(ge=1, le=100, description="bad edges in a row until ticks go by the clock")]
    lock_after: Annotated[int, Meta(ge=1, le=100, description="good edges in a row until ticks follow the trigger")]
    eye_threads: Annotated[
        int, Meta(ge=1, le=2, description="threads for the eyes: 1 takes less processor time, 2 are ready sooner")
    ]
    catch_up_ticks: Annotated[int, Meta(ge=0, le=10, description="late ticks that are made up for; more are skipped")]
    silent_after_ticks: Annotated[Ticks, Meta(description="ticks past its turn until a task is called silent")]
    dead_after_ticks: Annotated[Ticks, Meta(description="ticks past its turn until a task is called dead")]
    most_restarts: Annotated[int, Meta(ge=0, le=10, description="restarts by itself, at most")]
    arm_ticks: Annotated[Ticks, Meta(description="ticks that a dangerous command stays armed")]
    event_burst: Annotated[int, Meta(ge=1, le=1000, description="events that a source may raise at once")]
    event_refill_ticks: Annotated[Ticks, Meta(description="ticks until a source may raise one more")]
    black_box_ticks: Annotated[int, Meta(ge=15, le=3600, description="ticks that the black box holds")]
    black_box_after_ticks: Annotated[int, Meta(ge=0, le=3600, description="of them, ticks after the trip")]
    black_boxes: Annotated[int, Meta(ge=0, le=16, description="black boxes written in a flight, at most")]


class FlightTable(Table, frozen=True):
    """All flight tables. shadow: limits that run beside the active ones and only count."""

    schedule: Annotated[list[TaskSlot], Meta(min_length=1, max_length=32)]
    vision: VisionTable
    identify: IdentifyTable
    executive: ExecutiveTable
    limit: Annotated[list[Limit], Meta(max_length=200)]
    shadow: Annotated[list[Limit], Meta(max_length=200)] = field(default_factory=list)


def load_flight(path: Path | str | None = None) -> FlightTable:
    """The shipped tables, or these with what a file gives instead; a list (schedule, limit) is replaced whole.

    Raises InputError: see read_table, and a limit that cannot work.
    """
    document = tomllib.loads(SHIPPED.read_text(encoding="utf-8")) | {"limit": limit_rows()}
    where = SHIPPED if path is None else Path(path)
    if path is not None:
        document = _overlaid(document, read_document(where))
    return check_flight(convert_table(document, FlightTable, where), where)


def check_flight(table: FlightTable, where: Path | str) -> FlightTable:
    """The same table if its parts agree. Raises InputError that names the row."""
    for name, limits in (("limit", table.limit), ("shadow", table.shadow)):
        if problem := faults_in(limits):
            raise InputError(problem.replace("limit", name, 1), where, "correct this row")
    if table.identify.least_ticks > table.identify.history_ticks:
        raise InputError(
            f"identify.least_ticks = {table.identify.least_ticks}",
            where,
            f"at most history_ticks is allowed, {table.identify.history_ticks}",
        )
    return table


def _overlaid(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """base with the keys of over; tables are merged, all else is replaced."""
    merged = dict(base)
    for key, value in over.items():
        below = base.get(key)
        merged[key] = _overlaid(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged
