"""Checks of a declaration: numbers, lengths, angles, and the line of the user's file that contains a mistake."""

from __future__ import annotations

import linecache
import math
import os
import re
import sys
import warnings
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from .errors import AlfmuWarning, DeclarationError
from .words import shown

_LONG = 20.0
"""Length [m] above which the user may have meant millimetres."""

_GRID, _HALVINGS = 2000, 32
"""Number of intervals in which a law is sampled, and of halvings that locate a jump (to 1e-12 s)."""

JUMP = 1e-7
"""Smallest jump of a law relative to 1 + its largest value; round-off of a law integrated from its rate is below
1e-10."""

JUMPS = "%s: %s jumps by %.6g %s at t = %.6g s, which a rigid mechanism cannot follow; give a law without jumps"
"""Message for a law that jumps, at declaration and during a run: mechanism, quantity, size, unit, time."""

IMPACT = (
    "%s: %s changes its rate by %.6g %s at t = %.6g s: an impact, whose impulse no output contains; round the law "
    "off there, if no impact is meant"
)
"""Message for a law whose rate jumps."""

BROKEN = (
    "%s: at t = %.6g s %s, its rate or its acceleration is not finite; give a law with finite value, rate and "
    "acceleration, or other parameters"
)
"""Message for a law that ends or has a pole: mechanism, time, quantity."""

_BREAKS = {
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_NOT, ca.OP_SIGN, ca.OP_COPYSIGN),
    *(ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FABS),
    *(ca.OP_ATAN2, ca.OP_TAN, ca.OP_DIV, ca.OP_INV, ca.OP_SQRT, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_LOG, ca.OP_LOG1P),
    *(ca.OP_ASIN, ca.OP_ACOS, ca.OP_ACOSH, ca.OP_ATANH),
}
"""Operations at which a law or its rate may jump or become infinite: choices, whole numbers, kinks, angles within one
turn, poles, functions with a limited domain."""


@cache
def _ours() -> tuple[str, ...]:
    """Return the folders whose code is not the user's."""
    return tuple(f"{module.__path__[0]}{os.sep}" for module in (ca, sys.modules[__package__.partition(".")[0]]))


_OTHERWISE = {
    "absolute": "fabs",
    "abs": "fabs",
    "arccos": "acos",
    "arcsin": "asin",
    "arctan": "atan",
    "arctan2": "atan2",
    "clip": "fmin and ca.fmax",
    "max": "fmax",
    "maximum": "fmax",
    "min": "fmin",
    "minimum": "fmin",
    "norm": "norm_2",
    "select": "if_else",
    "where": "if_else",
}
"""CasADi's names for functions that Python and NumPy name differently."""


def number(what: str, value: Any) -> float | ca.SX:
    """Return a finite number, or an expression without NaN and infinity; raise DeclarationError for any other value."""
    if not isinstance(value, ca.SX):
        if isinstance(value, np.ndarray) and value.size == 1:
            return number(what, value.item())
        try:
            found = float("text" if isinstance(value, str | bytes | ca.MX) else value)
        except (TypeError, ValueError, RuntimeError):
            raise DeclarationError(f"{what} is {shown(value)}; give a number or an expression") from None
        if not math.isfinite(found):
            raise DeclarationError(f"{what} is {found}; {_finite(found)}")
        return value if isinstance(value, int) else found
    if not value.is_scalar():
        raise DeclarationError(f"{what} has {value.numel()} entries; give one number or expression")
    if not value.is_symbolic():
        steps = _steps(value)
        for i in range(steps.n_instructions()):
            if steps.instruction_id(i) == ca.OP_CALL:
                raise DeclarationError(
                    f"{what} calls a function of CasADi that has no formula, as those of ca.interpolant; for a table "
                    "use ca.pw_lin(x, places, values), and for a spline the polynomials of its parts in ca.pw_const"
                )
            if steps.instruction_id(i) == ca.OP_CONST and not math.isfinite(found := steps.instruction_constant(i)):
                raise DeclarationError(f"{what} contains {found}; {_finite(found)}")
    return value


def symbols_in(value: float | ca.SX) -> list[ca.SX]:
    """Return the symbols that an expression depends on."""
    if not isinstance(value, ca.SX):
        return []
    return [value] if value.is_symbolic() else _steps(value).free_sx()


def perhaps_degrees(what: str, value: float) -> None:
    """Warn of an angle [rad] that looks like degrees."""
    if abs(value) > 2 * math.pi:
        turns = f"{abs(value) / (2 * math.pi):.1f} turns"
        hint(f"{what} is {value:g} rad, {turns}; if degrees were meant, give {math.radians(value):.6g}")


def perhaps_millimetres(what: str, value: float) -> bool:
    """Warn of a length [m] that looks like millimetres, and return whether it does."""
    if long := abs(value) > _LONG:
        hint(f"{what} is {value:g} m; if millimetres were meant, give {value / 1000:g}")
    return long


def perhaps_an_impact(name: str, what: str, time: float, size: float, unit: str) -> None:
    """Warn of a law whose rate [unit] jumps at a time [s]."""
    hint(IMPACT % (name, what, size, unit, time))


def may_break(law: ca.SX, time: ca.SX) -> bool:
    """Return whether a law may jump in time or become infinite: whether such an operation acts on something
    time-dependent."""
    steps = ca.Function("law", [time], [law], {"allow_free": True})
    depends: dict[int, bool] = {}
    for i in range(steps.n_instructions()):
        code = steps.instruction_id(i)
        if code == ca.OP_OUTPUT:
            continue
        by = [] if code in (ca.OP_INPUT, ca.OP_PARAMETER) else [depends[x] for x in steps.instruction_input(i)]
        if code in _BREAKS and (by[-1] if code == ca.OP_DIV else any(by)):
            return True
        depends[steps.instruction_output(i)[0]] = code == ca.OP_INPUT or any(by)
    return False


def jump_in(law: ca.SX, time: ca.SX, stop: float) -> tuple[float, float] | None:
    """Return the time [s] and size of the first jump of a law from 0 to `stop` [s]; None if it has none.

    Between the points of a grid, the law is compared with the integral of its rate; bisection locates the place where
    they differ. A smooth law agrees with its rate everywhere, however steep it is.
    """
    evaluate = ca.Function("law", [time], [law, ca.jacobian(law, time)])

    def off(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the difference between the law and the integral of its rate in each interval of times, and its
        values."""
        value, slope = (np.array(each).reshape(t.shape) for each in evaluate(t.reshape(1, -1)))
        with np.errstate(invalid="ignore", over="ignore"):
            found = np.abs(np.diff(value) - np.diff(t) * (slope[:, 1:] + slope[:, :-1]) / 2)
        return np.where(np.isfinite(found), found, 0.0), value

    grid = np.linspace(0.0, stop, _GRID + 1)
    grid[1:-1] += 0.381966 * grid[1]  # Shift the grid off round times, at which a kink would be split into two halves.
    found, value = off(grid[None])
    limit = JUMP * (1.0 + np.abs(value, where=np.isfinite(value), out=np.zeros_like(value)).max())
    (places,) = np.nonzero(found[0] > limit)
    begin, end = grid[places], grid[places + 1]
    for _ in range(_HALVINGS):
        if not begin.size:
            return None
        middle = (begin + end) / 2
        halves, _ = off(np.stack([begin, middle, end], axis=1))
        first, still = halves[:, 0] > halves[:, 1], halves.max(axis=1) > limit
        begin, end = np.where(first, begin, middle)[still], np.where(first, middle, end)[still]
    return (float(end[0]), float(off(np.array([[begin[0], end[0]]]))[0][0, 0])) if begin.size else None


def hint(message: str, place: tuple[str, int] | None = None) -> None:
    """Warn of an allowed declaration that looks like a mistake, with the file and line of the user's code."""
    file, line = place or users_line()
    warnings.warn_explicit(message, AlfmuWarning, file, line)


def casadi_function(file: str, line: int) -> str:
    """Return CasADi's name of the function of `math` or NumPy that a line of code calls; empty if it calls none."""
    linecache.checkcache(file)
    called = re.search(r"\b(math|np|numpy)\.(?:linalg\.)?(\w+)\(", linecache.getline(file, line))
    if called is None:
        return ""
    name = _OTHERWISE.get(called[2], called[2])
    return f"ca.{name} instead of {called.group()[:-1]}" if hasattr(ca, name.split()[0]) else ""


def _finite(value: float) -> str:
    """Return the advice for a number that is not finite."""
    if not math.isnan(value):
        return "give a finite number"
    of_symbols = casadi_function(*users_line()) or "those of CasADi, such as ca.sin"
    return f"give a finite number; functions of Python's math make nan of symbols, so use {of_symbols}"


def users_line() -> tuple[str, int]:
    """Return the file and line of the user's code that is running."""
    frame = sys._getframe(1)
    while frame.f_back and frame.f_code.co_filename.startswith(_ours()):
        frame = frame.f_back
    return frame.f_code.co_filename, frame.f_lineno


def _steps(value: ca.SX) -> ca.Function:
    """Return the operations of an expression; walking its nodes instead is slow, and recursion is deep for long
    ones."""
    return ca.Function("steps", [], [value], {"allow_free": True})
