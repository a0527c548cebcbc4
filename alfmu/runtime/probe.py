"""Survey of a scene at its start, before it is traced or during a run: freedoms, shared loads, iterations."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..equations import Configuration, Equations, Mobility
from ..equations.evaluation import DENSE, tangents_once
from ..equations.interface import default_settings
from ..equations.types import Survey
from ..kernel.memory import SETTINGS, Layout
from ..kernel.tables import packed_start
from ..method import formulations as method
from ..method import implicit
from .library import DONE, Scene, Unit
from .shipped import installed

SINGULAR = (RuntimeError, np.linalg.LinAlgError)
"""Exceptions of SciPy and NumPy for a singular augmented mass, as near a motion with almost no mass."""

_RETURNS = 4
"""Number of corrections (10) in derivatives by displacements off the constraints."""

_SHARED = 1e-7
"""Change of an output per unit of a shared load, below which it is zero."""

_NUDGES = 3
"""Number of ways in which the last digits of H are changed to see round-off."""

_STRAIN = 1e6
"""Load [N, N.m] shared by redundant constraints in tests, large compared with others: friction follows from the
magnitude of a load, to which a small perpendicular share contributes nothing."""


COUNTED_ROWS = ("in force", "all", "without friction")
"""Sets of constraints for degrees of freedom, as `Counted_rows` in core/instance.h; "without friction" excludes
constraints in force of joints that stick by dry friction."""


def mobility(unit: Unit, n: int, rows: str = "in force") -> tuple[int, Mobility, NDArray[np.float64]]:
    """Return the outcome, degrees of freedom and redundant constraints, and a nearby regular position (n,).

    `rows` is a word of `COUNTED_ROWS`.
    """
    found, place, which = [ctypes.c_int() for _ in range(3)], np.empty(n), COUNTED_ROWS.index(rows)
    outcome = unit.scene.library.alfmu_mobility(unit.address, which, *map(ctypes.byref, found), place.ctypes.data)
    return outcome, Mobility(*(x.value for x in found)), place


def shared(
    e: Equations,
    numbers: dict[str, NDArray[np.float64]],
    held: NDArray[np.bool_],
    place: NDArray[np.float64],
    rank: int,
) -> list[str]:
    """Return outputs that are not unique because redundant constraints share a load.

    `numbers` are q, u, p and t by letter, `held` (l,) are the constraints in force, `place` (n,) is a position near q
    where they have this rank.
    """
    if held.sum() <= rank:
        return []
    v, nothing = np.zeros(e.n), np.zeros(e.l)
    C = np.array(e.functions["constraints"](place, v, numbers["p"])[1])[held]
    units = np.abs(C).max(axis=1, initial=0.0)
    units[units == 0] = 1.0
    rows, _, _ = np.linalg.svd(C / units[:, None])

    def read(lam: NDArray[np.float64]) -> NDArray[np.float64]:
        q, u, p, t = (numbers[letter] for letter in "qupt")
        return np.array(e.functions["readings"](q, v, v, lam, u, p, t)).ravel()

    def limits(lam: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the limits of friction, which follow from loads of joints."""
        q, u, p, t = (numbers[letter] for letter in "qupt")
        return np.array(e.functions["rubbing"](q, v, v, lam, u, p, t)).ravel()[count : 2 * count]

    count = len(e.frictions)
    found, rubs = np.zeros(len(e.outputs)), np.zeros(count)
    for share in (rows[:, rank:] / units[:, None]).T:
        lam = nothing.copy()
        lam[held] = share
        found = np.maximum(found, np.abs(read(lam) - read(nothing)))
        if count:
            rubs = np.maximum(rubs, np.abs(limits(_STRAIN * lam) - limits(nothing)) / _STRAIN)
    names = [v.name for v, size in zip(e.outputs, found, strict=True) if size > _SHARED]
    return [*names, *(x.output for x, size in zip(e.frictions, rubs, strict=True) if size > _SHARED)]


def row_units(e: Equations, k: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit of each row (l,) at the start, from the field `k` of the memory."""
    return 1 / k[len(SETTINGS) + e.l : len(SETTINGS) + 2 * e.l]


def row_shares(e: Equations, k: NDArray[np.float64], penalty: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return weights (l,) whose inverses are the compliances of redundant rows: penalties (l,), or stiffnesses if
    given."""
    begin = len(SETTINGS) + 2 * e.l + e.n
    return k[0] * k[begin : begin + e.l] if e.compliances else penalty.copy()


@dataclass(frozen=True)
class Probe:
    """A scene at the start given by its defaults, in the runtime, without steps."""

    equations: Equations
    unit: Unit
    brakes: bool
    """Whether redundant constraints would brake the motion near the start."""
    numbers: dict[str, NDArray[np.float64]]
    """q, v, u, p, t by letter."""
    units: NDArray[np.float64]
    """Units of the rows (l,)."""
    penalty: NDArray[np.float64]
    """alpha (l,) [kg or kg.m2 by row], zero for constraints not in force."""
    shares: NDArray[np.float64]
    """Weights (l,) whose inverses are compliances of redundant constraints, see `row_shares`."""
    own: NDArray[np.float64]
    """The mechanism's length [m] for coordinates in metres, 1 for others (n,): norms do not depend on the unit."""

    @classmethod
    def of(cls, equations: Equations, time: float = 0.0) -> Self | None:
        """Return the probe; None if the mechanism cannot be assembled from its default values at this time [s]."""
        e = equations
        # Reserve space for constraints that would brake; these are searched for only if there are few coordinates.
        room = Configuration.of(e)
        room = replace(room, survey=replace(room.survey, brakes=e.n <= DENSE))
        unit = Unit(Scene(packed_start(room), installed()))
        unit.time = time
        if unit.initialize() != DONE:
            return None
        layout, library = Layout(room), unit.scene.library
        offset = layout.fields["z"][0]
        block = (ctypes.c_double * layout.size).from_address(library.alfmu_state(unit.address) - 8 * offset)
        memory = np.array(block)
        field = {name: memory[begin : begin + size] for name, (begin, size) in layout.fields.items()}
        z, k = field["z"], field["k"]
        t = z[layout.time : layout.time + 1]
        u = np.concatenate([field["u"], z[layout.states : layout.time]])
        numbers = {"q": z[: e.n], "v": z[e.n : 2 * e.n], "u": u, "p": field["p"], "t": t}
        penalty = np.empty(e.l)
        library.alfmu_penalties(unit.address, penalty.ctypes.data)
        brakes = bool(library.alfmu_brakes(unit.address))
        length = 1 / k[SETTINGS.index("inverse_length")]
        own = np.array([length if c.unit == "m" else 1.0 for c in e.coordinates])
        return cls(e, unit, brakes, numbers, row_units(e, k), penalty, row_shares(e, k, penalty), own)

    def place(self, q: NDArray[np.float64]) -> None:
        """Move the scene to q (n,) for `mobility`; `numbers` do not change."""
        address = self.unit.scene.library.alfmu_state(self.unit.address)
        np.ctypeslib.as_array((ctypes.c_double * self.equations.n).from_address(address))[:] = q

    def mobility(self, every: bool = False) -> Mobility:
        """Return the mobility with the constraints in force, or with all if `every`."""
        return mobility(self.unit, self.equations.n, "all" if every else "in force")[1]

    def shared(self) -> list[str]:
        _, found, place = mobility(self.unit, self.equations.n)
        return shared(self.equations, self.numbers, self.penalty > 0, place, self.equations.dependent - found.freedom)

    @np.errstate(all="ignore")
    def iterations_needed(self) -> int:
        """Return the iterations of the residual form after which the error is at most a tenth of the tolerance.

        Each gains about the same factor, so a last change of limit^((m - 1) / m) after m iterations leaves the limit.
        The last digits of H are changed, because round-off is smaller at some starts than at the positions beside them;
        in several ways, as each is smaller in some directions of the mechanism. If the constraints carry nothing at the
        start, as in free fall, others that load them replace its forces; of these the error is at most the tolerance.
        """
        return max(self._iterations(way) for way in range(1, 1 + _NUDGES))

    def _iterations(self, way: int) -> int:
        """Return `iterations_needed` for one way of changing the last digits of H."""
        settings, made = default_settings(self.equations), 0
        left = settings.tolerance / 10

        def done(da: NDArray[np.float64], a: NDArray[np.float64]) -> bool:
            nonlocal made
            made += 1
            change, size = np.linalg.norm(da / self.own), np.linalg.norm(a / self.own)
            return made > 1 and change <= left ** ((made - 1) / made) * size

        M, C, F, xi, alpha, solve = self._dynamics(np.finfo(float).eps, way)
        zeros = np.zeros_like(F), np.zeros_like(xi)
        _, lam, _, _ = method.residual(M, F, C, xi, alpha, solve, *zeros, settings.max_iterations, done)
        if np.linalg.norm(self.own * (C.T @ lam)) <= settings.tolerance * np.linalg.norm(self.own * F):
            made, left, loads = 0, settings.tolerance, M.diagonal() * np.cos(np.arange(len(F)))
            method.residual(M, loads, C, zeros[1], alpha, solve, *zeros, settings.max_iterations, done)
        return made

    @np.errstate(all="ignore")
    def spectrum(self) -> NDArray[np.float64]:
        """Return eigenvalues [1/s] of small motions about the start and of its states, empty if they are not finite."""
        e, n, l, settings = self.equations, self.equations.n, self.equations.l, default_settings(self.equations)
        M, C, F, xi, alpha, solve = self._dynamics()

        def done(change: NDArray[np.float64], value: NDArray[np.float64]) -> bool:
            return np.abs(change).max(initial=0.0) <= settings.tolerance * np.abs(value).max(initial=0.0)

        most = settings.max_iterations
        a, lam, _, _ = method.residual(M, F, C, xi, alpha, solve, np.zeros(n), np.zeros(l), most, done)
        lam = method.minimum_norm(C, alpha, solve, lam, method.CORRECTIONS, done)
        q, v, u, p, t = (self.numbers[letter] for letter in "qvupt")
        Rq, Rv, Xq, Xv, _, *others = map(np.array, tangents_once(e)(q, v, a, lam, u, p, t))
        count = len(e.states)
        Rx, Gq, Gv, Gx = others or (np.zeros(shape) for shape in ((n, 0), (0, n), (0, n), (0, 0)))
        zeros = np.zeros((n, 2 * n + count)), np.zeros((l, 2 * n + count))
        R, X = np.hstack([Rq, Rv, Rx]), np.hstack([Xq, Xv, np.zeros((l, count))])
        both = implicit.tangent(M, C, alpha, solve, R, X, zeros, most, done)
        T, S = implicit.return_map(C, alpha, solve, Xv, np.eye(n), _RETURNS)
        (aq, av), ax = implicit.on_branch(both[:, :n], both[:, n : 2 * n], T, S), both[:, 2 * n :]
        Gq, Gv = implicit.on_branch(Gq, Gv, T, S)
        # T projects onto displacements that satisfy the constraints; time is excluded.
        d = e.dependent
        T, aq, av, ax, Gq, Gv = T[:d, :d], aq[:d, :d], av[:d, :d], ax[:d], Gq[:, :d], Gv[:, :d]
        motions = np.block(
            [
                [np.zeros_like(T), T, np.zeros((d, count))],
                [T @ aq, T @ av, T @ ax],
                [Gq, Gv, Gx],
            ]
        )
        return np.linalg.eigvals(motions) if np.isfinite(motions).all() else np.array([])

    def _dynamics(
        self, nudge: float = 0.0, way: int = 1
    ) -> tuple[method.Array, method.Array, NDArray[np.float64], NDArray[np.float64], method.Array, method.Solve]:
        """Return M, C, F, xi, the penalties as a matrix, and a solver with H; large matrices are sparse.

        The entries of H are changed by a fraction `nudge`, whose sign alternates every `way` rows and columns.
        """
        e = self.equations
        mass, slopes, *vectors = e.functions["dynamics"](*(self.numbers[letter] for letter in "qvupt"))
        F, xi = (np.array(x).ravel() for x in vectors)
        if e.n <= DENSE:
            M, C, alpha = np.array(mass), np.array(slopes), np.diag(self.penalty)
            signs = (-1.0) ** (np.arange(e.n) // way)
            H = method.augmented_mass(M, C, alpha) * (1 + nudge * np.outer(signs, signs))
            return M, C, F, xi, alpha, lambda b: np.linalg.solve(H, b)
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        M, C, alpha = mass.sparse(), slopes.sparse(), diags_array(self.penalty, format="csc")
        H = method.augmented_mass(M, C, alpha).tocoo()
        H.data *= 1 + nudge * (-1.0) ** (H.row // way + H.col // way)
        return M, C, F, xi, alpha, splu(H.tocsc()).solve


def survey(equations: Configuration) -> Survey:
    """Return the survey of equations at the start of their defaults, keeping their known properties of all starts.

    Tracing needs the survey, and the survey needs the runtime, so a scene with a start alone is traced, loaded and
    initialised.
    """
    e, known = equations, equations.survey
    probe = Probe.of(e)
    if probe is None:
        return known
    if known.shared is None:
        # Constraints that are switched on may be redundant, and so brake the motion.
        brakes = probe.brakes or (bool(e.switches) and probe.mobility(every=True).redundant > 0)
        known = replace(known, shared=tuple(probe.shared()), brakes=brakes, uneven=len(set(probe.units)) > 1)
    mobility = probe.mobility()
    if mobility.freedom_here > mobility.freedom:
        return replace(known, mobility=mobility)  # a singular start does not represent other positions
    try:
        return replace(known, mobility=mobility, iterations=probe.iterations_needed())
    except SINGULAR:  # the first evaluation of a run reports it
        return replace(known, mobility=mobility)
