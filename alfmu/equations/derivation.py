"""Mechanism -> Equations: every matrix, energy, output and reaction by symbolic differentiation.

The inertia of a mechanism is a set of displacements X(q) with weights w (place of a centre of mass with the mass, angle
with the inertia), so that

    T = v' M v / 2,  M = X_q' w X_q,  d = X_q' w (d(X_q)/dt) v.

Reactions are found in one way, whether a joint is closed by a coordinate or by constraints: each suppressed direction
of a joint gets a virtual displacement eps that moves the second body away from the first, and the reaction is the
generalised force that holds eps at zero,

    r = X_eps' w a_X + V_eps - s_eps' F + Phi_eps' lambda   at eps = 0,

with a_X the accelerations of X, V the potential, s the displacements along which efforts F act. Bodies in space that
joints place have recursions of their own (`equations.space`).

Where places, constraints or energies depend on time, time is the last coordinate, with the rate 1: X(q, t) is X of all
coordinates, and d/dt of anything contains its partial time derivatives. So C v + Phi_t = 0 for (2), and xi has what
(3) then needs. No force moves that coordinate: its row of M, d, f and its column of C are empty, but for a number on
the diagonal of M that keeps its acceleration at zero (`STEADY`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from ..model.doubts import doubt
from ..model.errors import AssemblyError, DeclarationError
from ..model.mechanism import (
    AnyJoint,
    AnyMarker,
    Body,
    Constraint,
    Coordinate,
    Friction,
    Joint,
    Lock,
    Marker,
    Mechanism,
    Motion,
    Point,
    Rigidity,
    Scalar,
    key_of,
    stack,
    symbolic,
)
from ..model.relations import Relation
from ..model.spatial import SpatialFreedom, SpatialJoint, SpatialMarker, with_turns
from ..model.stops import EndStop
from ..model.units import rate_of
from . import space
from .evaluation import ARGUMENTS, evaluable, shared
from .friction import rubbing
from .interface import variables_of
from .measures import measures
from .types import Equations, Followed, Leap, Row, Switch, Variable

__all__ = ["derive"]

STEADY = 1e-9
"""diagonal entry of M for time over the mean of masses and inertias [1]: small, so that no measure of M sees it."""


@dataclass
class Frame:
    """Place of a body: the point with local coordinates `local` is at (x, y), the x axis points along (ex, ey)."""

    x: ca.SX
    y: ca.SX
    local: tuple[Scalar, Scalar]
    ex: ca.SX
    ey: ca.SX
    angle: ca.SX
    wrapped: bool = False
    """Whether the angle is known up to whole turns only."""
    turned: ca.SX | None = None
    """The angle with its turns, where it is not."""

    @property
    def counted(self) -> ca.SX:
        """The angle with its turns, which a run counts where places tell it up to whole turns only."""
        return self.angle if self.turned is None else self.turned

    def turn(self, x: Scalar, y: Scalar) -> tuple[ca.SX, ca.SX]:
        """A vector of the body's frame in ground axes."""
        if _vanishes(y):
            return (x, y) if _vanishes(x) else (self.ex * x, self.ey * x)
        return self.ex * x - self.ey * y, self.ey * x + self.ex * y

    def place(self, x: Scalar, y: Scalar) -> tuple[ca.SX, ca.SX]:
        """A point of the body's frame in ground axes."""
        dx, dy = self.turn(_sum(x, -self.local[0]), _sum(y, -self.local[1]))
        return _sum(self.x, dx), _sum(self.y, dy)


Closure = AnyJoint | Rigidity | Constraint | Lock | Motion | Relation
"""What constraints close."""

Closing = tuple[Closure, str]
"""One relative displacement that is kept at zero: of what, and in which direction."""

FREE = "free"
"""The direction in which a joint moves by a law that is its coordinate."""

Displacement = dict[str, ca.SX]
"""Virtual displacement of a joint: direction -> symbol."""


class Kinematics:
    """Places of all bodies and residuals of all closures as expressions in q, and in virtual displacements if given.

    What has been worked out once is kept.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        held: Mapping[Joint, tuple[str, ...]] | None = None,
        eps: Mapping[Joint, Displacement] | None = None,
    ):
        self.mechanism = mechanism
        self.eps: dict[Joint, Displacement] = {joint: e for joint, e in (eps or {}).items() if e}
        self.held: dict[Body, list[Joint]] = {}
        for joint in held or ():
            if joint in self.eps:
                self.held.setdefault(joint.second.body, []).append(joint)
        self.frames: dict[Body, Frame] = {mechanism.ground: _absolute(0.0, 0.0, 0.0, (0.0, 0.0))}
        self.places: dict[Marker | Body, tuple[ca.SX, ca.SX]] = {}
        self.order: dict[Body, int] = {body: i for i, body in enumerate([mechanism.ground, *mechanism.bodies])}
        self.links: dict[tuple[Body, int | None], list[tuple[Joint, int, tuple[Body, int | None]]]] = {}
        self.spans: dict[Body, tuple[ca.SX, ca.SX, ca.SX, ca.SX]] = {}
        self.squares: dict[Joint | Rigidity, ca.SX] = {}
        self.residuals: dict[Closing, ca.SX] = {}
        self.pending: list[Body] = []

    def frame(self, body: Body) -> Frame:
        if body in self.frames:
            return self.frames[body]
        name = self.mechanism.name
        if body in self.pending:
            loop = " -> ".join(b.name for b in [*self.pending, body])
            raise DeclarationError(f"{name}: bodies place each other in a circle ({loop}); give one of them a pose")
        self.pending.append(body)
        if body.pose is not None:
            frame = _absolute(*body.pose, body.center)
        elif body.between is not None:
            frame = self._between(body)
        elif body.placed_by is not None:
            frame = self._by_joint(body, body.placed_by)
        else:
            raise DeclarationError(
                f"{name}: nothing places {body.name}{self.mechanism.declared_at(body.name)}; give it a pose, or give "
                "one of its joints a coordinate"
            )
        if body.between is None:
            for joint in self.held.get(body, ()):
                frame = self._displaced(frame, joint)
        self.pending.pop()
        self.frames[body] = frame
        return frame

    def place(self, at: Marker | Point) -> tuple[ca.SX, ca.SX]:
        """A marker or point in ground axes."""
        if isinstance(at, Point):
            return symbolic(at.x), symbolic(at.y)
        if at not in self.places:
            self.places[at] = self.frame(at.body).place(at.x, at.y)
        return self.places[at]

    def center(self, body: Body) -> tuple[ca.SX, ca.SX]:
        """The centre of mass of a body in ground axes."""
        if body not in self.places:
            self.places[body] = self.frame(body).place(*body.center)
        return self.places[body]

    def axes(self, joint: Joint) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Direction of a guide and its left normal."""
        ux, uy = self.frame(joint.first.body).turn(*_cis(joint.axis))
        return ux, uy, -uy, ux

    def free(self, joint: AnyJoint) -> ca.SX:
        """The free displacement of a revolute (angle) or prismatic (place) joint, second body from first."""
        if isinstance(joint, SpatialJoint | SpatialFreedom):
            return joint.free
        if joint.kind == "revolute":
            return self.frame(joint.second.body).angle - self.frame(joint.first.body).angle
        (x1, y1), (x2, y2) = self.place(joint.first), self.place(joint.second)
        ux, uy, _, _ = self.axes(joint)
        return ux * (x2 - x1) + uy * (y2 - y1)

    def counted(self, joint: AnyJoint) -> ca.SX:
        """The free displacement, an angle with its turns: for what depends on how far it is."""
        if isinstance(joint, SpatialFreedom):
            return joint.joint.counted(joint.which)
        if isinstance(joint, SpatialJoint):
            return joint.counted(next(iter(joint.freedoms)))
        if joint.kind == "revolute":
            return self.frame(joint.second.body).counted - self.frame(joint.first.body).counted
        return self.free(joint)

    def distance(self, between: tuple[AnyMarker, AnyMarker]) -> ca.SX:
        if isinstance(between[0], SpatialMarker):
            return ca.norm_2(between[1].place - between[0].place)
        (x1, y1), (x2, y2) = (self.place(m) for m in between)
        return ca.sqrt((x2 - x1) ** 2 + (y2 - y1) ** 2)

    def locked(self, lock: Lock | Motion) -> tuple[ca.SX, bool]:
        """The displacement that a lock or a motion keeps, and whether it is an angle known up to whole turns only.

        Of a motion it is what is beside its law.
        """
        value, wrapped = self._displacement(lock.of)
        return value - lock.law if isinstance(lock, Motion) else value, wrapped

    def _displacement(self, of: AnyJoint | SpatialFreedom | tuple[Body, Body] | ca.SX) -> tuple[ca.SX, bool]:
        if isinstance(of, ca.SX):
            return of, False
        if isinstance(of, SpatialJoint | SpatialFreedom):
            return of.free, of.wrapped
        if isinstance(of, Joint):
            turns = of.kind == "revolute"
            bodies, value = (of.first.body, of.second.body), self.free(of)
        else:
            turns, bodies = True, of
            value = self.frame(bodies[1]).angle - self.frame(bodies[0]).angle
        return value, turns and any(self.frame(body).wrapped for body in bodies)

    def gap(self, closure: Closure, direction: str) -> ca.SX:
        """The residual to first order where it is small; farther off in metres, and not zero half a turn away."""
        if isinstance(closure, SpatialJoint):
            return closure.gap(direction)
        if direction == "length":
            square, length = self._apart(closure)
            return ca.sqrt(square + 1e-300) - length
        if isinstance(closure, Motion) and self.locked(closure)[1]:
            beside = self._beside(closure)
            return ca.atan2(ca.sin(beside), ca.cos(beside))
        if isinstance(closure, Joint) and direction == "rotation":
            first, second = self.frame(closure.first.body), self.frame(closure.second.body)
            if first.wrapped or second.wrapped:
                ex, ey = first.turn(*_cis(closure.angle))
                return ca.atan2(ex * second.ey - ey * second.ex, ex * second.ex + ey * second.ey)
        return self.residual(closure, direction)

    def residual(self, closure: Closure, direction: str) -> ca.SX:
        """What a closure keeps at zero along one direction.

        For lengths it is zero at the given one, polynomial, and with a multiplier that is the force along the line.
        """
        if (closure, direction) not in self.residuals:
            self.residuals[closure, direction] = self._residual(closure, direction)
        return self.residuals[closure, direction]

    def _residual(self, closure: Closure, direction: str) -> ca.SX:
        if isinstance(closure, Constraint):
            return closure.expression
        if isinstance(closure, Relation):
            return closure.residual(self, direction)
        if isinstance(closure, SpatialJoint):
            return closure.residual(direction)
        if isinstance(closure, Lock | Motion):
            beside = self._beside(closure)
            if not self.locked(closure)[1]:
                return beside
            # The multiplier of friction is the torque wherever the joint slides, far from where it stuck.
            return ca.remainder(beside, 2 * math.pi) if isinstance(closure, Friction) else ca.sin(beside)
        if direction == "length":
            square, length = self._apart(closure)
            return (square - length**2) / (2 * length)
        (x1, y1), (x2, y2) = self.place(closure.first), self.place(closure.second)
        if direction == "x":
            return x2 - x1
        if direction == "y":
            return y2 - y1
        if direction == "normal":
            _, _, nx, ny = self.axes(closure)
            return nx * (x2 - x1) + ny * (y2 - y1) - closure.offset
        first, second = self.frame(closure.first.body), self.frame(closure.second.body)
        if not (first.wrapped or second.wrapped):
            return second.angle - first.angle - closure.angle
        ex, ey = first.turn(*_cis(closure.angle))
        return ex * second.ey - ey * second.ex

    def _beside(self, closure: Lock | Motion) -> ca.SX:
        """How far a displacement is from where a lock or a motion keeps it."""
        value, _ = self.locked(closure)
        return value if closure.value is None else value - closure.value

    def _apart(self, closure: Joint | Rigidity) -> tuple[ca.SX, Scalar]:
        """The square of the distance of two points, and the distance that a closure keeps between them."""
        if closure not in self.squares:
            if isinstance(closure, Rigidity):
                _, _, dx, dy = self._span(closure.body)
            else:
                (x1, y1), (x2, y2) = self.place(closure.first), self.place(closure.second)
                dx, dy = x2 - x1, y2 - y1
            self.squares[closure] = dx**2 + dy**2
        return self.squares[closure], closure.body.length if isinstance(closure, Rigidity) else closure.length

    def _span(self, body: Body) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """The first point of a body between points, and the way from there to the second."""
        if body not in self.spans:
            ends = []
            for anchor, marker in zip(body.between, (body.start, body.end), strict=True):
                (x, y), (dx, dy) = self.place(anchor), self._shift(marker)
                ends.append((x + dx, y + dy))
            (x1, y1), (x2, y2) = ends
            self.spans[body] = x1, y1, x2 - x1, y2 - y1
        return self.spans[body]

    def _shift(self, end: Marker) -> tuple[Scalar, Scalar]:
        """Virtual displacement of an end of a body between points.

        The joints at a point tie its bodies into a tree; what one of them displaces, all that hangs on it follows. The
        root is a body that no points carry, or the one declared first.
        """
        if not self.links:
            carried = [joints for body, joints in self.held.items() if body.between is not None]
            for joint in (j for joints in carried for j in joints):
                first, second = self._node(joint.first), self._node(joint.second)
                self.links.setdefault(first, []).append((joint, -1, second))
                self.links.setdefault(second, []).append((joint, 1, first))
        start = self._node(end)
        if start not in self.links:
            return 0.0, 0.0
        ways = {start: (0.0, 0.0)}
        pending = [start]
        while pending:
            node = pending.pop()
            if node[1] is None:  # other points of this body have trees of their own
                continue
            x, y = ways[node]
            for joint, sign, other in self.links.get(node, ()):
                if other not in ways:
                    e = self.eps.get(joint, {})
                    ways[other] = x + sign * e.get("x", 0), y + sign * e.get("y", 0)
                    pending.append(other)
        return ways[min(ways, key=lambda node: (node[1] is not None, self.order[node[0]], node[1] or 0))]

    def _node(self, marker: Marker) -> tuple[Body, int | None]:
        """A body with the number of its end where two points carry it, otherwise with None."""
        body = marker.body
        if body.between is not None:
            for i, end in enumerate((body.start, body.end)):
                if _same(marker.x, end.x) and _same(marker.y, end.y):
                    return body, i
        return body, None

    def _between(self, body: Body) -> Frame:
        x, y, dx, dy = self._span(body)
        ex, ey = dx / body.length, dy / body.length
        return Frame(x, y, (0.0, 0.0), ex, ey, ca.atan2(ey, ex), True, with_turns(ey, ex, body.near))

    def _by_joint(self, body: Body, joint: Joint) -> Frame:
        e = self.eps.get(joint, {})
        ex, ey, er = e.get("x", 0), e.get("y", 0), e.get("rotation", 0)
        angle = joint.coordinate + e.get(FREE, 0) if joint.kind == "revolute" else joint.angle + er
        along = joint.coordinate + e.get(FREE, 0) if joint.kind == "prismatic" else 0.0
        across = joint.offset + e.get("normal", 0)
        forward = body is joint.second.body
        if forward:
            other, marker = joint.first, joint.second
            base = self.frame(other.body)
            frame = _turned(base, angle, (marker.x, marker.y))
            guide = base
        else:
            other, marker = joint.second, joint.first
            frame = _turned(self.frame(other.body), -angle, (marker.x, marker.y))
            guide = frame
        x, y = self.place(other)
        if joint.kind == "prismatic":
            c, s = _cis(joint.axis)
            dx, dy = guide.turn(c * along - s * across, s * along + c * across)
        else:
            dx, dy = ex, ey
        sign = 1 if forward else -1
        frame.x, frame.y = x + sign * dx, y + sign * dy
        return frame

    def _displaced(self, frame: Frame, joint: Joint) -> Frame:
        """A body in absolute coordinates, displaced at a joint that its pose closes."""
        e = self.eps[joint]
        x, y = frame.place(joint.second.x, joint.second.y)
        moved = _turned(frame, e["rotation"], (joint.second.x, joint.second.y)) if "rotation" in e else frame
        dx, dy = e.get("x", 0), e.get("y", 0)
        if "normal" in e:
            _, _, nx, ny = self.axes(joint)
            dx, dy = dx + nx * e["normal"], dy + ny * e["normal"]
        return replace(moved, x=x + dx, y=y + dy, local=(joint.second.x, joint.second.y))


def derive(mechanism: Mechanism) -> Equations:
    """All equations of a mechanism, with names, units and every joint reaction.

    Raises DeclarationError where the declaration has no equations: a body that nothing places, a joint that no
    coordinate can close, an expression with a foreign symbol.
    """
    m = mechanism
    if not m.coordinates and not m.states and not m.moves:
        raise DeclarationError(f"{m.name}: a mechanism needs at least one coordinate, or a state")
    for body in m.spatial_bodies:
        if not body.is_placed:
            raise DeclarationError(
                f"{m.name}: nothing places {body.name}{m.declared_at(body.name)}, a body in relative coordinates; give "
                "a joint that ends on it its coordinate"
            )
    space.check_points(m)
    coordinates = m.coordinates or (() if m.moves else (_rest(),))
    q, v, a = (stack([getattr(c, letter) for c in coordinates]) for letter in "qva")
    own, n, t = (q, v), q.numel(), m.time
    if m.moves:
        q, t = ca.vertcat(q, m.time), ca.SX.sym("t")
        v, a = (ca.vertcat(x, ca.SX.sym(f"time_{letter}")) for x, letter in ((v, "v"), (a, "a")))
    locks = [c for c in m.closures if isinstance(c, Lock) or (isinstance(c, Motion) and c.value is not None)]
    frictions = [lock for lock in locks if isinstance(lock, Friction)]
    begin = ca.SX.sym("begin")
    kept = [("time", begin), *(("signal", x) for signal in m.signals for x in signal.numbers)] if m.moves else []
    inputs, x = stack([i.symbol for i in m.inputs]), stack([state.symbol for state in m.states])
    u = ca.vertcat(inputs, x)
    s = stack([x.symbol for x in m.starts])

    plain = Kinematics(m)
    held = _held(m, plain)
    rows, closures, signs = _closures(m, held)
    Phi = signs * stack([plain.residual(*c) for c in closures])
    lam = ca.SX.sym("lam", len(rows))

    X, W = _inertia(m, plain, pivoted=True)
    Xq = ca.jacobian(X, own[0])
    Xv = ca.jtimes(X, q, v)
    bias = ca.jtimes(Xv, q, v)
    M = Xq.T @ W @ Xq
    d = Xq.T @ (W @ bias)
    T = ca.dot(W @ Xv, Xv) / 2
    motion, placed = space.SpatialMotion(m, q, v), space.relative_bodies(m)
    if placed:
        carried = motion.mass_matrix(placed)
        M, d = M + carried[:n, :n], d + motion.along(motion.inertial(placed))[:n]
        T += ca.dot(v, carried @ v) / 2
    if m.kinetic:
        extra = sum(m.kinetic, ca.SX(0))
        momentum = ca.gradient(extra, own[1])
        M += ca.jacobian(momentum, own[1])
        d += ca.jtimes(momentum, q, v) - ca.gradient(extra, own[0])
        T += extra

    V = _potential(m, plain)
    paths, efforts = _efforts(m, plain, q, v)
    f_applied = ca.jacobian(paths, q).T @ efforts
    if m.spatial_loads:
        f_applied += motion.along(space.loads(m))
    place = {key_of(c.q): i for i, c in enumerate(m.coordinates)}
    for coordinate, expression in m.generalized:
        f_applied[place[key_of(coordinate)]] += expression
    f = f_applied - ca.gradient(V, q)
    if placed:
        f += motion.along(space.gravity(m, placed))
        V -= sum((body.mass * ca.dot(stack(m.gravity_vector), body.position) for body in placed), ca.SX(0))

    if not m.coordinates and not m.moves:
        M = ca.SX.eye(1)
    C = ca.jacobian(Phi, own[0])
    slips, slipping = _slips(m, plain, closures, q, v, own[1])
    C += slipping
    _check_held_or_heavy(m, plain, M, C)
    xi = -ca.jtimes(ca.jtimes(Phi, q, v) + slips, q, v)  # (3)
    gaps = signs * stack([plain.gap(*c) for c in closures])
    moving: dict[str, ca.SX] = {}
    if m.moves:
        moving["Phi_dot"] = ca.jtimes(Phi, q, v) + slips
        moving["motion_power"] = _motion_power(M, d, T, V, moving["Phi_dot"], f_applied, (q, v, a), lam)
        M, d, f, C = _with_time(M, d, f, C, ca.diag(W))
    if m.laws:
        moving["laws"] = _laws(m, q, v)

    # Everything a user can read.
    values: list[Scalar] = []
    outputs: list[Variable] = []
    wrapped: dict[str, int] = {}
    body_values, body_outputs = _body_outputs(m, plain, q, v, a)
    values += body_values
    outputs += body_outputs
    for body in m.bodies:
        if plain.frame(body).wrapped:
            wrapped[f"{body.name}.angle"] = _tied_start(m, plain.frame(body).angle)
    relations = _relations(m, closures, lam)
    reactions, reaction_outputs = _reactions(m, plain, held, q, v, a, efforts, lam, relations)
    values += reactions
    outputs += reaction_outputs
    for relation, its in relations:
        for suffix, value, unit, text in relation.readings(plain, its):
            values.append(value)
            outputs.append(Variable(f"{relation.name}.{suffix}", unit, description=text))
    loads = {o.name: r for o, r in zip(reaction_outputs, reactions, strict=True)}
    plain_locks = [x for x in locks if x not in frictions]
    for efforts_kept, kept_outputs in (_locking(plain_locks, closures, lam), _driving(closures, lam)):
        values += efforts_kept
        outputs += kept_outputs
    rows_of_locks = {x: closures.index((x, x.direction)) for x in locks if isinstance(x, Lock)}
    efforts_in_space = _efforts_in_space(m, plain, q, v)
    spatial_values, spatial_outputs = space.outputs(m, q, v, a, closures, lam, efforts_in_space)
    loads |= {o.name: x for o, x in zip(spatial_outputs, spatial_values, strict=True)}
    rubs = rubbing(locks, rows_of_locks, plain.free, loads, (q, v, a), lam)
    values += rubs.values
    outputs += rubs.outputs
    values += spatial_values
    outputs += spatial_outputs
    for joint in m.spatial_joints:
        for which in joint.freedoms:
            if joint.is_wrapped(which):
                wrapped[f"{joint.name}.{which}"] = _tied_start(m, joint.displacement(which))
    traced_values, traced_outputs = _watched(m, plain, q, v)
    values += traced_values
    outputs += traced_outputs
    measured_values, measured_outputs, angles = measures(m, plain, q, v, a)
    values += measured_values
    outputs += measured_outputs
    for joint in (j for j in m.joints if f"{j.name}.angle" in angles):
        if plain.frame(joint.first.body).wrapped or plain.frame(joint.second.body).wrapped:
            wrapped[f"{joint.name}.angle"] = _tied_start(m, angles[f"{joint.name}.angle"])
    values += ca.vertsplit(lam)
    for i, row in enumerate(rows):
        force = "N" if row.unit == "m" else "N.m"  # times the row it is work
        outputs.append(Variable(f"multiplier[{i + 1}]", force, description=f"multiplier of {row.name}, {row.what}"))
    values += [state.symbol for state in m.states]
    states = [Variable(x.name, x.unit, x.start, description=x.description, nominal=x.nominal) for x in m.states]
    outputs += states
    values += [o.expression for o in m.outputs]
    outputs += [Variable(o.name, o.unit, description=o.description) for o in m.outputs]
    limits: list[tuple[ca.SX, EndStop]] = []
    for stop in m.end_stops:
        x = _limited(plain, stop)
        limits += [(depth, stop) for depth, _ in stop.penetrations(x)]
        what, unit = ("force", "N") if stop.unit == "m" else ("torque", "N.m")
        values += [stop.penetration(x), stop.effort(x, ca.jtimes(x, q, v))]
        outputs.append(
            Variable(f"{stop.name}.penetration", stop.unit, description=f"how far {stop.limited} is in {stop.name}")
        )
        outputs.append(Variable(f"{stop.name}.{what}", unit, description=f"{what} of {stop.name} on {stop.limited}"))
    y = stack(values)
    lengths = _lengths(m, rows)
    carried = _carried(reactions, spatial_values, spatial_outputs, closures, lam, lengths)
    instant = _depends_on_any(y, ca.vertcat(a, lam, inputs))
    outputs = [Variable(**{**o.__dict__, "instant": i}) for o, i in zip(outputs, instant, strict=True)]

    guess = _without_turns(m, _guess(m, coordinates, begin))
    sdot = ca.SX.sym("sdot", len(m.starts))
    tied, ties = _ties(m)
    passive = ca.substitute(f_applied, u, ca.SX.zeros(u.shape)) if u.numel() else f_applied

    counted = _counted(m, plain, [y, M, d, f, Phi, C, xi, V, T, _state_rates(m), *rubs.functions.values()])
    nears = [near for near, _ in counted.values()]
    remembered = [*(x.value for x in locks), *(x.slip for x in frictions), *nears, *(x for _, x in kept)]
    p = stack([x.symbol for x in m.parameters] + remembered)
    symbols = {"q": q, "v": v, "a": a, "lam": lam, "u": u, "p": p, "t": t, "s": s, "sdot": sdot}
    expressions = {
        "M": M,
        "d": d,
        "f": f,
        "Phi": Phi,
        "C": C,
        "xi": xi,
        "displacements": stack(
            [
                *(plain.locked(lock)[0] for lock in locks),
                *(x.slip for x in frictions),
                *(angle for _, angle in counted.values()),
                *(0.0 for _ in kept),
            ]
        ),
        **({"counted": stack([angle for _, angle in counted.values()])} if counted else {}),
        "gaps": gaps,
        "gaps_matrix": _still(ca.jacobian(gaps, own[0]) + slipping, n, m.moves),
        "kinetic_energy": T,
        "potential_energy": V,
        "input_power": ca.dot(f_applied - passive, v),
        "other_power": ca.dot(passive, v),
        "state_rates": _state_rates(m),
        "readings": y,
        "shares": ca.gradient(ca.sumsqr(carried) / 2, lam) if lam.numel() else lam,
        **rubs.functions,
        **({"instants": stack(m.instants)} if m.instants else {}),
        **({"stops": stack([x for x, _ in limits])} if limits else {}),
        "guess": guess,
        "guess_rate": (ca.jtimes(guess, s, sdot) if m.starts else ca.SX.zeros(guess.shape))
        + (ca.jacobian(guess, begin) if m.moves else 0),
        "ties": ties,
        "ties_matrix": _still(ca.jacobian(ties, own[0]), n, m.moves),
        **moving,
    }
    doubt(m, lambda body: m._moves(plain.frame(body).angle) and not _guided(m, body))
    equations = Equations(
        name=m.name,
        description=m.description,
        coordinates=[*(Variable(c.name, c.unit) for c in coordinates), *[Variable("time", "s")] * m.moves],
        parameters=[Variable(x.name, x.unit, x.default, x.minimum, x.maximum, x.description) for x in m.parameters],
        starts=[Variable(f"start.{x.name}", x.unit, x.value, description=x.description) for x in m.starts],
        start_rates=[
            Variable(f"start.{x.rate_name}", rate_of(x.unit), x.rate, description=f"rate of start.{x.name}")
            for x in m.starts
        ],
        tied=tied,
        inputs=[Variable(i.name, i.unit, i.start, description=i.description) for i in m.inputs],
        states=states,
        resting=not m.coordinates and not m.moves,
        outputs=outputs,
        rows=rows,
        lengths=lengths,
        slips=[i for i, (c, k) in enumerate(closures) if isinstance(c, Relation) and c.slip(plain, k) is not None],
        compliances=_compliances(rows) if m.compliant else [],
        switches=_switches(m, locks, closures),
        frictions=rubs.frictions,
        held=[
            *(lock.name for lock in locks),
            *(f"{x.name}.slip" for x in frictions),
            *counted,
            *(name for name, _ in kept),
        ],
        counted={name: _tied_start(m, angle) for name, (_, angle) in counted.items()},
        timed=m.moves,
        followed=_followed(m),
        leaps=_leaps(m, closures),
        limited=[Variable(stop.name, stop.unit) for _, stop in limits],
        wrapped=wrapped,
        works=m.moves or bool(frictions) or not f_applied.is_zero(),
        stop_time=m.experiment.stop_time,
        step_size=m.experiment.step_size,
        interval=m.experiment.communication_step or m.experiment.step_size,
        options=m.options,
        functions={name: _function(m, name, symbols, x) for name, x in expressions.items()},
    )
    _check_names(m, equations)
    return evaluable(equations)


def _rest() -> Coordinate:
    """The coordinate of a mechanism that has none, and states alone: of a mass of 1 that no force moves."""
    return Coordinate("rest", *(ca.SX.sym(f"rest_{letter}") for letter in "qva"), "m", 0.0)


def _state_rates(m: Mechanism) -> ca.SX:
    """Time derivatives of the states; DeclarationError where one is not declared."""
    for state in m.states:
        if state.rate is None:
            raise DeclarationError(
                f"{m.name}: the state {state.name} has no rate{m.declared_at(state.name)}; give one, in state() or in "
                "derivative()"
            )
    return stack([state.rate for state in m.states])


def _motion_power(
    M: ca.SX,
    d: ca.SX,
    T: ca.SX,
    V: ca.SX,
    Phi_dot: ca.SX,
    f_applied: ca.SX,
    motion: tuple[ca.SX, ca.SX, ca.SX],
    lam: ca.SX,
) -> ca.SX:
    """Power [W] of what moves by itself: the rate of the energies less the power of efforts, on the motion of (4).

    There v' (M a + d - f) = -v' C' lam = Phi_t' lam, so that what energies lack is in multipliers and in what T and V
    themselves depend on time.
    """
    q, v, a = motion
    n, time, rate = M.shape[0], q[-1], v[-1]
    power = -f_applied[n] * rate
    if lam.numel():
        power += ca.dot(ca.jacobian(Phi_dot, rate), lam) * rate
    if ca.depends_on(ca.vertcat(T, V), ca.vertcat(time, rate)):
        power += ca.jtimes(T, v, a) + ca.jtimes(T, q, v) + ca.jacobian(V, time) * rate
        if n:
            power -= ca.dot(v[:n], M @ a[:n] + d)
    return power


def _with_time(M: ca.SX, d: ca.SX, f: ca.SX, C: ca.SX, w: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """The terms of (4) and (3) with time as the last coordinate, which no force moves."""
    n = M.shape[0]
    size = STEADY * (ca.sum1(w) / w.numel() if w.numel() and not w.is_zero() else 1)
    return (
        ca.diagcat(M, size),
        ca.vertcat(d, 0),
        ca.vertcat(*ca.vertsplit(f)[:n], 0),
        ca.horzcat(C, ca.SX(C.shape[0], 1)),
    )


def _counted(m: Mechanism, kinematics: Kinematics, expressions: Sequence[ca.SX]) -> dict[str, tuple[ca.SX, ca.SX]]:
    """Angles whose turns a run counts, as something depends on them: by name where each was last, and the angle."""
    known = {f"{body.name}.angle": (body.near, kinematics.frame(body).counted) for body in _between_points(m)}
    for joint in m.spatial_joints:
        for which in (x for x in joint.freedoms if joint.is_wrapped(x)):
            known[f"{joint.name}.{which}"] = joint.near(which), joint.counted(which)
    if not known:
        return {}
    used = {key_of(symbol) for symbol in ca.symvar(ca.veccat(*expressions))}
    return {name: (near, angle) for name, (near, angle) in known.items() if key_of(near) in used}


def _between_points(m: Mechanism) -> list[Body]:
    """Bodies that two points place."""
    return [body for body in m.bodies if body.between is not None]


def _without_turns(m: Mechanism, x: ca.SX) -> ca.SX:
    """An expression with angles as they are before a run has counted their turns."""
    nears = [body.near for body in _between_points(m)]
    return ca.substitute(x, stack(nears), ca.SX.zeros(len(nears))) if nears else x


def _still(matrix: ca.SX, n: int, moves: bool) -> ca.SX:
    """The derivative of something by n coordinates, with an empty column for time where that is one."""
    return ca.horzcat(matrix[:, :n], ca.SX(matrix.shape[0], int(moves)))


def _followed(m: Mechanism) -> list[Followed]:
    """What the runtime makes of inputs that move something; DeclarationError where companions of others do nothing."""
    places = {i.name: k for k, i in enumerate(m.inputs)}
    for each in m.inputs:
        if each.derivatives and not any(signal.input is each for signal in m.signals):
            raise DeclarationError(
                f"{m.name}: the input {each.name} has derivatives and moves nothing{m.declared_at(each.name)}; leave "
                "derivatives out, or use it in a motion, a place or a constraint"
            )
    return [Followed(places[x.name], x.derivatives, x.order, x.jump) for x in (signal.input for signal in m.signals)]


def _laws(m: Mechanism, q: ca.SX, v: ca.SX) -> ca.SX:
    """Laws that may jump or not be finite, their rates, and the rates of these where coordinates move evenly."""
    laws = stack([law.value for law in m.laws])
    rates = ca.jtimes(laws, q, v)
    return ca.vertcat(laws, rates, ca.jtimes(rates, q, v))


def _leaps(m: Mechanism, closures: Sequence[Closing]) -> list[Leap]:
    """What a run is told of them; one that can be switched counts while its constraint is in force."""
    rows = {c.name: i for i, (c, direction) in enumerate(closures) if direction == "motion"}
    return [Leap(law.what, law.unit, rows[law.motion] if law.motion else -1) for law in m.laws]


def _check_held_or_heavy(m: Mechanism, kinematics: Kinematics, M: ca.SX, C: ca.SX) -> None:
    """Every coordinate must move a mass or be in a constraint, whatever the parameters are."""
    there = {*ca.sparsify(M).sparsity().get_triplet()[1], *C.sparsity().get_triplet()[1]}
    if free := [c for i, c in enumerate(m.coordinates) if i not in there]:
        q = stack([c.q for c in free])
        poses = {body: ca.vertcat(*kinematics.center(body), kinematics.frame(body).angle) for body in m.bodies}
        bodies = [f"{b.name}{m.declared_at(b.name)}" for b, pose in poses.items() if ca.depends_on(pose, q)]
        bodies += [f"{b.name}{m.declared_at(b.name)}" for b in m.spatial_bodies if ca.depends_on(b.position, q)]
        along = ", ".join(c.name for c in free)
        moves = f"it moves {', '.join(bodies)}" if bodies else "it moves nothing"
        raise AssemblyError(
            f"{m.name}: the motion along {along} has no mass and no constraint that holds it; {moves}: give a mass (an "
            "inertia where it turns alone), or constraints at both ends of a massless body: "
            "never the last body of an open chain"
        )


def _check_names(m: Mechanism, equations: Equations) -> None:
    """No name of the user's may be that of a variable that is derived."""
    found: dict[str, Variable] = {}
    for _, v in variables_of(equations).causalities:
        if v.name in found:
            what = found[v.name].description or v.description
            raise DeclarationError(
                f"{m.name}: {v.name!r} is derived already ({what}), so that nothing else can be called so"
                f"{m.declared_at(v.name)}; take another name"
            )
        found[v.name] = v


def _function(m: Mechanism, name: str, symbols: dict[str, ca.SX], value: ca.SX) -> ca.Function:
    arguments = [symbols[letter] for letter in ARGUMENTS[name]]
    value = ca.densify(value) if value.is_column() else value
    function = ca.Function(name, arguments, [value], {"allow_free": True})
    if function.has_free():
        free = ", ".join(map(str, function.get_free()))
        raise DeclarationError(
            f"{m.name}: {name} uses {free}, which is no coordinate, rate, parameter or input of this mechanism; "
            "declare it here"
        )
    return shared(name, arguments, [value])


def _held(m: Mechanism, kinematics: Kinematics) -> dict[Joint, tuple[str, ...]]:
    """Directions of closures that hold by the choice of coordinates, so need no constraint; joint -> directions.

    Found by the residual being identically zero: two natural bars that share a point, a slider without an angle.
    """
    coordinates = {key_of(c.q) for c in m.coordinates}
    held: dict[Joint, tuple[str, ...]] = {}
    for closure in m.closures:
        if isinstance(closure, Relation):
            slips = [closure.slip(kinematics, direction) for direction in closure.directions]
            rows = stack(
                [x for each in slips for _, x in each or ()]
                + [kinematics.residual(closure, k) for k in closure.directions]
            )
            if not any(key_of(symbol) in coordinates for symbol in ca.symvar(rows)):
                raise DeclarationError(
                    f"{m.name}: no coordinate moves the bodies of {closure.kind} {closure.name}"
                    f"{m.declared_at(closure.name)}; give their hinges coordinates"
                )
        if not isinstance(closure, Joint):
            continue
        zero = []
        for direction in closure.directions:
            residual = kinematics.residual(closure, direction)
            if residual.is_zero():
                zero.append(direction)
            elif not any(key_of(symbol) in coordinates for symbol in ca.symvar(residual)):
                raise DeclarationError(
                    f"{m.name}: joint {closure.name} leaves a gap of {residual} along {direction} that no coordinate "
                    f"can close; check its markers, offset and angle{m.declared_at(closure.name)}"
                )
        if zero:
            held[closure] = tuple(zero)
    _check_held(m, held)
    return held


def _check_held(m: Mechanism, held: dict[Joint, tuple[str, ...]]) -> None:
    """Joints that one body's coordinates close must not disturb each other when displaced virtually."""
    eps = {j: {k: ca.SX.sym(f"{j.name}.{k}") for k in directions} for j, directions in held.items()}
    by_body: dict[Body, list[Joint]] = {}
    for joint in held:
        by_body.setdefault(joint.second.body, []).append(joint)
    for body, joints in by_body.items():
        if body.between is not None:
            for joint in joints:
                ends = (body.start, body.end)
                if not any(_same(joint.second.x, e.x) and _same(joint.second.y, e.y) for e in ends):
                    raise DeclarationError(
                        f"{m.name}: joint {joint.name} is closed by the points of {body.name} but is not at one of its "
                        "ends; place the body between other points"
                    )
            continue
        for joint in joints:
            moved = Kinematics(m, {joint: held[joint]}, {joint: eps[joint]})
            for other in joints:
                if other is joint:
                    continue
                symbols = stack(list(eps[joint].values()))
                for direction in held[other]:
                    if ca.depends_on(moved.residual(other, direction), symbols):
                        slope = ca.jacobian(moved.residual(other, direction), symbols)
                        if not ca.substitute(slope, symbols, ca.SX.zeros(symbols.shape)).is_zero():
                            raise DeclarationError(
                                f"{m.name}: the coordinates of {body.name} close both {joint.name} and {other.name}; "
                                "their reactions cannot be told apart; put both at one point of the body, or give "
                                "the body an angle coordinate"
                            )


def _relations(m: Mechanism, closures: list[Closing], lam: ca.SX) -> list[tuple[Relation, dict[str, ca.SX]]]:
    """Each relation with its multipliers by direction."""
    return [
        (each, {direction: lam[i] for i, (closure, direction) in enumerate(closures) if closure is each})
        for each in m.relations()
    ]


def _slips(
    m: Mechanism, kinematics: Kinematics, closures: list[Closing], q: ca.SX, v: ca.SX, own: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Velocities that non-holonomic rows keep at zero, zero in other rows, and their rows of C, by `own` rates."""
    rows = []
    for closure, direction in closures:
        slip = closure.slip(kinematics, direction) if isinstance(closure, Relation) else None
        rows.append(sum((ca.jtimes(x, q, v) * n for n, x in slip or ()), ca.SX(0)))
    slips = stack(rows)
    return slips, ca.jacobian(slips, own)


def _slid(closing: Closing, plain: Kinematics, moved: Kinematics) -> ca.SX:
    """What a row of velocities would measure of virtual displacements, up to a constant."""
    closure, direction = closing
    if not isinstance(closure, Relation) or (at_rest := closure.slip(plain, direction)) is None:
        return ca.SX(0)
    displaced = [x for _, x in closure.slip(moved, direction) or ()]
    return sum((n * x for (n, _), x in zip(at_rest, displaced, strict=True)), ca.SX(0))


def _closures(m: Mechanism, held: dict[Joint, tuple[str, ...]]) -> tuple[list[Row], list[Closing], ca.SX]:
    """Constraint rows in the order of declaration, what each closes, and the sign of the residual in it.

    A row reads point of the second body minus point of the first, the other way round where only the first body is torn
    off (has absolute coordinates); this is the sign in which the paper writes the five-bar.
    """
    rows: list[Row] = []
    closures: list[Closing] = []
    signs: list[float] = []
    for closure in m.closures:
        sign, directions = 1.0, ("length",)
        if isinstance(closure, Constraint):
            directions = ("",)
        elif isinstance(closure, Lock | Motion):
            directions = (closure.direction,)
        elif isinstance(closure, SpatialJoint | Relation):
            directions = closure.directions
        elif isinstance(closure, Joint):
            directions = tuple(k for k in closure.directions if k not in held.get(closure, ()))
            first, second = closure.first.body, closure.second.body
            if first.pose is not None and second.pose is None and first is not m.ground:
                sign = -1.0
        for direction in directions:
            turning = direction.startswith("rotation")
            own = isinstance(closure, Constraint | Lock | Motion | Relation)
            unit = closure.unit if own else "rad" if turning else "m"
            # The axes of bodies may lie anywhere, which coefficients would tell of instead of the unit.
            rows.append(Row(closure.name, direction, unit, float(isinstance(closure, SpatialJoint))))
            closures.append((closure, direction))
            signs.append(sign)
    return rows, closures, stack(signs)


def _compliances(rows: list[Row]) -> list[Variable]:
    units = {"m": "m/N", "rad": "rad/(N.m)"}
    return [
        Variable(
            f"{row.name}.compliance.{row.direction}".removesuffix("."),
            units.get(row.unit, "1"),
            minimum=0.0,
            description=f"compliance of {row.text}" + ", for shares of redundant constraints",
        )
        for row in rows
    ]


def _locking(locks: list[Lock | Motion], closures: list[Closing], lam: ca.SX) -> tuple[list[ca.SX], list[Variable]]:
    """Effort of each lock, in the direction in which its displacement grows."""
    values, outputs = [], []
    for lock in locks:
        if isinstance(lock, Lock):
            values.append(-lam[closures.index((lock, lock.direction))])
            what, unit = _effort(lock)
            text = f"{what} of the lock of {lock.name}"
            outputs.append(Variable(f"{lock.name}.locking_{what}", unit, description=text))
    return values, outputs


def _driving(closures: list[Closing], lam: ca.SX) -> tuple[list[ca.SX], list[Variable]]:
    """Effort that each motion takes, in the direction in which its displacement grows."""
    values, outputs = [], []
    for i, (motion, _) in enumerate(closures):
        if isinstance(motion, Motion):
            values.append(-lam[i])
            what, unit = _effort(motion)
            name = "driving_force" if getattr(motion.of, "kind", "") == "prismatic" else what
            text = f"{what} that the motion of {motion.name} takes"
            outputs.append(Variable(f"{motion.name}.{name}", unit, description=text))
    return values, outputs


def _effort(kept: Lock | Motion) -> tuple[str, str]:
    return ("torque", "N.m") if kept.unit == "rad" else ("force", "N")


def _switches(m: Mechanism, locks: list[Lock | Motion], closures: list[Closing]) -> list[Switch]:
    """Boolean inputs, locks first, each kind in the order of declaration."""
    switches = []
    for i, lock in enumerate(locks):
        if isinstance(lock, Friction):
            continue
        moving = isinstance(lock, Motion)
        name, text = ("driven", "put {} in force: the motion") if moving else ("locked", "stop the motion")
        row = closures.index((lock, lock.direction))
        text = f"{text.format('the law')} of {lock.name}"
        switches.append(Switch(f"{lock.name}.{name}", [row], True, i, description=text))
    for closure in m.releases:
        rows = [i for i, (each, _) in enumerate(closures) if each is closure]
        if not rows:
            raise DeclarationError(
                f"{m.name}: {closure.name} holds by the choice of coordinates, so it cannot be released; use "
                "coordinates in which constraints close it"
            )
        switches.append(Switch(f"{closure.name}.released", rows, False, description=f"switch {closure.name} off"))
    return switches


def _inertia(m: Mechanism, kinematics: Kinematics, pivoted: bool = False) -> tuple[ca.SX, ca.SX]:
    """Displacements X and their weights W: places of centres of mass, angles (natural coordinates, space: directions).

    With `pivoted`, a body that a hinge on the ground places counts by its angle and its inertia about the hinge alone.
    """
    X: list[Scalar] = []
    w: list[Scalar] = []
    moves = ca.vertcat(*(c.q for c in m.coordinates), m.time)
    for body in m.bodies:
        frame = kinematics.frame(body)
        hinge = body.placed_by
        still = hinge is not None and hinge.kind == "revolute" and hinge.first.body is m.ground
        if pivoted and still and not ca.depends_on(ca.vertcat(*kinematics.place(hinge.first)), moves):
            arm = (body.center[0] - hinge.second.x) ** 2 + (body.center[1] - hinge.second.y) ** 2
            X.append(frame.angle)
            w.append(body.inertia + body.mass * arm)
            continue
        if not symbolic(body.mass).is_zero():
            X += kinematics.center(body)
            w += [body.mass, body.mass]
        if not symbolic(body.inertia).is_zero():
            # (ex, ey) is linear in natural coordinates, so that the mass matrix is constant.
            X += [frame.ex, frame.ey] if frame.wrapped else [frame.angle]
            w += [body.inertia, body.inertia] if frame.wrapped else [body.inertia]
    blocks = [ca.diag(stack(w))]
    for body in (body for body in m.spatial_bodies if body.own is not None):
        displacements, weights = body.displacements()
        X += ca.vertsplit(displacements)
        blocks.append(weights)
    return stack(X), ca.diagcat(*blocks)


def _guided(m: Mechanism, body: Body) -> bool:
    """Whether a joint with the ground keeps the angle of a body."""
    joints = (j for j in m.joints if j.kind in ("prismatic", "weld"))
    return any({j.first.body, j.second.body} == {m.ground, body} for j in joints)


def _potential(m: Mechanism, kinematics: Kinematics) -> ca.SX:
    """Potential energy of gravity, springs and the user's own terms, but of the weight of bodies that joints in space
    place."""
    gx, gy, _ = m.gravity_vector
    centers = [kinematics.center(body) for body in m.bodies]
    x, y = (stack([center[k] for center in centers]) for k in (0, 1))
    V = sum(m.potential, ca.SX(0))
    for stop in m.end_stops:
        V += stop.energy(_limited(kinematics, stop))
    V -= ca.dot(stack([body.mass for body in m.bodies]), gx * x + gy * y)
    for body in (body for body in m.spatial_bodies if body.own is not None):
        V -= body.mass * ca.dot(stack(m.gravity_vector), body.position)
    for spring in m.springs:
        V += spring.stiffness * (_elongation(kinematics, spring.between) - spring.rest) ** 2 / 2
    return V


def _elongation(kinematics: Kinematics, between: AnyJoint | tuple[AnyMarker, AnyMarker]) -> ca.SX:
    return kinematics.counted(between) if isinstance(between, AnyJoint) else kinematics.distance(between)


def _limited(kinematics: Kinematics, stop: EndStop) -> ca.SX:
    """The displacement that a stop limits."""
    return stop.of if isinstance(stop.of, ca.SX) else _elongation(kinematics, stop.of)


def _paths(m: Mechanism, kinematics: Kinematics) -> list[Scalar]:
    """Displacements along which the efforts of drives, loads and dampers act, in that order."""
    paths: list[Scalar] = [kinematics.free(drive.joint) for drive in m.drives]
    for load in m.loads:
        paths += [*kinematics.place(load.at), kinematics.frame(load.at.body).angle]
    dampers = (s.between for s in m.springs if not symbolic(s.damping).is_zero())
    paths += [kinematics.free(x) if isinstance(x, AnyJoint) else kinematics.distance(x) for x in dampers]
    return paths + [_limited(kinematics, stop) for stop in m.end_stops]


def _efforts(m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The paths of the efforts and the efforts themselves."""
    paths = stack(_paths(m, kinematics))
    efforts: list[Scalar] = [drive.effort for drive in m.drives]
    for load in m.loads:
        efforts += [*load.force, load.torque]
    rates = ca.jtimes(paths, q, v) if paths.numel() else paths
    dampers = [s for s in m.springs if not symbolic(s.damping).is_zero()]
    efforts += [-s.damping * rates[len(efforts) + i] for i, s in enumerate(dampers)]
    stops = range(len(efforts), len(efforts) + len(m.end_stops))
    efforts += [stop.losses(paths[i], rates[i]) for i, stop in zip(stops, m.end_stops, strict=True)]
    return paths, stack(efforts)


def _lengths(m: Mechanism, rows: list[Row]) -> list[int]:
    """Constraints that keep Euler parameters at unit length."""
    names = {each.unit_length for each in (*m.spatial_bodies, *m.spatial_joints)}
    return [i for i, row in enumerate(rows) if row.name in names]


def _carried(
    reactions: Sequence[ca.SX],
    in_space: Sequence[ca.SX],
    outputs: Sequence[Variable],
    closures: list[Closing],
    lam: ca.SX,
    lengths: Sequence[int],
) -> ca.SX:
    """Forces [N] and moments [N.m, over 1 m] that joints and motions carry, and multipliers of what is no joint.

    The sum of their squares depends on no axes, and not on which joints are closed by coordinates. `outputs` are those
    of joints in space. Forces that part teeth are by the size of a multiplier and in no norm, so that all is linear.
    """
    found = [*reactions, *(x for x, o in zip(in_space, outputs, strict=True) if o.unit in ("N", "N.m"))]
    for i, (closure, _) in enumerate(closures):
        if isinstance(closure, Constraint | Lock | Motion | Relation) and i not in lengths:
            found.append(lam[i])
    carried = stack(found)
    if lam.numel() and not ca.is_linear(carried, lam):
        slope, here = (ca.substitute(x, lam, 0 * lam) for x in (ca.jacobian(carried, lam), carried))
        return here + slope @ lam
    return carried


def _efforts_in_space(
    m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX
) -> list[tuple[SpatialJoint | SpatialFreedom | tuple[SpatialMarker, SpatialMarker], ca.SX]]:
    """What drives, springs and stops do along joints in space, and between two points there, second from first."""
    found = [(drive.joint, symbolic(drive.effort)) for drive in m.drives if not isinstance(drive.joint, Joint)]
    for spring in m.springs:
        ends = spring.between if isinstance(spring.between, tuple) else (spring.between.first, spring.between.second)
        if isinstance(ends[0], SpatialMarker):
            path = _elongation(kinematics, spring.between)
            effort = -spring.stiffness * (path - spring.rest) - spring.damping * ca.jtimes(path, q, v)
            found.append((spring.between, effort))
    for stop in m.end_stops:
        first = stop.of[0] if isinstance(stop.of, tuple) else stop.of
        if isinstance(first, SpatialJoint | SpatialFreedom | SpatialMarker):
            path = _limited(kinematics, stop)
            found.append((stop.of, stop.effort(path, ca.jtimes(path, q, v))))
    return found


_REACTIONS = {
    "x": ("force.x", "N", "force along x on {second} from {first}"),
    "y": ("force.y", "N", "force along y on {second} from {first}"),
    "rotation": ("moment", "N.m", "moment on {second} from {first}, about the joint's point on {second}"),
    "normal": ("force", "N", "force on {second} from {first}, along the left normal of the guide"),
    "length": ("force", "N", "force on {second} from {first}, positive when the joint pushes"),
    f"{FREE} revolute": ("torque", "N.m", "torque that the motion takes, on {second} from {first}"),
    f"{FREE} prismatic": ("driving_force", "N", "force that the motion takes, on {second} from {first}"),
}


def _suppressed(m: Mechanism, joint: Joint) -> tuple[str, ...]:
    """The directions of a joint that have a reaction: also that in which a law in place of a coordinate moves it."""
    law = joint.kind in ("revolute", "prismatic") and isinstance(joint.coordinate, ca.SX)
    if (
        law
        and ca.depends_on(joint.coordinate, m.time)
        and not ca.depends_on(joint.coordinate, stack([c.q for c in m.coordinates]))
    ):
        return (*joint.directions, FREE)
    return joint.directions


def _reactions(
    m: Mechanism,
    plain: Kinematics,
    held: dict[Joint, tuple[str, ...]],
    q: ca.SX,
    v: ca.SX,
    a: ca.SX,
    efforts: ca.SX,
    lam: ca.SX,
    relations: list[tuple[Relation, dict[str, ca.SX]]],
) -> tuple[list[ca.SX], list[Variable]]:
    """Reaction of every joint along every direction it suppresses, on the second body from the first."""
    if not m.joints:
        return [], []
    eps = {j: {k: ca.SX.sym(f"{j.name}.{k}") for k in _suppressed(m, j)} for j in m.joints}
    # A direction that a constraint closes is displaced in the constraint, any other one in the kinematics.
    in_frames = {
        j: {k: e for k, e in eps[j].items() if j.coordinate is not None or k in held.get(j, ())} for j in m.joints
    }
    moved = Kinematics(m, held, in_frames) if any(in_frames.values()) else plain
    Xe, _ = _inertia(m, moved)
    _, closures, signs = _closures(m, held)
    displaced = stack([eps.get(c, {}).get(direction, 0.0) for c, direction in closures])
    Phie = signs * (stack([moved.residual(*c) for c in closures]) - displaced)
    # A row of velocities is displaced along what it keeps at rest.
    Phie += signs * stack([_slid(each, plain, moved) for each in closures])
    X, W = _inertia(m, plain)
    aX = ca.jtimes(X, q, a) + ca.jtimes(ca.jtimes(X, q, v), q, v)
    work = (
        ca.dot(Xe, W @ aX)
        + _potential(m, moved)
        - ca.dot(stack(_paths(m, moved)), efforts)
        + (ca.dot(Phie, lam) if lam.numel() else 0)
    )
    symbols = stack([e for j in m.joints for e in eps[j].values()])
    r = ca.substitute(ca.gradient(work, symbols), symbols, ca.SX.zeros(symbols.shape))
    which = {each: i for i, each in enumerate((j, direction) for j in m.joints for direction in j.directions)}
    for relation, own in relations:
        for joint, direction, value in relation.idle(plain, own):
            r[which[joint, direction]] += value
    outputs = []
    for joint in m.joints:
        for direction in eps[joint]:
            suffix, unit, text = _REACTIONS[f"{FREE} {joint.kind}" if direction == FREE else direction]
            text = text.format(first=joint.first.body.name, second=joint.second.body.name)
            outputs.append(Variable(f"{joint.name}.{suffix}", unit, description=text))
    return ca.vertsplit(r), outputs


def _body_outputs(
    m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX, a: ca.SX
) -> tuple[list[ca.SX], list[Variable]]:
    """Place, velocity and acceleration of every centre of mass and angle, and of every slider along its guide."""
    names: list[tuple[str, str, str, str, str]] = []
    places: list[Scalar] = []
    for body in m.bodies:
        frame = kinematics.frame(body)
        places += [*kinematics.center(body), frame.angle]
        b = body.name
        names += [
            (f"{b}.x", f"{b}.vx", f"{b}.ax", "m", f"{{}} of the centre of mass of {b} along x"),
            (f"{b}.y", f"{b}.vy", f"{b}.ay", "m", f"{{}} of the centre of mass of {b} along y"),
            (f"{b}.angle", f"{b}.angular_velocity", f"{b}.angular_acceleration", "rad", f"angular {{}} of {b}"),
        ]
    sliders = [j for j in m.joints if j.kind == "prismatic"]
    guides = Counter(j.second.body for j in sliders)
    for joint in sliders:
        b = joint.second.body.name
        if guides[joint.second.body] == 1:
            places.append(kinematics.free(joint))
            along = f"{{}} of {b} along {joint.name}"
            names.append((f"{b}.position", f"{b}.velocity", f"{b}.acceleration", "m", along))
    X = stack(places)
    Xv = ca.jtimes(X, q, v)
    Xa = ca.jtimes(Xv, q, v) + ca.jtimes(X, q, a)
    values, outputs = [], []
    for place in zip(*map(ca.vertsplit, (X, Xv, Xa)), strict=True):
        values += place
    for x, xv, xa, unit, text in names:
        rate, second = rate_of(unit), rate_of(rate_of(unit))
        word = "position" if unit == "m" else "place"
        for name, name_unit, what in ((x, unit, word), (xv, rate, "velocity"), (xa, second, "acceleration")):
            outputs.append(Variable(name, name_unit, description=text.format(what).replace("angular place", "angle")))
    return values, outputs


def _watched(m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX) -> tuple[list[ca.SX], list[Variable]]:
    """Place and velocity of every point that is watched."""
    values: list[ca.SX] = []
    outputs: list[Variable] = []
    for point in m.watched:
        marker = point.marker
        place = ca.vertcat(*kinematics.place(marker)) if isinstance(marker, Marker) else marker.place
        what = point.description or f"{point.name}, a point of {marker.body.name},"
        for letter, unit, word, vector in (("", "m", "place", place), ("v", "m/s", "velocity", ca.jtimes(place, q, v))):
            for axis, x in zip(point.axes, ca.vertsplit(vector), strict=True):
                values.append(x)
                outputs.append(
                    Variable(f"{point.name}.{letter}{axis}", unit, description=f"{word} of {what} along {axis}")
                )
    return values, outputs


def _guess(m: Mechanism, coordinates: Sequence[Coordinate], begin: ca.SX) -> ca.SX:
    """Guesses of the coordinates in parameters and start values alone, and in the time at which the run begins."""
    resolved: dict[int, ca.SX] = {}
    for c in coordinates:
        guess = symbolic(c.guess)
        before = [symbol for symbol in ca.symvar(guess) if key_of(symbol) in resolved]
        if before:
            guess = ca.substitute(guess, stack(before), stack([resolved[key_of(b)] for b in before]))
        resolved[key_of(c.q)] = guess
    guess = stack(list(resolved.values()))
    return ca.vertcat(ca.substitute(guess, m.time, begin), begin) if m.moves else guess


def _ties(m: Mechanism) -> tuple[list[int], ca.SX]:
    """Which start quantity each tie uses, and the ties; an angle that is computed counts up to whole turns."""
    tied, residuals = [], []
    place = {key_of(x.symbol): i for i, x in enumerate(m.starts)}
    for symbol, expression in m.ties:
        i = place[key_of(symbol)]
        difference = _without_turns(m, expression - symbol)
        if m.starts[i].unit == "rad" and not expression.is_symbolic():
            difference = ca.atan2(ca.sin(difference), ca.cos(difference))
        tied.append(i)
        residuals.append(difference)
    return tied, stack(residuals)


def _tied_start(m: Mechanism, angle: ca.SX) -> int:
    """The start quantity near which a computed angle begins, -1 where there is none."""
    for symbol, expression in m.ties:
        if (expression - angle).is_zero() or ca.is_equal(_without_turns(m, expression), _without_turns(m, angle), 12):
            return next(k for k, x in enumerate(m.starts) if key_of(x.symbol) == key_of(symbol))
    return -1


def _depends_on_any(y: ca.SX, x: ca.SX) -> list[bool]:
    """Which entries of y depend on any entry of x."""
    touched = set(ca.jacobian_sparsity(y, x).row())
    return [i in touched for i in range(y.numel())]


def _absolute(x: Scalar, y: Scalar, angle: Scalar, local: tuple[Scalar, Scalar]) -> Frame:
    c, s = _cis(angle)
    return Frame(symbolic(x), symbolic(y), local, c, s, symbolic(angle))


def _turned(base: Frame, by: Scalar, local: tuple[Scalar, Scalar]) -> Frame:
    """A frame turned by an angle against another one; its place is set by whoever asks."""
    by = symbolic(by)
    angle = base.angle + by
    if base.wrapped:
        return Frame(ca.SX(0), ca.SX(0), local, *base.turn(*_cis(by)), angle, True, base.counted + by)
    return Frame(ca.SX(0), ca.SX(0), local, *_cis(angle), angle)


def _same(a: Scalar, b: Scalar) -> bool:
    if isinstance(a, ca.SX) or isinstance(b, ca.SX):
        return a is b or (symbolic(a) - symbolic(b)).is_zero()
    return a == b


def _sum(a: Scalar, b: Scalar) -> Scalar:
    """a + b; operations with expressions are slow, so none is done where one of them vanishes."""
    return a if _vanishes(b) else b if _vanishes(a) else a + b


def _vanishes(x: Scalar) -> bool:
    """Whether something is the number zero."""
    return not isinstance(x, ca.SX) and x == 0


def _cis(angle: Scalar) -> tuple[ca.SX, ca.SX]:
    """Cosine and sine, exact at the right angles that guides usually have."""
    angle = symbolic(angle)
    if angle.is_constant():
        quarters = float(angle) / (math.pi / 2)
        if quarters == round(quarters):
            return tuple(ca.SX((1, 0, -1, 0)[(round(quarters) - k) % 4]) for k in (0, 1))
    return ca.cos(angle), ca.sin(angle)
