"""An instance that steps and reads by `blajer.Method`: slow, used like any other; tests hold the kernel against it.

The runtime has the values by name, start, scales, ranks, switches, impacts, times of jumps and state. This module
divides communication steps as the runtime does, evaluates outputs, and updates counters, messages and whole turns.
"""

import ctypes
import logging
import math
from collections.abc import Iterable
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from ..equations.interface import MONITORS, Counters, events
from ..kernel.thresholds import SAID, SHORTEST, UNFINISHED
from ..model.errors import AlfmuError, InputError, OpenError, StepError
from ..model.settings import internal_steps
from .blajer import Method

_LOGGER = logging.getLogger("alfmu")


class Instance(Method):
    """An instance with steps and outputs computed in Python, with `rk4` only."""

    run = None  # type: ignore[assignment]
    """Disabled, because it would run the C steps; `alfmu.simulation.run` then makes single steps."""

    def _take(self, equations: Equations) -> None:
        self._by_row = False
        super()._take(equations)
        self._seen: tuple = (None, None, None)

    def initialize(self) -> None:
        """Initialise as the runtime does, with RK4 for `auto`; raise InputError for any other method."""
        if (chosen := self.choices["solver.method"]) not in ("auto", "rk4"):
            raise InputError(f"{self.name}: the oracle has no solver.method {chosen}; use rk4, or kernel vm")
        e = self.equations
        for what, names in (
            ("dry friction", [joint.name for joint in e.frictions]),
            ("derivatives over a step", ["/".join(pair) for pair in e.jacobian]),
            ("peaks within a step", list(e.peaks)),
        ):
            if names:
                raise InputError(f"{self.name}: the oracle has no {what}, as {names[0]} has; use kernel vm")
        super().initialize()
        self.counters, self._step_error, self._unfinished, self._told = Counters(), 0.0, 0.0, False
        self._know()

    # Steps --------------------------------------------------------------------------------------------------------

    def step(self, communication_step: float, time: float | None = None) -> None:
        """Cover one communication step [s] as the runtime does, with the same errors."""
        h, start = communication_step, self.time if time is None else time
        before, counters, penalty, v = self.save(), copy(self.counters), self.penalty, self.v.copy()
        self._judged(self._scene.library.alfmu_ready(self._unit.address, start, h))
        try:
            self._change(penalty, v)
            self.memory["begin"][:] = self.memory["z"]
            if self._past:
                self._past.reach(start, self.inputs)
            for begin, end in self._stretches(start, start + h):
                if begin > start:  # skip the round-off of the time of a jump
                    self.q[:] += (begin - self.time) * self.v
                    self.time, self._seen = begin, (None, None, None)
                length = end - begin if (begin, end) != (start, start + h) else h
                n = internal_steps(length, self.settings.step_size)
                for k in range(n):
                    self._step(begin + k * (length / n), length / n)
        except AlfmuError:
            self.restore(before)
            self.counters = counters
            raise
        self.time = start + h
        self._step_error = self._scene.library.alfmu_balance(self._unit.address)
        self.counters.run_error = self._counted()["run_error"]
        self._warn()

    def _stretches(self, begin: float, end: float) -> Iterable[tuple[float, float]]:
        """Yield intervals [s] between the times of jumps that `alfmu_ready` found."""
        count = self._scene.library.alfmu_breaks(self._unit.address, None)
        times = (ctypes.c_double * (2 * count))()
        self._scene.library.alfmu_breaks(self._unit.address, times)
        for left, right in zip((*times[::2], end), (*times[1::2], end), strict=True):
            if left > begin:
                yield begin, min(left, end)
            begin = max(begin, right)

    def _step(self, start: float, dt: float) -> None:
        """Make an internal step; divide it if constraints stay open near a singular position."""
        t, h, near = 0.0, dt, False
        while t < dt:
            try:
                self._follow(start + t, h)
                t, h = t + h, min(2 * h, dt - t - h)
            except OpenError as error:
                h, near = h / 2, near or self._near
                if not near:
                    raise
                if h <= dt * SHORTEST:
                    names = (c.name for c in self.equations.coordinates[:SAID])
                    where = ", ".join(f"{name} = {x:.6g}" for name, x in zip(names, self.q, strict=False))
                    distance = f"distance {self.margin(self.q)[1] ** 0.5:.1e}"
                    remedy = f"no motion continues from this singular position ({distance}); reverse before it, or "
                    remedy += "change lengths or start"
                    raise self._error(StepError, start + t, f"locked up at {where}", remedy) from error

    def _follow(self, start: float, dt: float) -> None:
        """Make a step of RK4 and commit it."""
        e, c, t = self.equations, self.counters, start + dt
        read = self._seen[2] if start == self.time and self._seen[0] == self._key() else None
        q, v, x, work, position, velocity = self.stepped(start, dt, read)
        self._check_converged(t)
        c.steps += 1
        c.position_error, c.velocity_error = max(c.position_error, position), max(c.velocity_error, velocity)
        self._unwrap(self.readings(q, v, np.zeros(e.n), np.zeros(e.l), self.driven, t))
        if e.counted:  # store the angles from which the next step counts turns
            p, begin = self.memory["p"], len(e.parameters) + e.held.index(next(iter(e.counted)))
            angles = np.array(e.functions["counted"](q, p)).ravel()
            p[begin : begin + len(angles)] = self.angles[len(e.wrapped) :] = angles
        if e.timed:
            q[-1], v[-1] = t, 1.0
        self.q[:], self.v[:], self.states[:], self.state[self.layout.work], self.time = q, v, x, work, t

    def _check_converged(self, t: float) -> None:
        """Check the remaining changes of multiplier iterations since the last call: warn once, or raise StepError.

        As in the runtime, only the formulation that continues through singular positions raises.
        """
        left, most, self._unfinished = self._unfinished, self.settings.max_iterations, 0.0
        if not left:
            return
        penalty = float(self.get("solver.penalty"))
        given = penalty > 0 or self._by_row
        remedy = "use solver.penalty 0, which scales it with the masses" if given else "reduce solver.step_size"
        remedy += ", or raise solver.max_iterations"
        if left > UNFINISHED and given and self.continues:
            measured = (
                f"with solver.penalty {penalty or float(self.penalty.max()):g} the multiplier iteration still changes "
                f"accelerations by a relative {left:.1e} after {most} passes, above the limit of {UNFINISHED:.0e}"
            )
            raise self._error(StepError, t, measured, remedy)
        if not self._told:
            measured = f"an evaluation ended without convergence after {most} passes of the multiplier iteration"
            _LOGGER.warning("%s", self._error(StepError, t, measured, remedy))
            self._told = True

    def _unwrap(self, y: NDArray) -> NDArray:
        """Move computed angles among the outputs by whole turns to the values nearest to the last ones."""
        names = [v.name for v in self.equations.outputs]
        places = [names.index(name) for name in self.equations.wrapped]
        angles = self.angles[: len(places)]
        y[places] += 2 * np.pi * np.round((angles - y[places]) / (2 * np.pi))
        angles[:] = y[places]
        return y

    # Events -------------------------------------------------------------------------------------------------------

    def _change(self, penalty: NDArray, v: NDArray) -> None:
        """Make v (n,) consistent by an impact if the runtime added constraints to those in force by `penalty` (l,)."""
        if (penalty != self.penalty).any():
            self._know()
            if (self.active & (penalty == 0)).any():
                self.v[:] = self.impact(self.q, v)

    def _penalize(self, alpha: NDArray) -> None:
        if not self.initialized:
            self._by_row = True
            return super()._penalize(alpha)
        before, v = self.penalty, self.v.copy()
        super()._penalize(alpha)
        return self._change(before, v)

    def restore(self, state: bytes) -> None:
        super().restore(state)
        if self.initialized:
            self._know()

    # Readings -----------------------------------------------------------------------------------------------------

    def get(self, name: str) -> Any:
        """Return the value of an output, input, parameter, start value or solver number."""
        place = self._references.get(name, -1) - self._scene.first_output
        return float(self.read()[place]) if place >= 0 else super().get(name)

    def read(self) -> NDArray:
        """Return all outputs, in the order of `outputs`, at this time and for the present inputs."""
        if not self.initialized:
            raise InputError(f"{self.name}: outputs are known after initialising")
        if self._seen[0] != self._key():
            self.hold(self.q)
            self._unfinished = 0.0
            a, lam, used, left, singular, lost = self.seen()
            self._check_converged(self.time)
            q, v, e = self.q, self.v, self.equations
            y = self._unwrap(self.readings(q, v, a, lam, self.driven, self.time))
            values = [*self.residues(q, v), self.energy(q, v), self.work, self._step_error]
            values += [used, self.margin(q)[1] ** 0.5, singular, lost]
            seen = {monitor.name: float(x) for monitor, x in zip(MONITORS, values, strict=True)}
            seen = {name: x for name, x in seen.items() if name not in e.monitors}
            came = [self._unit.get(self._references[x.name]) for x in events(e)]
            self._seen = self._key(), np.concatenate([y, [*seen.values()], came]), (a, lam)
            self._watch(seen, left)
        return self._seen[1].copy()

    def _key(self) -> bytes:
        """Return a key of everything that readings depend on."""
        p = self.memory["p"]  # includes the coefficients of signals
        return b"".join(x.tobytes() for x in (self.q, self.v, self.driven, p, self.penalty, self.state[-1:]))

    def _watch(self, seen: dict[str, float], left: NDArray) -> None:
        """Record the largest errors; NaN for quantities without a monitor."""
        balance = abs(seen.get("monitor.energy", math.nan) - self.energy_start - self.work)
        found = {name: seen.get(f"monitor.{name}", math.nan) for name in ("position_error", "velocity_error")}
        found |= {"acceleration_error": self._largest(left), "energy_error": balance}
        for name, x in found.items():
            setattr(self.counters, name, float(np.maximum(getattr(self.counters, name), x)))
