"""Evaluate repeated calls of a program side by side, mainly those at the positions of a limit.

The runtime evaluates a function for several sets of values at once (`form.Lanes`), with the results of single calls.
Temporary values of each repetition get distinct names.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

from .form import Call, Choice, Lanes, Loop, Program, Step, Steps, every, inside, renamed, taken

FEW = 4
"""Repetitions up to which calls stay sequential: this many single calls take the time of one call in all lanes."""


def laned(program: Program, handed: Collection[str]) -> Program:
    """Return the program with independent repeated calls side by side; `handed` are the values needed after it."""
    return replace(program, steps=_side_by_side(program.steps, handed))


def _side_by_side(steps: Steps, after: Collection[str]) -> Steps:
    made: list[Step] = []
    shapes = [shape(step) for step in steps]
    at = 0
    while at < len(steps):
        period, count = repetition(steps[at:], shapes[at:])
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
            made.append(inside(steps[at], _side_by_side, {*after, *taken(steps[at + 1 :])}) if inner else steps[at])
            at += 1
    return tuple(made)


def repetition(steps: Steps, shapes: Sequence[tuple]) -> tuple[int, int]:
    """Return length and count of the shortest repetition from the first step on that occurs more than `FEW` times."""
    for period in range(1, len(steps) // (FEW + 1) + 1):
        count = 1
        while shapes[count * period : (count + 1) * period] == shapes[:period]:
            count += 1
        if count > FEW and _alone([steps[k * period : (k + 1) * period] for k in range(count)]):
            return period, count
    return 1, 1


def shape(step: Step) -> tuple:
    """Return a step without the names of its values."""
    return tuple((type(x), x.function if isinstance(x, Call) else None) for x in every([step]))


def _given(steps: Iterable[Step]) -> set[str]:
    return {name for step in every(steps) if not isinstance(step, Choice | Loop) for name in step.results}


def _alone(parts: Sequence[Steps]) -> bool:
    """Return whether no part uses results of another part."""
    given = [_given(part) for part in parts]
    return all(
        not set(taken(part)) & set().union(*(x for k, x in enumerate(given) if k != i)) for i, part in enumerate(parts)
    )


def _apart(parts: Sequence[Steps], after: Collection[str]) -> list[Steps] | None:
    """Return the parts with distinct names for temporary values; None if two parts give the same result to
    later steps."""
    given = [_given(part) for part in parts]
    if len([name for x in given for name in x if name in after]) > len({name for x in given for name in x} & {*after}):
        return None
    return [
        renamed(part, {name: f"{name} in lane {k}" for name in given[k] if name not in after})
        for k, part in enumerate(parts)
    ]
