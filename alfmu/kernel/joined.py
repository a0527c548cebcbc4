"""Join calls of a program into long functions, in which repeated operations are computed once
(`stream.Instructions`)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, groupby

import casadi as ca

from ..equations.evaluation import with_functions
from .form import Call, Program, Step, Steps, Traced, inside, taken
from .memory import Layout
from .stream import Instructions

LONGEST = 40000
"""Largest number of instructions of joined calls; programs of a larger scene call small functions."""


def joined(
    equations: Traced, programs: Iterable[str], handed: Iterable[str] = (), only: Collection[str] = ()
) -> Traced:
    """Return the equations with calls of these programs joined as far as choices, loops and routines allow.

    `handed` are values that they pass to other programs, besides the fields of the memory; `only` are the functions
    whose calls are joined, all if empty.
    """
    e = equations
    joining, fields = _Joining(e, only), {*Layout(e).fields, *handed}
    kernel: dict[str, Program] = dict(e.kernel)
    for name in programs:
        if name in kernel:
            kernel[name] = replace(kernel[name], steps=joining.steps(name, kernel[name].steps, fields))
    return replace(with_functions(e, joining.functions), kernel=kernel)


class _Joining:
    def __init__(self, equations: Traced, only: Collection[str]):
        self._e, self._only = equations, only
        self.functions: dict[str, ca.Function] = {}
        self._known: dict[tuple, str] = {}
        self._counts: dict[str, int] = {}
        """Instructions of functions without repeated operations."""

    def steps(self, program: str, steps: Steps, after: set[str]) -> Steps:
        """Return fewer equivalent steps; `after` are the values needed after them."""
        made: list[Step] = []
        at = 0
        for alone, group in groupby(steps, self._alone):
            part = tuple(group)
            at += len(part)
            if alone:
                for k, step in enumerate(part, at - len(part) + 1):
                    made.append(inside(step, partial(self.steps, program), after.union(taken(steps[k:]))))
            else:
                calls = [step for step in part if isinstance(step, Call)]
                made += self._together(program, calls, after.union(taken(steps[at:])))
        return tuple(made)

    def _alone(self, step: Step) -> bool:
        """Return whether a step is not joined with others."""
        return not isinstance(step, Call) or (bool(self._only) and step.function not in self._only)

    def _together(self, program: str, calls: Sequence[Call], wanted: set[str]) -> Sequence[Call]:
        small = self._e.functions
        if len(calls) == 1:
            return calls
        # Repeated operations do not count; they are searched for only if the limit is exceeded with them.
        counts = (small[call.function].n_instructions() for call in calls)
        if sum(counts) > LONGEST and sum(self._count(call.function) for call in calls) > LONGEST:
            return calls
        given = dict.fromkeys(chain(*(call.results for call in calls)))
        inputs, outputs = tuple(taken(calls)), tuple(name for name in given if name in wanted)
        numbers = {name: i for i, name in enumerate(inputs)}

        def numbered(names: Iterable[str]) -> tuple[int, ...]:
            return tuple(numbers.setdefault(name, len(numbers)) for name in names)

        key = *((x.function, numbered(x.arguments), numbered(x.results)) for x in calls), numbered(outputs)
        if key not in self._known:
            self._known[key] = f"{program}_{len(self.functions)}"
            self.functions[self._known[key]] = self._function(self._known[key], calls, inputs, outputs)
        return [Call(self._known[key], inputs, outputs)]

    def _count(self, function: str) -> int:
        if function not in self._counts:
            self._counts[function] = len(Instructions.of(self._e.functions[function]))
        return self._counts[function]

    def _function(self, name: str, calls: Sequence[Call], inputs: Sequence[str], outputs: Sequence[str]) -> ca.Function:
        functions, lengths = self._e.functions, dict[str, int]()
        for call in calls:
            for i, each in enumerate(call.arguments):
                lengths.setdefault(each, functions[call.function].size1_in(i))
        arguments = [ca.SX.sym(each, lengths[each]) for each in inputs]
        known = dict(zip(inputs, arguments, strict=True))
        for call in calls:
            results = functions[call.function].call([known[each] for each in call.arguments])
            known |= zip(call.results, results, strict=True)
        return ca.Function(name, arguments, [known[each] for each in outputs])  # encoding removes repeated operations
