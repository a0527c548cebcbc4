"""Blajer's method on NumPy arrays, with loops that stop on convergence: slow, readable, and the measure of the kernel.

To be read with the paper open: `alfmu.method.formulations` has its equations and letters, `alfmu.method.singular` what
is known of singular positions. Values by name, the start, scales and ranks, switches and the state are those of the C
runtime. What the paper does while time passes is computed here, from functions of the equations alone: accelerations
and multipliers by every formulation, steps of RK4 with projections (10), the branch of the motion through singular
positions, and plastic impacts.
"""

from __future__ import annotations

import ctypes
import logging
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .. import runtime
from ..equations import Equations
from ..equations.arrays import ArrayFunction, ArrayFunctions
from ..equations.evaluation import DENSE
from ..equations.interface import MONITORS, Counters, events
from ..kernel.memory import GROSS, SETTINGS, TURN
from ..kernel.thresholds import PATIENT, REGULAR, SAID, SHORTEST, TORN, UNFINISHED
from ..method import formulations as method
from ..method import singular as branch
from ..method.formulations import CORRECTIONS
from ..method.inputs import Past
from ..method.integrators import rk4
from ..model.errors import AlfmuError, InputError, OpenError, StepError
from ..model.settings import internal_steps

__all__ = ["Instance"]

Found = tuple[NDArray, NDArray, int, NDArray]
"""Accelerations a (n,), multipliers lam (l,), the multiplier iterations used, Phi-ddot (l,) that is left."""

EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)

_LOGGER = logging.getLogger("alfmu")

SOLVER = {"step_size": float, "tolerance": float, "max_iterations": int, "input_order": int}


class Instance(runtime.Instance):
    """An instance of the runtime whose steps and readings are made here; used alike, with `rk4` alone."""

    counters = Counters()
    """Work done and largest errors since initialisation."""

    run = None
    """A run in one call would be the runtime's; `alfmu.simulation.run` makes it step by step."""

    def _take(self, equations: Equations) -> None:
        super()._take(equations)
        e, arrays = self.equations, ArrayFunctions(self.equations)
        names = ["dynamics", "constraints", "power", "energy", "readings", *["state_rates"] * bool(e.states)]
        self._functions = {name: ArrayFunction(arrays, name, e.signatures[name]) for name in names}
        self._turns = np.array([c.unit == "rad" for c in e.coordinates])
        self._seen: tuple = (None, None, None)
        self.counters, self._unfinished, self._by_row = Counters(), 0.0, False

    def initialize(self) -> None:
        """Begin as the runtime does, with RK4 for `auto`; raise InputError if another method is asked for."""
        if (chosen := self.choices["solver.method"]) not in ("auto", "rk4"):
            raise InputError(f"{self.name}: the oracle has no solver.method {chosen}; use rk4, or kernel vm")
        if self.equations.frictions:
            joint = self.equations.frictions[0].name
            raise InputError(f"{self.name}: the oracle has no dry friction, which {joint} has; use kernel vm")
        if self.equations.jacobian:
            first = "/".join(self.equations.jacobian[0])
            raise InputError(f"{self.name}: the oracle has no derivatives over a step, as {first}; use kernel vm")
        if self.equations.peaks:
            first = next(iter(self.equations.peaks))
            raise InputError(f"{self.name}: the oracle has no peaks within a step, as of {first}; use kernel vm")
        super().initialize()
        self.counters, self._step_error = Counters(), 0.0
        self._unfinished, self._told = 0.0, False
        self._know()

    def _know(self) -> None:
        """What the runtime found at the start or at an event: penalties, units of rows, scales of pivots, freedoms."""
        e, k = self.equations, self.memory["k"]
        numbers = {name: kind(self.get(f"solver.{name}")) for name, kind in SOLVER.items()}
        texts = {name: self.choices[f"solver.{name}"] for name in ("formulation", "branch")}
        self.settings = replace(self._given, **numbers, **texts)
        self.continues = self.settings.continues and e.l > 0
        self.order = self.settings.input_order if e.inputs else 0
        self._past = Past(len(e.inputs), self.memory["past"]) if self.order else None
        for name in ("freedom", "masses", "regular", "nothing", "least_distance"):
            setattr(self, name, float(k[SETTINGS.index(name)]))
        ends = np.cumsum([len(SETTINGS), e.l, e.l, e.n, len(e.compliances)])
        _, _, inverse_units, inverse_scales, stiffnesses, _ = np.split(k, ends)
        with np.errstate(divide="ignore", invalid="ignore"):  # where a scale is not finite, the run says so
            self.units, self.scales, self.stiffnesses = 1 / inverse_units, k[0] / inverse_scales, k[0] * stiffnesses
        self.alpha, self.active = np.diag(self.penalty), self.penalty > 0
        self.rank = e.dependent - self.mobility().freedom if e.survey.brakes else 0
        self.heavy = np.zeros(e.n)
        self.heavy[e.telling] = branch.INDEPENDENT_MASS * self.nothing / branch.NOISE_FLOOR * self.scales[e.telling]

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
        """Return the same, and a solver with H."""
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
        """Return everything a user can read, in the order of `equations.outputs`."""
        return self._values("readings", q, v, a, lam, u, self.memory["p"], t)[0]

    def power(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> float:
        """Return the power [W] of inputs, loads and dampers."""
        return float(self._values("power", q, v, u, self.memory["p"], t)[0][0]) if self.equations.works else 0.0

    def state_rates(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> NDArray:
        """Return time derivatives of the states."""
        return self._values("state_rates", q, v, u, self.memory["p"], t)[0] if self.equations.states else u[:0]

    def supply(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> float:
        """Return the power [W] of prescribed motion."""
        e = self.equations
        if not (e.timed and e.works):
            return 0.0
        return float(e.functions["motion_power"](q, v, a, lam, u, self.memory["p"], t))

    def energy(self, q: NDArray, v: NDArray) -> float:
        """Return kinetic and potential energy [J]."""
        return float(self._values("energy", q, v, self.memory["p"])[0][0])

    def residues(self, q: NDArray, v: NDArray) -> tuple[float, float]:
        """Return the largest |Phi| and |Phi-dot|."""
        _, _, Phi, Cv = self.constraints(q, v)
        return self._largest(Phi), self._largest(Cv)

    # Accelerations ------------------------------------------------------------------------------------------------

    def accelerations(self, q: NDArray, v: NDArray, u: NDArray, t: float, patience: int = 1) -> Found:
        """Return accelerations and multipliers by the formulation that is chosen; `patience` times as many
        iterations."""
        M, C, F, xi = self.dynamics(q, v, u, t)
        kind, alpha, s, used = self.settings.formulation, self.alpha, self.settings, 1
        if not all(np.isfinite(x).all() for x in (M, F, xi)):
            raise self._error(StepError, t, "the equations of motion are not finite")
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
            a, lam[held] = method.dae(M, F, C[held], (xi if kind == "dae" else stabilised)[held], _least_squares)  # (9)
        self.counters.evaluations += 1
        self.counters.multiplier_iterations += used
        return a, lam, used, C @ a - xi

    def iterated(
        self, iterate: Callable, M: NDArray, F: NDArray, C: NDArray, xi: NDArray, solve: method.Solve, patience: int = 1
    ) -> tuple[NDArray, NDArray, int, bool]:
        """(8), classic or residual, until the change is within the tolerance of the accelerations it changes.

        Null vectors of C' do not act on a, so that alpha times the round-off of each pass stays in lam along them. Yet
        they act on tangents: lam is handed out without them.
        """
        scale, left = np.abs(F).max(initial=0.0) / np.abs(M).max(initial=1e-300), math.inf

        def done(da: NDArray, a: NDArray) -> bool:
            nonlocal left
            left = float(np.linalg.norm(da) / max(np.linalg.norm(a), TINY))
            return np.abs(da).max() <= self.settings.tolerance * max(np.abs(a).max(), scale)

        zeros, most = (np.zeros_like(F), np.zeros_like(xi)), patience * self.settings.max_iterations
        a, lam, used, converged = iterate(M, F, C, xi, self.alpha, solve, *zeros, most, done)
        if not converged:
            self._unfinished = max(self._unfinished, left)
        before = math.inf

        def settled(change: NDArray, value: NDArray) -> bool:
            nonlocal before
            change, last, before = change @ change, before, change @ change
            return method.settled(change, last, value @ value, self.settings.tolerance)

        return a, method.minimum_norm(C, self.alpha, solve, lam, method.SETTLING, settled), used, converged

    def _check_converged(self, t: float) -> None:
        """What multiplier iterations left since this was asked last: told once, StepError if it is too much.

        As the runtime, for the formulation that continues through singular positions; the others are only told about.
        """
        left, most, self._unfinished = self._unfinished, self.settings.max_iterations, 0.0
        if not left:
            return
        penalty = float(self.get("solver.penalty"))
        given = penalty > 0 or self._by_row
        remedy = "use solver.penalty 0, which scales it with the masses" if given else "reduce solver.step_size"
        remedy += ", or raise solver.max_iterations"
        if left > UNFINISHED and given and self.continues:
            penalty = penalty or float(self.penalty.max())
            measured = f"with solver.penalty {penalty:g} the multiplier iteration still changes accelerations by "
            measured += f"{left:.1e} of themselves after {most} passes, more than {UNFINISHED:.0e}"
            raise self._error(StepError, t, measured, remedy)
        if not self._told:
            measured = f"an evaluation ended without convergence after {most} passes of the multiplier iteration"
            _LOGGER.warning("%s", self._error(StepError, t, measured, remedy))
            self._told = True

    @staticmethod
    def _light(M: NDArray, alpha: NDArray) -> NDArray:
        """M made small beside penalties, where there are any."""
        ratio = method.LIGHT * alpha.max(initial=0.0) / max(M.diagonal().max(initial=0.0), TINY)
        return M * min(1.0, ratio or 1.0)

    def carried(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """Return multipliers that act like lam (l,) with the least that joints carry, or as the given compliances share
        it."""
        e, l = self.equations, len(lam)
        M, C, _, _ = self.constraints(q, v)
        held = np.diag(self.active.astype(float))
        if e.compliances:
            alpha, lengths = np.diag(self.stiffnesses), held * np.isin(np.arange(l), e.lengths)

            def inverse(C: NDArray) -> method.Solve:
                return self.inverse(method.augmented_mass(self._light(M, alpha), C, alpha))

            return method.minimum_norm_of_joints(C, alpha, lengths, inverse, lam, CORRECTIONS, _unchanged)

        def slope(lam: NDArray) -> NDArray:
            return np.array(e.functions["shares"](q, v, a, lam, self.driven, self.memory["p"], self.time)).ravel()

        C, nothing = held @ C, slope(np.zeros(l))
        P = held @ np.reshape([slope(unit) - nothing for unit in np.eye(l)], (l, l)).T @ held + np.eye(l) - held
        sizes = np.where(P.diagonal() > EPS, P.diagonal(), 1.0)
        columns = (C**2 / sizes[:, None]).sum(axis=0)
        there = np.minimum(1, (C**2).sum(axis=0) * self.memory["k"][0] / self.scales)  # little for one of round-off
        weights = np.diag(np.divide(method.HELD_SHARES * there, columns, out=np.zeros_like(columns), where=columns > 0))
        eased = P + method.EASE * np.diag(sizes)
        return lam + method.shared_again(P, held @ slope(lam), C, weights, self.inverse, eased, CORRECTIONS, _unchanged)

    def impact(self, q: NDArray, v: NDArray) -> NDArray:
        """v (n,) after a plastic impact, which keeps the constraints: M dv + C' impulse = 0, C dv = -C v."""
        M, C, _, Cv, solve = self.augmented(q, v)
        return v + self.iterated(method.residual, M, np.zeros_like(v), C, -Cv, solve)[0]

    def hold(self, q: NDArray) -> None:
        """Keep the combinations of constraints that are independent at q (n,), a place on the motion, until told again.

        Redundant ones are left out of H where they would brake beside the motion: lam is then of least norm by itself.
        """
        if self.equations.survey.brakes:
            root = np.sqrt(self.penalty)
            rows, sizes, _ = np.linalg.svd(root[:, None] * self.constraints(q, np.zeros_like(q))[1])
            if sizes[self.rank - 1] > REGULAR * sizes[0]:  # else a singular position: those before it still tell
                self.alpha = root[:, None] * (rows[:, : self.rank] @ rows[:, : self.rank].T) * root

    # Projections --------------------------------------------------------------------------------------------------

    def project(self, q: NDArray, v: NDArray, t: float, near: bool = False) -> tuple[NDArray, NDArray, float, float]:
        """q and v brought back to the constraints with (10), and the largest |Phi| and |Phi-dot| left.

        Near a singular position the corrections gain little in the direction that the constraints hardly hold, which
        magnifies what is left open, so that one more is made; what is left above the tolerance is counted. Raises
        OpenError if more than `GROSS` is left.
        """
        M, C, Phi, Cv, solve = self.augmented(q, v)
        for _ in range(CORRECTIONS):
            if self._closed(Phi, C, q):
                if not near:
                    break
                near = False
            q = self._closer(M, C, Phi, solve, q)
            M, C, Phi, Cv, solve = self.augmented(q, v)
            self.counters.projection_iterations += 1
        for _ in range(CORRECTIONS):
            if self._closed(Cv, C, v):
                break
            v = v + self._correction(M, C, Cv, solve)
            Cv = self.constraints(q, v)[3]
            self.counters.projection_iterations += 1
        for what, residue in (("|Phi|", Phi), ("|Phi-dot|", Cv)):
            worst, row = self._worst(residue)
            if not worst <= GROSS:
                left = f"{what} = {worst:.1e} at {row} > {GROSS:.0e} after {CORRECTIONS} corrections"
                raise self._error(OpenError, t, left)
        self.counters.unprojected += not (self._closed(Phi, C, q) and self._closed(Cv, C, v))
        return q, v, self._largest(Phi), self._largest(Cv)

    def _closer(self, M: NDArray, C: NDArray, Phi: NDArray, solve: method.Solve, q: NDArray) -> NDArray:
        """Return q after a correction (10)."""

        def left(d: NDArray) -> NDArray:
            return self.constraints(q + d, d)[2]

        return q + method.project_residual(M, C, self.alpha, solve, Phi, left)

    def _correction(self, M: NDArray, C: NDArray, Cv: NDArray, solve: method.Solve) -> NDArray:
        """Return a correction (10) of v."""
        return method.project_residual(M, C, self.alpha, solve, Cv, lambda d: Cv + C @ d)

    def _closed(self, residue: NDArray, C: NDArray, x: NDArray) -> bool:
        """Return whether a residue of C is within the tolerance, or within the round-off of the row where that is
        larger."""
        limit = np.maximum(self.settings.tolerance * self.units, 8 * EPS * (abs(C) @ np.abs(x)))
        return bool((np.abs(residue) <= limit)[self.active].all())

    # Singular positions -------------------------------------------------------------------------------------------

    def pivots(self, q: NDArray) -> NDArray:
        """Pivots of H at q (n,) over the scales of their coordinates (n,), in the order of elimination."""
        M, C, _, _ = self.constraints(q, np.zeros_like(q))
        order = np.ix_(self.equations.order, self.equations.order)
        try:
            pivots = np.linalg.cholesky(method.augmented_mass(M, C, self.alpha)[order]).diagonal() ** 2
        except np.linalg.LinAlgError:
            pivots = np.zeros(len(q))
        return np.maximum(pivots / self.scales[self.equations.order], 1e-300)

    def margin(self, q: NDArray) -> tuple[bool, float]:
        """Return whether the margin at q (n,) may be below `singular.BRANCH_MARGIN`, and the margin (S2)."""
        ratios = self.pivots(q)
        if self.equations.turns and len(q) <= DENSE and np.prod(ratios) >= self.regular:
            return False, 1.0
        near, small = (ratios < branch.BRANCH_MARGIN).sum() > self.freedom, ratios[ratios < branch.SMALL_PIVOT]
        more = len(small) - self.freedom
        return near, math.exp(min((np.log(small).sum() - self.masses) / more, 0.0)) if more > 0 else 1.0

    def approach(self, q: NDArray, v: NDArray, spacing: float) -> tuple[float, float, float]:
        """Distance to a singular position, how much of it one spacing [s] makes, and a spacing that can tell."""
        for _ in range(branch.DOUBLINGS):
            before, here, after = (self.margin(q + k * spacing * v)[1] for k in (-1, 0, 1))
            rate = max(branch.curvature(before, here, after), 0.0) ** 0.5
            if here > self.nothing or rate**2 > self.nothing:
                break
            spacing *= 2  # The places are too near to be told from the singular position.
        return here**0.5, rate, spacing

    def on_branch(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        """q and v nearby that keep the constraints: displaced across the motion alone, v then by (10).

        The motion through the places so found is smooth up to the singular position itself.
        """

        def closer(q: NDArray) -> NDArray:
            M, C, Phi, _, solve = self.augmented(q, v)
            return self._closer(M, C, Phi, solve, q)

        near = closer(closer(q))
        M, C, _, _, solve = self.augmented(near, v)
        near, v = branch.returned(M, C, self.alpha, solve, self.heavy, near, q, v, *self._moving(near, v))
        near = closer(near)
        for _ in range(2):
            M, C, _, Cv, solve = self.augmented(near, v)
            v = v + self._correction(M, C, Cv, solve)
        return near, v

    def _moving(self, q: NDArray, v: NDArray) -> tuple[Callable[[NDArray], NDArray], NDArray] | tuple[()]:
        """Where time is a coordinate, Phi-dot of velocities at q, and v with time standing still."""
        if not self.equations.timed:
            return ()
        return lambda x: self.constraints(q, x)[3], np.append(v[:-1], 0.0)

    def reached(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """What `on_branch` returns; raise OpenError if the branch does not lead there."""
        near, v = self.on_branch(q, v)
        gap, row = self._worst(self.constraints(near, v)[2])
        if not gap <= GROSS:
            raise self._error(OpenError, t, f"the branch of the motion leaves {row} open by {gap:.1e} ahead")
        return near, v

    def accelerations_on_branch(self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: float) -> Found:
        """What `accelerations` returns, at the place of the branch nearest to q; its limit near a singular position.

        `spacing` [s] of the places from which a limit is taken, along v; longer where the motion is slow, and shorter
        where it is fast. Where the motion does not reach them, accelerations are taken as they are, as long as the
        iteration converges.
        """
        here, rate, spacing = self.approach(q, v, spacing)
        if not (rate > 0 and here < branch.LIMIT_ZONE * self.least_distance):
            return self.accelerations(*self.reached(q, v, t), u, t)
        unconverged = self.counters.unconverged
        try:
            _, found = self._beside(q, v, u, t, spacing * self.least_distance / rate, branch.MEAN)
            a, lam, left = (branch.mean({k: x[i] for k, x in found.items()}) for i in (0, 1, 3))
            return a, lam, max(x[2] for x in found.values()), left
        except OpenError:
            alone = self.accelerations(*self.reached(q, v, t), u, t, PATIENT)
            if self.counters.unconverged > unconverged:
                raise self._error(OpenError, t, "the multiplier iteration does not converge") from None
            return alone

    def _beside(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: float, at: Iterable[int]
    ) -> tuple[dict[int, tuple[NDArray, NDArray]], dict[int, Found]]:
        """q and v, and what `accelerations` returns, at places on the branch before and after q."""
        places = {k: self.reached(q + k * spacing * v, v, t) for k in at}
        return places, {k: self.accelerations(*place, u, t) for k, place in places.items()}

    # Steps --------------------------------------------------------------------------------------------------------

    def step(self, communication_step: float, time: float | None = None) -> None:
        """Cover one communication step [s] as the runtime does, with what it refuses and raises."""
        h, start = communication_step, self.time if time is None else time
        before, counters, penalty, v = self.save(), copy(self.counters), self.penalty, self.v.copy()
        self._judged(self._scene.library.alfmu_ready(self._unit.address, start, h))
        try:
            self._change(penalty, v)
            self.memory["begin"][:] = self.memory["z"]
            if self._past:
                self._past.reach(start, self.inputs)
            for begin, end in self._stretches(start, start + h):
                if begin > start:  # the last digits of a time at which something jumps by itself
                    self.q[:] += (begin - self.time) * self.v
                    self.time, self._seen = begin, (None, None, None)
                length = end - begin if (begin, end) != (start, start + h) else h
                n = internal_steps(length, self.settings.step_size)
                for k in range(n):
                    self._step(begin + k * (length / n), length / n)
        except AlfmuError:
            self.restore(before)
            self.counters = counters
            raise
        self.time = start + h
        self._step_error = self._scene.library.alfmu_balance(self._unit.address)
        self.counters.run_error = self._counted()["run_error"]
        self._warn()

    def _stretches(self, begin: float, end: float) -> Iterable[tuple[float, float]]:
        """Return times [s] between which nothing jumps by itself, as `alfmu_ready` has found them."""
        count = self._scene.library.alfmu_breaks(self._unit.address, None)
        times = (ctypes.c_double * (2 * count))()
        self._scene.library.alfmu_breaks(self._unit.address, times)
        for left, right in zip(times[::2], times[1::2], strict=True):
            if left > begin:
                yield begin, min(left, end)
            begin = max(begin, right)
        if end > begin:
            yield begin, end

    def _step(self, start: float, dt: float) -> None:
        """Make an internal step, in shorter ones where constraints stay open near a singular position."""
        t, h, near = 0.0, dt, False
        while t < dt:
            try:
                self._follow(start + t, h)
                t, h = t + h, min(2 * h, dt - t - h)
            except OpenError as error:
                h, near = h / 2, near or self._near
                if not near:
                    raise
                if h <= dt * SHORTEST:
                    names = (c.name for c in self.equations.coordinates[:SAID])
                    where = ", ".join(f"{name} = {x:.6g}" for name, x in zip(names, self.q, strict=False))
                    ended = (
                        f"no motion goes on from this singular position (distance {self.margin(self.q)[1] ** 0.5:.1e})"
                    )
                    remedy = f"{ended}; turn round before it, or change lengths or start"
                    raise self._error(StepError, start + t, f"locked up at {where}", remedy) from error

    @np.errstate(all="ignore")
    def _follow(self, start: float, dt: float) -> None:
        """Make one step of RK4 and its projections, all stages on the branch if one is near a singular position."""
        n, c, t = self.equations.n, self.counters, start + dt
        read = self._seen[2] if start == self.time and self._seen[0] == self._key() else None

        def rate(t: float, y: NDArray, on_branch: bool = False) -> NDArray:
            (q, v, _, x), u = np.split(y, parts), self._past.at(t, self.order) if self._past else self.inputs
            u = np.concatenate([u, x])
            if on_branch:
                a, lam, *_ = self.accelerations_on_branch(q, v, u, t, branch.SPACING * dt)
            else:
                self._near = self._near or (self.continues and self.margin(q)[0])
                a, lam = self.accelerations(q, v, u, t)[:2] if read is None or t > start else read
            return np.concatenate(
                [v, a, [self.power(q, v, u, t) + self.supply(q, v, a, lam, u, t)], self.state_rates(q, v, u, t)]
            )

        parts = [n, 2 * n, 2 * n + 1]
        self.hold(self.q)
        self._unfinished = 0.0
        begin, unconverged = np.concatenate([self.q, self.v, [self.work], self.states]), c.unconverged
        self._near = False
        y = rk4(rate, start, begin, dt)
        if self._near:
            c.unconverged, self._unfinished = unconverged, 0.0
            y = rk4(lambda t, y: rate(t, y, on_branch=True), start, begin, dt)
        if not np.isfinite(y).all():
            raise self._error(StepError, t, "the state is not finite")
        q, v, work, x = np.split(y, parts)
        if self.settings.projects:
            self._check_length(np.abs(q - self.q)[: self.equations.dependent], q, t)
            q, v, position, velocity = self.project(q, v, t, self._near)
        else:
            position, velocity = self.residues(q, v)
        self._check_converged(t)
        c.steps += 1
        c.position_error, c.velocity_error = max(c.position_error, position), max(c.velocity_error, velocity)
        self._unwrap(self.readings(q, v, np.zeros(n), np.zeros(self.equations.l), self.driven, t))
        self._count_turns(q)
        if self.equations.timed:
            q[-1], v[-1] = t, 1.0
        self.q[:], self.v[:], self.states[:], self.state[self.layout.work], self.time = q, v, x, work[0], t

    def _check_length(self, moved: NDArray, q: NDArray, t: float) -> None:
        """Raise StepError if a step to q that moved the coordinates by `moved` (n,) is too long to be meaningful."""
        turned, (gap, row) = moved[self._turns[: len(moved)]].max(initial=0.0), self._worst(self.constraints(q, q)[2])
        if turned > TURN:
            raise self._error(StepError, t, f"an angle turned by {turned:.3g} rad in one step, more than half a turn")
        if gap > max(TORN * moved.max(initial=0.0), GROSS):
            raise self._error(StepError, t, f"a step of {moved.max():.3g} opened {row} by {gap:.3g}")

    def _change(self, penalty: NDArray, v: NDArray) -> None:
        """v after an impact, where the runtime put constraints in force that were not by `penalty` (l,), at v (n,)."""
        if (penalty != self.penalty).any():
            self._know()
            if (self.active & (penalty == 0)).any():
                self.v[:] = self.impact(self.q, v)

    def _penalize(self, alpha: NDArray) -> None:
        if not self.initialized:
            self._by_row = True
            return super()._penalize(alpha)
        before, v = self.penalty, self.v.copy()
        super()._penalize(alpha)
        return self._change(before, v)

    def restore(self, state: bytes) -> None:
        super().restore(state)
        if self.initialized:
            self._know()

    # Readings -----------------------------------------------------------------------------------------------------

    def get(self, name: str) -> float | str:
        """Return the value of an output, input, parameter, start value or solver number."""
        place = self._references.get(name, -1) - self._scene.first_output
        return float(self.read()[place]) if place >= 0 else super().get(name)

    def read(self) -> NDArray:
        """Return all outputs, in the order of `outputs`, at this time and for the inputs as they are now."""
        if not self.initialized:
            raise InputError(f"{self.name}: outputs are known after initialising")
        if self._seen[0] != self._key():
            self.hold(self.q)
            self._unfinished = 0.0
            a, lam, used, left, singular, lost = self._now()
            self._check_converged(self.time)
            q, v, e = self.q, self.v, self.equations
            y = self._unwrap(self.readings(q, v, a, lam, self.driven, self.time))
            values = *self.residues(q, v), self.energy(q, v), self.work, self._step_error
            values = *values, used, self.margin(q)[1] ** 0.5, singular, lost
            seen = {monitor.name: float(x) for monitor, x in zip(MONITORS, values, strict=True)}
            seen = {name: x for name, x in seen.items() if name not in e.monitors}
            came = [self._unit.get(self._references[x.name]) for x in events(e)]
            self._seen = self._key(), np.concatenate([y, [*seen.values()], came]), (a, lam)
            self._watch(seen, left)
        return self._seen[1].copy()

    def _key(self) -> bytes:
        """Return a key of everything that readings depend on."""
        p = self.memory["p"]  # with what signals are
        return b"".join(x.tobytes() for x in (self.q, self.v, self.driven, p, self.penalty, self.state[-1:]))

    @np.errstate(all="ignore")
    def _now(self) -> tuple[NDArray, NDArray, int, NDArray, int, float]:
        """What `accelerations` returns here, lam as joints carry it, whether it is a limit, and its error.

        It is 0 if lam is no limit; where it is, 1 if lam has a limit, 2 where it has a pole, of which the finite part
        is given at the position itself.
        """
        q, v, u, t = self.q, self.v, self.driven, self.time
        margin = self.margin(q)[1]
        near = self.continues and margin**0.5 < branch.READ_ZONE * branch.READ_DISTANCE
        a, lam, used, left = self.accelerations(q, v, u, t)
        lam = self.carried(q, v, a, lam) if self.settings.projects else lam
        _, C, F, _ = self.dynamics(q, v, u, t)
        lost = (
            branch.reading_error(margin, EPS) * max(np.abs(x).max(initial=0.0) for x in (F, C.T @ lam)) * bool(len(lam))
        )
        if near:
            _, rate, spacing = self.approach(q, v, branch.SPACING * self.settings.step_size)
            with suppress(OpenError, ZeroDivisionError):  # The motion may end before the places: then as it is here.
                places, found = self._beside(q, v, u, t, spacing * branch.READ_DISTANCE / rate, branch.READ_MEAN)
                # At the position itself more multipliers act alike than on the branch.
                loads = {k: self.carried(*places[k], *x[:2]) for k, x in found.items()}
                limit, pole, magnified = branch.with_pole(loads)
                told, fewer = magnified > 0 or not pole, branch.fewer(loads)
                rough, coarse = (branch.with_pole(x, told)[0] for x in (fewer, branch.fewer(fewer)))
                change, before = (np.abs(x).max() for x in (limit - rough, rough - coarse))
                if margin <= self.nothing or not branch.direct_error(margin, EPS) * np.abs(limit).max() < change:
                    a, lam = branch.mean({k: x[0] for k, x in found.items()}), limit
                    _, C, _, xi = self.dynamics(q, v, u, t)
                    left, largest = C @ a - xi, max(np.abs(x).max() for x in loads.values())
                    lost = branch.limit_error(change, before, largest, magnified, EPS)
                return a, lam, max(x[2] for x in found.values()), left, 1 + pole, lost
        return a, lam, used, left, 0, lost

    def _unwrap(self, y: NDArray) -> NDArray:
        """Readings whose computed angles are moved by whole turns to the values nearest to the last ones."""
        names = [v.name for v in self.equations.outputs]
        places = [names.index(name) for name in self.equations.wrapped]
        angles = self.angles[: len(places)]
        y[places] += 2 * np.pi * np.round((angles - y[places]) / (2 * np.pi))
        angles[:] = y[places]
        return y

    def _count_turns(self, q: NDArray) -> None:
        """Angles whose turns count as they are at q (n,): where they were last, for what comes."""
        e, p = self.equations, self.memory["p"]
        if e.counted:
            begin = len(e.parameters) + e.held.index(next(iter(e.counted)))
            angles = np.array(e.functions["counted"](q, p)).ravel()
            p[begin : begin + len(angles)] = self.angles[len(e.wrapped) :] = angles

    def _watch(self, seen: dict[str, float], left: NDArray) -> None:
        """Keep the largest errors; NaN for what nobody watches."""
        balance = abs(seen.get("monitor.energy", math.nan) - self.energy_start - self.work)
        found = {name: seen.get(f"monitor.{name}", math.nan) for name in ("position_error", "velocity_error")}
        found |= {"acceleration_error": self._largest(left), "energy_error": balance}
        for name, x in found.items():
            setattr(self.counters, name, float(np.maximum(getattr(self.counters, name), x)))

    def _largest(self, residue: NDArray) -> float:
        return float(np.abs(residue[self.active]).max(initial=0.0))

    def _worst(self, residue: NDArray) -> tuple[float, str]:
        """Return the largest residue, in units of its row, and what the row is called; 0 if there are none."""
        if not len(residue):
            return 0.0, ""
        sizes = np.where(self.active, np.nan_to_num(np.abs(residue / self.units), nan=np.inf), 0)
        row = self.equations.rows[int(np.argmax(sizes))]
        return float(sizes.max()), row.text

    def _error(
        self, kind: type[AlfmuError], t: float, measured: str, remedy: str = "reduce solver.step_size"
    ) -> AlfmuError:
        return kind(f"{self.name}, t = {t:.6g} s: {measured}; {remedy}")


def _unchanged(change: NDArray, value: NDArray) -> bool:
    """Return whether a pass changed round-off alone."""
    return bool(np.abs(change).max(initial=0.0) <= EPS * np.abs(value).max(initial=0.0))


def _least_squares(blocks: list, right: list) -> tuple[NDArray, NDArray]:
    """Least-squares solution of least norm of the block system (9); NaN where that is not finite.

    LAPACK is not asked then: it would say so on the screen.
    """
    (M, Ct), (C, _) = blocks
    K, b = np.block([[M, Ct], [C, np.zeros((len(C), len(C)))]]), np.concatenate(right)
    finite = np.isfinite(K).all() and np.isfinite(b).all()
    a, lam = np.split(np.linalg.lstsq(K, b, rcond=None)[0] if finite else np.full(len(b), np.nan), [len(M)])
    return a, lam
