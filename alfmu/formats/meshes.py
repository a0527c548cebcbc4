"""Volume and inertia of meshes in files (STL and OBJ) and of points, as homogeneous solids."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..model.errors import InputError
from .markup import content_of
from .poses import Array
from .solids import Inertial

_LARGEST = 100_000_000
"""Largest size of a file [bytes]: a million triangles of an STL file have 50 MB."""

_HEAD = 84
"""Bytes before the triangles of a binary STL file, the last four of which are their number."""

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def triangles(path: Path) -> Array:
    """Return the corners (n, 3, 3) of the triangles in a file."""
    if path.suffix.lower() not in (".stl", ".obj"):
        raise InputError(f"{path} is no STL or OBJ file; alfmu reads the inertia of these")
    content = content_of(path, _LARGEST)
    if content.startswith(b"version https://git-lfs"):
        raise InputError(f"{path} is a pointer of Git LFS; fetch the mesh by `git lfs pull`")
    try:
        found = _stl(content) if path.suffix.lower() == ".stl" else _obj(content.decode(errors="replace"))
    except (ValueError, IndexError):
        raise InputError(f"{path} is no {path.suffix[1:].upper()} file that alfmu can read") from None
    if not len(found) or not np.isfinite(found).all():
        raise InputError(f"{path} has no triangles, or corners that are no numbers")
    return found


def _stl(content: bytes) -> Array:
    count = int.from_bytes(content[_HEAD - 4 : _HEAD], "little")
    if len(content) == _HEAD + count * _TRIANGLE.itemsize:
        return np.frombuffer(content, _TRIANGLE, offset=_HEAD)["corners"].astype(float)
    lines = [line.split() for line in content.decode().splitlines()]
    return np.array([[float(x) for x in line[1:4]] for line in lines if line[:1] == ["vertex"]]).reshape(-1, 3, 3)


def _obj(text: str) -> Array:
    lines = [line.split() for line in text.splitlines()]
    corners = np.array([[float(x) for x in line[1:4]] for line in lines if line[:1] == ["v"]]).reshape(-1, 3)
    found = []
    for line in lines:
        if line[:1] == ["f"]:
            indices = [int(word.split("/")[0]) for word in line[1:]]
            plain = [i - 1 if i > 0 else i for i in indices]
            found += [(plain[0], one, other) for one, other in pairwise(plain[1:])]
    return corners[np.array(found, dtype=int).reshape(-1, 3)]


def hull(points: Array) -> Array:
    """Return the triangles (n, 3, 3) of the convex hull of points (n, 3), oriented outwards."""
    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):
        raise InputError("its points lie in a plane, and have no volume") from None
    corners = points[found.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = np.sum(normals * found.equations[:, :3], axis=1) < 0
    corners[inside] = corners[inside][:, ::-1]
    return corners


def solid(corners: Array, signed: bool, shell: bool = False) -> Inertial:
    """Return mass, centre and inertia of triangles (n, 3, 3) as a solid of unit density, or as a shell of unit density
    per area.

    The solid is the sum of pyramids between a point and each triangle, with the sign of the triangle's orientation if
    `signed`; both agree for convex meshes. The point is the centroid of the surface, then the centre of mass.
    """
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2

    def volumes(at: Array) -> Array:
        a, b, c = np.moveaxis(corners - at, 1, 0)
        found = np.sum(a * np.cross(b, c), axis=1) / 6
        return found if signed else np.abs(found)

    middles = corners.mean(axis=1)
    if not areas.sum() > 0:
        raise InputError("it has no surface")
    apex = areas @ middles / areas.sum()
    parts = areas if shell else volumes(apex)
    if not parts.sum() > 0:
        raise InputError("it has no volume, or is inside out")
    center = apex if shell else parts @ (3 / 4 * middles + apex / 4) / parts.sum()
    parts, x = areas if shell else volumes(center), corners - center
    whole = x.sum(axis=1)
    second = np.einsum("n,nki,nkj->ij", parts, x, x) + np.einsum("n,ni,nj->ij", parts, whole, whole)
    second /= 12 if shell else 20
    return Inertial(float(parts.sum()), center, np.trace(second) * np.eye(3) - second)
