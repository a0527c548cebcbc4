"""Mass and inertia of homogeneous bodies, about their centre and along their axes, and of composite bodies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from .poses import Array, Pose


@dataclass(frozen=True)
class Solid:
    """A volume [m3] and the moments of inertia (3,) [m5] of unit density."""

    volume: float
    moments: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass [kg], centre of mass (3,) [m] and matrix of inertia (3, 3) [kg.m2] about it, in the axes of a link."""

    mass: float = 0.0
    center: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @staticmethod
    def of(mass: float, pose: Pose, moments: Sequence[float], products: Sequence[float] = (0.0, 0.0, 0.0)) -> Inertial:
        """Return the inertia of moments (xx, yy, zz) and products (xy, xz, yz) in the axes of a pose."""
        matrix = np.diag(np.asarray(moments, dtype=float))
        matrix[np.triu_indices(3, 1)] = matrix.T[np.triu_indices(3, 1)] = products
        return Inertial(mass, pose.place, pose.turn @ matrix @ pose.turn.T)


def ellipsoid(a: float, b: float, c: float) -> Solid:
    """Return an ellipsoid of three half axes [m]."""
    volume = 4 / 3 * math.pi * a * b * c
    return Solid(volume, (volume / 5 * (b * b + c * c), volume / 5 * (a * a + c * c), volume / 5 * (a * a + b * b)))


def sphere(radius: float) -> Solid:
    """Return a sphere of a radius [m]."""
    return ellipsoid(radius, radius, radius)


def box(a: float, b: float, c: float) -> Solid:
    """Return a box of three half edges [m]."""
    volume = 8 * a * b * c
    return Solid(volume, (volume / 3 * (b * b + c * c), volume / 3 * (a * a + c * c), volume / 3 * (a * a + b * b)))


def cylinder(radius: float, half: float) -> Solid:
    """Return a cylinder of a radius and half a length [m] along z."""
    volume = 2 * math.pi * radius**2 * half
    across = volume * (3 * radius**2 + 4 * half**2) / 12
    return Solid(volume, (across, across, volume * radius**2 / 2))


def capsule(radius: float, half: float) -> Solid:
    """Return a cylinder along z with half a ball on either end; `half` [m] is that of the cylinder."""
    tube, ball = cylinder(radius, half), sphere(radius)
    # Each half of the ball has its centre of mass at 3/8 of the radius from its flat face.
    across = tube.moments[0] + ball.moments[0] + ball.volume * (half**2 + 3 / 4 * half * radius)
    return Solid(tube.volume + ball.volume, (across, across, tube.moments[2] + ball.moments[2]))


def placed(solid: Solid, mass: float, pose: Pose) -> Inertial:
    """Return the inertia of a solid of a mass [kg] at a pose of its centre."""
    factor = mass / solid.volume if solid.volume else 0.0
    return Inertial.of(mass, pose, [factor * x for x in solid.moments])


def together(parts: Iterable[Inertial]) -> Inertial:
    """Return the inertia of several parts as one rigid body."""
    parts = list(parts)
    mass = math.fsum(part.mass for part in parts)
    if not mass:
        return Inertial()
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        r = part.center - center
        inertia += part.inertia + part.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return Inertial(mass, center, inertia)
