"""Functions of a mechanism combined for numerical evaluation: each result once, with shared subexpressions."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import TypeVar

import casadi as ca

from ..model.kept import once
from ..model.making import making
from .types import Equations, Signature

Stage = TypeVar("Stage", bound=Equations)
"""Equations, or a later stage of them."""

DENSE = 50
"""Number of coordinates up to which matrices are dense arrays; larger ones are sparse."""

MANY = 100
"""Number of coordinates from which they may be eliminated in the order of declaration."""

MORE = 1.1
"""Elimination in the order of declaration is used if its work exceeds that of least fill by at most this factor."""

ARGUMENTS = {
    name: letters.split()
    for name, letters in {
        "M": "q p",
        "d": "q v p",
        "f": "q v u p t",
        "Phi": "q p",
        "C": "q p",
        "xi": "q v p",
        "displacements": "q p",
        "counted": "q p",
        "gaps": "q p",
        "gaps_matrix": "q p",
        "kinetic_energy": "q v p",
        "potential_energy": "q p",
        "input_power": "q v u p t",
        "other_power": "q v p t",
        "state_rates": "q v u p t",
        "readings": "q v a lam u p t",
        "shares": "q v a lam u p t",
        "rubbing": "q v a lam u p t",
        "sliding": "q v p",
        "guess": "p s",
        "guess_rate": "p s sdot",
        "ties": "q p s",
        "ties_matrix": "q p s",
        "Phi_dot": "q v p",
        "motion_power": "q v a lam u p t",
        "laws": "q v p",
        "instants": "p",
        "stops": "q p",
    }.items()
}
"""Arguments of each function of the equations; the last three exist if time is a coordinate."""

EVALUATED = {
    "dynamics": 2,
    "constraints": 2,
    "power": 0,
    "energy": 0,
    "readings": 0,
    "shares": 1,
    "closure": 2,
    "guesses": 0,
    "displacements": 0,
    "laws": 0,
    "beyond": 0,
    "state_rates": 0,
    "sliding": 0,
    "tangents": 4,
}
"""Functions evaluated outside the kernel, and how many of their results are matrices."""


def symbols(equations: Equations) -> dict[str, ca.SX]:
    """Return fresh symbols for the arguments of the functions of `equations`."""
    sizes = {
        "q": equations.n,
        "v": equations.n,
        "a": equations.n,
        "lam": equations.l,
        "u": equations.driven,
        "p": len(equations.parameters) + len(equations.held),
        "t": 1,
        "s": len(equations.starts),
        "sdot": len(equations.starts),
    }
    return {name: ca.SX.sym(name, size) for name, size in sizes.items()}


def evaluable(equations: Stage) -> Stage:
    """Return the same equations with the functions that the start and the oracle call.

    dynamics(q, v, u, p, t): M, C, F = f - d, xi. constraints(q, v, p): M, C, Phi, C v. power(q, v, u, p, t): W.
    energy(q, v, p): total and kinetic energies [J]. closure(q, p, s): derivatives of gaps and ties, gaps, ties.
    guesses(p, s, sdot): q, v.
    """
    e, x = equations, symbols(equations)
    q, v, u, p, t, s, sdot = (x[k] for k in ("q", "v", "u", "p", "t", "s", "sdot"))
    M, C, Phi = e.M(q, p), e.C(q, p), e.Phi(q, p)
    power = e.input_power(q, v, u, p, t) + e.other_power(q, v, p, t)
    kinetic = e.kinetic_energy(q, v, p)
    closure = [e.gaps_matrix(q, p), e.ties_matrix(q, p, s), e.gaps(q, p), e.ties(q, p, s)]
    results = {
        "dynamics": ([q, v, u, p, t], [M, C, e.f(q, v, u, p, t) - e.d(q, v, p), e.xi(q, v, p)]),
        "constraints": ([q, v, p], [M, C, Phi, e.Phi_dot(q, v, p) if e.timed else C @ v]),
        "power": ([q, v, u, p, t], [power]),
        "energy": ([q, v, p], [kinetic + e.potential_energy(q, p), kinetic]),
        "closure": ([q, p, s], closure),
        "guesses": ([p, s, sdot], [e.guess(p, s), e.guess_rate(p, s, sdot)]),
    }
    if e.limited:
        beyond = e.stops(q, p)
        results["beyond"] = ([q, p], [beyond, ca.jacobian(beyond, q)])
    functions = {"readings": e.readings, "shares": e.shares}
    if e.states:
        functions["state_rates"] = e.state_rates
    if e.held:
        functions["displacements"] = e.displacements
    if e.frictions:
        functions["sliding"] = e.sliding
    if e.leaps:
        functions["laws"] = e.laws
    for name, (arguments, values) in results.items():
        dense = [ca.densify(y) if e.n <= DENSE or i >= EVALUATED[name] else y for i, y in enumerate(values)]
        functions[name] = shared(name, arguments, dense)
    return with_functions(e, functions)


@once
def telling(equations: Equations) -> list[int]:
    """Return the independent coordinates that have a start value each."""
    ties = equations.ties_matrix.sparsity_out(0).T
    rows = [[c for c in ties.row()[a:b] if c < equations.dependent] for a, b in pairwise(ties.colind())]
    return [row[0] for row in rows if len(row) == 1]


@once
def loops(equations: Equations) -> int:
    """Return the number of loops, at least 1: closed joints, less the bodies with Euler parameters that they hold."""
    C = equations.functions["C"].sparsity_out(0).T
    touched = [set(C.row()[begin:end]) for begin, end in pairwise(C.colind())]
    closed = sorted({*range(equations.l)} - {*equations.lengths})
    columns = set[int]().union(*(touched[r] for r in closed))
    held = [r for r in equations.lengths if touched[r] & columns]
    return max(1, len({equations.rows[r].name for r in closed}) - len(held))


@once
def elimination_order(equations: Equations) -> list[int]:
    """Return the order of the coordinates with least fill in the factorised augmented mass H."""
    M, C = (ca.SX(equations.functions[name].sparsity_out(0), 1) for name in ("M", "C"))
    return elimination((M + C.T @ C).sparsity(), telling(equations))


def elimination(pattern: ca.Sparsity, telling: Sequence[int] = ()) -> list[int]:
    """Return an elimination order of the coordinates in H with little fill in L.

    Independent coordinates come last if that takes no more work: only masses then contribute to their pivots, and no
    other pivot is small except at a singular position. Many coordinates are eliminated in the order of declaration if
    it takes hardly more work, so that repeated parts of a mechanism compile to loops.
    """
    factor, order = pattern.ldl(True)
    if pattern.size1() >= MANY:
        declared, plain = pattern.ldl(False)
        if _work(declared) <= MORE * _work(factor):
            return list(plain)
    reordered = sorted(order, key=lambda i: i in telling)
    if _work(ca.DM(pattern, 1)[reordered, reordered].sparsity().ldl(False)[0]) <= _work(factor):
        return reordered
    return list(order)


def _work(factor: ca.Sparsity) -> int:
    """Return the approximate number of multiplications of a factorisation: squared column counts of L."""
    ends = factor.colind()
    return sum((end - begin) ** 2 for begin, end in pairwise(ends))


def shared(name: str, arguments: list[ca.SX], values: list[ca.SX]) -> ca.Function:
    """Return a function with its common subexpressions shared.

    The search runs on the nonzeros: on a matrix, CasADi's search takes quadratic time.
    """
    making(name)
    entries = ca.cse(ca.vertcat(*(ca.vec(value.nz[:]) for value in values)))
    ends = list(accumulate((value.nnz() for value in values), initial=0))
    values = [ca.SX(x.sparsity(), entries[ends[i] : ends[i + 1]]) for i, x in enumerate(values)]
    return ca.Function(name, arguments, values)


def with_functions(equations: Stage, functions: dict[str, ca.Function]) -> Stage:
    """Return the same equations with functions for numerical evaluation added or replaced."""
    signatures = {name: _signature(f, EVALUATED.get(name, 0)) for name, f in functions.items()}
    return replace(
        equations,
        functions={**equations.functions, **functions},
        signatures={**equations.signatures, **signatures},
    )


def _signature(f: ca.Function, matrices: int = 0) -> Signature:
    """Return sizes of arguments and results, see `Signature`."""
    outputs = []
    for i in range(f.n_out()):
        pattern = f.sparsity_out(i)
        shape = list(pattern.shape)
        outputs.append(shape if pattern.is_dense() else [*shape, pattern.colind(), pattern.row()])
    return {"inputs": [f.nnz_in(i) for i in range(f.n_in())], "outputs": outputs, "matrices": matrices}


def with_tangents(equations: Stage) -> Stage:
    """Return the same equations with the tangents of implicit methods, at fixed a and lam.

    tangents(q, v, a, lam, u, p, t): Rq, Rv (n, n), Xq, Xv (l, n), Rt (n,), derivatives by q, v and t of the residuals R
    = F - M a - C' lam of (4) and X = xi - C a of (3); if there are states x, also Rx (n, x) of R, and Gq, Gv, Gx of
    their rates.
    """
    if "tangents" in equations.signatures:
        return equations
    return with_functions(equations, {"tangents": shared("tangents", *_tangents(equations))})


def tangents_once(equations: Equations) -> ca.Function:
    """Return the function of `with_tangents` for a few evaluations, without the slow search for
    common subexpressions."""
    return equations.functions.get("tangents") or ca.Function("tangents", *_tangents(equations))


def _tangents(equations: Equations) -> tuple[list[ca.SX], list[ca.SX]]:
    e, x = equations, symbols(equations)
    q, v, a, lam, u, p, t = (x[k] for k in ("q", "v", "a", "lam", "u", "p", "t"))
    R = e.f(q, v, u, p, t) - e.d(q, v, p) - e.M(q, p) @ a - e.C(q, p).T @ lam
    X = e.xi(q, v, p) - e.C(q, p) @ a
    values = [ca.jacobian(R, q), ca.jacobian(R, v), ca.jacobian(X, q), ca.jacobian(X, v), ca.jacobian(R, t)]
    if e.states:
        rates, inputs = e.state_rates(q, v, u, p, t), len(e.inputs)
        values += [ca.jacobian(R, u)[:, inputs:], ca.jacobian(rates, q), ca.jacobian(rates, v)]
        values.append(ca.jacobian(rates, u)[:, inputs:])
    return [q, v, a, lam, u, p, t], list(map(ca.densify, values))
