"""Checks of steps, states, resets and derivatives: whether an FMU behaves as described, and repeatably."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from .registry import RISKY, Fault, NotApplicable, Task, Unjudged, check, judge
from .unit import DISCARD, WARNING, Broken, Session, Unit, Variable, shown

_COUNT = 20
"""Number of steps of a repeated run."""

_STIR = 1e-3
"""Relative changes of inputs in such runs [1], over their nominal value: visible in every bit, and always feasible."""

_ROUND_OFF = 1e-13
"""Relative difference of runs that must agree [1]: some hundred last digits. A state that is not restored causes more,
and a different order of summation, as with several threads, less."""

_VARIED = 0.05
"""Largest difference [1] due to other step sizes after a few steps, over 1 plus the value; a larger one is an error of
stepping rather than of the integrator."""

_DIFFERENCE = 1e-4
"""Largest difference [1] of a derivative from central differences, over 1 plus the largest one by that input, in
addition to ten times the disagreement of two difference sizes."""

_SLOPE = 1e-3
"""Limit as _DIFFERENCE for derivatives by time, against differences over steps."""


def excite(unit: Unit, k: int) -> None:
    """Change the continuous inputs slightly, depending on k."""
    for i, v in enumerate(unit.session.real_inputs):
        unit.must(unit.set(v, moved(v, _STIR * math.sin(1.0 + 0.7 * k + i))), f"Set{v.type} of {v.name}")


def moved(v: Variable, by: float) -> float:
    """Return a value that differs from the start of a variable by a share of its nominal value, within its bounds."""
    start = 0.0 if v.start is None else float(v.start)
    size = v.nominal or max(1.0, abs(start))
    low = -math.inf if v.minimum is None else v.minimum
    high = math.inf if v.maximum is None else v.maximum
    value = start + by * size
    return value if low <= value <= high else min(max(start - by * size, low), high)


def driven(unit: Unit, count: int, begin: int = 0, size: float | None = None) -> list[np.ndarray]:
    """Return the outputs before and after each of `count` steps with moving inputs."""
    numbers = unit.session.numbers
    rows = [unit.read(numbers)]
    for k in range(begin, begin + count):
        excite(unit, k)
        unit.step(size)
        rows.append(unit.read(numbers))
    return rows


def unlike(s: Session, wanted: Sequence[np.ndarray], got: Sequence[np.ndarray], when: str) -> list[str]:
    """Return the first outputs that differ by more than round-off, as sentences."""
    with np.errstate(invalid="ignore"):  # infinities
        allowed = _ROUND_OFF * np.abs(wanted).max(axis=0)
        for k, (a, b) in enumerate(zip(wanted, got, strict=True)):
            unlike = ~((np.abs(a - b) <= allowed) | (a == b) | (np.isnan(a) & np.isnan(b)))
            if not unlike.any():
                continue
            i = int(unlike.argmax())
            name = s.numbers[i].name
            return [f"{when}, {name} is {b[i]:.17g} in row {k} of the run, and was {a[i]:.17g}"]
    return []


@check(
    "run.default",
    "The FMU runs from its defaults",
    "Initialisation and steps succeed with the start values, and the outputs are finite",
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    "State Machine for Co-Simulation",
    after=None,
)
def default(s: Session, task: Task) -> str:
    rows = driven(s.ready(), _COUNT)
    names = [s.numbers[i].name for i in np.flatnonzero(~np.isfinite(np.array(rows)).all(axis=0))]
    faults = [f"{name} is not finite" for name in names]
    return judge(faults, f"{_COUNT} steps of {s.step:g} s")


@check(
    "run.repeated",
    "A second instance gives the same run",
    "The values of an FMU follow from start values, inputs and steps (a demand of this checker, not of the standard)",
    "not demanded",
    "not demanded",
    fault=RISKY,
)
def again(s: Session, task: Task) -> str:
    first, second = (s.apart(lambda: driven(s.ready(), _COUNT)) for _ in range(2))
    return judge(unlike(s, first, second, "in a second instance"))


@check(
    "state.restored",
    "A state that is restored gives the same run",
    "The state is complete, and may be restored more than once",
    "2.1.8 Getting and Setting the Complete FMU State",
    "Getting and Setting the Complete FMU State",
)
def restored(s: Session, task: Task) -> str:
    _states(s)
    unit = s.ready()
    driven(unit, 5)
    state, when = unit.save(), unit.time
    first = driven(unit, _COUNT, begin=5)
    faults: list[str] = []
    for turn in ("once", "twice"):
        unit.restore(state)
        unit.time = when
        faults = faults or unlike(s, first, driven(unit, _COUNT, begin=5), f"restored {turn}")
    unit.forget(state)
    unit.end()
    # Harmless unless the handle is used again; pythonfmu's library leaves it set.
    remark = "remark: FreeFMUState does not set the handle of the state to NULL, as the standard says"
    return judge(faults, "" if state.value is None else remark)


@check(
    "state.bytes",
    "A state written as bytes gives the same run, in another instance too",
    "A serialised state can be read by any instance of the same FMU",
    "2.1.8 Getting and Setting the Complete FMU State",
    "Getting and Setting the Complete FMU State",
)
def serialised(s: Session, task: Task) -> str:
    _states(s)
    name = "canSerializeFMUstate" if s.version == "2" else "canSerializeFMUState"
    if not _can(s, "canSerializeFMUState"):
        raise NotApplicable(f"{name} is false")

    def loaded(unit: Unit, data: bytes, when: float) -> list[np.ndarray]:
        unit.restore(unit.load(data))
        unit.time = when
        rows = driven(unit, _COUNT, begin=5)
        unit.end()
        return rows

    def written() -> tuple[bytes, float, list[np.ndarray], list[np.ndarray]]:
        unit = s.ready()
        driven(unit, 5)
        data, when = unit.write(unit.save()), unit.time
        return data, when, driven(unit, _COUNT, begin=5), loaded(unit, data, when)

    data, when, first, same = s.apart(written)
    other = s.apart(lambda: loaded(s.ready(name="other"), data, when))
    faults = []
    for rows, who in ((same, "the same instance"), (other, "another instance")):
        faults += unlike(s, first, rows, f"read from bytes by {who}")
    return judge(faults, f"{len(data)} bytes")


def _can(s: Session, name: str) -> bool:
    return s.flag(name, name.replace("FMUState", "FMUstate"))


def _states(s: Session) -> None:
    if not _can(s, "canGetAndSetFMUState"):
        raise NotApplicable("canGetAndSetFMUState is false")


@check(
    "run.reset",
    "After a reset an instance equals a new one",
    "Reset brings back the state after instantiation, and all variables their start values",
    "2.1.6 Initialization, Termination, and Resetting an FMU",
    "Reset",
)
def reset(s: Session, task: Task) -> str:
    parameter = next((v for v in s.of("parameter") if v.type in ("Real", "Float64") and v.start is not None), None)

    def begin() -> dict[str, object]:
        new, starts = s.unit(), {}
        new.show_starts()
        for v in [*s.of("parameter"), *s.of("input")]:
            status, value = new.get(v)
            if status <= WARNING:
                starts[v.name] = value
        new.end()
        return starts

    def used(change: bool) -> tuple[list[str], list[np.ndarray]]:
        unit = s.unit()
        if parameter and change:
            unit.set(parameter, moved(parameter, 1e-3))
        unit.begin()
        driven(unit, 5)
        unit.must(unit.reset(), "Reset")
        unit.show_starts()
        faults = []
        for name, value in starts.items():
            status, now = unit.get(s.by_name[name])
            if status > WARNING or (now != value and not (now != now and value != value)):
                faults.append(f"{name} is {now!r} after Reset, and {value!r} in a new instance")
        unit.must(unit.reset(), "Reset")
        unit.begin()
        return faults, driven(unit, _COUNT)

    starts, first = s.apart(begin), s.apart(lambda: driven(s.ready(), _COUNT))
    try:
        faults, rows = s.apart(lambda: used(True))
    except Broken:  # the parameter has no valid start
        faults, rows = s.apart(lambda: used(False))
    return judge(faults + unlike(s, first, rows, "after Reset"))


# Steps ----------------------------------------------------------------------------------------------------------------


@check(
    "step.zero",
    "A step of no length is refused",
    "communicationStepSize is above zero",
    "4.2.2 Computation",
    "Advancing Time: required to be larger than 0.0",
    fault=RISKY,
)
def zero(s: Session, task: Task) -> str:
    unit = s.ready()
    driven(unit, 2)
    before = unit.read(s.numbers)
    status = unit.step_raw(unit.time, 0.0)
    if status > WARNING:
        return f"by {shown(status)}"
    after = unit.read(s.numbers)
    faults = unlike(s, [before], [after], "after a step of no length")
    if s.version == "2" and not faults:
        raise Unjudged("it is taken, and changes nothing; FMI 2 names no status")
    return judge(faults or ["it is taken"])


@check(
    "step.negative",
    "A step back in time is refused",
    "communicationStepSize is above zero",
    "4.2.2 Computation",
    "Advancing Time: required to be larger than 0.0",
    fault=RISKY,
)
def negative(s: Session, task: Task) -> str:
    unit = s.ready()
    driven(unit, 2)
    status = unit.step_raw(unit.time, -s.step)
    return judge([f"a step of {-s.step:g} s ends with {shown(status)}"] if status <= WARNING else [], shown(status))


@check(
    "step.time",
    "A step from another time than that of the FMU",
    "currentCommunicationPoint is where the last step ended; the FMU may refuse it, or make up for the difference",
    "4.2.2 Computation",
    "fmi3DoStep: currentCommunicationPoint",
    fault=RISKY,
)
def elsewhere(s: Session, task: Task) -> str:
    unit = s.ready()
    driven(unit, 2)
    status = unit.step_raw(unit.time + 10 * s.step, s.step)
    if status > WARNING:
        return f"refused by {shown(status)}"
    after = unit.read(s.numbers)
    judge([] if np.isfinite(after).all() else ["it is taken, and outputs are not finite afterwards"])
    raise Unjudged("it is taken, which the standard leaves to the FMU")


@check(
    "step.sizes",
    "Steps of different lengths lead to the same state",
    "With canHandleVariableCommunicationStepSize every length above zero is taken",
    "4.3.1 Co-Simulation FMU (canHandleVariableCommunicationStepSize)",
    "canHandleVariableCommunicationStepSize",
    fault=RISKY,
)
def sizes(s: Session, task: Task) -> str:
    if not s.varies:
        raise NotApplicable("canHandleVariableCommunicationStepSize is false")

    def after(shares: Sequence[float]) -> np.ndarray:
        unit = s.ready()
        for share in shares:
            unit.step(share * s.step)
        return unit.read(s.real_outputs)

    a = s.apart(lambda: after([1.0] * 8))
    b = s.apart(lambda: after([0.3, 1.7, 0.01, 0.99, 2.0, 0.5, 1.5, 0.4, 0.6]))  # 8 in all
    if not np.isfinite(b).all():
        raise Fault("with uneven steps an output is not finite")
    apart = np.abs(a - b) / (1 + np.abs(a))
    if not apart.size:
        return "taken"
    k = int(apart.argmax())
    text = f"{s.real_outputs[k].name} differs by {apart[k]:.1e} (over 1 and its value) after 8 steps of {s.step:g} s"
    return judge([f"{text}; {_VARIED:g} is the limit"] if apart[k] > _VARIED else [], text)


# Derivatives ----------------------------------------------------------------------------------------------------------


def _jacobian(unit: Unit, outputs: Sequence[Variable], v: Variable, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Return central differences of outputs by an input, and their change when the difference is halved."""

    def by(h: float) -> np.ndarray:
        rows = []
        for value in (at + h, at - h):
            unit.must(unit.set(v, value), f"Set{v.type} of {v.name}")
            rows.append(unit.read(outputs))
        return (rows[0] - rows[1]) / (2 * h)

    h = 1e-3 * (v.nominal or max(1.0, abs(at)))
    wide, narrow = by(h), by(h / 2)
    unit.must(unit.set(v, at), f"Set{v.type} of {v.name}")
    return narrow, np.abs(wide - narrow)


def _by_differences(s: Session) -> tuple[Unit, list[Variable], list[Variable], np.ndarray, np.ndarray]:
    """Return a unit after some steps, its continuous outputs and inputs, the Jacobian by differences and its error."""
    outputs, inputs = s.real_outputs, s.real_inputs
    if not outputs or not inputs:
        raise NotApplicable("there are no continuous inputs and outputs")
    unit = s.ready()
    driven(unit, 3)
    found, errors = [], []
    for v in inputs:
        status, at = unit.get(v)
        unit.must(status, f"Get{v.type}")
        low, high = _range(v)
        margin = 2e-3 * (v.nominal or max(1.0, abs(at)))
        at = min(max(at, low + margin), high - margin) if high - low > 4 * margin else at
        unit.must(unit.set(v, at), f"Set{v.type} of {v.name}")
        column, error = _jacobian(unit, outputs, v, at)
        found.append(column)
        errors.append(error)
    J, error = np.array(found).T, np.array(errors).T
    if not np.isfinite(J).all():
        raise Unjudged("outputs are not finite beside these inputs")
    return unit, outputs, inputs, J, error


def _range(v: Variable) -> tuple[float, float]:
    return (-math.inf if v.minimum is None else v.minimum), (math.inf if v.maximum is None else v.maximum)


def _compared(
    claimed: np.ndarray, wanted: np.ndarray, error: np.ndarray, said: Callable[[int], str], tolerance: float
) -> tuple[list[str], float]:
    """Return where derivatives deviate from differences, and the largest deviation over 1 plus the largest value."""
    scale = 1 + np.abs(wanted).max(initial=0.0)
    apart = np.abs(claimed - wanted)
    allowed = tolerance * scale + 10 * error
    wrong = ~(apart <= allowed)
    faults = [f"{said(int(i))} is {claimed[i]:.6g}, and {wanted[i]:.6g} by differences" for i in np.flatnonzero(wrong)]
    return faults, float(apart.max(initial=0.0) / scale)


def _directional(s: Session) -> str:
    name = "providesDirectionalDerivative" if s.version == "2" else "providesDirectionalDerivatives"
    if not s.flag("providesDirectionalDerivative", "providesDirectionalDerivatives"):
        raise NotApplicable(f"{name} is false")
    return name


@check(
    "derivatives.directional",
    "Directional derivatives are those of the outputs",
    "They are the partial derivatives of outputs by inputs at this time, times the seed",
    "2.1.9 Getting Partial Derivatives",
    "Getting Directional Derivatives",
)
def directional(s: Session, task: Task) -> str:
    _directional(s)
    unit, outputs, inputs, J, error = _by_differences(s)
    faults: list[str] = []
    worst, zeros = 0.0, not J.any()
    seeds = [*np.eye(len(inputs)), np.cos(1.0 + np.arange(len(inputs)))]
    claimed = []
    for seed in seeds:
        status, found = unit.directional(outputs, inputs, seed)
        unit.must(status, "GetDirectionalDerivative")
        claimed.append(found)
        names = " and ".join(v.name for v, x in zip(inputs, seed, strict=True) if x)

        def said(i: int, names: str = names) -> str:
            return f"the derivative of {outputs[i].name} by {names}"

        more, apart = _compared(found, J @ seed, error @ np.abs(seed), said, _DIFFERENCE)
        faults, worst = faults + more, max(worst, apart)
    if zeros and np.any(claimed):
        raise Unjudged("inputs change outputs only after the next step, so that there are no differences to compare")
    return judge(faults, f"{len(outputs)} outputs by {len(inputs)} inputs, to {worst:.0e} of the largest")


@check(
    "derivatives.adjoint",
    "Adjoint derivatives are those of the outputs",
    "They are the partial derivatives of outputs by inputs at this time, weighted by the seed",
    "not in FMI 2",
    "Getting Adjoint Derivatives",
)
def adjoint(s: Session, task: Task) -> str:
    if s.version == "2" or not s.flag("providesAdjointDerivatives"):
        raise NotApplicable("providesAdjointDerivatives is false" if s.version == "3" else "FMI 2 has none")
    unit, outputs, inputs, J, error = _by_differences(s)
    seed = np.cos(1.0 + np.arange(len(outputs)))
    status, found = unit.directional(outputs, inputs, seed, adjoint=True)
    unit.must(status, "GetAdjointDerivative")
    faults, worst = _compared(
        found, J.T @ seed, error.T @ np.abs(seed), lambda i: f"the adjoint derivative by {inputs[i].name}", _DIFFERENCE
    )
    return judge(faults, f"to {worst:.0e} of the largest")


@check(
    "derivatives.output",
    "Derivatives of outputs by time are those of the motion",
    "Derivatives up to maxOutputDerivativeOrder are given at the communication point, and no higher ones",
    "4.2.1 Transfer of Input / Output Values and Parameters",
    "fmi3GetOutputDerivatives",
)
def by_time(s: Session, task: Task) -> str:
    highest = int(s.flags.get("maxOutputDerivativeOrder", 0))
    outputs = s.real_outputs
    if highest < 1 or not outputs:
        raise NotApplicable("maxOutputDerivativeOrder is 0")

    def rates() -> tuple[np.ndarray, int]:
        unit = s.ready()
        driven(unit, 3)
        status, found = unit.output_derivatives(outputs, 1)
        unit.must(status, "GetOutputDerivatives")
        status, _ = unit.output_derivatives(outputs, highest + 1)
        unit.end()
        return found, status

    found, status = s.apart(rates)
    faults = [] if status >= DISCARD else [f"order {highest + 1} is answered, and {highest} is the highest declared"]
    if not s.varies:
        judge(faults)
        raise Unjudged("canHandleVariableCommunicationStepSize is false, so that there are no differences to compare")

    def slopes(size: float) -> np.ndarray:
        """Return the derivatives, and the contribution of a jump at the communication point to them."""
        one = s.ready()
        driven(one, 3)
        rows = [one.read(outputs)]
        for _ in range(4):
            one.step(size)
            rows.append(one.read(outputs))
        one.end()
        return np.tensordot([[-25 / 12, 4, -3, 4 / 3, -1 / 4], [1, -4, 6, -4, 1]], rows, 1) / size

    (wide, _), (narrow, jump) = (s.apart(partial(slopes, s.step / parts)) for parts in (32, 64))
    error = np.abs(wide - narrow)
    known = (error <= 0.05 * (1 + np.abs(narrow))) & (np.abs(jump) <= 0.05 * (1e-3 + np.abs(narrow)))
    if not known.any():
        judge(faults)
        raise Unjudged("the outputs are not smooth enough here to compare with differences")
    more, worst = _compared(
        found[known],
        narrow[known],
        error[known],
        lambda i: f"the rate of {[v.name for v, k in zip(outputs, known, strict=True) if k][i]}",
        _SLOPE,
    )
    text = f"{known.sum()} of {len(outputs)} outputs, to {worst:.0e} of the largest"
    return judge(faults + more, text)


@check(
    "flags.capabilities",
    "Declared capabilities work",
    "A function whose capability is declared succeeds; one whose capability is not declared does not pretend to",
    "4.3.1 Co-Simulation FMU; 2.1.8; 2.1.9",
    "Attributes of CoSimulation",
)
def capabilities(s: Session, task: Task) -> str:
    import ctypes

    from .unit import state_call

    faults, said = [], []

    def tried(name: str, declared: bool, call: Callable[[Unit], int]) -> None:
        def one() -> int:
            unit = s.ready()
            unit.step()
            status = call(unit)
            unit.end()
            return status

        status = s.apart(one)
        if declared and status > WARNING:
            faults.append(f"{name} is true, and the call ends with {shown(status)}")
        if not declared and status <= WARNING:
            said.append(f"{name} is false, and the call ends with {shown(status)}")

    def state(unit: Unit) -> int:
        handle = ctypes.c_void_p()
        return unit.call(state_call("GetFMUState", s.version), ctypes.byref(handle))

    tried("canGetAndSetFMUState", _can(s, "canGetAndSetFMUState"), state)
    if s.real_outputs and s.real_inputs:
        declared = s.flag("providesDirectionalDerivative", "providesDirectionalDerivatives")
        one = s.real_outputs[:1], s.real_inputs[:1], [1.0]
        tried("providesDirectionalDerivatives", declared, lambda unit: unit.directional(*one)[0])
    if s.real_outputs:
        order = int(s.flags.get("maxOutputDerivativeOrder", 0))
        if order:
            tried("maxOutputDerivativeOrder", True, lambda unit: unit.output_derivatives(s.real_outputs[:1], order)[0])
    if s.version == "2" and s.real_inputs and s.flag("canInterpolateInputs"):
        v = s.real_inputs[0]
        vr, first, value = (ctypes.c_uint * 1)(v.reference), (ctypes.c_int * 1)(1), (ctypes.c_double * 1)(0.0)
        text = f"vr=[{v.reference}], order=1"
        tried(
            "canInterpolateInputs",
            True,
            lambda unit: unit.call("SetRealInputDerivatives", vr, 1, first, value, said=text),
        )
    judge(faults)
    return "; ".join(said)


# Records --------------------------------------------------------------------------------------------------------------


def replayed(s: Session, task: Task, number: int) -> str:
    """Repeat a record and compare the results; rows may have inputs before or after they are set."""
    record = task.records[number]
    start, step = record["start_time"], record["step_size"]
    count = round((record["stop_time"] - start) / step)
    stimuli, wanted = record["stimuli"], record["references"]
    if wanted is None:
        raise Unjudged("the experiment has no reference results")
    names = (*wanted["names"], *record["parameters"], *(stimuli["names"] if stimuli else ()))
    missing = [name for name in names if name not in s.by_name]
    if missing:
        raise Fault(f"{missing[0]} is no variable of the FMU")
    outputs = [s.by_name[name] for name in wanted["names"]]
    times = start + step * np.arange(count + 1)
    table = np.array(stimuli["values"]) if stimuli else np.empty((0, 0))

    def apply(unit: Unit, t: float) -> None:
        for i, name in enumerate(stimuli["names"] if stimuli else ()):
            v = s.by_name[name]
            value = float(np.interp(t, stimuli["time"], table[:, i]))
            if v.type not in ("Real", "Float32", "Float64"):
                row = max(0, int(np.searchsorted(stimuli["time"], t + 1e-9 * step, side="right")) - 1)
                value = type(v.start or 0)(table[row, i])
            unit.must(unit.set(v, value), f"Set{v.type} of {name}")

    unit = s.unit()
    for name, value in record["parameters"].items():
        v = s.by_name[name]
        if v.declared == "Enumeration" and isinstance(value, str):
            raise Unjudged(f"{name} is given by the name of an item, which this checker does not look up")
        unit.must(unit.set(v, value), f"Set{v.type} of {name}")
    unit.must(unit.enter(start), "EnterInitializationMode")
    apply(unit, start)
    unit.must(unit.exit(), "ExitInitializationMode")
    rows = {"held": [unit.read(outputs)], "set": [unit.read(outputs)]}
    for t, onward in pairwise(times):
        unit.time = t
        unit.step(onward - t)  # the same sum as in the recording, for equal round-off
        rows["held"].append(unit.read(outputs))
        apply(unit, onward)
        rows["set"].append(unit.read(outputs))
    reference, at = np.array(wanted["values"]), np.array(wanted["time"])
    if at[0] < times[0] - 1e-6 * step or at[-1] > times[-1] + 1e-6 * step:
        raise Fault(f"its results end at {at[-1]:g} s, and the experiment at {times[-1]:g} s")
    faults, worst = [], 0.0
    for i, v in enumerate(outputs):
        columns = [np.interp(at, times, np.array(rows[key])[:, i]) for key in rows]
        largest = 1 + np.abs(reference[:, i]).max()
        apart = min(float(np.abs(each - reference[:, i]).max()) / largest for each in columns)
        worst = max(worst, apart if math.isfinite(apart) else math.inf)
        if not apart <= task.tolerance:
            faults.append(f"{v.name} is {apart:.1e} (over 1 and the largest value) from the reference results")
    limit = f"{task.tolerance:.0e} is asked"
    return judge([f"{each}; {limit}" for each in faults], f"{len(at)} rows of {len(outputs)} to {worst:.0e}; {limit}")
