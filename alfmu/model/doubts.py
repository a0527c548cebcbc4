"""Doubts about a whole declaration: masses in grams, inertias that were forgotten, no gravity.

Each is allowed and yet looks like a mistake. `model.checks` has those that a single number raises.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import casadi as ca

from .checks import hint
from .mechanism import Mechanism
from .parts import Body, stack

__all__ = ["doubt", "evaluated", "masses", "no_gravity", "perhaps_grams", "tell", "tell_of_gravity"]

_HEAVY = 20.0
"""Mass [kg] beyond which grams may have been meant."""

_APART = 300.0
"""Ratio of masses [1]: a body that is heavier than every other by more may be given in grams, which are 1000."""

_NEAR = 30.0
"""Ratio of masses [1]: so far from those of other bodies the mass may be that was meant."""

_LOGGER = logging.getLogger("alfmu")

_TOLD: set[str] = set()
"""Texts that this process has logged."""


def doubt(m: Mechanism, turns: Callable[[Body], bool]) -> None:
    """Warn of bodies whose mass looks like grams, and of those that turn and were given no inertia."""
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


def masses(m: Mechanism, values: Mapping[str, float] | None = None) -> dict[str, float]:
    """Masses [kg] of the bodies by name, at values of parameters."""
    bodies = [*m.bodies, *m.spatial_bodies]
    return dict(zip((x.name for x in bodies), evaluated(m, [x.mass for x in bodies], values), strict=True))


def evaluated(m: Mechanism, expressions: list[float | ca.SX], values: Mapping[str, float] | None = None) -> list[float]:
    """Expressions in parameters at values of these by name, or at their defaults."""
    known = {x.name: x.default for x in m.parameters} | dict(values or {})
    at = ca.Function("at", [stack([x.symbol for x in m.parameters])], [stack(expressions)])
    return [float(x) for x in ca.vertsplit(at([known[x.name] for x in m.parameters]))]


def perhaps_grams(name: str, found: Mapping[str, float]) -> dict[str, str]:
    """What to say of the body, by its name, whose mass [kg] among these looks like grams."""
    *others, heaviest = sorted(found, key=found.__getitem__) if found else [""]
    rest = [found[x] for x in others if found[x] > 0]
    if not rest or found[heaviest] < max(_HEAVY, _APART * rest[-1]):
        return {}
    mass = found[heaviest]
    if not min(rest) / _NEAR <= mass / 1000 <= max(rest) * _NEAR:
        return {}
    times = f"{mass / rest[-1]:.0f} times that of any other body"
    return {
        heaviest: f"{name}: the mass of {heaviest} is {mass:g} kg, {times}; if grams were meant, give {mass / 1000:g}"
    }


def no_gravity(m: Mechanism) -> str:
    """What to say of a mechanism whose bodies have masses, and that does not say whether there is gravity."""
    if m._weighs or m.potential or not any(masses(m).values()):
        return ""
    return (
        f"{m.name}: bodies have masses and no gravity acts; declare it by gravity(0, -9.81), or none by gravity(0, 0)"
    )


def tell_of_gravity(m: Mechanism) -> None:
    """Log once that bodies have masses and no gravity acts, where that is so."""
    tell(no_gravity(m))


def tell(text: str) -> None:
    """Log a text as a warning, once in this process; an empty one is none."""
    if text and text not in _TOLD:
        _TOLD.add(text)
        _LOGGER.warning("%s", text)
