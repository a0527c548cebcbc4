"""Load-dependent friction in the multiplier iteration: the calls of an evaluation that solve for it.

An evaluation computes a and lambda without friction. `respond` computes their changes per unit of each friction, from
the same factors of H. Each pass of `rub` is an iteration of Newton's method (`alfmu.method.friction`) and of the
multiplier iteration, so that both converge to round-off. If no friction satisfies the laws, `rubbed` returns NaN
accelerations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import casadi as ca
from casadi import SX

from ..method import friction as method
from ..method.singular import NOISE_FLOOR
from .form import Loop, Step, Steps
from .symbolic import MATRICES, Scene, Watch


class Calls(Protocol):
    """Interface of the steps of a program while it is traced (`alfmu.kernel.trace.Calls`)."""

    scene: Scene
    made: list[Step]

    @property
    def steps(self) -> Steps: ...

    def inside(self) -> Calls:
        """Return empty calls of the same plan."""

    def __call__(self, name: str, arguments: str, results: str, function: Callable[..., SX | Sequence[SX]]) -> None:
        """Call the function of this name."""


def rub(calls: Calls, known: str, a: str, lam: str, power: str, watch: str) -> None:
    """Compute a, lam, power and watch of an evaluation with friction; `known` are its time, q, v and inputs."""
    scene, kind, again = calls.scene, calls.scene.kind, calls.inside()
    _, q, v, _ = known.split()
    matrices = " ".join(MATRICES)
    at = f"{known} p k" if _carried(scene) else "k"
    calls(f"{kind}_respond", f"{at} M C D L", "moved pressed", lambda *x: _respond(scene, *x))
    calls("rub_begin", "k", "rubs rubbed", lambda: (SX(1), SX.zeros(2)))
    names = f"{known} p k {matrices} {a} {lam} {watch} moved pressed"
    again(f"{kind}_rub", names, f"{a} {lam} {watch} rubs rubbed", lambda *x: _rub(scene, *x))
    calls.made.append(Loop("rubs", method.LAW_PASSES, again.steps))
    names = f"{q} {v} p k {a} {lam} {power} {watch} rubbed"
    calls(f"{kind}_rubbed", names, f"{a} {power} {watch}", lambda *x: _rubbed(scene, *x))


def _respond(scene: Scene, *known: SX) -> tuple[SX, SX]:
    """Return changes of a and lam, by columns, per unit of each friction; zero for a joint that sticks."""
    *at, M, C, D, L = known
    e, solve, moved, pressed = scene.e, scene.solver(D, L), [], []
    a, lam = SX.sym("a", e.n), SX.sym("lam", e.l)
    shared = _shared(scene, at, M, C, a, lam)
    for each in e.frictions:
        slides = 1 - scene.held[each.row]
        change = slides * solve(-ca.densify(C[each.row, :].T))
        by_lam, unit = scene.weights @ (C @ change), slides * SX.eye(e.l)[:, each.row]
        by_unit = ca.jtimes(shared, ca.vertcat(a, lam), ca.vertcat(change, by_lam + unit)) - unit
        moved.append(change)
        pressed.append(ca.substitute(by_unit, ca.vertcat(a, lam), SX.zeros(e.n + e.l)))
    return ca.vertcat(*moved), ca.densify(ca.vertcat(*pressed))


def _carried(scene: Scene) -> bool:
    """Return whether frictions follow from loads that joints share."""
    return not scene.e.compliances and any(x.output in (scene.e.survey.shared or ()) for x in scene.e.frictions)


def _shared(scene: Scene, at: Sequence[SX], M: SX, C: SX, a: SX, lam: SX) -> SX:
    """Return multipliers as in the outputs, from which friction follows; `at` are time, q, v and inputs."""
    if scene.e.compliances:
        return scene.distributed(M, C, lam)
    if not _carried(scene):
        return lam
    t, q, v, u = at
    return scene.carried(t, q, v, u, C, a, lam)


def _rub(scene: Scene, *known: SX) -> tuple[SX, ...]:
    """Return a, lam and watch after one more pass, whether to continue, and the convergence of the laws: their residual
    over the friction (squared), the least pivot."""
    t, q, v, u, M, C, F, xi, D, L, a, lam, watch, moved, pressed = known
    e, frictions = scene.e, scene.e.frictions
    count, rows = len(frictions), [x.row for x in frictions]
    law = scene.scale * e.rubbing(q, v, a, lam / scene.scale, u, scene.p, t)[:count]
    slides = [1 - scene.held[row] for row in rows]
    moves, presses = ca.vertsplit(moved, e.n), ca.vertsplit(pressed, e.l)
    units = [slides[j] * SX.eye(e.l)[:, row] for j, row in enumerate(rows)]
    columns = [ca.jtimes(law, ca.vertcat(a, lam), ca.vertcat(moves[j], presses[j] + units[j])) for j in range(count)]
    residues = [slides[i] * (law[i] - lam[rows[i]]) for i in range(count)]
    slopes = [[slides[i] * columns[j][i] for j in range(count)] for i in range(count)]
    change, pivots = method.newton(slopes, residues)
    after, lam = a, ca.densify(lam)
    for j in range(count):
        after += moves[j] * change[j]
        lam += (presses[j] + units[j]) * change[j]
    after, lam, _ = scene.iterated((M, C, F, xi), (D, L), after, lam, 1)
    lam = _shared(scene, (t, q, v, u), M, C, after, lam)
    changed = ca.fmax(scene.squares(after - a) - scene.left(M, F, C.T @ lam), 0)
    seen = Watch.of(watch)
    # Expected change by one more iteration, as in `Scene.judged`.
    following = changed * ca.fmin(scene.settings.nothing / NOISE_FLOOR / seen.margin, 1) ** 2
    watch = seen._replace(change=following, size=scene.squares(after)).vector()
    size = sum((lam[row] ** 2 for row in rows), SX(_TINY))
    lacking = sum((x**2 for x in residues), SX(0)) / size
    held = ca.vertcat(lacking, ca.mmin(ca.vertcat(*pivots)))
    # Multipliers converge after accelerations.
    done = following <= scene.settings.tolerance**2 * scene.squares(after) + _TINY
    more = 1 - done * (lacking <= method.LAW_ENOUGH**2)
    return after, lam, watch, more, held


_TINY = 1e-300
"""Avoids division by zero for a mechanism at rest."""


def _rubbed(scene: Scene, q: SX, v: SX, a: SX, lam: SX, power: SX, watch: SX, rubbed: SX) -> tuple[SX, SX, SX]:
    """Return a and watch, which are NaN if no friction was found, and the power including friction."""
    frictions = scene.e.frictions
    found = ca.logic_and(rubbed[0] <= method.JAM_SETTLED**2, rubbed[1] > 0)
    rates = scene.e.sliding(q, v, scene.p)
    for i, each in enumerate(frictions if scene.e.works else ()):
        power -= rates[i] * lam[each.row] / scene.scale
    seen = Watch.of(watch)
    return (
        ca.if_else(found, a, math.nan),
        power,
        seen._replace(change=ca.if_else(found, seen.change, math.inf)).vector(),
    )


def supply(scene: Scene, t: SX, q: SX, v: SX, a: SX, lam: SX, u: SX) -> SX:
    """Return power of prescribed motion and of friction, if time is a coordinate."""
    rates = scene.e.sliding(q, v, scene.p)
    lost = sum((rates[i] * lam[each.row] for i, each in enumerate(scene.e.frictions)), SX(0))
    return scene.supply(t, q, v, a, lam, u) - lost / scene.scale


def power(calls: Calls, known: str, a: str, result: str, name: str = "rubbing_power") -> None:
    """Compute the power including friction from accelerations alone, v' (M a - F), as constraints do no work.

    `known` are time, q, v and inputs; `a` may end with rates of states.
    """
    scene = calls.scene

    def found(t: SX, q: SX, v: SX, u: SX, a: SX) -> SX:
        M, _, F, _ = scene.terms(t, q, v, u)
        return scene.power(t, q, v, u) + ca.dot(v, M @ a[: scene.e.n] - F) / scene.scale

    calls(name, f"{known} {a} p k", result, found)


def grip(calls: Calls, known: str, a: str, lam: str) -> None:
    """Compute the quantities that decide on sticking and sliding: multipliers of the constraints of joints, their
    limits, accelerations, and the convergence of the laws."""
    scene, e = calls.scene, calls.scene.e

    def found(t: SX, q: SX, v: SX, u: SX, a: SX, lam: SX, rubbed: SX) -> SX:
        count = len(e.frictions)
        physical = lam / scene.scale
        laws = e.rubbing(q, v, a, physical, u, scene.p, t)
        return ca.vertcat(*(physical[x.row] for x in e.frictions), laws[count:], rubbed)

    calls("grip", f"{known} p k {a} {lam} rubbed", "grip", found)
