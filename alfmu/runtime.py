"""One mechanism in motion: values by name, initialisation, communication steps, outputs, complete state.

The run side's top: this is what an FMU carries, and what `alfmu.simulate` drives.
"""

from __future__ import annotations

import copy
import json
import math
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from .assembly import Mobility, assemble, assemble_rates, check_masses, mobility
from .equations import Equations, Variable
from .errors import AlfmuError, InputError, StepError
from .integrators import rk4
from .kernel.machine import Machine
from .oracle import FORMULATIONS, GROSS, Counters, Oracle, Settings

__all__ = ["MONITORS", "SOLVER_VARIABLES", "Instance"]

SOLVER_VARIABLES = (
    Variable("solver.step_size", "s", Settings.step_size, 1e-9, None, "largest internal step"),
    Variable("solver.penalty", "kg", Settings.penalty, 0.0, None, "artificial mass alpha; 0 scales it with the masses"),
    Variable(
        "solver.tolerance",
        "1",
        Settings.tolerance,
        1e-16,
        1e-3,
        "of multiplier iterations (relative) and of projected constraints (m, rad)",
    ),
    Variable(
        "solver.max_iterations",
        "1",
        Settings.max_iterations,
        1,
        1000,
        "limit of the multiplier iteration",
        type="Integer",
    ),
)
"""Numbers of the method that a user may set; `solver.formulation` (text) comes beside them."""

FORMULATION = "solver.formulation"
FORMULATION_TEXT = "one of " + ", ".join(f"{name} ({text})" for name, text in FORMULATIONS.items())

MONITORS = (
    Variable("monitor.position_error", "1", description="largest |Phi| (m, rad)"),
    Variable("monitor.velocity_error", "1", description="largest |Phi-dot| (m/s, rad/s)"),
    Variable("monitor.energy", "J", description="kinetic and potential energy"),
    Variable(
        "monitor.iterations",
        "1",
        description="multiplier iterations used at this instant",
        type="Integer",
        instant=True,
    ),
)
"""What every instance says about its own accuracy."""

_STRETCH = 512
"""Internal steps after which the kernel's checks are looked at."""

State = tuple[NDArray, NDArray, NDArray, float]
"""q (n,), v (n,), unwrapped angles, work of inputs, loads and dampers [J]."""


class Instance:
    """A mechanism with its own parameters, inputs and state.

    Use: `set` parameters and start values, `initialize`, then `step` and `get`, with `set` on inputs at any time::

        i = Instance(equations)
        i.set("m2", 0.0)
        i.initialize()
        i.step(0.02)
        i.get("link1.angle")

    A call that raises leaves the instance as it was before.
    """

    def __init__(self, equations: Equations, settings: Settings | None = None):
        self.equations = e = equations
        self.name = e.name
        self.input_variables = e.inputs
        self._given = settings or Settings(**{"step_size": e.step_size, **e.solver})
        solver = [replace(v, start=self._solver_default(v.name)) for v in SOLVER_VARIABLES]
        self.parameters = [*e.parameters, *e.starts, *e.start_rates, *solver]
        self.outputs = [*e.outputs, *MONITORS]
        self.values = np.array([v.start for v in self.parameters])
        self.inputs = np.array([v.start for v in e.inputs])
        self.formulation = self._given.formulation
        self._parameter = {v.name: i for i, v in enumerate(self.parameters)}
        self._input = {v.name: i for i, v in enumerate(e.inputs)}
        self._output = {v.name: i for i, v in enumerate(self.outputs)}
        self._wrapped = [(self._output[name], start) for name, start in e.wrapped.items()]
        self.oracle = Oracle(e)
        self.machine = Machine(e) if e.unrolled else None
        self._fast = self._scaled = False
        self.initialized = self._known = False
        self.time = 0.0

    def _solver_default(self, name: str) -> float:
        value = getattr(self._given, name.removeprefix("solver."))
        return float(value) if np.ndim(value) == 0 else 0.0

    # Values ------------------------------------------------------------------------------------------------------

    def set(self, name: str, value: float | str) -> None:
        """Set an input (any time), or a parameter, start value or solver number (before `initialize`)."""
        e = self.equations
        if name in self._input:
            self._check(e.inputs[self._input[name]], value)
            self.inputs[self._input[name]] = value
            self._known = False
            return
        if name not in self._parameter and name != FORMULATION:
            names = [*self._input, *self._parameter, FORMULATION]
            raise InputError(f"{e.name} has no input or parameter {name!r}; it has {', '.join(names)}")
        if self.initialized:
            raise InputError(f"{e.name}: {name} is fixed once the run has begun; set it before initialising")
        if name == FORMULATION:
            replace(self._given, formulation=value).checked(e.name, e.l)
            self.formulation = value
        else:
            self._check(self.parameters[self._parameter[name]], value)
            self.values[self._parameter[name]] = value

    def get(self, name: str) -> float | str:
        """The value of an output, input, parameter, start value or solver number."""
        if name in self._output:
            return float(self.read()[self._output[name]])
        if name in self._input:
            return float(self.inputs[self._input[name]])
        if name in self._parameter:
            return float(self.values[self._parameter[name]])
        if name == FORMULATION:
            return self.formulation
        raise InputError(f"{self.equations.name} has no variable {name!r}")

    def _check(self, v: Variable, value: float) -> None:
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
            raise InputError(f"{self.equations.name}: {v.name} is {value!r}; it must be a finite number in {v.unit}")
        if v.type == "Integer" and value != int(value):
            raise InputError(f"{self.equations.name}: {v.name} is {value:g}; it must be a whole number")
        if (v.minimum is not None and value < v.minimum) or (v.maximum is not None and value > v.maximum):
            low, high = ("-inf" if v.minimum is None else v.minimum), ("inf" if v.maximum is None else v.maximum)
            raise InputError(f"{self.equations.name}: {v.name} = {value:g} {v.unit} is outside [{low}, {high}]")

    # Life --------------------------------------------------------------------------------------------------------

    def initialize(self) -> None:
        """Assemble the mechanism from its start values at `time`; parameters are fixed from here on."""
        e = self.equations
        for v, value in zip(self.parameters, self.values, strict=True):
            self._check(v, float(value))
        self._check_inputs()
        p, s, sdot = self._start_values()
        settings = self._settings()
        alpha = np.asarray(settings.penalty, float)
        held = np.ones(e.l, bool) if alpha.ndim == 0 else alpha > 0
        q = assemble(e, p, s, held)
        v = assemble_rates(e, q, p, s, sdot, held)
        check_masses(e, q, p, held)
        oracle = self.oracle
        oracle.prepare(settings, p, q)
        # Whether the penalty is the one for which the quick step of the kernel is known to be enough.
        self._scaled = alpha.ndim == 0 and alpha == 0
        if oracle.settings.projects:
            q, v, _, _ = oracle.project(q, v, self.time)
        self.q, self.v, self.work = q, v, 0.0
        self.angles = np.array([s[start] if start >= 0 else 0.0 for _, start in self._wrapped])
        self.energy_start = oracle.energy(q, v)
        self._known = False
        self.initialized = True
        self._choose()

    def _choose(self) -> None:
        """Take the kernel where it does what the settings ask for, otherwise the oracle."""
        oracle, machine = self.oracle, self.machine
        settings, alpha = oracle.settings, oracle.penalty
        self._fast = bool(
            machine is not None
            and settings.formulation == "residual"
            and settings.projects
            and settings.max_iterations >= self.equations.unrolled[-1][0]
            and (alpha == alpha[:1]).all()
            and oracle.active.all()
        )
        if self._fast:
            machine.p[:] = oracle.p
            machine.k[:] = alpha[0] if len(alpha) else 1.0, settings.tolerance
            machine.first = 0 if self._scaled else 1

    def _start_values(self) -> list[NDArray]:
        """Parameters, start values and start rates."""
        e = self.equations
        return np.split(self.values, np.cumsum([len(e.parameters), len(e.starts), len(e.start_rates)]))[:3]

    def _settings(self) -> Settings:
        """Settings from the values of the solver variables, and from what has no variable."""
        values = {v.name.removeprefix("solver."): self.values[self._parameter[v.name]] for v in SOLVER_VARIABLES}
        values["max_iterations"] = int(values["max_iterations"])
        if np.ndim(self._given.penalty):
            values["penalty"] = self._given.penalty
        return replace(self._given, **values, formulation=self.formulation)

    def step(self, communication_step: float, time: float | None = None) -> None:
        """Cover one communication step [s] with internal steps no longer than solver.step_size.

        `time` is the communication point where the step begins, if the caller keeps time; it must be the instance's.
        Raises InputError or StepError and keeps the state before the step where the step cannot be taken.
        """
        e, h = self.equations, communication_step
        if not self.initialized:
            raise InputError(f"{e.name}: initialise before the first step")
        if not (isinstance(h, (int, float, np.number)) and math.isfinite(h) and h > 0):
            raise InputError(f"{e.name}, t = {self.time:.6g} s: a communication step of {h} s; it must be above zero")
        start = self.time if time is None else time
        if not abs(start - self.time) <= 1e-6 * h + 1e-12 * abs(self.time):
            raise InputError(f"{e.name}: a step from t = {start} s is asked for, but the state is at t = {self.time} s")
        self._check_inputs()
        n = max(1, math.ceil(h / self.oracle.settings.step_size * (1 - 1e-12)))
        dt, before = h / n, copy.copy(self.counters)
        state: State = (self.q, self.v, self.angles, self.work)
        try:
            for done in range(0, n, _STRETCH):
                t, steps = start + done * dt, min(_STRETCH, n - done)
                state = self._advanced(state, t, steps, dt) or self._followed(state, t, steps, dt)
        except AlfmuError:
            self.oracle.counters = before
            raise
        self.q, self.v, self.angles, self.work = state
        self.time, self._known = start + h, False

    def _advanced(self, state: State, start: float, n: int, dt: float) -> State | None:
        """n internal steps by the kernel; None where that is not enough."""
        if not self._fast:
            return None
        self.machine.load(*state, start, self.inputs)
        advanced = self.machine.advance(n, dt)
        if advanced is None:
            return None
        after, (iterations, corrections) = advanced
        c = self.counters
        c.steps += n
        c.evaluations += 4 * n
        c.multiplier_iterations += 4 * n * iterations
        c.projection_iterations += 2 * n * corrections
        return after

    @np.errstate(all="ignore")
    def _followed(self, state: State, start: float, n: int, dt: float) -> State:
        """n internal steps by the oracle, which iterates until it converges."""
        e, oracle, u, c = self.equations, self.oracle, self.inputs, self.counters
        q, v, angles, work = state
        size = len(q)

        def rate(t: float, y: NDArray) -> NDArray:
            if first and t == self.time and self._known and self._accelerations is not None:
                a = self._accelerations
            else:
                a, _, _, _ = oracle.accelerations(y[:size], y[size : 2 * size], u, t)
            dy = np.concatenate([y[size : 2 * size], a, [0.0]])
            if e.works:
                dy[-1] = oracle.power(y[:size], y[size : 2 * size], u, t)
            return dy

        for k in range(n):
            first = k == 0
            t = start + (k + 1) * dt
            y = rk4(rate, start + k * dt, np.concatenate([q, v, [work]]), dt)
            q, v, work = y[:size], y[size : 2 * size], float(y[-1])
            if not np.isfinite(y).all():
                raise StepError(f"{e.name}, t = {t:.6g} s: the state is not finite; reduce solver.step_size")
            if oracle.settings.projects:
                q, v, position, velocity = oracle.project(q, v, t)
            else:
                position, velocity = oracle.residues(q, v)
            c.steps += 1
            c.position_error = max(c.position_error, position)
            c.velocity_error = max(c.velocity_error, velocity)
            if self._wrapped:
                zeros = np.zeros(size), np.zeros(e.l)
                angles = self._unwrap(oracle.outputs(q, v, *zeros, u, t), angles)
        return q, v, angles, work

    @np.errstate(all="ignore")
    def read(self) -> NDArray:
        """All outputs, in the order of `outputs`, at this time and for the inputs as they are now."""
        if not self.initialized:
            raise InputError(f"{self.equations.name}: outputs are known after initialising")
        if self._known:
            return self._y
        oracle, q, v, t, c = self.oracle, self.q, self.v, self.time, self.counters
        seen = None
        if self._fast:
            self.machine.load(q, v, self.angles, self.work, t, self.inputs)
            seen = self.machine.read()
        if seen is not None:
            y, acceleration = seen
            used = self.equations.unrolled[-1][0]
            self._y, self._accelerations = np.append(y, used), None
            c.evaluations += 1
            c.multiplier_iterations += used
        else:
            a, lam, used, left = oracle.accelerations(q, v, self.inputs, t)
            if oracle.settings.projects:
                lam = oracle.minimum_norm(q, v, lam, t)
            self._y, self._accelerations = self._outputs(a, lam, used), a
            acceleration = float(np.abs(left[oracle.active]).max(initial=0.0))
        self._known = True
        position, velocity, energy, _ = self._y[-len(MONITORS) :]
        if self._fast:
            # float(): counters go into the saved state as JSON.
            c.position_error = max(c.position_error, float(position))
            c.velocity_error = max(c.velocity_error, float(velocity))
        c.acceleration_error = max(c.acceleration_error, acceleration)
        c.energy_error = max(c.energy_error, abs(float(energy) - self.energy_start - self.work))
        return self._y

    def read_inputs(self) -> NDArray:
        """The inputs as they are now, in the order of `input_variables`."""
        return self.inputs

    def read_state(self) -> NDArray:
        """Like `read` where accelerations and reactions cannot be computed: they are NaN, the rest is known."""
        e = self.equations
        return self._outputs(np.full(e.n, np.nan), np.full(e.l, np.nan), 0)

    def _outputs(self, a: NDArray, lam: NDArray, used: int) -> NDArray:
        oracle, q, v = self.oracle, self.q, self.v
        y = oracle.outputs(q, v, a, lam, self.inputs, self.time)
        self.angles = self._unwrap(y, self.angles)
        y[[i for i, _ in self._wrapped]] = self.angles
        return np.concatenate([y, [*oracle.residues(q, v), oracle.energy(q, v), used]])

    def mobility(self) -> Mobility:
        """Degrees of freedom and redundant constraints, in general and at the present position."""
        return mobility(self.equations, self._start_values()[0], self.q)

    @property
    def penalty(self) -> NDArray:
        """alpha (l,) [kg or kg.m2 by row], settable while running; a constraint with zero is switched off.

        A constraint that is switched on again must be closed; its velocity becomes consistent at once (10), as in a
        plastic impact. Raises InputError otherwise, and keeps the old values.
        """
        return self.oracle.penalty

    @penalty.setter
    def penalty(self, alpha: NDArray) -> None:
        e, oracle, before = self.equations, self.oracle, self.oracle.penalty
        alpha = np.array(alpha, float)
        replace(oracle.settings, penalty=alpha).checked(e.name, e.l)
        oracle.penalty = np.broadcast_to(alpha, (e.l,))
        gap, _ = oracle.residues(self.q, self.v)
        if gap > GROSS:
            oracle.penalty = before
            raise InputError(
                f"{e.name}, t = {self.time:.6g} s: a constraint that is open by {gap:.3g} cannot be switched on; "
                "wait until it closes"
            )
        self.v, self._known = oracle.impact(self.q, self.v, self.time), False
        self._scaled = False
        self._choose()

    # State -------------------------------------------------------------------------------------------------------

    @property
    def counters(self) -> Counters:
        """Work done and largest errors since initialisation."""
        return self.oracle.counters

    def save(self) -> bytes:
        """The complete state, from which `restore` continues to the last bit."""
        head = {
            "initialized": self.initialized,
            "formulation": self.formulation,
            "scaled": bool(self._scaled),
            "counters": asdict(self.counters) if self.initialized else None,
        }
        numbers = [self.values, self.inputs, [self.time]]
        if self.initialized:
            numbers += [self.q, self.v, self.angles, [self.work, self.energy_start], self.oracle.penalty]
        text = json.dumps(head, sort_keys=True).encode()
        return len(text).to_bytes(8, "little") + text + np.concatenate(numbers).tobytes()

    def restore(self, state: bytes) -> None:
        """Continue from a state that `save` gave, of this mechanism."""
        e = self.equations
        try:
            size = int.from_bytes(state[:8], "little")
            head = json.loads(state[8 : 8 + size])
            numbers = np.frombuffer(state[8 + size :]).copy()
            sizes = [len(self.parameters), len(e.inputs), 1]
            if head["initialized"]:
                sizes += [e.n, e.n, len(self._wrapped), 2, e.l]
            if numbers.size != sum(sizes):
                raise ValueError(numbers.size)
        except (ValueError, KeyError) as error:
            raise InputError(f"{e.name}: the saved state is not one of this mechanism; save it again") from error
        parts = np.split(numbers, np.cumsum(sizes)[:-1])
        self.values, self.inputs, self.time = parts[0], parts[1], float(parts[2][0])
        self.formulation = head["formulation"]
        self.initialized, self._known = head["initialized"], False
        if self.initialized:
            self.q, self.v, self.angles = parts[3:6]
            self.work, self.energy_start = map(float, parts[6])
            self.oracle.prepare(self._settings(), self._start_values()[0], self.q)
            self.oracle.penalty = parts[7]
            self.oracle.counters = Counters(**head["counters"])
            self._scaled = head["scaled"]
            self._choose()

    def _check_inputs(self) -> None:
        if not np.isfinite(self.inputs).all():
            for v, value in zip(self.equations.inputs, self.inputs, strict=True):
                self._check(v, float(value))

    def _unwrap(self, y: NDArray, near: NDArray) -> NDArray:
        """Computed angles moved by whole turns to the values nearest to `near`."""
        raw = y[[i for i, _ in self._wrapped]] if self._wrapped else near
        return raw + 2 * np.pi * np.round((near - raw) / (2 * np.pi))
