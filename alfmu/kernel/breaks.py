"""Times at which forces, laws of motion and rates of states may jump or bend, independent of the motion.

Terms in time and inputs alone are known before a step. Wherever such a term has a comparison, a maximum, a rounding and
the like, a smooth function changes its sign, which the runtime searches over each communication step (`step/breaks.c`).
Steps end at these times, so that no pulse is skipped, and no step crosses a jump.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca
import numpy as np
from casadi import SX

from ..equations import Configuration
from ..equations.evaluation import ARGUMENTS, shared, symbols
from .stream import BINARY, Instructions

_COMPARED = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_FMIN, ca.OP_FMAX)
_SIGNED = {ca.OP_FABS: 0, ca.OP_SIGN: 0, ca.OP_COPYSIGN: 1, ca.OP_ATAN2: 0}
_WHOLE = (ca.OP_FLOOR, ca.OP_CEIL)
_DIVIDED = (ca.OP_FMOD, ca.OP_REMAINDER)
_BELLS = (ca.OP_TANH, ca.OP_ERF, ca.OP_ATAN, ca.OP_COSH)
"""Operations that form a smooth step or pulse at a zero of their operand."""
_FALLING = {ca.OP_EXP: 0, ca.OP_INV: 0, ca.OP_DIV: 1, ca.OP_SQRT: 0, ca.OP_POW: 0, ca.OP_CONSTPOW: 0}
"""Operations that form a smooth pulse from a square, and the operand that contains it."""
_ALL = (*_COMPARED, *_SIGNED, *_WHOLE, *_DIVIDED, *_BELLS, ca.OP_SQ)

_LETTERS = {"dynamics": "qvupt", "constraints": "qvp"}
"""Arguments of functions that combine equations; `ARGUMENTS` has those of the others."""


def breaks(e: Configuration) -> tuple[ca.Function, list[int]] | None:
    """Return breaks(t, u, du, p), and the level of each of its results; None if there are none.

    The results change their sign at jumps and kinks; they come with their rates for rates du of the inputs. A result of
    a level has no jumps between sign changes of lower levels.
    """
    x, inputs = symbols(e), len(e.inputs)
    t, u, du, p = x["t"], SX.sym("u", inputs), SX.sym("du", inputs), x["p"]
    known: dict[str, list[SX | None]] = {name: [None] * x[name].numel() for name in ("q", "v", "a", "lam", "u")}
    known["u"][:inputs], known["p"], known["t"] = ca.vertsplit(u), [*ca.vertsplit(p)], [t]
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
    """Yield functions that change their sign, with their levels, of a function that calls no other; None marks moving
    arguments."""
    instructions = Instructions.of(f)
    if not np.isin(instructions.code, _ALL).any():
        return
    values: list[SX | None] = []
    levels: list[int] = []
    squares: list[dict[int, tuple[SX, int]]] = []
    """Squared values in each argument, by the number of the operand."""
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
    """Return the function that changes its sign where an operation jumps or bends; None for smooth operations."""
    if code in _COMPARED:
        return operands[0] - operands[1]
    if code in _SIGNED:
        return operands[_SIGNED[code]]
    if code in _WHOLE:
        return ca.sin(ca.pi * operands[0])
    if code in _DIVIDED:
        return (ca.sin if code == ca.OP_FMOD else ca.cos)(ca.pi * operands[0] / operands[1])
    return None
