"""Trace the method, RK4 and the projections over a mechanism's equations into flat, sparse functions.

What the oracle does with loops that stop on convergence is unrolled here a fixed number of times, and each function
says whether that was enough; where it was not, the caller takes the oracle's path. Only what the scene needs is traced:
no multiplier iteration without constraints, no least-norm pass without redundant rows, no work where nothing works.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import casadi as ca

from .. import method
from ..assembly import Mobility
from ..equations import Equations
from ..integrators import rk4
from ..oracle import symbols
from .machine import Layout

__all__ = ["Plan", "trace_instant", "trace_step", "traced", "untraced"]

FUNCTIONS = ("step", "step_careful", "instant")
"""Names of the traced functions among those of the equations."""

CAREFUL = 5
"""Multiplier iterations of the careful step: enough from the default penalty down to 1e4 masses."""


@dataclass(frozen=True)
class Plan:
    """How often the loops of the method are unrolled, and how it is judged whether that was enough."""

    iterations: int
    """Of multipliers in each evaluation."""
    corrections: int
    """Of q, and of v, after the step."""
    freedom: int | None
    """Degrees of freedom at a regular position: more pivots than these that are small say that a position is nearly
    singular, where two iterations are too few. None: the last change of the accelerations tells instead."""


def traced(equations: Equations, mobility: Mobility | None) -> Equations:
    """The same equations with the functions of the kernel; `mobility`: what is known of constraints and freedoms."""
    e = equations
    redundant = mobility is None or mobility.redundant > 0
    careful = Plan(CAREFUL, 3, None) if e.l else Plan(1, 0, None)
    # Each iteration gains the ratio of penalty to mass, so two reach round-off at a regular position.
    quick = Plan(2, 1, mobility.freedom) if mobility and e.l else careful
    kernel = trace_step(e, quick), trace_step(e, careful), trace_instant(e, careful, redundant)
    unrolled = [[plan.iterations, plan.corrections] for plan in (quick, careful)]
    return replace(e, functions={**e.functions, **dict(zip(FUNCTIONS, kernel, strict=True))}, unrolled=unrolled)


def untraced(equations: Equations) -> Equations:
    """The same equations without the functions of the kernel."""
    functions = {name: f for name, f in equations.functions.items() if name not in FUNCTIONS}
    return replace(equations, functions=functions, unrolled=[])


def trace_step(equations: Equations, plan: Plan) -> ca.Function:
    """step(z, u, p, k, dt): z (see `Layout`) after one internal step [s] of RK4 with projection.

    u (inputs), p (parameters), k = [alpha, tolerance].
    """
    e = equations
    layout, (z, u, p, k), scene = _begin(e, plan)
    dt = ca.SX.sym("dt")
    t = z[layout.time]

    def rate(t: ca.SX, y: ca.SX) -> ca.SX:
        q, v = y[: e.n], y[e.n : 2 * e.n]
        a, _, _ = scene.accelerations(q, v, t)
        power = e.input_power(q, v, u, p, t) + e.other_power(q, v, p, t) if e.works else 0
        return ca.vertcat(v, a, power)

    y = rk4(rate, t, ca.vertcat(z[: 2 * e.n], z[layout.work]), dt)
    q, v = scene.projected(y[: e.n], y[e.n : 2 * e.n])
    angles = scene.unwrapped(q, z[2 * e.n : layout.work])
    after = ca.vertcat(q, v, angles, y[2 * e.n], t + dt, z[layout.trouble] + scene.trouble())
    return ca.Function("step", [z, u, p, k, dt], [after], {"cse": True})


def trace_instant(equations: Equations, plan: Plan, redundant: bool) -> ca.Function:
    """instant(z, u, p, k): what a user can read, largest |Phi|, |Phi-dot|, energy; largest |Phi-ddot|; trouble."""
    e = equations
    layout, (z, u, p, k), scene = _begin(e, plan)
    q, v, angles, t = z[: e.n], z[e.n : 2 * e.n], z[2 * e.n : layout.work], z[layout.time]
    a, lam, solve = scene.accelerations(q, v, t)
    C = e.C(q, p)
    if redundant and e.l:
        lam = method.minimum_norm(C, scene.unity, solve, lam, 2, lambda change, value: False)
    readings = e.readings(q, v, a, lam / scene.scale, u, p, t)
    for row, angle in zip(scene.wrapped_rows, ca.vertsplit(scene.unwrapped(q, angles)), strict=False):
        readings[row] = angle
    position, velocity, acceleration = (
        ca.mmax(ca.fabs(x)) if e.l else ca.SX(0) for x in (e.Phi(q, p), C @ v, C @ a - e.xi(q, v, p))
    )
    energy = e.kinetic_energy(q, v, p) + e.potential_energy(q, p)
    seen = ca.vertcat(readings, position, velocity, energy, acceleration, scene.trouble())
    return ca.Function("instant", [z, u, p, k], [seen], {"cse": True})


def _begin(e: Equations, plan: Plan) -> tuple[Layout, tuple[ca.SX, ...], _Scene]:
    layout, s = Layout(e.n, len(e.wrapped)), symbols(e)
    z, k = ca.SX.sym("z", layout.size), ca.SX.sym("k", 2)
    return layout, (z, s["u"], s["p"], k), _Scene(e, plan, s["u"], s["p"], k)


class _Scene:
    """The method with symbols; it collects what its unrolled loops must have reached."""

    def __init__(self, equations: Equations, plan: Plan, u: ca.SX, p: ca.SX, k: ca.SX):
        self.e, self.plan, self.u, self.p = equations, plan, u, p
        alpha, self.tolerance = k[0], k[1]
        # Equation (4) divided by alpha, so that no product with it is left: M / alpha, F / alpha, lam / alpha.
        self.scale = 1 / alpha
        self.unity = ca.SX.eye(equations.l)
        self.pivots: list[ca.SX] = []
        self.small: list[ca.SX] = []
        self.sizes: list[ca.SX] = []
        self.changes: list[ca.SX] = []
        self.residues: list[ca.SX] = []
        names = [o.name for o in equations.outputs]
        self.wrapped_rows = [names.index(name) for name in equations.wrapped]

    def trouble(self) -> ca.SX:
        """Number of failed checks; each is a comparison that NaN fails."""
        limit, size = self.tolerance, sum(self.sizes, ca.SX(0))
        checks = [ca.mmin(ca.vertcat(*self.pivots)) > 0]
        checks += [ca.sumsqr(residue) <= limit**2 for residue in self.residues]
        if not self.e.l:
            checks.append(size < math.inf)
        elif self.plan.freedom is None:
            checks.append(sum(self.changes, ca.SX(0)) <= limit**2 * size + _TINY)
        else:
            # What is left after the last change is that change times its ratio to the first one, which is about a.
            checks.append(sum(self.changes, ca.SX(0)) <= limit * size + _TINY)
            checks += [small <= self.plan.freedom for small in self.small]
        return sum((1 - check for check in checks), ca.SX(0))

    def accelerations(self, q: ca.SX, v: ca.SX, t: ca.SX) -> tuple[ca.SX, ca.SX, method.Solve]:
        """a, lam (times `scale`) and what solves with H (times `scale`)."""
        e, p, changes = self.e, self.p, []
        M, C, xi = self.scale * e.M(q, p), e.C(q, p), e.xi(q, v, p)
        F = self.scale * (e.f(q, v, self.u, p, t) - e.d(q, v, p))
        solve = self._factor(method.augmented_mass(M, C, self.unity))

        def watch(da: ca.SX, a: ca.SX) -> bool:
            changes.append(da)
            return False

        zeros = ca.SX(e.n, 1), ca.SX(e.l, 1)
        a, lam, _, _ = method.residual(M, F, C, xi, self.unity, solve, *zeros, self.plan.iterations, watch)
        self.changes.append(ca.sumsqr(changes[-1]))
        if not (self.sizes and self.plan.freedom is not None):
            self.sizes.append(ca.sumsqr(a))
        return a, lam, solve

    def projected(self, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Corrections (10) of q and v, as many of each."""
        e, p = self.e, self.p
        if not e.l:
            return q, v
        for _ in range(self.plan.corrections):
            q = q + self._correction(q, e.C(q, p), e.Phi(q, p))
        C = e.C(q, p)
        solve = self._factor(method.augmented_mass(self.scale * e.M(q, p), C, self.unity), judged=False)
        for _ in range(self.plan.corrections):
            v = v + method.project(C, self.unity, solve, C @ v)
        self.residues += [e.Phi(q, p), C @ v]
        return q, v

    def _correction(self, q: ca.SX, C: ca.SX, Phi: ca.SX) -> ca.SX:
        H = method.augmented_mass(self.scale * self.e.M(q, self.p), C, self.unity)
        return method.project(C, self.unity, self._factor(H, judged=False), Phi)

    def unwrapped(self, q: ca.SX, near: ca.SX) -> ca.SX:
        e, nothing = self.e, ca.SX(self.e.n, 1)
        if not self.wrapped_rows:
            return ca.SX(0, 1)
        raw = e.readings(q, nothing, nothing, ca.SX(e.l, 1), self.u, self.p, 0)[self.wrapped_rows]
        return raw + 2 * ca.pi * ca.floor((near - raw) / (2 * ca.pi) + 0.5)

    def _factor(self, H: ca.SX, judged: bool = True) -> method.Solve:
        """Sparse LDL' with a fill-reducing order; its pivots must be positive, and few of them small."""
        D, L, order = ca.ldl(H, True)
        self.pivots.append(ca.mmin(D))
        if judged and self.plan.freedom is not None:
            diagonal = ca.diag(H)[order]
            self.small.append(sum((D[i] < _SMALL * diagonal[i] for i in range(D.numel())), ca.SX(0)))
        return lambda b: ca.ldl_solve(b, D, L, order)


_SMALL = 1e-3
"""Pivot over diagonal entry of H below which two iterations may be too few. Above it an iteration gains a factor of 1e5
or more at the default penalty, so that a last change within the square root of the tolerance leaves 3e-12 at most."""

_TINY = 1e-300
"""Lets a mechanism at rest pass the check of convergence."""
