"""A mechanism as a linkage: a tree of its joints, for any coordinates, and closures for the joints outside the tree.

Links have the frames of their bodies. Poses, and references of joints, are those of the start. Planar mechanisms lie in
the plane of x and y. If the format cannot close a loop by a joint, or by a joint with forces, one of the two bodies is
split: the joint places one half of its mass and inertia as a body of its own, which is welded to the other half.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ..model.mechanism import Mechanism
from ..model.parts import Constraint, Friction, Rigidity, key_of, stack, symbolic
from ..model.relations import Pair, Rack
from ..model.spatial import SpatialJoint
from .linkage import Closure, Coupling, Joint, Link, Linkage, Motor, Sum, Tendon, rank
from .markup import Node
from .poses import Array, Pose, cleaned, quaternion, vector
from .solids import Inertial

_SAME = 1e-12
"""Relative difference [1] up to which factors of sums, and efforts of springs, are equal."""


@dataclass(frozen=True)
class Form:
    """The abilities of a format: joint kinds that can close a loop, and whether it has springs; if `full`, it also has
    scaled and constant efforts, inertia of motors, dampers of balls, springs, dampers and limits along sums of
    coordinates, and couplings that are polynomials or of more than two joints."""

    name: str
    closures: Collection[str]
    springs: bool = True
    full: bool = False


@dataclass(eq=False)
class _Edge:
    """A joint between two bodies; its motions, of the second body from the first, have ground axes at the start."""

    name: str
    ends: tuple[Any, Any]
    kind: str
    point: Array
    placing: bool = False
    joints: list[Joint] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Limited:
    """An input, or a linear expression given by its terms, with limits."""

    name: str = ""
    start: float = 0.0
    limits: tuple[float, float] = (-math.inf, math.inf)
    terms: Mapping[tuple[str, Any], float] = field(default_factory=dict)


@dataclass(eq=False)
class _Pull:
    """An actuator whose effort depends on its input and on displacements and rates of several joints."""

    control: _Limited
    limits: tuple[float, float]
    terms: Mapping[tuple[str, Any], float]
    gain: float = 1.0
    along: list[tuple[Joint, float]] = field(default_factory=list)
    """Joints, and their efforts over that of the actuator."""

    def is_like(self, other: _Pull) -> bool:
        """Whether both are one actuator."""
        keys = {*self.terms, *other.terms}
        apart = max((abs(self.terms.get(k, 0.0) - other.terms.get(k, 0.0)) for k in keys), default=0.0)
        alike = [(x.control.name, x.control.limits, x.limits, x.gain) for x in (self, other)]
        return alike[0] == alike[1] and apart <= _SAME * max(map(abs, self.terms.values()), default=0.0)


def _joined(tendon: Tendon, other: Tendon) -> bool:
    """Add the parts of another tendon along the same sum, up to a factor, that the first lacks; return whether it had
    no others."""
    one, two = dict(tendon.along), dict(other.along)
    ratio = next(iter(two.values())) / one.get(next(iter(two)), math.inf)
    if one.keys() != two.keys() or max(abs(two[j] - ratio * one[j]) for j in one) > _SAME * max(map(abs, two.values())):
        return False
    if (tendon.stiffness and other.stiffness) or (tendon.limits and other.limits):
        return False
    for part in ("stiffness", "damping", "armature"):
        setattr(tendon, part, getattr(tendon, part) + ratio**2 * getattr(other, part))
    low, high = sorted(x / ratio for x in other.rest)
    tendon.rest = (low, high) if other.stiffness else tendon.rest
    if other.limits:
        low, high = sorted(x / ratio for x in other.limits)
        tendon.limits = (low, high)
    tendon.name = other.name
    return True


_NO_SUM = "its effort is not a sum of inputs, its displacement and its rate"


def described(mechanism: Mechanism, numbers: Sequence[Mapping[str, float]], constraints: Array, form: Form) -> Linkage:
    """Return a mechanism as a linkage; its causes name everything that the format cannot represent.

    `numbers` are coordinates, rates and parameters by name, `constraints` the Jacobian of constraints, at the start."""
    return _Describing(mechanism, numbers, constraints, form).linkage


class _Describing:
    def __init__(self, mechanism: Mechanism, numbers: Sequence[Mapping[str, float]], constraints: Array, form: Form):
        self.m, self.form, self.kinematics = mechanism, form, mechanism._kinematics()
        self.node = Node("mechanism", {}, Path(mechanism.name), 0)
        self.linkage = Linkage(mechanism.name, form.name, self.node)
        self.refuse = self.linkage.refuse
        c: Any = mechanism.coordinates
        p: Any = mechanism.parameters
        self.symbols = [stack([x.q for x in c]), stack([x.v for x in c]), stack([x.symbol for x in p])]
        self.values = [[given[x.name] for x in some] for given, some in zip(numbers, (c, c, p), strict=True)]
        self.taken = set(mechanism._names)
        self.motions: dict[str, Joint] = {}
        self.along: dict[int | None, tuple[str, Any]] = {
            key_of(x.symbol): ("u", _Limited(x.name, x.start)) for x in mechanism.inputs
        }
        """Inputs ("u"), limited efforts ("l"), displacements ("q") and rates ("v") of joints, Euler parameters ("e") of
        balls and their rates ("w") by their symbols."""
        self.known: dict[int | None, tuple[ca.SX, ca.SX]] = {}
        """Expressions, each with its form without limits, by the key of the expression."""
        self.coupled: set[Joint] = set()
        self.pulls: list[_Pull] = []
        self.edges: list[_Edge] = []
        grounds = (mechanism.ground, mechanism.spatial_ground)
        self.poses: dict[Any, Pose] = dict.fromkeys(grounds, Pose())
        self.spins: dict[Any, tuple[Array, Array]] = dict.fromkeys(grounds, (np.zeros(3), np.zeros(3)))
        """Velocity and angular velocity of the frames of bodies in ground axes."""
        self.inertia: dict[Any, Inertial] = {}
        self.links: dict[Any, Link | None] = dict.fromkeys(grounds)
        for part in (self._bodies, self._joints, self._forces, self._closures, self._tree, self._merge):
            part()
        if "world" in (link.name for link in self.linkage.links):
            self.refuse("world", "this is the name of the ground in files; take another name")
        motions = constraints.shape[1] - rank(constraints)
        if not self.linkage.causes and (found := self.linkage.freedoms) != motions:
            what = f"they permit {found} motions, and the coordinates {motions}"
            self.refuse("joints", f"{what}; declare a joint for each constraint that is implied by poses of bodies")

    # Numbers ----------------------------------------------------------------------------------------------------

    def number(self, expression: Any) -> Array:
        """Return the value of an expression at the start."""
        return np.array(ca.Function("f", self.symbols, [ca.densify(ca.SX(expression))])(*self.values))

    def scalar(self, expression: Any) -> float:
        return float(self.number(expression)[0, 0])

    def rate(self, expression: ca.SX) -> Array:
        return self.number(ca.jtimes(expression, self.symbols[0], self.symbols[1]))

    def fixed(self, expression: Any) -> ca.SX:
        """Return an expression with numbers in place of parameters."""
        return ca.substitute(symbolic(expression), self.symbols[2], ca.SX(ca.DM(self.values[2])))

    def constant(self, part: str, what: str, *values: Any) -> list[float]:
        """Return numbers, which must not depend on the motion."""
        found = [self.fixed(x) for x in values]
        if not all(x.is_constant() for x in found):
            self.refuse(part, f"its {what} is no constant")
        return [float(x) if x.is_constant() else 0.0 for x in found]

    def fresh(self, name: str) -> str:
        """Return an unused name."""
        tries = (f"{name}{i or ''}" for i in range(len(self.taken) + 1))
        self.taken.add(found := next(x for x in tries if x not in self.taken))
        return found

    # Bodies and joints ------------------------------------------------------------------------------------------

    def _bodies(self) -> None:
        """Find poses, velocities and inertia of bodies."""
        m = self.m
        if not (m.bodies or m.spatial_bodies):
            self.refuse("bodies", "it has none; declare bodies and joints instead of energies")
        for each in m.releases:
            self.refuse(each.name, "an input can release it")
        if m.moves:
            self.refuse("motions", "places, constraints or energies depend on time or on an input")
            self.linkage.judge()
        x, y, z = self.constant("gravity", "vector", *m.gravity_vector)
        self.linkage.gravity = (x, y, z)
        for body in m.bodies:
            frame = self.kinematics.frame(body)
            turn = ca.blockcat([[frame.ex, -frame.ey, 0], [frame.ey, frame.ex, 0], [0, 0, 1]])
            # Moments about x and y do not matter in a plane; equal ones make the inertia physically possible.
            self._body(body, ca.vertcat(*frame.place(0, 0), 0), turn, (*body.center, 0), ca.SX.eye(3) * body.inertia)
        for solid in m.spatial_bodies:
            origin = solid.anchor[1] + solid.turned((0.0, 0.0, 0.0))
            self._body(solid, origin, solid.rotation, solid.center, solid.inertia_matrix)

    def _body(self, body: Any, origin: ca.SX, turn: ca.SX, center: Sequence[Any], inertia: ca.SX) -> None:
        self.poses[body] = Pose(self.number(origin).ravel(), self.number(turn))
        spin = self.rate(turn) @ self.poses[body].turn.T
        self.spins[body] = self.rate(origin).ravel(), np.array((spin[2, 1], spin[0, 2], spin[1, 0]))
        at = self.number(ca.vertcat(*center)).ravel()
        self.inertia[body] = Inertial(self.scalar(body.mass), at, self.number(inertia))

    def _joints(self) -> None:
        joints: list[Any] = [*self.m.joints, *self.m.spatial_joints]
        for joint in joints:
            if joint.kind == "distance":
                self.refuse(joint.name, "it is a rod without mass; give it a body and two joints")
            spatial = isinstance(joint, SpatialJoint)
            points = [x.point if spatial else (x.x, x.y, 0.0) for x in (joint.first, joint.second)]
            _, local = (self.constant(joint.name, "point", *point) for point in points)
            at, ends = self.poses[joint.second.body].at(vector(local)), (joint.first.body, joint.second.body)
            placing = (joint.coordinates if spatial else joint.coordinate) is not None
            self.edges.append(edge := _Edge(joint.name, ends, joint.kind, at, placing))
            (self._in_space if spatial else self._in_plane)(joint, edge)

    def _in_plane(self, joint: Any, edge: _Edge) -> None:
        self.constant(joint.name, "geometry", joint.offset, joint.angle, joint.axis, joint.length)
        for which in joint.freedoms:
            kind, suffix = ("prismatic", "slide") if which == "position" else ("revolute", "turn")
            axis: Any = (0.0, 0.0, 1.0)
            if which == "position":
                ux, uy, _, _ = self.kinematics.axes(joint)
                axis = self.number(ca.vertcat(ux, uy, 0)).ravel()
            along = joint.coordinate if edge.placing else self.kinematics.displacement(joint, which)
            name = joint.name if len(joint.freedoms) == 1 else self.fresh(f"{joint.name}_{suffix}")
            self._move(edge, name, kind, axis, along)

    def _in_space(self, joint: SpatialJoint, edge: _Edge) -> None:
        if joint.kind == "spherical":
            spin = self.spins[edge.ends[1]][1] - self.spins[edge.ends[0]][1]
            ball = Joint(joint.name, "spherical", self.node, edge.point, rates=tuple(spin))
            ball.start = ball.zero
            edge.joints.append(ball)
            for e in (ca.SX(x) for x in joint.coordinates or ()):
                if e.is_symbolic():
                    self.along[key_of(e)], self.along[key_of(self.m.rate(e))] = ("e", ball), ("w", ball)
            return
        normal, other, axis = (self.number(x).ravel() for x in joint.triad())
        axes = {"position1": normal, "position2": other}
        if joint.kind == "universal":
            axes["angle2"] = self.number(joint.triad(second=True)[2]).ravel()
        (lead,) = self.constant(joint.name, "lead", joint.lead)
        screw = edge.kind == "screw" and "screw" in self.form.closures
        for which in sorted(joint.freedoms, key=lambda x: x.startswith("angle")):
            name = joint.name if len(joint.freedoms) == 1 else f"{joint.name}.{which}"
            kind = "prismatic" if which.startswith("position") else "screw" if screw else "revolute"
            self._move(edge, name, kind, axes.get(which, axis), joint.displacement(which), lead * (kind == "screw"))
        if edge.kind == "screw" and not screw:  # a hinge with a coupled slide
            way, pitch = self.fresh(f"{joint.name}_way"), lead / (2 * math.pi)
            self._move(edge, way, "prismatic", axis, pitch * joint.displacement("angle"))
            if not edge.placing:
                self._couple(f"{way}_follows", [(self.motions[way], 1.0), (self.motions[joint.name], -pitch)])

    def _move(self, edge: _Edge, name: str, kind: str, axis: Any, along: Any, lead: float = 0.0) -> None:
        """Add a motion with its displacement to a joint, unless the displacement is constant."""
        x = self.fixed(along)
        if edge.placing and x.is_constant():
            return
        value, rate = self.scalar(x), float(self.rate(x)[0, 0])
        joint = Joint(name, kind, self.node, edge.point, (vector(axis),), value, (value,), (rate,), lead=lead)
        edge.joints.append(joint)
        self.motions[name] = joint
        if x.is_symbolic() and key_of(x) not in self.along:
            self.along[key_of(x)], self.along[key_of(self.m.rate(x))] = ("q", joint), ("v", joint)
        elif edge.placing:
            leaders = [(key[1], -factor) for key, factor in (self._linear(x) or {}).items() if key[0] == "q"]
            if len(leaders) == 1:
                self._couple(f"{name}_follows", [(joint, 1.0), *leaders])
            else:
                self.refuse(edge.name, "its coordinate is an expression that no file holds")

    # Forces -----------------------------------------------------------------------------------------------------

    def _motion(self, of: Any, what: str) -> Joint:
        """Return the joint motion along which a force acts; refuse any other direction."""
        name = "" if isinstance(of, ca.SX) else getattr(of, "name", "")
        if name not in self.motions:
            self.refuse(name or what, f"{what} acts between points or along an expression; files hold those of joints")
        return self.motions.get(name) or Joint("", "revolute", self.node)

    def _forces(self) -> None:
        m = self.m
        for spring in m.springs:
            joint = self._motion(spring.between, "a spring")
            k, d, rest = self.constant(joint.name, "spring", spring.stiffness, spring.damping, spring.rest)
            self._spring(joint, k, d, k * rest)
        for stop in m.end_stops:
            ends = (-math.inf if stop.lower is None else stop.lower, math.inf if stop.upper is None else stop.upper)
            low, high = self.constant(stop.name, "limit", *ends)
            terms = self._linear(stop.of) if isinstance(stop.of, ca.SX) else None
            self.linkage.warn("stiffness and damping of end stops", self.node)
            shift = terms.pop(("1", None)) if terms else 0.0
            along = tuple((joint, size) for (kind, joint), size in (terms or {}).items() if kind == "q")
            if along and len(along) == len(terms or ()) and (self.form.full or len(along) == 1):
                self._limited(stop.name, along, low - shift, high - shift)
                continue
            joint = self._motion(stop.of, "an end stop")
            self._limited(stop.name, ((joint, 1.0),), low, high)
        given = [(self._motion(drive.joint, "a drive"), drive.effort) for drive in m.drives]
        hinges = {x.ends[1]: x.joints for x in self.edges if x.ends[0] is m.ground and x.kind == "revolute"}
        loads: list[Any] = [*m.loads, *m.spatial_loads]
        for load in loads:
            if hinges.get(load.at.body) and all(symbolic(x).is_zero() for x in load.force):
                given.append((hinges[load.at.body][0], load.torque))
            else:
                self.refuse(load.at.body.name, "a force from the ground acts on it; files hold efforts along joints")
        self._rated()
        for joint in dict.fromkeys(joint for joint, _ in given):
            self._drive(joint, self.fixed(sum((effort for moved, effort in given if moved is joint), ca.SX(0))))
        self._pulled()
        for joint in self.motions.values():
            if joint.stiffness[0] and not self.form.springs:
                self.refuse(joint.name, f"{self.form.name} holds no springs")

    def _limited(self, name: str, along: Sum, low: float, high: float) -> None:
        """Add limits of a joint, where several hold together, or of a sum of coordinates."""
        if len(along) > 1:
            self._along_sum(name, Tendon(name, self.node, along, limits=(low, high)))
            return
        joint, factor = along[0]
        low, high = sorted((low / factor, high / factor))
        old = joint.limits[0] if joint.limits else (low, high)
        low, high = max(low, old[0]), min(high, old[1])
        if low > high:
            self.refuse(name, f"end stops of {joint.name} leave no angle or way between {low:g} and {high:g}")
        joint.limits = ((low, high),)

    def _rated(self) -> None:
        """Convert quadratic energies and linear dampers, of joints, of sums of their coordinates, and of balls."""
        balls: dict[tuple[Joint, str], dict[int | None, float]] = {}
        dampers: dict[tuple[Any, Any], float] = {}
        for given in self.m.potential:
            self._energy(given, "q")
        forces: list[tuple[Any, Any]] = [*((None, x) for x in self.m.kinetic), *self.m.generalized]
        for along, given in forces:
            x = self.fixed(given)
            v = (ca.symvar(x) or [ca.SX.sym("none")])[0]
            kind, joint = self.along.get(key_of(v), ("", None))
            if kind != "w" and along is None:
                self._energy(given, "v")
                continue
            terms = self._linear(x) or {("", None): 1.0}
            moved, ball = self.along.get(key_of(along), ("", None)) if along is not None else ("e", joint)
            if moved == "q" and all(key[0] == "v" or not factor for key, factor in terms.items()):
                for (_, other), factor in terms.items():
                    dampers[ball, other] = dampers.get((ball, other), 0.0) - factor
                continue
            slopes = [x, ca.gradient(x, v)]
            slopes += [ca.gradient(slopes[1], v)] if along is None else []
            size, rests = slopes.pop(), all(ca.substitute(each, v, 0).is_zero() for each in slopes)
            own = kind == "w" and (along is None or key_of(self.m.rate(along)) == key_of(v))
            if not (size.is_constant() and rests and own and (float(size) > 0) == (along is None)):
                self._refuse_force(given)
                continue
            shares = balls.setdefault((joint, "armature" if along is None else "damping"), {})
            shares[key_of(v)] = shares.get(key_of(v), 0.0) + abs(float(size)) / 4
        for (ball, what), shares in balls.items():
            if len(shares) < 4 or len(set(shares.values())) > 1:
                self.refuse(ball.name, f"its {what} differs about its axes")
            value = next(iter(shares.values()))
            setattr(ball, what, value if what == "armature" else (value,))
        self._damped({key: size for key, size in dampers.items() if key[1] is not None})
        every = [joint for edge in self.edges for joint in edge.joints]
        for joint in (x for x in every if not self.form.full and (x.armature or (not x.axes and x.damping[0]))):
            self.refuse(joint.name, f"{self.form.name} holds no inertia of motors, and no dampers of balls")

    def _refuse_force(self, given: Any) -> None:
        what = f"this energy or force is an expression; {self.form.name} holds those of bodies and joints"
        self.refuse(str(given)[:60], what)

    def _energy(self, given: Any, kind: str) -> None:
        """Convert a quadratic energy of displacements ("q") to springs, of rates ("v") to inertia of motors."""
        x = self._unlimited(self.fixed(given))
        if not (symbols := ca.symvar(x)):
            return
        at = stack(symbols)
        keys = [self.along.get(key_of(each), ("", None)) for each in symbols]
        curved, slope = ca.hessian(x, at)
        squares = _squares(np.array(ca.DM(curved))) if curved.is_constant() else None
        slack = next((of for which, of in keys if which == "l"), None)
        if squares is None or any(which not in (kind, "l") for which, _ in keys):
            self._refuse_force(given)
            return
        pull = np.array(ca.DM(ca.substitute(slope, at, 0 * at))).ravel()
        whole = np.array([size * factors for size, factors in squares]).reshape(-1, len(keys)).T
        rests = np.linalg.lstsq(whole, -pull, rcond=None)[0]
        if np.abs(whole @ rests + pull).max() > _SAME * np.abs(pull).max() or (kind == "v" and pull.any()):
            self._refuse_force(given)
            return
        for (size, factors), rest in zip(squares, rests.tolist(), strict=True):
            terms = {key: factor for key, factor in zip(keys, factors.tolist(), strict=True) if factor}
            ends = (rest, rest)
            if slack is not None:  # a spring along a sum less the same sum within limits
                share = -terms.pop(("l", slack), 0.0)
                both = {*terms, *slack.terms}
                apart = [terms.get(key, 0.0) - share * slack.terms.get(key, 0.0) for key in both]
                if len(squares) > 1 or not share or kind == "v" or np.abs(apart).max() > _SAME or pull.any():
                    self._refuse_force(given)
                    return
                size, ends, terms = size * share**2, slack.limits, {k: f for k, f in slack.terms.items() if f}
            along = [(joint, factor) for (_, joint), factor in terms.items()]
            which = {"stiffness": size, "rest": ends} if kind == "q" else {"armature": size}
            self._along_sum(given, Tendon(self.fresh("tendon"), self.node, tuple(along), **which))

    def _damped(self, dampers: Mapping[tuple[Any, Any], float]) -> None:
        """Convert forces of dampers along joints, per rates of joints."""
        joints = list(dict.fromkeys(joint for pair in dampers for joint in pair))
        squares = _squares(np.array([[dampers.get((one, two), 0.0) for two in joints] for one in joints]))
        if squares is None:
            self.refuse(joints[0].name, "forces by rates act along it that no dampers of joints or of their sums have")
        for size, factors in squares or ():
            along = tuple((joint, x) for joint, x in zip(joints, factors.tolist(), strict=True) if x)
            self._along_sum("dampers", Tendon(self.fresh("tendon"), self.node, along, damping=size))

    def _along_sum(self, given: Any, tendon: Tendon) -> None:
        """Add a spring, a damper, motor inertia or limits along a joint, or along a sum of coordinates."""
        (joint, factor), low, high = tendon.along[0], *tendon.rest
        if len(tendon.along) == 1 and low == high and not tendon.limits:
            k, d = tendon.stiffness * factor**2, tendon.damping * factor**2
            joint.armature += tendon.armature * factor**2
            self._spring(joint, k, d, k * low / factor)
        elif self.form.full:
            self.coupled |= {joint for joint, _ in tendon.along}
            self.linkage.tendons = [each for each in self.linkage.tendons if not _joined(tendon, each)]
            self.linkage.tendons.append(tendon)
        else:
            self._refuse_force(given)

    def _spring(self, joint: Joint, k: float, d: float, pull: float) -> None:
        """Add a stiffness, a damping and an effort at zero to those of a joint."""
        pull, k, d = pull + joint.stiffness[0] * joint.rest[0], k + joint.stiffness[0], d + joint.damping[0]
        if k < 0 or d < 0:
            self.refuse(joint.name, "its stiffness or damping is negative")
        if pull and not k and self.form.full:  # an actuator with gain zero and the effort as its bias
            self._motor(joint, _Limited(self.fresh(f"{joint.name}_effort"), 0.0), 0.0, (pull, 0.0, 0.0))
        elif pull and not k:
            self.refuse(joint.name, f"a constant effort acts along it; {self.form.name} holds inputs alone")
        joint.stiffness, joint.damping, joint.rest = (k,), (d,), (pull / k if k else 0.0,)

    def _linear(self, expression: Any) -> dict[tuple[str, Any], float] | None:
        """Return the factors of inputs, and of displacements and rates of joints, and the constant of a linear
        expression.

        Return None if the expression is not linear."""
        x = self.fixed(expression)
        symbols = ca.symvar(x)
        factors = [ca.gradient(x, each) for each in symbols]
        if not all(f.is_constant() and key_of(each) in self.along for f, each in zip(factors, symbols, strict=True)):
            return None
        found = {self.along[key_of(each)]: float(f) for f, each in zip(factors, symbols, strict=True)}
        return found | {("1", None): float(ca.substitute(x, stack(symbols), ca.SX.zeros(len(symbols))))}

    def _drive(self, joint: Joint, effort: ca.SX) -> None:
        """Convert an effort along a joint to motors, which may be limited, a spring and a damper."""
        own = [("1", None), ("q", joint), ("v", joint)]
        terms = self._linear(self._unlimited(effort))
        inside = [key for kind, given in terms or () for key in (given.terms if kind == "l" else [(kind, given)])]
        if terms is None or any(key not in own and key[0] != "u" for key in inside):
            if not (self.form.full and self._pulls(joint, terms or {})):
                self.refuse(joint.name, _NO_SUM)
            return
        bias, k, d = (terms.pop(key, 0.0) for key in own)
        for (kind, given), gain in terms.items():
            inner = {key: gain * x for key, x in given.terms.items()} if kind == "l" else {(kind, given): gain}
            feedback = (*(inner.pop(key, 0.0) for key in own),)
            force = tuple(sorted(gain * x for x in given.limits)) if kind == "l" else None
            if force and not (self.form.full and len(inner) == 1):
                (low, high), force = force, None
                joint.effort = (low, high)
                if any((*feedback, bias, k, d)) or len(terms) > 1 or not (self.form.full or low == -high):
                    self.refuse(
                        joint.name, "its effort is limited, which files hold only for a sum of inputs, from -x to x"
                    )
            for (_, control), factor in inner.items():
                self._motor(joint, control, factor, feedback, force)
        self._spring(joint, -k, -d, bias)

    def _pulls(self, joint: Joint, terms: Mapping[tuple[str, Any], float]) -> bool:
        """Keep an effort by one input and other joints, as of an actuator along a sum; return whether it is one."""
        inner = {key: size for key, size in terms.items() if size}
        first: tuple[tuple[str, Any], float] = next(iter(inner.items()), (("", None), 0.0))
        (kind, given), share = first
        controls = [(of, size) for (which, of), size in inner.items() if which == "u"]
        limits = (-math.inf, math.inf)
        if kind == "l" and len(inner) == 1:
            inner, limits = {key: size for key, size in given.terms.items() if size}, given.limits
            controls = [(of, size) for (which, of), size in inner.items() if which == "u"]
        elif controls:
            share = controls[0][1]
            inner = {key: size / share for key, size in inner.items()}
        if len(controls) != 1 or any(which not in ("u", "q", "v", "1") for which, _ in inner):
            return False
        found = _Pull(controls[0][0], limits, {k: x for k, x in inner.items() if k[0] != "u"})
        found.gain = next(x for (which, _), x in inner.items() if which == "u")
        same = next((each for each in self.pulls if each.is_like(found)), found)
        self.pulls += [found] * (same is found)
        same.along.append((joint, share))
        return True

    def _pulled(self) -> None:
        """Convert efforts of actuators along sums of coordinates; their feedback must be that of these sums."""
        for pull in self.pulls:
            slopes = [[pull.terms.get((kind, joint), 0.0) / share for joint, share in pull.along] for kind in "qv"]
            others = {joint for (kind, joint) in pull.terms if kind != "1"} - {joint for joint, _ in pull.along}
            taken = pull.control.name in (motor.name for motor in self.linkage.motors)
            if others or taken or any(np.ptp(x) > _SAME * np.abs(x).max() for x in slopes):
                self.refuse(pull.along[0][0].name, _NO_SUM)
                continue
            bias = pull.terms.get(("1", None), 0.0), slopes[0][0], slopes[1][0]
            control = None if pull.control.limits == (-math.inf, math.inf) else pull.control.limits
            force = None if pull.limits == (-math.inf, math.inf) else pull.limits
            along, name, start = tuple(pull.along), pull.control.name, pull.control.start
            motor = Motor(name, self.node, along, "", 1.0, pull.gain, bias, 0.0, 0.0, control, force, start)
            self.linkage.motors.append(motor)

    def _unlimited(self, x: ca.SX) -> ca.SX:
        """Return an expression in which a new symbol replaces each limited input and each limited linear part."""
        if not x.n_dep() or key_of(x) in self.known:
            return self.known.get(key_of(x), (x, x))[1]
        parts = [self._unlimited(x.dep(i)) for i in range(x.n_dep())]
        found = (ca.SX.binary if len(parts) == 2 else ca.SX.unary)(x.op(), *parts)
        for part, limit in (parts, parts[::-1]) if x.op() in (ca.OP_FMIN, ca.OP_FMAX) else ():
            if not limit.is_constant() or (terms := self._linear(part)) is None:
                continue
            kind, given = self.along.get(key_of(part), ("", None))
            if kind != "l" and not (kind == "u" and self.form.full):
                kind, given = "l", _Limited(terms=terms)
            low, high = given.limits
            ends = (low, min(high, float(limit))) if x.op() == ca.OP_FMIN else (max(low, float(limit)), high)
            found = ca.SX.sym("limited")
            self.along[key_of(found)] = (kind, replace(given, limits=ends))
        self.known[key_of(x)] = (x, found)
        return found

    def _motor(
        self,
        joint: Joint,
        control: _Limited,
        gain: float,
        bias: Sequence[float],
        force: tuple[float, float] | None = None,
    ) -> None:
        name, limits = control.name, None if control.limits == (-math.inf, math.inf) else control.limits
        if gain != 1 and not self.form.full:
            self.refuse(joint.name, f"its input {name} is scaled; {self.form.name} holds unscaled efforts")
        for motor in (x for x in self.linkage.motors if x.name == name):
            if not self.form.full or any((*bias, *motor.bias, force, motor.force)) or motor.control != limits:
                self.refuse(name, "this input drives several joints; declare one for each")
            motor.along = (*motor.along, (joint, gain / motor.gain))
            return
        along, (b, k, d) = ((joint, 1.0),), bias
        motor = Motor(name, self.node, along, "", 1.0, gain, (b, k, d), 0.0, 0.0, limits, force, control.start)
        self.linkage.motors.append(motor)

    # Closures ---------------------------------------------------------------------------------------------------

    def _closures(self) -> None:
        units = {x.unit_length for x in self.m.spatial_bodies} | {x.unit_length for x in self.m.spatial_joints}
        for each in self.m.closures:
            if isinstance(each, Pair | Rack):
                if isinstance(each, Pair):
                    sums: list[Any] = list(zip(each.ways, each.radii, strict=True))
                else:
                    sums = [(((each.guide, 1.0),), 1.0), (each.way, -each.side * each.radius)]
                terms = [(self.motions.get(x.name), sign * self.scalar(R)) for way, R in sums for x, sign in way]
                self._couple(each.name, terms)
            elif isinstance(each, Friction):
                joint = self._motion(each.of, "friction")
                if each.load is None:
                    self.refuse(each.name, "its dry friction is in proportion to the reaction; give it a constant load")
                given = (0.0 if x is None else x for x in (each.coulomb, each.static, each.load))
                coulomb, static, load = self.constant(each.name, "friction", *given)
                if coulomb != static:
                    self.refuse(each.name, "its static friction differs from that while it slides")
                joint.friction = (coulomb * load,)
            elif isinstance(each, Constraint) and each.name not in units:
                if not (found := self._linear(each.expression)) and self._polynomial(each.name, each.expression):
                    continue
                found = found or {("", None): 1.0}
                self._couple(each.name, [(x[1] if x[0] == "q" else None, y) for x, y in found.items() if x[0] != "1"])
            elif not isinstance(each, Constraint | Rigidity) and each not in (*self.m.joints, *self.m.spatial_joints):
                self.refuse(each.name, f"it is a {type(each).__name__.lower()}, which no file holds")

    def _couple(self, name: str, terms: Sequence[tuple[Joint | None, float]]) -> None:
        """Add a coupling that keeps a weighted sum of displacements at its value at the start."""
        joints = dict.fromkeys(joint for joint, _ in terms)
        whole = [(joint, sum(factor for each, factor in terms if each is joint)) for joint in joints]
        found = [(joint, factor) for joint, factor in whole if joint and factor]
        if None in joints or not found or (len(found) != 2 and not self.form.full):
            what = "motions of joints" if self.form.full else "two motions of joints"
            self.refuse(name, f"{self.form.name} holds only couplings of {what}")
            return
        self.coupled |= {joint for joint, _ in found}
        coupling = Coupling(name, self.node, tuple(found), (), [0.0])
        if len(found) == 2:
            (one, a), (two, b) = found
            coupling = Coupling(name, self.node, ((one, 1.0),), ((two, 1.0),), [0.0, -b / a])
        self.linkage.couplings.append(coupling)

    def _polynomial(self, name: str, expression: Any) -> bool:
        """Convert a constraint to a polynomial of one displacement in another; return False if it is not one."""
        x = self.fixed(expression)
        places = [(s, *self.along.get(key_of(s), ("", None))) for s in ca.symvar(x)]
        for (q, kind, joint), (by, other, leader) in (places, places[::-1]) if len(places) == 2 else ():
            a, found = ca.gradient(x, q), [-x]
            for power in range(1, 6):
                found.append(ca.gradient(found[-1], by) / power)
            if (kind, other) == ("q", "q") and self.form.full and a.is_constant() and found[-1].is_zero():
                numbers = [self.scalar(each) / float(a) for each in found[:-1]]
                self.linkage.couplings.append(Coupling(name, self.node, ((joint, 1.0),), ((leader, 1.0),), numbers))
                self.coupled |= {joint, leader}
                return True
        return False

    # The tree ---------------------------------------------------------------------------------------------------

    def _closes(self, edge: _Edge) -> bool:
        """Return whether this format can close a loop by this joint."""
        used = self.coupled | {joint for motor in self.linkage.motors for joint, _ in motor.along}
        forced = (any((*x.damping, *x.stiffness, *x.friction, x.armature, *x.limits, x in used)) for x in edge.joints)
        return edge.kind in self.form.closures and not any(forced)

    def _tree(self) -> None:
        """Place bodies by joints from the ground outwards, first by those that cannot close loops; other bodies
        float."""
        ground, spatial = self.m.ground, self.m.spatial_ground
        bodies = [*self.m.bodies, *self.m.spatial_bodies]
        trees: dict[Any, set[Any]] = {body: {body} for body in bodies}
        trees[ground] = trees[spatial] = {ground, spatial}
        near: dict[Any, list[_Edge]] = {body: [] for body in trees}
        rest = []
        for edge in sorted(self.edges, key=lambda x: (self._closes(x), not x.placing, x.kind == "spherical")):
            one, two = (trees[body] for body in edge.ends)
            if one is two:
                rest.append(edge)
                continue
            one |= two
            trees |= dict.fromkeys(two, one)
            for body in edge.ends:
                near[body].append(edge)
        for root in (ground, spatial, *bodies):
            if root not in self.links:
                self._link(root, self._flying(root), None)
            waiting = [root]
            while waiting:
                here = waiting.pop()
                for edge in near.pop(here, ()):
                    other = edge.ends[edge.ends[0] is here]
                    if other not in self.links:
                        self._link(other, edge, self.links[here])
                        waiting.append(other)
        for edge in rest:
            self._close(edge)

    def _flying(self, body: Any) -> _Edge:
        """Return the free joint of a body that no joint connects to the ground."""
        pose, (velocity, spin) = self.poses[body], self.spins[body]
        edge = _Edge(body.name, (self.m.ground, body), "free", pose.place)
        if body in self.m.spatial_bodies:
            start = (*pose.place.tolist(), *quaternion(pose.turn).tolist())
            rates = (*velocity.tolist(), *(pose.turn.T @ spin).tolist())
            edge.joints = [Joint(self.fresh(f"{body.name}_free"), "free", self.node, start=start, rates=rates)]
            return edge
        frame, axes = self.kinematics.frame(body), np.eye(3)
        edge.point = self.number(ca.vertcat(frame.x, frame.y, 0.0)).ravel()
        self._move(edge, self.fresh(f"{body.name}_x"), "prismatic", axes[0], frame.x)
        self._move(edge, self.fresh(f"{body.name}_y"), "prismatic", axes[1], frame.y)
        self._move(edge, self.fresh(f"{body.name}_angle"), "revolute", axes[2], frame.angle)
        return edge

    def _link(self, body: Any, edge: _Edge, parent: Link | None, name: str = "") -> Link:
        """Add the link of a body, placed by a joint that begins or ends at it."""
        pose, before = self.poses[body], self.poses[edge.ends[edge.ends[0] is body]]
        forward = body is edge.ends[1]
        link = Link(name or body.name, self.node, parent, before.inverse @ pose, self.inertia[body])
        link.joints = edge.joints if forward else edge.joints[::-1]
        for joint in link.joints:
            joint.seen_from(pose, 1.0 if forward else -1.0)
        self.links.setdefault(body, link)
        self.linkage.links.append(link)
        return link

    def _close(self, edge: _Edge) -> None:
        """Close a loop by a joint, or by a weld between two halves of a body, one of which the joint places."""
        links = [self.links[body] for body in edge.ends]
        if self._closes(edge):
            frames = [self.poses[body].inverse @ Pose(edge.point, np.eye(3)) for body in edge.ends]
            joint = replace(edge.joints[0], name=edge.name) if edge.joints else Joint(edge.name, "weld", self.node)
            joint.kind, joint.axes = edge.kind, tuple(x.axes[0] for x in edge.joints if x.axes)
            self.linkage.closures.append(Closure(joint, (links[0], frames[0]), (links[1], frames[1])))
            return
        for k, body in ((1, edge.ends[1]), (0, edge.ends[0])):
            if (whole := links[k]) is not None and (x := whole.inertial).mass:
                self.inertia[body] = whole.inertial = Inertial(x.mass / 2, x.center, x.inertia / 2)
                half = self._link(body, edge, links[1 - k], self.fresh(f"{body.name}_half"))
                weld = Joint(self.fresh(f"{edge.name}_weld"), "weld", self.node)
                self.linkage.closures.append(Closure(weld, (half, Pose()), (whole, Pose())))
                return
        self.refuse(edge.name, f"its bodies have no mass, and {self.form.name} closes no loop by such a joint")

    def _merge(self) -> None:
        """Remove unneeded massless links, move their joints to their child, and sort parents before children."""
        links = self.linkage.links
        for link in list(links):
            children = [each for each in links if each.parent is link]
            closed = any(x[0] is link for c in self.linkage.closures for x in (c.first, c.second))
            free = any(joint.kind == "free" for joint in link.joints)
            needed = bool(link.joints) and (closed or len(children) != 1 or free or link.inertial.inertia.any())
            if link.inertial.mass or needed:
                continue
            if link.parent is not None and link.inertial.inertia.any():  # welded: its parent has its inertia, too
                turn, x = link.pose.turn, link.parent.inertial
                link.parent.inertial = replace(x, inertia=x.inertia + turn @ link.inertial.inertia @ turn.T)
            for child in children:
                for joint in link.joints:
                    joint.seen_from(child.pose, 1.0)
                child.joints = [*link.joints, *child.joints]
                child.parent, child.pose = link.parent, link.pose @ child.pose
            for closure in self.linkage.closures:
                closure.first, closure.second = (
                    (link.parent, link.pose @ frame) if of is link else (of, frame)
                    for of, frame in (closure.first, closure.second)
                )
            links.remove(link)
        waiting, found = [link for link in links if link.parent is None][::-1], []
        while waiting:
            found.append(link := waiting.pop())
            waiting += [each for each in links if each.parent is link][::-1]
            link.pose = Pose(cleaned(link.pose.place), link.pose.turn)
        self.linkage.links = found


def _squares(matrix: Array) -> list[tuple[float, Array]] | None:
    """Return sizes and factors of sums whose squares make up a symmetric matrix, by Cholesky's method with pivots; None
    if they would not all be positive."""
    found, left, tiny = list[tuple[float, Array]](), matrix, _SAME * np.abs(matrix).max(initial=0.0)
    while left.size and left.diagonal().max() > tiny:
        i = int(left.diagonal().argmax())
        size, factors = float(left[i, i]), left[i] / left[i, i]
        found.append((size, np.where(np.abs(factors) > _SAME, factors, 0.0)))
        left = left - size * np.outer(factors, factors)
    return found if np.abs(left).max(initial=0.0) <= tiny else None
