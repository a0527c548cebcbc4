"""Pictures of mechanisms in the plane.

The shapes define a scene of parts (`scene_of`), each fixed to the ground, to a body, to a dot or between two points, in
metres and in units of symbols. The motion defines the extent (`view_of`), and with the size of the picture the scale in
pixels (`Fit`). `Stage.paint` paints it at one instant; the script `shared/strokes.js` does so in a browser.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..model.errors import InputError
from .scene import LEFT, OVERHANG, RIGHT, RULER, Label, Part, hull_of, scene_of, supports_of
from .shapes import GROUND, Anchor, Shapes
from .surface import GRID, PALETTE, ZERO, Size, Surface, Text, Vector, base_of, cell_of, placed, rim_of, width_of

# View: extent of a motion -----------------------------------------------------------------------------------------

Pose = tuple[Any, Any, Any]
"""x [m], y [m], angle [rad] of a frame: numbers, or arrays over time."""


@dataclass(frozen=True)
class View:
    """The bounding box of a motion [m], and the travel of each guide [m from its base]."""

    low: Vector
    high: Vector
    travel: tuple[Vector, ...]


def view_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> View:
    """Return the view that contains all shapes at all instants of `columns` (numbers, or arrays over time).

    Raises InputError if a column is missing or not finite.
    """
    poses = poses_of(shapes, columns)
    for name, pose in poses.items():
        if not all(np.isfinite(q).all() for q in pose):
            raise InputError(f"{shapes.name}: the place of {name} is not finite all the time, so it cannot be drawn")
    points = [place_of(poses, Anchor(link.name, *p)) for link in shapes.links for p in link.points]
    points += [place_of(poses, Anchor(rim.body, *p)) for rim in shapes.rims for p in rim.points]
    points += [place_of(poses, at) for at in supports_of(shapes)]
    points += [poses[dot][:2] for dot in shapes.dots]
    xs, ys = (np.concatenate([np.ravel(p[k]) for p in points] or [np.zeros(1)]) for k in (0, 1))
    travel = []
    for guide in shapes.guides:
        (x, y), (rx, ry) = place_of(poses, guide.base), place_of(poses, guide.rider)
        axis = poses[guide.base.body][2] + guide.axis
        along = (rx - x) * np.cos(axis) + (ry - y) * np.sin(axis)
        travel.append((float(np.min(along)), float(np.max(along))))
    return View((float(xs.min()), float(ys.min())), (float(xs.max()), float(ys.max())), tuple(travel))


def poses_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> dict[str, Pose]:
    """Return the pose of every frame: the ground, the bodies and the dots."""
    if missing := [name for name in shapes.columns if name not in columns]:
        raise InputError(
            f"{shapes.name}: a picture needs {missing[0]}; the result must hold all outputs of bodies (x, y and angle "
            "of each) and of dots, so run it without choosing outputs"
        )
    poses: dict[str, Pose] = {GROUND: (0.0, 0.0, 0.0)}
    for link in shapes.links:
        x, y, angle = (np.asarray(columns[f"{link.name}.{q}"], float) for q in ("x", "y", "angle"))
        poses[link.name] = x, y, angle
    for dot in shapes.dots:
        poses[dot] = (np.asarray(columns[f"{dot}.x"], float), np.asarray(columns[f"{dot}.y"], float), 0.0)
    return poses


def place_of(poses: Mapping[str, Pose], at: Anchor) -> tuple[Any, Any]:
    """Return a point in ground axes [m]."""
    x, y, angle = poses[at.body]
    c, s = np.cos(angle), np.sin(angle)
    return x + c * at.x - s * at.y, y + s * at.x + c * at.y


def _extent(points: Sequence[Vector]) -> float:
    return max(math.dist(a, b) for a in points for b in points)


# Fit: scale of a picture ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fit:
    """Scale of a picture in pixels: `origin` + `scale` * metres.

    `base` is 1 in a picture of 640 x 480, the `unit` of symbols is smaller if links are short; `cell` is the distance
    of grid lines [m], `travel` the travel of each guide [m].
    """

    size: Size
    scale: float
    origin: Vector
    base: float
    unit: float
    cell: float
    travel: tuple[Vector, ...]
    names: bool
    """Whether there is room for names."""


def fit_of(shapes: Shapes, view: View, size: Size) -> Fit:
    """Fit the box of a view into a picture of `size` [pixels] with equal axes and a margin for symbols."""
    base = base_of(size)
    spans = [high - low for low, high in zip(view.low, view.high, strict=True)]
    if max(spans) < 1e-9:
        spans = [1.0, 1.0]
    scale = min((s - 150 * base) / span for s, span in zip(size, spans, strict=True) if span > 0)
    middle = [(low + high) / 2 for low, high in zip(view.low, view.high, strict=True)]
    origin = size[0] / 2 - scale * middle[0], size[1] / 2 + 8 * base - scale * middle[1]
    lengths = [scale * _extent(link.points) for link in shapes.links if len(link.points) > 1]
    shrink = min(1.0, max(0.2, float(np.median(lengths)) / (80 * base))) if lengths else 1.0
    return Fit(size, scale, origin, base, base * shrink, cell_of(70 * base, scale), view.travel, shrink >= 0.5)


class Stage:
    """The static part of a picture in the plane."""

    def __init__(self, shapes: Shapes, view: View, size: Size):
        self.shapes, self.size = shapes, size
        self.scene, self.fit = scene_of(shapes), fit_of(shapes, view, size)

    def paint(self, surface: Surface, columns: Mapping[str, float], trails: Mapping[str, Sequence[Vector]]) -> None:
        """Paint a scene at one instant, with the paths [m] of dots by name."""
        scene, fit = self.scene, self.fit
        painter = _Painter(surface, fit, poses_of(self.shapes, columns))
        painter.grid()
        for part in scene.back:
            painter.part(part)
        for dot, path in trails.items():
            painter.line([painter.place(Anchor(GROUND, *p)) for p in path], 2.5 * fit.unit, scene.colors[dot])
        for part in scene.front:
            painter.part(part)
        free = [painter.text(label) for label in scene.labels if label.free and fit.names]
        pins = [(*painter.place(at), 6 * fit.unit) for at in scene.pins]
        fixed = [painter.text(label) for label in scene.labels if not label.free]
        for text in (*fixed, *placed(free, fit.size, pins, surface.pushed)):
            surface.text(text)


# Painting -----------------------------------------------------------------------------------------------------------


class _Painter:
    """Paints a scene on a surface at one instant; `shared/strokes.js` does the same."""

    def __init__(self, surface: Surface, fit: Fit, poses: Mapping[str, Pose]):
        self.surface, self.fit, self.poses = surface, fit, poses

    def place(self, at: Anchor) -> Vector:
        """Return a point in pixels."""
        fit = self.fit
        if at.body in (LEFT, RIGHT):
            return fit.base * at.x + (fit.size[0] if at.body == RIGHT else 0), fit.base * at.y
        x, y = place_of(self.poses, at)
        return fit.origin[0] + fit.scale * float(x), fit.origin[1] + fit.scale * float(y)

    def way(self, of: Part | Label) -> tuple[Vector, Vector, Vector, float]:
        """Return the position of a part, the direction of its x axis, the start and end of x in pixels from the
        position, and the unit."""
        fit, at = self.fit, of.at[0]
        unit = fit.base if at.body in (LEFT, RIGHT) else fit.unit
        (x, y) = self.place(at)
        if isinstance(of, Part) and len(of.at) > 1:
            ex, ey = self.place(of.at[1])
            length = math.hypot(ex - x, ey - y)
            return (x, y), ((ex - x) / (length or 1.0), (ey - y) / (length or 1.0)), (0.0, length), unit
        turn = of.angle + (float(self.poses[at.body][2]) if at.body in self.poses else 0.0)
        low, high = 0.0, unit
        if of.guide == RULER:
            low, high = -fit.cell * fit.scale, 0.0
        elif of.guide is not None:
            low, high = (fit.scale * end for end in fit.travel[of.guide])
            low, high = low - OVERHANG * unit, high + OVERHANG * unit
        return (x, y), (math.cos(turn), math.sin(turn)), (low, high), unit

    def part(self, part: Part) -> None:
        (x0, y0), (ax, ay), (low, high), unit = self.way(part)

        def along(points: Sequence[Vector]) -> list[Vector]:
            return [(x0 + x * ax - y * ay, y0 + x * ay + y * ax) for x, y in points]

        for stroke in part.strokes:
            filled = stroke.filled
            if stroke.every:
                count = math.ceil(round((high - low) / unit - stroke.points[0][0], 9) / stroke.every)
                starts = [low + stroke.every * unit * i for i in range(max(0, count))]
                lines = [[(start + x * unit, y * unit) for x, y in stroke.points] for start in starts]
            elif stroke.metres:
                points = hull_of(stroke.points) if stroke.metres == "hull" else stroke.points
                filled = filled or (stroke.metres == "hull" and len(points) > 2)
                lines = [[(x * self.fit.scale, y * self.fit.scale) for x, y in points]]
            else:
                lines = [[(low + x * (high - low), y * unit) for x, y in stroke.points]]
            for line in lines:
                self.line(along(line), stroke.width * unit, stroke.color, filled, stroke.rim)

    def line(self, points: Sequence[Vector], width: float, color: str, filled: bool = False, rim: bool = False) -> None:
        if rim and width:
            self.surface.stroke(points, width + 3.2 * self.fit.unit, rim_of(color), filled)
        if width:
            self.surface.stroke(points, width, PALETTE.get(color, color), filled)

    def grid(self) -> None:
        """Paint grid lines, with those through the origin darker and on top."""
        fit, lines = self.fit, []
        step = fit.scale * fit.cell
        for k in (0, 1):
            for i in range(math.ceil(-fit.origin[k] / step), math.floor((fit.size[k] - fit.origin[k]) / step) + 1):
                at = fit.origin[k] + i * step
                lines.append((i == 0, [(at, 0), (at, fit.size[1])] if k == 0 else [(0, at), (fit.size[0], at)]))
        for axis, points in sorted(lines, key=lambda line: line[0]):
            self.surface.stroke(points, fit.base, ZERO if axis else GRID)

    def text(self, label: Label) -> Text:
        """Return the text of a label at its preferred position."""
        (x, y), (ax, ay), (low, high), unit = self.way(label)
        if label.guide is None:
            x, y = (sum(values) / len(label.at) for values in zip(*map(self.place, label.at), strict=True))
        else:
            along = low + label.share * (high - low)
            x, y = x + along * ax, y + along * ay
        text, size = label.text or f"{self.fit.cell:g} m", label.size * unit
        if label.gap:
            dx, dy = _free([_turned(float(self.poses[link.body][2]), link) for link in label.links])
            clear = label.gap * unit + abs(dx) * width_of(text, size) / 2 + abs(dy) * size / 3
            x, y = x + dx * clear, y + dy * clear
        return Text(text, x, y, size, rim_of(label.color) if label.rim else PALETTE.get(label.color, label.color))


def _turned(angle: float, link: Anchor) -> Vector:
    c, s = math.cos(angle), math.sin(angle)
    return c * link.x - s * link.y, s * link.x + c * link.y


def _free(taken: Sequence[Vector]) -> Vector:
    """Return the middle direction of the widest gap between some directions; upwards if there are none.

    Of equal gaps, the left one is chosen.
    """
    # Angles are counted from just below the right, so that the left gap of a bar comes first.
    angles = sorted((math.atan2(y, x) + 1e-6) % (2 * math.pi) for x, y in taken if x or y)
    if not angles:
        return 0.0, 1.0
    widest, middle = 0.0, 0.0
    for start, end in zip(angles, [*angles[1:], angles[0] + 2 * math.pi], strict=True):
        if end - start > widest + 1e-3:
            widest, middle = end - start, (start + end) / 2
    return math.cos(middle), math.sin(middle)


def hides(shapes: Shapes, columns: Mapping[str, float]) -> bool:
    """Return whether two bars overlap over some length."""
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
