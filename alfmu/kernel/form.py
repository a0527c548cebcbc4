"""Elements of programs: calls of functions, choices, loops, three routines of linear algebra.

All operate on named values in one memory: fields of the instance (`alfmu.kernel.memory`), and values that one step of a
program passes to later ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TypeVar

from ..equations.types import Configuration
from ..method import singular


@dataclass(frozen=True)
class Call:
    """A call of a function of the scene on values, with named results."""

    function: str
    arguments: tuple[str, ...]
    results: tuple[str, ...]


@dataclass(frozen=True)
class Lanes:
    """Independent calls of one function, evaluated at the same time."""

    calls: tuple[Call, ...]

    @property
    def arguments(self) -> tuple[str, ...]:
        return tuple(name for call in self.calls for name in call.arguments)

    @property
    def results(self) -> tuple[str, ...]:
        return tuple(name for call in self.calls for name in call.results)


@dataclass(frozen=True)
class Choice:
    """Steps that run if a number is not zero, and others if it is."""

    number: str
    nonzero: Steps = ()
    zero: Steps = ()


@dataclass(frozen=True)
class Loop:
    """Steps that repeat while a number is not zero, at most a fixed number of times, or as often as a value says."""

    number: str
    most: int | str
    body: Steps


@dataclass(frozen=True)
class Routine:
    """Linear algebra common to all scenes, outside their functions, on vectors of `side` numbers."""

    arguments: tuple[str, ...]
    results: tuple[str, ...]
    side: int
    count: int = 1


class Factor(Routine):
    """Factorise a matrix of count x count blocks (side, side), each a weighted sum of the parts of its row.

    `arguments` are the weights, by row and column, and the parts; `results` the factors and the order of their rows.
    """


class Solve(Routine):
    """Solve with these factors: `arguments` are the factors, their order, and `count` vectors of `side` numbers."""


class LeastNorm(Routine):
    """The least-squares solution of least norm of a system; `arguments` are its matrix (side, side) and its vector."""


Step = Call | Lanes | Choice | Loop | Routine

Steps = tuple[Step, ...]

AnyCall = TypeVar("AnyCall", bound=Call | Routine)


@dataclass(frozen=True)
class Plan:
    """Numbers of unrolled iterations of the method in a step, and criteria for their convergence."""

    iterations: int
    """Multiplier iterations in each evaluation."""
    corrections: int
    """Corrections of q, and of v, after the step."""
    quick: bool = False
    """Whether convergence is judged by the rate of the changes; otherwise the last change must be within the
    tolerance."""
    weighted: bool = False
    """Whether each constraint may have its own penalty."""
    spacing: float = singular.SPACING
    """Spacing of the positions from which a limit is taken on the branch, over the step."""
    side: int = singular.PLACES
    """Number of these positions on either side."""
    branch: bool = False
    """Whether each stage is brought to the branch of the motion, and a limit is taken near a singular position."""
    margins: bool = False
    """Whether the margin itself, not where it may be small, tells that a step is near a singular position."""

    gaining: bool = False
    """Whether evaluations continue after these iterations while each gains."""

    @property
    def own(self) -> str:
        """Suffix of names of functions that depend on the spacing and number of positions."""
        return "" if (self.spacing, self.side) == (Plan.spacing, Plan.side) else "_for_method"


@dataclass(frozen=True)
class Program:
    """A program: a step of the motion, or the evaluation of outputs."""

    steps: Steps
    plan: Plan = Plan(0, 0)
    """Plan (iteration counts) used for tracing, None if it has no iterations of the method."""
    rule: str = ""
    """Name of the coefficients of an integrator other than RK4."""
    evaluations: int = 0
    """Number of evaluations of accelerations in a step, without those at the nodes in an iteration of
    Newton's method."""
    nodes: int = 0
    history: int = 0
    """Size of the history of an integrator."""


@dataclass(frozen=True, repr=False)
class Traced(Configuration):
    """A configuration with its programs; `functions` includes those that the programs call."""

    kernel: dict[str, Program] = field(default_factory=dict)
    """The programs by name; programs from the cache have no steps until `controlled.whole` traces them."""
    breaks: list[int] = field(default_factory=list)
    """Levels of the functions that change their sign at jumps and kinks (`kernel.breaks`)."""
    library: Path | None = None
    """Compiled functions of the scene (`alfmu.runtime.compiled.compiled_scene`); None if it is interpreted."""


def every(steps: Iterable[Step]) -> Iterator[Step]:
    """Yield each step in order, followed by those inside choices, loops and lanes."""
    for step in steps:
        yield step
        for part in _inside(step):
            yield from every(part)


def _inside(step: Step) -> tuple[Steps, ...]:
    if isinstance(step, Choice):
        return step.nonzero, step.zero
    if isinstance(step, Lanes):
        return (step.calls,)
    return (step.body,) if isinstance(step, Loop) else ()


def called(program: Program) -> Iterator[str]:
    """Yield names of the functions that a program may call, in order and with repetition."""
    return (step.function for step in every(program.steps) if isinstance(step, Call))


def rewritten(steps: Iterable[Step], change: Callable[[Call | Routine], Iterable[Step]]) -> Steps:
    """Return the steps with each call and routine replaced, also inside choices, loops and lanes."""

    def each(step: Step) -> Iterable[Step]:
        if isinstance(step, Choice):
            return (Choice(step.number, rewritten(step.nonzero, change), rewritten(step.zero, change)),)
        if isinstance(step, Loop):
            return (Loop(step.number, step.most, rewritten(step.body, change)),)
        if isinstance(step, Lanes):
            return map(Lanes, zip(*map(change, step.calls), strict=True))
        return change(step)

    return tuple(chain(*map(each, steps)))


def inside(step: Step, change: Callable[[Steps, set[str]], Steps], later: set[str]) -> Step:
    """Return a step with the steps inside a choice or a loop changed; `later` are the values needed after it."""
    if isinstance(step, Choice):
        return Choice(step.number, change(step.nonzero, later), change(step.zero, later))
    if isinstance(step, Loop):
        return replace(step, body=change(step.body, later.union(taken([step]))))
    return step


def renamed(steps: Iterable[Step], names: Mapping[str, str]) -> Steps:
    """Return the steps with values renamed."""

    def new(name: str) -> str:
        return names.get(name, name)

    def moved(step: AnyCall) -> AnyCall:
        return replace(step, arguments=tuple(map(new, step.arguments)), results=tuple(map(new, step.results)))

    def each(step: Step) -> Step:
        if isinstance(step, Choice):
            return Choice(new(step.number), renamed(step.nonzero, names), renamed(step.zero, names))
        if isinstance(step, Loop):
            most = new(step.most) if isinstance(step.most, str) else step.most
            return Loop(new(step.number), most, renamed(step.body, names))
        if isinstance(step, Lanes):
            return Lanes(tuple(map(moved, step.calls)))
        return moved(step)

    return tuple(map(each, steps))


def taken(steps: Iterable[Step], wanted: Iterable[str] = ()) -> list[str]:
    """Return the values that must be known before steps for `wanted` to be known after them."""
    names = dict.fromkeys(wanted)
    for step in reversed(list(steps)):
        if isinstance(step, Choice):
            names = dict.fromkeys([step.number, *names, *taken(step.nonzero, names), *taken(step.zero, names)])
        elif isinstance(step, Loop):
            most = [step.most] if isinstance(step.most, str) else []
            names = dict.fromkeys([step.number, *most, *names, *taken(step.body, names)])
        else:
            for each in step.results:
                names.pop(each, None)
            names.update(dict.fromkeys(step.arguments))
    return list(names)


def lifetimes(steps: Iterable[Step], begin: int = 0) -> dict[str, tuple[int, int]]:
    """Return the numbers of the first and of the last step that use each value, counted from `begin` through both parts
    of choices; whatever a loop uses lives from its beginning to its end."""
    found: dict[str, tuple[int, int]] = {}

    def live(names: Iterable[str], first: int, last: int) -> None:
        for name in names:
            known = found.get(name, (first, last))
            found[name] = min(known[0], first), max(known[1], last)

    at = begin
    for step in steps:
        first, inside = at, lifetimes(chain(*_inside(step)), at + 1)
        at = max((last for _, last in inside.values()), default=at) + 1
        if isinstance(step, Choice):
            live([step.number], first, first)
            for name, (begun, ended) in inside.items():
                live([name], begun, ended)
        elif isinstance(step, Loop):
            live([step.number, *([step.most] if isinstance(step.most, str) else []), *inside], first, at - 1)
        else:
            live([*step.arguments, *step.results], first, at - 1)
    return found
