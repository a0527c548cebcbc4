"""Figures of studies with matplotlib: errors against run time, and maps of classes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..view.plot import blank, tidy
from .tables import Row, measured, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALE = 0.5
"""Share by which cells with a note are paler."""

LEAST = 1e-17
"""Value at which zero errors are drawn."""


@dataclass(frozen=True)
class Look:
    """Colour and marker of an integrator, the marker by its names in matplotlib and in plotly."""

    colour: str
    marker: str
    symbol: str
    filled: bool
    """Whether the marker is filled, for integrators of alfmu; those of other codes are open."""


@dataclass(frozen=True)
class Line:
    """A line style by its names in matplotlib and in plotly."""

    style: str
    dash: str


def slope(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Return the slope of a straight line through points on log-log scales; None for less than two points."""
    if len(set(x)) < 2:
        return None
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def scatter(
    title: str,
    rows: Sequence[Row],
    quantities: Sequence[str],
    time: str,
    label: Callable[[Row], str],
    look: Callable[[Row], tuple[Look, Line]],
    floors: Mapping[str, float | None],
) -> Figure:
    """Plot quantities against run time, with a panel for each and a line for each label, styled by `look`.

    `floors` are errors of the reference, drawn as dashed lines.
    """
    drawn = blank((13.5, 8.2), title, 14)
    labels = list(dict.fromkeys(map(label, rows)))
    for axes, quantity in zip(drawn.subplots(2, 2, sharex=True).flat, quantities, strict=True):
        for name in labels:
            line = [r for r in rows if label(r) == name and r.get(time) is not None]
            line = [r for r in line if (value := measured(r, quantity)) is not None and np.isfinite(value)]
            if line:
                x, y = [number(r, time) for r in line], [max(number(r, quantity), LEAST) for r in line]
                its, kind = look(line[0])
                style = {"color": its.colour, "marker": its.marker, "linestyle": kind.style}
                style["markerfacecolor"] = its.colour if its.filled else "white"
                axes.loglog(x, y, linewidth=1.2, markersize=4.5, label=name, **style)
        if floors.get(quantity):
            axes.axhline(floors[quantity], color="0.4", linestyle="--", linewidth=0.9)
            text = {
                "xy": (0.99, floors[quantity]),
                "xycoords": ("axes fraction", "data"),
                "ha": "right",
                "va": "bottom",
            }
            axes.annotate("error of the reference", fontsize=8, color="0.4", **text)
        axes.set_title(quantity, loc="left", fontsize=11)
        tidy(axes)
    for axes in drawn.axes[2:]:
        axes.set_xlabel(f"run time, {time}")
    lines = {name: line for axes in drawn.axes for line, name in zip(*axes.get_legend_handles_labels(), strict=True)}
    kept = [name for name in labels if name in lines]
    drawn.legend([lines[name] for name in kept], kept, loc="outside right upper", fontsize=8, frameon=False)
    return drawn


@dataclass(frozen=True)
class Map:
    """A map of cells: the class of each by the names of its row and column, and notes on some, which are pale."""

    title: str
    across: str
    down: str
    columns: Sequence[str]
    rows: Sequence[str]
    classes: Mapping[tuple[str, str], str]
    notes: Mapping[tuple[str, str], str]


def maps(title: str, each: Sequence[Map], colours: Mapping[str, str]) -> Figure:
    """Plot maps in rows of two, with one legend."""
    width = 2 if len(each) > 1 else 1
    lines = [each[i : i + width] for i in range(0, len(each), width)]
    heights = [max(1.2 + 0.3 * len(m.rows) for m in line) for line in lines]
    figure = blank((7.4 * width, sum(heights) + 1.1), title, 14)
    grid = figure.add_gridspec(len(lines), width, height_ratios=heights)
    for i, line in enumerate(lines):
        for k, each_map in enumerate(line):
            _map(figure.add_subplot(grid[i, k]), each_map, colours)
    from matplotlib.patches import Patch

    seen = {c for m in each for c in m.classes.values()}
    handles = [Patch(facecolor=c, edgecolor="0.3", label=name) for name, c in colours.items() if name in seen]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5), fontsize=9, frameon=False)
    return figure


def _map(axes: Axes, one: Map, colours: Mapping[str, str]) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    names = list(colours)
    table = np.full((len(one.rows), len(one.columns)), np.nan)
    for i, row in enumerate(one.rows):
        for k, column in enumerate(one.columns):
            if (row, column) in one.classes:
                table[i, k] = names.index(one.classes[row, column])
            if note := one.notes.get((row, column)):
                axes.add_patch(Rectangle((k - 0.5, i - 0.5), 1, 1, color="white", alpha=PALE, linewidth=0))
                axes.text(k, i, note, ha="center", va="center", fontsize=6.5, color="0.15")
    shades = ListedColormap(list(colours.values()))
    axes.imshow(table, cmap=shades, vmin=-0.5, vmax=len(names) - 0.5, aspect="auto", interpolation="nearest")
    axes.set_xticks(range(len(one.columns)), [x.replace(", ", "\n") for x in one.columns], fontsize=8)
    axes.set_yticks(range(len(one.rows)), one.rows, fontsize=8)
    axes.set_xticks(np.arange(-0.5, len(one.columns)), minor=True)
    axes.set_yticks(np.arange(-0.5, len(one.rows)), minor=True)
    axes.grid(which="minor", color="white", linewidth=1.5)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(one.title, loc="left", fontsize=10.5)
    axes.set_xlabel(one.across, fontsize=9)
    axes.set_ylabel(one.down, fontsize=9)
