"""Pictures of mechanisms in space: pieces with extent, seen in perspective, on a floor with a grid and shadows.

The shapes give frames and what is fixed in them, the motion gives what must be seen (`view_of`). From both follow
pieces (rods, balls, boxes, plates, coils) in metres, each fixed in a frame or stretched between two points. `paint`
draws their faces from the back to the front; the script of a page (`film/space.js`) hands the same pieces to a library.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.errors import InputError
from ..model.spatial import right_handed
from .plane import hull_of
from .shapes import GROUND, Shapes, Solid, Space, Spot, Vector3
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
    shade,
)

__all__ = [
    "Camera",
    "Piece",
    "Pose",
    "SpaceView",
    "camera_of",
    "colors_of",
    "paint",
    "pieces_of",
    "poses_of",
    "view_of",
]

Pose = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Place (..., 3) [m] and Euler parameters (..., 4) of a frame, at one instant or over time."""

Quaternion = tuple[float, float, float, float]

OPENING = 26.0
"""Angle [deg] that the camera sees from bottom to top: a long lens, so that sizes can be compared."""

ELEVATION = 24.0
"""Angle [deg] by which the camera looks down."""

AZIMUTHS = 24
"""Directions around the vertical from which the picture is tried."""

CLOUD = 400
"""Instants of a motion, at most, from which the camera is chosen."""

SIDES = 18
"""Faces around a rod."""

SHADOW = "#e4e9ee"

SLIDING = ("prismatic", "cylindrical", "screw")
"""Kinds of joints whose second point slides along an axis, which is drawn as a rail."""


@dataclass(frozen=True)
class Piece:
    """One thing of a picture, fixed at a point of a frame or stretched between two points.

    `size` [m] has for a "rod" its radius and the shares of the way at which it begins and ends; for a "coil" its radius
    and that of its wire; for a "ball" its radius; for a "box" half its edges; for a "cylinder" along z its radius and
    half its length; for a "cone" under its point its radii below and above and its height; for a "plate" half its
    thickness, with its `outline` [m] in its x and y. `turn` leads from the axes of the frame to its own.
    """

    name: str
    kind: Literal["rod", "coil", "ball", "box", "cylinder", "cone", "plate"]
    at: tuple[Spot, ...]
    size: tuple[float, ...]
    color: str
    turn: Quaternion = (1.0, 0.0, 0.0, 0.0)
    outline: tuple[Vector, ...] = ()


@dataclass(frozen=True)
class SpaceView:
    """What a picture must show of a motion: places (N, 3) [m] that it holds, the range of each joint that slides."""

    cloud: NDArray[np.float64] = field(compare=False)
    up: Vector3
    extent: float
    """Diagonal of the box around all places [m]."""
    unit: float
    """Radius of a rod [m], less where rods are short."""
    floor: float
    """Height of the floor [m] along `up`."""
    travel: dict[str, Vector]


@dataclass(frozen=True)
class Camera:
    """Where a picture is seen from [m]; `opening` is the angle from bottom to top [deg]."""

    eye: Vector3
    target: Vector3
    up: Vector3
    opening: float

    @property
    def axes(self) -> NDArray[np.float64]:
        """Directions (3, 3) to the right, up and towards the eye, as rows."""
        return _looking(np.subtract(self.eye, self.target), np.array(self.up))


# Where it all is ----------------------------------------------------------------------------------------------------


def poses_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> dict[str, Pose]:
    """Pose of every frame, the ground included. Raises InputError where a column is missing or not finite."""
    assert shapes.space is not None
    if missing := [name for name in shapes.columns if name not in columns]:
        raise InputError(
            f"{shapes.name}: a picture needs {missing[0]}; the result must hold the places of all bodies and points, "
            "so run it without choosing outputs"
        )
    poses: dict[str, Pose] = {GROUND: (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))}
    for frame in shapes.space.frames:
        values = [np.asarray(columns[name], float) for name in frame.columns]
        if not all(np.isfinite(x).all() for x in values):
            raise InputError(
                f"{shapes.name}: the place of {frame.name} is not finite all the time, so it cannot be drawn"
            )
        nothing = np.zeros_like(values[0])
        if frame.kind == "body":
            place, turn = values[:3], values[3:]
        elif frame.kind == "plane":
            place, turn = [*values[:2], nothing], [np.cos(values[2] / 2), nothing, nothing, np.sin(values[2] / 2)]
        else:
            place = [*values, nothing][:3]
            turn = [nothing + 1, nothing, nothing, nothing]
            if frame.kind == "axis":
                turn = list(np.moveaxis(_turned_to(np.stack(values[3:], -1)), -1, 0))
        poses[frame.name] = np.stack(place, -1), np.stack(turn, -1)
    return poses


def view_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> SpaceView:
    """What a picture must show so that all shapes are in it at all instants of `columns`."""
    space, poses = shapes.space, poses_of(shapes, columns)
    assert space is not None
    spots = [Spot(s.name, *p) for s in space.solids for p in (*s.points, (0.0, 0.0, 0.0))]
    spots += [at for pair in (*space.pivots, *space.struts) for at in (pair.first, pair.second)]
    spots += [Spot(dot, 0.0, 0.0, 0.0) for dot in space.dots]
    cloud = np.concatenate([np.reshape(_thinned(place_of(poses, at)), (-1, 3)) for at in spots] or [np.zeros((1, 3))])
    travel = {}
    for pivot in space.pivots:
        if pivot.kind in SLIDING and pivot.axis:
            axis = rotated(poses[pivot.first.frame][1], np.array(pivot.axis) / math.hypot(*pivot.axis))
            along = np.sum((place_of(poses, pivot.second) - place_of(poses, pivot.first)) * axis, -1)
            travel[pivot.name] = float(np.min(along)), float(np.max(along))
    extent = float(np.linalg.norm(np.ptp(cloud, axis=0))) or 1.0
    bars = [strut for strut in space.struts if strut.kind == "bar"]
    lengths = [np.linalg.norm(place_of(poses, x.second) - place_of(poses, x.first), axis=-1).mean() for x in bars]
    lengths += [math.dist(a, b) for s in space.solids for a, b in _tree(np.array([*s.points, (0.0,) * 3]), extent)]
    usual = float(np.median(lengths)) / extent if lengths else 1.0
    unit = extent * min(0.0145, max(0.004, 0.05 * usual))
    low = float(np.min(cloud @ np.array(space.up)))
    return SpaceView(cloud, space.up, extent, unit, low - 5.5 * unit, travel)


def _thinned(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places at some instants, those at the ends included."""
    if places.ndim == 1 or len(places) <= CLOUD:
        return places
    return places[np.unique(np.linspace(0, len(places) - 1, CLOUD).astype(int))]


def place_of(poses: Mapping[str, Pose], at: Spot) -> NDArray[np.float64]:
    """A point (..., 3) in ground axes [m]."""
    place, turn = poses[at.frame]
    return place + rotated(turn, np.array([at.x, at.y, at.z]))


def rotated(turn: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """A vector (..., 3) of a frame in ground axes, by Euler parameters (..., 4)."""
    p = turn[..., 1:]
    twice = 2 * _cross(p, vector)
    return vector + turn[..., :1] * twice + _cross(p, twice)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """NumPy's `cross` of vectors (..., 3), some ten times as fast for a few of them."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]).T


def _turned_to(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Euler parameters (..., 4) of the shortest turn that leads z to a direction (..., 3)."""
    z = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    e = np.stack([1 + z[..., 2], -z[..., 1], z[..., 0], 0 * z[..., 0]], -1)
    size = np.linalg.norm(e, axis=-1, keepdims=True)
    return np.where(size > 1e-9, e / np.where(size > 1e-9, size, 1.0), [0.0, 1.0, 0.0, 0.0])


def _product(e: Sequence[float], f: Sequence[float]) -> Quaternion:
    """Euler parameters of the turn f made in the axes that the turn e leads to."""
    p, s = np.array(e[1:]), np.array(f[1:])
    vector = e[0] * s + f[0] * p + np.cross(p, s)
    return float(e[0] * f[0] - p @ s), *map(float, vector)


def camera_of(view: SpaceView, size: Size) -> Camera:
    """The camera that sees a motion as widely spread as one can, and holds all of it with room for labels."""
    up = np.array(view.up)
    east, north, _ = (np.array(x) for x in right_handed(view.up))
    angle = math.radians(ELEVATION)
    best: tuple[float, NDArray[np.float64]] = (-1.0, east)
    for i in range(AZIMUTHS):
        around = 2 * math.pi * (i + 0.35) / AZIMUTHS  # never along an axis, where things hide each other
        flat = math.cos(around) * east + math.sin(around) * north
        towards = math.cos(angle) * flat + math.sin(angle) * up
        seen = (view.cloud - view.cloud.mean(axis=0)) @ _looking(towards, up)[:2].T
        spread = float(np.linalg.svd(seen, compute_uv=False)[-1])
        # Of two that are alike, the one from where x points to the right.
        spread *= 1 + 0.02 * float(_looking(towards, up)[0] @ np.array([1.0, 0.3, 0.1]))
        if spread > best[0]:
            best = spread, towards
    axes = _looking(best[1], up)
    room, base = 0.06 * view.extent, base_of(size)
    tangent = math.tan(math.radians(OPENING) / 2)
    slopes = np.array([tangent * (size[0] - 90 * base) / size[1], tangent * (size[1] - 100 * base) / size[1]])
    x, y, z = axes @ view.cloud.T
    middle = np.array([(x.min() + x.max()) / 2, (y.min() + y.max()) / 2, (z.min() + z.max()) / 2])
    for _ in range(4):
        off = np.abs(np.stack([x, y]) - middle[:2, None]) + room
        distance = float(np.max(off / slopes[:, None] + (z - middle[2])))
        depth = distance - (z - middle[2])
        for k, values in enumerate((x, y)):
            sides = (values - middle[k]) / depth
            middle[k] += (sides.min() + sides.max()) / 2 * distance * 0.9
    target = middle @ axes
    return Camera(
        tuple(map(float, target + distance * axes[2])), tuple(map(float, target)), tuple(map(float, up)), OPENING
    )


def _looking(towards: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows to the right, up and towards the eye."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


# Pieces -------------------------------------------------------------------------------------------------------------


def colors_of(space: Space) -> dict[str, str]:
    """Of bodies, bars and dots, in the order of declaration."""
    bars = [strut.name for strut in space.struts if strut.kind == "bar"]
    names = dict.fromkeys([*(solid.name for solid in space.solids), *bars, *space.dots])
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}


def pieces_of(space: Space, view: SpaceView) -> list[Piece]:
    """All that is seen, in metres."""
    unit, colors = view.unit, colors_of(space)
    pieces: list[Piece] = []
    for solid in space.solids:
        pieces += _solid(solid, colors[solid.name], unit, view.extent)
    boxes = {piece.name for piece in pieces if piece.kind == "box"}
    for pivot in space.pivots:
        axis = pivot.axis or (0.0, 0.0, 1.0)
        turn = tuple(map(float, _turned_to(np.array(axis))))

        def piece(
            kind: str, size: tuple[float, ...], color: str = WHITE, at=pivot.first, turn=turn, name=pivot.name
        ) -> Piece:
            return Piece(name, kind, (at,), tuple(u * unit for u in size), color, turn)

        if pivot.kind in SLIDING:
            low, high = view.travel[pivot.name]
            ends = [
                Spot(
                    pivot.first.frame,
                    *(o + end * a / math.hypot(*axis) for o, a in zip(_xyz(pivot.first), axis, strict=True)),
                )
                for end in (low - 6 * unit, high + 6 * unit)
            ]
            if not any(_inside(ends, piece, unit) for piece in pieces):
                pieces.append(Piece(pivot.name, "rod", tuple(ends), (0.62 * unit, 0.0, 1.0), FAINT))
            if pivot.kind != "prismatic":
                pieces.append(piece("cylinder", (1.7, 3.0), at=pivot.second))
            elif pivot.second.frame not in boxes:
                pieces.append(piece("box", (1.7, 1.7, 2.6), colors.get(pivot.second.frame, STEEL), at=pivot.second))
        elif pivot.kind == "revolute":
            pieces.append(piece("cylinder", (1.45, 2.3)))
        elif pivot.kind == "universal":
            pieces.append(piece("cylinder", (1.1, 2.6)))
            pieces.append(piece("ball", (1.6,)))
        elif pivot.kind == "planar":
            pieces.append(piece("cylinder", (3.2, 0.5), at=pivot.second))
        elif pivot.kind == "weld":
            pieces.append(piece("box", (1.3, 1.3, 1.3), INK))
        else:
            pieces.append(piece("ball", (1.75,)))
        if GROUND in (pivot.first.frame, pivot.second.frame) and pivot.kind not in (*SLIDING, "planar"):
            foot = pivot.first if pivot.first.frame == GROUND else pivot.second
            upright = tuple(map(float, _turned_to(np.array(space.up))))
            pieces.append(piece("cone", (3.6, 1.2, 5.0), STEEL, at=foot, turn=upright))
    for strut in space.struts:
        ends = strut.first, strut.second
        if strut.kind in ("bar", "rod"):
            color = colors[strut.name] if strut.kind == "bar" else FAINT
            pieces.append(
                Piece(strut.name, "rod", ends, ((1.0 if strut.kind == "bar" else 0.6) * unit, 0.0, 1.0), color)
            )
        if "damper" in strut.kind:
            pieces.append(Piece(strut.name, "rod", ends, (0.35 * unit, 0.0, 1.0), FAINT))
            pieces.append(Piece(strut.name, "rod", ends, (0.95 * unit, 0.22, 0.58), STEEL))
        elif strut.kind == "spring":
            pieces.append(Piece(strut.name, "rod", ends, (0.2 * unit, 0.0, 1.0), STEEL))
        if "spring" in strut.kind:
            pieces.append(Piece(strut.name, "coil", ends, (1.6 * unit, 0.22 * unit), INK))
    for dot in space.dots:
        pieces.append(Piece(dot, "ball", (Spot(dot, 0.0, 0.0, 0.0),), (1.8 * unit,), colors[dot]))
    return pieces


def _inside(ends: Sequence[Spot], piece: Piece, unit: float) -> bool:
    """Whether a rail lies along a rod of its own body, which then is what guides."""
    if piece.kind != "rod" or {at.frame for at in (*ends, *piece.at)} != {ends[0].frame}:
        return False
    start, end = (np.array(_xyz(at)) for at in piece.at)
    along = (end - start) / np.linalg.norm(end - start)
    apart = [np.array(_xyz(at)) - start for at in ends]
    return all(np.linalg.norm(x - (x @ along) * along) < 0.5 * unit for x in apart)


def _xyz(at: Spot) -> Vector3:
    return at.x, at.y, at.z


def _solid(solid: Solid, color: str, unit: float, extent: float) -> list[Piece]:
    """A body: a plate through points that lie in a plane, else rods; a box or a ball where it has a point alone."""
    name, center = solid.name, Spot(solid.name, 0.0, 0.0, 0.0)
    near = 1e-6 * extent
    points = _distinct(np.array(solid.points).reshape(-1, 3), near)
    everything = _distinct(np.vstack([points, np.zeros((1, 3))]), near)
    usual = solid.box and max(solid.box) < 0.3 * extent and min(solid.box) > 0.3 * unit
    if (solid.block or len(everything) == 1) and usual:
        return [Piece(name, "box", (center,), tuple(max(x, unit) for x in solid.box), color)]
    if solid.block and not solid.box:
        return [Piece(name, "box", (center,), (2.6 * unit, 1.7 * unit, 1.7 * unit), color)]
    if len(everything) == 1:
        return [Piece(name, "ball", (center,), (2.3 * unit,), color)]
    if plate := _plate(points, extent):
        middle, turn, outline = plate
        return [Piece(name, "plate", (Spot(name, *middle),), (0.55 * unit,), color, turn, outline)]
    pieces, ends = [], {}
    for a, b in _spine(everything, extent) or _tree(everything, extent):
        pieces.append(Piece(name, "rod", (Spot(name, *a), Spot(name, *b)), (unit, 0.0, 1.0), color))
        for end in (a, b):
            ends[end] = ends.get(end, 0) + 1
    own = [p for p in ends if math.hypot(*p) <= near]
    if own and ends[own[0]] == 1 and len(everything) > len(points):
        pieces.append(Piece(name, "ball", (center,), (2.6 * unit,), color))
    return pieces


def _distinct(points: NDArray[np.float64], near: float) -> NDArray[np.float64]:
    """Points (N, 3) without those that are next to one before."""
    kept: list[NDArray[np.float64]] = []
    for p in points:
        if all(np.linalg.norm(p - k) > near for k in kept):
            kept.append(p)
    return np.array(kept).reshape(-1, 3)


def _tree(points: NDArray[np.float64], extent: float) -> list[tuple[Vector3, Vector3]]:
    """The shortest rods that hold points together."""
    points = _distinct(points, 1e-6 * extent)
    inside, rods = [0], []
    while len(inside) < len(points):
        outside = [i for i in range(len(points)) if i not in inside]
        apart = np.linalg.norm(points[inside][:, None] - points[outside][None], axis=2)
        i, k = np.unravel_index(np.argmin(np.round(apart, 9)), apart.shape)
        rods.append((tuple(map(float, points[inside[i]])), tuple(map(float, points[outside[k]]))))
        inside.append(outside[k])
    return rods


def _spine(points: NDArray[np.float64], extent: float) -> list[tuple[Vector3, Vector3]]:
    """A rod through the centre of mass and short ones from it to each point, where all points are near one line."""
    _, sizes, axes = np.linalg.svd(points)
    if len(points) < 3 or not 1e-6 * extent < sizes[1] < 0.25 * sizes[0]:
        return []
    along = points @ axes[0]
    feet = along[:, None] * axes[0]
    ribs = [(feet[i], p) for i, p in enumerate(points) if np.linalg.norm(p - feet[i]) > 1e-6 * extent]
    spine = feet[np.argmin(along)], feet[np.argmax(along)]
    return [(tuple(map(float, a)), tuple(map(float, b))) for a, b in (spine, *ribs)]


def _plate(points: NDArray[np.float64], extent: float) -> tuple[Vector3, Quaternion, tuple[Vector, ...]] | None:
    """Middle, attitude and outline of the plate through points of one plane; None where there is none."""
    if len(points) < 3:
        return None
    middle = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - middle)
    if sizes[1] < 0.2 * sizes[0] or sizes[2] > 1e-6 * extent:
        return None
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    flat = (points - middle) @ axes[:2].T
    from scipy.spatial import ConvexHull

    corners = flat[ConvexHull(flat).vertices]
    return tuple(map(float, middle)), _attitude(axes.T), tuple((float(x), float(y)) for x, y in corners)


def _attitude(R: NDArray[np.float64]) -> Quaternion:
    """Euler parameters of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return float(w), float(x), float(y), float(z)


# Painting -----------------------------------------------------------------------------------------------------------


class Stage:
    """All of a picture in space that does not change while the mechanism moves."""

    def __init__(self, shapes: Shapes, view: SpaceView, size: Size):
        assert shapes.space is not None
        self.space, self.view, self.size = shapes.space, view, size
        self.camera = camera_of(view, size)
        self.unit, self.colors = view.unit, colors_of(self.space)
        self.pieces = pieces_of(self.space, view)
        self.lens = _Lens(self.camera, size)
        self.floor = floor_of(view, self.lens.scale, base_of(size))
        self.meshes = [() if piece.kind == "coil" else _mesh(piece, self.unit) for piece in self.pieces]


def paint(surface: Surface, stage: Stage, poses: Mapping[str, Pose], trails: Mapping[str, NDArray[np.float64]]) -> None:
    """A mechanism at one instant, with the paths (T, 3) [m] of dots and bodies by name."""
    lens, base, unit = stage.lens, base_of(stage.size), stage.unit
    rim = 1.3 * base / lens.scale
    faces: list[Faces] = []
    rims: list[Faces] = []
    lines: list[tuple[NDArray[np.float64], str, float]] = []  # (P, 3)
    for piece, mesh in zip(stage.pieces, stage.meshes, strict=True):
        dark = INK if piece.color in (WHITE, STEEL, FAINT) else shade(piece.color)
        if not mesh:
            lines.append((_between(piece, poses, _coil()), dark, max(1.2 * base, 2 * piece.size[1] * lens.scale)))
            continue
        vertices, normals, quads = mesh
        for grown, color, kept in ((0.0, piece.color, faces), (rim, dark, rims)):
            before = 0.8 * min(piece.size) if piece.kind == "box" else 0.0  # over a shaft that runs through it
            kept.append(Faces(_world(piece, poses, vertices + grown * normals)[quads], color, before))
    _floor(surface, lens, stage, [face.quads for face in faces])
    items = [*_lit(lens, faces), *_lit(lens, rims, back=True)]
    for name, path in trails.items():
        if len(path) > 1:
            some = np.unique(np.linspace(0, len(path) - 1, min(len(path), 400)).astype(int))
            lines.append((path[some], stage.colors.get(name, FAINT), 2.2 * base))
    for points, color, width in lines:
        (pixels, depth), stroke = lens.seen(points), Stroke((), width, color)
        items += [
            (float(depth[i : i + 2].mean()) - 0.5 * unit, pixels[i : i + 2].tolist(), stroke)
            for i in range(len(points) - 1)
        ]
    for _, points, stroke in sorted(items, key=lambda item: -item[0]):
        surface.stroke(points, stroke)
    _axes(surface, stage.camera, base)
    if unit * lens.scale > 2.2 * base:
        names = list(_texts(stage, poses))
        knots = {lens.one(place_of(poses, p.second)): 1.4 * unit * lens.scale for p in stage.space.pivots}
        for text in placed(names, stage.size, [(*at, r) for at, r in knots.items()], surface.pushed):
            surface.text(text)


class _Lens:
    """From places to pixels."""

    def __init__(self, camera: Camera, size: Size):
        self.eye, self.axes = np.array(camera.eye), camera.axes
        self.size = size
        self.focus = size[1] / 2 / math.tan(math.radians(camera.opening) / 2)
        self.scale = self.focus / float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
        """Pixels of a metre at the target."""

    def seen(self, places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels (..., 2), y upwards, and distance from the eye (...) [m]."""
        local = (places - self.eye) @ self.axes.T
        depth = np.maximum(-local[..., 2], 1e-9)
        pixels = self.focus * local[..., :2] / depth[..., None] + np.array(self.size) / 2
        return pixels, np.linalg.norm(local, axis=-1)

    def one(self, place: NDArray[np.float64]) -> Vector:
        """Pixels of one place."""
        x, y = self.seen(place)[0]
        return float(x), float(y)


Item = tuple[float, "Sequence[Vector] | NDArray[np.float64]", Stroke]
"""Distance from the eye, points in pixels, and how they are drawn."""


@dataclass(frozen=True)
class Faces:
    """Faces (F, 4, 3) of a piece in ground axes [m], drawn as if they were nearer to the eye by `before` [m]."""

    quads: NDArray[np.float64]
    color: str
    before: float


def _lit(lens: _Lens, faces: Sequence[Faces], back: bool = False) -> Iterator[Item]:
    """Faces that are turned to the eye, lit from above on the left; with `back` those that are turned away, unlit."""
    light = np.array([-0.45, 0.75, 0.6]) @ lens.axes
    light /= np.linalg.norm(light)
    for quads, color, before in ((f.quads, f.color, f.before) for f in faces):
        normals = _cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        middles = quads.mean(axis=1)
        towards = np.sum(normals * (lens.eye - middles), axis=1)
        keep = towards < 0 if back else towards > 0
        pixels, _ = lens.seen(quads[keep])
        depths = np.linalg.norm(middles[keep] - lens.eye, axis=1) - before
        shares = np.zeros(len(depths)) if back else 0.7 + 0.38 * np.maximum(0.0, normals[keep] @ light)
        for depth, points, share in zip(depths.tolist(), pixels.tolist(), shares.tolist(), strict=True):
            yield depth, points, Stroke((), 0.0, color if back else _light(color, share), True)


@cache
def _steps(color: str) -> tuple[str, ...]:
    """A colour from dark to light."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    found = []
    for i in range(65):
        share = 0.6 + 0.5 * i / 64
        found.append("#" + "".join(f"{min(255, int(x * share + 0.5)):02x}" for x in rgb))
    return tuple(found)


def _light(color: str, share: float) -> str:
    """A colour with a share of its light."""
    return _steps(color)[min(64, max(0, round((share - 0.6) / 0.5 * 64)))]


@dataclass(frozen=True)
class Floor:
    """Grid lines at multiples of `cell` [m] in two directions, from `low` to `high` of them, at a height along `up`."""

    east: Vector3
    north: Vector3
    low: tuple[int, int]
    high: tuple[int, int]
    cell: float
    height: float


def floor_of(view: SpaceView, scale: float, base: float) -> Floor:
    """The floor under a motion; `scale` is in pixels per metre."""
    east, north, _ = right_handed(view.up)
    cell = cell_of(46 * base, scale)
    flat = view.cloud @ np.array([east, north]).T
    low = np.floor((flat.min(axis=0) - 0.1 * view.extent) / cell).astype(int)
    high = np.ceil((flat.max(axis=0) + 0.1 * view.extent) / cell).astype(int)
    wide = max(high - low)
    low, high = low - (wide - (high - low)) // 2, high + (wide - (high - low) + 1) // 2
    return Floor(east, north, tuple(map(int, low)), tuple(map(int, high)), cell, view.floor)


def _floor(surface: Surface, lens: _Lens, stage: Stage, faces: Sequence[NDArray[np.float64]]) -> None:
    """Grid lines on the floor under the motion, and the shadows of what stands on it."""
    up, base, floor = np.array(stage.view.up), base_of(surface.size), stage.floor
    east, north = np.array(floor.east), np.array(floor.north)
    for k in (0, 1):
        for i in range(floor.low[k], floor.high[k] + 1):
            ends = [(i, floor.low[1]), (i, floor.high[1])] if k == 0 else [(floor.low[0], i), (floor.high[0], i)]
            places = [floor.cell * (x * east + y * north) + floor.height * up for x, y in ends]
            pixels, _ = lens.seen(np.array(places))
            surface.stroke(pixels.tolist(), Stroke((), base, GRID if i else ZERO))
    for quads in faces:  # of pieces without hollows, so that the shadow of each has none
        corners = quads.reshape(-1, 3)
        pixels, _ = lens.seen(corners - ((corners @ up) - floor.height)[:, None] * up)
        shadow = hull_of([tuple(p) for p in np.round(pixels, 2).tolist()])
        if len(shadow) > 2:
            surface.stroke(shadow, Stroke((), 0.0, SHADOW, True))
    surface.text(Text(f"grid: {floor.cell:g} m", surface.size[0] - 52 * base, 22 * base, 12 * base, FAINT))


def _axes(surface: Surface, camera: Camera, base: float) -> None:
    """Directions of the axes in the left lower corner."""
    x0, y0 = 44 * base, 44 * base
    for k in np.argsort(camera.axes[2]):
        dx, dy, _ = camera.axes[:, k]
        if math.hypot(dx, dy) < 0.45:  # it points at the eye
            continue
        end = x0 + 28 * base * dx, y0 + 28 * base * dy
        surface.stroke([(x0, y0), end], Stroke((), 1.5 * base, FAINT))
        surface.text(Text("xyz"[k], x0 + 39 * base * dx, y0 + 39 * base * dy, 12 * base, FAINT))


@dataclass(frozen=True)
class Name:
    """A label of a joint or of something else, in the middle of some points; its size is in pixels of 640 x 480."""

    text: str
    at: tuple[Spot, ...]
    joint: bool
    color: str
    size: float


def names_of(space: Space, colors: Mapping[str, str]) -> list[Name]:
    """Labels of bodies, bars and dots, then those of joints."""
    found: dict[str, tuple[Spot, ...]] = {}
    for solid in space.solids:
        points = [Spot(solid.name, *p) for p in solid.points]
        far = max(points, key=lambda p: math.hypot(*_xyz(p)), default=None)
        center = Spot(solid.name, 0.0, 0.0, 0.0)
        found[solid.name] = (center, center, far) if far else (center,)
    for strut in space.struts:
        if strut.kind == "bar":
            found.setdefault(strut.name, (strut.first, strut.second))
    found |= {dot: (Spot(dot, 0.0, 0.0, 0.0),) for dot in space.dots}
    names = [Name(text, at, False, shade(colors[text]), 13.0) for text, at in found.items()]
    return names + [Name(p.name, (p.second,), True, INK, 14.0) for p in space.pivots if p.name]


def _texts(stage: Stage, poses: Mapping[str, Pose]) -> Iterator[Text]:
    """Labels beside what they name; joints of one place share a label."""
    base, above = base_of(stage.size), 2.6 * stage.unit * stage.lens.scale
    joints: dict[Vector, list[str]] = {}
    for name in names_of(stage.space, stage.colors):
        x, y = stage.lens.one(np.mean([place_of(poses, at) for at in name.at], axis=0))
        if name.joint:
            joints.setdefault((round(x), round(y)), []).append(name.text)
        else:
            yield Text(name.text, x + 12 * base, y + 10 * base, name.size * base, name.color)
    for (x, y), texts in joints.items():
        yield Text(", ".join(texts), x, y + 9 * base + above, 14 * base, INK)


# Meshes: corners, directions in which a rim grows, faces of four corners whose normals point outwards -----------------

Mesh = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _world(piece: Piece, poses: Mapping[str, Pose], vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners of a piece (V, 3) in ground axes [m]."""
    if len(piece.at) == 2:
        return _between(piece, poses, vertices)
    at = piece.at[0]
    place, turn = poses[at.frame]
    return place + rotated(turn, np.array(_xyz(at)) + rotated(np.array(piece.turn), vertices))


def _between(piece: Piece, poses: Mapping[str, Pose], vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """What stretches between two points: z runs from 0 to 1, x and y are in radii of a coil, in metres of a rod."""
    start, end = (place_of(poses, at) for at in piece.at)
    way = end - start
    length = float(np.linalg.norm(way)) or 1e-12
    radius = piece.size[0] if piece.kind == "coil" else 1.0
    local = vertices * np.array([radius, radius, length])
    return start + rotated(_turned_to(way), local)


def _mesh(piece: Piece, unit: float) -> Mesh:
    kind, size = piece.kind, tuple(round(x, 9) for x in piece.size)
    if kind == "rod":
        length = 1.0 if piece.at[0].frame != piece.at[1].frame else math.dist(_xyz(piece.at[0]), _xyz(piece.at[1]))
        whole = piece.at[0].frame != piece.at[1].frame
        cuts = 12 if whole else max(1, min(12, round((size[2] - size[1]) * length / (5 * unit))))
        return _rod(size[0], size[1], size[2], cuts)
    if kind == "plate":
        return _prism(piece.outline, size[0])
    return {"ball": _ball, "box": _block, "cylinder": _cylinder, "cone": _cone}[kind](*size)


def _around(sides: int = SIDES) -> NDArray[np.float64]:
    angles = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    return np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)


def _lathe(radii: Sequence[float], heights: Sequence[float], slopes: Sequence[tuple[float, float]]) -> Mesh:
    """A body of revolution about z, from below to above, closed at both ends; a slope is (radial, axial)."""
    ring = _around()
    n, layers = len(ring), len(radii)
    vertices = np.concatenate([ring * (r, r, 0) + (0, 0, z) for r, z in zip(radii, heights, strict=True)])
    normals = np.concatenate([ring * (r, r, 0) + (0, 0, z) for r, z in slopes])
    quads = []
    for k in range(layers - 1):
        for i in range(n):
            j = (i + 1) % n
            quads.append((k * n + i, k * n + j, (k + 1) * n + j, (k + 1) * n + i))
    for first, order in ((0, -1), ((layers - 1) * n, 1)):
        if radii[0 if order < 0 else -1] > 0:
            for i in range(1, n - 1, 2):
                corners = [first, first + i, first + i + 1, first + min(i + 2, n - 1)]
                quads.append(tuple(corners[::order]))
    return vertices, normals, np.array(quads)


@cache
def _rod(radius: float, start: float, end: float, cuts: int) -> Mesh:
    heights = np.linspace(start, end, cuts + 1)
    return _lathe([radius] * (cuts + 1), heights, [(1.0, 0.0)] * (cuts + 1))


@cache
def _cylinder(radius: float, half: float) -> Mesh:
    heights = np.linspace(-half, half, 4)
    return _lathe([radius] * 4, heights, [(1.0, -1.0), (1.0, 0.0), (1.0, 0.0), (1.0, 1.0)])


@cache
def _cone(below: float, above: float, height: float) -> Mesh:
    return _lathe([below, above], [-height, 0.0], [(1.0, -1.0), (1.0, 1.0)])


@cache
def _ball(radius: float) -> Mesh:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 11)
    slopes = [(float(np.cos(a)), float(np.sin(a))) for a in angles]
    return _lathe([max(1e-9, radius * c) for c, _ in slopes], [radius * s for _, s in slopes], slopes)


@cache
def _block(x: float, y: float, z: float) -> Mesh:
    vertices, normals, quads = [], [], []
    half, steps = np.array([x, y, z]), np.linspace(-1, 1, 4)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        for side in (-1, 1):
            first = len(vertices)
            for a in steps:
                for b in steps:
                    corner = np.zeros(3)
                    corner[[k, i, j]] = side, a, b
                    vertices.append(corner * half)
                    normals.append(np.where(np.abs(corner) > 0.999, corner, 0.0))
            for p in range(3):
                for q in range(3):
                    corners = [
                        first + 4 * p + q,
                        first + 4 * (p + 1) + q,
                        first + 4 * (p + 1) + q + 1,
                        first + 4 * p + q + 1,
                    ]
                    quads.append(corners[::side])
    return np.array(vertices), np.array(normals), np.array(quads)


@cache
def _prism(outline: tuple[Vector, ...], half: float) -> Mesh:
    flat = np.array(outline)
    n = len(flat)
    normals = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    vertices = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (-half, half)])
    grown = np.concatenate([np.column_stack([normals, np.full(n, z)]) for z in (-1.0, 1.0)])
    quads = [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    # The faces in triangles about the middle, cut again, so that what passes near is sorted well.
    middle = [len(vertices), len(vertices) + 1]
    vertices = np.vstack([vertices, [0, 0, -half], [0, 0, half]])
    grown = np.vstack([grown, [0, 0, -1], [0, 0, 1]])
    for i in range(n):
        j = (i + 1) % n
        quads.append((middle[0], j, i, i))
        quads.append((middle[1], n + i, n + j, n + j))
    return vertices, grown, np.array(quads)


@cache
def _coil() -> NDArray[np.float64]:
    """A wire (P, 3) with nine turns between straight ends."""
    z = np.linspace(0.18, 0.82, 9 * 14 + 1)
    angle = 2 * np.pi * 9 * (z - 0.18) / 0.64
    wire = np.column_stack([np.cos(angle), np.sin(angle), z])
    return np.vstack([[0, 0, 0], [0, 0, 0.18], wire, [0, 0, 0.82], [0, 0, 1]])
