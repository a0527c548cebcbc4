"""Drive runs of a unit from Python, for tests, reports and the command line."""

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations, Variable
from ..model.errors import AlfmuError, InputError
from ..model.mechanism import Mechanism
from ..model.settings import FIXED, Settings
from ..model.words import shown
from ..runtime import Instance
from ..runtime.pipeline import prepared
from . import oracle
from .result import OFF, Check, Result, Signal

MOST = 500_000_000
"""Largest number of values in a result: 4 GB."""

HIDDEN, NOTHING = 1e-3, 1e-12
"""Largest value of a state over its nominal value [1]: below the first limit a tolerance of 1e-6 allows errors of a
thousandth, and the run warns; below the second the state is round-off."""

_LOGGER = logging.getLogger("alfmu")

Progress = Callable[[Iterable[float]], Iterable[float]]
"""Wraps the communication points of a run to show progress (`iter` shows none)."""


class Unit(Protocol):
    """The interface of an `Instance` or an FMU for the driver."""

    name: str

    @property
    def outputs(self) -> Sequence[Variable]: ...
    @property
    def input_variables(self) -> Sequence[Variable]: ...

    def set(self, name: str, value: float | str) -> None: ...
    def initialize(self) -> None: ...
    def step(self, communication_step: float, time: float) -> None: ...
    def read(self) -> NDArray[np.float64]: ...
    def read_inputs(self) -> NDArray[np.float64]: ...


def settings_of(unit: Instance) -> dict[str, float | str]:
    """Return the settings of a unit that a check of its run may change."""
    return {name: unit.get(name) for name in ("solver.method", *FINER)}


FINER = {"solver.relative_tolerance": 0.01, "solver.step_size": 0.5}
"""Factors on settings for a checking run [1]: on the tolerance, or on the length of fixed steps."""


def finer(name: str, known: Mapping[str, float | str]) -> tuple[str, float]:
    """Return the solver setting and its value for a checking run; raise InputError if there is none."""
    setting = list(FINER)[known.get("solver.method") in FIXED]
    if setting not in known:
        raise InputError(f"{name} has no {setting}, which a check changes for its second run; FMUs of alfmu have it")
    return setting, FINER[setting] * float(known[setting])


def checked(result: Result, other: Result, setting: str, value: float) -> Result:
    """Return a result with its deviation from a run with a finer setting; warn if that is large."""
    check = Check.of(result, other, setting, value)
    if check.since is not None:
        _LOGGER.warning(
            "%s: %s; its relative error exceeds %g from t = %.3g s on; take a smaller %s",
            *(result.mechanism, check, OFF, check.since, setting),
        )
    return replace(result, check=check)


def instance(equations: Equations, kernel: str, settings: Settings | None = None) -> Instance:
    """Return an instance that is not yet initialised, run by a kernel."""
    return (oracle.Instance if kernel == "oracle" else Instance)(prepared(equations, kernel), settings)


def run(
    unit: Unit,
    stop_time: float,
    communication_step: float,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    progress: Progress = iter,
    held_rows: bool = False,
    facts: Mapping[str, Any] | None = None,
    declared: Mechanism | None = None,
) -> Result:
    """Run a unit that is not yet initialised as `simulate` does; the result has `facts` and the mechanism."""
    for name, value in (parameters or {}).items():
        unit.set(name, value)
    variables = [*unit.outputs, *unit.input_variables]
    times = communication_points(unit.name, stop_time, communication_step, 1 + len(variables))
    names, units = [v.name for v in variables], {v.name: v.unit for v in variables}
    signals, at = by_name(unit, "inputs", inputs), values_of(unit, inputs)
    if isinstance(unit, Instance) and getattr(unit, "run", None) and not held_rows:
        values, ended = _in_one_call(unit, times, list(signals), at, names, progress)
    else:
        values, ended = _step_by_step(unit, times, list(signals), at, progress, held_rows)
    counters = getattr(unit, "counters", None)
    result = Result(unit.name, times[: len(values)], tuple(names), units, values, counters, facts or {}, declared)
    if ended is not None:
        ended.result = result if len(values) else None  # type: ignore[attr-defined]
        raise ended
    if isinstance(unit, Instance) and unit.adapts:
        _tell_of_small_states(unit, result)
    return result


def values_of(unit: Unit, inputs: Mapping[str, Signal] | None) -> Callable[[str, float], float]:
    """Return a function that gives the value of an input at a time [s]."""
    signals = signals_of(unit.name, inputs)
    kinds = {v.name: v.type for v in unit.input_variables}

    def at(name: str, t: float) -> float:
        value = signals[name](t)
        # A table of values 0 and 1, or of integers, switches half-way between them.
        if kinds.get(name) == "Boolean" and 0 <= value <= 1:
            return value >= 0.5
        return math.floor(value + 0.5) if kinds.get(name) == "Integer" else value

    return at


def _tell_of_small_states(unit: Instance, result: Result) -> None:
    """Warn of states whose nominal value hides their errors."""
    for v in unit.equations.states:
        nominal = v.nominal or 1.0
        largest = float(np.abs(result[v.name]).max()) if v.name in result.names else 0.0
        if NOTHING * nominal < largest < HIDDEN * nominal:
            _LOGGER.warning(
                "%s: the state %s reached %.2g %s at most, too small for error control by its nominal value %g %s; "
                "give nominal= in state()",
                *(unit.name, v.name, largest, v.unit, nominal, v.unit),
            )


def table_of(
    inputs: Sequence[str], at: Callable[[str, float], float], times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return inputs by columns, at times by rows."""
    return np.array([[at(name, t) for name in inputs] for t in times], float).reshape(len(times), len(inputs))


def _in_one_call(
    unit: Instance,
    times: NDArray[np.float64],
    inputs: list[str],
    at: Callable[[str, float], float],
    names: list[str],
    progress: Progress,
) -> tuple[NDArray[np.float64], BaseException | None]:
    """Return the values of a run by one call of the runtime, and the error if it ended early."""
    for name in inputs:
        unit.set(name, at(name, times[0]))
    table = table_of(inputs, at, times)
    shown = iter(progress(times[:-1]))
    passed = 0

    def show(done: int) -> bool:
        nonlocal passed
        for _ in range(done - passed):
            next(shown, None)
        passed = done
        if getattr(progress, "ended", bool)():  # checked within a long communication step
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
    times: NDArray[np.float64],
    inputs: list[str],
    at: Callable[[str, float], float],
    progress: Progress,
    held: bool,
) -> tuple[NDArray[np.float64], BaseException | None]:
    """Return the values of a run by successive communication steps, and the error if it ended early."""
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


def communication_points(name: str, stop_time: float, step: float, columns: int = 1) -> NDArray[np.float64]:
    """Return 0, step, 2 step, ... and stop_time; raise InputError if a result with this number of columns is
    too large."""
    for what, given in (("step", step), ("stop time", stop_time)):
        if not (isinstance(given, float | int | np.number) and math.isfinite(given) and given > 0):
            raise InputError(f"{name}: the {what} is {given!r} s; it must be a finite number above zero")
    if (points := stop_time / step) * columns > MOST:
        raise InputError(
            f"{name}: {points:.2g} communication points of {step:g} s up to {stop_time:g} s, with {columns} numbers at "
            f"each, are more than the {MOST:.0e} numbers that a result may hold; take a longer step, an earlier stop "
            "time or fewer outputs"
        )
    times = np.arange(math.floor(points * (1 + 1e-12)) + 1, dtype=np.float64) * step
    if len(times) == 1 or stop_time - times[-1] > 1e-9 * step:
        return np.append(times, stop_time)
    return times


def by_name(mechanism: object, what: str, given: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a mapping of values by name; raise InputError for any other type."""
    name = getattr(mechanism, "name", "") or mechanism
    if given is not None and not isinstance(given, Mapping):
        raise InputError(f"{name}: the {what} are {shown(given)}; give a dictionary of values by their names")
    if wrong := [x for x in given or () if not isinstance(x, str)]:
        raise InputError(f"{name}: one of the {what} is called {shown(wrong[0])}; a name is a text")
    return dict(given or {})


def names_in(mechanism: object, what: str, given: Iterable[str]) -> list[str]:
    """Return a sequence of names; raise InputError for any other type, in particular a single text."""
    if isinstance(given, str) or not isinstance(given, Iterable) or not all(isinstance(x, str) for x in given):
        name = getattr(mechanism, "name", "") or mechanism
        raise InputError(f"{name}: the {what} are {shown(given)}; give a list of names")
    return list(given)


def signals_of(mechanism: object, inputs: Mapping[str, Signal] | None) -> dict[str, Callable[[float], float]]:
    """Return inputs as functions of time [s], by name; raise InputError if one is not a signal."""
    found: dict[str, Callable[[float], float]] = {}
    for name, signal in by_name(mechanism, "inputs", inputs).items():
        if callable(signal):
            found[name] = partial(_number_of, signal)
        elif isinstance(signal, tuple):
            found[name] = _of_table(mechanism, name, signal)
        elif isinstance(signal, float | int | np.number):
            found[name] = _constant(float(signal))
        else:
            raise InputError(f"{_no_signal(mechanism, name)} is {shown(signal)}; {_SIGNALS}")
    return found


def _number_of(signal: Callable[[float], Any], t: float) -> Any:
    """Return a value of a function; splines of SciPy return arrays without dimensions."""
    value = signal(t)
    return value.item() if isinstance(value, np.ndarray) and not value.ndim else value


def _constant(value: float) -> Callable[[float], float]:
    return lambda t: value


_SIGNALS = "give a number, a function of time, or a pair (times, values)"


def _no_signal(mechanism: object, name: str) -> str:
    return f"{getattr(mechanism, 'name', '') or mechanism}: the signal of {name}"


def _of_table(mechanism: object, name: str, table: tuple[Any, ...]) -> Callable[[float], float]:
    """Return the piecewise linear function of a table, constant before and after it."""
    try:
        times, values = (np.array(each, float) for each in table)
    except (TypeError, ValueError):
        raise InputError(f"{_no_signal(mechanism, name)} is {shown(table)}; {_SIGNALS}") from None
    if times.ndim != 1 or times.shape != values.shape or not times.size:
        raise InputError(
            f"{_no_signal(mechanism, name)} has times of shape {times.shape} and values of shape {values.shape}; give "
            "one value for each time"
        )
    if not (np.isfinite(times).all() and (np.diff(times) >= 0).all()):
        raise InputError(
            f"{_no_signal(mechanism, name)} has times that do not rise, or are not finite; give them in order"
        )
    return lambda t: float(np.interp(t, times, values))
