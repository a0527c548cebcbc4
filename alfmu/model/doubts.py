"""Warnings about a whole declaration: masses in grams, forgotten inertias, no gravity.

Each is allowed but looks like a mistake. `model.checks` has the warnings about single numbers.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import casadi as ca

from .checks import hint
from .mechanism import Mechanism
from .parts import Body, Joint, Marker, Spring, stack, symbolic
from .spatial import SpatialBody

_HEAVY = 20.0
"""Mass [kg] above which the user may have meant grams."""

_APART = 300.0
"""Ratio of masses [1]: a body heavier than all others by more than this may be given in grams (a ratio of 1000), unless
it would be so in grams, too."""

_LOGGER = logging.getLogger("alfmu")

_TOLD: set[str] = set()
"""Texts that this process has logged."""


def doubt(m: Mechanism, turns: Callable[[Body], bool]) -> None:
    """Warn of bodies whose mass looks like grams, and of bodies that rotate without an inertia."""
    found = masses(m)
    for name, message in perhaps_grams(m.name, found).items():
        hint(message, m._lines[name])
    for body in m.bodies:
        if body in m._points and found[body.name] > 0 and turns(body):
            hint(
                f"{m.name}: {body.name} turns and has a mass but no inertia; give inertia= [kg.m2] about its centre of "
                "mass, or inertia=0.0 for a point mass",
                m._lines[body.name],
            )

    for spring in m.springs:
        if joint := next((j for j in m.joints if _pulls_at(spring, j)), None):
            hint(
                f"{m.name}: a spring with a length at rest joins two points that {joint.name} keeps together, so that "
                f"it has no direction; for a spring that turns give the joint: spring_damper({joint.name}, ...)"
            )


def _pulls_at(spring: Spring, joint: Joint) -> bool:
    """Return whether a spring that is not relaxed at length 0 joins the points of a hinge."""
    if joint.kind != "revolute" or not isinstance(spring.between, tuple | list) or symbolic(spring.rest).is_zero():
        return False
    ends, pins = ([x for x in pair if isinstance(x, Marker)] for pair in (spring.between, (joint.first, joint.second)))
    return len(ends) == 2 and all(any(_are_same(end, pin) for end in ends) for pin in pins)


def _are_same(a: Marker, b: Marker) -> bool:
    return a.body is b.body and ca.is_equal(stack([a.x, a.y]), stack([b.x, b.y]))


def masses(m: Mechanism, values: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the masses [kg] of the bodies by name, at values of parameters."""
    bodies: list[Body | SpatialBody] = [*m.bodies, *m.spatial_bodies]
    return dict(zip((x.name for x in bodies), evaluated(m, [x.mass for x in bodies], values), strict=True))


def evaluated(m: Mechanism, expressions: list[float | ca.SX], values: Mapping[str, float] | None = None) -> list[float]:
    """Return expressions in parameters evaluated at given values by name, or at the defaults."""
    known = {x.name: x.default for x in m.parameters} | dict(values or {})
    at = ca.Function("at", [stack([x.symbol for x in m.parameters])], [stack(expressions)])
    return [float(x) for x in ca.vertsplit(at([known[x.name] for x in m.parameters]))]


def perhaps_grams(name: str, found: Mapping[str, float]) -> dict[str, str]:
    """Return a warning, by body name, about a mass [kg] that looks like grams."""
    *others, heaviest = sorted(found, key=found.__getitem__) if found else [""]
    rest = [found[x] for x in others if found[x] > 0]
    mass = found.get(heaviest, 0.0)
    if not rest or not max(_HEAVY, _APART * rest[-1]) <= mass <= 1000 * _APART * rest[-1]:
        return {}
    times = f"{mass / rest[-1]:.0f} times that of any other body"
    return {
        heaviest: f"{name}: the mass of {heaviest} is {mass:g} kg, {times}; if grams were meant, give {mass / 1000:g}"
    }


def no_gravity(m: Mechanism) -> str:
    """Return a warning about masses in a declaration without gravity, or with one out of the plane; empty if there is
    none."""
    if not any(masses(m).values()):
        return ""
    x, y, z = evaluated(m, list(m.gravity_vector))
    if z and not (x or y or m.spatial_bodies):
        return f"{m.name}: gravity acts along z, out of the plane of all bodies; declare it by gravity(0, -9.81)"
    if m._weighs or m.potential:
        return ""
    return (
        f"{m.name}: bodies have masses and no gravity acts; declare it by gravity(0, -9.81), or none by gravity(0, 0)"
    )


def tell_of_gravity(m: Mechanism) -> None:
    """Log a warning once if bodies have masses and no gravity acts."""
    tell(no_gravity(m))


def tell(text: str) -> None:
    """Log a text as a warning once per process; ignore an empty text."""
    if text and text not in _TOLD:
        _TOLD.add(text)
        _LOGGER.warning("%s", text)
