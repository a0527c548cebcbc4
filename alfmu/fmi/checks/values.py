"""Checks of start values, bounds, NaN and infinity, enumerations, and dependencies."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from .calls import refused, sample
from .motion import driven, moved
from .registry import RISKY, NotApplicable, Noted, Task, Unjudged, check, judge
from .unit import WARNING, Broken, Session, Unit, Variable, shown

_PARAMETERS = 60
"""Number of variables whose influence on the start is tested, each in its own instance."""

_DIGITS = {"Float32": 1e-6}
"""Relative difference [1] of a start value from the description: the last of the digits that decimals preserve, 6 for
Float32 and 15 for other types."""

_SEEN = 1e-9
"""Change [1] of an output, over 1 plus its value, above round-off."""


@check(
    "values.start",
    "Start values equal those of the description",
    "A variable with a start value has it before initialisation and, where initial is exact, after it",
    "2.2.7 Definition of Model Variables (start, initial)",
    "Definition of Model Variables (start, initial)",
)
def starts(s: Session, task: Task) -> str:
    known = [v for v in s.variables if v.start is not None and (v.initial == "exact" or v.causality == "input")]
    if not known:
        raise NotApplicable("no variable has a start value")

    def one(begun: bool) -> list[str]:
        faults, when = [], "after initialisation" if begun else "before initialisation ends"
        unit = s.ready() if begun else s.unit()
        if not begun:
            unit.show_starts()
        for v in known:
            status, value = unit.get(v)
            if status > WARNING:
                faults.append(f"{v.name} cannot be read {when} ({shown(status)})")
                break
            if not _equal(v, value):
                faults.append(f"{v.name} is {value!r} {when}, and its start value is {v.start!r}")
        unit.end()
        return faults

    return judge([*s.apart(partial(one, False)), *s.apart(partial(one, True))], f"{len(known)} variables")


def _equal(v: Variable, value: Any) -> bool:
    if v.type in ("Real", "Float32", "Float64"):
        return bool(v.start == value or abs(value - v.start) <= _DIGITS.get(v.type, 1e-14) * abs(v.start))
    return value == v.start


@check(
    "values.bounds",
    "Values outside min and max are refused or handled",
    "An FMU does not rely on min and max: it returns Discard or Error, or is able to handle such values",
    "2.2.7 Definition of Model Variables (min, max); 2.1.3",
    "Handling min/max Range Violations",
    fault=RISKY,
)
def bounds(s: Session, task: Task) -> str:
    limited = [
        (v, value, running)
        for v in s.of("parameter", "input")
        if v.variability != "constant" and not v.items
        for value in (_below(v), _above(v))
        if value is not None
        for running in ([False, True] if v.causality == "input" else [False])
    ]
    if not limited:
        raise NotApplicable("no input or parameter has min or max")
    faults, taken, count = [], [], 0
    for v, value, running in limited:
        how = s.apart(partial(_handled, s, v, value, running))
        count += 1
        if how == "taken":
            taken.append(v.name)
        elif how:
            faults.append(f"{v.name} = {value:g}, outside its bounds, {how}")
    text = f"{count} values: {count - len(taken)} refused"
    text += f", {len(taken)} handled ({', '.join(dict.fromkeys(taken[:3]))})" if taken else ""
    return judge(faults, text)


def _below(v: Variable) -> float | int | None:
    return None if v.minimum is None else _beyond(v, v.minimum, -1)


def _above(v: Variable) -> float | int | None:
    return None if v.maximum is None else _beyond(v, v.maximum, 1)


def _beyond(v: Variable, limit: float, sign: int) -> float | int | None:
    """Return a value beyond a bound; None if the type has none."""
    if v.type in ("Real", "Float32", "Float64"):
        return limit + sign * max(1.0, abs(limit)) if math.isfinite(limit) else None
    value = int(limit) + sign
    bits = {"Integer": 32}.get(v.type) or int("".join(c for c in v.type if c.isdigit()))
    low, high = (0, 2**bits - 1) if v.type.startswith("U") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return value if low <= value <= high else None


def _handled(s: Session, v: Variable, value: Any, running: bool) -> str:
    """Return "" if a value is rejected, "taken" if all outputs stay finite with it, or else the error."""
    unit = s.ready() if running else s.unit()
    calls: list[Callable[[], int]] = [lambda: unit.set(v, value)]
    if not running:
        calls += [unit.enter, unit.exit]
    calls += [lambda: unit.step_raw(unit.time, s.step)]
    for call in calls:
        if call() > WARNING:
            unit.end()
            return ""
    try:
        found = unit.read(s.numbers)
    except Broken:
        return ""
    finally:
        unit.end()
    names = [s.numbers[i].name for i in np.flatnonzero(~np.isfinite(found))]
    return f"is taken, and {names[0]} is not finite afterwards, with OK" if names else "taken"


@check(
    "values.nonfinite",
    "Inputs that are NaN or infinite",
    "NaN and infinities as inputs are refused, handled or handed through (a question of this checker alone)",
    "2.1.3 Status Returned by Functions",
    "Status Returned by Functions",
    fault=RISKY,
)
def nonfinite(s: Session, task: Task) -> str:
    inputs = [v for v in s.of("input") if v.type in ("Real", "Float64", "Float32")]
    if not inputs:
        raise NotApplicable("there are no real inputs")
    faults, taken = [], []
    for v in inputs[:10]:
        for value in (math.nan, math.inf, -math.inf):
            how = s.apart(partial(_handled, s, v, value, True))
            if how == "taken":
                taken.append(f"{v.name} = {value}")
            elif how:
                faults.append(f"{v.name} = {value} {how}")
    if faults:
        more = f"; and {len(faults) - 1} more" if len(faults) > 1 else ""
        raise Noted(f"{faults[0]}{more}; the standard does not say what to do with such inputs")
    return f"handled: {', '.join(taken)}" if taken else "refused"


@check(
    "values.types",
    "Values read are of their type",
    "Integer and enumeration outputs are within min and max and are items; a value that is no item is not taken",
    "2.2.3 Definition of Types; 2.2.7",
    "Handling min/max Range Violations, and Definition of Types",
)
def types(s: Session, task: Task) -> str:
    listed = [v for v in s.variables if v.items]
    whole = [v for v in s.outputs if "Int" in v.type]
    if not listed and not whole:
        raise NotApplicable("there are no enumerations, and no integer outputs")
    faults = s.apart(partial(_items, s, whole, listed))
    for v in listed:
        if v.causality in ("parameter", "input"):
            faults += s.apart(partial(_other_item, s, v))
    return judge(faults, f"{len(listed)} enumerations, {len(whole)} integer outputs")


def _items(s: Session, whole: list[Variable], listed: list[Variable]) -> list[str]:
    """Return values that are illegal for their type after some steps."""
    faults = []
    unit = s.ready()
    driven(unit, 3)
    for v in [*whole, *listed]:
        status, value = unit.get(v)
        if status > WARNING:
            faults.append(f"{v.name} cannot be read ({shown(status)})")
        elif v.items and value not in v.items:
            faults.append(f"{v.name} is {value}, which is no item of its type")
        elif (v.minimum is not None and value < v.minimum) or (v.maximum is not None and value > v.maximum):
            faults.append(f"{v.name} is {value}, outside its bounds")
    unit.end()
    return faults


def _other_item(s: Session, v: Variable) -> list[str]:
    """Return the error of an enumeration that accepts a value outside its items."""
    other = max(v.items) + 1
    unit = s.unit()
    status = unit.set(v, other)
    taken = not refused(unit, status, running=False) and unit.get(v)[1] == other
    unit.end()
    return [f"{v.name} takes {other}, which is no item of its type, with {shown(status)}"] if taken else []


# Dependencies ---------------------------------------------------------------------------------------------------------


def _declared(s: Session, unknowns: Any) -> dict[str, set[str] | None]:
    """Return the names of each unknown's dependencies, by its name; None stands for everything."""
    return {
        each.variable.name: None if each.dependencies is None else {v.name for v in each.dependencies}
        for each in unknowns
        if each.variable is not None
    }


def _changed(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    return np.abs(after - before) > _SEEN * (1 + np.abs(before))


@check(
    "dependencies.outputs",
    "Outputs depend only on declared inputs",
    "dependencies lists all inputs that an output depends on at the same time",
    "2.2.8 Definition of the Model Structure",
    "Definition of the Model Structure",
)
def dependencies(s: Session, task: Task) -> str:
    declared = {name: on for name, on in _declared(s, s.description.outputs).items() if on is not None}
    inputs = [v for v in s.of("input") if v.type not in ("String",)]
    outputs = [v for v in s.numbers if v.name in declared]
    if not inputs or not outputs:
        raise NotApplicable("no output lists its dependencies" if inputs else "there are no inputs")
    unit = s.ready()
    driven(unit, 3)
    before, faults, seen = unit.read(outputs), [], 0
    for v in inputs:
        status, at = unit.get(v)
        unit.must(status, f"Get{v.type}")
        if (value := _other(v, at)) is None or unit.set(v, value) > WARNING:
            continue
        after = unit.read(outputs)
        for i in np.flatnonzero(_changed(before, after)):
            seen += 1
            if v.name not in declared[outputs[i].name]:
                faults.append(
                    f"{outputs[i].name} depends on {v.name} at the same time, which its dependencies do not list"
                )
        unit.must(unit.set(v, at), f"Set{v.type} of {v.name}")
    total = sum(len(on & {v.name for v in inputs}) for on in declared.values())
    return judge(faults, f"{seen} of {total} declared dependencies were seen here")


def _other(v: Variable, at: Any) -> Any:
    """Return another legal value of a variable; None if there is none."""
    if v.type == "Boolean":
        return not at
    if v.items:
        return next((each for each in v.items if each != at), None)
    if v.type in ("Real", "Float32", "Float64"):
        low = -math.inf if v.minimum is None else v.minimum
        high = math.inf if v.maximum is None else v.maximum
        by = 0.01 * (v.nominal or max(1.0, abs(at)))
        return next((each for each in (at + by, at - by) if low <= each <= high), None)
    return None


@check(
    "dependencies.start",
    "Values at the start depend only on declared dependencies",
    "dependencies of initial unknowns list all that they depend on when initialisation ends",
    "2.2.8 Definition of the Model Structure (InitialUnknowns)",
    "Definition of the Model Structure (InitialUnknown)",
)
def initial(s: Session, task: Task) -> str:
    declared = {name: on for name, on in _declared(s, s.description.initialUnknowns).items() if on is not None}
    outputs = [v for v in s.numbers if v.name in declared]
    knowns = [v for v in s.of("parameter", "input") if v.type != "String" and v.variability != "constant"]
    if not outputs or not knowns:
        raise NotApplicable("no initial unknown lists its dependencies")

    def one(v: Variable) -> np.ndarray | None:
        unit: Unit = s.unit()
        value = moved(v, 1e-3) if v.type in ("Real", "Float32", "Float64") else _other(v, sample(v))
        try:
            if value is None or unit.set(v, value) > WARNING:
                return None
            unit.begin()
            return unit.read(outputs)
        except Broken:  # this start may be impossible
            return None
        finally:
            unit.end()

    before, faults, tried = s.apart(lambda: s.ready().read(outputs)), [], 0
    for v in knowns[:_PARAMETERS]:
        if (after := s.apart(partial(one, v))) is None:
            continue
        tried += 1
        names = [outputs[i].name for i in np.flatnonzero(_changed(before, after))]
        wrong = [name for name in names if v.name not in declared[name]]
        faults += [f"{name} depends on {v.name} at the start, which its dependencies do not list" for name in wrong]
    if not tried:
        raise Unjudged("no variable can be changed before the start")
    left = f", {len(knowns) - _PARAMETERS} left out" if len(knowns) > _PARAMETERS else ""
    return judge(faults, f"{len(outputs)} unknowns by {tried} variables{left}")
