"""Rigid bodies in space: absolute coordinates with Euler parameters, or relative ones through joints; markers, joints.

A body in absolute coordinates has seven: the position r of its centre of mass, and the Euler parameters e = [e0 e1 e2
e3] of its frame, which a constraint keeps at unit length. The rotation matrix is taken in the homogeneous form

    R(e) = (e0^2 - p'p) 1 + 2 p p' + 2 e0 p~,    p = [e1 e2 e3],  p~ b = p x b,

every entry quadratic in e, and the angular velocity in ground axes is w = 2 (e0 p_dot - e0_dot p + p x p_dot)
(Nikravesh, Computer-Aided Analysis of Mechanical Systems, chapter 6). Every position is then an expression in the
coordinates of one body, and does not depend on any joint.

A body in relative coordinates has none of its own: a joint with coordinates places it on another body. Its rotation is
R = R1 R12 and its joint point follows from that of the other body, so its expressions extend those of its parent.

Constraints of a joint between bodies that one body carries are written in the axes of that body, from its origin. They
then contain only the coordinates of the loop, and neither the motion nor the distance of the carrier adds round-off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from .calls import explained
from .checks import number
from .errors import DeclarationError
from .words import Brief, in_words, shown

Scalar = float | ca.SX
Vector = tuple[Scalar, Scalar, Scalar]

_ALIGNED = ("rotation1", "rotation2")

SPATIAL_DIRECTIONS: dict[str, tuple[str, ...]] = {
    "spherical": ("x", "y", "z"),
    "revolute": ("x", "y", "z", *_ALIGNED),
    "cylindrical": ("normal1", "normal2", *_ALIGNED),
    "prismatic": ("normal1", "normal2", *_ALIGNED, "rotation3"),
    "screw": ("normal1", "normal2", *_ALIGNED, "screw"),
    "universal": ("x", "y", "z", "rotation"),
    "planar": ("axis", *_ALIGNED),
    "weld": ("x", "y", "z", *_ALIGNED, "rotation3"),
    "distance": ("length",),
}
"""The relative displacements that each kind of spatial joint suppresses, in the order of its constraint rows.

`normal1`, `normal2` and `rotation1`, `rotation2` belong to two normals of the axis, `axis` and `rotation3` to the axis
itself, `rotation` to the normal of two axes, `screw` to the deviation from the thread along the axis.
"""

SPATIAL_FREEDOMS: dict[str, dict[str, str]] = {
    "spherical": {},
    "revolute": {"angle": "rad"},
    "cylindrical": {"angle": "rad", "position": "m"},
    "prismatic": {"position": "m"},
    "screw": {"angle": "rad"},
    "universal": {"angle1": "rad", "angle2": "rad"},
    "planar": {"position1": "m", "position2": "m", "angle": "rad"},
    "weld": {},
    "distance": {},
}
"""The free motions of each kind of spatial joint that have a displacement, with its unit.

`position1` and `position2` run along two normals of the axis of a planar joint, `angle1` turns about the axis of a
universal joint on its first body, `angle2` about that on its second.
"""

RELATIVE: dict[str, tuple[str, ...]] = {
    **{kind: tuple(freedoms.values()) for kind, freedoms in SPATIAL_FREEDOMS.items() if kind != "distance"},
    "spherical": ("1",) * 4,
}
"""Units of the coordinates of each kind of joint that can place a body; a ball joint has Euler parameters."""


def rotation(e: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) of Euler parameters (4,): its columns are the body's axes in ground axes."""
    e0, e1, e2, e3 = ca.vertsplit(e)
    return ca.blockcat(
        [
            [e0**2 + e1**2 - e2**2 - e3**2, 2 * (e1 * e2 - e0 * e3), 2 * (e1 * e3 + e0 * e2)],
            [2 * (e1 * e2 + e0 * e3), e0**2 - e1**2 + e2**2 - e3**2, 2 * (e2 * e3 - e0 * e1)],
            [2 * (e1 * e3 - e0 * e2), 2 * (e2 * e3 + e0 * e1), e0**2 - e1**2 - e2**2 + e3**2],
        ]
    )


def angular_velocity(e: ca.SX, rate: ca.SX) -> ca.SX:
    """Return the angular velocity (3,) [rad/s] in ground axes, from Euler parameters (4,) and their rates."""
    return 2 * (e[0] * rate[1:] - rate[0] * e[1:] + ca.cross(e[1:], rate[1:]))


def about(axis: Vector, angle: Scalar) -> ca.SX:
    """Return Euler parameters (4,) of a turn by an angle [rad] about an axis of unit length."""
    return ca.vertcat(ca.cos(angle / 2), *(ca.sin(angle / 2) * x for x in axis))


def product(e: ca.SX, f: ca.SX) -> ca.SX:
    """Return Euler parameters (4,) of the rotation e followed by f about the rotated axes: R = R(e) R(f)."""
    return ca.vertcat(e[0] * f[0] - ca.dot(e[1:], f[1:]), e[0] * f[1:] + f[0] * e[1:] + ca.cross(e[1:], f[1:]))


def spin_matrix(e: ca.SX) -> ca.SX:
    """Return the matrix (3, 4) from the rates of Euler parameters (4,) to the angular velocity in ground axes."""
    rates = ca.SX.sym("rates", 4)
    return ca.jacobian(angular_velocity(e, rates), rates)


@dataclass(frozen=True, eq=False)
class Seen:
    """The pose of a body relative to a body that carries it, in the axes of that carrier."""

    rotation: ca.SX
    """Rotation matrix (3, 3) from the axes of the body to those of the carrier."""
    anchor: Vector
    """A point fixed on the body, in the body's frame [m]."""
    begin: ca.SX
    """The point (3,) of the carrier where the chain of joints to the body begins [m]."""
    way: ca.SX
    """Vector (3,) from there to the anchor [m]."""


@dataclass(eq=False, repr=False)
class SpatialBody(Brief):
    """A rigid body in space; `Mechanism.spatial_body` makes it.

    `mass` [kg], `inertia` [kg.m2] about the centre of mass, `center` (x, y, z) [m] of mass in the body's frame.
    """

    name: str
    mass: Scalar
    inertia: Vector
    """Moments of inertia: the diagonal of the matrix of inertia in the axes of the frame."""
    center: Vector
    own: tuple[ca.SX, ca.SX] | None
    """Centre of mass (3,) in ground axes and Euler parameters (4,) of a body in absolute coordinates."""
    products: Vector = (0.0, 0.0, 0.0)
    """Entries xy, xz and yz of that matrix, zero if the axes are principal ones."""
    placed_by: SpatialJoint | None = None
    """The joint that places a body in relative coordinates."""

    @property
    def is_placed(self) -> bool:
        """Whether the position of the body is defined: by coordinates of its own, or a joint with coordinates."""
        return self.own is not None or self.placed_by is not None

    @cached_property
    def rotation(self) -> ca.SX:
        """The rotation matrix (3, 3) from the axes of the frame to those of the ground."""
        if self.own is not None:
            return rotation(self.own[1])
        return self._joint.first.body.rotation @ self._joint.relative_turn

    @cached_property
    def attitude(self) -> ca.SX:
        """Euler parameters (4,) of the frame."""
        if self.own is not None:
            return self.own[1]
        return product(self._joint.first.body.attitude, self._joint.relative_attitude)

    @cached_property
    def position(self) -> ca.SX:
        """The centre of mass (3,) in ground axes."""
        return self.own[0] if self.own is not None else self.anchor[1] + self.turned(self.center)

    @cached_property
    def anchor(self) -> tuple[Vector, ca.SX]:
        """A point fixed on the body that the coordinates place, in the body's frame and in ground axes.

        In relative coordinates it is the joint's point, unless that point moves on the body; otherwise it is the centre
        of mass.
        """
        if self.own is not None:
            return self.center, self.own[0]
        joint = self._joint
        local = self.center if joint.drifts else joint.second.point
        place = joint.first.place + joint.slide
        return local, place + joint.reach if joint.drifts else place

    @property
    def carriers(self) -> list[SpatialBody]:
        """The chain of carriers: this body, its carrier, and so on up to a body that no joint places."""
        found = [self]
        while (joint := found[-1].placed_by) is not None:
            found.append(joint.first.body)
        return found

    def seen_by(self, carrier: SpatialBody) -> Seen | None:
        """Return the pose of the body relative to one of its carriers; None relative to itself."""
        if self is carrier:
            return None
        kept = self.__dict__.setdefault("_seen", {})
        if carrier not in kept:
            joint = self._joint
            before = joint.first.body.seen_by(carrier)
            if before is None:
                turn, begin, way = joint.relative_turn, _column(joint.first.point), joint.local_slide
            else:
                arm = _between(before.anchor, joint.first.point) + joint.local_slide
                turn, begin, way = (
                    before.rotation @ joint.relative_turn,
                    before.begin,
                    before.way + before.rotation @ arm,
                )
            anchor = joint.second.point
            if joint.drifts:
                anchor, way = self.center, way + turn @ joint.beyond
            kept[carrier] = Seen(turn, anchor, begin, way)
        return kept[carrier]

    def turned(self, point: Vector) -> ca.SX:
        """Return a point of the body's frame, from its anchor, in ground axes (3,)."""
        return self.rotation @ _between(self.center if self.own is not None else self.anchor[0], point)

    @property
    def _joint(self) -> SpatialJoint:
        if self.placed_by is None:
            raise DeclarationError(
                f"nothing places {self.name} yet, a body in relative coordinates; declare the joint whose coordinates "
                "place it first"
            )
        return self.placed_by

    @property
    def unit_length(self) -> str:
        """Name of the constraint that keeps the Euler parameters at unit length."""
        return f"{self.name}.attitude"

    @explained
    def at(self, x: Scalar = 0.0, y: Scalar = 0.0, z: Scalar = 0.0) -> SpatialMarker:
        """Return the point (x, y, z) [m] of the body's frame."""
        named = zip("xyz", (x, y, z), strict=True)
        return SpatialMarker(self, *(number(f"{axis} of {self.name}.at()", value) for axis, value in named))

    @property
    def inertia_matrix(self) -> ca.SX:
        """The matrix of inertia (3, 3) about the centre of mass in the axes of the frame."""
        (x, y, z), (xy, xz, yz) = (map(ca.SX, numbers) for numbers in (self.inertia, self.products))
        return ca.blockcat([[x, xy, xz], [xy, y, yz], [xz, yz, z]])

    def displacements(self) -> tuple[ca.SX, ca.SX]:
        """Displacements X and weights W (12, 12) with the kinetic energy X' W X/2: the centre of mass and three axes.

        The axes x_i have the weights E_ij of x_i' . x_j', with E = tr(J)/2 1 - J: where J is diagonal, an axis moves as
        the mass (Jj + Jk - Ji)/2 at unit distance would.
        """
        jx, jy, jz = self.inertia
        weights = ca.diag(ca.vertcat(*[ca.SX(self.mass)] * 3, ca.SX.zeros(9)))
        for i, weight in enumerate(((jy + jz - jx) / 2, (jz + jx - jy) / 2, (jx + jy - jz) / 2)):
            for k in range(3):
                weights[3 + 3 * i + k, 3 + 3 * i + k] = weight
        for (i, j), product in zip(((0, 1), (0, 2), (1, 2)), self.products, strict=True):
            if isinstance(product, ca.SX) or product:
                for k in range(3):
                    weights[3 + 3 * i + k, 3 + 3 * j + k] = weights[3 + 3 * j + k, 3 + 3 * i + k] = -product
        return ca.vertcat(self.position, ca.vec(self.rotation)), weights


@dataclass(frozen=True, eq=False, repr=False)
class SpatialMarker(Brief):
    """A point fixed on a body in space, by its position in the body's frame."""

    body: SpatialBody
    x: Scalar
    y: Scalar
    z: Scalar

    @property
    def point(self) -> Vector:
        """The point in the body's frame [m]."""
        return self.x, self.y, self.z

    @property
    def arm(self) -> ca.SX:
        """Vector (3,) from the body's anchor to the point, in ground axes."""
        return self.body.turned(self.point)

    @property
    def place(self) -> ca.SX:
        """The point (3,) in ground axes."""
        return self.body.anchor[1] + self.arm


@dataclass(eq=False, repr=False)
class SpatialJoint(Brief):
    """A joint between two bodies in space; `axes` is its axis in the frames of both.

    A joint with `coordinates` places its second body from its first; one without is closed by constraints.
    """

    name: str
    kind: str
    first: SpatialMarker
    second: SpatialMarker
    axes: tuple[Vector, Vector] = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    coordinates: tuple[Scalar, ...] | None = None
    lead: Scalar = 0.0
    """Displacement [m] along the axis of a screw in one turn."""
    length: Scalar = 0.0
    """Length of a rod [m]."""
    nominal: tuple[Vector, Vector] = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    """The axes at the defaults of parameters, as numbers; they determine the normals."""
    drifts: bool = False
    """Whether the joint's point on the second body, which the joint places, moves on that body."""
    spare: tuple[str, ...] = ()
    """Directions that the joint leaves to other joints."""

    @property
    def directions(self) -> tuple[str, ...]:
        """The relative displacements that the joint suppresses."""
        return tuple(each for each in SPATIAL_DIRECTIONS[self.kind] if each not in self.spare)

    @property
    def freedoms(self) -> dict[str, str]:
        """The free motions that have a displacement, with its unit."""
        return SPATIAL_FREEDOMS[self.kind]

    @property
    def driven_axis(self) -> Vector | None:
        """Direction of the only free motion in the frame of the second body; None if there are several or none."""
        return self.axes[1] if len(self.freedoms) == 1 else None

    @explained
    def freedom(self, which: str) -> SpatialFreedom:
        """Return one of the free motions of a joint that has several, for `drive`, `spring_damper`, `friction` and
        `lock`.

        `which` is "angle" or "position" (cylindrical), "angle1" or "angle2" (universal), "position1", "position2" or
        "angle" (planar). Raises DeclarationError for any other.
        """
        if which not in self.freedoms:
            has = f"it has {in_words(list(self.freedoms))}" if self.freedoms else "it has none with a displacement"
            raise DeclarationError(f"{self.name}, a {self.kind} joint, has no free motion {shown(which)}; {has}")
        return SpatialFreedom(self, which)

    def triad(self, second: bool = False, carrier: SpatialBody | None = None) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return two normals and the axis of the joint, a right-handed triad fixed on one of the bodies, in the axes of
        the ground, or of a body that carries that one."""
        body = (self.second if second else self.first).body
        normal, other, axis = map(_column, right_handed(self.axes[second], self.nominal[second]))
        if carrier is None:
            turn = body.rotation
        elif (seen := body.seen_by(carrier)) is None:
            return normal, other, axis
        else:
            turn = seen.rotation
        return turn @ normal, turn @ other, turn @ axis

    @property
    def carrier(self) -> SpatialBody | None:
        """Return the nearest body that carries both bodies of the joint; None if there is none."""
        others = self.second.body.carriers
        return next((body for body in self.first.body.carriers if body in others), None)

    @property
    def apart(self) -> ca.SX:
        """Vector (3,) from the first point to the second, in the axes of the carrier, or of the ground without one."""
        if (carrier := self.carrier) is None:
            return self.second.place - self.first.place
        (begin, way), (begin2, way2) = (
            (_column(marker.point), ca.SX.zeros(3))
            if (seen := marker.body.seen_by(carrier)) is None
            else (seen.begin, seen.way + seen.rotation @ _between(seen.anchor, marker.point))
            for marker in (self.first, self.second)
        )
        return (begin2 - begin) + (way2 - way)

    # Relative coordinates ---------------------------------------------------------------------------------------

    @property
    def unit_length(self) -> str:
        """Name of the constraint that keeps the Euler parameters of a ball joint at unit length."""
        return f"{self.name}.attitude"

    def _coordinate(self, which: str) -> Scalar:
        assert self.coordinates is not None
        return self.coordinates[list(self.freedoms).index(which)]

    @cached_property
    def relative_turn(self) -> ca.SX:
        """The rotation matrix (3, 3) from the axes of the second body to those of the first, from the coordinates."""
        if self.kind == "spherical":
            return rotation(ca.vertcat(*self.coordinates or ()))
        if self.kind == "universal":
            (one, two), angles = map(_unit, self.axes), ("angle1", "angle2")
            turns = [_about_axes((x, x), self._coordinate(which)) for x, which in zip((one, two), angles, strict=True)]
            return turns[0] @ turns[1]
        return _about_axes(self.axes, self._coordinate("angle") if "angle" in self.freedoms else 0.0, self.nominal)

    @cached_property
    def relative_attitude(self) -> ca.SX:
        """Euler parameters (4,) of the second body in the axes of the first, from the coordinates."""
        if self.kind == "spherical":
            return ca.vertcat(*self.coordinates or ())
        if self.kind == "universal":
            one, two = map(_unit, self.axes)
            return product(about(one, self._coordinate("angle1")), about(two, self._coordinate("angle2")))
        angle = self._coordinate("angle") if "angle" in self.freedoms else 0.0
        turned = about(_unit(self.axes[0]), angle)
        if _same(*self.axes):
            return turned
        mounted = _about_axes(self.axes, 0.0, self.nominal)
        return product(turned, _attitude(mounted, _about_axes(self.nominal, 0.0)))

    @cached_property
    def slide(self) -> ca.SX:
        """Vector (3,) from the first point to the second in ground axes, from the coordinates."""
        return self._slid(self.triad())

    @property
    def local_slide(self) -> ca.SX:
        """Vector (3,) from the first point to the second in the axes of the first body, from the coordinates."""
        return self._slid(self.triad(carrier=self.first.body))

    def _slid(self, triad: tuple[ca.SX, ca.SX, ca.SX]) -> ca.SX:
        found = ca.SX.zeros(3)
        for coordinate, along in zip(self.coordinates or (), self._ways(triad), strict=True):
            found += coordinate * along
        return found

    def _ways(self, triad: tuple[ca.SX, ca.SX, ca.SX]) -> list[ca.SX]:
        """Return the velocity (3,) of the second point relative to the first body per unit of each rate, in the axes of
        a triad."""
        nothing, (normal, other, axis) = ca.SX.zeros(3), triad
        return {
            "cylindrical": [nothing, axis],
            "prismatic": [axis],
            "screw": [self.lead / (2 * math.pi) * axis],
            "planar": [normal, other, nothing],
        }.get(self.kind, [nothing] * len(RELATIVE.get(self.kind, ())))

    @cached_property
    def reach(self) -> ca.SX:
        """Vector (3,) from a second point that drifts to the anchor of its body, in ground axes."""
        return self.second.body.rotation @ self.beyond

    @property
    def beyond(self) -> ca.SX:
        """Vector from a second point that drifts to the anchor of its body, in the frame of that body."""
        return _between(self.second.point, self.second.body.center)

    @cached_property
    def columns(self) -> list[tuple[ca.SX, ca.SX]]:
        """Angular velocity (3,) and velocity (3,) of the second point from the first body, per unit of each rate.

        They are in ground axes and in the order of `freedoms`; a ball joint has the rates of its Euler parameters.
        """
        nothing = ca.SX.zeros(3)
        if self.kind == "spherical":
            if self.coordinates is None:
                return []
            matrix = self.first.body.rotation @ spin_matrix(self.relative_attitude)
            return [(matrix[:, i], nothing) for i in range(4)]
        triad = self.triad()
        turns = {
            "revolute": lambda: [triad[2]],
            "cylindrical": lambda: [triad[2], nothing],
            "prismatic": lambda: [nothing],
            "screw": lambda: [triad[2]],
            "universal": lambda: [triad[2], self.triad(second=True)[2]],
            "planar": lambda: [nothing, nothing, triad[2]],
        }.get(self.kind, list)()
        return list(zip(turns, self._ways(triad), strict=True))

    # Measured displacements -----------------------------------------------------------------------------------------

    @property
    def free(self) -> ca.SX:
        """The free displacement of a joint that has one, second body from first [rad or m]. A run counts the turns."""
        return self.counted(next(iter(self.freedoms)))

    @property
    def measured(self) -> ca.SX:
        """The free displacement of a joint that has one; an angle is within one turn if constraints close the joint."""
        return self.displacement(next(iter(self.freedoms)))

    @property
    def wrapped(self) -> bool:
        """Whether the free displacement is an angle known up to whole turns only."""
        return self.is_wrapped(next(iter(self.freedoms)))

    def is_wrapped(self, which: str) -> bool:
        """Return whether a free displacement is an angle known up to whole turns only; the way of a screw tells its
        turns."""
        return self.coordinates is None and self.freedoms[which] == "rad" and self.kind != "screw"

    def displacement(self, which: str) -> ca.SX:
        """Return one of the free displacements, second body from first: an angle [rad], or a distance [m]."""
        if self.coordinates is not None:
            return ca.SX(self._coordinate(which))
        return self._measured(which)

    def near(self, which: str) -> ca.SX:
        """Return the symbol of the last known angle, from which whole turns are counted."""
        return self.__dict__.setdefault("_near", {}).setdefault(which, ca.SX.sym(f"{self.name}.{which}.near"))

    def counted(self, which: str) -> ca.SX:
        """Return one of the free displacements; an angle includes whole turns."""
        if not self.is_wrapped(which):
            return self.displacement(which)
        kept: dict[str, ca.SX] = self.__dict__.setdefault("_turning", {})
        if which not in kept:
            kept[which] = with_turns(*self._arms(which), self.near(which))
        return kept[which]

    def _measured(self, which: str) -> ca.SX:
        """Return the (cached) displacement from the positions of both bodies; an angle is within one turn."""
        kept = self.__dict__.setdefault("_kept", {})
        if which not in kept:
            kept[which] = self._from_places(which)
        return kept[which]

    def _from_places(self, which: str) -> ca.SX:
        if which.startswith("angle"):
            turned = self._measured("position") * (2 * math.pi) / self.lead if self.kind == "screw" else ca.SX(0)
            return with_turns(*self._arms(which), turned)
        normal, other, axis = self.triad(carrier=self.carrier)
        along = {"position": axis, "position1": normal, "position2": other}[which]
        return ca.dot(along, self.apart)

    def _arms(self, which: str) -> tuple[ca.SX, ca.SX]:
        """Return sine and cosine of an angle, times a common length."""
        if which != "angle":
            # With u1 on the first body, u2 on the second: R1 u1, R1 u2, R1 (u1 x u2), or these of R2.
            one, two = map(_unit, self.axes)
            body, across, on_other = (
                (self.first.body, two, self.second.body.rotation @ _column(two))
                if which == "angle1"
                else (self.second.body, one, self.first.body.rotation @ _column(one))
            )
            both = body.rotation @ _column(_cross(one, two))
            return ca.dot(on_other, both), ca.dot(on_other, body.rotation @ _column(across))
        carrier = self.carrier
        normal, other, _ = self.triad(carrier=carrier)
        turned = self.triad(True, carrier)[0]
        return ca.dot(other, turned), ca.dot(normal, turned)

    def residual(self, direction: str) -> ca.SX:
        """Return the constraint along one direction, zero when satisfied, in m or (for a small misalignment) rad."""
        carrier = self.carrier
        if direction in ("x", "y", "z"):
            return self.apart["xyz".index(direction)]
        if direction.startswith("normal"):
            return ca.dot(self.triad(carrier=carrier)[int(direction[-1]) - 1], self.apart)
        if direction == "axis":
            return ca.dot(self.triad(carrier=carrier)[2], self.apart)
        if direction == "length":
            return (ca.sumsqr(self.apart) - self.length**2) / (2 * self.length)
        if direction == "screw":
            return self._thread(carrier)[0]
        return ca.dot(*self._kept_square(direction, carrier))

    def gap(self, direction: str) -> ca.SX:
        """Return a residual for the assembly: equal to `residual` to first order near zero, but in metres for lengths
        far from zero, and not zero if directions that should be parallel are opposite."""
        residual, carrier = self.residual(direction), self.carrier
        if direction == "length":
            return ca.norm_2(self.apart) - self.length
        if direction == "screw":
            pitch = self.lead / (2 * math.pi)
            along = ca.dot(self._thread(carrier)[1], self.triad(carrier=carrier)[2])
            return pitch * ca.atan2(residual / pitch, along)
        if direction not in (*_ALIGNED, "rotation3"):
            return residual
        k = 0 if direction == "rotation3" else 2
        one, two = self.triad(carrier=carrier)[k], self.triad(True, carrier)[k]
        # During the assembly, Euler parameters may not have unit length.
        whole = ca.sqrt(ca.sumsqr(one) * ca.sumsqr(two)) + _NONE
        return (2 + _OPPOSITE) * whole / (whole + ca.dot(one, two) + _OPPOSITE * whole) * residual

    def reaction(self, multipliers: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
        """Return force (3,) and moment (3,) on the second body from the first, about the joint's point on the second
        body, in ground axes.

        They do the same virtual work as the constraint forces -C' lambda in a displacement and a rotation of that body.
        """
        force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
        for direction, lam in multipliers.items():
            if direction in ("x", "y", "z"):
                along = ca.SX([direction == axis for axis in "xyz"])
                force -= lam * (along if (carrier := self.carrier) is None else carrier.rotation @ along)
            elif direction.startswith("normal"):
                force -= lam * self.triad()[int(direction[-1]) - 1]
            elif direction == "axis":
                force -= lam * self.triad()[2]
            elif direction == "length":
                force -= lam * (self.second.place - self.first.place) / self.length
            elif direction == "screw":
                _, along, about = self._thread()
                force -= lam * along
                moment -= lam * about
            else:
                on_first, on_second = self._kept_square(direction)
                moment -= lam * ca.cross(on_second, on_first)
        return force, moment

    def _thread(self, carrier: SpatialBody | None = None) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the deviation [m] of a screw's second body from the thread, and the derivatives of the deviation.

        The deviation is p sin(s/p - th) with p = lead/(2 pi), independent of whole turns; the derivatives (3,) are by a
        displacement and a rotation of the second body, in the axes of the ground or of a carrier.
        """
        pitch = self.lead / (2 * math.pi)
        normal, other, axis = self.triad(carrier=carrier)
        turned = self.triad(True, carrier)[0]
        phase = self._measured("position") / pitch
        way = ca.cos(phase) * ca.dot(normal, turned) + ca.sin(phase) * ca.dot(other, turned)
        across = pitch * (ca.sin(phase) * normal - ca.cos(phase) * other)
        return ca.dot(across, turned), way * axis, ca.cross(turned, across)

    def _kept_square(self, direction: str, carrier: SpatialBody | None = None) -> tuple[ca.SX, ca.SX]:
        """Return two directions, one on each body, that a joint keeps at a right angle, in the axes of the ground or of
        a carrier."""
        on_first, on_second = self.triad(carrier=carrier), self.triad(True, carrier)
        if direction == "rotation":
            return on_first[2], on_second[2]
        if direction == "rotation3":
            return on_first[0], on_second[1]
        return on_first[_ALIGNED.index(direction)], on_second[2]


@dataclass(frozen=True, repr=False)
class SpatialFreedom(Brief):
    """One of the free motions of a joint in space; `SpatialJoint.freedom` makes it."""

    joint: SpatialJoint
    which: str

    @property
    def name(self) -> str:
        """Name of the displacement."""
        return f"{self.joint.name}.{self.which}"

    @property
    def kind(self) -> str:
        """Kind of the joint with only this free motion: revolute or prismatic."""
        return "revolute" if self.joint.freedoms[self.which] == "rad" else "prismatic"

    @property
    def freedoms(self) -> dict[str, str]:
        """The unit of this free motion, by its name."""
        return {self.which: self.joint.freedoms[self.which]}

    @property
    def driven_axis(self) -> Vector | None:
        """Direction of the motion in the frame of the second body; None if it is fixed on the first body alone."""
        return self.joint.axes[1] if self.which in ("angle", "angle2", "position") else None

    @property
    def first(self) -> SpatialMarker:
        """The joint's point on its first body."""
        return self.joint.first

    @property
    def second(self) -> SpatialMarker:
        """The joint's point on its second body."""
        return self.joint.second

    @property
    def free(self) -> ca.SX:
        """The free displacement, second body from first [rad or m]. A run counts the turns."""
        return self.joint.counted(self.which)

    @property
    def measured(self) -> ca.SX:
        """The free displacement; an angle is within one turn if constraints close the joint."""
        return self.joint.displacement(self.which)

    @property
    def wrapped(self) -> bool:
        """Whether the free displacement is an angle known up to whole turns only."""
        return self.joint.is_wrapped(self.which)


_OPPOSITE = 1e-6
"""Regularisation [1] of the residual at opposite directions, which a declaration may contain up to round-off."""


_NONE = 1e-30
"""Smallest length [1] in a quotient, instead of zero."""


def with_turns(sine: ca.SX, cosine: ca.SX, near: ca.SX) -> ca.SX:
    """Return the angle [rad] within half a turn of `near`, from its sine and cosine times a common length.

    It has no jumps near `near`; for `near` = 0 it is atan2.
    """
    c, s = ca.cos(near), ca.sin(near)
    return near + ca.atan2(sine * c - cosine * s, cosine * c + sine * s)


def _column(vector: Vector) -> ca.SX:
    """Return numbers or expressions as a column (3,)."""
    return ca.vertcat(*map(ca.SX, vector))


def _between(a: Vector, b: Vector) -> ca.SX:
    """Return the vector (3,) from one point of a body's frame to another."""
    return ca.vertcat(*(ca.SX(y) - x for x, y in zip(a, b, strict=True)))


def _length(axis: Vector) -> Scalar:
    """Return the length of a direction."""
    if any(isinstance(x, ca.SX) for x in axis):
        return ca.norm_2(ca.vertcat(*axis))
    return math.hypot(*axis)


def _same(first: Vector, second: Vector) -> bool:
    """Return whether two axes are given by the same numbers or expressions."""
    plain = not any(isinstance(x, ca.SX) for x in (*first, *second))
    return first == second if plain else all(a is b for a, b in zip(first, second, strict=True))


def _unit(axis: Vector) -> Vector:
    """Return a direction of unit length."""
    x, y, z = (a / _length(axis) for a in axis)
    return x, y, z


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _about_axes(axes: tuple[Vector, Vector], angle: Scalar, nominal: tuple[Vector, Vector] | None = None) -> ca.SX:
    """Return the rotation matrix (3, 3) of an angle [rad]; at zero the triads of the two axes coincide."""
    triads = (right_handed(axis, near) for axis, near in zip(axes, nominal or (None, None), strict=True))
    if any(isinstance(x, ca.SX) for axis in axes for x in axis):
        (i, j, k), (i2, j2, k2) = ([_column(each) for each in triad] for triad in triads)
        if _same(*axes):
            return k @ k.T + ca.cos(angle) * (ca.SX.eye(3) - k @ k.T) + ca.sin(angle) * ca.skew(k)
        return k @ k2.T + ca.cos(angle) * (i @ i2.T + j @ j2.T) + ca.sin(angle) * (j @ i2.T - i @ j2.T)
    (n, o, x), (n2, o2, x2) = ([np.array(each) for each in triad] for triad in triads)
    if _same(*axes):  # exact for an axis of the frame
        fixed, cosine = np.outer(x, x), np.eye(3) - np.outer(x, x)
        sine = np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])
    else:
        fixed, cosine = np.outer(x, x2), np.outer(n, n2) + np.outer(o, o2)
        sine = np.outer(o, n2) - np.outer(n, o2)
    parts = [ca.SX(ca.DM(np.where(np.abs(each) < 1e-15, 0.0, each))) for each in (fixed, cosine, sine)]
    return parts[0] + ca.cos(angle) * parts[1] + ca.sin(angle) * parts[2]


def _attitude(turn: ca.SX, nominal: ca.SX) -> ca.SX:
    """Return Euler parameters (4,) of a rotation matrix (3, 3); its numerical value `nominal` selects their sign."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(np.array(ca.DM(nominal))).as_quat()
    if turn.is_constant():
        return ca.SX([w, x, y, z])
    k = int(np.argmax(np.abs([w, x, y, z])))
    squares = _squares(turn)  # 4 e e'
    return squares[:, k] / (2 * ca.sqrt(squares[k, k])) * float(np.sign([w, x, y, z][k]))


def _squares(R: ca.SX) -> ca.SX:
    """Return the matrix (4, 4) of four times the products of the Euler parameters of a rotation matrix."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    found = ca.SX(4, 4)
    found[0, 0] = 1 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        found[i + 1, i + 1] = 1 + 2 * R[i, i] - trace
        found[0, i + 1] = found[i + 1, 0] = R[k, j] - R[j, k]
        found[i + 1, j + 1] = found[j + 1, i + 1] = R[i, j] + R[j, i]
    return found


def right_handed(axis: Vector, nominal: Vector | None = None) -> tuple[Vector, Vector, Vector]:
    """Return two normals of a direction and the direction itself, of unit length and right-handed.

    The first normal is the coordinate axis after the one nearest to the direction, made perpendicular to it: exact for
    an axis of the frame. For an expression in parameters, its value `nominal` at their defaults selects that axis.
    """
    x = _unit(axis)
    near = [abs(float(a)) for a in _unit(axis if nominal is None else nominal)]
    largest = near.index(max(near))
    start = [float(i == (largest + 1) % 3) for i in range(3)]
    along = sum(a * b for a, b in zip(start, x, strict=True))
    normal = [a - along * b for a, b in zip(start, x, strict=True)]
    size = _length((normal[0], normal[1], normal[2]))
    n = normal[0] / size, normal[1] / size, normal[2] / size
    other = x[1] * n[2] - x[2] * n[1], x[2] * n[0] - x[0] * n[2], x[0] * n[1] - x[1] * n[0]
    return n, other, x
