"""States in which a mechanism is analysed: its start, an equilibrium, instants of a motion."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..equations import Equations
from ..kernel import DEFAULT
from ..model.errors import InputError
from ..model.words import in_words
from ..runtime import Instance
from ..runtime.pipeline import ready
from ..simulation import instance, signals_of
from ..simulation.result import Signal
from .equilibria import Equilibrium, equilibria
from .situation import Situation, Source, Subject, begun, situation_of, source

PLACES = ("start", "equilibrium")
"""Words for states in which a mechanism is analysed."""


STARTS = ("declared", "equilibrium")
"""Words for starts of a run: at the start values, or in an equilibrium."""


def states(
    mechanism: Subject,
    at: str | float | Sequence[float] | Equilibrium,
    parameters: Mapping[str, float | str],
    inputs: Mapping[str, Signal],
) -> list[Situation]:
    """Return situations of a mechanism at an element of `PLACES`, an `Equilibrium`, or times [s] of the motion.

    Raises InputError if `at` is none of these, AlfmuError if the mechanism does not reach it.
    """
    if isinstance(at, Equilibrium):
        e = mechanism.equations if isinstance(mechanism, Instance) else source(mechanism, parameters).equations
        _check_own(e, at)
        if parameters or inputs:
            raise InputError(
                f"{e.name}: parameters and inputs are part of a position of rest; give them to equilibrium()"
            )
        return [at.situation]
    if at in PLACES if isinstance(at, str) else isinstance(mechanism, Instance) and at == 0:
        where = begun(mechanism, parameters, inputs, rubs=at != "equilibrium")
        if at == "equilibrium":
            return [equilibria(where).nearest.situation]
        return [where]
    times = _times(mechanism, at)
    if isinstance(mechanism, Instance):
        raise InputError(f"{mechanism.name}: an Instance is analysed in its present state; step it to the time first")
    if set(times) == {0.0}:
        return [begun(mechanism, parameters, inputs, rubs=True)] * len(times)
    found = dict(motion(source(mechanism, parameters), sorted(set(times)), inputs))
    return [found[t] for t in times]


def rest(
    equations: Equations, start: str | Equilibrium | None, inputs: Mapping[str, Signal] | None = None
) -> Equilibrium:
    """Return the equilibrium in which equations with their defaults start.

    `start` is an `Equilibrium`, or "equilibrium" for `Equilibria.nearest` with the inputs at 0 s. Raises InputError if
    there is none, or if it belongs to another mechanism.
    """
    if isinstance(start, Equilibrium):
        _check_own(equations, start)
        if equations.timed and start.time:
            raise InputError(
                f"{equations.name}: the run cannot start in a position of rest at t = {start.time:g} s, as it begins "
                "at 0 s, and laws of time move the mechanism; take one at 0 s"
            )
        return start
    if start not in STARTS:
        raise InputError(f"{equations.name}: start is {start!r}; it must be {in_words(STARTS)}, or an Equilibrium")
    return equilibria(begun(equations, {}, inputs or {})).nearest


def _check_own(equations: Equations, rest: Equilibrium) -> None:
    """Raise InputError if a position of rest belongs to another mechanism."""
    own, theirs = ([c.name for c in e.coordinates] for e in (equations, rest.situation.equations))
    if own != theirs:
        raise InputError(
            f"{equations.name}: the position of rest is one of {rest.mechanism}, which has other coordinates"
        )


def _times(mechanism: Any, at: Any) -> list[float]:
    """Return instants [s]; raise InputError if `at` is not a time or several."""
    name = getattr(mechanism, "name", "") or mechanism
    times = list(at) if isinstance(at, Sequence) and not isinstance(at, str) else [at]
    for t in times or [None]:
        if isinstance(t, (str, bool)) or not isinstance(t, (int, float, np.number)) or not 0 <= t < math.inf:
            raise InputError(f"{name}: at is {t!r}; it must be {', '.join(PLACES)}, or times of 0 s and above")
    return [float(t) for t in times]


def motion(
    source: Source, times: Iterable[float], inputs: Mapping[str, Signal], step: float | None = None
) -> Iterator[tuple[float, Situation]]:
    """Yield situations of the motion from the start at instants [s] in rising order.

    Communication steps have the mechanism's own length, or `step` [s], and inputs are held constant in each.
    """
    e = source.equations
    scene, left = ready(source.plain, source.given, None, None, DEFAULT)
    unit = instance(scene, DEFAULT)
    for name, value in left.items():
        unit.set(name, value)
    signals = signals_of(e.name, inputs)

    def apply(t: float) -> None:
        for name, signal in signals.items():
            unit.set(name, signal(t))

    apply(0.0)
    unit.initialize()
    step = step or e.interval
    for t in times:
        steps = max(1, math.ceil((t - unit.time) / step * (1 - 1e-9))) if t > unit.time else 0
        begin = unit.time
        for k in range(steps):
            now = unit.time
            unit.step(begin + (t - begin) * (k + 1) / steps - now, now)
            apply(unit.time)
        found = situation_of(unit)
        yield t, replace(found, source=source, state=replace(found.state, t=t))
