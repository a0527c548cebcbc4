"""The operations of a function in the form and the order that the interpreter runs fastest.

Sums, differences and products are sums of products, c + a b + a' b', and the sine and the cosine of an angle are one
operation, so that there are few kinds, and few numbers that are stored and read again. Equal operations follow each
other in runs: a processor that cannot foresee the next kind loses as much time as dozens of operations take. The
numbers are those of the function to the last bit: a factor of one, two negated factors and a summand of minus zero
change none.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import zip_longest

import casadi as ca

from .stream import BINARY, UNARY, Instructions

__all__ = ["KINDS", "SINE_COSINE", "SUMS", "Arrangement", "Operation", "arranged", "in_runs"]

SUMS = ("sum1", "sum2")
"""c + a b with so many products, which are added in their order."""

SINE_COSINE = "sine_cosine"
"""The sine and the cosine of an angle."""

_PRODUCTS = (ca.OP_MUL, ca.OP_SQ)
_JOINED = (ca.OP_ADD, ca.OP_SUB, *_PRODUCTS, ca.OP_TWICE, ca.OP_NEG, ca.OP_ASSIGN)
"""Operations of CasADi that sums of products stand for."""

KINDS = (*SUMS, ca.OP_DIV, SINE_COSINE, *(x for x in (*BINARY, *UNARY) if x not in (*_JOINED, ca.OP_DIV, ca.OP_INV)))
"""Kinds of operations in a scene; their places here are their numbers."""

_CYCLES = {SUMS[0]: 14, SUMS[1]: 17, ca.OP_DIV: 20, SINE_COSINE: 50}
"""From the operands of an operation to its result, both in memory; the others as the first."""

_URGENT = len(SUMS) + 2
"""Kinds that chains are made of; the others, comparisons above all, wait until there is nothing else."""

_PATIENCE = 60
"""Cycles by which another kind may be more urgent than the one of a run: some runs more, and a tenth less time."""

_NUMBER = {kind: i for i, kind in enumerate(KINDS)}


@dataclass(frozen=True)
class Operation:
    """Values are numbered; operands are values, and so is what is made."""

    kind: int
    operands: tuple[int, ...]
    made: tuple[int, ...]


@dataclass(frozen=True)
class Arrangement:
    """A function as runs of equal operations."""

    arguments: dict[int, tuple[int, int]]
    """Value to which argument, and which entry of it."""
    constants: dict[int, float]
    runs: list[list[Operation]]
    results: list[tuple[int, int, int]]
    """Which result, which entry of it, and the value."""


def arranged(instructions: Instructions) -> Arrangement:
    """The operations of a function that calls no other."""
    return _Form(instructions).arrangement()


class _Form:
    """Instructions as operations of few kinds."""

    def __init__(self, instructions: Instructions):
        self._code = instructions.code.tolist()
        self._operands = list(zip(*instructions.operands.tolist(), strict=True))
        self._places = list(zip(*instructions.place.tolist(), strict=True))
        self._numbers = instructions.constant.tolist()
        self._count = len(self._code)
        self._constants: dict[int, float] = {}
        self._shared: dict[bytes, int] = {}
        self._negatives: dict[int, int] = {}
        self._operations: list[Operation] = []
        self._one, self._minus_one, self._nothing = map(self._constant, (1.0, -1.0, -0.0))
        self._uses = Counter(i for pair in self._operands for i in pair if i >= 0)

    def arrangement(self) -> Arrangement:
        arguments, results = {}, []
        angles: dict[int, tuple[list[int], list[int]]] = {}
        within = self._within()
        for k, (code, (a, b)) in enumerate(zip(self._code, self._operands, strict=True)):
            if code == ca.OP_INPUT:
                arguments[k] = self._places[k]
            elif code == ca.OP_CONST:
                self._constants[k] = self._numbers[k]
            elif code == ca.OP_OUTPUT:
                results.append((*self._places[k], a))
            elif code in (ca.OP_SIN, ca.OP_COS):
                angles.setdefault(a, ([], []))[code == ca.OP_COS].append(k)
            elif code not in _JOINED:
                operands = (self._one, a) if code == ca.OP_INV else (a, b) if code in BINARY else (a,)
                self._add(ca.OP_DIV if code == ca.OP_INV else code, operands, k)
            elif k not in within:
                self._add(SUMS[0], self._sum(k, within), k)
        for angle, wanted in angles.items():
            for pair in zip_longest(*wanted):
                made = tuple(self._new() if k is None else k for k in pair)
                self._operations.append(Operation(_NUMBER[SINE_COSINE], (angle,), made))
        return Arrangement(arguments, self._constants, in_runs(_together(self._operations, results)), results)

    def _within(self) -> dict[int, int]:
        """Products that become part of the sum or difference that uses them, and which factor is negated (or -1)."""
        found, factors, differences = {}, Counter(), []
        for code, (a, b) in zip(self._code, self._operands, strict=True):
            if code == ca.OP_ADD and (self._single(a) or self._single(b)):
                found[a if self._single(a) else b] = -1
            elif code == ca.OP_SUB and self._single(b):
                differences.append(b)
                factors.update(set(self._factors(b)))
        for product in differences:
            factor = max(self._factors(product), key=lambda i: (self._code[i] == ca.OP_CONST, factors[i]))
            if factors[factor] > 1 or self._code[factor] == ca.OP_CONST:
                found[product] = factor
        return found

    def _sum(self, k: int, within: dict[int, int]) -> tuple[int, int, int]:
        """c, a and b of a sum, a difference or a product."""
        code, (a, b) = self._code[k], self._operands[k]
        if code in _PRODUCTS:
            return self._nothing, *self._factors(k)
        if code == ca.OP_ADD:
            product, other = (a, b) if a in within else (b, a)
            if product in within:
                return other, *self._factors(product)
            # What is used here alone can be part of this operation.
            first, second = (a, b) if self._uses[a] == 1 else (b, a)
            return first, second, self._one
        if code == ca.OP_SUB:
            if b not in within:
                return a, b, self._minus_one
            factor = within[b]
            x, y = self._factors(b)
            return a, self._negative(factor), y if factor == x else x
        if code == ca.OP_TWICE:
            return a, a, self._one
        return self._nothing, a, self._minus_one if code == ca.OP_NEG else self._one

    def _single(self, k: int) -> bool:
        return self._code[k] in _PRODUCTS and self._uses[k] == 1

    def _factors(self, k: int) -> tuple[int, int]:
        a, b = self._operands[k]
        return a, a if self._code[k] == ca.OP_SQ else b

    def _negative(self, k: int) -> int:
        if k not in self._negatives:
            if self._code[k] == ca.OP_CONST:
                self._negatives[k] = self._constant(-self._numbers[k])
            else:
                self._negatives[k] = self._new()
                self._add(SUMS[0], (self._nothing, k, self._minus_one), self._negatives[k])
        return self._negatives[k]

    def _add(self, kind: str | int, operands: tuple[int, ...], made: int) -> None:
        self._operations.append(Operation(_NUMBER[kind], operands, (made,)))

    def _new(self) -> int:
        self._count += 1
        return self._count - 1

    def _constant(self, value: float) -> int:
        bits = struct.pack("<d", value)
        if bits not in self._shared:
            self._shared[bits] = self._new()
            self._constants[self._shared[bits]] = value
        return self._shared[bits]


def _together(operations: list[Operation], results: list[tuple[int, int, int]]) -> list[Operation]:
    """The same operations, where a sum that only another one begins with is part of that one."""
    uses = Counter(x for operation in operations for x in operation.operands)
    uses.update(value for _, _, value in results)
    longer: dict[int, Operation] = {}
    kept: list[Operation] = []
    for operation in operations:  # in an order in which operands are made first
        begin = longer.get(operation.operands[0]) if operation.kind < len(SUMS) else None
        if begin and uses[operation.operands[0]] == 1:
            products = *begin.operands[1:], *operation.operands[1:]
            if len(products) <= 2 * len(SUMS):
                kind, operands = len(products) // 2 - 1, (begin.operands[0], *products)
                operation = Operation(kind, operands, operation.made)
                del longer[begin.made[0]]
        if operation.kind < len(SUMS):
            longer[operation.made[0]] = operation
        else:
            kept.append(operation)
    return [*kept, *longer.values()]


def in_runs(operations: list[Operation]) -> list[list[Operation]]:
    """The same operations, each after those that make its operands, in few runs of equal ones.

    Of the operations that are ready, a run takes those first on which the longest chain waits. It ends where another
    kind has one that is far more urgent; that kind follows.
    """
    users, missing = _users(operations)
    heights = _heights(operations, users)
    ready: list[list[tuple[int, int]]] = [[] for _ in KINDS]

    def add(i: int) -> None:
        heappush(ready[operations[i].kind], (-heights[i], i))

    for i, count in enumerate(missing):
        if not count:
            add(i)
    runs = []
    while any(ready):
        first = [kind for kind in range(_URGENT) if ready[kind]]
        kind = min(first, key=lambda k: ready[k][0]) if first else next(k for k in range(len(KINDS)) if ready[k])
        waiting, run = ready[kind], []
        runs.append(run)
        while waiting:
            _, i = heappop(waiting)
            run.append(operations[i])
            for user in users[i]:
                missing[user] -= 1
                if not missing[user]:
                    add(user)
            others = (ready[k][0][0] for k in first if k != kind and ready[k])
            if waiting and min(others, default=0) < waiting[0][0] - _PATIENCE:
                break
    return runs


def _users(operations: list[Operation]) -> tuple[list[list[int]], list[int]]:
    """The operations that use what each makes, and how many others each waits for."""
    maker = {value: i for i, operation in enumerate(operations) for value in operation.made}
    users: list[list[int]] = [[] for _ in operations]
    missing = [0] * len(operations)
    for i, operation in enumerate(operations):
        for j in {maker[x] for x in operation.operands if x in maker}:
            users[j].append(i)
            missing[i] += 1
    return users, missing


def _heights(operations: list[Operation], users: list[list[int]]) -> list[int]:
    """Cycles from the beginning of each operation to the end of the longest chain that waits for it."""
    heights: list[int] = [-1] * len(operations)
    for begin in range(len(operations)):
        stack = [begin]
        while stack:
            i = stack[-1]
            left = [j for j in users[i] if heights[j] < 0]
            if left:
                stack += left
                continue
            stack.pop()
            cycles = _CYCLES.get(KINDS[operations[i].kind], _CYCLES[SUMS[0]])
            heights[i] = cycles + max((heights[j] for j in users[i]), default=0)
    return heights
