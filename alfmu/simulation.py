"""Run a mechanism from Python: the driver that tests, reports and the command line share."""

from __future__ import annotations

import codecs
import csv
import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from . import oracle
from .equations import Equations, Variable
from .equations.derivation import derive
from .equations.interface import Counters
from .equations.specialisation import specialised
from .files import atomic
from .kernel import DEFAULT, KERNELS
from .model.errors import AlfmuError, InputError
from .model.mechanism import Mechanism
from .model.registry import load
from .model.settings import Settings
from .model.words import there_is
from .runtime import Instance
from .runtime.prepare import prepared, with_defaults

__all__ = [
    "KERNELS",
    "Result",
    "Unit",
    "communication_points",
    "instance",
    "prepared",
    "read_inputs",
    "run",
    "simulate",
    "with_defaults",
]

Signal = float | Callable[[float], float] | tuple[Sequence[float], Sequence[float]]
"""An input over time: a number, a function of time [s], or a table (times, values) that is interpolated linearly."""

MOST = 500_000_000
"""Numbers in a result, at most: 4 GB."""

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
            raise InputError(f"the result of {self.mechanism} has no {name!r}; {there_is(name, self.names)}") from None

    @classmethod
    def from_csv(cls, path: str | Path) -> Result:
        """A table with a column `time` and columns of numbers, called after its file; units are not known."""
        names, table = _table(path)
        return cls(Path(path).stem, table[:, 0], names[1:], {}, table[:, 1:])

    def to_csv(self, path: str | Path) -> None:
        """Write time and all columns with 17 significant digits; the first row holds the names. Raises WriteError."""
        with atomic(path) as file:
            writer = csv.writer(codecs.getwriter("utf-8")(file))
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
    held_rows: bool = False,
    progress: Progress = iter,
) -> Result:
    """Run a mechanism from 0 to `stop_time` [s] with communication steps of `step` [s].

    `parameters` sets parameters, start values and solver variables by name; `inputs` are held over each communication
    step at their value at its beginning. Defaults are the mechanism's own. Only outputs that match `outputs` (names, or
    patterns such as `link*.angle`) are computed, None for all; parameters in `freeze` are folded into the equations.
    `kernel` is one of `alfmu.kernel.KERNELS`.

    Outputs of a row that depend on inputs at once, such as accelerations and reactions, are those with the inputs that
    are set at its communication point; with `held_rows` those with the inputs of the step that ends there, as importers
    record them (fmpy, fmusim). Motions are the same.

    Raises AlfmuError where a name, a value or the mechanism is at fault. Where that, or a KeyboardInterrupt, ends a run
    that has begun, the exception's `result` has the rows up to then.
    """
    equations = mechanism if isinstance(mechanism, Equations) else derive(load(mechanism))
    if freeze is not None or "solver.method" in (parameters or {}):
        equations, parameters = with_defaults(equations, parameters or {}), {}
    unit = instance(specialised(equations, outputs, freeze), kernel, settings)
    stop_time = equations.stop_time if stop_time is None else stop_time
    step = equations.interval if step is None else step
    return run(unit, stop_time, step, inputs, parameters, progress, held_rows)


def instance(equations: Equations, kernel: str, settings: Settings | None = None) -> Instance:
    """An instance that is not yet initialised, run by a kernel."""
    return (oracle.Instance if kernel == "oracle" else Instance)(prepared(equations, kernel), settings)


def run(
    unit: Unit,
    stop_time: float,
    step: float,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    progress: Progress = iter,
    held_rows: bool = False,
) -> Result:
    """Drive a unit that is not yet initialised as `simulate` does."""
    for name, value in (parameters or {}).items():
        unit.set(name, value)
    variables = [*unit.outputs, *unit.input_variables]
    times = communication_points(unit.name, stop_time, step, 1 + len(variables))
    signals = {name: _signal(signal) for name, signal in (inputs or {}).items()}
    names, units = [v.name for v in variables], {v.name: v.unit for v in variables}
    switches = {v.name for v in unit.input_variables if v.type == "Boolean"}

    def at(name: str, t: float) -> float:
        value = signals[name](t)
        # A table between 0 and 1 switches half-way.
        return value >= 0.5 if name in switches and 0 <= value <= 1 else value

    if isinstance(unit, Instance) and unit.run and not held_rows:
        values, ended = _in_one_call(unit, times, list(signals), at, names, progress)
    else:
        values, ended = _step_by_step(unit, times, list(signals), at, progress, held_rows)
    result = Result(unit.name, times[: len(values)], names, units, values, getattr(unit, "counters", None))
    if ended is not None:
        ended.result = result if len(values) else None
        raise ended
    return result


def _in_one_call(
    unit: Instance,
    times: NDArray,
    inputs: list[str],
    at: Callable[[str, float], float],
    names: list[str],
    progress: Progress,
) -> tuple[NDArray, BaseException | None]:
    """The values of a run that is one call of the runtime, and why it ended early."""
    for name in inputs:
        unit.set(name, at(name, times[0]))
    table = np.array([[at(name, t) for name in inputs] for t in times], float).reshape(len(times), len(inputs))
    shown = iter(progress(times[:-1]))
    passed = 0

    def show(done: int) -> bool:
        nonlocal passed
        for _ in range(done - passed):
            next(shown, None)
        passed = done
        if getattr(progress, "ended", bool)():  # within a long communication step
            raise KeyboardInterrupt
        return True

    values, ended = unit.run(times, inputs, table, names, show)
    try:
        for _ in shown if ended is None else ():
            pass
    except KeyboardInterrupt as late:
        ended = late
    return values, ended


def _step_by_step(
    unit: Unit,
    times: NDArray,
    inputs: list[str],
    at: Callable[[str, float], float],
    progress: Progress,
    held: bool,
) -> tuple[NDArray, BaseException | None]:
    """The values of a run of a unit that makes one communication step after the other, and why it ended early."""
    table = np.empty((len(times), len(unit.outputs) + len(unit.input_variables)))

    def apply(t: float) -> None:
        for name in inputs:
            unit.set(name, at(name, t))

    apply(times[0])
    unit.initialize()
    table[0] = np.concatenate([unit.read(), unit.read_inputs()])
    made = 1
    try:
        for i, t in enumerate(progress(times[:-1])):
            unit.step(times[i + 1] - t, t)
            if not held:
                apply(times[i + 1])
            table[i + 1] = np.concatenate([unit.read(), unit.read_inputs()])
            made = i + 2
            if held:
                apply(times[i + 1])
    except (AlfmuError, KeyboardInterrupt) as ended:
        return table[:made], ended
    return table, None


def communication_points(name: str, stop_time: float, step: float, columns: int = 1) -> NDArray:
    """0, step, 2 step, ... and stop_time itself; InputError where a result of so many columns would be too large."""
    if not (math.isfinite(step) and step > 0):
        raise InputError(f"{name}: the step is {step} s; it must be a finite number above zero")
    if not (math.isfinite(stop_time) and stop_time > 0):
        raise InputError(f"{name}: the stop time is {stop_time} s; it must be a finite number above zero")
    if (points := stop_time / step) * columns > MOST:
        raise InputError(
            f"{name}: {points:.2g} communication points of {step:g} s up to {stop_time:g} s, with {columns} numbers at "
            f"each, are more than the {MOST:.0e} numbers that a result may hold; take a longer step, an earlier stop "
            "time or fewer outputs"
        )
    times = np.arange(math.floor(points * (1 + 1e-12)) + 1) * step
    if stop_time - times[-1] > 1e-9 * step:
        return np.append(times, stop_time)
    return times


def read_inputs(path: str | Path) -> dict[str, Signal]:
    """Inputs from a CSV file: a column `time` [s], and a column of finite numbers for each input."""
    names, table = _table(path)
    for row, column in np.argwhere(~np.isfinite(table))[:1]:
        raise InputError(f"{path}: {names[column]} is {table[row, column]} at {table[row, 0]:g} s; inputs are finite")
    return {name: (table[:, 0], table[:, i]) for i, name in enumerate(names) if i}


def _table(path: str | Path) -> tuple[list[str], NDArray]:
    """Names and numbers of a CSV file whose first column is time; InputError, with the line, where it is none."""
    line, numbers = 0, array("d")
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, strict=True)
            rows = (row for row in reader if row)
            names = [name.strip() for name in next(rows, [])]
            _check_names(path, names)
            for row in rows:
                line = reader.line_num
                if len(row) != len(names):
                    raise InputError(f"{path}, line {line}: {len(row)} columns under {len(names)} names")
                numbers.extend(map(float, row))
                if not -math.inf < numbers[-len(names)] < math.inf:
                    raise InputError(f"{path}, line {line}: time is {row[0]}; it must be a finite number")
                if len(numbers) > len(names) and numbers[-len(names)] < numbers[-2 * len(names)]:
                    raise InputError(f"{path}, line {line}: time goes back to {row[0]}; sort the rows by time")
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a table of numbers: it is no text in UTF-8 ({error.reason})") from None
    except csv.Error as error:
        quoted = "end of data" in str(error)
        why = "a quotation mark is opened and not closed" if quoted else f"it has a {error}"
        raise InputError(f"{path} is not a table of numbers: {why}, at line {reader.line_num} or before") from None
    except ValueError:
        wrong = next(cell for cell in row if not _number(cell))
        raise InputError(f"{path} is not a table of numbers: line {line} has {wrong[:40]!r}") from None
    if not numbers:
        raise InputError(f"{path} has no rows of numbers under its names")
    return names, np.array(numbers).reshape(-1, len(names))


def _check_names(path: str | Path, names: list[str]) -> None:
    """InputError where a row of names cannot stand over a table."""
    if names[:1] != ["time"]:
        raise InputError(
            f"{path} is not a table of numbers under names: its first column is {(names or [''])[0][:40]!r}; it must "
            "be 'time', with commas between the columns"
        )
    if "" in names:
        raise InputError(f"{path}: column {1 + names.index('')} has no name")
    if twice := next((name for name, count in Counter(names).items() if count > 1), None):
        raise InputError(f"{path}: two columns are called {twice!r}; leave one out")


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _signal(signal: Signal) -> Callable[[float], float]:
    if callable(signal):
        return signal
    if isinstance(signal, tuple):
        times, values = signal
        return lambda t: float(np.interp(t, times, values))
    return lambda t: signal
