"""The formulations beside `residual`, traced: what each makes of the same M, C, F, xi and factors of H.

An evaluation of another formulation begins with that of `residual`, whose long functions it shares, and goes on with
short ones of its own: iterations of (8) as printed, the solutions of (5) and (6), or the system of (9), which a routine
solves in the sense of least norm (`program.LEAST_NORM`). All but that system are in units of the largest penalty, as
`trace.Scene` has them; (9) keeps the units of the equations, as its singular values are compared with each other.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Self

import casadi as ca

from ..equations import Equations
from ..equations.evaluation import DENSE
from ..method import formulations as method
from ..model.settings import FORMULATIONS, Settings
from .program import LEAST_NORM
from .trace import Calls, Scene, Tracer, Watch, _factors, _solver

__all__ = ["OWN", "SYSTEMS", "Alternatives", "alternatives", "classic", "formulations"]

OWN = Settings.formulation
"""The formulation of every program whose name says no other."""

SYSTEMS = ("baumgarte", "dae")
"""Formulations that solve the dense system (9) of all coordinates and constraints."""


def formulations(equations: Equations) -> list[str]:
    """The formulations that a scene carries, in the order of FORMULATIONS; without constraints all are the same."""
    dense = equations.n <= DENSE or not equations.l
    return [name for name in FORMULATIONS if dense or name not in SYSTEMS]


def alternatives(equations: Equations) -> list[str]:
    """The formulations that have programs of their own."""
    return [name for name in formulations(equations) if name != OWN and equations.l]


class Alternatives(Tracer):
    """Traces evaluations by the formulation that is chosen."""

    formulation = OWN

    def by(self, formulation: str) -> Self:
        """The same tracer, sharing its functions, for another formulation."""
        other = copy.copy(self)
        other.formulation = formulation
        return other

    def once(self, calls: Calls, scene: Scene, names: Mapping[str, str]) -> None:
        """a, lam (times `scale`) and watch by a formulation that does not iterate, after an evaluation by `residual`.

        `names` are those of q, v, a, lam and watch.
        """
        own = {"penalty": self._penalty, "stiffness": self._stiffness}
        own.get(self.formulation, self._system)(calls, scene, names)

    def _penalty(self, calls: Calls, scene: Scene, names: Mapping[str, str]) -> None:
        """(6)."""
        matrices, watch = self.matrices(scene), _watch_symbol()
        self._stabilised(calls, scene, names)
        known = {"k": self.known["k"], **{x: matrices[x] for x in ("C", "F", "D", "L")}}
        known |= {"stabilised": matrices["xi"], names["watch"]: watch}
        calls("by_penalty", known, lambda: penalty(scene, matrices, watch), [names[x] for x in ("a", "lam", "watch")])

    def _stiffness(self, calls: Calls, scene: Scene, names: Mapping[str, str]) -> None:
        """(5)."""
        matrices, watch = self.matrices(scene), _watch_symbol()
        Phi, numbers = ca.SX.sym("Phi", self.e.l), ca.SX.sym("stabilisation", 2)
        self._residues(calls, names)
        known = {"k": self.known["k"], **{x: matrices[x] for x in ("M", "C", "F")}}
        known |= {"Phi": Phi, "stabilisation": numbers, names["watch"]: watch}
        results = [names[x] for x in ("a", "lam", "watch")]
        calls("by_stiffness", known, lambda: stiffness(scene, matrices, Phi, numbers, watch), results)

    def _system(self, calls: Calls, scene: Scene, names: Mapping[str, str]) -> None:
        """(9), with Baumgarte's stabilisation or without."""
        e, k = self.e, self.known["k"]
        matrices, watch, solution = self.matrices(scene), _watch_symbol(), ca.SX.sym("solution", e.n + e.l)
        right = "xi"
        if self.formulation == "baumgarte":
            self._stabilised(calls, scene, names)
            right = "stabilised"
        terms, both = {x: matrices[x] for x in ("M", "C", "F")}, _System(scene, matrices, solution)
        calls("by_system", {"k": k, **terms, right: matrices["xi"]}, both.system, ["system", "system_right"])
        calls.made.append([LEAST_NORM, ["system", "system_right"], ["system_solution"], e.n + e.l])
        known = {"k": k, "system_solution": solution, names["watch"]: watch}
        calls("by_solution", known, lambda: both.solved(watch), [names[x] for x in ("a", "lam", "watch")])

    def _stabilised(self, calls: Calls, scene: Scene, names: Mapping[str, str]) -> None:
        """xi with damping and frequency."""
        xi, Phi, Cv = self.matrices(scene)["xi"], ca.SX.sym("Phi", self.e.l), ca.SX.sym("Cv", self.e.l)
        numbers = ca.SX.sym("stabilisation", 2)
        self._residues(calls, names)
        known = {"xi": xi, "Phi": Phi, "Cv": Cv, "stabilisation": numbers}
        values = xi, Cv, Phi, *ca.vertsplit(numbers)
        calls("by_stabilised", known, lambda: {"xi": method.stabilised(*values)}, ["stabilised"])

    def _residues(self, calls: Calls, names: Mapping[str, str]) -> None:
        """Phi and C v, by a function that the start needs anyway."""
        calls.made.append(
            ["constraints", [names["q"], names["v"], "p"], ["residue_mass", "residue_matrix", "Phi", "Cv"]]
        )


def classic(scene: Scene, nonzeros: dict[str, ca.SX], a: ca.SX, lam: ca.SX, watch: ca.SX) -> dict[str, ca.SX]:
    """a and lam (times `scale`) after one more iteration (8) as printed; its changes are judged as the oracle does."""
    M, C, F, xi, D, L = (scene.matrix(name, nonzeros) for name in ("M", "C", "F", "xi", "D", "L"))
    sizes: list[ca.SX] = []

    def done(change: ca.SX, value: ca.SX) -> bool:
        scale = _largest(F) / ca.fmax(_largest(nonzeros["M"]), 1e-300)
        sizes[:] = [_largest(change) ** 2, ca.fmax(_largest(value), scale) ** 2]
        return False

    a, lam, _, _ = method.classic(M, F, C, xi, scene.weights, _solver(D, L, scene.e.order), a, lam, 1, done)
    return {"a": a, "lam": lam, "watch": _watch(watch, *sizes)}


def penalty(scene: Scene, nonzeros: dict[str, ca.SX], watch: ca.SX) -> dict[str, ca.SX]:
    """a and lam (times `scale`) by (6); xi is stabilised already."""
    C, F, xi, D, L = (scene.matrix(name, nonzeros) for name in ("C", "F", "xi", "D", "L"))
    a, lam = method.penalty(F, C, xi, scene.weights, _solver(D, L, scene.e.order))
    return {"a": a, "lam": lam, "watch": _watch(watch)}


def stiffness(
    scene: Scene, nonzeros: dict[str, ca.SX], Phi: ca.SX, stabilisation: ca.SX, watch: ca.SX
) -> dict[str, ca.SX]:
    """a and lam (times `scale`) by (5) with the stiffness omega^2 alpha; the pivots that are watched are those of M."""
    M, C, F = (scene.matrix(name, nonzeros) for name in ("M", "C", "F"))
    D, L, order = _factors(scene.e, M)
    a, lam = method.stiffness(F, C, Phi, stabilisation[1] ** 2 * scene.weights, _solver(D, L, order))
    return {"a": a, "lam": lam, "watch": _watch(watch, pivot=ca.mmin(ca.densify(D)))}


class _System:
    """(9), before it is solved and after that."""

    def __init__(self, scene: Scene, nonzeros: dict[str, ca.SX], solution: ca.SX):
        self._scale, n = scene.scale, scene.e.n
        M, C, F, xi = (scene.matrix(name, nonzeros) for name in ("M", "C", "F", "xi"))
        # A constraint that is not in force leaves a row and a column of zeros, and its multiplier is zero.
        C, xi = ca.diag(scene.held) @ C, scene.held * xi

        def solve(blocks: list, right: list) -> tuple[ca.SX, ca.SX]:
            (M, Ct), (C, _) = blocks
            nothing = ca.SX(C.size1(), C.size1())
            self._K, self._right = ca.blockcat([[M, Ct], [C, nothing]]), ca.vertcat(*right)
            return solution[:n], solution[n:]

        self._a, self._lam = method.dae(M / scene.scale, F / scene.scale, C, xi, solve)

    def system(self) -> dict[str, ca.SX]:
        """The matrix, by columns, and the right-hand side."""
        return {"K": ca.vec(ca.densify(self._K)), "right": self._right}

    def solved(self, watch: ca.SX) -> dict[str, ca.SX]:
        """a and lam (times `scale`); there is no pivot that could be too small."""
        return {"a": self._a, "lam": self._scale * self._lam, "watch": _watch(watch, pivot=ca.SX(1))}


def _watch(watch: ca.SX, change: ca.SX | None = None, size: ca.SX | None = None, pivot: ca.SX | None = None) -> ca.SX:
    """What an evaluation says of itself, with another change (none where it does not iterate), size or pivot."""
    seen = Watch(watch)
    return ca.vertcat(
        ca.SX(0) if change is None else change,
        seen.size if size is None else size,
        seen.pivot if pivot is None else pivot,
        seen.near,
        seen.margin,
    )


def _watch_symbol() -> ca.SX:
    return ca.SX.sym("watch", len(Watch.FIELDS))


def _largest(x: ca.SX) -> ca.SX:
    return ca.mmax(ca.fabs(ca.densify(x)))
