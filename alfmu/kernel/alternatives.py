"""The formulations other than `residual`, traced from the same M, C, F, xi and factors of H.

An evaluation of another formulation begins with that of `residual`, whose long functions it shares, and continues with
short ones of its own: iterations of (8) as printed, the solutions of (5) and (6), or the system of (9), which a routine
solves with least norm (`form.LeastNorm`). All but that system are in units of the largest penalty, as in
`symbolic.Scene`; (9) keeps the units of the equations, as its singular values are compared with each other.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Self

import casadi as ca
from casadi import SX

from ..equations import Equations
from ..equations.evaluation import DENSE
from ..method import formulations as method
from ..model.settings import FORMULATIONS, Settings
from .form import Call, LeastNorm
from .symbolic import MATRICES, Scene, Watch
from .trace import Calls, Tracer, spaced

OWN = Settings.formulation
"""Formulation of all programs except those that serve every formulation."""

CHOSEN = {name: f"by_{name}" for name in FORMULATIONS if name != OWN}
"""Flags with which the runtime selects another formulation, by its name."""

SYSTEMS = ("baumgarte", "dae")
"""Formulations that solve the dense system (9) of all coordinates and constraints."""


BEYOND_SLIPS = ("stiffness", *SYSTEMS)
"""Formulations without nonholonomic constraints: `stiffness` constrains positions only. A scene with nonholonomic
constraints omits them."""


def formulations(equations: Equations) -> list[str]:
    """Return the formulations of a scene, in the order of FORMULATIONS; without constraints all are equal."""
    left_out = () if equations.n <= DENSE or not equations.l else SYSTEMS
    return [name for name in FORMULATIONS if name not in (*left_out, *(BEYOND_SLIPS if equations.slips else ()))]


def alternatives(equations: Equations) -> list[str]:
    """Return the formulations with their own programs."""
    e = equations
    return [name for name in formulations(e) if name != OWN and e.l and not e.frictions]


class Alternatives(Tracer):
    """Traces evaluations of a selected formulation."""

    chooses = False
    """Whether evaluations serve all formulations, not only `residual`."""

    def of_all(self, chooses: bool = True) -> Self:
        """Return a tracer for another formulation that shares the functions of this one."""
        other = copy.copy(self)
        other.chooses = chooses
        return other

    def classic(self, calls: Calls, a: str, lam: str, watch: str) -> None:
        """Update a, lam and watch by one more iteration (8) as printed."""
        found = f"{a} {lam} {watch}"
        calls("classic_iterate", spaced("k", MATRICES, found), found, lambda *x: _classic(calls.scene, *x))

    def once(self, calls: Calls, names: Mapping[str, str], formulation: str) -> None:
        """Compute a, lam and watch by a formulation without iterations, after an evaluation by `residual`.

        `names` maps q, v, a, lam and watch to names of values.
        """
        e, scene, watch = self.e, calls.scene, names["watch"]
        # Phi and C v come from a function that the start needs, too.
        residues = ("residue_mass", "residue_matrix", "Phi", "Cv")
        results = spaced([names[x] for x in ("a", "lam", "watch")])
        right = "xi"
        if formulation != "dae":
            calls.made.append(Call("constraints", (names["q"], names["v"], "p"), residues))
        if formulation in ("penalty", "baumgarte"):
            right = "stabilised"
            calls("by_stabilised", "xi Phi Cv stabilisation", right, _stabilised)
        if formulation == "penalty":  # (6)
            calls("by_penalty", f"k C F D L {right} {watch}", results, lambda *x: _penalty(scene, *x))
        elif formulation == "stiffness":  # (5)
            known = f"k M C F Phi stabilisation {watch}"
            calls("by_stiffness", known, results, lambda *x: _stiffness(scene, *x))
        else:  # (9), with or without Baumgarte's stabilisation
            system, solution = ("system", "system_right"), "system_solution"
            calls("by_system", f"k M C F {right}", spaced(system), lambda *x: _system(scene, *x))
            calls.made.append(LeastNorm(system, (solution,), e.n + e.l))
            calls("by_solution", f"k {solution} {watch}", results, lambda *x: _solved(scene, *x))


def _stabilised(xi: SX, Phi: SX, Cv: SX, stabilisation: SX) -> SX:
    return method.stabilised(xi, Cv, Phi, *ca.vertsplit(stabilisation))


def _classic(scene: Scene, M: SX, C: SX, F: SX, xi: SX, D: SX, L: SX, a: SX, lam: SX, watch: SX) -> tuple[SX, SX, SX]:
    """Iterate (8); changes are judged as in the oracle."""
    sizes: list[SX] = []

    def done(change: SX, value: SX) -> bool:
        scale = _largest(F) / ca.fmax(_largest(ca.vec(M.nz[:])), 1e-300)
        sizes[:] = [_largest(change) ** 2, ca.fmax(_largest(value), scale) ** 2]
        return False

    a, lam, _, _ = method.classic(M, F, C, xi, scene.weights, scene.solver(D, L), a, lam, 1, done)
    change, size = sizes
    return a, lam, Watch.of(watch)._replace(change=change, size=size).vector()


def _penalty(scene: Scene, C: SX, F: SX, D: SX, L: SX, xi: SX, watch: SX) -> tuple[SX, SX, SX]:
    """Solve (6) with xi already stabilised."""
    a, lam = method.penalty(F, C, xi, scene.weights, scene.solver(D, L))
    return a, lam, _at_once(watch)


def _stiffness(scene: Scene, M: SX, C: SX, F: SX, Phi: SX, stabilisation: SX, watch: SX) -> tuple[SX, SX, SX]:
    """Solve (5) with the stiffness omega^2 alpha; the watch reports pivots of M."""
    D, L = scene.factors(M)
    a, lam = method.stiffness(F, C, Phi, stabilisation[1] ** 2 * scene.weights, scene.solver(D, L))
    return a, lam, _at_once(watch, ca.mmin(ca.densify(D)))


def _system(scene: Scene, M: SX, C: SX, F: SX, xi: SX) -> tuple[SX, SX]:
    """Return the matrix of (9), by columns, and the right-hand side."""
    # A constraint that is not in force has zero row and column, and so a zero multiplier.
    C, xi = ca.diag(scene.held) @ C, scene.held * xi
    found: list[SX] = []

    def solve(blocks: list, right: list) -> tuple[SX, SX]:
        (M, Ct), (C, _) = blocks
        nothing = SX(C.size1(), C.size1())
        found[:] = [ca.vec(ca.densify(ca.blockcat([[M, Ct], [C, nothing]]))), ca.vertcat(*right)]
        return tuple(right)

    method.dae(M / scene.scale, F / scene.scale, C, xi, solve)
    matrix, right = found
    return matrix, right


def _solved(scene: Scene, solution: SX, watch: SX) -> tuple[SX, SX, SX]:
    """Split the solution of (9); its watch reports no pivot."""
    n = scene.e.n
    return solution[:n], scene.scale * solution[n:], _at_once(watch, SX(1))


def _at_once(watch: SX, pivot: SX | None = None) -> SX:
    """Return the watch of an evaluation without iterations, with another pivot."""
    seen = Watch.of(watch)
    return seen._replace(change=SX(0), pivot=seen.pivot if pivot is None else pivot).vector()


def _largest(x: SX) -> SX:
    return ca.mmax(ca.fabs(ca.densify(x)))
