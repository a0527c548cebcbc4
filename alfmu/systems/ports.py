"""Ports of components: variables with their units, and conversion of units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from ..model.errors import DeclarationError, InputError
from ..model.units import UNITS, composed

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units of FMI and SSP, in their order."""


@dataclass(frozen=True)
class Measure:
    """A unit: `factor` times a value in it, plus `offset`, is the value in base units with these exponents."""

    name: str = field(compare=False)
    exponents: tuple[tuple[str, int], ...]
    factor: float = 1.0
    offset: float = 0.0

    @classmethod
    def of(cls, name: str, exponents: Mapping[str, int], factor: float = 1.0, offset: float = 0.0) -> Measure:
        return cls(name, tuple((base, int(exponents[base])) for base in BASES if exponents.get(base)), factor, offset)


@dataclass(frozen=True)
class Port:
    """A variable of a component."""

    name: str
    kind: str
    """parameter, input or output."""
    type: str
    """Real, Integer, Boolean, Enumeration or String."""
    unit: str | None
    """None if unknown."""
    measure: Measure | None = None
    """None if the unit or its definition is unknown."""
    description: str = ""
    follows: frozenset[str] = frozenset()
    """Inputs on which an output depends directly."""


def measure(name: str | None) -> Measure | None:
    """Return a unit by a name known to alfmu, including display units."""
    for known in UNITS.values():
        if name in known.display:
            return Measure.of(name, known.exponents, 1 / known.display[name])
    with suppress(DeclarationError):
        return Measure.of(str(name), composed(str(name)).exponents)
    return None


def conversion(source: Measure, target: Measure) -> tuple[float, float]:
    """Return factor and offset from one unit to another; raise InputError if they measure different quantities."""
    if source.exponents != target.exponents:
        raise InputError(f"{source.name} and {target.name} do not measure the same")
    factor, offset = source.factor / target.factor, (source.offset - target.offset) / target.factor
    if not (math.isfinite(factor) and math.isfinite(offset) and factor):
        raise InputError(f"{source.name} cannot be converted to {target.name}")
    nearest = round(1 / factor) if abs(factor) < 1 and math.isfinite(1 / factor) else 0
    if nearest and math.isclose(factor, 1 / nearest, rel_tol=1e-15):
        factor = 1 / nearest
    return factor, offset
