"""Find periodic repetitions in a sequence of operations, which can become loops.

A mechanism of many equal parts has the same operations for each. In CasADi's depth-first order these follow each other
part by part, so that repetition is found by comparing the sequence with itself, shifted. Nothing is reordered.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .stream import INPUT, VALUE, Operations

FEWEST = 4
"""Least number of repetitions for a loop."""

SAVED = 40
"""Least number of operations that a loop must save."""

LONGEST = 2500
"""Largest number of operations in the body of a loop; compile time grows faster than linearly with it."""

_WINDOWS = (4, 16, 64, 256, 1024)
"""Lengths of windows compared to find candidates; long ones are not misled by repetition within a period."""

_NEAR = 24
"""Largest distance between operations that is part of a window's key."""

_MULTIPLES = range(1, 13)
"""Multiples of a period that may give indices a constant step."""

_TRIMMED = 2
"""Number of iterations at either end left to straight code to give the others' indices a constant step."""

_NONE = np.iinfo(np.int64).max
"""Marks a missing step."""

_LINE = 8
"""Number of table entries whose C text is as long as that of an operation."""

_STRAIGHT, _HEAD = 1.25, 40
"""Words of an operation in straight code, and of a loop besides its operations and tables, measured."""

_FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""An odd constant without pattern, for hashes."""


Numbers = Sequence[int] | NDArray


class Repeat(NamedTuple):
    """`times` repetitions of the same `period` operations from `start` on."""

    start: int
    period: int
    times: int

    @property
    def end(self) -> int:
        return self.start + self.period * self.times

    def passes(self, column: int) -> NDArray:
        """Return the numbers of one operation in all repetitions."""
        return self.start + column + self.period * np.arange(self.times)

    def columns(self, numbers: NDArray) -> Sequence[Numbers] | NDArray:
        """Return numbers of all operations, by operation of the period; plain lists for a single repetition."""
        columns = numbers[self.start : self.end].reshape(self.times, self.period).T
        return columns.tolist() if self.times == 1 else columns


def pieces(count: int, found: list[Repeat], most: int) -> Iterator[Repeat]:
    """Yield loops, and the straight code between them."""
    ends = [0, *(each.end for each in found)]
    for end, loop in zip(ends, [*found, None], strict=True):
        stop = loop.start if loop else count
        yield from (Repeat(i, min(most, stop - i), 1) for i in range(end, stop, most))
        if loop:
            yield loop


class _Candidate(NamedTuple):
    saved: int
    period: int
    start: int
    end: int


def repeats(operations: Operations, worth: float = 0.0) -> list[Repeat]:
    """Return repetitions in order and without overlap, chosen greedily by gain; none if a function with them would have
    less than `worth` operations per word."""
    sequence = _Sequence(operations)
    taken = np.zeros(len(operations), bool)
    found = []
    for each in sorted(sequence.candidates(), reverse=True):
        free = np.flatnonzero(~taken[each.start : each.end])
        if not len(free):
            continue
        start, end = each.start + int(free[0]), each.start + int(free[-1]) + 1
        if taken[start:end].any() or not _saves(each.period, end - start):
            continue
        count = (end - start) // each.period
        repeat = sequence.begun_best(Repeat(start, each.period, count), end)
        taken[repeat.start : repeat.end] = True
        found.append(repeat)
    return _Lines(operations).improved(sorted(found), worth)


def _saves(period: int, length: int) -> bool:
    """Return whether as many operations are enough for a loop of this period."""
    count = length // period
    return count >= FEWEST and (count - 1) * period >= SAVED


class _Sequence:
    """Operations as numbers, equal for operations that may be equal."""

    def __init__(self, operations: Operations):
        o = operations
        self.values = o.kind == VALUE
        self.distance = np.where(self.values, np.arange(len(o)) - o.operand, 0)
        """Distance from an operation back to the operation of its operand."""
        self.token = np.zeros(len(o), np.uint64)
        for part in (o.code, *o.kind, *o.argument, o.result[0]):
            distinct, number = np.unique(part, return_inverse=True)
            self.token = self.token * np.uint64(len(distinct)) + number.astype(np.uint64)

    def candidates(self) -> Iterator[_Candidate]:
        """Yield ranges equal to those one period before, for all window lengths."""
        count = len(self.token)
        hashed = self.token
        for near in np.minimum(self.distance, _NEAR):
            hashed = (hashed * np.uint64(_NEAR + 1) + near.astype(np.uint64)) * _FACTOR
        hashed ^= hashed >> np.uint64(32)
        length, seen = 1, set()
        while 2 * length <= count:
            hashed = hashed[: len(hashed) - length] * _power(length) + hashed[length:]
            length *= 2
            if length in _WINDOWS:
                for period, start, end in _stretches(hashed):
                    begin, end = max(0, start - length - period), min(count, end + length + period)
                    if not _saves(period, end - begin):
                        continue
                    for each in self._exact(period, begin, end):
                        if each not in seen:
                            seen.add(each)
                            yield each

    def _exact(self, period: int, begin: int, end: int) -> Iterator[_Candidate]:
        """Yield the parts of the range from `begin` to `end` that repeat with a period."""
        same = self.token[begin : end - period] == self.token[begin + period : end]
        one, other = self.distance[:, begin : end - period], self.distance[:, begin + period : end]
        # Operands from before the period come from elsewhere.
        same &= ((one == other) | (np.minimum(one, other) >= period)).all(axis=0)
        for start, stop in _true(same):
            length = stop - start
            if _saves(period, length + period):
                yield _Candidate(length, period, begin + start, begin + stop + period)

    def begun_best(self, repeat: Repeat, end: int) -> Repeat:
        """Return the repetition with the start at which fewest values pass between periods, if it keeps the number of
        periods."""
        start, period, count = repeat
        spare = end - repeat.end + 1
        if spare == 1:
            return repeat
        middle = start + count // 2 * period
        reach = np.zeros(period, int)  # distance to the last use of a value, up to a period
        users = np.arange(middle, min(middle + 2 * period, end))
        for distance in self.distance[:, users]:
            made = users - distance - middle
            used = (distance > 0) & (distance < period) & (made >= 0) & (made < period)
            np.maximum.at(reach, made[used], distance[used])
        crossing = np.zeros(2 * period + 1, int)  # number of values across the boundary before an operation
        np.add.at(crossing, np.arange(period) + 1, reach > 0)
        np.add.at(crossing, np.arange(period) + 1 + reach, -(reach > 0).astype(int))
        live = np.cumsum(crossing)
        passing = live[:period] + live[period : 2 * period]
        return Repeat(start + int(np.argmin(passing[:spare])), period, count)


class _Lines:
    """Finds which indices have a constant step between iterations, and which need tables."""

    def __init__(self, operations: Operations):
        self._operations = operations
        self._period = np.zeros(len(operations), int)
        """Period of the loop that contains an operation, 0 for none."""

    def improved(self, found: list[Repeat], worth: float) -> list[Repeat]:
        """Return the repetitions with longer periods or fewer iterations if tables cost more, as `repeats` does."""
        count, result = len(self._operations), []
        # About the number of words, up to a twentieth less than there are; it only grows below.
        words = _STRAIGHT * count + sum(map(_added, found))
        for each in found:
            best, tables = each, self._tables(each, ends=True)
            if tables:
                ways = [Repeat(each.start, m * each.period, each.times // m) for m in _MULTIPLES]
                best = self._best(ways, each, ends=False)
                ways = [
                    Repeat(best.start + first * best.period, best.period, best.times - first - last)
                    for first, last in product(range(_TRIMMED + 1), repeat=2)
                ]
                best = self._best(ways, best, ends=True)
                tables = tables if best == each else self._tables(best, ends=True)
            words += _added(best) - _added(each) + tables * best.times
            if worth * words >= count:
                return []
            self._period[best.start : best.end] = best.period
            result.append(best)
        return result

    def _best(self, ways: Iterable[Repeat], given: Repeat, ends: bool) -> Repeat:
        """Return the first variant with the shortest C: fewest table entries, and operations inside and outside the
        loop. Most variants have so many operations that their tables do not matter."""
        best, least = given, math.inf
        for way in ways:
            length = _LINE * (way.period + given.period * given.times - way.period * way.times)
            if way.times < FEWEST or way.period > LONGEST or length >= least or not self._alike(way):
                continue
            cost = length + self._tables(way, ends) * way.times
            if cost < least:
                best, least = way, cost
        return best

    def _alike(self, way: Repeat) -> bool:
        """Return whether an operand that is computed in its own iteration is so in every iteration: in a longer period,
        a value may be found in the same iteration only once."""
        o, part, begin = self._operations, slice(way.start, way.end), way.passes(0)[:, None]
        made = np.where(o.kind[:, part] == VALUE, o.made[:, part], -1).reshape(2, way.times, way.period)
        here = np.where(made >= begin, made - begin, -1)
        return bool((here == here[:, :1]).all())

    def _tables(self, repeat: Repeat, ends: bool) -> int:
        """Return the number of tables of a loop; entries of the first and last iteration may differ unless `ends`."""
        o, part, shape = self._operations, slice(repeat.start, repeat.end), (repeat.times, repeat.period)
        self._period[part] = repeat.period
        made = o.made[:, part]
        which, entry = o.written[:, made].reshape(2, 2, *shape)
        numbers = np.array([o.result[1, part], *o.operand[:, part]]).reshape(3, *shape)
        numbers = np.concatenate([numbers, made.reshape(2, *shape), which, entry])
        steps = numbers[:, 1:] - numbers[:, :-1]  # differences between successive iterations

        def even(steps: NDArray, ends: bool) -> NDArray:
            """Return the step of each index; _NONE if it varies."""
            steps = steps if ends or repeat.times < FEWEST else steps[:, 1:-1]
            first = steps[:, 0]
            return np.where((steps == first[:, None]).all(axis=1), first, _NONE)

        step = even(steps, ends)
        kind, first, middle = o.kind[:, part][:, : repeat.period], repeat.times // 2, made.reshape(2, *shape)
        middle = middle[:, first]
        there = np.where(middle >= repeat.start, even(steps[3:5], False), step[3:5])
        owner = self._period[middle]
        stored = (there == 0) | ((there != _NONE) & (owner > 0) & (there % np.maximum(owner, 1) == 0))
        writes = o.result[0, part][: repeat.period] >= 0
        written = ~writes & (which[:, 0] >= 0) & (step[5:7] == 0) & (step[7:9] != _NONE)
        tables = np.count_nonzero(writes & (step[0] == _NONE))
        tables += np.count_nonzero((kind == INPUT) & (step[1:3] == _NONE))
        tables += np.count_nonzero((kind == VALUE) & ~stored & ~written)
        self._period[part] = 0
        return int(tables)


def _added(loop: Repeat) -> float:
    """Return the words of a loop without tables, less those of its operations as straight code."""
    return _HEAD - _STRAIGHT * loop.period * (loop.times - 1)


def _power(exponent: int) -> np.uint64:
    return np.uint64(pow(int(_FACTOR), exponent, 2**64))


def _stretches(hashed: NDArray) -> Iterator[tuple[int, int, int]]:
    """Yield (period, start, end) of ranges in which every hash last occurred one period before."""
    order = np.argsort(hashed, kind="stable")
    again = np.flatnonzero(hashed[order[1:]] == hashed[order[:-1]])
    back = np.zeros(len(hashed), int)
    back[order[again + 1]] = order[again + 1] - order[again]
    edges = np.flatnonzero(np.diff(back, prepend=-1, append=-1))
    for start, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        period = int(back[start])
        if 0 < period <= LONGEST and end - start + period >= max((FEWEST - 2) * period, FEWEST):
            yield period, start, end


def _true(flags: NDArray) -> Iterator[tuple[int, int]]:
    """Yield starts and ends of ranges of true values."""
    changes = (np.flatnonzero(flags[1:] != flags[:-1]) + 1).tolist()
    edges = [0, *changes, len(flags)] if len(flags) and flags[0] else [*changes, len(flags)]
    yield from zip(edges[::2], edges[1::2], strict=False)
