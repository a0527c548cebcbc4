"""Encode a function of a scene for the interpreter: straight code, and loops over repeated parts of a long function.

Each value has its own address. Those of a loop are stored iteration by iteration, so that operands advance by a step;
others are found by tables. Pieces of a function keep their order; within a piece operations are arranged in runs
(`alfmu.kernel.arrangement`), and the results are the same to the last bit.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .arrangement import KIND_OF, KINDS, Arrangement, Operation, arranged, in_runs
from .places import line
from .repeat import Repeat, pieces, repeats
from .stream import CONSTANT, INPUT, NOTHING, ROLE, VALUE, Instructions, Operations, address, library

LOOP_KIND, EACH_KIND, GATHER_KIND = (len(KINDS) + i for i in range(3))
"""Numbers of other elements of a function: a loop; an operation in all iterations of a loop; copies of values."""

BEHIND = 2**40
"""Offset of provisional addresses: a function's constants are below -BEHIND; values from BEHIND on follow the scene's
constants, whose number is known only after all functions are encoded."""

NARROW = 2**16
"""Range of operands of 16 bits, and of operations in a run of them."""

LONG = NARROW
"""Number of operations above which a function is searched for repetition. Shorter straight code has operands of 16
bits, takes half to five sixths of the time of loops, and needs no search."""

WORTH = 1.0
"""Least number of operations per word of a function with loops; one without them has two words per operation."""

SHORT = 10
"""Number of addresses with a constant step up to which they are listed: this takes about as many words."""

_WORDS = 42
"""Most words for an instruction: two runs, with the operands of its operations and of those of an argument."""

LINE, TABLE, BEFORE = range(3)
"""Sources of values from outside an iteration: addresses with a constant step, a table, an earlier iteration."""


class Constants:
    """Constants of a function, or of all functions of a scene, identified by their bits."""

    def __init__(self) -> None:
        self.numbers: list[bytes] = []
        self._places: dict[bytes, int] = {}
        self._blocks: dict[tuple[bytes, ...], int] = {}

    def place(self, value: float) -> int:
        """Return the index of a number, added if missing."""
        return self._place(struct.pack("<d", value))

    def places(self, code: Code) -> NDArray:
        """Return the indices of a function's constants: each once, or all in order if steps lead from one
        to another."""
        if not code.stepped:
            return np.array([self._place(number) for number in code.constants], np.int64)
        first = self._blocks.setdefault(code.constants, len(self.numbers))
        if first == len(self.numbers):
            self.numbers += code.constants
        return first + np.arange(len(code.constants))

    def _place(self, number: bytes) -> int:
        place = self._places.setdefault(number, len(self.numbers))
        if place == len(self.numbers):
            self.numbers.append(number)
        return place


@dataclass(frozen=True)
class Code:
    """An encoded function. Addresses of its constants count from -BEHIND, others from its first argument at BEHIND."""

    inputs: list[int]
    """Length of each argument."""
    outputs: list[int]
    """Number of entries of each result."""
    words: NDArray
    """Runs: number of the operation, count, and addresses of the operands."""
    results: NDArray
    """Rows of addresses of results, later ones overriding: count, first entry and step, first address and step."""
    values: int
    """Number of values that the operations compute."""
    constants: tuple[bytes, ...]
    looped: bool
    """Whether the code has loops; their operands have 32 bits."""

    @property
    def stepped(self) -> bool:
        """Whether steps may lead from one constant to another."""
        return self.looped or bool(((self.results[:, 3] < 0) & (self.results[:, 4] != 0)).any())

    def placed(self, places: NDArray, constants: NDArray, count: int) -> NDArray:
        """Return final addresses in a scene with `count` constants, `places` being those of the function's
        constants."""
        found = np.where(places >= BEHIND // 2, places - BEHIND + count, places)
        own = places < -BEHIND // 2
        found[own] = constants[places[own] + BEHIND]
        return found


def written(instructions: Instructions, inputs: list[int], outputs: list[int]) -> Code:
    """Encode a function with arguments and results of these lengths."""
    if len(instructions) > LONG:
        operations = Operations.of(instructions)
        if len(operations) > LONG and (found := repeats(operations, WORTH)):
            made = _Writing(operations, inputs, outputs).done(found)
            if WORTH * len(made.words) < len(operations):
                return made
    return _straight(instructions, inputs, outputs)


def _straight(instructions: Instructions, inputs: list[int], outputs: list[int]) -> Code:
    """Encode a function without loops."""
    count = len(instructions)
    arguments, results = (np.cumsum([0, *lengths], dtype=np.int32) for lengths in (inputs, outputs))
    words, numbers = np.empty(_WORDS * count, np.int64), np.empty(2 * count + 4)
    rows, sizes = np.empty((count, 2), np.int64), np.empty(4, np.int32)
    made: list[NDArray] = [words, numbers, rows, sizes]
    done = library().alfmu_straight(
        *(count, *map(address, instructions.arrays), address(ROLE), address(KIND_OF)),
        *(address(arguments), sum(inputs), address(results), BEHIND),
        *map(address, made),
    )
    if done < 0:
        raise MemoryError
    length, constants, values, written = sizes.tolist()
    # Results without an operation are zero.
    lines = [(sum(outputs), 0, 1, -BEHIND, 0), *(in_line(*rows[:written].T) if written else ())]
    data = numbers[:constants].tobytes()
    known = tuple(data[k : k + 8] for k in range(0, len(data), 8))
    return Code(inputs, outputs, words[:length].copy(), np.array(lines, np.int64), values, known, False)


class _Writing:
    """A function under construction, piece by piece."""

    def __init__(self, operations: Operations, inputs: list[int], outputs: list[int]):
        o = self._operations = operations
        self._inputs, self._outputs, self._constants = inputs, outputs, Constants()
        self._words: list[int] = []
        self._end = BEHIND + sum(inputs)
        """Address of the next value."""
        self._arguments, self._results = (np.cumsum([0, *lengths]) for lengths in (inputs, outputs))
        # Results without an operation are zero.
        self._lines: list[tuple[int, ...]] = [(sum(outputs), 0, 1, self._constant(0.0), 0)]
        used = np.unique(o.operand[o.kind == CONSTANT])
        self._number = np.zeros(len(o.constant), int)
        self._number[used] = [self._constant(value) for value in o.constant[used].tolist()]
        self._place = np.full(len(o), -1)
        """Addresses of values visible outside their iteration."""
        self._local = self._kept = np.zeros(0, bool)

    def done(self, found: list[Repeat]) -> Code:
        """Return the function, with loops for repetitions as far as possible."""
        o = self._operations
        carried = {each: one for each in found if (one := _carried(o, each)) is not None}
        parts = list(pieces(len(o), list(carried), max(len(o), 1)))
        scope = np.concatenate([np.zeros(0, int), *(np.repeat(x.passes(0), x.period) for x in parts)])
        self._local = (o.kind == VALUE) & (scope[o.made] == scope)
        """Operands computed in the same iteration of the same piece."""
        self._kept = np.zeros(len(o), bool)
        """Values that are used elsewhere."""
        self._kept[o.made[(o.kind == VALUE) & ~self._local]] = True
        self._kept[o.made[0, (o.kind[0] == VALUE) & (o.result[0] >= 0)]] = True
        for piece in parts:
            self._piece(piece, carried.get(piece, {}))
        words, lines = (np.array(x, np.int64) for x in (self._words, self._lines))
        values, constants = self._end - BEHIND - sum(self._inputs), tuple(self._constants.numbers)
        return Code(self._inputs, self._outputs, words, lines, values, constants, bool(carried))

    def _constant(self, value: float) -> int:
        return self._constants.place(value) - BEHIND

    def _piece(self, piece: Repeat, carried: dict[tuple[int, int], tuple[int, int]]) -> None:
        """Encode a loop, or straight code as one iteration."""
        part = slice(piece.start, piece.end)
        body = _Body(piece, self._operations, self._local, self._kept, self._found(part), carried)
        made = arranged(body.instructions())
        at = {value: (self._constant(number), 0) for value, number in made.constants.items()}
        if piece.times == 1:
            at |= {value: body.sources[slot][1:] for value, (_, slot) in made.arguments.items()}
            self._straight(made, at)
        else:
            self._looped(piece.times, body, made, at)
        for _, column, value in made.results:
            first, step = at[value]
            self._place[piece.passes(column)] = first + step * np.arange(piece.times)
        writes = np.flatnonzero(self._operations.result[0, part][: piece.period] >= 0)
        for columns in [writes] if piece.times == 1 else writes[:, None]:
            users = (piece.passes(0)[:, None] + columns).reshape(-1)
            which, entry = self._operations.result[:, users]
            self._lines += in_line(self._results[which] + entry, self._found(users)[0])

    def _straight(self, made: Arrangement, at: dict[int, tuple[int, int]]) -> None:
        """Encode straight code between loops, and add the addresses of its values."""
        for run in made.runs:
            for value in chain(*(operation.made for operation in run)):
                at[value] = self._end, 0
                self._end += 1
        self._words += _runs(made.runs, {value: place[:1] for value, place in at.items()})

    def _looped(self, count: int, body: _Body, made: Arrangement, at: dict[int, tuple[int, int]]) -> None:
        """Encode operations independent of earlier iterations over all iterations at once, and the others as loops."""
        value_of = {column: value for _, column, value in made.results}
        before: dict[int, list[tuple[int, int]]] = {}  # values and their aliases in later iterations
        for value, (_, slot) in made.arguments.items():
            kind, first, second = body.sources[slot]
            if kind == LINE:
                at[value] = first, second
            elif kind == TABLE:
                at[value] = self._copies(body.tables[first]), 1
            else:
                before.setdefault(value_of[first], []).append((second, value))
        cells = {(value_of[column], row): place for (column, row), place in body.cells.items()}
        earlier = {value: source for source, found in before.items() for _, value in found}
        operations = [operation for run in made.runs for operation in run]
        for group, repeated in _groups(operations, earlier):
            runs = in_runs(group) if repeated else [group]
            values = [value for run in runs for operation in run for value in operation.made]
            back = max((i for value in values for i, _ in before.get(value, [])), default=0)
            if back:
                rows = range(-back, 0)
                self._copies([cells.get((value, row), 0) for row in rows for value in values])
            for i, value in enumerate(values):
                at[value] = self._end + i, len(values)
                at |= {x: (self._end + i - k * len(values), len(values)) for k, x in before.get(value, [])}
            if repeated:
                words = _runs(runs, at)
                self._words += [LOOP_KIND, count, len(values), len(words), *words]
            else:
                self._words += [EACH_KIND, count, group[0].kind, *(x for k in group[0].operands for x in at[k])]
            self._end += count * len(values)

    def _copies(self, places: Sequence[int]) -> int:
        """Copy values to consecutive addresses; return the first."""
        listed: list[int] = []

        def gather() -> None:
            self._words += [GATHER_KIND, len(listed), *listed] if listed else []
            listed.clear()

        for count, first, step in in_line(np.array(places)):
            if count < SHORT:
                listed += range(first, first + count * step, step) if step else [first] * count
                continue
            gather()
            nothing, one = map(self._constant, (-0.0, 1.0))
            self._words += [EACH_KIND, count, KINDS.index("sum1"), nothing, 0, first, step, one, 0]
        gather()
        self._end += len(places)
        return self._end - len(places)

    def _found(self, part: slice | NDArray) -> NDArray:
        """Return addresses of operands in two rows; -1 for those not known yet."""
        o = self._operations
        kind, operand, argument = o.kind[:, part], o.operand[:, part], o.argument[:, part]
        cases = [kind == VALUE, kind == INPUT, kind == CONSTANT]
        entries = BEHIND + self._arguments[argument] + operand
        return np.select(cases, [self._place[o.made[:, part]], entries, self._number[operand * cases[2]]], -1)


class _Body:
    """One iteration of a piece as a function of its own, whose arguments are values from elsewhere."""

    def __init__(
        self,
        piece: Repeat,
        operations: Operations,
        local: NDArray,
        kept: NDArray,
        found: NDArray,
        carried: dict[tuple[int, int], tuple[int, int]],
    ):
        self._piece, self._operations, self._found = piece, operations, found
        first = slice(piece.start, piece.start + piece.period)
        self._first = [x[..., first].tolist() for x in (operations.code, operations.kind, operations.made, local)]
        self._constant = operations.constant
        self._carried = carried
        self._kept = np.flatnonzero(kept[piece.start : piece.end].reshape(piece.times, -1).any(axis=0)).tolist()
        self.sources: list[tuple[int, int, int]] = []
        """Sources of arguments: LINE, first address and step; TABLE and its number; BEFORE, operation, and number of
        iterations before."""
        self.tables: list[list[int]] = []
        """Addresses in all iterations."""
        self.cells: dict[tuple[int, int], int] = {}
        """Address of the initial value of each operand from an earlier iteration, by operation and iteration."""
        self._slots: dict[tuple[int, int, int] | bytes, int] = {}
        self._numbers: dict[int, int] = {}

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

    def _leaf(self, j: int, column: int, kind: int) -> tuple[int, int]:
        """Return an operation and its operand: a constant, or the source of the values in all iterations."""
        piece = self._piece
        places = self._found[j, column :: piece.period]
        if kind == CONSTANT and (places == places[0]).all():
            return ca.OP_CONST, self._number(places[0], self._operations.operand[j, piece.start + column])
        if (j, column) in self._carried:
            value, back = self._carried[j, column]
            self.cells |= {(value, row - back): int(places[row]) for row in range(back)}
            return ca.OP_INPUT, self._slot((BEFORE, value, back))
        if (found := line(places)) is not None:
            return ca.OP_INPUT, self._slot((LINE, *found))
        key = places.tobytes()
        if key not in self._slots:
            self.tables.append(places.tolist())
        return ca.OP_INPUT, self._slot((TABLE, len(self.tables) - 1, 0), key)

    def _slot(self, source: tuple[int, int, int], key: tuple[int, int, int] | bytes | None = None) -> int:
        """Return the number of a source, equal for equal keys."""
        slot = self._slots.setdefault(key or source, len(self.sources))
        if slot == len(self.sources):
            self.sources.append(source)
        return slot

    def _number(self, place: int, operand: int) -> int:
        """Return an instruction operand that stands for a constant, the same for each use."""
        return self._numbers.setdefault(int(place), int(operand))


def _carried(operations: Operations, piece: Repeat) -> dict[tuple[int, int], tuple[int, int]] | None:
    """Map operands computed in another iteration of a loop (index of the operand, operation) to the operation that
    computes them and the number of iterations before; None if it varies."""
    o, part, shape = operations, slice(piece.start, piece.end), (piece.times, piece.period)
    begin = piece.passes(0)[:, None]
    found: dict[tuple[int, int], tuple[int, int]] = {}
    cells: dict[tuple[int, int], int] = {}
    for j in (0, 1):
        value, made = o.kind[j, part].reshape(shape) == VALUE, o.made[j, part].reshape(shape)
        for column in np.flatnonzero((value & (made < begin) & (made >= piece.start)).any(axis=0)).tolist():
            row, which = np.divmod(made[:, column] - piece.start, piece.period)
            back = piece.times - 1 - int(row[-1])
            later = slice(back, None)
            if not 0 < back < piece.times or (row[:back] >= 0).any():
                return None
            if (row[later] != np.arange(piece.times - back)).any() or (which[later] != which[-1]).any():
                return None
            found[j, column] = int(which[-1]), back
            before = {(int(which[-1]), i - back): int(made[i, column]) for i in range(back)}
            if any(cells.setdefault(cell, maker) != maker for cell, maker in before.items()):
                return None
    return found


def _groups(operations: list[Operation], earlier: dict[int, int]) -> Iterator[tuple[list[Operation], bool]]:
    """Yield operations that can run over all iterations at once, each alone, and others in groups, in order.

    `earlier` are operands that are earlier values of an operation. Operations that depend on their own earlier values
    must run iteration by iteration.
    """
    from scipy.sparse import csr_array  # slow to import, and needed for tracing only
    from scipy.sparse.csgraph import connected_components

    maker = {value: i for i, operation in enumerate(operations) for value in operation.made}
    edges = {
        (maker[source], i)
        for i, operation in enumerate(operations)
        for x in operation.operands
        if (source := earlier.get(x, x)) in maker
    }
    made, users = np.array(sorted(edges), int).reshape(-1, 2).T
    shape = (len(operations), len(operations))
    count, part = connected_components(csr_array((np.ones(len(made)), (made, users)), shape), connection="strong")
    members: list[list[Operation]] = [[] for _ in range(count)]
    for i, k in enumerate(part.tolist()):
        members[k].append(operations[i])
    repeated = [len(x) > 1 for x in members]
    for k in part[made[made == users]].tolist():
        repeated[k] = True
    after: list[set[int]] = [set() for _ in members]
    for k, user in zip(part[made].tolist(), part[users].tolist(), strict=True):
        if k != user:
            after[k].add(user)
    missing = np.bincount([user for x in after for user in x], minlength=count).tolist()
    ready = [k for k in range(count) if not missing[k]]

    def done(k: int) -> None:
        for user in after[k]:
            missing[user] -= 1
            if not missing[user]:
                ready.append(user)

    while ready:
        alone = next((k for k in ready if not repeated[k]), None)
        if alone is not None:
            ready.remove(alone)
            yield members[alone], False
            done(alone)
            continue
        group = []
        while (k := next((k for k in ready if repeated[k]), None)) is not None:
            ready.remove(k)
            group += members[k]
            done(k)
        yield group, True


def in_line(*values: NDArray) -> list[tuple[int, ...]]:
    """Return, for common runs of all sequences, the length, and first value and step of each."""
    rows: list[tuple[int, ...]] = []
    count = len(values[0])
    steps = np.array([np.diff(x) for x in values])
    ends = iter([*(np.flatnonzero((np.diff(steps) != 0).any(axis=0)) + 1).tolist(), count - 1])
    first = np.array(values).T.tolist()
    at = end = 0
    while at < count:
        while end <= at < count - 1:
            end = next(ends)
        step, last = [0] * len(values), at
        if at < count - 1 and np.abs(steps[:, at]).max() < BEHIND // 2:  # a larger step would lead out of the constants
            step, last = steps[:, at].tolist(), end
        rows.append((last + 1 - at, *chain(*zip(first[at], step, strict=True))))
        at = last + 1
    return rows


def _runs(runs: list[list[Operation]], at: Mapping[int, tuple[int, ...]]) -> list[int]:
    """Return the words of runs of operations on values at these addresses."""
    words: list[int] = []
    for run in runs:
        for start in range(0, len(run), NARROW - 1):
            part = run[start : start + NARROW - 1]
            words += [part[0].kind, len(part)]
            words += [word for operation in part for value in operation.operands for word in at[value]]
    return words
