"""Figure of a study of coupling: error over step by master, and the energy created by coupling over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..view.plot import COLORS, blank, tidy
from .case import Case

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOOKS = {"held": (COLORS[3], "o"), "extrapolated": (COLORS[1], "s"), "iterated": (COLORS[0], "^")}
"""Colour and marker of each master."""


def figure(
    name: str, cases: Sequence[Case], orders: Mapping[str, float], stable: Mapping[str, tuple[float, bool]]
) -> Figure:
    """Return the matplotlib figure of a study: runs, `orders` by master, the largest `stable` steps [s].

    Raises InputError if matplotlib is missing.
    """
    drawn = blank((9.6, 4.2), f"{name}: cost of coupling")
    error, energy = drawn.subplots(1, 2)
    masters = list(orders)
    for master in masters:
        color, marker = _LOOKS[master]
        used = [case for case in cases if case.master == master and np.isfinite(case.error) and case.error > 0]
        order = orders[master]
        label = master if np.isnan(order) else f"{master}, order {order:.2f}"
        error.loglog([c.step for c in used], [c.error for c in used], marker=marker, color=color, label=label, ms=5)
        limit, ended = stable.get(master, (0.0, False))
        if limit and ended:
            error.axvline(limit, color=color, linewidth=1.0, linestyle=":")
            label = f"{master} fails\nbeyond {limit:.2g} s"
            error.annotate(
                label,
                (limit, 0.02 + 0.12 * masters.index(master)),
                xycoords=("data", "axes fraction"),
                xytext=(-4, 0),
                textcoords="offset points",
                fontsize=7,
                color=color,
                ha="right",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )
    error.set_xlabel("communication step [s]", fontsize=9)
    error.set_ylabel("largest error over the largest value", fontsize=9)
    shown = _shown(cases, masters)
    for case in shown:
        energy.plot(case.time, case.made, color=_LOOKS[case.master][0], label=case.master, linewidth=1.5)
    if shown:
        energy.set_title(f"communication step {shown[0].step:g} s", fontsize=9, loc="right")
        reach = sorted(float(np.abs(case.made).max(initial=0.0)) for case in shown)
        if reach[-1] > 20 * reach[0] > 0:
            energy.set_yscale("symlog", linthresh=max(reach[0], reach[-1] * 1e-8) / 5)
    else:
        energy.text(0.5, 0.5, "no power bond is known", ha="center", transform=energy.transAxes, fontsize=9)
    energy.set_xlabel("time [s]", fontsize=9)
    energy.set_ylabel("energy created by coupling [J]", fontsize=9)
    for axes in (error, energy):
        tidy(axes)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False, fontsize=8, loc="best")
    return drawn


def _shown(cases: Sequence[Case], masters: list[str]) -> list[Case]:
    """Return one run of each master, all of the longest step at which every master is stable."""
    fit = [case for case in cases if np.isfinite(case.error) and not np.isnan(case.energy)]
    good = [{case.step: case for case in fit if case.master == master} for master in masters]
    common = set.intersection(*(set(each) for each in good)) if good else set()
    return [each[max(common)] for each in good] if common else []
