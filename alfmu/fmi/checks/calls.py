"""Checks of the status of calls with illegal arguments, in the wrong order, and repeated many times."""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from .registry import RISKY, NotApplicable, Task, Unjudged, check, judge
from .unit import DISCARD, FATAL, WARNING, Broken, Session, Unit, Variable, shown

LEAK = 10_000
"""Memory [bytes] that an instance may leak: a study of 100,000 runs then leaks a gigabyte. Pages and the allocator add
some hundred bytes of noise to the mean of 200 instances."""

_INSTANCES, _SECONDS, _WARM = 200, 3.0, 40
"""Number of instances that are created and freed, their time limit [s], and the number before memory is measured."""

_ILLEGAL = (
    "When detecting illegal arguments or a function call not allowed in the current state, the FMU returns Error; it "
    "need not detect them, and then hides mistakes of importers"
)


def refused(unit: Unit, status: int, running: bool) -> str:
    """Return how a call with an illegal argument was rejected, at once or by the next call that counts; empty if it was
    not.

    FMUs whose wrapper has no status for it reject a value when the initialisation ends, or in the next step.
    """
    if status >= DISCARD:
        return f"by {shown(status)}"
    calls: list[Callable[[], int]] = [lambda: unit.step_raw(unit.time, unit.session.step)]
    if not running:
        calls = [unit.enter, unit.exit]
    for call in calls:
        if (later := call()) >= DISCARD:
            return f"later, by {shown(later)} of the next {'step' if running else 'initialisation'}"
    return ""


def unused(session: Session) -> list[int]:
    """Return value references without a variable."""
    known = {v.reference for v in session.variables} | {v.valueReference for v in session.description.modelVariables}
    near = max(known, default=0) + 1000
    return [each for each in (near, 0xFFFFFFFE) if each not in known]


def sample(v: Variable) -> object:
    """Return a legal value of a variable."""
    if v.start is not None:
        return v.start
    if v.items:
        return v.items[0]
    return {"String": "", "Boolean": False}.get(v.type, 0 if v.minimum is None else v.minimum)


def value_of(kind: str) -> object:
    return "" if kind == "String" else False if kind == "Boolean" else 0


@check(
    "api.version",
    "The library reports its version of FMI",
    "GetVersion returns the version of the headers; in FMI 2 the platform's types are the default ones",
    "2.1.4 Inquire Platform and Version Number of Header Files",
    "Inquire Version Number of Header Files",
    after=None,
)
def version(s: Session, task: Task) -> str:
    s.journal.say(s.name("GetVersion"))
    said = (getattr(s.library, s.name("GetVersion"))() or b"").decode("utf-8", "replace")
    faults = [] if said.startswith(f"{s.version}.") else [f"it reports {said!r}, the description {s.version}"]
    if s.version == "2":
        s.journal.say("fmi2GetTypesPlatform")
        platform = (s.library.fmi2GetTypesPlatform() or b"").decode("utf-8", "replace")
        faults += [] if platform == "default" else [f"its types are those of {platform!r}"]
    return judge(faults, said)


def _got(s: Session, kind: str, reference: int) -> tuple[int, list[object]]:
    """Return status and values of a reference, read as this type by a new instance."""
    unit = s.ready()
    found = unit.get_raw(kind, [reference])
    unit.end()
    return found


@check(
    "reference.get",
    "Reading an unknown value reference is refused",
    _ILLEGAL,
    "2.1.7 Getting and Setting Variable Values",
    "Status Returned by Functions",
    fault=RISKY,
)
def get_unknown(s: Session, task: Task) -> str:
    faults: list[str] = []
    ways: dict[str, list[str]] = {}
    for kind in s.types:
        for reference in unused(s):
            status, values = s.apart(partial(_got, s, kind, reference))
            ways.setdefault(shown(status), []).append(kind)
            if status <= WARNING:
                faults.append(f"{s.name(f'Get{kind}')} of reference {reference}, which no variable has, gives {values}")
    return judge(faults, "; ".join(f"{way}: {', '.join(dict.fromkeys(kinds))}" for way, kinds in ways.items()))


@check(
    "reference.set",
    "Setting an unknown value reference is refused",
    _ILLEGAL,
    "2.1.7 Getting and Setting Variable Values",
    "Status Returned by Functions",
    fault=RISKY,
)
def set_unknown(s: Session, task: Task) -> str:
    def one(kind: str, reference: int) -> tuple[int, str]:
        unit = s.unit()
        status = unit.set_raw(kind, [reference], [value_of(kind)])
        how = refused(unit, status, running=False)
        unit.end()
        return status, how

    faults: list[str] = []
    ways: dict[str, list[str]] = {}
    for kind in s.types:
        for reference in unused(s):
            status, how = s.apart(partial(one, kind, reference))
            if how:
                ways.setdefault(how, []).append(kind)
            else:
                name = s.name(f"Set{kind}")
                faults.append(f"{name} of reference {reference}, which no variable has, ends with {shown(status)}")
    return judge(faults, "; ".join(f"{way}: {', '.join(dict.fromkeys(kinds))}" for way, kinds in ways.items()))


@check(
    "reference.type",
    "A variable is read only by the function of its type",
    "The type of a variable determines the function that gets and sets it; anything else is an illegal argument",
    "2.1.7 Getting and Setting Variable Values",
    "Getting and Setting Variable Values",
    fault=RISKY,
)
def wrong_type(s: Session, task: Task) -> str:
    if s.version == "2":
        raise NotApplicable("in FMI 2 variables of different types may have the same reference")
    faults = []
    for kind in dict.fromkeys(v.type for v in s.variables):
        v = next(v for v in s.variables if v.type == kind)
        others = [other for other in ("Float64", "Int32", "Boolean", "String") if other != kind]
        found = [(other, s.apart(partial(_got, s, other, v.reference))[0]) for other in others]
        faults += [
            f"{s.name(f'Get{other}')} of {v.name}, a {kind}, ends with {shown(status)}"
            for other, status in found
            if status <= WARNING
        ]
    return judge(faults)


@check(
    "set.output",
    "Outputs and constants cannot be set",
    "An output is calculated by the FMU and a constant never changes: neither is set once initialisation has begun",
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    "State: Initialization Mode, and Status Returned by Functions",
    fault=RISKY,
)
def set_output(s: Session, task: Task) -> str:
    chosen = [v for v in s.variables if v.causality == "output" or v.variability == "constant"]
    chosen = [v for v in chosen if v.initial in ("calculated", "exact")]
    if not chosen:
        raise NotApplicable("there are no outputs or constants")

    def one(v: Variable) -> list[str]:
        unit = s.ready()
        status, value = unit.get(v)
        status = unit.set(v, value)
        taken = not refused(unit, status, running=True)
        unit.end()
        return [f"{v.name}, whose causality is {v.causality}, is set with {shown(status)}"] if taken else []

    each = {v.type: v for v in reversed(chosen)}.values()
    return judge([fault for v in each for fault in s.apart(partial(one, v))])


@check(
    "set.parameter",
    "Fixed parameters cannot be set once the run has begun",
    "A parameter with variability fixed does not change after initialisation",
    "2.2.7 Definition of Model Variables (variability), 4.2.4",
    "State: Step Mode, and Status Returned by Functions",
    fault=RISKY,
)
def set_fixed(s: Session, task: Task) -> str:
    fixed = [v for v in s.of("parameter") if v.variability == "fixed"]
    if not fixed:
        raise NotApplicable("there are no fixed parameters")

    def one(v: Variable) -> list[str]:
        unit = s.ready()
        status = unit.set(v, sample(v))
        taken = not refused(unit, status, running=True)
        unit.end()
        return [f"{v.name}, which is fixed, is set with {shown(status)} between steps"] if taken else []

    each = {v.type: v for v in reversed(fixed)}.values()
    return judge([fault for v in each for fault in s.apart(partial(one, v))])


@check(
    "order.calls",
    "Calls in the wrong order are refused",
    f"{_ILLEGAL} (FMI 2 forbids the calls and names no status)",
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    "Status Returned by Functions, and State Machine for Co-Simulation",
    fault=RISKY,
)
def order(s: Session, task: Task) -> str:
    def entered(unit: Unit) -> Unit:
        unit.must(unit.enter(), "EnterInitializationMode")
        return unit

    def ended(unit: Unit) -> Unit:
        unit.must(unit.terminate(), "Terminate")
        return unit

    cases: list[tuple[str, Callable[[], int]]] = []

    def case(said: str, made: Callable[[], Unit], call: Callable[[Unit], int]) -> None:
        def one() -> int:
            unit = made()
            status = call(unit)
            unit.end()
            return status

        cases.append((said, one))

    def step(unit: Unit) -> int:
        return unit.step_raw(unit.time, s.step)

    case("a step before initialisation", s.unit, step)
    case("a step during initialisation", lambda: entered(s.unit()), step)
    case("the end of an initialisation that has not begun", s.unit, Unit.exit)
    case("initialisation begun twice", lambda: entered(s.unit()), Unit.enter)
    case("initialisation after initialisation", s.ready, Unit.enter)
    case("Terminate before initialisation", s.unit, Unit.terminate)
    case("Terminate twice", lambda: ended(s.ready()), Unit.terminate)
    case("a step after Terminate", lambda: ended(s.ready()), step)
    taken: list[str] = []
    ways: dict[str, list[str]] = {}
    for said, one in cases:
        if (status := s.apart(one)) <= WARNING:
            taken.append(said)
        else:
            ways.setdefault(shown(status), []).append(said)
    text = "; ".join(f"{way}: {', '.join(each)}" for way, each in ways.items())
    if taken and s.version == "2":
        raise Unjudged(f"FMI 2 names no status; it takes {', '.join(taken)}")
    return judge([f"it takes {each}" for each in taken], text)


@check(
    "logging.categories",
    "The declared categories can be chosen, and no others",
    "The allowed values of categories are those of LogCategories",
    "2.1.5 Creation, Destruction and Logging of FMU Instances; 2.2.4",
    "SetDebugLogging, and Definition of Log Categories",
)
def categories(s: Session, task: Task) -> str:
    known = [each.name for each in s.description.logCategories]
    if not known:
        raise NotApplicable("LogCategories declares none")

    def chosen(name: str) -> int:
        unit = s.unit()
        status = unit.logging(True, [name])
        unit.end()
        return status

    found = {name: s.apart(partial(chosen, name)) for name in known}
    refusals = {name: shown(status) for name, status in found.items() if status > WARNING}
    faults = [f"the declared category {name!r} is refused with {status}" for name, status in refusals.items()]
    status = s.apart(partial(chosen, "no_category_of_this_name"))
    if status == 0 and s.version == "2":
        judge(faults)
        raise Unjudged("the declared ones are accepted, and so is an unknown one, for which FMI 2 names no status")
    if status == 0:
        faults.append("a category that is not declared is accepted without a warning")
    return judge(faults, ", ".join(known))


@check(
    "logging.errors",
    "Errors are explained",
    "The FMU calls the logger, where logging is on, before it returns Error",
    "2.1.3 Status Returned by Functions; 2.2.4",
    "Status Returned by Functions and Logging Mechanism",
)
def errors(s: Session, task: Task) -> str:
    known = {each.name for each in s.description.logCategories}
    unit = s.ready()
    status, _ = unit.get_raw(s.types[1], [unused(s)[0]])
    said = [(category, text) for _, category, text in s.log]
    unit.end()
    if status <= WARNING:
        raise Unjudged("it refuses no unknown reference; see reference.get")
    faults = [] if said else [f"{s.name(f'Get{s.types[1]}')} ends with {shown(status)} and logs nothing"]
    # The standard allows undeclared categories.
    other = sorted({category for category, _ in said} - known) if known else []
    remark = f"; remark: the category {other[0]!r} is not declared" if other else ""
    return judge(faults, f"{said[0][1][:200]}{remark}" if said else "")


@check(
    "instance.two",
    "Two instances in one process do not disturb each other",
    "An FMU can be instantiated many times, unless canBeInstantiatedOnlyOncePerProcess is true",
    "2.1.5 Creation, Destruction and Logging of FMU Instances; 4.3.1",
    "Instantiation, and canBeInstantiatedOnlyOncePerProcess",
)
def two(s: Session, task: Task) -> str:
    from .motion import driven, unlike

    if s.flag("canBeInstantiatedOnlyOncePerProcess"):
        raise NotApplicable("canBeInstantiatedOnlyOncePerProcess is true")
    alone = driven(s.ready(), 12)
    first, second = s.ready(name="first"), s.ready(name="second")
    rows = []
    for k in range(12):
        rows.append(driven(first, 1, begin=k)[-1])
        driven(second, 1, begin=3 * k)  # a run with other inputs
    first.end()
    second.end()
    return judge(unlike(s, alone[1:], rows, "beside a second instance"))


@check(
    "instance.repeated",
    "Instances can be made and freed again and again",
    "FreeInstance frees all memory and other resources of an instance",
    "2.1.5 Creation, Destruction and Logging of FMU Instances",
    "FreeInstance",
)
def repeated(s: Session, task: Task) -> str:
    def resident() -> int:
        path = Path("/proc/self/statm")
        if path.is_file():
            import resource

            return int(path.read_text().split()[1]) * resource.getpagesize()
        if sys.platform == "win32":
            raise Unjudged("memory is not measured on Windows")
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

    def one() -> None:
        unit = s.ready()
        unit.step()
        unit.must(unit.terminate(), "Terminate")
        unit.free()

    began, made = time.monotonic(), 0
    for _ in range(_WARM):
        one()
    before = resident()
    while made < _INSTANCES and (made < 20 or time.monotonic() - began < _SECONDS):
        one()
        made += 1
    growth = (resident() - before) / made
    text = f"{max(0.0, growth) / 1000:.1f} kB for each of {made} instances"
    if growth > LEAK:
        judge([f"memory grows by {text}; {LEAK / 1000:g} kB is the limit"])
    return text


@check(
    "instance.end",
    "A run can be ended and freed in every state",
    "Outputs can be read after Terminate; FreeInstance is allowed in every state but during a step",
    "2.1.5, 2.1.6 Initialization, Termination, and Resetting an FMU",
    "State: Terminated, and FreeInstance",
)
def end(s: Session, task: Task) -> str:
    from .motion import unlike

    def early(begun: bool) -> None:
        unit = s.unit()
        if begun:
            unit.must(unit.enter(), "EnterInitializationMode")
        unit.free()

    faults = []
    for begun in (False, True):
        s.apart(partial(early, begun))
    unit = s.ready()
    unit.step()
    before = unit.read(s.numbers)
    if (status := unit.terminate()) > WARNING:
        faults.append(f"Terminate ends with {shown(status)}")
    else:
        try:
            if unlike(s, [before], [unit.read(s.numbers)], "after Terminate"):
                faults.append("outputs change at Terminate")
        except Broken as error:
            faults.append(f"after Terminate, {error}")
    if status != FATAL:
        unit.free()
    s.journal.say(f"{s.name('FreeInstance')}(NULL)")
    getattr(s.library, s.name("FreeInstance"))(None)
    return judge(faults)
