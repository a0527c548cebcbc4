"""Interactive figures of studies as plotly data: errors against run time, steps and tolerances.

A figure is a dictionary for JSON with `data` and `layout`; this module does not need plotly.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..view.plot import GRID
from .charts import LEAST, Line
from .looks import LOOKS, integrator, line_of
from .tables import Row, number

Figure = dict[str, Any]

GAP = 0.1
"""Share of the width and height of a figure between its panels."""

MOST = 1e4
"""Errors above this limit are outside a panel until one zooms out: they belong to runs that lost the motion."""

DECADES = 2
"""Smallest range of an error axis in decades."""

ABOVE = 40
"""Space between the panels and the buttons above them [px]."""

BAR = 30
"""Height of the plotly toolbar, below which the buttons are [px]."""

FONT = {"family": "system-ui, sans-serif", "size": 13, "color": "#1c2733"}
FAINT = "#6b7680"


def against_time(
    rows: Sequence[Row],
    quantities: Sequence[str],
    time: str,
    style_by: str,
    group: str,
    floors: Mapping[str, float | None],
) -> Figure:
    """Plot quantities against run time, with a panel for each, and a line style for each value of `style_by`.

    Buttons select a value of the column `group`; other codes are always visible. `floors` are errors of the reference.
    """
    own = [r for r in rows if r["code"] == "alfmu"]
    kinds, groups = (list(dict.fromkeys(str(r[name]) for r in own)) for name in (style_by, group))
    figure = _log_panels(quantities, 2, f"run time, {time}")
    data = figure["data"]
    of: list[str | None] = []
    """Group of each trace."""
    lines: dict[tuple, list[Row]] = {}
    for row in sorted(rows, key=lambda r: r["code"] != "alfmu"):
        lines.setdefault((integrator(row), *(row[x] for x in ("code", "formulation", "way"))), []).append(row)
    for key, line in lines.items():
        mine = line[0]["code"] == "alfmu"
        name = f"{key[0]}, {line[0][style_by]}" if mine else f"{key[0]} ({line[0]['language']})"
        kind = line_of(str(line[0][style_by]), kinds) if mine else LINE_OF_OTHERS
        first = True
        for i, quantity in enumerate(quantities):
            known = [r for r in line if _drawn(r.get(quantity)) and _drawn(r.get(time))]
            if known:
                x, y = [number(r, time) for r in known], [max(number(r, quantity), LEAST) for r in known]
                about = [_about(r) for r in known]
                data.append(_trace(i, x, y, name, key[0], kind, about, first) | {"legendgroup": name})
                of.append(str(line[0][group]) if mine else None)
                first = False
    for i, quantity in enumerate(quantities):
        if floor := floors.get(quantity):
            _floor(figure["layout"], i, floor)
    _scaled(figure)
    if len(groups) > 1:
        shown = {each: [x is None or x == each for x in of] for each in groups}
        for trace, visible in zip(data, shown[groups[0]], strict=True):
            trace["visible"] = visible
        buttons = [
            {"label": each, "method": "restyle", "args": [{"visible": visible}]} for each, visible in shown.items()
        ]
        buttons.append({"label": "all", "method": "restyle", "args": [{"visible": [True] * len(of)}]})
        layout = figure["layout"]
        inner = layout["height"] - layout["margin"]["t"] - layout["margin"]["b"]
        layout["height"] += BAR
        layout["margin"]["t"] += BAR
        place = {"direction": "right", "type": "buttons", "x": 0, "xanchor": "left", "yanchor": "bottom"}
        place["y"] = 1 + ABOVE / inner
        figure["layout"]["updatemenus"] = [{**place, "buttons": buttons, "pad": {"b": 4}, "showactive": True}]
    return figure


def convergence(panels: Mapping[str, Sequence[Row]], orders: Mapping[str, float], equal: str, quantity: str) -> Figure:
    """Plot a quantity over the step or tolerance: rows by the name of the axis, and measured orders by integrator.

    In the panel of the axis `equal`, a dashed line marks equality with the tolerance.
    """
    figure = _log_panels([f"{quantity} over {axis.split(' ')[0]}" for axis in panels], len(panels), None)
    for i, (axis, rows) in enumerate(panels.items()):
        figure["layout"][f"xaxis{number_of(i)}"]["title"] = {"text": axis}
        for name in dict.fromkeys(map(integrator, rows)):
            known = [r for r in rows if integrator(r) == name and _drawn(r.get(quantity))]
            if known:
                text = f"{name}: order {orders[name]:.1f}" if name in orders else name
                x, y = [number(r, "value") for r in known], [max(number(r, quantity), LEAST) for r in known]
                line = LINE_OF_OTHERS
                figure["data"].append(_trace(i, x, y, text, name, line, [_about(r) for r in known], True))
        if axis == equal:
            _equal(figure, i)
    _scaled(figure)
    return figure


def _equal(figure: Figure, i: int) -> None:
    """Add a faint line on which the error of panel i equals the tolerance."""
    x = sorted({value for trace in figure["data"] if trace["xaxis"] == f"x{number_of(i)}" for value in trace["x"]})
    if x:
        line = {"color": FAINT, "dash": "dash", "width": 1}
        at = {"xref": f"x{number_of(i)}", "yref": f"y{number_of(i)}"}
        place = {**at, "x0": x[0], "x1": x[-1], "y0": x[0], "y1": x[-1]}
        figure["layout"]["shapes"].append({"type": "line", **place, "line": line})


def _scaled(figure: Figure) -> None:
    """Set the error axes of each panel to whole decades, ignoring values above MOST."""
    for i in range(sum(key.startswith("yaxis") for key in figure["layout"])):
        own = [trace for trace in figure["data"] if trace["yaxis"] == f"y{number_of(i)}"]
        values = [y for trace in own for y in trace["y"] if y <= MOST]
        if values:
            low, high = math.floor(math.log10(min(values)) - 0.1), math.ceil(math.log10(max(values)) + 0.1)
            figure["layout"][f"yaxis{number_of(i)}"]["range"] = [min(low, high - DECADES), high]


LINE_OF_OTHERS = Line("-", "solid")


def _drawn(value: Any) -> bool:
    return value is not None and math.isfinite(value)


def _about(row: Row) -> str:
    value = f"{str(row['control']).split(' ')[0]} {row['value']:.3g}"
    steps = f", {row['steps']} steps" if row.get("steps") else ""
    return f"{row['code']}, {row['formulation']}, {row['way']} ({row['language']})<br>{value}{steps}"


def number_of(i: int) -> str:
    """Return the number of panel i in the names of its axes; the first has none."""
    return str(i + 1) if i else ""


def _trace(
    i: int, x: list[Any], y: list[Any], name: str, who: str, kind: Line, about: list[str], legend: bool
) -> dict[str, Any]:
    """Return a line of an integrator in panel i."""
    look = LOOKS[who]
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "x": x,
        "y": y,
        "xaxis": f"x{number_of(i)}",
        "yaxis": f"y{number_of(i)}",
        "name": name,
        "showlegend": legend,
        "text": about,
        "hovertemplate": "<b>%{fullData.name}</b><br>error %{y:.3g}<br>%{x:.3g}<br>%{text}<extra></extra>",
        "line": {"color": look.colour, "dash": kind.dash, "width": 1.6},
        "marker": {
            "color": look.colour,
            "symbol": look.symbol + "-open" * (not look.filled),
            "size": 8,
            "line": {"color": look.colour, "width": 1.5},
        },
    }


def panels(
    titles: Sequence[str], across: int, sides: tuple[float, float], between: tuple[float, float], axis: dict[str, Any]
) -> Figure:
    """Return a figure with empty panels, `across` in a row.

    `sides` are heights of the margins above all panels and of a row [px], `between` the shares of width and height of
    the figure between panels, `axis` the attributes of all axes.
    """
    down = math.ceil(len(titles) / across)
    width, height = (1 - between[0] * (across - 1)) / across, (1 - between[1] * (down - 1)) / down
    layout: dict[str, Any] = {"font": FONT, "height": sides[0] + sides[1] * down, "plot_bgcolor": "white"}
    layout |= {"hovermode": "closest", "annotations": [], "shapes": []}
    for i, title in enumerate(titles):
        left, top, n = i % across * (width + between[0]), 1 - i // across * (height + between[1]), number_of(i)
        layout[f"xaxis{n}"] = {**axis, "domain": [left, min(1.0, left + width)], "anchor": f"y{n}"}
        layout[f"yaxis{n}"] = {**axis, "domain": [max(0.0, top - height), top], "anchor": f"x{n}"}
        place = {"xref": "paper", "yref": "paper", "x": left, "y": top, "xanchor": "left", "yanchor": "bottom"}
        layout["annotations"].append({**place, "text": f"<b>{title}</b>", "showarrow": False})
    return {"data": [], "layout": layout}


def _log_panels(titles: Sequence[str], across: int, x_title: str | None) -> Figure:
    """Return a figure with empty log-log panels, `across` in a row."""
    axis = {"type": "log", "gridcolor": GRID, "exponentformat": "power", "dtick": 1, "zeroline": False}
    figure = panels(titles, across, (90, 330), (GAP, GAP), {**axis, "ticks": "outside"})
    layout = figure["layout"]
    layout["margin"] = {"l": 60, "r": 20, "t": 90, "b": 55}
    layout["legend"] = {"font": {"size": 12}, "groupclick": "togglegroup", "itemwidth": 50, "x": 1.02, "y": 1}
    for i in range(len(titles)):
        layout[f"yaxis{number_of(i)}"]["dtick"] = None
        if x_title and i // across == (len(titles) - 1) // across:
            layout[f"xaxis{number_of(i)}"]["title"] = {"text": x_title}
        if x_title and i:
            layout[f"xaxis{number_of(i)}"]["matches"] = "x"
    return figure


def _floor(layout: dict[str, Any], i: int, value: float) -> None:
    """Add a dashed line at the error of the reference."""
    n = number_of(i)
    at = {"xref": f"x{n} domain", "yref": f"y{n}"}
    line = {"color": FAINT, "dash": "dash", "width": 1}
    layout["shapes"].append({"type": "line", **at, "x0": 0, "x1": 1, "y0": value, "y1": value, "line": line})
    text = {"text": "error of the reference", "font": {"size": 11, "color": FAINT}, "showarrow": False}
    place = {"x": 1, "y": math.log10(value), "xanchor": "right", "yanchor": "bottom"}
    layout["annotations"].append({**at, **place, **text})
