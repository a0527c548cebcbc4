"""Run the functions of a scene on CasADi's virtual machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
from numpy.typing import NDArray

from ..equations import Equations
from .program import Layout, Memory, Program

__all__ = ["Vm", "program_function"]

FLAT = 40000
"""Instructions up to which a step is one flat function; a longer one calls its parts."""

_BUNDLE = 8
"""Internal steps in one call of the next larger function."""

_LARGEST = 3
"""Bundles of bundles."""


def program_function(equations: Equations, program: Program) -> ca.Function:
    """A program as one function of z, u, p, k, dt: with subexpressions shared, or of calls where it is long."""
    fields = Layout(equations).fields
    size = sum(equations.functions[name].n_instructions() for name, _, _ in program["calls"])
    symbol = ca.SX if size <= FLAT else ca.MX
    arguments = {name: symbol.sym(name, fields[name][1]) for name in ("z", "u", "p", "k", "dt")}
    known, outputs = dict(arguments), []
    for name, inputs, outputs in program["calls"]:
        results = equations.functions[name].call([known[i] for i in inputs])
        known.update(zip(outputs, results, strict=True))
    options = {"cse": True} if symbol is ca.SX else {}
    return ca.Function("program", list(arguments.values()), [known[outputs[-1]]], options)


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

    def machine(self, memory: Memory) -> _Machine:
        return _Machine(self, memory)


class _Machine:
    """See `alfmu.kernel.program.Machine`."""

    def __init__(self, vm: Vm, memory: Memory):
        self._vm, self._memory = vm, memory
        self._z, self._after, self._begin = memory["z"], memory["after"], memory["begin"]
        self._block = memoryview(memory.block)
        layout, at = memory.layout, memory.at
        self._time, self._trouble = at("z", layout.time), at("after", layout.trouble)
        self._dt, self._step_size, self._first = at("dt", 0), at("control", 0), at("control", 1)
        self._tally = at("tally", 0)
        self._arguments = [memory[name] for name in ("z", "u", "p", "k", "dt")]
        kernel = vm.equations.kernel
        careful = program_function(vm.equations, kernel["careful"])
        quick = careful if kernel["quick"] == kernel["careful"] else program_function(vm.equations, kernel["quick"])
        self._functions = [[quick], [careful]]
        self._runs = [[self._bound(quick)], [self._bound(careful)]]
        instant = program_function(vm.equations, kernel["instant"])
        self._instant = vm.bound(instant, self._arguments, [memory["seen"]])
        self._seen_trouble = at("seen", len(memory["seen"]) - 1)

    def communicate(self, start: float, h: float) -> bool:
        m, time = self._block, self._time
        if not (0.0 < h < math.inf and abs(start - m[time]) <= 1e-6 * h + 1e-12 * abs(start)):
            return False
        ratio = h / m[self._step_size] * (1 - 1e-12)
        before = m[time]
        m[time] = start
        if ratio <= 1.0:
            tier = int(m[self._first])
            m[self._dt] = h
            self._runs[tier][0]()
            if m[self._trouble] != 0.0:
                tier = 1
                self._runs[1][0]()
                if m[self._trouble] != 0.0:
                    m[time] = before
                    return False
            self._z[:] = self._after
            m[self._tally + tier] += 1.0
        else:
            n = math.ceil(ratio)
            self._begin[:] = self._z
            tally = m[self._tally], m[self._tally + 1]
            if self.advance(n, h / n) < n:
                self._z[:] = self._begin
                m[time] = before
                m[self._tally], m[self._tally + 1] = tally
                return False
        m[time] = start + h
        return True

    def advance(self, steps: int, dt: float) -> int:
        m, done, level = self._block, 0, _LARGEST
        m[self._dt] = dt
        tier = int(m[self._first])
        while done < steps:
            while _BUNDLE**level > steps - done:
                level -= 1
            if self._ran(self._bundle(tier, level)):
                size, used, level = _BUNDLE**level, tier, min(level + 1, _LARGEST)
            elif level:
                level -= 1
                continue
            elif self._ran(self._runs[1][0]):
                size, used = 1, 1
            else:
                break
            m[self._tally + used] += size
            done += size
        return done

    def read(self) -> bool:
        self._instant()
        return self._block[self._seen_trouble] == 0.0

    def _ran(self, run: Callable[[], Any]) -> bool:
        run()
        if self._block[self._trouble] != 0.0:
            return False
        self._z[:] = self._after
        return True

    def _bundle(self, tier: int, level: int) -> Callable[[], Any]:
        """The step 8^level times in one call; built when first wanted."""
        functions, runs = self._functions[tier], self._runs[tier]
        while level >= len(runs):
            z, *rest = (ca.MX.sym(f"x{i}", len(x)) for i, x in enumerate(self._arguments))
            after = z
            for _ in range(_BUNDLE):
                after = functions[-1](after, *rest)
            functions.append(ca.Function("steps", [z, *rest], [after]))
            runs.append(self._bound(functions[-1]))
        return runs[level]

    def _bound(self, function: ca.Function) -> Callable[[], Any]:
        return self._vm.bound(function, self._arguments, [self._after])
