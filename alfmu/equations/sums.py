"""Sums far from the origin: lengths that cancel are subtracted first, so that their round-off enters no force.

A point at (arm + 70) m has round-off of 1e-14 m, which the difference of two such points keeps, and a stiff spring
multiplies. In sums and differences, large constants are therefore added up exactly, and coordinates of places are
subtracted from each other, before anything else is added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import casadi as ca

FAR = 16.0
"""Distance from the origin, over the longest arm, from which sums are rearranged: nearer ones lose no digit that the
coordinates have."""


@dataclass
class _Sum:
    """rest + constant + the sum of factor times place."""

    rest: ca.SX | None = None
    constant: Fraction = Fraction(0)
    places: dict[int, int] = field(default_factory=dict)
    """Factor of each coordinate, by its index."""

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

    def value(self, q: Sequence[ca.SX]) -> ca.SX:
        """Return the sum: places less others first, then the constant, then the rest."""
        more, less = ([q[i] for i, k in self.places.items() for _ in range(sign * k)] for sign in (1, -1))
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


def rearranged(arguments: list[ca.SX], value: ca.SX, far: float, places: Sequence[int]) -> ca.SX:
    """Return the same expressions in other sums; `far` is the smallest constant that is added up exactly, `places` are
    entries of the first argument that are coordinates of places."""
    f = ca.Function("sums", arguments, [value.nz[:]])
    entries = [ca.vertsplit(ca.vec(x)) for x in arguments]
    q, atoms = entries[0], {*places}
    kept: dict[int, _Sum] = {}
    found = [ca.SX(0)] * value.nnz()
    for k in range(f.n_instructions()):
        code, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if code == ca.OP_OUTPUT:
            found[outputs[1]] = kept[inputs[0]].value(q)
            continue
        if code == ca.OP_INPUT:
            which, entry = inputs
            mine = _Sum(None, places={entry: 1}) if which == 0 and entry in atoms else _Sum(entries[which][entry])
        elif code == ca.OP_CONST:
            number = f.instruction_constant(k)
            mine = _Sum(None, Fraction(number)) if far <= abs(number) < math.inf else _Sum(ca.SX(number))
        else:
            mine = _combined(code, [kept[i] for i in inputs], q)
        kept[outputs[0]] = mine
    return ca.SX(value.sparsity(), ca.vertcat(*found))


def _combined(code: int, operands: list[_Sum], q: Sequence[ca.SX]) -> _Sum:
    """Return the result of an operation: a sum of sums, or of a sum times a number, else one value."""
    if code in (ca.OP_ADD, ca.OP_SUB):
        return operands[0].plus(operands[1], 1 if code == ca.OP_ADD else -1)
    if code == ca.OP_NEG:
        return _Sum().plus(operands[0], -1)
    if code == ca.OP_MUL and not any(x.places for x in operands):
        for one, other in (operands, operands[::-1]):
            number = one.rest if other.constant and not one.constant else None
            if number is not None and number.is_constant() and math.isfinite(float(number)):
                return other.times(Fraction(float(number)))
    values = [x.value(q) for x in operands]
    return _Sum(ca.SX.binary(code, *values) if len(values) == 2 else ca.SX.unary(code, *values))
