"""Variables that every scene has besides those of its mechanism: solver variables, monitors, impacts."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..model.errors import InputError
from ..model.settings import BRANCHES, FORMULATIONS, METHODS, Settings
from ..model.units import quotient
from ..model.words import interval, there_is
from .types import REACTION_ERROR, Configuration, Equations, Variable, configured

assert isinstance(Settings.penalty, float)  # a single penalty for all rows is the default
SOLVER_VARIABLES = (
    Variable("solver.step_size", "s", Settings.step_size, 1e-9, None, "largest internal step"),
    Variable("solver.penalty", "kg", Settings.penalty, 0.0, None, "artificial mass alpha; 0 scales it with the masses"),
    Variable(
        "solver.tolerance",
        "1",
        Settings.tolerance,
        1e-16,
        1e-3,
        "tolerance of multiplier iterations (relative) and of projected constraints (m, rad)",
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
    Variable(
        "solver.relative_tolerance",
        "1",
        Settings.relative_tolerance,
        1e-13,
        1e-1,
        "relative tolerance of methods with error control",
    ),
    Variable(
        "solver.absolute_tolerance",
        "1",
        Settings.absolute_tolerance,
        0.0,
        1.0,
        "absolute tolerance of methods with error control (m, rad; per s); 0 takes the number of the relative one",
    ),
    Variable(
        "solver.input_order",
        "1",
        Settings.input_order,
        0,
        2,
        "inputs inside a communication step: 0 held, 1 or 2 extrapolated from past communication points",
        type="Integer",
    ),
)
"""Solver variables that are numbers; those of `CHOICES` are text."""

Choice = Literal["solver.formulation", "solver.branch", "solver.method"]
"""Names of solver variables that are text."""

CHOICES: dict[Choice, dict[str, str]] = {
    "solver.formulation": FORMULATIONS,
    "solver.branch": BRANCHES,
    "solver.method": METHODS,
}
"""Values of each text variable."""

MONITORS = (
    Variable("monitor.position_error", "1", description="largest |Phi| (m, rad)"),
    Variable("monitor.velocity_error", "1", description="largest |Phi-dot| (m/s, rad/s)"),
    Variable("monitor.energy", "J", description="kinetic and potential energy"),
    Variable("monitor.work", "J", description="work of inputs, loads and dampers since the start, less impacts"),
    Variable(
        "monitor.step_error",
        "1",
        description="change of energy minus work in the last communication step, over the largest kinetic energy or "
        "work so far",
    ),
    Variable(
        "monitor.iterations",
        "1",
        description="multiplier iterations used at this instant",
        type="Integer",
        instant=True,
    ),
    Variable(
        "monitor.distance",
        "1",
        description="distance to a singular position: square root of the smallest pivot of the augmented mass, over "
        "its diagonal entry and apart from those of masses; rad for links of similar lengths",
    ),
    Variable(
        "monitor.singular",
        "1",
        description="0 regular; at a singular position 1 where reactions have a limit, which is given, "
        "2 where they grow without bound on both sides",
        type="Integer",
        instant=True,
    ),
    Variable(
        REACTION_ERROR,
        "1",
        description="estimated error of the reactions read at this instant: of the largest or, where a limit is read, "
        "of the least exact (N, N.m)",
        instant=True,
    ),
)
"""Outputs in which every instance reports its own accuracy."""


SOLVED = {"monitor.distance", "monitor.singular", REACTION_ERROR}
"""Monitors that need accelerations, multipliers or pivots, which are computed only if an output or monitor needs
them."""

BALANCE = {"monitor.energy", "monitor.work", "monitor.step_error"}
"""Monitors of the energy balance: without all of them, no work is integrated."""


def events(equations: Equations) -> list[Variable]:
    """Return variables that report impacts (last impulse of each switchable constraint, energy lost so far),
    and peaks."""
    return [v for v in every_event(equations) if v.name not in configured(equations).monitors]


def every_event(e: Equations) -> list[Variable]:
    """Return the variables of `events`, including those that are left out."""
    found = []
    for row in (e.rows[i] for switch in e.switches for i in switch.rows):
        name = f"{row.name}.impulse" if row.direction == "locked" else f"{row.name}.impulse.{row.direction}"
        text = f"last impulse of {row.name} when it came into force"
        found.append(Variable(name, "N.m.s" if row.unit == "rad" else "N.s", description=text))
    if e.switches:
        found.append(Variable("monitor.energy_lost", "J", description="kinetic energy that impacts took so far"))
    units = {v.name: v.unit for v in e.outputs}
    for name, parts in configured(e).peaks.items():
        text = f"largest magnitude of {name} within the last communication step; 0 before the first step"
        found.append(Variable(f"{name}{PEAK}", units[parts[0]], description=text, of_step=True))
    return found


PEAK = ".peak"
"""Suffix of the peak of an output, or of a vector of outputs."""


@dataclass(frozen=True)
class Interface:
    """The variables of a scene by causality; value references count through them in this order."""

    parameters: list[Variable]
    """Parameters of the mechanism, start values, start rates, compliances, starts of states, numbers of the solver."""
    choices: list[Variable]
    """Solver variables that are text."""
    inputs: list[Variable]
    switches: list[Variable]
    """Boolean inputs."""
    outputs: list[Variable]
    jacobian: list[Variable]
    """Entries of the interface Jacobian, which follow the outputs."""

    def causal(self, causality: str) -> list[Variable]:
        return [v for each, v in self.causalities if each == causality]

    @property
    def causalities(self) -> list[tuple[str, Variable]]:
        """All variables, each with its causality in FMI."""
        named = {"parameter": [*self.parameters, *self.choices], "input": [*self.inputs, *self.switches]}
        named["output"] = [*self.outputs, *self.jacobian]
        return [(causality, v) for causality, each in named.items() for v in each]


def default_settings(equations: Equations) -> Settings:
    """Return the default settings of a mechanism."""
    return Settings(**{"step_size": equations.step_size, **configured(equations).solver})


def integrator(equations: Equations) -> str:
    """Return the integrator that the settings of a mechanism select, `auto` already resolved."""
    method = default_settings(equations).method
    decided = equations.decision if isinstance(equations, Configuration) else None
    return decided.method if method == "auto" and decided else method


def variables_of(equations: Equations, settings: Settings | None = None) -> Interface:
    """Return the variables of a scene; defaults of the solver are those of `settings`."""
    e, given = configured(equations), settings or default_settings(equations)
    solver = [replace(v, start=_default(given, v.name)) for v in SOLVER_VARIABLES]
    return Interface(
        [*e.parameters, *e.starts, *e.start_rates, *e.compliances, *state_starts(e), *solver],
        choices({name: getattr(given, setting(name)) for name in CHOICES}),
        [*e.inputs],
        [Variable(s.name, "1", float(s.start), description=s.description, type="Boolean") for s in e.switches],
        [*e.outputs, *(v for v in MONITORS if v.name not in e.monitors), *events(e)],
        _jacobian(e),
    )


def _jacobian(e: Configuration) -> list[Variable]:
    """Return the entries of the interface Jacobian."""
    units = {v.name: v.unit for v in (*e.outputs, *e.inputs)}
    return [
        Variable(
            f"{output}/{by}",
            quotient(units[output], units[by]),
            description=f"derivative of {output} at the end of the last communication step by {by}, held over it; 0 "
            "before the first step",
            of_step=True,
        )
        for output, by in e.jacobian
    ]


def state_starts(equations: Equations) -> list[Variable]:
    """Return the parameters that set start values of states."""
    return [replace(v, name=f"start.{v.name}", description=f"{v.name} at the start") for v in equations.states]


def setting(name: str) -> str:
    """Return the field of Settings behind a solver variable."""
    return name.removeprefix("solver.")


def _default(settings: Settings, name: str) -> float:
    """Return the default of a solver variable; 0 for penalties of single constraints, which are no variables."""
    value = getattr(settings, setting(name))
    return float(value) if np.ndim(value) == 0 else 0.0


def not_there(equations: Equations, name: str, names: Collection[str]) -> str:
    """Return the message for a name that is no input or parameter; an independent coordinate has a start value."""
    said = f"{equations.name} has no input or parameter {name!r}"
    own = name.removeprefix("start.").removesuffix("_rate")
    if own in {c.name for c in equations.coordinates} and f"start.{own}" not in names:
        return f"{said}: {own} is not independent, so its start follows from others; declare it with independent=True"
    return f"{said}; {there_is(name, names)}"


def choices(values: Mapping[str, str]) -> list[Variable]:
    """Return the solver variables that are text, at the given values."""
    return [
        Variable(
            name,
            "1",
            values[name],
            description="one of " + ", ".join(f"{key} ({text})" for key, text in known.items()),
            type="String",
        )
        for name, known in CHOICES.items()
    ]


@dataclass
class Counters:
    """Work done and the largest errors seen since initialisation."""

    steps: int = 0
    evaluations: int = 0
    """Evaluations of accelerations and multipliers, including those for outputs."""
    multiplier_iterations: int = 0
    unconverged: int = 0
    """Evaluations in which the multiplier iteration reached its limit."""
    projection_iterations: int = 0
    refused: int = 0
    """Steps rejected as too inaccurate and repeated at a shorter step."""
    patient: int = 0
    """Steps by loops that stop on convergence, used where unrolled iterations did not converge."""
    unprojected: int = 0
    """Steps after which a constraint was above the tolerance."""
    position_error: float = 0.0
    """Largest |Phi| after a step [m, rad]."""
    velocity_error: float = 0.0
    """Largest |Phi-dot| after a step [m/s, rad/s]."""
    acceleration_error: float = 0.0
    """Largest |Phi-ddot| at an output [m/s2, rad/s2]."""
    energy_error: float = 0.0
    """Largest |energy - energy at the start - work of inputs, loads and dampers| at an output [J]."""
    run_error: float = 0.0
    """Energy error at communication points, over the largest kinetic energy or work so far [1]."""
    drift: float = 0.0
    """Estimated drift of positions that this energy error causes if no work is done [rad or m]."""


def checked(name: str, v: Variable, value: object) -> None:
    """Raise InputError if the variable of the mechanism of this name cannot have this value."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
        raise InputError(f"{name}: {v.name} is {value!r}; it must be a finite number in {v.unit}")
    if v.type == "Integer" and value != int(value):
        raise InputError(f"{name}: {v.name} is {value:g}; it must be a whole number")
    if (v.minimum is not None and value < v.minimum) or (v.maximum is not None and value > v.maximum):
        raise InputError(f"{name}: {v.name} = {value:g} {v.unit} is outside {interval(v.minimum, v.maximum)}")
