"""A mechanism at its start on NumPy arrays: assembled, with consistent velocities, scales and ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...equations import Equations, Mobility, Variable
from ...equations.interface import (
    CHOICES,
    SOLVER_VARIABLES,
    checked,
    default_settings,
    setting,
    variables_of,
)
from ...kernel.program import GROSS, Backend, Layout
from ...model.errors import AlfmuError, InputError
from ...model.settings import Settings
from .assembly import Assembly
from .oracle import Oracle
from .topology import Topology

__all__ = ["Instance"]


class Instance:
    """A mechanism with its own parameters and inputs, at its start once it is initialised."""

    def __init__(self, equations: Equations, settings: Settings | None = None):
        self.equations = e = equations
        self.name = e.name
        self.topology = Topology(e)
        self.input_variables = [*e.inputs, *self.topology.inputs]
        self._given = settings or default_settings(e)
        found = variables_of(e, self._given)
        self.parameters = found.parameters
        self.values = np.array([v.start for v in self.parameters])
        self.choices = {v.name: v.start for v in found.choices}
        self._parameter = {v.name: i for i, v in enumerate(self.parameters)}
        self._input = {v.name: i for i, v in enumerate(e.inputs)}
        self._switch = {v.name: i for i, v in enumerate(self.topology.inputs)}
        self._starts = list(e.wrapped.values())
        backend: Backend = _portable(e)
        self.oracle, self._assembly = Oracle(e, backend), Assembly(e, backend)
        self.layout = Layout(e)
        self.memory = backend.memory(self.layout)
        self.state, self.inputs = self.memory["z"], self.memory["u"]
        self.inputs[:] = [v.start for v in e.inputs]
        self.initialized = False

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
    def time(self) -> float:
        """Time [s]."""
        return float(self.state[self.layout.time])

    @time.setter
    def time(self, value: float) -> None:
        self.state[self.layout.time] = value

    # Values ------------------------------------------------------------------------------------------------------

    def set(self, name: str, value: float | str) -> None:
        """Set an input (any time), or a parameter, start value or solver number (before `initialize`)."""
        e = self.equations
        if name in self._input:
            self._check(e.inputs[self._input[name]], value)
            self.inputs[self._input[name]] = value
            return
        if name in self._switch:
            if value not in (0, 1):
                raise InputError(f"{e.name}: {name} is {value!r}; it must be true or false")
            self.topology.wanted[self._switch[name]] = value
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

    def _check(self, v: Variable, value: float) -> None:
        checked(self.equations.name, v, value)

    # Life --------------------------------------------------------------------------------------------------------

    def initialize(self) -> None:
        """Assemble the mechanism from its start values at `time`; parameters are fixed from here on."""
        e = self.equations
        for v, value in zip(self.parameters, self.values, strict=True):
            self._check(v, float(value))
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
            q, v = oracle.project(q, v, self.time)
        self._know(q, v)
        angles = [s[start] if start >= 0 else 0.0 for start in self._starts]
        self.state[: self.layout.time] = [*q, *v, *angles, 0.0]
        self.initialized = True
        if topology.pending:
            self._take_effect()

    def _know(self, q: NDArray, v: NDArray) -> None:
        """Find what tells a singular position from a regular one, with the constraints that are held."""
        oracle = self.oracle
        if self.equations.l:
            usual = self.topology.force(np.zeros(len(self.equations.switches)))
            freedom = self.equations.freedom if (oracle.active == usual).all() else None
            oracle.know(q, v, self._mobility(q).freedom if freedom is None else freedom)

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

    def spectrum(self) -> NDArray:
        """Eigenvalues [1/s] of small motions about the present one; for equations that have tangents."""
        return self.oracle.spectrum(self.q, self.v, self.inputs, self.time)

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

    def _take_effect(self) -> None:
        """Put in force what the Boolean inputs ask for, at this instant; where that cannot be, they are as before."""
        oracle, topology = self.oracle, self.topology
        before = topology.kept.copy()
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
            v = oracle.impact(self.q, self.v, self.time) if new.any() else self.v.copy()
            self._know(self.q, v)
        except AlfmuError:
            oracle.penalty, oracle.known = before, known
            raise
        self.v[:] = v


def _portable(equations: Equations) -> Backend:
    """The functions as CasADi holds them; loaded here alone, as compiled ones need no CasADi."""
    from ...kernel.vm import Vm

    return Vm(equations)
