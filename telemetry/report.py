"""report.html: one page, complete in itself, that shows a person what a run found and how far to trust it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import plotly.offline
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from telemetry.modes_text import partners as partners
from telemetry.report_data import Arrays, Run, read_run
from telemetry.report_figures import figure_html, quality_figure
from telemetry.report_modal import channel_shapes_figure, spectrum_figure, tracking_figure, wing_shapes_figure
from telemetry.report_text import (
    Table,
    Truth,
    drop_sentence,
    event_rows,
    missed_sentence,
    modes_rows,
    paper_rows,
    timing_rows,
    verdict,
)
from telemetry.report_wing import history_figure, middle_and_normal, picture_figure, steady_points, wing_figure
from wingbeat.errors import InputError

REPORT = "report.html"


@dataclass(frozen=True)
class Section:
    """A part of the page: a caption that says what to see, then a table and figures; without either, it says why."""

    title: str
    caption: str
    table: Table | None = None
    figures: tuple[Markup, ...] = ()


def write_report(folder: Path, title: str) -> Path:
    """Write report.html of the run in `folder`, and return its path.

    Reads the run's files as the contract describes them; only modes.json must be there. InputError: no run, a damaged
    file, or not writable.
    """
    run = read_run(folder)
    truth = partners(run.modes["modes"], run.summary.get("true_modes", ())) if run.modes["modes"] else {}
    measured = run.summary.get("ticks_measured")
    sections = [
        section
        for part in (_modes(run, truth), _pictures(run), _motion(run), _modal(run), _course(run, truth), _health(run))
        for section in part
    ]
    return _write_page(folder / REPORT, title, verdict(run.modes, truth, measured), sections)


def write_identify_report(path: Path, title: str, modes: Mapping[str, Any], diagram: Arrays) -> Path:
    """Write the page of an identification from recorded channels to `path`, and return it.

    modes: as in modes.json. diagram: order, frequency_hz, damping_ratio, stable (a pole each), spectrum_hz, spectrum
    (in the channels' unit), and shape (modes, channels) complex. InputError: not writable.
    """
    found = modes["modes"]
    sections = [
        Section("Modes", _record_sentence(modes), modes_rows(found, {}, "channels' unit") if found else None),
        *_spectrum(diagram, modes, "channels' unit"),
    ]
    shapes = channel_shapes_figure(diagram["shape"], found) if "shape" in diagram else None
    if shapes is not None:
        caption = "Shape of each valid mode over the channels, in order of the file; its largest entry is 1."
        sections.append(Section("Mode shapes", caption, figures=(figure_html(shapes, "shapes"),)))
    return _write_page(path, title, verdict(modes, {}, None), sections)


def _modes(run: Run, truth: Truth) -> Iterator[Section]:
    found, known = run.modes["modes"], run.summary.get("true_modes", [])
    caption = _record_sentence(run.modes) + missed_sentence(known, truth)
    yield Section("Modes", caption, modes_rows(found, truth, "mm") if found else None)
    if known:
        caption = "What the paper that this method comes from reports for its own wing, and this run."
        yield Section("Beside the paper", caption, paper_rows(found, truth, run.summary.get("against_truth", {})))


def _record_sentence(modes: Mapping[str, Any]) -> str:
    record, estimate = modes["record"], modes.get("estimate")
    if not record["samples"]:
        return "No estimate was made, so there are no modes to show."
    sentence = f"From {record['samples']} samples in {record['duration_s']:.2f} s"
    if record["rate_hz"]:
        sentence += f" at {record['rate_hz']:.4g} Hz"
    if record.get("begin_s"):
        sentence += f", cut out from {record['begin_s']:.2f} s on"
    if estimate is not None:
        sentence += f", up to tick {estimate['tick']}"
    if not modes["modes"]:
        return sentence + ": no mode was found."
    return sentence + "; ± is half of the 95 % interval. Only a valid mode may be used; pale rows say why they are not."


def _pictures(run: Run) -> Iterator[Section]:
    title, preview = "What the cameras saw", run.summary.get("preview")
    if not run.pictures or preview is None:
        yield Section(title, "The run kept no images.")
        return
    times, cell = run.points["time_s"], run.points["cell"]
    ticks = run.quality.get("tick", np.arange(len(times)))[: len(times)]
    rows = np.flatnonzero(ticks == preview["tick"])
    centre_px = run.points["centre_px"][:, rows[0]] if len(rows) else np.full((2, len(cell), 2), np.nan)
    figures = tuple(
        figure_html(picture_figure(run.pictures[name], preview["scale"], centre_px[eye], cell), f"picture-{name}")
        for eye, name in enumerate(("left", "right"))
        if name in run.pictures
    )
    caption = (
        f"The left and the right eye at tick {preview['tick']}, with the centres of the "
        f"{np.isfinite(centre_px[0, :, 0]).sum()} cells measured then. Each mark should sit in the middle of its cell; "
        "the same cell bears the same name in both."
    )
    yield Section(title, caption, figures=figures)


def _motion(run: Run) -> Iterator[Section]:
    points = steady_points(run.points)
    if len(points["cell"]) == 0:
        yield Section("The wing and its points", "No cell was measured in any tick: there is no motion to show.")
        return
    figure, stretch, time_s = wing_figure(points)
    caption = (
        f"The wing in the left camera's frame at {time_s - run.start_s:.2f} s, when it moved most, its displacement "
        f"drawn {stretch:g} times as large; the pale dots are its cells at rest. The {len(points['cell'])} of "
        f"{len(run.points['cell'])} cells that were measured in at least half of the ticks. Turn it with the mouse."
    )
    yield Section("The wing in space", caption, figures=(figure_html(figure, "wing"),))
    caption = (
        "Displacement normal to the wing's mean plane, towards the cameras, of cells that lie far apart; all have the "
        "same scale."
    )
    yield Section("Motion", caption, figures=(figure_html(history_figure(points, run.start_s), "histories"),))


def _modal(run: Run) -> Iterator[Section]:
    yield from _spectrum(run.diagram, run.modes, "mm")
    shapes = None
    if "shape" in run.diagram:
        points = steady_points(run.points)
        _, normal = middle_and_normal(points["xyz_mm"])
        shapes = wing_shapes_figure(run.diagram, run.modes["modes"], normal, points["cell"])
    if shapes is None:
        why = "No mode is valid: there is no shape to show." if "shape" in run.diagram else "The run kept no shapes."
        yield Section("Mode shapes", why)
        return
    caption = (
        "How the cells move in each valid mode, normal to the wing: red moves against blue. 1 is the largest motion but"
        " for the outermost fiftieth of the cells. Cells that were measured in less than half of the ticks stay blank."
    )
    yield Section("Mode shapes", caption, figures=(figure_html(shapes, "shapes"),))


def _spectrum(diagram: Arrays, modes: Mapping[str, Any], unit: str) -> Iterator[Section]:
    title = "Spectrum and stabilisation"
    if not len(diagram.get("spectrum", ())):
        why = "The run kept no spectrum." if modes["record"]["samples"] else "No estimate was made."
        yield Section(title, why)
        return
    caption = (
        "Amplitude averaged over the channels, and below it the poles of growing model orders: a true mode stands as a "
        "straight column of stable poles under a peak. Lines are the identified modes by number; dotted: not valid."
    )
    figure = spectrum_figure(diagram, modes["modes"], unit)
    yield Section(title, caption, figures=(figure_html(figure, "spectrum"),))


def _course(run: Run, truth: Truth) -> Iterator[Section]:
    title = "Modes over time"
    if not run.estimates or not run.modes["modes"]:
        yield Section(title, "No estimate was sent.")
        return
    caption = (
        "Each estimate as it was sent, at the time of its newest frame: the band is the 95 % interval, hollow marks "
        f"were not valid{', the dashed line is the truth' if truth else ''}. The scales suit the later estimates: the "
        "first ones, from short records, may lie outside."
    )
    figure = tracking_figure(run.modes["modes"], run.estimates, truth, run.start_s)
    yield Section(title, caption, figures=(figure_html(figure, "tracking"),))


def _health(run: Run) -> Iterator[Section]:
    if not len(run.quality.get("time_s", ())):
        yield Section("Quality", "The run has no quality.csv, or no tick.")
    else:
        caption = (
            "Scene characteristic (char), matching uniqueness (MU) and their joint measure (CMP), with precision and "
            "recall; cells found and matched; how well the two eyes agree; and what the flight application was doing."
        )
        figure = quality_figure(run.quality, run.start_s)
        yield Section("Quality", caption, figures=(figure_html(figure, "quality"),))
    events, said = event_rows(run.events, run.start_s)
    yield Section("Faults and events", said, events if run.events else None)
    timing = timing_rows(run.summary.get("cpu_ms", {}))
    caption = "Processor time of each task's thread. " if timing.rows else "The run kept no timing. "
    yield Section("Timing and losses", caption + drop_sentence(run.summary), timing if timing.rows else None)


def _write_page(path: Path, title: str, sentence: str, sections: list[Section]) -> Path:
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(files("telemetry").joinpath("report.html.j2").read_text("utf-8"))
    has_figures = any(section.figures for section in sections)
    library = Markup(plotly.offline.get_plotlyjs()) if has_figures else ""  # its own text
    page = template.render(title=title, verdict=sentence, sections=sections, library=library)
    try:
        path.write_text(page, "utf-8")
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", path, "name a file in a writable folder") from None
    return path
