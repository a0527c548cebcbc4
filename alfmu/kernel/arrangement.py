"""Arrange the operations of a function in the form and order that the interpreter runs fastest.

Sums, differences and products become sums of products, c + a b + a' b' and the like, and the sine and the cosine of an
angle one operation, so that there are few kinds, and few numbers are stored and read again. Equal operations are
grouped in as few runs as possible. Results are the same to the last bit: only factors of one, pairs of negations,
summands of minus zero and the order of two summands change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .stream import BINARY, OPERATIONS, UNARY, Instructions, address, library

SUMS = {
    **{"sum1": 3, "sum2": 5, "sum4": 9},
    **{"product": 2, "products": 4, "plus": 2, "minus": 2, "negative": 1},
}
"""Kinds of sums of products, and their numbers of operands: c + a b with one or more products, added in order; a b, a b
+ c d, a + b, a - b, -a."""

SINE_COSINE = "sine_cosine"
"""The sine and the cosine of an angle."""

_KIND_OF = {
    **{ca.OP_ADD: "plus", ca.OP_TWICE: "plus", ca.OP_ASSIGN: "plus", ca.OP_SUB: "minus", ca.OP_NEG: "negative"},
    **{ca.OP_MUL: "product", ca.OP_SQ: "product", ca.OP_INV: ca.OP_DIV},
}
"""Operations of CasADi that are expressed by other kinds, mainly sums of products."""

KINDS = (*SUMS, ca.OP_DIV, SINE_COSINE, *(x for x in (*BINARY, *UNARY) if x not in (*_KIND_OF, ca.OP_DIV)))
"""Kinds of operations in a scene; their indices are their numbers in the file."""

OPERANDS = {kind: 2 if kind in BINARY else 1 for kind in KINDS} | SUMS
"""Number of operands by kind."""

NARROW_HEAD = 3
"""Number of words before the operands of a run in a loaded function with 16-bit places: the kind of its operations,
their number, and the place of the first result."""

_MOST = 15
"""Most operands of the operations that replace an instruction."""

_NEUTRAL = (1.0, -1.0, -0.0)
"""Constants by which an operation reduces to another kind."""


def _kinds() -> NDArray[np.int32]:
    """Return the kind of each operation of CasADi, by its number; -1 for those without results here."""
    own = {x: i for i, x in enumerate(KINDS) if not isinstance(x, str)}
    own |= {x: KINDS.index(kind) for x, kind in _KIND_OF.items()}
    own |= dict.fromkeys((ca.OP_SIN, ca.OP_COS), KINDS.index(SINE_COSINE))
    return np.array([own.get(x, -1) for x in range(OPERATIONS)], np.int32)


@dataclass(frozen=True)
class Operation:
    """An operation on numbered values: its operands and its results."""

    kind: int
    operands: tuple[int, ...]
    made: tuple[int, ...]


@dataclass(frozen=True)
class Runs:
    """Runs of equal operations, as arrays."""

    heads: NDArray[np.int32]
    """Rows: the kind of a run, and its number of operations."""
    operands: NDArray[np.int32]
    """Operands of all operations, in order."""
    made: NDArray[np.int32]
    """Rows of the two results of an operation, -1 for none."""

    @classmethod
    def of(cls, count: int, heads: NDArray, operands: NDArray, made: NDArray) -> Runs:
        """Return the first `count` runs of larger arrays."""
        heads = heads[:count].copy()
        return cls(heads, operands[: heads[:, 1] @ _COUNTS[heads[:, 0]]].copy(), made[: heads[:, 1].sum()].copy())

    @cached_property
    def each(self) -> list[NDArray[np.int32]]:
        """Return the operands of each run, a row for each operation."""
        ends = accumulate((int(count) * _COUNTS[kind] for kind, count in self.heads.tolist()), initial=0)
        return [
            self.operands[begin:end].reshape(-1, _COUNTS[kind])
            for kind, (begin, end) in zip(self.heads[:, 0], pairwise(ends), strict=True)
        ]

    def operations(self) -> list[list[Operation]]:
        """Return the operations of each run as objects."""
        made = iter(self.made.tolist())
        return [
            [Operation(kind, tuple(operands), tuple(x for x in next(made) if x >= 0)) for operands in run.tolist()]
            for kind, run in zip(self.heads[:, 0].tolist(), self.each, strict=True)
        ]


@dataclass(frozen=True)
class Arrangement:
    """A function as runs of equal operations."""

    arguments: dict[int, tuple[int, int]]
    """Argument and entry of each value that is an argument."""
    constants: dict[int, float]
    arrays: Runs
    results: list[tuple[int, int, int]]
    """Result, entry and value."""

    @cached_property
    def runs(self) -> list[list[Operation]]:
        return self.arrays.operations()


def arranged(instructions: Instructions) -> Arrangement:
    """Arrange the operations of a function that calls no other."""
    code, count = instructions.code, len(instructions)
    # Copying a number's own sign is no operation.
    same = (code == ca.OP_COPYSIGN) & (instructions.operands[0] == instructions.operands[1])
    origin = np.where(same, instructions.operands[0], np.arange(count))
    operands = np.where(instructions.operands < 0, -1, origin[instructions.operands]).astype(np.int32, "C")
    result = operands[0, code == ca.OP_OUTPUT]
    kinds = np.where(same, -1, KIND_OF[code]).astype(np.int32)
    twice, inverse, cosine = np.isin(code, (ca.OP_TWICE, ca.OP_SQ)), code == ca.OP_INV, code == ca.OP_COS
    operands[1, twice] = operands[0, twice]
    operands[1, inverse], operands[0, inverse] = operands[0, inverse], count
    operands[1, cosine], operands[0, cosine] = operands[0, cosine], -1
    constant = np.flatnonzero(code == ca.OP_CONST)
    numbers = np.concatenate([_NEUTRAL, -instructions.constant[constant]])
    _, first, number = np.unique(numbers.view(np.int64), return_index=True, return_inverse=True)
    opposite = np.full(count, -1, np.int32)
    opposite[constant] = first[number][len(_NEUTRAL) :]
    values, heads, made = (np.empty(size, np.int32) for size in (len(numbers), (3 * count, 2), (3 * count, 2)))
    room = np.empty(_MOST * count + 2, np.int32)
    inputs = kinds, operands, opposite
    found = library().alfmu_arrange(
        count, *map(address, inputs), len(numbers), *map(address, (values, heads, room, made))
    )
    own = sorted((value, x) for value, x in zip(values.tolist(), numbers.tolist(), strict=True) if value >= 0)
    return Arrangement(
        {k: (which, entry) for k, which, entry in _places(instructions, code == ca.OP_INPUT)},
        dict(zip(constant.tolist(), instructions.constant[constant].tolist(), strict=True)) | dict(own),
        Runs.of(_done(found), heads, room, made),
        [
            (*x[1:], value)
            for x, value in zip(_places(instructions, code == ca.OP_OUTPUT), result.tolist(), strict=True)
        ],
    )


def in_runs(operations: Sequence[Operation]) -> list[list[Operation]]:
    """Order operations after those of their operands, in few runs of equal ones."""
    count = len(operations)
    kinds = np.array([x.kind for x in operations], np.int32)
    operands = np.array([value for x in operations for value in x.operands], np.int32)
    made = np.array([(*x.made, -1)[:2] for x in operations], np.int32)
    heads, room, then = np.empty((count, 2), np.int32), np.empty_like(operands), np.empty_like(made)
    values = 1 + int(max(operands.max(), made.max()))
    found = library().alfmu_in_runs(
        count, values, *map(address, (kinds, operands, made)), None, *map(address, (heads, room, then))
    )
    return Runs.of(_done(found), heads, room, then).operations()


def _places(instructions: Instructions, which: NDArray) -> list[list[int]]:
    """Return rows of instructions, each with its argument or result and entry."""
    return np.vstack([np.flatnonzero(which), instructions.place[:, which]]).T.tolist()


def _done(runs: int) -> int:
    """Return the number of runs; raise MemoryError if there is no memory."""
    if runs < 0:
        raise MemoryError
    return runs


KIND_OF, _COUNTS = _kinds(), np.array([OPERANDS[kind] for kind in KINDS])
