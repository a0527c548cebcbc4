"""Other codes that compute the motion of a mechanism, for comparison.

SciPy's integrators run any mechanism, on the index-1 DAE (9); Pinocchio, Exudyn and MuJoCo run those with models in
`peers`, if they are installed. To compare another code, add a `Rival` to RIVALS.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ..equations import Equations
from ..model.settings import Settings
from ..simulation.oracle import Instance
from . import peers
from .cases import ARITHMETIC, STEP, TOLERANCE, Case, Run
from .peers import Peer, Start

PYTHON, COMPILED = "Python", "compiled code"
LANGUAGES = {"Pinocchio": "compiled code, stepped in Python", "SciPy stabilised": PYTHON}
"""Languages of codes that are not entirely compiled."""

MONITORS = ("monitor.position_error", "monitor.velocity_error", "monitor.energy")


@dataclass(frozen=True)
class Rival:
    """A code with a step or a tolerance: `build` prepares a mechanism and returns a function that runs a case once."""

    name: str
    method: str
    control: str
    """STEP or TOLERANCE."""
    values: Callable[[str], Sequence[float]]
    """Steps [s] or tolerances for a mechanism by its name, the largest first; none without a model."""
    build: Callable[[Equations, float, Case], Callable[[], Run]]
    language: str
    """Language of its steps and evaluations."""
    missing: str = ""
    """Reason why it cannot be run here; empty if it can."""

    def run(self, equations: Equations, value: float, case: Case) -> Run:
        """Run a case, with repetitions if it is short, for an accurate time."""
        once = self.build(equations, value, case)
        found = once()
        while found.complete and not case.enough(found.seconds):
            found.seconds += once().seconds
        return found


def _scipy(method: str, equations: Equations, tolerance: float, case: Case) -> Callable[[], Run]:
    """Integrate (9), solved by least squares in every evaluation, without stabilisation: constraints may drift."""
    e = equations
    instance = Instance(e, Settings(step_size=e.step_size, formulation="dae"))
    instance.initialize()
    n = e.n
    names = [*(v.name for v in e.outputs), *MONITORS]
    start, span = np.concatenate([instance.q, instance.v, instance.states]), (0.0, case.times[-1])

    def parted(y: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        q, v, x = np.split(y, [n, 2 * n])
        return q, v, np.concatenate([instance.inputs, x])

    def read(t: float, y: NDArray) -> NDArray:
        q, v, u = parted(y)
        a, lam, _, _ = instance.accelerations(q, v, u, t)
        return np.concatenate([instance.readings(q, v, a, lam, u, t), instance.residues(q, v), [instance.energy(q, v)]])

    @np.errstate(all="ignore")
    def once() -> Run:
        begin, started = time.perf_counter(), time.process_time()

        def rate(t: float, y: NDArray) -> NDArray:
            if time.perf_counter() - begin > case.limit:
                raise TimeoutError
            q, v, u = parted(y)
            return np.concatenate([v, instance.accelerations(q, v, u, t)[0], instance.state_rates(q, v, u, t)])

        table, reached, failure, cut, before = np.empty((0, len(names))), 0, "", False, instance.counters.evaluations
        try:
            found = solve_ivp(rate, span, start, method, case.times, rtol=tolerance, atol=tolerance)
            table = np.array([read(t, y) for t, y in zip(found.t, found.y.T, strict=True)])
            reached, failure = len(found.t), "" if found.success else found.message
        except TimeoutError:
            cut = True
        except ARITHMETIC as error:
            failure = str(error) or type(error).__name__
        seconds = [time.process_time() - started]
        used = instance.counters.evaluations - before
        counters = replace(instance.counters, steps=0, evaluations=used, energy_error=np.nan)
        return Run(names, case.times[:reached], table, seconds, counters if reached else None, failure, cut)

    return once


def _peer(peer: Peer, equations: Equations, value: float, case: Case) -> Callable[[], Run]:
    """Run a model of the same mechanism from the same start; its angle and its reactions are judged."""
    starts = [float(v.start) for v in (*equations.starts, *equations.start_rates)]
    names = [peers.ANGLE[equations.name], *peers.REACTIONS[equations.name]]
    empty = case.times[:0], np.empty((0, len(names)))

    def failed(error: Exception, seconds: float) -> Run:
        return Run(names, *empty, [seconds], failure=f"{type(error).__name__}: {' '.join(str(error).split())[:120]}")

    try:
        simulate = peer.build(equations.name, Start(*starts), value, case.times)
    except Exception as error:
        broken = failed(error, 0.0)
        return lambda: broken

    @np.errstate(all="ignore")
    def once() -> Run:
        started = time.process_time()
        try:
            found = simulate()
        except Exception as error:
            return failed(error, time.process_time() - started)
        seconds, k = [time.process_time() - started], len(found.times)
        short = "" if k == len(case.times) else found.note or f"stopped after {k} of {len(case.times)} points"
        table = np.column_stack([found.angle, found.reactions]) if k else empty[1]
        return Run(names, case.times[:k], table, seconds, failure=short)

    return once


def _model(peer: Peer) -> Rival:
    control = STEP if peer.control == "step" else TOLERANCE
    missing = "" if peer.installed else "not installed; pip install 'alfmu[bench]' has it"
    values, build = (lambda name: peer.steps.get(name, ())), partial(_peer, peer)
    return Rival(peer.name, peer.setting, control, values, build, LANGUAGES.get(peer.name, COMPILED), missing)


TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)

SCIPY = tuple(
    Rival("SciPy on (9)", method, TOLERANCE, lambda name: TOLERANCES, partial(_scipy, method), PYTHON)
    for method in ("DOP853", "Radau", "BDF")
)
"""SciPy's integrators."""

TUNED = tuple(map(_model, peers.TUNED))
"""Codes that are tuned to a mechanism."""

RIVALS = (*SCIPY, *TUNED)
"""Codes that every report runs beside alfmu."""
