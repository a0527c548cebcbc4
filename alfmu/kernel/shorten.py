"""Shorten programs: parts that occur more than once are stored once, and run again from there.

`alike` gives values of repeated parts, mainly those at the positions of a limit, the same names, so that the parts are
equal but for copies of values into and out of them. `shortened` replaces equal sequences in the words of a program by
references to the first one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import casadi as ca

from ..equations.evaluation import with_functions
from .form import Call, Choice, Loop, Step, Steps, Traced, every, renamed, taken
from .lanes import repetition, shape
from .scene import AGAIN, CALLS

CALL, CHOICE, LOOP = (CALLS.index(kind) for kind in (Call, Choice, Loop))


def alike(equations: Traced) -> Traced:
    """Return equations whose programs have equal steps in repeated parts, and functions that copy values."""
    e, copies = equations, dict[str, ca.Function]()
    steps = {name: _Alike(e, copies, program.steps).steps for name, program in e.kernel.items()}
    kernel = {name: replace(program, steps=steps[name]) for name, program in e.kernel.items()}
    return replace(with_functions(e, copies), kernel=kernel)


class _Alike:
    """A program with equal repeated parts."""

    def __init__(self, equations: Traced, copies: dict[str, ca.Function], steps: Steps):
        self._copies = copies
        self._lengths = dict[str, int]()
        for call in every(steps):
            if isinstance(call, Call):
                f = equations.functions[call.function]
                known = [*map(f.nnz_in, range(f.n_in())), *map(f.nnz_out, range(f.n_out()))]
                self._lengths |= zip((*call.arguments, *call.results), known, strict=True)
        parts = defaultdict[tuple, list[Steps]](list)
        for part in _parts(steps):
            parts[tuple(map(shape, part))].append(part)
        self._made = {part: made for same in parts.values() for part, made in self._equal(same)}
        self.steps: Steps = self._of(steps)

    def _of(self, steps: Steps) -> Steps:
        """Return steps with equal parts in place of the repeated ones."""
        found: list[Step] = []
        for part, repeated in _divided(steps):
            if repeated and part in self._made:
                found += self._made[part]
            elif isinstance(part[0], Choice):
                found.append(replace(part[0], nonzero=self._of(part[0].nonzero), zero=self._of(part[0].zero)))
            elif isinstance(part[0], Loop):
                found.append(replace(part[0], body=self._of(part[0].body)))
            else:
                found += part
        return tuple(found)

    def _equal(self, parts: Sequence[Steps]) -> Iterator[tuple[Steps, Steps]]:
        """Yield each of these parts of the same shape, and it with the names that all get, and copies."""
        names = [tuple(_names(part)) for part in parts]
        rows = list(dict.fromkeys(zip(*names, strict=True)))
        if any(len({row[k] for row in rows}) < len(rows) for k in range(len(parts))):
            return  # names that are equal in one part differ in another
        own = {row: f"{row[0]} again" for row in rows if len({*row}) > 1}
        for k, part in enumerate(parts):
            given = {name for step in every(part) if not isinstance(step, Choice | Loop) for name in step.results}
            before, new = taken(part, given), {row[k]: name for row, name in own.items()}
            first, last = ([name for name in new if name in some] for some in (before, given))
            yield part, (*self._copied(first, new), *renamed(part, new), *self._copied(last, new, back=True))

    def _copied(self, names: Sequence[str], new: Mapping[str, str], back: bool = False) -> Iterator[Call]:
        """Yield the call that copies values to those with the new names, or back from them."""
        if names:
            lengths = [self._lengths[name] for name in names]
            function, others = "_".join(["copy", *map(str, lengths)]), [new[name] for name in names]
            if function not in self._copies:
                values = [ca.SX.sym("x", length) for length in lengths]
                self._copies[function] = ca.Function(function, values, values)
            yield Call(function, *map(tuple, (others, names) if back else (names, others)))


def _divided(steps: Steps) -> Iterator[tuple[Steps, bool]]:
    """Yield the repeated parts of steps, and single steps between them."""
    shapes, at = [shape(step) for step in steps], 0
    while at < len(steps):
        period, count = repetition(steps[at:], shapes[at:])
        for _ in range(count):
            yield steps[at : at + period], count > 1
            at += period


def _parts(steps: Steps) -> Iterator[Steps]:
    """Yield the repeated parts of steps, also inside choices and loops."""
    for part, repeated in _divided(steps):
        if repeated:
            yield part
        elif isinstance(part[0], Choice):
            yield from _parts(part[0].nonzero)
            yield from _parts(part[0].zero)
        elif isinstance(part[0], Loop):
            yield from _parts(part[0].body)


def _names(steps: Iterable[Step]) -> Iterator[str]:
    """Yield the names of values, in order and with repetition."""
    for step in every(steps):
        if isinstance(step, Choice | Loop):
            yield step.number
            yield from [step.most] if isinstance(step, Loop) and isinstance(step.most, str) else []
        else:
            yield from (*step.arguments, *step.results)


class _Element(NamedTuple):
    """A step in the words of a program."""

    head: tuple[int, ...]
    """The words without lengths of blocks."""
    blocks: tuple[tuple[_Element, ...], ...] = ()


def shortened(words: Sequence[int], places: Sequence[int]) -> list[int]:
    """Return the words of a program with references for sequences that occurred before: AGAIN, the distance back to the
    first of its words, and their number. `places` are the numbers of arguments and results of each function."""
    elements, made = _read(words, places), _Shortened()
    made.block(elements)
    return made.words


def _read(words: Sequence[int], places: Sequence[int]) -> tuple[_Element, ...]:
    """Return the elements of words, which have calls, choices and loops only."""
    found, at = list[_Element](), 0
    while at < len(words):
        if words[at] == CALL:
            end = at + 2 + places[words[at + 1]]
            found.append(_Element(tuple(words[at:end])))
        else:
            counts = words[at + 2 : at + 4] if words[at] == CHOICE else words[at + 3 : at + 4]
            head = words[at : at + 2] if words[at] == CHOICE else words[at : at + 3]
            ends = [at + 4, *(at + 4 + sum(counts[: k + 1]) for k in range(len(counts)))]
            blocks = (_read(words[i:j], places) for i, j in pairwise(ends))
            found.append(_Element(tuple(head), tuple(blocks)))
            end = ends[-1]
        at = end
    return tuple(found)


class _Shortened:
    """Words of a program under construction."""

    def __init__(self) -> None:
        self.words = list[int]()
        self._blocks = list[list[tuple[int, int, tuple[_Element, ...]]]]()
        """Of each block, first word, end and elements of each item, which may be a reference to several elements."""

    def block(self, elements: Sequence[_Element]) -> None:
        """Append a block."""
        own = list[tuple[int, int, tuple[_Element, ...]]]()
        self._blocks.append(own)
        at = 0
        while at < len(elements):
            begin, (length, first, end) = len(self.words), self._before(elements[at:])
            if length:
                self.words += [AGAIN, begin - first, end - first]
            else:
                self._element(elements[at])
            own.append((begin, len(self.words), tuple(elements[at : at + max(length, 1)])))
            at += max(length, 1)

    def _element(self, element: _Element) -> None:
        self.words += element.head
        lengths = len(self.words)
        self.words += [0] * len(element.blocks)
        for k, block in enumerate(element.blocks):
            begin = len(self.words)
            self.block(block)
            self.words[lengths + k] = len(self.words) - begin

    def _before(self, elements: Sequence[_Element]) -> tuple[int, int, int]:
        """Return number, first word and end of the longest sequence so far that is the same as the next elements; zeros
        if it is no longer than a reference."""
        best = 0, 0, 0
        for block in self._blocks:
            for k in range(len(block)):
                length = 0
                for _, end, items in block[k:]:
                    if tuple(elements[length : length + len(items)]) != items:
                        break
                    length += len(items)
                    if length > best[0] and end - block[k][0] > 3:
                        best = length, block[k][0], end
        return best
