"""An instance whose steps and outputs are computed in Python; everything else is inherited from the runtime.

The runtime has the values by name, start, scales, ranks, switches, impacts, times of jumps and state. The class here
divides communication steps into internal ones, evaluates outputs, and updates counters, messages and whole turns; its
subclass in `oracle` implements the method.
"""

from __future__ import annotations

import ctypes
import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import runtime
from ..equations import Equations
from ..equations.arrays import ArrayFunction, ArrayFunctions
from ..equations.evaluation import elimination_order, telling
from ..equations.interface import MONITORS, Counters, events
from ..kernel.memory import GROSS, SETTINGS, TURN
from ..kernel.thresholds import SAID, SHORTEST, TORN, UNFINISHED
from ..method import formulations as method
from ..method import singular as branch
from ..method.inputs import Past
from ..model.errors import AlfmuError, InputError, OpenError, StepError
from ..model.settings import internal_steps

EPS = float(np.finfo(float).eps)

_LOGGER = logging.getLogger("alfmu")

SOLVER = {"step_size": float, "tolerance": float, "max_iterations": int, "input_order": int}

Reading = tuple[NDArray, NDArray, int, NDArray, int, float]
"""Accelerations a (n,), multipliers lam (l,), iterations, residual Phi-ddot (l,), 1 or 2 for a limit, error of lam."""


class Stepped(runtime.Instance, ABC):
    """An instance with steps and outputs computed in Python; used like any other, but with `rk4` only."""

    counters = Counters()
    """Work done and largest errors since initialisation."""

    run = None  # type: ignore[assignment]
    """Disabled, because it would run the C steps; `alfmu.simulation.run` then makes single steps."""

    @abstractmethod
    def _follow(self, start: float, dt: float) -> None:
        """Make one step from a time [s] of a length [s]; raise OpenError if constraints stay open."""

    @abstractmethod
    def _now(self) -> Reading:
        """Return the accelerations and multipliers at this state."""

    @abstractmethod
    def impact(self, q: NDArray, v: NDArray) -> NDArray:
        """Return v (n,) after an impact."""

    @abstractmethod
    def margin(self, q: NDArray) -> tuple[bool, float]:
        """Return whether a singular position may be near, and the margin (S2)."""

    @abstractmethod
    def hold(self, q: NDArray) -> None:
        """Freeze the rank of the constraints at q (n,)."""

    def _take(self, equations: Equations) -> None:
        super()._take(equations)
        e, arrays = self.equations, ArrayFunctions(self.equations)
        names = ["dynamics", "constraints", "power", "energy", "readings", "shares", *["state_rates"] * bool(e.states)]
        self._functions = {name: ArrayFunction(arrays, name, e.signatures[name]) for name in names}
        self._turns = np.array([c.unit == "rad" for c in e.coordinates])
        self._seen: tuple = (None, None, None)
        self.counters, self._unfinished, self._by_row, self._near = Counters(), 0.0, False, False

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
        self.counters, self._step_error = Counters(), 0.0
        self._unfinished, self._told = 0.0, False
        self._know()

    def _know(self) -> None:
        """Copy penalties, units of rows, scales of pivots and freedoms that the runtime found at a start or event."""
        e, k = self.equations, self.memory["k"]
        values: dict[str, Any] = {name: kind(self.get(f"solver.{name}")) for name, kind in SOLVER.items()}
        values |= {name: self.choices[f"solver.{name}"] for name in ("formulation", "branch")}
        self.settings = replace(self._given, **values)
        self.continues = self.settings.continues and e.l > 0
        self.order = self.settings.input_order if e.inputs else 0
        self._past = Past(len(e.inputs), self.memory["past"]) if self.order else None
        found = dict(zip(SETTINGS, k.tolist(), strict=False))
        self.freedom, self.masses, self.regular = (found[name] for name in ("freedom", "masses", "regular"))
        self.nothing, self.least_distance = found["nothing"], found["least_distance"]
        self.inverse_length, self.inverse_loop = found["inverse_length"], found["inverse_loop"]
        ends = np.cumsum([len(SETTINGS), e.l, e.l, e.n, len(e.compliances), e.n * bool(e.l)])
        _, _, inverse_units, inverse_scales, stiffnesses, self.way, _ = np.split(k, ends)
        with np.errstate(divide="ignore", invalid="ignore"):  # the run reports a scale that is not finite
            self.units, self.scales, self.stiffnesses = 1 / inverse_units, k[0] / inverse_scales, k[0] * stiffnesses
        self.alpha, self.active = np.diag(self.penalty), self.penalty > 0
        self.rank = e.dependent - self.mobility().freedom if e.survey.brakes else 0
        self.heavy = np.zeros(e.n)
        own = telling(e)
        self.heavy[own] = branch.INDEPENDENT_MASS * self.nothing / branch.NOISE_FLOOR * self.scales[own]

    # Equations ----------------------------------------------------------------------------------------------------

    def _values(self, function: str, *arguments: NDArray | float) -> list[NDArray]:
        """Return the results of a function of the equations, matrices dense."""
        return [x.toarray() if hasattr(x, "toarray") else x.copy() for x in self._functions[function](*arguments)]

    def dynamics(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> list[NDArray]:
        """Return M, C, F = f - d and xi of (3) and (4)."""
        return self._values("dynamics", q, v, u, self.memory["p"], t)

    def constraints(self, q: NDArray, v: NDArray) -> list[NDArray]:
        """Return M, C, Phi and C v of (1) and (2)."""
        return self._values("constraints", q, v, self.memory["p"])

    def inverse(self, H: NDArray) -> method.Solve:
        """Return a solver with a matrix; raise StepError if it is singular."""

        def solve(b: NDArray) -> NDArray:
            try:
                return np.linalg.solve(H, b)
            except np.linalg.LinAlgError:
                remedy = "give the massless body a mass, or hold it by constraints"
                raise self._error(StepError, self.time, "the augmented mass matrix is singular", remedy) from None

        return solve

    def pivots(self, q: NDArray) -> NDArray:
        """Return the pivots (n,) of H at q (n,) over the scales of their coordinates, in the order of elimination."""
        M, C, _, _ = self.constraints(q, np.zeros_like(q))
        order = elimination_order(self.equations)
        try:
            pivots = np.linalg.cholesky(method.augmented_mass(M, C, self.alpha)[np.ix_(order, order)]).diagonal() ** 2
        except np.linalg.LinAlgError:
            pivots = np.zeros(len(q))
        return np.maximum(pivots / self.scales[order], 1e-300)

    def readings(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> NDArray:
        """Return all outputs, in the order of `equations.outputs`."""
        return self._values("readings", q, v, a, lam, u, self.memory["p"], t)[0]

    def power(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> float:
        """Return the power [W] of inputs, loads and dampers."""
        return float(self._values("power", q, v, u, self.memory["p"], t)[0][0]) if self.equations.works else 0.0

    def supply(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> float:
        """Return the power [W] of prescribed motion."""
        e = self.equations
        if not (e.timed and e.works):
            return 0.0
        return float(e.functions["motion_power"](q, v, a, lam, u, self.memory["p"], t))

    def state_rates(self, q: NDArray, v: NDArray, u: NDArray, t: float) -> NDArray:
        """Return time derivatives of the states."""
        return self._values("state_rates", q, v, u, self.memory["p"], t)[0] if self.equations.states else u[:0]

    def energy(self, q: NDArray, v: NDArray) -> float:
        """Return kinetic and potential energy [J]."""
        return float(self._values("energy", q, v, self.memory["p"])[0][0])

    def residues(self, q: NDArray, v: NDArray) -> tuple[float, float]:
        """Return the largest |Phi| and |Phi-dot|."""
        _, _, Phi, Cv = self.constraints(q, v)
        return self._largest(Phi), self._largest(Cv)

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
        for left, right in zip(times[::2], times[1::2], strict=True):
            if left > begin:
                yield begin, min(left, end)
            begin = max(begin, right)
        if end > begin:
            yield begin, end

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
                    ended = (
                        "no motion continues from this singular position (distance "
                        f"{self.margin(self.q)[1] ** 0.5:.1e})"
                    )
                    remedy = f"{ended}; reverse before it, or change lengths or start"
                    raise self._error(StepError, start + t, f"locked up at {where}", remedy) from error

    def _arrive(
        self, t: float, q: NDArray, v: NDArray, x: NDArray, work: float, position: float, velocity: float
    ) -> None:
        """Commit a step to a time [s]; `position` and `velocity` are the largest |Phi| and |Phi-dot| after it."""
        e, c = self.equations, self.counters
        self._check_converged(t)
        c.steps += 1
        c.position_error, c.velocity_error = max(c.position_error, position), max(c.velocity_error, velocity)
        self._unwrap(self.readings(q, v, np.zeros(e.n), np.zeros(e.l), self.driven, t))
        self._count_turns(q)
        if e.timed:
            q[-1], v[-1] = t, 1.0
        self.q[:], self.v[:], self.states[:], self.state[self.layout.work], self.time = q, v, x, work, t

    def _check_length(self, moved: NDArray, q: NDArray, t: float) -> None:
        """Raise StepError if a step to q that moved the coordinates by `moved` (n,) is too long to be meaningful."""
        turned, (gap, row) = moved[self._turns[: len(moved)]].max(initial=0.0), self._worst(self.constraints(q, q)[2])
        if turned > TURN:
            raise self._error(StepError, t, f"an angle turned by {turned:.3g} rad in one step, more than half a turn")
        if gap > max(TORN * moved.max(initial=0.0), GROSS):
            raise self._error(StepError, t, f"a step of {moved.max():.3g} opened {row} by {gap:.3g}")

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
            penalty = penalty or float(self.penalty.max())
            measured = (
                f"with solver.penalty {penalty:g} the multiplier iteration still changes accelerations by a relative "
            )
            measured += f"{left:.1e} after {most} passes, above the limit of {UNFINISHED:.0e}"
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

    def _count_turns(self, q: NDArray) -> None:
        """Store the angles whose turns are counted at q (n,), from which the next step counts."""
        e, p = self.equations, self.memory["p"]
        if e.counted:
            begin = len(e.parameters) + e.held.index(next(iter(e.counted)))
            angles = np.array(e.functions["counted"](q, p)).ravel()
            p[begin : begin + len(angles)] = self.angles[len(e.wrapped) :] = angles

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
            a, lam, used, left, singular, lost = self._now()
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

    def _largest(self, residue: NDArray) -> float:
        return float(np.abs(residue[self.active]).max(initial=0.0))

    def _worst(self, residue: NDArray) -> tuple[float, str]:
        """Return the largest residue, in units of its row, and the name of that row; 0 if there are none."""
        if not len(residue):
            return 0.0, ""
        sizes = np.where(self.active, np.nan_to_num(np.abs(residue / self.units), nan=np.inf), 0)
        row = self.equations.rows[int(np.argmax(sizes))]
        return float(sizes.max()), row.text

    def _error(
        self, kind: type[AlfmuError], t: float, measured: str, remedy: str = "reduce solver.step_size"
    ) -> AlfmuError:
        return kind(f"{self.name}, t = {t:.6g} s: {measured}; {remedy}")


def unchanged(change: NDArray, value: NDArray) -> bool:
    """Return whether an iteration changed only round-off."""
    return bool(np.abs(change).max(initial=0.0) <= EPS * np.abs(value).max(initial=0.0))


def least_squares(blocks: list, right: list) -> tuple[NDArray, NDArray]:
    """Return the least-squares solution of least norm of the block system (9); NaN if the system is not finite.

    LAPACK is not called then, because it would print a message.
    """
    (M, Ct), (C, _) = blocks
    K, b = np.block([[M, Ct], [C, np.zeros((len(C), len(C)))]]), np.concatenate(right)
    finite = np.isfinite(K).all() and np.isfinite(b).all()
    a, lam = np.split(np.linalg.lstsq(K, b, rcond=None)[0] if finite else np.full(len(b), np.nan), [len(M)])
    return a, lam
