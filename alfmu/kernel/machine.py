"""Run the traced functions of a scene: one call for any number of internal steps."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..equations import Equations

__all__ = ["Layout", "Machine"]


@dataclass(frozen=True)
class Layout:
    """Where things stand in the state z of a kernel: q, v, unwrapped angles, work, time, trouble."""

    n: int
    angles: int

    @property
    def work(self) -> int:
        return 2 * self.n + self.angles

    @property
    def time(self) -> int:
        return self.work + 1

    @property
    def trouble(self) -> int:
        """Number of checks that failed since it was set to zero; a NaN fails them all."""
        return self.work + 2

    @property
    def size(self) -> int:
        return self.work + 3


_BUNDLE = 8
"""Internal steps in one call of the next larger function."""


class Machine:
    """The kernel of a scene on CasADi's virtual machine, with arrays of its own.

    `advance` and `read` return None where the unrolled loops were not enough, or something is not finite; nothing has
    changed then, and the caller takes the oracle's path.
    """

    def __init__(self, equations: Equations):
        e = equations
        self.layout = Layout(e.n, len(e.wrapped))
        self.z, self.after = np.zeros(self.layout.size), np.zeros(self.layout.size)
        self.u, self.p, self.k = np.zeros(len(e.inputs)), np.zeros(len(e.parameters)), np.zeros(2)
        self.dt = np.zeros(1)
        self.seen = np.zeros(e.instant.size1_out(0))
        self._begin = self.z.copy()
        self._arguments = (self.z, self.u, self.p, self.k, self.dt)
        self._steps = [_Steps(f, self._arguments, self.after) for f in (e.step, e.step_careful)]
        self._instant = _bound(e.instant, self._arguments[:4], self.seen)
        self.unrolled = e.unrolled
        self.first = 0
        """Whether `advance` begins with the quick step (0) or the careful one (1)."""

    def load(self, q: NDArray, v: NDArray, angles: NDArray, work: float, time: float, u: NDArray) -> None:
        """Take over a state and the inputs."""
        z, layout, n = self.z, self.layout, self.layout.n
        z[:n], z[n : 2 * n], z[2 * n : layout.work] = q, v, angles
        z[layout.work :] = work, time, 0.0
        self.u[:] = u

    def advance(self, steps: int, dt: float) -> tuple[tuple[NDArray, NDArray, NDArray, float], list[int]] | None:
        """q, v, angles and work after that many internal steps of dt [s], and what was unrolled in each.

        First by the quick step, then by the careful one.
        """
        self.dt[0] = dt
        self._begin[:] = self.z
        for run, unrolled in zip(self._steps[self.first :], self.unrolled[self.first :], strict=True):
            run(steps)
            layout, n, z = self.layout, self.layout.n, self.after
            if z[layout.trouble] == 0.0:
                z = z.copy()
                return (z[:n], z[n : 2 * n], z[2 * n : layout.work], float(z[layout.work])), unrolled
            self.z[:] = self._begin
        return None

    def read(self) -> tuple[NDArray, float] | None:
        """What a user can read of what was loaded, and the largest |Phi-ddot|."""
        self._instant[1]()
        return None if self.seen[-1] != 0.0 else (self.seen[:-2].copy(), float(self.seen[-2]))


class _Steps:
    """A step function, and bundles of it for many steps in one call, built when first wanted."""

    def __init__(self, step: ca.Function, arguments: tuple[NDArray, ...], after: NDArray):
        self._functions = [step]
        self._arguments, self._after = arguments, after
        self._runs = [_bound(step, arguments, after)]

    def __call__(self, steps: int) -> None:
        while steps:
            size = 0
            while _BUNDLE ** (size + 1) <= steps:
                size += 1
                if size == len(self._runs):
                    self._bundle()
            self._runs[size][1]()
            self._arguments[0][:] = self._after
            steps -= _BUNDLE**size

    def _bundle(self) -> None:
        z, *rest = (ca.MX.sym(f"x{i}", len(x)) for i, x in enumerate(self._arguments))
        after = z
        for _ in range(_BUNDLE):
            after = self._functions[-1](after, *rest)
        self._functions.append(ca.Function("steps", [z, *rest], [after]))
        self._runs.append(_bound(self._functions[-1], self._arguments, self._after))


def _bound(function: ca.Function, arguments: tuple[NDArray, ...], result: NDArray) -> tuple:
    """A function bound to arrays, to be called without any argument; its buffer must be kept alive with it."""
    buffer, run = function.buffer()
    for i, x in enumerate(arguments):
        buffer.set_arg(i, memoryview(x))
    buffer.set_res(0, memoryview(result))
    return buffer, run
