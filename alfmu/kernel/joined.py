"""Calls of a program joined into long functions: what they would compute twice is computed once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain, groupby

import casadi as ca

from ..equations import Equations
from ..equations.evaluation import with_functions
from .program import CHOICE, FACTOR, LEAST_NORM, LOOP, SOLVE, Layout

__all__ = ["LONGEST", "joined"]

LONGEST = 40000
"""Instructions up to which calls are joined; the programs of a larger scene stay calls of small functions."""

_APART = (CHOICE, LOOP, FACTOR, SOLVE, LEAST_NORM)
"""What stays between joined functions."""


def joined(equations: Equations, programs: Iterable[str]) -> Equations:
    """The same equations, the calls of these programs joined as far as choices, loops and routines let them be."""
    e = equations
    joining = _Joining(e)
    kernel = dict(e.kernel)
    for name in programs:
        if name in kernel:
            calls = joining.calls(name, kernel[name]["calls"], set(joining.sizes))
            kernel[name] = {**kernel[name], "calls": calls}
    return replace(with_functions(e, joining.functions), kernel=kernel)


class _Joining:
    def __init__(self, equations: Equations):
        self._e = equations
        self.sizes = {name: length for name, (_, length) in Layout(equations).fields.items()}
        self.functions: dict[str, ca.Function] = {}
        self._known: dict[str, str] = {}

    def calls(self, program: str, calls: list[list], after: set[str]) -> list[list]:
        """The same calls in fewer; `after` is what is wanted after them."""
        made: list[list] = []
        groups = [list(group) for _, group in groupby(calls, lambda call: call[0] in _APART)]
        for i, group in enumerate(groups):
            wanted = after.union(taken(chain(*groups[i + 1 :])))
            if group[0][0] not in _APART:
                made += self._together(program, group, wanted)
                continue
            for k, call in enumerate(group):
                later = wanted.union(taken(group[k + 1 :]))
                if call[0] == CHOICE:
                    made.append([CHOICE, call[1], *(self.calls(program, way, later) for way in call[2:])])
                elif call[0] == LOOP:
                    again = later.union(taken([call]))
                    made.append([*call[:3], self.calls(program, call[3], again)])
                else:
                    made.append(call)
        return made

    def _together(self, program: str, calls: list[list], wanted: set[str]) -> list[list]:
        small = self._e.functions
        if len(calls) == 1 or sum(small[name].n_instructions() for name, *_ in calls) > LONGEST:
            return calls
        inputs, outputs = taken(calls), [name for name in given(calls) if name in wanted]
        numbers = {name: i for i, name in enumerate(inputs)}

        def numbered(names: Iterable[str]) -> list[int]:
            return [numbers.setdefault(name, len(numbers)) for name in names]

        key = str(([(name, numbered(x), numbered(y)) for name, x, y in calls], numbered(outputs)))
        if key not in self._known:
            self._known[key] = f"{program}_{len(self.functions)}"
            self.functions[self._known[key]] = self._function(self._known[key], calls, inputs, outputs)
        return [[self._known[key], inputs, outputs]]

    def _function(self, name: str, calls: list[list], inputs: list[str], outputs: list[str]) -> ca.Function:
        lengths: dict[str, int] = {}
        for function, x, _ in calls:
            for i, each in enumerate(x):
                lengths.setdefault(each, self._e.functions[function].size1_in(i))
        arguments = [ca.SX.sym(each, lengths[each]) for each in inputs]
        known = dict(zip(inputs, arguments, strict=True))
        for function, x, y in calls:
            known |= zip(y, self._e.functions[function].call([known[each] for each in x]), strict=True)
        return ca.Function(name, arguments, [known[each] for each in outputs], {"cse": True})


def taken(calls: Iterable[list], wanted: Iterable[str] = ()) -> list[str]:
    """What has to be known before calls so that what is wanted is known after them."""
    names = dict.fromkeys(wanted)
    for name, *rest in reversed(list(calls)):
        if name == CHOICE:
            number, *ways = rest
            names = dict.fromkeys([number, *names, *chain(*(taken(way, names) for way in ways))])
        elif name == LOOP:
            number, times, again = rest
            more = [times] if isinstance(times, str) else []
            names = dict.fromkeys([number, *more, *names, *taken(again, names)])
        else:
            inputs, outputs, *_ = rest
            for each in outputs:
                names.pop(each, None)
            names.update(dict.fromkeys(inputs))
    return list(names)


def given(calls: Iterable[list]) -> list[str]:
    """What calls give."""
    return list(dict.fromkeys(chain(*(call[2] for call in calls))))
