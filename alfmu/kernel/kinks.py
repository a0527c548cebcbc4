"""Kinks of a function: functions that change their sign there.

A comparison, a maximum, a minimum, an absolute value or a sign is smooth on either side of equal operands. Error
estimates of high order detect little of a kink inside a step.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from casadi import SX

from ..equations import Equations
from .stream import BINARY, Instructions

_COMPARED = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX)
"""Operations with a kink or a jump at equal operands."""

_SIGNED = {ca.OP_FABS: 0, ca.OP_SIGN: 0, ca.OP_COPYSIGN: 1}
"""Operations with a kink or jump at a zero of an operand, and the number of that operand."""


def kinks(f: ca.Function, arguments: list[SX], along: SX) -> SX:
    """Return functions that change their sign at kinks of a function that calls no other, evaluated at symbols; those
    independent of `along` are left out."""
    instructions = Instructions.of(f)
    if not np.isin(instructions.code, (*_COMPARED, *_SIGNED)).any():
        return SX(0, 1)
    values: list[SX] = []
    found: dict[tuple[int, int], SX] = {}
    for k, code in enumerate(instructions.code.tolist()):
        first, second = instructions.operands[:, k].tolist()
        if code == ca.OP_INPUT:
            which, entry = instructions.place[:, k].tolist()
            values.append(arguments[which].nz[entry])
        elif code == ca.OP_CONST:
            values.append(SX(instructions.constant[k]))
        elif code == ca.OP_OUTPUT:
            values.append(values[first])
        elif code in BINARY:
            values.append(SX.binary(code, values[first], values[second]))
        else:
            values.append(SX.unary(code, values[first]))
        if code in _COMPARED:
            pair = min(first, second), max(first, second)
            found.setdefault(pair, values[pair[0]] - values[pair[1]])
        elif code in _SIGNED:
            k = (first, second)[_SIGNED[code]]
            found.setdefault((k, k), values[k])
    return ca.vertcat(*(x for x in found.values() if ca.depends_on(x, along)))


def kinks_of_rates(equations: Equations, x: Mapping[str, SX]) -> SX:
    """Return functions of symbols x that change their sign at kinks of accelerations or rates of states; those in time
    alone are left out, as steps end there (`kernel.breaks`)."""
    known = [x[name] for name in "qvupt"]
    along = ca.vertcat(*(x[name][: equations.dependent] for name in "qv"), x["u"])
    names = ["dynamics", *["state_rates"] * bool(equations.states)]
    return ca.vertcat(*(kinks(equations.functions[name], known, along) for name in names))


JUMPS = {
    ca.OP_LT: "comparisons",
    ca.OP_LE: "comparisons",
    ca.OP_EQ: "comparisons",
    ca.OP_NE: "comparisons",
    ca.OP_SIGN: "signs",
    ca.OP_COPYSIGN: "signs",
    ca.OP_FLOOR: "whole numbers",
    ca.OP_CEIL: "whole numbers",
    ca.OP_FMOD: "remainders",
    ca.OP_REMAINDER: "remainders",
}
"""Descriptions of operations that may jump; maxima, minima and absolute values only have kinks."""


def jumps(f: ca.Function) -> list[str]:
    """Return descriptions of the operations that may jump in a function without calls."""
    return sorted({JUMPS[code] for code in Instructions.of(f).code.tolist() if code in JUMPS})
