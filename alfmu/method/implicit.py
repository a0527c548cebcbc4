"""Implicit forms of a mechanism's equations: tangents, and the reduced linear systems of implicit methods.

State (q, v), rate (v, a(q, v, u, t)) with a from the augmented Lagrangian, so for constraints of any rank. Its tangent
is J = [[0, I], [aq, av]] with aq, av (n, n) the derivatives of a. Written for NumPy arrays and for symbols alike, as
`formulations` is: `solve` applies the inverse of H, `divide(A, b)` the inverse of A. Letters are those of
`formulations`; R = F - M a - C' lam and X = xi - C a are the residuals of (4) and (3), and Rq, Rv, Xq, Xv their
derivatives at fixed a and lam (`alfmu.equations.evaluation.tangents`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from . import formulations as method
from .stepping import RADAU9, Collocation, combined

Array = Any
Divide = Callable[[Array, Array], Array]


# First order: collocation by accelerations alone; the kernel stores a tangent as H, Q, V of `stiffness` ---------------


def tangent(
    M: Array,
    C: Array,
    alpha: Array,
    solve: method.Solve,
    R: Array,
    X: Array,
    zeros: tuple[Array, Array],
    most: int,
    done: method.Done,
) -> Array:
    """Return derivatives of a (n, k) from those of R (n, k) and X (l, k) at fixed a and lam, by (8).

    The iteration starts at `zeros`, (n, k) and (l, k).
    """
    return method.residual(M, R, C, X, alpha, solve, *zeros, most, done)[0]


def stiffness(H: Array, C: Array, alpha: Array, Rq: Array, Rv: Array, Xq: Array, Xv: Array) -> tuple[Array, ...]:
    """Return H, Q, V (n, n) with H da = Q dq + V dv: (8) for small changes, up to a relative error of mass / alpha.

    Newton's method needs no better tangent: its own residual is of that size.
    """
    weighted = C.T @ alpha
    return H, Rq + weighted @ Xq, Rv + weighted @ Xv


def at_node(rule: Collocation, i: int, dt: Array, q: Array, v: Array, a: Sequence[Array]) -> tuple[Array, Array]:
    """Return q and v at node i of a collocation step from q and v at its start and the accelerations at all nodes."""
    return q + dt * (rule.nodes[i] * v + dt * combined(_squared(rule)[i], a)), v + dt * combined(rule.matrix[i], a)


def stage_weights(rule: Collocation, dt: Array) -> list[list[list[Array]]]:
    """Return the weights of H, Q, V of each node in the matrix of a collocation step."""
    nodes = range(len(rule.nodes))
    eye = [[float(i == j) for j in nodes] for i in nodes]
    first, second = ([[x * w for w in row] for row in A] for x, A in ((-dt, rule.matrix), (-dt * dt, _squared(rule))))
    return [eye, second, first]


def filter_weights(s: Array) -> list[list[list[Array]]]:
    """Return the weights of H, Q, V in the matrix of (I - s J)^-1, for (H - s V - s^2 Q) dv = H rv + s Q rq."""
    return [[[1.0]], [[-s * s]], [[-s]]]


def _squared(rule: Collocation) -> list[list[float]]:
    A, nodes = rule.matrix, range(len(rule.nodes))
    return [[sum(A[i][k] * A[k][j] for k in nodes) for j in nodes] for i in nodes]


# Beside singular positions ------------------------------------------------------------------------------------


def return_map(C: Array, alpha: Array, solve: method.Solve, Xv: Array, eye: Array, passes: int) -> tuple[Array, Array]:
    """Return T, S (n, n), which project displacements from a branch back onto it: dq -> T dq, dv -> T dv + S dq.

    T projects onto the motions that satisfy the constraints; S corrects v for the rotation of the constraints: with
    xi quadratic in v, (dC) v = -Xv T dq / 2.
    """
    T, S = eye, 0 * eye
    for _ in range(passes):
        T = T - solve(C.T @ (alpha @ (C @ T)))
    turned = Xv @ T / 2
    for _ in range(passes):
        S = S + solve(C.T @ (alpha @ (turned - C @ S)))
    return T, S


def on_branch(aq: Array, av: Array, T: Array, S: Array) -> tuple[Array, Array]:
    """Return aq and av of the accelerations on the branch with respect to displacements that may leave it."""
    return aq @ T + av @ S, av @ T


# Second order: Newmark's family on positions ----------------------------------------------------------------------


@dataclass(frozen=True)
class Newmark:
    """A member of the generalised-alpha family (Chung and Hulbert 1993; for constraints, Arnold and Bruels 2007).

    (1 - m) w1 + m w0 = (1 - f) a1 + f a0 for the accelerations w that positions and velocities are integrated from:
    q1 = q0 + dt v0 + dt^2 ((1/2 - beta) w0 + beta w1), v1 = v0 + dt ((1 - gamma) w0 + gamma w1).
    """

    m: float
    f: float
    beta: float
    gamma: float

    @property
    def name(self) -> str:
        """Return a name that identifies the rule and its parameters."""
        return f"newmark {self.m} {self.f}"


TRAPEZOIDAL = Newmark(0.0, 0.0, 0.25, 0.5)
"""No damping (Bayo and Ledesma 1996)."""


def damped(radius: float) -> Newmark:
    """Return the member of order 2 with this spectral radius (0 to 1) at infinite frequency and least damping below."""
    m, f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
    gamma = 0.5 + f - m
    return Newmark(m, f, (gamma + 0.5) ** 2 / 4, gamma)


DAMPED = 0.8
"""Spectral radius at infinite frequency of `generalized_alpha`."""

CONVERGED = 1e-12
"""Last change of Newton's method in the index-3 form, over the coordinates."""

RULES: dict[str, Collocation | Newmark] = {
    "stiff": RADAU9,
    "trapezoidal": TRAPEZOIDAL,
    "generalized_alpha": damped(DAMPED),
}
"""Methods that need tangents of the equations (`alfmu.equations.evaluation.with_tangents`), by name."""


def moved(rule: Newmark, dt: Array, q: Array, v: Array, w: Array, a: Array, change: Array) -> tuple:
    """Return q, v, w after a step in which the accelerations change from a to a + change."""
    after = ((1 - rule.f) * (a + change) + rule.f * a - rule.m * w) / (1 - rule.m)
    q = q + dt * v + dt * dt * ((0.5 - rule.beta) * w + rule.beta * after)
    return q, v + dt * ((1 - rule.gamma) * w + rule.gamma * after), after


def changes(rule: Newmark, dt: Array) -> tuple[Array, Array]:
    """Return dv1/dq1 = gamma / (beta dt) and da1/dq1 = (1 - m) / (beta dt^2 (1 - f))."""
    return rule.gamma / (rule.beta * dt), (1 - rule.m) / (rule.beta * dt * dt * (1 - rule.f))


def position_weights(rule: Newmark, dt: Array) -> list[list[list[Array]]]:
    """Return the weights of H, Rq, Rv in the matrix of `position_step`."""
    by_v, by_a = changes(rule, dt)
    return [[[1.0]], [[-1 / by_a]], [[-by_v / by_a]]]


def position_step(
    M: Array,
    C: Array,
    Phi: Array,
    R: Array,
    Rq: Array,
    Rv: Array,
    alpha: Array,
    rule: Newmark,
    dt: Array,
    divide: Divide,
) -> tuple[Array, Array]:
    """Return one Newton iteration on the positions q1 of a step: changes of q1 and of lam [N, N.m].

    Index-3 augmented Lagrangian (Bayo and Ledesma 1996, Cuadrado et al. 1997) in residual form: R = F - M a - C' lam
    and Phi at the present iterate; all scaled with the square of the step, so that alpha [kg, kg.m2] is that of (8).
    """
    by_v, by_a = changes(rule, dt)
    inertia = M - (by_v / by_a) * Rv - Rq / by_a
    dq = divide(inertia + C.T @ alpha @ C, R / by_a - C.T @ (alpha @ Phi))
    return dq, by_a * (alpha @ (Phi + C @ dq))
