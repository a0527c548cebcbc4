"""Common parts of studies: a case, its run with errors, cost and failure, and the loop over cases."""

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
from ..fmi.drive import Fmu
from ..model.errors import AlfmuError
from ..model.files import write
from ..model.mechanism import Mechanism
from ..model.settings import FIXED
from ..runtime import Instance
from ..simulation import Unit, prepared, with_defaults
from ..view.plot import require
from . import tables
from .reference import Reference
from .tables import Cell, Row, write_csv

POSITION, REACTION = "position error [m, rad]", "reaction error [N, N.m]"
PHI, PHI_DOT = "constraint error, Phi [m, rad]", "constraint error, Phi-dot [m/s, rad/s]"
ENERGY = "energy error [J]"
QUANTITIES = (POSITION, REACTION, PHI, PHI_DOT, ENERGY)
"""Measured quantities of each run: largest values over the points where outputs are read."""

STEP, TOLERANCE = "step [s]", "tolerance"
"""Parameters that control the error of a method."""

SMALL = 1000
"""Number of operations in the equations that cost a study as much time as its fixed overhead."""

REPEATED = 0.1
"""Share of the time limit for repetitions of a run."""

AGREEING, AGREED = 3, 1.03
"""The fastest repetition counts once this many are within this factor of it, since disturbances only add time."""

ARITHMETIC = (AlfmuError, ArithmeticError, ValueError, np.linalg.LinAlgError)
"""Exceptions that end a run and count as its result."""


def methods() -> dict[str, str]:
    """Return names and descriptions of the integrators that a user can choose."""
    return dict(CHOICES["solver.method"])


def control(method: str) -> str:
    """Return the parameter that controls the error of a method: STEP or TOLERANCE."""
    return STEP if method in FIXED else TOLERANCE


def scene(equations: Equations, method: str, kernel: str) -> Configuration:
    """Return the scene of a mechanism for an integrator."""
    return prepared(with_defaults(equations, {"solver.method": method}), kernel)


def exactness(method: str, value: float) -> dict[str, float | str]:
    """Return solver variables for the step [s] of a method, or its tolerance."""
    if control(method) == STEP:
        return {"solver.step_size": value}
    known = {v.name for v in SOLVER_VARIABLES}
    return {x: value for x in ("solver.relative_tolerance", "solver.absolute_tolerance") if x in known}


Progress = Callable[[Sequence[Any]], Iterable[Any]]
"""Wraps the cases of a study to show progress (`iter` shows none)."""


@dataclass(frozen=True)
class Case:
    """A case to run."""

    values: Mapping[str, float | str]
    """Solver variables and parameters set before the start."""
    times: NDArray
    """Times at which the outputs are read [s]."""
    limit: float
    """Wall time limit of a run [s]."""
    most: int = 1
    """Largest number of repetitions within a share of the limit; fewer are made if the fastest agree."""
    compared: Sequence[str] = ()
    """Outputs to keep of a run in one call, which evaluates all outputs; empty for a run step by step."""

    def enough(self, seconds: Sequence[float]) -> bool:
        """Return whether these durations determine the time well enough."""
        if len(seconds) >= self.most or sum(seconds) > REPEATED * self.limit:
            return True
        spread = _spread(seconds)
        return spread is not None and spread <= AGREED


@dataclass
class Run:
    """Result of a case."""

    names: list[str]
    """Names of the outputs."""
    times: NDArray
    """Times that were reached (k,)."""
    values: NDArray
    """Outputs (k, outputs) at these times."""
    seconds: list[float]
    """Processor time [s] of each repetition, for steps and outputs."""
    counters: Counters | None = None
    failure: str = ""
    """Message of the error that ended the run."""
    cut: bool = False
    """Whether the time limit ended the run."""

    @property
    def complete(self) -> bool:
        return not (self.failure or self.cut)

    def __getitem__(self, name: str) -> NDArray | None:
        """Return an output over time, None if it is not computed."""
        return self.values[:, self.names.index(name)] if name in self.names else None

    def cost(self) -> Row:
        """Return time, work and failure."""
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
    """Return the ratio of the AGREEING-th fastest to the fastest run; None if there are fewer."""
    return sorted(seconds)[AGREEING - 1] / min(seconds) if len(seconds) >= AGREEING else None


def restarting(unit: Instance | Fmu) -> Callable[[], None]:
    """Return a function that restores the current state of a unit that is not initialised yet."""
    return unit.reset if isinstance(unit, Fmu) else partial(unit.restore, unit.save())


def run(unit: Unit, restart: Callable[[], None], case: Case) -> Run:
    """Run a case, with repetitions if it is short, for an accurate time."""
    return repeated(partial(_once, unit, restart, case), case)


def repeated(once: Callable[[], Run], case: Case) -> Run:
    """Return the result of a run, with the times of repetitions if it is short."""
    found = once()
    while found.complete and not case.enough(found.seconds):
        found.seconds += once().seconds
    return found


@np.errstate(all="ignore")
def _once(unit: Unit, restart: Callable[[], None], case: Case) -> Run:
    restart()
    if case.compared and isinstance(unit, Instance):
        return _in_one_call(unit, case)
    times, names = case.times.tolist(), [v.name for v in unit.outputs]
    table, reached, failure, cut = np.empty((len(times), len(names))), 0, "", False
    begin, started = time.perf_counter(), time.process_time()
    try:
        for name, value in case.values.items():
            unit.set(name, value)
        unit.initialize()
        begin, started = time.perf_counter(), time.process_time()
        table[0], reached = unit.read(), 1
        for i, t in enumerate(times[:-1], 1):
            if time.perf_counter() - begin > case.limit:
                cut = True
                break
            unit.step(times[i] - t, t)
            table[i], reached = unit.read(), i + 1
    except ARITHMETIC as error:
        failure = str(error) or type(error).__name__
    seconds = [time.process_time() - started]
    counters = getattr(unit, "counters", None) if reached else None
    return Run(names, case.times[:reached], table[:reached], seconds, counters, failure, cut)


def _in_one_call(unit: Instance, case: Case) -> Run:
    """Run a case in one call of the unit; the measured time includes the start."""
    names = [v.name for v in unit.outputs]
    for name, value in case.values.items():
        unit.set(name, value)
    started = time.process_time()
    try:
        table, ended = unit.run(case.times, (), np.empty((len(case.times), 0)), names)
    except ARITHMETIC as error:
        table, ended = np.empty((0, len(names))), error
    seconds, reached = [time.process_time() - started], len(table)
    columns = [names.index(name) for name in case.compared]
    counters = getattr(unit, "counters", None) if reached else None
    failure = "" if ended is None else str(ended) or type(ended).__name__
    return Run(list(case.compared), case.times[:reached], table[:, columns], seconds, counters, failure)


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
        """Return the quantities of a run."""
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
        """Return the largest errors of positions and of reactions; None if nothing can be compared."""
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
        at, on = (
            np.array([place[name] for name in names if name in place], int)
            for names in (self.positions, self.reactions)
        )
        return _largest(gaps[np.ix_(known, at)]), _largest(gaps[np.ix_(readable, on)])

    def size(self, times: NDArray) -> float:
        """Return the size of the mechanism: the largest output in m of the reference; 1 if there is none."""
        exact = self._exact(times)[0]
        metres = [name in self.positions and not turns for name, turns in zip(self.names, self.turning, strict=True)]
        return float(np.nanmax(np.abs(exact[:, metres]), initial=0.0)) or 1.0

    def errors_of_reference(self, times: NDArray) -> list[Row]:
        """Return the differences between the reference and other computations of the same motion."""
        rows: list[Row] = []
        for name, values in self.reference.checks(times) if self.reference else ():
            reached = ~np.isnan(values[:, 0])
            position, reaction = self.compared(self.names, times[reached], values[reached])
            rows.append({"compared with": name, POSITION: position, REACTION: reaction})
        return rows

    def _exact(self, times: NDArray) -> tuple[NDArray, NDArray]:
        """Return outputs of the reference, and the times at which reactions can be judged."""
        assert self.reference is not None
        key = times.tobytes()
        if key not in self._known:
            self._known[key] = self.reference.outputs(times), self.reference.readable(times)
        return self._known[key]

    def _energy(self, run: Run) -> float | None:
        """Return energy minus the work done on the mechanism, over the run."""
        energy = run["monitor.energy"]
        if self.conserves and energy is not None and len(energy):
            return _largest(energy - energy[0])
        return run.counters.energy_error if run.counters and np.isfinite(run.counters.energy_error) else None


def _largest(values: NDArray | None) -> float | None:
    """Return the largest magnitude, NaN if any is NaN, None for no values."""
    return None if values is None or not values.size else float(np.abs(values).max())


# Studies -----------------------------------------------------------------------------------------------------------


class Effort(Protocol):
    """Extent of a study."""

    @property
    def total(self) -> float:
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
        """Run the cases until `deadline` (of `time.perf_counter`)."""


AnyStudy = TypeVar("AnyStudy", bound=Study)


@dataclass(frozen=True)
class Begun(Generic[AnyStudy]):
    """Studies of mechanisms, ready to run."""

    studies: list[AnyStudy]
    folder: Path
    """Folder of their files."""
    environment: list[Row]
    """Machine and versions."""
    total: float
    """Wall time for all [s]."""

    def measured(self, progress: Callable[[str], Progress]) -> Iterator[AnyStudy]:
        """Yield the studies, each measured with its share of the remaining time, larger equations with more."""
        end = time.perf_counter() + self.total
        sizes = [sum(f.n_nodes() for f in study.derived.functions.values()) for study in self.studies]
        weights = [SMALL + size for size in sizes]
        for i, study in enumerate(self.studies):
            now = time.perf_counter()
            study.measure(now + (end - now) * weights[i] / sum(weights[i:]), progress(study.name))
            yield study

    def write(self, name: str, text: str) -> Path:
        """Write the report and the description of the machine; return the path of the report."""
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
    """Prepare studies of mechanisms for the command `alfmu KIND`, and their folder.

    Raises AlfmuError before any run if a name is unknown, a mechanism cannot start or matplotlib is missing.
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
