"""Relations that couple the motions of several bodies: gears, racks, belts, rolling wheels, blades.

A relation is closed by constraints, as a loop is. Each row is the relative displacement of two bodies where they touch,
written in the places of the bodies themselves, so that its multiplier is the force there and the reactions of all
bearings follow from it. Centres are held by hinges; while these hold, the rows are linear in the angles. A row of
velocities (`slip`) has a zero residual at position level.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import casadi as ca

from .errors import DeclarationError
from .parts import Body, Joint, Marker, Scalar, stack
from .spatial import SpatialMarker
from .words import Brief

Reading = tuple[str, ca.SX, str, str]
"""An output of a relation: suffix of its name, expression, unit, description."""

_ROUND = 72
"""Sides of a circle in pictures [1]: five degrees each, which is round at the size of a screen."""

_RUN = 4
"""Half the length of a rack or a line in pictures, in radii of the wheel on it [1]."""


@dataclass(frozen=True, eq=False, repr=False)
class Rim(Brief):
    """A curve on a body in pictures: points (x, y) [m] in its frame; `filled` if it bounds a disc."""

    body: Body
    points: tuple[tuple[Scalar, Scalar], ...]
    filled: bool = False


Way = tuple[tuple[Joint, int], ...]
"""Joints on the path from the carrier to a body, each with 1 if its second body is farther along the path, else -1."""


class Places(Protocol):
    """Where bodies and points are, as expressions: `model.kinematics.Kinematics`."""

    mechanism: Any

    def frame(self, body: Body) -> Any: ...
    def place(self, at: Marker) -> tuple[ca.SX, ca.SX]: ...
    def free(self, joint: Joint) -> ca.SX: ...
    def axes(self, joint: Joint) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]: ...
    def residual(self, closure: Joint, direction: str) -> ca.SX: ...


@dataclass(eq=False, repr=False)
class Relation(Brief, ABC):
    """A constraint between bodies that is not a joint; `kind` is its name in messages."""

    kind: ClassVar[str] = ""
    directions: ClassVar[tuple[str, ...]] = ()
    """Names of its rows."""
    unit: ClassVar[str] = "m"

    name: str

    @abstractmethod
    def residual(self, places: Places, direction: str) -> ca.SX:
        """Return the residual of the relation [m]."""

    @abstractmethod
    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        """Return the outputs of the relation."""

    def idle(self, places: Places, multipliers: dict[str, ca.SX]) -> list[tuple[Joint, str, ca.SX]]:
        """Return the contributions of workless forces to reactions: joint, direction and amount of each."""
        return []

    def slip(self, places: Places, direction: str) -> list[tuple[ca.SX, ca.SX]] | None:
        """Return pairs (factor, place) of a velocity row, the sum of factor times rate of place; None for a position
        row."""
        return None

    def rims(self) -> list[Rim]:
        """Return its curves in pictures."""
        return []


@dataclass(eq=False, repr=False)
class Pair(Relation):
    """Two wheels on a carrier whose rims have the same speed: gears, or pulleys with a belt.

    With the angles th of both from the carrier, signed radii R (negative where both turn the same way), and the vector
    of ground axes e from the first centre to the second, t = e turned by +90 degrees,

        Phi = R1 th1 + R2 (th2 - phase) - (R1 + R2)/distance t . (gap2 - gap1),

    where a gap is the opening of a bearing, zero if a coordinate keeps the bearing closed.
    """

    directions: ClassVar[tuple[str, ...]] = ("rim",)

    first: Marker
    second: Marker
    carrier: Body
    ways: tuple[Way, Way]
    across: tuple[Scalar, Scalar]
    """From the first centre to the second, in the carrier's frame [m]."""
    distance: Scalar
    radii: tuple[Scalar, Scalar]
    """Signed radii [m]: the first is positive; the second is positive if the wheels turn in opposite directions."""
    phase: Scalar

    def residual(self, places: Places, direction: str) -> ca.SX:
        first, second = (_turn(self, places, at.body, self.carrier) for at in (self.first, self.second))
        R1, R2 = self.radii
        row = R1 * first + R2 * (second - self.phase)
        gap = [b - a for a, b in zip(*(_gap(places, way) for way in self.ways), strict=True)]
        if not all(x.is_zero() for x in gap):
            ex, ey = self.line(places)
            row -= (R1 + R2) / self.distance * (ex * gap[1] - ey * gap[0])
        return row

    def rims(self) -> list[Rim]:
        return [circle(at, ca.fabs(R)) for at, R in zip((self.first, self.second), self.radii, strict=True)]

    def line(self, places: Places) -> tuple[ca.SX, ca.SX]:
        """Return the direction from the first centre to the second in ground axes."""
        return places.frame(self.carrier).turn(*(x / self.distance for x in self.across))

    def driving(self, multipliers: dict[str, ca.SX]) -> ca.SX:
        """Return the force [N] at the rim of the second wheel, positive if it turns this wheel counter-clockwise."""
        R2 = self.radii[1]
        return -multipliers["rim"] * (ca.sign(R2) if isinstance(R2, ca.SX) else math.copysign(1.0, R2))

    def pushed(self, places: Places, force: ca.SX) -> list[tuple[Joint, str, ca.SX]]:
        """Return the reactions to a force [N] that pushes the centres apart."""
        if force.is_zero():
            return []
        e = self.line(places)
        return [
            (joint, direction, side * sign * force * x)
            for way, side in zip(self.ways, (1, -1), strict=True)
            for joint, sign in way
            for direction, x in zip("xy", e, strict=True)
        ]


@dataclass(eq=False, repr=False)
class Gear(Pair):
    """Two gears in mesh, or rolling discs."""

    kind: ClassVar[str] = "gear"

    pressure_angle: Scalar
    ring: int
    """Index, 0 or 1, of the internal gear; -1 if both are external."""

    def rims(self) -> list[Rim]:
        both = zip((self.first, self.second), self.radii, strict=True)
        return [circle(at, ca.fabs(R), spoke=i != self.ring) for i, (at, R) in enumerate(both)]

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        pair = f"on {self.second.body.name} from {self.first.body.name}"
        said = f"force {pair} along the pitch circles, positive where it turns {self.second.body.name} to the left"
        readings: list[Reading] = [("force", self.driving(multipliers), "N", said)]
        if not _nothing(self.pressure_angle):
            apart = self.separating(multipliers)
            readings.append(
                ("separating_force", apart, "N", f"force {pair} across the pitch circles, which pushes them apart")
            )
        return readings

    def separating(self, multipliers: dict[str, ca.SX]) -> ca.SX:
        """Return the force [N] across the pitch circles, of the flank in contact."""
        return ca.fabs(multipliers["rim"]) * ca.tan(self.pressure_angle)

    def idle(self, places: Places, multipliers: dict[str, ca.SX]) -> list[tuple[Joint, str, ca.SX]]:
        # A ring pushes the inner wheel towards its own centre.
        apart = self.separating(multipliers)
        return self.pushed(places, apart if self.ring < 0 else -apart)


@dataclass(eq=False, repr=False)
class Belt(Pair):
    """Two pulleys with a belt or chain around both that does not slip."""

    kind: ClassVar[str] = "belt"

    pretension: Scalar
    start: Marker
    """The first centre on the carrier."""

    def rims(self) -> list[Rim]:
        R1, R2 = self.radii
        ex, ey = (x / self.distance for x in self.across)
        sine = (R1 + R2) / self.distance
        cosine = ca.sqrt(1 - sine**2)
        strands = []
        for hand in (1, -1):
            nx, ny = sine * ex - hand * cosine * ey, sine * ey + hand * cosine * ex
            x, y = self.start.x, self.start.y
            ends = (x + R1 * nx, y + R1 * ny), (x + self.across[0] - R2 * nx, y + self.across[1] - R2 * ny)
            strands.append(Rim(self.carrier, ends))
        return super().rims() + strands

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        names = f"{self.first.body.name} to {self.second.body.name}"
        pair = f"on {self.second.body.name} from {self.first.body.name}"
        said = f"force {pair} by the belt, positive where it turns {self.second.body.name} to the left"
        half = multipliers["rim"] / 2
        strand = f"tension of the strand that leaves {self.first.body.name} on the {{}} side of the way from {names}"
        return [
            ("force", self.driving(multipliers), "N", said),
            ("tension.left", self.pretension + half, "N", strand.format("left")),
            ("tension.right", self.pretension - half, "N", strand.format("right")),
        ]

    def idle(self, places: Places, multipliers: dict[str, ca.SX]) -> list[tuple[Joint, str, ca.SX]]:
        R1, R2 = self.radii
        slope = (R1 + R2) / self.distance
        return self.pushed(places, ca.SX(-2 * self.pretension) * ca.sqrt(1 - slope**2))


@dataclass(eq=False, repr=False)
class Rack(Relation):
    """A pinion and a rack in a guide on the pinion's carrier.

    With the place s of the rack along the guide's direction u, the pinion's angle th from the carrier, the side of the
    pitch line on which the pinion lies (1 for left),

        Phi = s - side radius (th - phase) - u . gap - h turn,

    where `gap` is the opening of the pinion's bearing, `turn` the rotation of the rack in its guide, and h the distance
    of the pitch line to the left of the joint's point on the rack.
    """

    kind: ClassVar[str] = "rack"
    directions: ClassVar[tuple[str, ...]] = ("teeth",)

    pinion: Marker
    guide: Joint
    way: Way
    held: Marker
    """The pinion's centre on the carrier."""
    radius: Scalar
    side: int
    phase: Scalar
    pressure_angle: Scalar

    def residual(self, places: Places, direction: str) -> ca.SX:
        angle = _turn(self, places, self.pinion.body, self.guide.first.body)
        row = places.free(self.guide) - self.side * self.radius * (angle - self.phase)
        ux, uy, _, _ = places.axes(self.guide)
        gx, gy = _gap(places, self.way)
        if not (gx.is_zero() and gy.is_zero()):
            row -= ux * gx + uy * gy
        turned = places.residual(self.guide, "rotation")
        return row if turned.is_zero() else row - self._arm(places)[1] * turned

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        pair = f"on {self.guide.second.body.name} from {self.pinion.body.name}"
        readings: list[Reading] = [("force", -multipliers["teeth"], "N", f"force {pair} along {self.guide.name}")]
        if not _nothing(self.pressure_angle):
            said = f"force {pair} across {self.guide.name}, which pushes them apart"
            readings.append(("separating_force", self.separating(multipliers), "N", said))
        return readings

    def rims(self) -> list[Rim]:
        # The pitch line of the rack, the guide's line shifted to touch the pinion at the start.
        bar, run = self.guide.second, _RUN * self.radius
        lean = self.guide.axis - self.guide.angle
        dx, dy = self.held.x - self.guide.first.x, self.held.y - self.guide.first.y
        ux, uy = direction(self.guide.axis)
        up = ux * dy - uy * dx - self.guide.offset - self.side * self.radius
        cx, cy = direction(lean)
        x, y = bar.x - cy * up, bar.y + cx * up
        ends = ((x - run * cx, y - run * cy), (x + run * cx, y + run * cy))
        return [circle(self.pinion, self.radius), Rim(bar.body, ends)]

    def separating(self, multipliers: dict[str, ca.SX]) -> ca.SX:
        """Return the force [N] across the pitch line."""
        return ca.fabs(multipliers["teeth"]) * ca.tan(self.pressure_angle)

    def idle(self, places: Places, multipliers: dict[str, ca.SX]) -> list[tuple[Joint, str, ca.SX]]:
        force = self.side * self.separating(multipliers)  # on the pinion, along the left normal of the guide
        if force.is_zero():
            return []
        _, _, nx, ny = places.axes(self.guide)
        along, _ = self._arm(places)
        added = [(self.guide, "normal", force), (self.guide, "rotation", force * along)]
        for joint, sign in self.way:
            added += [(joint, "x", -sign * force * nx), (joint, "y", -sign * force * ny)]
        return added

    def _arm(self, places: Places) -> tuple[ca.SX, ca.SX]:
        """Return the pitch point from the joint's point on the rack: along the guide and to its left [m]."""
        (x, y), (x2, y2) = places.place(self.held), places.place(self.guide.second)
        ux, uy, nx, ny = places.axes(self.guide)
        dx, dy = x - x2, y - y2
        return ux * dx + uy * dy, nx * dx + ny * dy - self.side * self.radius


@dataclass(eq=False, repr=False)
class Rolling(Relation):
    """A wheel that rolls on a line of another body without slip and does not leave it.

    With the centre (s, h) along the line and to its left, and the wheel's angle th from the line,

        Phi_normal = h - radius,   Phi_rolling = s + radius (th - phase).
    """

    kind: ClassVar[str] = "rolling"
    directions: ClassVar[tuple[str, ...]] = ("normal", "rolling")

    line: Marker
    wheel: Marker
    axis: tuple[Scalar, Scalar]
    """Cosine and sine of the direction of the line in its body."""
    radius: Scalar
    phase: Scalar

    def residual(self, places: Places, direction: str) -> ca.SX:
        (x1, y1), (x2, y2) = places.place(self.line), places.place(self.wheel)
        ux, uy = places.frame(self.line.body).turn(*self.axis)
        if direction == "normal":
            return ux * (y2 - y1) - uy * (x2 - x1) - self.radius
        angle = _turn(self, places, self.wheel.body, self.line.body)
        return ux * (x2 - x1) + uy * (y2 - y1) + self.radius * (angle - self.phase)

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        pair = f"on {self.wheel.body.name} from {self.line.body.name}"
        return [
            (
                "normal_force",
                -multipliers["normal"],
                "N",
                f"force {pair} normal to the line, negative where it would lift off",
            ),
            (
                "friction_force",
                -multipliers["rolling"],
                "N",
                f"force {pair} along the line, which prevents slip",
            ),
        ]

    def rims(self) -> list[Rim]:
        run, (cx, cy) = _RUN * self.radius, self.axis
        ends = [(self.line.x + side * run * cx, self.line.y + side * run * cy) for side in (-1, 1)]
        return [circle(self.wheel, self.radius), Rim(self.line.body, tuple(ends))]


@dataclass(eq=False, repr=False)
class Blade(Relation):
    """A blade or a thin wheel on the ground: its point moves along it, and not across.

    With the normal n of the blade in ground axes and the place P of its point, n . dP/dt = 0.
    """

    kind: ClassVar[str] = "blade"
    directions: ClassVar[tuple[str, ...]] = ("across",)

    at: Marker
    axis: tuple[Scalar, Scalar]
    """Cosine and sine of the direction of the blade in its body."""

    def residual(self, places: Places, direction: str) -> ca.SX:
        return ca.SX(0)

    def slip(self, places: Places, direction: str) -> list[tuple[ca.SX, ca.SX]] | None:
        ux, uy = places.frame(self.at.body).turn(*self.axis)
        return list(zip((-uy, ux), places.place(self.at), strict=True))

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        said = f"force on {self.at.body.name} from the ground, along the left normal of the blade"
        return [("force", -multipliers["across"], "N", said)]


@dataclass(eq=False, repr=False)
class SpatialRolling(Relation):
    """A ball, or a thin disc on its edge, that rolls without slip on a plane of the ground and does not leave it.

    With the plane's normal N, its point p, the centre c, and the vector a from c to the contact (-radius N for a ball;
    for a disc about k, radius times the steepest descent in the disc's plane),

        Phi = N . (c - p) - radius |N - (N . k) k|,   dc/dt + w x a = 0 along the plane.
    """

    kind: ClassVar[str] = "rolling"
    directions: ClassVar[tuple[str, ...]] = ("normal", "slip1", "slip2")

    plane: SpatialMarker
    centre: SpatialMarker
    radius: Scalar
    axis: tuple[Scalar, Scalar, Scalar] | None
    """Axis of a disc, in its body's frame; None for a ball."""
    triad: tuple[tuple[Scalar, Scalar, Scalar], ...]
    """Two directions along the plane and its normal, of unit length."""

    def residual(self, places: Places, direction: str) -> ca.SX:
        if direction != "normal":
            return ca.SX(0)
        normal, _, size = self._lean()
        return ca.dot(normal, self.centre.place - self.plane.place) - self.radius * size

    def slip(self, places: Places, direction: str) -> list[tuple[ca.SX, ca.SX]] | None:
        if direction == "normal":
            return None
        along, turn, centre = self.triad[direction == "slip2"], self.centre.body.rotation, self.centre.place
        normal, lean, size = self._lean()
        arm = turn.T @ (-self.radius * (normal - lean) / size)  # to the contact, in the body's frame
        pairs = []
        for k in range(3):
            pairs.append((ca.SX(along[k]), centre[k]))
            pairs += [(along[k] * arm[j], turn[k, j]) for j in range(3)]
        return pairs

    def _lean(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the plane's normal, its part along a disc's axis, and the length of the remainder."""
        normal = stack(self.triad[2])
        if self.axis is None:
            return normal, ca.SX.zeros(3), ca.SX(1)
        axis = self.centre.body.rotation @ stack(self.axis)
        tilt = ca.dot(normal, axis)
        return normal, tilt * axis, ca.sqrt(1 - tilt**2)

    def wrench(self, multipliers: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
        """Return the force on the rolling body, and its moment about the centre."""
        order = ("slip1", "slip2", "normal")
        force = sum((-multipliers[k] * stack(x) for k, x in zip(order, self.triad, strict=True)), ca.SX.zeros(3))
        normal, lean, size = self._lean()
        return force, ca.cross(-self.radius * (normal - lean) / size, force)

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        force, _ = self.wrench(multipliers)
        said = f"force on {self.centre.body.name} from the ground where it rolls, along {{}}"
        return [(f"force.{k}", x, "N", said.format(k)) for k, x in zip("xyz", ca.vertsplit(force), strict=True)]


def circle(centre: Marker, radius: Scalar, spoke: bool = True) -> Rim:
    """Return a circle about a marker, with a spoke that shows how it turns."""
    turns = [2 * math.pi * k / _ROUND for k in range(_ROUND + 1)]
    points = [(centre.x + radius * math.cos(t), centre.y + radius * math.sin(t)) for t in turns]
    return Rim(centre.body, ((centre.x, centre.y), *points) if spoke else tuple(points))


def _turn(relation: Relation, places: Places, body: Body, carrier: Body) -> ca.SX:
    """Return the angle of a body from its carrier, with whole turns."""
    frames = [places.frame(each) for each in (body, carrier)]
    for each, frame in zip((body, carrier), frames, strict=True):
        if frame.wrapped:
            raise DeclarationError(
                f"{places.mechanism.name}: {relation.kind} {relation.name} needs the turns of {each.name}, whose "
                "angle is known only within one turn, as two points place it; place it by a pose, or by a joint with "
                "a coordinate"
            )
    return frames[0].angle - frames[1].angle


def _gap(places: Places, way: Way) -> tuple[ca.SX, ca.SX]:
    """Return the sum (x, y) [m] of the openings of the joints of a path."""
    x, y = ca.SX(0), ca.SX(0)
    for joint, sign in way:
        (x1, y1), (x2, y2) = places.place(joint.first), places.place(joint.second)
        x, y = x + sign * (x2 - x1), y + sign * (y2 - y1)
    return x, y


def _nothing(value: Scalar) -> bool:
    return ca.SX(value).is_zero()


def direction(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Return cosine and sine of an angle, exact at right angles."""
    if isinstance(angle, ca.SX):
        return ca.cos(angle), ca.sin(angle)
    quarters = angle / (math.pi / 2)
    if quarters == round(quarters):
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
    return math.cos(angle), math.sin(angle)
