"""Pictures of mechanisms in space without a browser: pieces as faces, painted from back to front."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .pieces import Piece, colors_of, names_of, pieces_of, xyz
from .scene import hull_of
from .shapes import Shapes, Vector3
from .space import Camera, Lens, Pose, SpaceView, camera_of, cross, floor_of, place_of, poses_of, rotated, turned_to
from .surface import FAINT, GRID, INK, PALETTE, ZERO, Size, Surface, Text, Vector, base_of, placed, rim_of

SIDES = 18
"""Number of faces around a rod."""

SHADOW = "#e4e9ee"


class Stage:
    """The static part of a picture in space."""

    def __init__(self, shapes: Shapes, view: SpaceView, size: Size):
        assert shapes.space is not None
        self.shapes = shapes
        self.space, self.view, self.size = shapes.space, view, size
        self.camera = camera_of(view, size)
        self.unit, self.colors = view.unit, colors_of(self.space)
        self.pieces = pieces_of(self.space, view)
        self.lens = Lens(self.camera, size)
        self.floor = floor_of(view, self.lens.scale, base_of(size))
        meshes = [None if piece.kind == "coil" else _mesh(piece, self.unit) for piece in self.pieces]
        rim = 1.3 * base_of(size) / self.lens.scale
        self.meshes = [mesh and np.concatenate([mesh[0], mesh[0] + rim * mesh[1]]) for mesh in meshes]
        """Corners of each piece, and of its rim; None for a coil."""
        self.faces = _Faces.of(self.pieces, [mesh for mesh in meshes if mesh])

    def paint(self, surface: Surface, columns: Mapping[str, float], trails: Mapping[str, Sequence[Any]]) -> None:
        """Paint a mechanism at one instant, with the paths (T, 3) [m] of dots and bodies by name."""
        poses = poses_of(self.shapes, columns)
        lens, base, unit = self.lens, base_of(self.size), self.unit
        corners: list[NDArray[np.float64]] = []
        lines: list[tuple[NDArray[np.float64], str, float]] = []  # (P, 3)
        for piece, mesh in zip(self.pieces, self.meshes, strict=True):
            if mesh is None:
                dark = rim_of(piece.color)
                lines.append((_between(piece, poses, _coil()), dark, max(1.2 * base, 2 * piece.size[1] * lens.scale)))
            else:
                corners.append(_world(piece, poses, mesh))
        _floor(surface, lens, self, [x[each] for x, each in zip(corners, self.faces.outer, strict=True)])
        items = self.faces.lit(lens, corners)
        for name, path in trails.items():
            if len(path) > 1:
                some = np.unique(np.linspace(0, len(path) - 1, min(len(path), 400)).astype(int))
                lines.append((np.array(path)[some], self.colors.get(name, FAINT), 2.2 * base))
        for points, color, width in lines:
            pixels, depth = lens.seen(points)
            items += [
                (float(depth[i : i + 2].mean()) - 0.5 * unit, pixels[i : i + 2].tolist(), width, color, False)
                for i in range(len(points) - 1)
            ]
        for item in sorted(items, key=lambda item: -item[0]):
            surface.stroke(*item[1:])
        _axes(surface, self.camera, base)
        if unit * lens.scale > 2.2 * base:
            names = list(_texts(self, poses))
            knots = {lens.one(place_of(poses, p.second)): 1.4 * unit * lens.scale for p in self.space.pivots}
            for text in placed(names, self.size, [(*at, r) for at, r in knots.items()], surface.pushed):
                surface.text(text)


Item = tuple[float, Sequence[Vector], float, str, bool]
"""Distance from the eye, points in pixels, and style: width, colour, filled."""


@dataclass(frozen=True)
class _Faces:
    """All faces of a picture, of pieces first and then of their rims, whose far sides are shown."""

    quads: NDArray[np.intp]
    """Places (F, 4) of their corners among those of all pieces."""
    back: NDArray[np.bool_]
    """Whether a face belongs to a rim."""
    before: NDArray[np.float64]
    """Distance [m] by which a face is sorted as if nearer."""
    colors: list[tuple[str, ...]]
    """Shades of each face from dark to light; of a rim one."""
    outer: list[NDArray[np.intp]]
    """Corners of each piece that are on its convex hull, which alone shape its shadow."""

    @classmethod
    def of(cls, pieces: Sequence[Piece], meshes: Sequence[Mesh]) -> _Faces:
        solid = [piece for piece in pieces if piece.kind != "coil"]
        first = np.cumsum([0, *(2 * len(vertices) for vertices, *_ in meshes)])[:-1]
        parts = list(zip(solid, meshes, first, strict=True))
        quads = [quads + at for _, (_, _, quads), at in parts]
        quads += [quads + at + len(vertices) for _, (vertices, _, quads), at in parts]
        counts = [len(each) for each in quads]
        # A box hides a shaft inside it.
        before = [0.8 * min(piece.size) if piece.kind == "box" else 0.0 for piece in solid]
        shades = [_steps(PALETTE.get(piece.color, piece.color)) for piece in solid]
        shades += [(rim_of(piece.color),) for piece in solid]
        return cls(
            np.concatenate(quads or [np.empty((0, 4), int)]),
            np.repeat([False, True], [sum(counts[: len(solid)]), sum(counts[len(solid) :])]),
            np.repeat([*before, *before], counts),
            [shade for shade, count in zip(shades, counts, strict=True) for _ in range(count)],
            [_outer(piece, vertices) for piece, (vertices, *_) in zip(solid, meshes, strict=True)],
        )

    def lit(self, lens: Lens, corners: Sequence[NDArray[np.float64]]) -> list[Item]:
        """Return faces towards the eye, lit from above on the left, and faces of rims away from it, unlit."""
        places = np.concatenate([*corners, np.empty((0, 3))])
        a, b, c, d = (places[each] for each in self.quads.T)
        middles, normals = (a + b + c + d) / 4 - lens.eye, cross(c - a, d - b)
        towards = -np.sum(normals * middles, axis=1)
        seen = np.flatnonzero(np.where(self.back, -towards, towards) > 0)
        light = np.array([-0.45, 0.75, 0.6]) @ lens.axes
        light /= np.linalg.norm(light)
        normals, back = normals[seen], self.back[seen]
        sizes = np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
        shares = 0.7 + 0.38 * np.maximum(0.0, normals @ light / sizes)
        steps = np.where(back, 0, np.clip(np.rint((shares - 0.6) / 0.5 * 64), 0, 64)).astype(int)
        depths = np.linalg.norm(middles[seen], axis=1) - self.before[seen]
        pixels = lens.seen(places)[0][self.quads[seen]]
        shown = zip(depths.tolist(), pixels.tolist(), seen.tolist(), steps.tolist(), strict=True)
        return [(depth, points, 0.0, self.colors[face][step], True) for depth, points, face, step in shown]


def _outer(piece: Piece, vertices: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the corners of a piece that can be on its convex hull: a rod and a box have others on their sides."""
    if piece.kind == "box":
        return np.flatnonzero(np.isclose(np.abs(vertices), piece.size).all(axis=1))
    ends = SIDES if piece.kind == "rod" else len(vertices)
    return np.unique([*range(ends), *range(len(vertices) - ends, len(vertices))])


@cache
def _steps(color: str) -> tuple[str, ...]:
    """Return the shades of a colour from dark to light."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    found = []
    for i in range(65):
        share = 0.6 + 0.5 * i / 64
        found.append("#" + "".join(f"{min(255, int(x * share + 0.5)):02x}" for x in rgb))
    return tuple(found)


def _floor(surface: Surface, lens: Lens, stage: Stage, pieces: Sequence[NDArray[np.float64]]) -> None:
    """Paint grid lines on the floor under the motion, and the shadows on it."""
    up, base, floor = np.array(stage.view.up), base_of(surface.size), stage.floor
    east, north = np.array(floor.east), np.array(floor.north)
    for k in (0, 1):
        for i in range(floor.low[k], floor.high[k] + 1):
            ends = [(i, floor.low[1]), (i, floor.high[1])] if k == 0 else [(floor.low[0], i), (floor.high[0], i)]
            places = [floor.cell * (x * east + y * north) + floor.height * up for x, y in ends]
            pixels, _ = lens.seen(np.array(places))
            surface.stroke(pixels.tolist(), base, GRID if i else ZERO)
    for corners in pieces:  # convex ones, so that their shadows are too
        pixels, _ = lens.seen(corners - ((corners @ up) - floor.height)[:, None] * up)
        shadow = hull_of([tuple(p) for p in np.round(pixels, 2).tolist()])
        if len(shadow) > 2:
            surface.stroke(shadow, 0.0, SHADOW, True)
    surface.text(Text(f"grid: {floor.cell:g} m", surface.size[0] - 52 * base, 22 * base, 12 * base, FAINT))


def _axes(surface: Surface, camera: Camera, base: float) -> None:
    """Paint the directions of the axes in the lower left corner."""
    x0, y0 = 44 * base, 44 * base
    for k in np.argsort(camera.axes[2]):
        dx, dy, _ = camera.axes[:, k]
        if math.hypot(dx, dy) < 0.45:  # this axis points towards the eye
            continue
        end = x0 + 28 * base * dx, y0 + 28 * base * dy
        surface.stroke([(x0, y0), end], 1.5 * base, FAINT)
        surface.text(Text("xyz"[k], x0 + 39 * base * dx, y0 + 39 * base * dy, 12 * base, FAINT))


def _texts(stage: Stage, poses: Mapping[str, Pose]) -> Iterator[Text]:
    """Yield labels beside their objects; joints at one position share a label."""
    base, above = base_of(stage.size), 2.6 * stage.unit * stage.lens.scale
    joints: dict[Vector, list[str]] = {}
    for name in names_of(stage.space, stage.colors):
        x, y = stage.lens.one(np.mean([place_of(poses, at) for at in name.at], axis=0))
        if name.joint:
            joints.setdefault((round(x), round(y)), []).append(name.text)
        else:
            yield Text(name.text, x + 12 * base, y + 10 * base, name.size * base, rim_of(name.color))
    for (x, y), texts in joints.items():
        yield Text(", ".join(texts), x, y + 9 * base + above, 14 * base, INK)


# Meshes: corners, directions in which a rim grows, faces of four corners whose normals point outwards -----------------

Mesh = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _world(piece: Piece, poses: Mapping[str, Pose], vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vertices (V, 3) of a piece in ground axes [m]."""
    if len(piece.at) == 2:
        return _between(piece, poses, vertices)
    at = piece.at[0]
    place, turn = poses[at.frame]
    if piece.kind == "plate":
        return place + rotated(turn, vertices)
    return place + rotated(turn, np.array(xyz(at)) + rotated(turned_to(np.array(piece.axis)), vertices))


def _between(piece: Piece, poses: Mapping[str, Pose], vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the places of vertices of a piece between two points: z is 0 at the first and 1 at the second; x and y are
    in radii of a coil, in metres for a rod."""
    start, end = (place_of(poses, at) for at in piece.at)
    way = end - start
    length = float(np.linalg.norm(way)) or 1e-12
    radius = piece.size[0] if piece.kind == "coil" else 1.0
    local = vertices * np.array([radius, radius, length])
    return start + rotated(turned_to(way), local)


def _mesh(piece: Piece, unit: float) -> Mesh:
    kind, size, (first, *rest) = piece.kind, tuple(round(x, 9) for x in piece.size), piece.at
    if kind == "plate":
        return _prism(tuple(map(xyz, piece.at)), size[0])
    if kind == "box":
        return _block(*size)
    cuts = 12  # cuts sort a rod correctly among near objects; fewer if its length is known
    if kind == "rod" and first.frame == rest[0].frame:
        length = (size[2] - size[1]) * math.dist(xyz(first), xyz(rest[0]))
        cuts = max(1, min(12, round(length / (5 * unit))))
    return _lathe(kind, size, cuts)


@cache
def _lathe(kind: str, size: tuple[float, ...], cuts: int) -> Mesh:
    """Return a closed body of revolution about z, from bottom to top."""
    if kind == "ball":
        angles = np.linspace(-np.pi / 2, np.pi / 2, 11)
        slopes = np.stack([np.cos(angles), np.sin(angles)], axis=1)  # radial and axial components
        profile = size[0] * slopes
    elif kind == "rod":
        slopes = np.array([[1.0, 0.0]] * (cuts + 1))
        profile = np.stack([np.full(cuts + 1, size[0]), np.linspace(size[1], size[2], cuts + 1)], axis=1)
    elif kind == "cylinder":
        slopes = np.array([[1.0, -1.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
        profile = np.stack([np.full(4, size[0]), np.linspace(-size[1], size[1], 4)], axis=1)
    else:
        slopes, profile = np.array([[1.0, -1.0], [1.0, 1.0]]), np.array([[size[0], -size[2]], [size[1], 0.0]])
    angles = 2 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices, normals = (
        np.concatenate([np.column_stack([r * around, np.full(SIDES, z)]) for r, z in line])
        for line in (np.maximum(profile, [1e-9, -np.inf]), slopes)
    )
    n, last = SIDES, (len(profile) - 1) * SIDES
    quads: list[tuple[int, ...]] = [
        (k + i, k + (i + 1) % n, k + n + (i + 1) % n, k + n + i) for k in range(0, last, n) for i in range(n)
    ]
    for low, order in ((0, -1), (last, 1)):
        quads += [(low, low + i, low + i + 1, low + min(i + 2, n - 1))[::order] for i in range(1, n - 1, 2)]
    return vertices, normals, np.array(quads)


@cache
def _block(x: float, y: float, z: float) -> Mesh:
    """Return a box, with four by four corners on each side."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 4), np.linspace(-1, 1, 4), indexing="ij"), axis=-1).reshape(-1, 2)
    quads = np.add.outer(4 * np.arange(3), np.arange(3)).reshape(-1, 1) + np.array([0, 4, 5, 1])
    sides = [(k, side) for k in range(3) for side in (-1, 1)]
    corners = np.concatenate([np.roll(np.insert(grid, 0, side, axis=1), k, axis=1) for k, side in sides])
    faces = np.concatenate([16 * i + quads[:, ::side] for i, (_, side) in enumerate(sides)])
    return corners * [x, y, z], np.where(np.abs(corners) > 0.999, corners, 0.0), faces


@cache
def _prism(corners: tuple[Vector3, ...], half: float) -> Mesh:
    """Return the plate through corners in its frame."""
    middle = np.mean(corners, axis=0)
    flat = np.array(corners) - middle
    n = len(flat)
    across = sum((cross(a, b) for a, b in zip(flat, np.roll(flat, -1, axis=0), strict=True)), np.zeros(3))
    across = across / np.linalg.norm(across)
    normals = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    vertices = np.concatenate([flat - half * across, flat + half * across])
    grown = np.concatenate([normals - across, normals + across])
    quads = [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    # Triangles about the middle sort correctly among near objects.
    vertices = np.vstack([vertices, -half * across, half * across])
    grown = np.vstack([grown, -across, across])
    for i in range(n):
        j = (i + 1) % n
        quads.append((2 * n, j, i, i))
        quads.append((2 * n + 1, n + i, n + j, n + j))
    return middle + vertices, grown, np.array(quads)


@cache
def _coil() -> NDArray[np.float64]:
    """Return a wire (P, 3) with nine turns between straight ends."""
    z = np.linspace(0.18, 0.82, 9 * 14 + 1)
    angle = 2 * np.pi * 9 * (z - 0.18) / 0.64
    wire = np.column_stack([np.cos(angle), np.sin(angle), z])
    return np.vstack([[0, 0, 0], [0, 0, 0.18], wire, [0, 0, 0.82], [0, 0, 1]])
