"""Assign storage to the values of a long function: local variables, results, or the workspace.

Values of a loop used elsewhere are stored in the workspace by iteration, so that other loops address them with a step.
Values of straight code that continue them (as the first and the last of a chain) are stored before and after.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .repeat import Numbers, Repeat
from .stream import VALUE, Operations

_BESIDE = 8
"""Number of iterations before the first and after the last of a loop for which space may be reserved."""


class Places:
    """Storage of each value used in another piece of code, or another iteration of a loop, than it is computed in.

    `pieces` are in order: loops, and straight code as loops of one iteration. The first `reserved` entries of the
    workspace stay free.
    """

    def __init__(self, operations: Operations, pieces: list[Repeat], reserved: int):
        self._operations, self._pieces = operations, pieces
        count, self._made, self._result = len(operations), operations.made, operations.written
        self._piece = np.repeat(np.arange(len(pieces)), [each.end - each.start for each in pieces])
        starts, periods, counts = (np.array([each[i] for each in pieces], int) for i in range(3))
        self._straight = counts[self._piece] == 1
        self._row, self.column = np.divmod(np.arange(count) - starts[self._piece], periods[self._piece])
        """Number of the iteration, and of the operation in it."""
        scope = np.arange(count) - self.column
        self.elsewhere = (operations.kind == VALUE) & (scope[self._made] != scope)
        """Operands not computed in the same iteration of the same piece."""
        self.stored = np.zeros(count, bool)
        """Values stored in the workspace."""
        self.fetched = np.zeros((2, count), bool)
        """Operands from elsewhere that are read from the workspace; others are read from results."""
        self._choose()
        self.address = np.full(count, -1)
        """Addresses in the workspace."""
        self.size = self._place(Heap(reserved))

    def _sequences(self) -> Iterator[tuple[int, NDArray, NDArray]]:
        """Yield operands of loops from elsewhere: index of the operand, operation in all iterations, values."""
        for piece in self._pieces:
            if piece.times > 1:
                for column, j in np.argwhere(self.elsewhere[:, piece.start : piece.start + piece.period].T).tolist():
                    users = piece.passes(column)
                    yield j, users, self._made[j, users]

    def _choose(self) -> None:
        """Choose storage: operands of loops are read from results with a constant step, unless they become results
        themselves; all others are stored."""
        writing = self._operations.result[0] >= 0
        self.fetched = self.elsewhere & self._straight & ((self._result[0, self._made] < 0) | writing)
        for j, users, values in self._sequences():
            which, entries = self._result[:, values]
            if writing[users[0]] or which[0] < 0 or (which != which[0]).any() or line(entries) is None:
                self.fetched[j, users] = True
        self.stored[self._made[self.fetched]] = True
        for piece in self._pieces:
            if piece.times > 1:
                passes = self.stored[piece.start : piece.end].reshape(piece.times, piece.period)
                passes[:] = passes.any(axis=0)

    def _place(self, heap: Heap) -> int:
        """Assign addresses, reused after the last use of a value; return the size of the workspace."""
        begin: list[list[_Table]] = [[] for _ in self._pieces]
        end: list[list[tuple[int, int]]] = [[] for _ in self._pieces]
        for table in self._tables():
            begin[table.first].append(table)
        for beginning, ending in zip(begin, end, strict=True):
            for table in beginning:
                base = heap.take(table.length)
                self.address[table.values] = base + table.offsets
                end[table.last].append((base, table.length))
            for base, length in ending:
                heap.give(base, length)
        return heap.size

    def _tables(self) -> Iterator[_Table]:
        """Yield groups of stored values: in a loop, values with equal lifetimes; in straight code, each value alone."""
        last = np.full(len(self._operations), -1)
        for made, users in zip(self._made, map(np.flatnonzero, self.fetched), strict=True):
            np.maximum.at(last, made[users], self._piece[users])
        row, column, owner = self._row.copy(), self.column.copy(), self._piece.copy()
        for value, cell in self._continuations().items():
            owner[value], column[value], row[value] = cell
        values = np.flatnonzero(self.stored)
        values = values[np.argsort(owner[values], kind="stable")]
        for own in np.split(values, np.flatnonzero(np.diff(owner[values])) + 1) if len(values) else []:
            if self._pieces[owner[own[0]]].times == 1:
                for value in own.tolist():
                    yield _Table(int(self._piece[value]), int(last[value]), 1, np.array([value]), np.array([0]))
                continue
            needed = np.zeros(int(column[own].max()) + 1, int)
            np.maximum.at(needed, column[own], last[own])
            for end in np.unique(needed[column[own]]).tolist():
                alike = own[needed[column[own]] == end]
                columns, places = np.unique(column[alike], return_inverse=True)
                rows = row[alike] - row[alike].min()
                length = (int(rows.max()) + 1) * len(columns)
                yield _Table(int(self._piece[alike].min()), end, length, alike, rows * len(columns) + places)

    def _continuations(self) -> dict[int, tuple[int, int, int]]:
        """Return the values of straight code that continue those of a loop, with the loop's piece, column and row."""
        found: dict[int, tuple[int, int, int]] = {}
        taken = set()
        for j, users, values in self._sequences():
            middle = len(values) // 2
            one, other = values[middle - 1 : middle + 1]
            owner, column = int(self._piece[one]), int(self.column[one])
            count = self._pieces[owner].times
            if not self.fetched[j, users[0]] or count == 1:
                continue
            if (self._piece[other], self.column[other]) != (owner, column):
                continue
            rows = self._row[one] + (self._row[other] - self._row[one]) * (np.arange(len(values)) - middle + 1)
            beside = self._straight[values] & ((rows < 0) | (rows >= count))
            beside &= (rows >= -_BESIDE) & (rows < count + _BESIDE)
            for value, row in zip(values[beside].tolist(), rows[beside].tolist(), strict=True):
                cell = owner, column, row
                if value not in found and cell not in taken:
                    found[value] = cell
                    taken.add(cell)
        return found


class _Table(NamedTuple):
    """Values stored together, from the first piece that computes one to the last that uses one."""

    first: int
    last: int
    length: int
    values: NDArray
    offsets: NDArray


class Heap:
    """Ranges of addresses, allocated first-fit, and freed."""

    def __init__(self, size: int):
        self.size = size
        self._free: list[tuple[int, int]] = []  # starts and ends of free ranges, in order

    def take(self, length: int) -> int:
        for i, (begin, end) in enumerate(self._free):
            if end - begin >= length:
                self._free[i : i + 1] = [(begin + length, end)] if end - begin > length else []
                return begin
        begin, self.size = self.size, self.size + length
        return begin

    def give(self, begin: int, length: int) -> None:
        i, end = bisect(self._free, (begin, begin)), begin + length
        low = high = i
        if i and self._free[i - 1][1] == begin:
            low, begin = i - 1, self._free[i - 1][0]
        if i < len(self._free) and self._free[i][0] == end:
            high, end = i + 1, self._free[i][1]
        self._free[low:high] = [(begin, end)]


def line(entries: Numbers) -> tuple[int, int] | None:
    """Return start and step of equally spaced numbers; None if they are not."""
    if len(entries) == 1:
        return int(entries[0]), 0
    steps = np.diff(entries)
    return (int(entries[0]), int(steps[0])) if (steps == steps[0]).all() else None
