"""Write a scene as a file for the C runtime: functions as runs of equal operations, programs as calls, tables.

The file is little-endian and reproducible. A function works on one array of numbers: the constants of the scene, its
arguments, and the results of its operations, in order. Only the indices of operands are stored, and equal operations
follow each other, so that the runtime dispatches once per run (`core/interpret.c` of the runtime). Repeated parts of a
long function are loops over indices with a constant step.
"""

from __future__ import annotations

import hashlib
import re
import struct
from collections import OrderedDict
from collections.abc import Callable, Iterable
from threading import Lock

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import NDArray

from ..model.making import making
from . import passes
from .arrangement import KINDS, NARROW_HEAD, OPERANDS, SINE_COSINE, SUMS
from .form import Call, Choice, Factor, Lanes, LeastNorm, Loop, Solve
from .passes import EACH_KIND, GATHER_KIND, LOOP_KIND, NARROW, Code, written
from .stream import BINARY, OPERATIONS, ROLES, UNARY, Instructions, number

CALLS = (Call, Choice, Loop, Factor, Solve, LeastNorm, Lanes)
"""Elements of a program, in the order of their numbers."""

AGAIN = len(CALLS)
"""Number of another element, which only sources have: earlier words of the program, run again."""


def operations_header() -> str:
    """Return operations.h: the results of operations on a, b and c, in C."""
    lines = [
        "/* Operations of a scene and their formulas; generated from alfmu/kernel/scene.py. */",
        "",
        "#ifndef ALFMU_OPERATIONS_H",
        "#define ALFMU_OPERATIONS_H",
        "",
    ]
    named = set(KINDS) - {ca.OP_DIV}
    for name, table in (("BINARY_OPERATIONS", BINARY), ("UNARY_OPERATIONS", UNARY)):
        rows = [f"    X({KINDS.index(each)}, {text.format('a', 'b')})" for each, text in table.items() if each in named]
        lines += [f"#define {name}(X) \\", *(f"{row} \\" for row in rows[:-1]), rows[-1], ""]
    texts = [(each, (BINARY | UNARY)[each].format("a", "b")) for each in _SHORT]
    rows = [f"    X({KINDS.index(each)}, {text})" for each, text in texts]
    lines += ["#define SHORT_OPERATIONS(X) \\", *(f"{row} \\" for row in rows[:-1]), rows[-1], ""]
    for name, table in (("BINARY_PARTIALS", BINARY), ("UNARY_PARTIALS", UNARY)):
        rows = [f"    X({KINDS.index(each)}, {', '.join(_partials(each))})" for each in table if each in named]
        lines += [f"#define {name}(X) \\", *(f"{row} \\" for row in rows[:-1]), rows[-1], ""]
    counts = ", ".join(str(OPERANDS[kind]) for kind in KINDS)
    lines += [
        *(f"#define {name.upper()}_KIND {KINDS.index(name)}" for name in SUMS),
        f"#define IS_BINARY(kind) ((kind) <= {max(KINDS.index(x) for x in KINDS if x in BINARY)}) /* of those above */",
        f"#define OVER_KIND {KINDS.index(ca.OP_DIV)}",
        f"#define SINE_COSINE_KIND {KINDS.index(SINE_COSINE)}",
        f"#define KIND_COUNT {len(KINDS)}",
        f"#define LOOP_KIND {LOOP_KIND}",
        f"#define EACH_KIND {EACH_KIND}",
        f"#define GATHER_KIND {GATHER_KIND}",
        f"#define NARROW_HEAD {NARROW_HEAD} /* words before the operands of a run with 16-bit places, once loaded */",
        f"#define OPERAND_COUNTS {counts}",
        "#define VALUES_OF(kind) ((kind) == SINE_COSINE_KIND ? 2 : 1)",
        f"#define OPERATIONS {OPERATIONS}",
        f"enum {{ {', '.join(f'{role.upper()}_ROLE' for role in ROLES)} }};",
        f"enum {{ {', '.join(f'{_macro(step.__name__)}_CODE' for step in CALLS)}, AGAIN_CODE }};",
        "",
        "#endif",
    ]
    return "\n".join([*lines, ""])


_SHORT = (
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_NOT),
    *(ca.OP_IF_ELSE_ZERO, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FABS, ca.OP_SQRT),
)
"""Operations of a few instructions, which compilers replace by vectors."""


def _partials(operation: int) -> list[str]:
    """Return derivatives of an operation by its operands a and b, in C, as derived by CasADi."""
    operands = [SX.sym(name) for name in ("a", "b")[: OPERANDS[operation]]]
    value = SX.binary(operation, *operands) if len(operands) == 2 else SX.unary(operation, *operands)
    return [_in_c(ca.jacobian(value, each)) for each in operands]


def _in_c(x: SX) -> str:
    """Return a symbolic number in C."""
    if x.is_constant():
        return number(float(x))
    if x.is_symbolic():
        return x.name()
    text = f"({(BINARY | UNARY)[x.op()].format(*(_in_c(x.dep(k)) for k in range(x.n_dep())))})"
    return f"((double){text})" if x.op() in _TRUTHS else text


_TRUTHS = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_NOT)
"""Operations that give 0 or 1, which are integers in C."""


def _macro(name: str) -> str:
    """Return a name in C."""
    return re.sub("(?<=[a-z])(?=[A-Z])", "_", name).upper()


class _Written:
    """A cache of the most recently used encoded functions."""

    MOST = 2**23
    """Largest number of cached words: 64 MB."""

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, Code] = OrderedDict()
        self._words = 0
        self._lock = Lock()

    def get(self, key: bytes, write: Callable[[], Code]) -> Code:
        """Return the code of a key, written now if missing."""
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        made = write()
        with self._lock:
            if key not in self._known:
                self._known[key] = made
                self._words += len(made.words)
            while self._words > self.MOST:
                self._words -= len(self._known.popitem(last=False)[1].words)
        return made


_WRITTEN = _Written()


def code(f: ca.Function, scene: str) -> Code:
    """Encode a function that calls no other.

    Scenes of one mechanism share most functions, each of which is encoded once.
    """
    making(f.name())
    instructions = Instructions.of(f)
    instructions.check(scene, f.name())
    inputs, outputs = (
        [part(i) for i in range(count)] for part, count in ((f.nnz_in, f.n_in()), (f.nnz_out, f.n_out()))
    )
    key = hashlib.sha256(repr((inputs, outputs, passes.LONG, passes.WORTH)).encode())
    for each in instructions.arrays:
        key.update(each.data)
    return _WRITTEN.get(key.digest(), lambda: written(instructions, inputs, outputs))


class Writer:
    """Bytes of a scene file, little-endian."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []

    def integer(self, value: int) -> None:
        self.parts.append(struct.pack("<i", value))

    def real(self, value: float) -> None:
        self.parts.append(struct.pack("<d", value))

    def text(self, value: str) -> None:
        data = value.encode()
        self.integer(len(data))
        self.parts.append(data)

    def integers(self, values: Iterable[int] | NDArray) -> None:
        """Write a count and integers."""
        data = np.asarray(values if isinstance(values, np.ndarray) else list(values), np.int64)
        self.integer(data.size)
        self.bare(data)

    def bare(self, values: NDArray) -> None:
        """Write integers of 32 bits: small ones take one byte, others up to five. The sign is the lowest bit; each byte
        has seven bits, the highest ones first, and an eighth if more bytes follow."""
        data = np.where(values < 0, -2 * values - 1, 2 * values)
        lengths = 1 + sum((data >= 1 << bits).astype(np.int64) for bits in (7, 14, 21, 28))
        ends = np.cumsum(lengths)
        made = np.zeros(ends[-1] if len(ends) else 0, np.uint8)
        for k in range(5):
            there = lengths > k
            made[ends[there] - 1 - k] = data[there] >> 7 * k & 127 | 128 * (k > 0)
        self.parts.append(made.tobytes())

    def reals(self, values: Iterable[float]) -> None:
        data = np.array(list(values), "<f8")
        self.integer(data.size)
        self.parts.append(data.tobytes())

    def code(self, made: Code, constants: NDArray, count: int) -> None:
        """Write a function whose constants have these indices among `count` of the scene."""
        words, results = (made.placed(places, constants, count) for places in (made.words, made.results))
        self.integers(made.inputs)
        self.integers(made.outputs)
        wide = made.looped or count + sum(made.inputs) + made.values > NARROW
        self.integer(int(wide))
        if wide:
            self.integers(words)
            self.integers(results.ravel())
            return
        found = np.zeros(sum(made.outputs), np.int64)
        counts, entries, steps, places, strides = results.T
        found[_in_rows(counts, entries, steps)] = _in_rows(counts, places, strides)  # the last one counts
        runs, differences = _differences(words, found, count + sum(made.inputs))
        self.integer(len(words) + (NARROW_HEAD - 2) * runs)
        self.bare(differences)


def _differences(words: NDArray, results: NDArray, first: int) -> tuple[int, NDArray]:
    """Return the number of runs, and all numbers of a function: kind, count and operands of each run, then results.

    Places are stored as differences, so that archives are smaller. Addresses from `first` on, which are results of
    operations, count back from the end of the run; those of results count back from the end of all runs. The first
    operands of a run precede the second ones, and each is stored as its difference from the one before.
    """

    begins, heads, at = [], [], 0
    while at < len(words):
        begins.append(at + 2)
        heads.append(words[at : at + 2].tolist())
        at += 2 + _OPERANDS[heads[-1][0]] * heads[-1][1]
    kinds, counts = np.array(heads, np.int64).reshape(-1, 2).T
    each = _OPERANDS[kinds]
    ends = first + np.cumsum(counts * np.where(kinds == _PAIR, 2, 1))
    lengths = np.repeat(counts, each)  # length of each sequence: the operands of a run at one place
    first_of_place = _in_rows(each, np.array(begins, np.int64), np.ones_like(each))
    places = words[_in_rows(lengths, first_of_place, np.repeat(each, each))]

    def stored(places: NDArray, end: NDArray | int, lengths: NDArray) -> NDArray:
        found = np.where(places < first, places, places - end)
        before = np.concatenate([[0], found[:-1]])
        before[(np.cumsum(lengths) - lengths)[lengths > 0]] = 0
        return found - before[: len(found)]

    made = words.copy()
    made[_in_rows(lengths, _in_rows(each, np.array(begins, np.int64), counts), np.ones_like(lengths))] = stored(
        places, np.repeat(np.repeat(ends, each), lengths), lengths
    )
    end = int(ends[-1]) if len(ends) else first
    return len(heads), np.concatenate([made, stored(results, end, np.array([len(results)]))])


def _in_rows(counts: NDArray, first: NDArray, steps: NDArray) -> NDArray:
    """Return consecutive arithmetic sequences, each given by its count, first number and step."""
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(first, counts) + np.repeat(steps, counts) * within


_OPERANDS, _PAIR = np.array([OPERANDS[kind] for kind in KINDS]), KINDS.index(SINE_COSINE)
