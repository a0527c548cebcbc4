"""Bodies in space: outward and inward recursions for relative coordinates, and outputs of all bodies.

A body is placed by a joint on another one, or by coordinates of its own. Each coordinate c has a column in its joint:
the angular velocity w and the velocity u of the body's anchor per unit of its rate. Accelerations are computed outwards
from body to body; forces and moments about the anchors are summed inwards, with the power w.n + u.f along c (Newton and
Euler). A column of the mass matrix is the momentum of all bodies that the joint carries, taken as one body. If a law or
an input moves the point of a joint on one of its bodies, the coordinates of that point have columns, too. Expressions
therefore grow linearly with the number of bodies, the mass matrix with the number of its entries. (Featherstone, Rigid
Body Dynamics Algorithms, chapters 5 and 6, in ground axes.)
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from ..model.errors import DeclarationError
from ..model.kinematics import Closing
from ..model.mechanism import Mechanism
from ..model.parts import Friction, Lock, Motion, Scalar, stack, symbolic
from ..model.relations import SpatialRolling
from ..model.spatial import SpatialBody, SpatialFreedom, SpatialJoint, SpatialMarker, angular_velocity, spin_matrix
from .types import Variable

Wrench = tuple[ca.SX, ca.SX]
"""A force (3,) and a moment (3,) about a body's anchor, in ground axes."""

Effort = tuple[SpatialJoint | SpatialFreedom | tuple[SpatialMarker, SpatialMarker], ca.SX]
"""An effort along a joint, or between two points, second from first."""


@dataclass(frozen=True)
class Column:
    """Angular velocity of a body and velocity of its anchor per unit rate of a coordinate."""

    coordinate: Scalar
    w: ca.SX
    u: ca.SX


@dataclass(frozen=True)
class Moving:
    """Motion of a body: angular velocity and its rate, velocity and acceleration of the anchor.

    `bending` (3, 3) maps an arm to the acceleration of its end relative to the anchor, w' x arm + w x (w x arm).
    """

    spin: ca.SX
    spin_rate: ca.SX
    speed: ca.SX
    acceleration: ca.SX

    @cached_property
    def bending(self) -> ca.SX:
        w, rate = self.spin, self.spin_rate
        squares = ca.SX.zeros(3, 3)
        for i in range(3):
            for j in range(3):
                squares[i, j] = w[i] * w[j] if i != j else -sum(w[k] ** 2 for k in range(3) if k != i)
        return ca.skew(rate) + squares


def relative_bodies(m: Mechanism) -> list[SpatialBody]:
    """Return the bodies placed by joints."""
    return [body for body in m.spatial_bodies if body.placed_by is not None]


def check_points(m: Mechanism) -> None:
    """Raise DeclarationError if coordinates move a point of a joint that places a body: the joint would do work."""
    own = stack([c.q for c in m.coordinates])
    for joint in (each for each in m.spatial_joints if each.coordinates is not None and m.coordinates):
        for marker in (joint.first, joint.second):
            if ca.depends_on(stack(marker.point), own):
                raise DeclarationError(
                    f"{m.name}: a point of {marker.body.name}{m.declared_at(joint.name)} at which {joint.name} places "
                    f"{joint.second.body.name} depends on coordinates; parameters, time and inputs may move it, or "
                    f"give {joint.second.body.name} coordinates of its own (leave out relative)"
                )


class SpatialMotion:
    """Motion of bodies in space at rates v and accelerations a (zero if left out)."""

    def __init__(self, mechanism: Mechanism, q: ca.SX, v: ca.SX, a: ca.SX | None = None):
        self.mechanism, self.q, self.v, self.a = mechanism, q, v, a
        self.order: list[SpatialBody] = []
        """Bodies without the ground, each after the one that carries it."""
        for body in mechanism.spatial_bodies:
            self._add(body)
        self._moving: dict[SpatialBody, Moving] = {}
        self._columns: dict[SpatialBody, list[Column]] = {}
        self._inertia: dict[SpatialBody, ca.SX] = {}

    def _add(self, body: SpatialBody) -> None:
        if body is not self.mechanism.spatial_ground and body not in self.order:
            if body.placed_by is not None:
                self._add(body.placed_by.first.body)
            self.order.append(body)

    # Outwards ---------------------------------------------------------------------------------------------------

    def columns(self, body: SpatialBody) -> list[Column]:
        """Return the columns of the coordinates that place a body."""
        if body not in self._columns:
            if body.own is not None:
                place, attitude = body.own
                nothing, matrix = ca.SX.zeros(3), spin_matrix(attitude)
                found = [Column(place[i], nothing, ca.SX([i == k for k in range(3)])) for i in range(3)]
                found += [Column(attitude[i], matrix[:, i], nothing) for i in range(4)]
            else:
                joint = self._joint(body)
                found = self._of_joint(joint)
                if joint.drifts:
                    found = [Column(c.coordinate, c.w, c.u + ca.cross(c.w, joint.reach)) for c in found]
                    found += self._moved(joint.beyond, body)
            self._columns[body] = found
        return self._columns[body]

    def _of_joint(self, joint: SpatialJoint) -> list[Column]:
        """Return columns of a joint's coordinates for its second body at the joint's point, and of coordinates that
        move that point on the first body."""
        first = joint.first.body
        found = [Column(c, *column) for c, column in zip(joint.coordinates or (), joint.columns, strict=True)]
        return found + self._moved(stack(joint.first.point) - stack(first.anchor[0]), first)

    def _moved(self, local: ca.SX, body: SpatialBody) -> list[Column]:
        """Return columns of the moving coordinates among the three of a point in a body's frame."""
        return [
            Column(x, ca.SX.zeros(3), body.rotation[:, i])
            for i, x in enumerate(ca.vertsplit(local))
            if ca.depends_on(x, self.q)
        ]

    @staticmethod
    def _joint(body: SpatialBody) -> SpatialJoint:
        assert body.placed_by is not None
        return body.placed_by

    def rates(self, coordinate: Scalar) -> tuple[ca.SX, ca.SX]:
        """Return first and second rate of an expression in the coordinates."""
        c = symbolic(coordinate)
        rate = ca.jtimes(c, self.q, self.v)
        second = ca.jtimes(rate, self.q, self.v)
        return rate, second if self.a is None else second + ca.jtimes(c, self.q, self.a)

    def moving(self, body: SpatialBody) -> Moving:
        """Return the motion of a body."""
        if body not in self._moving:
            self._moving[body] = self._worked_out(body)
        return self._moving[body]

    def _worked_out(self, body: SpatialBody) -> Moving:
        nothing = ca.SX.zeros(3)
        if body is self.mechanism.spatial_ground:
            return Moving(nothing, nothing, nothing, nothing)
        joint = body.placed_by
        if joint is None:  # the angular velocity is linear in the rates, so its rate without accelerations vanishes
            before, arm = Moving(nothing, nothing, nothing, nothing), nothing
        else:
            before, arm = self.moving(joint.first.body), joint.first.arm + joint.slide
        spin, spin_rate, slip, push = before.spin, before.spin_rate, nothing, nothing
        carrier = before.spin
        for column in self.columns(body) if joint is None else self._of_joint(joint):
            rate, second = self.rates(column.coordinate)
            turn = column.w * rate
            spin_rate = spin_rate + ca.cross(carrier, turn) + column.w * second
            spin, slip, push = spin + turn, slip + column.u * rate, push + column.u * second
            if joint is not None and joint.kind == "universal":  # the second axis turns with the first
                carrier = carrier + turn
        speed = before.speed + ca.cross(before.spin, arm) + slip
        carried = before.acceleration + before.bending @ arm + 2 * ca.cross(before.spin, slip)
        found = Moving(spin, spin_rate, speed, carried + push)
        if joint is None or not joint.drifts:
            return found
        rates = [self.rates(x) for x in ca.vertsplit(joint.beyond)]
        slip, push = (body.rotation @ ca.vertcat(*each) for each in zip(*rates, strict=True))
        carried = found.acceleration + found.bending @ joint.reach + 2 * ca.cross(spin, slip)
        return Moving(spin, spin_rate, speed + ca.cross(spin, joint.reach) + slip, carried + push)

    def velocity(self, marker: SpatialMarker) -> ca.SX:
        """Return velocity (3,) of a point."""
        moving = self.moving(marker.body)
        return moving.speed + ca.cross(moving.spin, marker.arm)

    def acceleration(self, marker: SpatialMarker) -> ca.SX:
        """Return acceleration (3,) of a point."""
        moving = self.moving(marker.body)
        return moving.acceleration + moving.bending @ marker.arm

    # Back -------------------------------------------------------------------------------------------------------

    def inertia(self, body: SpatialBody) -> ca.SX:
        """Return the matrix of inertia (3, 3) about the centre of mass in ground axes."""
        if body not in self._inertia:
            J = body.inertia_matrix
            turned = body.rotation @ J @ body.rotation.T
            self._inertia[body] = ca.triu2symm(ca.triu(turned))
        return self._inertia[body]

    def inertial(self, bodies: Sequence[SpatialBody]) -> dict[SpatialBody, Wrench]:
        """Return inertia loads: mass times acceleration, and the rate of the angular momentum."""
        found = {}
        for body in bodies:
            moving, lever, J = self.moving(body), body.turned(body.center), self.inertia(body)
            force = body.mass * (moving.acceleration + moving.bending @ lever)
            moment = J @ moving.spin_rate + ca.cross(moving.spin, J @ moving.spin)
            found[body] = force, moment + ca.cross(lever, force)
        return found

    def carried(self, loads: Mapping[SpatialBody, Wrench]) -> dict[SpatialBody, Wrench]:
        """Return the load that each body transmits for itself and all bodies that it carries."""
        found = dict(loads)
        for body in reversed(self.order):
            if body in found and body.placed_by is not None:
                joint, (force, moment) = body.placed_by, found[body]
                arm = _way(joint)
                _add_to(found, joint.first.body, (force, moment + ca.cross(arm, force)))
        return found

    def along(self, loads: Mapping[SpatialBody, Wrench]) -> ca.SX:
        """Return generalised forces (n,) of loads on bodies."""
        coordinates, efforts = [], []
        for body, (force, moment) in self.carried(loads).items():
            if body is not self.mechanism.spatial_ground:
                for column in self.columns(body):
                    coordinates.append(column.coordinate)
                    efforts.append(ca.dot(column.w, moment) + ca.dot(column.u, force))
        return ca.jacobian(stack(coordinates), self.q).T @ stack(efforts) if efforts else ca.SX(self.q.numel(), 1)

    def mass_matrix(self, bodies: Sequence[SpatialBody]) -> ca.SX:
        """Return the mass matrix (n, n) of bodies, from the bodies that each joint carries."""
        whole: dict[SpatialBody, tuple[ca.SX, ca.SX, ca.SX]] = {}  # mass, first moment, inertia about the anchor
        for body in bodies:
            lever, mass = body.turned(body.center), symbolic(body.mass)
            whole[body] = mass, mass * lever, self.inertia(body) + mass * _square(lever, lever)
        entries: dict[tuple[int, int], ca.SX] = {}
        coordinates: list[Scalar] = []
        first: dict[SpatialBody, int] = {}
        for body in self.order:
            first[body] = len(coordinates)
            coordinates += [column.coordinate for column in self.columns(body)]
        for body in reversed(self.order):
            if body not in whole:
                continue
            mass, moment, inertia = whole[body]
            joint = body.placed_by
            for j, column in enumerate(self.columns(body), first[body]):
                momentum = mass * column.u + ca.cross(column.w, moment)
                turning = inertia @ column.w + ca.cross(moment, column.u)
                at = body
                for i, each in enumerate(self.columns(body)[: j - first[body] + 1], first[body]):
                    entries[i, j] = ca.dot(each.w, turning) + ca.dot(each.u, momentum)
                while at.placed_by is not None and at.placed_by.first.body is not self.mechanism.spatial_ground:
                    arm = _way(at.placed_by)
                    turning = turning + ca.cross(arm, momentum)
                    at = at.placed_by.first.body
                    for i, each in enumerate(self.columns(at), first[at]):
                        entries[i, j] = ca.dot(each.w, turning) + ca.dot(each.u, momentum)
            if joint is not None and (carrier := joint.first.body) is not self.mechanism.spatial_ground:
                arm = _way(joint)
                shifted = inertia + mass * _square(arm, arm) + _square(arm, moment) + _square(moment, arm)
                before = whole.get(carrier, (ca.SX(0), ca.SX.zeros(3), ca.SX.zeros(3, 3)))
                more = mass, moment + mass * arm, shifted
                whole[carrier] = before[0] + more[0], before[1] + more[1], before[2] + more[2]
        k = len(coordinates)
        M = ca.SX(k, k)
        for (i, j), entry in entries.items():
            if not entry.is_zero():
                M[i, j] = M[j, i] = entry
        U = ca.jacobian(stack(coordinates), self.q)
        return U.T @ M @ U


def _way(joint: SpatialJoint) -> ca.SX:
    """Return the vector (3,) from the anchor of the first body of a joint to that of the second, in ground axes."""
    way = joint.first.arm + joint.slide
    return way + joint.reach if joint.drifts else way


def _add_to(loads: dict[SpatialBody, Wrench], body: SpatialBody, wrench: Wrench) -> None:
    force, moment = wrench
    before = loads.get(body)
    loads[body] = wrench if before is None else (before[0] + force, before[1] + moment)


def _square(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return a.b 1 - b a': for b = a the inertia of 1 kg at a."""
    return ca.dot(a, b) * ca.SX.eye(3) - b @ a.T


# Applied loads --------------------------------------------------------------------------------------------------------


def gravity(m: Mechanism, bodies: Sequence[SpatialBody]) -> dict[SpatialBody, Wrench]:
    """Return the weight of bodies."""
    weights = {body: body.mass * stack(m.gravity_vector) for body in bodies}
    return {body: (force, ca.cross(body.turned(body.center), force)) for body, force in weights.items()}


def loads(m: Mechanism) -> dict[SpatialBody, Wrench]:
    """Return forces and torques declared on bodies in space."""
    found: dict[SpatialBody, Wrench] = {}
    for load in m.spatial_loads:
        _push(found, load.at, stack(load.force), stack(load.torque))
    return found


def applied(
    m: Mechanism, efforts: Sequence[Effort], closures: Sequence[Closing], lam: ca.SX
) -> dict[SpatialBody, Wrench]:
    """Return all loads on bodies in space except those of joints with coordinates.

    These are weights, declared loads, efforts and reactions of joints that constraints close. `efforts` act along
    joints, or push two points apart. Those along a joint with coordinates are left out, as their pair of forces does
    nothing to any other joint.
    """
    found = dict(gravity(m, m.spatial_bodies))
    for body, wrench in loads(m).items():
        _add_to(found, body, wrench)
    for between, effort in efforts:
        if isinstance(between, tuple):
            apart = between[1].place - between[0].place
            _pair(found, *between, effort / ca.norm_2(apart) * apart, ca.SX.zeros(3))
        else:
            _effort(found, between, effort)
    multipliers: dict[SpatialJoint | SpatialRolling, dict[str, ca.SX]] = {}
    for (closure, direction), x in zip(closures, ca.vertsplit(lam), strict=True):
        if isinstance(closure, SpatialJoint | SpatialRolling):
            multipliers.setdefault(closure, {})[direction] = x
        elif isinstance(closure, Lock | Motion) and isinstance(closure.of, SpatialJoint | SpatialFreedom):
            beside = closure.of.measured - (0.0 if closure.value is None else closure.value)
            beside -= closure.law if isinstance(closure, Motion) else 0.0
            turned = closure.of.wrapped and not isinstance(closure, Friction)
            _effort(found, closure.of, -(ca.cos(beside) if turned else 1.0) * x)
    for each, own in multipliers.items():
        if isinstance(each, SpatialRolling):
            _push(found, each.centre, *each.wrench(own))
        else:
            _pair(found, each.first, each.second, *each.reaction(own))
    return found


def _effort(found: dict[SpatialBody, Wrench], along: SpatialJoint | SpatialFreedom, effort: ca.SX) -> None:
    """Add an effort along a free motion of a joint that constraints close."""
    joint = along.joint if isinstance(along, SpatialFreedom) else along
    which = along.which if isinstance(along, SpatialFreedom) else next(iter(joint.freedoms))
    if joint.coordinates is None:
        w, u = joint.columns[list(joint.freedoms).index(which)]
        force = u * effort if joint.freedoms[which] == "m" else ca.SX.zeros(3)  # a drive of a screw turns it
        _pair(found, joint.first, joint.second, force, w * effort)


def _pair(
    found: dict[SpatialBody, Wrench], first: SpatialMarker, second: SpatialMarker, force: ca.SX, moment: ca.SX
) -> None:
    """Add a force at the second point and a moment on the second body, and the opposite, on the same line, on the
    first."""
    _push(found, second, force, moment)
    across = second.place - first.place
    _push(found, first, -force, -moment - ca.cross(across, force))


def _push(found: dict[SpatialBody, Wrench], at: SpatialMarker, force: ca.SX, moment: ca.SX) -> None:
    _add_to(found, at.body, (force, moment + ca.cross(at.arm, force)))


# Outputs --------------------------------------------------------------------------------------------------------------


def reaction(joint: SpatialJoint, force: ca.SX, moment: ca.SX) -> Wrench:
    """Return the part of a joint's load that does no work in its free motions."""
    columns = joint.columns
    axis = joint.triad()[2]
    if joint.kind in ("prismatic", "cylindrical"):
        force = force - axis * ca.dot(axis, force)
    if joint.kind in ("revolute", "cylindrical", "planar"):
        moment = moment - axis * ca.dot(axis, moment)
    if joint.kind == "planar":
        force = axis * ca.dot(axis, force)
    if joint.kind == "screw":
        moment = moment - axis * (ca.dot(axis, moment) + joint.lead / (2 * math.pi) * ca.dot(axis, force))
    if joint.kind == "universal":
        both = ca.cross(columns[0][0], columns[1][0])
        moment = both * ca.dot(both, moment)
    return force, moment


def outputs(
    m: Mechanism, q: ca.SX, v: ca.SX, a: ca.SX, closures: Sequence[Closing], lam: ca.SX, efforts: Sequence[Effort]
) -> tuple[list[ca.SX], list[Variable]]:
    """Return the motion of every body in space, and free motions and reaction of every joint between such bodies."""

    def rate(x: ca.SX) -> ca.SX:
        return ca.jtimes(x, q, v) + ca.jtimes(x, v, a)

    values: list[ca.SX] = []
    found: list[Variable] = []

    def add(name: str, vector: ca.SX, unit: str, text: str) -> None:
        """Add a number, or a vector by components; {} is the axis in the name, ` along {}` in the text."""
        for axis, x in zip("xyz", ca.vertsplit(vector), strict=False):
            values.append(x)
            found.append(Variable(name.format(axis), unit, description=text.format(axis)))

    tree = relative_bodies(m)
    motion = SpatialMotion(m, q, v, a) if tree else None
    needed: dict[SpatialBody, Wrench] = {}
    if motion is not None:
        balance = motion.inertial(motion.order)
        for body, (force, moment) in applied(m, efforts, closures, lam).items():
            _add_to(balance, body, (-force, -moment))
        needed = motion.carried(balance)
    for body in m.spatial_bodies:
        b, r, e = body.name, body.position, body.attitude
        if motion is not None and body.placed_by is not None:
            center, moving = body.at(*body.center), motion.moving(body)
            speed, acceleration = motion.velocity(center), motion.acceleration(center)
            spin, spin_rate = moving.spin, moving.spin_rate
        else:
            speed, acceleration = rate(r), rate(rate(r))
            spin = angular_velocity(e, ca.jtimes(e, q, v))
            spin_rate = rate(spin)
        add(b + ".{}", r, "m", f"position of the centre of mass of {b} along {{}}")
        add(b + ".v{}", speed, "m/s", f"velocity of the centre of mass of {b} along {{}}")
        add(b + ".a{}", acceleration, "m/s2", f"acceleration of the centre of mass of {b} along {{}}")
        for i, x in enumerate(ca.vertsplit(e)):
            add(f"{b}.e{i}", x, "1", f"Euler parameter {i} of {b}")
        add(b + ".angular_velocity.{}", spin, "rad/s", f"angular velocity of {b} along {{}}")
        add(b + ".angular_acceleration.{}", spin_rate, "rad/s2", f"angular acceleration of {b} along {{}}")
    sliders = Counter(j.second.body for j in m.spatial_joints if j.kind == "prismatic")
    for joint in m.spatial_joints:
        j, pair = joint.name, f"{joint.second.body.name} from {joint.first.body.name}"
        for which, unit in joint.freedoms.items():
            x, number = joint.displacement(which), which[len(which.rstrip("12")) :]
            if unit == "rad":
                add(f"{j}.{which}", x, "rad", f"angle of {pair}" + _about(joint, which))
                add(f"{j}.angular_velocity{number}", rate(x), "rad/s", f"rate of {j}.{which}")
                add(f"{j}.angular_acceleration{number}", rate(rate(x)), "rad/s2", f"second rate of {j}.{which}")
            elif joint.kind != "prismatic" or sliders[joint.second.body] == 1:
                on = joint.second.body.name if joint.kind == "prismatic" else j
                of = f"{joint.second.body.name} along {j}"
                add(f"{on}.{which}", x, "m", f"position of {of}" + _about(joint, which))
                add(f"{on}.velocity{number}", rate(x), "m/s", f"velocity of {of}" + _about(joint, which))
                add(f"{on}.acceleration{number}", rate(rate(x)), "m/s2", f"acceleration of {of}" + _about(joint, which))
        own = {direction: x for (c, direction), x in zip(closures, ca.vertsplit(lam), strict=True) if c is joint}
        if joint.kind == "distance":
            add(f"{j}.force", -own["length"], "N", f"force on {pair}, positive when the joint pushes")
            continue
        force, moment = joint.reaction(own)
        if joint.coordinates is not None:
            force, moment = needed[joint.second.body]
            moment = moment + ca.cross(joint.reach, force) if joint.drifts else moment
            for law, effort in _driven(m, joint, force, moment, efforts):
                what, unit = ("torque", "N.m") if law.kind == "revolute" else ("driving_force", "N")
                name = j if len(joint.freedoms) == 1 else law.name
                add(f"{name}.{what}", effort, unit, f"{what.replace('_', ' ')} that the motion takes, on {pair}")
            force, moment = reaction(joint, force, moment)
        add(j + ".force.{}", force, "N", f"force along {{}} on {pair}")
        if joint.kind != "spherical":
            add(
                j + ".moment.{}",
                moment,
                "N.m",
                f"moment along {{}} on {pair}, about the joint's point on {joint.second.body.name}",
            )
    return values, found


def _driven(
    m: Mechanism, joint: SpatialJoint, force: ca.SX, moment: ca.SX, efforts: Sequence[Effort]
) -> list[tuple[SpatialFreedom, ca.SX]]:
    """Return free motions of a joint that laws of time prescribe, and the share of the joint's load that each takes."""
    found, own = [], stack([c.q for c in m.coordinates])
    for which, coordinate, (w, u) in zip(joint.freedoms, joint.coordinates or (), joint.columns, strict=False):
        x = symbolic(coordinate)
        if ca.depends_on(x, m.time) and not ca.depends_on(x, own):
            along = joint.freedom(which)
            others = [x for of, x in efforts if of == along or (of is joint and len(joint.freedoms) == 1)]
            found.append((along, ca.dot(w, moment) + ca.dot(u, force) - sum(others, ca.SX(0))))
    return found


def _about(joint: SpatialJoint, which: str) -> str:
    """Return the description of one of several free motions of a kind in a joint."""
    return {
        "angle1": f", about the axis of {joint.name} on the first",
        "angle2": f", about the axis of {joint.name} on the second",
        "position1": ", along its first normal",
        "position2": ", along its second normal",
    }.get(which, "")
