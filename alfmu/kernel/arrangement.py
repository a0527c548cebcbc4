"""The operations of a function in the form and the order that the interpreter runs fastest.

Sums, differences and products are sums of products, c + a b + a' b' and the like, and the sine and the cosine of an
angle are one operation, so that there are few kinds, and few numbers that are stored and read again. Equal operations
follow each other in runs, as few as can be. The numbers are those of the function to the last bit: a factor of one, two
negated factors, a summand of minus zero and summands that change places change none.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import zip_longest
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca
import numpy as np

from .stream import BINARY, UNARY, Instructions

__all__ = ["KINDS", "SINE_COSINE", "SUMS", "Arrangement", "Operation", "arranged", "in_runs"]

SUMS = {
    **{"sum1": 3, "sum2": 5, "sum4": 9},
    **{"product": 2, "products": 4, "plus": 2, "minus": 2, "negative": 1},
}
"""Kinds that sums of products are made of, and how many operands they have: c + a b with so many products, which are
added in their order; a b, a b + c d, a + b, a - b, -a."""

SINE_COSINE = "sine_cosine"
"""The sine and the cosine of an angle."""

_PRODUCTS = (ca.OP_MUL, ca.OP_SQ)
_JOINED = (ca.OP_ADD, ca.OP_SUB, *_PRODUCTS, ca.OP_TWICE, ca.OP_NEG, ca.OP_ASSIGN)
"""Operations of CasADi that sums of products stand for."""

KINDS = (*SUMS, ca.OP_DIV, SINE_COSINE, *(x for x in (*BINARY, *UNARY) if x not in (*_JOINED, ca.OP_DIV, ca.OP_INV)))
"""Kinds of operations in a scene; their places here are their numbers."""

_CYCLES = {ca.OP_DIV: 20, SINE_COSINE: 50, "sum2": 17, "products": 17, "sum4": 23}
"""From the operands of an operation to its result, both in memory; 14 of others."""

_COSTS = [_CYCLES.get(kind, 14) for kind in KINDS]

_NUMBER = {kind: i for i, kind in enumerate(KINDS)}


FEW = 2
"""Operations that become part of a run of another kind: what they cost more is less than a run of their own, above all
where the processor has not learnt the sequence of runs."""

NOTHING_NEUTRAL: Mapping[str, int] = MappingProxyType({})

_AS: dict[tuple[str | int, str | int], tuple[int | str, ...]] = {
    ("plus", "sum1"): (0, 1, "one"),
    ("minus", "sum1"): (0, 1, "minus one"),
    ("product", "sum1"): ("nothing", 0, 1),
    ("negative", "sum1"): ("nothing", 0, "minus one"),
    ("negative", "product"): (0, "minus one"),
    ("sum1", "sum2"): (0, 1, 2, "nothing", "one"),
    ("products", "sum2"): ("nothing", 0, 1, 2, 3),
    ("product", "products"): (0, 1, "nothing", "one"),
    ("plus", "products"): (0, "one", 1, "one"),
    ("minus", "products"): (0, "one", 1, "minus one"),
}
"""Operands of an operation as one of another kind: its own by their places, and 1, -1, -0 by their names."""

_BECOME = [[_NUMBER[one] for one, other in _AS if other == kind] for kind in KINDS]
"""By kind, those whose operations can be of it."""


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


class _Term(NamedTuple):
    """A summand: a value, or a product of two."""

    negative: bool
    first: int
    second: int | None = None


class _Form:
    """Instructions as operations of few kinds."""

    def __init__(self, instructions: Instructions):
        self._code = instructions.code.tolist()
        # The sign of a number is its own: what stands for the same number is no operation.
        self._same = same = (instructions.code == ca.OP_COPYSIGN) & (
            instructions.operands[0] == instructions.operands[1]
        )
        origin = np.where(same, instructions.operands[0], np.arange(len(same)))
        operands = np.where(instructions.operands < 0, -1, origin[instructions.operands])
        self._operands = list(zip(*operands.tolist(), strict=True))
        self._places = list(zip(*instructions.place.tolist(), strict=True))
        numbers = instructions.constant.tolist()
        self._count = len(self._code)
        self._constants = {k: numbers[k] for k, code in enumerate(self._code) if code == ca.OP_CONST}
        self._shared: dict[bytes, int] = {}
        self._negatives: dict[int, int] = {}
        self._operations: list[Operation] = []
        self._one, self._minus_one, self._nothing = map(self._constant, (1.0, -1.0, -0.0))
        self._uses = Counter(i for pair in self._operands for i in pair if i >= 0)

    def arrangement(self) -> Arrangement:
        arguments, results = {}, []
        angles: dict[int, tuple[list[int], list[int]]] = {}
        sums = self._sums()
        for k, terms in self._without_differences(sums).items():
            self._write(k, terms)
        for k, (code, (a, b)) in enumerate(zip(self._code, self._operands, strict=True)):
            if code == ca.OP_INPUT:
                arguments[k] = self._places[k]
            elif code == ca.OP_OUTPUT:
                results.append((*self._places[k], a))
            elif code in (ca.OP_SIN, ca.OP_COS):
                angles.setdefault(a, ([], []))[code == ca.OP_COS].append(k)
            elif code not in (*_JOINED, ca.OP_CONST) and not self._same[k]:
                operands = (self._one, a) if code == ca.OP_INV else (a, b) if code in BINARY else (a,)
                self._add(ca.OP_DIV if code == ca.OP_INV else code, operands, k)
        for angle, wanted in angles.items():
            for pair in zip_longest(*wanted):
                made = tuple(self._new() if k is None else k for k in pair)
                self._operations.append(Operation(_NUMBER[SINE_COSINE], (angle,), made))
        neutral = {"one": self._one, "minus one": self._minus_one, "nothing": self._nothing}
        return Arrangement(arguments, self._constants, in_runs(self._operations, neutral), results)

    # Sums ----------------------------------------------------------------------------------------------------------

    def _sums(self) -> dict[int, list[_Term]]:
        """The summands of each sum, in the order in which they are added.

        Sums that only begin another one, and products that only one sum has, are part of that one.
        """
        found: dict[int, list[_Term]] = {}
        for k, (code, (a, b)) in enumerate(zip(self._code, self._operands, strict=True)):
            if code in _PRODUCTS:
                found[k] = [_Term(False, a, a if code == ca.OP_SQ else b)]
            elif code in (ca.OP_ADD, ca.OP_SUB):
                found[k] = self._joined(found, a, b, code == ca.OP_SUB)
            elif code in _JOINED:
                found[k] = [_Term(code == ca.OP_NEG, a)] * (2 if code == ca.OP_TWICE else 1)
        return found

    def _joined(self, found: dict[int, list[_Term]], a: int, b: int, difference: bool) -> list[_Term]:
        """The summands of a + b or a - b; what becomes part of it is no longer a sum of its own."""
        begins = [len(found[x]) if self._uses[x] == 1 and x in found else 0 for x in (a, b)]
        products = [self._is_product(found, x) for x in (a, b)]
        turned = (not difference or products[1]) and (products[0], begins[1]) > (products[1], begins[0])
        first, second = (b, a) if turned else (a, b)
        terms = found.pop(first) if begins[turned] else [_Term(False, first)]
        if turned and difference:  # a - b = -b + a
            terms = [_Term(True, *terms[0][1:])]
        last = found.pop(second)[0] if products[not turned] else _Term(False, second)
        return [*terms, _Term(difference and not turned, *last[1:])]

    def _is_product(self, found: dict[int, list[_Term]], k: int) -> bool:
        """Whether a value is a product that is used once."""
        return self._uses[k] == 1 and self._code[k] in _PRODUCTS and k in found

    def _without_differences(self, sums: dict[int, list[_Term]]) -> dict[int, list[_Term]]:
        """The same, of products that are subtracted one factor negated instead: few factors, which many have in
        common."""
        left = {
            (k, i): x for k, terms in sums.items() for i, x in enumerate(terms) if x.negative and x.second is not None
        }
        of: dict[int, dict[tuple[int, int], None]] = defaultdict(dict)
        for place, term in left.items():
            for factor in {term.first, term.second}:
                of[factor][place] = None
        # Constants cost nothing; of others, those first that most products have.
        heap = [(x not in self._constants, -len(places), x) for x, places in of.items()]
        heapify(heap)
        while left:
            rank, count, factor = heappop(heap)
            places = [place for place in of[factor] if place in left]
            if len(places) != -count:
                heappush(heap, (rank, -len(places), factor))
                continue
            for k, i in places:
                term = left.pop((k, i))
                other = term.second if term.first == factor else term.first
                sums[k][i] = _Term(False, self._negative(factor), other)
        return sums

    def _write(self, k: int, terms: list[_Term]) -> None:
        """A sum as operations."""
        *before, (kind, operands) = self._parts(terms)
        made: int | None = None
        for each, operands_of_it in before:
            value = self._new()
            self._add(each, operands_of_it if made is None else (made, *operands_of_it), value)
            made = value
        self._add(kind, operands if made is None else (made, *operands), k)

    def _parts(self, terms: list[_Term]) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Kinds and operands of what a sum is made of; each part begins with what the one before it gives."""
        first, rest = terms[0], terms[1:]
        if not rest:
            yield self._alone(first)
            return
        begin: tuple[int, ...] = (first.first,)
        if first.second is not None and rest[0] == rest[0]._replace(negative=False, second=None):
            begin, rest = (rest[0].first,), [first, *rest[1:]]
        elif first.second is not None:
            yield "products", (*self._factors(first), *self._factors(rest[0]))
            begin, rest = (), rest[1:]
        elif first.negative:
            begin, rest = (self._nothing,), terms
        while rest:
            count = next(n for n in (4, 2, 1) if n <= len(rest))
            part, rest = rest[:count], rest[count:]
            if count == 1 and part[0].second is None:
                yield "minus" if part[0].negative else "plus", (*begin, part[0].first)
            else:
                yield f"sum{count}", (*begin, *(x for term in part for x in self._factors(term)))
            begin = ()

    def _alone(self, term: _Term) -> tuple[str, tuple[int, ...]]:
        if term.second is not None:
            return "product", (term.first, term.second)
        return ("negative", (term.first,)) if term.negative else ("plus", (term.first, self._nothing))

    def _factors(self, term: _Term) -> tuple[int, int]:
        if term.second is None:
            return term.first, self._minus_one if term.negative else self._one
        return term.first, term.second

    # Values --------------------------------------------------------------------------------------------------------

    def _negative(self, k: int) -> int:
        if k not in self._negatives:
            if k in self._constants:
                self._negatives[k] = self._constant(-self._constants[k])
            else:
                self._negatives[k] = self._new()
                self._add("negative", (k,), self._negatives[k])
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


def in_runs(operations: list[Operation], neutral: Mapping[str, int] = NOTHING_NEUTRAL) -> list[list[Operation]]:
    """The same operations, each after those that make its operands, in few runs of equal ones.

    The next run is of the kind that has an operation on which the longest sequence of other kinds waits, and takes all
    of its kind that are ready, ordered by their operands. `neutral` are values by their names in `_AS`: with them a run
    also takes operations that would be a short one of their own.
    """
    users, missing = _users(operations)
    urgency = _urgency(operations, users, missing)
    ready: list[list[tuple[int, int, int]]] = [[] for _ in KINDS]
    runs: list[list[Operation]] = []
    places: dict[int, int] = {}

    def add(i: int) -> None:
        heappush(ready[operations[i].kind], (*urgency[i], i))

    def done(i: int) -> None:
        for user in users[i]:
            missing[user] -= 1
            if not missing[user]:
                add(user)

    def short(kind: int) -> int | None:
        """A kind of which few operations are ready, all of which can be of this one."""
        return next((x for x in _BECOME[kind] if 0 < len(ready[x]) <= FEW), None) if neutral else None

    for i, count in enumerate(missing):
        if not count:
            add(i)
    while any(ready):
        waiting = min(filter(None, ready), key=lambda each: each[0])
        kind = operations[waiting[0][-1]].kind
        run: list[Operation] = []
        while waiting or (other := short(kind)) is not None:
            i = heappop(waiting or ready[other])[-1]
            run.append(_as(operations[i], kind, neutral))
            done(i)
        runs.append(_by_operands(run, places))
    return runs


def _by_operands(run: list[Operation], places: dict[int, int]) -> list[Operation]:
    """The operations of a run by the places of their operands, which are added: an archive of them is a tenth smaller.

    Those that wait for others of the run follow these.
    """
    waits: dict[int, int] = {}
    keys = []
    for operation in run:
        after = 1 + max(waits.get(x, -1) for x in operation.operands)
        waits.update(dict.fromkeys(operation.made, after))
        keys.append((after, *(places.get(x, x) for x in operation.operands)))
    ordered = [run[i] for i in sorted(range(len(run)), key=keys.__getitem__)]
    for operation in ordered:
        for value in operation.made:
            places[value] = _MADE + len(places)
    return ordered


_MADE = 2**40
"""Place of the first value that an operation makes: behind all others."""


def _as(operation: Operation, kind: int, neutral: Mapping[str, int]) -> Operation:
    """The same as an operation of another kind."""
    if operation.kind == kind:
        return operation
    form = _AS[KINDS[operation.kind], KINDS[kind]]
    return Operation(
        kind, tuple(neutral[x] if isinstance(x, str) else operation.operands[x] for x in form), operation.made
    )


def _users(operations: list[Operation]) -> tuple[list[list[int]], list[int]]:
    """The operations that use what each makes, and how many others each waits for."""
    maker = {value: i for i, operation in enumerate(operations) for value in operation.made}
    users: list[list[int]] = [[] for _ in operations]
    missing = [0] * len(operations)
    for i, operation in enumerate(operations):
        makers = {maker[x] for x in operation.operands if x in maker}
        for j in makers:
            users[j].append(i)
        missing[i] = len(makers)
    return users, missing


def _urgency(operations: list[Operation], users: list[list[int]], missing: list[int]) -> list[tuple[int, int]]:
    """Of each operation, below zero: how often the kind changes after it at least, and cycles from its beginning to the
    end of the longest chain that waits for it."""
    order, left = [i for i, count in enumerate(missing) if not count], missing.copy()
    for i in order:  # which grows
        for user in users[i]:
            left[user] -= 1
            if not left[user]:
                order.append(user)
    kinds, found = [operation.kind for operation in operations], [(0, 0)] * len(operations)
    for i in reversed(order):
        kind, changes, cycles = kinds[i], 0, 0
        for j in users[i]:
            later, most = found[j]
            if (after := later - (kinds[j] != kind)) < changes:
                changes = after
            if most < cycles:
                cycles = most
        found[i] = changes, cycles - _COSTS[kind]
    return found
