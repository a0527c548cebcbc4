"""The instructions of a CasADi function as arrays, and their meaning in C."""

from __future__ import annotations

import struct
from collections import OrderedDict
from dataclasses import dataclass
from functools import cache, cached_property
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..model.errors import ExportError
from ..model.hooks import handed_in

NOTHING, VALUE, INPUT, CONSTANT = range(4)
"""Kinds of operands."""

_FUNCTIONS = (
    *("fabs", "floor", "ceil", "sqrt", "exp", "log", "expm1", "log1p", "erf", "sin", "cos", "tan", "asin", "acos"),
    *("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
"""Operations that are C functions of a given name."""

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
    ca.OP_FMIN: "{0} < {1} || {1} != {1} ? {0} : {1}",
    ca.OP_FMAX: "{0} > {1} || {1} != {1} ? {0} : {1}",
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
    ca.OP_SIGN: "{0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : {0}",
    **{getattr(ca, f"OP_{name.upper()}"): f"{name}({{}})" for name in _FUNCTIONS},
}

PLAIN = frozenset(
    (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_ASSIGN, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV)
)
"""Arithmetic, which C also does on vectors."""

ROLES = ("unary", "binary", "input", "output", "constant", "doubled", "inverse", "cosine", "copysign")
"""Roles of CasADi's operations, for the C library (`runtime/c/binding/straight.c`)."""

_OF_ROLES = {
    **dict.fromkeys(BINARY, "binary"),
    **{ca.OP_INPUT: "input", ca.OP_OUTPUT: "output", ca.OP_CONST: "constant", ca.OP_COPYSIGN: "copysign"},
    **{ca.OP_TWICE: "doubled", ca.OP_SQ: "doubled", ca.OP_INV: "inverse", ca.OP_COS: "cosine"},
}

OPERATIONS = 256
"""Limit of the numbers of CasADi's operations."""

ROLE = np.array([ROLES.index(_OF_ROLES.get(code, "unary")) for code in range(OPERATIONS)], np.int32)
"""The role of each operation of CasADi, as an index of ROLES."""

MOST = 1_000_000
"""Number of cached instructions of all functions, some 100 bytes each; mechanisms in space have as many."""

_KNOWN: OrderedDict[int, tuple[ca.Function, Instructions]] = OrderedDict()

_COUNT = [0]
"""Number of instructions in `_KNOWN`."""

_LOCK = Lock()


def library() -> Any:
    """Return the C library, which reads, arranges and encodes functions."""
    return handed_in("installed")()


def address(array: NDArray[Any]) -> int:
    return array.ctypes.data


def number(value: float) -> str:
    """Return a double in C."""
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return f"({value!r})" if value < 0 else repr(value)


@dataclass(frozen=True)
class Instructions:
    """The instructions of a function, each with the instructions of its operands (-1 for none), without operations that
    an earlier one already does on the same values."""

    code: NDArray
    """Operation codes of CasADi."""
    operands: NDArray
    """Instructions of the operands, in two rows."""
    place: NDArray
    """Argument or result, and entry of it, in two rows."""
    constant: NDArray

    @classmethod
    def of(cls, f: ca.Function) -> Instructions:
        """Return the instructions of a symbolic function that calls no other; cached for the latest functions."""
        if found := _KNOWN.get(id(f)):
            return found[1]
        made = cls._of(f)
        with _LOCK:
            if id(f) not in _KNOWN:
                _KNOWN[id(f)] = f, made  # caching the function keeps its id unique
                _COUNT[0] += len(made)
            while _COUNT[0] > MOST:
                _COUNT[0] -= len(_KNOWN.popitem(last=False)[1][1])
        return made

    @classmethod
    def _of(cls, f: ca.Function) -> Instructions:
        atoms = _listed(f)
        if atoms is None:
            atoms = _one_by_one(f)
        count = len(atoms)
        made = *(np.empty(shape, np.int64) for shape in (count, (2, count), (2, count))), np.empty(count)
        kept = library().alfmu_instructions(count, *map(address, (np.ascontiguousarray(atoms), ROLE, *made)))
        if kept < 0:
            raise MemoryError
        return cls(*(np.ascontiguousarray(each[..., :kept]) for each in made))

    @property
    def arrays(self) -> tuple[NDArray, ...]:
        return self.code, self.operands, self.place, self.constant

    def check(self, scene: str, function: str) -> None:
        """Raise ExportError if an operation has no C here."""
        if missing := set(self.code.tolist()) - {*BINARY, *UNARY, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}:
            raise ExportError(f"{scene}: operation {min(missing)} of {function} has no C here; use --kernel vm")

    def __len__(self) -> int:
        return len(self.code)


def _one_by_one(f: ca.Function) -> NDArray:
    """Return the instructions of a function by CasADi's calls: operation, output address, input addresses."""
    count = f.n_instructions()
    atoms = np.zeros((count, 4), "<i4")
    atoms[:, 0] = list(map(f.instruction_id, range(count)))
    for k, operation in enumerate(atoms[:, 0].tolist()):
        atoms[k, 1:] = _atom(f, k, operation)
    return atoms


def _atom(f: ca.Function, k: int, operation: int) -> list[int]:
    """Return an instruction's output address, and two numbers for its inputs or its constant."""
    if operation == ca.OP_CONST:
        return [f.instruction_output(k)[0], *struct.unpack("<ii", struct.pack("<d", f.instruction_constant(k)))]
    inputs = f.instruction_input(k)
    if operation == ca.OP_OUTPUT:
        which, entry = f.instruction_output(k)
        return [which, inputs[0], entry]
    return [f.instruction_output(k)[0], *inputs, *[0] * (2 - len(inputs))]


_SAMPLE = 3
"""Number of instructions compared with CasADi's calls, to detect a change of the listing."""

_FORMS = OrderedDict({0: ca.OP_CONST})
"""Operations by the form of their lines in CasADi's listing, for `alfmu_listing`; it grows (`stored._is_constant`)."""


def _listed(f: ca.Function) -> NDArray | None:
    """Return the instructions from CasADi's listing, in at most half the time of its serialised function; None if its
    form has changed."""
    count, atoms = f.n_instructions(), _read(f)
    if atoms is None:
        return None
    for k in np.flatnonzero(_alike()[atoms[:, 0]]).tolist():
        atoms[k, 0] = f.instruction_id(k)
    constants = np.flatnonzero(atoms[:, 0] == ca.OP_CONST)
    values = np.array([f.instruction_constant(k) for k in constants.tolist()], float)
    atoms[constants, 2:] = values.view(np.int32).reshape(-1, 2)
    sample = sorted({k * (count - 1) // (_SAMPLE - 1) for k in range(_SAMPLE)}) if count else []
    told = ([operation, *_atom(f, k, operation)] for k in sample for operation in [f.instruction_id(k)])
    return atoms if all(map(_agree, atoms[sample].tolist(), told)) else None


def _read(f: ca.Function) -> NDArray | None:
    """Return the instructions from CasADi's listing, without the values of constants; None if it is no such listing."""
    count = f.n_instructions()
    text = f.str(True).partition("\nAlgorithm:\n")[2].encode()
    atoms, done = np.zeros((count, 4), np.int32), 0
    while done < count:
        forms = np.array([*_FORMS.items(), (0, 0)], np.uint64)
        done = library().alfmu_listing(text, count, address(atoms), len(forms) - 1, address(forms))
        if done < 0 or len(forms) > OPERATIONS:
            return None
        if done < count:
            _FORMS[int(forms[-1, 0])] = f.instruction_id(done)
    return atoms


@cache
def _alike() -> NDArray[np.bool_]:
    """Return whether an operation may look like another in a listing, as both powers do, by its number."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    made = [*(ca.SX.binary(k, x, y) for k in BINARY), x**1.5, *(ca.SX.unary(k, x) for k in UNARY)]
    f = ca.Function("operations", [x, y], made)
    read, found = _read(f), np.zeros(OPERATIONS, bool)
    for k, operation in enumerate(read[:, 0].tolist() if read is not None else ()):
        if operation != (told := f.instruction_id(k)):
            found[[operation, told]] = True
    return found


def _agree(atom: list[int], expected: list[int]) -> bool:
    operands = 4 if expected[0] in BINARY or expected[0] in (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST) else 3
    return atom[:operands] == expected[:operands]


@dataclass(frozen=True)
class Operations:
    """The operations of a function, in order.

    Inputs and constants are operands, not operations, and each result is written right after its value is computed. A
    value has the number of the operation that computes it.
    """

    code: NDArray
    kind: NDArray
    """Kind of each operand, in two rows: NOTHING, VALUE, INPUT or CONSTANT."""
    operand: NDArray
    """Number of a value, entry of an argument, or instruction of a constant, in two rows."""
    argument: NDArray
    """Argument of an entry, or -1, in two rows."""
    result: NDArray
    """Result and entry that are written, or -1, in two rows."""
    constant: NDArray
    """Constants by number of the instruction."""

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
        kinds = np.full(len(code) + 1, VALUE)  # the last entry is for -1
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
        """Operation of each operand, in two rows; 0 if there is none."""
        return np.where(self.kind == VALUE, self.operand, 0)

    @cached_property
    def written(self) -> NDArray:
        """Result and entry of each value, the first of several, or -1, in two rows."""
        written = np.full((2, len(self)), -1)
        writes = np.flatnonzero((self.result[0] >= 0) & (self.kind[0] == VALUE))[::-1]
        written[:, self.operand[0, writes]] = self.result[:, writes]
        return written
