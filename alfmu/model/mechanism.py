"""The declaration of a mechanism: frames, bodies, joints, forces, inputs, outputs, parameters.

A declaration lists *the parts*; `alfmu.derive` turns it into equations. Nothing here is differentiated or stepped.
Every number may be a float or an expression in parameters; poses, forces and outputs may use coordinates too.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import InitVar, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Never, Self, TypeVar, overload

import casadi as ca
import numpy as np

from .calls import declares, explained
from .cams import Cam, Profile, cam
from .checks import (
    JUMPS,
    jump_in,
    may_break,
    number,
    perhaps_an_impact,
    perhaps_degrees,
    perhaps_millimetres,
    symbols_in,
    users_line,
)
from .errors import DeclarationError
from .motion import DERIVATIVES, ORDERS, Input, Law, Signal
from .motion import JUMPS as LEAPS
from .relations import (
    INVOLUTE,
    Belt,
    Blade,
    Gear,
    Rack,
    Relation,
    Rolling,
    SpatialRolling,
    belt,
    blade,
    gear,
    rack,
    rolling,
)
from .spatial import RELATIVE, SpatialBody, SpatialFreedom, SpatialJoint, SpatialMarker, Vector, right_handed
from .stops import CREEP, ONSET, EndStop
from .units import UNITS, alike, is_rate, rate_of, unit
from .words import LONGEST, Brief, counted, in_words, no_attribute, quantity, shown, text, there_is

if TYPE_CHECKING:
    from ..equations.derivation import Kinematics
    from ..view.picture import Drawing

__all__ = ["Body", "Joint", "Marker", "Mechanism", "Point", "Scalar"]

Scalar = float | ca.SX
"""A number or an expression."""

_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*\Z", re.ASCII)
_RESERVED = {"start", "solver", "monitor", "multiplier", "ground", "time"}

DIRECTIONS: dict[str, tuple[str, ...]] = {
    "revolute": ("x", "y"),
    "prismatic": ("normal", "rotation"),
    "weld": ("x", "y", "rotation"),
    "point_on_line": ("normal",),
    "distance": ("length",),
}
"""The relative displacements that each kind of joint suppresses, in the order of its constraint rows."""

DRAWN = ("", "revolute", "cylindrical", "prismatic", "spherical")
"""Kinds of joints that pictures show of what is declared at the general level; the first is none."""

QUICK = 100
"""Coordinates up to which a notebook draws a mechanism that it shows: a second, or less."""

CONSTANT = ("parameters",)
LAW = (*CONSTANT, "time", "inputs")
PLACE = (*CONSTANT, "coordinates", "time", "inputs")
GUESS = (*CONSTANT, "coordinates", "start values")
MOTION = (*CONSTANT, "coordinates", "rates", "time")
EFFORT = (*CONSTANT, "coordinates", "rates", "inputs", "states", "time")
READING = (*EFFORT, "accelerations")
"""What a number of a declaration may depend on: a mass, a motion, a place, a guess, an energy, a force or the
rate of a state, an output."""

MOVING = (LAW, PLACE, MOTION)
"""What makes the mechanism depend on time where it depends on time or on an input, which is a signal there."""

EFFORTS = {"rad": "N.m", "m": "N"}
"""Unit of the effort along a displacement."""


@dataclass(frozen=True, repr=False)
class Symbol(Brief):
    """What a symbol of a declaration stands for; `kind` is one of READING or GUESS."""

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
    """An expression that a user asked for by name."""

    name: str
    expression: ca.SX
    unit: str
    description: str


@dataclass(frozen=True, repr=False)
class Watched(Brief):
    """A point of a body that is watched: outputs of its place and velocity, and a trail in pictures."""

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


@dataclass(frozen=True, eq=False, repr=False)
class Marker(Brief):
    """A point fixed on a body, at (x, y) [m] of the body's frame; `body.at(x, y)` makes it."""

    body: Body
    x: Scalar
    y: Scalar

    @property
    def position(self) -> tuple[ca.SX, ca.SX]:
        """The point (x, y) [m] in ground axes, as expressions in coordinates and parameters.

        Raises DeclarationError where nothing places its body yet.
        """
        return self.body._places().place(self)


@dataclass(eq=False, repr=False)
class Body(Brief):
    """A rigid body in the plane; `Mechanism.body` and `Mechanism.bar` make it.

    `mass` [kg], `inertia` [kg.m2] about the centre of mass, `center` (x, y) [m] of mass in the body's frame, whose
    origin is wherever the user measures from; `length` [m] of a bar.
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
        self._mechanism: Mechanism | None = None
        self.near: ca.SX = ca.SX.sym(f"{self.name}.near")
        """Where its angle was last, which tells its turns where two points place it."""

    @property
    def angle(self) -> ca.SX:
        """The angle [rad] of its frame in ground axes, as an expression in coordinates and parameters.

        Of a bar between two points a run counts the turns. Raises DeclarationError where nothing places it yet.
        """
        return self._places().frame(self).counted

    def _places(self) -> Kinematics:
        """Where all bodies of its mechanism are, as it is declared by now."""
        from ..equations.derivation import Kinematics

        if self._mechanism is None:
            raise DeclarationError(f"{self.name} belongs to no mechanism; make bodies by body() and bar()")
        return Kinematics(self._mechanism)

    @explained
    def at(self, x: Scalar = 0.0, y: Scalar = 0.0) -> Marker:
        """The point (x, y) [m] of the body's frame."""
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
        """Whether something says where the body is: a pose, two points, a joint with a coordinate."""
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

    @property
    def directions(self) -> tuple[str, ...]:
        """The relative displacements that the joint suppresses."""
        return DIRECTIONS[self.kind]


_DRY_FRICTION: dict[tuple[str, bool], tuple[tuple[str, ...], str]] = {
    ("revolute", False): (("radius",), "a revolute joint is a journal; give its radius [m], and no length or collar"),
    ("prismatic", False): (
        ("length",),
        "a prismatic joint has no radius or collar; give the length [m] between its edges, or nothing",
    ),
    ("revolute", True): (
        ("radius", "length", "collar"),
        "a revolute joint is a journal; give its radius [m], and perhaps the length [m] between its bearings and the "
        "radius [m] of its collar",
    ),
    ("prismatic", True): (
        ("radius", "length"),
        "a prismatic joint has no collar; give the length [m] between its edges, the radius [m] of its key, or nothing",
    ),
    ("screw", True): (("radius",), "a screw takes the radius [m] of its thread, and no length or collar"),
}
"""What dry friction of each kind of joint, in the plane or in space, can be told, and what is said of anything else."""

AnyMarker = Marker | SpatialMarker
AnyJoint = Joint | SpatialJoint | SpatialFreedom


@dataclass(frozen=True, repr=False)
class Rigidity(Brief):
    """The constant distance between the two points that carry a body in natural coordinates."""

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
    """A displacement that a Boolean input stops where it is and lets go again; `value` is where it was stopped."""

    direction: ClassVar[str] = "locked"
    name: str
    of: AnyJoint | tuple[Body, Body] | ca.SX
    unit: str
    value: ca.SX


@dataclass(frozen=True, repr=False)
class Motion(Brief):
    """A displacement that follows a law; `value` is what a motion that is switched keeps beside it, else None."""

    direction: ClassVar[str] = "motion"
    name: str
    of: AnyJoint | ca.SX
    law: ca.SX
    unit: str
    value: ca.SX | None = None


@dataclass(frozen=True, repr=False)
class Friction(Lock):
    """Dry friction in a joint, in proportion to its own reaction: a lock that the load lets go.

    `slip` stands for the direction in which it slides (1 or -1), and is 0 while it sticks.
    """

    direction: ClassVar[str] = "friction"
    slip: ca.SX
    coulomb: Scalar
    static: Scalar
    radius: Scalar | None
    length: Scalar | None
    stribeck: Scalar | None
    collar: Scalar | None


@dataclass(frozen=True, repr=False)
class Spring(Brief):
    """A linear spring-damper along a displacement: of a joint, or the distance of two markers."""

    between: AnyJoint | tuple[AnyMarker, AnyMarker]
    stiffness: Scalar
    damping: Scalar
    rest: Scalar
    name: str = ""
    friction: bool = False
    """Whether it is the viscous friction of a joint, which nobody declared as a spring."""


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
    """A joint or point that pictures show of what is declared at the general level; it moves nothing."""

    name: str
    kind: str
    at: tuple[Scalar, ...]
    axis: tuple[Scalar, ...] | None
    outputs: tuple[str, ...]
    """Names of the outputs that tell its place, then its axis; none where it stands still."""


@dataclass(frozen=True, repr=False)
class DrawnBar(Brief):
    """A bar that pictures show through drawn joints."""

    name: str
    joints: tuple[str, ...]


@declares
@dataclass(frozen=True)
class Experiment:
    """What a run of the mechanism looks like when nobody says otherwise.

    `stop_time` is its end [s], `communication_step` the time between two rows of the result [s], `step_size` the
    default of `solver.step_size` [s], which stands for the communication step where that is None. Raises
    DeclarationError where one of them is not above zero.
    """

    stop_time: float = 10.0
    """[s]"""
    step_size: float = 0.02
    """Default of `solver.step_size` [s]."""
    communication_step: float | None = None
    """[s]; None for the step size of the solver."""
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


MEANT = {
    **dict.fromkeys(("damper", "damping", "spring", "stiffness", "torsion_spring"), "spring_damper"),
    **dict.fromkeys(("hinge", "pin", "pin_joint", "pivot", "rotational"), "revolute"),
    **dict.fromkeys(("slider", "slide", "guide", "translational", "linear"), "prismatic"),
    **dict.fromkeys(("rod", "beam", "link", "segment"), "bar"),
    **dict.fromkeys(("ball", "ball_joint"), "spherical"),
    **dict.fromkeys(("motor", "actuator", "actuate"), "drive"),
    **dict.fromkeys(("fix", "fixed", "rigid", "attach"), "weld"),
    **dict.fromkeys(("slot", "pin_in_slot"), "point_on_line"),
    **dict.fromkeys(("contact", "limit", "stop", "bumper"), "end_stop"),
    **dict.fromkeys(("mass", "rigid_body", "plate"), "body"),
    **dict.fromkeys(("rope", "cable", "tie_rod"), "distance"),
    **dict.fromkeys(("sensor", "probe"), "measure"),
}
"""Names that other programs have for what a mechanism is made of, and the method of each."""

BOOKKEEPING = (
    *("closures", "compliant", "declared_at", "drawn_bars", "drawn_joints", "drives", "end_stops", "generalized"),
    *("gravity_vector", "kinetic", "laws", "loads", "measured", "measured_joints", "measured_springs", "measures_all"),
    *("moves", "potential", "relations", "releases", "signals", "spatial_loads", "springs", "starts", "ties", "trace"),
    *("instants", "watched"),
)
"""Public names that no user needs: they are not listed, and become private."""

_Part = TypeVar("_Part")
_Form = TypeVar("_Form", str, bytes)
_Related = TypeVar("_Related", bound=Relation)


class _Parts(Generic[_Part]):
    """Parts of a mechanism in the order of their declaration: a tuple for readers; its methods alone add to it."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, mechanism: None, owner: type) -> Self: ...
    @overload
    def __get__(self, mechanism: Mechanism, owner: type) -> tuple[_Part, ...]: ...
    def __get__(self, mechanism: Mechanism | None, owner: type) -> Self | tuple[_Part, ...]:
        if mechanism is None:
            return self
        if self._name in BOOKKEEPING and not sys._getframe(1).f_globals.get("__name__", "").startswith("alfmu."):
            warnings.warn(f"Mechanism.{self._name} becomes private in the next version", DeprecationWarning, 2)
        return tuple(self.of(mechanism))

    def __set__(self, mechanism: Mechanism, value: Never) -> None:
        raise DeclarationError(
            f"{mechanism.name}: its {self._name.replace('_', ' ')} cannot be set; declare them one by one, by methods "
            "such as bar() and revolute()"
        )

    def of(self, mechanism: Mechanism) -> list[_Part]:
        """The list itself."""
        return mechanism._parts.setdefault(self._name, [])


@declares
@dataclass(eq=False, repr=False)
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

    `ground` is the frame of the ground in the plane, x to the right, y upwards and angles [rad] counter-clockwise;
    `spatial_ground` is that in space; `time` is the symbol of time [s]. Numbers are in SI units: floats, or expressions
    of CasADi in what the methods return.

    What is declared can be read: `parameters`, `coordinates`, `inputs`, `states`, `outputs`, `bodies`, `joints`,
    `spatial_bodies` and `spatial_joints` are tuples in the order of declaration, `options` are those it was made with.

    `sketch` is shown wherever the mechanism is explained; the README beside a mechanism's file is its documentation.
    Its `author` is named in the FMU. Methods raise DeclarationError, with the mechanism and the name, where what they
    are given makes no sense.
    """

    name: str
    description: str = ""
    sketch: str = ""
    experiment: Experiment = field(default_factory=Experiment)
    author: str = ""
    parameters: ClassVar[_Parts[Parameter]] = _Parts()
    """Constants that a user may change."""
    starts: ClassVar[_Parts[Start]] = _Parts()
    """Quantities given at the start."""
    ties: ClassVar[_Parts[tuple[ca.SX, ca.SX]]] = _Parts()
    """Start quantities and the expressions that must equal them."""
    coordinates: ClassVar[_Parts[Coordinate]] = _Parts()
    """The dependent coordinates q, in their order."""
    inputs: ClassVar[_Parts[Input]] = _Parts()
    """What the environment sets."""
    states: ClassVar[_Parts[State]] = _Parts()
    """First-order equations beside the motion."""
    outputs: ClassVar[_Parts[Output]] = _Parts()
    """Results of the user's own."""
    bodies: ClassVar[_Parts[Body]] = _Parts()
    """Bodies in the plane, without the ground."""
    joints: ClassVar[_Parts[Joint]] = _Parts()
    """Joints in the plane."""
    spatial_bodies: ClassVar[_Parts[SpatialBody]] = _Parts()
    """Bodies in space, without the ground."""
    spatial_joints: ClassVar[_Parts[SpatialJoint]] = _Parts()
    """Joints in space."""
    closures: ClassVar[_Parts[AnyJoint | Rigidity | Constraint | Lock | Motion | Relation]] = _Parts()
    """What is closed by constraints, in the order of its rows."""
    signals: ClassVar[_Parts[Signal]] = _Parts()
    """Inputs that move something."""
    instants: ClassVar[_Parts[Scalar]] = _Parts()
    """Times at which steps end."""
    laws: ClassVar[_Parts[Law]] = _Parts()
    """What moves something in time and may jump, or not be finite."""
    releases: ClassVar[_Parts[AnyJoint | Constraint | Relation]] = _Parts()
    """What a Boolean input can open."""
    springs: ClassVar[_Parts[Spring]] = _Parts()
    """Springs and dampers."""
    drives: ClassVar[_Parts[Drive]] = _Parts()
    """Efforts along joints."""
    end_stops: ClassVar[_Parts[EndStop]] = _Parts()
    """Limit stops."""
    loads: ClassVar[_Parts[Load]] = _Parts()
    """Forces and torques from the ground."""
    spatial_loads: ClassVar[_Parts[SpatialLoad]] = _Parts()
    """The same on bodies in space."""
    kinetic: ClassVar[_Parts[ca.SX]] = _Parts()
    """Kinetic energies at the general level."""
    potential: ClassVar[_Parts[ca.SX]] = _Parts()
    """Potential energies at the general level."""
    generalized: ClassVar[_Parts[tuple[ca.SX, Scalar]]] = _Parts()
    """Coordinates and generalised forces along them."""
    watched: ClassVar[_Parts[Watched]] = _Parts()
    """Points of bodies that are watched."""
    measured: ClassVar[_Parts[AnyJoint | Spring]] = _Parts()
    """Joints and springs that are measured, beside springs with names."""
    drawn_joints: ClassVar[_Parts[DrawnJoint]] = _Parts()
    """Joints that pictures show of a mechanism whose bodies are energies alone."""
    drawn_bars: ClassVar[_Parts[DrawnBar]] = _Parts()
    """Bars between them."""
    gravity_vector: Vector = field(default=(0.0, 0.0, 0.0), init=False)
    documentation: str = field(default="", init=False)
    options: dict[str, Any] = field(default_factory=dict, init=False)
    compliant: bool = field(default=False, init=False)
    measures_all: bool = field(default=False, init=False)
    moves: bool = field(default=False, init=False)
    """Whether a place, a constraint or an energy depends on time or on an input."""

    def __repr__(self) -> str:
        sizes = {"coordinate": len(self.coordinates), "state": len(self.states), "input": len(self.inputs)}
        sizes["body"] = len(self.bodies) + len(self.spatial_bodies)
        sizes["joint"] = len(self.joints) + len(self.spatial_joints)
        said = [counted(size, of) for of, size in sizes.items() if size]
        return f"Mechanism({', '.join([repr(self.name), *said])})"

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name not in BOOKKEEPING]

    if not TYPE_CHECKING:  # a checker knows what there is

        def __getattr__(self, name: str) -> Any:
            raise AttributeError(no_attribute(self, name, MEANT.get(name)))

    def __setattr__(self, name: str, value: Any) -> None:
        if inspect.isfunction(getattr(Mechanism, name, None)) and not name.startswith("_"):
            raise DeclarationError(f"{self.name}: {name} is a method; call it, as m.{name}(...), and do not set it")
        super().__setattr__(name, value)

    def __post_init__(self) -> None:
        self._parts: dict[str, list[Any]] = {}
        if not re.fullmatch(r"[A-Za-z_]\w*", text("the name of a mechanism", self.name, LONGEST), re.ASCII):
            raise DeclarationError(f"{self.name!r} cannot name a mechanism; use letters, digits and underscores")
        for each in ("description", "sketch", "author"):
            text(f"{self.name}: its {each}", getattr(self, each))
        if not isinstance(self.experiment, Experiment):
            raise DeclarationError(f"{self.name}: its experiment is {shown(self.experiment)}; give an Experiment")
        self.ground: Body = Body("ground", 0.0, 0.0, (0.0, 0.0), pose=(0.0, 0.0, 0.0))
        origin, upright = ca.SX.zeros(3), ca.SX([1, 0, 0, 0])
        self.spatial_ground: SpatialBody = SpatialBody("ground", 0.0, (0.0,) * 3, (0.0,) * 3, (origin, upright))
        self.ground._mechanism = self
        self.time: ca.SX = ca.SX.sym("time")
        self._names: dict[str, str] = {}
        self._lines: dict[str, tuple[str, int]] = {}
        self._by_symbol: dict[int | None, Start | Coordinate | Input] = {}
        self._symbols: dict[int | None, Symbol] = {key_of(self.time): Symbol("time", "time", "s")}
        self._owned: set[Body | SpatialBody] = {self.ground, self.spatial_ground}
        self._changes: list[tuple[Any, str, Any]] = []
        self._choices: dict[str, list[str]] = {}
        self._weighs = False
        self._points: set[Body] = set()
        self._told: set[float] = set()

    def _as_it_was(self) -> Callable[[], None]:
        """What makes the mechanism again what it is now, for a declaration that is refused halfway."""
        own = {name: copy(each) if isinstance(each, dict | set) else each for name, each in vars(self).items()}
        own["_parts"] = {name: [*each] for name, each in self._parts.items()}
        changes, count = self._changes, len(self._changes)

        def restore() -> None:
            while len(changes) > count:
                part, name, value = changes.pop()
                object.__setattr__(part, name, value)
            vars(self).clear()
            vars(self).update(own)

        return restore

    def _change(self, part: Any, name: str, value: Any) -> None:
        """Change a part that is declared, or a marker, so that `_as_it_was` can take it back."""
        self._changes.append((part, name, getattr(part, name)))
        object.__setattr__(part, name, value)

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
        """A constant that a user may change before the start; returns its symbol.

        `default`, `minimum` and `maximum` (inclusive) are floats in `unit`, one of `alfmu.model.units.UNITS`.
        """
        symbol = self._claim(name, unit, "a parameter")
        default = self._plain(f"the default of {name}", default)
        low, high = (
            bound if bound is None else self._plain(f"the {which} of {name}", bound)
            for which, bound in (("minimum", minimum), ("maximum", maximum))
        )
        if low is not None and high is not None and low > high:
            raise DeclarationError(f"{self.name}: the minimum {low:g} of {name} is above its maximum {high:g}")
        if (low is not None and default < low) or (high is not None and default > high):
            raise DeclarationError(f"{self.name}: the default {default} of {name} is outside [{low}, {high}]")
        if unit == "m":
            self._perhaps_millimetres(f"the default of {name}", default)
        elif unit == "rad":
            perhaps_degrees(f"{self.name}: the default of {name}", default)
        text(f"{self.name}: the description of {name}", description)
        Mechanism.parameters.of(self).append(Parameter(name, symbol, default, unit, low, high, description))
        return self._stands_for(symbol, "parameters", f"the parameter {name}", unit)

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
        self._displacement(name, unit)
        rate_name = rate_name or f"{name}_rate"
        symbol = self._claim(f"start.{name}", unit, "a start value")
        self._claim(f"start.{rate_name}", rate_of(unit), "a start value")
        value, rate = self._plain(f"start.{name}", value), self._plain(f"start.{rate_name}", rate)
        if unit == "rad":
            perhaps_degrees(f"{self.name}: start.{name}", value)
        text(f"{self.name}: the description of {name}", description)
        Mechanism.starts.of(self).append(Start(name, symbol, value, unit, rate_name, rate, description))
        self._by_symbol[key_of(symbol)] = self.starts[-1]
        return self._stands_for(symbol, "start values", f"the start value start.{name}", unit)

    def tie(self, start: ca.SX, expression: ca.SX) -> None:
        """Require `expression` (of the coordinates) to equal a start quantity when the run begins."""
        if not self._is_start(start):
            raise DeclarationError(f"{self.name}: tie() takes a symbol that start() returned, not {shown(start)}")
        quantity = self._by_symbol[key_of(start)]
        what = f"what start.{quantity.name} is tied to"
        Mechanism.ties.of(self).append((start, symbolic(self._quantity(what, expression, quantity.unit, PLACE))))

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
        """A dependent coordinate (entry of q) in `unit`: rad, m or 1; returns its symbol.

        `start` is the guess from which the assembly is solved: a number, or an expression in parameters, start
        quantities and coordinates declared before; its time derivative is the guess of the velocity. A coordinate with
        `independent=True`, or whose `start` is a start quantity, keeps the value the user gives.
        """
        self._displacement(name, unit)
        symbol = self._claim(name, unit, "a coordinate")
        start = self._quantity(f"the start of {name}", start, unit, GUESS)
        if independent:
            if isinstance(start, ca.SX) and not start.is_constant():
                raise DeclarationError(
                    f"{self.name}: the start of the independent coordinate {name} is a number; give one, or tie() the "
                    "coordinate to a start() quantity"
                )
            start = self.start(name, float(start), unit, rate=rate, description=description)
        elif self._plain(f"the rate of {name}", rate):
            raise DeclarationError(
                f"{self.name}: only an independent coordinate has a start rate; {name} is not, so add independent=True"
            )
        elif unit == "rad" and not isinstance(start, ca.SX):
            perhaps_degrees(f"{self.name}: the guess of {name}", start)
        c = Coordinate(name, symbol, ca.SX.sym(f"{name}_v"), ca.SX.sym(f"{name}_a"), unit, start)
        Mechanism.coordinates.of(self).append(c)
        self._by_symbol[key_of(symbol)] = c
        self._stands_for(symbol, "coordinates", f"the coordinate {name}", unit)
        self._stands_for(c.v, "rates", f"the rate of {name}", rate_of(unit))
        self._stands_for(c.a, "accelerations", f"the acceleration of {name}", rate_of(rate_of(unit)))
        if isinstance(start, ca.SX) and self._is_start(start):
            self.tie(start, symbol)
        return symbol

    def rate(self, coordinate: ca.SX) -> ca.SX:
        """The velocity of a coordinate, or the rate of an expression in coordinates declared before: for kinetic
        energies, forces and outputs."""
        if isinstance(coordinate, ca.SX) and coordinate.is_scalar() and not coordinate.is_symbolic():
            x = symbolic(self._quantity("what rate() is asked of", coordinate, "1", PLACE))
            moving = stack([self.time, *(c.q for c in self.coordinates)])
            return ca.jtimes(x, moving, stack([1.0, *(c.v for c in self.coordinates)]))
        return self._coordinate(coordinate).v

    def acceleration(self, coordinate: ca.SX) -> ca.SX:
        """The acceleration symbol of a coordinate, for outputs."""
        return self._coordinate(coordinate).a

    def input(
        self,
        name: str,
        unit: str,
        *,
        start: float = 0.0,
        description: str = "",
        derivatives: int = 0,
        order: int = 2,
        jump: float | None = None,
    ) -> ca.SX:
        """A quantity in `unit` that is set from outside at any time and is `start` until then; returns its symbol.

        An input can also move something: a `motion`, a place, a guide, a constraint. It is a *signal* there, which
        inside a communication step runs without a jump from where it is to where it will be, as far as is known.
        `derivatives` 1 or 2 declares the inputs `<name>_rate` and `<name>_acceleration`, which tell more of that; the
        highest one given goes on by a polynomial of `order` (0, 1 or 2) through its values at past communication
        points. A value that differs from where the signal is by more than `jump` is refused: 0.1 rad or 0.01 m where
        nothing else is given.
        """
        symbol = self._claim(name, unit, "an input")
        text(f"{self.name}: the description of {name}", description)
        start = self._plain(f"the start of {name}", start)
        for what, given, known in (("derivatives", derivatives, (0, 1, 2)), ("order", order, ORDERS)):
            if type(given) is not int or given not in known:
                raise DeclarationError(f"{self.name}: the {what} of {name} is {shown(given)}; give 0, 1 or 2")
        limit = LEAPS.get(unit, LEAPS["m"]) if jump is None else self._plain(f"the jump of {name}", jump)
        if not limit > 0:
            raise DeclarationError(f"{self.name}: the jump of {name} is {limit:g} {unit}; it must be above zero")
        if derivatives:
            self._displacement(name, unit)
        own = Input(name, symbol, unit, start, description, derivatives, order, limit)
        Mechanism.inputs.of(self).append(own)
        self._by_symbol[key_of(symbol)] = own
        companion, its = name, unit
        for what in DERIVATIVES[:derivatives]:
            companion, its = f"{name}_{what}", rate_of(its)
            rate = self._claim(companion, its, "an input")
            Mechanism.inputs.of(self).append(Input(companion, rate, its, 0.0, f"{what} of {name}"))
            self._stands_for(rate, "inputs", f"the input {companion}", its)
        return self._stands_for(symbol, "inputs", f"the input {name}", unit)

    def state(
        self,
        name: str,
        unit: str,
        rate: Scalar | None = None,
        *,
        start: float = 0.0,
        nominal: float = 1.0,
        description: str = "",
    ) -> ca.SX:
        """A quantity of a first-order equation that is integrated with the motion: a current, an integral of a
        controller, a filtered signal, the filling of a vessel. Returns its symbol, for forces, rates and outputs.

        `rate` is its time derivative [unit/s]: an expression in parameters, coordinates, rates, inputs, states and
        time. Where it takes the state itself, or one that is declared later, `derivative` gives it instead. `start` is
        its value [unit] at the start, which the parameter `start.<name>` changes. `nominal` [unit] is what a large
        value of it is: an error below `solver.absolute_tolerance` of it does not count. The output `<name>` shows it.
        Raises DeclarationError where the name is taken, or a number or the unit makes no sense.
        """
        symbol = self._claim(name, unit, "a state")
        self._claim(f"start.{name}", unit, "a start value")
        start, nominal = self._plain(f"start.{name}", start), self._plain(f"the nominal value of {name}", nominal)
        if not nominal > 0:
            raise DeclarationError(
                f"{self.name}: the nominal value of {name} is {nominal:g} {unit}; give what a large value of it is, "
                "above zero"
            )
        text(f"{self.name}: the description of {name}", description)
        Mechanism.states.of(self).append(State(name, symbol, unit, start, None, nominal, description))
        self._stands_for(symbol, "states", f"the state {name}", unit)
        if rate is not None:
            self.derivative(symbol, rate)
        return symbol

    def derivative(self, state: ca.SX, rate: Scalar) -> None:
        """Give a state its rate, where it was declared without one: an expression as `state` takes it::

            i = m.state("motor.current", "A")
            m.derivative(i, (voltage - resistance * i - constant * m.rate(angle)) / inductance)

        Raises DeclarationError where the symbol is no state of this mechanism, or has a rate already.
        """
        place = next((k for k, x in enumerate(self.states) if key_of(x.symbol) == key_of(state)), None)
        if place is None:
            given = state if isinstance(state, ca.SX) else shown(state)
            raise DeclarationError(
                f"{self.name}: {given} is not a state of this mechanism; give the symbol that state() returned"
            )
        found = self.states[place]
        if found.rate is not None:
            raise DeclarationError(
                f"{self.name}: the state {found.name} has a rate already{self.declared_at(found.name)}; give one, in "
                "state() or in derivative()"
            )
        what = f"the rate of {found.name}"
        expression = symbolic(self._quantity(what, rate, "1", EFFORT))
        own = self._symbols[key_of(expression)].unit if expression.is_symbolic() else "1"
        if own != "1" and not is_rate(own, found.unit):
            raise DeclarationError(
                f"{self.name}: {what} is in {found.unit} per second, and "
                f"{self._symbols[key_of(expression)].text} in {own}; give one in {found.unit} per second"
            )
        Mechanism.states.of(self)[place] = replace(found, rate=expression)

    def output(self, name: str, expression: Scalar, unit: str = "1", description: str = "") -> None:
        """A result in `unit` of the user's own: an expression in coordinates, rates, accelerations, inputs, states,
        time."""
        self._claim(name, unit, "an output")
        text(f"{self.name}: the description of {name}", description)
        expression = symbolic(self._quantity(f"output {name}", expression, unit, READING))
        Mechanism.outputs.of(self).append(Output(name, expression, unit, description))

    def watch(self, name: str, marker: AnyMarker, description: str = "") -> None:
        """Watch a point of a body: outputs `<name>.x`, `.y` [m] and `.vx`, `.vy` [m/s] in ground axes, in space also
        `.z` and `.vz`. Pictures show the point, and films its trail, the path that it has made.

        Raises DeclarationError where the name is taken or the marker is not on a body of this mechanism.
        """
        self._claim(name, "m", "a watched point")
        text(f"{self.name}: the description of {name}", description)
        self._own((marker,), f"watched point {name}")
        Mechanism.watched.of(self).append(Watched(name, marker, description))

    def trace(self, name: str, marker: AnyMarker, description: str = "") -> None:
        """Former name of `watch`."""
        self.watch(name, marker, description)

    def measure(self, *of: AnyJoint | Spring | str) -> None:
        """Outputs of joints and springs, or their names; of all that there are where none is given.

        A hinge `A` has `A.angle` [rad], `A.angular_velocity` and `A.angular_acceleration`, a slider `guide` has
        `guide.displacement` [m], `guide.velocity` and `guide.acceleration`: of the second body from the first. A spring
        `S` has `S.elongation`, `S.elongation_rate` and `S.force` [N], positive in tension, or `S.torque` [N.m]. One
        without a name is called after its joint (`A.spring`), between points by its number (`spring1`). Viscous
        friction is no spring: declare a damper in its place to measure it.

        Raises DeclarationError where something is neither a spring nor a joint with one free motion.
        """
        if not of:
            self.measures_all = True
        springs = dict(self._springs())
        for each in of:
            spring = each if isinstance(each, Spring) else springs.get(each) if isinstance(each, str) else None
            if spring is not None:
                if not any(spring is known for known in self.springs):
                    raise DeclarationError(f"{self.name}: measure() is given a spring of another mechanism")
                Mechanism.measured.of(self).append(spring)
                continue
            names = [*springs, *(j.name for j in self.joints), *(j.name for j in self.spatial_joints)]
            if not isinstance(each, AnyJoint) and each not in names:
                if not isinstance(each, str):
                    raise DeclarationError(
                        f"{self.name}: measure() takes joints, springs or their names, not {shown(each)}"
                    )
                raise DeclarationError(f"{self.name} has no joint or spring {each} to measure; {there_is(each, names)}")
            joint = self._joint(each)
            self._free(joint, "measure()")
            Mechanism.measured.of(self).append(joint)

    def measured_joints(self) -> list[AnyJoint]:
        """Joints whose motion is an output on request, once each; hinges in space have theirs anyway."""
        joints: list[AnyJoint] = [*self.joints, *self.spatial_joints]
        return [
            joint
            for joint in joints
            if joint.kind in ("revolute", "prismatic")
            and (self.measures_all or any(joint is each for each in self.measured))
            and not (isinstance(joint, SpatialJoint) and joint.kind == "revolute")
        ]

    def measured_springs(self) -> list[tuple[str, Spring]]:
        """Springs that are measured, with the names of their outputs."""
        asked = [id(each) for each in self.measured]
        return [(name, s) for name, s in self._springs() if s.name or self.measures_all or id(s) in asked]

    def _springs(self) -> list[tuple[str, Spring]]:
        """All springs but frictions, by their own names or by those that `measure` gives them."""
        named: dict[str, Spring] = {}
        for i, spring in enumerate((s for s in self.springs if not s.friction), 1):
            joint = spring.between if isinstance(spring.between, AnyJoint) else None
            name = spring.name or (f"{joint.name}.spring" if joint else f"spring{i}")
            named[f"{name}{i}" if name in named else name] = spring
        return list(named.items())

    # Bodies -----------------------------------------------------------------------------------------------------

    def body(
        self,
        name: str,
        *,
        mass: Scalar,
        inertia: Scalar | None = None,
        center: tuple[Scalar, Scalar] = (0.0, 0.0),
        pose: tuple[Scalar, Scalar, Scalar] | None = None,
    ) -> Body:
        """A rigid body: mass [kg], inertia about its centre of mass [kg.m2], centre of mass in its frame [m].

        Without an inertia it is a point mass; where it turns, a warning asks whether the inertia was forgotten, which
        `inertia=0.0` answers.

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
        """A thin uniform bar, mass [kg] and length [m], along the x axis of its frame from `start` to `end`.

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
            Mechanism.closures.of(self).append(Rigidity(body))
        return body

    def point(self, x: Scalar, y: Scalar) -> Point:
        """A point in ground axes [m], usually a pair of coordinates."""
        return Point(*(self._moving("a point", each, "m") for each in (x, y)))

    def gravity(self, x: Scalar, y: Scalar, z: Scalar = 0.0) -> None:
        """The acceleration of gravity [m/s2] in ground axes; (0, 0) says that there is none."""
        self._weighs = True
        self.gravity_vector = self._vector("gravity", (x, y, z), ("m/s2",) * 3, CONSTANT)

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
        """A rigid body in space: mass [kg], inertia about its centre of mass [kg.m2], the centre of mass in its frame
        [m].

        `inertia` is three principal moments along the axes of the frame, or the matrix (3, 3) of inertia in these axes:
        moments on its diagonal, products of inertia with a minus sign beside it.

        The body has seven coordinates, `<name>_x` ... `<name>_e3`: the place of the centre of mass and the Euler
        parameters of the frame, kept at unit length by a constraint. `position` and `attitude` are their guesses at the
        start, as `start` of `coordinate` is; `spatial.about` and `spatial.product` make Euler parameters from turns.
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
                f"{self.name}: {name} is relative and has a position or an attitude; give the coordinate of the joint "
                "that places it a start"
            )
        self._claim(name, "1", "a body")
        own = None
        if not relative:
            r = [self.coordinate(f"{name}_{axis}", "m", start=x) for axis, x in zip("xyz", position, strict=True)]
            own = stack(r), stack([self.coordinate(f"{name}_e{i}", "1", start=x) for i, x in enumerate(attitude)])
        body = SpatialBody(name, mass, moments, center, own, products)
        Mechanism.spatial_bodies.of(self).append(body)
        self._owned.add(body)
        if own is not None:
            self.constraint(body.unit_length, (ca.sumsqr(own[1]) - 1) / 2, "1")
        return body

    # Joints -----------------------------------------------------------------------------------------------------

    def revolute(self, name: str, first: Marker, second: Marker, *, coordinate: Scalar | None = None) -> Joint:
        """A hinge: the two markers coincide. Returns the joint, for `drive`, `spring_damper`, `friction` and `lock`.

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
        """A slider in a guide: the second marker on a line through the first, the second body at a constant angle.

        The guide has the direction `axis` [rad] in the first body's frame and lies `offset` [m] to its left; the second
        body's frame stands at `angle` [rad] from the first's. `coordinate` is the place [m] of the second marker along
        the guide from the first. Outputs `<name>.force` [N], across the guide, and `<name>.moment` [N.m] are the
        reaction on the second body from the first.
        """
        return self._join(Joint(name, "prismatic", first, second, coordinate, axis, offset, angle))

    def weld(self, name: str, first: Marker, second: Marker, *, angle: Scalar = 0.0) -> Joint:
        """A rigid connection: markers coincide, the second body at `angle` [rad] from the first.

        Where nothing else places one of the bodies, the weld does; otherwise it is closed by constraints.
        """
        joint = Joint(name, "weld", first, second, angle=angle)
        self._own((first, second), f"joint {name}", Marker)
        if not (first.body.is_placed and second.body.is_placed):
            joint.coordinate = 0.0
        return self._join(joint)

    def point_on_line(
        self, name: str, first: Marker, second: Marker, *, axis: Scalar = 0.0, offset: Scalar = 0.0
    ) -> Joint:
        """A pin in a slot: the second marker on a line through the first, free to turn.

        The line has the direction `axis` [rad] in the first body's frame and lies `offset` [m] to its left.
        """
        return self._join(Joint(name, "point_on_line", first, second, None, axis, offset))

    @overload
    def distance(self, name: str, first: Marker, second: Marker, *, length: Scalar) -> Joint: ...
    @overload
    def distance(self, name: str, first: SpatialMarker, second: SpatialMarker, *, length: Scalar) -> SpatialJoint: ...
    def distance(self, name: str, first: AnyMarker, second: AnyMarker, *, length: Scalar) -> AnyJoint:
        """A massless rod: the markers, both in the plane or both in space, stay `length` [m] apart.

        Output `<name>.force` [N] is positive when the rod pushes.
        """
        length = self._moving(f"the length of {name}", self._length(f"the length of {name}", length, PLACE), "m")
        if isinstance(first, SpatialMarker) and isinstance(second, SpatialMarker):
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
        """A ball joint in space: the two markers coincide.

        `coordinates` are the four Euler parameters of the second body in the axes of the first; a constraint keeps
        them at unit length. A joint without them closes a loop.
        """
        joint = SpatialJoint(
            name, "spherical", first, second, coordinates=self._placing(name, "spherical", coordinates)
        )
        self._join_in_space(joint)
        if joint.coordinates is not None:
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
        """A hinge in space: the two markers coincide, and so does an axis fixed on both bodies.

        `axis` gives its direction in the frame of the first body, `second_axis` in that of the second (the same numbers
        if left out). The angle, output `<name>.angle` [rad], is zero where the triads of `spatial.right_handed` on both
        coincide: for one and the same axis, where the frames are parallel. `coordinate` is this angle and places the
        second body, which is `relative`; a hinge without one closes a loop. Axes may be expressions in parameters.
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
        """A sleeve on a shaft: the second marker on an axis through the first, free to slide along it and to turn.

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
        """A slider in space: the second marker on an axis through the first, the frames of both bodies parallel.

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
        """A nut on a screw: as `cylindrical`, and one turn of the second body moves it `lead` [m] along the axis.

        A negative lead is a left-hand thread. `coordinate` is the angle [rad] and places the second body. Where
        constraints close the screw, it keeps the turn of the thread on which it starts. A drive is a torque [N.m].
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
        """A universal (Cardan) joint: the markers coincide, and two axes, one on each body, stay square to each other.

        `axis` in the frame of the first body and `second_axis` in that of the second are square to each other by their
        numbers: the frames are parallel where both angles are zero. `coordinates` are the angles [rad] about the first
        and then about the second axis, and place the second body.
        """
        axes = self._direction(name, axis), self._direction(name, second_axis)
        across = sum(a * b for a, b in zip(*axes, strict=True)) / (math.hypot(*axes[0]) * math.hypot(*axes[1]))
        if abs(across) > 1e-9:
            raise DeclarationError(
                f"{self.name}: the axes {shown(axis)} and {shown(second_axis)} of {name} make an angle of "
                f"{math.degrees(math.acos(across)):.6g} degrees; those of a universal joint are square to each other "
                "where the frames are parallel"
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
        """A plate on a table: the second marker in a plane through the first, free to slide in it and to turn about its
        normal `axis`.

        `coordinates` are the positions [m] along the two normals of `axis` that `spatial.right_handed` gives and the
        angle [rad] about it, and place the second body.
        """
        axes, placing = self._axes(name, axis, second_axis), self._placing(name, "planar", coordinates)
        return self._join_in_space(SpatialJoint(name, "planar", first, second, axes, placing))

    def spatial_weld(self, name: str, first: SpatialMarker, second: SpatialMarker) -> SpatialJoint:
        """A rigid connection in space: markers coincide, frames are parallel.

        Where nothing else places the second body, the weld does; otherwise it is closed by constraints.
        """
        self._own((first, second), f"joint {name}", SpatialMarker)
        placing = None if second.body.is_placed else ()
        return self._join_in_space(SpatialJoint(name, "weld", first, second, coordinates=placing))

    # Relations between bodies -----------------------------------------------------------------------------------

    def gear(
        self,
        name: str,
        first: Marker,
        second: Marker,
        *,
        radii: Sequence[Scalar] | None = None,
        teeth: Sequence[int] | None = None,
        internal: bool = False,
        phase: Scalar = 0.0,
        pressure_angle: Scalar | None = None,
        carrier: Body | None = None,
    ) -> Gear:
        """Two gears in mesh, by the markers of their centres; both turn on a carrier, which is the ground or moves.

        Hinges declared before hold the centres; they tell the carrier, or `carrier` says which body it is. Either
        `radii`, the pitch radii of both [m], or `teeth`, their numbers of teeth. With `internal` the larger of the two
        is a ring with teeth inside. `phase` is the angle [rad] of the second from the carrier where the first has none.
        `pressure_angle` [rad] is 20 degrees if left out, 0 for discs that roll on each other: it moves nothing, and
        parts the bearings.

        Outputs: `<name>.force` [N] at the pitch circles, positive where it turns the second gear counter-clockwise, and
        `<name>.separating_force` [N] across them. Raises DeclarationError where hinges or radii do not fit.
        """
        self._own((first, second), f"gear {name}", Marker)
        if carrier is not None:
            self._body(carrier, f"gear {name}")
        angle = INVOLUTE if pressure_angle is None else pressure_angle
        return self._relate(gear(self, name, first, second, radii, teeth, internal, phase, angle, carrier))

    def belt(
        self,
        name: str,
        first: Marker,
        second: Marker,
        *,
        radii: Sequence[Scalar],
        crossed: bool = False,
        pretension: Scalar = 0.0,
        phase: Scalar = 0.0,
        carrier: Body | None = None,
    ) -> Belt:
        """A belt or chain around two pulleys, by the markers of their centres; it neither slips nor stretches.

        Hinges, `carrier` and `phase` are those of `gear`. `radii` [m] of the pulleys; with `crossed` they turn
        against each other. `pretension` [N] is the tension of each strand without load: half of the load comes on top
        of it in one strand, and is taken from it in the other.

        Outputs: `<name>.force` [N], positive where it turns the second pulley counter-clockwise, `<name>.tension.left`
        and `<name>.tension.right` [N] of the strands that leave the first pulley on the left and right, seen towards
        the second. A negative tension tells that the belt is slack. Raises DeclarationError where it cannot fit.
        """
        self._own((first, second), f"belt {name}", Marker)
        if carrier is not None:
            self._body(carrier, f"belt {name}")
        return self._relate(belt(self, name, first, second, radii, crossed, pretension, phase, carrier))

    def rack(
        self,
        name: str,
        pinion: Marker,
        guide: Joint,
        *,
        radius: Scalar,
        side: str | None = None,
        phase: Scalar = 0.0,
        pressure_angle: Scalar | None = None,
    ) -> Rack:
        """A pinion, by the marker of its centre, and a rack, by the prismatic joint that guides it.

        A hinge declared before holds the pinion on the first body of the guide; the rack is its second body. `radius`
        [m] is that of the pitch circle. `side` is where the pinion lies, "left" or "right" of the pitch line seen along
        the guide; it may be left out where the guide itself runs along the pitch line. `phase` is the pinion's angle
        [rad] where the rack is at 0, `pressure_angle` that of `gear`.

        Outputs: `<name>.force` [N] on the rack along the guide, `<name>.separating_force` [N] across it.
        """
        self._own((pinion,), f"rack {name}", Marker)
        self._free(guide, f"rack {name}")
        angle = INVOLUTE if pressure_angle is None else pressure_angle
        return self._relate(rack(self, name, pinion, guide, radius, side, phase, angle))

    def rolling(
        self, name: str, line: Marker, wheel: Marker, *, radius: Scalar, axis: Scalar = 0.0, phase: Scalar = 0.0
    ) -> Rolling:
        """A wheel, by the marker of its centre, that rolls without slip on a line through a marker of another body.

        The line has the direction `axis` [rad] in its body, and the wheel of `radius` [m] lies to its left. `phase` is
        the wheel's angle [rad] from the line's body where it stands on the line's marker.

        Outputs: `<name>.normal_force` [N] on the wheel across the line, negative where it would lift off, and
        `<name>.friction_force` [N] along it, which rolling takes.
        """
        self._own((line, wheel), f"rolling {name}", Marker)
        return self._relate(rolling(self, name, line, wheel, radius, axis, phase))

    def cam(
        self,
        name: str,
        cam_centre: Marker,
        follower: Marker,
        *,
        outline: Profile | None = None,
        distance: Profile | None = None,
        roller: Scalar | None = None,
        face: Scalar | None = None,
    ) -> Cam:
        """A cam that turns about the marker of its centre, and a follower that stays on it, wherever joints lead it.

        The follower has a `roller` of that radius [m] about its marker (0: an edge), or a flat `face` through its
        marker: the direction [rad] square to the face in the follower's frame, away from the cam.

        The curve is an `outline`, the cam's radius [m] over the polar angle in its frame, or a `distance` [m] from the
        cam's centre to the roller's centre (the pitch curve), or to the face, over the direction in the cam's frame in
        which the roller lies or the face's normal points. It is a function of the angle from 0 to 2 pi [rad], made of
        CasADi's functions and parameters, or points: (x, y) [m] of an outline, (angle, length) [rad, m] of a distance,
        with a periodic cubic spline through them. An outline adds the coordinate `<name>_contact`, without mass, unless
        the roller is an edge; bodies must have been placed before.

        Outputs: `<name>.force` [N] between both, negative where the follower would lift off, and the place of contact
        `<name>.contact.x`, `.y` [m]. Raises DeclarationError where a curve does not close, or no follower fits it.
        """
        what = f"cam {name}"
        self._own((cam_centre, follower), what, Marker)
        defaults = stack([x.symbol for x in self.parameters]), ca.DM([x.default for x in self.parameters])
        found = cam(self, name, cam_centre, follower, outline, distance, roller, face, defaults)
        if outline is not None and not (roller is not None and ca.SX(roller).is_zero()):
            (x1, y1), (x2, y2) = cam_centre.position, follower.position
            if found.face is not None:
                guess = follower.body.angle + found.face[0] - cam_centre.body.angle
            else:
                guess = ca.atan2(y2 - y1, x2 - x1) - cam_centre.body.angle
            found.contact = self.coordinate(f"{name}_contact", "rad", start=guess)
        return self._relate(found)

    def blade(self, name: str, at: Marker, *, axis: Scalar = 0.0) -> Blade:
        """A blade on the ground, or a thin wheel that rolls on it: a point of a body moves along the blade, not across.

        `axis` is the direction of the blade [rad] in the body's frame. This is no constraint of positions: the body can
        get anywhere, and has fewer independent velocities than positions. Start rates have to fit the blade, and
        `solver.formulation` is `residual`, `classic` or `penalty`.

        Output `<name>.force` [N] across the blade, from the ground, along its left normal.
        """
        self._own((at,), f"blade {name}", Marker)
        if at.body is self.ground:
            raise DeclarationError(
                f"{self.name}: blade {name} is on the ground, which does not move; give a body's point"
            )
        return self._relate(blade(self, name, at, axis))

    def spatial_rolling(
        self,
        name: str,
        plane: SpatialMarker,
        centre: SpatialMarker,
        *,
        radius: Scalar,
        axis: Sequence[float] | None = None,
        normal: Sequence[float] = (0.0, 0.0, 1.0),
    ) -> SpatialRolling:
        """A ball that rolls without slip on a plane, by the marker of its middle; with `axis`, a thin disc on its edge.

        The plane goes through a marker on `spatial_ground`, and `normal` is the direction from it towards the ball.
        `radius` is in m; `axis` is that of the disc in its body's frame. As with `blade`, slip is of velocities: start
        rates have to fit, and formulations are those of a blade.

        Outputs `<name>.force.x` ... [N] on the body from the ground. Nothing keeps it from pulling.
        """
        self._own((plane, centre), f"rolling {name}", SpatialMarker)
        if plane.body is not self.spatial_ground or centre.body is self.spatial_ground:
            raise DeclarationError(
                f"{self.name}: rolling {name} is on a plane of {plane.body.name} by {centre.body.name}; give a marker "
                "of spatial_ground first, and one of a body"
            )
        radius = self._constant_length(f"the radius of rolling {name}", radius)
        up = self._direction(f"rolling {name}", normal)
        disc = None if axis is None else right_handed(self._direction(f"rolling {name}", axis))[2]
        return self._relate(SpatialRolling(name, plane, centre, radius, disc, right_handed(up)))

    def relations(self) -> list[Relation]:
        """Gears, belts, racks, rolling wheels and cams, in the order of their declaration."""
        return [each for each in self.closures if isinstance(each, Relation)]

    # Forces -----------------------------------------------------------------------------------------------------

    def drive(self, joint: AnyJoint, effort: Scalar) -> None:
        """A torque [N.m] (revolute) or force along the guide [N] (prismatic) on the second body from the first."""
        unit = EFFORTS[self._free(joint, "drive()")]
        Mechanism.drives.of(self).append(
            Drive(joint, self._quantity(f"the effort on {joint.name}", effort, unit, EFFORT))
        )

    def force(self, at: AnyMarker, x: Scalar = 0.0, y: Scalar = 0.0, z: Scalar = 0.0) -> None:
        """A force [N] in ground axes at a point of a body: an input, a state, a constant, or any expression.

        `z` is for bodies in space. Of a force that turns with its body, give `body.rotation @ force` by its entries.
        """
        self._own((at,), "force()")
        what = f"the force on {at.body.name}"
        if isinstance(at, SpatialMarker):
            force = self._vector(what, (x, y, z), ("N",) * 3, EFFORT)
            Mechanism.spatial_loads.of(self).append(SpatialLoad(at, force, (0.0,) * 3))
        elif isinstance(z, ca.SX) or z != 0:
            raise DeclarationError(f"{self.name}: {what}, a body in the plane, has a part along z; leave z out")
        else:
            Mechanism.loads.of(self).append(Load(at, self._vector(what, (x, y), ("N",) * 2, EFFORT), 0.0))

    def torque(self, body: Body | SpatialBody, torque: Scalar | Sequence[Scalar] | ca.SX) -> None:
        """A torque [N.m] on a body from the ground: a number or an expression; three in ground axes in space."""
        self._body(body, "torque()")
        what = f"the torque on {body.name}"
        if isinstance(body, SpatialBody):
            vector = self._vector(f"{what}, a body in space,", torque, ("N.m",) * 3, EFFORT)
            Mechanism.spatial_loads.of(self).append(SpatialLoad(body.at(*body.center), (0.0,) * 3, vector))
        else:
            torque = self._quantity(what, torque, "N.m", EFFORT)
            Mechanism.loads.of(self).append(Load(body.start, (0.0, 0.0), torque))

    def spring_damper(
        self,
        between: AnyJoint | tuple[AnyMarker, AnyMarker],
        *,
        stiffness: Scalar = 0.0,
        damping: Scalar = 0.0,
        rest: Scalar = 0.0,
        name: str = "",
    ) -> Spring:
        """A linear spring-damper: torsional on a revolute joint, along the guide on a prismatic one, or between points.

        stiffness [N.m/rad or N/m], damping [N.m.s/rad or N.s/m], rest angle or length [rad or m]. Points may belong to
        bodies in space. Angles count whole turns, however bodies are placed.
        With a `name` its elongation and force are outputs (see `measure`).
        """
        if isinstance(between, AnyJoint):
            along, what = self._free(between, "spring_damper()"), f"the spring at {between.name}"
        else:
            along, what = "m", "the spring between two points"
            if not isinstance(between, tuple | list) or len(between) != 2:
                given = "" if isinstance(between, tuple | list) else f", not {shown(between)}"
                raise DeclarationError(f"{self.name}: spring_damper() takes a joint, or a pair of markers{given}")
            self._own(between, "a spring")
            if isinstance(between[0], Marker) != isinstance(between[1], Marker):
                raise DeclarationError(
                    f"{self.name}: a spring joins a point in the plane to one in space; take one kind"
                )
        stiffness = self._quantity(f"the stiffness of {what}", stiffness, f"{EFFORTS[along]}/{along}", PLACE)
        damping = self._quantity(f"the damping of {what}", damping, f"{EFFORTS[along]}.s/{along}", EFFORT)
        rest = self._quantity(f"the rest of {what}", rest, along, PLACE)
        if name:
            self._claim(name, "1", "a spring")
        Mechanism.springs.of(self).append(Spring(between, stiffness, damping, rest, name))
        return self.springs[-1]

    def end_stop(
        self,
        name: str,
        of: AnyJoint | tuple[AnyMarker, AnyMarker] | ca.SX,
        *,
        upper: Scalar | None = None,
        lower: Scalar | None = None,
        stiffness: Scalar,
        onset: Scalar = ONSET,
        dissipation: Scalar | None = None,
        restitution: Scalar | None = None,
        creep: Scalar = CREEP,
        unit: str = "m",
    ) -> EndStop:
        """A limit stop: it pushes a displacement back beyond `upper`, below `lower`, or both, and never pulls.

        It acts on the free motion of a joint, on the distance of two markers, or on an expression in coordinates in
        `unit`, m or rad. `stiffness` [N/m or N.m/rad] is full beyond a penetration of `onset` [m or rad], up to which
        it rises smoothly. Energy is lost by `dissipation` [s/m or s/rad], in proportion to the push and its rate, or by
        a coefficient of `restitution` from 0 to 1, the speed after a blow over that before; with neither, none is. With
        a restitution, `creep` [m/s or rad/s] is the rate about zero in which the push goes from one to the other.

        Outputs: `<name>.penetration` [m or rad] and `<name>.force` [N] or `<name>.torque` [N.m] along the displacement.
        Raises DeclarationError where there is no limit, or numbers that no stop can have.
        """
        what = f"end stop {name}"
        if isinstance(of, AnyJoint):
            along = self._free(of, what)
        elif isinstance(of, tuple | list):
            along = "m"
            if len(of) != 2:
                raise DeclarationError(f"{self.name}: {what} is between {len(of)} points; give two markers")
            self._own(of, what)
            if isinstance(of[0], Marker) != isinstance(of[1], Marker):
                raise DeclarationError(f"{self.name}: {what} joins a point in the plane to one in space; take one kind")
        else:
            along = unit
            if unit not in EFFORTS:
                raise DeclarationError(f"{self.name}: {what} is in {shown(unit)}; give m or rad")
            if not isinstance(of, ca.SX):
                raise DeclarationError(
                    f"{self.name}: {what} takes a joint, two markers or an expression in coordinates, not {shown(of)}"
                )
            of = self._of_coordinates(what, of, unit)
        limits = {
            which: self._quantity(f"the {which} limit of {what}", x, along, PLACE)
            for which, x in (("upper", upper), ("lower", lower))
            if x is not None
        }
        if not limits:
            raise DeclarationError(f"{self.name}: {what} has no limit; give upper=, lower= or both, in {along}")
        if not any(self._moves(x) for x in limits.values()):
            at = {which: self._at_defaults(f"the {which} limit of {what}", x) for which, x in limits.items()}
            if len(at) == 2 and not at["upper"] > at["lower"]:
                raise DeclarationError(
                    f"{self.name}: {what} has the upper limit {quantity(at['upper'], along, 6)} and the lower limit "
                    f"{quantity(at['lower'], along, 6)}; the upper one must be above"
                )
        if dissipation is not None and restitution is not None:
            raise DeclarationError(f"{self.name}: {what} has a dissipation and a restitution; give one of them")
        effort = f"{EFFORTS[along]}/{along}"

        def positive(which: str, value: Scalar, unit: str, least: float | None, most: float = math.inf) -> Scalar:
            """A constant above zero, or in a range where `least` is given."""
            value = self._constant(f"the {which} of {what}", value, unit)
            x = self._at_defaults(f"the {which} of {what}", value)
            if not (x > 0 if least is None else least <= x <= most):
                needed = "be above zero" if least is None else f"be from {least:g} to {most:g}"
                needed = needed if math.isfinite(most) or least is None else "not be negative"
                given = f"{x:g} {unit}".removesuffix(" 1")
                raise DeclarationError(f"{self.name}: the {which} of {what} is {given}; it must {needed}")
            return value

        stop = EndStop(
            name,
            tuple(of) if isinstance(of, list) else of,
            along,
            limits.get("upper"),
            limits.get("lower"),
            positive("stiffness", stiffness, effort, 0.0),
            positive("onset", onset, along, None),
            None if dissipation is None else positive("dissipation", dissipation, "s/m" if along == "m" else "s", 0.0),
            None if restitution is None else positive("restitution", restitution, "1", 0.0, 1.0),
            positive("creep", creep, rate_of(along), None),
        )
        self._claim(f"{name}.penetration", along, "an output")
        self._claim(f"{name}.{'force' if along == 'm' else 'torque'}", EFFORTS[along], "an output")
        Mechanism.end_stops.of(self).append(stop)
        return stop

    def friction(
        self,
        joint: AnyJoint,
        viscous: Scalar | None = None,
        *,
        coulomb: Scalar | None = None,
        static: Scalar | None = None,
        radius: Scalar | None = None,
        length: Scalar | None = None,
        stribeck: Scalar | None = None,
        collar: Scalar | None = None,
    ) -> None:
        """Friction in a revolute, prismatic or screw joint: viscous, and dry in proportion to the joint's reaction.

        `viscous` [N.m.s/rad or N.s/m] resists in proportion to the rate. `coulomb` is the coefficient of dry friction
        while the joint slides, `static` that at which it begins to slide (the same where it is not given). With
        `stribeck` [rad/s or m/s] the coefficient goes from the static one at rest to the Coulomb one at such rates. A
        joint that sticks is held as by a lock. A coefficient that depends on inputs, time or the motion counts as none
        where it is below zero.

        A revolute joint is a journal of `radius` [m]: its torque is coefficient times radius times the force across its
        axis. A prismatic one bears at two edges that are `length` [m] apart, which carry its force and its moment;
        without `length` its force alone rubs. In space a journal may have a `length` between two bearings, too, and a
        `collar` of that radius [m] for the force along its axis; a guide may have a key at a `radius` for the moment
        about its axis; a screw takes the `radius` of its thread. What is not given carries without friction.
        """
        numbers = (viscous, coulomb, static, radius, length, stribeck, collar)
        if any(x is not None for x in numbers[1:]):
            self._slides_one_way(joint)
        along = self._free(joint, "friction()")
        if all(x is None for x in numbers):
            raise DeclarationError(
                f"{self.name}: the friction of {joint.name} has no coefficient; give viscous or coulomb"
            )
        coulomb = self._coefficient(joint, "coefficient coulomb", 0.0 if coulomb is None else coulomb, "1")
        unit = f"{EFFORTS[along]}.s/{along}"
        viscous = self._coefficient(joint, "viscous coefficient", 0.0 if viscous is None else viscous, unit)
        dry = not symbolic(coulomb).is_zero() or static is not None
        if not dry and (given := [x for x in (radius, length, stribeck, collar) if x is not None]):
            raise DeclarationError(
                f"{self.name}: the friction of {joint.name} has {counted(len(given), 'number')} of dry friction and no "
                "coefficient; give coulomb"
            )
        if not dry or not symbolic(viscous).is_zero():
            known = replace(self.spring_damper(joint, damping=viscous), friction=True)
            Mechanism.springs.of(self)[-1] = known
        if dry:
            self._dry_friction(joint, along, coulomb, static, radius, length, stribeck, collar)

    def _coefficient(self, joint: AnyJoint, which: str, value: Any, unit: str) -> Scalar:
        """A coefficient of friction, which is not negative: refused as far as it is known before the run, none then."""
        what = f"the {which} of friction of {joint.name}"
        value = self._quantity(what, value, unit, EFFORT)
        if all(self._symbols[key_of(symbol)].kind in CONSTANT for symbol in symbols_in(value)):
            self._not_negative(what, value, unit)
            return value
        return ca.fmax(value, 0)

    def _slides_one_way(self, joint: AnyJoint) -> None:
        """DeclarationError where no sign tells the direction in which a joint slides, as dry friction takes it."""
        whole = joint.joint if isinstance(joint, SpatialFreedom) else joint
        if isinstance(whole, SpatialJoint) and len(whole.freedoms) != 1 and whole.kind not in ("weld", "distance"):
            moves = in_words(list(whole.freedoms)) if whole.freedoms else "turns"
            raise DeclarationError(
                f"{self.name}: dry friction of {whole.name}: a {whole.kind} joint slides in any direction of several "
                f"({moves.replace(' or ', ' and ')}), and friction against their sum is not known here; make it of "
                "joints with one free motion each, which rub apart, or give viscous friction alone"
            )

    def _dry_friction(
        self,
        joint: AnyJoint,
        along: str,
        coulomb: Scalar,
        static: Scalar | None,
        radius: Scalar | None,
        length: Scalar | None,
        stribeck: Scalar | None,
        collar: Scalar | None,
    ) -> None:
        name = joint.name
        takes, text = _DRY_FRICTION[joint.kind, isinstance(joint, SpatialJoint)]
        given = {"radius": radius, "length": length, "collar": collar}
        if any(x is not None and each not in takes for each, x in given.items()) or (
            joint.kind != "prismatic" and radius is None
        ):
            raise DeclarationError(f"{self.name}: dry friction of {name}: {text}")
        if static is None and stribeck is not None:
            raise DeclarationError(
                f"{self.name}: dry friction of {name}: stribeck leads from the static coefficient to the Coulomb one; "
                "give static"
            )
        what = "the {} of friction of {}".format
        static = coulomb if static is None else self._coefficient(joint, "coefficient static", static, "1")
        if not isinstance(coulomb, ca.SX) and not isinstance(static, ca.SX) and static < coulomb:
            raise DeclarationError(
                f"{self.name}: the friction of {name} has static = {static:g} below coulomb = {coulomb:g}; a joint "
                "that sticks holds at least what it rubs with"
            )
        radius, length, collar = (
            None if x is None else self._length(what(letter, name), x, CONSTANT) for letter, x in given.items()
        )
        if stribeck is not None:
            stribeck = self._quantity(what("rate stribeck", name), stribeck, rate_of(along), CONSTANT)
            if (value := self._at_defaults(what("rate stribeck", name), stribeck)) <= 0:
                raise DeclarationError(
                    f"{self.name}: {what('rate stribeck', name)} is {value:g} {rate_of(along)}; it must be above zero"
                )
        if any(isinstance(each, Friction) and each.of is joint for each in self.closures):
            raise DeclarationError(f"{self.name}: {name} has dry friction already; give its numbers in one call")
        self._claim(f"{name}.slip", "1", "an output")
        at, slip = ca.SX.sym(f"{name}.sticks_at"), ca.SX.sym(f"{name}.slip")
        Mechanism.closures.of(self).append(
            Friction(name, joint, along, at, slip, coulomb, static, radius, length, stribeck, collar)
        )

    # Pictures ---------------------------------------------------------------------------------------------------

    def drawn_joint(
        self,
        name: str,
        at: Sequence[Scalar] | np.ndarray | ca.SX,
        *,
        kind: str = "",
        axis: Sequence[Scalar] | np.ndarray | ca.SX | None = None,
    ) -> None:
        """What pictures show at a place (3,) [m] in ground axes: for mechanisms whose bodies are energies alone.

        `kind` is "revolute", "cylindrical" or "prismatic", with the direction `axis` (3,); "spherical"; or "" for an
        end of a bar.
        Where they move, the outputs `<name>.x` ... and `<name>.axis.x` ... tell the place and the axis.
        """
        if kind not in DRAWN:
            raise DeclarationError(f"{self.name}: {name} is drawn as {shown(kind)}; take one of {in_words(DRAWN[1:])}")
        if (axis is None) != (kind in ("", "spherical")):
            what = "needs an axis" if axis is None else "has no axis"
            raise DeclarationError(f"{self.name}: {name}, drawn as {kind or 'an end'}, {what}")
        if name in (joint.name for joint in self.drawn_joints):
            raise DeclarationError(f"{self.name}: {name} is drawn twice; give each joint its own name")
        place = self._vector(f"the place of {name}", at, ("m",) * 3, PLACE)
        along = None if axis is None else self._vector(f"the axis of {name}", axis, ("1",) * 3, PLACE)
        parts = {f"{name}.{k}": (x, "m", f"place of {name} along {k}") for k, x in zip("xyz", place, strict=True)}
        for k, x in zip("xyz", along or (), strict=False):
            parts[f"{name}.axis.{k}"] = x, "1", f"direction of the axis of {name} along {k}"
        kinds = {self._symbols[key_of(s)].kind for x in (*place, *(along or ())) for s in symbols_in(x)}
        if moves := bool(kinds & {"coordinates", "time", "inputs"}):
            for output, (expression, unit, description) in parts.items():
                self.output(output, expression, unit, description)
        Mechanism.drawn_joints.of(self).append(DrawnJoint(name, kind, place, along, tuple(parts) if moves else ()))

    def drawn_bar(self, name: str, *joints: str) -> None:
        """A bar in pictures, through two or more drawn joints by their names."""
        known = [joint.name for joint in self.drawn_joints]
        if len(joints) < 2:
            raise DeclarationError(f"{self.name}: {name} is drawn through {len(joints)} joints; give two or more")
        for joint in joints:
            if joint not in known:
                raise DeclarationError(f"{self.name}: {name} is drawn through {joint}; {there_is(joint, known)}")
        Mechanism.drawn_bars.of(self).append(DrawnBar(name, joints))

    def draw(
        self,
        path: str | Path | None = None,
        *,
        at: Mapping[str, float] | None = None,
        parameters: Mapping[str, float] | None = None,
        size: tuple[int, int] = (640, 480),
    ) -> Drawing:
        """The picture of the mechanism at its start, before anything is simulated; written to `path` (PNG or SVG) too.

        `at` gives values [rad, m] of start quantities or coordinates that it is drawn at, `parameters` changes
        defaults, `size` is in pixels. Returns a `Drawing`, which notebooks show. Raises AlfmuError where there is no
        start.
        """
        from ..view.picture import drawing

        drawn = drawing(self, at, parameters, size)
        if path is not None:
            drawn.save(path)
        return drawn

    def _repr_svg_(self) -> str | None:
        """What notebooks show; nothing, in silence, of a declaration that is not finished or cannot start."""
        return self._shown(lambda drawing: drawing._repr_svg_())

    def _repr_png_(self) -> bytes | None:
        return self._shown(lambda drawing: drawing._repr_png_())

    def _shown(self, how: Callable[[Drawing], _Form | None]) -> _Form | None:
        """The drawing as a notebook asks for it, None where there is none or where it would take long."""
        if len(self.coordinates) > QUICK:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return how(self.draw())
            except Exception:
                return None

    # General level ----------------------------------------------------------------------------------------------

    def kinetic_energy(self, expression: ca.SX) -> None:
        """Kinetic energy [J] in coordinates, their rates and time, in addition to that of the bodies."""
        Mechanism.kinetic.of(self).append(symbolic(self._quantity("a kinetic energy", expression, "J", MOTION)))

    def potential_energy(self, expression: ca.SX) -> None:
        """Potential energy [J] in coordinates, time and inputs, in addition to that of the bodies and springs."""
        Mechanism.potential.of(self).append(symbolic(self._quantity("a potential energy", expression, "J", PLACE)))

    def generalized_force(self, coordinate: ca.SX, expression: Scalar) -> None:
        """A generalised force along a coordinate: any expression in coordinates, rates, inputs, states and time."""
        along = self._coordinate(coordinate)
        what = f"the generalised force along {along.name}"
        expression = self._quantity(what, expression, EFFORTS.get(along.unit, "1"), EFFORT)
        Mechanism.generalized.of(self).append((along.q, expression))

    def constraint(self, name: str, expression: ca.SX, unit: str = "m") -> None:
        """A holonomic constraint Phi(q, t) = 0 in m, rad or 1, after the joints declared so far.

        It is an expression in coordinates, time and inputs. Its force acts along the coordinates, so that reactions of
        joints with coordinates do not contain it.
        """
        self._claim(name, unit, "a constraint")
        value = self._of_coordinates(f"constraint {name}", expression, unit)
        self._no_jumps(f"constraint {name}", value, unit)
        Mechanism.closures.of(self).append(Constraint(name, value, unit))

    def compliances(self) -> None:
        """Give each constraint a parameter `<joint>.compliance.<direction>` [m/N or rad/(N.m)], zero by default.

        Where they are given, redundant constraints share a load as joints of that compliance do; otherwise joints
        carry the least. The motion is that of rigid joints either way.
        """
        self.compliant = True

    def event(self, time: Scalar) -> None:
        """Let steps end at a time [s]: a number, or an expression in parameters.

        Where forces, laws and rates of states have comparisons, maxima, whole numbers and the like of time and inputs,
        these times are found by themselves. Declare one where something smooth is so short that steps may pass it.
        """
        Mechanism.instants.of(self).append(self._quantity("the time of an event", time, "s", CONSTANT))

    # Changing topology ------------------------------------------------------------------------------------------

    def lock(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.locked` stop the free motion of a revolute or prismatic joint while it is on.

        A joint that moves stops in a plastic impact, and keeps its state where it is let go.
        """
        joint = self._joint(of)
        self._lock(joint.name, joint, self._free(joint, "lock()"))

    def motion(self, of: AnyJoint | str | ca.SX, law: Scalar, *, switch: bool = False) -> None:
        """Prescribe a motion: the free displacement of a revolute or prismatic joint, or a coordinate, follows `law`.

        `law` [rad or m] is an expression in time, parameters and inputs. The output `<name>.torque` [N.m] is the
        torque that the motion takes, on the second body from the first: inverse dynamics. Of a displacement in metres
        it is `<name>.force` [N], of a prismatic joint `<joint>.driving_force`. A coordinate that is independent has
        no start value then: it begins where the law has it.

        With `switch`, the Boolean input `<name>.driven` puts the motion in force while it is on, as a `lock` is: from
        where the joint is at that instant, it makes the *changes* of the law, in a plastic impact where the rates
        differ.
        """
        along: AnyJoint | ca.SX
        placed: Scalar | None
        if isinstance(of, ca.SX):
            own = self._coordinate(of)
            name, unit, along, placed = own.name, own.unit, own.q, own.q
            if unit == "1":
                raise DeclarationError(f"{self.name}: {name} has no unit; motion() takes a coordinate in m or rad")
        else:
            along = self._joint(of)
            name, unit = along.name, self._free(along, "motion()")
            placed = self._displacing(along)
            if placed is not None and not self._moves(placed):
                raise DeclarationError(
                    f"{self.name}: the coordinate of {name} says already how it moves; leave out one of both"
                )
        if any(isinstance(c, Motion) and c.name == name for c in self.closures):
            raise DeclarationError(f"{self.name}: {name} has a motion already; give it one")
        law = symbolic(self._quantity(f"the motion of {name}", law, unit, LAW))
        self._no_jumps(f"the motion of {name}", law, unit, name if switch else "")
        self.moves = True
        value = None
        coordinate = None if placed is None else self._by_symbol.get(key_of(placed))
        if switch:
            self._claim(f"{name}.driven", "1", "an input")
            value = ca.SX.sym(f"{name}.driven_from")
        elif isinstance(coordinate, Coordinate):
            self._begins(coordinate, law)
        Mechanism.closures.of(self).append(Motion(name, along, law, unit, value))

    def _displacing(self, joint: AnyJoint) -> Scalar | None:
        """What is declared as the free displacement of a joint, if anything: its coordinate, or the angle in the pose
        of a body that the joint hinges to the ground."""
        if isinstance(joint, SpatialFreedom):
            whole, which = joint.joint, joint.which
            return None if whole.coordinates is None else whole.coordinates[list(whole.freedoms).index(which)]
        if isinstance(joint, SpatialJoint):
            return None if joint.coordinates is None else joint.coordinates[0]
        if joint.coordinate is None and joint.kind == "revolute" and joint.first.body is self.ground:
            pose = joint.second.body.pose
            return pose[2] if pose is not None and self._moves(pose[2]) else None
        return joint.coordinate

    def _begins(self, coordinate: Coordinate, law: ca.SX) -> None:
        """A coordinate begins where its motion has it; DeclarationError where it was given another start."""
        name = coordinate.name
        own = [x for x in self.starts if x.name == name and x.symbol is coordinate.guess]
        for start in own:
            for each, rate in ((start.value, False), (start.rate, True)):
                there = self._at_begin(ca.jacobian(law, self.time) if rate else law)
                if each and there is not None and abs(each - there) > 1e-9 * max(1.0, abs(there)):
                    what, unit = ("rate of ", rate_of(start.unit)) if rate else ("", start.unit)
                    raise DeclarationError(
                        f"{self.name}: the start {what}{name} is {quantity(each, unit, 6)}, and its motion has "
                        f"{quantity(there, unit, 6)} at t = 0; leave the start out, which follows the motion"
                    )
            Mechanism.starts.of(self).remove(start)
            ties = Mechanism.ties.of(self)
            ties[:] = [tie for tie in ties if tie[0] is not start.symbol]
            for claimed in (f"start.{name}", f"start.{start.rate_name}"):
                del self._names[claimed]
        i = next(i for i, each in enumerate(self.coordinates) if each is coordinate)
        following = replace(coordinate, guess=law)
        Mechanism.coordinates.of(self)[i] = self._by_symbol[key_of(coordinate.q)] = following

    def _at_begin(self, law: ca.SX) -> float | None:
        """A law at time zero and default parameters; None where it takes a signal."""
        known = {key_of(self.time): 0.0, **{key_of(x.symbol): x.default for x in self.parameters}}
        symbols = ca.symvar(law)
        if any(key_of(x) not in known for x in symbols):
            return None
        return float(ca.substitute(law, stack(symbols), stack([known[key_of(x)] for x in symbols])))

    def clutch(self, name: str, first: Body, second: Body) -> None:
        """Let the Boolean input `<name>.locked` couple the turning of two bodies; a brake where one is the ground."""
        self._claim(name, "1", "a clutch")
        for body in (first, second):
            self._body(body, f"clutch {name}")
            if isinstance(body, SpatialBody):
                raise DeclarationError(
                    f"{self.name}: clutch {name} couples bodies in the plane, and {body.name} is in space; use "
                    "lock() on a hinge"
                )
        if first is second:
            raise DeclarationError(f"{self.name}: clutch {name} couples {first.name} to itself")
        self._lock(name, (first, second), "rad")

    def lock_displacement(self, name: str, expression: ca.SX, unit: str = "rad") -> None:
        """Let the Boolean input `<name>.locked` keep any expression in the coordinates [m or rad] as it is."""
        self._claim(name, unit, "a lock")
        self._lock(name, self._of_coordinates(f"lock {name}", expression, unit), unit)

    def release(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.released` switch the constraints of a joint off while it is on.

        It can be switched off where the joint is closed again, in a plastic impact. `of` may name a `constraint`.
        """
        found = [c for c in self.closures if c is of or (not isinstance(c, Rigidity | Lock | Motion) and c.name == of)]
        if not found:
            names = ", ".join(c.name for c in self.closures if not isinstance(c, Rigidity | Lock | Motion)) or "none"
            called = of.name if isinstance(of, AnyJoint) else of
            raise DeclarationError(
                f"{self.name}: {called} is not closed by constraints, so it cannot be released; those are {names}"
            )
        self._claim(f"{found[0].name}.released", "1", "an input")
        Mechanism.releases.of(self).append(found[0])

    def _lock(self, name: str, of: AnyJoint | tuple[Body, Body] | ca.SX, unit: str) -> None:
        self._claim(f"{name}.locked", "1", "an input")
        Mechanism.closures.of(self).append(Lock(name, of, unit, ca.SX.sym(f"{name}.locked_at")))

    def _joint(self, of: AnyJoint | str) -> AnyJoint:
        joints: list[AnyJoint] = [*self.joints, *self.spatial_joints]
        joints += [j.freedom(which) for j in self.spatial_joints for which in j.freedoms if len(j.freedoms) > 1]
        for joint in joints:
            if of is joint or (isinstance(of, SpatialFreedom) and of == joint) or of == joint.name:
                return joint
        names = [joint.name for joint in joints]
        if isinstance(of, AnyJoint):
            raise DeclarationError(
                f"{self.name}: {of.name} is a joint of another mechanism; {self.name} has {', '.join(names) or 'none'}"
            )
        if not isinstance(of, str):
            raise DeclarationError(
                f"{self.name}: {shown(of)} is no joint; give one, or its name: {', '.join(names) or 'there is none'}"
            )
        raise DeclarationError(f"{self.name} has no joint {of}; {there_is(of, names)}")

    # ------------------------------------------------------------------------------------------------------------

    def declared_at(self, name: str) -> str:
        """Where the user declared something of this name, as ` (pendulum.py, line 7)`."""
        return " ({}, line {})".format(*self._lines[name]) if name in self._lines else ""

    def _claim(self, name: str, unit_name: str, what: str) -> ca.SX:
        text(f"{self.name}: the name of {what}", name, LONGEST)
        if not _NAME.match(name):
            raise DeclarationError(
                f"{self.name}: {name!r} cannot be {what}; use words joined by dots, of the letters A to Z, digits and "
                "underscores"
            )
        try:
            unit(unit_name)
        except DeclarationError as error:
            raise DeclarationError(f"{self.name}: {name}: {error}") from None
        if name.split(".")[0] in _RESERVED and what != "a start value":
            raise DeclarationError(f"{self.name}: {name!r} is a name that alfmu uses itself; choose another")
        if name in self._names:
            raise DeclarationError(
                f"{self.name}: {name!r} is {self._names[name]} already{self.declared_at(name)}; take another name"
            )
        self._names[name], self._lines[name] = what, users_line()
        return ca.SX.sym(name)

    def _coordinate(self, symbol: ca.SX) -> Coordinate:
        found = self._by_symbol.get(key_of(symbol))
        if not isinstance(found, Coordinate):
            raise DeclarationError(
                f"{self.name}: {symbol if isinstance(symbol, ca.SX) else shown(symbol)} is not a coordinate of this "
                "mechanism; give the symbol that coordinate() returned"
            )
        return found

    def _is_start(self, symbol: Scalar) -> bool:
        return isinstance(self._by_symbol.get(key_of(symbol)), Start)

    def _relate(self, relation: _Related) -> _Related:
        self._claim(relation.name, "1", f"a {relation.kind}")
        Mechanism.closures.of(self).append(relation)
        return relation

    def _add(self, body: Body) -> Body:
        self._claim(body.name, "1", "a body")
        Mechanism.bodies.of(self).append(body)
        self._owned.add(body)
        body._mechanism = self
        return body

    def _join(self, joint: Joint) -> Joint:
        self._claim(joint.name, "1", "a joint")
        self._own((joint.first, joint.second), f"joint {joint.name}", Marker)
        for each, its in (("axis", "rad"), ("offset", "m"), ("angle", "rad"), ("length", "m")):
            setattr(joint, each, self._moving(f"the {each} of {joint.name}", getattr(joint, each), its))
        first, second = joint.first.body, joint.second.body
        if first is second:
            raise DeclarationError(f"{self.name}: joint {joint.name} connects {first.name} to itself")
        if second is self.ground:
            raise DeclarationError(f"{self.name}: joint {joint.name} ends on the ground; name the ground first")
        if joint.coordinate is not None:
            what = f"the coordinate of {joint.name}, a {joint.kind},"
            along = "m" if joint.kind == "prismatic" else "rad"
            joint.coordinate = self._moving(what, joint.coordinate, along)
            # The joint places whichever body has no place yet, the second one if it can.
            target = second if not second.is_placed else first
            if target.is_placed:
                raise DeclarationError(
                    f"{self.name}: joint {joint.name} has a coordinate, but {first.name} and {second.name} are placed "
                    "already; leave the coordinate out to close the joint by constraints"
                )
            self._change(target, "placed_by", joint)
        else:
            Mechanism.closures.of(self).append(joint)
        Mechanism.joints.of(self).append(joint)
        return joint

    def _join_in_space(self, joint: SpatialJoint) -> SpatialJoint:
        self._claim(joint.name, "1", "a joint")
        self._own((joint.first, joint.second), f"joint {joint.name}", SpatialMarker)
        first, second = joint.first.body, joint.second.body
        if first is second:
            raise DeclarationError(f"{self.name}: joint {joint.name} connects {first.name} to itself")
        if second is self.spatial_ground:
            raise DeclarationError(f"{self.name}: joint {joint.name} ends on the ground; name the ground first")
        if joint.coordinates is None:
            Mechanism.closures.of(self).append(joint)
            for which in (x for x in joint.freedoms if joint.is_wrapped(x)):
                self._stands_for(joint.near(which), "coordinates", f"the {which} of {joint.name}", "rad")
        else:
            if second.is_placed:
                by, other = "seven coordinates of its own", "declare the body with relative=True, or "
                if second.placed_by is not None:
                    by, other = f"its place by {second.placed_by.name}", ""
                raise DeclarationError(
                    f"{self.name}: joint {joint.name} has a coordinate, but {second.name} has {by}; {other}leave the "
                    "coordinate out to close the joint by constraints"
                )
            if not first.is_placed:
                raise DeclarationError(
                    f"{self.name}: joint {joint.name} places {second.name} on {first.name}, which nothing places yet; "
                    "declare joints with coordinates from the ground outwards"
                )
            self._change(second, "placed_by", joint)
            moving = (self._symbols[key_of(x)].kind for each in joint.second.point for x in symbols_in(each))
            joint.drifts = any(kind not in CONSTANT for kind in moving)
        (a, b, c), (d, e, f) = ([self._at_defaults(joint.name, x) for x in axis] for axis in joint.axes)
        joint.nominal = (a, b, c), (d, e, f)
        Mechanism.spatial_joints.of(self).append(joint)
        return joint

    def _placing(self, name: str, kind: str, given: Any) -> tuple[Scalar, ...] | None:
        """The coordinates of a joint in space that places its second body, None where constraints close it."""
        units = RELATIVE[kind]
        if given is None:
            return None
        if len(units) == 1:
            return (self._moving(f"the coordinate of {name}, a {kind},", given, units[0]),)
        what = f"the coordinates of {name}, a {kind} joint,"
        if not _several(given) or len(_entries(given)) != len(units):
            count = f"{len(_entries(given))} numbers" if _several(given) else shown(given)
            raise DeclarationError(f"{self.name}: {what} are {count}; give {len(units)} [{', '.join(units)}]")
        return tuple(self._moving(what, x, u) for x, u in zip(_entries(given), units, strict=True))

    def _axes(self, name: str, axis: Any, second: Any) -> tuple[Vector, Vector]:
        """Axes on both bodies: numbers, or expressions in parameters."""
        axes = []
        for x in (axis, axis if second is None else second):
            entries = _entries(x) if _several(x) else []
            known = [a for a in entries if isinstance(a, float | int | np.number | ca.SX)]
            if len(known) != 3 or len(entries) != 3 or not 0 < self._size_of_axis(name, known) < math.inf:
                raise DeclarationError(
                    f"{self.name}: the axis {shown(x)} of {name} has no direction; give three numbers, not all zero"
                )
            axes.append((known[0], known[1], known[2]))
        return axes[0], axes[0] if second is None else axes[1]

    def _direction(self, name: str, axis: Any) -> tuple[float, float, float]:
        """A direction that is three numbers."""
        x, y, z = self._axes(name, axis, None)[0]
        what = f"the axis of {name}"
        return self._plain(what, x), self._plain(what, y), self._plain(what, z)

    def _size_of_axis(self, name: str, axis: Sequence[Scalar]) -> float:
        """The length of an axis at the defaults of parameters."""
        what = f"the axis of {name}"
        given = [self._quantity(what, x, "1", CONSTANT) if isinstance(x, ca.SX) else x for x in axis]
        return math.hypot(*(self._at_defaults(what, x) for x in given))

    def _at_defaults(self, what: str, value: Scalar) -> float:
        """A number, or an expression in parameters at their defaults; DeclarationError where that is not finite."""
        if not isinstance(value, ca.SX):
            return value
        symbols, defaults = stack([x.symbol for x in self.parameters]), stack([x.default for x in self.parameters])
        found = float(ca.substitute(value, symbols, defaults) if self.parameters else value)
        if not math.isfinite(found):
            raise DeclarationError(f"{self.name}: {what} is {found} at the defaults of its parameters; check them")
        return found

    def _own(
        self, markers: Iterable[AnyMarker], user: str, kind: type[Marker] | type[SpatialMarker] | None = None
    ) -> None:
        """Points of bodies of this mechanism; of joints and the like, as the kind says, all in the plane or space."""
        for marker in markers:
            if isinstance(marker, Body | SpatialBody):
                body = marker.name
                raise DeclarationError(f"{self.name}: {user} takes a point of {body}, not the body; use {body}.at(...)")
            if not isinstance(marker, kind or AnyMarker):
                where = "the plane; take its markers from body(), bar() and ground"
                if kind is SpatialMarker:
                    where = "space; take its markers from spatial_body() and spatial_ground"
                given = "" if isinstance(marker, AnyMarker) else f", as BODY.at(...), not {shown(marker)}"
                raise DeclarationError(f"{self.name}: {user} joins bodies in {where}{given}")
            self._body(marker.body, user)
            place = (marker.x, marker.y, *((marker.z,) if isinstance(marker, SpatialMarker) else ()))
            what = f"a point of {marker.body.name} that {user} uses"
            place = self._vector(what, place, ("m",) * len(place), PLACE)
            for axis, x in zip("xyz", place, strict=False):
                if x is not getattr(marker, axis):
                    self._change(marker, axis, x)  # An input that moves the point is a signal from here on.
                if kind:
                    self._no_jumps(f"a point of {user}", x, "m")
            for x in place if marker.body not in (self.ground, self.spatial_ground) else ():
                self._perhaps_millimetres(what, x)

    def _body(self, body: Body | SpatialBody, user: str) -> None:
        if not isinstance(body, Body | SpatialBody):
            raise DeclarationError(
                f"{self.name}: {user} takes a body, as body() and bar() return it, not {shown(body)}"
            )
        if body not in self._owned:
            raise DeclarationError(f"{self.name}: {user} uses {body.name}, a body of another mechanism")

    def _free(self, joint: AnyJoint, user: str) -> str:
        """Unit of the free motion of a joint."""
        if not isinstance(joint, AnyJoint):
            raise DeclarationError(
                f"{self.name}: {user} takes a joint, as revolute() and prismatic() return it, not {shown(joint)}"
            )
        if isinstance(joint, SpatialJoint) and len(joint.freedoms) > 1:
            ways = in_words([f'{joint.name}.freedom("{which}")' for which in joint.freedoms])
            raise DeclarationError(
                f"{self.name}: {joint.name} is a {joint.kind} joint, which has several free motions; take {ways}"
            )
        if joint.kind not in ("revolute", "prismatic", "screw"):
            raise DeclarationError(
                f"{self.name}: {joint.name} is a {joint.kind}, which has no single free motion; "
                "use force() or torque() on its bodies"
            )
        if joint.first.body not in self._owned:
            raise DeclarationError(f"{self.name}: {user} uses {joint.name}, a joint of another mechanism")
        return "m" if joint.kind == "prismatic" else "rad"

    # What a number may be ---------------------------------------------------------------------------------------

    def _stands_for(self, symbol: ca.SX, kind: str, text: str, unit: str) -> ca.SX:
        self._symbols[key_of(symbol)] = Symbol(kind, text, unit)
        return symbol

    def _quantity(self, what: str, value: Any, unit: str, may: Collection[str]) -> Scalar:
        """A number or an expression in the kinds of symbols that it may depend on, in a unit."""
        what = f"{self.name}: {what}"
        value = number(what, value)
        for symbol in symbols_in(value):
            found = self._symbols.get(key_of(symbol))
            if found is None:
                raise DeclarationError(f"{what} depends on {symbol}, which this mechanism does not declare")
            if found.kind not in may:
                raise DeclarationError(
                    f"{what} depends on {found.text}; it must be a number or an expression in {_and(may)}"
                )
        if isinstance(value, ca.SX):
            for symbol in (value, -value):
                own = self._symbols[key_of(symbol)] if symbol.is_symbolic() else None
                if own and "1" not in (own.unit, unit) and not alike(own.unit, unit):
                    raise DeclarationError(f"{what} is in {unit}, and {own.text} in {own.unit}; give one in {unit}")
        return self._moved(value) if tuple(may) in MOVING else value

    def _moved(self, value: Scalar) -> Scalar:
        """What moves something, with signals in place of inputs."""
        for symbol in symbols_in(value):
            given = self._by_symbol.get(key_of(symbol))
            self.moves |= self._symbols[key_of(symbol)].kind in ("time", "inputs")
            if isinstance(given, Input):
                value = ca.substitute(value, symbol, self._signal(given).at(self.time))
        return value

    def _moving(self, what: str, value: Any, unit: str) -> Scalar:
        """A quantity that places bodies, and does not jump in time."""
        value = self._quantity(what, value, unit, PLACE)
        self._no_jumps(what, value, unit)
        return value

    def _no_jumps(self, what: str, value: Scalar, unit: str, motion: str = "") -> None:
        """What moves bodies in time does so without a jump: at the defaults of parameters and up to the stop time it is
        looked at here, all else by the run.

        Raises DeclarationError with the size of a jump; a jump of the rate is an impact, of which it warns.
        """
        symbols = symbols_in(value)
        kinds = {key_of(symbol): self._symbols[key_of(symbol)].kind for symbol in symbols}
        law = Law(what, symbolic(value), unit, motion)
        if "time" not in kinds.values() or not may_break(law.value, self.time):
            return
        if any(each.what == what and key_of(each.value) == key_of(law.value) for each in self.laws):
            return
        if "inputs" not in kinds.values():
            self._no_jump_at_defaults(law, [symbol for symbol in symbols if kinds[key_of(symbol)] != "time"])
        Mechanism.laws.of(self).append(law)

    def _no_jump_at_defaults(self, law: Law, others: Sequence[ca.SX]) -> None:
        """The same at the defaults of parameters; `others` are its symbols beside time."""
        known = {key_of(x.symbol): x.default for x in self.parameters}
        at = ca.substitute(law.value, stack(others), stack([known.get(key_of(x), 0.5) for x in others]))
        stop = self.experiment.stop_time
        if found := jump_in(at, self.time, stop):
            raise DeclarationError(JUMPS % (self.name, law.what, found[1], law.unit, found[0]))
        if found := jump_in(ca.jacobian(at, self.time), self.time, stop):
            perhaps_an_impact(self.name, law.what, *found, rate_of(law.unit))

    def _signal(self, given: Input) -> Signal:
        """The signal of an input, declared where the input moves something for the first time."""
        for signal in self.signals:
            if signal.input is given:
                return signal
        if given.unit not in ("m", "rad", "1"):
            raise DeclarationError(
                f"{self.name}: the input {given.name} is in {given.unit}, and what it moves is in m, rad or 1; give it "
                "in one of these"
            )
        Mechanism.signals.of(self).append(signal := Signal.of(given))
        for each in signal.numbers:
            self._stands_for(each, "inputs", f"the input {given.name}", "1")
        return signal

    def _vector(self, what: str, values: Any, units: Sequence[str], may: Collection[str]) -> Any:
        """Several quantities, each in its unit: a tuple of as many as there are units."""
        if not _several(values) or len(_entries(values)) != len(units):
            count = f"{len(_entries(values))} numbers" if _several(values) else shown(values)
            wanted = {2: "two", 3: "three", 4: "four"}[len(units)]
            raise DeclarationError(f"{self.name}: {what} is {count}; give {wanted}")
        entries = zip(_entries(values), units, strict=True)
        return tuple(self._quantity(what, value, unit, may) for value, unit in entries)

    def _constant(self, what: str, value: Any, unit: str, *arguments: ca.SX) -> Scalar:
        """A quantity that only parameters change, and arguments of a function."""
        for symbol in arguments:
            self._stands_for(symbol, CONSTANT[0], f"the argument {symbol}", "1")
        try:
            return self._quantity(what, value, unit, CONSTANT)
        finally:
            for symbol in arguments:
                del self._symbols[key_of(symbol)]

    def _constant_length(self, what: str, value: Any) -> Scalar:
        return self._length(what, value, CONSTANT)

    def _plain(self, what: str, value: Any) -> float:
        """A number, where no expression will do."""
        value = number(f"{self.name}: {what}", value)
        if isinstance(value, ca.SX) and not value.is_constant():
            raise DeclarationError(f"{self.name}: {what} is an expression; give a number")
        return float(value)

    def _displacement(self, name: str, unit: str) -> None:
        if unit in UNITS and unit not in ("m", "rad", "1"):
            raise DeclarationError(f"{self.name}: {name} is in {unit}; what moves is in m, rad or 1")

    def _of_coordinates(self, what: str, expression: Any, unit: str) -> ca.SX:
        """What a constraint or a lock keeps: an expression that moves."""
        self._displacement(what, unit)
        value = symbolic(self._quantity(what, expression, unit, PLACE))
        if not self._moves(value):
            raise DeclarationError(f"{self.name}: {what} depends on no coordinate, so that no motion can keep it")
        return value

    def _moves(self, value: Scalar) -> bool:
        """Whether a quantity depends on coordinates."""
        return any(self._symbols[key_of(symbol)].kind == "coordinates" for symbol in symbols_in(value))

    def _mass(self, name: str, mass: Any, what: str = "mass", unit: str = "kg") -> Scalar:
        what = f"the {what} of {name}"
        mass = self._quantity(what, mass, unit, CONSTANT)
        self._not_negative(what, mass, unit)
        return mass

    def _not_negative(self, what: str, value: Scalar, unit: str) -> None:
        """A number or an expression in parameters is zero or above at their defaults; a parameter stays so later."""
        if (found := self._at_defaults(what, value)) < 0:
            given = f"{found:g} {unit}".removesuffix(" 1")
            raise DeclarationError(f"{self.name}: {what} is {given}; it must not be negative")
        for i, parameter in enumerate(self.parameters):
            if parameter.symbol is value and parameter.minimum is None:
                Mechanism.parameters.of(self)[i] = replace(parameter, minimum=0.0)

    def _inertia(self, name: str, inertia: Any) -> Scalar:
        return self._mass(name, inertia, "inertia", "kg.m2")

    def _spatial_inertia(self, name: str, inertia: Any) -> tuple[Vector, Vector]:
        """Moments of inertia and entries xy, xz, yz of their matrix, of three principal moments or of a matrix."""
        what = f"the inertia of {name}"
        given = inertia.tolist() if isinstance(inertia, np.ndarray) and inertia.ndim else inertia
        if isinstance(given, ca.SX) and given.shape == (3, 3):
            given = [ca.horzsplit(row) for row in ca.vertsplit(given)]
        rowwise = _several(given) and any(
            row.numel() != 1 if isinstance(row, ca.SX) else _several(row) for row in _entries(given)
        )
        if not (rowwise and len(_entries(given)) == 3):
            vector = self._vector(what, inertia, ("kg.m2",) * 3, CONSTANT)
            self._check_moments(name, "", [self._at_defaults(what, x) for x in vector])
            return vector, (0.0, 0.0, 0.0)
        rows = [self._vector(f"a row of {what}", row, ("kg.m2",) * 3, CONSTANT) for row in _entries(given)]
        J = np.array([[float(self._at_defaults(what, x)) for x in row] for row in rows])
        for i, j in ((0, 1), (0, 2), (1, 2)):
            if abs(J[i, j] - J[j, i]) > 1e-9 * np.abs(J).max():
                raise DeclarationError(
                    f"{self.name}: the matrix of inertia of {name} is not symmetric: {J[i, j]:g} stands at ({i + 1}, "
                    f"{j + 1}) and {J[j, i]:g} at ({j + 1}, {i + 1}); give the same number twice"
                )
        self._check_moments(name, " by its matrix of inertia", np.linalg.eigvalsh(J).tolist())
        return (rows[0][0], rows[1][1], rows[2][2]), (rows[0][1], rows[0][2], rows[1][2])

    def _check_moments(self, name: str, how: str, moments: list[float]) -> None:
        tiny = 1e-12 * max(map(abs, moments))
        if min(moments) < -tiny * bool(how) or 2 * max(moments) > sum(moments) + tiny:
            shorter = [float(f"{x:.6g}") for x in moments]
            raise DeclarationError(
                f"{self.name}: no body has the principal moments of inertia {shorter} that {name} is given{how}; give "
                "three, none negative and none above the sum of the others"
            )

    def _length(self, what: str, length: Any, may: Collection[str]) -> Scalar:
        length = self._quantity(what, length, "m", may)
        constant = all(self._symbols[key_of(symbol)].kind in CONSTANT for symbol in symbols_in(length))
        if constant and not (value := self._at_defaults(what, length)) > 0:
            raise DeclarationError(f"{self.name}: {what} is {value:g} m; it must be above zero")
        self._perhaps_millimetres(what, length)
        return length

    def _perhaps_millimetres(self, what: str, value: Scalar) -> None:
        """Warn of a length that looks like millimetres: once of each."""
        if isinstance(value, ca.SX) or abs(value) not in self._told:
            perhaps_millimetres(f"{self.name}: {what}", value)
        if not isinstance(value, ca.SX):
            self._told.add(abs(value))

    def _pose(self, name: str, pose: Any) -> tuple[Scalar, Scalar, Scalar] | None:
        if pose is None:
            return None
        what = f"the pose of {name}"
        x, y, angle = self._vector(what, pose, ("m", "m", "rad"), PLACE)
        return self._moving(what, x, "m"), self._moving(what, y, "m"), self._moving(what, angle, "rad")

    def _ends(self, name: str, between: Any) -> tuple[Point | Marker, Point | Marker]:
        if not isinstance(between, tuple | list) or len(between) != 2:
            raise DeclarationError(f"{self.name}: {name} is between {shown(between)}; give a pair of points")
        self._own([end for end in between if not isinstance(end, Point)], f"bar {name}", Marker)
        return between[0], between[1]


def key_of(symbol: Scalar) -> int | None:
    """A key that no other scalar symbol or expression has; None for a number."""
    return symbol.element_hash() if isinstance(symbol, ca.SX) and symbol.is_scalar(True) else None


def _entries(vector: Sequence[Scalar] | ca.SX) -> Sequence[Scalar]:
    return ca.vertsplit(vector) if isinstance(vector, ca.SX) else vector


def _several(values: Any) -> bool:
    """Whether something is a row of things, as a vector is."""
    if isinstance(values, ca.SX):
        return values.is_column()
    if isinstance(values, np.ndarray):
        return values.ndim > 0
    return isinstance(values, Sequence) and not isinstance(values, str | bytes)


def _and(words: Collection[str]) -> str:
    return in_words(words).replace(" or ", " and ")


def symbolic(value: Scalar) -> ca.SX:
    """A number or an expression as an expression; conversion is slow, so it is left out where it does nothing."""
    return value if isinstance(value, ca.SX) else ca.SX(value)


def stack(expressions: Sequence[Scalar]) -> ca.SX:
    """A column of expressions, empty ones included."""
    return ca.vertcat(*map(symbolic, expressions)) if expressions else ca.SX(0, 1)
