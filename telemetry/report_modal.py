"""Figures of the modes: spectrum, stabilisation diagram, shapes, and how each estimate came about over time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from telemetry.modes_text import INTERVAL
from telemetry.report_data import Arrays
from telemetry.report_figures import BENT, COLOURS, QUIET, TRUTH, line, new_figure

FloatArray = NDArray[np.float64]
Modes = Sequence[Mapping[str, Any]]

SHAPE_SCALE_PERCENT = 98.0  # so that one cell at the border of the view does not pale all others
SAME_MODE = 0.1  # relative distance in frequency within which an earlier estimate belongs to a mode of the last one


def spectrum_figure(diagram: Arrays, modes: Modes, unit: str) -> go.Figure:
    """Averaged amplitude spectrum above the stabilisation diagram, with the modes marked in both."""
    figure = new_figure(rows=2, height=560, shared_xaxes=True, vertical_spacing=0.05, row_heights=[3, 2])
    spectrum = line(diagram["spectrum_hz"], diagram["spectrum"], "spectrum", COLOURS[5], showlegend=False)
    figure.add_trace(spectrum, row=1, col=1)
    stable = diagram["stable"].astype(bool)
    for chosen, name, colour, symbol in (
        (~stable, "pole", QUIET, "x-thin"),
        (stable, "stable pole", COLOURS[2], "circle"),
    ):
        figure.add_trace(_poles(diagram, chosen, name, colour, symbol), row=2, col=1)
    for number, mode in enumerate(modes, 1):
        style = {
            "color": COLOURS[0] if mode["valid"] else TRUTH,
            "dash": "solid" if mode["valid"] else "dot",
            "width": 1,
        }
        figure.add_vline(x=mode["frequency_hz"], line=style, row="all", col=1)
        figure.add_annotation(
            text=str(number), x=mode["frequency_hz"], y=1, xref="x", yref="y domain", yanchor="bottom",
            showarrow=False, row=1, col=1,
        )  # fmt: skip
    figure.update_yaxes(type="log", title_text=f"amplitude / {unit}", exponentformat="power", dtick=1, row=1, col=1)
    figure.update_yaxes(title_text="model order", row=2, col=1)
    figure.update_xaxes(title_text="frequency / Hz", row=2, col=1)
    figure.update_layout(legend={"y": -0.12, "yanchor": "top"})
    return figure


def _poles(diagram: Arrays, chosen: NDArray[np.bool_], name: str, colour: str, symbol: str) -> go.Scatter:
    return go.Scatter(
        x=diagram["frequency_hz"][chosen],
        y=diagram["order"][chosen],
        customdata=100.0 * diagram["damping_ratio"][chosen],
        mode="markers",
        name=name,
        marker={"size": 5, "color": colour, "symbol": symbol, "line": {"width": 1, "color": colour}},
        hovertemplate="%{x:.4f} Hz, damping %{customdata:.3f} %<extra></extra>",
    )


def real_shape(shape: NDArray[np.complex128]) -> FloatArray:
    """A complex shape turned to its best real phase, largest entry 1; NaN stays NaN."""
    known = shape[np.isfinite(shape)]
    turned = np.real(shape * np.exp(-0.5j * np.angle(np.sum(known**2))))
    peak = turned[np.nanargmax(np.abs(turned))] if np.isfinite(turned).any() else 1.0
    return np.asarray(turned / peak if peak != 0.0 else turned)


def wing_shapes_figure(
    diagram: Arrays, modes: Modes, normal: FloatArray, steady: NDArray[np.int64]
) -> go.Figure | None:
    """Each valid mode's shape normal to the wing, as a map over the cells in steady (N, 3); None if there is none."""
    kept = (diagram["shape_cell"][:, None] == steady).all(axis=-1).any(axis=1)
    shapes, cell = diagram["shape"][:, kept] @ normal, diagram["shape_cell"][kept].astype(int)
    chosen = [number for number in valid_numbers(modes) if number < len(shapes) and np.isfinite(shapes[number]).any()]
    if not chosen or len(cell) == 0:
        return None
    titles = [f"mode {n + 1}: {modes[n]['frequency_hz']:.4f} Hz" for n in chosen]
    figure = new_figure(
        rows=len(chosen), height=70 + 190 * len(chosen), subplot_titles=titles, shared_xaxes=True,
        vertical_spacing=0.25 / max(len(chosen), 2),
    )  # fmt: skip
    x, ticks = _column_places(cell)
    for row, number in enumerate(chosen, 1):
        grid = np.full((cell[:, 2].max() + 1, x.max() + 1), np.nan)
        shape = real_shape(shapes[number])
        grid[cell[:, 2], x] = shape / (np.nanpercentile(np.abs(shape), SHAPE_SCALE_PERCENT) or 1.0)
        heat = go.Heatmap(
            z=grid, zmin=-1, zmax=1, colorscale=BENT, showscale=row == 1, hoverongaps=False,
            colorbar={"thickness": 10, "title": {"text": "shape"}},
            hovertemplate="column %{x}, row %{y}: %{z:.3f}<extra></extra>",
        )  # fmt: skip
        figure.add_trace(heat, row=row, col=1)
        figure.update_yaxes(title_text="row", autorange="reversed", showgrid=False, row=row, col=1)
    figure.update_xaxes(showgrid=False, tickvals=list(ticks), ticktext=list(ticks.values()))
    return figure


def _column_places(cell: NDArray[np.int64]) -> tuple[NDArray[np.int64], dict[int, str]]:
    """Place of each cell along the wing, one place left free between panels, and the panels' names at their middles."""
    x = np.zeros(len(cell), np.int64)
    names, at = {}, 0
    for panel in np.unique(cell[:, 0]):
        on = cell[:, 0] == panel
        first, last = cell[on, 1].min(), cell[on, 1].max()
        x[on] = cell[on, 1] - first + at
        names[int(at + (last - first) // 2)] = f"panel {panel} (columns {first} to {last})"
        at += int(last - first) + 2
    return x, names


def channel_shapes_figure(shapes: NDArray[np.complex128], modes: Modes) -> go.Figure | None:
    """Each valid mode's shape over the channels; None if there is none."""
    chosen = [number for number in valid_numbers(modes) if number < len(shapes)]
    if not chosen:
        return None
    figure = new_figure(rows=len(chosen), height=70 + 130 * len(chosen), shared_xaxes=True, vertical_spacing=0.04)
    for row, number in enumerate(chosen, 1):
        values = real_shape(shapes[number])
        bars = go.Bar(x=np.arange(len(values)), y=values, marker={"color": COLOURS[0]}, showlegend=False)
        figure.add_trace(bars, row=row, col=1)
        figure.update_yaxes(title_text=f"mode {number + 1}", range=[-1.05, 1.05], row=row, col=1)
    figure.update_xaxes(tick0=0, dtick=max(1, shapes.shape[1] // 10))
    figure.update_xaxes(title_text="channel", row=len(chosen), col=1)
    return figure


def valid_numbers(modes: Modes) -> list[int]:
    """Places of the valid modes."""
    return [number for number, mode in enumerate(modes) if mode["valid"]]


def tracking_figure(
    modes: Modes, estimates: Modes, truth: Mapping[int, Mapping[str, float]], start_s: float
) -> go.Figure:
    """Frequency and damping of each mode as they were sent, with 95 % bands; hollow marks were not valid.

    truth: by the mode's place, its true frequency_hz and damping_ratio.
    """
    figure = new_figure(
        rows=len(modes), columns=2, height=80 + 190 * len(modes), shared_xaxes=True, horizontal_spacing=0.1,
        vertical_spacing=0.1 / len(modes), column_titles=["frequency / Hz", "damping / %"],
    )  # fmt: skip
    for row in range(1, len(modes) + 1):
        mine = [e for e in estimates if _nearest(e["frequency_hz"], modes) == row - 1]
        for column, (name, scale) in enumerate((("frequency_hz", 1.0), ("damping_ratio", 100.0)), 1):
            sigma = name.replace("_hz", "_sigma_hz") if column == 1 else f"{name}_sigma"
            known = truth[row - 1][name] * scale if row - 1 in truth else None
            _track(figure, (row, column), mine, (name, sigma, scale), start_s, known)
        figure.update_yaxes(title_text=f"mode {row}", row=row, col=1)
    figure.update_xaxes(rangemode="tozero")
    figure.update_xaxes(title_text="time / s", row=len(modes))
    return figure


def _nearest(frequency_hz: float, modes: Modes) -> int | None:
    distance = [abs(frequency_hz / mode["frequency_hz"] - 1.0) for mode in modes]
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] < SAME_MODE else None


def _track(
    figure: go.Figure,
    place: tuple[int, int],
    estimates: Modes,
    names: tuple[str, str, float],
    start_s: float,
    known: float | None,
) -> None:
    """One panel of the tracking figure."""
    row, column = place
    name, sigma_name, scale = names
    shown = [e for e in estimates if e.get(name) is not None]
    if not shown:
        return
    time_s = np.array([e["time_s"] for e in shown]) - start_s
    value = scale * np.array([e[name] for e in shown])
    half = INTERVAL * scale * np.array([e.get(sigma_name, np.nan) for e in shown], dtype=float)
    valid = np.array([bool(e.get("valid")) for e in shown])
    colour = COLOURS[(row - 1) % len(COLOURS)]
    band = go.Scatter(
        x=np.r_[time_s, time_s[::-1]], y=np.r_[value + half, (value - half)[::-1]], fill="toself", mode="none",
        fillcolor=_faint(colour), hoverinfo="skip", showlegend=False,
    )  # fmt: skip
    marks = go.Scatter(
        x=time_s, y=value, customdata=half, mode="lines+markers", showlegend=False, line={"color": colour, "width": 1},
        marker={"size": 5, "color": np.where(valid, colour, "rgba(0,0,0,0)"), "line": {"width": 1, "color": colour}},
        hovertemplate="%{x:.2f} s: %{y:.5g} ± %{customdata:.2g}<extra></extra>",
    )  # fmt: skip
    figure.add_trace(band, row=row, col=column)
    figure.add_trace(marks, row=row, col=column)
    if known is not None:
        figure.add_hline(y=known, line={"color": TRUTH, "dash": "dash", "width": 1}, row=row, col=column)
    figure.update_yaxes(range=_readable_range(value, half, valid, known), row=row, col=column)


def _readable_range(value: FloatArray, half: FloatArray, valid: NDArray[np.bool_], known: float | None) -> list[float]:
    """An axis for all valid estimates and the better half of the bands: the others, of short records, may leave it."""
    half = np.nan_to_num(half)
    best = half <= np.median(half)
    shown = np.concatenate([(value - half)[best], (value + half)[best], value[valid], [] if known is None else [known]])
    low, high = float(shown.min()), float(shown.max())
    margin = 0.25 * (high - low) or 0.01 * abs(high) or 1.0
    return [low - margin, high + margin]


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"
