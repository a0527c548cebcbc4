"""Shapes as plain data, as they stand beside a result, so that a film needs neither the mechanism nor its code."""

from __future__ import annotations

import math
from dataclasses import asdict, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from .picture import GROUND, Shapes

__all__ = ["as_data", "from_data"]

LARGEST = 1e9
"""Numbers in a drawing [m, rad], at most: what is further away cannot be seen."""


def as_data(shapes: Shapes) -> dict[str, Any]:
    """Shapes as dictionaries, lists, texts and numbers, for JSON."""
    return asdict(shapes)


def from_data(data: object) -> Shapes:
    """The shapes that `as_data` gave; ValueError, with the place, where data from anywhere is something else."""
    shapes = _read(Shapes, data, "drawing")
    frames = {GROUND, *(link.name for link in shapes.links), *shapes.dots}
    if len(frames) != 1 + len(shapes.links) + len(shapes.dots):
        raise ValueError("drawing has two bodies or points of one name")
    if not all(link.points for link in shapes.links):
        raise ValueError("drawing has a body without points")
    pairs = [(x.first, x.second) for x in (*shapes.joints, *shapes.ties)] + [(g.base, g.rider) for g in shapes.guides]
    for at in (each for pair in pairs for each in pair):
        if at.body not in frames:
            raise ValueError(f"drawing has no body {at.body!r}")
    return shapes


def _read(form: Any, value: object, place: str) -> Any:
    """A value of a type: a dataclass, a tuple, a literal, an optional value, a text, a finite number."""
    kind, inner = get_origin(form) or form, get_args(form)
    if kind is UnionType:
        return None if value is None else _read(inner[0], value, place)
    if is_dataclass(form) and isinstance(value, dict):
        hints = _fields(form)
        if value.keys() == hints.keys():
            return form(**{name: _read(hint, value[name], f"{place}.{name}") for name, hint in hints.items()})
    elif kind is tuple and isinstance(value, (list, tuple)):
        forms = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        if len(forms) == len(value):
            return tuple(_read(each, x, f"{place}[{i}]") for i, (each, x) in enumerate(zip(forms, value, strict=True)))
    elif (kind is Literal and isinstance(value, str) and value in inner) or (form is str and isinstance(value, str)):
        return value
    elif form is float and type(value) in (int, float) and math.isfinite(value) and abs(value) <= LARGEST:
        return float(value)
    raise ValueError(f"{place} is {str(value)[:40]!r}")


_fields = cache(get_type_hints)
"""Types of the fields of a dataclass."""
