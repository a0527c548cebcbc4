"""Inputs, signals (inputs that move something), and laws of time.

Inside a communication step a signal is a polynomial of time from where the motion is, so that its rate and its
acceleration are known and its position never jumps (`core/driving_inputs.c` of the runtime has the rule).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from .words import Brief

__all__ = ["COEFFICIENTS", "DERIVATIVES", "JUMPS", "ORDERS", "Input", "Law", "Signal"]

DERIVATIVES = ("rate", "acceleration")
"""What companions of an input are called, behind its name: `A.angle_rate`, `A.angle_acceleration`."""

ORDERS = (0, 1, 2)
"""Orders by which the highest given derivative of an input can be extrapolated."""

JUMPS = {"rad": 0.1, "m": 0.01}
"""Largest jump [rad, m] of an input that moves something, where the declaration says no other; 0.01 for other units."""

COEFFICIENTS = 6
"""Of the polynomial of a signal: a quintic."""


@dataclass(frozen=True, repr=False)
class Input(Brief):
    """A quantity that the environment sets at any time.

    Where it moves something, `derivatives` of it are inputs too, the highest one that is given is extrapolated inside
    a communication step by a polynomial of `order`, and a `jump` [in its unit] above that limit is refused.
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
    """An input that moves something, as a polynomial of time from `since` [s] on."""

    input: Input
    since: ca.SX
    coefficients: tuple[ca.SX, ...]
    """In the unit of the input over powers of a second, the constant one first."""

    @classmethod
    def of(cls, given: Input) -> Signal:
        """Fresh symbols for the polynomial of an input."""
        name = given.name
        coefficients = tuple(ca.SX.sym(f"{name}.c{k}") for k in range(COEFFICIENTS))
        return cls(given, ca.SX.sym(f"{name}.since"), coefficients)

    def at(self, time: ca.SX) -> ca.SX:
        """The signal at a time [s]."""
        x, value = time - self.since, ca.SX(0)
        for coefficient in reversed(self.coefficients):
            value = coefficient + x * value
        return value

    @property
    def numbers(self) -> tuple[ca.SX, ...]:
        """Everything that says what it is, in the order in which the runtime keeps it."""
        return (self.since, *self.coefficients)


@dataclass(frozen=True, repr=False)
class Law(Brief):
    """What moves something in time, and may jump or not be finite: a run looks at it over each communication step."""

    what: str
    """What it is, in words."""
    value: ca.SX
    """In coordinates, parameters, signals and time."""
    unit: str
    motion: str = ""
    """Name of the motion in force with which alone it counts; empty where it always does."""
