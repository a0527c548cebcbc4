"""A mechanism with its numbers, the input of an analysis, from a declaration, equations or a running instance."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..equations import Equations, Mobility, Variable
from ..equations.changes import LEVELS, changes, signal_numbers
from ..equations.evaluation import ARGUMENTS
from ..fmi.recipe import Recipe, of
from ..model.doubts import tell_of_gravity
from ..model.errors import AlfmuWarning, InputError
from ..model.mechanism import Mechanism
from ..model.motion import COEFFICIENTS
from ..model.words import there_is
from ..runtime import Instance
from ..runtime.pipeline import derive, with_defaults
from ..runtime.probe import Probe, mobility, row_shares, row_units
from ..simulation import by_name, signals_of
from ..simulation.result import Signal

Vector = NDArray[np.float64]
Subject = str | Path | Mechanism | Recipe | Equations | Instance
"""Types that can be analysed."""


LEFT_OUT = "left out"
"""State of a joint whose dry friction is ignored."""

NONE = Mobility(0, 0, 0)
"""Mobility of equations of states alone, whose dummy coordinate does not move."""


@dataclass(frozen=True)
class Source:
    """The subject of an analysis: equations with defaults, as derived, and the declaration if known."""

    equations: Equations
    changes: dict[str, ca.Function]
    """Derivatives of the equations by name (`alfmu.equations.changes`)."""
    declared: Mechanism | None
    plain: Equations
    """Equations as derived, with the defaults of the declaration."""
    given: Mapping[str, float | str]
    """Changed defaults by name."""
    outputs: Sequence[str] | None = None
    """Patterns of the outputs that a recipe selects; None for all."""

    @property
    def name(self) -> str:
        return self.equations.name

    def drawn(self) -> Mechanism:
        """Return the declaration, for a drawing; raise InputError if only the equations are known."""
        if self.declared is None:
            raise InputError(f"{self.equations.name}: equations alone do not define a drawing; give the mechanism")
        return self.declared


def source(
    mechanism: str | Path | Mechanism | Recipe | Equations | Source, parameters: Mapping[str, float | str] | None
) -> Source:
    """Return the source of a name, file, declaration, recipe or equations, with other defaults; or a source with more.

    Raises AlfmuError if a name or a value is invalid.
    """
    if isinstance(mechanism, str | Path) and str(mechanism).endswith(".fmu"):
        raise InputError(
            f"{mechanism}: an FMU does not contain its equations; name the mechanism that it was exported from"
        )
    parameters = by_name(mechanism, "parameters", parameters)
    if isinstance(mechanism, Source):
        given = {**mechanism.given, **parameters}
        return replace(mechanism, equations=with_defaults(mechanism.plain, given), given=given)
    if isinstance(mechanism, Equations):
        return Source(with_defaults(mechanism, parameters), changes(mechanism), None, mechanism, parameters)
    recipe = of(mechanism)
    declared = recipe.declared()
    plain, given = derive(declared), {**recipe.parameters, **parameters}
    return Source(with_defaults(plain, given), changes(plain), declared, plain, given, recipe.outputs)


@dataclass(frozen=True)
class State:
    """A state: positions and velocities q, v (n,), inputs u followed by states, and time t [s]."""

    q: Vector
    v: Vector
    u: Vector
    t: float


@dataclass(frozen=True)
class Situation:
    """A mechanism with its numbers: parameters, constraints in force, units of rows, initial state."""

    source: Source
    state: State
    p: Vector
    held: NDArray[np.bool_]
    """Whether each constraint (l,) is in force."""
    units: Vector
    """Units of the rows (l,), as found at the start."""
    shares: Vector
    """Weights (l,) whose inverses are the compliances by which redundant constraints share a load."""
    count_freedoms: Callable[[Vector, str], tuple[Mobility, Vector]]
    """Computes the result of `mobility` for a position and an element of `COUNTED_ROWS`."""
    rubs: bool = False
    """Whether dry friction counts: sticking joints are fixed, sliding ones have their friction law."""

    @property
    def equations(self) -> Equations:
        return self.source.equations

    @property
    def name(self) -> str:
        return self.equations.name

    @property
    def coordinates(self) -> Sequence[Variable]:
        """Coordinates without time."""
        return () if self.equations.resting else self.equations.coordinates[: self.equations.dependent]

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the mechanism by name."""
        return dict(zip((x.name for x in self.equations.parameters), self.p.tolist(), strict=False))

    @cached_property
    def start(self) -> Mobility:
        """Degrees of freedom and redundant constraints at the start."""
        return self.mobility(self.state.q)[0]

    def mobility(self, q: Vector) -> tuple[Mobility, Vector]:
        """Return degrees of freedom near a position (n,), and a regular position near it, by the runtime's rule."""
        return self.count_freedoms(q, "in force" if self.rubs else "without friction")

    def at_rest(self, q: Vector) -> State:
        """Return the state at rest in another position (n,), at the same rate of time."""
        e, v = self.equations, np.zeros_like(self.state.v)
        v[e.dependent :] = 1.0
        return replace(self.state, q=np.array(q), v=v)

    @property
    def frictions(self) -> dict[str, str]:
        """States of joints with dry friction, by name: "sticks", "slides", "held by others", or `LEFT_OUT`."""
        e, words = self.equations, {0.0: "sticks", 1.0: "slides"}
        slips = [abs(float(self.p[len(e.parameters) + x.slip])) for x in e.frictions]
        return {
            x.name: words.get(slip, "held by others") if self.rubs else LEFT_OUT
            for x, slip in zip(e.frictions, slips, strict=True)
        }

    def without_friction(self) -> Situation:
        """Return the situation without dry friction."""
        if not self.rubs:
            return self
        e, p, held = self.equations, self.p.copy(), self.held.copy()
        held[[x.row for x in e.frictions]] = False
        p[[len(e.parameters) + x.slip for x in e.frictions]] = 0.0
        return replace(self, p=p, held=held, rubs=False)

    def known(self, s: State, **more: Any) -> dict[str, Any]:
        """Return the numbers of a state by the letters of the equations."""
        return {"q": s.q, "v": s.v, "u": s.u, "p": self.p, "t": s.t, **more}

    def value(self, name: str, s: State, **more: Any) -> NDArray[np.float64]:
        """Return the value of a function of the equations as a dense array, a vector if it has one column."""
        known = self.known(s, **more)
        found = np.array(self.equations.functions[name](*(known[letter] for letter in ARGUMENTS[name])))
        return found if name in ("M", "C") else found.ravel()

    def change(self, name: str, s: State, **more: Any) -> list[NDArray[np.float64]]:
        """Return derivatives of the equations (`alfmu.equations.changes`), dense."""
        function, known = self.source.changes[name], self.known(s, **more)
        results = function(*(known[letter] for letter in function.name_in()))
        return [np.array(each) for each in (results if isinstance(results, tuple) else (results,))]


def situation(source: Source, time: float = 0.0, rubs: bool = False) -> Situation:
    """Return the situation at the start that the defaults give, at a time [s] if there are laws of time.

    The runtime assembles it; with `rubs` dry friction is included, which needs a traced scene. Raises AssemblyError if
    there is no such start.
    """
    e = source.equations
    begin = time if e.timed else 0.0
    if e.frictions and rubs:
        unit = Instance(_by_rk4(e))
        unit.time = begin
        unit.initialize()
        return replace(situation_of(unit), source=source)
    probe = Probe.of(e, begin)
    if probe is None:
        unit = Instance(_by_rk4(e))
        unit.time = begin
        unit.initialize()  # its message names the reason
        raise InputError(f"{e.name}: the start cannot be found from the equations alone; analyse an Instance")
    if probe.unit.text:
        warnings.warn(probe.unit.text, AlfmuWarning, stacklevel=3)

    def count_freedoms(q: Vector, rows: str) -> tuple[Mobility, Vector]:
        if e.resting:
            return NONE, q
        probe.place(q)
        return mobility(probe.unit, e.n, rows)[1:]

    x = probe.numbers
    state = State(x["q"].copy(), x["v"].copy(), x["u"].copy(), float(x["t"][0]))
    found = Situation(
        source, state, _here(e, x["p"], x["q"]), probe.penalty > 0, probe.units, probe.shares, count_freedoms, True
    )
    return found.without_friction() if e.frictions else found


def situation_of(instance: Instance) -> Situation:
    """Return the situation of a running instance, without changing the instance."""
    if not instance.initialized:
        raise InputError(f"{instance.name}: its state is known after initialising; call initialize() first")
    e, memory = instance.equations, instance.memory
    penalty = instance.penalty

    def count_freedoms(q: Vector, rows: str) -> tuple[Mobility, Vector]:
        if e.resting:
            return NONE, q
        before = instance.q.copy()
        instance.q[:] = q
        try:
            return instance._mobility(rows)
        finally:
            instance.q[:] = before

    u = np.array(instance.driven)
    state = State(instance.q.copy(), instance.v.copy(), u, instance.time)
    rows = penalty > 0, row_units(e, memory["k"]), row_shares(e, memory["k"], penalty)
    return Situation(
        Source(e, changes(e), None, e, {}), state, _here(e, memory["p"], instance.q), *rows, count_freedoms, True
    )


def _by_rk4(equations: Equations) -> Equations:
    """Return the equations with the integrator that is fastest to trace."""
    return with_defaults(equations, {"solver.method": "rk4"})


def _here(equations: Equations, p: Vector, q: Vector) -> Vector:
    """Return parameters p with signals as quadratic polynomials that start at the time in q (n,)."""
    p = p.copy()
    for begin in signal_numbers(equations):
        numbers = p[begin + 1 : begin + 1 + COEFFICIENTS]
        signal, at = np.polynomial.Polynomial(numbers), q[-1] - p[begin]
        taylor = [signal.deriv(k)(at) / math.factorial(k) for k in range(LEVELS)]
        numbers[:] = 0.0
        numbers[:LEVELS] = taylor
        p[begin] = q[-1]
    return p


def subject(
    mechanism: Subject | Source,
    parameters: Mapping[str, float | str] | None = None,
    time: float = 0.0,
    rubs: bool = False,
) -> Situation:
    """Return the situation of a subject with other defaults, with loads and laws at a time [s].

    Raises AlfmuError if a name or a value is invalid, or the mechanism cannot start.
    """
    if isinstance(mechanism, Instance):
        if parameters:
            raise InputError(f"{mechanism.name}: an Instance has its values already; set() them before it initialises")
        return situation_of(mechanism)
    if isinstance(time, bool) or not isinstance(time, (int, float, np.number)) or not math.isfinite(time):
        name = getattr(mechanism, "name", "") or mechanism
        raise InputError(f"{name}: the time is {time!r}; it must be a finite number in s")
    found = situation(source(mechanism, parameters), float(time), rubs)
    return replace(found, state=replace(found.state, t=float(time)))


def begun(
    mechanism: Subject | Source,
    parameters: Mapping[str, float | str],
    inputs: Mapping[str, Signal],
    time: float = 0.0,
    rubs: bool = False,
) -> Situation:
    """Return the situation at a start with inputs at its time [s]; see `subject`."""
    signals = signals_of(mechanism, inputs)
    where = subject(mechanism, parameters, time, rubs and not signals)
    if where.source.declared is not None:
        tell_of_gravity(where.source.declared)
    if not signals:
        return where
    e = where.equations
    held, given = e.inputs, {name: signal(where.state.t) for name, signal in signals.items()}
    moving = {held[x.input + k].name for x in e.followed for k in range(1 + x.derivatives)}
    elsewhere = [name for name in given if name in moving | {x.name for x in e.switches}]
    if isinstance(mechanism, Instance):
        if elsewhere:
            raise InputError(
                f"{where.name}: {elsewhere[0]} prescribes a motion or switches a joint; set() it in the "
                "Instance, and make a step"
            )
    elif elsewhere or (rubs and e.frictions):  # the start differs, or sliding joints now stick
        return subject(mechanism, {**parameters, **given}, time, rubs)
    return _with_inputs(where, given)


def _with_inputs(where: Situation, inputs: Mapping[str, float]) -> Situation:
    """Return the situation with other inputs."""
    u, names = where.state.u.copy(), [v.name for v in where.equations.inputs]
    for name, value in inputs.items():
        if name not in names:
            raise InputError(f"{where.name} has no input {name!r}; {there_is(name, names)}")
        u[names.index(name)] = value
    return replace(where, state=replace(where.state, u=u))
