"""A scene as one file that the C runtime loads: functions as runs of equal operations, programs as calls, tables.

The file is little-endian and the same bytes for the same equations. A function works on one array of numbers: the
constants of the scene, then its arguments, then what each of its operations gives, in order. Of an operation the places
of its operands are stored alone, and equal operations follow each other, so that the runtime chooses what to do once a
run (`runtime/interpret.c`). What repeats in a long function is a loop over places that go by a step.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .arrangement import KINDS, SINE_COSINE, SUMS, arranged
from .stream import BINARY, UNARY, Instructions

__all__ = ["CALLS", "Code", "Constants", "Writer", "code", "operations_header"]

LOOP_KIND, GATHER_KIND = len(KINDS), len(KINDS) + 1
"""Numbers of what else there is in a function: a loop, and values found by a table in each pass of it."""

CALLS = ("call", "choice", "loop", "factor", "solve", "least_norm")
"""What a program is made of, in the order of their numbers."""

NARROW = 2**16
"""Places that operands of 16 bits reach."""

LONG = 6000
"""Operations above which a function is searched for what repeats."""


def operations_header() -> str:
    """operations.h: what operations compute from a, b and c, in C."""
    lines = ["/* What operations of a scene compute; generated from alfmu/kernel/scene.py. */", ""]
    for name, table in (("BINARY_OPERATIONS", BINARY), ("UNARY_OPERATIONS", UNARY)):
        rows = [f"    X({KINDS.index(each)}, {text.format('a', 'b')})" for each, text in table.items() if each in KINDS]
        lines += [f"#define {name}(X) \\", *(f"{row} \\" for row in rows[:-1]), rows[-1], ""]
    counts = ", ".join(str(OPERANDS[kind]) for kind in KINDS)
    lines += [
        *(f"#define {name.upper()}_KIND {KINDS.index(name)}" for name in SUMS),
        f"#define SINE_COSINE_KIND {KINDS.index(SINE_COSINE)}",
        f"#define KIND_COUNT {len(KINDS)}",
        f"#define LOOP_KIND {LOOP_KIND}",
        f"#define GATHER_KIND {GATHER_KIND}",
        f"#define OPERAND_COUNTS {counts}",
        f"enum {{ {', '.join(f'{name.upper()}_CODE' for name in CALLS)} }};",
    ]
    return "\n".join([*lines, ""])


OPERANDS = {kind: 2 if kind in BINARY else 1 for kind in KINDS} | {kind: 3 + 2 * i for i, kind in enumerate(SUMS)}
"""How many operands operations of a kind have."""


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
    """A function of a scene. Places count from the first constant; negative ones, from behind the last."""

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


def code(f: ca.Function, constants: Constants, scene: str) -> Code:
    """The operations of a function that calls no other."""
    instructions = Instructions.of(f)
    instructions.check(scene, f.name())
    inputs, outputs = (
        [part(i) for i in range(count)] for part, count in ((f.nnz_in, f.n_in()), (f.nnz_out, f.n_out()))
    )
    return _straight(instructions, constants, inputs, outputs)


def _straight(instructions: Instructions, constants: Constants, inputs: list[int], outputs: list[int]) -> Code:
    """All operations once, each value in a place of its own."""
    made = arranged(instructions)
    offsets, begins = np.cumsum([0, *inputs]).tolist(), np.cumsum([0, *outputs]).tolist()
    place = {k: constants.place(value) for k, value in made.constants.items()}
    place |= {k: -1 - offsets[which] - entry for k, (which, entry) in made.arguments.items()}
    words: list[int] = []
    end = -1 - offsets[-1]
    for run in made.runs:
        for part in batched(run, NARROW - 1):
            words += [part[0].kind, len(part)]
            for operation in part:
                words += [place[k] for k in operation.operands]
                for k in operation.made:
                    place[k] = end
                    end -= 1
    results = [constants.place(0.0)] * sum(outputs)  # what no operation gives is zero
    for which, entry, k in made.results:
        results[begins[which] + entry] = place[k]
    return Code(inputs, outputs, np.array(words, np.int64), np.array(results, np.int64), -1 - offsets[-1] - end)


def batched(values: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    """Parts of at most `size`."""
    return (values[i : i + size] for i in range(0, len(values), size))


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

    def integers(self, values: Iterable[int] | NDArray, kind: str = "<i4") -> None:
        """How many there are, and each."""
        data = np.asarray(values if isinstance(values, np.ndarray) else list(values), np.int64).astype(kind)
        self.integer(data.size)
        self.parts.append(data.tobytes())

    def reals(self, values: Iterable[float]) -> None:
        data = np.array(list(values), "<f8")
        self.integer(data.size)
        self.parts.append(data.tobytes())

    def code(self, made: Code, constants: int) -> None:
        """A function whose places are known now."""

        def placed(places: NDArray) -> NDArray:
            return np.where(places < 0, constants - 1 - places, places)

        top = constants + sum(made.inputs) + made.values
        self.integers(made.inputs)
        self.integers(made.outputs)
        narrow = top <= NARROW
        self.integer(int(not narrow))
        kind = "<u2" if narrow else "<i4"
        self.integers(placed(made.words), kind)
        self.integers(placed(made.results), kind)
