"""Shapes as plain data beside a result, so that a film needs neither the mechanism nor its code."""

import math
from dataclasses import asdict, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from .shapes import GROUND, Shapes, Space

_LATER = ("rims",)
"""Fields that drawings may omit if they are empty."""

LARGEST = 1e9
"""Largest coordinate in a drawing [m, rad]."""


def as_data(shapes: Shapes) -> dict[str, Any]:
    """Return shapes as dictionaries, lists, texts and numbers, for JSON."""
    return {name: value for name, value in asdict(shapes).items() if name not in _LATER or value}


def from_data(data: object) -> Shapes:
    """Return the shapes from the result of `as_data`; raise ValueError with the path of any invalid data."""
    shapes = _read(Shapes, {**dict.fromkeys(_LATER, ()), **data} if isinstance(data, dict) else data, "drawing")
    frames = {GROUND, *(link.name for link in shapes.links), *shapes.dots}
    if len(frames) != 1 + len(shapes.links) + len(shapes.dots):
        raise ValueError("drawing has two bodies or points of one name")
    if not all(link.points for link in shapes.links):
        raise ValueError("drawing has a body without points")
    pairs = [(x.first, x.second) for x in (*shapes.joints, *shapes.ties)] + [(g.base, g.rider) for g in shapes.guides]
    for body in (*(each.body for pair in pairs for each in pair), *(rim.body for rim in shapes.rims)):
        if body not in frames:
            raise ValueError(f"drawing has no body {body!r}")
    if not all(rim.points for rim in shapes.rims):
        raise ValueError("drawing has a rim without points")
    if shapes.space:
        _check_space(shapes.space)
    return shapes


def _check_space(space: Space) -> None:
    """Raise ValueError if names or numbers of a drawing in space are inconsistent."""
    frames = {frame.name: frame for frame in space.frames}
    if len(frames) != len(space.frames) or GROUND in frames:
        raise ValueError("drawing has two bodies or points of one name")
    for frame in space.frames:
        if len(frame.columns) not in {"body": (7,), "plane": (3,), "axis": (6,), "point": (2, 3)}[frame.kind]:
            raise ValueError(f"drawing has {len(frame.columns)} columns for {frame.name!r}")
    named = [at.frame for at in (*space.spots, *(arrow.at for arrow in space.arrows))]
    for name in (*named, *(solid.name for solid in space.solids), *space.dots):
        if name not in frames and name != GROUND:
            raise ValueError(f"drawing has no body {name!r}")
    directions = [space.up, *(pivot.axis for pivot in space.pivots), *(arrow.along for arrow in space.arrows)]
    if any(x is not None and math.hypot(*x) < 1e-9 for x in directions):
        raise ValueError("drawing has a direction of no length")
    for arrow in space.arrows:
        if len(arrow.columns) != (3 if arrow.along is None else 1):
            raise ValueError(f"drawing has {len(arrow.columns)} columns for {arrow.name!r}")
    if any(solid.box and min(solid.box) < 0 for solid in space.solids):
        raise ValueError("drawing has a box of no size")


def _read(form: Any, value: object, place: str) -> Any:
    """Return a value of a type: a dataclass, a tuple, a literal, an optional value, a text, a finite number."""
    kind, inner = get_origin(form) or form, get_args(form)
    if kind is UnionType:
        return None if value is None else _read(inner[0], value, place)
    if isinstance(form, type) and is_dataclass(form) and isinstance(value, dict):
        hints = _fields(form)
        if value.keys() == hints.keys():
            return form(**{name: _read(hint, value[name], f"{place}.{name}") for name, hint in hints.items()})
    elif kind is tuple and isinstance(value, (list, tuple)):
        forms = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        if len(forms) == len(value):
            return tuple(_read(each, x, f"{place}[{i}]") for i, (each, x) in enumerate(zip(forms, value, strict=True)))
    elif value in inner if kind is Literal and isinstance(value, str) else form in (str, bool) and type(value) is form:
        return value
    elif form is float and (type(value) is int or type(value) is float) and abs(value) <= LARGEST:
        return float(value)
    raise ValueError(f"{place} is {str(value)[:40]!r}")


_fields = cache(get_type_hints)
"""Types of the fields of a dataclass."""
