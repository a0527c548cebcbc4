"""Model Exchange: the states that an importer integrates, and the mechanisms that are exported for co-simulation alone.

The states are all coordinates, their rates, and the states of first-order equations. The runtime evaluates their rates
with outputs, at the position on the constraints nearest to them (`step/exchange.c`).
"""

from __future__ import annotations

from ..equations import Equations, Variable
from ..equations.interface import SOLVED
from ..model.units import quotient
from .form import Traced

FADING = 0.1
"""Share of the distance to the constraints by which states return in a communication step [1]: errors of an importer
fade over ten of these. A fifth of this share leaves up to twice the error of a run; twice the share gains nothing."""

ACCELERATIONS = "a0"
"""Value of the programs that evaluate outputs; the runtime reads it."""


def obstacle(e: Traced) -> str:
    """Return why an importer cannot integrate a mechanism; empty if it can. The equations are those of a scene
    (`alfmu.kernel.complete.complete`)."""
    if e.followed:
        names = ", ".join(e.inputs[each.input].name for each in e.followed)
        return f"{names} prescribes a motion, whose course between communication points follows from past values"
    if e.breaks and e.functions["breaks"].jac_sparsity(0, 1).nnz():
        return "a force, a law of motion or the rate of a state has a jump or kink where an input passes a value"
    if not SOLVED - set(e.monitors) and not any(output.instant for output in e.outputs):
        return "none of its outputs needs accelerations; add monitor.distance to them"
    return ""


def exchanged(e: Equations) -> list[tuple[Variable, Variable]]:
    """Return the states of Model Exchange, each with its rate, in the order of the runtime."""
    own = e.coordinates[: e.n - e.timed]
    found: list[tuple[str, str, str, float | None]] = [(f"state.{c.name}", c.unit, c.name, None) for c in own]
    found += [(f"state.{c.name}_rate", quotient(c.unit, "s"), f"rate of {c.name}", None) for c in own]
    found += [(f"state.{v.name}", v.unit, v.name, v.nominal) for v in e.states]
    return [
        (
            Variable(name, unit, description=f"{text}, integrated by the importer", nominal=nominal),
            Variable(f"der({name})", quotient(unit, "s"), description=f"time derivative of {name}"),
        )
        for name, unit, text, nominal in found
    ]


def indicators(e: Equations) -> list[Variable]:
    """Return the event indicators, in the order of the runtime."""
    text = (
        "above zero until {} sticks or slides: its rate while it slides, the unused share of its friction limit "
        "while it sticks"
    )
    return [Variable(f"indicator.{each.name}", "1", description=text.format(each.name)) for each in e.frictions]
