"""Films of small motions: the mechanism moves in a mode at a visible amplitude, with its loops closed."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..model.errors import InputError
from ..model.files import path_for
from ..model.words import counted
from ..simulation.result import Result
from ..view.picture import animate
from .loops import STEP, Loops
from .situation import Situation, Vector

SECONDS = 2.0
"""Time [s] of one vibration in a film."""

FRAMES = 60
"""Number of frames of one vibration [1]."""


def motion_of(where: Situation, shape: Mapping[str, complex], amplitude: float) -> Result:
    """Return one vibration in a shape (coordinate -> complex change) about a state: positions only, loops closed.

    The largest change of a coordinate is `amplitude` [rad, lengths over the size of the mechanism]. Raises InputError
    if the loops cannot be closed at that amplitude.
    """
    loops, e = Loops(where), where.equations
    way = np.zeros(e.n, complex)
    way[: len(where.coordinates)] = [shape[c.name] for c in where.coordinates]
    way /= loops.scale
    way = way * (amplitude / max(np.abs(way).max(), 1e-300))
    phases = np.linspace(0.0, 2 * math.pi, FRAMES + 1)
    rows, y, before = [], loops.home.copy(), np.zeros_like(loops.home)
    for phase in phases:
        wanted = (way * np.exp(1j * phase)).real
        # Steps from the previous position are small enough to stay in the same assembly.
        parts = max(1, math.ceil(np.abs(wanted - before).max() / (STEP / 2)))
        for part in range(1, parts + 1):
            ahead = loops.home + before + (wanted - before) * part / parts
            found = loops.closed(y + (ahead - y), y)
            if found is None:
                raise InputError(
                    f"{where.name}: the loops cannot be closed at an amplitude of {amplitude:g}; take a smaller one"
                )
            y = found
        before = wanted
        rows.append(_readings(where, y * loops.scale))
    names, units = tuple(v.name for v in e.outputs), {v.name: v.unit for v in e.outputs}
    return Result(where.name, phases / (2 * math.pi) * SECONDS, names, units, np.array(rows))


def _readings(where: Situation, q: Vector) -> Vector:
    e = where.equations
    return where.value("readings", where.at_rest(q), a=np.zeros(e.n), lam=np.zeros(e.l))


def film(
    linear: Any,
    path: Path,
    mode: int,
    amplitude: float,
    fps: float,
    progress: Callable[[Any], Any] = iter,
) -> None:
    """Write a mode of a linearisation as a film (`Linearization.film`)."""
    path_for("a film", path)
    modes = linear.modes
    if isinstance(mode, bool) or not isinstance(mode, int) or not 1 <= mode <= len(modes):
        raise InputError(f"{linear.mechanism}: there is no mode {mode!r}; it has {counted(len(modes), 'mode')}")
    if not (math.isfinite(amplitude) and 0 < amplitude <= math.pi):
        raise InputError(f"{linear.mechanism}: the amplitude is {amplitude}; it must be above 0 and at most pi")
    where = linear.situation
    declared = where.source.drawn()
    result = motion_of(where, modes[mode - 1].shape, amplitude)
    animate(declared, result, path, parameters=where.parameters, fps=fps, progress=progress)
