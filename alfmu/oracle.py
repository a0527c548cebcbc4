"""Blajer's method on NumPy arrays, with loops that stop on convergence: slow, readable, and the measure of the kernel.

To be read with the paper open (`alfmu.method.formulations` has its equations and letters, `alfmu.method.singular` what
is known of singular positions). Values by name, the start, scales and ranks, switches and the state are those of the C
runtime. What the paper does while time passes is computed here, from functions of the equations alone: accelerations
and multipliers by every formulation, steps of RK4 with projections (10), the branch of the motion through singular
positions, and plastic impacts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import runtime
from .equations import Equations
from .equations.interface import MONITORS, Counters, events, setting
from .kernel.program import GROSS, SETTINGS, TURN, Call
from .kernel.thresholds import PATIENT, REGULAR, SAID, SHORTEST, TORN
from .kernel.vm import Vm
from .method import formulations as method
from .method import singular as branch
from .method.formulations import CORRECTIONS
from .method.inputs import Past
from .method.integrators import rk4
from .model.errors import AlfmuError, InputError, OpenError, StepError

__all__ = ["Instance"]

Found = tuple[NDArray, NDArray, int, NDArray]
"""Accelerations a (n,), multipliers lam (l,), the multiplier iterations used, Phi-ddot (l,) that is left."""

EPS = float(np.finfo(float).eps)


class Instance(runtime.Instance):
    """An instance of the runtime whose steps and readings are made here; used alike, with `rk4` alone."""

    def _take(self, equations: Equations) -> None:
        super()._take(equations)
        e, vm = self.equations, Vm(self.equations)
        names = ("dynamics", "constraints", "power", "energy", "readings")
        self._functions = {name: Call(vm, name, e.signatures[name]) for name in names}
        self._turns = np.array([c.unit == "rad" for c in e.coordinates])
        self._seen: tuple = (None, None, None)
        self._counters = Counters()

    def initialize(self) -> None:
        """Begin as the runtime does; InputError where another method of integration is asked for."""
        if self.choices["solver.method"] != "rk4":
            raise InputError(
                f"{self.name}: the oracle integrates by rk4 alone, and solver.method is "
                f"{self.choices['solver.method']}; use kernel vm or compiled"
            )
        super().initialize()
        self._counters = Counters()
        self._know()

    def restore(self, state: bytes) -> None:
        super().restore(state)
        if self.initialized:
            self._know()

    def _know(self) -> None:
        """What the runtime found at the start or at an event: penalties, units of rows, scales of pivots, freedoms."""
        e, k = self.equations, self.memory["k"]
        chosen = {setting(name): self.get(name) for name in ("solver.formulation", "solver.branch")}
        numbers = {name: self.get(f"solver.{name}") for name in ("step_size", "tolerance")}
        whole = {name: int(self.get(f"solver.{name}")) for name in ("max_iterations", "input_order")}
        self.settings = replace(self._given, **chosen, **numbers, **whole)
        self.continues = self.settings.continues and e.l > 0
        self.freedom, self.masses, self.regular, self.nothing, self.least_distance = k[2:7]
        self.active = self.penalty > 0
        ends = np.cumsum([SETTINGS, e.l, e.l, e.n, len(e.compliances)])
        _, _, inverse_units, inverse_scales, stiffnesses, _ = np.split(k, ends)
        self.units, self.scales, self.stiffnesses = 1 / inverse_units, k[0] / inverse_scales, k[0] * stiffnesses
        self.alpha = self._diagonal(self.penalty)
        self.rank = e.n - self.mobility().freedom if e.brakes else 0
        self.heavy = np.zeros(e.n)
        self.heavy[e.telling] = branch.HEAVY * self.nothing / branch.NOTHING * self.scales[e.telling]
        self._past = Past(len(e.inputs), self.memory["past"]) if whole["input_order"] and e.inputs else None

    # Equations ----------------------------------------------------------------------------------------------------

    def _values(self, function: str, *arguments: NDArray | float) -> list[Any]:
        """The results of a function of the equations."""
        return [x.copy() for x in self._functions[function](*arguments)]

    def dynamics(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> list[Any]:
        """M, C, F = f - d and xi of (3) and (4)."""
        return self._values("dynamics", q, v, u, self.memory["p"], t)

    def constraints(self, q: NDArray, v: NDArray) -> list[Any]:
        """M, C, Phi and C v of (1) and (2)."""
        return self._values("constraints", q, v, self.memory["p"])

    def residues(self, q: NDArray, v: NDArray) -> tuple[float, float]:
        """The largest |Phi| and |Phi-dot|."""
        _, _, Phi, Cv = self.constraints(q, v)
        return self._largest(Phi), self._largest(Cv)

    def power(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> float:
        """Power [W] of inputs, loads and dampers."""
        return float(self._values("power", q, v, u, self.memory["p"], t)[0][0]) if self.equations.works else 0.0

    def energy(self, q: NDArray, v: NDArray) -> float:
        """Kinetic and potential energy [J]."""
        return float(self._values("energy", q, v, self.memory["p"])[0][0])

    def readings(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> NDArray:
        """Everything a user can read, in the order of `equations.outputs`."""
        return self._values("readings", q, v, a, lam, u, self.memory["p"], t)[0]

    # Accelerations ------------------------------------------------------------------------------------------------

    def accelerations(self, q: NDArray, v: NDArray, u: NDArray, t: float, patience: int = 1) -> Found:
        """Accelerations and multipliers by the formulation that is chosen; `patience` times as many iterations."""
        M, C, F, xi = self.dynamics(q, v, u, t)
        kind, alpha = self.settings.formulation, self.alpha
        if not all(np.isfinite(_entries(x)).all() for x in (M, F, xi)):
            raise StepError(self._say(t, "the equations of motion are not finite", "reduce solver.step_size"))
        self._counters.evaluations += 1
        if kind in ("residual", "classic"):
            iterate = method.residual if kind == "residual" else method.classic
            a, lam, used, converged = self._iterated(iterate, M, F, C, xi, t, patience)  # (8)
            self._counters.unconverged += not converged
        else:
            used, (_, _, Phi, Cv) = 1, self.constraints(q, v)
            stabilised = method.stabilised(xi, Cv, Phi, self.settings.zeta, self.settings.omega)
            if kind == "penalty":
                a, lam = method.penalty(F, C, stabilised, alpha, self.inverse(self._augmented(M, C), t))  # (6)
            elif kind == "stiffness":
                a, lam = method.stiffness(F, C, Phi, self.settings.omega**2 * alpha, self.inverse(M, t))  # (5)
            else:
                held, lam = np.flatnonzero(self.active), np.zeros_like(xi)
                right = (xi if kind == "dae" else stabilised)[held]
                a, lam[held] = method.dae(M, F, C[held], right, _least_squares)  # (9)
        self._counters.multiplier_iterations += used
        return a, lam, used, C @ a - xi

    def _iterated(
        self, iterate: Callable, M: Any, F: NDArray, C: Any, xi: NDArray, t: float, patience: int = 1
    ) -> tuple[NDArray, NDArray, int, bool]:
        """(8), classic or residual, until the change is within the tolerance of the accelerations it changes.

        Null vectors of C' do not act on a, so that alpha times the round-off of each pass stays in lam along them. Yet
        they act on tangents: lam is handed out without them.
        """
        solve, limit = self.inverse(self._augmented(M, C), t), self.settings.tolerance
        scale = np.abs(F).max(initial=0.0) / np.abs(_entries(M)).max(initial=1e-300)

        def done(da: NDArray, a: NDArray) -> bool:
            return np.abs(da).max() <= limit * max(np.abs(a).max(), scale)

        zeros, most = (np.zeros_like(F), np.zeros_like(xi)), patience * self.settings.max_iterations
        a, lam, used, converged = iterate(M, F, C, xi, self.alpha, solve, *zeros, most, done)
        return a, _least(C, self.alpha, solve, lam), used, converged

    def minimum_norm(self, q: NDArray, v: NDArray, lam: NDArray, t: float) -> NDArray:
        """Multipliers that act like lam (l,): of least norm, or as constraints of the given compliances share them."""
        M, C, _, _ = self.constraints(q, v)
        alpha = self._diagonal(self.stiffnesses) if self.equations.compliances else self.alpha
        return _least(C, alpha, self.inverse(method.augmented_mass(M, C, alpha), t), lam)

    def impact(self, q: NDArray, v: NDArray, t: float) -> NDArray:
        """v (n,) after a plastic impact, which keeps the constraints: M dv + C' impulse = 0, C dv = -C v."""
        M, C, _, Cv = self.constraints(q, v)
        return v + self._iterated(method.residual, M, np.zeros_like(v), C, -Cv, t)[0]

    # Projections --------------------------------------------------------------------------------------------------

    def project(self, q: NDArray, v: NDArray, t: float, near: bool = False) -> tuple[NDArray, NDArray, float, float]:
        """q and v brought back to the constraints with (10), and the largest |Phi| and |Phi-dot| left.

        Near a singular position the corrections gain little in the direction that the constraints hardly hold, which
        magnifies what is left open, so that one more is made; what is left above the tolerance is counted. Raises
        OpenError where more than `GROSS` is left.
        """
        c, (M, C, Phi, Cv) = self._counters, self.constraints(q, v)
        for _ in range(CORRECTIONS):
            if self._closed(Phi, C, q):
                if not near:
                    break
                near = False
            q = q + method.project(C, self.alpha, self.inverse(self._augmented(M, C), t), Phi)  # (10)
            M, C, Phi, Cv = self.constraints(q, v)
            c.projection_iterations += 1
        solve = self.inverse(self._augmented(M, C), t)
        for _ in range(CORRECTIONS):
            if self._closed(Cv, C, v):
                break
            v = v + method.project(C, self.alpha, solve, Cv)  # (10)
            Cv = C @ v
            c.projection_iterations += 1
        for what, residue in (("|Phi|", Phi), ("|Phi-dot|", Cv)):
            worst, row = self._worst(residue)
            if not worst <= GROSS:
                measured = f"{what} = {worst:.1e} at {row} > {GROSS:.0e} after {CORRECTIONS} corrections"
                raise OpenError(self._say(t, measured, "reduce solver.step_size"))
        c.unprojected += not (self._closed(Phi, C, q) and self._closed(Cv, C, v))
        return q, v, self._largest(Phi), self._largest(Cv)

    def _closed(self, residue: NDArray, C: Any, x: NDArray) -> bool:
        """Whether a residue of C is within the tolerance, or within the round-off of the row where that is larger."""
        limit = np.maximum(self.settings.tolerance * self.units, 8 * EPS * (abs(C) @ np.abs(x)))
        return bool((np.abs(residue) <= limit)[self.active].all())

    # Singular positions -------------------------------------------------------------------------------------------

    def margin(self, q: NDArray) -> float:
        """How far q (n,) is from a singular position: see `alfmu.method.singular.GUARD`."""
        pivots = self._pivots(q)
        small = np.maximum(pivots[pivots < branch.SMALL], 1e-300)
        more = len(small) - self.freedom
        if more <= 0 or self._regular(pivots):
            return 1.0
        return math.exp(min((np.log(small).sum() - self.masses) / more, 0.0))

    def near(self, q: NDArray) -> bool:
        """Whether the margin at q may be below the guard: more pivots are than there are degrees of freedom."""
        pivots = self._pivots(q)
        return int((pivots < branch.GUARD).sum()) > self.freedom and not self._regular(pivots)

    def _regular(self, pivots: NDArray) -> bool:
        """Whether a position is known to be regular by all pivots together: see `alfmu.method.singular.FAR`."""
        return self.equations.turns and isinstance(self.alpha, np.ndarray) and np.prod(pivots) >= self.regular

    def _pivots(self, q: NDArray) -> NDArray:
        """Pivots of H over the scales of their coordinates (n,); zeros where it is singular."""
        M, C, _, _ = self.constraints(q, np.zeros_like(q))
        H, order = self._augmented(M, C), self.equations.order
        try:
            return _factorised(H, order) / self.scales[order]
        except (np.linalg.LinAlgError, RuntimeError):
            return np.zeros(len(order))

    def on_branch(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        """q and v nearby that keep the constraints: displaced across the motion alone, v then by (10).

        The motion through the places so found is smooth up to the singular position itself.
        """
        near = self._closer(self._closer(q, v), v)
        M, C, _, _ = self.constraints(near, v)
        solve = self.inverse(self._augmented(M, C), 0.0)
        near, v = branch.returned(M, C, self.alpha, solve, self.heavy, near, q, v)
        near = self._closer(near, v)
        M, C, _, _ = self.constraints(near, v)
        solve = self.inverse(self._augmented(M, C), 0.0)
        for _ in range(2):
            v = v + method.project(C, self.alpha, solve, C @ v)  # (10)
        return near, v

    def _closer(self, q: NDArray, v: NDArray) -> NDArray:
        M, C, Phi, _ = self.constraints(q, v)
        return q + method.project(C, self.alpha, self.inverse(self._augmented(M, C), 0.0), Phi)  # (10)

    def reached(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """What `on_branch` returns; OpenError where the branch does not lead there."""
        near, rate = self.on_branch(q, v)
        gap, row = self._widest(near)
        if not gap <= GROSS:
            measured = f"the branch of the motion leaves {row} open by {gap:.1e} ahead"
            raise OpenError(self._say(t, measured, "reduce solver.step_size"))
        return near, rate

    def approach(self, q: NDArray, v: NDArray, spacing: float) -> tuple[float, float, float]:
        """Distance to a singular position, how much of it one spacing [s] makes, and a spacing that can tell."""
        for _ in range(branch.LONGER):
            before, here, after = (self.margin(q + k * spacing * v) for k in (-1, 0, 1))
            rate = max(branch.curvature(before, here, after), 0.0) ** 0.5
            if here > self.nothing or rate**2 > self.nothing:
                break
            spacing *= 2  # The places are too near to be told from the singular position.
        return here**0.5, rate, spacing

    def accelerations_on_branch(self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: float) -> Found:
        """What `accelerations` returns, at the place of the branch nearest to q; its limit near a singular position.

        `spacing` [s] of the places from which a limit is taken, along v; longer where the motion is slow, and shorter
        where it is fast. Where the motion does not reach them, accelerations are taken as they are, as long as the
        iteration converges.
        """
        here, rate, spacing = self.approach(q, v, spacing)
        wanted = branch.first_distance(rate, self.least_distance, min, max)
        if not (rate > 0 and here < branch.ZONE * wanted):
            return self.accelerations(*self.reached(q, v, t), u, t)
        try:
            _, found = self._beside(q, v, u, t, spacing * wanted / rate, branch.MEAN)
        except OpenError:
            before = self._counters.unconverged
            alone = self.accelerations(*self.reached(q, v, t), u, t, PATIENT)
            if self._counters.unconverged > before:
                measured = "the multiplier iteration does not converge"
                raise OpenError(self._say(t, measured, "reduce solver.step_size")) from None
            return alone
        a, lam, left = (branch.mean({k: x[i] for k, x in found.items()}) for i in (0, 1, 3))
        return a, lam, max(x[2] for x in found.values()), left

    def _beside(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: float, at: Iterable[int]
    ) -> tuple[dict[int, tuple], dict[int, Found]]:
        """q and v, and what `accelerations` returns, at places on the branch before and after q."""
        places = {k: self.reached(q + k * spacing * v, v, t) for k in at}
        return places, {k: self.accelerations(*place, u, t) for k, place in places.items()}

    # Steps --------------------------------------------------------------------------------------------------------

    def step(self, communication_step: float, time: float | None = None) -> None:
        """Cover one communication step [s]: as the runtime's, also in what it raises."""
        h, start = communication_step, self.time if time is None else time
        before, counters, penalty, v = self.save(), copy(self._counters), self.penalty, self.v.copy()
        self._judged(self._scene.library.alfmu_ready(self._unit.address, start, h))
        try:
            self._change(penalty, v)
            n = max(1, math.ceil(h / self.settings.step_size * (1 - 1e-12)))
            if self._past:
                self._past.reach(start, self.inputs)
            for k in range(n):
                self._step(start + k * (h / n), h / n)
        except AlfmuError:
            self.restore(before)
            self._counters = counters
            raise
        self.time = start + h

    def _change(self, penalty: NDArray, v: NDArray) -> None:
        """v after an impact, where the runtime put constraints in force that were not by `penalty` (l,), at v (n,)."""
        if (penalty == self.penalty).all():
            return
        self._know()
        if (self.active & (penalty == 0)).any():
            self.v[:] = self.impact(self.q, v, self.time)

    @property
    def penalty(self) -> NDArray:
        return runtime.Instance.penalty.fget(self)

    @penalty.setter
    def penalty(self, alpha: ArrayLike) -> None:
        before, v = self.penalty, self.v.copy()
        runtime.Instance.penalty.fset(self, alpha)
        if self.initialized:
            self._change(before, v)

    def _step(self, start: float, dt: float) -> None:
        """An internal step; near a singular position in shorter ones where constraints stay open."""
        t, h, near = 0.0, dt, False
        while t < dt:
            try:
                self._rk4(start + t, h)
                t, h = t + h, min(2 * h, dt - t - h)
            except OpenError as error:
                near, h = near or self._near, h / 2
                if not near:
                    raise
                if h > dt * SHORTEST:
                    continue
                at = ", ".join(
                    f"{c.name} = {x:.6g}" for c, x in [*zip(self.equations.coordinates, self.q, strict=True)][:SAID]
                )
                raise StepError(
                    f"{self.name}, t = {start + t:.6g} s: locked up at {at}; no motion goes on from this singular "
                    f"position (distance {self.margin(self.q) ** 0.5:.1e}); turn round before it, or change lengths or "
                    "start"
                ) from error

    @np.errstate(all="ignore")
    def _rk4(self, start: float, dt: float) -> None:
        """One step of RK4 and the projections after it; all stages on the branch where one is near its singularity."""
        n, c, t = self.equations.n, self._counters, start + dt
        known = self._seen[2] if start == self.time and self._key() == self._seen[0] else None
        self._near = False

        def inputs(t: float) -> NDArray:
            return self._past.at(t, self.settings.input_order) if self._past else self.inputs

        def moved(t: float, q: NDArray, v: NDArray, a: NDArray) -> NDArray:
            return np.concatenate([v, a, [self.power(q, v, inputs(t), t)]])

        def rate(t: float, y: NDArray) -> NDArray:
            q, v = y[:n], y[n : 2 * n]
            self._near = self._near or (self.continues and self.near(q))
            a = known if known is not None and t == start else self.accelerations(q, v, inputs(t), t)[0]
            return moved(t, q, v, a)

        def rate_on_branch(t: float, y: NDArray) -> NDArray:
            q, v = y[:n], y[n : 2 * n]
            return moved(t, q, v, self.accelerations_on_branch(q, v, inputs(t), t, branch.SPACING * dt)[0])

        self.hold(self.q)
        begin, unconverged = np.concatenate([self.q, self.v, [self.work]]), c.unconverged
        y = rk4(rate, start, begin, dt)
        if self._near:
            c.unconverged = unconverged
            y = rk4(rate_on_branch, start, begin, dt)
        if not np.isfinite(y).all():
            raise StepError(self._say(t, "the state is not finite", "reduce solver.step_size"))
        q, v = y[:n], y[n : 2 * n]
        if self.settings.projects:
            self._check_length(q - self.q, q, t)
            q, v, position, velocity = self.project(q, v, t, self._near)
        else:
            position, velocity = self.residues(q, v)
        c.steps += 1
        c.position_error, c.velocity_error = max(c.position_error, position), max(c.velocity_error, velocity)
        if self.equations.wrapped:
            self._unwrap(self.readings(q, v, np.zeros(n), np.zeros(self.equations.l), self.inputs, t))
        self.q[:], self.v[:], self.state[self.layout.work], self.time = q, v, y[-1], t

    def hold(self, q: NDArray) -> None:
        """Keep the combinations of constraints that are independent at q (n,), a place on the motion, until told again.

        Redundant ones are left out of H where they would brake beside the motion: lam is then of least norm by itself.
        """
        if not self.equations.brakes:
            return
        root = np.sqrt(self.penalty)
        rows, sizes, _ = np.linalg.svd(root[:, None] * self.constraints(q, np.zeros_like(q))[1])
        if sizes[self.rank - 1] > REGULAR * sizes[0]:  # else a singular position: those before it still tell
            kept = rows[:, : self.rank]
            self.alpha = root[:, None] * (kept @ kept.T) * root

    def _check_length(self, moved: NDArray, q: NDArray, t: float) -> None:
        """StepError where a step to q that moved the coordinates so far (n,) is too long to mean anything."""
        turned, advice = np.where(self._turns, np.abs(moved), 0.0), "reduce solver.step_size"
        if turned.max(initial=0.0) > TURN:
            name = self.equations.coordinates[int(np.argmax(turned))].name
            measured = f"{name} turned by {turned.max():.3g} rad in one step, more than half a turn"
            raise StepError(self._say(t, measured, advice))
        gap, row = self._widest(q)
        if gap > TORN * np.abs(moved).max(initial=0.0) and gap > GROSS:
            raise StepError(self._say(t, f"a step of {np.abs(moved).max():.3g} opened {row} by {gap:.3g}", advice))

    # Readings -----------------------------------------------------------------------------------------------------

    def get(self, name: str) -> float | str:
        """The value of an output, input, parameter, start value or solver number."""
        reference = self._references.get(name, 0)
        if reference >= self._scene.first_output:
            return float(self.read()[reference - self._scene.first_output])
        return super().get(name)

    def read(self) -> NDArray:
        """All outputs, in the order of `outputs`, at this time and for the inputs as they are now."""
        if not self.initialized:
            raise InputError(f"{self.name}: outputs are known after initialising")
        if self._seen[0] != self._key():
            self.hold(self.q)
            a, lam, used, left, singular = self._now()
            self._seen = self._key(), self._outputs(a, lam, used, singular), a
            self._watch(left)
        return self._seen[1].copy()

    def _key(self) -> bytes:
        """What readings depend on."""
        return b"".join(x.tobytes() for x in (self.q, self.v, self.inputs, self.penalty, self.state[-1:]))

    @np.errstate(all="ignore")
    def _now(self) -> tuple[NDArray, NDArray, int, NDArray, int]:
        """What `accelerations` returns here, lam of least norm, and whether it is a limit.

        The last result is 0 where it is not; where it is, 1 where lam has a limit, 2 where it has a pole, of which the
        finite part is given at the position itself.
        """
        q, v, u, t = self.q, self.v, self.inputs, self.time
        if self.continues and self.margin(q) ** 0.5 < branch.READ_ZONE * branch.READ_DISTANCE:
            _, rate, spacing = self.approach(q, v, branch.SPACING * self.settings.step_size)
            with suppress(OpenError, ZeroDivisionError):  # The motion may end before the places: then as it is here.
                spacing *= branch.READ_DISTANCE / rate
                places, found = self._beside(q, v, u, t, spacing, branch.READ_MEAN)
                a = branch.mean({k: x[0] for k, x in found.items()})
                # At the position itself more multipliers act alike than on the branch.
                lam, pole = branch.with_pole({k: self.minimum_norm(*places[k], x[1], t) for k, x in found.items()})
                _, C, _, xi = self.dynamics(q, v, u, t)
                return a, lam, max(x[2] for x in found.values()), C @ a - xi, 1 + pole
        a, lam, used, left = self.accelerations(q, v, u, t)
        return a, self.minimum_norm(q, v, lam, t) if self.settings.projects else lam, used, left, 0

    def _outputs(self, a: NDArray, lam: NDArray, used: int, singular: int) -> NDArray:
        """Readings, monitors, and what came of events."""
        q, v, e = self.q, self.v, self.equations
        y = self._unwrap(self.readings(q, v, a, lam, self.inputs, self.time))
        values = *self.residues(q, v), self.energy(q, v), used, self.margin(q) ** 0.5, singular
        monitors = [x for monitor, x in zip(MONITORS, values, strict=True) if monitor.name not in e.monitors]
        return np.concatenate([y, monitors, [self._unit.get(self._references[x.name]) for x in events(e)]])

    def _unwrap(self, y: NDArray) -> NDArray:
        """Readings whose computed angles are moved by whole turns to the values nearest to the last ones."""
        names = [v.name for v in self.equations.outputs]
        places = [names.index(name) for name in self.equations.wrapped]
        y[places] += 2 * np.pi * np.round((self.angles - y[places]) / (2 * np.pi))
        self.angles[:] = y[places]
        return y

    def _watch(self, left: NDArray) -> None:
        """Keep the largest errors; NaN for what nobody watches."""
        c, y = self._counters, dict(zip((v.name for v in self.outputs), self._seen[1], strict=True))
        position, velocity, energy = (float(y.get(monitor.name, math.nan)) for monitor in MONITORS[:3])
        c.position_error = position + max(c.position_error - position, 0.0)
        c.velocity_error = velocity + max(c.velocity_error - velocity, 0.0)
        balance = abs(energy - self.energy_start - self.work)
        c.energy_error = balance + max(c.energy_error - balance, 0.0)
        c.acceleration_error = max(c.acceleration_error, self._largest(left))

    @property
    def counters(self) -> Counters:
        """Work done and largest errors since initialisation."""
        return self._counters

    # Matrices and words -------------------------------------------------------------------------------------------

    def _augmented(self, M: Any, C: Any) -> Any:
        return method.augmented_mass(M, C, self.alpha)

    def inverse(self, H: Any, t: float) -> method.Solve:
        """What solves with a matrix, dense or sparse; StepError where it is singular."""

        def solve(b: NDArray) -> NDArray:
            try:
                return np.linalg.solve(H, b)
            except np.linalg.LinAlgError:
                raise StepError(self._say(t, *_SINGULAR)) from None

        if isinstance(H, np.ndarray):
            return solve
        from scipy.sparse.linalg import splu

        try:
            return splu(H.tocsc()).solve
        except RuntimeError:
            raise StepError(self._say(t, *_SINGULAR)) from None

    def _diagonal(self, alpha: NDArray) -> Any:
        """alpha (l, l): a sparse matrix where those of the equations are."""
        if isinstance(self._functions["dynamics"].y[0], np.ndarray):
            return np.diag(alpha)
        from scipy.sparse import diags_array

        return diags_array(alpha, format="csc")

    def _largest(self, residue: NDArray) -> float:
        return float(np.abs(residue[self.active]).max(initial=0.0))

    def _widest(self, q: NDArray) -> tuple[float, str]:
        """How far the constraint that is furthest open is at q (n,), and which it is."""
        return self._worst(self.constraints(q, np.zeros_like(q))[2])

    def _worst(self, residue: NDArray) -> tuple[float, str]:
        """The largest residue, in units of its row, and what the row is called; 0 where there are none."""
        if not len(residue):
            return 0.0, ""
        sizes = np.where(self.active, np.nan_to_num(np.abs(residue / self.units), nan=np.inf), 0)
        row = self.equations.rows[int(np.argmax(sizes))]
        return float(sizes.max()), f"{row.name} {row.direction}".strip()

    def _say(self, t: float, measured: str, remedy: str) -> str:
        return f"{self.name}, t = {t:.6g} s: {measured}; {remedy}"


_SINGULAR = "the augmented mass matrix is singular", "give the massless body a mass, or hold it by constraints"


def _least(C: Any, alpha: Any, solve: method.Solve, lam: NDArray) -> NDArray:
    """lam of least norm, until another pass would change round-off alone."""

    def done(change: NDArray, value: NDArray) -> bool:
        return np.abs(change).max(initial=0.0) <= EPS * np.abs(value).max(initial=0.0)

    return method.minimum_norm(C, alpha, solve, lam, CORRECTIONS, done)


def _least_squares(blocks: list, right: list) -> tuple[NDArray, NDArray]:
    """Least-squares solution of least norm of the block system (9)."""
    (M, Ct), (C, _) = ([x.toarray() if hasattr(x, "toarray") else x for x in row] for row in blocks)
    n, l = M.shape[0], C.shape[0]
    K = np.block([[M, Ct], [C, np.zeros((l, l))]])
    return tuple(np.split(np.linalg.lstsq(K, np.concatenate(right), rcond=None)[0], [n]))


def _entries(matrix: Any) -> NDArray:
    """The entries of a dense or sparse matrix, or of a vector."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.data


def _factorised(H: Any, order: list[int]) -> NDArray:
    """Pivots of H, eliminated in this order."""
    if isinstance(H, np.ndarray):
        return np.linalg.cholesky(H[np.ix_(order, order)]).diagonal() ** 2
    from scipy.sparse.linalg import splu

    permuted = H.tocsc()[order][:, order]
    factors = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return factors.U.diagonal()
