"""Derivatives of the equations for analyses; no scene contains them."""

import casadi as ca

from ..model.kept import once
from ..model.motion import COEFFICIENTS
from .evaluation import ARGUMENTS, symbols
from .types import Equations

LEVELS = 3
"""Value, rate and acceleration of a signal, on which accelerations and reactions depend."""


def signal_numbers(equations: Equations) -> list[int]:
    """Return indices in p of the numbers of each signal: `since`, then the coefficients of its polynomial."""
    e, length = equations, 1 + COEFFICIENTS
    end = len(e.parameters) + len(e.held)
    return [end - length * (len(e.followed) - k) for k in range(len(e.followed))]


@once
def changes(equations: Equations) -> dict[str, ca.Function]:
    """Return functions of derivatives by name, cached with these equations.

    R = F - M a - C' lam and X = xi - C a are the residuals of (4) and (3); u holds the inputs, then the states.

    * tangents(q, v, a, lam, u, p, t): Rq, Rv (n, n), Xq, Xv (l, n).
    * inputs(q, v, a, lam, u, p, t): Ru, Xu.
    * turned(w, q, u, p, t): derivative (l, n) of C w by q, for w (n,).
    * turning(q, v, u, p, t): derivative (l, n) of C v + Phi_t by q.
    * readings(q, v, a, lam, u, p, t): derivatives of all outputs by q, v, a, lam, u.
    * shares(q, v, a, lam, u, p, t): the same of the condition for least loads of joints.
    * rates(q, v, u, p, t): derivatives of the rates of states by q, v, u.
    * place(q, u, p, t): C (l, n) dense, Phi, and at rest f, the rates of states, and their derivative by the states.

    If there are signals, signals(q, v, a, lam, u, p, t): derivatives of Phi, C v + Phi_t, R, X, the outputs, the rates
    of states and shares by `LEVELS` coefficients of each polynomial, the constant one first. If there is dry friction,
    rubbing(q, v, a, lam, u, p, t): derivatives of its multipliers by q, v, a, lam, u, and by these coefficients. If
    time is a coordinate, moving(q, p): Phi_t, xi at rest, the kinetic energy of the prescribed motion and its second
    rate, each zero if nothing is prescribed.
    """
    e, x = equations, symbols(equations)
    w = ca.SX.sym("w", e.n)
    q, v, a, lam, u, p, t = (x[letter] for letter in ("q", "v", "a", "lam", "u", "p", "t"))
    M, C = value(e, "M", x), value(e, "C", x)
    R = value(e, "f", x) - value(e, "d", x) - M @ a - C.T @ lam
    X, y, shares = value(e, "xi", x) - C @ a, value(e, "readings", x), value(e, "shares", x)
    state = {"q": q, "v": v, "a": a, "lam": lam, "u": u, "p": p, "t": t}
    place = {"q": q, "u": u, "p": p, "t": t}
    x_dot, Phi_dot = value(e, "state_rates", x), value(e, "Phi_dot", x) if e.timed else C @ v
    rates = {"q": q, "v": v, "u": u, "p": p, "t": t}
    # At rest, time advances at the rate 1.
    rest = ca.vertcat(ca.SX.zeros(e.dependent), ca.SX.ones(int(e.timed)))
    still = {**x, "v": rest}
    at_rest = ca.substitute(x_dot, v, rest)
    by_x = ca.jacobian(at_rest, u)[:, len(e.inputs) :]
    made = {
        "tangents": (state, [ca.jacobian(each, by) for each in (R, X) for by in (q, v)]),
        "inputs": (state, [ca.jacobian(R, u), ca.jacobian(X, u)]),
        "turned": ({"w": w, **place}, [ca.jacobian(C @ w, q)]),
        "turning": (rates, [ca.jacobian(Phi_dot, q)]),
        "rates": (rates, [ca.jacobian(x_dot, each) for each in (q, v, u)]),
        "place": (place, [ca.densify(C), value(e, "Phi", x), value(e, "f", still), at_rest, ca.densify(by_x)]),
        "readings": (state, [ca.jacobian(y, each) for each in (q, v, a, lam, u)]),
        "shares": (state, [ca.jacobian(shares, each) for each in (q, v, a, lam, u)]),
    }
    levels = [p[begin + 1 + k] for begin in signal_numbers(e) for k in range(LEVELS)]
    signals = ca.vertcat(*levels) if levels else ca.SX(0, 1)
    if e.followed:
        moving = value(e, "Phi", x), Phi_dot, R, X, y, x_dot, shares
        made["signals"] = (state, [ca.jacobian(each, signals) for each in moving])
    if e.frictions:
        laws = value(e, "rubbing", x)[: len(e.frictions)]
        made["rubbing"] = (state, [ca.jacobian(laws, each) for each in (q, v, a, lam, u, signals)])
    if e.timed:
        T = value(e, "kinetic_energy", still)
        second = ca.jacobian(ca.jacobian(T, q[-1]), q[-1])
        made["moving"] = ({"q": q, "p": p}, [value(e, "Phi_dot", still), value(e, "xi", still), T, second])
    return {
        name: ca.Function(name, list(arguments.values()), values, list(arguments), _results(values))
        for name, (arguments, values) in made.items()
    }


def _results(values: list[ca.SX]) -> list[str]:
    return [f"result{i}" for i in range(len(values))]


def value(equations: Equations, name: str, known: dict[str, ca.SX]) -> ca.SX:
    """Return a function of the equations evaluated at the symbols or numbers in `known`, by letter."""
    return equations.functions[name](*(known[letter] for letter in ARGUMENTS[name]))
