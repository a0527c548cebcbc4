"""Numbers with their expressions in parameters, so that shapes can follow the parameters."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from ..model.errors import DeclarationError
from ..model.mechanism import Mechanism
from ..model.parts import Scalar


def _operator(f: Callable[[Any, Any], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return a binary operator for traced numbers, and its reflected form."""
    return lambda a, b: a._with(b, f), lambda a, b: a._with(b, lambda x, y: f(y, x))


class Traced(float):
    """A number with its expression.

    Two are equal if their expressions are equal at slightly perturbed parameters (`generic`), so that points are not
    merged because their lengths happen to be equal.
    """

    expression: ca.SX
    generic: float

    @classmethod
    def of(cls, value: float, expression: ca.SX, generic: float) -> Traced:
        made = cls(value)
        made.expression, made.generic = expression, generic
        return made

    def __eq__(self, other: object) -> bool:
        return self.generic == (other.generic if isinstance(other, Traced) else other)

    def __hash__(self) -> int:
        return hash(self.generic)

    def __deepcopy__(self, memo: Any) -> Traced:
        return self

    def __round__(self, digits: Any = None) -> Any:
        return Traced.of(round(float(self), digits), self.expression, round(self.generic, digits))

    def __neg__(self) -> Traced:
        return Traced.of(-float(self), -self.expression, -self.generic)

    def _with(self, other: float, f: Callable[[Any, Any], Any]) -> Traced:
        others = (float(other), other.expression, other.generic) if isinstance(other, Traced) else (float(other),) * 3
        own = float(self), self.expression, self.generic
        return Traced.of(*(f(x, y) for x, y in zip(own, others, strict=True)))

    __add__, __radd__ = _operator(operator.add)
    __sub__, __rsub__ = _operator(operator.sub)
    __mul__, __rmul__ = _operator(operator.mul)
    __truediv__, __rtruediv__ = _operator(operator.truediv)
    __pow__, __rpow__ = _operator(operator.pow)


def sin(x: float) -> float:
    """Return the sine of a number, traced or not."""
    return Traced.of(math.sin(x), ca.sin(x.expression), math.sin(x.generic)) if isinstance(x, Traced) else math.sin(x)


def cos(x: float) -> float:
    """Return the cosine of a number, traced or not."""
    return Traced.of(math.cos(x), ca.cos(x.expression), math.cos(x.generic)) if isinstance(x, Traced) else math.cos(x)


def tracer(m: Mechanism, values: Mapping[str, float]) -> Callable[[Scalar], float]:
    """Return a function that turns an expression in parameters into a traced number."""
    symbols = ca.vertcat(*(p.symbol for p in m.parameters))
    usual = [values[p.name] for p in m.parameters]
    points = ca.DM([usual, _generic(m, usual)]).T
    known: dict[str, float] = {}

    def number(expression: Scalar) -> float:
        if not isinstance(expression, ca.SX):
            return float(expression)
        key = str(expression)
        if key not in known:
            if expression.is_constant():
                known[key] = float(expression)
            else:
                if free := [x for x in ca.symvar(expression) if not ca.depends_on(symbols, x)]:
                    raise DeclarationError(f"{m.name}: a shape uses {free[0]}; it may use parameters only")
                both = ca.Function("f", [symbols], [expression])(points)
                known[key] = Traced.of(float(both[0]), expression, float(both[1]))
        return known[key]

    return number


def _generic(m: Mechanism, usual: list[float]) -> list[float]:
    """Return parameters that are slightly perturbed by different shares within their bounds."""
    found = []
    for i, (p, value) in enumerate(zip(m.parameters, usual, strict=True), 1):
        share = 1e-3 * (0.5 + (i * 0.6180339887498949) % 1.0)
        off = value + share * (abs(value) or 1.0)
        found.append(off if p.maximum is None or off <= p.maximum else value - share * (abs(value) or 1.0))
    return found
