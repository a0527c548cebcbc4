"""Pictures of mechanisms in space: poses, the extent of a motion, the camera.

The shapes define frames and parts fixed in them, the motion defines the extent (`view_of`), from which the camera and
the floor follow (`Camera`, `Floor`).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.errors import InputError
from ..model.spatial import right_handed
from .shapes import GROUND, Shapes, Spot, Vector3
from .surface import Size, Vector, base_of, cell_of

Pose = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Position (..., 3) [m] and Euler parameters (..., 4) of a frame, at one instant or over time."""

OPENING = 26.0
"""Vertical angle of view of the camera [deg]: a long lens, so that sizes can be compared."""

ELEVATION = 24.0
"""Angle of the camera above the horizontal [deg]."""

AZIMUTHS = 24
"""Number of directions around the vertical that are tried for the camera."""

CLOUD = 400
"""Largest number of instants of a motion in the choice of the camera."""

SLIDING = ("prismatic", "cylindrical", "screw")
"""Kinds of joints whose second point slides along an axis, which is drawn as a rail."""


@dataclass(frozen=True)
class SpaceView:
    """Extent of a motion: positions (N, 3) [m] in the picture, the travel of each sliding joint."""

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
    """Position of the camera [m]; `opening` is the vertical angle of view [deg]."""

    eye: Vector3
    target: Vector3
    up: Vector3
    opening: float

    @property
    def axes(self) -> NDArray[np.float64]:
        """Directions (3, 3) to the right, up and towards the eye, as rows."""
        return _looking(np.subtract(self.eye, self.target), np.array(self.up))


# Poses --------------------------------------------------------------------------------------------------------------


def poses_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> dict[str, Pose]:
    """Return the pose of every frame, including the ground. Raises InputError if a column is missing or not finite."""
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
                turn = list(np.moveaxis(turned_to(np.stack(values[3:], -1)), -1, 0))
        poses[frame.name] = np.stack(place, -1), np.stack(turn, -1)
    return poses


def view_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> SpaceView:
    """Return the extent that contains all shapes at all instants of `columns`."""
    space, poses = shapes.space, poses_of(shapes, columns)
    assert space is not None
    spots = [Spot(s.name, *p) for s in space.solids for p in (*s.points, (0.0, 0.0, 0.0))]
    spots += space.spots
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
    lengths += [math.dist(a, b) for s in space.solids for a, b in tree([*s.points, (0.0, 0.0, 0.0)], extent)]
    usual = float(np.median(lengths)) / extent if lengths else 1.0
    unit = extent * min(0.0145, max(0.004, 0.05 * usual))
    low = float(np.min(cloud @ np.array(space.up)))
    return SpaceView(cloud, space.up, extent, unit, low - 5.5 * unit, travel)


def distinct(points: Sequence[Vector3], near: float) -> list[Vector3]:
    """Return points without those close to an earlier one."""
    kept: list[Vector3] = []
    for p in points:
        if all(math.dist(p, k) > near for k in kept):
            kept.append(p)
    return kept


def tree(points: Sequence[Vector3], extent: float) -> list[tuple[Vector3, Vector3]]:
    """Return the shortest rods that connect points."""
    points = distinct(points, 1e-6 * extent)
    inside, rods = [0], []
    while len(inside) < len(points):
        pairs = [(i, k) for i in inside for k in range(len(points)) if k not in inside]
        i, k = min(pairs, key=lambda pair: round(math.dist(points[pair[0]], points[pair[1]]), 9))
        rods.append((points[i], points[k]))
        inside.append(k)
    return rods


def _thinned(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions at some instants, including both ends."""
    if places.ndim == 1 or len(places) <= CLOUD:
        return places
    return places[np.unique(np.linspace(0, len(places) - 1, CLOUD).astype(int))]


def place_of(poses: Mapping[str, Pose], at: Spot) -> NDArray[np.float64]:
    """Return a point (..., 3) in ground axes [m]."""
    place, turn = poses[at.frame]
    return place + rotated(turn, np.array([at.x, at.y, at.z]))


def rotated(turn: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate a vector (..., 3) of a frame to ground axes, by Euler parameters (..., 4)."""
    p = turn[..., 1:]
    twice = 2 * cross(p, vector)
    return vector + turn[..., :1] * twice + cross(p, twice)


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross product of vectors (..., 3), some ten times as fast as NumPy's for a few of them."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]).T


def turned_to(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Euler parameters (..., 4) of the smallest rotation of z to a direction (..., 3)."""
    z = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    e = np.stack([1 + z[..., 2], -z[..., 1], z[..., 0], 0 * z[..., 0]], -1)
    size = np.linalg.norm(e, axis=-1, keepdims=True)
    return np.where(size > 1e-9, e / np.where(size > 1e-9, size, 1.0), [0.0, 1.0, 0.0, 0.0])


def camera_of(view: SpaceView, size: Size) -> Camera:
    """Return the camera that shows a motion with the widest spread, and all of it with room for labels."""
    up = np.array(view.up)
    east, north, _ = (np.array(x) for x in right_handed(view.up))
    angle = math.radians(ELEVATION)
    best: tuple[float, NDArray[np.float64]] = (-1.0, east)
    for i in range(AZIMUTHS):
        around = 2 * math.pi * (i + 0.35) / AZIMUTHS  # never along an axis, where parts hide each other
        flat = math.cos(around) * east + math.sin(around) * north
        towards = math.cos(angle) * flat + math.sin(angle) * up
        seen = (view.cloud - view.cloud.mean(axis=0)) @ _looking(towards, up)[:2].T
        spread = float(np.linalg.svd(seen, compute_uv=False)[-1])
        # Of two equal ones, x points to the right.
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
    return Camera(_vector(target + distance * axes[2]), _vector(target), _vector(up), OPENING)


def _vector(numbers: Iterable[SupportsFloat]) -> Vector3:
    x, y, z = map(float, numbers)
    return x, y, z


def _looking(towards: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit vectors to the right, up and towards the eye, as rows."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


class Lens:
    """Projection of positions to pixels."""

    def __init__(self, camera: Camera, size: Size):
        self.eye, self.axes = np.array(camera.eye), camera.axes
        self.size = size
        self.focus = size[1] / 2 / math.tan(math.radians(camera.opening) / 2)
        self.scale = self.focus / float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
        """Pixels per metre at the target."""

    def seen(self, places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return pixels (..., 2), y upwards, and distance from the eye (...) [m]."""
        local = (places - self.eye) @ self.axes.T
        depth = np.maximum(-local[..., 2], 1e-9)
        pixels = self.focus * local[..., :2] / depth[..., None] + np.array(self.size) / 2
        return pixels, np.linalg.norm(local, axis=-1)

    def one(self, place: NDArray[np.float64]) -> Vector:
        """Return the pixels of one position."""
        x, y = self.seen(place)[0]
        return float(x), float(y)


@dataclass(frozen=True)
class Floor:
    """Grid lines at multiples of `cell` [m] in two directions, from `low` to `high`, at a height along `up`."""

    east: Vector3
    north: Vector3
    low: tuple[int, int]
    high: tuple[int, int]
    cell: float
    height: float


def floor_of(view: SpaceView, scale: float, base: float) -> Floor:
    """Return the floor under a motion; `scale` is in pixels per metre."""
    east, north, _ = map(_vector, right_handed(view.up))
    cell = cell_of(46 * base, scale)
    flat = view.cloud @ np.array([east, north]).T
    low = np.floor((flat.min(axis=0) - 0.1 * view.extent) / cell).astype(int)
    high = np.ceil((flat.max(axis=0) + 0.1 * view.extent) / cell).astype(int)
    wide = max(high - low)
    low, high = low - (wide - (high - low)) // 2, high + (wide - (high - low) + 1) // 2
    corners = (int(low[0]), int(low[1])), (int(high[0]), int(high[1]))
    return Floor(east, north, *corners, cell, view.floor)
