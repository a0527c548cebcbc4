"""Matplotlib plots of a result: a column of panels, with a caption on omitted columns."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError, needs
from ..model.files import atomic, path_for
from ..model.words import some_like
from ..simulation.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS = 4
"""Largest number of panels of a default figure."""

LINES = 6
"""Largest number of lines of a panel in a default figure; those with the largest range are shown."""

SAME = 2e-3
"""Share of a panel's range within which two columns are drawn as one line: less than its width."""

CLOSE, OFTEN = 0.015, 0.15
"""A line gets markers if it is within the first share of the range of another during the second share of the time."""

TURN, FAR = 2 * np.pi, 4.0
"""Angles of a whole turn [rad] have their own panel if they are this many times as large as the others."""

ROUNDING = 1e-17
"""Lower limit of axes of errors [m, rad; per s]: smaller errors are random."""

METADATA = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""File types, each with the metadata to omit for reproducible files."""

COLORS = ("#3b75af", "#d98c1f", "#3f9268", "#c0523a", "#7a66b0", "#1f8f96", "#b0608c", "#6b7680")
"""Colours of bodies and joints, in the order of the result."""

GRID = "#e3e8ee"

DASHES, MARKERS = ("-", "--", "-.", ":"), "os^Dv<>P"

KINDS = {
    "rad": "angle",
    "m": "position",
    "N": "force",
    "N.m": "moment",
    "J": "energy",
    "rad/s": "angular velocity",
    "m/s": "velocity",
    "rad/s2": "angular acceleration",
    "m/s2": "acceleration",
    "W": "power",
    "A": "current",
    "V": "voltage",
    "Pa": "pressure",
    "m3/s": "flow",
}
"""Labels of axes, by unit, in the order of panels."""

FIRST = ("rad", "m", "N", "N.m", "J")
"""Units of the panels of a default figure, in order of preference."""

ERRORS = ("monitor.position_error", "monitor.velocity_error", "monitor.step_error")
"""Outputs in a separate panel with a logarithmic scale."""

_PART = re.compile(r"(?P<whole>.*\.(?:force|moment))\.[xyz]\Z")
"""Matches components of reactions."""

_REACTION = re.compile(r"\.(force|moment)(\.[xyz])?\|?\Z|\Amultiplier\[")
"""Matches outputs that may have a pole at a singular position."""

POLE = 2
"""Value of `monitor.singular` where reactions are unbounded."""


@dataclass(frozen=True)
class _Line:
    """A line for several columns with the same values."""

    names: tuple[str, ...]
    values: NDArray[np.float64]

    @property
    def owner(self) -> str:
        """Body or joint of the first column."""
        return self.names[0].strip("|").split(".")[0]

    @property
    def label(self) -> str:
        return textwrap.fill(" = ".join(self.names), 34, break_long_words=False, break_on_hyphens=False)


@dataclass
class _Panel:
    """Lines on a common axis."""

    label: str
    lines: list[_Line]
    logarithmic: bool = False
    left_out: list[str] = field(default_factory=list)


def plot(result: Result, path: str | Path, names: Sequence[str] | None = None) -> None:
    """Draw a result into a `.png`, `.svg` or `.pdf` file; see `figure`.

    Raises InputError for another suffix, if no column matches one of `names`, or if matplotlib is missing.
    """
    path = path_for("a plot", path)
    save(figure(result, names), path, 150)


def save(drawn: Figure, path: Path, dpi: float) -> None:
    """Write a figure atomically and reproducibly."""
    suffix = path.suffix.lower()
    with atomic(path) as file:
        drawn.savefig(file, format=suffix[1:], dpi=dpi, metadata=METADATA[suffix])


def require() -> type[Figure]:
    """Return the class of figures; raise InputError if matplotlib is missing."""
    with needs("a plot needs matplotlib", "plot"):
        from matplotlib.figure import Figure
    return Figure


def blank(size: tuple[float, float], title: str, fontsize: float = 11) -> Figure:
    """Return a figure of a size [inch] with a title alone."""
    drawn = require()(figsize=size, layout="constrained")
    drawn.suptitle(title.replace("_", " "), x=0.01, ha="left", fontsize=fontsize, fontweight="bold")
    return drawn


def tidy(axes: Axes) -> None:
    """Add a faint grid below the lines, and remove the frame above and on the right."""
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def figure(result: Result, names: Sequence[str] | None = None) -> Figure:
    """Return the matplotlib figure of a result over time [s]: a column of panels, and a caption on omitted columns.

    `names` are names or patterns such as "link*.angle": all matching columns are shown, in a panel for each unit. By
    default the figure shows varying columns: angles, positions, magnitudes of reactions, and constraint errors. Columns
    with the same values share a line. Raises InputError if no column matches one of `names`, or if matplotlib is
    missing.
    """
    if names is None:
        panels, caption = _chosen(result)
    else:
        panels, caption = _panels(result, [_column(result, name) for name in _matching(result, names)]), ""
    drawn = blank((7.2, 0.7 + 1.75 * len(panels)), result.mechanism)
    grid = drawn.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(grid, panels, strict=True):
        _draw(axes, result, panel)
    steps = np.diff(result.time)
    if steps.size and any(_REACTION.search(name) for panel in panels for line in panel.lines for name in line.names):
        grid[-1].set_xlabel(f"time [s]; forces at points of {steps.max():.3g} s", fontsize=9)
    else:
        grid[-1].set_xlabel(result.facts.get("axis", "time [s]"), fontsize=9)
    for axes in grid:
        for mark in result.facts.get("marks", ()):
            axes.axvline(mark, color="#66727f", linewidth=0.8, linestyle=":")
    drawn.align_ylabels()
    if caption:
        drawn.supxlabel(textwrap.fill(caption, 118), x=0.01, ha="left", fontsize=7, color="#66727f")
    return drawn


def _chosen(result: Result) -> tuple[list[_Panel], str]:
    """Return the panels of a default figure, and a caption on the others."""
    moving = [name for name in result.names if _range(result[name], name) > 0]
    wanted = [name for name in moving if _wanted(result, name)]
    panels = _panels(result, _reduced(result, wanted))
    errors = [panel for panel in panels if panel.logarithmic]
    shown = [panel for panel in panels if not panel.logarithmic]
    if not shown:  # nothing moves: show columns of the motion
        known = [name for name in result.names if result.units.get(name, "") in FIRST and _wanted(result, name)]
        shown = _panels(result, _reduced(result, known or result.names))
    apart = shown[1:2] and shown[0].label == shown[1].label  # a panel of whole turns does not replace another one
    shown = [*shown[: PANELS + bool(apart) - len(errors)], *errors]
    for panel in shown:
        if len(panel.lines) > LINES:
            largest = sorted(panel.lines, key=lambda line: -np.ptp(line.values))[:LINES]
            panel.left_out = [name for line in panel.lines if line not in largest for name in line.names]
            panel.lines = [line for line in panel.lines if line in largest]
    return shown, _caption(result, shown)


def _wanted(result: Result, name: str) -> bool:
    """Return whether a column belongs in a default figure."""
    if name in ERRORS and np.nanmax(result[name]) <= ROUNDING:
        return False
    if name.startswith("monitor."):
        return name in ("monitor.position_error", "monitor.velocity_error", "monitor.energy", "monitor.work")
    unit = result.units.get(name, "")
    return not name.startswith("multiplier[") and (unit in FIRST or unit not in KINDS) and unit != "1"


def _reduced(result: Result, names: Iterable[str]) -> list[_Line]:
    """Return columns as lines, with reactions by their magnitude alone."""
    lines: dict[str, _Line] = {}
    for name in names:
        if found := _PART.match(name):
            whole = found["whole"]
            parts = [result[f"{whole}.{k}"] for k in "xyz" if f"{whole}.{k}" in result.names]
            lines[whole] = _Line((f"|{whole}|",), np.sqrt(np.sum(np.square(parts), axis=0)))
        else:
            lines[name] = _column(result, name)
    return list(lines.values())


def _column(result: Result, name: str) -> _Line:
    return _Line((name,), result[name])


def _caption(result: Result, panels: Sequence[_Panel]) -> str:
    """Return the omitted columns of a figure, by kind and number."""
    shown = {name for panel in panels for line in panel.lines for name in line.names}
    partly = [name for panel in panels for name in panel.left_out]
    counts: Counter[str] = Counter()
    for name in result.names:
        found = _PART.match(name)
        if name in shown or name in partly:
            continue
        if found and f"|{found['whole']}|" in (*shown, *partly):
            counts["component of a reaction"] += 1
        elif _range(result[name], name) == 0:
            counts["constant"] += 1
        elif name.startswith("multiplier["):
            counts["multiplier"] += 1
        elif name.startswith("monitor."):
            counts["monitor"] += 1
        else:
            counts[KINDS.get(result.units.get(name, ""), "other result")] += 1
    said = []
    if partly:
        some = ", ".join(partly[:6]) + (f" and {len(partly) - 6} more" if len(partly) > 6 else "")
        said.append(f"Smaller changes, not shown: {some}.")
    if counts:
        said.append("Also in the result: " + ", ".join(_counted(n, what) for what, n in counts.items()) + ".")
    return " ".join([*said, "Columns to plot can be named (--plot-names)."]) if said else ""


def _counted(n: int, what: str) -> str:
    """Return a number with a noun."""
    plural = {"component of a reaction": "components of reactions", "angular velocity": "angular velocities"}
    plural |= {"velocity": "velocities", "energy": "energies"}
    return f"{n} {what if n == 1 else plural.get(what, what + 's')}"


def _matching(result: Result, patterns: Iterable[str]) -> list[str]:
    """Return columns that match the patterns, each once, in the order of the patterns."""
    found: dict[str, None] = {}
    for pattern in patterns:
        names = [name for name in result.names if name == pattern or fnmatchcase(name, pattern)]
        if not names:
            raise InputError(
                f"the result of {result.mechanism} has no column like {pattern!r}; {some_like(pattern, result.names)}"
            )
        found |= dict.fromkeys(names)
    return list(found)


def _panels(result: Result, lines: Iterable[_Line]) -> list[_Panel]:
    """Return lines grouped by unit, known units first, constraint errors last; equal lines are merged."""
    groups: dict[str, list[_Line]] = {unit: [] for unit in KINDS}
    errors: list[_Line] = []
    for line in lines:
        (name,) = line.names
        part = name.strip("|")
        unit = result.units.get(name) or result.units.get(f"{part}.x", "")
        (errors if name in ERRORS else groups.setdefault(unit, [])).append(line)
    panels = [
        _Panel(_titled(unit), _merged(part)) for unit, group in groups.items() for part in _apart(unit, group) if part
    ]
    return [*panels, _Panel("error [m, rad; per s]", errors, True)] if errors else panels


def _apart(unit: str, lines: list[_Line]) -> list[list[_Line]]:
    """Return lines of a unit by panel: oscillations would be invisible beside many whole turns."""
    reach = [float(np.ptp(line.values)) for line in lines]
    turning = [unit == "rad" and x >= TURN for x in reach]
    others = [x for x, turns in zip(reach, turning, strict=True) if not turns]
    if not others or max(reach) < max(TURN, FAR * max(others)):
        return [lines]
    return [[line for line, turns in zip(lines, turning, strict=True) if turns is which] for which in (False, True)]


def _merged(lines: Sequence[_Line]) -> list[_Line]:
    """Merge lines that are indistinguishable."""
    reach = max(float(np.max(x.values)) for x in lines) - min(float(np.min(x.values)) for x in lines)
    found: list[_Line] = []
    for line in lines:
        for i, other in enumerate(found):
            if np.max(np.abs(line.values - other.values)) <= SAME * reach:
                found[i] = _Line(other.names + line.names, other.values)
                break
        else:
            found.append(line)
    return found


def _titled(unit: str) -> str:
    """Return the label of an axis."""
    printed = "dimensionless" if unit == "1" else unit.replace(".", "·").replace("2", "²").replace("3", "³")
    return f"{KINDS.get(unit, 'value')} [{printed}]" if unit else "value"


def _draw(axes: Axes, result: Result, panel: _Panel) -> None:
    """Draw lines, labels and legend of one panel."""
    values = np.array([line.values for line in panel.lines])
    low, high = float(values.min()), float(values.max())
    logarithmic = panel.logarithmic and high > ROUNDING
    for i, (line, style) in enumerate(zip(panel.lines, _styles(result, panel.lines), strict=True)):
        near = (np.mean(np.abs(values[i] - other) <= CLOSE * (high - low)) for other in values[:i])
        if not panel.logarithmic and any(share > OFTEN for share in near):
            style |= {"marker": MARKERS[i % len(MARKERS)], "markersize": 3.5, "markevery": (0.02 + 0.023 * i, 0.14)}
        if logarithmic:  # mostly round-off, better shown as points
            style |= {"linestyle": "", "marker": ".", "markersize": 2.5}
        poles = _poles(result, line)
        shown = np.where(poles, np.nan, line.values) if poles.any() else line.values
        drawn = axes.plot(result.time, shown, label=line.label, linewidth=1.5, **style)
        if poles.any():  # draw an arrow, and a gap in the line
            top = np.ones(int(poles.sum()))
            arrow: dict[str, Any] = {"marker": "^", "linestyle": "", "markersize": 4, "color": drawn[0].get_color()}
            axes.plot(result.time[poles], top, transform=axes.get_xaxis_transform(), clip_on=False, **arrow)
    if logarithmic:
        axes.set_yscale("log", nonpositive="mask")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], ROUNDING))
    else:
        axes.ticklabel_format(useOffset=False)
        if high - low < 1e-6 * max(abs(high), abs(low)):  # this is round-off
            axes.set_ylim(low - 1e-6 * abs(low), high + 1e-6 * abs(high))
    axes.set_ylabel(panel.label, fontsize=9)
    axes.margins(x=0)
    tidy(axes)
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.04), "borderaxespad": 0.0}
    scale = 3 if logarithmic else 1
    axes.legend(**place, frameon=False, fontsize=7.5, handlelength=2.6, labelspacing=0.35, markerscale=scale)


def _poles(result: Result, line: _Line) -> NDArray[np.bool_]:
    """Return rows (rows,) at which a line is infinite, and its value is only the finite part."""
    may = "monitor.singular" in result.names and any(_REACTION.search(name) for name in line.names)
    return result["monitor.singular"] == POLE if may else np.zeros(len(result.time), bool)


def _styles(result: Result, lines: Sequence[_Line]) -> list[dict[str, Any]]:
    """Return styles: colour by body or joint, the same in all panels, dashes by component; colour alone with one owner.

    Multipliers have no owner.
    """
    if len({"multiplier" if line.owner.startswith("multiplier[") else line.owner for line in lines}) == 1:
        return [{"color": COLORS[i % len(COLORS)], "linestyle": DASHES[i % 4]} for i in range(len(lines))]
    names = sorted(result.names, key=lambda name: name.startswith("multiplier["))  # bodies and joints first
    owners = list(dict.fromkeys(name.split(".")[0] for name in names))
    seen: Counter[str] = Counter()
    styles: list[dict[str, Any]] = []
    for line in lines:
        place = owners.index(line.owner)
        # Bodies and joints beyond the number of colours have different dashes.
        dashes = DASHES[(seen[line.owner] + place // len(COLORS)) % 4]
        styles.append({"color": COLORS[place % len(COLORS)], "linestyle": dashes})
        seen[line.owner] += 1
    return styles


def _range(values: NDArray[np.float64], name: str) -> float:
    """Return the range of a column; 0 if it is constant up to round-off."""
    change = float(np.ptp(values))
    return change if name in ERRORS or change > 1e-9 * (1 + float(np.abs(values).max())) else 0.0
