"""Fit parameters and start values to measured columns, by SciPy's least squares with the derivatives of the run."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from ..analysis.loops import evenly
from ..equations import Equations
from ..model.errors import AlfmuError, InputError, collected
from ..model.mechanism import Mechanism
from ..model.words import counted, shown, there_is
from ..simulation import by_name, names_in
from ..simulation.result import Result, Signal
from .run import Runs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..fmi.recipe import Recipe

_LOGGER = logging.getLogger("alfmu")

_UNSEEN = 1e-7
"""Singular value of the derivatives over the largest [1], below which the data do not determine a combination of
numbers; the relative error of derivatives is some 1e-9."""

_STILL = 1e-9
"""Range of a column over the largest value of its unit, below which it is constant up to round-off [1] and weighted by
that value."""

_WORSE = 1e3
"""Residuals assigned to a run that fails, over those of the first guess [1], so that the step is rejected."""

_NEAREST = 4
"""Number of other first guesses from which the search begins [1]."""

_BLOCK = 1024
"""Largest number of first guesses whose runs are in memory together [1]."""

_TOLERANCE = 1e-12
"""Relative change of the sum of squares, and of the numbers, at which the fit ends [1]."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit, the numbers with which a run is closest to measurements: `found["m2"]`."""

    values: Mapping[str, float]
    errors: Mapping[str, float]
    """Standard deviation of each number, from the residuals; infinite if the data do not determine it, NaN at a bound,
    or if there are no more measurements than numbers."""
    units: Mapping[str, str]
    covariance: NDArray[np.float64]
    """Covariance (numbers, numbers) in the order of `values`, with numbers at their bounds fixed."""
    bounds: Mapping[str, tuple[float, float]]
    noise: Mapping[str, float]
    """Root mean square of the residuals of each measured column."""
    result: Result
    """The run with these numbers, at the times of the measurements."""
    data: Result
    """The measurements."""
    runs: int
    """Number of runs, including those with derivatives."""
    said: str
    """Reason for the end of the fit."""

    def __getitem__(self, name: str) -> float:
        if name not in self.values:
            raise InputError(f"{name!r} was not fitted; {there_is(name, list(self.values))}")
        return self.values[name]

    @property
    def residuals(self) -> dict[str, NDArray[np.float64]]:
        """Measurements minus the run, by column; NaN without a measurement."""
        return {name: self.data[name] - self.result[name] for name in self.noise}

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation (numbers, numbers): covariances over the standard deviations of both."""
        sizes = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(sizes, sizes)

    def __str__(self) -> str:
        wide = max(map(len, self.values))
        lines = []
        for name, value in self.values.items():
            error = self.errors[name]
            known = f"+/- {error:.2g}" if math.isfinite(error) else "not determined by the data"
            if math.isnan(error):
                there = np.isclose(value, self.bounds[name], _TOLERANCE, _TOLERANCE).any()
                known = "at its bound" if there else "error unknown: no more measurements than numbers"
            lines.append(f"{name:{wide}}  {value:.8g} {self.units[name]}  {known}")
        lines += [f"{name}: differs by {size:.3g} {self.result.units[name]}" for name, size in self.noise.items()]
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Plot measured points, the run through them, and residuals, by column."""
        from ..view.fitted import figure

        return figure(self.data, self.result, list(self.noise))


def fit(
    mechanism: str | Path | Mechanism | Equations | Recipe,
    data: str | Path | Result,
    vary: Sequence[str] | Mapping[str, float],
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    columns: Sequence[str] | None = None,
    deviations: Mapping[str, float] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    starts: int = 0,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Find parameters and start values with which a run is closest to measurements, by least squares.

    `data` is a table (CSV or a `Result`) with a column `time` [s], which begins at the start of the run; columns with
    names of outputs are measurements (NaN for missing ones), those with names of inputs drive the run. `columns` are
    the measurements to use, None for all but monitors. `vary` names parameters and start values, or maps them to first
    guesses. `bounds` overrides bounds of the mechanism. Residuals of a column are divided by its standard deviation in
    `deviations`, by default by the range of the column, or if it is constant by the largest value in its unit.
    `starts` is a number of other first guesses, evenly distributed within the bounds: one run is made with each, and
    the search begins at the nearest of them, too, as a search from one guess may end in a local minimum; guesses at
    which a run or its derivatives fail are left out. `progress` is called with the number of the run and the root mean
    square of its weighted residuals.

    The covariance follows from the residuals, so it describes errors of measurement, not of the model. Combinations of
    numbers that the data do not determine cause a warning. Raises InputError if a name or number is invalid, if units
    of the data differ from those of the mechanism, and if there are fewer measurements than numbers.
    """
    by = names_in(mechanism, "numbers to vary", vary)
    wanted = None if columns is None else names_in(mechanism, "columns", columns)
    if not isinstance(data, str | Path | Result):
        raise InputError(f"the data are {shown(data)}; give a Result, or the path of a CSV file")
    table = data if isinstance(data, Result) else Result.from_csv(data)
    guesses = dict(vary) if isinstance(vary, Mapping) else {}
    given = {**by_name(mechanism, "parameters", parameters), **guesses}
    runs = _runs(mechanism, by, table, inputs, given)
    measured = _measured(runs, table, wanted)
    seen = np.column_stack([table[name] for name in measured])
    known = np.isfinite(seen)
    sizes = _sizes(runs, measured, seen, known, by_name(mechanism, "deviations", deviations))
    if (count := int(known.sum())) < len(runs.by):
        has, wants = counted(count, "measurement"), counted(len(runs.by), "number")
        raise InputError(f"{has} cannot determine {wants}; vary fewer, or measure more")
    low, high = _bounds(runs, by_name(mechanism, "bounds", bounds))
    scale = [abs(float(runs.unit.get(name))) or 1.0 for name in runs.by]  # present values, or 1
    first = np.array([runs.unit.get(name) for name in runs.by], float)
    if (outside := (first < low) | (first > high)).any():
        k = int(np.argmax(outside))
        raise InputError(f"{runs.by[k]} begins at {first[k]:g}, outside its bounds [{low[k]:g}, {high[k]:g}]")
    problem = _Problem(runs, measured, seen, known, sizes, progress)
    ended = problem.best([first, *problem.others(low, high, starts)], low, high, scale)
    covariance = _covariance(runs, problem, ended.x, np.array(scale), ended.active_mask == 0)
    result = problem.result(ended.x)
    left = np.where(known, seen - np.column_stack([result[name] for name in measured]), 0.0)
    units = {v.name: v.unit for v in runs.unit.parameters}
    return Fit(
        values=dict(zip(runs.by, ended.x.tolist(), strict=True)),
        errors=dict(zip(runs.by, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        units={name: units[name] for name in runs.by},
        covariance=covariance,
        bounds={name: (float(a), float(b)) for name, a, b in zip(runs.by, low, high, strict=True)},
        noise=dict(zip(measured, np.sqrt((left**2).sum(axis=0) / known.sum(axis=0)).tolist(), strict=True)),
        result=result,
        data=table,
        runs=problem.made,
        said=str(ended.message),
    )


def _runs(
    mechanism: Any,
    vary: list[str],
    table: Result,
    inputs: Mapping[str, Signal] | None,
    parameters: Mapping[str, float | str],
) -> Runs:
    """Return runs at the times of a table, with its inputs, before the first start."""
    if not vary:
        raise InputError("no numbers to vary are given; name parameters or start values")
    times = np.asarray(table.time)
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise InputError(f"{table.mechanism}: the times of measurements must grow from row to row")
    runs = Runs(mechanism, vary, None, None, inputs, parameters, times=times, begin=False)
    drivers = [v.name for v in runs.unit.input_variables if v.name in table.names]
    for name in drivers:
        if not np.isfinite(table[name]).all():
            raise InputError(f"the input {name} is not finite in the data; fill in the missing values")
    if drivers:
        held: dict[str, Signal] = {name: (times, table[name]) for name in drivers}
        runs = Runs(mechanism, vary, None, None, {**held, **(inputs or {})}, parameters, times=times, begin=False)
    if by_input := [name for name in vary if name in runs.inputs]:
        raise InputError(f"{by_input[0]} is an input; vary parameters and start values")
    return runs


def _measured(runs: Runs, table: Result, columns: Sequence[str] | None) -> list[str]:
    """Return the measured columns to use."""
    units = {v.name: v.unit for v in runs.unit.outputs}
    outputs = list(units)
    if (found := columns) is None:
        found = [name for name in table.names if name in outputs and not name.startswith("monitor.")]
    for name in found:
        if name not in table.names:
            raise InputError(f"the data have no column {name!r}; {there_is(name, table.names)}")
        if name not in outputs:
            raise InputError(f"{runs.unit.name} has no output {name!r}; {there_is(name, outputs)}")
    if not found:
        names = ", ".join(table.names[:5])
        raise InputError(f"no column of the data ({names}) is an output of {runs.unit.name}, such as {outputs[0]}")
    for name in found:
        if (unit := table.units.get(name, units[name])) != units[name]:
            raise InputError(f"the data have {name} in {unit}, {runs.unit.name} has it in {units[name]}; convert it")
    return list(found)


def _sizes(
    runs: Runs,
    measured: list[str],
    seen: NDArray[np.float64],
    known: NDArray[np.bool_],
    deviations: Mapping[str, float],
) -> NDArray[np.float64]:
    """Return the divisor of the residuals of each column."""
    for name, value in deviations.items():
        if name not in measured:
            raise InputError(f"a deviation is given for {name!r}, which is not measured; {there_is(name, measured)}")
        if not (isinstance(value, float | int | np.number) and math.isfinite(value) and value > 0):
            raise InputError(f"the deviation of {name} is {shown(value)}; it must be a finite number above zero")
    units = {v.name: v.unit for v in runs.unit.outputs}
    largest: dict[str, float] = {}
    for name, column, there in zip(measured, seen.T, known.T, strict=True):
        if not there.any():
            raise InputError(f"the column {name} has no finite number")
        largest[units[name]] = max(largest.get(units[name], 0.0), float(np.abs(column[there]).max()))
    sizes = []
    for name, column, there in zip(measured, seen.T, known.T, strict=True):
        reach, usual = float(np.ptp(column[there])), largest[units[name]]
        sizes.append(deviations.get(name, reach if reach > _STILL * usual else usual or 1.0))
    return np.array(sizes)


def _bounds(runs: Runs, bounds: Mapping[str, tuple[float, float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    variables = {v.name: v for v in runs.unit.parameters}
    for name, given in bounds.items():
        if name not in runs.by:
            raise InputError(f"bounds are given for {name!r}, which is not varied; {there_is(name, runs.by)}")
        try:
            a, b = map(float, given)
        except (TypeError, ValueError):
            raise InputError(f"the bounds of {name} are {shown(given)}; give two numbers") from None
        if not a < b:
            raise InputError(f"the bounds of {name} are {a} and {b}; the first must be less")
    low, high = [], []
    for name in runs.by:
        v = variables[name]
        own = (-math.inf if v.minimum is None else v.minimum, math.inf if v.maximum is None else v.maximum)
        a, b = bounds.get(name, own)
        if max(a, own[0]) >= min(b, own[1]):
            raise InputError(f"the bounds of {name} are {a:g} and {b:g}; it must be from {own[0]:g} to {own[1]:g}")
        low.append(max(a, own[0]))
        high.append(min(b, own[1]))
    return np.array(low), np.array(high)


class _Problem:
    """Residuals and their derivatives; repeated calls at one point share a run."""

    def __init__(
        self,
        runs: Runs,
        measured: list[str],
        seen: NDArray[np.float64],
        known: NDArray[np.bool_],
        sizes: NDArray[np.float64],
        progress: Callable[[int, float], None] | None,
    ):
        self._runs, self._measured, self._seen, self._known, self._sizes = runs, measured, seen, known, sizes
        self._progress = progress
        self._at: NDArray[np.float64] | None = None
        self._values = self._slopes = np.empty(0)
        self._worst = 0.0
        self.made = 0

    def _make(self, x: NDArray[np.float64]) -> None:
        if self._at is not None and np.array_equal(x, self._at):
            return
        self._runs.set(x)
        self._values, self._slopes = self._runs.tangents(self._measured)
        self._at = x.copy()
        self.made += 1

    def residuals(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        try:
            self._make(x)
        except AlfmuError:
            if not self.made:
                raise
            self._at = None
            return np.full(int(self._known.sum()), self._worst)
        found = ((self._values - self._seen) / self._sizes)[self._known]
        if not self._worst:
            self._worst = _WORSE * (float(np.abs(found).max()) or 1.0)
        if self._progress:
            self._progress(self.made, math.sqrt(float(np.mean(found**2))))
        return found

    def derivatives(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        self._make(x)
        return (self._slopes / self._sizes[:, None])[self._known]

    def best(
        self,
        guesses: list[NDArray[np.float64]],
        low: NDArray[np.float64],
        high: NDArray[np.float64],
        scale: list[float],
    ) -> OptimizeResult:
        """Return the best end of searches from first guesses, without those at which no search can begin."""
        ends, errors = list[OptimizeResult](), list[AlfmuError]()
        begun = False
        for guess in guesses:
            try:
                if not begun:
                    self._runs.set(guess)
                    self._runs.begin()
                    begun = True
                ends.append(self._ended(guess, low, high, scale))
            except AlfmuError as error:
                errors.append(error)
        if not ends:
            raise errors[0]
        return min(ends, key=lambda end: float(end.cost))

    def _ended(
        self, first: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], scale: list[float]
    ) -> OptimizeResult:
        """Search from a first guess."""
        return least_squares(
            self.residuals,
            first,
            self.derivatives,
            bounds=(low, high),
            x_scale=scale,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
        )

    def others(self, low: NDArray[np.float64], high: NDArray[np.float64], count: int) -> list[NDArray[np.float64]]:
        """Return the nearest of other first guesses within the bounds; their runs are made side by side."""
        runs = self._runs
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
            raise InputError(f"{runs.unit.name}: starts is {count!r}; it must be a whole number, 0 or above")
        if not count:
            return []
        if (unbounded := ~np.isfinite(low) | ~np.isfinite(high)).any():
            name = runs.by[int(np.argmax(unbounded))]
            raise InputError(
                f"{runs.unit.name}: other first guesses of {name} need bounds; give them, or leave out starts"
            )
        guesses = low + (high - low) * np.array([*evenly(len(low), count)])
        sizes = np.concatenate([self._apart(part) for part in np.split(guesses, range(_BLOCK, len(guesses), _BLOCK))])
        self.made += count
        nearest = np.argsort(sizes)[:_NEAREST]
        return [guesses[k] for k in nearest if np.isfinite(sizes[k])]

    def _apart(self, guesses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return root mean squares of the weighted residuals of guesses, NaN for those that fail."""
        with collected():  # warnings about guesses are not shown
            found = self._runs.side_by_side(guesses, self._measured)
        left = ((found - self._seen) / self._sizes)[:, self._known]
        return np.sqrt((left**2).mean(axis=1))

    def result(self, x: NDArray[np.float64]) -> Result:
        self._make(x)
        return self._runs.result(self._measured, self._values)


def _covariance(
    runs: Runs, problem: _Problem, x: NDArray[np.float64], scale: NDArray[np.float64], free: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return (J' J)^-1 times the variance of the residuals, for free numbers.

    Numbers that the data do not determine have infinite entries, fixed ones NaN; all are NaN without surplus
    measurements.
    """
    left, slopes = problem.residuals(x), (problem.derivatives(x) * scale)[:, free]
    _, sizes, rows = np.linalg.svd(slopes, full_matrices=False)
    seen = sizes > _UNSEEN * sizes.max(initial=0.0)
    spare = len(left) - len(sizes)
    variance = float(left @ left) / spare if spare else math.nan
    inverse = rows[seen].T / sizes[seen]
    among = variance * inverse @ inverse.T * np.outer(scale[free], scale[free])
    hidden = np.abs(rows[~seen]).max(axis=0, initial=0.0) > math.sqrt(_UNSEEN)
    if hidden.any():
        names = ", ".join(np.array(runs.by)[free][hidden])
        _LOGGER.warning(
            "%s: the data do not determine %s, or only a combination of them; vary fewer, or measure more",
            *(runs.unit.name, names),
        )
        among[hidden, :] = among[:, hidden] = np.nan
        among[hidden, hidden] = np.inf
    covariance = np.full((len(x), len(x)), np.nan)
    covariance[np.ix_(free, free)] = among
    return covariance
