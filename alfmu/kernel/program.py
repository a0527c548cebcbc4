"""What every way to run a scene shares: where its numbers stand, the shapes of its functions, a step as calls of them.

Nothing here needs CasADi; it travels inside an FMU.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from ..method.inputs import memory_size

__all__ = [
    "CHOICE",
    "FACTOR",
    "GROSS",
    "LEAST_NORM",
    "LIBRARY",
    "LOOP",
    "PACE",
    "PLATFORM",
    "SETTINGS",
    "SOLVE",
    "STAGED",
    "SUFFIX",
    "TIERS",
    "TURN",
    "Backend",
    "Call",
    "Layout",
    "Memory",
    "Program",
    "Signature",
    "called",
    "given",
]

Program = dict[str, Any]
"""A step, or what is read at an instant.

The plan it was traced by (`alfmu.kernel.trace.Plan`), and its `calls`: a list that begins with `given` and ends with
`after` or `seen`; in the programs of a method with pace in place of dt, and beside `after`. A call is [function,
names of its arguments, names of its results]; or [CHOICE, name of a number, calls to make where it is not zero, calls
to make where it is]. Programs of a method (STAGED), and of native FMUs, may also have [LOOP, name of a number, times,
calls to make while it is not zero], at most so many times or as often as a number of that name says; [FACTOR, [weights,
parts], [factors, order], n, m], which factorises the matrix of m times m blocks (n, n) that are sums of the parts of
their row, by weights of row and column; and [SOLVE, [factors, order, m vectors], [solution], n, m]. Native FMUs alone
have [LEAST_NORM, [matrix (n, n), vector], [solution], n], the least-squares solution of least norm.
"""

CHOICE = "?"
"""Marks a choice between calls."""

STAGED = ("method", "beside")
"""A step by the method of the scene; the same on the branch of the motion, beside singular positions."""

LOOP, FACTOR, SOLVE, LEAST_NORM = "*", "factor", "solve", "least_norm"
"""Marks loops, and what is done by routines that all scenes share."""

TIERS = ("quick", "careful", "branch")
"""Steps in the order in which they are tried; `branch` at once where a position is nearly singular."""

Signature = dict[str, Any]
"""`inputs`, the length of each argument; `outputs`, [rows, columns] of each result, or [rows, columns, column offsets,
row indices] where it is sparse; `matrices`, how many of the results are matrices, the rest being vectors."""

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
"""Of shared libraries here."""

PLATFORM = f"{sys.platform}-{platform.machine().lower()}"
"""What a compiled library is tied to."""

LIBRARY = f"kernel-{PLATFORM}{SUFFIX}"
"""Name of the compiled functions in an FMU."""

GROSS = 1e-6
"""Residue of a constraint, in units of its row [m, rad; per s], above which a projected step is refused."""

TURN = np.pi
"""Most that a coordinate in radians may turn in an internal step [rad]; beyond it no method sees what lies between."""

SETTINGS = 10
"""Numbers before the weights of the constraints in k: alpha, tolerance; degrees of freedom, logarithm of the product of
the pivots that masses make, product of all pivots below which a position may be singular, margin that is nothing, least
distance of places beside a singular position, whether to continue on the branch there (`method.singular`), relative and
absolute tolerance of a step with error control."""


PACE = ("dt", "before", "refused", "fixed", "end", "last", "accepted")
"""What step control remembers (`method.stepping.Control.numbers`); the length of all steps where they have one, else 0,
the end of the communication step, the length of the last step in it that was accepted, 0 before the first; whether the
last one was accepted."""


def given(layout: Layout) -> list[str]:
    """What a step takes."""
    return ["z", "u", "p", "k", "dt", *["past"] * bool(layout.fields["past"][1])]


def called(calls: list[list]) -> Iterator[str]:
    """Names of the functions that calls may call, in order and with repetition."""
    for name, *rest in calls:
        if name == CHOICE:
            yield from called(rest[1])
            yield from called(rest[2])
        elif name == LOOP:
            yield from called(rest[2])
        elif name not in (FACTOR, SOLVE, LEAST_NORM):
            yield name


class Layout:
    """Where things stand in the one array of doubles of an instance; every name maps to (offset, length).

    ========  ==========================================================================================
    z         state: q, v, unwrapped angles, work, time, and from the last step: trouble (number of checks
              that failed), change (of accelerations in the last iteration, squared over their size; of a step
              with error control its error over the tolerance), pivot
              (smallest of the augmented mass over alpha), near (stages too near a singular position; in a
              step on the branch those in which a limit was taken)
    after     the state after a step under way
    begin     the state before a communication step under way
    u, p, k   inputs; parameters; SETTINGS, the penalty of each constraint over alpha, one over the unit of each
              constraint, alpha over the scale of the pivot of each coordinate, and where constraints may have a
              compliance the least one over that of each; where redundant ones would brake, what stands for all
              penalties over alpha (`oracle.Instance.hold`), a matrix
    dt        internal step [s]
    control   largest internal step [s], first tier (0 quick, 1 careful), what makes the steps (0 the tiers, 1 the
              method of the scene with error control, 2 the same in steps of one length)
    tally     internal steps made by each tier, limits taken; by the method of the scene: steps, refused ones, tries
              on the branch, limits taken
    pace      PACE
    past      inputs at past communication points (`alfmu.method.inputs`), where the scene extrapolates them
    passes    of Newton's method, where the method is implicit
    history   what the method keeps from step to step inside a communication step
    seen      what can be read at an instant, largest |Phi-ddot|, whether that is a limit, trouble
    ========  ==========================================================================================
    """

    def __init__(self, equations: Equations):
        e = equations
        self.n, self.l, self.angles = e.n, e.l, len(e.wrapped)
        self.work = 2 * e.n + self.angles
        self.time, self.trouble, self.change, self.pivot, self.near = (self.work + i for i in range(1, 6))
        size = self.work + 6
        seen = e.signatures["seen"]["outputs"][0][0] if e.kernel else 0
        kept = e.kernel.get("method", {}).get("history", 0)
        fields = {
            "z": size,
            "after": size,
            "begin": size,
            "u": len(e.inputs),
            "p": len(e.parameters) + len(e.held),
            "k": SETTINGS + 2 * e.l + e.n + len(e.compliances) + e.brakes * e.l**2,
            "dt": 1,
            "control": 3,
            "tally": len(TIERS) + 5,
            "pace": len(PACE),
            "past": memory_size(len(e.inputs)) if "reach" in e.kernel else 0,
            "passes": bool(kept),
            "history": kept,
            "seen": seen,
        }
        self.fields: dict[str, tuple[int, int]] = {}
        self.size = 0
        for name, length in fields.items():
            self.fields[name] = self.size, length
            self.size += length


class Memory:
    """The numbers of one instance: `memory["z"]` is a view into one array, `block`."""

    def __init__(self, layout: Layout, block: NDArray | None = None):
        self.layout = layout
        self.block = np.zeros(layout.size) if block is None else block

    def __getitem__(self, name: str) -> NDArray:
        offset, length = self.layout.fields[name]
        return self.block[offset : offset + length]

    def at(self, name: str, index: int) -> int:
        """Place in the block of an entry of a field."""
        return self.layout.fields[name][0] + index


class Backend(Protocol):
    """A way to run the functions of a scene."""

    def bind(self, name: str, x: list[NDArray], y: list[NDArray]) -> Callable[[], Any]:
        """The function bound to arrays for its arguments and the nonzeros of its results."""

    def memory(self, layout: Layout) -> Memory: ...


class Call:
    """A function called on arrays of its own: dense, or sparse matrices whose pattern never changes."""

    def __init__(self, backend: Backend, name: str, signature: Signature):
        self.x = [np.zeros(size) for size in signature["inputs"]]
        y = [np.zeros(len(shape[3]) if len(shape) > 2 else shape[0] * shape[1]) for shape in signature["outputs"]]
        self._run, self._backend = backend.bind(name, self.x, y), backend  # which keeps alive what runs
        self.y = [
            _matrix(each, shape) if i < signature["matrices"] else each
            for i, (each, shape) in enumerate(zip(y, signature["outputs"], strict=True))
        ]

    def __call__(self, *arguments: NDArray | float) -> list[Any]:
        for x, value in zip(self.x, arguments, strict=True):
            x[:] = value
        self._run()
        return self.y


def _matrix(data: NDArray, shape: list) -> Any:
    if len(shape) == 2:
        return data.reshape(shape, order="F")
    from scipy.sparse import csc_array

    rows, columns, offsets, indices = shape
    return csc_array((data, np.array(indices), np.array(offsets)), shape=(rows, columns), copy=False)
