"""Dry friction that follows from the load: multipliers of joints that slide, limits of those that stick.

The constraint that a joint keeps while it sticks has a multiplier, the torque or force against which it would slide.
While it slides in the direction s = 1 or -1, that constraint is not in force, and its multiplier is

    lambda = s mu(rate) L,      mu(rate) = coulomb + (static - coulomb) exp(-(rate / stribeck)^2),

so that friction enters M a + d = f - C' lambda as all reactions do. If more joints are at rest than there are motions
to hold, others hold some of them: these carry a share of their limit static L, or all of it. The load L is that of the
joint itself: in a journal its radius times the force; in a guide whose edges are b apart, the sum of |N/2 + M/b| and
|N/2 - M/b| of force N and moment M about the midpoint, which is the larger of |N| and 2 |M|/b.

In space N and M/b are vectors across the axis. A journal with bearings b apart carries them as a guide does, and a
force along its axis by a collar; a guide carries a moment about its axis by a key at a radius r, which adds |M|/r. In a
screw of radius r with p = lead/(2 pi), force W along the axis and friction T load the flank with

    L = |W (r^2 + p^2) - T p| / r.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from ..model.parts import AnyJoint, Friction, Lock, Motion, Scalar, stack, symbolic
from ..model.spatial import SpatialJoint
from .types import Rubbing, Variable

LIMITED = 2.0
"""Direction, 2 or -2, of a joint at rest at its static limit, held by other joints."""

SHARED = 3.0
"""Direction of a joint at rest with a given share of its limit, between -1 and 1; the share replaces its sticking
displacement."""

_NOTHING = 1e-300
"""Added to a sum of squares, so that its root is differentiable at zero force."""


@dataclass
class Rubs:
    """Functions and outputs of the dry friction of a mechanism."""

    frictions: list[Rubbing] = field(default_factory=list)
    functions: dict[str, ca.SX] = field(default_factory=dict)
    """Expressions of the functions `rubbing` and `sliding`; empty without friction."""
    values: list[Scalar] = field(default_factory=list)
    outputs: list[Variable] = field(default_factory=list)


def rubbing(
    locks: Sequence[Lock | Motion],
    rows: Mapping[Lock, int],
    free: Callable[[AnyJoint], ca.SX],
    reactions: Mapping[str, ca.SX],
    motion: tuple[ca.SX, ca.SX, ca.SX],
    lam: ca.SX,
) -> Rubs:
    """Return laws and outputs of the frictions among locks.

    `rows` are the constraints of the locks, `free` gives the displacement of a joint, `reactions` are expressions by
    the names of outputs, `motion` is q, v, a.
    """
    q, v, a = motion
    found = Rubs()
    laws, limits, rates, seconds = [], [], [], []
    frictions = [x for x in locks if isinstance(x, Friction)]
    for i, x in enumerate(frictions):
        displacement = free(x.of)
        rate = ca.jtimes(displacement, q, v)
        load = _load(x, reactions, -lam[rows[x]])
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


def _load(x: Friction, reactions: Mapping[str, ca.SX], friction: ca.SX) -> ca.SX:
    """Return the load of a joint with this friction."""
    if x.load is not None:
        return symbolic(x.load)
    if isinstance(x.of, SpatialJoint):
        return _load_in_space(x, x.of, reactions, friction)
    if x.radius is not None:
        return x.radius * _size([reactions[f"{x.name}.force.{axis}"] for axis in "xy"])
    force = ca.fabs(reactions[f"{x.name}.force"])
    if x.length is None:
        return force
    return ca.fmax(force, 2 / x.length * ca.fabs(reactions[f"{x.name}.moment"]))


def _load_in_space(x: Friction, joint: SpatialJoint, reactions: Mapping[str, ca.SX], friction: ca.SX) -> ca.SX:
    """Return the load of a joint in space, from its reaction along its axis and two normals."""
    triad = joint.triad()
    force, moment = (
        [ca.dot(each, stack([reactions[f"{x.name}.{what}.{axis}"] for axis in "xyz"])) for each in triad]
        for what in ("force", "moment")
    )
    across = _size(force[:2])
    if x.length is not None:
        ends = -moment[1] / x.length, moment[0] / x.length
        across = sum(
            (_size([f / 2 + way * end for f, end in zip(force, ends, strict=False)]) for way in (1, -1)), ca.SX(0)
        )
    if joint.kind == "prismatic":
        return across if x.radius is None else across + ca.fabs(moment[2]) / x.radius
    assert x.radius is not None  # journals and screws are declared with one
    if joint.kind == "screw":
        pitch, radius = joint.lead / (2 * math.pi), symbolic(x.radius)
        return ca.fabs(force[2] * (radius**2 + pitch**2) - friction * pitch) / radius
    return x.radius * across + (0 if x.collar is None else x.collar * ca.fabs(force[2]))


def _size(vector: Sequence[ca.SX]) -> ca.SX:
    return ca.sqrt(sum((each**2 for each in vector), ca.SX(_NOTHING)))
