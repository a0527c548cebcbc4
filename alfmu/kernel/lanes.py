"""Calls that a program repeats on other values, side by side: the places from which a limit is read, above all.

The runtime evaluates a function for several sets of values at once (`form.Lanes`), each number as it would be by
itself. Values that each repetition keeps for itself get names of their own; what comes after it knows none of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

from .form import Call, Choice, Lanes, Loop, Program, Step, Steps, every, renamed, taken

__all__ = ["laned"]

FEW = 4
"""Repetitions that go on one after the other: the time of so many single calls is that of a call in all lanes."""


def laned(program: Program, handed: Collection[str]) -> Program:
    """The same program, with calls that repeat on values of their own side by side; `handed` is known after it."""
    return replace(program, steps=_side_by_side(program.steps, handed))


def _side_by_side(steps: Steps, after: Collection[str]) -> Steps:
    made: list[Step] = []
    shapes = [_shape(step) for step in steps]
    at = 0
    while at < len(steps):
        period, count = _repetition(steps[at:], shapes[at:])
        end = at + period * count
        parts = None
        if count > FEW:
            known = {*after, *taken(steps[end:])}
            parts = _apart([steps[k : k + period] for k in range(at, end, period)], known)
        if parts:
            for each in zip(*parts, strict=True):
                made += [Lanes(each)] if isinstance(each[0], Call) else each
            at = end
        else:
            inner = isinstance(steps[at], Choice | Loop)
            made.append(_inside(steps[at], {*after, *taken(steps[at + 1 :])}) if inner else steps[at])
            at += 1
    return tuple(made)


def _inside(step: Step, after: Collection[str]) -> Step:
    if isinstance(step, Choice):
        return Choice(step.number, *(_side_by_side(way, after) for way in (step.nonzero, step.zero)))
    if isinstance(step, Loop):
        return replace(step, body=_side_by_side(step.body, {*after, *taken([step])}))
    return step


def _repetition(steps: Steps, shapes: Sequence[tuple]) -> tuple[int, int]:
    """How many steps are repeated from the first one on, and how often: the shortest that is more often than a few."""
    for period in range(1, len(steps) // (FEW + 1) + 1):
        count = 1
        while shapes[count * period : (count + 1) * period] == shapes[:period]:
            count += 1
        if count > FEW and _alone([steps[k * period : (k + 1) * period] for k in range(count)]):
            return period, count
    return 1, 1


def _shape(step: Step) -> tuple:
    """What a step is but for the names of its values."""
    return tuple((type(x), x.function if isinstance(x, Call) else None) for x in every([step]))


def _given(steps: Iterable[Step]) -> set[str]:
    return {name for step in every(steps) if not isinstance(step, Choice | Loop) for name in step.results}


def _alone(parts: Sequence[Steps]) -> bool:
    """Whether none of these takes what another one gives."""
    given = [_given(part) for part in parts]
    return all(
        not set(taken(part)) & set().union(*(x for k, x in enumerate(given) if k != i)) for i, part in enumerate(parts)
    )


def _apart(parts: Sequence[Steps], after: Collection[str]) -> list[Steps] | None:
    """The same with names of their own for what each keeps for itself; None where two give the same to what follows."""
    given = [_given(part) for part in parts]
    if len([name for x in given for name in x if name in after]) > len({name for x in given for name in x} & {*after}):
        return None
    return [
        renamed(part, {name: f"{name} in lane {k}" for name in given[k] if name not in after})
        for k, part in enumerate(parts)
    ]
