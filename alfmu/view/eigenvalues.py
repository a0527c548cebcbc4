"""Plot of eigenvalues in the complex plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .plot import COLORS, blank, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATIOS = (0.1, 0.3, 0.6)
"""Damping ratios of the dotted lines."""


def figure(values: Sequence[NDArray[np.complex128]], times: Sequence[float], name: str) -> Figure:
    """Return the matplotlib figure of eigenvalues [1/s] of one state, or of states at several times [s], coloured by
    time.

    The unstable half plane is shaded; dotted lines show damping ratios. Raises InputError if matplotlib is missing.
    """
    drawn = blank((5.6, 4.6), name)
    axes = drawn.subplots()
    every = np.concatenate(list(values)) if values else np.zeros(0)
    reach = 1.15 * max(np.abs(every).max(initial=0.0), 1e-9)
    deep = 1.15 * max(np.abs(every.real).max(initial=0.0), 0.1 * reach)
    axes.axvspan(0.0, deep, color="#f6e4e0", linewidth=0)
    for ratio in RATIOS:
        x = min(deep, reach * ratio / np.sqrt(1 - ratio**2))
        y = x * np.sqrt(1 - ratio**2) / ratio
        axes.plot([-x, 0, -x], [-y, 0, y], color="#9aa5b1", linewidth=0.7, linestyle=":")
        axes.annotate(f"{ratio:g}", (-x, y), fontsize=7, color="#66727f", ha="left", va="bottom")
    if len(values) > 1:
        points = axes.scatter(
            every.real, every.imag, c=np.repeat(times, [len(x) for x in values]), s=14, cmap="viridis", zorder=3
        )
        drawn.colorbar(points, ax=axes, label="time [s]")
    else:
        axes.plot(every.real, every.imag, "x", color=COLORS[0], markersize=8, markeredgewidth=1.8, zorder=3)
    axes.axhline(0.0, color="#66727f", linewidth=0.8)
    axes.axvline(0.0, color="#66727f", linewidth=0.8)
    axes.set_xlim(-deep, deep)
    axes.set_ylim(-reach, reach)
    axes.set_xlabel("real part [1/s]: decays to the left, grows to the right", fontsize=9)
    axes.set_ylabel("imaginary part [rad/s]", fontsize=9)
    tidy(axes)
    return drawn
