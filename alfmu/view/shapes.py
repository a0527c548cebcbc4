"""Shapes of a mechanism for pictures, in metres, computed from its declaration (`geometry`)."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal

import casadi as ca

from ..model.errors import DeclarationError, InputError
from ..model.mechanism import Mechanism
from ..model.parts import Joint, Marker, Point, Scalar, Spring, key_of
from ..model.spatial import SpatialBody, SpatialMarker
from .surface import Vector
from .traced import cos, sin, tracer

GROUND = "ground"

POSE = ("x", "y", "z", "e0", "e1", "e2", "e3")
"""Outputs with the pose of a body in space: its centre of mass [m] and its Euler parameters."""

Vector3 = tuple[float, float, float]

LinkKind = Literal["bar", "mass", "block"]
TieKind = Literal["rod", "spring", "damper", "spring-damper", "spiral"]
Effort = Literal["force", "moment"]

EFFORTS: tuple[Effort, Effort] = ("force", "moment")


# In the plane -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Anchor:
    """A point fixed on a body, by its position [m] from the centre of mass (the ground's origin) in its axes."""

    body: str
    x: float
    y: float


@dataclass(frozen=True)
class Link:
    """A body: the points of its joints, springs and ends, at least one, from its centre of mass [m].

    `kind` is "bar" (through its points), "mass" (fewer than two points of its own: an arm to its centre of mass) or
    "block" (in a guide).
    """

    name: str
    kind: LinkKind
    points: tuple[Vector, ...]


@dataclass(frozen=True)
class Hinge:
    """A joint: its declared kind, and its point on either body."""

    name: str
    kind: str
    first: Anchor
    second: Anchor


@dataclass(frozen=True)
class Guide:
    """A straight guide through `base`, in direction `axis` [rad] of the base's body; `rider` moves along it.

    `block` is the direction of the guide in the rider's body [rad]; None if the rider is a pin, free to turn.
    """

    name: str
    base: Anchor
    axis: float
    rider: Anchor
    block: float | None


@dataclass(frozen=True)
class Tie:
    """A symbol between two points: a "rod" (of a joint), "spring", "damper", "spring-damper" or torsional "spiral"."""

    name: str
    kind: TieKind
    first: Anchor
    second: Anchor


@dataclass(frozen=True)
class Rim:
    """A curve on a body, from its centre of mass [m]: of a gear, a pulley, a rack; of a cam it is filled."""

    body: str
    points: tuple[Vector, ...]
    filled: bool


# In space ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spot:
    """A point fixed in a frame, by its position [m] from the frame's origin, a body's centre of mass, in its axes."""

    frame: str
    x: float
    y: float
    z: float


@dataclass(frozen=True)
class Frame:
    """A moving frame and its outputs: `columns` are x, y, z [m], then those of its kind.

    A "body" in space adds its Euler parameters; one in the "plane" has x, y and its angle [rad]; an "axis" adds a
    direction, which is the z axis of the frame; a "point" adds nothing.
    """

    name: str
    kind: Literal["body", "plane", "axis", "point"]
    columns: tuple[str, ...]


@dataclass(frozen=True)
class Solid:
    """A body: the points of its joints, springs and ends, from its centre of mass [m].

    `box` is half the edges [m] of the homogeneous box with its mass and inertia, None if there is none; `block` is true
    for a body in a guide, which is shown as that box.
    """

    name: str
    points: tuple[Vector3, ...]
    box: Vector3 | None
    block: bool


@dataclass(frozen=True)
class Pivot:
    """A joint in space: its kind, its point on either body, and its axis in the frame of the first."""

    name: str
    kind: str
    first: Spot
    second: Spot
    axis: Vector3 | None


@dataclass(frozen=True)
class Strut:
    """A symbol that spans two points: a "bar", "rod", "spring", "damper" or "spring-damper"."""

    name: str
    kind: Literal["bar", "rod", "spring", "damper", "spring-damper"]
    first: Spot
    second: Spot


@dataclass(frozen=True)
class Arrow:
    """A force or moment in a result: three outputs in ground axes, or one along a direction of a frame."""

    name: str
    kind: Effort
    role: Literal["applied", "reaction"]
    at: Spot
    columns: tuple[str, ...]
    along: Vector3 | None


@dataclass(frozen=True)
class Space:
    """The shapes of a picture in space; `up` is the direction against gravity."""

    frames: tuple[Frame, ...]
    solids: tuple[Solid, ...]
    pivots: tuple[Pivot, ...]
    struts: tuple[Strut, ...]
    arrows: tuple[Arrow, ...]
    dots: tuple[str, ...]
    up: Vector3

    @property
    def spots(self) -> list[Spot]:
        """The points of its pivots and struts."""
        pairs: list[Pivot | Strut] = [*self.pivots, *self.struts]
        return [at for pair in pairs for at in (pair.first, pair.second)]


# Mechanism ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shapes:
    """The shapes of a picture of a mechanism: in space if `space` is not None, else in the plane.

    `dots` are points given by user outputs `NAME.x`, `NAME.y`.
    """

    name: str
    description: str = field(compare=False)
    links: tuple[Link, ...] = ()
    joints: tuple[Hinge, ...] = ()
    guides: tuple[Guide, ...] = ()
    ties: tuple[Tie, ...] = ()
    dots: tuple[str, ...] = ()
    space: Space | None = None
    rims: tuple[Rim, ...] = ()

    @property
    def columns(self) -> list[str]:
        """Return the names of the outputs for a picture."""
        if self.space:
            return [column for frame in self.space.frames for column in frame.columns]
        links = [f"{link.name}.{q}" for link in self.links for q in ("x", "y", "angle")]
        return links + [f"{dot}.{q}" for dot in self.dots for q in ("x", "y")]

    @property
    def efforts(self) -> list[str]:
        """Return the names of the outputs and inputs that a film shows as arrows, if a result has them."""
        return [column for arrow in self.space.arrows for column in arrow.columns] if self.space else []


def geometry(mechanism: Mechanism, parameters: Mapping[str, Any] | None = None, traced: bool = False) -> Shapes:
    """Return the shapes of a mechanism at given values of its parameters, by default at the defaults.

    Numbers of `traced` shapes contain their expressions (`Traced`). `parameters` may be the mapping for a run: start
    values and solver variables in it have no effect. Raises DeclarationError if a shape depends on more than
    parameters.
    """
    m, given = mechanism, parameters or {}
    values = {p.name: _given(m, p.name, given.get(p.name, p.default)) for p in m.parameters}
    found = tracer(m, values)
    number = found if traced else lambda x: float(found(x))
    places = [o.name for o in m.outputs if o.unit == "m"]
    places += [f"{point.name}.{axis}" for point in m.watched for axis in point.axes]
    dots = tuple(name[:-2] for name in places if name.endswith(".x") and f"{name[:-2]}.y" in places)
    plane = Shapes(m.name, m.description, *_in_plane(m, number), dots, rims=tuple(_rims(m, number)))
    if m.spatial_bodies or m.drawn_joints or any(f"{dot}.z" in places for dot in dots):
        return Shapes(m.name, m.description, space=_in_space(m, number, plane, places))
    return plane


def _in_plane(
    m: Mechanism, number: Callable[[Scalar], float]
) -> tuple[tuple[Link, ...], tuple[Hinge, ...], tuple[Guide, ...], tuple[Tie, ...]]:
    """Return the shapes in the plane."""
    centers = {body: [number(c) for c in body.center] for body in (m.ground, *m.bodies)}

    def anchor(marker: Marker) -> Anchor:
        x, y = centers[marker.body]
        return Anchor(marker.body.name, round(number(marker.x) - x, 12), round(number(marker.y) - y, 12))

    drawn = {j: ends for j in m.joints if (ends := ends_of(m, j)) is not None}
    joints = tuple(Hinge(j.name, j.kind, *map(anchor, ends)) for j, ends in drawn.items())
    joints += tuple(_pins(m, joints, anchor, number))
    guided = [j for j in drawn if "position" in j.freedoms and not _telescopes(j)]
    guides = tuple(_guide(j, anchor, number) for j in guided)
    ties = [Tie(j.name, "rod", j.first, j.second) for j in joints if j.kind == "distance"]
    for spring in m.springs:
        between = spring.between
        first, second = between if isinstance(between, tuple) else (between.first, between.second)
        if not (isinstance(first, Marker) and isinstance(second, Marker)):
            continue
        if by_law(m, first.x, first.y, second.x, second.y):
            continue
        kind: TieKind | None = _spring(spring)
        if isinstance(between, Joint) and between.kind == "revolute":
            kind = "spiral" if kind and "spring" in kind else None
        if kind:
            ties.append(Tie("", kind, anchor(first), anchor(second)))

    fixed: dict[str, list[Anchor]] = {}
    pairs: list[Hinge | Tie] = [*joints, *ties]
    for pair in pairs:
        for at in (pair.first, pair.second):
            fixed.setdefault(at.body, []).append(at)
    for point in m.watched:
        if isinstance(point.marker, Marker) and not by_law(m, point.marker.x, point.marker.y):
            fixed.setdefault(point.marker.body.name, []).append(anchor(point.marker))
    blocks = {g.rider.body for g in guides if g.block is not None}
    links = []
    for body in m.bodies:
        own = [] if body.length is None else [anchor(body.start), anchor(body.end)]
        points = list(dict.fromkeys((a.x, a.y) for a in (*own, *fixed.get(body.name, ()))))
        form: LinkKind = "block" if body.name in blocks else "bar" if len(points) > 1 else "mass"
        if form == "mass" and (0.0, 0.0) not in points:
            points.append((0.0, 0.0))
        links.append(Link(body.name, form, tuple(points)))
    return tuple(links), joints, guides, tuple(ties)


def _rims(m: Mechanism, number: Callable[[Scalar], float]) -> Iterator[Rim]:
    """Yield the curves of relations."""
    for relation in m.relations():
        for rim in relation.rims():
            x, y = (number(c) for c in rim.body.center)
            points = tuple((round(number(a) - x, 12), round(number(b) - y, 12)) for a, b in rim.points)
            yield Rim(rim.body.name, points, rim.filled)


def by_law(m: Mechanism, *places: Scalar) -> bool:
    """Return whether a point moves on its body by a law of time, so that no static shape contains it."""
    return any(isinstance(x, ca.SX) and ca.depends_on(x, m.time) for x in places)


def ends_of(m: Mechanism, joint: Any) -> tuple[Any, Any] | None:
    """Return the points of a joint on its bodies; a point moved by a law is replaced by the other, at the same
    position.

    None if the position is unknown: for a guide or a rod with moving points, or if both points move.
    """
    first, second = (by_law(m, at.x, at.y, getattr(at, "z", 0.0)) for at in (joint.first, joint.second))
    turned = isinstance(joint, Joint) and by_law(m, joint.axis, joint.offset, joint.angle)
    if not (first or second or turned):
        return joint.first, joint.second
    if (first and second) or joint.kind not in ("revolute", "weld", "spherical"):
        return None
    return (joint.second, joint.second) if first else (joint.first, joint.first)


def _pins(
    m: Mechanism, joints: Sequence[Hinge], anchor: Callable[[Marker], Anchor], number: Callable[[Scalar], float]
) -> Iterator[Hinge]:
    """Yield pins without a name for points that bars share without a joint, as in natural coordinates."""
    joined = Knots()
    for joint in joints:
        if joint.kind in ("revolute", "weld"):
            joined.join(joint.first, joint.second)
    ends: dict[tuple[int | float | None, ...], Anchor] = {}
    for body, between in [(body, body.between) for body in m.bodies if body.between]:
        for end, marker in zip(between, (body.start, body.end), strict=True):
            here = anchor(marker)
            if isinstance(end, Marker):
                there = anchor(end)
            else:
                key = tuple(key_of(x) if isinstance(x, ca.SX) else x for x in (end.x, end.y))
                there = ends.setdefault(key, _fixed(end, number) or here)
            if not joined.together(there, here):
                joined.join(there, here)
                yield Hinge("", "revolute", there, here)


def _fixed(point: Point, number: Callable[[Scalar], float]) -> Anchor | None:
    """Return a point on the ground, None if it moves."""
    try:
        return Anchor(GROUND, number(point.x), number(point.y))
    except DeclarationError:
        return None


class Knots:
    """Equality of points connected by joints."""

    def __init__(self) -> None:
        self._groups: dict[Any, set[Any]] = {}

    def join(self, one: Any, other: Any) -> None:
        """Merge two points, and all points connected to either."""
        group = self._groups.get(one, {one}) | self._groups.get(other, {other})
        self._groups.update(dict.fromkeys(group, group))

    def together(self, one: Any, other: Any) -> bool:
        """Return whether two points are connected."""
        return one == other or other in self._groups.get(one, ())


def _spring(spring: Spring) -> Literal["spring", "damper", "spring-damper"] | None:
    """Return "spring", "damper" or both; None if neither has a strength."""
    springs, damps = (not ca.SX(strength).is_zero() for strength in (spring.stiffness, spring.damping))
    if springs:
        return "spring-damper" if damps else "spring"
    return "damper" if damps else None


def _in_space(m: Mechanism, number: Callable[[Scalar], float], plane: Shapes, places: Sequence[str]) -> Space:
    """Return the shapes in space; plane parts are in the plane z = 0."""
    centers = {body: [number(c) for c in body.center] for body in (m.spatial_ground, *m.spatial_bodies)}

    def spot(marker: SpatialMarker) -> Spot:
        local = zip((marker.x, marker.y, marker.z), centers[marker.body], strict=True)
        return Spot(marker.body.name, *(round(number(x) - c, 12) for x, c in local))

    def flat(at: Anchor) -> Spot:
        return Spot(at.body, at.x, at.y, 0.0)

    def direction(axis: Sequence[Scalar]) -> Vector3:
        x, y, z = map(number, axis)
        return x, y, z

    frames = [Frame(b.name, "body", tuple(f"{b.name}.{q}" for q in POSE)) for b in m.spatial_bodies]
    frames += [Frame(x.name, "plane", tuple(f"{x.name}.{q}" for q in ("x", "y", "angle"))) for x in plane.links]
    pivots = [
        Pivot(j.name, j.kind, spot(ends[0]), spot(ends[1]), None if j.kind == "spherical" else direction(j.axes[0]))
        for j in m.spatial_joints
        if j.kind != "distance" and (ends := ends_of(m, j)) is not None
    ]
    pivots += [Pivot(j.name, j.kind, flat(j.first), flat(j.second), (0.0, 0.0, 1.0)) for j in plane.joints]
    drawn: dict[str, Spot] = {}
    for each in m.drawn_joints:
        axis: Vector3 = (0.0, 0.0, 1.0)
        if each.outputs:
            frames.append(Frame(each.name, "axis" if each.axis else "point", each.outputs))
            drawn[each.name] = Spot(each.name, 0.0, 0.0, 0.0)
        else:
            drawn[each.name] = Spot(GROUND, *map(number, each.at))
            axis = direction(each.axis or axis)
        if each.kind:
            pivots.append(Pivot(each.name, each.kind, drawn[each.name], drawn[each.name], axis if each.axis else None))
    struts = [
        Strut(bar.name, "bar", drawn[first], drawn[second])
        for bar in m.drawn_bars
        for first, second in pairwise(bar.joints)
    ]
    struts += [
        Strut(tie.name, tie.kind, flat(tie.first), flat(tie.second)) for tie in plane.ties if tie.kind != "spiral"
    ]
    struts += [Strut(j.name, "rod", spot(j.first), spot(j.second)) for j in m.spatial_joints if j.kind == "distance"]
    for spring in m.springs:
        between = spring.between
        first, second = between if isinstance(between, tuple) else (between.first, between.second)
        along = isinstance(between, tuple) or between.kind == "prismatic"
        if not (along and isinstance(first, SpatialMarker) and isinstance(second, SpatialMarker)):
            continue
        if (kind := _spring(spring)) and not by_law(m, *first.point, *second.point):
            struts.append(Strut("", kind, spot(first), spot(second)))
    shown = {*drawn, *(bar.name for bar in m.drawn_bars)}  # parts with their own symbol
    dots = tuple(dot for dot in plane.dots if dot not in shown)
    frames += [Frame(x, "point", tuple(f"{x}.{q}" for q in "xyz" if f"{x}.{q}" in places)) for x in dots]

    points: dict[str, list[Vector3]] = {frame.name: [] for frame in frames}
    pairs: list[Pivot | Strut] = [*pivots, *struts]
    for pair in pairs:
        for at in (pair.first, pair.second):
            points.get(at.frame, []).append((at.x, at.y, at.z))
    for point in m.watched:
        if isinstance(point.marker, SpatialMarker) and point.marker.body is not m.spatial_ground:
            at = spot(point.marker)
            points[at.frame].append((at.x, at.y, at.z))
    riders = {p.second.frame for p in pivots if p.kind == "prismatic"}
    solids = [
        Solid(b.name, tuple(dict.fromkeys(points[b.name])), _box(b, number), b.name in riders) for b in m.spatial_bodies
    ]
    solids += [
        Solid(link.name, tuple((x, y, 0.0) for x, y in link.points), None, link.kind == "block") for link in plane.links
    ]

    arrows = [
        Arrow(j.name, effort, "reaction", spot(ends[1]), tuple(f"{j.name}.{effort}.{q}" for q in "xyz"), None)
        for j in m.spatial_joints
        if (ends := ends_of(m, j)) is not None
        for effort in EFFORTS[: {"spherical": 1, "distance": 0}.get(j.kind, 2)]
    ]
    inputs = {key_of(x.symbol): x.name for x in m.inputs}
    for drive in m.drives:
        name = inputs.get(key_of(drive.effort))
        if name and not isinstance(drive.joint, Joint) and drive.joint.driven_axis:
            effort: Effort = "force" if drive.joint.kind == "prismatic" else "moment"
            axis = direction(drive.joint.driven_axis)
            arrows.append(Arrow(name, effort, "applied", spot(drive.joint.second), (name,), axis))
    for load in m.spatial_loads:
        for effort, vector in zip(EFFORTS, (load.force, load.torque), strict=True):
            names = tuple(inputs.get(key_of(x), "") for x in vector)
            if all(names):
                arrows.append(Arrow(names[0].removesuffix(".x"), effort, "applied", spot(load.at), names, None))
    x, y, z = (float(number(g)) for g in m.gravity_vector)
    size = math.hypot(x, y, z)
    up = (-x / size + 0.0, -y / size + 0.0, -z / size + 0.0) if size else (0.0, 0.0, 1.0)
    return Space(tuple(frames), tuple(solids), tuple(pivots), tuple(struts), tuple(arrows), dots, up)


def _box(body: SpatialBody, number: Callable[[Scalar], float]) -> Vector3 | None:
    """Return half the edges of the homogeneous box with the mass and the moments of inertia of a body."""
    mass, (x, y, z) = number(body.mass), map(number, body.inertia)
    if mass <= 0:
        return None
    return tuple(max(0.0, 1.5 * j / mass) ** 0.5 for j in (y + z - x, z + x - y, x + y - z))


def _given(m: Mechanism, name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{m.name}: {name} is {value!r}; it must be a number") from None


def _telescopes(joint: Joint) -> bool:
    """Return whether a joint slides one bar along another, as in a cylinder, so that the bars suffice as a symbol."""
    return joint.kind == "prismatic" and None not in (joint.first.body.length, joint.second.body.length)


def _guide(joint: Joint, anchor: Callable[[Marker], Anchor], number: Callable[[Scalar], float]) -> Guide:
    base, axis, offset = anchor(joint.first), number(joint.axis), number(joint.offset)
    base = replace(base, x=base.x - offset * sin(axis), y=base.y + offset * cos(axis))
    block = axis - number(joint.angle) if joint.kind == "prismatic" else None
    return Guide(joint.name, base, axis, anchor(joint.second), block)
