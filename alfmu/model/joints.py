"""Calls that declare bodies and the joints between them, in the plane and in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import overload

import casadi as ca
import numpy as np

from .calls import declares
from .declaration import Declaration
from .errors import DeclarationError
from .parts import (
    CONSTANT,
    GUESS,
    PLACE,
    AnyJoint,
    AnyMarker,
    Body,
    Constraint,
    Coordinate,
    Joint,
    Marker,
    Point,
    Rigidity,
    Scalar,
    key_of,
    stack,
)
from .quantities import Quantities
from .spatial import SpatialBody, SpatialJoint, SpatialMarker, Vector
from .words import shown


@declares
class Joints(Quantities):
    """A declaration with the calls for bodies and joints."""

    # Bodies -----------------------------------------------------------------------------------------------------

    def constraint(self, name: str, expression: ca.SX, unit: str = "m") -> None:
        """A holonomic constraint Phi(q, t) = 0 in m, rad or 1, after the joints declared so far.

        It is an expression in coordinates, time and inputs. Its force acts along the coordinates, so that reactions of
        joints with coordinates do not contain it.
        """
        self._claim(name, unit, "a constraint")
        value = self._of_coordinates(f"constraint {name}", expression, unit)
        self._no_jumps(f"constraint {name}", value, unit)
        Declaration.closures.of(self).append(Constraint(name, value, unit))

    def body(
        self,
        name: str,
        *,
        mass: Scalar,
        inertia: Scalar | None = None,
        center: tuple[Scalar, Scalar] = (0.0, 0.0),
        pose: tuple[Scalar, Scalar, Scalar] | None = None,
    ) -> Body:
        """Add a rigid body: mass [kg], inertia about its centre of mass [kg.m2], centre of mass in its frame [m].

        Without an inertia it is a point mass; if it rotates, a warning asks whether the inertia was forgotten, and
        `inertia=0.0` silences it.

        `pose` (x, y, angle) gives the place of the *centre of mass* [m] and the angle of the frame [rad] in ground axes
        (absolute coordinates). A body without one is placed by a joint with a coordinate, or by a weld.
        """
        mass, given = self._mass(name, mass), self._inertia(name, 0.0 if inertia is None else inertia)
        center = self._vector(f"the center of {name}", center, ("m",) * 2, CONSTANT)
        body = self._add(Body(name, mass, given, center, pose=self._pose(name, pose)))
        if inertia is None:
            self._points.add(body)
        return body

    def bar(
        self,
        name: str,
        *,
        mass: Scalar,
        length: Scalar,
        pose: tuple[Scalar, Scalar, Scalar] | None = None,
        between: tuple[Point | Marker, Point | Marker] | None = None,
    ) -> Body:
        """Add a thin uniform bar, mass [kg] and length [m], along the x axis of its frame from `start` to `end`.

        `pose` (x, y, angle) gives the place of its *middle* [m] and its angle [rad] in ground axes.

        `between` places it on two points (natural coordinates): its mass matrix is then constant, and one constraint
        keeps the points at their distance.
        """
        if pose is not None and between is not None:
            raise DeclarationError(f"{self.name}: {name} has a pose and two points; give one of them")
        mass, length = self._mass(name, mass), self._length(f"the length of {name}", length, CONSTANT)
        if between is not None:
            between = self._ends(name, between)
        body = Body(name, mass, mass * length**2 / 12, (length / 2, 0.0), length, self._pose(name, pose), between)
        self._add(body)
        if between is not None:
            self._stands_for(body.near, "coordinates", f"the angle of {name}", "rad")
            Declaration.closures.of(self).append(Rigidity(body))
        return body

    def point(self, x: Scalar, y: Scalar) -> Point:
        """Return a point in ground axes [m], usually a pair of coordinates."""
        return Point(*(self._moving("a point", each, "m") for each in (x, y)))

    def gravity(self, x: Scalar, y: Scalar, z: Scalar = 0.0) -> None:
        """Set the acceleration of gravity [m/s2] in ground axes; (0, 0) declares that there is none."""
        self._weighs = True
        self.gravity_vector: Vector = self._vector("gravity", (x, y, z), ("m/s2",) * 3, CONSTANT)

    def spatial_body(
        self,
        name: str,
        *,
        mass: Scalar,
        inertia: Vector | Sequence[Sequence[Scalar]] | np.ndarray | ca.SX,
        center: Vector = (0.0, 0.0, 0.0),
        position: Vector | ca.SX = (0.0, 0.0, 0.0),
        attitude: Sequence[Scalar] | ca.SX = (1.0, 0.0, 0.0, 0.0),
        relative: bool = False,
    ) -> SpatialBody:
        """Add a rigid body in space: mass [kg], inertia about its centre of mass [kg.m2], the centre of mass in its
        frame [m].

        `inertia` is three principal moments along the axes of the frame, or the matrix (3, 3) of inertia in these axes:
        moments on its diagonal, negated products of inertia off the diagonal.

        The body has seven coordinates, `<name>_x` ... `<name>_e3`: the place of the centre of mass and the Euler
        parameters of the frame, kept at unit length by a constraint. `position` and `attitude` are their guesses at the
        start, like `start` of `coordinate`; `spatial.about` and `spatial.product` make Euler parameters from rotations.
        Joints to `spatial_ground` and to other bodies in space are closed by constraints.

        With `relative=True` it has no coordinates of its own: a joint with a `coordinate` places it on another body.
        """
        moments, products = self._spatial_inertia(name, inertia)
        mass, center = self._mass(name, mass), self._vector(f"the center of {name}", center, ("m",) * 3, CONSTANT)
        position = self._vector(f"the position of {name}", position, ("m",) * 3, GUESS)
        attitude = self._vector(f"the attitude of {name}", attitude, ("1",) * 4, GUESS)
        if not any(isinstance(x, ca.SX) or x for x in attitude):
            raise DeclarationError(f"{self.name}: the attitude of {name} is zero; give (1, 0, 0, 0) for no turn")
        if relative and (position, attitude) != ((0.0,) * 3, (1.0, 0.0, 0.0, 0.0)):
            raise DeclarationError(
                f"{self.name}: {name} is relative and has a position or an attitude; give start= to the coordinate of "
                "the joint that places it"
            )
        self._claim(name, "1", "a body")
        own = None
        if not relative:
            r = [self.coordinate(f"{name}_{axis}", "m", start=x) for axis, x in zip("xyz", position, strict=True)]
            own = stack(r), stack([self.coordinate(f"{name}_e{i}", "1", start=x) for i, x in enumerate(attitude)])
        body = SpatialBody(name, mass, moments, center, own, products)
        Declaration.spatial_bodies.of(self).append(body)
        self._owned.add(body)
        if own is not None:
            self.constraint(body.unit_length, (ca.sumsqr(own[1]) - 1) / 2, "1")
        return body

    # Joints -----------------------------------------------------------------------------------------------------

    def revolute(self, name: str, first: Marker, second: Marker, *, coordinate: Scalar | None = None) -> Joint:
        """Add a hinge: the two markers coincide. Return the joint, for `drive`, `spring_damper`, `friction` and `lock`.

        `coordinate` is the angle [rad] of the second body from the first, counter-clockwise; a hinge without one closes
        a loop. Outputs `<name>.force.x` and `.y` [N] are the reaction on the second body from the first in ground axes.
        """
        return self._join(Joint(name, "revolute", first, second, coordinate))

    def prismatic(
        self,
        name: str,
        first: Marker,
        second: Marker,
        *,
        axis: Scalar = 0.0,
        offset: Scalar = 0.0,
        angle: Scalar = 0.0,
        coordinate: Scalar | None = None,
    ) -> Joint:
        """Add a slider in a guide: the second marker stays on a line through the first, the second body at a constant
        angle.

        The guide has the direction `axis` [rad] in the first body's frame and lies `offset` [m] to its left; the second
        body's frame stands at `angle` [rad] from the first's. `coordinate` is the place [m] of the second marker along
        the guide from the first. Outputs `<name>.force` [N], across the guide, and `<name>.moment` [N.m] are the
        reaction on the second body from the first.
        """
        return self._join(Joint(name, "prismatic", first, second, coordinate, axis, offset, angle))

    def weld(self, name: str, first: Marker, second: Marker, *, angle: Scalar = 0.0) -> Joint:
        """Add a rigid connection: the markers coincide, and the second body stays at `angle` [rad] from the first.

        If nothing else places one of the bodies, the weld does; otherwise it is closed by constraints.
        """
        joint = Joint(name, "weld", first, second, angle=angle)
        self._own((first, second), f"joint {name}", Marker)
        if not (first.body.is_placed and second.body.is_placed):
            joint.coordinate = 0.0
        return self._join(joint)

    def point_on_line(
        self, name: str, first: Marker, second: Marker, *, axis: Scalar = 0.0, offset: Scalar = 0.0
    ) -> Joint:
        """Add a pin in a slot: the second marker stays on a line through the first, free to turn.

        The line has the direction `axis` [rad] in the first body's frame and lies `offset` [m] to its left.
        """
        return self._join(Joint(name, "point_on_line", first, second, None, axis, offset))

    @overload
    def distance(self, name: str, first: Marker, second: Marker, *, length: Scalar) -> Joint: ...
    @overload
    def distance(self, name: str, first: SpatialMarker, second: SpatialMarker, *, length: Scalar) -> SpatialJoint: ...
    def distance(self, name: str, first: AnyMarker, second: AnyMarker, *, length: Scalar) -> AnyJoint:
        """Add a massless rod: the markers, both in the plane or both in space, stay `length` [m] apart.

        Output `<name>.force` [N] is positive when the rod pushes.
        """
        what = f"the length of {name}"
        length = self._length(what, length, PLACE)
        if isinstance(first, SpatialMarker) and isinstance(second, SpatialMarker):
            length = self._moving(what, length, "m")
            return self._join_in_space(SpatialJoint(name, "distance", first, second, length=length))
        return self._join(Joint(name, "distance", first, second, length=length))  # type: ignore[arg-type]

    def spherical(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        coordinates: Sequence[Scalar] | ca.SX | None = None,
    ) -> SpatialJoint:
        """Add a ball joint in space: the two markers coincide.

        `coordinates` are the four Euler parameters of the second body in the axes of the first; a constraint keeps them
        at unit length. If none has a guess, they begin without a turn. A joint without them closes a loop.
        """
        joint = SpatialJoint(
            name, "spherical", first, second, coordinates=self._placing(name, "spherical", coordinates)
        )
        self._join_in_space(joint)
        if joint.coordinates is not None:
            given = [self._by_symbol.get(key_of(x)) for x in joint.coordinates]
            if isinstance(scalar := given[0], Coordinate) and not any(getattr(c, "guessed", True) for c in given):
                listed = Declaration.coordinates.of(self)
                listed[listed.index(scalar)] = self._by_symbol[key_of(scalar.q)] = replace(scalar, guess=1.0)
            self.constraint(joint.unit_length, (ca.sumsqr(stack(joint.coordinates)) - 1) / 2, "1")
        return joint

    def spatial_revolute(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[Scalar],
        second_axis: Sequence[Scalar] | None = None,
        coordinate: Scalar | None = None,
    ) -> SpatialJoint:
        """Add a hinge in space: the two markers coincide, and so does an axis fixed on both bodies.

        `axis` gives its direction in the frame of the first body, `second_axis` in that of the second (the same numbers
        by default). The angle, output `<name>.angle` [rad], is zero if the triads of `spatial.right_handed` on both
        bodies coincide: with the same axis on both, if the frames are parallel. `coordinate` is this angle and places
        the second body, which is `relative`; a hinge without one closes a loop. Axes may be expressions in parameters.
        """
        axes, placing = self._axes(name, axis, second_axis), self._placing(name, "revolute", coordinate)
        return self._join_in_space(SpatialJoint(name, "revolute", first, second, axes, placing))

    def cylindrical(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[Scalar],
        second_axis: Sequence[Scalar] | None = None,
        coordinates: Sequence[Scalar] | ca.SX | None = None,
    ) -> SpatialJoint:
        """Add a sleeve on a shaft: the second marker stays on an axis through the first, free to slide along it and to
        turn.

        `coordinates` are the angle [rad] and the position [m] along the axis, and place the second body.
        """
        axes, placing = self._axes(name, axis, second_axis), self._placing(name, "cylindrical", coordinates)
        return self._join_in_space(SpatialJoint(name, "cylindrical", first, second, axes, placing))

    def spatial_prismatic(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[Scalar],
        coordinate: Scalar | None = None,
    ) -> SpatialJoint:
        """Add a slider in space: the second marker stays on an axis through the first, with both frames parallel.

        `coordinate` is the position [m] along the axis, and places the second body.
        """
        axes, placing = self._axes(name, axis, None), self._placing(name, "prismatic", coordinate)
        return self._join_in_space(SpatialJoint(name, "prismatic", first, second, axes, placing))

    def spatial_screw(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[Scalar],
        lead: Scalar,
        second_axis: Sequence[Scalar] | None = None,
        coordinate: Scalar | None = None,
    ) -> SpatialJoint:
        """Add a nut on a screw: as `cylindrical`, and one turn of the second body moves it `lead` [m] along the axis.

        A negative lead is a left-hand thread. `coordinate` is the angle [rad] and places the second body. If
        constraints close the screw, it stays on the turn of the thread on which it starts, and the place of the second
        marker tells the turns of the angle. A drive is a torque [N.m].
        """
        axes, placing = self._axes(name, axis, second_axis), self._placing(name, "screw", coordinate)
        lead = self._quantity(f"the lead of {name}", lead, "m", CONSTANT)
        if not self._at_defaults(f"the lead of {name}", lead):
            raise DeclarationError(f"{self.name}: the lead of {name} is zero; take spatial_revolute() for a hinge")
        return self._join_in_space(SpatialJoint(name, "screw", first, second, axes, placing, lead))

    def universal(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[float],
        second_axis: Sequence[float],
        coordinates: Sequence[Scalar] | ca.SX | None = None,
    ) -> SpatialJoint:
        """Add a universal (Cardan) joint: the markers coincide, and two axes, one on each body, stay perpendicular.

        `axis` in the frame of the first body and `second_axis` in that of the second must be perpendicular as numbers:
        the frames are parallel when both angles are zero. `coordinates` are the angles [rad] about the first and then
        about the second axis, and place the second body.
        """
        axes = self._direction(name, axis), self._direction(name, second_axis)
        across = sum(a * b for a, b in zip(*axes, strict=True)) / (math.hypot(*axes[0]) * math.hypot(*axes[1]))
        if abs(across) > 1e-9:
            raise DeclarationError(
                f"{self.name}: the axes {shown(axis)} and {shown(second_axis)} of {name} make an angle of "
                f"{math.degrees(math.acos(across)):.6g} degrees; those of a universal joint are perpendicular where "
                "the frames are parallel"
            )
        placing = self._placing(name, "universal", coordinates)
        return self._join_in_space(SpatialJoint(name, "universal", first, second, axes, placing))

    def planar(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[Scalar],
        second_axis: Sequence[Scalar] | None = None,
        coordinates: Sequence[Scalar] | ca.SX | None = None,
    ) -> SpatialJoint:
        """Add a plate on a table: the second marker slides in a plane through the first and turns about its normal
        `axis`.

        `coordinates` are the positions [m] along the two normals of `axis` that `spatial.right_handed` gives and the
        angle [rad] about it, and place the second body.
        """
        axes, placing = self._axes(name, axis, second_axis), self._placing(name, "planar", coordinates)
        return self._join_in_space(SpatialJoint(name, "planar", first, second, axes, placing))

    def spatial_weld(self, name: str, first: SpatialMarker, second: SpatialMarker) -> SpatialJoint:
        """Add a rigid connection in space: the markers coincide, the frames are parallel.

        If nothing else places the second body, the weld does; otherwise it is closed by constraints.
        """
        self._own((first, second), f"joint {name}", SpatialMarker)
        placing = None if second.body.is_placed else ()
        return self._join_in_space(SpatialJoint(name, "weld", first, second, coordinates=placing))

    def spare(self, of: SpatialJoint | str, *directions: str) -> None:
        """Leave out directions in which a joint in space closes a loop, because other joints suppress them.

        A hinge that closes a planar loop in space suppresses some directions for a second time. If numbers are rounded,
        this makes the loop rigid, or keeps it open. Directions have the names of the joint's reaction outputs.
        """
        joint = self._joint(of)
        if not isinstance(joint, SpatialJoint) or joint.coordinates is not None:
            raise DeclarationError(
                f"{self.name}: {joint.name} closes no loop in space, so that it has no spare directions"
            )
        if unknown := [each for each in directions if each not in joint.directions]:
            raise DeclarationError(
                f"{self.name}: {joint.name} does not constrain {shown(unknown[0])}; it constrains "
                f"{', '.join(joint.directions)}"
            )
        self._change(joint, "spare", (*joint.spare, *directions))
