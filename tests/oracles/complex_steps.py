"""The programs of a scene in complex numbers: what a small imaginary part of a number becomes, over that part, is its
derivative to round-off.

It executes CasADi's instructions one by one and knows nothing of tangents, tapes or the arrangement of scene files.
Decisions go by real parts, step control has no imaginary part.
"""

import cmath
from collections.abc import Callable, Iterable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from alfmu.kernel.controlled import whole
from alfmu.kernel.form import Call, Choice, Factor, Lanes, Loop, Solve, Step
from alfmu.kernel.memory import PACE, Layout
from alfmu.kernel.stream import Instructions
from alfmu.runtime import Instance

__all__ = ["EPSILON", "Complex"]

EPSILON = 1e-30
"""The imaginary part: its square is nothing beside any number."""


def _atan2(a: complex, b: complex) -> complex:
    slope = (b.real * a.imag - a.real * b.imag) / (a.real**2 + b.real**2 or 1.0)
    return complex(np.arctan2(a.real, b.real), slope)


_TWO: dict[int, Callable[[complex, complex], complex]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b if b else complex(np.float64(a.real) / np.float64(b.real)),
    ca.OP_LT: lambda a, b: complex(a.real < b.real),
    ca.OP_LE: lambda a, b: complex(a.real <= b.real),
    ca.OP_EQ: lambda a, b: complex(a.real == b.real),
    ca.OP_NE: lambda a, b: complex(a.real != b.real),
    ca.OP_AND: lambda a, b: complex(bool(a.real) and bool(b.real)),
    ca.OP_OR: lambda a, b: complex(bool(a.real) or bool(b.real)),
    ca.OP_IF_ELSE_ZERO: lambda a, b: b if a.real else 0j,
    ca.OP_POW: lambda a, b: a**b,
    ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_ATAN2: _atan2,
    ca.OP_FMIN: lambda a, b: a if a.real < b.real or b.real != b.real else b,
    ca.OP_FMAX: lambda a, b: a if a.real > b.real or b.real != b.real else b,
    ca.OP_REMAINDER: lambda a, b: a - round(a.real / b.real) * b,
    ca.OP_HYPOT: lambda a, b: cmath.sqrt(a * a + b * b),
    ca.OP_COPYSIGN: lambda a, b: a if (a.real < 0) == (b.real < 0) else -a,
}
_ONE: dict[int, Callable[[complex], complex]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: lambda a: -a,
    ca.OP_NOT: lambda a: complex(not a.real),
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: 1 / a if a else complex(np.inf),
    ca.OP_SIGN: lambda a: complex(np.sign(a.real)),
    ca.OP_FABS: lambda a: -a if a.real < 0 else a,
    ca.OP_FLOOR: lambda a: complex(np.floor(a.real)),
    ca.OP_CEIL: lambda a: complex(np.ceil(a.real)),
    ca.OP_SQRT: lambda a: complex(np.nan) if a.real < 0 else cmath.sqrt(a),
    ca.OP_EXP: cmath.exp,
    ca.OP_LOG: lambda a: cmath.log(a) if a else complex(-np.inf),
    ca.OP_SIN: cmath.sin,
    ca.OP_COS: cmath.cos,
    ca.OP_TAN: cmath.tan,
    ca.OP_ATAN: cmath.atan,
    ca.OP_TANH: cmath.tanh,
}


class _Function:
    """A function of the scene, instruction by instruction."""

    def __init__(self, f: ca.Function):
        found = Instructions.of(f)
        self._steps = list(
            zip(
                found.code.tolist(),
                *found.operands.tolist(),
                *found.place.tolist(),
                found.constant.tolist(),
                strict=True,
            )
        )
        self._outputs = [f.nnz_out(k) for k in range(f.n_out())]

    def __call__(self, arguments: list[NDArray[np.complex128]]) -> list[NDArray[np.complex128]]:
        made: list[complex] = []
        results = [np.zeros(count, complex) for count in self._outputs]
        for code, a, b, which, entry, constant in self._steps:
            if code == ca.OP_INPUT:
                value = complex(arguments[which][entry])
            elif code == ca.OP_CONST:
                value = complex(constant)
            elif code == ca.OP_OUTPUT:
                value = made[a]
                results[which][entry] = value
            elif code in _TWO:
                value = _TWO[code](made[a], made[b])
            else:
                value = _ONE[code](made[a])
            made.append(value)
        return results


class Complex:
    """The motion of an instance that is initialised, from a state of its own, with parameters of its own."""

    def __init__(self, unit: Instance, q: NDArray, v: NDArray, p: NDArray):
        self.e, self.layout = whole(unit.equations), Layout(unit.equations)
        self.m: dict[str, NDArray[np.complex128]] = {
            name: np.array(unit.memory[name], complex) for name in self.layout.fields
        }
        n = self.layout.n
        self.m["z"][:n], self.m["z"][n : 2 * n], self.m["p"] = q, v, np.array(p, complex)
        self._matrices: dict[str, NDArray[np.complex128]] = {}
        self._functions: dict[str, _Function] = {}
        self.tiers: list[str] = []

    def _call(self, step: Call) -> None:
        if step.function not in self._functions:
            self._functions[step.function] = _Function(self.e.functions[step.function])
        results = self._functions[step.function]([self.m[name] for name in step.arguments])
        self.m.update(zip(step.results, results, strict=True))

    def run(self, steps: Iterable[Step]) -> None:
        with np.errstate(all="ignore"):  # on ways that are not taken
            self._run(steps)
        self.m["pace"], self.m["tally"] = self.m["pace"].real + 0j, self.m["tally"].real + 0j

    def _run(self, steps: Iterable[Step]) -> None:
        for step in steps:
            if isinstance(step, Call):
                self._call(step)
            elif isinstance(step, Lanes):
                self._run(step.calls)
            elif isinstance(step, Choice):
                self._run(step.nonzero if self.m[step.number][0].real else step.zero)
            elif isinstance(step, Loop):
                most = step.most if isinstance(step.most, int) else int(self.m[step.most][0].real)
                for _ in range(most):
                    if not self.m[step.number][0].real:
                        break
                    self._run(step.body)
            else:
                self._algebra(step)

    def _algebra(self, step: Any) -> None:
        n, s = step.side, step.count
        if isinstance(step, Factor):
            weights, *parts = (self.m[name] for name in step.arguments)
            terms = len(parts) // s
            matrix = np.zeros((n * s, n * s), complex)
            for t in range(terms):
                for i in range(s):
                    part = parts[t * s + i].reshape(n, n, order="F")
                    for j in range(s):
                        matrix[i * n : (i + 1) * n, j * n : (j + 1) * n] += weights[(t * s + i) * s + j] * part
            self.m[step.results[0]] = matrix.ravel()
            self.m[step.results[1]] = np.zeros(n * s, complex)
        elif isinstance(step, Solve):
            matrix = self.m[step.arguments[0]].reshape(n * s, n * s)
            right = np.concatenate([self.m[name] for name in step.arguments[2:]])
            self.m[step.results[0]] = np.linalg.solve(matrix, right)
        else:
            raise NotImplementedError(type(step).__name__)

    @property
    def _troubled(self) -> bool:
        return bool(self.m["after"][self.layout.trouble].real)

    def _accept(self) -> None:
        self.m["z"] = self.m["after"].copy()

    def rk4(self, steps: int, dt: float) -> None:
        """Internal steps by the first tier that can make them, as `step_fixed` in step/fixed.c."""
        self.m["dt"][:] = dt
        for _ in range(steps):
            for tier in ("quick", "careful", "branch"):
                self.run(self.e.kernel[tier].steps)
                if not self._troubled:
                    break
            assert not self._troubled
            self.tiers.append(tier)
            self._accept()

    def method(self, end: float) -> None:
        """Steps of the method up to an end, as `step_adaptive`, where none needs more than the method itself."""
        pace = PACE.index
        self.m["pace"][pace("last")] = 0.0
        self.m["pace"][pace("end")] = end
        while self.m["z"][self.layout.time].real < end:
            self.run(self.e.kernel["method"].steps)
            assert not self._troubled
            if self.m["pace"][pace("accepted")].real:
                self._accept()
