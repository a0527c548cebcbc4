"""What a program of a scene is made of: calls of functions, choices, loops, three routines of linear algebra.

All work on values with names, which stand in one memory: fields of the instance (`alfmu.kernel.memory`), and what one
step of a program hands to later ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

from ..equations.types import Configuration
from ..method import singular

__all__ = [
    "Call",
    "Choice",
    "Factor",
    "Lanes",
    "LeastNorm",
    "Loop",
    "Plan",
    "Program",
    "Routine",
    "Solve",
    "Step",
    "Steps",
    "Traced",
    "called",
    "every",
    "renamed",
    "rewritten",
    "taken",
]


@dataclass(frozen=True)
class Call:
    """A function of the scene called on values, giving others."""

    function: str
    arguments: tuple[str, ...]
    results: tuple[str, ...]


@dataclass(frozen=True)
class Lanes:
    """Calls of one function, none of which takes what another one gives: made at once."""

    calls: tuple[Call, ...]

    @property
    def arguments(self) -> tuple[str, ...]:
        return tuple(name for call in self.calls for name in call.arguments)

    @property
    def results(self) -> tuple[str, ...]:
        return tuple(name for call in self.calls for name in call.results)


@dataclass(frozen=True)
class Choice:
    """Steps that are made where a number is not zero, and others where it is."""

    number: str
    nonzero: Steps = ()
    zero: Steps = ()


@dataclass(frozen=True)
class Loop:
    """Steps that are made while a number is not zero: at most so many times, or as often as a value says."""

    number: str
    most: int | str
    body: Steps


@dataclass(frozen=True)
class Routine:
    """Linear algebra that all scenes share, and no function of a scene does, on vectors of `side` numbers."""

    arguments: tuple[str, ...]
    results: tuple[str, ...]
    side: int
    count: int = 1


class Factor(Routine):
    """Factorise the matrix of count x count blocks (side, side), sums of the parts of their row by weights.

    `arguments` are the weights, by row and column, and the parts; `results` the factors and the order of their rows.
    """


class Solve(Routine):
    """Solve with these factors: `arguments` are the factors, their order, and `count` vectors of `side` numbers."""


class LeastNorm(Routine):
    """The least-squares solution of least norm of a system; `arguments` are its matrix (side, side) and its vector."""


Step = Call | Lanes | Choice | Loop | Routine

Steps = tuple[Step, ...]


@dataclass(frozen=True)
class Plan:
    """How often the loops of the method are unrolled in a step, and how it is judged whether that was enough."""

    iterations: int
    """Of multipliers in each evaluation."""
    corrections: int
    """Of q, and of v, after the step."""
    quick: bool = False
    """Whether few iterations are judged by how they shrink; otherwise the last change must be within the tolerance."""
    weighted: bool = False
    """Whether each constraint may have a penalty of its own."""
    spacing: float = singular.SPACING
    """Of the places from which limits are taken on the branch, over the step."""
    side: int = singular.PLACES
    """How many of these places there are on either side."""
    branch: bool = False
    """Whether each stage is brought to the branch of the motion that is followed, its limit taken where singular."""
    margins: bool = False
    """Whether the margin itself tells what is near a singular position, not only that it may be; where weighted."""

    gaining: bool = False
    """Whether evaluations go on, after these iterations, while each gains."""

    @property
    def own(self) -> str:
        """What the names of functions end in that depend on how far apart places are, and how many there are."""
        return "" if (self.spacing, self.side) == (Plan.spacing, Plan.side) else "_for_method"


@dataclass(frozen=True)
class Program:
    """A step of the motion, or what is read at an instant."""

    steps: Steps
    plan: Plan = Plan(0, 0)
    """What it was traced by; no loops of the method are in it where that is not given."""
    rule: str = ""
    """Name of the coefficients of a method of integration beside RK4."""
    evaluations: int = 0
    """Of accelerations in a step of such a method, but for those at the nodes of a pass of Newton's method."""
    nodes: int = 0
    history: int = 0
    """Numbers that such a method keeps from step to step."""


@dataclass(frozen=True, repr=False)
class Traced(Configuration):
    """A configuration with its programs, whose functions are among its own."""

    kernel: dict[str, Program] = field(default_factory=dict)
    """The programs by name; of a scene from the cache without steps, which `controlled.whole` traces."""
    breaks: list[int] = field(default_factory=list)
    """Levels of what tells when something jumps or bends by itself (`kernel.breaks`)."""
    library: Path | None = None
    """The functions of the scene compiled (`alfmu.runtime.compiled.compiled_scene`), where they are."""


def every(steps: Iterable[Step]) -> Iterator[Step]:
    """Each step in order, those inside choices, loops and lanes after their own."""
    for step in steps:
        yield step
        yield from every(chain(*_inside(step)))


def _inside(step: Step) -> tuple[Steps, ...]:
    if isinstance(step, Choice):
        return step.nonzero, step.zero
    if isinstance(step, Lanes):
        return (step.calls,)
    return (step.body,) if isinstance(step, Loop) else ()


def called(program: Program) -> Iterator[str]:
    """Names of the functions that a program may call, in order and with repetition."""
    return (step.function for step in every(program.steps) if isinstance(step, Call))


def rewritten(steps: Iterable[Step], change: Callable[[Call | Routine], Iterable[Step]]) -> Steps:
    """The same steps, with what stands for each call and each routine in its place, inside choices, loops and
    lanes too."""

    def each(step: Step) -> Iterable[Step]:
        if isinstance(step, Choice):
            return (replace(step, nonzero=rewritten(step.nonzero, change), zero=rewritten(step.zero, change)),)
        if isinstance(step, Loop):
            return (replace(step, body=rewritten(step.body, change)),)
        if isinstance(step, Lanes):
            return map(Lanes, zip(*map(change, step.calls), strict=True))
        return change(step)

    return tuple(chain(*map(each, steps)))


def renamed(steps: Iterable[Step], names: Mapping[str, str]) -> Steps:
    """The same steps on values of other names."""

    def new(name: str) -> str:
        return names.get(name, name)

    def each(step: Step) -> Step:
        if isinstance(step, Choice):
            return Choice(new(step.number), renamed(step.nonzero, names), renamed(step.zero, names))
        if isinstance(step, Loop):
            most = new(step.most) if isinstance(step.most, str) else step.most
            return Loop(new(step.number), most, renamed(step.body, names))
        if isinstance(step, Lanes):
            return Lanes(tuple(each(call) for call in step.calls))
        return replace(step, arguments=tuple(map(new, step.arguments)), results=tuple(map(new, step.results)))

    return tuple(map(each, steps))


def taken(steps: Iterable[Step], wanted: Iterable[str] = ()) -> list[str]:
    """What has to be known before steps so that what is wanted is known after them."""
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
