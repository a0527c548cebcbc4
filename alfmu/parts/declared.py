"""What the parts have in common: their parameters, and units that follow from others."""

from __future__ import annotations

from typing import Any

import casadi as ca

from ..model.mechanism import Mechanism, Scalar
from ..model.units import UNITS, unit

__all__ = ["named", "quotient"]


def named(
    m: Mechanism,
    part: str,
    name: str,
    value: Scalar,
    unit_name: str,
    description: str,
    minimum: float | None = None,
    maximum: float | None = None,
) -> Any:
    """A number as the parameter `<part>.<name>` of the mechanism; an expression stays what it is."""
    if isinstance(value, ca.SX):
        return value
    return m.parameter(
        f"{part}.{name}", value, unit_name, minimum=minimum, maximum=maximum, description=f"{description} of {part}"
    )


def quotient(one: str, other: str) -> str:
    """Name of the unit of a quantity in the first unit over one in the second; 1 where alfmu has no name for it."""
    exponents = dict(unit(one).exponents)
    for base, power in unit(other).exponents.items():
        exponents[base] = exponents.get(base, 0) - power
    exponents = {base: power for base, power in exponents.items() if power}
    return next((name for name, known in UNITS.items() if known.exponents == exponents), "1")
