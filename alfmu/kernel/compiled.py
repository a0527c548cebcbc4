"""Run the functions of a scene from a compiled library: needs neither CasADi nor a compiler."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from .program import Layout, Memory

__all__ = ["Library"]


class Library:
    """A compiled scene. Raises OSError where the file is not one for this platform."""

    def __init__(self, path: Path, equations: Equations):
        self.path, self.workspace = Path(path), equations.workspace
        self._names = {name: i for i, name in enumerate(equations.signatures)}
        self._library = ctypes.CDLL(str(path))
        pointer, integer, double = ctypes.c_void_p, ctypes.c_long, ctypes.c_double
        self._declare("alfmu_call", None, ctypes.c_int, pointer, pointer, pointer)
        if equations.kernel:
            self._declare("alfmu_communicate", ctypes.c_int, pointer, double, double)
            self._declare("alfmu_advance", integer, pointer, integer, double)
            self._declare("alfmu_read", ctypes.c_int, pointer)
            if "method" in equations.kernel:
                self._declare("alfmu_cover", ctypes.c_int, pointer, double, integer)

    def _declare(self, name: str, result: Any, *arguments: Any) -> None:
        function = getattr(self._library, name)
        function.restype, function.argtypes = result, arguments
        setattr(self, name.removeprefix("alfmu_"), function)

    def bind(self, name: str, x: list[NDArray], y: list[NDArray]) -> Callable[[], Any]:
        alive = x, y, np.zeros(self.workspace)  # as long as `run`, which knows their addresses
        tables = [(ctypes.c_void_p * max(1, len(each)))(*(a.ctypes.data for a in each)) for each in (x, y)]
        arguments = self._names[name], *tables, alive[2].ctypes.data

        def run(alive: tuple = alive) -> None:
            self.call(*arguments)

        return run

    def memory(self, layout: Layout) -> Memory:
        return Memory(layout, self.workspace)

    def machine(self, memory: Memory) -> _Machine:
        return _Machine(self, memory)


class _Machine:
    """See `alfmu.kernel.program.Machine`; each call goes straight to the library."""

    def __init__(self, library: Library, memory: Memory):
        address = memory.block.ctypes.data
        self.communicate = partial(library.communicate, address)
        self.advance = partial(library.advance, address)
        self.read = partial(library.read, address)
        self.cover = partial(getattr(library, "cover", None) or library.read, address)
        for call in (self.communicate, self.advance, self.read, self.cover):
            call.alive = memory  # as long as its address is known
