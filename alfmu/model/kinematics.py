"""Places of bodies and points, and residuals of joints, as expressions in coordinates and virtual displacements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from .checks import symbols_in
from .declaration import Declaration
from .errors import DeclarationError
from .parts import (
    AnyJoint,
    AnyMarker,
    Body,
    Constraint,
    Friction,
    Joint,
    Lock,
    Marker,
    Motion,
    Point,
    Rigidity,
    Scalar,
    key_of,
    symbolic,
)
from .relations import Relation
from .spatial import SpatialFreedom, SpatialJoint, SpatialMarker, with_turns


@dataclass
class Frame:
    """Place of a body: its point with local coordinates `local` is at (x, y) from its root, and its x axis points along
    (ex, ey)."""

    x: ca.SX
    y: ca.SX
    local: tuple[Scalar, Scalar]
    ex: ca.SX
    ey: ca.SX
    angle: ca.SX
    wrapped: bool = False
    """Whether the angle is known modulo whole turns only."""
    turned: ca.SX | None = None
    """The angle with whole turns counted, if known."""
    root: Marker | None = None
    """Where its chain of joints begins, on a body that no joint places; None for such a body."""
    origin: tuple[Scalar, Scalar] = (0.0, 0.0)
    """The root in ground axes."""

    @property
    def counted(self) -> ca.SX:
        """The angle with whole turns, which a run counts if coordinates determine the angle modulo turns only."""
        return self.angle if self.turned is None else self.turned

    def turn(self, x: Scalar, y: Scalar) -> tuple[ca.SX, ca.SX]:
        """Return a vector of the body's frame in ground axes."""
        if _vanishes(y):
            return self.ex * x, self.ey * x
        return self.ex * x - self.ey * y, self.ey * x + self.ex * y

    def place(self, x: Scalar, y: Scalar) -> tuple[ca.SX, ca.SX]:
        """Return a point of the body's frame in ground axes."""
        x, y = self.arm(x, y)
        return symbolic(_sum(x, self.origin[0])), symbolic(_sum(y, self.origin[1]))

    def arm(self, x: Scalar, y: Scalar) -> tuple[ca.SX, ca.SX]:
        """Return the way from the root to a point of the body's frame, in ground axes."""
        x, y = _sum(x, -self.local[0]), _sum(y, -self.local[1])
        if _vanishes(x) and _vanishes(y):
            return self.x, self.y
        dx, dy = self.turn(x, y)
        return self.x + dx, self.y + dy


Closure = Joint | SpatialJoint | Rigidity | Constraint | Lock | Motion | Relation
"""A part that constraints close."""

Closing = tuple[Closure, str]
"""One relative displacement kept at zero: its closure and its direction."""

FREE = "free"
"""Direction of the free motion of a joint whose coordinate follows a law."""

Displacement = dict[str, ca.SX]
"""Virtual displacement of a joint: direction -> symbol."""


class Kinematics:
    """Places of all bodies and residuals of all closures as expressions in q, and in virtual displacements if given.

    Results are cached.
    """

    def __init__(
        self,
        mechanism: Declaration,
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
        self.spans: dict[Body, tuple[ca.SX, ca.SX, ca.SX, ca.SX, Scalar]] = {}
        self.squares: dict[Joint | Rigidity, tuple[ca.SX, Scalar]] = {}
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
        """Return a marker or point in ground axes."""
        if isinstance(at, Point):
            return symbolic(at.x), symbolic(at.y)
        if at not in self.places:
            self.places[at] = self.frame(at.body).place(at.x, at.y)
        return self.places[at]

    def way(self, first: Marker, second: Marker) -> tuple[ca.SX, ca.SX]:
        """Return the way from a marker to another in ground axes: as exact far from the origin as near it if joints
        place both from one body."""
        (one, x1, y1), (other, x2, y2) = self._rooted(first), self._rooted(second)
        if one.body is other.body:
            x, y = self.frame(one.body).turn(_sum(other.x, -one.x), _sum(other.y, -one.y))
        else:
            (xa, ya), (xb, yb) = self.place(one), self.place(other)
            x, y = xb - xa, yb - ya
        return x + (x2 - x1), y + (y2 - y1)

    def _rooted(self, at: Marker) -> tuple[Marker, Scalar, Scalar]:
        """Return the root of the chain that carries a marker, and the way from there to the marker."""
        frame = self.frame(at.body)
        return (at, 0.0, 0.0) if frame.root is None else (frame.root, *frame.arm(at.x, at.y))

    def center(self, body: Body) -> tuple[ca.SX, ca.SX]:
        """Return the centre of mass of a body in ground axes."""
        if body not in self.places:
            self.places[body] = self.frame(body).place(*body.center)
        return self.places[body]

    def axes(self, joint: Joint) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return the direction of a guide and its left normal."""
        ux, uy = self.frame(joint.first.body).turn(*_cis(joint.axis))
        return ux, uy, -uy, ux

    def free(self, joint: AnyJoint) -> ca.SX:
        """Return the free displacement of a revolute (angle) or prismatic (place) joint, second body from first."""
        if isinstance(joint, SpatialJoint | SpatialFreedom):
            return joint.measured
        return self.displacement(joint, next(iter(joint.freedoms)))

    def displacement(self, joint: Joint, which: str) -> ca.SX:
        """Return a free displacement of a joint in the plane, one of its `freedoms`."""
        if which == "angle":
            return self.frame(joint.second.body).angle - self.frame(joint.first.body).angle
        x, y = self.way(joint.first, joint.second)
        ux, uy, _, _ = self.axes(joint)
        return ux * x + uy * y

    def counted(self, joint: AnyJoint) -> ca.SX:
        """Return the free displacement, with whole turns counted for an angle."""
        if isinstance(joint, SpatialJoint | SpatialFreedom):
            return joint.free
        if joint.kind == "revolute":
            first, second = self.frame(joint.first.body), self.frame(joint.second.body)
            if all(
                not x.wrapped or self._told.intersection(map(key_of, symbols_in(x.counted))) for x in (first, second)
            ):
                return second.counted - first.counted
            cross, dot = first.ex * second.ey - first.ey * second.ex, first.ex * second.ex + first.ey * second.ey
            return with_turns(cross, dot, joint.near)
        return self.free(joint)

    @cached_property
    def _told(self) -> set[int | None]:
        """Bodies between two points whose turns at the start a tied start value tells, by the keys of their angles."""
        nears = {key_of(body.near) for body in self.mechanism.bodies}
        tied = [nears.intersection(map(key_of, symbols_in(expression))) for _, expression in self.mechanism.ties]
        return {key for keys in tied if len(keys) == 1 for key in keys}

    def distance(self, between: tuple[AnyMarker, AnyMarker]) -> ca.SX:
        in_space = [m.place for m in between if isinstance(m, SpatialMarker)]
        if in_space:
            return ca.norm_2(in_space[1] - in_space[0])
        x, y = self.way(*(m for m in between if isinstance(m, Marker)))
        return ca.sqrt(x**2 + y**2)

    def locked(self, lock: Lock | Motion) -> tuple[ca.SX, bool]:
        """Return the displacement that a lock or a motion keeps, and whether it is an angle known modulo whole turns
        only.

        For a motion, return its deviation from the law.
        """
        value, wrapped = self._displacement(lock.of)
        return value - lock.law if isinstance(lock, Motion) else value, wrapped

    def _displacement(self, of: AnyJoint | SpatialFreedom | tuple[Body, Body] | ca.SX) -> tuple[ca.SX, bool]:
        if isinstance(of, ca.SX):
            return of, False
        if isinstance(of, SpatialJoint | SpatialFreedom):
            return of.measured, of.wrapped
        if isinstance(of, Joint):
            turns = of.kind == "revolute"
            bodies, value = (of.first.body, of.second.body), self.free(of)
        else:
            turns, bodies = True, of
            value = self.frame(bodies[1]).angle - self.frame(bodies[0]).angle
        return value, turns and any(self.frame(body).wrapped for body in bodies)

    def gap(self, closure: Closure, direction: str) -> ca.SX:
        """Return a residual for the assembly: equal to `residual` to first order near zero, but in metres for lengths
        far from zero, and not zero for angles half a turn away."""
        if isinstance(closure, SpatialJoint):
            return closure.gap(direction)
        if isinstance(closure, Joint | Rigidity) and direction == "length":
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
        """Return the residual of a closure along one direction.

        For a length it is polynomial in the places, and its multiplier is the force along the line.
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
            # A sliding joint is far from the position at which it stuck, but its multiplier must remain the torque.
            return ca.remainder(beside, 2 * math.pi) if isinstance(closure, Friction) else ca.sin(beside)
        if isinstance(closure, Rigidity) or direction == "length":
            square, length = self._apart(closure)
            return (square - length**2) / (2 * length)
        x, y = self.way(closure.first, closure.second)
        if direction in ("x", "y"):
            return x if direction == "x" else y
        if direction == "normal":
            _, _, nx, ny = self.axes(closure)
            return nx * x + ny * y - closure.offset
        first, second = self.frame(closure.first.body), self.frame(closure.second.body)
        if not (first.wrapped or second.wrapped):
            return second.angle - first.angle - closure.angle
        ex, ey = first.turn(*_cis(closure.angle))
        return ex * second.ey - ey * second.ex

    def _beside(self, closure: Lock | Motion) -> ca.SX:
        """Return the deviation of a displacement from the value that a lock or a motion keeps."""
        value, _ = self.locked(closure)
        return value if closure.value is None else value - closure.value

    def _apart(self, closure: Joint | Rigidity) -> tuple[ca.SX, Scalar]:
        """Return the squared distance of two points, and the distance that a closure keeps between them."""
        if closure not in self.squares:
            if isinstance(closure, Rigidity):
                _, _, dx, dy, length = self._span(closure.body)
            else:
                (dx, dy), length = self.way(closure.first, closure.second), closure.length
            self.squares[closure] = dx**2 + dy**2, length
        return self.squares[closure]

    def _span(self, body: Body) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, Scalar]:
        """Return the first point of a body between points, the vector from it to the second, and its length."""
        if body not in self.spans:
            assert body.between is not None
            assert body.length is not None
            ends = []
            for anchor, marker in zip(body.between, (body.start, body.end), strict=True):
                (x, y), (dx, dy) = self.place(anchor), self._shift(marker)
                ends.append((x + dx, y + dy))
            (x1, y1), (x2, y2) = ends
            self.spans[body] = x1, y1, x2 - x1, y2 - y1, body.length
        return self.spans[body]

    def _shift(self, end: Marker) -> tuple[Scalar, Scalar]:
        """Return the virtual displacement of an end of a body between points.

        The joints at a point connect its bodies into a tree; the displacement of one of them moves all bodies that hang
        on it. The root is a body that no points carry, or the one declared first.
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
        ways: dict[tuple[Body, int | None], tuple[Scalar, Scalar]] = {start: (0.0, 0.0)}
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
        """Return a body with the number of its end if two points carry it, otherwise with None."""
        body = marker.body
        if body.between is not None:
            for i, end in enumerate((body.start, body.end)):
                if same(marker.x, end.x) and same(marker.y, end.y):
                    return body, i
        return body, None

    def _between(self, body: Body) -> Frame:
        x, y, dx, dy, length = self._span(body)
        ex, ey = dx / length, dy / length
        return Frame(x, y, (0.0, 0.0), ex, ey, ca.atan2(ey, ex), True, with_turns(ey, ex, body.near))

    def _by_joint(self, body: Body, joint: Joint) -> Frame:
        e = self.eps.get(joint, {})
        free = (0.0 if joint.coordinate is None else joint.coordinate) + e.get(FREE, 0)
        angle = free if joint.kind == "revolute" else joint.angle + e.get("rotation", 0)
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
        root, x, y = self._rooted(other)
        dx, dy = e.get("x", 0), e.get("y", 0)
        if joint.kind == "prismatic":
            c, s = _cis(joint.axis)
            dx, dy = guide.turn(c * free - s * across, s * free + c * across)
        sign = 1 if forward else -1
        return replace(frame, x=symbolic(x + sign * dx), y=symbolic(y + sign * dy), root=root, origin=self.place(root))

    def _displaced(self, frame: Frame, joint: Joint) -> Frame:
        """Return a body in absolute coordinates, displaced at a joint that its pose closes."""
        e = self.eps[joint]
        x, y = frame.place(joint.second.x, joint.second.y)
        moved = _turned(frame, e["rotation"], (joint.second.x, joint.second.y)) if "rotation" in e else frame
        dx, dy = e.get("x", 0), e.get("y", 0)
        if "normal" in e:
            _, _, nx, ny = self.axes(joint)
            dx, dy = dx + nx * e["normal"], dy + ny * e["normal"]
        return replace(moved, x=x + dx, y=y + dy, local=(joint.second.x, joint.second.y))


def _absolute(x: Scalar, y: Scalar, angle: Scalar, local: tuple[Scalar, Scalar]) -> Frame:
    c, s = _cis(angle)
    return Frame(symbolic(x), symbolic(y), local, c, s, symbolic(angle))


def _turned(base: Frame, by: Scalar, local: tuple[Scalar, Scalar]) -> Frame:
    """Return a frame turned by an angle relative to another; the caller sets its place."""
    by = symbolic(by)
    angle = base.angle + by
    if base.wrapped:
        return Frame(ca.SX(0), ca.SX(0), local, *base.turn(*_cis(by)), angle, True, base.counted + by)
    return Frame(ca.SX(0), ca.SX(0), local, *_cis(angle), angle)


def same(a: Scalar, b: Scalar) -> bool:
    if isinstance(a, ca.SX) or isinstance(b, ca.SX):
        return a is b or (symbolic(a) - symbolic(b)).is_zero()
    return a == b


def _sum(a: Scalar, b: Scalar) -> Scalar:
    """Return a + b; if one of them vanishes, no operation is made, as operations with expressions are slow."""
    return a if _vanishes(b) else b if _vanishes(a) else a + b


def _vanishes(x: Scalar) -> bool:
    """Return whether a value is the number zero."""
    return not isinstance(x, ca.SX) and x == 0


def _cis(angle: Scalar) -> tuple[ca.SX, ca.SX]:
    """Return cosine and sine, exact at right angles, which are usual for guides."""
    angle = symbolic(angle)
    if angle.is_constant():
        quarters = float(angle) / (math.pi / 2)
        if quarters == round(quarters):
            c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[round(quarters) % 4]
            return ca.SX(c), ca.SX(s)
    return ca.cos(angle), ca.sin(angle)
