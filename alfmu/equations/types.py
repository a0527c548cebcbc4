"""Equations of a mechanism for numerical use: functions, names, units; no symbols, no declaration.

`alfmu.derive` makes `Equations`; a scene is traced from a `Configuration`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self

from ..model.kept import Kept
from ..model.words import Brief

if TYPE_CHECKING:
    import casadi as ca

REACTION_ERROR = "monitor.reaction_error"
"""The monitor that must be requested."""

Signature = dict[str, Any]
"""Sizes of a function: `inputs`, the length of each argument; `outputs`, [rows, columns] of each result, or [rows,
columns, column offsets, row indices] of a sparse one; `matrices`, the number of results that are matrices, the others
being vectors."""


@dataclass(frozen=True, repr=False)
class Variable(Brief):
    """A named quantity with unit, start value, inclusive bounds and description."""

    name: str
    unit: str
    start: float | str = 0.0
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""
    type: str = "Real"
    """FMI type: Real, Integer, Boolean or String."""
    instant: bool = False
    """Whether an output follows the inputs without delay (accelerations and reactions do)."""
    nominal: float | None = None
    """Declared order of magnitude; None if there is none."""
    readiness: float = 1.0
    """Weight of the change of a coordinate in the assembly: larger for one without a guess."""
    of_step: bool = False
    """Whether an output belongs to the last communication step, and changes only with steps."""


@dataclass(frozen=True, repr=False)
class Switch(Brief):
    """A Boolean input that switches constraints on and off while the mechanism moves."""

    name: str
    rows: list[int]
    """Constraints that it switches."""
    holds: bool
    """Whether they are in force while it is on (a lock) or off (a joint that can be released)."""
    value: int = -1
    """Index in `Equations.held` of the displacement that a lock keeps; -1 if there is none."""
    start: bool = False
    description: str = ""


@dataclass(frozen=True)
class Followed:
    """An input that prescribes motion: its index, and its extrapolation within a communication step."""

    input: int
    derivatives: int
    """Number of companions that follow it among the inputs: none, its rate, or also its acceleration."""
    order: int
    """Order of the polynomial that extrapolates the highest derivative given."""
    jump: float
    """Largest accepted difference [its unit] between a new value and the motion reached."""


@dataclass(frozen=True)
class Leap:
    """A law of time that may jump or diverge: its description, its unit, and the switchable constraint that it belongs
    to, -1 if it is always in force."""

    what: str
    unit: str
    row: int


@dataclass(frozen=True)
class Row:
    """One constraint: the joint, body or constraint that it closes, its direction and unit."""

    name: str
    direction: str
    unit: str
    size: float = 0.0
    """Value of the row per unit of displacement; 0 if it follows from the coefficients (`start/row_units.c`)."""

    @property
    def what(self) -> str:
        """The direction in words."""
        return "dry friction" if self.direction == "friction" else self.direction

    @property
    def text(self) -> str:
        """Joint and direction for display: `A x`, `drum locked`, `A dry friction`."""
        return f"{self.name} {self.what}".strip()


@dataclass(frozen=True)
class Rubbing:
    """Dry friction of a joint, proportional to its load: a constraint while the joint sticks.

    While the joint slides, the law of friction gives the multiplier of that constraint.
    """

    name: str
    row: int
    value: int
    """Index in `Equations.held` of the displacement at which it sticks."""
    slip: int
    """Index there of the direction in which it slides: 1 or -1, 0 while it sticks (`equations.friction` has others)."""
    output: str
    """Name of the output for its friction."""


@dataclass(frozen=True)
class Mobility:
    """Degrees of freedom of a mechanism: in general, and at one position."""

    freedom: int
    """Degrees of freedom at a regular position."""
    redundant: int
    """Constraints that depend on the others at every position."""
    freedom_here: int
    """Independent velocities at the given position; more than `freedom` where it is singular."""


@dataclass(frozen=True)
class Decision:
    """The integrator of a scene."""

    method: str
    """A method of `alfmu.model.settings`, never `auto`."""
    reason: str = ""
    """Reason for which `auto` selected it; empty if the method was given."""


@dataclass(frozen=True)
class Survey:
    """Properties of a scene at its start, which its programs depend on.

    The runtime assembles the mechanism to find them (`alfmu.runtime.probe.survey`), before anything is traced.
    """

    mobility: Mobility | None = None
    """None if unknown: not surveyed, or the defaults have no start."""
    iterations: int = 2
    """Multiplier iterations that reach round-off at a regular position."""
    shared: tuple[str, ...] | None = None
    """Outputs that are not unique, as redundant constraints share a load; None if unknown."""
    brakes: bool = False
    """Whether redundant constraints become independent near the start and brake the motion (S5 of docs/singular.md)."""
    uneven: bool = False
    """Whether constraints have different units, so that each has its own penalty."""

    @property
    def elsewhere(self) -> Survey:
        """Return the properties that hold at other starts, too."""
        return replace(self, mobility=None, iterations=Survey.iterations)


_TUPLES = (
    *("coordinates", "parameters", "starts", "start_rates", "inputs", "outputs", "rows"),
    *("compliances", "switches", "frictions", "states"),
)
"""Fields of equations that are converted to tuples, as users read them."""


class _Functions:
    """The functions of equations as attributes."""

    if TYPE_CHECKING:
        M: ca.Function
        d: ca.Function
        f: ca.Function
        Phi: ca.Function
        C: ca.Function
        xi: ca.Function
        Phi_dot: ca.Function
        displacements: ca.Function
        gaps: ca.Function
        gaps_matrix: ca.Function
        kinetic_energy: ca.Function
        potential_energy: ca.Function
        input_power: ca.Function
        other_power: ca.Function
        motion_power: ca.Function
        state_rates: ca.Function
        readings: ca.Function
        shares: ca.Function
        rubbing: ca.Function
        sliding: ca.Function
        instants: ca.Function
        stops: ca.Function
        laws: ca.Function
        guess: ca.Function
        guess_rate: ca.Function
        ties: ca.Function
        ties_matrix: ca.Function
        dynamics: ca.Function
        constraints: ca.Function
        power: ca.Function
        energy: ca.Function
        tangents: ca.Function


@dataclass(frozen=True, repr=False)
class Equations(_Functions):
    """The equations that `alfmu.derive` found of a mechanism with n coordinates and l constraints.

    `functions` holds CasADi functions of q (n,), v (n,), a (n,), lam (l,), u (inputs, and behind them the states x),
    p (parameters), s (start values) and t (s); the name of each is the paper's letter or the quantity:

    ===============================  ======================================================  ======================
    M(q, p)                          mass matrix (n, n)                                      kinetic energy v'Mv/2
    d(q, v, p)                       velocity terms (n,)                                     (4)
    f(q, v, u, p, t)                 applied forces (n,)                                     (4)
    Phi(q, p)                        constraints (l,)                                        (1)
    C(q, p)                          constraint matrix (l, n)                                (2)
    xi(q, v, p)                      constraint-induced accelerations (l,)                   (3)
    displacements(q, p)              displacements that locks keep, m or rad
    counted(q, p)                    angles whose turns count, rad
    gaps(q, p)                       opening of each constraint (l,), m or rad               zero where Phi is
    gaps_matrix(q, p)                its derivative (l, n)
    kinetic_energy(q, v, p)          J
    potential_energy(q, p)           J
    input_power(q, v, u, p, t)       power of the inputs and states, W
    other_power(q, v, p, t)          power of dampers and loads, W
    state_rates(q, v, u, p, t)       time derivatives of the states
    readings(q, v, a, lam, u, p, t)  everything a user can read, in the order of `outputs`
    shares(q, v, a, lam, u, p, t)    half the derivative by lam of the sum of squares of     zero at least loads
                                     all loads of joints [N; N.m over L] (l,)
    rubbing(q, v, a, lam, u, p, t)   multipliers, limits, second rates of dry friction
    sliding(q, v, p)                 rates of joints with dry friction
    instants(p)                      times that are declared as events, s
    stops(q, p)                      displacement beyond each limit of a stop, m or rad
    guess(p, s)                      start of the position assembly (n,)
    guess_rate(p, s, sdot)           its time derivative (n,)
    ties(q, p, s)                    independent quantities minus their start values
    ties_matrix(q, p, s)             its derivative with respect to q
    ===============================  ======================================================  ======================

    If positions, constraints or energies depend on time, time is the last coordinate, its rate is 1, and there are

    ========================================  ==================================================================
    Phi_dot(q, v, p)                          C v + Phi_t (l,), linear in v
    motion_power(q, v, a, lam, u, p, t)       power of prescribed motion, W
    laws(q, v, p)                             laws of time that may jump or diverge, and their first and second rates
    ========================================  ==================================================================

    `alfmu.equations.evaluation` combines the functions that are evaluated with numbers, and `alfmu.kernel.trace` traces
    them.
    """

    name: str
    description: str
    coordinates: Sequence[Variable]
    parameters: Sequence[Variable]
    starts: Sequence[Variable]
    start_rates: Sequence[Variable]
    tied: list[int]
    inputs: Sequence[Variable]
    outputs: Sequence[Variable]
    rows: Sequence[Row]
    wrapped: dict[str, int]
    """Outputs that are angles known only up to whole turns, and the start value near which each begins (-1: none)."""
    works: bool
    """Whether inputs, dampers or loads do work; otherwise energy is conserved."""
    stop_time: float
    step_size: float
    interval: float
    """Default communication step [s]."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options that the mechanism was declared with."""
    lengths: list[int] = field(default_factory=list)
    """Constraints that keep Euler parameters at unit length: they belong to no joint."""
    slips: list[int] = field(default_factory=list)
    """Nonholonomic constraints: they have rows in C, and none in Phi."""
    compliances: Sequence[Variable] = ()
    """Compliance of each constraint, if a user may give them: redundant ones then share a load as elastic ones do."""
    switches: Sequence[Switch] = ()
    """Boolean inputs that change the topology."""
    frictions: Sequence[Rubbing] = ()
    """Joints with dry friction."""
    held: list[str] = field(default_factory=list)
    """Names of stored values in p after the parameters, which `displacements` computes: displacements that locks keep,
    states of joints with dry friction, angles whose turns are counted, and if time is a coordinate, the time at which
    the run began and the numbers of signals."""
    counted: dict[str, int] = field(default_factory=dict)
    """Angles among `held` whose turns are counted because something depends on them, and the start value they begin
    near."""
    states: Sequence[Variable] = ()
    """States of first-order equations, integrated with the motion; `start` is their value at the start."""
    resting: bool = False
    """Whether a dummy coordinate stands for a mechanism of states alone; it never moves."""
    timed: bool = False
    """Whether time is the last coordinate."""
    followed: Sequence[Followed] = ()
    """Inputs that prescribe motion."""
    leaps: Sequence[Leap] = ()
    """Laws of time that may jump or diverge."""
    limited: Sequence[Variable] = ()
    """Stops, by their names and units, one for each of their limits."""
    reach: float = 0.0
    """Largest coordinate [m] of a joint's point on the ground, by default parameters; round-off grows with it."""
    functions: dict[str, ca.Function] = field(default_factory=dict, repr=False)
    signatures: dict[str, Signature] = field(default_factory=dict, repr=False)
    """Sizes of the functions that run with numbers."""
    kept: Kept = field(default_factory=Kept, init=False, repr=False, compare=False)
    """Cache of results of these equations, not passed on to equations made from them."""

    def __post_init__(self) -> None:
        # Instances share equations, so users must not change them.
        for each in _TUPLES:
            object.__setattr__(self, each, tuple(getattr(self, each)))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, n = {self.n}, l = {self.l})"

    @classmethod
    def of(cls, equations: Equations, **changes: Any) -> Self:
        """Return equations at this stage, with changes; fields of later stages are dropped."""
        if type(equations) is cls and not changes:
            return equations
        given = vars(equations)
        known = {field.name: given[field.name] for field in fields(cls) if field.init and field.name in given}
        return cls(**{**known, **changes})

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def l(self) -> int:  # noqa: E743 - the paper's letter
        """Number of constraints."""
        return len(self.rows)

    @property
    def driven(self) -> int:
        """Length of u: inputs, followed by states."""
        return len(self.inputs) + len(self.states)

    @property
    def dependent(self) -> int:
        """Number of coordinates without time."""
        return self.n - self.timed

    @property
    def changes(self) -> bool:
        """Whether constraints come into force and go while a scene runs."""
        return bool(self.switches or self.frictions)

    @property
    def turns(self) -> bool:
        """Whether there are Euler parameters, each of which has a small pivot somewhere along a motion."""
        return any(c.unit == "1" for c in self.coordinates)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> ca.Function:
            functions = self.__dict__.get("functions", {})
            if name in functions:
                return functions[name]
            raise AttributeError(name)


@dataclass(frozen=True, repr=False)
class Configuration(Equations):
    """Equations with the defaults, outputs and frozen parameters of a scene, with its integrator and survey."""

    solver: dict[str, Any] = field(default_factory=dict)
    """Defaults of solver variables that differ from those of alfmu, by name without `solver.`."""
    monitors: list[str] = field(default_factory=lambda: [REACTION_ERROR])
    """Monitors that are left out."""
    jacobian: Sequence[tuple[str, str]] = ()
    """Entries of the interface Jacobian: an output, and the input by which it is differentiated."""
    peaks: dict[str, list[str]] = field(default_factory=dict)
    """Peaks requested, and the outputs that each consists of."""
    decision: Decision | None = None
    """None if the method of integration is not decided yet."""
    survey: Survey = Survey()


def configured(equations: Equations) -> Configuration:
    """Return equations as a configuration: with alfmu's defaults and all outputs, if they are none yet."""
    if isinstance(equations, Configuration):
        return equations
    return equations.kept.latest(configured, lambda: Configuration.of(equations))
