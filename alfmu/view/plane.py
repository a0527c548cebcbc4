"""Pictures of mechanisms in the plane.

The shapes give what there is, the motion gives what they must fit in (`view_of`). From both follows a scene: strokes in
pixels, each fixed to the ground, to a body, to a dot or between two points. `paint` shows it at one instant; the script
that pages share (`shared/strokes.js`) does so in a browser.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..model.errors import InputError
from .shapes import GROUND, ORIGIN, Anchor, Guide, Link, Rim, Shapes, Tie
from .surface import (
    COLORS,
    FAINT,
    GRID,
    INK,
    STEEL,
    WHITE,
    ZERO,
    Size,
    Stroke,
    Surface,
    Text,
    Vector,
    base_of,
    cell_of,
    placed,
    rounded,
    shade,
    width_of,
)

__all__ = ["View", "hides", "hull_of", "paint", "poses_of", "scene_of", "view_of"]

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
    poses = poses_of(shapes, columns)
    for name, pose in poses.items():
        if not all(np.isfinite(q).all() for q in pose):
            raise InputError(f"{shapes.name}: the place of {name} is not finite all the time, so it cannot be drawn")
    points = [place_of(poses, Anchor(link.name, *p)) for link in shapes.links for p in link.points]
    points += [place_of(poses, Anchor(rim.body, *p)) for rim in shapes.rims for p in rim.points]
    points += [place_of(poses, at) for at in _supports(shapes)]
    points += [poses[dot][:2] for dot in shapes.dots]
    xs, ys = (np.concatenate([np.ravel(p[k]) for p in points] or [[0.0]]) for k in (0, 1))
    travel = []
    for guide in shapes.guides:
        (x, y), (rx, ry) = place_of(poses, guide.base), place_of(poses, guide.rider)
        axis = poses[guide.base.body][2] + guide.axis
        along = (rx - x) * np.cos(axis) + (ry - y) * np.sin(axis)
        travel.append((float(np.min(along)), float(np.max(along))))
    return View((float(xs.min()), float(ys.min())), (float(xs.max()), float(ys.max())), tuple(travel))


def poses_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> dict[str, Pose]:
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


def place_of(poses: Mapping[str, Pose], at: Anchor) -> tuple[Any, Any]:
    """A point in ground axes [m]."""
    x, y, angle = poses[at.body]
    c, s = np.cos(angle), np.sin(angle)
    return x + c * at.x - s * at.y, y + s * at.x + c * at.y


# Scene: what it looks like, in pixels -----------------------------------------------------------------------------


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
    """Text in the middle of some points, or `gap` pixels from there in the middle of the widest gap that `links` leave.

    What is `free` gives way to other labels and to pins.
    """

    text: str
    at: tuple[Anchor, ...]
    links: tuple[Anchor, ...]
    gap: float
    size: float
    color: str
    free: bool = True


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
    pins: tuple[Anchor, ...]
    pin: float
    """Radius of a pin that no label covers [pixels]."""


@dataclass(frozen=True)
class _Knot:
    """Joints that share a point."""

    names: tuple[str, ...]
    kind: str
    anchors: tuple[Anchor, ...]


def scene_of(shapes: Shapes, view: View, size: Size) -> Scene:
    """The scene that fits `view` into `size` [pixels] with equal axes."""
    pen = _Pen.fitting(shapes, view, size)
    guides = list(zip(shapes.guides, view.travel, strict=True))
    knots = _knots(shapes)
    names = [*(link.name for link in shapes.links), *shapes.dots]
    colors = {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}
    back = [pen.grid(), pen.marks()]
    back += [pen.support(at, legs) for at, legs in _supports(shapes).items()]
    rims = [(rim.filled, pen.rim(rim, colors.get(rim.body, STEEL))) for rim in shapes.rims]
    front = [part for filled, part in rims if filled]
    front += [pen.link(link, colors[link.name]) for link in shapes.links]
    front += [part for filled, part in rims if not filled]
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
        labels += [pen.link_label(link, shapes.guides, shade(colors[link.name])) for link in shapes.links]
        labels += [pen.knot_label(knot, shapes) for knot in knots if knot.names]
    pins = tuple(knot.anchors[0] for knot in knots) + tuple(Anchor(dot, 0.0, 0.0) for dot in shapes.dots)
    parts = tuple(back), colors, tuple(front), tuple(labels)
    return Scene(size, pen.scale, pen.origin, pen.unit, *parts, pins, 6 * pen.unit)


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
        base = base_of(size)
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
        """Distance of grid lines [m]."""
        return cell_of(70 * self.base, self.scale)

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
                lines.append(Stroke(rounded(ends), u, GRID if i else ZERO))
        return Part(ORIGIN, tuple(sorted(lines, key=lambda line: line.color == ZERO)))

    def marks(self) -> Part:
        """Directions of the axes in the left lower corner, the scale in the right one."""
        u, (x, y), (right, _) = self.base, self.corner(24, 24), self.corner(-24, 24)
        left = right - self.scale * self.cell
        lines = [[(x, y + 30 * u), (x, y), (x + 30 * u, y)], [(left, y), (right, y)]]
        lines += [[(end, y - 4 * u), (end, y + 4 * u)] for end in (left, right)]
        tips = [[(36, 0), (28, 3), (28, -3)], [(0, 36), (3, 28), (-3, 28)]]
        return Part(
            ORIGIN,
            (
                *(Stroke(rounded(line), 1.5 * u, FAINT) for line in lines),
                *(Stroke(rounded((x + dx * u, y + dy * u) for dx, dy in tip), u, FAINT, True) for tip in tips),
            ),
        )

    def mark_labels(self) -> list[Label]:
        """Names of the axes and the length of the scale."""
        (x, y), scale = self.corner(-24, 36), self.scale
        texts = {"x": self.corner(70, 24), "y": self.corner(24, 70), f"{self.cell:g} m": (x - scale * self.cell / 2, y)}
        return [
            Label(text, (Anchor(GROUND, x / scale, y / scale),), (), 0.0, 12 * self.base, FAINT, False)
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

    def rim(self, rim: Rim, color: str) -> Part:
        """The line of a gear, a pulley or a rack, or a disc such as a cam."""
        points = [(x * self.scale, y * self.scale) for x, y in rim.points]
        width = (2 if rim.filled else 4) * self.unit
        return Part((Anchor(rim.body, 0.0, 0.0),), tuple(self._outlined(points, width, color, rim.filled)))

    def link(self, link: Link, color: str) -> Part:
        """A bar or plate through the points of a body, the mass at the end of an arm, nothing for a mere block."""
        u, strokes = self.unit, []
        points = [(x * self.scale, y * self.scale) for x, y in hull_of(link.points)]
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

        hull = hull_of(link.points)
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
        return Stroke(rounded(points), width * self.unit, color, filled)

    def _outlined(self, points: Sequence[Vector], width: float, color: str, filled: bool = False) -> tuple[Stroke, ...]:
        """A line or area of `width` pixels with a dark rim."""
        rim = 3.2 * self.unit
        dark = INK if color in (WHITE, STEEL) else shade(color)
        points = rounded(points)
        return Stroke(points, width + rim, dark, filled), Stroke(points, width, color, filled)

    def _hatch(self, low: float, high: float, y: float) -> list[Stroke]:
        """Slanted strokes under a line."""
        u = self.unit
        return [self._line([(x, y), (x - 7 * u, y - 8 * u)], 1.2, FAINT) for x in np.arange(low + 7 * u, high, 7 * u)]

    def _half(self, guide: Guide) -> float:
        """Half the height between the rails of a guide."""
        return (9 if guide.block is None else 15) * self.unit


def _knots(shapes: Shapes) -> list[_Knot]:
    """Hinges, welds and pins; those that share a point are one."""
    knots: dict[int, _Knot] = {}
    found: dict[Anchor, int] = {}
    for i, joint in enumerate(shapes.joints):
        if joint.kind in ("prismatic", "distance"):
            continue
        knot = _Knot((joint.name,) if joint.name else (), joint.kind, (joint.first, joint.second))
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


def hull_of(points: Sequence[Vector]) -> list[Vector]:
    """Corners of the convex hull of some points; the two ends where they lie on one line."""
    ordered = sorted(set(points))
    tolerance = 1e-9 * max(max(x) - min(x) for x in zip(*points, strict=True)) ** 2

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


# Painting -----------------------------------------------------------------------------------------------------------


def paint(surface: Surface, scene: Scene, poses: Mapping[str, Pose], trails: Mapping[str, Sequence[Vector]]) -> None:
    """A scene at one instant, with the paths [m] of dots by name."""
    (ox, oy), scale = scene.origin, scene.scale

    def pixels(place: Vector) -> Vector:
        return ox + scale * float(place[0]), oy + scale * float(place[1])

    def parts(parts: Sequence[Part]) -> None:
        for part in parts:
            (x0, y0), *rest = [pixels(place_of(poses, at)) for at in part.at]
            if rest:
                ax, ay = rest[0][0] - x0, rest[0][1] - y0
                length = math.hypot(ax, ay) or 1.0
                bx, by = -ay / length, ax / length
            else:
                angle = float(poses[part.at[0].body][2]) + part.angle
                ax, ay = math.cos(angle), math.sin(angle)
                bx, by = -ay, ax
            for stroke in part.strokes:
                surface.stroke([(x0 + x * ax + y * bx, y0 + x * ay + y * by) for x, y in stroke.points], stroke)

    parts(scene.back)
    for dot, path in trails.items():
        surface.stroke([pixels(p) for p in path], Stroke((), 2.5 * scene.unit, scene.colors[dot]))
    parts(scene.front)
    texts: dict[bool, list[Text]] = {True: [], False: []}
    for label in scene.labels:
        xs, ys = zip(*(pixels(place_of(poses, at)) for at in label.at), strict=True)
        x, y = sum(xs) / len(xs), sum(ys) / len(ys)
        if label.gap:
            dx, dy = _free([_turned(float(poses[link.body][2]), link) for link in label.links])
            clear = label.gap + abs(dx) * width_of(label.text, label.size) / 2 + abs(dy) * label.size / 3
            x, y = x + dx * clear, y + dy * clear
        texts[label.free].append(Text(label.text, x, y, label.size, label.color))
    pins = [(*pixels(place_of(poses, at)), scene.pin) for at in scene.pins]
    for text in (*texts[False], *placed(texts[True], scene.size, pins, surface.pushed)):
        surface.text(text)


def _turned(angle: float, link: Anchor) -> Vector:
    c, s = math.cos(angle), math.sin(angle)
    return c * link.x - s * link.y, s * link.x + c * link.y


def _free(taken: Sequence[Vector]) -> Vector:
    """The direction in the middle of the widest gap between some directions; upwards where there are none.

    Of gaps that are alike, the one on the left.
    """
    if not taken:
        return 0.0, 1.0
    # Counted from just below the direction to the right, so that the gap on the left comes first of the two of a bar.
    angles = sorted((math.atan2(y, x) + 1e-6) % (2 * math.pi) for x, y in taken)
    widest, middle = 0.0, 0.0
    for start, end in zip(angles, [*angles[1:], angles[0] + 2 * math.pi], strict=True):
        if end - start > widest + 1e-3:
            widest, middle = end - start, (start + end) / 2
    return math.cos(middle), math.sin(middle)


def hides(shapes: Shapes, columns: Mapping[str, float]) -> bool:
    """Whether two bars lie on each other over some length."""
    poses = poses_of(shapes, columns)
    bars = [(link.name, hull) for link in shapes.links if len(hull := hull_of(link.points)) == 2]
    places = np.array([[complex(*place_of(poses, Anchor(name, *p))) for p in hull] for name, hull in bars])
    for i, (start, end) in enumerate(places[:-1]):
        one, other = (places[i + 1 :].T - start) / (end - start)  # real part along the bar, imaginary part across
        near = np.maximum(np.minimum(one.real, other.real), 0.0)
        far = np.minimum(np.maximum(one.real, other.real), 1.0)
        across = np.maximum(np.abs(one.imag), np.abs(other.imag))
        if np.any((across < 1e-3) & (far - near > 1e-3)):
            return True
    return False
