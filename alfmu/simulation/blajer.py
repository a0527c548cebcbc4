"""Blajer's method on NumPy arrays, with loops that stop on convergence: slow, readable, the kernel's reference.

Read it with the paper open: `alfmu.method.formulations` has its equations and letters, `alfmu.method.singular` S1 to
S5, the treatment of singular positions. M (n, n), C (l, n), Phi and xi (l,), alpha (l, l), F = f - d (n,), q, v and a
(n,), lam (l,), u inputs and states. `oracle` adds the other parts of an instance to it.
"""

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import runtime
from ..equations import Equations
from ..equations.arrays import ArrayFunction, ArrayFunctions
from ..equations.evaluation import elimination_order, loops, telling
from ..equations.interface import Counters
from ..kernel.memory import GROSS, SETTINGS, TURN
from ..kernel.thresholds import PATIENT, REGULAR, TORN
from ..method import formulations as method
from ..method import singular as branch
from ..method.formulations import CORRECTIONS
from ..method.inputs import Past
from ..method.integrators import rk4
from ..model.errors import AlfmuError, OpenError, StepError

EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)

_SOLVER = {
    **{"step_size": float, "tolerance": float, "max_iterations": int, "input_order": int},
    **{"formulation": str, "branch": str},
}

Found = tuple[NDArray, NDArray, int, NDArray]
"""Accelerations a (n,), multipliers lam (l,), number of multiplier iterations, residual Phi-ddot (l,)."""

Reading = tuple[NDArray, NDArray, int, NDArray, int, float]
"""The same with the kind of lam (0 direct, 1 a limit, 2 the finite part at a pole), and the error of lam."""


class Method(runtime.Instance):
    """The method, for an instance whose values, start, scales, ranks and events are the runtime's."""

    counters = Counters()
    """Work done and largest errors since initialisation."""

    def _take(self, equations: Equations) -> None:
        super()._take(equations)
        e, arrays = self.equations, ArrayFunctions(self.equations)
        names = ["dynamics", "constraints", "power", "energy", "readings", "shares", *["state_rates"] * bool(e.states)]
        self._functions = {name: ArrayFunction(arrays, name, e.signatures[name]) for name in names}
        self._lengths, self._turns = (np.array([c.unit == unit for c in e.coordinates]) for unit in ("m", "rad"))
        self.counters, self._unfinished, self._near = Counters(), 0.0, False

    def _know(self) -> None:
        """Copy penalties, units of rows, scales of pivots and freedoms that the runtime found at a start or event."""
        e, k = self.equations, self.memory["k"]
        values: dict[str, Any] = {name: kind(self.get(f"solver.{name}")) for name, kind in _SOLVER.items()}
        self.settings = replace(self._given, **values)
        self.continues = self.settings.continues and e.l > 0
        self.order = self.settings.input_order if e.inputs else 0
        self._past = Past(len(e.inputs), self.memory["past"]) if self.order else None
        found = dict(zip(SETTINGS, k.tolist(), strict=False))
        self.freedom, self.masses, self.regular = (found[name] for name in ("freedom", "masses", "regular"))
        self.nothing, self.least_distance = found["nothing"], found["least_distance"]
        self.inverse_length, self.inverse_loop = found["inverse_length"], found["inverse_loop"]
        ends = np.cumsum([len(SETTINGS), e.l, e.l, e.n, len(e.compliances), e.n * bool(e.l)])
        _, _, inverse_units, inverse_scales, stiffnesses, self.way, _ = np.split(k, ends)
        with np.errstate(divide="ignore", invalid="ignore"):  # the run reports a scale that is not finite
            self.units, self.scales, self.stiffnesses = 1 / inverse_units, k[0] / inverse_scales, k[0] * stiffnesses
        self.sizes = np.where(self._lengths, self.inverse_length, 1.0)  # one over the unit of each coordinate
        self.alpha, self.active = np.diag(self.penalty), self.penalty > 0
        self.rank = e.dependent - self.mobility().freedom if e.survey.brakes else 0
        self.heavy, own = np.zeros(e.n), telling(e)
        self.heavy[own] = branch.INDEPENDENT_MASS * self.nothing / branch.NOISE_FLOOR * self.scales[own]

    # Equations ----------------------------------------------------------------------------------------------------

    def _values(self, function: str, *arguments: NDArray | float) -> list[NDArray]:
        """Return the results of a function of the equations, matrices dense."""
        return [x.toarray() if hasattr(x, "toarray") else x.copy() for x in self._functions[function](*arguments)]

    def dynamics(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> list[NDArray]:
        """Return M, C, F = f - d and xi of (3) and (4)."""
        return self._values("dynamics", q, v, u, self.memory["p"], t)

    def constraints(self, q: NDArray, v: NDArray) -> list[NDArray]:
        """Return M, C, Phi and C v of (1) and (2)."""
        return self._values("constraints", q, v, self.memory["p"])

    def augmented(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, method.Solve]:
        """Return M, C, Phi and C v of (1) and (2), and a solver with H."""
        M, C, Phi, Cv = self.constraints(q, v)
        return M, C, Phi, Cv, self.inverse(method.augmented_mass(M, C, self.alpha))

    def inverse(self, H: NDArray) -> method.Solve:
        """Return a solver with a matrix; raise StepError if it is singular."""

        def solve(b: NDArray) -> NDArray:
            try:
                return np.linalg.solve(H, b)
            except np.linalg.LinAlgError:
                remedy = "give the massless body a mass, or hold it by constraints"
                raise self._error(StepError, self.time, "the augmented mass matrix is singular", remedy) from None

        return solve

    def readings(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> NDArray:
        """Return all outputs, in the order of `equations.outputs`."""
        return self._values("readings", q, v, a, lam, u, self.memory["p"], t)[0]

    def power(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> float:
        """Return the power [W] of inputs, loads and dampers."""
        return float(self._values("power", q, v, u, self.memory["p"], t)[0][0]) if self.equations.works else 0.0

    def supply(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> float:
        """Return the power [W] of prescribed motion."""
        e = self.equations
        given = e.timed and e.works
        return float(e.functions["motion_power"](q, v, a, lam, u, self.memory["p"], t)) if given else 0.0

    def state_rates(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> NDArray:
        """Return time derivatives of the states."""
        return self._values("state_rates", q, v, u, self.memory["p"], t)[0] if self.equations.states else u[:0]

    def energy(self, q: NDArray, v: NDArray) -> float:
        """Return kinetic and potential energy [J]."""
        return float(self._values("energy", q, v, self.memory["p"])[0][0])

    def residues(self, q: NDArray, v: NDArray) -> tuple[float, float]:
        """Return the largest |Phi| and |Phi-dot|."""
        _, _, Phi, Cv = self.constraints(q, v)
        return self._largest(Phi), self._largest(Cv)

    # Accelerations ------------------------------------------------------------------------------------------------

    def accelerations(self, q: NDArray, v: NDArray, u: NDArray, t: float, patience: int = 1) -> Found:
        """Return accelerations and multipliers by the chosen formulation, with `patience` times the usual
        iterations."""
        M, C, F, xi = self.dynamics(q, v, u, t)
        kind, alpha, s, used = self.settings.formulation, self.alpha, self.settings, 1
        if not all(np.isfinite(x).all() for x in (M, F, xi)):
            remedy = "check roots, logarithms and quotients in forces, or reduce solver.step_size"
            raise self._error(StepError, t, "the equations of motion are not finite", remedy)
        solve = self.inverse(M if kind == "stiffness" else method.augmented_mass(M, C, alpha))
        _, _, Phi, Cv = self.constraints(q, v)
        stabilised = method.stabilised(xi, Cv, Phi, s.zeta, s.omega)
        if kind in ("residual", "classic"):
            iterate = method.residual if kind == "residual" else method.classic
            a, lam, used, converged = self.iterated(iterate, M, F, C, xi, solve, patience)  # (8)
            self.counters.unconverged += not converged
        elif kind == "penalty":
            a, lam = method.penalty(F, C, stabilised, alpha, solve)  # (6)
        elif kind == "stiffness":
            a, lam = method.stiffness(F, C, Phi, s.omega**2 * alpha, solve)  # (5)
        else:
            held, lam = self.active, np.zeros_like(xi)
            a, lam[held] = method.dae(M, F, C[held], (xi if kind == "dae" else stabilised)[held], least_squares)  # (9)
        self.counters.evaluations += 1
        self.counters.multiplier_iterations += used
        return a, lam, used, C @ a - xi

    def iterated(
        self, iterate: Callable, M: NDArray, F: NDArray, C: NDArray, xi: NDArray, solve: method.Solve, patience: int = 1
    ) -> tuple[NDArray, NDArray, int, bool]:
        """Iterate (8), classic or residual, until the change of the accelerations is within their tolerance.

        Null vectors of C' do not act on a, so alpha times the round-off of each pass accumulates in lam along them. As
        they do act on tangents, they are removed from the returned lam.
        """
        s, sizes, left, before = self.settings, self.sizes, math.inf, math.inf
        scale = np.abs(F / sizes).max(initial=0.0) / np.abs(M / np.outer(sizes, sizes)).max(initial=1e-300)

        def done(da: NDArray, a: NDArray) -> bool:
            nonlocal left
            left = float(np.linalg.norm(sizes * da)) / max(float(np.linalg.norm(sizes * a)), TINY)
            return np.abs(sizes * da).max() <= s.tolerance * max(np.abs(sizes * a).max(), scale)

        def settled(change: NDArray, value: NDArray) -> bool:
            nonlocal before
            change, last, before = change @ change, before, change @ change
            return method.settled(change, last, value @ value, s.tolerance)

        zeros = np.zeros_like(F), np.zeros_like(xi)
        a, lam, used, converged = iterate(M, F, C, xi, self.alpha, solve, *zeros, patience * s.max_iterations, done)
        if not converged:
            self._unfinished = max(self._unfinished, left)
        return a, method.minimum_norm(C, self.alpha, solve, lam, method.SETTLING, settled), used, converged

    def carried(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """Return multipliers equivalent to lam (l,) with the least loads of joints, or shared by the given
        compliances."""
        e, l = self.equations, len(lam)
        M, C, _, _ = self.constraints(q, v)
        held = np.diag(self.active.astype(float))
        if e.compliances:
            alpha, lengths = np.diag(self.stiffnesses), held * np.isin(np.arange(l), e.lengths)
            ratio = method.LIGHT * alpha.max(initial=0.0) / max(M.diagonal().max(initial=0.0), TINY)
            light = M * min(1.0, ratio or 1.0)  # small beside the penalties

            def inverse(C: NDArray) -> method.Solve:
                return self.inverse(method.augmented_mass(light, C, alpha))

            return method.minimum_norm_of_joints(C, alpha, lengths, inverse, lam, CORRECTIONS, unchanged)

        def slope(lam: NDArray) -> NDArray:
            return self._values("shares", q, v, a, lam, self.driven, self.memory["p"], self.time)[0].ravel()

        C, nothing = held @ C, slope(np.zeros(l))
        P = held @ np.reshape([slope(unit) - nothing for unit in np.eye(l)], (l, l)).T @ held + np.eye(l) - held
        sizes = np.where(P.diagonal() > EPS, P.diagonal(), 1.0)
        columns = (C**2 / sizes[:, None]).sum(axis=0)
        there = np.minimum(1, (C**2).sum(axis=0) * self.memory["k"][0] / self.scales)  # small for a column of round-off
        weights = np.diag(np.divide(method.HELD_SHARES * there, columns, out=np.zeros_like(columns), where=columns > 0))
        eased = P + method.EASE * np.diag(sizes)
        solve, start = self.inverse(method.augmented_mass(eased, C.T, weights)), (0 * lam, np.zeros(C.shape[1]))
        return lam + method.shared_again(P, held @ slope(lam), C, weights, solve, *start, CORRECTIONS, unchanged)[0]

    def impact(self, q: NDArray, v: NDArray) -> NDArray:
        """Return v (n,) after a plastic impact that satisfies the constraints: M dv + C' impulse = 0, C dv = -C v."""
        M, C, _, Cv, solve = self.augmented(q, v)
        return v + self.iterated(method.residual, M, np.zeros_like(v), C, -Cv, solve)[0]

    def hold(self, q: NDArray) -> None:
        """Freeze the rank: use the independent combinations of constraints at q (n,) until the next call.

        H omits redundant constraints if they would brake stages beside the motion; lam then has least norm by itself.
        """
        if self.equations.survey.brakes:
            root = np.sqrt(self.penalty)
            rows, sizes, _ = np.linalg.svd(root[:, None] * self.constraints(q, np.zeros_like(q))[1])
            if sizes[self.rank - 1] > REGULAR * sizes[0]:  # else keep those before this singular position
                self.alpha = root[:, None] * (rows[:, : self.rank] @ rows[:, : self.rank].T) * root

    # Projections --------------------------------------------------------------------------------------------------

    def project(self, q: NDArray, v: NDArray, t: float, near: bool = False) -> tuple[NDArray, NDArray, float, float]:
        """Return q and v projected onto the constraints by (10), and the largest remaining |Phi| and |Phi-dot|.

        Near a singular position corrections converge slowly in the direction that the constraints hardly fix, which
        magnifies the remaining gap, so one more is made. Gaps above the tolerance are counted. Raises OpenError if a
        gap exceeds `GROSS`.
        """
        M, C, Phi, Cv, solve = self.augmented(q, v)
        for _ in range(CORRECTIONS):
            if self._closed(Phi, C, q, q):
                if not near:
                    break
                near = False
            q = self._closer(M, C, Phi, solve, q)
            M, C, Phi, Cv, solve = self.augmented(q, v)
            self.counters.projection_iterations += 1
        for _ in range(CORRECTIONS):
            if self._closed(Cv, C, q, v):
                break
            v = self._slower(M, C, Cv, solve, v)
            Cv = self.constraints(q, v)[3]
            self.counters.projection_iterations += 1
        for what, residue in (("|Phi|", Phi), ("|Phi-dot|", Cv)):
            worst, row = self._worst(residue)
            if not worst <= GROSS:
                left = f"{what} = {worst:.1e} at {row} > {GROSS:.0e} after {CORRECTIONS} corrections"
                raise self._error(OpenError, t, left)
        self.counters.unprojected += not (self._closed(Phi, C, q, q) and self._closed(Cv, C, q, v))
        return q, v, self._largest(Phi), self._largest(Cv)

    def _closer(self, M: NDArray, C: NDArray, Phi: NDArray, solve: method.Solve, q: NDArray) -> NDArray:
        """Return q after a correction (10)."""
        return q + method.project_residual(M, C, self.alpha, solve, Phi, lambda d: self.constraints(q + d, d)[2])

    def _slower(self, M: NDArray, C: NDArray, Cv: NDArray, solve: method.Solve, v: NDArray) -> NDArray:
        """Return v after a correction (10)."""
        return v + method.project_residual(M, C, self.alpha, solve, Cv, lambda d: Cv + C @ d)

    def _closed(self, residue: NDArray, C: NDArray, q: NDArray, x: NDArray) -> bool:
        """Return whether residuals of constraints, of x = q or v, are within the tolerance, or the round-off of their
        row or of places if larger."""
        far = self._far(q) * (1.0 if x is q else np.abs(self.sizes * x).max(initial=0.0))
        limit = 8 * EPS * np.maximum(abs(C) @ np.abs(x), far * self.units)
        return bool((np.abs(residue) <= np.maximum(self.settings.tolerance * self.units, limit))[self.active].all())

    def _far(self, q: NDArray) -> float:
        """Return the largest coordinate of a place, over the size of the smallest loop."""
        return self.inverse_loop * max(self.equations.reach, np.abs(q[self._lengths]).max(initial=0.0))

    # Singular positions -------------------------------------------------------------------------------------------

    def factor(self, q: NDArray) -> NDArray:
        """Return Cholesky's factor (n, n) of H at q (n,) over the scales, in the order of elimination."""
        M, C, _, _ = self.constraints(q, np.zeros_like(q))
        order, scales = elimination_order(self.equations), np.sqrt(self.scales)
        H = method.augmented_mass(M, C, self.alpha) / np.outer(scales, scales)
        try:
            return np.linalg.cholesky(H[np.ix_(order, order)])
        except np.linalg.LinAlgError:
            return np.zeros_like(H)

    def margin(self, q: NDArray) -> tuple[bool, float]:
        """Return whether the margin at q (n,) may be below `singular.BRANCH_MARGIN`, and the margin (S2)."""
        factor = self.factor(q) ** 2
        ratios = np.maximum(factor.diagonal(), 1e-300)
        if self.equations.turns and np.log(ratios).sum() >= self.regular:
            return False, 1.0
        near, small = (ratios < branch.BRANCH_MARGIN).sum() > self.freedom, ratios < branch.SMALL_PIVOT
        if small.sum() <= self.freedom:
            return near, 1.0
        if self.equations.turns:
            more = min(small.sum() - self.freedom, loops(self.equations))
        else:
            left = factor[small][:, small].sum(axis=1)  # what large pivots leave of the diagonal of H
            more = max((left < branch.SMALL_PIVOT).sum() - self.freedom, 1)
        return near, math.exp(min((np.log(ratios[small]).sum() - self.masses) / more, 0.0))

    def approach(self, q: NDArray, v: NDArray, shortest: float) -> tuple[float, float, NDArray]:
        """Return the distance to a singular position, its change per spacing, and a spacing (n,) long enough to measure
        it: along v, or in the direction that the runtime has found (S2)."""
        self._unit.scene.library.alfmu_update_way(self._unit.address)
        spacing = shortest * (self.way + self.memory["k"][SETTINGS.index("along")] * v)
        for _ in range(branch.DOUBLINGS):
            before, here, after = (self.margin(q + k * spacing)[1] for k in (-1, 0, 1))
            rate = max(branch.curvature(before, here, after), 0.0) ** 0.5
            if here > self.nothing or rate**2 > self.nothing:
                break
            spacing *= 2  # The positions are too close to be distinguished from the singular one.
        return here**0.5, rate, spacing

    def on_branch(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        """Return q and v nearby that satisfy the constraints: q displaced only across the motion, then v by (10).

        The motion through positions found in this way is smooth up to the singular position itself (S3).
        """

        def closer(q: NDArray) -> NDArray:
            M, C, Phi, _, solve = self.augmented(q, v)
            return self._closer(M, C, Phi, solve, q)

        near = closer(closer(q))
        M, C, _, _, solve = self.augmented(near, v)
        still = (lambda x, q=near: self.constraints(q, x)[3], np.append(v[:-1], 0.0)) if self.equations.timed else ()
        near, v = branch.returned(M, C, self.alpha, solve, self.heavy, near, q, v, *still)
        near = closer(near)
        for _ in range(2):
            M, C, _, Cv, solve = self.augmented(near, v)
            v = self._slower(M, C, Cv, solve, v)
        return near, v

    def reached(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """Return the result of `on_branch`; raise OpenError if the branch does not lead there."""
        near, v = self.on_branch(q, v)
        gap, row = self._worst(self.constraints(near, v)[2])
        if not gap <= GROSS:
            left = f"{row} does not close ahead on the branch of the motion, and stays open by {gap:.1e}"
            raise self._error(OpenError, t, left)
        return near, v

    def accelerations_on_branch(self, q: NDArray, v: NDArray, u: NDArray, t: float, shortest: float) -> Found:
        """Return `accelerations` at the position of the branch nearest to q; near a singular position their limit (S4).

        `shortest` is the spacing [s] of the positions from which a limit is extrapolated; slow motion increases it,
        fast motion reduces it. If the motion does not reach these positions, the accelerations at the position itself
        are returned, provided that the iteration converges.
        """
        here, rate, spacing = self.approach(q, v, shortest)
        moved = float(np.abs(self.sizes * spacing)[: self.equations.dependent].max())
        first = float(branch.first_position(self.least_distance, rate, moved, self.nothing, np.where))
        moved *= first
        if not (here < branch.LIMIT_ZONE * first and 0 < moved <= rate * branch.farthest(self.least_distance, max)):
            return self.accelerations(*self.reached(q, v, t), u, t)
        unconverged = self.counters.unconverged
        try:
            _, found = self._beside(q, v, u, t, spacing * first / rate, branch.MEAN)
            a, lam, left = (branch.mean({k: x[i] for k, x in found.items()}) for i in (0, 1, 3))
            with suppress(OpenError):
                unconverged = self.counters.unconverged
                alone = self.accelerations(*self.reached(q, v, t), u, t)
                clear, off = here**2 > max(self.nothing, branch.JUDGED), np.abs(a - alone[0]).max()
                if clear and off > branch.direct_error(here**2, EPS) * np.abs(a).max():
                    return alone  # a different motion passes through the singular position
                self.counters.unconverged = unconverged
            return a, lam, max(x[2] for x in found.values()), left
        except OpenError:
            alone = self.accelerations(*self.reached(q, v, t), u, t, PATIENT)
            if self.counters.unconverged > unconverged:
                raise self._error(OpenError, t, "the multiplier iteration does not converge") from None
            return alone

    def _beside(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: NDArray, at: Iterable[int]
    ) -> tuple[dict[int, tuple[NDArray, NDArray]], dict[int, Found]]:
        """Return q and v, and the results of `accelerations`, at positions on the branch before and after q."""
        places = {k: self.reached(q + k * spacing, v, t) for k in at}
        return places, {k: self.accelerations(*place, u, t) for k, place in places.items()}

    # One step, and one reading ------------------------------------------------------------------------------------

    @np.errstate(all="ignore")
    def stepped(self, t: float, dt: float, read: tuple[NDArray, NDArray] | None) -> tuple[Any, ...]:
        """Return q, v, states and work after a step of RK4 with projections (10), and the largest |Phi| and |Phi-dot|.

        All stages are on the branch if one is near a singular position. `read` are a and lam at t, if known.
        """
        n, c, end = self.equations.n, self.counters, t + dt
        parts, begin = [n, 2 * n, 2 * n + 1], np.concatenate([self.q, self.v, [self.work], self.states])

        def rate(at: float, y: NDArray, on_branch: bool = False) -> NDArray:
            (q, v, _, x), u = np.split(y, parts), self._past.at(at, self.order) if self._past else self.inputs
            u = np.concatenate([u, x])
            if on_branch:
                a, lam, *_ = self.accelerations_on_branch(q, v, u, at, branch.SPACING * dt)
            else:
                self._near = self._near or (self.continues and self.margin(q)[0])
                a, lam = self.accelerations(q, v, u, at)[:2] if read is None or at > t else read
            work = self.power(q, v, u, at) + self.supply(q, v, a, lam, u, at)
            return np.concatenate([v, a, [work], self.state_rates(q, v, u, at)])

        self.hold(self.q)
        self._unfinished, self._near, unconverged = 0.0, False, c.unconverged
        y = rk4(rate, t, begin, dt)
        if self._near:
            c.unconverged, self._unfinished = unconverged, 0.0
            y = rk4(lambda t, y: rate(t, y, on_branch=True), t, begin, dt)
        if not np.isfinite(y).all():
            raise self._error(StepError, end, "the state is not finite")
        q, v, work, x = np.split(y, parts)
        if not self.settings.projects:
            return q, v, x, work[0], *self.residues(q, v)
        moved, (gap, row) = np.abs(q - self.q)[: self.equations.dependent], self._worst(self.constraints(q, q)[2])
        turned = moved[self._turns[: len(moved)]].max(initial=0.0)
        if turned > TURN:
            raise self._error(StepError, end, f"an angle turned by {turned:.3g} rad in one step, more than half a turn")
        if gap > max(TORN * moved.max(initial=0.0), GROSS):
            raise self._error(StepError, end, f"a step of {moved.max():.3g} opened {row} by {gap:.3g}")
        q, v, *gaps = self.project(q, v, end, self._near)
        return q, v, x, work[0], *gaps

    @np.errstate(all="ignore")
    def seen(self) -> Reading:
        """Return the accelerations at this state, and lam as joints share it; near a singular position its limit."""
        q, v, u, t = self.q, self.v, self.driven, self.time
        margin = self.margin(q)[1]
        near = self.continues and margin**0.5 < branch.READ_ZONE * branch.READ_DISTANCE
        a, lam, used, left = self.accelerations(q, v, u, t)
        lam = self.carried(q, v, a, lam) if self.settings.projects else lam
        lost, noise = self._lost(q, v, a, lam, margin) if len(lam) else (0.0, EPS)
        if near:
            _, rate, spacing = self.approach(q, v, branch.SPACING * self.settings.step_size)
            with suppress(OpenError, ZeroDivisionError):  # Direct values if the motion ends before them.
                places, found = self._beside(q, v, u, t, spacing * branch.READ_DISTANCE / rate, branch.READ_MEAN)
                # More multipliers are equivalent at the singular position than on the branch.
                loads = {k: self.carried(*places[k], *x[:2]) for k, x in found.items()}
                limit, pole, magnified = branch.with_pole(loads)
                told, fewer = magnified > 0 or not pole, branch.fewer(loads)
                rough, coarse = (branch.with_pole(x, told)[0] for x in (fewer, branch.fewer(fewer)))
                change, before = (np.abs(x).max() for x in (limit - rough, rough - coarse))
                if margin <= self.nothing or not branch.direct_error(margin, EPS) * np.abs(limit).max() < change:
                    a, lam = branch.mean({k: x[0] for k, x in found.items()}), limit
                    _, C, _, xi = self.dynamics(q, v, u, t)
                    left, largest = C @ a - xi, max(np.abs(x).max() for x in loads.values())
                    lost = branch.limit_error(change, before, largest, magnified, noise)
                return a, lam, max(x[2] for x in found.values()), left, 1 + pole, lost
        return a, lam, used, left, 0, lost

    def _lost(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, margin: float) -> tuple[float, float]:
        """Return the error of reactions evaluated directly at this position, and the relative error of the position."""
        own, arms = self.inverse_length, np.where(self._turns, self.inverse_length, 1.0)
        (M, C, F, xi), (_, _, Phi, Cv) = self.dynamics(q, v, self.driven, self.time), self.constraints(q, v)
        off = [float(np.linalg.norm((x / self.units)[self.active])) for x in (Phi, Cv, C @ a - xi)]
        off[0] += EPS * self._far(q)
        off[1:] = [x / (float(np.linalg.norm(self.sizes * y)) + TINY) for x, y in zip(off[1:], (v, a), strict=True)]
        forces = [float(np.abs(arms * x).max()) for x in (F, C.T @ lam, F - M @ a - C.T @ lam, M @ a)]
        masses = self.nothing / branch.NOISE_FLOOR
        margin = max(margin - masses, masses / branch.NOISE_FLOOR)
        return branch.reading_error(margin, EPS, off, [*forces, own * v @ M @ v]), EPS + off[0]

    # Gaps and errors ----------------------------------------------------------------------------------------------

    def _largest(self, residue: NDArray) -> float:
        return float(np.abs(residue[self.active]).max(initial=0.0))

    def _worst(self, residue: NDArray) -> tuple[float, str]:
        """Return the largest residue, in units of its row, and the name of that row; 0 if there are none."""
        if not len(residue):
            return 0.0, ""
        sizes = np.where(self.active, np.nan_to_num(np.abs(residue / self.units), nan=np.inf), 0)
        return float(sizes.max()), self.equations.rows[int(np.argmax(sizes))].text

    def _error(
        self, kind: type[AlfmuError], t: float, measured: str, remedy: str = "reduce solver.step_size"
    ) -> AlfmuError:
        return kind(f"{self.name}, t = {t:.6g} s: {measured}; {remedy}")


def unchanged(change: NDArray, value: NDArray) -> bool:
    """Return whether an iteration changed only round-off."""
    return bool(np.abs(change).max(initial=0.0) <= EPS * np.abs(value).max(initial=0.0))


def least_squares(blocks: list, right: list) -> tuple[NDArray, NDArray]:
    """Return the least-squares solution of least norm of the block system (9); NaN if the system is not finite.

    LAPACK is not called then, because it would print a message.
    """
    (M, Ct), (C, _) = blocks
    K, b = np.block([[M, Ct], [C, np.zeros((len(C), len(C)))]]), np.concatenate(right)
    finite = np.isfinite(K).all() and np.isfinite(b).all()
    a, lam = np.split(np.linalg.lstsq(K, b, rcond=None)[0] if finite else np.full(len(b), np.nan), [len(M)])
    return a, lam
