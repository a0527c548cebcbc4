"""Plots of a result with matplotlib: one panel for each kind of quantity, constraint errors on a logarithmic scale."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..files import atomic
from ..model.errors import InputError
from ..model.words import there_is
from ..result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure", "plot"]

LINES = 8
"""Lines in a panel, at most; those with the largest range are shown."""

METADATA = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Files that can be written, each without what would make its bytes differ from time to time."""

COLORS = ("#3b75af", "#d98c1f", "#3f9268", "#c0523a", "#7a66b0", "#1f8f96", "#b0608c", "#6b7680")
"""One for each body and joint, in the order of the result."""

TITLES = {
    "rad": "Angles",
    "m": "Positions",
    "rad/s": "Angular velocities",
    "m/s": "Velocities",
    "rad/s2": "Angular accelerations",
    "m/s2": "Accelerations",
    "N": "Forces",
    "N.m": "Torques and moments",
    "J": "Energy",
    "W": "Power",
}
"""Panels by unit, in their order; other units follow."""

ERRORS = ("monitor.position_error", "monitor.velocity_error", "monitor.step_error")
"""What has a panel of its own, on a logarithmic scale."""


@dataclass(frozen=True)
class _Panel:
    """Some columns of a result that share an axis."""

    title: str
    label: str
    names: list[str]


def plot(result: Result, path: str | Path, names: Sequence[str] | None = None) -> None:
    """Draw a result into a `.png`, `.svg` or `.pdf` file; see `figure`.

    Raises InputError where the suffix is another one, nothing is called like one of `names`, or matplotlib is missing.
    """
    path = Path(path)
    check_name(path)
    save(figure(result, names), path, 150)


def check_name(path: Path) -> None:
    """InputError where a plot has no kind of this name."""
    if path.suffix not in METADATA:
        raise InputError(f"{path} cannot hold a plot; its name must end in {', '.join(METADATA)}")


def save(drawn: Figure, path: Path, dpi: float) -> None:
    """Write a figure as a whole, the same bytes each time."""
    with atomic(path) as file:
        drawn.savefig(file, format=path.suffix[1:], dpi=dpi, metadata=METADATA[path.suffix])


def figure(result: Result, names: Sequence[str] | None = None) -> Figure:
    """The matplotlib figure of a result: a panel for each unit, over time [s].

    `names` are names or patterns such as "link*.angle". Without them come positions, velocities, forces, energy and
    constraint errors, as far as they change. Raises InputError where nothing is called like one of `names`, or where
    matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("a plot needs matplotlib; install it with: pip install 'alfmu[plot]'") from None
    panels = _panels(result, _interesting(result) if names is None else _matching(result, names))
    columns = 1 if len(panels) < 3 else 2
    rows = -(-len(panels) // columns)
    drawn = Figure(figsize=(7.2 * columns, 0.5 + 2.7 * rows), layout="constrained")
    drawn.suptitle(result.mechanism.replace("_", " "), x=0.01, ha="left", fontsize=14, fontweight="bold")
    for i, panel in enumerate(panels):
        axes = drawn.add_subplot(rows, columns, i + 1)
        _draw(axes, result, panel)
        if i >= len(panels) - columns:
            axes.set_xlabel("time [s]")
    return drawn


def _interesting(result: Result) -> list[str]:
    """What one wants to see first: no accelerations, multipliers and counts, nothing that never changes."""
    names = [
        name
        for name in result.names
        if not name.startswith("multiplier[")
        and not result.units.get(name, "").endswith("/s2")
        and name not in ("monitor.step_error", "monitor.iterations", "monitor.distance", "monitor.singular")
        and (name == "monitor.energy" or _range(result, name) > 0)
    ]
    return names or result.names


def _matching(result: Result, patterns: Iterable[str]) -> list[str]:
    """Columns called like the patterns, each once, in the order of the patterns."""
    found: dict[str, None] = {}
    for pattern in patterns:
        names = [name for name in result.names if name == pattern or fnmatchcase(name, pattern)]
        if not names:
            raise InputError(
                f"the result of {result.mechanism} has nothing like {pattern!r}; {there_is(pattern, result.names)}"
            )
        found |= dict.fromkeys(names)
    return list(found)


def _panels(result: Result, names: Iterable[str]) -> list[_Panel]:
    """Names grouped by unit, known units first, constraint errors last."""
    groups: dict[str, list[str]] = {unit: [] for unit in TITLES}
    errors = []
    for name in names:
        (errors if name in ERRORS else groups.setdefault(result.units.get(name, ""), [])).append(name)
    panels = [
        _Panel(TITLES.get(unit, "Other results"), _printed(unit), group) for unit, group in groups.items() if group
    ]
    return [*panels, _Panel("Constraint errors", "m, rad; per s", errors)] if errors else panels


def _printed(unit: str) -> str:
    """A unit as people write it."""
    return "dimensionless" if unit == "1" else unit.replace(".", "·").replace("2", "²").replace("3", "³")


def _draw(axes: Axes, result: Result, panel: _Panel) -> None:
    """Lines, labels and legend of one panel."""
    chosen = sorted(panel.names, key=lambda name: -_range(result, name))[:LINES]
    shown = [name for name in panel.names if name in chosen]
    low, high = np.inf, -np.inf
    for name, width, style in zip(shown, np.linspace(2.8, 1.2, len(shown)), _styles(result, shown), strict=True):
        values = result[name]
        axes.plot(result.time, values, label=name, linewidth=width, **style)  # a line under another one still shows
        low, high = min(low, values.min()), max(high, values.max())
    if panel.names[0] in ERRORS and high > 0:
        axes.set_yscale("log", nonpositive="mask")
    else:
        axes.ticklabel_format(useOffset=False)
        if high - low < 1e-6 * max(abs(high), abs(low)):  # rounding is no motion
            axes.set_ylim(low - 1e-6 * abs(low), high + 1e-6 * abs(high))
    axes.set_title(panel.title, loc="left", fontsize=11)
    axes.set_ylabel(f"[{panel.label}]" if panel.label else "")
    axes.margins(x=0)
    axes.grid(color="#e3e8ee", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    complete = len(shown) == len(panel.names)
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(1.01, 1.03),
        frameon=False,
        fontsize=8.5,
        title=None if complete else f"{len(shown)} of {len(panel.names)} lines",
        title_fontsize=8.5,
        alignment="left",
    )


def _styles(result: Result, names: Sequence[str]) -> list[dict[str, str]]:
    """Colour by body or joint, the same in all panels, dashes by component; colour alone where there is one owner."""
    if len({_owner(name) for name in names}) == 1:
        return [{"color": COLORS[i % len(COLORS)]} for i in range(len(names))]
    owners = list(dict.fromkeys(map(_owner, result.names)))
    seen = Counter()
    styles = []
    for owner in map(_owner, names):
        dashes = ("-", "--", ":", "-.")[seen[owner] % 4]
        styles.append({"color": COLORS[owners.index(owner) % len(COLORS)], "linestyle": dashes})
        seen[owner] += 1
    return styles


def _owner(name: str) -> str:
    """The body or joint that a column belongs to."""
    return name.split(".")[0]


def _range(result: Result, name: str) -> float:
    """How much a column changes; 0 for what is constant but for rounding."""
    values = result[name]
    change = float(np.ptp(values))
    return change if name in ERRORS or change > 1e-9 * (1 + float(np.abs(values).max())) else 0.0
