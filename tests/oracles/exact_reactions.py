"""Reactions by exact arithmetic: functions of equations in 50 digits, positions closed, constraints by elimination.

Nothing of the method is used: no penalty, no iteration for multipliers, no limits. Dependent rows are found by
elimination with complete pivoting, and reactions of least norm in the space that it leaves.
"""

import operator
from functools import lru_cache

import casadi as ca
import numpy as np
from mpmath import mp, mpf

import alfmu

DIGITS = 50
DEPENDENT = mpf(10) ** -25
"""A pivot below it, over the largest entry, is round-off."""

_BINARY = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_POW: operator.pow,
    ca.OP_CONSTPOW: operator.pow,
    ca.OP_ATAN2: mp.atan2,
    ca.OP_FMIN: min,
    ca.OP_FMAX: max,
    ca.OP_LT: lambda a, b: mpf(a < b),
    ca.OP_LE: lambda a, b: mpf(a <= b),
    ca.OP_EQ: lambda a, b: mpf(a == b),
    ca.OP_NE: lambda a, b: mpf(a != b),
    ca.OP_AND: lambda a, b: mpf(bool(a) and bool(b)),
    ca.OP_OR: lambda a, b: mpf(bool(a) or bool(b)),
    ca.OP_IF_ELSE_ZERO: lambda a, b: b if a else mpf(0),
    ca.OP_COPYSIGN: lambda a, b: abs(a) if b >= 0 else -abs(a),
    ca.OP_HYPOT: mp.hypot,
}
_UNARY = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: operator.neg,
    ca.OP_SIN: mp.sin,
    ca.OP_COS: mp.cos,
    ca.OP_TAN: mp.tan,
    ca.OP_ASIN: mp.asin,
    ca.OP_ACOS: mp.acos,
    ca.OP_ATAN: mp.atan,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_SQRT: mp.sqrt,
    ca.OP_FABS: abs,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_EXP: mp.exp,
    ca.OP_LOG: mp.log,
    ca.OP_TANH: mp.tanh,
    ca.OP_SIGN: mp.sign,
    ca.OP_NOT: lambda a: mpf(not a),
    ca.OP_FLOOR: mp.floor,
}


@lru_cache(100)
def instructions(f: ca.Function) -> list[tuple[int, list[int], list[int], mpf | None]]:
    """Operation, outputs, inputs and constant of each instruction, which take longer to ask for than to do."""
    found = []
    for k in range(f.n_instructions()):
        op = f.instruction_id(k)
        constant = mpf(f.instruction_constant(k)) if op == ca.OP_CONST else None
        found.append((op, f.instruction_output(k), f.instruction_input(k), constant))
    return found


def evaluated(f: ca.Function, *arguments: object) -> list[np.ndarray]:
    """Dense results of a function in the present precision."""
    w = [mpf(0)] * f.sz_w()
    given = [[mpf(x) for x in np.atleast_1d(a).ravel()] for a in arguments]
    nonzeros = [[mpf(0)] * f.nnz_out(i) for i in range(f.n_out())]
    for op, out, ins, constant in instructions(f):
        if op == ca.OP_INPUT:
            w[out[0]] = given[ins[0]][ins[1]]
        elif op == ca.OP_OUTPUT:
            nonzeros[out[0]][out[1]] = w[ins[0]]
        elif op == ca.OP_CONST:
            w[out[0]] = constant
        elif op in _UNARY:
            w[out[0]] = _UNARY[op](w[ins[0]])
        else:
            w[out[0]] = _BINARY[op](w[ins[0]], w[ins[1]])
    results = []
    for i, values in enumerate(nonzeros):
        pattern = f.sparsity_out(i)
        dense = np.full(pattern.shape, mpf(0), object)
        for row, column, value in zip(*pattern.get_triplet(), values, strict=True):
            dense[row, column] = value
        results.append(dense)
    return results


def solved(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One solution of consistent equations A x = b, and a basis (columns) of what A does not see."""
    count = A.shape[1]
    both = np.hstack([A, np.reshape(b, (-1, 1))])
    scale = [max(abs(x) for x in row) or mpf(1) for row in A]
    both = np.array([row / s for row, s in zip(both, scale, strict=True)])
    R, rows, columns = eliminated(both, count)
    x, free = np.full(count, mpf(0), object), [k for k in range(count) if k not in columns]
    kernel = np.full((count, len(free)), mpf(0), object)
    for row, column in zip(rows, columns, strict=True):
        x[column] = R[row, count]
        kernel[column] = -R[row, free]
    for k, column in enumerate(free):
        kernel[column, k] = mpf(1)
    return x, kernel


def eliminated(A: np.ndarray, count: int) -> tuple[np.ndarray, list[int], list[int]]:
    """The reduced echelon form of A, with complete pivoting in its first columns; rows and columns of pivots."""
    A, rows, columns = A.copy(), [], []
    while len(rows) < len(A):
        free = [i for i in range(len(A)) if i not in rows]
        sizes = np.abs(A[free, :count].astype(float))
        sizes[:, columns] = 0.0
        row, column = free[int(np.argmax(sizes)) // count], int(np.argmax(sizes)) % count
        if not abs(A[row, column]) > DEPENDENT:
            break
        A[row] = A[row] / A[row, column]
        there = np.flatnonzero(A[row])
        for i in range(len(A)):
            if i != row and A[i, column]:
                A[i, there] -= A[row, there] * A[i, column]  # a number before an array is 20 times slower
        rows.append(row)
        columns.append(column)
    return A, rows, columns


def exact(i: alfmu.Instance) -> dict[str, mpf]:
    """Reactions at the place of an instance: its independent coordinates and rates are kept, the others are closed."""
    with mp.workdps(DIGITS):
        e = i.equations
        q, v = ([mpf(float(x)) for x in y] for y in (i.q, i.v))
        p = [mpf(float(x)) for x in i.memory["p"]]
        u = [mpf(float(i.get(x.name))) for x in e.inputs]
        s, t = [mpf(0)] * len(e.starts), mpf(float(i.time))
        q, v, p = np.array(q, object), np.array(v, object), np.array(p, object)
        [C], [T] = evaluated(e.functions["C"], q, p), evaluated(e.functions["ties_matrix"], q, p, s)
        _, kernel = solved(np.vstack([C, T]), np.full(len(C) + len(T), mpf(0), object))
        kept = [int(np.argmax(np.abs(each))) for each in kernel.T]  # freedoms that no start value determines
        own, [ties] = q[kept], evaluated(e.functions["ties"], q, p, s)
        for _ in range(12):
            [C], [Phi] = evaluated(e.functions["C"], q, p), evaluated(e.functions["Phi"], q, p)
            [T], [now] = evaluated(e.functions["ties_matrix"], q, p, s), evaluated(e.functions["ties"], q, p, s)
            T = np.vstack([T, np.eye(e.n, dtype=int)[kept] * mpf(1)])
            gaps = np.concatenate([Phi.ravel(), (now - ties).ravel(), q[kept] - own])
            change, _ = solved(np.vstack([C, T]), -gaps)
            q = q + change
            if max(abs(change)) < mpf(10) ** -(DIGITS - 8):
                break
        else:
            raise AssertionError("not closed")
        v, _ = solved(np.vstack([C, T]), np.concatenate([np.full(len(C), mpf(0), object), T @ v]))
        [M], [d], [f] = (
            evaluated(e.functions[k], *x) for k, x in (("M", (q, p)), ("d", (q, v, p)), ("f", (q, v, u, p, t)))
        )
        [xi] = evaluated(e.functions["xi"], q, v, p)
        n, F = e.n, (f - d).ravel()
        both = np.vstack([np.hstack([M, C.T]), np.hstack([C, np.full((len(C), len(C)), mpf(0), object)])])
        x, kernel = solved(both, np.concatenate([F, xi.ravel()]))
        a, lam, free = x[:n], x[n:], kernel[n:]

        def shares(lam: np.ndarray) -> np.ndarray:
            return evaluated(e.functions["shares"], q, v, a, lam, u, p, t)[0].ravel()

        if free.shape[1]:
            here = shares(lam)
            P = np.array([shares(lam + each) - here for each in free.T]).T
            change, _ = solved(free.T @ P, -free.T @ here)
            lam = lam + free @ change
        [y] = evaluated(e.functions["readings"], q, v, a, lam, u, p, t)
        return {o.name: x for o, x in zip(e.outputs, y.ravel(), strict=True) if o.unit in ("N", "N.m")}
