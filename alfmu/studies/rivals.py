"""Other codes that compute the motion of a mechanism, for comparison.

SciPy's integrators run any mechanism, on the index-1 DAE (9); Pinocchio, Exudyn and MuJoCo run those with models in
`peers`, if they are installed. To compare another code, add a `Rival` to RIVALS.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ..equations import Equations
from ..model.settings import Settings
from ..simulation.oracle import Instance
from . import peers
from .cases import ARITHMETIC, STEP, TOLERANCE, Case, Run, repeated
from .trees import Simulation, by_exudyn, by_mujoco

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
        return repeated(self.build(equations, value, case), case)


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


def _machine(
    build: Callable[..., Simulation],
    given: Mapping[str, Mapping[str, Any]],
    equations: Equations,
    value: float,
    case: Case,
) -> Callable[[], Run]:
    """Run a model of the same mechanism from the same start; its angle and its reactions are judged."""
    machine = replace(peers.MACHINES[equations.name], times=case.times)
    start = machine.begin(*(float(v.start) for v in (*equations.starts, *equations.start_rates)))
    empty = case.times[:0], np.empty((0, len(machine.names)))

    def failed(error: Exception, seconds: float) -> Run:
        why = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        return Run(machine.names, *empty, [seconds], failure=why)

    try:
        simulate = build(machine, **given.get(equations.name, {}))
    except Exception as error:
        broken = failed(error, 0.0)
        return lambda: broken

    @np.errstate(all="ignore")
    def once() -> Run:
        started = time.process_time()
        try:
            found = simulate(start, value)
        except Exception as error:
            return failed(error, time.process_time() - started)
        k = len(found.places)
        short = "" if k == len(case.times) else found.stopped or f"stopped after {k} of {len(case.times)} points"
        table = machine.table(found) if k else empty[1]
        return Run(machine.names, case.times[:k], table, [found.seconds], failure=short)

    return once


def not_installed(package: str) -> str:
    """Return how to install a package that a code needs; empty if it is installed."""
    try:
        version(package)
    except PackageNotFoundError:
        return "not installed; pip install 'alfmu[bench]' has it"
    return ""


TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)

SCIPY = tuple(
    Rival("SciPy on (9)", method, TOLERANCE, lambda name: TOLERANCES, partial(_scipy, method), PYTHON)
    for method in ("DOP853", "Radau", "BDF")
)
"""SciPy's integrators."""

PART = 0.02
"""Steps divide this interval [s], and intervals of times are multiples of it."""

_CODES = {"Pinocchio": "pin", "Exudyn": "exudyn", "MuJoCo": "mujoco", "SciPy stabilised": "scipy"}
"""Packages of codes."""


def _tuned(
    name: str,
    method: str,
    values: Mapping[str, Sequence[float]],
    build: Callable[..., Simulation],
    given: Mapping[str, Mapping[str, Any]],
    control: str = STEP,
) -> Rival:
    """Return a code with its steps or tolerances, and arguments of its model, by mechanism."""
    return Rival(
        name,
        method,
        control,
        lambda mechanism: values.get(mechanism, ()),
        partial(_machine, build, given),
        LANGUAGES.get(name, COMPILED),
        not_installed(_CODES[name]),
    )


def _every(tried: Sequence[float]) -> dict[str, Sequence[float]]:
    """Return the same steps or tolerances for all mechanisms."""
    return dict.fromkeys(peers.MACHINES, tried)


def _steps(*parts: int) -> dict[str, Sequence[float]]:
    return _every([PART / k for k in parts])


def _each(argument: str, five_bar: Any, slider_crank: Any) -> dict[str, dict[str, Any]]:
    """Return an argument of models by mechanism."""
    return {"five_bar": {argument: five_bar}, "slider_crank": {argument: slider_crank}}


_RTOLS = {"five_bar": (1e-6, 1e-8, 1e-10, 1e-11, 1e-12), "slider_crank": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-11, 1e-12)}
_TIGHT = {"five_bar": (1e-7, 1e-8, 1e-9, 1e-11), "slider_crank": (1e-6, 1e-7, 1e-8, 1e-9, 1e-11)}
_STABILISED = _each("frequency", 60.0, 5.0)
_REDUNDANT = _each("redundant", True, False)
_INDEX_1 = {
    "five_bar": {"omega": 15.0, "cut": 1e-4, "coordinates": "mixed"},
    "slider_crank": {"omega": 6.0, "cut": 1e-12, "coordinates": "joint"},
}

TUNED = (
    _tuned("Pinocchio", "RK4, Baumgarte", _steps(1, 2, 3, 4, 8, 16, 32, 64), peers.by_pinocchio, _STABILISED),
    _tuned("Pinocchio", "RK4, not stabilised", _steps(1, 2, 3, 4, 8, 16, 32, 64), peers.by_pinocchio, {}),
    *(
        _tuned("Pinocchio", f"{x}, Baumgarte", _RTOLS, partial(peers.by_pinocchio, method=x), _STABILISED, TOLERANCE)
        for x in ("DOP853", "LSODA")
    ),
    _tuned(
        "Exudyn",
        "generalized alpha",
        {"five_bar": (5e-3, 1e-3, 2e-4, 1e-4, 4e-5), "slider_crank": (5e-3, 1e-3)},
        by_exudyn,
        _REDUNDANT,
    ),
    _tuned(
        "Exudyn",
        "trapezoidal, index 2",
        {"five_bar": (5e-3, 1e-3), "slider_crank": (5e-3, 1e-3, 2e-4, 5e-5)},
        partial(by_exudyn, solver="TrapezoidalIndex2"),
        _REDUNDANT,
    ),
    _tuned("MuJoCo", "RK4", _steps(2, 4, 5, 8, 10, 20, 40), by_mujoco, _each("hardness", 2.0, 0.2)),
    _tuned(
        "MuJoCo",
        "implicitfast",
        _steps(10, 40),
        partial(by_mujoco, integrator="implicitfast"),
        _each("hardness", 0.1, 0.5),
    ),
    *(
        _tuned("SciPy stabilised", x, values, partial(peers.by_scipy, method=x), _INDEX_1, TOLERANCE)
        for x, values in (("DOP853", _every([10.0**-k for k in range(5, 12)])), ("RK45", _TIGHT), ("LSODA", _TIGHT))
    ),
)
"""Codes that are tuned to a mechanism, each with the best settings of those tried (`peers.USAGE`)."""

RIVALS = (*SCIPY, *TUNED)
"""Codes that every report runs beside alfmu."""
