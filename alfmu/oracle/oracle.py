"""The method on NumPy arrays, with loops that stop on convergence: slow, readable, and the measure of every kernel."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from ..equations.interface import Counters
from ..kernel.program import GROSS, Backend, Call
from ..kernel.thresholds import ASIDE, COARSE, FAR_RATIO, LITTLE, PATIENT, REGULAR
from ..method import formulations as method
from ..method import singular as branch
from ..method.formulations import CORRECTIONS
from ..model.errors import OpenError, StepError
from ..model.settings import Settings
from .scaling import scaled

__all__ = ["Oracle"]


class Oracle:
    """Accelerations, multipliers and projections of one mechanism.

    Arrays handed in are left alone; arrays handed out are the caller's.
    """

    def __init__(self, equations: Equations, backend: Backend):
        self.equations = equations
        names = ("dynamics", "constraints", "power", "energy", "readings")
        calls = (Call(backend, name, equations.signatures[name]) for name in names)
        self._dynamics, self._constraints, self._power, self._energy, self._outputs = calls
        self._displacements, self._tangents = (
            Call(backend, name, equations.signatures[name]) if name in equations.signatures else None
            for name in ("displacements", "tangents")
        )
        self.sparse = not isinstance(self._dynamics.y[0], np.ndarray)
        self.counters = Counters()
        self.units = np.ones(equations.l)
        self.compliances = np.zeros(equations.l)
        self.freedom, self.masses, self.scales = equations.n, -math.inf, np.ones(equations.n)
        self.regular, self.rank, self.brakes = 0.0, 0, False

    def prepare(self, settings: Settings, p: NDArray, q: NDArray) -> None:
        """Begin a run: settings and parameters fixed, the penalty scaled with the masses at q (n,) if left open."""
        self.settings = settings.checked(self.equations.name, self.equations.l)
        self.p = p
        self.counters = Counters()
        default, self.units = self._scaled(q)
        alpha = np.asarray(settings.penalty, float)
        if alpha.ndim == 0:
            alpha = np.full(self.equations.l, alpha) if alpha else default
        self.penalty = alpha

    def _scaled(self, q: NDArray) -> tuple[NDArray, NDArray]:
        """Default penalties and units of the rows, as they are at q (n,) and where angles are turned."""
        units = [c.unit for c in self.equations.coordinates]
        metres, angles = (np.array([unit == one for unit in units]) for one in ("m", "rad"))
        turn = np.random.default_rng(0).standard_normal(len(q)) * np.where(metres, LITTLE, 1.0)
        M, C, _, _ = self._constraints(q, np.zeros_like(q), self.p)
        masses, (row, column) = M.diagonal().copy(), _places(C)

        def entries(place: NDArray) -> NDArray:
            return _entries(self._constraints(place, np.zeros_like(q), self.p)[1]).ravel().copy()

        places = [q + k * turn for k in (0.0, *ASIDE)]
        found = np.array([entries(place) for place in places])
        turned = np.zeros_like(found)
        for i in () if self.sparse else np.flatnonzero(angles):
            quarter, own = np.pi / 2 * (np.arange(len(q)) == i), column == i
            turned[:, own] = [entries(place + quarter)[own] for place in places]
        return scaled(masses, found, turned, row, column, self.equations.l, metres, angles)

    @property
    def penalty(self) -> NDArray:
        """alpha (l,) [kg or kg.m2 by row]; a constraint with zero is switched off."""
        return self._penalty.copy()

    @penalty.setter
    def penalty(self, alpha: NDArray) -> None:
        self._penalty = np.array(alpha, float)
        self.alpha = _sparse_diagonal(alpha) if self.sparse else np.diag(alpha)
        self.active = np.asarray(alpha) > 0

    def dynamics(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> list[NDArray]:
        """M, C, F, xi; overwritten by the next call."""
        return self._dynamics(q, v, u, self.p, t)

    def constraints(self, q: NDArray, v: NDArray) -> list[NDArray]:
        """M, C, Phi, C v; overwritten by the next call."""
        return self._constraints(q, v, self.p)

    def tangents(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> list[NDArray]:
        """Rq, Rv, Xq, Xv, Rt (`alfmu.equations.evaluation.with_tangents`); overwritten by the next call."""
        return self._tangents(q, v, a, lam, u, self.p, t)

    def accelerations(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, patience: int = 1
    ) -> tuple[NDArray, NDArray, int, NDArray]:
        """a (n,), lam (l,) of least norm, the multiplier iterations used, and Phi-ddot (l,) that is left.

        `patience` times as many iterations as usual may be made.
        """
        M, C, F, xi = self._dynamics(q, v, u, self.p, t)
        self.counters.evaluations += 1
        kind, alpha = self.settings.formulation, self.alpha
        if not all(np.isfinite(_entries(x)).all() for x in (M, F, xi)):
            raise StepError(self._say(t, "the equations of motion are not finite", "reduce solver.step_size"))
        if kind in ("residual", "classic"):
            iterate = method.residual if kind == "residual" else method.classic
            a, lam, used, converged = self._iterated(iterate, M, F, C, xi, t, patience)
            self.counters.multiplier_iterations += used
            self.counters.unconverged += not converged
        else:
            used = 1
            self.counters.multiplier_iterations += 1
            if kind != "dae":
                _, _, Phi, Cv = self._constraints(q, v, self.p)
                stabilised = method.stabilised(xi, Cv, Phi, self.settings.zeta, self.settings.omega)
            if kind == "penalty":
                a, lam = method.penalty(F, C, stabilised, alpha, self.factor(method.augmented_mass(M, C, alpha), t))
            elif kind == "stiffness":
                a, lam = method.stiffness(F, C, Phi, self.settings.omega**2 * alpha, self.factor(M, t))
            else:
                held = np.flatnonzero(self.active)
                lam = np.zeros_like(xi)
                right = (xi if kind == "dae" else stabilised)[held]
                a, lam[held] = method.dae(M, F, C[held], right, _least_squares)
        return a, lam, used, C @ a - xi

    def know(self, q: NDArray, v: NDArray, freedom: int) -> None:
        """Take note of the degrees of freedom, and of the pivots of H that constraints and masses make on the way.

        A pivot of H is judged by the largest diagonal entry that its coordinate has at q and beside it. Coordinates
        that no constraint holds are left out: their pivots are masses beside masses, and not small.
        """
        self.masses = -math.inf  # not known yet
        M, C, _, _ = self._constraints(q, v, self.p)
        way = v.copy()
        if not way.any():
            solve = self.factor(method.augmented_mass(M, C, self.alpha), 0.0)
            aside = np.random.default_rng(0).standard_normal(len(q))
            way = branch.tangential(C.copy(), self.alpha, solve, aside)
        way /= max(np.abs(way).max(), 1e-300)
        held, self.scales, places = np.zeros(len(q)), np.zeros(len(q)), [q]
        for k in (0.0, *ASIDE):
            there = q + k * way
            M, C, _, _ = self._constraints(there, v, self.p)
            held += (self.alpha @ abs(C)).sum(axis=0)
            self.scales = np.maximum(self.scales, method.augmented_mass(M, C, self.alpha).diagonal())
            there, _ = self.on_branch(there, v)
            if self.residues(there, v)[0] <= GROSS:
                places.append(there)
        self.freedom = freedom - int((held == 0).sum())
        self.rank = len(q) - freedom
        self.brakes = any(self._brakes(place, way) for place in places)
        everything = [np.sort(self._pivots(place)) for place in places]
        pivots = [r[: max(self.freedom, 0)] for r in everything]
        # Where a coordinate cannot tell the motion its pivot is far larger; at a singular position it may be smaller.
        found = np.sort([np.log(np.maximum(r, 1e-300)).sum() for r in pivots])
        typical = float(np.median(found[found <= found[min(1, len(found) - 1)] + FAR_RATIO]))
        # Coarse, as these are scales: the same bits however they are computed, and so the same limits.
        self.masses = math.floor(typical * COARSE + 0.5) / COARSE
        self.scales = self.scales.astype(np.float32).astype(float)
        together = [np.log(np.maximum(r, 1e-300)).sum() for r in everything]
        self.regular = float(np.median(together)) + math.log(branch.FAR)

    @property
    def known(self) -> NDArray:
        """What `know` found, as numbers to be saved and restored."""
        return np.array([self.freedom, self.masses, self.regular, self.rank, self.brakes, *self.scales], float)

    @known.setter
    def known(self, numbers: NDArray) -> None:
        freedom, self.masses, self.regular, rank, brakes = map(float, numbers[:5])
        self.freedom, self.rank, self.brakes, self.scales = int(freedom), int(rank), bool(brakes), numbers[5:].copy()

    def _brakes(self, q: NDArray, way: NDArray) -> bool:
        """Whether constraints that are redundant at q become independent beside the motion, and so would stop it.

        Then they are, at the stages of a step, by its truncation error.
        """
        if self.sparse or self.rank >= self.active.sum():
            return False
        rows, sizes = self._ranges(q)
        if sizes[self.rank - 1] < REGULAR * sizes[0]:
            return False
        there = np.sqrt(self._penalty)[:, None] * self._constraints(q + ASIDE[2] * way, way, self.p)[1]
        return bool(np.abs(rows[:, self.rank :].T @ there).max() > REGULAR**3 * sizes[0])

    def hold(self, q: NDArray) -> None:
        """Keep the combinations of constraints that are independent at q (n,), a place on the motion, until told again.

        Redundant ones are left out of H, where it matters (`brakes`): lam is then of least norm by itself.
        """
        if not self.brakes:
            return
        rows, sizes = self._ranges(q)
        if sizes[self.rank - 1] > REGULAR * sizes[0]:  # else a singular position: those before it still tell
            root, kept = np.sqrt(self._penalty), rows[:, : self.rank]
            self.alpha = root[:, None] * (kept @ kept.T) * root

    def _ranges(self, q: NDArray) -> tuple[NDArray, NDArray]:
        """Combinations (l, l) of constraints, weighted by the root of alpha, and their sizes at q, largest first."""
        C = self._constraints(q, np.zeros_like(q), self.p)[1]
        rows, sizes, _ = np.linalg.svd(np.sqrt(self._penalty)[:, None] * C)
        return rows, sizes

    @property
    def pivot_of_mass(self) -> float:
        """What a pivot over its scale comes to where only masses make it; 0 where none is made so."""
        return math.exp(self.masses / self.freedom) if self.freedom > 0 else 0.0

    @property
    def heavy(self) -> NDArray:
        """Masses (n,) that telling coordinates are given: see `alfmu.method.singular.HEAVY`."""
        masses = np.zeros_like(self.scales)
        telling = self.equations.telling
        masses[telling] = branch.HEAVY * self.pivot_of_mass * self.scales[telling]
        return masses

    @property
    def least_distance(self) -> float:
        """Least distance of places from a singular position, where the multiplier iteration converges fast enough."""
        return max(branch.LEAST, branch.CONVERGING * self.pivot_of_mass**0.5)

    @property
    def nothing(self) -> float:
        """Margin that cannot be told from that of the singular position itself."""
        return branch.NOTHING * self.pivot_of_mass

    def margin(self, q: NDArray) -> float:
        """How far q (n,) is from a singular position: see `alfmu.method.singular.GUARD`."""
        pivots = self._pivots(q)
        small = pivots[pivots < branch.SMALL]
        if self._regular(pivots):
            return 1.0
        more = len(small) - self.freedom
        if more <= 0:
            return 1.0
        return math.exp(min((np.log(np.maximum(small, 1e-300)).sum() - self.masses) / more, 0.0))

    def near(self, q: NDArray) -> bool:
        """Whether the margin at q may be below the guard: more pivots are than there are degrees of freedom."""
        pivots = self._pivots(q)
        several = int((pivots < branch.GUARD).sum()) > self.freedom
        return several and not self._regular(pivots)

    def _regular(self, pivots: NDArray) -> bool:
        """Whether a position is known to be regular by all pivots together: see `alfmu.method.singular.FAR`."""
        return (
            self.equations.turns and not self.sparse and float(np.log(np.maximum(pivots, 1e-300)).sum()) >= self.regular
        )

    def on_branch(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        """q and v nearby that keep the constraints: displaced across the motion alone, v then by (10).

        The motion through the places so found is smooth up to the singular position itself.
        """
        near = q
        for _ in range(2):
            near = self._closer(near, v)
        M, C, _, _ = self._constraints(near, v, self.p)
        solve = self.factor(method.augmented_mass(M, C, self.alpha), 0.0)
        way, d = (branch.tangential(C, self.alpha, solve, x) for x in (v, q - near))
        near = near + d + way * branch.along(M, self.heavy, way, q - near - d)
        v = way + way * branch.along(M, self.heavy, way, v - way)
        near = self._closer(near, v)
        M, C, _, _ = self._constraints(near, v, self.p)
        solve = self.factor(method.augmented_mass(M, C, self.alpha), 0.0)
        for _ in range(2):
            v = v + method.project(C, self.alpha, solve, C @ v)  # (10)
        return near, v

    def _closer(self, q: NDArray, v: NDArray) -> NDArray:
        """q after one correction (10)."""
        M, C, Phi, _ = self._constraints(q, v, self.p)
        return q + method.project(C, self.alpha, self.factor(method.augmented_mass(M, C, self.alpha), 0.0), Phi)

    def accelerations_on_branch(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: float
    ) -> tuple[NDArray, NDArray, int, NDArray]:
        """What `accelerations` returns, at the place of the branch nearest to q; its limit near a singular position.

        `spacing` [s] of the places from which a limit is taken, along v; longer where the motion is slow, and shorter
        where it is fast. Where the motion does not reach them, accelerations are taken as they are, as long as the
        iteration converges.
        """
        here, rate, spacing = self.approach(q, v, spacing)
        wanted = max(min(rate, branch.MOST), self.least_distance)
        if not (rate > 0 and here < branch.ZONE * wanted):
            return self.accelerations(*self.reached(q, v, t), u, t)
        try:
            _, found = self._beside(q, v, u, t, spacing * wanted / rate, branch.MEAN)
        except OpenError:
            return self._at_last(q, v, u, t)
        a, left = (branch.mean({k: x[i] for k, x in found.items()}) for i in (0, 3))
        return a, branch.mean({k: x[1] for k, x in found.items()}), max(x[2] for x in found.values()), left

    def read(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, continues: bool
    ) -> tuple[NDArray, NDArray, int, NDArray, int]:
        """What `accelerations` returns at a state that keeps the constraints, lam of least norm; if it is singular.

        The last result is 0 where it is not; where it is and the limit is wanted, 1 where lam has a limit, 2 where it
        has a pole, of which the finite part is given at the position itself.
        """
        if continues and self.margin(q) ** 0.5 < branch.READ_ZONE * branch.READ_DISTANCE:
            _, rate, spacing = self.approach(q, v, branch.SPACING * self.settings.step_size)
            if rate > 0:
                spacing *= branch.READ_DISTANCE / rate
                with suppress(OpenError):  # The motion may end before the places: then as it is here.
                    places, found = self._beside(q, v, u, t, spacing, branch.READ_MEAN)
                    a = branch.mean({k: x[0] for k, x in found.items()})
                    # At the position itself more multipliers act alike than on the branch.
                    lam, pole = branch.with_pole({k: self.minimum_norm(*places[k], x[1], t) for k, x in found.items()})
                    _, C, _, xi = self._dynamics(q, v, u, self.p, t)
                    return a, lam, max(x[2] for x in found.values()), C @ a - xi, 1 + pole
        a, lam, used, left = self.accelerations(q, v, u, t)
        return a, self.minimum_norm(q, v, lam, t) if self.settings.projects else lam, used, left, 0

    def _at_last(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> tuple[NDArray, NDArray, int, NDArray]:
        """What `accelerations` returns where the motion may end ahead; OpenError where it does not converge."""
        unconverged = self.counters.unconverged
        found = self.accelerations(*self.reached(q, v, t), u, t, PATIENT)
        if self.counters.unconverged > unconverged:
            raise OpenError(self._say(t, "the multiplier iteration does not converge", "reduce solver.step_size"))
        return found

    def approach(self, q: NDArray, v: NDArray, spacing: float) -> tuple[float, float, float]:
        """Distance to a singular position, how much of it one spacing [s] makes, and a spacing that can tell."""
        for _ in range(branch.LONGER):
            before, here, after = (self.margin(q + k * spacing * v) for k in (-1, 0, 1))
            rate = max(branch.curvature(before, here, after), 0.0) ** 0.5
            if here > self.nothing or rate**2 > self.nothing:
                break
            spacing *= 2  # The places are too near to be told from the singular position.
        return here**0.5, rate, spacing

    def _beside(
        self, q: NDArray, v: NDArray, u: NDArray, t: float, spacing: float, at: Iterable[int]
    ) -> tuple[dict[int, tuple], dict[int, tuple]]:
        """q and v, and what `accelerations` returns, at places on the branch before and after q."""
        places = {k: self.reached(q + k * spacing * v, v, t) for k in at}
        return places, {k: self.accelerations(*place, u, t) for k, place in places.items()}

    def reached(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """What `on_branch` returns; StepError where the branch does not lead there."""
        near, rate = self.on_branch(q, v)
        gap, row = self.widest(near)
        if not gap <= GROSS:
            measured = f"the branch of the motion leaves {row} open by {gap:.1e} ahead"
            raise OpenError(self._say(t, measured, "reduce solver.step_size"))
        return near, rate

    def iterations_needed(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> int:
        """Iterations of the residual form after which no more than a tenth of the tolerance is left.

        Each gains about the same factor, so a last change of limit^((m - 1) / m) after m of them leaves the limit.
        """
        M, C, F, xi = self._dynamics(q, v, u, self.p, t)
        limit, made = self.settings.tolerance / 10, 0

        def done(da: NDArray, a: NDArray) -> bool:
            nonlocal made
            made += 1
            return made > 1 and np.linalg.norm(da) <= limit ** ((made - 1) / made) * np.linalg.norm(a)

        solve, zeros = self.factor(method.augmented_mass(M, C, self.alpha), t), (np.zeros_like(F), np.zeros_like(xi))
        method.residual(M, F, C, xi, self.alpha, solve, *zeros, self.settings.max_iterations, done)
        return made

    def nearest(self, M: NDArray, C: NDArray, a: NDArray, xi: NDArray, t: float) -> NDArray:
        """Accelerations (n,) that keep the constraints, the nearest to a in the metric of M."""
        return self._iterated(method.residual, M, M @ a, C, xi, t)[0]

    def displacements(self, q: NDArray) -> NDArray:
        """What locks keep, at q (n,)."""
        return self._displacements(q, self.p)[0].copy() if self._displacements else np.zeros(0)

    def impact(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray, float]:
        """v (n,) after a plastic impact that makes it consistent with the constraints: the nearest in the metric of M.

        M dv + C' impulse = 0, C dv = -C v in residual form, so that large changes are as exact as small ones. Also the
        impulses (l,) [N.s, N.m.s] that the constraints gave, of least norm, and the kinetic energy lost [J].
        """
        M, C, _, Cv = (x.copy() for x in self._constraints(q, v, self.p))
        dv, impulses, _, _ = self._iterated(method.residual, M, np.zeros_like(v), C, -Cv, t)
        return v + dv, -self.minimum_norm(q, v, impulses, t), float(dv @ (M @ dv)) / 2

    def _iterated(
        self, iterate: Callable, M: NDArray, F: NDArray, C: NDArray, xi: NDArray, t: float, patience: int = 1
    ) -> tuple[NDArray, NDArray, int, bool]:
        """(8), classic or residual, until the change is within the tolerance of the accelerations it changes.

        Null vectors of C' do not act on a, so that alpha times the round-off of each pass stays in lam along them. Yet
        they act on tangents: lam is handed out without them.
        """
        solve = self.factor(method.augmented_mass(M, C, self.alpha), t)
        scale = np.abs(F).max(initial=0.0) / np.abs(_entries(M)).max(initial=1e-300)
        limit = self.settings.tolerance

        def done(da: NDArray, a: NDArray) -> bool:
            return np.abs(da).max() <= limit * max(np.abs(a).max(), scale)

        zeros = np.zeros_like(F), np.zeros_like(xi)
        most = patience * self.settings.max_iterations
        a, lam, used, converged = iterate(M, F, C, xi, self.alpha, solve, *zeros, most, done)
        return a, _least(C, self.alpha, solve, lam), used, converged

    def minimum_norm(self, q: NDArray, v: NDArray, lam: NDArray, t: float) -> NDArray:
        """Multipliers that act like lam (l,): of least norm, or as constraints of the given compliances share them."""
        M, C, _, _ = self._constraints(q, v, self.p)
        alpha = self.alpha
        if self.compliances.any():
            stiffness = self.stiffnesses * self._penalty.max()
            alpha = _sparse_diagonal(stiffness) if self.sparse else np.diag(stiffness)
        return _least(C, alpha, self.factor(method.augmented_mass(M, C, alpha), t), lam)

    @property
    def stiffnesses(self) -> NDArray:
        """Stiffness of each constraint (l,) over the largest, zero where it is off; penalties where none is known."""
        if self.compliances.any():
            return self.active * self.compliances.min() / self.compliances
        return self._penalty / self._penalty.max(initial=1e-300)

    def project(self, q: NDArray, v: NDArray, t: float, near: bool = False) -> tuple[NDArray, NDArray, float, float]:
        """q and v brought back to the constraints with (10), and the largest |Phi| and |Phi-dot| left.

        Near a singular position the corrections gain little in the direction that the constraints hardly hold, which
        magnifies what is left open, so that one more is made; what is left above the tolerance is counted. Raises
        StepError where more than `GROSS` is left.
        """
        q, v, c = q.copy(), v.copy(), self.counters
        M, C, Phi, Cv = self._constraints(q, v, self.p)
        for _ in range(CORRECTIONS):
            if self._closed(Phi, C, q):
                if not near:
                    break
                near = False
            q += method.project(C, self.alpha, self.factor(method.augmented_mass(M, C, self.alpha), t), Phi)  # (10)
            M, C, Phi, Cv = self._constraints(q, v, self.p)
            c.projection_iterations += 1
        solve = self.factor(method.augmented_mass(M, C, self.alpha), t)
        for _ in range(CORRECTIONS):
            if self._closed(Cv, C, v):
                break
            v += method.project(C, self.alpha, solve, Cv)  # (10)
            Cv = C @ v
            c.projection_iterations += 1
        for what, residue in (("|Phi|", Phi), ("|Phi-dot|", Cv)):
            if not self._largest(residue / self.units) <= GROSS:
                raise OpenError(self._open(t, what, residue))
        c.unprojected += not (self._closed(Phi, C, q) and self._closed(Cv, C, v))
        return q, v, self._largest(Phi), self._largest(Cv)

    def residues(self, q: NDArray, v: NDArray) -> tuple[float, float]:
        """The largest |Phi| and |Phi-dot|."""
        _, _, Phi, Cv = self._constraints(q, v, self.p)
        return self._largest(Phi), self._largest(Cv)

    def widest(self, q: NDArray) -> tuple[float, str]:
        """How far the constraint that is furthest open is at q (n,), and which it is; 0 where there are none."""
        if not self.equations.l:
            return 0.0, ""
        return self._worst(self._constraints(q, np.zeros_like(q), self.p)[2])

    def power(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> float:
        """Power [W] of inputs, loads and dampers."""
        return float(self._power(q, v, u, self.p, t)[0][0])

    def energy(self, q: NDArray, v: NDArray) -> float:
        """Kinetic and potential energy [J]."""
        return float(self._energy(q, v, self.p)[0][0])

    def outputs(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> NDArray:
        """Everything a user can read, in the order of `equations.outputs`."""
        return self._outputs(q, v, a, lam, u, self.p, t)[0].copy()

    def _largest(self, residue: NDArray) -> float:
        return float(np.abs(residue[self.active]).max(initial=0.0))

    def _closed(self, residue: NDArray, C: NDArray, x: NDArray) -> bool:
        """Whether a residue of C is within the tolerance, or within the round-off of the row where that is larger."""
        limit = np.maximum(self.settings.tolerance * self.units, 8 * np.finfo(float).eps * (abs(C) @ np.abs(x)))
        return bool((np.abs(residue) <= limit)[self.active].all())

    def _pivots(self, q: NDArray) -> NDArray:
        """Pivots of H over the scales of their coordinates (n,); zeros where it is singular."""
        M, C, _, _ = self._constraints(q, np.zeros_like(q), self.p)
        H = method.augmented_mass(M, C, self.alpha)
        order = self.equations.order
        if self.sparse:
            from scipy.sparse.linalg import splu

            H = H.tocsc()[order][:, order]
            try:
                factors = splu(H, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            except RuntimeError:
                return np.zeros(len(order))
            return factors.U.diagonal() / self.scales[order]
        H = H[np.ix_(order, order)]
        try:
            return np.linalg.cholesky(H).diagonal() ** 2 / self.scales[order]
        except np.linalg.LinAlgError:
            return np.zeros(len(order))

    def factor(self, H: NDArray, t: float) -> method.Solve:
        def refused() -> StepError:
            advice = "give the massless body a mass, or hold it by constraints"
            return StepError(self._say(t, "the augmented mass matrix is singular", advice))

        def solve(b: NDArray) -> NDArray:
            try:
                return np.linalg.solve(H, b)
            except np.linalg.LinAlgError:
                raise refused() from None

        if not self.sparse:
            return solve
        from scipy.sparse.linalg import splu

        try:
            return splu(H.tocsc()).solve
        except RuntimeError:
            raise refused() from None

    def _open(self, t: float, what: str, residue: NDArray) -> str:
        worst, where = self._worst(residue)
        measured = f"{what} = {worst:.1e} at {where} > {GROSS:.0e} after {CORRECTIONS} corrections"
        return self._say(t, measured, "reduce solver.step_size")

    def _worst(self, residue: NDArray) -> tuple[float, str]:
        """The largest residue, in units of its row, and what the row is called."""
        if not len(residue):
            return 0.0, ""
        sizes = np.where(self.active, np.nan_to_num(np.abs(residue / self.units), nan=np.inf), 0)
        row = self.equations.rows[int(np.argmax(sizes))]
        return float(sizes.max()), f"{row.name} {row.direction}".strip()

    def _say(self, t: float, measured: str, remedy: str) -> str:
        return f"{self.equations.name}, t = {t:.6g} s: {measured}; {remedy}"


def _least(C: NDArray, alpha: NDArray, solve: method.Solve, lam: NDArray) -> NDArray:
    """lam of least norm, until another pass would change round-off alone."""
    limit = np.finfo(float).eps

    def done(change: NDArray, value: NDArray) -> bool:
        return np.abs(change).max(initial=0.0) <= limit * np.abs(value).max(initial=0.0)

    return method.minimum_norm(C, alpha, solve, lam, CORRECTIONS, done)


def _least_squares(blocks: list, right: list) -> tuple[NDArray, NDArray]:
    """Least-squares solution of least norm of the block system (9)."""
    (M, Ct), (C, _) = ([x if isinstance(x, (np.ndarray, int)) else x.toarray() for x in row] for row in blocks)
    n, l = M.shape[0], C.shape[0]
    K = np.block([[M, Ct], [C, np.zeros((l, l))]])
    x = np.linalg.lstsq(K, np.concatenate(right), rcond=None)[0]
    return x[:n], x[n:]


def _entries(matrix: Any) -> NDArray:
    """The entries of a dense or sparse matrix, or of a vector."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.data


def _places(matrix: Any) -> tuple[NDArray, NDArray]:
    """Row and column of each of `_entries`, flattened."""
    if isinstance(matrix, np.ndarray):
        row, column = np.indices(matrix.shape)
        return row.ravel(), column.ravel()
    return matrix.indices, np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))


def _sparse_diagonal(alpha: NDArray) -> Any:
    from scipy.sparse import diags_array

    return diags_array(alpha, format="csc")
