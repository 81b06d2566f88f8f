"""How figures of the report look, and the figure of a run's quality over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io
from markupsafe import Markup
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from telemetry.report_data import Arrays

FloatArray = NDArray[np.float64]

COLOURS = ("#3b7dd8", "#d9822b", "#2a9d7f", "#b04fb3", "#c9a227", "#5b6b7f", "#d1495b", "#3aa6c1")
"""Distinct for most eyes, readable on white and on black."""
QUIET = "rgba(128,136,148,0.55)"
TRUTH = "#808894"
BENT = "RdBu"  # for a displacement: white is none
LEGEND = {"orientation": "h", "x": 0, "y": 1.0, "xanchor": "left", "yanchor": "bottom"}
MOST_POINTS = 2000  # of one line


def new_figure(rows: int = 1, columns: int = 1, height: int = 320, **options: Any) -> go.Figure:
    """An empty figure in the page's style."""
    figure = make_subplots(rows=rows, cols=columns, **options)
    figure.update_layout(
        template="none",
        height=height,
        margin={"l": 62, "r": 14, "t": 30, "b": 46},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"family": "system-ui, sans-serif", "size": 12, "color": "#6b7280"},
        colorway=COLOURS,
        legend=LEGEND,
        hovermode="closest",
    )
    figure.update_xaxes(gridcolor="rgba(128,136,148,0.18)", zeroline=False, automargin=True)
    figure.update_yaxes(gridcolor="rgba(128,136,148,0.18)", zeroline=False, automargin=True)
    return figure


def figure_html(figure: go.Figure, name: str) -> Markup:
    """The figure as HTML that needs plotly.js on the page; name: its fixed identifier."""
    html = plotly.io.to_html(
        figure,
        include_plotlyjs=False,
        full_html=False,
        div_id=name,
        config={"displayModeBar": False, "responsive": True},
    )
    return Markup(html)  # plotly escapes what it is given


def thin(x: FloatArray, y: FloatArray, most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """A line of at most `most` points that keeps every peak: the least and the largest value of equal pieces."""
    if len(x) <= most:
        return x, y
    length = -(-len(x) // (most // 2))
    pieces = -(-len(x) // length)
    padded = np.pad(y, (0, pieces * length - len(y)), constant_values=np.nan).reshape(pieces, length)
    first = np.arange(pieces) * length
    low = np.where(np.isnan(padded), np.inf, padded).argmin(axis=1) + first
    high = np.where(np.isnan(padded), -np.inf, padded).argmax(axis=1) + first
    kept = np.unique(np.concatenate([low, high]))
    return x[kept], y[kept]


def line(x: FloatArray, y: FloatArray, name: str, colour: str, **options: Any) -> go.Scatter:
    """A thinned line; gaps stay gaps."""
    x, y = thin(x, y)
    return go.Scatter(x=x, y=y, name=name, mode="lines", line={"color": colour, "width": 1.4}, **options)


def quality_figure(quality: Arrays, start_s: float) -> go.Figure:
    """Scene and match figures, counted cells, residual and flight mode over time."""
    figure = new_figure(rows=4, height=680, shared_xaxes=True, vertical_spacing=0.06, row_heights=[3, 3, 2, 1.5])
    time_s = quality["time_s"] - start_s
    _lines(figure, 1, time_s, quality, _SHARES)
    _lines(figure, 2, time_s, quality, ("detected_left", "detected_right", "matched"), first_colour=5)
    figure.update_traces(legend="legend2", row=2, col=1)
    figure.update_layout(legend2=LEGEND | {"y": figure.layout.yaxis2.domain[1]})
    residual = line(time_s, quality["reprojection_rms_px"], "reprojection", COLOURS[0], showlegend=False)
    figure.add_trace(residual, row=3, col=1)
    figure.add_trace(_states(time_s, quality["mode"]), row=4, col=1)
    for row, title in enumerate(("share", "cells", "rms / px", "mode"), 1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    shares = np.concatenate([quality[name] for name in _SHARES])
    lowest = np.nanmin(shares) if np.isfinite(shares).any() else 0.0
    figure.update_yaxes(range=[min(0.9, lowest) - 0.01, 1.01], row=1, col=1)
    figure.update_yaxes(rangemode="tozero", row=2, col=1)
    figure.update_yaxes(rangemode="tozero", row=3, col=1)
    figure.update_xaxes(title_text="time / s", row=4, col=1)
    return figure


_SHARES = ("char", "mu", "cmp", "precision", "recall")
_SHOWN = {"mu": "MU", "cmp": "CMP", "detected_left": "detected left", "detected_right": "detected right"}


def _lines(
    figure: go.Figure, row: int, time_s: FloatArray, columns: Arrays, names: Sequence[str], first_colour: int = 0
) -> None:
    for number, name in enumerate(names):
        colour = COLOURS[(first_colour + number) % len(COLOURS)]
        figure.add_trace(line(time_s, columns[name], _SHOWN.get(name, name), colour), row=row, col=1)


def _states(time_s: FloatArray, states: NDArray[np.str_]) -> go.Scatter:
    """The flight mode as a step line; only its changes are drawn."""
    change = np.flatnonzero(np.r_[True, states[1:] != states[:-1]]) if len(states) else np.zeros(0, np.int64)
    kept = np.r_[change, len(states) - 1] if len(states) else change
    return go.Scatter(
        x=time_s[kept], y=states[kept], mode="lines", showlegend=False, line={"shape": "hv", "color": COLOURS[5]}
    )
