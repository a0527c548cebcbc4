"""Rigid bodies in space: absolute coordinates with Euler parameters, markers, and joints closed by constraints.

A body has seven coordinates: the place r of its centre of mass, and the Euler parameters e = [e0 e1 e2 e3] of its
frame, kept at unit length by a constraint of their own. The rotation matrix is taken in the homogeneous form

    R(e) = (e0^2 - p'p) 1 + 2 p p' + 2 e0 p~,    p = [e1 e2 e3],  p~ b = p x b,

every entry quadratic in e, and the angular velocity in ground axes is w = 2 (e0 p_dot - e0_dot p + p x p_dot)
(Nikravesh, Computer-Aided Analysis of Mechanical Systems, chapter 6). Every place is an expression in the coordinates
of one body, so no joint is needed to work it out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca

from .checks import number
from .words import Brief

__all__ = ["SpatialBody", "SpatialJoint", "SpatialMarker", "about", "angular_velocity", "product", "rotation"]

Scalar = float | ca.SX
Vector = tuple[Scalar, Scalar, Scalar]

_ALIGNED = ("rotation1", "rotation2")

SPATIAL_DIRECTIONS: dict[str, tuple[str, ...]] = {
    "spherical": ("x", "y", "z"),
    "revolute": ("x", "y", "z", *_ALIGNED),
    "cylindrical": ("normal1", "normal2", *_ALIGNED),
    "prismatic": ("normal1", "normal2", *_ALIGNED, "rotation3"),
}
"""The relative displacements that each kind of spatial joint suppresses, in the order of its constraint rows.

`normal1`, `normal2` and `rotation1`, `rotation2` belong to two normals of the axis, `rotation3` to the axis itself.
"""


def rotation(e: ca.SX) -> ca.SX:
    """Rotation matrix (3, 3) of Euler parameters (4,): its columns are the axes of the body in ground axes."""
    e0, e1, e2, e3 = ca.vertsplit(e)
    return ca.blockcat(
        [
            [e0**2 + e1**2 - e2**2 - e3**2, 2 * (e1 * e2 - e0 * e3), 2 * (e1 * e3 + e0 * e2)],
            [2 * (e1 * e2 + e0 * e3), e0**2 - e1**2 + e2**2 - e3**2, 2 * (e2 * e3 - e0 * e1)],
            [2 * (e1 * e3 - e0 * e2), 2 * (e2 * e3 + e0 * e1), e0**2 - e1**2 - e2**2 + e3**2],
        ]
    )


def angular_velocity(e: ca.SX, rate: ca.SX) -> ca.SX:
    """Angular velocity (3,) [rad/s] in ground axes, from Euler parameters (4,) and their rates."""
    return 2 * (e[0] * rate[1:] - rate[0] * e[1:] + ca.cross(e[1:], rate[1:]))


def about(axis: Vector, angle: Scalar) -> ca.SX:
    """Euler parameters (4,) of a turn by an angle [rad] about an axis of unit length."""
    return ca.vertcat(ca.cos(angle / 2), *(ca.sin(angle / 2) * x for x in axis))


def product(e: ca.SX, f: ca.SX) -> ca.SX:
    """Euler parameters (4,) of the turn f made in the axes that the turn e leads to: R = R(e) R(f)."""
    return ca.vertcat(e[0] * f[0] - ca.dot(e[1:], f[1:]), e[0] * f[1:] + f[0] * e[1:] + ca.cross(e[1:], f[1:]))


@dataclass(eq=False, repr=False)
class SpatialBody(Brief):
    """A rigid body in space; its frame is parallel to its principal axes of inertia."""

    name: str
    mass: Scalar
    inertia: Vector
    """Principal moments of inertia about the centre of mass."""
    center: Vector
    """The centre of mass in the body's frame."""
    position: ca.SX
    """The centre of mass (3,) in ground axes."""
    attitude: ca.SX
    """Euler parameters (4,) of the frame."""
    rotation: ca.SX = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.rotation = rotation(self.attitude)

    @property
    def unit_length(self) -> str:
        """Name of the constraint that keeps the Euler parameters at unit length."""
        return f"{self.name}.attitude"

    def at(self, x: Scalar = 0.0, y: Scalar = 0.0, z: Scalar = 0.0) -> SpatialMarker:
        """The point (x, y, z) [m] of the body's frame."""
        named = zip("xyz", (x, y, z), strict=True)
        return SpatialMarker(self, *(number(f"{axis} of {self.name}.at()", value) for axis, value in named))

    def displacements(self) -> tuple[ca.SX, list[Scalar]]:
        """Displacements X and weights w with the kinetic energy w' X'^2/2: the centre of mass and the three axes.

        An axis i moves as mass (Jj + Jk - Ji)/2 at unit distance would.
        """
        jx, jy, jz = self.inertia
        axes = (jy + jz - jx) / 2, (jz + jx - jy) / 2, (jx + jy - jz) / 2
        return ca.vertcat(self.position, ca.vec(self.rotation)), [self.mass] * 3 + [w for w in axes for _ in range(3)]


@dataclass(frozen=True, eq=False, repr=False)
class SpatialMarker(Brief):
    """A point fixed on a body in space, by its place in the body's frame."""

    body: SpatialBody
    x: Scalar
    y: Scalar
    z: Scalar

    @property
    def place(self) -> ca.SX:
        """The point (3,) in ground axes."""
        local = ca.vertcat(*(ca.SX(a) - c for a, c in zip((self.x, self.y, self.z), self.body.center, strict=True)))
        return self.body.position + self.body.rotation @ local


@dataclass(eq=False, repr=False)
class SpatialJoint(Brief):
    """A joint between two bodies in space, closed by constraints; `axes` is its axis in the frames of both."""

    name: str
    kind: str
    first: SpatialMarker
    second: SpatialMarker
    axes: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))

    @property
    def directions(self) -> tuple[str, ...]:
        """The relative displacements that the joint suppresses."""
        return SPATIAL_DIRECTIONS[self.kind]

    def triad(self, second: bool = False) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Two normals and the axis of the joint, a right-handed triad fixed on one of the bodies, in ground axes."""
        turn = (self.second if second else self.first).body.rotation
        normal, other, axis = (turn @ ca.SX(list(x)) for x in right_handed(self.axes[second]))
        return normal, other, axis

    @cached_property
    def free(self) -> ca.SX:
        """The free displacement, second body from first: angle [rad] within a turn, or place along the axis [m]."""
        normal, other, axis = self.triad()
        if self.kind == "revolute":
            turned = self.triad(second=True)[0]
            return ca.atan2(ca.dot(other, turned), ca.dot(normal, turned))
        return ca.dot(axis, self.second.place - self.first.place)

    def residual(self, direction: str) -> ca.SX:
        """What the joint keeps at zero along one direction, in m or (for a small misalignment) rad."""
        apart = self.second.place - self.first.place
        if direction in ("x", "y", "z"):
            return apart["xyz".index(direction)]
        if direction.startswith("normal"):
            return ca.dot(self.triad()[int(direction[-1]) - 1], apart)
        return ca.dot(*self._kept_square(direction))

    def reaction(self, multipliers: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
        """Force (3,) and moment (3,) about the joint's point on the second body, on it from the first, in ground axes.

        What the constraint forces -C' lambda do in a displacement and in a turn of the second body.
        """
        force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
        for direction, lam in multipliers.items():
            if direction in ("x", "y", "z"):
                force -= lam * ca.SX([direction == axis for axis in "xyz"])
            elif direction.startswith("normal"):
                force -= lam * self.triad()[int(direction[-1]) - 1]
            else:
                on_first, on_second = self._kept_square(direction)
                moment -= lam * ca.cross(on_second, on_first)
        return force, moment

    def _kept_square(self, direction: str) -> tuple[ca.SX, ca.SX]:
        """Two directions, one on each body, that a joint keeps at a right angle."""
        on_first, on_second = self.triad(), self.triad(second=True)
        return (
            (on_first[0], on_second[1])
            if direction == "rotation3"
            else (
                on_first[_ALIGNED.index(direction)],
                on_second[2],
            )
        )


def right_handed(axis: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    """Two normals of a direction and the direction itself, of unit length and right-handed.

    The first normal is the next coordinate axis, made square to the direction: exact for an axis of the frame.
    """
    length = math.hypot(*axis)
    x = tuple(a / length for a in axis)
    largest = max(range(3), key=lambda i: abs(x[i]))
    start = [float(i == (largest + 1) % 3) for i in range(3)]
    along = sum(a * b for a, b in zip(start, x, strict=True))
    normal = [a - along * b for a, b in zip(start, x, strict=True)]
    size = math.hypot(*normal)
    n = tuple(a / size for a in normal)
    other = x[1] * n[2] - x[2] * n[1], x[2] * n[0] - x[0] * n[2], x[0] * n[1] - x[1] * n[0]
    return n, other, x
