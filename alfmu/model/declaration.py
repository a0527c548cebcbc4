"""Base of all declaring calls: the tuples of a mechanism's parts, its names and symbols, checks of arguments."""

from __future__ import annotations

import inspect
import math
import re
import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Never, Self, TypeVar, overload

import casadi as ca
import numpy as np

from .calls import declares
from .checks import JUMPS, jump_in, may_break, number, perhaps_an_impact, perhaps_millimetres, symbols_in, users_line
from .errors import DeclarationError
from .motion import Input, Law, Signal
from .parts import (
    CONSTANT,
    FREE,
    MOVING,
    PLACE,
    AnyJoint,
    AnyMarker,
    Body,
    Constraint,
    Coordinate,
    DrawnBar,
    DrawnJoint,
    Drive,
    Experiment,
    Joint,
    Load,
    Lock,
    Marker,
    Motion,
    Output,
    Parameter,
    Point,
    Rigidity,
    Scalar,
    SpatialLoad,
    Spring,
    Start,
    State,
    Symbol,
    Watched,
    key_of,
    stack,
    symbolic,
)
from .relations import Relation
from .spatial import RELATIVE, SpatialBody, SpatialFreedom, SpatialJoint, SpatialMarker, Vector
from .stops import EndStop
from .units import UNITS, alike, rate_of, unit
from .words import LONGEST, counted, in_words, no_attribute, shown, text, there_is

_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*\Z", re.ASCII)
_RESERVED = {"start", "solver", "monitor", "multiplier", "ground", "time"}
_DOUBTS = 3
"""Largest number of lengths of one mechanism that cause a warning."""


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
"""Names that other programs use for parts of a mechanism, and the corresponding method of each."""

BOOKKEEPING = (
    *("closures", "compliant", "declared_at", "drawn_bars", "drawn_joints", "drives", "end_stops", "generalized"),
    *("gravity_vector", "kinetic", "laws", "loads", "measured", "measured_joints", "measured_springs", "measures_all"),
    *("moves", "potential", "relations", "releases", "signals", "spatial_loads", "springs", "starts", "ties", "trace"),
    *("instants", "watched"),
)
"""Public names that users do not need: they are hidden from listings and become private."""

_Part = TypeVar("_Part")
_Related = TypeVar("_Related", bound=Relation)


class _Parts(Generic[_Part]):
    """Parts of a mechanism in the order of their declaration: readers see a tuple; only its methods add to it."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, mechanism: None, owner: type) -> Self: ...
    @overload
    def __get__(self, mechanism: Declaration, owner: type) -> tuple[_Part, ...]: ...
    def __get__(self, mechanism: Declaration | None, owner: type) -> Self | tuple[_Part, ...]:
        if mechanism is None:
            return self
        if self._name in BOOKKEEPING and not sys._getframe(1).f_globals.get("__name__", "").startswith("alfmu."):
            warnings.warn(f"Mechanism.{self._name} becomes private in the next version", DeprecationWarning, 2)
        return tuple(self.of(mechanism))

    def __set__(self, mechanism: Declaration, value: Never) -> None:
        raise DeclarationError(
            f"{mechanism.name}: its {self._name.replace('_', ' ')} cannot be set; declare them one by one, by methods "
            "such as bar() and revolute()"
        )

    def of(self, mechanism: Declaration) -> list[_Part]:
        """Return the list itself."""
        return mechanism._parts.setdefault(self._name, [])


@declares
@dataclass(eq=False, repr=False)
class Declaration:
    """The parts of a mechanism, and the services of every declaring call: names, symbols, checks of arguments.

    `alfmu.Mechanism` has the calls. The parts can be read: `parameters`, `coordinates`, `inputs`, `states`, `outputs`,
    `bodies`, `joints`, `spatial_bodies` and `spatial_joints` are tuples in the order of declaration.
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
    """Quantities that the environment sets."""
    states: ClassVar[_Parts[State]] = _Parts()
    """First-order equations integrated with the motion."""
    outputs: ClassVar[_Parts[Output]] = _Parts()
    """Outputs that the user declared."""
    bodies: ClassVar[_Parts[Body]] = _Parts()
    """Bodies in the plane, without the ground."""
    joints: ClassVar[_Parts[Joint]] = _Parts()
    """Joints in the plane."""
    spatial_bodies: ClassVar[_Parts[SpatialBody]] = _Parts()
    """Bodies in space, without the ground."""
    spatial_joints: ClassVar[_Parts[SpatialJoint]] = _Parts()
    """Joints in space."""
    closures: ClassVar[_Parts[Joint | SpatialJoint | Rigidity | Constraint | Lock | Motion | Relation]] = _Parts()
    """Everything that constraints close, in the order of the rows."""
    signals: ClassVar[_Parts[Signal]] = _Parts()
    """Inputs that prescribe motion."""
    instants: ClassVar[_Parts[Scalar]] = _Parts()
    """Times at which steps end."""
    laws: ClassVar[_Parts[Law]] = _Parts()
    """Laws that prescribe motion in time and may jump or become infinite."""
    releases: ClassVar[_Parts[AnyJoint | Constraint | Relation]] = _Parts()
    """Closures that a Boolean input can open."""
    springs: ClassVar[_Parts[Spring]] = _Parts()
    """Springs and dampers."""
    drives: ClassVar[_Parts[Drive]] = _Parts()
    """Efforts along the free motions of joints."""
    end_stops: ClassVar[_Parts[EndStop]] = _Parts()
    """Limit stops."""
    loads: ClassVar[_Parts[Load]] = _Parts()
    """Forces and torques from the ground."""
    spatial_loads: ClassVar[_Parts[SpatialLoad]] = _Parts()
    """Forces and torques from the ground on bodies in space."""
    kinetic: ClassVar[_Parts[ca.SX]] = _Parts()
    """Kinetic energies declared as expressions."""
    potential: ClassVar[_Parts[ca.SX]] = _Parts()
    """Potential energies declared as expressions."""
    generalized: ClassVar[_Parts[tuple[ca.SX, Scalar]]] = _Parts()
    """Coordinates and generalised forces along them."""
    watched: ClassVar[_Parts[Watched]] = _Parts()
    """Points of bodies that are watched."""
    measured: ClassVar[_Parts[AnyJoint | Spring]] = _Parts()
    """Measured joints and springs without names of their own."""
    drawn_joints: ClassVar[_Parts[DrawnJoint]] = _Parts()
    """Joints for pictures of a mechanism that is declared by energies only."""
    drawn_bars: ClassVar[_Parts[DrawnBar]] = _Parts()
    """Bars between drawn joints."""
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

    if not TYPE_CHECKING:  # type checkers report unknown attributes themselves

        def __getattr__(self, name: str) -> Any:
            raise AttributeError(no_attribute(self, name, MEANT.get(name)))

    def __setattr__(self, name: str, value: Any) -> None:
        if inspect.isfunction(getattr(type(self), name, None)) and not name.startswith("_"):
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
        self._dropped = False
        """Whether a refused declaration ends the whole mechanism, as in an import: then no earlier state is kept."""
        self._points: set[Body] = set()
        self._told: set[float] = set()

    def _as_it_was(self) -> Callable[[], None]:
        """Return a function that restores the mechanism to its present state, for a declaration that is refused
        halfway."""
        if self._dropped:
            return lambda: None
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
        """Change a declared part or a marker in a way that `_as_it_was` can undo."""
        self._changes.append((part, name, getattr(part, name)))
        object.__setattr__(part, name, value)

    def _springs(self) -> list[tuple[str, Spring]]:
        """Return all springs except frictions, by their own names or those that `measure` gives them."""
        named: dict[str, Spring] = {}
        for i, spring in enumerate((s for s in self.springs if not s.friction), 1):
            joint = spring.between if isinstance(spring.between, AnyJoint) else None
            name = spring.name or (f"{joint.name}.spring" if joint else f"spring{i}")
            named[f"{name}{i}" if name in named else name] = spring
        return list(named.items())

    def measured_joints(self) -> list[AnyJoint]:
        """Return joints whose motion is an output on request, once each; hinges in space always have this output.

        A request for all joints leaves out joints whose outputs would have the name of another variable.
        """
        joints = [j for j in self.joints if j.kind in FREE] + [j for j in self.spatial_joints if j.kind == "prismatic"]

        def named(joint: AnyJoint) -> bool:
            return any(f"{joint.name}.{x}" in self._names for x in FREE[joint.kind])

        return [j for j in joints if any(j is x for x in self.measured) or (self.measures_all and not named(j))]

    def measured_springs(self) -> list[tuple[str, Spring]]:
        """Return the measured springs, with the names of their outputs."""
        asked = [id(each) for each in self.measured]
        return [(name, s) for name, s in self._springs() if s.name or self.measures_all or id(s) in asked]

    def relations(self) -> list[Relation]:
        """Return gears, belts, racks, rolling wheels and cams, in the order of their declaration."""
        return [each for each in self.closures if isinstance(each, Relation)]

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

    def _kinematics(self) -> Any:
        """Return the places of its bodies and points as expressions; `Mechanism` implements it."""
        raise NotImplementedError

    def declared_at(self, name: str) -> str:
        """Return the place in the user's code that declared this name, as ` (pendulum.py, line 7)`."""
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
        Declaration.closures.of(self).append(relation)
        return relation

    def _add(self, body: Body) -> Body:
        self._claim(body.name, "1", "a body")
        Declaration.bodies.of(self).append(body)
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
            joint.coordinate = self._moving(what, joint.coordinate, next(iter(joint.freedoms.values()), "rad"))
            # The joint places a body that has no place yet, preferably the second one.
            target = second if not second.is_placed else first
            if target.is_placed:
                raise DeclarationError(
                    f"{self.name}: joint {joint.name} has a coordinate, but {first.name} and {second.name} are placed "
                    "already; leave the coordinate out to close the joint by constraints"
                )
            self._change(target, "placed_by", joint)
        else:
            Declaration.closures.of(self).append(joint)
        Declaration.joints.of(self).append(joint)
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
            Declaration.closures.of(self).append(joint)
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
        Declaration.spatial_joints.of(self).append(joint)
        return joint

    def _placing(self, name: str, kind: str, given: Any) -> tuple[Scalar, ...] | None:
        """Return the coordinates of a joint in space that places its second body, None if constraints close it."""
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
        """Return the axes on both bodies: numbers, or expressions in parameters."""
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
        """Return a direction given by three numbers."""
        x, y, z = self._axes(name, axis, None)[0]
        what = f"the axis of {name}"
        return self._plain(what, x), self._plain(what, y), self._plain(what, z)

    def _size_of_axis(self, name: str, axis: Sequence[Scalar]) -> float:
        """Return the length of an axis at the default parameters."""
        what = f"the axis of {name}"
        given = [self._quantity(what, x, "1", CONSTANT) if isinstance(x, ca.SX) else x for x in axis]
        return math.hypot(*(self._at_defaults(what, x) for x in given))

    def _at_defaults(self, what: str, value: Scalar) -> float:
        """Return a number, or an expression evaluated at the default parameters; raise DeclarationError if it is not
        finite."""
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
        """Check that points, joints and the like belong to this mechanism, and are all in the plane or all in space."""
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
                    self._change(marker, axis, x)  # From here on, an input that moves the point is a signal.
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
        """Return the unit of the free motion of a joint."""
        if not isinstance(joint, AnyJoint):
            raise DeclarationError(
                f"{self.name}: {user} takes a joint, as revolute() and prismatic() return it, not {shown(joint)}"
            )
        if isinstance(joint, SpatialJoint) and len(joint.freedoms) > 1:
            ways = in_words([f'{joint.name}.freedom("{which}")' for which in joint.freedoms])
            raise DeclarationError(
                f"{self.name}: {joint.name} is a {joint.kind} joint, which has several free motions; take {ways}"
            )
        if joint.kind not in (*FREE, "screw"):
            raise DeclarationError(
                f"{self.name}: {joint.name} is a {joint.kind}, which has no single free motion; "
                "use force() or torque() on its bodies"
            )
        if joint.first.body not in self._owned:
            raise DeclarationError(f"{self.name}: {user} uses {joint.name}, a joint of another mechanism")
        return next(iter(joint.freedoms.values()))

    # Allowed numbers ---------------------------------------------------------------------------------------

    def _stands_for(self, symbol: ca.SX, kind: str, text: str, unit: str) -> ca.SX:
        self._symbols[key_of(symbol)] = Symbol(kind, text, unit)
        return symbol

    def _quantity(self, what: str, value: Any, unit: str, may: Collection[str]) -> Scalar:
        """Return a number or an expression in the permitted kinds of symbols, in a unit."""
        what = f"{self.name}: {what}"
        value = number(what, value)
        for symbol in symbols_in(value):
            found = self._symbols.get(key_of(symbol))
            if found is None:
                raise DeclarationError(f"{what} depends on {symbol}, which this mechanism does not declare")
            if found.kind not in may:
                raise DeclarationError(
                    f"{what} depends on {found.text}; it must be a number or an expression in {in_words(may, 'and')}"
                )
        if isinstance(value, ca.SX):
            for symbol in (value, -value):
                own = self._symbols[key_of(symbol)] if symbol.is_symbolic() else None
                if own and "1" not in (own.unit, unit) and not alike(own.unit, unit):
                    raise DeclarationError(f"{what} is in {unit}, and {own.text} in {own.unit}; give one in {unit}")
        return self._moved(value) if tuple(may) in MOVING else value

    def _moved(self, value: Scalar) -> Scalar:
        """Return an expression that prescribes motion, with signals in place of inputs."""
        for symbol in symbols_in(value):
            given = self._by_symbol.get(key_of(symbol))
            self.moves |= self._symbols[key_of(symbol)].kind in ("time", "inputs")
            if isinstance(given, Input):
                value = ca.substitute(value, symbol, self._signal(given).at(self.time))
        return value

    def _moving(self, what: str, value: Any, unit: str) -> Scalar:
        """Return a quantity that places bodies and does not jump in time."""
        value = self._quantity(what, value, unit, PLACE)
        self._no_jumps(what, value, unit)
        return value

    def _no_jumps(self, what: str, value: Scalar, unit: str, motion: str = "") -> None:
        """Check that a law of time that moves bodies does not jump, at the default parameters and up to the stop time;
        the run checks everything else.

        Raises DeclarationError with the size of a jump. A jump of the rate is an impact and causes a warning.
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
        Declaration.laws.of(self).append(law)

    def _no_jump_at_defaults(self, law: Law, others: Sequence[ca.SX]) -> None:
        """Check a law for jumps at the default parameters; `others` are its symbols other than time."""
        known = {key_of(x.symbol): x.default for x in self.parameters}
        at = ca.substitute(law.value, stack(others), stack([known.get(key_of(x), 0.5) for x in others]))
        stop = self.experiment.stop_time
        if found := jump_in(at, self.time, stop):
            raise DeclarationError(JUMPS % (self.name, law.what, found[1], law.unit, found[0]))
        if found := jump_in(ca.jacobian(at, self.time), self.time, stop):
            perhaps_an_impact(self.name, law.what, *found, rate_of(law.unit))

    def _signal(self, given: Input) -> Signal:
        """Return the signal of an input; declare it if the input moves something for the first time."""
        for signal in self.signals:
            if signal.input is given:
                return signal
        if given.unit not in ("m", "rad", "1"):
            raise DeclarationError(
                f"{self.name}: the input {given.name} is in {given.unit}, and an input that prescribes motion is in "
                "m, rad or 1; give it in one of these"
            )
        Declaration.signals.of(self).append(signal := Signal.of(given))
        for each in signal.numbers:
            self._stands_for(each, "inputs", f"the input {given.name}", "1")
        return signal

    def _vector(self, what: str, values: Any, units: Sequence[str], may: Collection[str]) -> Any:
        """Return several quantities as a tuple, one for each unit."""
        if not _several(values) or len(_entries(values)) != len(units):
            count = f"{len(_entries(values))} numbers" if _several(values) else shown(values)
            wanted = {2: "two", 3: "three", 4: "four"}[len(units)]
            raise DeclarationError(f"{self.name}: {what} is {count}; give {wanted}")
        entries = zip(_entries(values), units, strict=True)
        return tuple(self._quantity(what, value, unit, may) for value, unit in entries)

    def _constant(self, what: str, value: Any, unit: str, *arguments: ca.SX) -> Scalar:
        """Return a quantity that depends on parameters and the arguments of a function only."""
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
        """Return a number; expressions are refused."""
        value = number(f"{self.name}: {what}", value)
        if isinstance(value, ca.SX) and not value.is_constant():
            raise DeclarationError(f"{self.name}: {what} is an expression; give a number")
        return float(value)

    def _displacement(self, name: str, unit: str) -> None:
        if unit in UNITS and unit not in ("m", "rad", "1"):
            raise DeclarationError(f"{self.name}: {name} is in {unit}; give a displacement in m, rad or 1")

    def _of_coordinates(self, what: str, expression: Any, unit: str) -> ca.SX:
        """Return the expression of a constraint or a lock, which must depend on coordinates."""
        self._displacement(what, unit)
        value = symbolic(self._quantity(what, expression, unit, PLACE))
        if not self._moves(value):
            raise DeclarationError(f"{self.name}: {what} depends on no coordinate, so that it constrains no motion")
        return value

    def _moves(self, value: Scalar) -> bool:
        """Return whether a quantity depends on coordinates."""
        return any(self._symbols[key_of(symbol)].kind == "coordinates" for symbol in symbols_in(value))

    def _mass(self, name: str, mass: Any, what: str = "mass", unit: str = "kg") -> Scalar:
        what = f"the {what} of {name}"
        mass = self._quantity(what, mass, unit, CONSTANT)
        self._not_negative(what, mass, unit)
        return mass

    def _not_negative(self, what: str, value: Scalar, unit: str) -> None:
        """Check that a quantity is not negative at the default parameters; a parameter gets a minimum of zero."""
        if (found := self._at_defaults(what, value)) < 0:
            given = f"{found:g} {unit}".removesuffix(" 1")
            raise DeclarationError(f"{self.name}: {what} is {given}; it must not be negative")
        for i, parameter in enumerate(self.parameters):
            if parameter.symbol is value and parameter.minimum is None:
                Declaration.parameters.of(self)[i] = replace(parameter, minimum=0.0)

    def _inertia(self, name: str, inertia: Any) -> Scalar:
        return self._mass(name, inertia, "inertia", "kg.m2")

    def _spatial_inertia(self, name: str, inertia: Any) -> tuple[Vector, Vector]:
        """Return the moments of inertia and the entries xy, xz, yz of their matrix, from three principal moments or a
        matrix."""
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
        """Warn of a length that looks like millimetres: once per length, and of at most _DOUBTS lengths."""
        if isinstance(value, ca.SX) or abs(value) in self._told or len(self._told) == _DOUBTS:
            return
        if perhaps_millimetres(f"{self.name}: {what}", value):
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


def _entries(vector: Sequence[Scalar] | ca.SX) -> Sequence[Scalar]:
    return ca.vertsplit(vector) if isinstance(vector, ca.SX) else vector


def _several(values: Any) -> bool:
    """Return whether a value is a sequence, as a vector is."""
    if isinstance(values, ca.SX):
        return values.is_column()
    if isinstance(values, np.ndarray):
        return values.ndim > 0
    return isinstance(values, Sequence) and not isinstance(values, str | bytes)
