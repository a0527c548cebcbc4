"""The programs of a scene as functions of CasADi: calls of small functions fused into long ones.

In a long function what its parts would compute twice is computed once, and operations are in runs
(`alfmu.kernel.order`). A program is one such function where it is not too long for that. Otherwise its calls are fused
between choices, and a part that is made again and again (an evaluation at several places) is fused once and called.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain, groupby, product

import casadi as ca

from ..equations import Equations
from .order import in_runs
from .program import CHOICE, FACTOR, LOOP, SOLVE, STAGED, Layout, Program, given

__all__ = ["FLAT", "functions_of", "program_function", "staged"]

_APART = (LOOP, FACTOR, SOLVE)
"""What stays between fused functions."""

FLAT = 40000
"""Instructions up to which calls are fused; more stay calls, and all do in a scene whose quick step has more."""


def program_function(equations: Equations, name: str) -> ca.Function:
    """A program of the kernel as a function of z, u, p, k, dt; built when it is first wanted, and kept.

    Programs that are the same are one function.
    """
    built, kernel = equations.programs, equations.kernel
    if name not in built:
        same = next((other for other in built if kernel.get(other) == kernel[name]), None)
        built[name] = built[same] if same else _Fusion(equations).program(kernel[name])
    return built[name]


def functions_of(equations: Equations, name: str) -> dict[str, ca.Function]:
    """All functions that a program is run by, under the names by which `Equations.programs` keeps them."""
    if name not in STAGED:
        return {name: program_function(equations, name)}
    staged(equations, name)
    return {key: f for key, f in equations.programs.items() if key.startswith(f"{name}.")}


def staged(equations: Equations, name: str) -> list[list]:
    """A program of a method with its calls fused as far as loops and routines let them; what they call is kept.

    Names of functions are those of `Equations.programs`.
    """
    e, fusion, fields = equations, None, Layout(equations).fields
    sizes = {name: length for name, (_, length) in fields.items()}

    def function(calls: list[list], inputs: list[str], outputs: list[str]) -> str:
        nonlocal fusion
        key = f"{name}.{len(made)}"
        if key not in e.programs:
            fusion = fusion or _Fusion(e)
            e.programs[key] = fusion.stage(calls, {name: sizes[name] for name in inputs}, outputs)
        made.append(key)
        sizes.update({name: e.programs[key].size1_out(i) for i, name in enumerate(outputs)})
        return key

    def stages(calls: list[list], after: set[str]) -> list[list]:
        found, groups = [], [list(group) for _, group in groupby(calls, lambda call: call[0] in _APART)]
        for i, group in enumerate(groups):
            wanted = after.union(_taken(chain(*groups[i + 1 :])))
            if group[0][0] not in _APART:
                inputs, outputs = _taken(group), [name for name in _made(group) if name in wanted]
                found.append([function(group, inputs, outputs), inputs, outputs])
                continue
            for k, call in enumerate(group):
                if call[0] == LOOP:
                    _, number, times, again = call
                    later = wanted.union(_taken(group[k:]), _taken(again))
                    found.append([LOOP, number, times, stages(again, later)])
                else:
                    mark, _, outputs, n, s = call
                    lengths = [(n * s) ** 2, n * s] if mark == FACTOR else [n * s]
                    sizes.update(zip(outputs, lengths, strict=True))
                    found.append(call)
        return found

    made: list[str] = []
    return stages(e.kernel[name]["calls"], set(fields))


class _Fusion:
    """Fuses the calls of a program; a part that comes again is built once."""

    def __init__(self, equations: Equations):
        layout = Layout(equations)
        self._small, self._fields, self._inputs = equations.functions, layout.fields, given(layout)
        self._most = FLAT if self._size(equations.kernel["quick"]["calls"]) <= FLAT else 0
        self._long: dict[str, ca.Function] = {}

    def program(self, program: Program) -> ca.Function:
        """A program in one function without calls, or in one that calls its parts."""
        calls = program["calls"]
        outputs = calls[-1][-1]
        known = {name: ca.MX.sym(name, self._fields[name][1]) for name in self._inputs}
        if self._parts(calls) == [calls] and self._fits(calls):
            return self._fused(calls, known, outputs)
        return self._function("program", calls, known, outputs)

    def stage(self, calls: list[list], sizes: Mapping[str, int], outputs: list[str]) -> ca.Function:
        """What calls give, as a function of what is taken by them."""
        known = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
        if self._parts(calls) == [calls] and self._fits(calls):
            return self._fused(calls, known, outputs)
        return self._function("stage", calls, known, outputs)

    def _function(self, name: str, calls: list[list], known: dict[str, ca.MX], outputs: list[str]) -> ca.Function:
        """What calls give as a function of what is known before them, each part fused if it is not too long."""
        arguments = list(known.values())
        parts = self._parts(calls)
        for i, part in enumerate(parts):
            wanted = _taken(chain(*parts[i + 1 :]), outputs)
            make = self._choice if part[0][0] == CHOICE else self._call if self._fits(part) else self._calls
            known |= make(part, known, wanted)
        return ca.Function(name, arguments, [known[name] for name in outputs])

    def _choice(self, part: list[list], known: Mapping[str, ca.MX], wanted: Iterable[str]) -> dict[str, ca.MX]:
        """The results of a choice that are wanted."""
        [[_, number, *ways]] = part
        made = [set(_made(way)) for way in ways]
        # What one way makes may be known before it.
        outputs = [name for name in wanted if any(name in way for way in made)]
        inputs = list(dict.fromkeys(chain(*(_taken(way, outputs) for way in ways))))
        functions = []
        for way in ways:
            own = {name: ca.MX.sym(name, known[name].sparsity()) for name in inputs}
            functions.append(self._function("way", way, own, outputs))
        choice = ca.Function.if_else("choice", *functions)
        return dict(zip(outputs, choice.call([known[name] for name in (number, *inputs)]), strict=True))

    def _calls(self, part: list[list], known: Mapping[str, ca.MX], wanted: Iterable[str]) -> dict[str, ca.MX]:
        """The results of calls as they are."""
        results = dict(known)
        for name, inputs, outputs in part:
            results |= zip(outputs, self._small[name].call([results[i] for i in inputs]), strict=True)
        return results

    def _call(self, part: list[list], known: Mapping[str, ca.MX], wanted: Iterable[str]) -> dict[str, ca.MX]:
        """The results of calls that are wanted, by one call of a function that they are fused into."""
        inputs = {name: known[name] for name in _taken(part)}
        outputs = [name for name in _made(part) if name in wanted]
        results = self._fused(part, inputs, outputs).call(list(inputs.values()))
        return dict(zip(outputs, results, strict=True))

    def _fused(self, calls: list[list], inputs: Mapping[str, ca.MX], outputs: list[str]) -> ca.Function:
        """Calls as one function without calls, the same for the same calls under other names."""
        numbers = {name: str(i) for i, name in enumerate(inputs)}

        def numbered(names: Iterable[str]) -> list[str]:
            return [numbers.setdefault(name, str(len(numbers))) for name in names]

        renamed = [(name, numbered(x), numbered(y)) for name, x, y in calls]
        key = str((renamed, numbered(outputs)))
        if key not in self._long:
            known = {numbers[name]: ca.SX.sym(name, x.sparsity()) for name, x in inputs.items()}
            arguments = list(known.values())
            for name, x, y in renamed:
                known |= zip(y, self._small[name].call([known[i] for i in x]), strict=True)
            results = [known[i] for i in numbered(outputs)]
            self._long[key] = in_runs(ca.Function("fused", arguments, results, {"cse": True}))
        return self._long[key]

    def _parts(self, calls: list[list]) -> list[list[list]]:
        """Calls in parts, each to be fused for itself, between choices and around what is most of the work."""
        parts = []
        for choice, group in groupby(calls, lambda call: call[0] == CHOICE):
            together = list(group)
            parts += [[call] for call in together] if choice else self._split(together)
        return [part for part in parts if part]

    def _split(self, calls: list[list]) -> list[list[list]]:
        """Calls apart from what is most of the work, a call or each round of a sequence, as other parts may have it."""
        names, sizes = [call[0] for call in calls], [self._size([call]) for call in calls]
        most, found = sum(sizes) / 2, None
        for begin, length in product(range(len(calls)), range(1, len(calls) // 2 + 1)):
            end = begin + length
            while names[end : end + length] == names[begin : begin + length]:
                end += length
            again = sum(sizes[begin + length : end]) or (sizes[begin] if length == 1 else 0)
            if again > most:
                most, found = again, (begin, length, end)
        if not found:
            return [calls]
        begin, length, end = found
        rounds = [calls[i : i + length] for i in range(begin, end, length)]
        return [*self._split(calls[:begin]), *rounds, *self._split(calls[end:])]

    def _fits(self, calls: list[list]) -> bool:
        return self._size(calls) <= self._most

    def _size(self, calls: list[list]) -> int:
        return sum(self._small[call[0]].n_instructions() for call in calls)


def _taken(calls: Iterable[list], wanted: Iterable[str] = ()) -> list[str]:
    """What has to be known before calls so that what is wanted is known after them."""
    names = dict.fromkeys(wanted)
    for name, *rest in reversed(list(calls)):
        if name == CHOICE:
            number, *ways = rest
            names = dict.fromkeys([number, *chain(*(_taken(way, names) for way in ways))])
        elif name == LOOP:
            number, _, again = rest
            names = dict.fromkeys([number, *names, *_taken(again, names)])
        else:
            inputs, outputs, *_ = rest
            for each in outputs:
                names.pop(each, None)
            names.update(dict.fromkeys(inputs))
    return list(names)


def _made(calls: Iterable[list]) -> list[str]:
    """What calls give, whatever is chosen."""
    names: dict[str, None] = {}
    for name, *rest in calls:
        if name == CHOICE:
            names |= dict.fromkeys(chain(*map(_made, rest[1:])))
        else:
            names |= dict.fromkeys(rest[1])
    return list(names)
