"""Sums far from the origin: lengths that cancel are subtracted first, so that their round-off enters no force.

A point at (arm + 70) m has round-off of 1e-14 m, which the difference of two such points keeps, and a stiff spring
multiplies. In sums and differences, large constants are therefore added up exactly, and places (coordinates, and large
parameters) are subtracted from each other, before anything else is added.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import casadi as ca

FAR = 16.0
"""Distance from the origin, over the longest arm, from which sums are rearranged: nearer ones lose no digit that the
coordinates have."""

_MOST_PLACES = 16
"""Number of places in a sum, counted as often as they occur, above which its value takes part in other sums: the work
and the expressions stay in proportion to the given ones."""

_LARGEST = 1e100
"""Constants above are not added up exactly, as sums and products of them may exceed all numbers."""


@dataclass
class _Sum:
    """rest + constant + the sum of factor times place."""

    rest: ca.SX | None = None
    constant: Fraction = Fraction(0)
    places: dict[tuple[int, int], int] = field(default_factory=dict)
    """Factor of each place, by its argument and its entry there."""

    def plus(self, other: _Sum, sign: int) -> _Sum:
        """Return the sum with another, or the difference."""
        rest = self.rest
        if other.rest is not None:
            signed = other.rest if sign > 0 else -other.rest
            rest = signed if rest is None else rest + other.rest if sign > 0 else rest - other.rest
        places = {i: self.places.get(i, 0) + sign * other.places.get(i, 0) for i in {**self.places, **other.places}}
        return _Sum(rest, self.constant + sign * other.constant, {i: k for i, k in places.items() if k})

    def times(self, factor: Fraction) -> _Sum:
        """Return the sum, which has no places, times a number."""
        return _Sum(None if self.rest is None else float(factor) * self.rest, factor * self.constant)

    def is_short(self) -> bool:
        """Return whether other sums may contain the parts of this one."""
        return sum(map(abs, self.places.values())) <= _MOST_PLACES and abs(self.constant) < _LARGEST

    def value(self, entries: Sequence[Sequence[ca.SX]]) -> ca.SX:
        """Return the sum: places less others first, then the constant, then the rest."""
        more, less = ([entries[i][j] for (i, j), k in self.places.items() for _ in range(sign * k)] for sign in (1, -1))
        both = min(len(more), len(less))
        parts = [a - b for a, b in zip(more, less, strict=False)]
        left = [*more[both:], *(-x for x in less[both:])]
        if self.constant:
            left.append(ca.SX(float(self.constant)))
        parts += [sum(left[1:], left[0])] if left else []
        found = sum(parts[1:], parts[0]) if parts else None
        if self.rest is None:
            return ca.SX(0) if found is None else found
        return self.rest if found is None else found + self.rest


def rearranged(arguments: list[ca.SX], value: ca.SX, far: float, places: Collection[tuple[int, int]]) -> ca.SX:
    """Return the same expressions in other sums; `far` is the smallest constant that is added up exactly, `places` are
    arguments and their entries that are places."""
    f = ca.Function("sums", arguments, [value.nz[:]])
    steps = [(f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)) for k in range(f.n_instructions())]
    numbers = {k: f.instruction_constant(k) for k, (code, _, _) in enumerate(steps) if code == ca.OP_CONST}
    large = {k for k, number in numbers.items() if far <= abs(number) < _LARGEST}
    if not _may_cancel(steps, large, places):
        return value
    entries = [ca.vertsplit(ca.vec(x)) for x in arguments]
    given = ca.vertsplit(f.instructions_sx())
    kept: dict[int, _Sum | ca.SX] = {}  # expressions that stay as they are, and sums
    found = [ca.SX(0)] * value.nnz()
    for k, (code, inputs, outputs) in enumerate(steps):
        if code == ca.OP_INPUT:
            which, entry = inputs
            place = (which, entry) in places
            kept[outputs[0]] = _Sum(places={(which, entry): 1}) if place else entries[which][entry]
            continue
        if code == ca.OP_CONST:
            kept[outputs[0]] = _Sum(None, Fraction(numbers[k])) if k in large else ca.SX(numbers[k])
            continue
        parts = [kept[i] for i in inputs]
        if code == ca.OP_OUTPUT:
            found[outputs[1]] = _summed(parts[0]).value(entries)
        elif any(isinstance(x, _Sum) for x in parts):
            operands = [_summed(x) for x in parts]
            combined = _combined(code, operands)
            if combined is None or not combined.is_short():
                values = [x.value(entries) for x in operands]
                combined = _Sum(ca.SX.binary(code, *values) if len(values) == 2 else ca.SX.unary(code, *values))
            kept[outputs[0]] = combined
        else:
            kept[outputs[0]] = given[k]
    return ca.SX(value.sparsity(), ca.vertcat(*found))


def _summed(value: _Sum | ca.SX) -> _Sum:
    return value if isinstance(value, _Sum) else _Sum(value)


def _may_cancel(
    steps: Sequence[tuple[int, Sequence[int], Sequence[int]]],
    large: Collection[int],
    places: Collection[tuple[int, int]],
) -> bool:
    """Return whether a sum has two operands with places or large constants: operations, inputs, outputs of `steps`."""
    carries: dict[int, bool] = {}
    for k, (code, inputs, outputs) in enumerate(steps):
        if code == ca.OP_INPUT:
            mine = (inputs[0], inputs[1]) in places
        elif code == ca.OP_CONST:
            mine = k in large
        elif code == ca.OP_OUTPUT:
            continue
        else:
            mine = any(carries[i] for i in inputs) and code in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_MUL)
            if code in (ca.OP_ADD, ca.OP_SUB) and all(carries[i] for i in inputs):
                return True
        carries[outputs[0]] = mine
    return False


def _combined(code: int, operands: list[_Sum]) -> _Sum | None:
    """Return a sum or difference of sums, or a sum times a number; None for the result of any other operation."""
    if code in (ca.OP_ADD, ca.OP_SUB):
        return operands[0].plus(operands[1], 1 if code == ca.OP_ADD else -1)
    if code == ca.OP_NEG:
        return _Sum().plus(operands[0], -1)
    if code == ca.OP_MUL and not any(x.places for x in operands):
        for one, other in (operands, operands[::-1]):
            number = one.rest if other.constant and not one.constant else None
            if number is not None and number.is_constant() and math.isfinite(float(number)):
                return other.times(Fraction(float(number)))
    return None
