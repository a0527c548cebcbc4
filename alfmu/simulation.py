"""Run a mechanism from Python: the driver that tests, reports and the command line share."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .equations import Equations, Variable
from .equations.derivation import derive
from .equations.evaluation import DENSE, with_tangents
from .equations.interface import CHOICES, SOLVER_VARIABLES
from .equations.specialisation import specialised
from .kernel import DEFAULT, KERNELS
from .kernel.build import compiled, compiler
from .kernel.controlled import controlled
from .kernel.trace import traced, untraced
from .model.errors import AlfmuError, InputError
from .model.mechanism import Mechanism
from .model.registry import load
from .model.settings import Settings
from .runtime import Instance
from .runtime.adaptive import TANGENTS
from .runtime.oracle import Counters

__all__ = [
    "KERNELS",
    "Result",
    "Unit",
    "communication_points",
    "prepared",
    "read_inputs",
    "run",
    "simulate",
    "with_defaults",
]

STIFF = 20.0
"""Ratio of the fastest small motion to the slowest that lasts, above which a scene is stiff if the fastest does not:
stability limits explicit steps to some 4 over the one, accuracy all steps to 0.3 over the other, and an implicit step
costs two or three explicit ones."""

LASTS = 30.0
"""Time constants in a run up to which a small motion lasts; one with more is gone after a tenth of it."""

Signal = float | Callable[[float], float] | tuple[Sequence[float], Sequence[float]]
"""An input over time: a number, a function of time [s], or a table (times, values) that is interpolated linearly."""

Progress = Callable[[Sequence[float]], Iterable[float]]
"""Wraps the communication points of a run, to show how far it is (`iter` shows nothing)."""


@dataclass(frozen=True)
class Result:
    """Outputs and inputs over time, with what it took: `result["link1.angle"]` is an array like `result.time`."""

    mechanism: str
    time: NDArray
    names: list[str]
    units: dict[str, str]
    values: NDArray
    """One row per communication point, one column per name."""
    counters: Counters | None = None
    """Work and largest errors; None where the run was made by somebody else's solver."""

    def __getitem__(self, name: str) -> NDArray:
        try:
            return self.values[:, self.names.index(name)]
        except ValueError:
            raise InputError(
                f"the result of {self.mechanism} has no {name!r}; it has {', '.join(self.names)}"
            ) from None

    @classmethod
    def from_csv(cls, path: str | Path) -> Result:
        """A table with a column `time` and columns of numbers, called after its file; units are not known."""
        names, table = _table(path)
        return cls(Path(path).stem, table[:, 0], names[1:], {}, table[:, 1:])

    def to_csv(self, path: str | Path) -> None:
        """Write time and all columns with 17 significant digits; the first row holds the names."""
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time", *self.names])
            for t, row in zip(self.time, self.values, strict=True):
                writer.writerow([f"{x:.17g}" for x in (t, *row)])


class Unit(Protocol):
    """What the driver needs of a mechanism, whether it is an `Instance` or an FMU."""

    name: str
    outputs: Sequence[Variable]
    input_variables: Sequence[Variable]

    def set(self, name: str, value: float | str) -> None: ...
    def initialize(self) -> None: ...
    def step(self, communication_step: float, time: float) -> None: ...
    def read(self) -> NDArray: ...
    def read_inputs(self) -> NDArray: ...


def simulate(
    mechanism: str | Path | Mechanism | Equations,
    stop_time: float | None = None,
    step: float | None = None,
    *,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    settings: Settings | None = None,
    outputs: Sequence[str] | None = None,
    freeze: Sequence[str] | None = None,
    kernel: str = DEFAULT,
    progress: Progress = iter,
) -> Result:
    """Run a mechanism from 0 to `stop_time` [s] with communication steps of `step` [s].

    `parameters` sets parameters, start values and solver variables by name; `inputs` are held over each communication
    step at their value at its beginning. Defaults are the mechanism's own. Only outputs that match `outputs` (names, or
    patterns such as `link*.angle`) are computed, None for all; parameters in `freeze` are folded into the equations.
    `kernel` is one of `alfmu.kernel.KERNELS`. Raises AlfmuError where a name, a value or the mechanism is at fault.
    """
    equations = mechanism if isinstance(mechanism, Equations) else derive(load(mechanism))
    if freeze is not None or "solver.method" in (parameters or {}):
        equations, parameters = with_defaults(equations, parameters or {}), {}
    instance = Instance(prepared(specialised(equations, outputs, freeze), kernel), settings)
    stop_time = equations.stop_time if stop_time is None else stop_time
    step = equations.interval if step is None else step
    return run(instance, stop_time, step, inputs, parameters, progress)


def run(
    unit: Unit,
    stop_time: float,
    step: float,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    progress: Progress = iter,
) -> Result:
    """Drive a unit that is not yet initialised as `simulate` does."""
    times = communication_points(unit.name, stop_time, step)
    for name, value in (parameters or {}).items():
        unit.set(name, value)
    signals = {name: _signal(signal) for name, signal in (inputs or {}).items()}
    variables = [*unit.outputs, *unit.input_variables]
    table = np.empty((len(times), len(variables)))

    switches = {v.name for v in unit.input_variables if v.type == "Boolean"}

    def apply(t: float) -> None:
        for name, signal in signals.items():
            value = signal(t)
            # A table between 0 and 1 switches half-way.
            unit.set(name, value >= 0.5 if name in switches and 0 <= value <= 1 else value)

    apply(0.0)
    unit.initialize()
    table[0] = np.concatenate([unit.read(), unit.read_inputs()])
    for i, t in enumerate(progress(times[:-1])):
        unit.step(times[i + 1] - t, t)
        apply(times[i + 1])
        table[i + 1] = np.concatenate([unit.read(), unit.read_inputs()])
    names = [v.name for v in variables]
    return Result(unit.name, times, names, {v.name: v.unit for v in variables}, table, getattr(unit, "counters", None))


def communication_points(name: str, stop_time: float, step: float) -> NDArray:
    """0, step, 2 step, ... and stop_time itself."""
    if not (math.isfinite(step) and step > 0):
        raise InputError(f"{name}: the step is {step} s; it must be a finite number above zero")
    if not (math.isfinite(stop_time) and stop_time > 0):
        raise InputError(f"{name}: the stop time is {stop_time} s; it must be a finite number above zero")
    whole = math.floor(stop_time / step * (1 + 1e-12))
    times = np.arange(whole + 1) * step
    if stop_time - times[-1] > 1e-9 * step:
        return np.append(times, stop_time)
    return times


def read_inputs(path: str | Path) -> dict[str, Signal]:
    """Inputs from a CSV file: a column `time` [s], and a column for each input."""
    names, table = _table(path)
    return {name: (table[:, 0], table[:, i]) for i, name in enumerate(names) if i}


def _table(path: str | Path) -> tuple[list[str], NDArray]:
    """Names and numbers of a CSV file whose first column is time."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row]
        names, table = [name.strip() for name in rows[0]], np.array(rows[1:], float)
    except (OSError, IndexError, ValueError) as error:
        raise InputError(f"{path} is not a table of numbers under a row of names ({error})") from None
    if table.ndim != 2 or table.shape[1] != len(names) or names[0] != "time" or not np.isfinite(table[:, 0]).all():
        raise InputError(f"{path}: the first column must be time, and every row as long as the row of names")
    if (np.diff(table[:, 0]) < 0).any():
        raise InputError(f"{path}: time must not go back")
    return names, table


def _signal(signal: Signal) -> Callable[[float], float]:
    if callable(signal):
        return signal
    if isinstance(signal, tuple):
        times, values = signal
        return lambda t: float(np.interp(t, times, values))
    return lambda t: signal


def prepared(equations: Equations, kernel: str = DEFAULT) -> Equations:
    """The equations with what the chosen kernel runs; InputError where there is no such kernel."""
    if kernel not in KERNELS:
        raise InputError(f"{equations.name}: there is no kernel {kernel!r}; use one of {', '.join(KERNELS)}")
    equations, probe = _with_method(equations), None
    if not equations.kernel or equations.shared is None:
        probe = _started(equations)
        equations = _surveyed(equations, probe)
    if kernel == "oracle":
        return replace(untraced(equations), library=None)
    e = equations if equations.kernel else _traced(equations, probe)
    if kernel == "compiled" or (kernel == "auto" and compiler()):
        return e if e.library else compiled(e)
    return replace(e, library=None) if e.library else e


def _started(equations: Equations) -> Instance | None:
    """An instance at the start, None where the defaults have none, so that nothing is known of its freedoms."""
    probe = Instance(equations)
    try:
        probe.initialize()
    except AlfmuError:
        return None
    return probe


def _with_method(equations: Equations) -> Equations:
    """The same equations with what their method of integration needs, and `auto` decided."""
    chosen, reason = equations.solver.get("method", "rk4"), equations.reason
    if chosen == "auto":
        chosen, reason = _chosen(equations)
    if chosen in TANGENTS and equations.n > DENSE:
        raise InputError(f"{equations.name}: solver.method {chosen} takes up to {DENSE} coordinates; use explicit")
    e = with_tangents(equations) if chosen in TANGENTS else equations
    same = reason == equations.reason
    return e if same else replace(e, solver={**e.solver, "method": chosen}, reason=reason)


def _chosen(equations: Equations) -> tuple[str, str]:
    """The method that `auto` stands for, and why: by the eigenvalues of small motions at the start."""
    if equations.n > DENSE:
        return "explicit", f"explicit: more than {DENSE} coordinates"
    solver = {**equations.solver, "method": "stiff"}
    probe = _started(replace(with_tangents(equations), kernel={}, solver=solver))
    if probe is None:
        return "explicit", "explicit: the defaults have no start"
    values = probe.spectrum()
    fastest = values[np.argmax(np.abs(values))]
    lasting = values[-values.real * equations.stop_time < LASTS]
    slow = max(2 * math.pi / equations.stop_time, min((abs(x) for x in lasting if abs(x) > 1e-3), default=0.0))
    seen = f"the fastest small motion at the start has {abs(fastest):.3g} 1/s, the slowest that lasts {slow:.3g}"
    if abs(fastest) > STIFF * slow and fastest not in lasting:
        return "stiff", f"stiff: {seen}, and it decays"
    return "explicit", f"explicit: {seen}"


def _surveyed(equations: Equations, probe: Instance | None) -> Equations:
    """The same equations with what redundant constraints share said of each output that it concerns."""
    if equations.shared is not None or probe is None:
        return equations
    shared = probe.shared()
    note = "; not unique: of all that redundant constraints allow, that of least norm"
    outputs = [replace(v, description=v.description + note * (v.name in shared)) for v in equations.outputs]
    oracle = probe.oracle
    uneven = len(set(oracle.units)) > 1
    return replace(equations, outputs=outputs, shared=shared, brakes=oracle.brakes, uneven=uneven)


def _traced(equations: Equations, probe: Instance | None) -> Equations:
    if probe is None:
        return traced(equations, None, controlled=controlled)
    mobility = probe.mobility()
    if mobility.freedom_here > mobility.freedom:
        return traced(equations, mobility, controlled=controlled)  # a singular start says nothing of other positions
    needed = probe.oracle.iterations_needed(probe.q, probe.v, probe.inputs, 0.0)
    return traced(equations, mobility, needed, controlled)


def with_defaults(equations: Equations, values: Mapping[str, float | str]) -> Equations:
    """The same equations with other defaults for parameters, start values, inputs and solver variables.

    Raises InputError where a name is unknown or a value out of bounds.
    """
    probe = Instance(equations)
    for name, value in values.items():
        probe.set(name, value)
    changed = {
        field: [replace(v, start=float(values.get(v.name, v.start))) for v in getattr(equations, field)]
        for field in ("parameters", "starts", "start_rates", "compliances", "inputs")
    }
    solver = {v.name for v in SOLVER_VARIABLES} | set(CHOICES)
    changed["switches"] = [replace(s, start=bool(values.get(s.name, s.start))) for s in equations.switches]
    own = {name.removeprefix("solver."): probe.get(name) for name in values if name in solver}
    return replace(equations, **changed, solver={**equations.solver, **own})
