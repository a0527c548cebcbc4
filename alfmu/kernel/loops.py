"""Write a long function in C: a chain of blocks of bounded length, with repeated parts as loops.

The operations and their order are those of the function, so the results are the same to the last bit. A value is a
local variable of the code, or of the iteration of a loop, that computes it; `alfmu.kernel.places` assigns storage for
uses elsewhere. Indices with a constant step between iterations are computed; others, and varying constants, are in
tables.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .places import Places, line
from .repeat import Numbers, Repeat, pieces, repeats
from .stream import BINARY, CONSTANT, INPUT, PLAIN, UNARY, VALUE, Operations, number

ANGULAR = {ca.OP_SIN: "sine", ca.OP_COS: "cosine"}
"""Functions of an angle that are computed together."""


class Angles:
    """The angles of a piece of C whose sines and cosines are known, by their expressions."""

    def __init__(self) -> None:
        self._known: dict[str, int] = {}

    def lines(self, angle: str) -> list[str]:
        """Return the lines that compute the sine and the cosine of an angle; none if they are known."""
        if angle in self._known:
            return []
        k = self._known[angle] = len(self._known)
        return [
            f"const Real angle{k} = {angle};",
            f"Real sine{k}, cosine{k};",
            f"sine_cosine_of(&angle{k}, &sine{k}, &cosine{k});",
        ]

    def name(self, operation: int, angle: str) -> str:
        """Return the sine or the cosine of a known angle."""
        return f"{ANGULAR[operation]}{self._known[angle]}"


def constant(value: float) -> str:
    """Return a number in C, the same in all lanes."""
    return f"REAL({number(value)})"


def expression(operation: int, *operands: str) -> str:
    """Return an operation of CasADi in C."""
    template = BINARY.get(operation) or UNARY[operation]
    if operation in PLAIN:
        return template.format(*operands)
    return f"{name_of(operation)}({', '.join(operands[: 1 + (operation in BINARY)])})"


def name_of(operation: int) -> str:
    """Return the name of the C function of an operation other than arithmetic, such as `fmin_of`."""
    return f"{_NAMES[operation]}_of"


_NAMES = {getattr(ca, name): name.removeprefix("OP_").lower() for name in dir(ca) if name.startswith("OP_")}


def blocks(name: str, operations: Operations, kept: dict[int, int], most: int) -> Iterator[tuple[str, int]]:
    """Yield C functions of at most `most` operations or one loop each, and one that calls them; with their workspace.

    `kept` are the lengths of arguments that are copied first, since results may overwrite them.
    """
    parts = list(pieces(len(operations), repeats(operations), most))
    code = _Code(operations, parts, kept)
    names: list[str] = []
    lines = code.copies()
    size = 0
    for i, piece in enumerate(parts):
        lines += code.piece(i)
        size += piece.period
        if i + 1 == len(parts) or size + parts[i + 1].period > most:
            names.append(f"{name}_{len(names)}")
            yield c_function(names[-1], lines), code.workspace
            lines, size = [], 0
    declared = "".join(f"extern Function {each};\n" for each in names)
    yield declared + c_function(name, [f"{each}(x, y, w);" for each in names]), code.workspace


def c_function(name: str, lines: Iterable[str]) -> str:
    """Return a C function of arguments, results and workspace."""
    body = "".join(f"    {line}\n" for line in lines)
    head = f"__attribute__((noinline)) void {name}(Arguments x, Results y, Real *w)"
    return f"extern Function {name};\n{head}\n{{\n    (void)x, (void)y, (void)w;\n{body}}}\n\n"


class _Code:
    """The text of pieces."""

    def __init__(self, operations: Operations, pieces: list[Repeat], kept: dict[int, int]):
        self._operations, self._pieces, self._kept = operations, pieces, kept
        ends = np.cumsum([0, *kept.values()]).tolist()
        self._copy = dict(zip(kept, ends, strict=False))
        self._places = Places(operations, pieces, ends[-1])
        self.workspace = self._places.size
        self._letter, self._which, self._entry = self._found()

    def _found(self) -> tuple[NDArray, NDArray, NDArray]:
        """Return location, array and entry of each operand: c a constant, v a local variable, w, x or y."""
        o, places = self._operations, self._places
        offset = np.zeros(max([*self._copy, o.argument.max(initial=0)]) + 1, int)
        offset[list(self._copy)] = list(self._copy.values())
        copied = (o.kind == INPUT) & np.isin(o.argument, list(self._kept))
        cases = [o.kind == CONSTANT, copied, o.kind == INPUT, places.fetched, places.elsewhere, o.kind == VALUE]
        result, entry = o.written[:, o.made]
        entries = [o.operand, offset[o.argument] + o.operand, o.operand, places.address[o.made], entry]
        return (
            np.select(cases, list("cwxwyv"), ""),
            np.select(cases, [0, 0, o.argument, 0, result, 0]),
            np.select(cases, [*entries, places.column[o.made]]),
        )

    def copies(self) -> list[str]:
        """Return copies of arguments to the start of the workspace."""
        return [f"memcpy(w + {self._copy[i]}, x[{i}], {n} * sizeof(Real));" for i, n in self._kept.items()]

    def piece(self, i: int) -> list[str]:
        """Return the code of a straight piece, or a loop."""
        o, piece = self._operations, self._pieces[i]
        body = _Body(piece.times)
        first = slice(piece.start, piece.start + piece.period)
        letters, which = (x[:, first].tolist() for x in (self._letter, self._which))
        entries = [piece.columns(x) for x in self._entry]
        addresses, results = piece.columns(self._places.address), piece.columns(o.result[1])
        facts = (x[first].tolist() for x in (o.code, o.result[0], self._places.stored))
        for column, (code, result, stored) in enumerate(zip(*facts, strict=True)):
            operands = [
                self._operand(body, letters[j][column], which[j][column], entries[j][column])
                for j in (0, 1)
                if letters[j][column]
            ]
            if result >= 0:
                body.store(f"y{result}", results[column], operands[0])
                continue
            if code in ANGULAR:
                body.lines += body.angles.lines(operands[0])
                value = body.angles.name(code, operands[0])
            else:
                value = expression(code, *operands)
            body.lines.append(f"const Real v{column} = {value};")
            if stored:
                body.store("w", addresses[column], f"v{column}")
        return body.text()

    def _operand(self, body: _Body, letter: str, which: int, entries: Numbers) -> str:
        """Return an operand as an expression, which may be used until the end of the iteration."""
        if letter == "v":
            return f"v{entries[0]}"
        if letter == "c":
            return body.constant(self._operations.constant[entries])
        return body.loaded("w" if letter == "w" else f"{letter}{which}", entries)


class _Body:
    """A piece of C under construction: code before the loop, and in it."""

    def __init__(self, count: int):
        self.lines: list[str] = []
        self.angles = Angles()
        self._count = count
        self._before: dict[str, str] = {}
        self._tables: dict[tuple[str, str], str] = {}
        self._known: dict[str, str] = {}

    def constant(self, values: NDArray) -> str:
        """Return a constant, or an element of a table of constants."""
        if (values.view(np.int64) == values[:1].view(np.int64)).all():
            return constant(float(values[0]))
        return self._local(f"REAL({self._table('double', map(number, values.tolist()))})")

    def loaded(self, array: str, entries: Numbers) -> str:
        """Return a local variable with an array entry, loaded once per iteration, or once before the loop."""
        text = self._element(array, entries)
        if self._count == 1 or "k" in text:
            return self._local(text)
        name = self._known.setdefault(text, f"u{len(self._known)}")
        self._before[f"const Real {name}"] = text
        return name

    def store(self, array: str, entries: Numbers, value: str) -> None:
        self.lines.append(f"{self._element(array, entries)} = {value};")

    def text(self) -> list[str]:
        before = [f"{head} = {tail};" for head, tail in self._before.items()]
        if self._count == 1:
            return ["{", *(f"    {line}" for line in (*before, *self.lines)), "}"]
        loop = [f"for (long k = 0; k < {self._count}; k++) {{", *(f"    {line}" for line in self.lines), "}"]
        return ["{", *(f"    {line}" for line in (*before, *loop)), "}"]

    def _local(self, text: str) -> str:
        if text not in self._known:
            self._known[text] = f"u{len(self._known)}"
            self.lines.append(f"const Real {self._known[text]} = {text};")
        return self._known[text]

    def _element(self, array: str, entries: Numbers) -> str:
        """Return an element of w, x or y; cached pointers avoid reloads after each store."""
        if array != "w":
            read_only = "const " * array.startswith("x")
            self._before[f"{read_only}Real *const {array}"] = f"{array[0]}[{array[1:]}]"
        found = line(entries)
        if found is None:
            return f"{array}[{self._table('int', map(str, np.asarray(entries).tolist()))}]"
        begin, step = found
        if not step:
            return f"{array}[{begin}]"
        return f"{array}[{begin} {'-' if step < 0 else '+'} {abs(step)} * k]"

    def _table(self, kind: str, entries: Iterable[str]) -> str:
        text = ", ".join(entries)
        name = self._tables.setdefault((kind, text), f"t{len(self._tables)}")
        self._before[f"static const {kind} {name}[]"] = f"{{{text}}}"
        return f"{name}[k]"
