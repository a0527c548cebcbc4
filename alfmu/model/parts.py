"""Parts of a declaration as data: quantities, points, bodies, joints, constraints, forces and motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import casadi as ca

from .calls import declares, explained
from .checks import number
from .errors import DeclarationError
from .spatial import SpatialFreedom, SpatialJoint, SpatialMarker, Vector
from .words import Brief

Scalar = float | ca.SX
"""A number or an expression."""

DIRECTIONS: dict[str, tuple[str, ...]] = {
    "revolute": ("x", "y"),
    "prismatic": ("normal", "rotation"),
    "weld": ("x", "y", "rotation"),
    "point_on_line": ("normal",),
    "distance": ("length",),
}
"""The relative displacements that each kind of joint suppresses, in the order of its constraint rows."""

FREEDOMS: dict[str, dict[str, str]] = {
    "revolute": {"angle": "rad"},
    "prismatic": {"position": "m"},
    "weld": {},
    "point_on_line": {"position": "m", "angle": "rad"},
    "distance": {},
}
"""The displacements along which each kind of joint is free, with their units; none for the swing of a rod."""

CONSTANT = ("parameters",)
LAW = (*CONSTANT, "time", "inputs")
PLACE = (*CONSTANT, "coordinates", "time", "inputs")
GUESS = (*CONSTANT, "coordinates", "start values")
MOTION = (*CONSTANT, "coordinates", "rates", "time")
EFFORT = (*CONSTANT, "coordinates", "rates", "inputs", "states", "time")
READING = (*EFFORT, "accelerations")
"""Kinds of symbols on which a value may depend: a mass (CONSTANT), a law (LAW), a place (PLACE), a guess (GUESS), an
energy (MOTION), a force or the rate of a state (EFFORT), an output (READING)."""

MOVING = (LAW, PLACE, MOTION)
"""Kinds of values that make the mechanism depend on time if they contain time or an input, which is then a signal."""

EFFORTS = {"rad": "N.m", "m": "N"}
"""Unit of the effort along a displacement."""

FREE = {
    "revolute": ("angle", "angular_velocity", "angular_acceleration"),
    "prismatic": ("displacement", "velocity", "acceleration"),
}
"""Names of the free motion of a joint and of its rates."""


@dataclass(frozen=True, repr=False)
class Symbol(Brief):
    """Meaning of a symbol of a declaration; `kind` is one of READING or GUESS."""

    kind: str
    text: str
    unit: str


@dataclass(frozen=True, repr=False)
class Parameter(Brief):
    """A constant that a user may change before the start."""

    name: str
    symbol: ca.SX
    default: float
    unit: str
    minimum: float | None
    maximum: float | None
    description: str


@dataclass(frozen=True, repr=False)
class Start(Brief):
    """A quantity whose value and rate the user gives at the start; `tied` is the expression that must equal it."""

    name: str
    symbol: ca.SX
    value: float
    unit: str
    rate_name: str
    rate: float
    description: str


@dataclass(frozen=True, repr=False)
class Coordinate(Brief):
    """A dependent coordinate with its symbols for q, v, a and its guess at the start."""

    name: str
    q: ca.SX
    v: ca.SX
    a: ca.SX
    unit: str
    guess: Scalar
    guessed: bool = True
    """Whether the user gave the guess, in which case the assembly prefers to move other coordinates."""


@dataclass(frozen=True, repr=False)
class State(Brief):
    """A quantity of a first-order equation that is integrated with the motion; its rate may be given later."""

    name: str
    symbol: ca.SX
    unit: str
    start: float
    rate: ca.SX | None
    nominal: float
    description: str


@dataclass(frozen=True, repr=False)
class Output(Brief):
    """An expression that the user declared as an output."""

    name: str
    expression: ca.SX
    unit: str
    description: str


@dataclass(frozen=True, repr=False)
class Watched(Brief):
    """A watched point of a body: outputs of its place and velocity, and a trail in pictures."""

    name: str
    marker: Marker | SpatialMarker
    description: str

    @property
    def axes(self) -> str:
        """The axes along which the point has outputs."""
        return "xy" if isinstance(self.marker, Marker) else "xyz"


@dataclass(frozen=True, repr=False)
class Point(Brief):
    """A point in ground axes given by expressions in the coordinates (natural coordinates)."""

    x: Scalar
    y: Scalar


class Owner(Protocol):
    """The mechanism of a body, which knows the places of all its bodies (`model.kinematics.Kinematics`)."""

    def _kinematics(self) -> Any: ...


@dataclass(frozen=True, eq=False, repr=False)
class Marker(Brief):
    """A point fixed on a body, at (x, y) [m] of the body's frame; `body.at(x, y)` makes it."""

    body: Body
    x: Scalar
    y: Scalar

    @property
    def position(self) -> tuple[ca.SX, ca.SX]:
        """The point (x, y) [m] in ground axes, as expressions in coordinates and parameters.

        Raises DeclarationError if nothing places its body yet.
        """
        return self.body._places().place(self)


@dataclass(eq=False, repr=False)
class Body(Brief):
    """A rigid body in the plane; `Mechanism.body` and `Mechanism.bar` make it.

    `mass` [kg], `inertia` [kg.m2] about the centre of mass, `center` (x, y) [m] of mass in the body's frame, whose
    origin the user chooses; `length` [m] of a bar.
    """

    name: str
    mass: Scalar
    inertia: Scalar
    center: tuple[Scalar, Scalar]
    length: Scalar | None = None
    pose: tuple[Scalar, Scalar, Scalar] | None = None
    between: tuple[Point | Marker, Point | Marker] | None = None
    placed_by: Joint | None = None

    def __post_init__(self) -> None:
        self._mechanism: Owner | None = None
        self.near: ca.SX = ca.SX.sym(f"{self.name}.near")
        """The last known angle, from which whole turns are counted if two points place the body."""

    @property
    def angle(self) -> ca.SX:
        """The angle [rad] of its frame in ground axes, as an expression in coordinates and parameters.

        For a bar between two points, a run counts the turns. Raises DeclarationError if nothing places it yet.
        """
        counted: ca.SX = self._places().frame(self).counted
        return counted

    def _places(self) -> Any:
        """Return the places of all bodies of its mechanism, from the declaration so far."""
        if self._mechanism is None:
            raise DeclarationError(f"{self.name} belongs to no mechanism; make bodies by body() and bar()")
        return self._mechanism._kinematics()

    @explained
    def at(self, x: Scalar = 0.0, y: Scalar = 0.0) -> Marker:
        """Return the point (x, y) [m] of the body's frame."""
        x, y = (number(f"{axis} of {self.name}.at()", value) for axis, value in (("x", x), ("y", y)))
        return Marker(self, x, y)

    @property
    def start(self) -> Marker:
        """The origin of a bar: its first end."""
        return self.at(0.0, 0.0)

    @property
    def end(self) -> Marker:
        """The far end of a bar."""
        if self.length is None:
            raise DeclarationError(f"{self.name} has no length, so no end; use {self.name}.at(x, y), or a bar()")
        return self.at(self.length, 0.0)

    @property
    def is_placed(self) -> bool:
        """Whether something places the body: a pose, two points, or a joint with a coordinate."""
        return self.pose is not None or self.between is not None or self.placed_by is not None


@dataclass(eq=False, repr=False)
class Joint(Brief):
    """A joint in the plane; `Mechanism.revolute` and the methods beside it make it.

    A joint with a `coordinate` places its second body from its first; one without is closed by constraints.
    """

    name: str
    kind: str
    first: Marker
    second: Marker
    coordinate: Scalar | None = None
    axis: Scalar = 0.0
    offset: Scalar = 0.0
    angle: Scalar = 0.0
    length: Scalar = 0.0

    @cached_property
    def near(self) -> ca.SX:
        """Symbol of the last known angle, from which whole turns are counted if two points place one of the bodies."""
        return ca.SX.sym(f"{self.name}.near")

    @property
    def directions(self) -> tuple[str, ...]:
        """The relative displacements that the joint suppresses."""
        return DIRECTIONS[self.kind]

    @property
    def freedoms(self) -> dict[str, str]:
        """Its free displacements, with their units."""
        return FREEDOMS[self.kind]


AnyMarker = Marker | SpatialMarker
AnyJoint = Joint | SpatialJoint | SpatialFreedom


@dataclass(frozen=True, repr=False)
class Rigidity(Brief):
    """The constant distance between two points that define a body in natural coordinates."""

    body: Body

    @property
    def name(self) -> str:
        return f"{self.body.name}.length"


@dataclass(frozen=True, repr=False)
class Constraint(Brief):
    """A constraint written out by the user."""

    name: str
    expression: ca.SX
    unit: str


@dataclass(frozen=True, repr=False)
class Lock(Brief):
    """A displacement that a Boolean input keeps at its present `value` and releases again."""

    direction: ClassVar[str] = "locked"
    name: str
    of: AnyJoint | tuple[Body, Body] | ca.SX
    unit: str
    value: ca.SX


@dataclass(frozen=True, repr=False)
class Motion(Brief):
    """A displacement that follows a law; `value` is the offset that a switched motion adds to it, else None."""

    direction: ClassVar[str] = "motion"
    name: str
    of: AnyJoint | ca.SX
    law: ca.SX
    unit: str
    value: ca.SX | None = None


@dataclass(frozen=True, repr=False)
class Friction(Lock):
    """Dry friction in a joint, in proportion to its reaction or to a constant load: a lock that can break loose.

    `slip` stands for the direction in which it slides (1 or -1), and is 0 while it sticks.
    """

    direction: ClassVar[str] = "friction"
    of: AnyJoint
    slip: ca.SX
    coulomb: Scalar
    static: Scalar
    radius: Scalar | None
    length: Scalar | None
    stribeck: Scalar | None
    collar: Scalar | None
    load: Scalar | None


@dataclass(frozen=True, repr=False)
class Spring(Brief):
    """A linear spring-damper along a displacement: of a joint, or the distance of two markers."""

    between: AnyJoint | tuple[AnyMarker, AnyMarker]
    stiffness: Scalar
    damping: Scalar
    rest: Scalar
    name: str = ""
    friction: bool = False
    """Whether it is the viscous friction of a joint, not a declared spring."""


@dataclass(frozen=True, repr=False)
class Drive(Brief):
    """An effort along a joint's free direction, on the second body from the first."""

    joint: AnyJoint
    effort: Scalar


@dataclass(frozen=True, repr=False)
class Load(Brief):
    """A force in ground axes at a marker, or a torque on a body."""

    at: Marker
    force: tuple[Scalar, Scalar]
    torque: Scalar


@dataclass(frozen=True, repr=False)
class SpatialLoad(Brief):
    """A force and a torque in ground axes at a point of a body in space."""

    at: SpatialMarker
    force: Vector
    torque: Vector


@dataclass(frozen=True, repr=False)
class DrawnJoint(Brief):
    """A joint or point that pictures show for a mechanism at the general level; it does not affect the motion."""

    name: str
    kind: str
    at: tuple[Scalar, ...]
    axis: tuple[Scalar, ...] | None
    outputs: tuple[str, ...]
    """Names of the outputs that give its place, then its axis; empty if it stands still."""


@dataclass(frozen=True, repr=False)
class DrawnBar(Brief):
    """A bar that pictures show through drawn joints."""

    name: str
    joints: tuple[str, ...]


@declares
@dataclass(frozen=True)
class Experiment:
    """Default settings of a run of the mechanism.

    `stop_time` is its end [s], `communication_step` the time between two rows of the result [s], `step_size` the
    default of `solver.step_size` [s], which is also the communication step if that is None. Raises DeclarationError if
    one of them is not above zero.
    """

    stop_time: float = 10.0
    """End of the run [s]."""
    step_size: float = 0.02
    """Default of `solver.step_size` [s]."""
    communication_step: float | None = None
    """Time between two rows of the result [s]; None for the step size of the solver."""
    interval: InitVar[float | None] = None
    """Former name of `communication_step`."""

    def __post_init__(self, interval: float | None) -> None:
        if interval is not None:
            if self.communication_step is not None:
                raise DeclarationError("an experiment takes communication_step or its former name interval, not both")
            object.__setattr__(self, "communication_step", interval)
        for name in ("stop_time", "step_size", "communication_step"):
            value = getattr(self, name)
            optional = value is None and name == "communication_step"
            if not optional and not number(f"{name} of an experiment", value) > 0:
                raise DeclarationError(f"{name} of an experiment is {value} s; it must be above zero")


def key_of(symbol: Scalar) -> int | None:
    """Return a key that no other scalar symbol or expression has; None for a number."""
    return symbol.element_hash() if isinstance(symbol, ca.SX) and symbol.is_scalar(True) else None


def symbolic(value: Scalar) -> ca.SX:
    """Return a number or an expression as an expression; an expression is returned as it is, as conversion is slow."""
    return value if isinstance(value, ca.SX) else ca.SX(value)


def stack(expressions: Sequence[Scalar]) -> ca.SX:
    """Return a column of expressions, empty ones included."""
    return ca.vertcat(*map(symbolic, expressions)) if expressions else ca.SX(0, 1)
