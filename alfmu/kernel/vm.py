"""Run the functions of a scene on CasADi's virtual machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
from numpy.typing import NDArray

from ..equations import Equations
from .program import CHOICE, TIERS, Layout, Memory, Program, called

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
    calls = program["calls"]
    flat = not any(call[0] == CHOICE for call in calls)
    size = sum(equations.functions[name].n_instructions() for name in called(calls))
    symbol = ca.SX if flat and size <= FLAT else ca.MX
    known = {name: symbol.sym(name, fields[name][1]) for name in ("z", "u", "p", "k", "dt")}
    arguments = list(known.values())
    outputs = _run(equations, calls, known)
    options = {"cse": True} if symbol is ca.SX else {}
    return ca.Function("program", arguments, [known[outputs[-1]]], options)


def _run(equations: Equations, calls: list[list], known: dict[str, Any]) -> list[str]:
    """Make calls with what is known, to which the results are added; returns the names of the last results."""
    outputs: list[str] = []
    for name, *rest in calls:
        if name == CHOICE:
            number, *ways = rest
            outputs = sorted(set.intersection(*(_made(way) for way in ways)))
            inputs = sorted(set(known) & set.union(*(_used(way) for way in ways)))
            choice = ca.Function.if_else("choice", *(_block(equations, way, known, inputs, outputs) for way in ways))
            results = choice.call([known[number], *(known[i] for i in inputs)])
        else:
            inputs, outputs = rest
            results = equations.functions[name].call([known[i] for i in inputs])
        known.update(zip(outputs, results, strict=True))
    return outputs


def _block(
    equations: Equations, calls: list[list], known: dict[str, Any], inputs: list[str], outputs: list[str]
) -> ca.Function:
    """Calls as a function of its own."""
    x = {name: ca.MX.sym(name, known[name].sparsity()) for name in inputs}
    arguments = list(x.values())
    _run(equations, calls, x)
    return ca.Function("block", arguments, [x[name] for name in outputs])


def _made(calls: list[list]) -> set[str]:
    return {key for _, _, outputs in calls for key in outputs}


def _used(calls: list[list]) -> set[str]:
    return {key for _, inputs, _ in calls for key in inputs}


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
        self._time, self._trouble, self._near = (
            at("z", layout.time),
            at("after", layout.trouble),
            at("after", layout.near),
        )
        self._dt, self._step_size, self._first = at("dt", 0), at("control", 0), at("control", 1)
        self._tally = memory["tally"]
        self._arguments = [memory[name] for name in ("z", "u", "p", "k", "dt")]
        kernel = vm.equations.kernel
        self._functions: dict[int, list[ca.Function]] = {}
        self._runs: dict[int, list[Callable[[], Any]]] = {}
        for tier in (0, 1):
            same = tier and kernel["quick"] == kernel["careful"]
            self._build(tier, self._functions[0][0] if same else None)
        instant = program_function(vm.equations, kernel["instant"])
        self._seen = memory["seen"]
        self._instant = vm.bound(instant, self._arguments, [self._seen])
        self._limit: Callable[[], Any] | None = None
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
                self._tally[tier] += _BUNDLE**level
                level = min(level + 1, _LARGEST)
            else:
                level -= 1
        return done

    def read(self) -> bool:
        self._instant()
        if self._block[self._seen_near] != 0.0:
            if self._limit is None:
                limit = program_function(self._vm.equations, self._vm.equations.kernel["limit"])
                self._limit = self._vm.bound(limit, self._arguments, [self._seen])
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
        self._tally[tier] += 1.0
        if tier == 2:
            self._tally[-1] += m[self._near]
        return True

    def _build(self, tier: int, function: ca.Function | None = None) -> None:
        """The step of a tier; that on the branch when it is first wanted."""
        e = self._vm.equations
        self._functions[tier] = [function or program_function(e, e.kernel[TIERS[tier]])]
        self._runs[tier] = [self._bound(self._functions[tier][0])]

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
