"""Figures of the wing itself: what the eyes saw, where its points are, how they move."""

import base64

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from telemetry.report_data import Arrays, Picture
from telemetry.report_figures import BENT, COLOURS, line, new_figure

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STEM_SHARE = 0.15  # of the wing's extent: how long the largest displacement is drawn in the view in space
VIEW_SIZE = 1.9  # of the longest side, in plotly's units of space: it fills the figure
HISTORIES = 5
STEADY_SHARE = 0.5  # of the ticks of the best cell: a cell seen less often has no mean place to move about


def middle_and_normal(xyz_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean place of each point (N, 3) and the unit normal (3,) of the plane through them, towards the cameras.

    xyz_mm (T, N, 3), NaN where not measured; a point that was never measured stays NaN.
    """
    count = np.isfinite(xyz_mm[..., 0]).sum(axis=0)
    mean = np.where(count[:, None] > 0, np.nansum(xyz_mm, axis=0) / np.maximum(count, 1)[:, None], np.nan)
    known = mean[count > 0]
    if len(known) < 3:
        return mean, np.array([0.0, 0.0, -1.0])
    normal = np.linalg.svd(known - known.mean(axis=0), full_matrices=False)[2][2]
    return mean, normal if normal[2] < 0.0 else -normal


def displacement_mm(xyz_mm: FloatArray) -> FloatArray:
    """Displacement (T, N) of each point from its mean place, along the normal of the mean plane."""
    mean, normal = middle_and_normal(xyz_mm)
    return (xyz_mm - mean) @ normal


def steady_points(points: Arrays) -> Arrays:
    """The points of the cells that were measured often enough to tell how they move; (T, N, 3) arrays and cell."""
    count = np.isfinite(points["xyz_mm"][..., 0]).sum(axis=0)
    kept = count >= max(STEADY_SHARE * count.max(initial=0), 1)
    return {"time_s": points["time_s"], "cell": points["cell"][kept], "xyz_mm": points["xyz_mm"][:, kept]}


def cell_names(cell: IntArray) -> list[str]:
    """How a cell is called on the page."""
    return [f"panel {p}, column {c}, row {r}" for p, c, r in cell]


def picture_figure(picture: Picture, scale: float, centre_px: FloatArray, cell: IntArray) -> go.Figure:
    """One eye's image with the measured centres (N, 2), in pixels of the full image."""
    width, height = picture.width * scale, picture.height * scale
    figure = new_figure(height=400)
    source = "data:image/png;base64," + base64.b64encode(picture.png).decode()
    figure.add_layout_image(
        source=source, x=-0.5, y=-0.5, sizex=width, sizey=height, xref="x", yref="y", layer="below", sizing="stretch"
    )
    names = np.array(cell_names(cell))
    for panel in np.unique(cell[:, 0]):
        on = (cell[:, 0] == panel) & np.isfinite(centre_px[:, 0])
        figure.add_trace(
            go.Scatter(
                x=centre_px[on, 0],
                y=centre_px[on, 1],
                mode="markers",
                name=f"panel {panel}",
                marker={"size": 5, "color": _panel_colour(panel), "line": {"width": 0.6, "color": "white"}},
                text=names[on],
                hovertemplate="%{text}<br>%{x:.2f}, %{y:.2f} px<extra></extra>",
            )
        )
    figure.update_xaxes(range=[-0.5, width - 0.5], showgrid=False, showticklabels=False, constrain="domain")
    figure.update_yaxes(
        range=[height - 0.5, -0.5], showgrid=False, showticklabels=False, scaleanchor="x", constrain="domain"
    )
    figure.update_layout(margin={"l": 4, "r": 4, "t": 30, "b": 4})
    return figure


def wing_figure(points: Arrays) -> tuple[go.Figure, float, float]:
    """The points in space at the moment of the largest motion, and at rest as small dots.

    Returns the figure, how much the displacement is exaggerated, and the time of that moment in s.
    """
    xyz, cell = points["xyz_mm"], points["cell"]
    mean, normal = middle_and_normal(xyz)
    moved = (xyz - mean) @ normal
    tick = int(np.argmax(np.nansum(moved**2, axis=1)))
    now = moved[tick]
    largest = float(np.nanmax(np.abs(now))) if np.isfinite(now).any() else 0.0
    extent = float(np.linalg.norm(np.nanmax(mean, axis=0) - np.nanmin(mean, axis=0)))
    stretch = _round_factor(STEM_SHARE * extent / largest) if largest > 0.0 else 1.0
    shown = mean + stretch * now[:, None] * normal
    figure = new_figure(height=440, specs=[[{"type": "scene"}]])
    figure.add_trace(_dots(mean, "#a3abb6", cell_names(cell)))
    for panel in np.unique(cell[:, 0]):
        on = cell[:, 0] == panel
        sheet = _sheet(cell[on], shown[on], now[on])
        figure.add_trace(sheet.update(cmin=-largest, cmax=largest, showscale=bool(panel == cell[0, 0])))
    names = [f"{name}<br>{value:+.3f} mm" for name, value in zip(cell_names(cell), now, strict=True)]
    figure.add_trace(_dots(shown, "rgba(40,48,58,0.8)", names))
    span = np.maximum(np.ptp(np.concatenate([mean, shown[np.isfinite(now)]]), axis=0), 1.0)
    axis = {"gridcolor": "#b5bcc4", "showbackground": False, "zeroline": False}
    # As the left eye sees it, from a little aside: x to the right, y down, z away.
    figure.update_layout(
        showlegend=False,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", (VIEW_SIZE * span / span.max()).tolist(), strict=True)),
            "xaxis": axis | {"title": {"text": "x / mm"}},
            "yaxis": axis | {"title": {"text": "y / mm"}},
            "zaxis": axis | {"title": {"text": "z / mm"}, "nticks": 4},
            "camera": {
                "projection": {"type": "orthographic"},
                "up": {"x": 0, "y": -1, "z": 0}, "eye": {"x": -0.4, "y": -0.42, "z": -0.7},
            },
        },
    )  # fmt: skip
    return figure, stretch, float(points["time_s"][tick])


def _sheet(cell: IntArray, xyz_mm: FloatArray, moved_mm: FloatArray) -> go.Surface:
    """A panel's cells as a surface, coloured by displacement; open where cells were not measured."""
    first = cell.min(axis=0)
    place = tuple((cell - first)[:, ::-1][:, :2].T)  # row, column
    grid = np.full((4, *(cell.max(axis=0) - first + 1)[:0:-1]), np.nan)
    grid[:3, place[0], place[1]] = xyz_mm.T
    grid[3, place[0], place[1]] = moved_mm
    return go.Surface(
        x=grid[0], y=grid[1], z=grid[2], surfacecolor=grid[3], colorscale=BENT, opacity=0.9, hoverinfo="skip",
        lighting={"ambient": 0.9, "diffuse": 0.3, "specular": 0.0},
        colorbar={"title": {"text": "mm"}, "thickness": 10, "len": 0.6},
    )  # fmt: skip


def history_figure(points: Arrays, start_s: float) -> go.Figure:
    """Displacement over time of a few cells that lie far apart and were measured well."""
    moved = displacement_mm(points["xyz_mm"])
    chosen = spread_cells(points["xyz_mm"], moved, HISTORIES)
    figure = new_figure(rows=len(chosen), height=90 + 120 * len(chosen), shared_xaxes=True, vertical_spacing=0.03)
    names = cell_names(points["cell"])
    time_s = points["time_s"] - start_s
    for row, index in enumerate(chosen, 1):
        colour = _panel_colour(int(points["cell"][index, 0]))
        figure.add_trace(line(time_s, moved[:, index], names[index], colour, showlegend=False), row=row, col=1)
        figure.add_annotation(
            text=names[index], x=1, y=1, xref="x domain", yref="y domain", xanchor="right", yanchor="bottom",
            showarrow=False, row=row, col=1,
        )  # fmt: skip
        figure.update_yaxes(title_text="mm", row=row, col=1, matches="y")
    figure.update_xaxes(title_text="time / s", row=len(chosen), col=1)
    return figure


def spread_cells(xyz_mm: FloatArray, moved_mm: FloatArray, count: int) -> list[int]:
    """Cells that lie far apart: first the one that moves most, then always the one farthest from those chosen.

    Only cells that were measured nearly as often as the best one take part. In order of the numbers.
    """
    seen = np.isfinite(moved_mm).sum(axis=0)
    mean, _ = middle_and_normal(xyz_mm)
    candidates = np.flatnonzero(seen >= 0.95 * seen.max(initial=1))
    if len(candidates) == 0:
        return []
    energy = np.nansum(moved_mm[:, candidates] ** 2, axis=0) / seen[candidates]
    chosen = [int(candidates[np.argmax(energy)])]
    while len(chosen) < min(count, len(candidates)):
        distance = np.linalg.norm(mean[candidates, None] - mean[None, chosen], axis=-1).min(axis=1)
        chosen.append(int(candidates[np.argmax(distance)]))
    return sorted(chosen)


def _dots(xyz_mm: FloatArray, colour: str, text: list[str]) -> go.Scatter3d:
    return go.Scatter3d(
        x=xyz_mm[:, 0],
        y=xyz_mm[:, 1],
        z=xyz_mm[:, 2],
        mode="markers",
        marker={"size": 2.2, "color": colour},
        text=text,
        hovertemplate="%{text}<extra></extra>",
    )


def _round_factor(value: float) -> float:
    """The nearest of 1, 2, 5, 10, ... below the value, and 1 at least."""
    if value <= 1.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value))


def _panel_colour(panel: int) -> str:
    return COLOURS[panel % len(COLOURS)]
