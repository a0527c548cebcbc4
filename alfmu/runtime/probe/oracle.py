"""What the start of a mechanism is judged by: accelerations, projections, pivots, tangents."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...equations import Equations
from ...kernel.program import GROSS, Backend, Call
from ...kernel.thresholds import ASIDE, COARSE, FAR_RATIO, LITTLE, REGULAR
from ...method import formulations as method
from ...method import implicit
from ...method import singular as branch
from ...method.formulations import CORRECTIONS
from ...model.errors import OpenError, StepError
from ...model.settings import Settings
from .scaling import scaled

__all__ = ["Oracle"]

RETURNS = 4
"""Passes of the derivative of the return to the branch."""


class Oracle:
    """Accelerations, multipliers and projections of one mechanism.

    Arrays handed in are left alone; arrays handed out are the caller's.
    """

    def __init__(self, equations: Equations, backend: Backend):
        self.equations = equations
        names = ("dynamics", "constraints", "readings")
        calls = (Call(backend, name, equations.signatures[name]) for name in names)
        self._dynamics, self._constraints, self._outputs = calls
        self._displacements, self._tangents = (
            Call(backend, name, equations.signatures[name]) if name in equations.signatures else None
            for name in ("displacements", "tangents")
        )
        self.sparse = not isinstance(self._dynamics.y[0], np.ndarray)
        self.units = np.ones(equations.l)
        self.compliances = np.zeros(equations.l)
        self.freedom, self.masses, self.scales = equations.n, -math.inf, np.ones(equations.n)
        self.regular, self.rank, self.brakes = 0.0, 0, False

    def prepare(self, settings: Settings, p: NDArray, q: NDArray) -> None:
        """Begin a run: settings and parameters fixed, the penalty scaled with the masses at q (n,) if left open."""
        self.settings = settings.checked(self.equations.name, self.equations.l)
        self.p = p
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

    def accelerations(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """a (n,) and lam (l,) of least norm by (8)."""
        M, C, F, xi = self._dynamics(q, v, u, self.p, t)
        if not all(np.isfinite(_entries(x)).all() for x in (M, F, xi)):
            raise StepError(self._say(t, "the equations of motion are not finite", "reduce solver.step_size"))
        return self._iterated(M, F, C, xi, t)

    def spectrum(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> NDArray:
        """Eigenvalues [1/s] of small motions about the present one."""
        n, l, alpha = self.equations.n, self.equations.l, self.alpha
        a, lam = self.accelerations(q, v, u, t)
        Rq, Rv, Xq, Xv, _ = (x.copy() for x in self._tangents(q, v, a, lam, u, self.p, t))
        M, C, _, _ = (x.copy() for x in self._dynamics(q, v, u, self.p, t))
        solve = self.factor(method.augmented_mass(M, C, alpha), t)
        limit = self.settings.tolerance * 100

        def done(change: NDArray, value: NDArray) -> bool:
            return np.abs(change).max() <= limit * np.abs(value).max()

        zeros = np.zeros((n, 2 * n)), np.zeros((l, 2 * n))
        R, X = np.column_stack([Rq, Rv]), np.column_stack([Xq, Xv])
        both = implicit.tangent(M, C, alpha, solve, R, X, zeros, self.settings.max_iterations, done)
        T, S = implicit.return_map(C, alpha, solve, Xv, np.eye(n), RETURNS)
        aq, av = implicit.on_branch(both[:, :n], both[:, n:], T, S)
        # Displacements that the constraints keep, alone: T projects on them.
        return np.linalg.eigvals(np.block([[np.zeros((n, n)), T], [T @ aq, T @ av]]))

    def know(self, q: NDArray, v: NDArray, freedom: int) -> None:
        """Find the degrees of freedom, and of the pivots of H that constraints and masses make on the way.

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
    def known(self) -> tuple:
        """What `know` found, to be restored."""
        return self.freedom, self.masses, self.regular, self.rank, self.brakes, self.scales

    @known.setter
    def known(self, found: tuple) -> None:
        self.freedom, self.masses, self.regular, self.rank, self.brakes, self.scales = found

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

    def displacements(self, q: NDArray) -> NDArray:
        """What locks keep, at q (n,)."""
        return self._displacements(q, self.p)[0].copy() if self._displacements else np.zeros(0)

    def impact(self, q: NDArray, v: NDArray, t: float) -> NDArray:
        """v (n,) after a plastic impact: consistent with the constraints, the nearest in the metric of M."""
        M, C, _, Cv = (x.copy() for x in self._constraints(q, v, self.p))
        return v + self._iterated(M, np.zeros_like(v), C, -Cv, t)[0]

    def _iterated(self, M: NDArray, F: NDArray, C: NDArray, xi: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """(8) until the change is within the tolerance of the accelerations it changes; lam of least norm."""
        solve = self.factor(method.augmented_mass(M, C, self.alpha), t)
        scale = np.abs(F).max(initial=0.0) / np.abs(_entries(M)).max(initial=1e-300)
        limit = self.settings.tolerance

        def done(da: NDArray, a: NDArray) -> bool:
            return np.abs(da).max() <= limit * max(np.abs(a).max(), scale)

        zeros = np.zeros_like(F), np.zeros_like(xi)
        a, lam, _, _ = method.residual(M, F, C, xi, self.alpha, solve, *zeros, self.settings.max_iterations, done)
        return a, _least(C, self.alpha, solve, lam)

    def project(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray]:
        """q and v brought back to the constraints with (10); OpenError where more than `GROSS` is left."""
        q, v = q.copy(), v.copy()
        M, C, Phi, Cv = self._constraints(q, v, self.p)
        for _ in range(CORRECTIONS):
            if self._closed(Phi, C, q):
                break
            q += method.project(C, self.alpha, self.factor(method.augmented_mass(M, C, self.alpha), t), Phi)  # (10)
            M, C, Phi, Cv = self._constraints(q, v, self.p)
        solve = self.factor(method.augmented_mass(M, C, self.alpha), t)
        for _ in range(CORRECTIONS):
            if self._closed(Cv, C, v):
                break
            v += method.project(C, self.alpha, solve, Cv)  # (10)
            Cv = C @ v
        for what, residue in (("|Phi|", Phi), ("|Phi-dot|", Cv)):
            if not self._largest(residue / self.units) <= GROSS:
                raise OpenError(self._open(t, what, residue))
        return q, v

    def residues(self, q: NDArray, v: NDArray) -> tuple[float, float]:
        """The largest |Phi| and |Phi-dot|."""
        _, _, Phi, Cv = self._constraints(q, v, self.p)
        return self._largest(Phi), self._largest(Cv)

    def widest(self, q: NDArray) -> tuple[float, str]:
        """How far the constraint that is furthest open is at q (n,), and which it is; 0 where there are none."""
        if not self.equations.l:
            return 0.0, ""
        return self._worst(self._constraints(q, np.zeros_like(q), self.p)[2])

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
