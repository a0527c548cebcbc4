"""Inputs, signals (inputs that move something), and laws of time.

Inside a communication step a signal is a polynomial of time that starts at the present motion, so that its rate and
acceleration are known and its position never jumps (`core/driving_inputs.c` of the runtime has the rule).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from .words import Brief

DERIVATIVES = ("rate", "acceleration")
"""Suffixes of the derivatives of an input: `A.angle_rate`, `A.angle_acceleration`."""

ORDERS = (0, 1, 2)
"""Orders by which the highest given derivative of an input can be extrapolated."""

JUMPS = {"rad": 0.1, "m": 0.01}
"""Largest jump [rad, m] of an input that moves something, by default; 0.01 for other units."""

COEFFICIENTS = 6
"""Number of coefficients of a signal's polynomial: a quintic."""


@dataclass(frozen=True, repr=False)
class Input(Brief):
    """A quantity that the environment sets at any time.

    If it moves something, its `derivatives` are inputs too, a polynomial of `order` extrapolates the highest given one
    inside a communication step, and a jump above `jump` [in its unit] is refused.
    """

    name: str
    symbol: ca.SX
    unit: str
    start: float
    description: str
    derivatives: int = 0
    order: int = 2
    jump: float = 0.0


@dataclass(frozen=True, repr=False)
class Signal(Brief):
    """An input that prescribes a motion, as a polynomial of time starting at `since` [s]."""

    input: Input
    since: ca.SX
    coefficients: tuple[ca.SX, ...]
    """Coefficients in the unit of the input over powers of a second, the constant one first."""

    @classmethod
    def of(cls, given: Input) -> Signal:
        """Return a signal with fresh symbols for the polynomial of an input."""
        name = given.name
        coefficients = tuple(ca.SX.sym(f"{name}.c{k}") for k in range(COEFFICIENTS))
        return cls(given, ca.SX.sym(f"{name}.since"), coefficients)

    def at(self, time: ca.SX) -> ca.SX:
        """Return the signal at a time [s]."""
        x, value = time - self.since, ca.SX(0)
        for coefficient in reversed(self.coefficients):
            value = coefficient + x * value
        return value

    @property
    def numbers(self) -> tuple[ca.SX, ...]:
        """Symbols of the signal, in the order in which the runtime stores them."""
        return (self.since, *self.coefficients)


@dataclass(frozen=True, repr=False)
class Law(Brief):
    """A law of time that prescribes motion and may jump or diverge: a run checks it over each communication step."""

    what: str
    """Description in words."""
    value: ca.SX
    """Expression in coordinates, parameters, signals and time."""
    unit: str
    motion: str = ""
    """Switchable motion this law belongs to; empty if always active."""
