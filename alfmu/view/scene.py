"""Scenes in the plane: parts and labels of a picture, in metres and in units of symbols, independent of its size.

Positions and directions stay traced if numbers of shapes are. `plane` paints a scene, and so does the script
`shared/strokes.js` of pages.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from .shapes import GROUND, Anchor, Guide, Link, Rim, Shapes, Tie
from .surface import COLORS, Vector, rounded
from .traced import cos, sin

LEFT, RIGHT = "left corner", "right corner"
"""Lower corners of a picture as frames, with anchors in `Fit.base` pixels."""

RULER = -1
"""Index of the guide that draws the length scale in the right corner, one grid cell long."""

OVERHANG = 50.0
"""Length of rails beyond their travel [units]."""


@dataclass(frozen=True)
class Stroke:
    """A line with round ends: a disc if it has one point, a closed area if filled.

    Its points and its width are in units; x is relative to the length if its part has one. With `metres` the points are
    in metres: a "line" through them or their convex "hull", filled if it has an area. A stroke with `every` is repeated
    at this distance in units along its part, with its x from each repetition. `rim` adds a dark outline.
    """

    points: tuple[Vector, ...]
    width: float = 2.0
    color: str = "ink"
    filled: bool = False
    rim: bool = False
    every: float = 0.0
    metres: Literal["", "line", "hull"] = ""


@dataclass(frozen=True)
class Part:
    """Strokes that move with a point of a body, turned by `angle` in its axes, or that span two points.

    With a `guide` they span its travel. A `held` part can be dragged in a live page.
    """

    at: tuple[Anchor, ...]
    strokes: tuple[Stroke, ...]
    angle: float = 0.0
    guide: int | None = None
    held: bool = False


@dataclass(frozen=True)
class Label:
    """Text in the centre of some points, or `gap` units from there in the middle of the widest gap between `links`.

    With a `guide`, it is at a `share` of its travel. A `free` label avoids other labels and pins.
    """

    text: str
    at: tuple[Anchor, ...]
    links: tuple[Anchor, ...] = ()
    gap: float = 0.0
    size: float = 14.0
    color: str = "ink"
    rim: bool = False
    """Whether the label has the colour of the rim instead of its own."""
    angle: float = 0.0
    guide: int | None = None
    share: float = 0.0
    free: bool = True


@dataclass(frozen=True)
class Scene:
    """Parts behind and in front of the trails of dots, labels, and pins that labels must not cover.

    Colours are names of `PALETTE`, or "#rrggbb" of bodies and dots.
    """

    back: tuple[Part, ...]
    front: tuple[Part, ...]
    labels: tuple[Label, ...]
    pins: tuple[Anchor, ...]
    colors: dict[str, str]
    """Colours of bodies and dots."""


@dataclass(frozen=True)
class _Knot:
    """Joints that share a point."""

    names: tuple[str, ...]
    kind: str
    anchors: tuple[Anchor, ...]


def scene_of(shapes: Shapes) -> Scene:
    """Return the scene of shapes, independent of its size."""
    knots = _knots(shapes)
    names = [*(link.name for link in shapes.links), *shapes.dots]
    colors = {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}
    back = [*_marks(), *(_support(at, legs) for at, legs in supports_of(shapes).items())]
    rims = [(rim.filled, _rim(rim, colors.get(rim.body, "steel"))) for rim in shapes.rims]
    front = [part for filled, part in rims if filled]
    front += [_link(link, colors[link.name]) for link in shapes.links]
    front += [part for filled, part in rims if not filled]
    for i, guide in enumerate(shapes.guides):
        (back if guide.base.body == GROUND else front).extend(_guide(i, guide, colors[guide.rider.body]))
    front += [_tie(tie) for tie in shapes.ties]
    front += [_pin(knot) for knot in knots]
    dots = [Anchor(dot, 0.0, 0.0) for dot in shapes.dots]
    front += [Part((at,), (_disc(14, colors[at.body]),), held=True) for at in dots]
    labels = [
        Label("x", (Anchor(LEFT, 70.0, 24.0),), size=12.0, color="faint", free=False),
        Label("y", (Anchor(LEFT, 24.0, 70.0),), size=12.0, color="faint", free=False),
        Label("", (Anchor(RIGHT, -24.0, 36.0),), size=12.0, color="faint", guide=RULER, share=0.5, free=False),
    ]
    labels += [Label(tie.name, (tie.first, tie.second), gap=5.0) for tie in shapes.ties if tie.name]
    labels += [Label(at.body, (at,), gap=10.0) for at in dots]
    labels += [_guide_label(i, guide) for i, guide in enumerate(shapes.guides)]
    labels += [_link_label(link, shapes.guides, colors[link.name]) for link in shapes.links]
    labels += [_knot_label(knot, shapes) for knot in knots if knot.names]
    pins = *(knot.anchors[0] for knot in knots), *dots
    return Scene(tuple(back), tuple(front), tuple(labels), pins, colors)


def _marks() -> list[Part]:
    """Return the axes in the lower left corner, and the scale in the right one."""
    tips = [((36.0, 0.0), (28.0, 3.0), (28.0, -3.0)), ((0.0, 36.0), (3.0, 28.0), (-3.0, 28.0))]
    axes = [Stroke(((0.0, 30.0), (0.0, 0.0), (30.0, 0.0)), 1.5, "faint"), *(Stroke(x, 1, "faint", True) for x in tips)]
    lines = [((0.0, 0.0), (1.0, 0.0)), *(((end, -4.0), (end, 4.0)) for end in (0.0, 1.0))]
    ruler = Part((Anchor(RIGHT, -24.0, 24.0),), tuple(Stroke(line, 1.5, "faint") for line in lines), guide=RULER)
    return [Part((Anchor(LEFT, 24.0, 24.0),), tuple(axes)), ruler]


def _support(at: Anchor, legs: bool) -> Part:
    """Return the ground symbol under a point, with legs under a hinge."""
    foot = -24.0 if legs else -9.0
    strokes = [Stroke(((x, foot), (x - 7.0, foot - 8.0)), 1.2, "faint") for x in np.arange(-17.0, 24.0, 7.0).tolist()]
    strokes += [Stroke(((-24.0, foot), (24.0, foot)))]
    if legs:
        strokes += [Stroke(((0.0, 0.0), (-13.0, foot), (13.0, foot)), 2, "steel", True, True)]
    return Part((at,), tuple(strokes))


def _guide(i: int, guide: Guide, color: str) -> list[Part]:
    """Return rails about a dash-dotted centre line over the travel of a guide, hatched on the ground, and the block in
    them."""
    half, grounded = _half(guide), guide.base.body == GROUND
    strokes = [Stroke(((0.0, -half), (1.0, -half)))]
    if grounded:
        strokes += [Stroke(((7.0, -half), (0.0, -half - 8.0)), 1.2, "faint", every=7.0)]
    if not grounded or guide.block is None:
        strokes += [Stroke(((0.0, half), (1.0, half)))]
    strokes += [
        Stroke(((0.0, 0.0), (10.0, 0.0)), 1, "faint", every=20.0),
        Stroke(((15.0, 0.0),), 1.5, "faint", every=20.0),
    ]
    rails = Part((guide.base,), tuple(strokes), guide.axis, i)
    if guide.block is None:
        return [rails]
    x, y = 24.0, half - 2.0
    block = Stroke(((-x, -y), (x, -y), (x, y), (-x, y)), 4, color, True, True)
    return [rails, Part((guide.rider,), (block,), guide.block)]


def _rim(rim: Rim, color: str) -> Part:
    """Return the outline of a gear, a pulley or a rack, or a disc such as a cam."""
    line = Stroke(rim.points, 2 if rim.filled else 4, color, rim.filled, True, metres="line")
    return Part((Anchor(rim.body, 0.0, 0.0),), (line,))


def _link(link: Link, color: str) -> Part:
    """Return a bar or plate through the points of a body, or the mass at the end of an arm; nothing for a
    mere block."""
    width = 0 if len(set(link.points)) == 1 else 8 if link.kind == "mass" else 14
    strokes = [Stroke(link.points, width, color, rim=True, metres="hull")]
    if link.kind == "mass":
        strokes += [_disc(28, color)]
    return Part((Anchor(link.name, 0.0, 0.0),), tuple(strokes), held=True)


def _disc(width: float, color: str = "white", x: float = 0.0) -> Stroke:
    return Stroke(((x, 0.0),), width, color, rim=True)


def _pin(knot: _Knot) -> Part:
    """Return a circle for a hinge, a square for a weld."""
    square = Stroke(((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)), 2, "ink", True)
    return Part(knot.anchors[:1], (square if knot.kind == "weld" else _disc(13),))


def _tie(tie: Tie) -> Part:
    """Return a rod, spring or damper from point to point, or a spiral around one."""
    if tie.kind == "spiral":
        turns = [5 * math.pi * i / 60 for i in range(61)]
        points = [((10 + 0.7 * t) * math.cos(t), (10 + 0.7 * t) * math.sin(t)) for t in turns]
        return Part((tie.first,), (Stroke(rounded(points), 1.5),))
    strokes = []
    if tie.kind == "rod":
        strokes += [Stroke(((0.0, 0.0), (1.0, 0.0)), 4), _disc(8), _disc(8, x=1.0)]
    apart = 9.0 if tie.kind == "spring-damper" else 0.0
    if "spring" in tie.kind:
        teeth = [(0.26 + 0.04 * i, apart + (7 if i % 2 else -7)) for i in range(13)]
        coil = [(0, 0), (0.15, 0), (0.15, apart), (0.23, apart), *teeth]
        strokes += [Stroke(rounded([*coil, (0.77, apart), (0.85, apart), (0.85, 0), (1, 0)]))]
    if "damper" in tie.kind:
        y, r = -apart, 6.0
        strokes += [
            Stroke(((0.0, 0.0), (0.15, 0.0), (0.15, y), (0.38, y))),
            Stroke(((0.62, y + r), (0.38, y + r), (0.38, y - r), (0.62, y - r))),
            Stroke(((0.52, y + r / 2), (0.52, y - r / 2)), 3),
            Stroke(((0.52, y), (0.85, y), (0.85, 0.0), (1.0, 0.0))),
        ]
    if tie.kind != "rod":
        strokes += [Stroke(((0.0, 0.0),), 6), Stroke(((1.0, 0.0),), 6)]
    return Part((tie.first, tie.second), tuple(strokes))


# Labels


def _knot_label(knot: _Knot, shapes: Shapes) -> Label:
    """Return the label on the side without links, rails and ground."""
    points = {link.name: link.points for link in shapes.links}
    directions = [Anchor(GROUND, 0.0, -1.0) for at in knot.anchors if at.body == GROUND]
    for at in knot.anchors:
        others = [p for p in points.get(at.body, ()) if p != (at.x, at.y)]
        directions += [Anchor(at.body, x - at.x, y - at.y) for x, y in others]
    blocks = [(g.rider.body, g.block) for g in shapes.guides if g.block is not None and g.rider in knot.anchors]
    directions += [Anchor(body, sin(block), -cos(block)) for body, block in blocks]
    spirals = [tie for tie in shapes.ties if tie.kind == "spiral" and tie.first in knot.anchors]
    return Label(", ".join(knot.names), knot.anchors[:1], tuple(directions), 26.0 if blocks or spirals else 11.0)


def _guide_label(i: int, guide: Guide) -> Label:
    """Return the label under the start of the rails."""
    up = Anchor(guide.base.body, -sin(guide.axis), cos(guide.axis))
    return Label(guide.name, (guide.base,), (up,), _half(guide) + 12.0, angle=guide.axis, guide=i)


def _link_label(link: Link, guides: Sequence[Guide], color: str) -> Label:
    """Return the label beside the longest free stretch of a bar, in the middle of a plate, or under a block."""

    def label(at: Sequence[Vector], away: Sequence[Vector], gap: float) -> Label:
        places, links = (tuple(Anchor(link.name, *p) for p in group) for group in (at, away))
        return Label(link.name, places, links, gap, 13.0, color, True)

    hull = hull_of(link.points)
    for guide in guides:
        if link.kind == "block" and guide.rider.body == link.name and guide.block is not None:
            up = -sin(guide.block), cos(guide.block)
            return label([(guide.rider.x, guide.rider.y)], [up], _half(guide) + 12.0)
    if len(hull) == 1:
        return label(hull, [], 18.0)
    if len(hull) > 2:
        return label(hull, [], 0.0)
    (ax, ay), (bx, by) = hull
    ex, ey = max((bx - ax, by - ay), (ax - bx, ay - by))
    gap = max(pairwise(sorted(link.points)), key=lambda ends: round(math.dist(*ends), 9))
    return label(gap, [(ey, -ex)], 15.0)


def _half(guide: Guide) -> float:
    """Return half the height between the rails of a guide [units]."""
    return 9.0 if guide.block is None else 15.0


def _knots(shapes: Shapes) -> list[_Knot]:
    """Return hinges, welds and pins, with those at a common point merged."""
    knots: dict[int, _Knot] = {}
    found: dict[Anchor, int] = {}
    guided = {guide.name for guide in shapes.guides}
    for i, joint in enumerate(shapes.joints):
        if joint.kind in ("prismatic", "distance"):
            continue
        knot = _Knot((joint.name,) if joint.name else (), joint.kind, (joint.first, joint.second))
        if joint.name in guided:  # its guide has the label
            knot = _Knot((), joint.kind, (joint.second,))
        for k in sorted({found[at] for at in knot.anchors if at in found}):
            other = knots.pop(k)
            knot = _Knot(other.names + knot.names, other.kind, tuple(dict.fromkeys(other.anchors + knot.anchors)))
        knots[i] = knot
        found |= dict.fromkeys(knot.anchors, i)
    return list(knots.values())


def supports_of(shapes: Shapes) -> dict[Anchor, bool]:
    """Return points fixed to the ground, and whether the support has legs (all but welds)."""
    held = [(j.first, j.kind != "weld") for j in shapes.joints if j.kind in ("revolute", "weld", "distance")]
    held += [(at, True) for tie in shapes.ties if tie.kind != "spiral" for at in (tie.first, tie.second)]
    return {at: legs for at, legs in held if at.body == GROUND}


def hull_of(points: Sequence[Vector]) -> list[Vector]:
    """Return the corners of the convex hull of some points; the two ends if they are collinear."""
    ordered = sorted(set(points))
    tolerance = 1e-9 * max(max(x) - min(x) for x in zip(*points, strict=True)) ** 2

    def chain(sequence: Sequence[Vector]) -> list[Vector]:
        corners: list[Vector] = []
        for x, y in sequence:
            while len(corners) > 1:
                (ax, ay), (bx, by) = corners[-2], corners[-1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > tolerance:
                    break
                corners.pop()
            corners.append((x, y))
        return corners

    return ordered if len(ordered) < 3 else chain(ordered)[:-1] + chain(ordered[::-1])[:-1]
