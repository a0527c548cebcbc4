"""The equations of a mechanism as numbers need them: functions, names, units. No symbols, no declaration.

`alfmu.derive` makes `Equations`; a `Configuration` is what a scene is traced from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self

from ..model.kept import Kept
from ..model.words import Brief

if TYPE_CHECKING:
    import casadi as ca

__all__ = [
    *(
        "REACTION_ERROR",
        "Configuration",
        "Decision",
        "Equations",
        "Followed",
        "Leap",
        "Mobility",
        "Row",
        "Signature",
        "Survey",
        "Switch",
    ),
    "Variable",
]

REACTION_ERROR = "monitor.reaction_error"
"""The monitor that is there on request alone."""

Signature = dict[str, Any]
"""Of a function: `inputs`, the length of each argument; `outputs`, [rows, columns] of each result, or [rows, columns,
column offsets, row indices] where it is sparse; `matrices`, how many of the results are matrices, the rest being
vectors."""


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
    """What a large value is, where one is declared."""
    of_step: bool = False
    """Whether an output belongs to the communication step that was made last, and changes with steps alone."""


@dataclass(frozen=True, repr=False)
class Switch(Brief):
    """A Boolean input that puts constraints in force and out of it while the mechanism moves."""

    name: str
    rows: list[int]
    """Constraints that it concerns."""
    holds: bool
    """Whether they hold where it is on (a lock) or where it is off (a joint that can be released)."""
    value: int = -1
    """Place among `Equations.held` of the displacement that a lock keeps; -1 where nothing is kept."""
    start: bool = False
    description: str = ""


@dataclass(frozen=True)
class Followed:
    """An input that moves something: its place among the inputs, and how it goes on inside a communication step."""

    input: int
    derivatives: int
    """Companions that follow it among the inputs: none, its rate, or its acceleration too."""
    order: int
    """Of the polynomial by which the highest derivative given goes on."""
    jump: float
    """Largest difference [in its unit] of a value and of what the motion has reached."""


@dataclass(frozen=True)
class Leap:
    """A law of time that may jump, or not be finite: what it is, in words, its unit, and the constraint with which
    alone it counts, -1 where it always does."""

    what: str
    unit: str
    row: int


@dataclass(frozen=True)
class Row:
    """One constraint: the joint (or body, or constraint) that it closes, its direction and unit."""

    name: str
    direction: str
    unit: str
    size: float = 0.0
    """What the row comes to for a unit of displacement; 0 where the coefficients have to tell (`start/row_units.c`)."""

    @property
    def what(self) -> str:
        """The direction in words."""
        return "dry friction" if self.direction == "friction" else self.direction

    @property
    def text(self) -> str:
        """Joint and direction as they are shown: `A x`, `drum locked`, `A dry friction`."""
        return f"{self.name} {self.what}".strip()


@dataclass(frozen=True)
class Rubbing:
    """Dry friction of a joint, in proportion to its load: a constraint that holds while the joint sticks.

    While it slides, the multiplier of that constraint is what the law of friction gives for the load.
    """

    name: str
    row: int
    value: int
    """Place among `Equations.held` of the displacement at which it sticks."""
    slip: int
    """Place there of the direction in which it slides: 1 or -1, 0 while it sticks (`equations.friction` has others)."""
    output: str
    """The output of its friction."""


@dataclass(frozen=True)
class Mobility:
    """How a mechanism can move: in general, and at one position."""

    freedom: int
    """Degrees of freedom at a regular position."""
    redundant: int
    """Constraints that follow from the others on the whole of the motion."""
    freedom_here: int
    """Independent velocities at the given position; more than `freedom` where it is singular."""


@dataclass(frozen=True)
class Decision:
    """The method of integration of a scene."""

    method: str
    """A method of `alfmu.model.settings`, never `auto`."""
    reason: str = ""
    """Why `auto` stands for it; empty where the method was given."""


@dataclass(frozen=True)
class Survey:
    """Properties of a scene at its start, which its programs depend on.

    The runtime assembles the mechanism to find them (`alfmu.runtime.probe.survey`), before anything is traced.
    """

    mobility: Mobility | None = None
    """None where it is not known: nobody looked, or the defaults have no start."""
    iterations: int = 2
    """Multiplier iterations that reach round-off at a regular position."""
    shared: tuple[str, ...] | None = None
    """Outputs that are not unique, as redundant constraints share a load; None where it is not known."""
    brakes: bool = False
    """Whether redundant constraints become independent beside the motion and brake it (S5 of docs/singular.md)."""
    uneven: bool = False
    """Whether constraints are in different units, so that each has a penalty of its own."""

    @property
    def elsewhere(self) -> Survey:
        """The part of it that holds at other starts, too."""
        return replace(self, mobility=None, iterations=Survey.iterations)


_TUPLES = (
    *("coordinates", "parameters", "starts", "start_rates", "inputs", "outputs", "rows"),
    *("compliances", "switches", "frictions", "states", "jacobian"),
)
"""Fields of equations that users read."""


@dataclass(frozen=True, repr=False)
class Equations:
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
    displacements(q, p)              what locks keep, m or rad
    counted(q, p)                    angles whose turns count, rad
    gaps(q, p)                       how far each constraint is open (l,), m or rad          zero where Phi is
    gaps_matrix(q, p)                its derivative (l, n)
    kinetic_energy(q, v, p)          J
    potential_energy(q, p)           J
    input_power(q, v, u, p, t)       power of the inputs and states, W
    other_power(q, v, p, t)          power of dampers and loads, W
    state_rates(q, v, u, p, t)       time derivatives of the states
    readings(q, v, a, lam, u, p, t)  everything a user can read, in the order of `outputs`
    shares(q, v, a, lam, u, p, t)    half the derivative by lam of the sum of squares of     zero where least
                                     all that joints carry [N; N.m over L] (l,)
    rubbing(q, v, a, lam, u, p, t)   of dry friction: multipliers, limits, second rates
    sliding(q, v, p)                 rates of joints with dry friction
    instants(p)                      times that are declared as events, s
    stops(q, p)                      how far each limit of a stop is passed, m or rad
    guess(p, s)                      start of the position assembly (n,)
    guess_rate(p, s, sdot)           its time derivative (n,)
    ties(q, p, s)                    independent quantities minus their start values
    ties_matrix(q, p, s)             its derivative with respect to q
    ===============================  ======================================================  ======================

    Where places, constraints or energies depend on time, time is the last coordinate, its rate is 1, and there are also

    ========================================  ==================================================================
    Phi_dot(q, v, p)                          C v + Phi_t (l,), linear in v
    motion_power(q, v, a, lam, u, p, t)       power of what moves by itself, W
    laws(q, v, p)                             laws of time that may break, their rates, and the rates of these
    ========================================  ==================================================================

    Those that are evaluated with numbers are combined by `alfmu.equations.evaluation`, and traced into a kernel by
    `alfmu.kernel.trace`.
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
    """Outputs that are angles known up to whole turns only, and the start value they begin near (-1: none)."""
    works: bool
    """Whether inputs, dampers or loads do work; otherwise energy is conserved."""
    stop_time: float
    step_size: float
    interval: float
    """Communication step when nobody says otherwise [s]."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options that the mechanism was declared with."""
    solver: dict[str, Any] = field(default_factory=dict)
    """Defaults of solver variables that differ from those of alfmu, by name without `solver.`."""
    monitors: list[str] = field(default_factory=lambda: [REACTION_ERROR])
    """Monitors that are left out."""
    order: list[int] = field(default_factory=list)
    """Order of the coordinates in which the augmented mass fills in least when it is factorised."""
    telling: list[int] = field(default_factory=list)
    """Independent coordinates, which a start gives one by one."""
    lengths: list[int] = field(default_factory=list)
    """Constraints that keep Euler parameters at unit length: they belong to no joint."""
    slips: list[int] = field(default_factory=list)
    """Constraints of velocities alone (not holonomic): they have rows in C, and none in Phi."""
    compliances: Sequence[Variable] = ()
    """Compliance of each constraint, where a user may give them: redundant ones share a load as elastic ones do."""
    switches: Sequence[Switch] = ()
    """Boolean inputs that change the topology."""
    frictions: Sequence[Rubbing] = ()
    """Joints with dry friction."""
    held: list[str] = field(default_factory=list)
    """Displacements that locks keep, and what joints with dry friction remember: their values follow the parameters in
    p, `displacements` computes them. Behind them angles whose turns count; and where time is a coordinate, the time at
    which the run began and the numbers of signals."""
    counted: dict[str, int] = field(default_factory=dict)
    """Angles among `held` whose turns count, as something depends on them, and the start value they begin near."""
    states: Sequence[Variable] = ()
    """Quantities of first-order equations that are integrated with the motion; `start` is their value at the start."""
    resting: bool = False
    """Whether the one coordinate stands for none: of states alone, it never moves."""
    timed: bool = False
    """Whether time is the last coordinate."""
    followed: Sequence[Followed] = ()
    """Inputs that move something."""
    leaps: Sequence[Leap] = ()
    """Laws of time that may jump, or not be finite."""
    limited: Sequence[Variable] = ()
    """Stops, by their names and units, one for each of their limits."""
    jacobian: Sequence[tuple[str, str]] = ()
    """Entries of the interface Jacobian: names of an output and of the input that it is differentiated by."""
    peaks: dict[str, list[str]] = field(default_factory=dict)
    """Of what the largest magnitude within a communication step is asked for, and the outputs that it consists of."""
    functions: dict[str, ca.Function] = field(default_factory=dict, repr=False)
    signatures: dict[str, Signature] = field(default_factory=dict, repr=False)
    """Sizes of the functions that run with numbers."""
    kept: Kept = field(default_factory=Kept, init=False, repr=False, compare=False)
    """Results that follow from these equations: made once, and not kept for others made of them."""

    def __post_init__(self) -> None:
        # Equations are shared by instances, so that nobody may change them.
        for each in _TUPLES:
            object.__setattr__(self, each, tuple(getattr(self, each)))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, n = {self.n}, l = {self.l})"

    @classmethod
    def of(cls, equations: Equations, **changes: Any) -> Self:
        """Return equations at this stage, with what belongs to later ones left out, and with changes."""
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
        """Length of u: inputs, and behind them states."""
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
        """Whether there are Euler parameters, whose pivots are small in turn along a motion."""
        return any(c.unit == "1" for c in self.coordinates)

    def __getattr__(self, name: str) -> ca.Function:
        functions = self.__dict__.get("functions", {})
        if name in functions:
            return functions[name]
        raise AttributeError(name)


@dataclass(frozen=True, repr=False)
class Configuration(Equations):
    """Equations with the defaults, outputs and frozen parameters of a scene, and what is decided and found for it."""

    decision: Decision | None = None
    """None where the method of integration is not decided yet."""
    survey: Survey = Survey()
