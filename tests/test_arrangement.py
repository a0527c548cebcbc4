"""Functions as the interpreter runs them: few kinds of operations in runs, and no bit of any number changed."""

import math
import struct

import casadi as ca
import numpy as np
import pytest

from alfmu.kernel.arrangement import KINDS, SINE_COSINE, SUMS, Arrangement, arranged
from alfmu.kernel.stream import Instructions

WORK = {
    "sum1": lambda c, a, b: c + a * b,
    "sum2": lambda c, a, b, d, e: c + a * b + d * e,
    "sum4": lambda c, *x: c + x[0] * x[1] + x[2] * x[3] + x[4] * x[5] + x[6] * x[7],
    "product": lambda a, b: a * b,
    "products": lambda a, b, c, d: a * b + c * d,
    "plus": lambda a, b: a + b,
    "minus": lambda a, b: a - b,
    "negative": lambda a: -a,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_SQRT: math.sqrt,
    SINE_COSINE: lambda a: (math.sin(a), math.cos(a)),
}


def results(arrangement: Arrangement, arguments: list[list[float]]) -> dict[tuple[int, int], float]:
    """What the runs of a function give; each operand must have been made before."""
    values = dict(arrangement.constants)
    values |= {value: arguments[which][entry] for value, (which, entry) in arrangement.arguments.items()}
    for run in arrangement.runs:
        assert len({operation.kind for operation in run}) == 1
        for operation in run:
            kind = KINDS[operation.kind]
            assert len(operation.operands) == SUMS.get(kind, len(operation.operands))
            made = WORK[kind](*(values[x] for x in operation.operands))
            values.update(zip(operation.made, made if isinstance(made, tuple) else (made,), strict=True))
    return {(which, entry): values[value] for which, entry, value in arrangement.results}


def counted(f: ca.Function) -> dict:
    """How many operations of each kind there are."""
    kinds = [KINDS[operation.kind] for run in arranged(Instructions.of(f)).runs for operation in run]
    return {kind: kinds.count(kind) for kind in kinds}


def drawn(seed: int) -> ca.Function:
    """A function of sums, differences and products drawn by chance, some used once and some often."""
    random, x = np.random.default_rng(seed), ca.SX.sym("x", 6)
    known = [*ca.vertsplit(x), ca.SX(2.0), ca.SX(-0.75)]

    def one() -> ca.SX:
        return known[random.integers(len(known))]

    makers = (
        lambda: one() + one() * one(),
        lambda: one() - one() * one(),
        lambda: one() * one() - one(),
        lambda: one() * one() - one() * one() + one() - one() * one(),
        lambda: -one() - one(),
        lambda: -(one() * one()),
        lambda: 2 * one() + one() ** 2,
        lambda: one() - (one() - one()),
        lambda: one() / (1 + one() ** 2),
        lambda: ca.sin(one()) * ca.cos(one()),
        lambda: 1 / (3 + ca.cos(one())),
    )
    for maker in random.integers(len(makers), size=120):
        known += [makers[maker]()]
    return ca.Function("drawn", [x], [ca.vertcat(*known[-40:])], {"cse": True})


@pytest.mark.parametrize("seed", range(8))
def test_no_bit_of_any_number_changes(seed):
    f = drawn(seed)
    x = np.random.default_rng(100 + seed).uniform(-1.5, 1.5, 6)
    x[seed % 6] = -0.0
    found = results(arranged(Instructions.of(f)), [x.tolist()])
    expected = f(x).full().ravel().tolist()
    for entry, value in enumerate(expected):
        assert struct.pack("<d", found[0, entry]) == struct.pack("<d", value) or (value != value), entry


def test_sums_of_products_are_few_operations():
    a, b, c = ca.SX.sym("a", 8), ca.SX.sym("b", 8), ca.SX.sym("c")
    assert counted(ca.Function("f", [a, b, c], [sum((a[i] * b[i] for i in range(4)), c)])) == {"sum4": 1}
    assert counted(ca.Function("f", [a, b], [ca.dot(a, b)])) == {"products": 1, "sum4": 1, "sum2": 1}
    # A factor that many products have in common is negated once.
    less = ca.vertcat(*(b[i] - c * a[i] for i in range(8)))
    assert counted(ca.Function("f", [a, b, c], [less])) == {"negative": 1, "sum1": 8}


def test_equal_operations_that_wait_for_nothing_are_one_run():
    a, b = ca.SX.sym("a", 20), ca.SX.sym("b", 20)
    f = ca.Function("f", [a, b], [ca.vertcat(*((a[i] * b[i]) / (a[i] + b[i]) for i in range(20)))])
    assert [(KINDS[run[0].kind], len(run)) for run in arranged(Instructions.of(f)).runs][-1] == (ca.OP_DIV, 20)
    assert len(arranged(Instructions.of(f)).runs) == 3
