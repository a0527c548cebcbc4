"""Model Exchange: the states that an importer integrates, and the mechanisms that are exported for co-simulation alone.

The states are all coordinates, their rates, and the states of first-order equations. The runtime evaluates their rates
with outputs, at the position on the constraints nearest to them (`step/exchange.c`).
"""

from __future__ import annotations

from ..equations import Equations, Variable
from ..equations.interface import MONITORS
from ..equations.types import REACTION_ERROR
from ..model.units import quotient

__all__ = ["ACCELERATIONS", "exchanged", "obstacle"]

ACCELERATIONS = "a0"
"""Value of the programs that evaluate outputs; the runtime reads it."""


def obstacle(e: Equations) -> str:
    """Return why an importer cannot integrate a mechanism; empty if it can."""
    if e.followed:
        names = ", ".join(e.inputs[each.input].name for each in e.followed)
        return f"{names} moves something, and its course between communication points comes from its past values"
    if e.frictions:
        names = ", ".join(each.name for each in e.frictions)
        return f"{names} has dry friction that follows from the load"
    if e.breaks:
        return "a force, a law of motion or the rate of a state jumps or bends"
    monitors = {"monitor.distance", "monitor.singular", REACTION_ERROR} & {v.name for v in MONITORS} - set(e.monitors)
    if not monitors and not any(output.instant for output in e.outputs):
        return "none of its outputs needs accelerations; add monitor.distance to them"
    return ""


def exchanged(e: Equations) -> list[tuple[Variable, Variable]]:
    """Return the states of Model Exchange, each with its rate, in the order of the runtime."""
    own = e.coordinates[: e.n - e.timed]
    found = [(f"state.{c.name}", c.unit, c.name) for c in own]
    found += [(f"state.{c.name}_rate", quotient(c.unit, "s"), f"rate of {c.name}") for c in own]
    found += [(f"state.{v.name}", v.unit, v.name) for v in e.states]
    return [
        (
            Variable(name, unit, description=f"{text}, as the importer integrates it"),
            Variable(f"der({name})", quotient(unit, "s"), description=f"time derivative of {name}"),
        )
        for name, unit, text in found
    ]
