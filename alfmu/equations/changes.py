"""Derivatives of the equations that analyses take; no scene carries them."""

from __future__ import annotations

import casadi as ca

from .evaluation import ARGUMENTS, symbols
from .types import Equations

__all__ = ["changes", "value"]


def changes(equations: Equations) -> dict[str, ca.Function]:
    """Functions of derivatives by name, made once for these equations.

    With R = F - M a - C' lam and X = xi - C a, what (4) and (3) lack: tangents(q, v, a, lam, u, p, t): Rq, Rv (n, n),
    Xq, Xv (l, n); inputs(q, v, a, lam, u, p, t): Ru, Xu. turned(w, q, u, p, t): derivative (l, n) by q of C w, for w
    (n,). readings(q, v, a, lam, u, p, t): derivatives of all outputs by q, v, a, lam, u. rates(q, v, u, p, t): those of
    the rates of further states by q, v, u, where u are the inputs and behind them these states. And what a place alone
    tells, place(q, u, p, t): C (l, n) dense, Phi, and at rest f, the rates of further states, and their derivative by
    these.
    """
    known = equations.programs
    if "changes" not in known:
        e, x = equations, symbols(equations)
        w = ca.SX.sym("w", e.n)
        q, v, a, lam, u, p, t = (x[letter] for letter in ("q", "v", "a", "lam", "u", "p", "t"))
        M, C = value(e, "M", x), value(e, "C", x)
        R = value(e, "f", x) - value(e, "d", x) - M @ a - C.T @ lam
        X, y = value(e, "xi", x) - C @ a, value(e, "readings", x)
        state = {"q": q, "v": v, "a": a, "lam": lam, "u": u, "p": p, "t": t}
        turned = {"w": w, "q": q, "u": u, "p": p, "t": t}
        x_dot = value(e, "state_rates", x)
        rates = {"q": q, "v": v, "u": u, "p": p, "t": t}
        still = {**x, "v": ca.SX.zeros(e.n)}
        at_rest = ca.substitute(x_dot, v, still["v"])
        by_x = ca.jacobian(at_rest, u)[:, len(e.inputs) :]
        place = {"q": q, "u": u, "p": p, "t": t}
        made = {
            "tangents": (state, [ca.jacobian(each, by) for each in (R, X) for by in (q, v)]),
            "inputs": (state, [ca.jacobian(R, u), ca.jacobian(X, u)]),
            "turned": (turned, [ca.jacobian(C @ w, q)]),
            "rates": (rates, [ca.jacobian(x_dot, each) for each in (q, v, u)]),
            "place": (place, [ca.densify(C), value(e, "Phi", x), value(e, "f", still), at_rest, ca.densify(by_x)]),
            "readings": (state, [ca.jacobian(y, each) for each in (q, v, a, lam, u)]),
        }
        known["changes"] = {
            name: ca.Function(name, list(arguments.values()), values, list(arguments), _results(values))
            for name, (arguments, values) in made.items()
        }
    return known["changes"]


def _results(values: list[ca.SX]) -> list[str]:
    return [f"result{i}" for i in range(len(values))]


def value(equations: Equations, name: str, known: dict[str, ca.SX]) -> ca.SX:
    """A function of the equations at symbols, or numbers, that are known by letter."""
    return equations.functions[name](*(known[letter] for letter in ARGUMENTS[name]))
