"""The declaration of a mechanism: frames, bodies, joints, forces, inputs, outputs, parameters.

A declaration lists *the parts*; `alfmu.derive` turns it into equations. Nothing here is differentiated or stepped.
Every number may be a float or an expression in parameters; poses, forces and outputs may use coordinates too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from .errors import DeclarationError
from .spatial import SpatialBody, SpatialJoint, SpatialMarker, Vector
from .units import rate_of, unit

__all__ = ["Body", "Joint", "Marker", "Mechanism", "Point", "Scalar"]

Scalar = float | ca.SX
"""A number or an expression."""

_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*\Z")
_RESERVED = {"start", "solver", "monitor", "multiplier", "ground", "time"}

DIRECTIONS: dict[str, tuple[str, ...]] = {
    "revolute": ("x", "y"),
    "prismatic": ("normal", "rotation"),
    "weld": ("x", "y", "rotation"),
    "point_on_line": ("normal",),
    "distance": ("length",),
}
"""The relative displacements that each kind of joint suppresses, in the order of its constraint rows."""


@dataclass(frozen=True)
class Parameter:
    """A constant that a user may change before the start."""

    name: str
    symbol: ca.SX
    default: float
    unit: str
    minimum: float | None
    maximum: float | None
    description: str


@dataclass(frozen=True)
class Start:
    """A quantity whose value and rate the user gives at the start; `tied` is the expression that must equal it."""

    name: str
    symbol: ca.SX
    value: float
    unit: str
    rate_name: str
    rate: float
    description: str


@dataclass(frozen=True)
class Coordinate:
    """A dependent coordinate with its symbols for q, v, a and its guess at the start."""

    name: str
    q: ca.SX
    v: ca.SX
    a: ca.SX
    unit: str
    guess: Scalar


@dataclass(frozen=True)
class Input:
    """A quantity that the environment sets at any time."""

    name: str
    symbol: ca.SX
    unit: str
    start: float
    description: str


@dataclass(frozen=True)
class Output:
    """An expression that a user asked for by name."""

    name: str
    expression: ca.SX
    unit: str
    description: str


@dataclass(frozen=True)
class Point:
    """A point in ground axes given by expressions in the coordinates (natural coordinates)."""

    x: Scalar
    y: Scalar


@dataclass(frozen=True, eq=False)
class Marker:
    """A point fixed on a body, by its place in the body's frame."""

    body: Body
    x: Scalar
    y: Scalar


@dataclass(eq=False)
class Body:
    """A rigid planar body; its frame's origin is wherever the user measures from."""

    name: str
    mass: Scalar
    inertia: Scalar
    center: tuple[Scalar, Scalar]
    length: Scalar | None = None
    pose: tuple[Scalar, Scalar, Scalar] | None = None
    between: tuple[Point | Marker, Point | Marker] | None = None
    placed_by: Joint | None = None

    def at(self, x: Scalar = 0.0, y: Scalar = 0.0) -> Marker:
        """The point (x, y) [m] of the body's frame."""
        return Marker(self, x, y)

    @property
    def start(self) -> Marker:
        """The origin of a bar: its first end."""
        return self.at(0.0, 0.0)

    @property
    def end(self) -> Marker:
        """The far end of a bar."""
        if self.length is None:
            raise DeclarationError(f"{self.name} has no length, so no end; use at(x, y)")
        return self.at(self.length, 0.0)

    @property
    def is_placed(self) -> bool:
        return self.pose is not None or self.between is not None or self.placed_by is not None


@dataclass(eq=False)
class Joint:
    """A joint between two bodies: closed by a coordinate where one is given, otherwise by constraints."""

    name: str
    kind: str
    first: Marker
    second: Marker
    coordinate: Scalar | None = None
    axis: Scalar = 0.0
    offset: Scalar = 0.0
    angle: Scalar = 0.0
    length: Scalar = 0.0

    @property
    def directions(self) -> tuple[str, ...]:
        """The relative displacements that the joint suppresses."""
        return DIRECTIONS[self.kind]


AnyMarker = Marker | SpatialMarker
AnyJoint = Joint | SpatialJoint


@dataclass(frozen=True)
class Rigidity:
    """The constant distance between the two points that carry a body in natural coordinates."""

    body: Body

    @property
    def name(self) -> str:
        return f"{self.body.name}.length"


@dataclass(frozen=True)
class Constraint:
    """A constraint written out by the user."""

    name: str
    expression: ca.SX
    unit: str


@dataclass(frozen=True)
class Lock:
    """A displacement that a Boolean input stops where it is and lets go again; `value` is where it was stopped."""

    name: str
    of: AnyJoint | tuple[Body, Body] | ca.SX
    unit: str
    value: ca.SX


@dataclass(frozen=True)
class Spring:
    """A linear spring-damper along a displacement: of a joint, or the distance of two markers."""

    between: AnyJoint | tuple[AnyMarker, AnyMarker]
    stiffness: Scalar
    damping: Scalar
    rest: Scalar


@dataclass(frozen=True)
class Drive:
    """An effort along a joint's free direction, on the second body from the first."""

    joint: AnyJoint
    effort: Scalar


@dataclass(frozen=True)
class Load:
    """A force in ground axes at a marker, or a torque on a body."""

    at: Marker
    force: tuple[Scalar, Scalar]
    torque: Scalar


@dataclass(frozen=True)
class Experiment:
    """What a run of the mechanism looks like when nobody says otherwise."""

    stop_time: float = 10.0
    """[s]"""
    step_size: float = 0.02
    """Default of `solver.step_size` [s]."""
    interval: float | None = None
    """Communication step [s]; None for that of the solver."""


@dataclass
class Mechanism:
    """A mechanism: bodies and joints in the plane or in space, with a general level for everything else.

    Declare parameters and coordinates, then bodies, then joints and forces::

        m = Mechanism("pendulum", description="A bar on a hinge")
        l = m.parameter("l", 1.0, "m", minimum=1e-6)
        g = m.parameter("g", 9.81, "m/s2")
        th = m.coordinate("th", "rad", start=0.5, independent=True)
        rod = m.bar("rod", mass=1.0, length=l)
        m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th)
        m.gravity(0, -g)

    `sketch` is shown wherever the mechanism is explained; the README beside a mechanism's file is its documentation.
    Its `author` is named in the FMU.
    """

    name: str
    description: str = ""
    sketch: str = ""
    experiment: Experiment = field(default_factory=Experiment)
    author: str = ""
    parameters: list[Parameter] = field(default_factory=list, init=False)
    starts: list[Start] = field(default_factory=list, init=False)
    ties: list[tuple[ca.SX, ca.SX]] = field(default_factory=list, init=False)
    coordinates: list[Coordinate] = field(default_factory=list, init=False)
    inputs: list[Input] = field(default_factory=list, init=False)
    outputs: list[Output] = field(default_factory=list, init=False)
    bodies: list[Body] = field(default_factory=list, init=False)
    joints: list[Joint] = field(default_factory=list, init=False)
    spatial_bodies: list[SpatialBody] = field(default_factory=list, init=False)
    spatial_joints: list[SpatialJoint] = field(default_factory=list, init=False)
    closures: list[AnyJoint | Rigidity | Constraint | Lock] = field(default_factory=list, init=False)
    releases: list[AnyJoint | Constraint] = field(default_factory=list, init=False)
    springs: list[Spring] = field(default_factory=list, init=False)
    drives: list[Drive] = field(default_factory=list, init=False)
    loads: list[Load] = field(default_factory=list, init=False)
    kinetic: list[ca.SX] = field(default_factory=list, init=False)
    potential: list[ca.SX] = field(default_factory=list, init=False)
    generalized: list[tuple[ca.SX, Scalar]] = field(default_factory=list, init=False)
    gravity_vector: Vector = field(default=(0.0, 0.0, 0.0), init=False)
    documentation: str = field(default="", init=False)
    options: dict[str, Any] = field(default_factory=dict, init=False)
    compliant: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z_]\w*", self.name):
            raise DeclarationError(f"{self.name!r} cannot name a mechanism; use letters, digits and underscores")
        self.ground = Body("ground", 0.0, 0.0, (0.0, 0.0), pose=(0.0, 0.0, 0.0))
        origin, upright = ca.SX.zeros(3), ca.SX([1, 0, 0, 0])
        self.spatial_ground = SpatialBody("ground", 0.0, (0.0,) * 3, (0.0,) * 3, origin, upright)
        self.time = ca.SX.sym("time")
        self._names: dict[str, str] = {}
        self._by_symbol: dict[int, Start | Coordinate] = {}
        self._owned: set[Body | SpatialBody] = {self.ground, self.spatial_ground}

    # Quantities -------------------------------------------------------------------------------------------------

    def parameter(
        self,
        name: str,
        default: float,
        unit: str = "1",
        *,
        minimum: float | None = None,
        maximum: float | None = None,
        description: str = "",
    ) -> ca.SX:
        """A constant with a default, a unit and inclusive bounds; returns its symbol."""
        symbol = self._claim(name, unit, "a parameter")
        if (minimum is not None and default < minimum) or (maximum is not None and default > maximum):
            raise DeclarationError(f"{self.name}: the default {default} of {name} is outside [{minimum}, {maximum}]")
        self.parameters.append(Parameter(name, symbol, float(default), unit, minimum, maximum, description))
        return symbol

    def start(
        self,
        name: str,
        value: float = 0.0,
        unit: str = "rad",
        *,
        rate: float = 0.0,
        rate_name: str | None = None,
        description: str = "",
    ) -> ca.SX:
        """A quantity given at the start, `start.<name>`, and its rate; returns the symbol of its value.

        A coordinate whose `start` is this symbol is independent; `tie` binds the symbol to any other expression.
        """
        rate_name = rate_name or f"{name}_rate"
        symbol = self._claim(f"start.{name}", unit, "a start value")
        self._claim(f"start.{rate_name}", rate_of(unit), "a start value")
        self.starts.append(Start(name, symbol, float(value), unit, rate_name, float(rate), description))
        self._by_symbol[key_of(symbol)] = self.starts[-1]
        return symbol

    def tie(self, start: ca.SX, expression: ca.SX) -> None:
        """Require `expression` (of the coordinates) to equal a start quantity when the run begins."""
        if not self._is_start(start):
            raise DeclarationError(f"{self.name}: tie() takes a symbol that start() returned")
        self.ties.append((start, expression))

    def coordinate(
        self,
        name: str,
        unit: str = "rad",
        *,
        start: Scalar = 0.0,
        rate: float = 0.0,
        independent: bool = False,
        description: str = "",
    ) -> ca.SX:
        """A dependent coordinate (entry of q); returns its symbol.

        `start` is the guess from which the assembly is solved: a number, or an expression in parameters, start
        quantities and coordinates declared before; its time derivative is the guess of the velocity. A coordinate with
        `independent=True`, or whose `start` is a start quantity, keeps the value the user gives.
        """
        symbol = self._claim(name, unit, "a coordinate")
        if independent:
            if isinstance(start, ca.SX) and not start.is_constant():
                raise DeclarationError(f"{self.name}: the start of the independent coordinate {name} is a number")
            start = self.start(name, float(start), unit, rate=rate, description=description)
        elif rate:
            raise DeclarationError(f"{self.name}: only an independent coordinate has a start rate; {name} is not")
        c = Coordinate(name, symbol, ca.SX.sym(f"{name}_v"), ca.SX.sym(f"{name}_a"), unit, start)
        self.coordinates.append(c)
        self._by_symbol[key_of(symbol)] = c
        if self._is_start(start):
            self.tie(start, symbol)
        return symbol

    def rate(self, coordinate: ca.SX) -> ca.SX:
        """The velocity symbol of a coordinate, for kinetic energies and forces at the general level."""
        return self._coordinate(coordinate).v

    def acceleration(self, coordinate: ca.SX) -> ca.SX:
        """The acceleration symbol of a coordinate, for outputs."""
        return self._coordinate(coordinate).a

    def input(self, name: str, unit: str, *, start: float = 0.0, description: str = "") -> ca.SX:
        """A quantity set from outside at any time; returns its symbol."""
        symbol = self._claim(name, unit, "an input")
        self.inputs.append(Input(name, symbol, unit, float(start), description))
        return symbol

    def output(self, name: str, expression: Scalar, unit: str = "1", description: str = "") -> None:
        """A result of the user's own: any expression in coordinates, rates, accelerations, inputs and time."""
        self._claim(name, unit, "an output")
        self.outputs.append(Output(name, ca.SX(expression), unit, description))

    # Bodies -----------------------------------------------------------------------------------------------------

    def body(
        self,
        name: str,
        *,
        mass: Scalar,
        inertia: Scalar = 0.0,
        center: tuple[Scalar, Scalar] = (0.0, 0.0),
        pose: tuple[Scalar, Scalar, Scalar] | None = None,
    ) -> Body:
        """A rigid body: mass [kg], inertia about its centre of mass [kg.m2], centre of mass in its frame [m].

        `pose` gives the place of the *centre of mass* and the angle of the frame (absolute coordinates). A body without
        one is placed by a joint with a coordinate, or by a weld.
        """
        return self._add(Body(name, mass, inertia, center, pose=pose))

    def bar(
        self,
        name: str,
        *,
        mass: Scalar,
        length: Scalar,
        pose: tuple[Scalar, Scalar, Scalar] | None = None,
        between: tuple[Point | Marker, Point | Marker] | None = None,
    ) -> Body:
        """A thin uniform bar along the x axis of its frame, from `start` to `end`.

        `between` places it on two points (natural coordinates): its mass matrix is then constant, and one constraint
        keeps the points at their distance.
        """
        if pose is not None and between is not None:
            raise DeclarationError(f"{self.name}: {name} has a pose and two points; give one of them")
        body = Body(name, mass, mass * length**2 / 12, (length / 2, 0.0), length, pose, between)
        self._add(body)
        if between is not None:
            self.closures.append(Rigidity(body))
        return body

    def point(self, x: Scalar, y: Scalar) -> Point:
        """A point in ground axes [m], usually a pair of coordinates."""
        return Point(x, y)

    def gravity(self, x: Scalar, y: Scalar, z: Scalar = 0.0) -> None:
        """The acceleration of gravity [m/s2] in ground axes."""
        self.gravity_vector = (x, y, z)

    def spatial_body(
        self,
        name: str,
        *,
        mass: Scalar,
        inertia: Vector,
        center: Vector = (0.0, 0.0, 0.0),
        position: Vector | ca.SX = (0.0, 0.0, 0.0),
        attitude: Sequence[Scalar] | ca.SX = (1.0, 0.0, 0.0, 0.0),
    ) -> SpatialBody:
        """A rigid body in space: mass [kg], principal moments of inertia about its centre of mass [kg.m2], along the
        axes of its frame, and the centre of mass in its frame [m].

        It has seven coordinates, `<name>_x` ... `<name>_e3`: the place of the centre of mass and the Euler parameters
        of the frame, kept at unit length by a constraint. `position` and `attitude` are their guesses at the start, as
        `start` of `coordinate` is; `spatial.about` and `spatial.product` make Euler parameters from turns. Joints to
        `spatial_ground` and to other bodies in space are closed by constraints.
        """
        moments = [self._at_defaults(x) for x in inertia]
        if len(moments) != 3 or min(moments) < 0 or 2 * max(moments) > sum(moments) * (1 + 1e-12):
            raise DeclarationError(
                f"{self.name}: no body has the principal moments of inertia {moments} that {name} is given; give "
                "three, none negative and none above the sum of the others"
            )
        r = [self.coordinate(f"{name}_{axis}", "m", start=x) for axis, x in zip("xyz", _entries(position), strict=True)]
        e = [self.coordinate(f"{name}_e{i}", "1", start=x) for i, x in enumerate(_entries(attitude))]
        body = SpatialBody(name, mass, tuple(inertia), center, stack(r), stack(e))
        self._claim(name, "1", "a body")
        self.spatial_bodies.append(body)
        self._owned.add(body)
        self.constraint(body.unit_length, (ca.sumsqr(body.attitude) - 1) / 2, "1")
        return body

    # Joints -----------------------------------------------------------------------------------------------------

    def revolute(self, name: str, first: Marker, second: Marker, *, coordinate: Scalar | None = None) -> Joint:
        """A hinge: the two markers coincide. `coordinate` is the angle [rad] of the second body from the first."""
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
        """A slider in a guide: the second marker on a line through the first, the second body at a constant angle.

        The guide has the direction `axis` [rad] in the first body's frame and lies `offset` [m] to its left; the second
        body's frame stands at `angle` [rad] from the first's. `coordinate` is the place [m] along the guide.
        """
        return self._join(Joint(name, "prismatic", first, second, coordinate, axis, offset, angle))

    def weld(self, name: str, first: Marker, second: Marker, *, angle: Scalar = 0.0) -> Joint:
        """A rigid connection: markers coincide, the second body at `angle` [rad] from the first.

        Where nothing else places one of the bodies, the weld does; otherwise it is closed by constraints.
        """
        joint = Joint(name, "weld", first, second, angle=angle)
        if not (first.body.is_placed and second.body.is_placed):
            joint.coordinate = 0.0
        return self._join(joint)

    def point_on_line(
        self, name: str, first: Marker, second: Marker, *, axis: Scalar = 0.0, offset: Scalar = 0.0
    ) -> Joint:
        """A pin in a slot: the second marker on a line through the first, free to turn."""
        return self._join(Joint(name, "point_on_line", first, second, None, axis, offset))

    def distance(self, name: str, first: Marker, second: Marker, *, length: Scalar) -> Joint:
        """A massless rod: the markers stay `length` [m] apart."""
        return self._join(Joint(name, "distance", first, second, length=length))

    def spherical(self, name: str, first: SpatialMarker, second: SpatialMarker) -> SpatialJoint:
        """A ball joint in space: the two markers coincide."""
        return self._join_in_space(SpatialJoint(name, "spherical", first, second))

    def spatial_revolute(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[float],
        second_axis: Sequence[float] | None = None,
    ) -> SpatialJoint:
        """A hinge in space: the two markers coincide, and so does an axis fixed on both bodies.

        `axis` gives its direction in the frame of the first body, `second_axis` in that of the second (the same numbers
        if left out). The angle, output `<name>.angle` [rad], is zero where the triads of `spatial.right_handed` on both
        coincide: for one and the same axis, where the frames are parallel.
        """
        return self._join_in_space(SpatialJoint(name, "revolute", first, second, self._axes(name, axis, second_axis)))

    def cylindrical(
        self,
        name: str,
        first: SpatialMarker,
        second: SpatialMarker,
        *,
        axis: Sequence[float],
        second_axis: Sequence[float] | None = None,
    ) -> SpatialJoint:
        """A sleeve on a shaft: the second marker on an axis through the first, free to slide along it and to turn."""
        axes = self._axes(name, axis, second_axis)
        return self._join_in_space(SpatialJoint(name, "cylindrical", first, second, axes))

    def spatial_prismatic(
        self, name: str, first: SpatialMarker, second: SpatialMarker, *, axis: Sequence[float]
    ) -> SpatialJoint:
        """A slider in space: the second marker on an axis through the first, the frames of both bodies parallel."""
        return self._join_in_space(SpatialJoint(name, "prismatic", first, second, self._axes(name, axis, None)))

    # Forces -----------------------------------------------------------------------------------------------------

    def drive(self, joint: AnyJoint, effort: Scalar) -> None:
        """A torque [N.m] (revolute) or force along the guide [N] (prismatic) on the second body from the first."""
        self._free(joint)
        self.drives.append(Drive(joint, effort))

    def force(self, at: Marker, x: Scalar = 0.0, y: Scalar = 0.0) -> None:
        """A force [N] in ground axes at a point of a body: an input, a constant, or any expression."""
        self.loads.append(Load(at, (x, y), 0.0))

    def torque(self, body: Body, torque: Scalar) -> None:
        """A torque [N.m] on a body from the ground."""
        self.loads.append(Load(body.start, (0.0, 0.0), torque))

    def spring_damper(
        self,
        between: AnyJoint | tuple[AnyMarker, AnyMarker],
        *,
        stiffness: Scalar = 0.0,
        damping: Scalar = 0.0,
        rest: Scalar = 0.0,
    ) -> None:
        """A linear spring-damper: torsional on a revolute joint, along the guide on a prismatic one, or between points.

        stiffness [N.m/rad or N/m], damping [N.m.s/rad or N.s/m], rest angle or length [rad or m]. Points may belong to
        bodies in space; the angle of a spatial hinge is known within a turn, so that its spring should stay within one.
        """
        if isinstance(between, AnyJoint):
            self._free(between)
        else:
            self._own(between, "a spring")
            if isinstance(between[0], Marker) != isinstance(between[1], Marker):
                raise DeclarationError(
                    f"{self.name}: a spring joins a point in the plane to one in space; take one kind"
                )
        self.springs.append(Spring(between, stiffness, damping, rest))

    def friction(self, joint: AnyJoint, coefficient: Scalar) -> None:
        """Viscous friction in a joint [N.m.s/rad or N.s/m]."""
        self.spring_damper(joint, damping=coefficient)

    # General level ----------------------------------------------------------------------------------------------

    def kinetic_energy(self, expression: ca.SX) -> None:
        """Kinetic energy [J] in coordinates and their rates, in addition to that of the bodies."""
        self.kinetic.append(expression)

    def potential_energy(self, expression: ca.SX) -> None:
        """Potential energy [J] in coordinates, in addition to that of the bodies and springs."""
        self.potential.append(expression)

    def generalized_force(self, coordinate: ca.SX, expression: Scalar) -> None:
        """A generalised force along a coordinate: any expression in coordinates, rates, inputs and time."""
        self.generalized.append((self._coordinate(coordinate).q, expression))

    def constraint(self, name: str, expression: ca.SX, unit: str = "m") -> None:
        """A holonomic constraint Phi(q) = 0 in m, rad or 1, after the joints declared so far."""
        self._claim(name, unit, "a constraint")
        self.closures.append(Constraint(name, ca.SX(expression), unit))

    def compliances(self) -> None:
        """Give each constraint a parameter `<joint>.compliance.<direction>` [m/N or rad/(N.m)], zero by default.

        Where they are given, redundant constraints share a load as joints of that compliance do; otherwise their
        multipliers are of least norm. The motion is that of rigid joints either way.
        """
        self.compliant = True

    # Changing topology ------------------------------------------------------------------------------------------

    def lock(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.locked` stop the free motion of a revolute or prismatic joint while it is on.

        A joint that moves stops in a plastic impact, and keeps its state where it is let go.
        """
        joint = self._joint(of)
        self._free(joint)
        self._lock(joint.name, joint, "rad" if joint.kind == "revolute" else "m")

    def clutch(self, name: str, first: Body, second: Body) -> None:
        """Let the Boolean input `<name>.locked` couple the turning of two bodies; a brake where one is the ground."""
        self._claim(name, "1", "a clutch")
        self._own((first.start, second.start), name)
        if first is second:
            raise DeclarationError(f"{self.name}: clutch {name} couples {first.name} to itself")
        self._lock(name, (first, second), "rad")

    def lock_displacement(self, name: str, expression: ca.SX, unit: str = "rad") -> None:
        """Let the Boolean input `<name>.locked` keep any expression in the coordinates [m or rad] as it is."""
        self._claim(name, unit, "a lock")
        self._lock(name, ca.SX(expression), unit)

    def release(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.released` switch the constraints of a joint off while it is on.

        It can be switched off where the joint is closed again, in a plastic impact. `of` may name a `constraint`.
        """
        found = [c for c in self.closures if c is of or (not isinstance(c, Rigidity | Lock) and c.name == of)]
        if not found:
            names = ", ".join(c.name for c in self.closures if not isinstance(c, Rigidity | Lock)) or "none"
            called = of.name if isinstance(of, AnyJoint) else of
            raise DeclarationError(
                f"{self.name}: {called} is not closed by constraints, so it cannot be released; those are {names}"
            )
        self._claim(f"{found[0].name}.released", "1", "an input")
        self.releases.append(found[0])

    def _lock(self, name: str, of: AnyJoint | tuple[Body, Body] | ca.SX, unit: str) -> None:
        self._claim(f"{name}.locked", "1", "an input")
        self.closures.append(Lock(name, of, unit, ca.SX.sym(f"{name}.locked_at")))

    def _joint(self, of: AnyJoint | str) -> AnyJoint:
        joints = [*self.joints, *self.spatial_joints]
        for joint in joints:
            if of is joint or of == joint.name:
                return joint
        names = ", ".join(joint.name for joint in joints) or "none"
        called = of.name if isinstance(of, AnyJoint) else of
        raise DeclarationError(f"{self.name} has no joint {called}; it has {names}")

    # ------------------------------------------------------------------------------------------------------------

    def _claim(self, name: str, unit_name: str, what: str) -> ca.SX:
        unit(unit_name)
        if not _NAME.match(name):
            raise DeclarationError(f"{self.name}: {name!r} cannot be {what}; use words joined by dots")
        if name.split(".")[0] in _RESERVED and what != "a start value":
            raise DeclarationError(f"{self.name}: {name!r} is a name that alfmu uses itself")
        if name in self._names:
            raise DeclarationError(f"{self.name}: {name!r} is {self._names[name]} already")
        self._names[name] = what
        return ca.SX.sym(name)

    def _coordinate(self, symbol: ca.SX) -> Coordinate:
        found = self._by_symbol.get(key_of(symbol))
        if not isinstance(found, Coordinate):
            raise DeclarationError(f"{self.name}: {symbol} is not a coordinate of this mechanism")
        return found

    def _is_start(self, symbol: Scalar) -> bool:
        return isinstance(self._by_symbol.get(key_of(symbol)), Start)

    def _add(self, body: Body) -> Body:
        self._claim(body.name, "1", "a body")
        self.bodies.append(body)
        self._owned.add(body)
        return body

    def _join(self, joint: Joint) -> Joint:
        self._claim(joint.name, "1", "a joint")
        self._own((joint.first, joint.second), joint.name)
        first, second = joint.first.body, joint.second.body
        if first is second:
            raise DeclarationError(f"{self.name}: joint {joint.name} connects {first.name} to itself")
        if second is self.ground:
            raise DeclarationError(f"{self.name}: joint {joint.name} ends on the ground; name the ground first")
        if joint.coordinate is not None:
            # The joint places whichever body has no place yet, the second one if it can.
            target = second if not second.is_placed else first
            if target.is_placed:
                raise DeclarationError(
                    f"{self.name}: joint {joint.name} has a coordinate, but {first.name} and {second.name} are placed "
                    "already; leave the coordinate out to close the joint by constraints"
                )
            target.placed_by = joint
        else:
            self.closures.append(joint)
        self.joints.append(joint)
        return joint

    def _join_in_space(self, joint: SpatialJoint) -> SpatialJoint:
        self._claim(joint.name, "1", "a joint")
        for marker in (joint.first, joint.second):
            if not isinstance(marker, SpatialMarker):
                raise DeclarationError(
                    f"{self.name}: joint {joint.name} joins bodies in space; take its markers from spatial_body() and "
                    "spatial_ground"
                )
        self._own((joint.first, joint.second), joint.name)
        first, second = joint.first.body, joint.second.body
        if first is second:
            raise DeclarationError(f"{self.name}: joint {joint.name} connects {first.name} to itself")
        if second is self.spatial_ground:
            raise DeclarationError(f"{self.name}: joint {joint.name} ends on the ground; name the ground first")
        self.closures.append(joint)
        self.spatial_joints.append(joint)
        return joint

    def _axes(self, name: str, axis: Sequence[float], second: Sequence[float] | None) -> tuple[tuple[float, ...], ...]:
        axes = tuple(axis), tuple(axis if second is None else second)
        for x in axes:
            if len(x) != 3 or any(isinstance(a, ca.SX) for a in x) or not 0 < math.hypot(*x) < math.inf:
                raise DeclarationError(f"{self.name}: the axis {x} of {name} has no direction; give three numbers")
        return axes

    def _at_defaults(self, value: Scalar) -> float:
        """A number, or an expression in parameters at their defaults."""
        symbols, defaults = stack([x.symbol for x in self.parameters]), stack([x.default for x in self.parameters])
        found = ca.substitute(symbolic(value), symbols, defaults) if self.parameters else symbolic(value)
        if not found.is_constant():
            raise DeclarationError(f"{self.name}: {value} must be a number or an expression in parameters")
        return float(found)

    def _own(self, markers: Iterable[AnyMarker], user: str) -> None:
        for marker in markers:
            if marker.body not in self._owned:
                raise DeclarationError(f"{self.name}: {user} uses {marker.body.name}, a body of another mechanism")

    def _free(self, joint: AnyJoint) -> None:
        if joint.kind not in ("revolute", "prismatic"):
            raise DeclarationError(
                f"{self.name}: {joint.name} is a {joint.kind}, which has no single free motion; "
                "use force() or torque() on its bodies"
            )


def key_of(symbol: Scalar) -> int | None:
    """A key that no other scalar symbol or expression has; None for a number."""
    return symbol.element_hash() if isinstance(symbol, ca.SX) and symbol.is_scalar(True) else None


def _entries(vector: Sequence[Scalar] | ca.SX) -> Sequence[Scalar]:
    return ca.vertsplit(vector) if isinstance(vector, ca.SX) else vector


def symbolic(value: Scalar) -> ca.SX:
    """A number or an expression as an expression; conversion is slow, so it is left out where it does nothing."""
    return value if isinstance(value, ca.SX) else ca.SX(value)


def stack(expressions: Sequence[Scalar]) -> ca.SX:
    """A column of expressions, empty ones included."""
    return ca.vertcat(*map(symbolic, expressions)) if expressions else ca.SX(0, 1)
