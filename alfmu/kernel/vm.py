"""Run the functions of a scene on CasADi's virtual machine."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from .fusion import functions_of, program_function, staged
from .program import FACTOR, LOOP, PACE, SOLVE, TIERS, Layout, Memory, given

__all__ = ["Vm", "serialized", "with_serialized"]

_BUNDLE = 8
"""Internal steps in one call of the next larger function."""

_LARGEST = 3
"""Bundles of bundles."""


def serialized(equations: Equations, names: Iterable[str]) -> str:
    """Functions by name, and all programs of the kernel as one function each: what `with_serialized` reads."""
    e = equations
    functions = {name: e.functions[name] for name in names if name in e.signatures}
    found = functions, {key: f for name in e.kernel for key, f in functions_of(e, name).items()}
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
        self._tallied = at("tally", 0)
        self._arguments = [memory[name] for name in given(layout)]
        self._reach: Callable[[], Any] | None = None
        if layout.fields["past"][1]:
            noted = np.zeros_like(memory["past"])
            reach, past = vm.bound(self._program("reach"), self._arguments, [noted]), memory["past"]
            self._reach = lambda: (reach(), np.copyto(past, noted))
        self._kept = memory.block[at("tally", 0) : layout.fields["past"][0] + layout.fields["past"][1]]
        self._functions: dict[int, list[ca.Function]] = {}
        self._runs: dict[int, list[Callable[[], Any]]] = {}
        for tier in (0, 1):
            self._build(tier)
        self._seen = memory["seen"]
        self._instant = vm.bound(self._program("instant"), self._arguments, [self._seen])
        self._limit: Callable[[], Any] | None = None
        self._staged: dict[str, _Staged] = {}
        self._chosen, self._made = at("control", 2), at("tally", len(TIERS) + 1)
        self._fixed, self._end, self._last, self._accepted = (
            at("pace", PACE.index(name)) for name in ("fixed", "end", "last", "accepted")
        )
        self._seen_near = at("seen", len(memory["seen"]) - 2)
        self._seen_trouble = at("seen", len(memory["seen"]) - 1)

    def communicate(self, start: float, h: float) -> bool:
        m, time = self._block, self._time
        before, longest = m[time], m[self._step_size]
        if not (0.0 < h < math.inf and (start == before or abs(start - before) <= 1e-6 * h + 1e-12 * abs(start))):
            return False
        m[time] = start
        plain = m[self._chosen] == 0.0 and self._reach is None
        if plain and h * (1 - 1e-12) <= longest:
            m[self._dt] = h
            if not self._single():
                m[time] = before
                return False
        else:
            n = math.ceil(h / longest * (1 - 1e-12))
            self._begin[:] = self._z
            kept = self._kept.copy()
            if not (self.advance(n, h / n) == n if plain else self._covered(start + h, n, h / n)):
                self._z[:] = self._begin
                m[time] = before
                self._kept[:] = kept
                return False
        m[time] = start + h
        return True

    def _covered(self, end: float, steps: int, dt: float) -> bool:
        """A communication step whose inputs are extrapolated, or by the method of the scene."""
        m = self._block
        if self._reach:
            self._reach()
        if m[self._chosen] == 0.0:
            return self.advance(steps, dt) == steps
        m[self._last] = 0.0
        m[self._fixed] = dt if m[self._chosen] == 2.0 else 0.0
        return self.cover(end, -1)

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

    def cover(self, end: float, tries: int) -> bool:
        m = self._block
        method = self._program_of("method")
        m[self._end] = end
        with method.context():
            while m[self._time] < end and tries != 0:
                method.run()
                if m[self._trouble] != 0.0 and "beside" in self._vm.equations.kernel:
                    self._program_of("beside").run()
                    m[self._made + 2] += 1.0
                    m[self._made + 3] += m[self._near]
                if m[self._trouble] != 0.0:
                    return False
                refused = m[self._accepted] == 0.0
                if not refused:
                    self._z[:] = self._after
                m[self._made + refused] += 1.0
                tries -= 1
        return True

    def _program_of(self, name: str) -> _Staged:
        if name not in self._staged:
            self._staged[name] = _Staged(self._vm, self._memory, name)
        return self._staged[name]

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
        while True:
            self._runs[tier][0]()
            if m[self._trouble] == 0.0:
                break
            # Near a singular position no step but that on the branch can be good.
            near = m[self._near] != 0.0
            if tier == 2 or (tier == 1 and not near):
                return False
            tier = 2 if near else 1
            if tier not in self._runs:
                self._build(tier)
        self._z[:] = self._after
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


class _Staged:
    """A program of a method bound to a memory."""

    def __init__(self, vm: Vm, memory: Memory, name: str):
        self._vm = vm
        self._arrays = {name: memory[name] for name in memory.layout.fields}
        calls = staged(vm.equations, name)
        self._runs = self._bound(calls)
        self.context: Callable[[], AbstractContextManager] = nullcontext
        if any(call[0] == LOOP for call in calls):
            from ..oracle.threads import one_thread

            self.context = one_thread

    def run(self) -> None:
        for run in self._runs:
            run()

    def _bound(self, calls: list[list]) -> list[Callable[[], Any]]:
        return [x for call in calls for x in self._call(*call)]

    def _call(self, name: str, *rest: Any) -> Iterator[Callable[[], Any]]:
        if name == LOOP:
            number, times, again = rest
            # What a loop is asked is known before it.
            yield _loop(self._arrays[number], times, self._bound(again))
        elif name == FACTOR:
            (weights, *parts), outputs, n, s = rest
            both = self._array(outputs[0], 2 * (n * s) ** 2).reshape(2, n * s, n * s)
            yield partial(_factor, self._arrays[weights], [self._arrays[x] for x in parts], both, n, s)
        elif name == SOLVE:
            (factors, _, *right), [x], n, s = rest
            both = self._arrays[factors].reshape(2, n * s, n * s)
            yield partial(_solve, both, [self._arrays[b] for b in right], self._array(x, n * s))
        else:
            inputs, outputs = rest
            function, x = self._vm.equations.programs[name], [self._arrays[key] for key in inputs]
            y = [self._array(key, function.size1_out(i)) for i, key in enumerate(outputs)]
            # Results are not written over arguments, which may be wanted after them.
            apart = [np.empty_like(each) if key in inputs else each for key, each in zip(outputs, y, strict=True)]
            yield self._vm.bound(function, x, apart)
            yield from (partial(np.copyto, each, new) for each, new in zip(y, apart, strict=True) if each is not new)

    def _array(self, name: str, size: int) -> NDArray:
        return self._arrays.setdefault(name, np.zeros(size))


def _loop(number: NDArray, times: int, runs: list[Callable[[], Any]]) -> Callable[[], Any]:
    here = memoryview(number)

    def run() -> None:
        for _ in range(times):
            if here[0] == 0.0:
                break
            for each in runs:
                each()

    return run


def _factor(weights: NDArray, parts: list[NDArray], both: NDArray, n: int, s: int) -> None:
    """The inverse in place of factors, which NumPy does not hand out, and the matrix itself."""
    blocks = np.array(parts).reshape(-1, s, n, n)  # each by columns
    both[1] = np.einsum("tij,ticr->irjc", weights.reshape(-1, s, s), blocks).reshape(n * s, n * s)
    try:
        both[0] = np.linalg.inv(both[1])
    except np.linalg.LinAlgError:
        both[0] = np.nan


def _solve(both: NDArray, right: list[NDArray], x: NDArray) -> None:
    """Solved by the inverse, and once more for what that leaves."""
    inverse, matrix = both
    b = np.concatenate(right)
    np.matmul(inverse, b, out=x)
    x += inverse @ (b - matrix @ x)
