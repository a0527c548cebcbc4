"""Trace the method, RK4 and the projections over a mechanism's equations into flat, sparse functions.

What the oracle does with loops that stop on convergence is unrolled here a fixed number of times, and each step says
whether that was enough; where it was not, the caller takes the careful step, then the oracle's path. Only what the
scene needs is traced: no multiplier iteration without constraints, no least-norm pass without redundant rows, no
reaction equation where no reaction is read, no work where nothing works.

A step is a program (`alfmu.kernel.program`) of small functions: `stage` combines rates into the state of a stage,
`rate` holds the method, `place` and `settle` correct q and v (10), `close` judges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import casadi as ca

from .. import method
from ..assembly import Mobility
from ..equations import Equations
from ..evaluation import symbols, with_functions
from ..integrators import rk4
from .program import SETTINGS, Layout, Program

__all__ = ["Plan", "traced", "untraced"]

CAREFUL = 5
"""Multiplier iterations of the careful step: enough from the default penalty down to 1e4 masses."""

MONITORED = ("monitor.position_error", "monitor.velocity_error", "monitor.energy", "monitor.iterations")
"""Monitors that `instant` computes, in this order."""

_SMALL = 1e-3
"""Pivot over diagonal entry of H below which two iterations may be too few. Above it an iteration gains a factor of 1e5
or more at the default penalty, so that a last change within the square root of the tolerance leaves 3e-12 at most."""

_TINY = 1e-300
"""Lets a mechanism at rest pass the check of convergence."""

_ROUND_OFF = 8 * 2.0**-52
"""Of a constraint, over its coordinates."""


@dataclass(frozen=True)
class Plan:
    """How often the loops of the method are unrolled in a step, and how it is judged whether that was enough."""

    name: str
    iterations: int
    """Of multipliers in each evaluation."""
    corrections: int
    """Of q, and of v, after the step."""
    freedom: int | None = None
    """Degrees of freedom at a regular position: more pivots than these that are small say that a position is nearly
    singular, where few iterations are too few. None: the last change of the accelerations alone tells."""
    weighted: bool = False
    """Whether each constraint may have a penalty of its own."""


def traced(equations: Equations, mobility: Mobility | None, iterations: int = 2) -> Equations:
    """The same equations with the functions of the kernel.

    `mobility` is what is known of constraints and freedoms, `iterations` how many multiplier iterations reach round-off
    at a regular position.
    """
    e = untraced(equations)
    redundant = mobility is None or mobility.redundant > 0
    careful = Plan("careful", CAREFUL, 3, weighted=True) if e.l else Plan("careful", 1, 0)
    plans = [careful, careful]
    if mobility and e.l and iterations < CAREFUL:
        plans[0] = Plan("quick", iterations, 1, mobility.freedom)
    functions = {"instant": _instant(e, careful, redundant)}
    programs = []
    for plan in plans:
        program, needed = _step(e, plan)
        programs.append(program)
        functions |= needed
    return replace(with_functions(e, functions), kernel=programs)


def untraced(equations: Equations) -> Equations:
    """The same equations without the functions of the kernel."""
    if not equations.kernel:
        return equations
    names = {"instant"} | {name for program in equations.kernel for name, _, _ in program["calls"]}
    functions, signatures = (
        {name: x for name, x in each.items() if name not in names}
        for each in (equations.functions, equations.signatures)
    )
    return replace(equations, functions=functions, signatures=signatures, kernel=[])


def _arguments(layout: Layout) -> list[ca.SX]:
    return [ca.SX.sym(name, layout.fields[name][1]) for name in ("z", "u", "p", "k", "dt")]


def _step(e: Equations, plan: Plan) -> tuple[Program, dict[str, ca.Function]]:
    """An internal step of RK4 with projection: the calls, and the functions that they call."""
    layout, prefix = Layout(e), plan.name
    z, u, p, k, dt = _arguments(layout)
    scene = _Scene(e, plan, p, k)
    functions: dict[str, ca.Function] = {}
    calls: list[list] = []

    def call(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> None:
        if name not in functions:
            values = [ca.densify(x) for x in outputs.values()]
            functions[name] = ca.Function(name, list(inputs.values()), values, {"cse": True})
        calls.append([name, list(inputs), list(outputs)])

    q, v, y = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n), ca.SX.sym("y", 2 * e.n + 1)
    rates: dict[str, ca.SX] = {}

    def rate(t: ca.SX, y: ca.SX) -> ca.SX:
        i = len(rates) + 1
        call(f"stage{i}", {"z": z, "dt": dt, **rates}, {f"t{i}": t, f"q{i}": y[: e.n], f"v{i}": y[e.n : 2 * e.n]})
        ts = ca.SX.sym("t")
        dy, watch = scene.rate(q, v, u, ts)
        call(
            f"{prefix}_rate",
            {f"t{i}": ts, f"q{i}": q, f"v{i}": v, "u": u, "p": p, "k": k},
            {"rate": dy, f"watch{i}": watch},
        )
        calls[-1][2][0] = f"rate{i}"
        rates[f"rate{i}"] = ca.SX.sym(f"rate{i}", 2 * e.n + 1)
        return rates[f"rate{i}"]

    y = rk4(rate, z[layout.time], ca.vertcat(z[: 2 * e.n], z[layout.work]), dt)
    call("sum", {"z": z, "dt": dt, **rates}, {"q": y[: e.n], "v": y[e.n : 2 * e.n], "work": y[2 * e.n]})
    watches = {f"watch{i + 1}": ca.SX.sym("watch", 4) for i in range(len(rates))}
    if e.l:
        if plan.corrections > 1:
            for _ in range(plan.corrections):
                call(f"{prefix}_place", {"q": q, "p": p, "k": k}, {"q": scene.placed(q)})
            names, values = ("v", "pivot", "residues"), scene.settled(q, v)
        else:
            names, values = ("q", "v", "pivot", "residues"), scene.corrected(q, v)
        call(f"{prefix}_settle", {"q": q, "v": v, "p": p, "k": k}, dict(zip(names, values, strict=True)))
        watches |= {"pivot": ca.SX.sym("pivot"), "residues": ca.SX.sym("residues", 2)}
    work = ca.SX.sym("work")
    after = scene.closed(z, dt, q, v, work, watches)
    call(
        f"{prefix}_close", {"z": z, "dt": dt, "q": q, "v": v, "work": work, "p": p, "k": k, **watches}, {"after": after}
    )
    return {"calls": calls, "iterations": plan.iterations, "corrections": plan.corrections if e.l else 0}, functions


def _instant(e: Equations, plan: Plan, redundant: bool) -> ca.Function:
    """instant(z, u, p, k): what a user can read, monitors, largest |Phi-ddot|, trouble."""
    layout = Layout(e)
    z, u, p, k, _ = _arguments(layout)
    scene = _Scene(e, plan, p, k)
    q, v, angles, t = z[: e.n], z[e.n : 2 * e.n], z[2 * e.n : layout.work], z[layout.time]
    a, lam, solve, watch = scene.accelerations(q, v, u, t)
    C = e.C(q, p)
    if redundant and e.l:
        lam = method.minimum_norm(C, scene.weights, solve, lam, 2, lambda change, value: False)
    readings = e.readings(q, v, a, lam / scene.scale, u, p, t)
    for row, angle in zip(scene.wrapped_rows, ca.vertsplit(scene.unwrapped(q, angles)), strict=False):
        readings[row] = angle
    position, velocity, acceleration = (
        scene.largest(x) if e.l else ca.SX(0) for x in (e.Phi(q, p), C @ v, C @ a - e.xi(q, v, p))
    )
    energy = e.kinetic_energy(q, v, p) + e.potential_energy(q, p)
    monitors = [position, velocity, energy, ca.SX(plan.iterations)]
    monitors = [x for name, x in zip(MONITORED, monitors, strict=True) if name not in e.monitors]
    trouble = scene.unconverged([watch]) + 1 - (watch[_PIVOT] > 0)
    if any(o.instant for o in e.outputs):
        last = [acceleration, trouble]
    else:  # Nobody reads an acceleration or a reaction: none is computed.
        last = [ca.SX(0), 1 - (ca.sumsqr(readings) < math.inf)]
    return ca.Function("instant", [z, u, p, k], [ca.densify(ca.vertcat(readings, *monitors, *last))], {"cse": True})


_CHANGE, _SIZE, _PIVOT, _SMALL_PIVOTS = range(4)
"""What an evaluation says of itself: last change of a and a itself (squared), smallest pivot, number of small ones."""


class _Scene:
    """The method with symbols; every part says what tells whether its unrolled loops were enough."""

    def __init__(self, equations: Equations, plan: Plan, p: ca.SX, k: ca.SX):
        self.e, self.plan, self.p = equations, plan, p
        alpha, self.tolerance = k[0], k[1]
        # Equation (4) divided by alpha, so that no product with it is left: M / alpha, F / alpha, lam / alpha.
        self.scale = 1 / alpha
        own = k[SETTINGS:] if plan.weighted else ca.SX.ones(equations.l)
        self.weights = ca.diag(own)
        self.held = own > 0 if plan.weighted else own
        names = {o.name: i for i, o in enumerate(equations.outputs)}
        self.wrapped_rows = [names[name] for name in equations.wrapped]

    def rate(self, q: ca.SX, v: ca.SX, u: ca.SX, t: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rate of q, v and work, and what tells about it."""
        e, p = self.e, self.p
        a, _, _, watch = self.accelerations(q, v, u, t)
        power = e.input_power(q, v, u, p, t) + e.other_power(q, v, p, t) if e.works else 0
        return ca.vertcat(v, a, power), watch

    def accelerations(self, q: ca.SX, v: ca.SX, u: ca.SX, t: ca.SX) -> tuple[ca.SX, ca.SX, method.Solve, ca.SX]:
        """a, lam (times `scale`), what solves with H (times `scale`), and what tells about them."""
        e, p, changes = self.e, self.p, []
        M, C, xi = self.scale * e.M(q, p), e.C(q, p), e.xi(q, v, p)
        F = self.scale * (e.f(q, v, u, p, t) - e.d(q, v, p))
        H = method.augmented_mass(M, C, self.weights)
        D, solve, order = _factor(H)

        def watch(da: ca.SX, a: ca.SX) -> bool:
            changes.append(da)
            return False

        zeros = ca.SX(e.n, 1), ca.SX(e.l, 1)
        a, lam, _, _ = method.residual(M, F, C, xi, self.weights, solve, *zeros, self.plan.iterations, watch)
        diagonal = ca.diag(H)[order]
        reduced = [i for i in range(e.n) if not ca.is_equal(D[i], diagonal[i])]
        small = ca.sum1(ca.vertcat(ca.SX(0), *(D[i] < _SMALL * diagonal[i] for i in reduced)))
        return a, lam, solve, ca.vertcat(ca.sumsqr(changes[-1]), ca.sumsqr(a), ca.mmin(D), small)

    def corrected(self, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """q and v after one correction (10) each, by H and C' of q as it was, which serves both at a regular position;
        the smallest pivot, the residues (squared) of both."""
        C, D, solve = self._augmented(q)
        q = q + method.project(C, self.weights, solve, self.e.Phi(q, self.p))
        after = self.e.C(q, self.p)
        v = v + method.project(C, self.weights, solve, after @ v)
        return q, v, ca.mmin(D), self._residues(q, after @ v)

    def placed(self, q: ca.SX) -> ca.SX:
        """q after a correction (10)."""
        C, _, solve = self._augmented(q)
        return q + method.project(C, self.weights, solve, self.e.Phi(q, self.p))

    def settled(self, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """v after corrections (10), the smallest pivot, and the residues (squared) of q and v."""
        C, D, solve = self._augmented(q)
        for _ in range(self.plan.corrections):
            v = v + method.project(C, self.weights, solve, C @ v)
        return v, ca.mmin(D), self._residues(q, C @ v)

    def _residues(self, q: ca.SX, Cv: ca.SX) -> ca.SX:
        return ca.vertcat(*(ca.sumsqr(x * self.held) for x in (self.e.Phi(q, self.p), Cv)))

    def closed(self, z: ca.SX, dt: ca.SX, q: ca.SX, v: ca.SX, work: ca.SX, watches: dict[str, ca.SX]) -> ca.SX:
        """The state after the step; its `trouble` counts failed checks, each a comparison that NaN fails."""
        e, layout = self.e, Layout(self.e)
        evaluations = [x for name, x in watches.items() if name.startswith("watch")]
        pivot = ca.mmin(ca.vertcat(*(x[_PIVOT] for x in evaluations), watches.get("pivot", ca.SX(0, 1))))
        trouble = 1 - (pivot > 0) + self.unconverged(evaluations)
        if e.l:
            for residue, x in zip(ca.vertsplit(watches["residues"]), (q, v), strict=True):
                trouble += 1 - (residue <= ca.fmax(self.tolerance**2, _ROUND_OFF**2 * ca.sumsqr(x)))
        else:
            trouble += 1 - (ca.sumsqr(ca.vertcat(q, v)) < math.inf)
        change = sum(x[_CHANGE] for x in evaluations) / (evaluations[0][_SIZE] + _TINY)
        angles = self.unwrapped(q, z[2 * e.n : layout.work])
        return ca.vertcat(q, v, angles, work, z[layout.time] + dt, z[layout.trouble] + trouble, change, pivot)

    def unconverged(self, evaluations: list[ca.SX]) -> ca.SX:
        """Number of checks of the multiplier iteration that fail."""
        if not self.e.l:
            return ca.SX(0)
        limit, most = self.tolerance, self.plan.freedom
        change, size = sum(x[_CHANGE] for x in evaluations), evaluations[0][_SIZE]
        if most is None:
            return 1 - (change <= limit**2 * sum(x[_SIZE] for x in evaluations) + _TINY)
        # Each of m iterations gains about the same factor, so a last change of limit^((m - 1) / m) leaves the limit.
        m = self.plan.iterations
        trouble = 1 - (change <= limit ** (2 * (m - 1) / m) * size + _TINY)
        return trouble + sum(1 - (x[_SMALL_PIVOTS] <= most) for x in evaluations)

    def largest(self, residue: ca.SX) -> ca.SX:
        return ca.mmax(ca.fabs(residue * self.held))

    def unwrapped(self, q: ca.SX, near: ca.SX) -> ca.SX:
        """Computed angles moved by whole turns to the values nearest to `near`."""
        e = self.e
        if not self.wrapped_rows:
            return ca.SX(0, 1)
        s = symbols(e)
        raw = e.readings(q, s["v"], s["a"], s["lam"], s["u"], self.p, s["t"])[self.wrapped_rows]
        return raw + 2 * ca.pi * ca.floor((near - raw) / (2 * ca.pi) + 0.5)

    def _augmented(self, q: ca.SX) -> tuple[ca.SX, ca.SX, method.Solve]:
        """C, the pivots of H (times `scale`), and what solves with it."""
        C = self.e.C(q, self.p)
        D, solve, _ = _factor(method.augmented_mass(self.scale * self.e.M(q, self.p), C, self.weights))
        return C, D, solve


def _factor(H: ca.SX) -> tuple[ca.SX, method.Solve, list[int]]:
    """Pivots of a sparse LDL' factorisation, what solves with it, and its fill-reducing order."""
    D, L, order = ca.ldl(H, True)
    return D, lambda b: ca.ldl_solve(b, D, L, order), order
