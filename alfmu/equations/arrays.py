"""Functions of equations on NumPy arrays, evaluated by CasADi: for the oracle, studies and references."""

from collections.abc import Callable
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .types import Equations, Signature


class Backend(Protocol):
    """Evaluates functions."""

    def bind(self, name: str, x: list[NDArray[np.float64]], y: list[NDArray[np.float64]]) -> Callable[[], Any]:
        """Return a call without arguments that evaluates the function from arrays x into the nonzeros y."""


class ArrayFunctions:
    """Functions of equations, evaluated by CasADi."""

    def __init__(self, equations: Equations):
        self.equations = equations
        self._buffers: list[Any] = []

    def bind(self, name: str, x: list[NDArray[np.float64]], y: list[NDArray[np.float64]]) -> Callable[[], Any]:
        return self.bound(self.equations.functions[name], x, y)

    def bound(
        self, function: ca.Function, x: list[NDArray[np.float64]], y: list[NDArray[np.float64]]
    ) -> Callable[[], Any]:
        """Return a call without arguments that evaluates the function from arrays x into the nonzeros y."""
        buffer: Any  # stubs of CasADi expect the size beside the memory, as in C++
        buffer, run = function.buffer()
        for i, each in enumerate(x):
            buffer.set_arg(i, each.data)
        for i, each in enumerate(y):
            buffer.set_res(i, each.data)
        self._buffers.append(buffer)
        return run


class ArrayFunction:
    """A function with its own arrays: dense, or sparse matrices of constant pattern."""

    def __init__(self, backend: Backend, name: str, signature: Signature):
        self.x: list[NDArray[np.float64]] = [np.zeros(size) for size in signature["inputs"]]
        y = [np.zeros(len(shape[3]) if len(shape) > 2 else shape[0] * shape[1]) for shape in signature["outputs"]]
        self._run, self._backend = backend.bind(name, self.x, y), backend  # the backend owns memory that `_run` uses
        self.y: list[Any] = [
            _matrix(each, shape) if i < signature["matrices"] else each
            for i, (each, shape) in enumerate(zip(y, signature["outputs"], strict=True))
        ]

    def __call__(self, *arguments: NDArray[np.float64] | float) -> list[Any]:
        for x, value in zip(self.x, arguments, strict=True):
            x[:] = value
        self._run()
        return self.y


def _matrix(data: NDArray[np.float64], shape: list) -> Any:
    if len(shape) == 2:
        return data.reshape(shape, order="F")
    from scipy.sparse import csc_array

    rows, columns, offsets, indices = shape
    return csc_array((data, np.array(indices), np.array(offsets)), shape=(rows, columns), copy=False)
