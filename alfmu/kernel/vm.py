"""Functions of CasADi on NumPy arrays, as the oracle and references call them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
from numpy.typing import NDArray

from ..equations import Equations
from .program import Layout, Memory

__all__ = ["Vm"]


class Vm:
    """The functions of a scene as CasADi holds them."""

    def __init__(self, equations: Equations):
        self.equations = equations
        self._buffers: list[Any] = []

    def bind(self, name: str, x: list[NDArray], y: list[NDArray]) -> Callable[[], Any]:
        return self.bound(self.equations.functions[name], x, y)

    def bound(self, function: ca.Function, x: list[NDArray], y: list[NDArray]) -> Callable[[], Any]:
        """A function bound to arrays, to be called without any argument."""
        buffer, run = function.buffer()
        for i, each in enumerate(x):
            buffer.set_arg(i, memoryview(each))
        for i, each in enumerate(y):
            buffer.set_res(i, memoryview(each))
        self._buffers.append(buffer)
        return run

    def memory(self, layout: Layout) -> Memory:
        return Memory(layout)
