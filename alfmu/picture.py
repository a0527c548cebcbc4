"""Drawings of mechanisms: one frame, the picture of a model, an animation of a result.

The declaration gives the shapes in metres (`geometry`), the motion gives what they must fit in (`view_of`). From both
follows a scene: strokes in pixels, each fixed to the ground, to a body, to a dot or between two points. Two small
painters show it, one with Pillow (`draw`, GIF), one in a browser (HTML).
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from .derivation import derive
from .errors import AssemblyError, DeclarationError, InputError, StepError
from .mechanism import Joint, Marker, Mechanism, Scalar
from .runtime import Instance
from .simulation import simulate

if TYPE_CHECKING:
    from .simulation import Result

__all__ = ["Shapes", "View", "animate", "draw", "geometry", "model_png", "view_of"]

GROUND = "ground"

MAX_FRAMES = 750
"""Frames of a GIF, at most; a longer motion is shown with fewer frames per second."""

MAX_SAMPLES = 5000
"""Instants in an HTML page, at most; the page interpolates between them."""

Vector = tuple[float, float]

Size = tuple[int, int]


# Shapes: what there is, in metres ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Anchor:
    """A point fixed on a body, by its place [m] from the centre of mass in the body's axes (from the origin: ground)."""

    body: str
    x: float
    y: float


@dataclass(frozen=True)
class Link:
    """A body: the points that its joints, springs and ends have on it, from its centre of mass [m].

    `kind` is "bar" (through its points), "mass" (fewer than two points of its own: an arm to its centre of mass) or
    "block" (rides in a guide).
    """

    name: str
    kind: str
    points: tuple[Vector, ...]


@dataclass(frozen=True)
class Hinge:
    """A joint: its kind as declared, and its point on either body."""

    name: str
    kind: str
    first: Anchor
    second: Anchor


@dataclass(frozen=True)
class Guide:
    """A straight guide through `base`, in direction `axis` [rad] of the base's body; `rider` moves along it.

    `block` is the direction of the guide in the rider's body [rad]; None where the rider is a pin, free to turn.
    """

    name: str
    base: Anchor
    axis: float
    rider: Anchor
    block: float | None


@dataclass(frozen=True)
class Tie:
    """What acts between two points: a "rod" (constant distance, named), a "spring", "damper" or torsional "spiral"."""

    name: str
    kind: str
    first: Anchor
    second: Anchor


@dataclass(frozen=True)
class Shapes:
    """All that a picture of a mechanism shows; `dots` are points that user outputs `NAME.x`, `NAME.y` give."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Hinge, ...]
    guides: tuple[Guide, ...]
    ties: tuple[Tie, ...]
    dots: tuple[str, ...]

    @property
    def columns(self) -> list[str]:
        """Names of the outputs that a picture needs."""
        links = [f"{link.name}.{q}" for link in self.links for q in ("x", "y", "angle")]
        return links + [f"{dot}.{q}" for dot in self.dots for q in ("x", "y")]


def geometry(mechanism: Mechanism, parameters: Mapping[str, Any] | None = None) -> Shapes:
    """The shapes of a mechanism for given values of its parameters, defaults otherwise.

    `parameters` may be the mapping that a run took: start values and solver variables in it change no shape.
    Raises DeclarationError where a shape depends on more than parameters.
    """
    m = mechanism
    number = _evaluator(m, parameters or {})
    centers = {body: [number(c) for c in body.center] for body in (m.ground, *m.bodies)}

    def anchor(marker: Marker) -> Anchor:
        x, y = centers[marker.body]
        return Anchor(marker.body.name, round(number(marker.x) - x, 12), round(number(marker.y) - y, 12))

    joints = tuple(Hinge(j.name, j.kind, anchor(j.first), anchor(j.second)) for j in m.joints)
    guides = tuple(_guide(j, anchor, number) for j in m.joints if j.kind in ("prismatic", "point_on_line"))
    ties = [Tie(j.name, "rod", j.first, j.second) for j in joints if j.kind == "distance"]
    for spring in m.springs:
        between = spring.between
        first, second = (between.first, between.second) if isinstance(between, Joint) else between
        elastic, viscous = number(spring.stiffness) != 0, number(spring.damping) != 0
        if isinstance(between, Joint) and between.kind == "revolute":
            kind = "spiral" if elastic else ""
        else:
            kind = "spring" if elastic else "damper" if viscous else ""
        if kind:
            ties.append(Tie("", kind, anchor(first), anchor(second)))

    fixed = [a for pair in (*joints, *ties) for a in (pair.first, pair.second)]
    blocks = {g.rider.body for g in guides if g.block is not None}
    links = []
    for body in m.bodies:
        ends = [] if body.length is None else [anchor(body.start), anchor(body.end)]
        points = list(dict.fromkeys((a.x, a.y) for a in (*ends, *fixed) if a.body == body.name))
        kind = "block" if body.name in blocks else "bar" if len(points) > 1 else "mass"
        if kind == "mass" and (0.0, 0.0) not in points:
            points.append((0.0, 0.0))
        links.append(Link(body.name, kind, tuple(points)))

    places = [o.name for o in m.outputs if o.unit == "m"]
    dots = tuple(name[:-2] for name in places if name.endswith(".x") and f"{name[:-2]}.y" in places)
    return Shapes(m.name, tuple(links), joints, guides, tuple(ties), dots)


def _evaluator(m: Mechanism, parameters: Mapping[str, Any]) -> Callable[[Scalar], float]:
    """What turns an expression in parameters into a number."""
    symbols = ca.vertcat(*(p.symbol for p in m.parameters))
    values = ca.DM([float(parameters.get(p.name, p.default)) for p in m.parameters])

    def number(expression: Scalar) -> float:
        value = ca.substitute(ca.SX(expression), symbols, values) if m.parameters else ca.SX(expression)
        if free := ca.symvar(value):
            raise DeclarationError(f"{m.name}: a shape uses {free[0]}; it may use parameters only")
        return float(value)

    return number


def _guide(joint: Joint, anchor: Callable[[Marker], Anchor], number: Callable[[Scalar], float]) -> Guide:
    base, axis, offset = anchor(joint.first), number(joint.axis), number(joint.offset)
    base = replace(base, x=base.x - offset * math.sin(axis), y=base.y + offset * math.cos(axis))
    block = axis - number(joint.angle) if joint.kind == "prismatic" else None
    return Guide(joint.name, base, axis, anchor(joint.second), block)


# View: where it all is over a motion ------------------------------------------------------------------------------

Pose = tuple[Any, Any, Any]
"""x [m], y [m], angle [rad] of a frame: numbers, or arrays over time."""


@dataclass(frozen=True)
class View:
    """The box that a motion stays in [m], and the range in which each guide is used [m from its base]."""

    low: Vector
    high: Vector
    travel: tuple[Vector, ...]


def view_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> View:
    """The view that holds all shapes at all instants of `columns` (numbers, or arrays over time).

    Raises InputError where a column is missing or not finite.
    """
    poses = _poses(shapes, columns)
    for name, pose in poses.items():
        if not all(np.isfinite(q).all() for q in pose):
            raise InputError(f"{shapes.name}: the place of {name} is not finite all the time, so it cannot be drawn")
    points = [_place(poses, Anchor(link.name, *p)) for link in shapes.links for p in link.points]
    points += [_place(poses, a) for pair in (*shapes.joints, *shapes.ties) for a in (pair.first, pair.second)]
    points += [poses[dot][:2] for dot in shapes.dots]
    xs, ys = (np.concatenate([np.ravel(p[k]) for p in points] or [[0.0]]) for k in (0, 1))
    travel = []
    for guide in shapes.guides:
        (x, y), (rx, ry) = _place(poses, guide.base), _place(poses, guide.rider)
        axis = poses[guide.base.body][2] + guide.axis
        along = (rx - x) * np.cos(axis) + (ry - y) * np.sin(axis)
        travel.append((float(np.min(along)), float(np.max(along))))
    return View((float(xs.min()), float(ys.min())), (float(xs.max()), float(ys.max())), tuple(travel))


def _poses(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> dict[str, Pose]:
    """Pose of every frame: the ground, the bodies and the dots."""
    if missing := [name for name in shapes.columns if name not in columns]:
        raise InputError(
            f"{shapes.name}: a picture needs {missing[0]}; the result must hold x, y and angle of every body, and every "
            "dot, so keep all outputs when you run it"
        )
    poses: dict[str, Pose] = {GROUND: (0.0, 0.0, 0.0)}
    for link in shapes.links:
        poses[link.name] = tuple(np.asarray(columns[f"{link.name}.{q}"], float) for q in ("x", "y", "angle"))
    for dot in shapes.dots:
        poses[dot] = (np.asarray(columns[f"{dot}.x"], float), np.asarray(columns[f"{dot}.y"], float), 0.0)
    return poses


def _place(poses: Mapping[str, Pose], at: Anchor) -> tuple[Any, Any]:
    """A point in ground axes [m]."""
    x, y, angle = poses[at.body]
    c, s = np.cos(angle), np.sin(angle)
    return x + c * at.x - s * at.y, y + s * at.x + c * at.y


# Scene: what it looks like, in pixels -----------------------------------------------------------------------------

BACKGROUND, GRID, ZERO = "#fbfcfd", "#eceff3", "#d3dae2"
INK, FAINT, STEEL, WHITE = "#2b3440", "#7d8995", "#dde3e9", "#ffffff"
COLORS = ("#6b9bc7", "#e3b05f", "#76b18f", "#d0826f", "#9d8fc6", "#58a9ae", "#c98ca9", "#9aa4ae")
"""Of bodies and of dots, in the order of declaration."""


@dataclass(frozen=True)
class Stroke:
    """A line with round ends in pixels, y upwards: a disc where it has one point, a closed area where it is filled."""

    points: tuple[Vector, ...]
    width: float
    color: str
    filled: bool = False


@dataclass(frozen=True)
class Part:
    """Strokes that move with a point of a body, turned by `angle` in its axes, or that stretch between two points.

    Between two points, x runs from 0 at the first to 1 at the second, and y is in pixels across.
    """

    at: tuple[Anchor, ...]
    strokes: tuple[Stroke, ...]
    angle: float = 0.0


@dataclass(frozen=True)
class Label:
    """Text in the middle of some points, or `gap` pixels from there on the side that the directions `links` leave."""

    text: str
    at: tuple[Anchor, ...]
    links: tuple[Anchor, ...]
    gap: float
    size: float
    color: str


@dataclass(frozen=True)
class Scene:
    """Parts behind and before the trails of the dots, and labels; `origin` + `scale` * metres is a place in pixels."""

    size: Size
    scale: float
    origin: Vector
    unit: float
    back: tuple[Part, ...]
    trails: dict[str, str]
    """Colour of the trail of each dot."""
    front: tuple[Part, ...]
    labels: tuple[Label, ...]


@dataclass(frozen=True)
class _Knot:
    """Joints that share a point."""

    names: tuple[str, ...]
    kind: str
    anchors: tuple[Anchor, ...]


def _scene(shapes: Shapes, view: View, size: Size) -> Scene:
    """The scene that fits `view` into `size` [pixels] with equal axes."""
    pen = _Pen.fitting(shapes, view, size)
    guides = list(zip(shapes.guides, view.travel, strict=True))
    knots = _knots(shapes)
    colors = _colors(link.name for link in shapes.links)
    dots = _colors(shapes.dots)
    back = [pen.grid(), pen.marks()]
    back += [pen.support(at, legs) for at, legs in _supports(shapes).items()]
    back += [pen.guide(guide, travel) for guide, travel in guides]
    front = [pen.tie(tie) for tie in shapes.ties]
    front += [pen.link(link, colors[link.name]) for link in shapes.links]
    front += [pen.block(guide, colors[guide.rider.body]) for guide in shapes.guides if guide.block is not None]
    front += [pen.knot(knot) for knot in knots]
    front += [pen.dot(dot, color) for dot, color in dots.items()]
    labels = pen.mark_labels()
    if pen.unit >= 0.5 * pen.base:
        labels += [pen.label(", ".join(k.names), k.anchors[:1], _occupied(shapes, k), 10) for k in knots]
        labels += [pen.label(tie.name, (tie.first, tie.second), (), 5) for tie in shapes.ties if tie.name]
        labels += [pen.label(dot, (Anchor(dot, 0.0, 0.0),), (), 10) for dot in dots]
        labels += [pen.guide_label(guide, travel) for guide, travel in guides]
        labels += [pen.link_label(link, shapes.guides, _shade(colors[link.name])) for link in shapes.links]
    return Scene(size, pen.scale, pen.origin, pen.unit, tuple(back), dots, tuple(front), tuple(labels))


@dataclass(frozen=True)
class _Pen:
    """Symbols in pixels: `base` is 1 in a picture of 640 x 480, `unit` is smaller where links are short."""

    size: Size
    scale: float
    origin: Vector
    base: float
    unit: float

    @classmethod
    def fitting(cls, shapes: Shapes, view: View, size: Size) -> _Pen:
        """Scale and origin that put the box of a view into the picture, with room for symbols around it."""
        base = min(size[0] / 640, size[1] / 480)
        spans = [high - low for low, high in zip(view.low, view.high, strict=True)]
        if max(spans) < 1e-9:
            spans = [1.0, 1.0]
        scale = min((s - 150 * base) / span for s, span in zip(size, spans, strict=True) if span > 0)
        middle = [(low + high) / 2 for low, high in zip(view.low, view.high, strict=True)]
        origin = size[0] / 2 - scale * middle[0], size[1] / 2 + 8 * base - scale * middle[1]
        lengths = [scale * _extent(link.points) for link in shapes.links if len(link.points) > 1]
        shrink = min(1.0, max(0.2, float(np.median(lengths)) / (80 * base))) if lengths else 1.0
        return cls(size, scale, origin, base, base * shrink)

    @property
    def cell(self) -> float:
        """Distance of grid lines [m]: 1, 2 or 5 times a power of ten."""
        wanted = 70 * self.base / self.scale
        power = 10.0 ** math.floor(math.log10(wanted))
        return next(m * power for m in (1, 2, 5, 10) if m * power >= wanted * (1 - 1e-9))

    def corner(self, x: float, y: float) -> Vector:
        """A place `base` pixels from the left lower corner (from the right one: x < 0), seen from the ground's origin."""
        return x * self.base + (self.size[0] if x < 0 else 0) - self.origin[0], y * self.base - self.origin[1]

    # The ground

    def grid(self) -> Part:
        """Grid lines, those through the origin darker."""
        step, u = self.scale * self.cell, self.base
        lines = []
        for k in (0, 1):
            low, high = (-self.origin[1 - k], self.size[1 - k] - self.origin[1 - k])
            for i in range(math.ceil(-self.origin[k] / step), math.floor((self.size[k] - self.origin[k]) / step) + 1):
                ends = [(i * step, low), (i * step, high)] if k == 0 else [(low, i * step), (high, i * step)]
                lines.append(Stroke(_rounded(ends), u, GRID if i else ZERO))
        return Part(_GROUND, tuple(sorted(lines, key=lambda line: line.color == ZERO)))

    def marks(self) -> Part:
        """Directions of the axes in the left lower corner, the scale in the right one."""
        u, (x, y), (right, _) = self.base, self.corner(24, 24), self.corner(-24, 24)
        left = right - self.scale * self.cell
        lines = [[(x, y + 30 * u), (x, y), (x + 30 * u, y)], [(left, y), (right, y)]]
        lines += [[(end, y - 4 * u), (end, y + 4 * u)] for end in (left, right)]
        tips = [[(36, 0), (28, 3), (28, -3)], [(0, 36), (3, 28), (-3, 28)]]
        return Part(
            _GROUND,
            (
                *(Stroke(_rounded(line), 1.5 * u, FAINT) for line in lines),
                *(Stroke(_rounded((x + dx * u, y + dy * u) for dx, dy in tip), u, FAINT, True) for tip in tips),
            ),
        )

    def mark_labels(self) -> list[Label]:
        """Names of the axes and the length of the scale."""
        (x, y), scale = self.corner(-24, 36), self.scale
        texts = {"x": self.corner(70, 24), "y": self.corner(24, 70), f"{self.cell:g} m": (x - scale * self.cell / 2, y)}
        return [
            Label(text, (Anchor(GROUND, x / scale, y / scale),), (), 0.0, 12 * self.base, FAINT)
            for text, (x, y) in texts.items()
        ]

    def support(self, at: Anchor, legs: bool) -> Part:
        """Ground under a point; with legs, under a hinge."""
        u, foot = self.unit, (-24 if legs else -9) * self.unit
        triangle = self._outlined([(0, 0), (-13 * u, foot), (13 * u, foot)], 2 * u, STEEL, True) if legs else ()
        return Part((at,), (*self._hatch(-24 * u, 24 * u, foot), *triangle, self._line([(-24 * u, foot), (24 * u, foot)])))

    def guide(self, guide: Guide, travel: Vector) -> Part:
        """Rails along the range in which a guide is used, hatched on the ground, about a dash-dotted centre line."""
        u, half = self.unit, self._half(guide)
        low, high = (end * self.scale + side * 44 * u for end, side in zip(travel, (-1, 1), strict=True))
        sides = (-half,) if guide.block is not None else (-half, half)
        strokes = [self._line([(low, y), (high, y)]) for y in sides]
        if guide.base.body == GROUND:
            strokes = [*self._hatch(low, high, -half), *strokes]
        for x in np.arange(low, high, 20 * u):
            strokes += [self._line([(x, 0), (x + 10 * u, 0)], 1, FAINT), self._line([(x + 15 * u, 0)], 1.5, FAINT)]
        return Part((guide.base,), tuple(strokes), guide.axis)

    # What moves

    def link(self, link: Link, color: str) -> Part:
        """A bar or plate through the points of a body, the mass at the end of an arm, nothing for a mere block."""
        u, strokes = self.unit, []
        points = [(x * self.scale, y * self.scale) for x, y in _hull(link.points)]
        if len(points) > 1:
            strokes += self._outlined(points, (8 if link.kind == "mass" else 14) * u, color, len(points) > 2)
        if link.kind == "mass":
            strokes += self._outlined([(0.0, 0.0)], 28 * u, color)
        return Part((Anchor(link.name, 0.0, 0.0),), tuple(strokes))

    def block(self, guide: Guide, color: str) -> Part:
        """The block that rides in a guide."""
        x, y = 24 * self.unit, self._half(guide) - 2 * self.unit
        corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
        return Part((guide.rider,), self._outlined(corners, 4 * self.unit, color, True), guide.block)

    def knot(self, knot: _Knot) -> Part:
        """A hinge as a circle, a weld as a square."""
        u = self.unit
        if knot.kind == "weld":
            square = [(-3 * u, -3 * u), (3 * u, -3 * u), (3 * u, 3 * u), (-3 * u, 3 * u)]
            return Part(knot.anchors[:1], (self._line(square, 2, INK, True),))
        return Part(knot.anchors[:1], self._outlined([(0.0, 0.0)], 13 * u, WHITE))

    def tie(self, tie: Tie) -> Part:
        """A rod, spring or damper from point to point, or a spiral around one."""
        u = self.unit
        if tie.kind == "spiral":
            turns = np.linspace(0, 5 * math.pi, 61)
            points = [((10 + 0.7 * t) * u * math.cos(t), (10 + 0.7 * t) * u * math.sin(t)) for t in turns]
            return Part((tie.first,), (self._line(points, 1.5),))
        if tie.kind == "rod":
            strokes = [self._line([(0, 0), (1, 0)], 4), *self._outlined([(0, 0)], 8 * u, WHITE)]
            return Part((tie.first, tie.second), (*strokes, *self._outlined([(1, 0)], 8 * u, WHITE)))
        apart = 9 * u if tie.kind == "spring-damper" else 0
        strokes = []
        if "spring" in tie.kind:
            teeth = [(0.26 + 0.06 * i, apart + (6 if i % 2 else -6) * u) for i in range(9)]
            coil = [(0, 0), (0.15, 0), (0.15, apart), (0.23, apart), *teeth]
            strokes += [self._line([*coil, (0.77, apart), (0.85, apart), (0.85, 0), (1, 0)])]
        if "damper" in tie.kind:
            y, r = -apart, 6 * u
            strokes += [
                self._line([(0, 0), (0.15, 0), (0.15, y), (0.38, y)]),
                self._line([(0.62, y + r), (0.38, y + r), (0.38, y - r), (0.62, y - r)]),
                self._line([(0.52, y + r / 2), (0.52, y - r / 2)], 3),
                self._line([(0.52, y), (0.85, y), (0.85, 0), (1, 0)]),
            ]
        return Part((tie.first, tie.second), (*strokes, self._line([(0, 0)], 6), self._line([(1, 0)], 6)))

    def dot(self, name: str, color: str) -> Part:
        """A point that outputs give."""
        return Part((Anchor(name, 0.0, 0.0),), self._outlined([(0.0, 0.0)], 14 * self.unit, color))

    # Labels

    def label(
        self, text: str, at: tuple[Anchor, ...], links: tuple[Anchor, ...], gap: float, size: float = 14, color: str = INK
    ) -> Label:
        """A label with its sizes in units."""
        return Label(text, at, links, gap * self.unit, size * self.unit, color)

    def guide_label(self, guide: Guide, travel: Vector) -> Label:
        """Under the beginning of the rails."""
        along = travel[0] - 44 * self.unit / self.scale
        c, s = math.cos(guide.axis), math.sin(guide.axis)
        at = replace(guide.base, x=guide.base.x + c * along, y=guide.base.y + s * along)
        return self.label(guide.name, (at,), (Anchor(guide.base.body, -s, c),), self._half(guide) / self.unit + 10)

    def link_label(self, link: Link, guides: tuple[Guide, ...], color: str) -> Label:
        """Beside the longest free stretch of a bar, in the middle of a plate, under a block."""
        for guide in guides:
            if link.kind == "block" and guide.rider.body == link.name:
                up = Anchor(link.name, -math.sin(guide.block), math.cos(guide.block))
                return self.label(link.name, (guide.rider,), (up,), self._half(guide) / self.unit + 10, 13, color)
        hull = _hull(link.points)
        if len(hull) == 1:
            return self.label(link.name, (Anchor(link.name, *hull[0]),), (), 18, 13, color)
        if len(hull) > 2:
            return self.label(link.name, tuple(Anchor(link.name, *p) for p in hull), (), 0, 13, color)
        (x, y), (ex, ey) = hull[0], _direction(*hull)
        if ex < 0 or (ex == 0 and ey < 0):
            ex, ey = -ex, -ey
        ordered = sorted(link.points, key=lambda p: (p[0] - x) * ex + (p[1] - y) * ey)
        gap = max(zip(ordered, ordered[1:], strict=False), key=lambda ends: round(math.dist(*ends), 9))
        return self.label(link.name, tuple(Anchor(link.name, *p) for p in gap), (Anchor(link.name, ey, -ex),), 10, 13, color)

    # Strokes

    def _line(self, points: Sequence[Vector], width: float = 2, color: str = INK, filled: bool = False) -> Stroke:
        return Stroke(_rounded(points), width * self.unit, color, filled)

    def _outlined(self, points: Sequence[Vector], width: float, color: str, filled: bool = False) -> tuple[Stroke, ...]:
        """A line or area of `width` pixels with a dark rim."""
        rim = 3.2 * self.unit
        dark = INK if color in (WHITE, STEEL) else _shade(color)
        points = _rounded(points)
        return Stroke(points, width + rim, dark, filled), Stroke(points, width, color, filled)

    def _hatch(self, low: float, high: float, y: float) -> list[Stroke]:
        """Slanted strokes under a line."""
        u = self.unit
        return [self._line([(x, y), (x - 7 * u, y - 8 * u)], 1.2, FAINT) for x in np.arange(low + 7 * u, high, 7 * u)]

    def _half(self, guide: Guide) -> float:
        """Half the height between the rails of a guide."""
        return (9 if guide.block is None else 15) * self.unit


_GROUND = (Anchor(GROUND, 0.0, 0.0),)


def _knots(shapes: Shapes) -> list[_Knot]:
    """Hinges, welds and pins; those that share a point are one."""
    knots: list[_Knot] = []
    for joint in shapes.joints:
        if joint.kind in ("prismatic", "distance"):
            continue
        anchors = (joint.second,) if joint.kind == "point_on_line" else (joint.first, joint.second)
        knot = _Knot((joint.name,), joint.kind, anchors)
        for other in [k for k in knots if set(k.anchors) & set(anchors)]:
            knots.remove(other)
            knot = _Knot(other.names + knot.names, other.kind, tuple(dict.fromkeys(other.anchors + knot.anchors)))
        knots.append(knot)
    return knots


def _supports(shapes: Shapes) -> dict[Anchor, bool]:
    """Points held by the ground, and whether the support has legs (all but welds)."""
    held = [(j.first, j.kind != "weld") for j in shapes.joints if j.kind in ("revolute", "weld", "distance")]
    held += [(at, True) for tie in shapes.ties if tie.kind != "spiral" for at in (tie.first, tie.second)]
    return {at: legs for at, legs in held if at.body == GROUND}


def _occupied(shapes: Shapes, knot: _Knot) -> tuple[Anchor, ...]:
    """Directions in which links, rails and ground lie, seen from a knot."""
    points = {link.name: link.points for link in shapes.links}
    directions = []
    for at in knot.anchors:
        if at.body == GROUND:
            directions.append(Anchor(GROUND, 0.0, -1.0))
        here = (at.x, at.y)
        directions += [Anchor(at.body, *_direction(here, p)) for p in points.get(at.body, ()) if math.dist(here, p) > 0]
        rails = [g.block for g in shapes.guides if g.block is not None and g.rider == at]
        directions += [Anchor(at.body, math.sin(angle), -math.cos(angle)) for angle in rails]
    return tuple(directions)


def _colors(names: Iterable[str]) -> dict[str, str]:
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}


def _direction(start: Vector, end: Vector) -> Vector:
    length = math.dist(start, end)
    return (end[0] - start[0]) / length, (end[1] - start[1]) / length


def _extent(points: Sequence[Vector]) -> float:
    return max(math.dist(a, b) for a in points for b in points)


def _hull(points: Sequence[Vector]) -> list[Vector]:
    """Corners of the convex hull of some points; the two ends where they lie on one line."""
    ordered = sorted(set(points))
    tolerance = 1e-9 * _extent(points) ** 2

    def chain(sequence: Sequence[Vector]) -> list[Vector]:
        corners: list[Vector] = []
        for x, y in sequence:
            while len(corners) > 1:
                (ax, ay), (bx, by) = corners[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > tolerance:
                    break
                corners.pop()
            corners.append((x, y))
        return corners

    return ordered if len(ordered) < 3 else chain(ordered)[:-1] + chain(ordered[::-1])[:-1]


def _rounded(points: Any) -> tuple[Vector, ...]:
    return tuple((round(float(x), 2), round(float(y), 2)) for x, y in points)


def _shade(color: str) -> str:
    """A darker version of a colour #rrggbb."""
    return "#" + "".join(f"{int(color[i : i + 2], 16) * 58 // 100:02x}" for i in (1, 3, 5))


# Painting with Pillow ---------------------------------------------------------------------------------------------

SAMPLES = 3
"""Pixels painted for each pixel shown, along either axis."""


def draw(
    shapes: Shapes,
    columns: Mapping[str, float],
    size: Size = (640, 480),
    view: View | None = None,
    trails: Mapping[str, Sequence[Vector]] | None = None,
    caption: str = "",
) -> Image.Image:
    """One frame of `size` [pixels]: the mechanism where the outputs `columns` put it.

    `view` is what the frame must hold (this instant alone, otherwise), `trails` the path [m] of dots by name, `caption`
    stands in the left upper corner. Raises InputError where a column is missing.
    """
    poses = _poses(shapes, columns)
    canvas = _Canvas(_scene(shapes, view or view_of(shapes, columns), size), poses)
    canvas.parts(canvas.scene.back)
    for dot, path in (trails or {}).items():
        canvas.trail(path, canvas.scene.trails[dot])
    canvas.parts(canvas.scene.front)
    canvas.labels(caption)
    return canvas.image.resize(size, Image.Resampling.LANCZOS)


class _Canvas:
    """A scene at one instant, painted larger than it is shown."""

    def __init__(self, scene: Scene, poses: Mapping[str, Pose]):
        self.scene, self.poses = scene, poses
        self.image = Image.new("RGB", (SAMPLES * scene.size[0], SAMPLES * scene.size[1]), BACKGROUND)
        self.pen = ImageDraw.Draw(self.image)

    def parts(self, parts: Sequence[Part]) -> None:
        """Strokes where their frames are."""
        for part in parts:
            (ox, oy), *rest = [self._pixels(_place(self.poses, at)) for at in part.at]
            if rest:
                ax, ay = rest[0][0] - ox, rest[0][1] - oy
                length = math.hypot(ax, ay) or 1.0
                bx, by = -ay / length, ax / length
            else:
                angle = float(self.poses[part.at[0].body][2]) + part.angle
                ax, ay = math.cos(angle), math.sin(angle)
                bx, by = -ay, ax
            for stroke in part.strokes:
                self._stroke([(ox + x * ax + y * bx, oy + x * ay + y * by) for x, y in stroke.points], stroke)

    def trail(self, path: Sequence[Vector], color: str) -> None:
        """A path in metres."""
        points = [self._pixels(p) for p in path]
        self._stroke(points, Stroke((), 2.5 * self.scene.unit, color))

    def labels(self, caption: str) -> None:
        """All labels, and a caption in the left upper corner."""
        for label in self.scene.labels:
            xs, ys = zip(*(self._pixels(_place(self.poses, at)) for at in label.at), strict=True)
            x, y = sum(xs) / len(xs), sum(ys) / len(ys)
            if label.gap:
                dx, dy = 0.0, 0.4
                for link in label.links:
                    c, s = math.cos(self.poses[link.body][2]), math.sin(self.poses[link.body][2])
                    dx, dy = dx - c * link.x + s * link.y, dy - s * link.x - c * link.y
                length = math.hypot(dx, dy) or 1.0
                x += dx / length * (label.gap + _width(label.text, label.size) / 2)
                y += dy / length * (label.gap + label.size / 2.6)
            self._text(x, y, label.text, label.size, label.color, "mm")
        unit = min(self.scene.size) / 480
        self._text(20 * unit, self.scene.size[1] - 24 * unit, caption, 14 * unit, FAINT, "lm")

    def _pixels(self, place: Vector) -> Vector:
        (ox, oy), scale = self.scene.origin, self.scene.scale
        return ox + scale * float(place[0]), oy + scale * float(place[1])

    def _stroke(self, points: Sequence[Vector], stroke: Stroke) -> None:
        top, width = self.scene.size[1], max(1, round(SAMPLES * stroke.width))
        points = [(SAMPLES * x, SAMPLES * (top - y)) for x, y in points]
        if stroke.filled:
            self.pen.polygon(points, stroke.color)
            points = [*points, points[0]]
        if len(points) > 1:
            self.pen.line(points, stroke.color, width)
        r = width / 2
        for x, y in points:
            self.pen.ellipse((x - r, y - r, x + r, y + r), stroke.color)

    def _text(self, x: float, y: float, text: str, size: float, color: str, anchor: str) -> None:
        place = SAMPLES * x, SAMPLES * (self.scene.size[1] - y)
        halo = round(SAMPLES * size / 5)
        self.pen.text(place, text, color, _font(SAMPLES * size), anchor, stroke_width=halo, stroke_fill=BACKGROUND)


@cache
def _font(size: float) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)


def _width(text: str, size: float) -> float:
    return _font(SAMPLES * size).getlength(text) / SAMPLES


# Pictures of a model and of a motion ------------------------------------------------------------------------------


def model_png(mechanism: Mechanism, size: Size = (640, 480)) -> bytes:
    """A PNG of a mechanism at its start, the same bytes each time.

    Where bars hide each other at the start (singular positions do that), the first start angle is taken 1 rad further,
    and the picture says so. Dots have the trail of the mechanism's own experiment, as far as it can be run.
    """
    shapes, equations = geometry(mechanism), derive(mechanism)
    columns, caption = _start(shapes, equations), ""
    angle = next((start for start in equations.starts if start.unit == "rad"), None)
    if angle and _hides(shapes, columns):
        with suppress(AlfmuError):
            columns = _start(shapes, equations, {angle.name: angle.start + 1})
            caption = f"shown at {angle.name} = {angle.start + 1:.4g} rad"
    trails, seen = {}, columns
    if shapes.dots:
        with suppress(AlfmuError):
            result = simulate(equations, outputs=shapes.columns)
            trails = {dot: list(zip(result[f"{dot}.x"], result[f"{dot}.y"], strict=True)) for dot in shapes.dots}
            seen = {name: result[name] for name in shapes.columns}
    buffer = io.BytesIO()
    draw(shapes, columns, size, view_of(shapes, seen), trails, caption).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _start(shapes: Shapes, equations: Equations, starts: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """The columns of a picture at the start."""
    instance = Instance(equations)
    for name, value in starts.items():
        instance.set(name, value)
    instance.initialize()
    return {name: instance.get(name) for name in shapes.columns}


def _hides(shapes: Shapes, columns: Mapping[str, float]) -> bool:
    """Whether two bars lie on each other over some length."""
    poses = _poses(shapes, columns)
    bars = [_hull(link.points) for link in shapes.links]
    places = [
        [np.array(_place(poses, Anchor(link.name, *p))) for p in hull]
        for link, hull in zip(shapes.links, bars, strict=True)
        if len(hull) == 2
    ]
    for (a, b), other in combinations(places, 2):
        along, length = (b - a) / np.linalg.norm(b - a), np.linalg.norm(b - a)
        s, n = zip(*((along @ (p - a), along[0] * (p - a)[1] - along[1] * (p - a)[0]) for p in other), strict=True)
        if max(map(abs, n)) < 1e-3 * length < min(max(s), length) - max(min(s), 0.0):
            return True
    return False


def animate(
    mechanism: Mechanism,
    result: Result,
    path: str | Path,
    *,
    parameters: Mapping[str, Any] | None = None,
    fps: float = 25,
    speed: float = 1.0,
    size: Size = (640, 480),
    progress: Callable[[Sequence[float]], Iterator[float]] = iter,
) -> None:
    """Write a motion as an endless `.gif`, or as an `.html` page that needs nothing else and can be stopped and scrolled.

    `result` has `time` [s], `names` and arrays by name; `parameters` are those it was run with. `fps` is that of a GIF (a
    page draws as often as the browser does), `speed` the time [s] shown per second. `progress` wraps the instants of the
    frames. Raises InputError where the suffix is another one, a column is missing, or fps or speed is not above zero.
    """
    path = Path(path)
    if path.suffix not in (".gif", ".html"):
        raise InputError(f"{path} cannot hold an animation; its name must end in .gif or .html")
    for name, value in (("fps", fps), ("speed", speed)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{mechanism.name}: {name} is {value}; it must be a finite number above zero")
    shapes = geometry(mechanism, parameters)
    columns = {name: result[name] for name in shapes.columns if name in result.names}
    view = view_of(shapes, columns)
    if path.suffix == ".gif":
        delay, instants = _instants(result.time, fps, speed)
        _write_gif(shapes, view, size, delay, progress(instants), _sampled(result.time, columns, instants), path)
    else:
        time = result.time
        ...
