"""Run the functions of a scene on CasADi's virtual machine."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import casadi as ca
from numpy.typing import NDArray

from ..equations import Equations
from .fusion import program_function
from .program import TIERS, Layout, Memory

__all__ = ["Vm", "serialized", "with_serialized"]

_BUNDLE = 8
"""Internal steps in one call of the next larger function."""

_LARGEST = 3
"""Bundles of bundles."""


def serialized(equations: Equations, names: Iterable[str]) -> str:
    """Functions by name, and all programs of the kernel as one function each: what `with_serialized` reads."""
    e = equations
    functions = {name: e.functions[name] for name in names if name in e.signatures}
    found = functions, {name: program_function(e, name) for name in e.kernel}
    stream = ca.StringSerializer()  # in which what several functions call is there once
    stream.pack([function for each in found for function in each.values()])
    return json.dumps({"functions": list(found[0]), "programs": list(found[1]), "casadi": stream.encode()}, indent=1)


def with_serialized(equations: Equations, text: str) -> Equations:
    """The same equations with the functions that `serialized` wrote; no program is left to be built."""
    data = json.loads(text)
    names, programs, found = data["functions"], data["programs"], ca.StringDeserializer(data["casadi"]).unpack()
    e = replace(equations, functions=dict(zip(names, found[: len(names)], strict=True)))
    e.programs.update(zip(programs, found[len(names) :], strict=True))
    return e


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
        # Single numbers and short copies take a fraction of NumPy's time this way.
        self._z, self._after, self._begin = (memoryview(memory[name]) for name in ("z", "after", "begin"))
        self._block = memoryview(memory.block)
        layout, at = memory.layout, memory.at
        self._time, self._trouble, self._near = (
            at("z", layout.time),
            at("after", layout.trouble),
            at("after", layout.near),
        )
        self._dt, self._step_size, self._first = at("dt", 0), at("control", 0), at("control", 1)
        self._tally, self._tallied = memory["tally"], at("tally", 0)
        self._arguments = [memory[name] for name in ("z", "u", "p", "k", "dt")]
        self._functions: dict[int, list[ca.Function]] = {}
        self._runs: dict[int, list[Callable[[], Any]]] = {}
        for tier in (0, 1):
            self._build(tier)
        self._seen = memory["seen"]
        self._instant = vm.bound(self._program("instant"), self._arguments, [self._seen])
        self._limit: Callable[[], Any] | None = None
        self._method: Callable[[], Any] | None = None
        self._seen_near = at("seen", len(memory["seen"]) - 2)
        self._seen_trouble = at("seen", len(memory["seen"]) - 1)

    def communicate(self, start: float, h: float) -> bool:
        m, time = self._block, self._time
        if not (0.0 < h < math.inf and abs(start - m[time]) <= 1e-6 * h + 1e-12 * abs(start)):
            return False
        ratio = h / m[self._step_size] * (1 - 1e-12)
        before = m[time]
        m[time] = start
        if ratio <= 1.0:
            m[self._dt] = h
            if not self._single():
                m[time] = before
                return False
        else:
            n = math.ceil(ratio)
            self._begin[:] = self._z
            tally = self._tally.copy()
            if self.advance(n, h / n) < n:
                self._z[:] = self._begin
                m[time] = before
                self._tally[:] = tally
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
            if level == 0:
                if not self._single():
                    break
                done, level = done + 1, 1
            elif self._ran(self._bundle(tier, level)):
                done += _BUNDLE**level
                m[self._tallied + tier] += _BUNDLE**level
                level = min(level + 1, _LARGEST)
            else:
                level -= 1
        return done

    def attempt(self, dt: float) -> bool:
        if self._method is None:
            self._method = self._bound(self._program("method"))
        self._block[self._dt] = dt
        self._method()
        return self._block[self._trouble] == 0.0

    def read(self) -> bool:
        self._instant()
        if self._block[self._seen_near] != 0.0:
            if self._limit is None:
                self._limit = self._vm.bound(self._program("limit"), self._arguments, [self._seen])
            self._limit()
        return self._block[self._seen_trouble] == 0.0

    def _single(self) -> bool:
        """An internal step by the first tier that can make it."""
        m, tier = self._block, int(self._block[self._first])
        while not self._ran(self._runs[tier][0]):
            # Near a singular position no step but that on the branch can be good.
            near = m[self._near] != 0.0
            if tier == 2 or (tier == 1 and not near):
                return False
            tier = 2 if near else 1
            if tier not in self._runs:
                self._build(tier)
        m[self._tallied + tier] += 1.0
        if tier == 2:
            m[self._tallied + len(TIERS)] += m[self._near]
        return True

    def _build(self, tier: int) -> None:
        """The step of a tier; that on the branch when it is first wanted."""
        self._functions[tier] = [self._program(TIERS[tier])]
        self._runs[tier] = [self._bound(self._functions[tier][0])]

    def _program(self, name: str) -> ca.Function:
        return program_function(self._vm.equations, name)

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
        return self._vm.bound(function, self._arguments, [self._memory["after"]])
