"""Plot of a fit: measured points with the run through them, and residuals, by column."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..simulation.result import Result
from .plot import COLORS, blank, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 4
"""Largest number of columns in the plot: the first ones."""


def figure(data: Result, result: Result, names: Sequence[str]) -> Figure:
    """Return two panels for each of some columns: both over time [s], and the residual below.

    Raises InputError if matplotlib is missing.
    """
    shown = list(names)[:MOST]
    drawn = blank((7.2, 0.7 + 2.6 * len(shown)), f"{result.mechanism}: fit")
    grid = drawn.subplots(2 * len(shown), 1, sharex=True, squeeze=False, height_ratios=[3, 1] * len(shown))[:, 0]
    for name, over, under, color in zip(shown, grid[::2], grid[1::2], COLORS, strict=False):
        unit = result.units[name]
        over.plot(data.time, data[name], ".", color="#9aa3ad", markersize=3.5, label="measured")
        over.plot(result.time, result[name], color=color, linewidth=1.4, label="fitted run")
        over.set_ylabel(f"{name}\n[{unit}]", fontsize=9)
        over.legend(fontsize=8, frameon=False, loc="best")
        left = data[name] - result[name]
        under.axhline(0.0, color=color, linewidth=0.8)
        under.plot(data.time, left, ".", color="#9aa3ad", markersize=3)
        reach = 1.15 * float(np.nanmax(np.abs(left))) or 1.0
        under.set_ylim(-reach, reach)
        under.set_ylabel(f"left\n[{unit}]", fontsize=9)
        for axes in (over, under):
            tidy(axes)
    grid[-1].set_xlabel("time [s]", fontsize=9)
    drawn.align_ylabels()
    if len(names) > len(shown):
        drawn.supxlabel(f"and {len(names) - len(shown)} more", x=0.01, ha="left", fontsize=7, color="#66727f")
    return drawn
