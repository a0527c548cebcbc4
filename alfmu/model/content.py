"""The content of a declaration as a short text that depends on the declaration alone, not on its Python objects.

Caches of results that follow from a mechanism use this text as their key, so that every change is noticed: of a list,
of a body's mass, of an expression.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import casadi as ca
import numpy as np

from .mechanism import Mechanism

_PLAIN = (bool, int, float, str, bytes, type(None))


def content(mechanism: Mechanism) -> str | None:
    """Return a digest of everything that a mechanism declares; None if it holds an object that has no text."""
    m, said = mechanism, _Said()
    parts = {name: each for name, each in sorted(m._parts.items()) if each}
    # Bodies and joints refer to each other: write each once and refer to it by its index.
    named = [m.ground, m.spatial_ground, *m.bodies, *m.joints, *m.spatial_bodies, *m.spatial_joints]
    said.places = {id(part): i for i, part in enumerate(named)}
    own = [getattr(m, field.name) for field in fields(m)]
    try:
        text = [said.of(own), [said.parts(part) for part in named], said.of(parts), said.of(m.time)]
    except TypeError:
        return None
    expressions = ca.vertcat(*said.expressions) if said.expressions else ca.SX(0, 1)
    program = ca.Function("content", [ca.vertcat(*ca.symvar(expressions))], [expressions])
    return hashlib.sha256(f"{text!r}{program.serialize()}".encode("utf-8", "surrogatepass")).hexdigest()


def value_text(value: Any) -> str:
    """Return a value without expressions as text; raise TypeError if its type has no text."""
    said = _Said()
    text = repr(said.of(value))
    if said.expressions:
        raise TypeError("SX")
    return text


class _Said:
    """Values as nested lists of texts and numbers, with the list of their expressions."""

    def __init__(self) -> None:
        self.expressions: list[ca.SX] = []
        self.places: dict[int, int] = {}

    def of(self, value: Any) -> Any:
        """Return a value as text; raise TypeError if its type has no text."""
        if isinstance(value, _PLAIN):
            return type(value).__name__, repr(value)
        if isinstance(value, ca.SX):
            self.expressions += [value] if value.is_scalar(True) else [ca.vec(ca.densify(value))]
            return "SX", value.shape, value.is_dense() or (value.row(), value.colind())
        if id(value) in self.places:
            return "part", self.places[id(value)]
        if isinstance(value, np.generic | np.ndarray):
            return type(value).__name__, str(value.dtype), value.shape, value.tobytes()
        if isinstance(value, Mapping):
            return "mapping", [(self.of(key), self.of(each)) for key, each in value.items()]
        if isinstance(value, tuple | list):
            return type(value).__name__, [self.of(each) for each in value]
        if is_dataclass(value) and not isinstance(value, type):
            return self.parts(value)
        raise TypeError(type(value).__name__)

    def parts(self, value: Any) -> Any:
        """Return the fields of a dataclass."""
        return type(value).__name__, [self.of(getattr(value, field.name)) for field in fields(value)]
