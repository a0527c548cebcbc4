"""Plotly figures of a sweep: bands over time, histograms, scatter, parallel axes, sensitivities."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..studies.plots import FAINT, FONT, Figure, number_of, panels
from ..view.plot import GRID
from .summary import QUANTILES, Spread

Column = NDArray[np.float64]

INK, WIDE, NARROW, POINT = "#1f5fae", "rgba(31,95,174,0.16)", "rgba(31,95,174,0.32)", "rgba(31,95,174,0.45)"
WORST = "#c0523a"
DIVERGING = [[0, "#c0523a"], [0.5, "#f6f8fa"], [1, "#1f5fae"]]
ALONG = [[0, "#30123b"], [0.25, "#2f6fd0"], [0.5, "#2aa37a"], [0.75, "#e0a528"], [1, "#b5301d"]]

ROW = 300
"""Height of a row of panels [px]."""

BINS = 40


def _panels(titles: Sequence[str], across: int, row: int = ROW) -> Figure:
    """Return a figure with empty panels, `across` in a row."""
    between = 0.09 if across < 4 else 0.05, 0.3 / math.ceil(len(titles) / across)
    axis = {"gridcolor": GRID, "zeroline": False, "ticks": "outside", "tickcolor": GRID, "linecolor": FAINT}
    figure = panels(titles, across, (95, row), between, axis)
    figure["layout"] |= {"margin": {"l": 70, "r": 20, "t": 65, "b": 55}, "showlegend": False}
    for title in figure["layout"]["annotations"]:
        title |= {"yshift": 4, "font": {"size": 12}}
    return figure


def _axes(i: int) -> dict[str, str]:
    return {"xaxis": f"x{number_of(i)}", "yaxis": f"y{number_of(i)}"}


def _named(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def _plain(x: Column) -> list[float | None]:
    """Return numbers for JSON with six digits; None for NaN."""
    return [float(f"{each:.6g}") if math.isfinite(each) else None for each in x.tolist()]


def bands(time: Column, columns: dict[str, Column], units: Sequence[str], worst: dict[str, int]) -> Figure:
    """Plot outputs (cases, points) over time [s]: bands of 90 % and 50 % of the cases, the median, and the case, by
    index, with the largest magnitude."""
    figure = _panels([_named(name, unit) for name, unit in zip(columns, units, strict=True)], min(2, len(columns)))
    for i, (name, values) in enumerate(columns.items()):
        t = _plain(time)
        known = np.isfinite(values).any(axis=0)
        quantiles = np.full((len(QUANTILES), len(time)), np.nan)
        quantiles[:, known] = np.nanquantile(values[:, known], QUANTILES, axis=0)
        low, quarter, median, three, high = (_plain(each) for each in quantiles)
        common = {"type": "scatter", "mode": "lines", "x": t, **_axes(i), "showlegend": i == 0}
        empty = {"line": {"width": 0}, "hoverinfo": "skip"}
        figure["data"] += [
            {**common, **empty, "y": low, "showlegend": False},
            {**common, **empty, "y": high, "fill": "tonexty", "fillcolor": WIDE, "name": "90 % of the cases"},
            {**common, **empty, "y": quarter, "showlegend": False},
            {**common, **empty, "y": three, "fill": "tonexty", "fillcolor": NARROW, "name": "50 %"},
            {**common, "y": median, "line": {"color": INK, "width": 2}, "name": "median"},
        ]
        line = {"color": WORST, "width": 1.2, "dash": "dot"}
        figure["data"].append({**common, "y": _plain(values[worst[name]]), "line": line, "name": "largest magnitude"})
        figure["layout"][f"xaxis{number_of(i)}"]["title"] = {"text": "time [s]", "standoff": 4}
    figure["layout"] |= {"showlegend": True, "hovermode": "x unified"}
    place = {"x": 0, "xanchor": "left", "y": 0.995, "yanchor": "top", "yref": "container"}
    figure["layout"]["legend"] = {"orientation": "h", "traceorder": "normal", **place}
    figure["layout"]["margin"]["t"] = 75
    return figure


def histograms(columns: dict[str, Column], spreads: Sequence[Spread]) -> Figure:
    """Plot distributions of measures, with quantiles."""
    figure = _panels([_named(s.name, s.unit) for s in spreads], min(3, len(spreads)), 240)
    for i, (s, values) in enumerate(zip(spreads, columns.values(), strict=True)):
        known = values[np.isfinite(values)]
        counts, edges = np.histogram(known, min(BINS, max(5, int(math.sqrt(len(known))))))
        middle = (edges[1:] + edges[:-1]) / 2
        bar = {"type": "bar", "x": _plain(middle), "y": counts.tolist(), "width": _plain(np.diff(edges))}
        look = {"marker": {"color": NARROW, "line": {"color": "white", "width": 0.5}}, "name": s.name}
        figure["data"].append({**bar, **look, **_axes(i), "hovertemplate": "%{x:.4g}: %{y} cases<extra></extra>"})
        for q, x in zip(QUANTILES, s.quantiles, strict=True):
            line = {"color": INK, "width": 2 if q == 0.5 else 1, "dash": "solid" if q == 0.5 else "dot"}
            at = {"xref": f"x{number_of(i)}", "yref": f"y{number_of(i)} domain", "x0": x, "x1": x, "y0": 0, "y1": 1}
            figure["layout"]["shapes"].append({"type": "line", **at, "line": line})
        figure["layout"][f"yaxis{number_of(i)}"]["title"] = {"text": "cases" if i % 3 == 0 else "", "standoff": 4}
    return figure


def scatter(
    varied: dict[str, Column], kept: dict[str, Column], units: dict[str, str], cases: NDArray[np.int64]
) -> Figure:
    """Plot each measure (rows) over each varied quantity (columns)."""
    across = len(varied)
    figure = _panels([""] * (across * len(kept)), across, 230)
    i = 0
    for k, (name, y) in enumerate(kept.items()):
        for c, (other, x) in enumerate(varied.items()):
            trace = {"type": "scatter", "mode": "markers", "x": _plain(x), "y": _plain(y), **_axes(i)}
            size = 3 if len(x) > 400 else 5
            about = {"customdata": cases.tolist(), "marker": {"color": POINT, "size": size}}
            said = f"case %{{customdata}}<br>{other} %{{x:.4g}}<br>{name} %{{y:.4g}}<extra></extra>"
            figure["data"].append({**trace, **about, "hovertemplate": said})
            n = number_of(i)
            if c == 0:
                text = _named(name, units.get(name, "")).replace(" [", "<br>[")
                figure["layout"][f"yaxis{n}"]["title"] = {"text": text, "font": {"size": 12}, "standoff": 4}
            else:
                figure["layout"][f"yaxis{n}"] |= {"matches": f"y{number_of(k * across)}", "showticklabels": False}
            if k == len(kept) - 1:
                figure["layout"][f"xaxis{n}"]["title"] = {"text": _named(other, units.get(other, ""))}
            if k:
                figure["layout"][f"xaxis{n}"]["matches"] = f"x{number_of(c)}"
            i += 1
    figure["layout"]["margin"]["l"] = 95
    figure["layout"]["annotations"] = []
    return figure


def parallel(varied: dict[str, Column], kept: dict[str, Column], units: dict[str, str]) -> Figure:
    """Plot a line for each case across axes of all quantities, coloured by the first measure; axes can be moved and
    filtered."""
    dimensions = []
    for name, x in {**varied, **kept}.items():
        dimensions.append({"label": _named(name, units.get(name, "")), "values": _plain(x)})
    colour = next(iter(kept))
    bar = {
        "title": {"text": _named(colour, units.get(colour, "")), "side": "right"},
        "thickness": 12,
        "outlinewidth": 0,
    }
    line = {"color": _plain(kept[colour]), "colorscale": ALONG, "showscale": True, "colorbar": bar}
    trace = {
        "type": "parcoords",
        "dimensions": dimensions,
        "line": line,
        "labelangle": -12,
        "labelfont": {"size": 12},
        "tickfont": {"size": 10, "color": FAINT},
        "rangefont": {"size": 1, "color": "rgba(0,0,0,0)"},
    }
    layout = {"font": FONT, "height": 430, "margin": {"l": 80, "r": 30, "t": 95, "b": 30}}
    return {"data": [trace], "layout": layout}


def sensitivities(spreads: Sequence[Spread], varied: Sequence[str]) -> Figure:
    """Plot rank correlations of measures with varied quantities as a map."""
    z = [[s.sensitivities.get(name, 0.0) for name in varied] for s in spreads]
    text = [[f"{x:+.2f}" for x in row] for row in z]
    bar = {"thickness": 12, "outlinewidth": 0, "tickvals": [-1, -0.5, 0, 0.5, 1]}
    trace = {
        "type": "heatmap",
        "x": list(varied),
        "y": [s.name for s in spreads],
        "z": [[round(x, 4) for x in row] for row in z],
        "text": text,
        "texttemplate": "%{text}",
        "zmin": -1,
        "zmax": 1,
        "xgap": 2,
        "ygap": 2,
        "colorscale": DIVERGING,
        "colorbar": bar,
        "hovertemplate": "%{y} with %{x}: %{text}<extra></extra>",
    }
    layout = {
        "font": FONT,
        "height": 110 + 27 * len(spreads),
        "margin": {"l": 10, "r": 20, "t": 45, "b": 20},
        "xaxis": {"side": "top", "fixedrange": True, "type": "category"},
        "yaxis": {"autorange": "reversed", "automargin": True, "fixedrange": True, "type": "category"},
        "plot_bgcolor": "white",
    }
    return {"data": [trace], "layout": layout}
