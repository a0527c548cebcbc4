"""Drawings of mechanisms: one frame, the picture of a model, an animation of a result.

The declaration gives the shapes in metres (`geometry`), the motion gives what they must fit in (`view_of`). From both
follows a scene: strokes in pixels, each fixed to the ground, to a body, to a dot or between two points. Two small
painters show it, one with Pillow (`draw`, GIF), one in a browser (HTML).
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from ..equations import Equations
from ..equations.derivation import derive
from ..files import atomic, write
from ..model.errors import AlfmuError, DeclarationError, InputError
from ..model.mechanism import Joint, Marker, Mechanism, Scalar, key_of
from ..result import Result
from ..runtime import Instance
from ..runtime.probe import Probe
from ..simulation import Progress, simulate, with_defaults

__all__ = ["Shapes", "View", "animate", "draw", "geometry", "model_png", "view_of"]

GROUND = "ground"

MAX_FRAMES = 750
"""Frames of a GIF, at most; a longer motion is shown with fewer frames per second."""

COLORS_OF_GIF = 96
"""Colours that all frames of a GIF share."""

MAX_SAMPLES = 5000
"""Instants of a result that an animation uses, at most; it interpolates between them."""

Vector = tuple[float, float]

Size = tuple[int, int]


# Shapes: what there is, in metres ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Anchor:
    """A point fixed on a body, by its place [m] from the centre of mass (the ground's origin) in its axes."""

    body: str
    x: float
    y: float


_ORIGIN = (Anchor(GROUND, 0.0, 0.0),)


@dataclass(frozen=True)
class Link:
    """A body: the points that its joints, springs and ends have on it, at least one, from its centre of mass [m].

    `kind` is "bar" (through its points), "mass" (fewer than two points of its own: an arm to its centre of mass) or
    "block" (rides in a guide).
    """

    name: str
    kind: Literal["bar", "mass", "block"]
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
    """What acts between two points: a "rod" (a joint's), "spring", "damper", "spring-damper" or torsional "spiral"."""

    name: str
    kind: Literal["rod", "spring", "damper", "spring-damper", "spiral"]
    first: Anchor
    second: Anchor


@dataclass(frozen=True)
class Shapes:
    """All that a picture of a mechanism shows; `dots` are points that user outputs `NAME.x`, `NAME.y` give."""

    name: str
    description: str = field(compare=False)
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
        first, second = between if isinstance(between, tuple) else (between.first, between.second)
        if not isinstance(first, Marker):
            continue  # of bodies in space the centres of mass are shown
        kinds = {"spring": spring.stiffness, "damper": spring.damping}
        kind = "-".join(kind for kind, strength in kinds.items() if not ca.SX(strength).is_zero())
        if isinstance(between, Joint) and between.kind == "revolute":
            kind = "spiral" if "spring" in kind else ""
        if kind:
            ties.append(Tie("", kind, anchor(first), anchor(second)))

    fixed: dict[str, list[Anchor]] = {}
    for pair in (*joints, *ties):
        for at in (pair.first, pair.second):
            fixed.setdefault(at.body, []).append(at)
    blocks = {g.rider.body for g in guides if g.block is not None}
    links = []
    for body in m.bodies:
        ends = [] if body.length is None else [anchor(body.start), anchor(body.end)]
        points = list(dict.fromkeys((a.x, a.y) for a in (*ends, *fixed.get(body.name, ()))))
        kind = "block" if body.name in blocks else "bar" if len(points) > 1 else "mass"
        if kind == "mass" and (0.0, 0.0) not in points:
            points.append((0.0, 0.0))
        links.append(Link(body.name, kind, tuple(points)))

    places = [o.name for o in m.outputs if o.unit == "m"] + [f"{b.name}.{k}" for b in m.spatial_bodies for k in "xy"]
    dots = tuple(name[:-2] for name in places if name.endswith(".x") and f"{name[:-2]}.y" in places)
    return Shapes(m.name, m.description, tuple(links), joints, guides, tuple(ties), dots)


def _evaluator(m: Mechanism, parameters: Mapping[str, Any]) -> Callable[[Scalar], float]:
    """What turns an expression in parameters into a number."""
    symbols = ca.vertcat(*(p.symbol for p in m.parameters))
    values = ca.DM([_given(m, p.name, parameters.get(p.name, p.default)) for p in m.parameters])
    known: dict[int, tuple[ca.SX, float]] = {}  # with the expression, so that its key stays its own

    def number(expression: Scalar) -> float:
        if not isinstance(expression, ca.SX):
            return float(expression)
        key = key_of(expression)
        if key not in known:
            value = ca.substitute(expression, symbols, values) if m.parameters else expression
            if not value.is_constant():
                free = ca.symvar(value)[0]
                raise DeclarationError(f"{m.name}: a shape uses {free}; it may use parameters only")
            known[key] = expression, float(value)
        return known[key][1]

    return number


def _given(m: Mechanism, name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{m.name}: {name} is {value!r}; it must be a number") from None


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
    points += [_place(poses, at) for at in _supports(shapes)]
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
            f"{shapes.name}: a picture needs {missing[0]}; the result must hold all outputs of bodies (x, y and angle "
            "of each) and of dots, so run it without choosing outputs"
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
    colors: dict[str, str]
    """Of bodies and dots."""
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
    names = [*(link.name for link in shapes.links), *shapes.dots]
    colors = {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}
    back = [pen.grid(), pen.marks()]
    back += [pen.support(at, legs) for at, legs in _supports(shapes).items()]
    front = [pen.link(link, colors[link.name]) for link in shapes.links]
    for guide, travel in guides:
        (back if guide.base.body == GROUND else front).extend(pen.guide(guide, travel, colors[guide.rider.body]))
    front += [pen.tie(tie) for tie in shapes.ties]
    front += [pen.knot(knot) for knot in knots]
    front += [pen.dot(dot, colors[dot]) for dot in shapes.dots]
    labels = pen.mark_labels()
    if pen.unit >= 0.5 * pen.base:
        labels += [pen.label(tie.name, (tie.first, tie.second), (), 5) for tie in shapes.ties if tie.name]
        labels += [pen.label(dot, (Anchor(dot, 0.0, 0.0),), (), 10) for dot in shapes.dots]
        labels += [pen.guide_label(guide, travel) for guide, travel in guides]
        labels += [pen.link_label(link, shapes.guides, _shade(colors[link.name])) for link in shapes.links]
        labels += [pen.knot_label(knot, shapes) for knot in knots if knot.names]
    return Scene(size, pen.scale, pen.origin, pen.unit, tuple(back), colors, tuple(front), tuple(labels))


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
        base = _base(size)
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

    @property
    def overhang(self) -> float:
        """How far rails go beyond the places where they are used [pixels]."""
        return 50 * self.unit

    def corner(self, x: float, y: float) -> Vector:
        """A place so many `base` pixels from the left lower corner (x < 0: the right one), seen from the origin."""
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
        return Part(_ORIGIN, tuple(sorted(lines, key=lambda line: line.color == ZERO)))

    def marks(self) -> Part:
        """Directions of the axes in the left lower corner, the scale in the right one."""
        u, (x, y), (right, _) = self.base, self.corner(24, 24), self.corner(-24, 24)
        left = right - self.scale * self.cell
        lines = [[(x, y + 30 * u), (x, y), (x + 30 * u, y)], [(left, y), (right, y)]]
        lines += [[(end, y - 4 * u), (end, y + 4 * u)] for end in (left, right)]
        tips = [[(36, 0), (28, 3), (28, -3)], [(0, 36), (3, 28), (-3, 28)]]
        return Part(
            _ORIGIN,
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
        strokes = [*self._hatch(-24 * u, 24 * u, foot), self._line([(-24 * u, foot), (24 * u, foot)])]
        if legs:
            strokes += self._outlined([(0, 0), (-13 * u, foot), (13 * u, foot)], 2 * u, STEEL, True)
        return Part((at,), tuple(strokes))

    def guide(self, guide: Guide, travel: Vector, color: str) -> list[Part]:
        """Rails about a dash-dotted centre line where a guide is used, hatched on the ground, and the block in them."""
        u, half = self.unit, self._half(guide)
        low, high = (end * self.scale + side * self.overhang for end, side in zip(travel, (-1, 1), strict=True))
        strokes = [self._line([(low, -half), (high, -half)])]
        if guide.base.body == GROUND:
            strokes += self._hatch(low, high, -half)
        if guide.base.body != GROUND or guide.block is None:
            strokes += [self._line([(low, half), (high, half)])]
        for x in np.arange(low, high, 20 * u):
            strokes += [self._line([(x, 0), (x + 10 * u, 0)], 1, FAINT), self._line([(x + 15 * u, 0)], 1.5, FAINT)]
        rails = Part((guide.base,), tuple(strokes), guide.axis)
        if guide.block is None:
            return [rails]
        x, y = 24 * u, half - 2 * u
        corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
        return [rails, Part((guide.rider,), self._outlined(corners, 4 * u, color, True), guide.block)]

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
            teeth = [(0.26 + 0.04 * i, apart + (7 if i % 2 else -7) * u) for i in range(13)]
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
        self,
        text: str,
        at: tuple[Anchor, ...],
        links: tuple[Anchor, ...],
        gap: float,
        size: float = 14,
        color: str = INK,
    ) -> Label:
        """A label with its sizes in units."""
        return Label(text, at, links, gap * self.unit, size * self.unit, color)

    def knot_label(self, knot: _Knot, shapes: Shapes) -> Label:
        """On the side that links, rails and ground leave free."""
        points = {link.name: link.points for link in shapes.links}
        directions = [Anchor(GROUND, 0.0, -1.0) for at in knot.anchors if at.body == GROUND]
        for at in knot.anchors:
            others = [p for p in points.get(at.body, ()) if p != (at.x, at.y)]
            directions += [Anchor(at.body, *_direction((at.x, at.y), p)) for p in others]
        blocks = [g for g in shapes.guides if g.block is not None and g.rider in knot.anchors]
        directions += [Anchor(g.rider.body, math.sin(g.block), -math.cos(g.block)) for g in blocks]
        spirals = [tie for tie in shapes.ties if tie.kind == "spiral" and tie.first in knot.anchors]
        return self.label(", ".join(knot.names), knot.anchors[:1], tuple(directions), 26 if blocks or spirals else 11)

    def guide_label(self, guide: Guide, travel: Vector) -> Label:
        """Under the beginning of the rails."""
        along = travel[0] - self.overhang / self.scale
        c, s = math.cos(guide.axis), math.sin(guide.axis)
        at = replace(guide.base, x=guide.base.x + c * along, y=guide.base.y + s * along)
        return self.label(guide.name, (at,), (Anchor(guide.base.body, -s, c),), self._half(guide) / self.unit + 12)

    def link_label(self, link: Link, guides: Sequence[Guide], color: str) -> Label:
        """Beside the longest free stretch of a bar, in the middle of a plate, under a block."""

        def label(at: Sequence[Vector], away: Sequence[Vector], gap: float) -> Label:
            anchors = (tuple(Anchor(link.name, *p) for p in group) for group in (at, away))
            return self.label(link.name, *anchors, gap, 13, color)

        hull = _hull(link.points)
        for guide in guides:
            if link.kind == "block" and guide.rider.body == link.name and guide.block is not None:
                up = -math.sin(guide.block), math.cos(guide.block)
                return label([(guide.rider.x, guide.rider.y)], [up], self._half(guide) / self.unit + 12)
        if len(hull) == 1:
            return label(hull, [], 18)
        if len(hull) > 2:
            return label(hull, [], 0)
        ex, ey = max(_direction(*hull), _direction(*hull[::-1]))
        gap = max(pairwise(sorted(link.points)), key=lambda ends: round(math.dist(*ends), 9))
        return label(gap, [(ey, -ex)], 15)

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


def _base(size: Size) -> float:
    """Size of a picture compared with 640 x 480."""
    return min(size[0] / 640, size[1] / 480)


def _knots(shapes: Shapes) -> list[_Knot]:
    """Hinges, welds and pins; those that share a point are one."""
    knots: dict[int, _Knot] = {}
    found: dict[Anchor, int] = {}
    for i, joint in enumerate(shapes.joints):
        if joint.kind in ("prismatic", "distance"):
            continue
        knot = _Knot((joint.name,), joint.kind, (joint.first, joint.second))
        if joint.kind == "point_on_line":  # its guide has the name
            knot = _Knot((), joint.kind, (joint.second,))
        for k in sorted({found[at] for at in knot.anchors if at in found}):
            other = knots.pop(k)
            knot = _Knot(other.names + knot.names, other.kind, tuple(dict.fromkeys(other.anchors + knot.anchors)))
        knots[i] = knot
        found |= dict.fromkeys(knot.anchors, i)
    return list(knots.values())


def _supports(shapes: Shapes) -> dict[Anchor, bool]:
    """Points held by the ground, and whether the support has legs (all but welds)."""
    held = [(j.first, j.kind != "weld") for j in shapes.joints if j.kind in ("revolute", "weld", "distance")]
    held += [(at, True) for tie in shapes.ties if tie.kind != "spiral" for at in (tie.first, tie.second)]
    return {at: legs for at, legs in held if at.body == GROUND}


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
        canvas.trail(path, canvas.scene.colors[dot])
    canvas.parts(canvas.scene.front)
    canvas.labels(caption)
    return canvas.image.reduce(SAMPLES)


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
                dx, dy = dx / length, dy / length
                clear = label.gap + abs(dx) * _width(label.text, label.size) / 2 + abs(dy) * label.size / 3
                x, y = x + dx * clear, y + dy * clear
            self._text(x, y, label.text, label.size, label.color, "mm")
        base = _base(self.scene.size)
        self._text(20 * base, self.scene.size[1] - 24 * base, caption, 14 * base, FAINT, "lm")

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
        halo = round(SAMPLES * size / 7)
        self.pen.text(place, text, color, _font(SAMPLES * size), anchor, stroke_width=halo, stroke_fill=BACKGROUND)


@cache
def _font(size: float) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)


def _width(text: str, size: float) -> float:
    return _font(SAMPLES * size).getlength(text) / SAMPLES


# Pictures of a model and of a motion ------------------------------------------------------------------------------


def model_png(
    mechanism: Mechanism,
    parameters: Mapping[str, float | str] | None = None,
    size: Size = (640, 480),
    equations: Equations | None = None,
) -> bytes:
    """A PNG of a mechanism at its start, the same bytes each time; `parameters` changes defaults as `export` does.

    `equations` are those of the mechanism, all outputs and parameters in them, where they are derived already.
    Where bars hide each other at the start (singular positions do that), the first start angle is taken 1 rad further,
    and the picture says so. Dots have the trail of the mechanism's own experiment, as far as 500 steps and as it can be
    run. Raises AlfmuError where the mechanism cannot start.
    """
    equations = with_defaults(equations or derive(mechanism), parameters or {})
    shapes = geometry(mechanism, parameters)
    columns = _start(shapes, equations)
    caption = "" if columns else f"{mechanism.name} declares no bodies and no points"
    angle = next((start for start in equations.starts if start.unit == "rad"), None)
    if angle and _hides(shapes, columns):
        turned = {angle.name: round(angle.start + 1, 4)}
        with suppress(AlfmuError):
            columns = _start(shapes, with_defaults(equations, turned))
            caption = f"shown at {angle.name} = {turned[angle.name]:g} rad"
    covered, trails = columns, {}
    if shapes.dots:
        stop_time = min(equations.stop_time, 500 * equations.step_size)
        with suppress(AlfmuError):
            result = simulate(equations, stop_time, equations.step_size, outputs=shapes.columns)
            covered = {name: np.append(result[name], columns[name]) for name in shapes.columns}
            trails = {dot: _path(result, dot) for dot in shapes.dots}
    buffer = io.BytesIO()
    draw(shapes, columns, size, view_of(shapes, covered), trails, caption).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _start(shapes: Shapes, equations: Equations) -> dict[str, float]:
    """The columns of a picture at the start."""
    probe = Probe.of(equations)
    if probe is None:
        Instance(equations).initialize()  # says why there is no start
        return {}
    q, v, u, p, t = (probe.numbers[letter] for letter in "qvupt")
    nothing = np.zeros(equations.n), np.zeros(equations.l)  # no place depends on accelerations and multipliers
    values = np.array(equations.functions["readings"](q, v, *nothing, u, p, t)).ravel()
    known = dict(zip((each.name for each in equations.outputs), values.tolist(), strict=True))
    return {name: known[name] for name in shapes.columns}


def _path(columns: Mapping[str, Sequence[float]] | Result, dot: str) -> list[Vector]:
    """Where a dot has been [m]."""
    return list(zip(columns[f"{dot}.x"], columns[f"{dot}.y"], strict=True))


def _hides(shapes: Shapes, columns: Mapping[str, float]) -> bool:
    """Whether two bars lie on each other over some length."""
    poses = _poses(shapes, columns)
    bars = [(link.name, hull) for link in shapes.links if len(hull := _hull(link.points)) == 2]
    places = np.array([[complex(*_place(poses, Anchor(name, *p))) for p in hull] for name, hull in bars])
    for i, (start, end) in enumerate(places[:-1]):
        one, other = (places[i + 1 :].T - start) / (end - start)  # real part along the bar, imaginary part across
        near = np.maximum(np.minimum(one.real, other.real), 0.0)
        far = np.minimum(np.maximum(one.real, other.real), 1.0)
        across = np.maximum(np.abs(one.imag), np.abs(other.imag))
        if np.any((across < 1e-3) & (far - near > 1e-3)):
            return True
    return False


def animate(
    shown: Mechanism | Shapes,
    result: Result,
    path: str | Path,
    *,
    parameters: Mapping[str, float | str] | None = None,
    fps: float = 25,
    speed: float = 1.0,
    size: Size = (640, 480),
    progress: Progress = iter,
) -> None:
    """Write a motion as an endless `.gif`, or as an `.html` page with controls that needs nothing else.

    `result` has `time` [s], `names` and arrays by name; `parameters` is what it was run with, for a mechanism (shapes
    have theirs). `speed` is the time [s]
    shown per second. `fps` and `progress` (wraps the instants of the frames [s]) are those of a GIF; a page draws as
    often as the browser does. Raises InputError where the suffix is another one, a column is missing, or a number is
    not above zero.
    """
    path = Path(path)
    check_film(path)
    for name, value in (("fps", fps), ("speed", speed)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{shown.name}: {name} is {value}; it must be a finite number above zero")
    shapes = shown if isinstance(shown, Shapes) else geometry(shown, parameters)
    if not shapes.columns:
        raise InputError(
            f"{shapes.name} has nothing to draw; it needs bodies, or outputs NAME.x and NAME.y in m for each point"
        )
    time, columns = result.time, {name: result[name] for name in shapes.columns if name in result.names}
    view = view_of(shapes, columns)
    if len(time) > MAX_SAMPLES:
        instants = np.linspace(time[0], time[-1], MAX_SAMPLES)
        time, columns = instants, {name: np.interp(instants, time, x) for name, x in columns.items()}
    if path.suffix == ".gif":
        with atomic(path) as file:
            _film(file, shapes, view, size, time, columns, *_instants(time, fps, speed), progress)
    else:
        write(path, _page(shapes, _scene(shapes, view, size), time, columns, speed).encode())


def check_film(path: Path) -> None:
    """InputError where a film has no kind of this name."""
    if path.suffix not in (".gif", ".html"):
        raise InputError(f"{path} cannot hold an animation; its name must end in .gif or .html")


def _film(
    file: BinaryIO,
    shapes: Shapes,
    view: View,
    size: Size,
    time: NDArray,
    columns: Mapping[str, NDArray],
    delay: int,
    instants: list[float],
    progress: Progress,
) -> None:
    """A GIF of a motion at some instants [s], each for `delay` [ms]."""
    some = instants[:: math.ceil(len(instants) / 5)]
    sheet = np.concatenate([np.asarray(f) for f in _frames(shapes, view, size, time, columns, some)])
    palette = Image.fromarray(sheet).quantize(COLORS_OF_GIF)
    frames = _frames(shapes, view, size, time, columns, progress(instants))
    indexed = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    next(indexed).save(file, "GIF", save_all=True, append_images=indexed, duration=delay, loop=0)


def _instants(time: NDArray, fps: float, speed: float) -> tuple[int, list[float]]:
    """Duration of each frame of a GIF [ms], whole hundredths of a second as GIF counts, and their instants [s]."""
    seconds = (time[-1] - time[0]) / speed
    hundredths = max(2, round(100 / fps), math.ceil(100 * seconds / MAX_FRAMES))
    count = 1 + math.floor(100 * seconds / hundredths * (1 + 1e-12))
    return 10 * hundredths, [float(time[0] + i * hundredths / 100 * speed) for i in range(count)]


def _frames(
    shapes: Shapes,
    view: View,
    size: Size,
    time: NDArray,
    columns: Mapping[str, NDArray],
    instants: Iterable[float],
) -> Iterator[Image.Image]:
    """Pictures of a motion at some instants [s], dots with the trail behind them."""
    for t in instants:
        now = {name: float(np.interp(t, time, x)) for name, x in columns.items()}
        past = {name: [*columns[name][time < t], now[name]] for name in now}
        trails = {dot: _path(past, dot) for dot in shapes.dots}
        yield draw(shapes, now, size, view, trails, f"t = {t:.2f} s")


def _page(shapes: Shapes, scene: Scene, time: NDArray, columns: Mapping[str, NDArray], speed: float) -> str:
    """The page of a motion: its scene, and all poses over time to a hundredth of a pixel and 1e-4 rad."""
    digits = _digits(0.01 / scene.scale)
    data = {
        "scene": asdict(scene),
        "dots": shapes.dots,
        "time": np.round(time, _digits(1e-6 * (time[-1] - time[0]) or 1.0)).tolist(),
        "poses": {
            name: [np.round(q + 0 * time, n).tolist() for q, n in zip(pose, (digits, digits, 4), strict=True)]
            for name, pose in _poses(shapes, columns).items()
        },
        "speed": speed,
    }
    values = {
        "title": escape(shapes.name.replace("_", " ")),
        "description": escape(shapes.description),
        "background": BACKGROUND,
        "data": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: values[match[1]], PAGE)


def _digits(step: float) -> int:
    """Decimals that distinguish values that differ by `step`."""
    return -math.floor(math.log10(step))


PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{title}}</title>
<style>
  :root { color-scheme: light; font-family: system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
  body { margin: 0; min-height: 100vh; display: grid; place-items: center; background: #e9edf2; color: #2b3440; }
  main { width: min(94vw, 960px, calc((100vh - 11rem) * var(--aspect))); min-width: min(94vw, 320px); margin: 1rem; }
  h1 { font-size: 1.15rem; font-weight: 600; margin: 0; }
  header p { margin: .15rem 0 .8rem; color: #66727f; font-size: .92rem; }
  figure { margin: 0; background: {{background}}; border: 1px solid #d5dce4; border-radius: 10px; overflow: hidden;
    box-shadow: 0 1px 2px #2b344014, 0 8px 28px #2b34401c; }
  canvas { display: block; width: 100%; aspect-ratio: var(--aspect); }
  nav { display: flex; align-items: center; gap: .8rem; padding: .6rem .9rem; border-top: 1px solid #e3e8ee;
    background: #fff; }
  button { display: grid; place-items: center; width: 2.3rem; height: 2.3rem; flex: none; border: 0; border-radius: 50%;
    background: #3f6f9e; cursor: pointer; }
  button:hover { background: #335c85; }
  button svg { width: 1rem; height: 1rem; fill: #fff; }
  button .pause, button.playing .play { display: none; }
  button.playing .pause { display: block; }
  input { flex: 1; min-width: 4rem; accent-color: #3f6f9e; }
  output { font-variant-numeric: tabular-nums; white-space: nowrap; font-size: .92rem; min-width: 7.6rem;
    text-align: right; }
  select { font: inherit; font-size: .92rem; padding: .2rem .3rem; border: 1px solid #d5dce4; border-radius: 6px;
    background: #fff; color: inherit; }
  :focus-visible { outline: 2px solid #e3b05f; outline-offset: 2px; }
</style>
</head>
<body>
<main>
  <header><h1>{{title}}</h1><p>{{description}}</p></header>
  <figure>
    <canvas role="img" aria-label="Moving picture of {{title}}"></canvas>
    <nav>
      <button type="button" aria-label="Play or pause" title="Play or pause (space)">
        <svg class="play" viewBox="0 0 16 16"><path d="M4 2l10 6-10 6z"/></svg>
        <svg class="pause" viewBox="0 0 16 16"><path d="M3 2h4v12H3zM9 2h4v12H9z"/></svg>
      </button>
      <input type="range" min="0" max="1" step="any" value="0" aria-label="Time" title="Time (arrow keys)">
      <output></output>
      <select aria-label="Speed" title="Speed"></select>
    </nav>
  </figure>
</main>
<script type="application/json" id="data">{{data}}</script>
<script>
"use strict";
const { scene, dots, time, poses, speed } = JSON.parse(document.getElementById("data").textContent);
const [width, height] = scene.size;
const first = time[0], last = time[time.length - 1];
const find = (tag) => document.querySelector(tag);
const canvas = find("canvas"), button = find("button"), slider = find("input"), shown = find("output");
const select = find("select"), pen = canvas.getContext("2d");
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
let now = first, playing = !still && last > first, before = null;

document.documentElement.style.setProperty("--aspect", width / height);
slider.min = first;
slider.max = last;
for (const s of [...new Set([0.1, 0.25, 0.5, 1, 2, 5, 10, speed])].sort((a, b) => a - b)) {
  select.add(new Option(s + " \u00d7", s, s === speed, s === speed));
}

// The last instant not after t.
function latest(t) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// Pixels and angle of every frame at t, interpolated.
function posesAt(t) {
  const i = latest(t), j = Math.min(i + 1, time.length - 1);
  const share = j > i ? (t - time[i]) / (time[j] - time[i]) : 0;
  const now = {};
  for (const name in poses) {
    const [x, y, angle] = poses[name].map((q) => q[i] + share * (q[j] - q[i]));
    now[name] = { x, y, angle };
  }
  return [now, i];
}

const pixels = (x, y) => [scene.origin[0] + scene.scale * x, scene.origin[1] + scene.scale * y];

function turned(pose, x, y) {
  const c = Math.cos(pose.angle), s = Math.sin(pose.angle);
  return [c * x - s * y, s * x + c * y];
}

function place(frames, at) {
  const pose = frames[at.body], [dx, dy] = turned(pose, at.x, at.y);
  return pixels(pose.x + dx, pose.y + dy);
}

function stroke(points, { width, color, filled }) {
  pen.lineWidth = width;
  pen.strokeStyle = pen.fillStyle = color;
  pen.beginPath();
  if (points.length === 1) {
    pen.arc(...points[0], width / 2, 0, 2 * Math.PI);
    pen.fill();
    return;
  }
  points.forEach(([x, y]) => pen.lineTo(x, y));
  if (filled) { pen.closePath(); pen.fill(); }
  pen.stroke();
}

function part(frames, { at, strokes, angle }) {
  const [[ox, oy], end] = at.map((a) => place(frames, a));
  const turn = angle + frames[at[0].body].angle;
  let ax = Math.cos(turn), ay = Math.sin(turn), across = 1;
  if (end) {
    [ax, ay] = [end[0] - ox, end[1] - oy];
    across = 1 / (Math.hypot(ax, ay) || 1);
  }
  for (const s of strokes) {
    stroke(s.points.map(([x, y]) => [ox + x * ax - y * across * ay, oy + x * ay + y * across * ax]), s);
  }
}

function trail(dot, frames, i) {
  const [xs, ys] = poses[dot], points = [];
  for (let k = 0; k <= i; k++) points.push(pixels(xs[k], ys[k]));
  points.push(pixels(frames[dot].x, frames[dot].y));
  stroke(points, { width: 2.5 * scene.unit, color: scene.colors[dot] });
}

function label(frames, { text, at, links, gap, size, color }) {
  const places = at.map((a) => place(frames, a));
  let [x, y] = [0, 1].map((k) => places.reduce((sum, p) => sum + p[k], 0) / places.length);
  pen.font = `${size}px system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif`;
  if (gap) {
    let dx = 0, dy = 0.4;
    for (const link of links) {
      const [ex, ey] = turned(frames[link.body], link.x, link.y);
      [dx, dy] = [dx - ex, dy - ey];
    }
    const length = Math.hypot(dx, dy) || 1;
    [dx, dy] = [dx / length, dy / length];
    const clear = gap + Math.abs(dx) * pen.measureText(text).width / 2 + Math.abs(dy) * size / 3;
    [x, y] = [x + dx * clear, y + dy * clear];
  }
  pen.save();
  pen.translate(x, y);
  pen.scale(1, -1);
  pen.lineWidth = 2 * size / 7;
  pen.strokeStyle = "{{background}}";
  pen.fillStyle = color;
  pen.strokeText(text, 0, 0);
  pen.fillText(text, 0, 0);
  pen.restore();
}

function draw() {
  const [frames, i] = posesAt(now), k = canvas.width / width;
  pen.setTransform(k, 0, 0, -k, 0, k * height);
  pen.fillStyle = "{{background}}";
  pen.fillRect(0, 0, width, height);
  pen.lineCap = pen.lineJoin = "round";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  scene.back.forEach((p) => part(frames, p));
  dots.forEach((dot) => trail(dot, frames, i));
  scene.front.forEach((p) => part(frames, p));
  scene.labels.forEach((l) => label(frames, l));
  slider.value = now;
  shown.value = `${now.toFixed(2)} s / ${last.toFixed(2)} s`;
  button.classList.toggle("playing", playing);
}

function tick(stamp) {
  if (playing && before !== null) {
    now += Math.min(stamp - before, 100) / 1000 * Number(select.value);
    if (now > last) now = first + (now - last) % (last - first);
    draw();
  }
  before = stamp;
  requestAnimationFrame(tick);
}

function toggle() {
  playing = !playing && last > first;
  draw();
}

button.addEventListener("click", toggle);
slider.addEventListener("input", () => { now = Number(slider.value); playing = false; draw(); });
document.addEventListener("keydown", (event) => {
  if (event.code === "Space" && event.target !== button) { event.preventDefault(); toggle(); }
});
new ResizeObserver(() => {
  canvas.width = Math.round(canvas.clientWidth * devicePixelRatio);
  canvas.height = Math.round(canvas.width * height / width);
  draw();
}).observe(canvas);
requestAnimationFrame(tick);
</script>
</body>
</html>
"""
