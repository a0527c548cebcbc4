"""Runs with derivatives: `derivatives` of columns by tangents, `gradient` of a function of a run by adjoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..analysis.start import prepare
from ..equations import Equations
from ..model.errors import InputError
from ..model.mechanism import Mechanism
from ..model.words import there_is
from ..runtime.batch import Batch
from ..runtime.instance import Instance, tell_of_jumps
from ..runtime.sweeps import Sweeps
from ..simulation import Progress, by_name, communication_points, names_in, oracle, table_of, values_of
from ..simulation.result import Result, Signal
from .functions import Expression, Final, Function

if TYPE_CHECKING:
    from ..fmi.recipe import Recipe


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Columns of a run and their derivatives: `found["link1.angle"]` is an array (k, by), `found["link1.angle", "m2"]`
    one of its columns (k,)."""

    result: Result
    """The run."""
    by: tuple[str, ...]
    values: NDArray[np.float64]
    """Derivatives (k, columns of the result, by)."""

    def __getitem__(self, name: str | tuple[str, str]) -> NDArray[np.float64]:
        column, by = (name, None) if isinstance(name, str) else name
        if column not in self.result.names:
            raise InputError(f"there is no column {column!r}; {there_is(column, self.result.names)}")
        found = self.values[:, self.result.names.index(column)]
        if by is None:
            return found
        if by not in self.by:
            raise InputError(f"there is no derivative by {by!r}; {there_is(by, self.by)}")
        return found[:, self.by.index(by)]

    def __repr__(self) -> str:
        rows, columns = self.values.shape[:2]
        return f"Derivatives({self.result.mechanism}: {rows} rows, {columns} columns by {', '.join(self.by)})"


@dataclass(frozen=True, eq=False)
class Gradient:
    """A function of a run and its derivatives: `found["m2"]`."""

    value: float
    by: Mapping[str, float]
    """Derivatives by parameters and start values, and by a constant change of an input."""
    inputs: Mapping[str, NDArray[np.float64]]
    """Derivatives by each input at each communication point (k,); an input is constant during a step."""
    result: Result
    """The run, with the columns of the function."""

    def __getitem__(self, name: str) -> float:
        if name not in self.by:
            raise InputError(f"there is no derivative by {name!r}; {there_is(name, list(self.by))}")
        return self.by[name]


class Runs:
    """Runs of one mechanism with common communication points and inputs, and different numbers."""

    unit: Instance
    facts: Mapping[str, Any]
    declared: Mechanism | None
    by: tuple[str, ...]
    names: list[str]
    inputs: list[str]
    times: NDArray[np.float64]
    table: NDArray[np.float64]

    def __init__(
        self,
        mechanism: Any,
        by: Sequence[str],
        stop_time: float | None,
        communication_step: float | None,
        inputs: Mapping[str, Signal] | None,
        parameters: Mapping[str, float | str] | None,
        outputs: Sequence[str] | None = None,
        times: NDArray[np.float64] | None = None,
        begin: bool = True,
    ):
        if isinstance(mechanism, str | Path) and str(mechanism).endswith(".fmu"):
            raise InputError(f"{mechanism}: runs of an FMU have no derivatives; give the mechanism that it was made of")
        by = names_in(mechanism, "numbers to derive by", by)
        found = prepare(
            mechanism, by_name(mechanism, "parameters", parameters), inputs, outputs=outputs, kept=by, jacobian=False
        )
        if isinstance(found.unit, oracle.Instance):
            raise InputError(f"{found.unit.name}: the kernel oracle has no derivatives; use another one")
        self.unit, self.facts, self.declared = found.unit, found.facts, found.declared
        for name, value in found.left.items():
            self.unit.set(name, value)
        self.by = tuple(by)
        self.names = [v.name for v in self.unit.parameters]
        own = {v.name for v in self.unit.input_variables if v.type != "Boolean"}
        self._check(own)
        given: dict[str, Signal] = by_name(self.unit, "inputs", inputs)
        for name in self.by:
            if name in own and name not in given:
                given[name] = self.unit.get(name)
        self.inputs = list(given)
        stop = found.stop_time if stop_time is None else stop_time
        step = found.interval if communication_step is None else communication_step
        self.times = communication_points(self.unit.name, stop, step) if times is None else times
        self.table = table_of(self.inputs, values_of(self.unit, given), self.times)
        if begin:
            self.begin()

    def begin(self) -> None:
        """Make the first start, which issues warnings, and retraces the scene if redundant constraints would brake."""
        self.unit.time = float(self.times[0])
        self.unit.initialize_with(dict(zip(self.inputs, self.table[0], strict=True)))
        tell_of_jumps(self.unit.equations)

    def _check(self, inputs: set[str]) -> None:
        e = self.unit.equations
        count, starts = len(e.parameters), 2 * len(e.starts)
        states = count + starts + len(e.compliances)
        known = {*self.names[: count + starts], *self.names[states : states + len(e.states)], *inputs}
        for k, name in enumerate(self.by):
            if name in self.by[:k]:
                raise InputError(f"{e.name}: {name} is named twice in by; leave one out")
            if name not in known:
                raise InputError(
                    f"{e.name} has no parameter, start value or input {name!r} to differentiate by; "
                    f"{there_is(name, sorted(known))}"
                )

    def columns(self, names: Sequence[str] | None = None) -> list[str]:
        """Return all outputs and inputs, or those of some names."""
        known = [v.name for v in (*self.unit.outputs, *self.unit.input_variables)]
        names = None if names is None else names_in(self.unit, "outputs", names)
        for name in names or ():
            if name not in known:
                raise InputError(f"{self.unit.name} has no output or input {name!r}; {there_is(name, known)}")
        return list(names) if names is not None else known

    def set(self, values: Sequence[float] | NDArray[np.float64]) -> None:
        """Set the numbers of the next run."""
        self.unit._unit.run_on(False)
        for name, value in zip(self.by, values, strict=True):
            self.unit.set(name, float(value))

    def side_by_side(self, values: NDArray[np.float64], wanted: Sequence[str]) -> NDArray[np.float64]:
        """Return outputs (runs, k, wanted) of runs with these numbers (runs, by), which are made in the vector lanes of
        the processor; NaN after a run fails."""
        batch = Batch(self.unit, len(values))
        found = np.full((len(values), len(self.times), len(wanted)), np.nan)
        batch.time = float(self.times[0])
        batch.set_many(self.by, values)
        batch.set_many(self.inputs, self.table[0])
        going = ~batch.initialize()
        for k, row in enumerate(self.table):
            if k and going.any():
                going &= ~batch.step(self.times[k] - self.times[k - 1], going)
                batch.set_many(self.inputs, row)
            found[going, k] = batch.get(*wanted).reshape(len(values), -1)[going]
        return found

    def sweeps(self, wanted: Sequence[str], directions: int, progress: Callable[[int], bool] | None) -> Sweeps:
        return Sweeps(self.unit, self.times, self.inputs, self.table, wanted, progress, directions)

    def tangents(
        self, wanted: Sequence[str], progress: Callable[[int], bool] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return values (k, wanted) and their derivatives (k, wanted, by)."""
        sweeps = self.sweeps(wanted, len(self.by), progress)
        seeds = np.zeros((len(self.names), len(self.by)))
        of_inputs = np.zeros((*self.table.shape, len(self.by)))
        for k, name in enumerate(self.by):
            if name in self.inputs:
                of_inputs[:, self.inputs.index(name), k] = 1.0
            else:
                seeds[self.names.index(name), k] = 1.0
        found = sweeps.tangents(seeds, of_inputs)
        self.checked(found)
        return sweeps.values, found

    def checked(self, found: NDArray[np.float64]) -> None:
        if not np.isfinite(found).all():
            raise InputError(
                f"{self.unit.name}: a derivative is not finite, as at the root of zero or where a length vanishes; "
                "change the start values or parameters a little"
            )

    def result(self, names: Sequence[str], values: NDArray[np.float64]) -> Result:
        units = {v.name: v.unit for v in (*self.unit.outputs, *self.unit.input_variables)}
        units = {name: units[name] for name in names}
        return Result(
            self.unit.name,
            self.times,
            tuple(names),
            units,
            values,
            self.unit.counters,
            self.facts,
            self.declared,
        )


def shown(progress: Progress, times: NDArray[np.float64]) -> Callable[[int], bool]:
    """Return a function that advances `progress` to a number of finished communication points."""
    points, passed = iter(progress(times[:-1])), 0

    def show(done: int) -> bool:
        nonlocal passed
        for _ in range(done - passed):
            next(points, None)
        passed = max(done, passed)
        return True

    return show


def derivatives(
    mechanism: str | Path | Mechanism | Equations | Recipe,
    by: Sequence[str],
    stop_time: float | None = None,
    communication_step: float | None = None,
    *,
    outputs: Sequence[str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    progress: Progress = iter,
) -> Derivatives:
    """Run a mechanism as `simulate` does, with the derivatives of outputs by numbers.

    `by` names parameters, start values and inputs; the derivative by an input is that by a constant change of it.
    `outputs` names the outputs and inputs to differentiate, None for all. Derivatives are those of the computed steps,
    including projections and iterations, at fixed step sizes, tiers and ranks. The cost is proportional to the number
    of derivatives; for one number of a run by many use `gradient`.

    Raises InputError if a name is invalid, and if there are no derivatives, as with dry friction. Warns of forces that
    may jump.
    """
    runs = Runs(mechanism, by, stop_time, communication_step, inputs, parameters)
    names = runs.columns(outputs)
    values, found = runs.tangents(names, shown(progress, runs.times))
    return Derivatives(runs.result(names, values), runs.by, found)


def gradient(
    mechanism: str | Path | Mechanism | Equations | Recipe,
    of: Function | Expression,
    by: Sequence[str],
    stop_time: float | None = None,
    communication_step: float | None = None,
    *,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    progress: Progress = iter,
) -> Gradient:
    """Return a function of a run and its derivatives by many numbers, in the time of a few runs.

    `of` is a function of `alfmu.gradients` (`Final`, `Integral`, `Maximum`, `TimeOfMaximum`, `Columns`); an expression
    alone stands for its final value. `by` names parameters, start values and inputs; derivatives by each input at each
    communication point are included. Adjoints run backwards; if the run is too long to be stored, parts of it are
    repeated.

    Raises and warns as `derivatives` does.
    """
    function = of if isinstance(of, Function) else Final(of)
    runs = Runs(mechanism, by, stop_time, communication_step, inputs, parameters)
    names = runs.columns(function.names)
    sweeps = runs.sweeps(names, 0, shown(progress, runs.times))
    sweeps.record()
    value, weights = function.weighed(runs.times, sweeps.values)
    result = runs.result(names, sweeps.values)
    of_parameters, of_inputs = sweeps.adjoints(weights)
    runs.checked(of_parameters)
    runs.checked(of_inputs)
    at_points = dict(zip(runs.inputs, of_inputs.T, strict=True))
    found = {
        name: float(at_points[name].sum() if name in at_points else of_parameters[runs.names.index(name)])
        for name in runs.by
    }
    return Gradient(value, found, at_points, result)
