"""One mechanism in motion: values by name, initialisation, communication steps, outputs, complete state.

The run side's top: this is what an FMU carries, and what `alfmu.simulate` drives.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations, Mobility, Variable
from ..equations.interface import (
    CHOICES,
    MONITORS,
    SOLVER_VARIABLES,
    Counters,
    checked,
    default_settings,
    events,
    setting,
    variables_of,
)
from ..kernel.program import GROSS, PACE, TURN, Backend, Layout
from ..kernel.thresholds import SAID, SHORTEST, TORN
from ..method.inputs import Past
from ..method.integrators import rk4
from ..method.singular import SPACING
from ..model.errors import AlfmuError, InputError, OpenError, StepError
from ..model.settings import FIXED, Settings
from .assembly import Assembly
from .oracle import Oracle
from .topology import Topology

__all__ = ["Instance"]


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
        self.topology = Topology(e)
        self.input_variables = [*e.inputs, *self.topology.inputs]
        self._given = settings or default_settings(e)
        found = variables_of(e, self._given)
        self.parameters, self.outputs = found.parameters, found.outputs
        self.values = np.array([v.start for v in self.parameters])
        self.choices = {v.name: v.start for v in found.choices}
        self._parameter = {v.name: i for i, v in enumerate(self.parameters)}
        self._input = {v.name: i for i, v in enumerate(e.inputs)}
        self._switch = {v.name: i for i, v in enumerate(self.topology.inputs)}
        self._output = {v.name: i for i, v in enumerate(self.outputs)}
        self._wrapped = [(self._output[name], start) for name, start in e.wrapped.items()]
        backend: Backend = _portable(e)
        self.oracle, self._assembly = Oracle(e, backend), Assembly(e, backend)
        self.layout = Layout(e)
        self.memory = backend.memory(self.layout)
        self.state, self.inputs = self.memory["z"], self.memory["u"]
        # A single number takes a fraction of NumPy's time this way.
        self._clock = memoryview(self.state)[self.layout.time :]
        self._past = Past(len(e.inputs), self.memory["past"] if self.layout.fields["past"][1] else None)
        self._adaptive: Any = None
        self.inputs[:] = [v.start for v in e.inputs]
        self._watched = [self._output.get(v.name) for v in MONITORS[:3]]
        self._turns = np.array([c.unit == "rad" for c in e.coordinates])
        self._events = bool(events(e))
        self._pending = self._near = False
        self.initialized = self._known = False

    # State -------------------------------------------------------------------------------------------------------

    @property
    def q(self) -> NDArray:
        """Coordinates (n,), a view."""
        return self.state[: self.layout.n]

    @property
    def v(self) -> NDArray:
        """Velocities (n,), a view."""
        return self.state[self.layout.n : 2 * self.layout.n]

    @property
    def angles(self) -> NDArray:
        """Computed angles, whole turns counted, a view."""
        return self.state[2 * self.layout.n : self.layout.work]

    @property
    def work(self) -> float:
        """Work of inputs, loads and dampers since the start [J]."""
        return float(self.state[self.layout.work])

    @property
    def time(self) -> float:
        """Time [s]."""
        return self._clock[0]

    @time.setter
    def time(self, value: float) -> None:
        self._clock[0] = value

    @property
    def adapts(self) -> bool:
        """Whether the method that is chosen controls its error."""
        return self.choices["solver.method"] not in FIXED

    # Values ------------------------------------------------------------------------------------------------------

    def set(self, name: str, value: float | str) -> None:
        """Set an input (any time), or a parameter, start value or solver number (before `initialize`)."""
        e = self.equations
        if name in self._input:
            self._check(e.inputs[self._input[name]], value)
            self.inputs[self._input[name]] = value
            self._known = False
            return
        if name in self._switch:
            if value not in (0, 1):
                raise InputError(f"{e.name}: {name} is {value!r}; it must be true or false")
            self.topology.wanted[self._switch[name]] = value
            self._pending = self.topology.pending
            return
        if name not in self._parameter and name not in CHOICES:
            names = [*self._input, *self._switch, *self._parameter, *CHOICES]
            raise InputError(f"{e.name} has no input or parameter {name!r}; it has {', '.join(names)}")
        if self.initialized:
            raise InputError(f"{e.name}: {name} is fixed once the run has begun; set it before initialising")
        if name in CHOICES:
            replace(self._given, **{setting(name): value}).checked(e.name, e.l)
            self.choices[name] = value
        else:
            self._check(self.parameters[self._parameter[name]], value)
            self.values[self._parameter[name]] = value

    def get(self, name: str) -> float | str:
        """The value of an output, input, parameter, start value or solver number."""
        if name in self._output:
            return float(self.read()[self._output[name]])
        if name in self._input:
            return float(self.inputs[self._input[name]])
        if name in self._switch:
            return float(self.topology.wanted[self._switch[name]])
        if name in self._parameter:
            return float(self.values[self._parameter[name]])
        if name in CHOICES:
            return self.choices[name]
        raise InputError(f"{self.equations.name} has no variable {name!r}")

    def _check(self, v: Variable, value: float) -> None:
        checked(self.equations.name, v, value)

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
        topology = self.topology
        topology.on[:] = [wanted and not s.holds for wanted, s in zip(topology.wanted, e.switches, strict=True)]
        held = (np.ones(e.l, bool) if alpha.ndim == 0 else alpha > 0) & topology.force(topology.on)
        q = self._assembly.assemble(p, s, held)
        v = self._assembly.rates(q, p, s, sdot, held)
        self._assembly.check_masses(q, p, held)
        oracle = self.oracle
        oracle.prepare(settings, p, q)
        self._comply()
        self._full = oracle.penalty
        oracle.penalty = self._full * held
        if oracle.settings.projects:
            q, v, _, _ = oracle.project(q, v, self.time)
        self._know(q, v)
        angles = [s[start] if start >= 0 else 0.0 for _, start in self._wrapped]
        self._begin([*q, *v, *angles, 0.0], oracle.energy(q, v))
        self._pending = topology.pending
        if self._pending:
            self._take_effect()

    def _begin(self, state: Sequence[float], energy: float) -> None:
        """Go on from q, v, angles and work."""
        self.state[: self.layout.time] = state
        self.state[self.layout.time + 1 :] = 0.0
        self.energy_start = energy
        self._known, self.initialized = False, True
        self._past.numbers[:] = 0.0
        self._adaptive = self._other_method() if self.oracle.settings.method != "rk4" else None
        self._choose()

    def _know(self, q: NDArray, v: NDArray) -> None:
        """Take note of what tells a singular position from a regular one, with the constraints that are held."""
        oracle = self.oracle
        if self.equations.l:
            usual = self.topology.force(np.zeros(len(self.equations.switches)))
            freedom = self.equations.freedom if (oracle.active == usual).all() else None
            oracle.know(q, v, self._mobility(q).freedom if freedom is None else freedom)

    def _choose(self) -> None:
        """Whether the branch of the motion is followed through singular positions."""
        self._continues = self.oracle.settings.continues and self.equations.l > 0

    def _start_values(self) -> list[NDArray]:
        """Parameters with what locks keep, start values and start rates."""
        e = self.equations
        p, s, sdot, *_ = np.split(self.values, np.cumsum([len(e.parameters), len(e.starts), len(e.start_rates)]))
        return [np.concatenate([p, self.topology.kept]), s, sdot]

    def _comply(self) -> None:
        """Hand compliances on; all constraints have one, or none."""
        e = self.equations
        given = np.array([self.values[self._parameter[v.name]] for v in e.compliances])
        if given.any():
            if not given.all():
                name = e.compliances[int(np.argmin(given))].name
                raise InputError(
                    f"{e.name}: {name} is 0 and others are not; give each constraint a compliance, or none"
                )
            self.oracle.compliances = given

    def _settings(self) -> Settings:
        """Settings from the values of the solver variables, and from what has no variable."""
        values = {setting(v.name): self.values[self._parameter[v.name]] for v in SOLVER_VARIABLES}
        values |= {setting(name): value for name, value in self.choices.items()}
        values |= {name: int(values[name]) for name in ("max_iterations", "input_order")}
        if np.ndim(self._given.penalty):
            values["penalty"] = self._given.penalty
        return replace(self._given, **values)

    def step(self, communication_step: float, time: float | None = None) -> None:
        """Cover one communication step [s] with internal steps no longer than solver.step_size.

        `time` is the communication point where the step begins, if the caller keeps time; it must be the instance's.
        Raises InputError or StepError and keeps the state before the step where the step cannot be taken.
        """
        h = communication_step
        start = self.time if time is None else time
        if self._pending:
            self._step_after_event(h, start)
        else:
            self._step(h, start)
        self._known = False

    def _step_after_event(self, h: float, start: float) -> None:
        """A communication step that begins with switches taking effect; where it cannot be taken, nothing has."""
        before = self.save()
        self._take_effect()
        try:
            self._step(h, start)
        except AlfmuError:
            self.restore(before)
            raise

    def _step(self, h: float, start: float) -> None:
        """A communication step; where it cannot be taken, nothing has changed."""
        e = self.equations
        if not self.initialized:
            raise InputError(f"{e.name}: initialise before the first step")
        if not (isinstance(h, (int, float, np.number)) and math.isfinite(h) and h > 0):
            raise InputError(f"{e.name}, t = {self.time:.6g} s: a communication step of {h} s; it must be above zero")
        if not abs(start - self.time) <= 1e-6 * h + 1e-12 * abs(self.time):
            raise InputError(f"{e.name}: a step from t = {start} s is asked for, but the state is at t = {self.time} s")
        self._check_inputs()
        n = max(1, math.ceil(h / self.oracle.settings.step_size * (1 - 1e-12)))
        dt, done = h / n, 0
        before, counters = self.state.copy(), copy.copy(self.counters)
        past = self._past.numbers.copy()
        self._past.reach(start, self.inputs)
        try:
            if self._adaptive:
                self._advance(start, h, n)
                done = n
            while done < n:
                self._watched_step(start + done * dt, dt)
                self._known, done = False, done + 1
        except AlfmuError:
            self.state[:], self._past.numbers[:] = before, past
            self.oracle.counters = counters
            raise
        self.time = start + h

    def _extrapolated(self, t: float) -> NDArray:
        """The inputs at t, inside the communication step under way."""
        order = self.oracle.settings.input_order
        return self._past.at(t, order) if order else self.inputs

    def _other_method(self) -> Any:
        """What makes steps by a method other than RK4; loaded where a scene asks for it."""
        name, method = self.equations.name, self.oracle.settings.method
        try:
            from .adaptive import TANGENTS, adaptive
        except ImportError:
            raise InputError(
                f"{name}: this FMU carries rk4 alone; export it with --set solver.method={method}"
            ) from None
        if method in TANGENTS and "tangents" not in self.equations.signatures:
            raise InputError(
                f"{name}: solver.method {method} needs the tangents of the equations; choose it where the scene is "
                f"made: simulate(..., parameters={{'solver.method': '{method}'}}), or export with --set"
            )
        return adaptive(self.oracle, self._extrapolated, self.memory["pace"][:3])

    def spectrum(self) -> NDArray:
        """Eigenvalues [1/s] of small motions about the present one; for methods that have tangents."""
        self._adaptive.place(self.time, self.q, self.v, self.work)
        return self._adaptive.spectrum()

    def _advance(self, start: float, h: float, n: int) -> None:
        """A communication step by a method other than RK4; n steps where they have a given length."""
        a, pace, end = self._adaptive, self.memory["pace"], start + h
        before, refused = pace.copy(), a.counts["refused"]
        a.fixed = h / n if self.oracle.settings.method in FIXED else None
        pace[PACE.index("fixed")], pace[PACE.index("last")] = a.fixed or 0.0, 0.0
        self.time = start
        a.place(start, self.q, self.v, self.work)
        try:
            while self.time < end:
                a.advance(end, self._taken)
        except AlfmuError:
            pace[:] = before
            raise
        self.oracle.counters.refused += a.counts["refused"] - refused
        self._known = False

    def _taken(self) -> None:
        """Take over the state that a step led to."""
        a, c, zeros = self._adaptive, self.oracle.counters, np.zeros(self.equations.n)
        position, velocity = self.oracle.residues(a.q, a.v)
        c.steps += 1
        c.position_error = max(c.position_error, position)
        c.velocity_error = max(c.velocity_error, velocity)
        angles = self.angles
        if self._wrapped:
            u = self._extrapolated(a.t)
            angles = self._unwrap(self.oracle.outputs(a.q, a.v, zeros, np.zeros(self.equations.l), u, a.t), angles)
        self.state[: self.layout.time + 1] = [*a.q, *a.v, *angles, a.work, a.t]

    def _watched_step(self, start: float, dt: float) -> None:
        """One internal step by the oracle; near a singular position in shorter ones where constraints stay open."""
        try:
            self._follow(start, dt)
        except OpenError as error:
            if not self._near:
                raise
            self._subdivided(start, dt, error)

    def _subdivided(self, start: float, dt: float, error: OpenError) -> None:
        """An internal step near a singular position in shorter ones; StepError where none, however short, leads on."""
        oracle, t, h = self.oracle, 0.0, dt / 2
        while t < dt and h > dt * SHORTEST:
            try:
                self._follow(start + t, h)
                t, h = t + h, min(2 * h, dt - t - h)
            except OpenError:
                h /= 2
        if t >= dt:
            return
        where = ", ".join(
            f"{c.name} = {x:.6g}" for c, x in zip(self.equations.coordinates[:SAID], self.q, strict=False)
        )
        raise StepError(
            f"{self.equations.name}, t = {start + t:.6g} s: locked up at {where}; no motion goes on from this singular "
            f"position (distance {oracle.margin(self.q) ** 0.5:.1e}); turn round before it, or change lengths or start"
        ) from error

    @np.errstate(all="ignore")
    def _follow(self, start: float, dt: float) -> None:
        """One internal step by the oracle, which iterates until it converges."""
        e, oracle, u, c = self.equations, self.oracle, self.inputs, self.oracle.counters
        size = e.n
        known = self._accelerations if self._known and start == self.time else None
        self._near = False

        def rate(t: float, y: NDArray) -> NDArray:
            q, v = y[:size], y[size : 2 * size]
            if self._continues:
                self._near = self._near or oracle.near(q)
            a = known
            if a is None or t != start:
                a, _, _, _ = oracle.accelerations(q, v, self._extrapolated(t), t)
            return moved(t, y, a)

        def rate_on_branch(t: float, y: NDArray) -> NDArray:
            u = self._extrapolated(t)
            a, *_ = oracle.accelerations_on_branch(y[:size], y[size : 2 * size], u, t, SPACING * dt)
            return moved(t, y, a)

        def moved(t: float, y: NDArray, a: NDArray) -> NDArray:
            q, v = y[:size], y[size : 2 * size]
            return np.concatenate([v, a, [oracle.power(q, v, self._extrapolated(t), t) if e.works else 0.0]])

        oracle.hold(self.q)
        t = start + dt
        begin = np.concatenate([self.q, self.v, [self.work]])
        unconverged = c.unconverged
        y = rk4(rate, start, begin, dt)
        if self._near:
            c.unconverged = unconverged
            y = rk4(rate_on_branch, start, begin, dt)
        q, v = y[:size], y[size : 2 * size]
        if not np.isfinite(y).all():
            raise StepError(f"{e.name}, t = {t:.6g} s: the state is not finite; reduce solver.step_size")
        if oracle.settings.projects:
            self._check_length(q - begin[:size], q, t)
            q, v, position, velocity = oracle.project(q, v, t, self._near)
        else:
            position, velocity = oracle.residues(q, v)
        c.steps += 1
        c.position_error = max(c.position_error, position)
        c.velocity_error = max(c.velocity_error, velocity)
        angles = self.angles
        if self._wrapped:
            zeros = np.zeros(size), np.zeros(e.l)
            angles = self._unwrap(oracle.outputs(q, v, *zeros, u, t), angles)
        self.state[: self.layout.time + 1] = [*q, *v, *angles, y[-1], t]

    def _check_length(self, moved: NDArray, q: NDArray, t: float) -> None:
        """StepError where a step to q that moved the coordinates so far (n,) is too long to mean anything."""
        e, say = self.equations, f"{self.equations.name}, t = {t:.6g} s"
        turned = np.where(self._turns, np.abs(moved), 0.0)
        if turned.max(initial=0.0) > TURN:
            name = e.coordinates[int(np.argmax(turned))].name
            raise StepError(
                f"{say}: {name} turned by {turned.max():.3g} rad in one step, more than half a turn; "
                "reduce solver.step_size"
            )
        gap, row = self.oracle.widest(q)
        if gap > TORN * np.abs(moved).max(initial=0.0) and gap > GROSS:
            raise StepError(
                f"{say}: a step of {np.abs(moved).max():.3g} opened {row} by {gap:.3g}; reduce solver.step_size"
            )

    def read(self) -> NDArray:
        """All outputs, in the order of `outputs`, at this time and for the inputs as they are now."""
        if not self.initialized:
            raise InputError(f"{self.equations.name}: outputs are known after initialising")
        if not self._known:
            acceleration = self._read_by_oracle()
            self._known = True
            self._watch(acceleration)
        return self._y

    @np.errstate(all="ignore")
    def _read_by_oracle(self) -> float:
        """All outputs by iterations that converge; returns the largest |Phi-ddot|."""
        oracle, q, v, t = self.oracle, self.q, self.v, self.time
        oracle.hold(q)
        a, lam, used, left, singular = oracle.read(q, v, self.inputs, t, self._continues)
        self._y, self._accelerations = self._outputs(a, lam, used, oracle.margin(q), singular), a
        return float(np.abs(left[oracle.active]).max(initial=0.0))

    def _watch(self, acceleration: float) -> None:
        """Keep the largest errors; NaN for what nobody watches. float(): counters go into the saved state as JSON."""
        c, (position, velocity, energy) = self.oracle.counters, self._watched
        c.position_error = math.nan if position is None else max(c.position_error, float(self._y[position]))
        c.velocity_error = math.nan if velocity is None else max(c.velocity_error, float(self._y[velocity]))
        c.acceleration_error = max(c.acceleration_error, acceleration)
        balance = math.nan if energy is None else abs(float(self._y[energy]) - self.energy_start - self.work)
        c.energy_error = balance if energy is None else max(c.energy_error, balance)

    def read_inputs(self) -> NDArray:
        """The inputs as they are now, in the order of `input_variables`."""
        return np.concatenate([self.inputs, self.topology.wanted])

    def read_state(self) -> NDArray:
        """Like `read` where accelerations and reactions cannot be computed: they are NaN, the rest is known."""
        e = self.equations
        return self._outputs(np.full(e.n, np.nan), np.full(e.l, np.nan), 0, self.oracle.margin(self.q), 0)

    def _outputs(self, a: NDArray, lam: NDArray, used: int, margin: float, singular: int) -> NDArray:
        oracle, q, v = self.oracle, self.q, self.v
        y = oracle.outputs(q, v, a, lam, self.inputs, self.time)
        self.angles[:] = self._unwrap(y, self.angles)
        y[[i for i, _ in self._wrapped]] = self.angles
        values = *oracle.residues(q, v), oracle.energy(q, v), used, math.sqrt(max(margin, 0.0)), singular
        seen = zip(MONITORS, values, strict=True)
        monitors = [value for v, value in seen if v.name in self._output]
        return np.concatenate([y, monitors, self.topology.read()] if self._events else [y, monitors])

    def mobility(self) -> Mobility:
        """Degrees of freedom and redundant constraints, in general and at the present position."""
        return self._mobility(self.q)

    def shared(self) -> list[str]:
        """Outputs that are not unique, because redundant constraints share a load: those of least norm are given."""
        e, oracle, zeros = self.equations, self.oracle, np.zeros(self.equations.n)

        def read(lam: NDArray) -> NDArray:
            return oracle.outputs(self.q, zeros, zeros, lam, self.inputs, self.time)

        nothing = read(np.zeros(e.l))
        found = np.zeros(len(nothing))
        for lam in self._assembly.redundancy(oracle.p, self.q, oracle.active).T:
            found = np.maximum(found, np.abs(read(lam) - nothing))
        return [v.name for v, size in zip(e.outputs, found, strict=True) if size > 1e-7]

    @property
    def known(self) -> list[NDArray]:
        """What another way to run needs to begin here: q, v, penalties, those in force, units, scales, and the rest."""
        o = self.oracle
        return [
            self.q,
            self.v,
            self._full,
            o.penalty,
            o.units,
            o.scales,
            np.array([o.freedom, o.masses, o.regular, o.rank]),
        ]

    def take(self, p: NDArray, state: NDArray, penalty: NDArray) -> None:
        """Stand where another instance does: parameters, state (q, v, angles, work, time), alpha."""
        self.oracle.prepare(self._settings(), np.array(p), state[: self.layout.n])
        self.state[: len(state)] = state
        self.oracle.penalty = penalty

    def redundant_with_all(self) -> int:
        """Redundant constraints where all of them are in force."""
        return self._assembly.mobility(self.oracle.p, self.q, np.ones(self.equations.l, bool)).redundant

    def _mobility(self, q: NDArray) -> Mobility:
        return self._assembly.mobility(self.oracle.p, q, self.oracle.active)

    @property
    def penalty(self) -> NDArray:
        """alpha (l,) [kg or kg.m2 by row], settable while running; a constraint with zero is switched off.

        A constraint that is switched on again must be closed; its velocity becomes consistent at once (10), as in a
        plastic impact. Raises InputError otherwise, and keeps the old values.
        """
        return self.oracle.penalty

    @penalty.setter
    def penalty(self, alpha: NDArray) -> None:
        e, full = self.equations, np.array(alpha, float)
        replace(self.oracle.settings, penalty=full).checked(e.name, e.l)
        full = np.broadcast_to(full, (e.l,)).copy()
        self._change(full * self.topology.force(self.topology.on))
        self._full = full
        self._choose()

    def _take_effect(self) -> None:
        """Put in force what the Boolean inputs ask for, at this instant; where that cannot be, they are as before."""
        oracle, topology = self.oracle, self.topology
        if not self.initialized:
            return
        before = topology.kept.copy()
        self._pending = False
        topology.kept[:] = topology.stops(oracle.displacements(self.q))
        oracle.p = self._start_values()[0]
        try:
            self._change(self._full * topology.force(topology.wanted))
        except AlfmuError:
            topology.kept[:], topology.wanted[:] = before, topology.on
            oracle.p = self._start_values()[0]
            raise
        topology.on[:] = topology.wanted

    def _change(self, alpha: NDArray) -> None:
        """Other penalties (l,) from now on; what comes into force must be closed, and makes the velocity consistent."""
        e, oracle, before, known = self.equations, self.oracle, self.oracle.penalty, self.oracle.known
        oracle.penalty = alpha
        try:
            gap, row = oracle.widest(self.q)
            if not gap <= GROSS:
                raise InputError(
                    f"{e.name}, t = {self.time:.6g} s: a constraint that is open by {gap:.3g} at {row} cannot be "
                    "switched on; wait until it closes"
                )
            self._assembly.check_masses(self.q, oracle.p, oracle.active)
            new = oracle.active & ~(before > 0)
            nothing = self.v.copy(), np.zeros(e.l), 0.0
            v, impulses, lost = oracle.impact(self.q, self.v, self.time) if new.any() else nothing
            self._know(self.q, v)
        except AlfmuError:
            oracle.penalty, oracle.known = before, known
            raise
        self.v[:] = v
        self.state[self.layout.work] -= lost
        self.topology.happened(impulses, lost, new)
        self._known = False
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
            "choices": self.choices,
            "counters": asdict(self.counters) if self.initialized else None,
        }
        numbers = [self.values, self.inputs, self.state]
        if self.initialized:
            oracle = self.oracle
            control = self._adaptive.control.numbers if self._adaptive else ()
            numbers += [[self.energy_start], self._past.numbers, control]
            numbers += [oracle.penalty, self._full, oracle.known, oracle.units, self.topology.numbers]
        text = json.dumps(head, sort_keys=True).encode()
        return len(text).to_bytes(8, "little") + text + np.concatenate(numbers).tobytes()

    def restore(self, state: bytes) -> None:
        """Continue from a state that `save` gave, of this mechanism."""
        e = self.equations
        try:
            size = int.from_bytes(state[:8], "little")
            head = json.loads(state[8 : 8 + size])
            numbers = np.frombuffer(state[8 + size :]).copy()
            sizes = [len(self.parameters), len(e.inputs), len(self.state)]
            if head["initialized"]:
                adaptive = head["choices"]["solver.method"] != "rk4"
                known = len(self.oracle.known)
                sizes += [1, len(self._past.numbers), 3 * adaptive, e.l, e.l, known, e.l, len(self.topology.numbers)]
            if numbers.size != sum(sizes):
                raise ValueError(numbers.size)
        except (ValueError, KeyError) as error:
            raise InputError(f"{e.name}: the saved state is not one of this mechanism; save it again") from error
        parts = np.split(numbers, np.cumsum(sizes)[:-1])
        self.values, self.inputs[:], self.state[:] = parts[:3]
        self.choices = head["choices"]
        self.initialized = self._known = False
        if head["initialized"]:
            state = self.state.copy()
            energy, past, control, penalty, full, known, units, topology = parts[3:]
            self.topology.numbers[:] = topology
            self._pending = self.topology.pending
            self.oracle.prepare(self._settings(), self._start_values()[0], self.q)
            self._comply()
            self.oracle.penalty, self._full = penalty, full
            self.oracle.known, self.oracle.units = known, units
            self._begin(state[: self.layout.time], float(energy[0]))
            self._past.numbers[:] = past
            if self._adaptive:
                self._adaptive.control.numbers[:] = control
            self.state[:] = state
            self.oracle.counters = Counters(**head["counters"])

    def _check_inputs(self) -> None:
        if not np.isfinite(self.inputs).all():
            for v, value in zip(self.equations.inputs, self.inputs, strict=True):
                self._check(v, float(value))

    def _unwrap(self, y: NDArray, near: NDArray) -> NDArray:
        """Computed angles moved by whole turns to the values nearest to `near`."""
        raw = y[[i for i, _ in self._wrapped]] if self._wrapped else near
        return raw + 2 * np.pi * np.round((near - raw) / (2 * np.pi))


def _portable(equations: Equations) -> Backend:
    """The functions as CasADi holds them; loaded here alone, as compiled ones need no CasADi."""
    from ..kernel.vm import Vm

    return Vm(equations)
