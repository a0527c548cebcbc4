"""Dry friction that follows from the load: multipliers of joints that slide, limits of those that stick.

The constraint that a joint keeps while it sticks has a multiplier, the torque or force against which it would slide.
While it slides in the direction s = 1 or -1, that constraint is not in force, and its multiplier is

    lambda = s mu(rate) L,      mu(rate) = coulomb + (static - coulomb) exp(-(rate / stribeck)^2),

so that friction enters M a + d = f - C' lambda as all reactions do. Where more joints are at rest than there are
motions to hold, some are held by others: they have a share of their limit static L, or all of it. The load L is that of
the joint itself: in a journal its radius times the force; in a guide whose edges are b apart, the sum of |N/2 + M/b|
and |N/2 - M/b| of force N and moment M about the point half-way, which is the larger one of |N| and 2 |M|/b.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from ..model.mechanism import Friction, Joint, Lock, Scalar, stack
from .types import Rubbing, Variable

__all__ = ["LIMITED", "SHARED", "Rubs", "rubbing"]

LIMITED = 2.0
"""Direction, 2 or -2, of a joint that is at rest and would slide so, if others did not hold it: at its static limit."""

SHARED = 3.0
"""The same of one that holds with a given share of its limit, between -1 and 1, which stands where it would stick."""

_NOTHING = 1e-300
"""Added to a sum of squares, so that its root has a derivative where the force vanishes."""


@dataclass
class Rubs:
    """What follows from the dry friction of a mechanism."""

    frictions: list[Rubbing]
    functions: dict[str, ca.SX]
    """Expressions of the functions `rubbing` and `sliding`; none without friction."""
    values: list[Scalar]
    outputs: list[Variable]


def rubbing(
    locks: Sequence[Lock],
    rows: Mapping[Lock, int],
    free: Callable[[Joint], ca.SX],
    reactions: Mapping[str, ca.SX],
    motion: tuple[ca.SX, ca.SX, ca.SX],
    lam: ca.SX,
) -> Rubs:
    """Laws and outputs of the frictions among locks.

    `rows` are the constraints of the locks, `free` gives the displacement of a joint, `reactions` are expressions by
    the names of outputs, `motion` is q, v, a.
    """
    q, v, a = motion
    found = Rubs([], {}, [], [])
    laws, limits, rates, seconds = [], [], [], []
    frictions = [x for x in locks if isinstance(x, Friction)]
    for i, x in enumerate(frictions):
        displacement = free(x.of)
        rate = ca.jtimes(displacement, q, v)
        load = _load(x, reactions)
        coefficient = x.coulomb
        if x.stribeck is not None:
            coefficient = x.coulomb + (x.static - x.coulomb) * ca.exp(-((rate / x.stribeck) ** 2))
        slides, limited = ca.fabs(x.slip) == 1, ca.fabs(x.slip) == LIMITED
        share = limited * x.slip / LIMITED + (x.slip == SHARED) * x.value
        laws.append((slides * x.slip * coefficient + share * x.static) * load)
        limits.append(x.static * load)
        rates.append(rate)
        seconds.append(ca.jtimes(rate, q, v) + ca.jtimes(displacement, q, a))
        row, pair = rows[x], f"{x.of.second.body.name} from {x.of.first.body.name}"
        what, unit = ("torque", "N.m") if x.unit == "rad" else ("force", "N")
        output = f"{x.name}.friction_{what}"
        found.frictions.append(Rubbing(x.name, row, locks.index(x), len(locks) + i, output))
        found.values += [-lam[row], ca.if_else(slides, x.slip, 0)]
        found.outputs += [
            Variable(output, unit, description=f"{what} of dry friction on {pair}"),
            Variable(f"{x.name}.slip", "1", description=f"direction in which {x.name} slides, 0 at rest"),
        ]
    if frictions:
        found.functions = {"rubbing": stack([*laws, *limits, *seconds]), "sliding": stack(rates)}
    return found


def _load(x: Friction, reactions: Mapping[str, ca.SX]) -> ca.SX:
    """The load of a joint."""
    if x.radius is not None:
        along, across = (reactions[f"{x.name}.force.{axis}"] for axis in "xy")
        return x.radius * ca.sqrt(along**2 + across**2 + _NOTHING)
    force = ca.fabs(reactions[f"{x.name}.force"])
    if x.length is None:
        return force
    return ca.fmax(force, 2 / x.length * ca.fabs(reactions[f"{x.name}.moment"]))
