"""A function of a scene as words for the interpreter: straight code, and loops over what repeats in a long function.

Each value has a place of its own. Those of a loop follow each other pass by pass, so that operands go by a step from
pass to pass; others are found by tables. Operations keep their order from piece to piece of a function; within a piece
they are arranged in runs (`alfmu.kernel.arrangement`), and the numbers are the same to the last bit.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .arrangement import KINDS, Arrangement, arranged
from .places import line
from .repeat import Repeat, pieces, repeats
from .stream import CONSTANT, INPUT, NOTHING, VALUE, Instructions, Operations

__all__ = ["BEHIND", "GATHER_KIND", "LOOP_KIND", "NARROW", "Code", "Constants", "written"]

LOOP_KIND, GATHER_KIND = len(KINDS), len(KINDS) + 1
"""Numbers of what else there is in a function: a loop, and values found by a table in each pass of it."""

BEHIND = 2**40
"""Added to places that count from behind the last constant: how many there are is known when all functions are."""

NARROW = 2**16
"""Places that operands of 16 bits reach, and operations in a run of them."""

LONG = 6000
"""Operations above which a function is searched for what repeats."""

LINE, TABLE, BEFORE = range(3)
"""Where values come from that are not made in a pass: places that go by a step, a table, a pass before."""

_BACK = 4
"""Passes before the first for which a loop has places, where values pass from one to the next."""


class Constants:
    """The constants of all functions of a scene, each once, by their bits."""

    def __init__(self) -> None:
        self._places: dict[bytes, int] = {}

    def place(self, value: float) -> int:
        return self._places.setdefault(struct.pack("<d", value), len(self._places))

    def __len__(self) -> int:
        return len(self._places)

    def packed(self) -> bytes:
        return b"".join(self._places)


@dataclass(frozen=True)
class Code:
    """A function of a scene. Places count from the first constant; with BEHIND, from behind the last."""

    inputs: list[int]
    """Length of each argument."""
    outputs: list[int]
    """Number of entries of each result."""
    words: NDArray
    """Runs: number of the operation, how many, and the places of their operands."""
    results: NDArray
    """Place of each entry of the results."""
    values: int
    """How many numbers the operations give."""
    looped: bool
    """Whether there are loops, which have 32 bits."""


def written(instructions: Instructions, constants: Constants, inputs: list[int], outputs: list[int]) -> Code:
    """The words of a function with arguments and results of these lengths."""
    operations = Operations.of(instructions)
    found = repeats(operations) if len(operations) > LONG else []
    writing = _Writing(operations, list(pieces(len(operations), found, len(operations))), constants, inputs, outputs)
    for piece in writing.pieces:
        writing.piece(piece)
    words = np.array(writing.words, np.int64)
    return Code(inputs, outputs, words, writing.results, writing.end - writing.begin, bool(found))


class _Writing:
    """A function while it is written, piece by piece."""

    def __init__(
        self,
        operations: Operations,
        parts: list[Repeat],
        constants: Constants,
        inputs: list[int],
        outputs: list[int],
    ):
        o = self._operations = operations
        self.pieces, self._constants = parts, constants
        self.words: list[int] = []
        self.begin = self.end = BEHIND + sum(inputs)
        """Places of the first value, and of the next."""
        self._arguments, self._results = (np.cumsum([0, *lengths]) for lengths in (inputs, outputs))
        self.results = np.full(sum(outputs), constants.place(0.0))  # what no operation gives is zero
        used = np.unique(o.operand[o.kind == CONSTANT])
        self._number = np.zeros(len(o.constant), int)
        self._number[used] = [constants.place(value) for value in o.constant[used].tolist()]
        self._place = np.full(len(o), -1)
        """Of values that are known outside the pass that makes them."""
        scope = np.concatenate([np.repeat(x.start + x.period * np.arange(x.count), x.period) for x in parts] or [[]])
        self._local = (o.kind == VALUE) & (scope[o.made] == scope)
        """Operands that are made in the same pass of the same piece."""
        self._kept = np.zeros(len(o), bool)
        self._kept[o.made[(o.kind == VALUE) & ~self._local]] = True
        self._kept[o.made[0, (o.kind[0] == VALUE) & (o.result[0] >= 0)]] = True

    def piece(self, piece: Repeat) -> None:
        """A loop, or straight code, which has one pass."""
        o, part = self._operations, slice(piece.start, piece.end)
        body = _Body(piece, o, self._local, self._kept, self._found(part))
        made = arranged(body.instructions())
        ordered = [value for run in made.runs for operation in run for value in operation.made]
        offset = {value: i for i, value in enumerate(ordered, len(body.tables))}
        columns = {column: offset[value] for _, column, value in made.results}
        values = len(body.tables) + len(ordered)
        base = self.end + values * body.back
        for column, i in columns.items():
            self._place[piece.passes(column)] = base + values * np.arange(piece.count) + i
        found = self._found(part)
        writes = np.flatnonzero(o.result[0, part] >= 0)
        which, entry = o.result[:, part][:, writes]
        self.results[self._results[which] + entry] = found[0, writes]
        at = {value: (self._constants.place(number), 0) for value, number in made.constants.items()}
        at |= {value: (base + i, values) for value, i in offset.items()}
        at |= {value: body.source(slot, base, values, columns) for value, (_, slot) in made.arguments.items()}
        if piece.count == 1:
            self.words += _runs(made, {value: place[:1] for value, place in at.items()})
        elif values:
            if body.back:
                self._copy(body, found, values, columns)
            tables = [found[j, column :: piece.period] for j, column in body.tables]
            code = [GATHER_KIND, len(tables), *(i * piece.count for i in range(len(tables)))] if tables else []
            code += _runs(made, at)
            self.words += [LOOP_KIND, piece.count, values, len(code), piece.count * len(tables), *code]
            self.words += np.concatenate([*tables, []]).astype(int).tolist()
        self.end = base + values * piece.count

    def _found(self, part: slice) -> NDArray:
        """Places of operands, two rows; -1 of those that are not known yet."""
        o = self._operations
        kind, operand, argument = o.kind[:, part], o.operand[:, part], o.argument[:, part]
        cases = [kind == VALUE, kind == INPUT, kind == CONSTANT]
        entries = BEHIND + self._arguments[argument] + operand
        return np.select(cases, [self._place[o.made[:, part]], entries, self._number[operand * cases[2]]], -1)

    def _copy(self, body: _Body, found: NDArray, values: int, columns: dict[int, int]) -> None:
        """Values that the first passes take from elsewhere, where they would be if passes before had made them."""
        table = np.zeros(values * body.back, int)
        for (row, column), (j, user) in body.copies.items():
            table[values * (body.back + row) + columns[column]] = found[j, user]
        self.words += [LOOP_KIND, len(table), 1, 3, len(table), GATHER_KIND, 1, 0, *table.tolist()]


class _Body:
    """One pass of a piece as a function of its own, whose arguments are what it takes from elsewhere."""

    def __init__(self, piece: Repeat, operations: Operations, local: NDArray, kept: NDArray, found: NDArray):
        self._piece, self._operations, self._found = piece, operations, found
        first = slice(piece.start, piece.start + piece.period)
        self._first = [x[..., first].tolist() for x in (operations.code, operations.kind, operations.made, local)]
        self._firsts = found[:, : piece.period].tolist()
        self._constant = operations.constant
        self._kept = np.flatnonzero(kept[piece.start : piece.end].reshape(piece.count, -1).any(axis=0)).tolist()
        self.tables: list[tuple[int, int]] = []
        """Operands that need one: which of two, and the operation."""
        self.copies: dict[tuple[int, int], tuple[int, int]] = {}
        """Which value of which pass before the first to which operand: which of two, and the operation in the piece."""
        self.back = 0
        """Passes before the first that there are copies of values of."""
        self._sources: list[tuple[int, int, int]] = []
        self._slots: dict[tuple[int, int, int] | bytes, int] = {}
        self._numbers: dict[int, int] = {}
        self._wanted: dict[tuple[int, int], int] = {}

    def instructions(self) -> Instructions:
        code, kinds, made, local = self._first
        rows: list[tuple[int, int, int, int]] = []  # operation, operands, number of a constant or entry
        values: list[int] = []  # of each operation, its number among them
        leaves: dict[tuple[int, int], int] = {}
        for column, operation in enumerate(code):
            operands = [-1, -1]
            for j in (0, 1) if operation != ca.OP_OUTPUT else ():
                if local[j][column]:
                    operands[j] = values[made[j][column] - self._piece.start]
                elif kinds[j][column] != NOTHING:
                    leaf = self._leaf(j, column, kinds[j][column])
                    if leaf not in leaves:
                        leaves[leaf] = len(rows)
                        rows.append((leaf[0], -1, -1, leaf[1]))
                    operands[j] = leaves[leaf]
            values.append(len(rows))
            rows += [(operation, *operands, -1)] * (operation != ca.OP_OUTPUT)
        rows += [(ca.OP_OUTPUT, values[column], -1, column) for column in self._kept]
        found = np.array(rows, int).reshape(-1, 4).T
        constants = np.zeros(found.shape[1])
        constant = found[0] == ca.OP_CONST
        constants[constant] = self._constant[found[3, constant]]
        return Instructions(found[0], found[1:3], np.array([np.zeros_like(found[3]), found[3]]), constants)

    def source(self, slot: int, base: int, values: int, columns: dict[int, int]) -> tuple[int, int]:
        """Place and step of what comes from elsewhere, where values of the first pass begin at `base`."""
        kind, first, second = self._sources[slot]
        if kind == TABLE:
            return base + first, values
        if kind == BEFORE:
            return base - second * values + columns[first], values
        return first, second

    def _leaf(self, j: int, column: int, kind: int) -> tuple[int, int]:
        """A constant, or where else an operand comes from in each pass."""
        piece = self._piece
        if piece.count == 1 and kind != CONSTANT:
            return ca.OP_INPUT, self._slot((LINE, self._firsts[j][column], 0))
        places = self._found[j, column :: piece.period]
        if kind == CONSTANT and (places == places[0]).all():
            return ca.OP_CONST, self._number(places[0], self._operations.operand[j, piece.start + column])
        if kind == VALUE and (places < 0).any():
            made = self._operations.made[j, piece.passes(column)]
            source, key = self._before(j, column, made), made.tobytes()
        else:
            found, key = line(places), places.tobytes()
            source = None if found is None else (LINE, *found)
        if source is None and key not in self._slots:
            self.tables.append((j, column))
        return ca.OP_INPUT, self._slot(source or (TABLE, len(self.tables) - 1, 0), source or key)

    def _slot(self, source: tuple[int, int, int], key: tuple[int, int, int] | bytes | None = None) -> int:
        """The number of a source, the same for the same key."""
        slot = self._slots.setdefault(key or source, len(self._sources))
        if slot == len(self._sources):
            self._sources.append(source)
        return slot

    def _number(self, place: int, operand: int) -> int:
        """One number of those of a constant."""
        return self._numbers.setdefault(int(place), int(operand))

    def _before(self, j: int, column: int, made: NDArray) -> tuple[int, int, int] | None:
        """Whether an operand is what the pass so many before has made, or would have made before the first."""
        row, which = np.divmod(made - self._piece.start, self._piece.period)
        back = len(made) - 1 - int(row[-1])
        own = slice(back, None)
        if not 0 < back <= _BACK or (row[own] != np.arange(len(made) - back)).any() or (which[own] != which[-1]).any():
            return None
        value = int(which[-1])
        cells = {(p - back, value): int(made[p]) for p in range(back)}
        if any(self._wanted.get(cell, x) != x for cell, x in cells.items()) or (row[:back] >= 0).any():
            return None
        self._wanted |= cells
        self.copies |= {(p - back, value): (j, column + p * self._piece.period) for p in range(back)}
        self.back = max(self.back, back)
        return BEFORE, value, back


def _runs(made: Arrangement, at: dict[int, tuple[int, ...]]) -> list[int]:
    """The words of runs of operations on values at these places."""
    words: list[int] = []
    for run in made.runs:
        for start in range(0, len(run), NARROW - 1):
            part = run[start : start + NARROW - 1]
            words += [part[0].kind, len(part)]
            words += [word for operation in part for value in operation.operands for word in at[value]]
    return words
