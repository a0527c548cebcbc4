"""Other ways to the motion of a mechanism, for comparison: SciPy's integrators on the index-1 DAE (9).

Whoever has another code for any mechanism adds a `Rival` to RIVALS; what knows some mechanisms alone (Pinocchio,
Exudyn, MuJoCo) stands in `scripts/peers.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from .cases import ARITHMETIC, Case, Run
from .equations import Equations
from .oracle import Settings
from .runtime import Instance

__all__ = ["RIVALS", "Rival"]

MONITORS = ("monitor.position_error", "monitor.velocity_error", "monitor.energy")


@dataclass(frozen=True)
class Rival:
    """A code with a tolerance: `once` runs a mechanism and returns its outputs at the points of a case."""

    name: str
    method: str
    tolerances: Sequence[float]
    once: Callable[[Equations, float, Case], Run]

    def run(self, equations: Equations, tolerance: float, case: Case) -> Run:
        """A case, and again where it is short, to know its time better."""
        found = self.once(equations, tolerance, case)
        while found.complete and not case.enough(found.seconds):
            found.seconds += self.once(equations, tolerance, case).seconds
        return found


@np.errstate(all="ignore")
def _scipy(method: str, equations: Equations, tolerance: float, case: Case) -> Run:
    """(9) by least squares in every evaluation, integrated as it stands: constraints may drift."""
    e = equations
    instance = Instance(e, Settings(step_size=e.step_size, formulation="dae"))
    instance.initialize()
    oracle, u, n = instance.oracle, instance.inputs, e.n
    names = [*(v.name for v in e.outputs), *MONITORS]
    begin = time.perf_counter()

    def rate(t: float, y: NDArray) -> NDArray:
        if time.perf_counter() - begin > case.limit:
            raise TimeoutError
        return np.concatenate([y[n:], oracle.accelerations(y[:n], y[n:], u, t)[0]])

    def read(t: float, y: NDArray) -> NDArray:
        q, v = y[:n], y[n:]
        a, lam, _, _ = oracle.accelerations(q, v, u, t)
        return np.concatenate([oracle.outputs(q, v, a, lam, u, t), oracle.residues(q, v), [oracle.energy(q, v)]])

    table, reached, failure, cut = np.empty((0, len(names))), 0, "", False
    try:
        start, span = np.concatenate([instance.q, instance.v]), (0.0, case.times[-1])
        found = solve_ivp(rate, span, start, method, case.times, rtol=tolerance, atol=tolerance)
        table = np.array([read(t, y) for t, y in zip(found.t, found.y.T, strict=True)])
        reached, failure = len(found.t), "" if found.success else found.message
    except TimeoutError:
        cut = True
    except ARITHMETIC as error:
        failure = str(error) or type(error).__name__
    seconds = [time.perf_counter() - begin]
    counters = replace(oracle.counters, steps=0, energy_error=np.nan)
    return Run(names, case.times[:reached], table, seconds, counters if reached else None, failure, cut)


RIVALS = tuple(
    Rival("SciPy on (9)", method, (1e-3, 1e-5, 1e-7, 1e-9, 1e-11), partial(_scipy, method))
    for method in ("DOP853", "Radau", "BDF")
)
"""What every report runs beside alfmu."""
