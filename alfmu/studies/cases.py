"""What studies share: a case, which is a run with its errors, its cost and what went wrong; and the loop over them."""

from __future__ import annotations

import shlex
import statistics
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..catalogue.registry import load
from ..equations import Equations
from ..equations.derivation import derive
from ..equations.interface import CHOICES, SOLVER_VARIABLES, Counters
from ..equations.types import Configuration
from ..model.errors import AlfmuError
from ..model.files import write
from ..model.mechanism import Mechanism
from ..model.settings import FIXED
from ..runtime import Instance
from ..simulation import Unit, prepared, with_defaults
from . import tables
from .charts import require
from .reference import Reference
from .tables import Cell, Row, write_csv

__all__ = [
    "ENERGY",
    "PHI",
    "PHI_DOT",
    "POSITION",
    "QUANTITIES",
    "REACTION",
    "STEP",
    "TOLERANCE",
    "Begun",
    "Case",
    "Judge",
    "Progress",
    "Run",
    "Study",
    "begin",
    "control",
    "exactness",
    "methods",
    "restarting",
    "run",
    "scene",
]

POSITION, REACTION = "position error [m, rad]", "reaction error [N, N.m]"
PHI, PHI_DOT = "constraint error, Phi [m, rad]", "constraint error, Phi-dot [m/s, rad/s]"
ENERGY = "energy error [J]"
QUANTITIES = (POSITION, REACTION, PHI, PHI_DOT, ENERGY)
"""What is measured of each run: largest values over the points where it was read."""

STEP, TOLERANCE = "step [s]", "tolerance"
"""What sets the error of a method."""

SMALL = 1000
"""Operations in the equations that a study takes as long for as for all that does not depend on their number."""

REPEATED = 0.1
"""Part of the limit of time that goes into repeating a run."""

AGREEING, AGREED = 3, 1.03
"""The fastest of the repeats is believed where so many of them are within this factor of it: others only add to it."""

ARITHMETIC = (AlfmuError, ArithmeticError, ValueError, np.linalg.LinAlgError)
"""What ends a run and is a result of it."""


def methods() -> dict[str, str]:
    """Names of the methods of integration that there are to choose from, and what they are."""
    return dict(CHOICES["solver.method"])


def control(method: str) -> str:
    """What sets the error of a method: STEP or TOLERANCE."""
    return STEP if method in FIXED else TOLERANCE


def scene(equations: Equations, method: str, kernel: str) -> Configuration:
    """The scene of a mechanism that carries a method."""
    return prepared(with_defaults(equations, {"solver.method": method}), kernel)


def exactness(method: str, value: float) -> dict[str, float | str]:
    """Solver variables for the step [s] of a method, or its tolerance."""
    if control(method) == STEP:
        return {"solver.step_size": value}
    known = {v.name for v in SOLVER_VARIABLES}
    return {x: value for x in ("solver.relative_tolerance", "solver.absolute_tolerance") if x in known}


Progress = Callable[[Sequence[Any]], Iterable[Any]]
"""Wraps the cases of a study, to show how far it is (`iter` shows nothing)."""


@dataclass(frozen=True)
class Case:
    """What is run."""

    values: Mapping[str, float | str]
    """Solver variables and parameters that are set before the start."""
    times: NDArray
    """Points at which the outputs are read [s]."""
    limit: float
    """Wall time after which a run is stopped [s]."""
    most: int = 1
    """Times that it is run, as far as a part of the limit allows; fewer where the fastest agree."""

    def enough(self, seconds: Sequence[float]) -> bool:
        """Whether runs of this length measure the time well enough."""
        if len(seconds) >= self.most or sum(seconds) > REPEATED * self.limit:
            return True
        spread = _spread(seconds)
        return spread is not None and spread <= AGREED


@dataclass
class Run:
    """What came of a case."""

    names: list[str]
    """Of the outputs."""
    times: NDArray
    """Points that were reached (k,)."""
    values: NDArray
    """Outputs there (k, outputs)."""
    seconds: list[float]
    """Wall time of each repetition, for steps and reading."""
    counters: Counters | None = None
    failure: str = ""
    """Message of the error that ended it."""
    cut: bool = False
    """Whether the limit of time ended it."""

    @property
    def complete(self) -> bool:
        return not (self.failure or self.cut)

    def __getitem__(self, name: str) -> NDArray | None:
        """An output over time, None where it is not computed."""
        return self.values[:, self.names.index(name)] if name in self.names else None

    def cost(self) -> Row:
        """Time and work, and what went wrong."""
        c = self.counters
        return {
            "median [s]": statistics.median(self.seconds) if self.complete else None,
            "least [s]": min(self.seconds) if self.complete else None,
            "spread of the fastest": _spread(self.seconds) if self.complete else None,
            "repeats": len(self.seconds),
            "simulated [s]": float(self.times[-1]) if len(self.times) else 0.0,
            "steps": c.steps if c else None,
            "evaluations": c.evaluations if c else None,
            "note": self.failure or ("stopped: it took too long" if self.cut else ""),
        }


def _spread(seconds: Sequence[float]) -> float | None:
    """How many times as long as the fastest run the last of the AGREEING fastest took; None of fewer."""
    return sorted(seconds)[AGREEING - 1] / min(seconds) if len(seconds) >= AGREEING else None


def restarting(unit: Unit) -> Callable[[], None]:
    """What brings a unit that is not initialised yet back to where it is now."""
    return unit.reset if hasattr(unit, "reset") else partial(unit.restore, unit.save())


def run(unit: Unit, restart: Callable[[], None], case: Case) -> Run:
    """Run a case, and again where it is short, to know its time better."""
    found = _once(unit, restart, case)
    while found.complete and not case.enough(found.seconds):
        found.seconds += _once(unit, restart, case).seconds
    return found


@np.errstate(all="ignore")
def _once(unit: Unit, restart: Callable[[], None], case: Case) -> Run:
    restart()
    times, names = case.times.tolist(), [v.name for v in unit.outputs]
    table, reached, failure, cut = np.empty((len(times), len(names))), 0, "", False
    begin = time.perf_counter()
    try:
        for name, value in case.values.items():
            unit.set(name, value)
        unit.initialize()
        begin = time.perf_counter()
        table[0], reached = unit.read(), 1
        for i, t in enumerate(times[:-1], 1):
            if time.perf_counter() - begin > case.limit:
                cut = True
                break
            unit.step(times[i] - t, t)
            table[i], reached = unit.read(), i + 1
    except ARITHMETIC as error:
        failure = str(error) or type(error).__name__
    seconds = [time.perf_counter() - begin]
    counters = getattr(unit, "counters", None) if reached else None
    return Run(names, case.times[:reached], table[:reached], seconds, counters, failure, cut)


class Judge:
    """Errors of runs of one mechanism against a reference; without one, of constraints and energy alone."""

    def __init__(self, equations: Configuration, reference: Reference | None):
        outputs, shared = equations.outputs, set(equations.survey.shared or ())
        self.reference = reference
        self.conserves = not equations.works
        self.names = [v.name for v in outputs]
        self.turning = np.array([v.unit == "rad" for v in outputs])
        self.positions = [v.name for v in outputs if v.unit in ("m", "rad")]
        self.reactions = [v.name for v in outputs if v.unit in ("N", "N.m") and v.name not in shared]
        self._known: dict[bytes, tuple[NDArray, NDArray]] = {}
        if reference is not None and equations.works:
            self.conserves = reference.conserves()

    def errors(self, run: Run) -> Row:
        """The quantities of a run."""
        position, reaction = self.compared(run.names, run.times, run.values)
        return {
            POSITION: position,
            REACTION: reaction,
            PHI: _largest(run["monitor.position_error"]),
            PHI_DOT: _largest(run["monitor.velocity_error"]),
            ENERGY: self._energy(run),
        }

    @np.errstate(all="ignore")
    def compared(self, names: list[str], times: NDArray, values: NDArray) -> tuple[float | None, float | None]:
        """Largest errors of positions and of reactions; None where nothing can be compared."""
        if self.reference is None or not len(times):
            return None, None
        exact, readable = self._exact(times)
        columns = [names.index(name) for name in self.names if name in names]
        kept = [i for i, name in enumerate(self.names) if name in names]
        gaps = values[:, columns] - exact[:, kept]
        turning = self.turning[kept]
        gaps[:, turning] -= 2 * np.pi * np.round(gaps[:, turning] / (2 * np.pi))
        place = {self.names[i]: k for k, i in enumerate(kept)}
        known = ~np.isnan(exact[:, 0])
        at = [place[name] for name in self.positions if name in place]
        on = [place[name] for name in self.reactions if name in place]
        return _largest(gaps[np.ix_(known, at)]), _largest(gaps[np.ix_(readable, on)])

    def size(self, times: NDArray) -> float:
        """Size of the mechanism: the largest output in m of the reference at some times; 1 where there is none."""
        exact = self._exact(times)[0]
        metres = [name in self.positions and not turns for name, turns in zip(self.names, self.turning, strict=True)]
        return float(np.nanmax(np.abs(exact[:, metres]), initial=0.0)) or 1.0

    def errors_of_reference(self, times: NDArray) -> list[Row]:
        """What the reference changes by where it is computed in other ways."""
        rows = []
        for name, values in self.reference.checks(times):
            reached = ~np.isnan(values[:, 0])
            position, reaction = self.compared(self.names, times[reached], values[reached])
            rows.append({"compared with": name, POSITION: position, REACTION: reaction})
        return rows

    def _exact(self, times: NDArray) -> tuple[NDArray, NDArray]:
        """Outputs of the reference, and where reactions can be judged."""
        key = times.tobytes()
        if key not in self._known:
            self._known[key] = self.reference.outputs(times), self.reference.readable(times)
        return self._known[key]

    def _energy(self, run: Run) -> float | None:
        """Energy less what was worked on the mechanism, over the run."""
        energy = run["monitor.energy"]
        if self.conserves and energy is not None and len(energy):
            return _largest(energy - energy[0])
        return run.counters.energy_error if run.counters and np.isfinite(run.counters.energy_error) else None


def _largest(values: NDArray | None) -> float | None:
    """The largest size, NaN where one is not a number, None of nothing."""
    return None if values is None or not values.size else float(np.abs(values).max())


# Studies -----------------------------------------------------------------------------------------------------------


class Effort(Protocol):
    """How much is measured."""

    total: float
    """Wall time for all mechanisms together [s]."""


class Study(ABC):
    """All cases of one mechanism."""

    def __init__(self, name: str | Path | Mechanism, effort: Any):
        self.mechanism, self.effort = load(name), effort
        self.name = self.mechanism.name
        self.derived = derive(self.mechanism)
        Instance(self.derived).initialize()

    @abstractmethod
    def measure(self, deadline: float, progress: Progress) -> None:
        """Run the cases, as far as time allows until `deadline` (of `time.perf_counter`)."""


AnyStudy = TypeVar("AnyStudy", bound=Study)


@dataclass(frozen=True)
class Begun(Generic[AnyStudy]):
    """Studies of mechanisms that are about to run."""

    studies: list[AnyStudy]
    folder: Path
    """Where they are written."""
    environment: list[Row]
    """Where they are made."""
    total: float
    """Wall time for all [s]."""

    def measured(self, progress: Callable[[str], Progress]) -> Iterator[AnyStudy]:
        """The studies, each measured with its share of the time that is left: larger equations take longer."""
        end = time.perf_counter() + self.total
        sizes = [sum(f.n_nodes() for f in study.derived.functions.values()) for study in self.studies]
        weights = [SMALL + size for size in sizes]
        for i, study in enumerate(self.studies):
            now = time.perf_counter()
            study.measure(now + (end - now) * weights[i] / sum(weights[i:]), progress(study.name))
            yield study

    def rows(self, of: Callable[[AnyStudy], Iterable[Row]]) -> list[Row]:
        """Rows of all studies."""
        return [row for study in self.studies for row in of(study)]

    def write(self, name: str, text: str) -> Path:
        """Write the report and where it was made; returns the path of the report."""
        write_csv(self.folder / "environment.csv", self.environment)
        path = self.folder / name
        write(path, text.encode())
        return path


def begin(
    kind: str,
    study: Callable[[Any, Any], AnyStudy],
    names: Sequence[str | Path | Mechanism],
    folder: str | Path,
    effort: Effort,
    quick: bool,
    bounds: Mapping[str, Cell],
    packages: Sequence[str],
) -> Begun[AnyStudy]:
    """Studies of mechanisms by the command `alfmu KIND`, and the folder for them.

    Raises AlfmuError where a name is unknown, a mechanism cannot start or matplotlib is missing, before any run.
    """
    require()
    studies = [study(name, effort) for name in names]
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    chosen = str(names[0]) if len(names) == 1 else "all"
    name, *profile = kind.split()
    command = shlex.join(["alfmu", name, chosen, *profile, *["--quick"] * quick])
    bounds = {"wall time for all mechanisms [s]": effort.total, **bounds}
    return Begun(studies, folder, tables.where(command, packages, bounds), effort.total)
