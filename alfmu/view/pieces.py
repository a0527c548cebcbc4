"""Pieces of pictures in space: rods, balls, boxes, plates, coils in metres, and labels.

Each is fixed in a frame or spans two points. `faces` paints them, and so does the script `shared/space.js` of pages,
with three.js. Positions and directions stay traced if numbers of shapes are.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .shapes import GROUND, Solid, Space, Spot, Vector3
from .space import SLIDING, SpaceView, distinct, tree
from .surface import COLORS

Kind = Literal["rod", "coil", "ball", "box", "cylinder", "cone", "plate"]


@dataclass(frozen=True)
class Piece:
    """A piece of a picture, fixed at a point of a frame or spanning two points.

    `size` [m] of a "rod" is its radius and the relative positions of its ends between the points; of a "coil" its
    radius and that of its wire; of a "ball" its radius; of a "box" half its edges; of a "cylinder" along z its radius
    and half its length; of a "cone" under its point its radii below and above and its height; of a "plate" through
    points of a frame half its thickness. `axis` is the direction of its z in the frame. A colour is a name of
    `PALETTE`, or "#rrggbb".
    """

    name: str
    kind: Kind
    at: tuple[Spot, ...]
    size: tuple[float, ...]
    color: str
    axis: Vector3 = (0.0, 0.0, 1.0)


def colors_of(space: Space) -> dict[str, str]:
    """Return colours of bodies, bars and dots, in the order of declaration."""
    bars = [strut.name for strut in space.struts if strut.kind == "bar"]
    names = dict.fromkeys([*(solid.name for solid in space.solids), *bars, *space.dots])
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}


def pieces_of(space: Space, view: SpaceView) -> list[Piece]:
    """Return all visible pieces, in metres."""
    unit, colors = view.unit, colors_of(space)
    pieces: list[Piece] = []
    for solid in space.solids:
        pieces += _solid(solid, colors[solid.name], unit, view.extent)
    boxes = {piece.name for piece in pieces if piece.kind == "box"}
    for pivot in space.pivots:
        axis = pivot.axis or (0.0, 0.0, 1.0)
        length = sum(a * a for a in axis) ** 0.5

        def piece(
            kind: Kind,
            size: tuple[float, ...],
            color: str = "white",
            at: Spot = pivot.first,
            axis: Vector3 = axis,
            name: str = pivot.name,
        ) -> Piece:
            return Piece(name, kind, (at,), tuple(u * unit for u in size), color, axis)

        if pivot.kind in SLIDING:
            low, high = view.travel[pivot.name]
            rail = [
                Spot(pivot.first.frame, *(o + end * a / length for o, a in zip(xyz(pivot.first), axis, strict=True)))
                for end in (low - 6 * unit, high + 6 * unit)
            ]
            if not any(_inside(rail, piece, unit) for piece in pieces):
                pieces.append(Piece(pivot.name, "rod", tuple(rail), (0.62 * unit, 0.0, 1.0), "faint"))
            if pivot.kind != "prismatic":
                pieces.append(piece("cylinder", (1.7, 3.0), at=pivot.second))
            elif pivot.second.frame not in boxes:
                pieces.append(piece("box", (1.7, 1.7, 2.6), colors.get(pivot.second.frame, "steel"), at=pivot.second))
        elif pivot.kind == "revolute":
            pieces.append(piece("cylinder", (1.45, 2.3)))
        elif pivot.kind == "universal":
            pieces.append(piece("cylinder", (1.1, 2.6)))
            pieces.append(piece("ball", (1.6,)))
        elif pivot.kind == "planar":
            pieces.append(piece("cylinder", (3.2, 0.5), at=pivot.second))
        elif pivot.kind == "weld":
            pieces.append(piece("box", (1.3, 1.3, 1.3), "ink"))
        else:
            pieces.append(piece("ball", (1.75,)))
        if GROUND in (pivot.first.frame, pivot.second.frame) and pivot.kind not in (*SLIDING, "planar"):
            foot = pivot.first if pivot.first.frame == GROUND else pivot.second
            pieces.append(piece("cone", (3.6, 1.2, 5.0), "steel", at=foot, axis=space.up))
    for strut in space.struts:
        ends = strut.first, strut.second
        if strut.kind in ("bar", "rod"):
            color = colors[strut.name] if strut.kind == "bar" else "faint"
            pieces.append(
                Piece(strut.name, "rod", ends, ((1.0 if strut.kind == "bar" else 0.6) * unit, 0.0, 1.0), color)
            )
        if "damper" in strut.kind:
            pieces.append(Piece(strut.name, "rod", ends, (0.35 * unit, 0.0, 1.0), "faint"))
            pieces.append(Piece(strut.name, "rod", ends, (0.95 * unit, 0.22, 0.58), "steel"))
        elif strut.kind == "spring":
            pieces.append(Piece(strut.name, "rod", ends, (0.2 * unit, 0.0, 1.0), "steel"))
        if "spring" in strut.kind:
            pieces.append(Piece(strut.name, "coil", ends, (1.6 * unit, 0.22 * unit), "ink"))
    for dot in space.dots:
        pieces.append(Piece(dot, "ball", (Spot(dot, 0.0, 0.0, 0.0),), (1.8 * unit,), colors[dot]))
    return pieces


def _inside(ends: Sequence[Spot], piece: Piece, unit: float) -> bool:
    """Return whether a rail lies along a rod of its own body, which then serves as the guide."""
    if piece.kind != "rod" or {at.frame for at in (*ends, *piece.at)} != {ends[0].frame}:
        return False
    start, end = (np.array(xyz(at)) for at in piece.at)
    along = (end - start) / np.linalg.norm(end - start)
    apart = [np.array(xyz(at)) - start for at in ends]
    return all(np.linalg.norm(x - (x @ along) * along) < 0.5 * unit for x in apart)


def xyz(at: Spot) -> Vector3:
    return at.x, at.y, at.z


def _solid(solid: Solid, color: str, unit: float, extent: float) -> list[Piece]:
    """Return a body: a plate through coplanar points, else rods; a box or a ball for a single point."""
    name, center = solid.name, Spot(solid.name, 0.0, 0.0, 0.0)
    near = 1e-6 * extent
    points = distinct(solid.points, near)
    everything = distinct([*points, (0.0, 0.0, 0.0)], near)
    usual = solid.box if solid.box and max(solid.box) < 0.3 * extent and min(solid.box) > 0.3 * unit else None
    if (solid.block or len(everything) == 1) and usual:
        return [Piece(name, "box", (center,), tuple(max(x, unit) for x in usual), color)]
    if solid.block and not solid.box:
        return [Piece(name, "box", (center,), (2.6 * unit, 1.7 * unit, 1.7 * unit), color)]
    if len(everything) == 1:
        return [Piece(name, "ball", (center,), (2.3 * unit,), color)]
    if corners := _corners(points, extent):
        return [Piece(name, "plate", tuple(Spot(name, *p) for p in corners), (0.55 * unit,), color)]
    pieces: list[Piece] = []
    ends: Counter[Vector3] = Counter()
    for a, b in _spine(everything, extent) or tree(everything, extent):
        pieces.append(Piece(name, "rod", (Spot(name, *a), Spot(name, *b)), (unit, 0.0, 1.0), color))
        ends.update((a, b))
    own = [p for p in ends if math.hypot(*p) <= near]
    if own and ends[own[0]] == 1 and len(everything) > len(points):
        pieces.append(Piece(name, "ball", (center,), (2.6 * unit,), color))
    return pieces


def _spine(points: Sequence[Vector3], extent: float) -> list[tuple[Vector3, Vector3]]:
    """Return a rod through the centre of mass with short ones to each point, if all points are near one line."""
    _, sizes, axes = np.linalg.svd(np.array(points, float))
    if len(points) < 3 or not 1e-6 * extent < sizes[1] < 0.25 * sizes[0]:
        return []
    x, y, z = axes[0].tolist()
    along = [p[0] * x + p[1] * y + p[2] * z for p in points]
    feet = [(a * x, a * y, a * z) for a in along]
    ribs = [(foot, p) for foot, p in zip(feet, points, strict=True) if math.dist(foot, p) > 1e-6 * extent]
    return [(feet[along.index(min(along))], feet[along.index(max(along))]), *ribs]


def _corners(points: Sequence[Vector3], extent: float) -> list[Vector3]:
    """Return corners of the plate through coplanar points, in order; none if the points are not coplanar."""
    if len(points) < 3:
        return []
    places = np.array(points, float) - np.mean(np.array(points, float), axis=0)
    _, sizes, axes = np.linalg.svd(places)
    if sizes[1] < 0.2 * sizes[0] or sizes[2] > 1e-6 * extent:
        return []
    from scipy.spatial import ConvexHull

    return [points[i] for i in ConvexHull(places @ axes[:2].T).vertices]


@dataclass(frozen=True)
class Name:
    """A label in the centre of some points; its size is in pixels of a 640 x 480 picture.

    A joint's label has its colour, others the colour of its rim.
    """

    text: str
    at: tuple[Spot, ...]
    joint: bool
    color: str
    size: float


def names_of(space: Space, colors: Mapping[str, str]) -> list[Name]:
    """Return labels of bodies, bars and dots, then those of joints."""
    found: dict[str, tuple[Spot, ...]] = {}
    for solid in space.solids:
        points = [Spot(solid.name, *p) for p in solid.points]
        far = max(points, key=lambda p: math.hypot(*xyz(p)), default=None)
        center = Spot(solid.name, 0.0, 0.0, 0.0)
        found[solid.name] = (center, center, far) if far else (center,)
    for strut in space.struts:
        if strut.kind == "bar":
            found.setdefault(strut.name, (strut.first, strut.second))
    found |= {dot: (Spot(dot, 0.0, 0.0, 0.0),) for dot in space.dots}
    names = [Name(text, at, False, colors[text], 13.0) for text, at in found.items()]
    return names + [Name(p.name, (p.second,), True, "ink", 14.0) for p in space.pivots if p.name]
