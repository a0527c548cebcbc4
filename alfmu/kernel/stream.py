"""The instructions of a CasADi function as arrays, and their meaning in C."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..model.errors import ExportError

__all__ = ["BINARY", "CONSTANT", "INPUT", "NOTHING", "UNARY", "VALUE", "Instructions", "Operations", "number"]

NOTHING, VALUE, INPUT, CONSTANT = range(4)
"""What an operand is."""

_FUNCTIONS = (
    *("fabs", "floor", "ceil", "sqrt", "exp", "log", "expm1", "log1p", "erf", "sin", "cos", "tan", "asin", "acos"),
    *("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
"""Operations that have the name of a C function."""

BINARY = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_LT: "{} < {}",
    ca.OP_LE: "{} <= {}",
    ca.OP_EQ: "{} == {}",
    ca.OP_NE: "{} != {}",
    ca.OP_AND: "{} && {}",
    ca.OP_OR: "{} || {}",
    ca.OP_IF_ELSE_ZERO: "{} ? {} : 0.0",
    ca.OP_POW: "pow({}, {})",
    ca.OP_CONSTPOW: "pow({}, {})",
    ca.OP_ATAN2: "atan2({}, {})",
    ca.OP_FMIN: "fmin({}, {})",
    ca.OP_FMAX: "fmax({}, {})",
    ca.OP_FMOD: "fmod({}, {})",
    ca.OP_REMAINDER: "remainder({}, {})",
    ca.OP_HYPOT: "hypot({}, {})",
    ca.OP_COPYSIGN: "copysign({}, {})",
}
UNARY = {
    ca.OP_ASSIGN: "{}",
    ca.OP_NEG: "-{}",
    ca.OP_NOT: "!{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_SIGN: "({0} > 0.0) - ({0} < 0.0)",
    **{getattr(ca, f"OP_{name.upper()}"): f"{name}({{}})" for name in _FUNCTIONS},
}


def number(value: float) -> str:
    """A double in C."""
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return f"({value!r})" if value < 0 else repr(value)


@dataclass(frozen=True)
class Instructions:
    """The instructions of a function, each with the instructions that made its operands (-1 for none)."""

    code: NDArray
    """Operations as CasADi numbers them."""
    operands: NDArray
    """Two rows."""
    place: NDArray
    """Two rows: which argument or result, and which entry of it."""
    constant: NDArray

    @classmethod
    def of(cls, f: ca.Function) -> Instructions:
        """Those of a function of symbols that calls no other."""
        count = f.n_instructions()
        code = list(map(f.instruction_id, range(count)))
        first, second, place = [-1] * count, [-1] * count, {}
        constant = np.zeros(count)
        current: dict[int, int] = {}  # place in CasADi's workspace -> instruction that wrote it last
        for k, operation in enumerate(code):
            if operation == ca.OP_CONST:
                constant[k] = f.instruction_constant(k)
            elif operation == ca.OP_INPUT:
                place[k] = f.instruction_input(k)
            else:
                inputs = f.instruction_input(k)
                first[k] = current[inputs[0]]
                if len(inputs) > 1:
                    second[k] = current[inputs[1]]
                elif operation == ca.OP_OUTPUT:
                    place[k] = f.instruction_output(k)
                    continue
            current[f.instruction_output(k)[0]] = k
        places = np.full((2, count), -1)
        if place:
            places[:, list(place)] = np.array(list(place.values())).T
        return cls(np.array(code), np.array([first, second]), places, constant)

    def check(self, scene: str, function: str) -> None:
        """ExportError where an operation has no C here."""
        if missing := set(self.code.tolist()) - {*BINARY, *UNARY, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}:
            raise ExportError(f"{scene}: operation {min(missing)} of {function} has no C here; use --kernel vm")

    def __len__(self) -> int:
        return len(self.code)


@dataclass(frozen=True)
class Operations:
    """What a function computes, in order.

    Inputs and constants are operands, not operations of their own, and each result is written right after its value
    was computed. A value has the number of the operation that computes it.
    """

    code: NDArray
    kind: NDArray
    """Of each operand, two rows: NOTHING, VALUE, INPUT or CONSTANT."""
    operand: NDArray
    """Two rows: number of a value, entry of an argument, instruction with a constant."""
    argument: NDArray
    """Two rows: which argument it is an entry of, or -1."""
    result: NDArray
    """Two rows: which result is written, and which entry of it, or -1."""
    constant: NDArray
    """By number of the instruction."""

    @classmethod
    def of(cls, instructions: Instructions) -> Operations:
        code, made = instructions.code, instructions.operands
        numbers = np.arange(len(code))
        leaf = (code == ca.OP_INPUT) | (code == ca.OP_CONST)
        writes = code == ca.OP_OUTPUT
        early = writes & ~leaf[made[0]]
        kept = np.lexsort((numbers, np.where(early, made[0], numbers)))
        kept = kept[~leaf[kept]]
        own = np.full(len(code), -1)
        own[kept] = np.arange(len(kept))

        made = made[:, kept]
        kinds = np.full(len(code) + 1, VALUE)  # the last is that of -1
        kinds[:-1][code == ca.OP_INPUT], kinds[:-1][code == ca.OP_CONST], kinds[-1] = INPUT, CONSTANT, NOTHING
        kind = kinds[made]
        operand = np.select([kind == VALUE, kind == INPUT], [own[made], instructions.place[1, made]], made)
        argument = np.where(kind == INPUT, instructions.place[0, made], -1)
        result = np.where(writes[kept], instructions.place[:, kept], -1)
        return cls(code[kept], kind, operand, argument, result, instructions.constant)

    def __len__(self) -> int:
        return len(self.code)

    @cached_property
    def made(self) -> NDArray:
        """Two rows: the operation that makes each operand; 0 where none does."""
        return np.where(self.kind == VALUE, self.operand, 0)

    @cached_property
    def written(self) -> NDArray:
        """Two rows: which result each value becomes, and which entry of it; the first of several, or -1."""
        written = np.full((2, len(self)), -1)
        writes = np.flatnonzero((self.result[0] >= 0) & (self.kind[0] == VALUE))[::-1]
        written[:, self.operand[0, writes]] = self.result[:, writes]
        return written
