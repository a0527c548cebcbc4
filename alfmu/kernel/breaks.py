"""When forces, laws of motion and rates of states may jump or bend by themselves, whatever the motion is.

What depends on time and inputs alone is known before a step is made. Where it has a comparison, a maximum, a whole
number and the like, something smooth changes its sign there, which the runtime looks for over each communication step
(`step/breaks.c`). Steps end at these times, so that no pulse is stepped over, and no step tries to cross a jump.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca
import numpy as np
from casadi import SX

from ..equations import Equations
from ..equations.evaluation import ARGUMENTS, shared, symbols
from .stream import BINARY, Instructions

__all__ = ["breaks"]

_COMPARED = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX)
_SIGNED = {ca.OP_FABS: 0, ca.OP_SIGN: 0, ca.OP_COPYSIGN: 1, ca.OP_ATAN2: 0}
_WHOLE = (ca.OP_FLOOR, ca.OP_CEIL)
_DIVIDED = (ca.OP_FMOD, ca.OP_REMAINDER)
_BELLS = (ca.OP_TANH, ca.OP_ERF, ca.OP_ATAN, ca.OP_COSH)
"""Operations that make a smooth step or pulse where their operand is zero."""
_FALLING = {ca.OP_EXP: 0, ca.OP_INV: 0, ca.OP_DIV: 1, ca.OP_SQRT: 0, ca.OP_POW: 0, ca.OP_CONSTPOW: 0}
"""Operations that make a smooth pulse of a square, and which operand that is in."""
_ALL = (*_COMPARED, *_SIGNED, *_WHOLE, *_DIVIDED, *_BELLS, ca.OP_SQ)

_LETTERS = {"dynamics": "qvupt", "constraints": "qvp"}
"""Arguments of functions that the equations are combined in; those of others are in `ARGUMENTS`."""


def breaks(e: Equations) -> tuple[ca.Function, list[int]] | None:
    """breaks(t, u, du, p): what changes its sign where something jumps or bends by itself, and its rates, for rates du
    of the inputs; and the level of each, which is free of jumps between those of lower ones. None where there is
    nothing."""
    x, inputs = symbols(e), len(e.inputs)
    t, u, du, p = x["t"], SX.sym("u", inputs), SX.sym("du", inputs), x["p"]
    known = {letter: [None] * x[letter].numel() for letter in ("q", "v", "a", "lam", "u")}
    known["u"][:inputs], known["p"], known["t"] = u.nz[:].elements(), p.nz[:].elements(), [t]
    if e.timed:
        known["q"][-1], known["v"][-1] = t, SX(1)
    asked = {"constraints": e.timed, "state_rates": e.states, "rubbing": e.frictions, "readings": e.peaks}
    names = ["dynamics", *(name for name, there in asked.items() if there)]
    found: dict[str, tuple[SX, int]] = {}
    for name in names:
        letters = _LETTERS.get(name) or ARGUMENTS[name]
        for g, level in _found(e.functions[name], [known[letter] for letter in letters]):
            found.setdefault(str(g), (g, level))
    if "instants" in e.functions:
        found |= {f"instant {i}": (t - each, 0) for i, each in enumerate(ca.vertsplit(e.functions["instants"](p)))}
    moving = {key: each for key, each in found.items() if ca.depends_on(each[0], ca.vertcat(t, u))}
    if not moving:
        return None
    g = ca.vertcat(*(each for each, _ in moving.values()))
    rates = ca.jtimes(g, ca.vertcat(t, u), ca.vertcat(1, du))
    return shared("breaks", [t, u, du, p], [ca.densify(ca.vertcat(g, rates))]), [level for _, level in moving.values()]


def _found(f: ca.Function, known: Sequence[Sequence[SX | None]]) -> Iterator[tuple[SX, int]]:
    """Of a function that calls no other at arguments, None where they move: what changes its sign, and its level."""
    instructions = Instructions.of(f)
    if not np.isin(instructions.code, _ALL).any():
        return
    values: list[SX | None] = []
    levels: list[int] = []
    squares: list[dict[int, tuple[SX, int]]] = []
    """What is squared in each, by the number of its operand."""
    for k, code in enumerate(instructions.code.tolist()):
        operands = [i for i in instructions.operands[:, k].tolist() if i >= 0]
        mine = [values[i] for i in operands]
        level = max((levels[i] for i in operands), default=0)
        square = {i: each for j in operands for i, each in squares[j].items()}
        value: SX | None
        if code == ca.OP_INPUT:
            which, entry = instructions.place[:, k].tolist()
            value = known[which][entry]
        elif code == ca.OP_CONST:
            value = SX(instructions.constant[k])
        elif any(x is None for x in mine):
            value = None
        elif code == ca.OP_OUTPUT:
            value = mine[0]
        elif code in BINARY:
            value = SX.binary(code, *mine)
        else:
            value = SX.unary(code, mine[0])
        if value is not None and operands and not value.is_constant():
            yield from square.values() if code in _FALLING and squares[operands[_FALLING[code]]] else ()
            if (g := _changing(code, mine)) is not None:
                yield g, level
                level += 1
            elif code in _BELLS:
                yield mine[0], level
            elif code == ca.OP_SQ:
                square[operands[0]] = mine[0], level
        values.append(value)
        levels.append(level)
        squares.append(square if value is not None else {})


def _changing(code: int, operands: Sequence[SX]) -> SX | None:
    """What changes its sign where an operation jumps or bends; None for those that do neither."""
    if code in _COMPARED:
        return operands[0] - operands[1]
    if code in _SIGNED:
        return operands[_SIGNED[code]]
    if code in _WHOLE:
        return ca.sin(ca.pi * operands[0])
    if code in _DIVIDED:
        return (ca.sin if code == ca.OP_FMOD else ca.cos)(ca.pi * operands[0] / operands[1])
    return None
