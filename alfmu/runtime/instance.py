"""One mechanism in motion: values by name, initialisation, communication steps, outputs, complete state.

The C library makes the steps; this module binds it to NumPy, and `alfmu.simulate` drives it.
"""

from __future__ import annotations

import ctypes
import logging
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Never, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..catalogue.registry import load
from ..equations import Equations, Mobility, Variable
from ..equations.evaluation import DENSE
from ..equations.interface import CHOICES, Choice, Counters, checked, default_settings, not_there, setting, variables_of
from ..kernel import DEFAULT
from ..kernel.form import Traced
from ..kernel.kinks import jumps
from ..kernel.memory import TALLY, TIERS, Layout, Memory
from ..method.singular import MEAN
from ..model.errors import AlfmuError, AlfmuWarning, AssemblyError, InputError, OpenError, StepError
from ..model.kept import once
from ..model.mechanism import Mechanism
from ..model.settings import FIXED, Settings
from ..model.words import there_is
from .library import BRAKES, DONE, ENDED, INTERRUPTED, OPEN, REFUSED, UNHELD, Run, Unit
from .pipeline import derive, loaded, ready, retraced, with_brakes
from .probe import mobility, shared

_NAMED = 5
"""Largest number of coordinates that a message names."""

_LOGGER = logging.getLogger("alfmu")

_FREE = 1e-7
"""Ratio of the rate of a start value or coordinate to that of a motion [1] below which the motion does not change
it."""

_COUNTED = (
    *("patient_steps", "reads", "quick_reads", "unconverged", "position_error", "velocity_error", "acceleration_error"),
    *("energy_error", "energy_start", "balance", "energy_scale", "step_error", "run_error", "at_rest", "drift"),
)
"""Counters of the library that are not in the tally of the kernel, in the order of the library."""


@once
def tell_of_jumps(equations: Equations) -> bool:
    """Warn once of forces that may jump; derivatives omit the effect of jumps."""
    if found := jumps(equations.functions["dynamics"]):
        _LOGGER.warning(
            "%s: its forces have %s, as contacts do; derivatives are exact if forces change continuously, and omit "
            "the effect of jumps",
            *(equations.name, " and ".join(found)),
        )
    return True


class Instance:
    """A mechanism with its own parameters, inputs and state.

    Use: `set` parameters and start values, `initialize`, then `step` and `get`, with `set` on inputs at any time::

        i = Instance("five_bar")
        i.set("m2", 0.0)
        i.initialize()
        i.step(0.02)
        i.get("link1.angle")

    `mechanism` is a `Mechanism`, a name, a file, or equations. `settings` (`alfmu.model.settings`) are for studies of
    the method and include numbers that no solver variable sets. `outputs` are those of `alfmu.simulate`. A call that
    raises leaves the instance unchanged.
    """

    def __init__(
        self,
        mechanism: str | Path | Mechanism | Equations,
        settings: Settings | None = None,
        outputs: Sequence[str] | None = None,
    ):
        e = mechanism if isinstance(mechanism, Equations) else derive(load(mechanism))
        if e is not mechanism or outputs is not None:
            e, _ = ready(e, {}, outputs, None, DEFAULT)
        self._given = (settings or default_settings(e)).checked(e.name, e.l)
        self._take(e)

    def __repr__(self) -> str:
        return f"Instance({self.name!r}, {f't = {self.time:g} s' if self.initialized else 'not initialised'})"

    def _take(self, equations: Equations) -> None:
        """Load the scene of these equations with the given settings."""
        e = retraced(equations, self._given)
        self.equations: Traced = e
        given = self._given
        self.name: str = e.name
        found = variables_of(e, given)
        self.parameters: tuple[Variable, ...] = tuple(found.parameters)
        self.outputs: tuple[Variable, ...] = tuple(found.causal("output"))
        self.input_variables: tuple[Variable, ...] = (*found.inputs, *found.switches)
        self._variables = {v.name: v for _, v in found.causalities}
        self._scene = loaded(e)
        self._unit = Unit(self._scene)
        if e.jacobian:
            tell_of_jumps(e)
        self._references = self._scene.references
        for v in (*found.parameters, *found.choices):
            self._unit.set(self._references[v.name], v.start)
        projection = -1 if given.projection is None else int(given.projection)
        self._judged(self._scene.library.alfmu_stabilise(self._unit.address, given.zeta, given.omega, projection))
        if np.ndim(given.penalty):
            self._penalize(np.asarray(given.penalty, float))
        layout = Layout(e)
        self.layout: Layout = layout
        address = self._scene.library.alfmu_state(self._unit.address) - 8 * layout.fields["z"][0]
        block = np.ctypeslib.as_array((ctypes.c_double * layout.size).from_address(address))
        self.memory: Memory = Memory(layout, block=block)
        """Named fields of the numbers that evolve (`alfmu.kernel.memory.Layout`), as views."""
        self.state: NDArray[np.float64] = self.memory["z"][: layout.time + 1]

    # State -------------------------------------------------------------------------------------------------------

    @property
    def q(self) -> NDArray[np.float64]:
        """Coordinates (n,) [m or rad], a view."""
        return self.state[: self.layout.n]

    @property
    def v(self) -> NDArray[np.float64]:
        """Velocities (n,) [m/s or rad/s], a view."""
        return self.state[self.layout.n : 2 * self.layout.n]

    @property
    def angles(self) -> NDArray[np.float64]:
        """Angles [rad] that are computed from coordinates, whole turns counted, a view."""
        return self.state[2 * self.layout.n : self.layout.work]

    @property
    def inputs(self) -> NDArray[np.float64]:
        """Numeric inputs, a view; values written here are not checked, those of `set` are."""
        return self.memory["u"]

    @property
    def states(self) -> NDArray[np.float64]:
        """States of first-order equations (`Mechanism.state`), in the order of their declaration, a view."""
        return self.state[self.layout.states : self.layout.time]

    @property
    def driven(self) -> NDArray[np.float64]:
        """The argument u of the equations: inputs, then states."""
        return np.concatenate([self.inputs, self.states]) if self.equations.states else self.inputs

    @property
    def work(self) -> float:
        """Work of inputs, loads and dampers since the start [J]."""
        return float(self.state[self.layout.work])

    @property
    def time(self) -> float:
        """Time [s]."""
        return self._unit.time

    @time.setter
    def time(self, value: float) -> None:
        self._unit.time = value

    @property
    def energy_start(self) -> float:
        """Kinetic and potential energy at the start [J]."""
        return self._counted()["energy_start"]

    @property
    def energy_scale(self) -> float:
        """Largest kinetic energy, or work, at a communication point so far [J]."""
        return self._counted()["energy_scale"]

    @property
    def initialized(self) -> bool:
        """Whether `initialize` has assembled the mechanism."""
        return self._unit.initialized

    @property
    def adapts(self) -> bool:
        """Whether the chosen integrator controls its error."""
        return self.choices["solver.method"] not in FIXED

    @property
    def values(self) -> NDArray[np.float64]:
        """Parameters, start values and numeric solver variables, in the order of `parameters`."""
        return np.array(self._unit.get_many(range(len(self.parameters)))[1])

    @property
    def choices(self) -> dict[str, str]:
        """The solver variables that are text."""
        return {name: str(self._unit.get(self._references[name])) for name in CHOICES}

    # Values ------------------------------------------------------------------------------------------------------

    def set(self, name: str, value: float | str) -> None:
        """Set an input (any time), or a parameter, start value or solver variable (before `initialize`), in its unit.

        Raises InputError, and keeps the old value, if the name is unknown or the value is not finite or out of its
        bounds.
        """
        e = self.equations
        reference = self._references.get(name)
        if reference is None or reference >= self._scene.first_output:
            names = list(self._references)[: self._scene.first_output]
            raise InputError(not_there(e, name, names))
        v = self._variables[name]
        if v.type == "Boolean":
            if value not in (0, 1):
                raise InputError(f"{e.name}: {name} is {value!r}; it must be true or false")
        elif v.type == "String":
            changed: dict[str, Any] = {setting(name): value}
            replace(self._given, **changed).checked(e.name, e.l)
        else:
            checked(e.name, v, value)
        if setting(name) in ("method", "input_order") and not self.initialized:
            self._retrace(setting(name), value)
        elif self._unit.set(reference, value if isinstance(value, str) else float(value)) != DONE:
            raise InputError(self._unit.text)

    def slope(self, name: str, rate: float) -> None:
        """Set the rate, per second, at which an input changes in the next communication step from the value set before.

        Afterwards the input keeps the value at the end of that step. `set` cancels the rate. Raises InputError
        if the name is not that of a numeric input, or the rate is not finite.
        """
        v = self._variables.get(name)
        if v not in self.input_variables or v.type != "Real":
            names = [each.name for each in self.input_variables if each.type == "Real"]
            raise InputError(f"{self.name} has no input {name!r} that is a number; {there_is(name, names)}")
        if self._unit.slope(self._references[name], float(rate)) != DONE:
            raise InputError(self._unit.text)

    def _retrace(self, name: str, value: float | str) -> None:
        """Change the integrator or the order of inputs; this loads another scene and keeps the values set before."""
        changed: dict[str, Any] = {name: int(value) if name == "input_order" else value}
        before = self._given
        if getattr(before, name) == changed[name]:
            return
        self._given = replace(before, **changed)
        try:
            self._rebuild(self.equations)
        except AlfmuError:
            self._given = before
            raise

    def _rebuild(self, equations: Equations) -> None:
        """Load other equations of this mechanism and keep the values set before."""
        known = [*self._references][: self._scene.first_output]
        values, time = {each: self._unit.get(self._references[each]) for each in known}, self.time
        self._take(equations)
        for each, old in values.items():
            if setting(each) not in ("method", "input_order"):
                self._unit.set(self._references[each], old)
        self.time = time

    @overload  # A choice is a text; every other variable is a number.
    def get(self, name: Choice) -> str: ...  # type: ignore[overload-overlap]
    @overload
    def get(self, name: str) -> float: ...
    def get(self, name: str) -> float | str:
        """Return the value of an output, an input, a parameter, a start value or a solver variable, in its unit.

        A choice such as `solver.method` is a text. Raises InputError if the name is unknown, or if it is an output and
        the instance is not initialised; StepError if the outputs cannot be computed.
        """
        if name not in self._references:
            raise InputError(f"{self.equations.name} has no variable {name!r}; {there_is(name, self._references)}")
        reference = self._references[name]
        if reference >= self._scene.first_output:
            self._read()
        return self._unit.get(reference)

    # Start and steps ---------------------------------------------------------------------------------------------

    def initialize(self) -> None:
        """Assemble the mechanism from its start values at `time`; parameters are fixed from here on.

        Warns if the result is not the assembly nearest to the guess. Raises AssemblyError if the loops cannot be
        closed, InputError if a parameter is invalid.
        """
        self._unit.run_on(False)
        self.memory["passes"][:] = 0.0
        outcome = self._unit.initialize()
        if outcome == BRAKES:
            self._rebuild(with_brakes(self.equations))
            outcome = self._unit.initialize()
        if outcome != DONE:
            raise self._failure(outcome, moving=False)
        self._assembled()
        self._warn()
        self._unit.run_on(True)

    def _assembled(self) -> None:
        """Record the assembled position, and warn if the library reports that it is far from the guess."""
        self._start = np.array(self.q)
        if self._unit.text:
            body, way = next(iter(self.moved.items()), ("", 0.0))
            most = f"; it moved {body} by {way:.3g} m" * (way > 0)
            warnings.warn(self._unit.text + most, AlfmuWarning, stacklevel=3)

    @property
    def moved(self) -> dict[str, float]:
        """Distance [m] by which the assembly moved each body from its guessed position, the largest first.

        Includes every part with outputs NAME.x and NAME.y (and NAME.z in space); if there are none, the coordinates
        that are lengths.
        """
        e, p, v, guess = self.equations, self.memory["p"], np.zeros(self.equations.n), self._guess()
        places = [
            np.array(e.functions["readings"](q, v, v, np.zeros(e.l), np.zeros(e.driven), p, 0.0)).ravel()
            for q in (guess, self._start)
        ]
        square: dict[str, float] = {}
        for output, before, after in zip(e.outputs, *places, strict=True):
            name, _, axis = output.name.rpartition(".")
            if name and axis in "xyz" and output.unit == "m":
                square[name] = square.get(name, 0.0) + (after - before) ** 2
        if not square:
            changes = zip(e.coordinates, self._start - guess, strict=True)
            square = {c.name: change**2 for c, change in changes if c.unit == "m"}
        return {name: math.sqrt(x) for name, x in sorted(square.items(), key=lambda each: -each[1])}

    def _guess(self) -> NDArray[np.float64]:
        """Return the guess (n,) from which the assembly began."""
        e = self.equations
        s = self.values[len(e.parameters) :][: len(e.starts)]
        return np.array(e.functions["guess"](self.memory["p"], s)).ravel()

    @property
    def turned(self) -> dict[str, float]:
        """Change [rad] of each angle among the coordinates, and of the attitude of each body with Euler parameters of
        its own, from the guess to the assembly, the largest first."""
        guess, coordinates = self._guess(), self.equations.coordinates
        changes = zip(coordinates, self._start - guess, strict=True)
        angles = {c.name: float(change) for c, change in changes if c.unit == "rad"}
        places = {c.name: k for k, c in enumerate(coordinates)}
        for body in self._flying:
            k = places[f"{body}_e0"]
            before, after = guess[k : k + 4], self._start[k : k + 4]
            angles[body] = 2 * math.acos(min(1.0, float(abs(before @ after) / np.linalg.norm(before))))
        return dict(sorted(angles.items(), key=lambda each: -abs(each[1])))

    @property
    def _flying(self) -> list[str]:
        """Names of the bodies with a place and Euler parameters of their own."""
        e = self.equations
        names, bodies = {c.name for c in e.coordinates}, [e.rows[i].name.removesuffix(".attitude") for i in e.lengths]
        return [body for body in bodies if f"{body}_e0" in names]

    def undetermined(self) -> list[str]:
        """Return coordinates that neither constraints nor start values determine, so that they begin at their guess.

        Returns none for more than `alfmu.equations.evaluation.DENSE` coordinates, and none at a singular position,
        where other coordinates move on each branch.
        """
        e = self.equations
        if e.n > DENSE or e.resting:
            return []
        found, place = self._mobility()
        if found.freedom_here > found.freedom:
            return []
        p, s = self.memory["p"], self.values[len(e.parameters) :][: len(e.starts)]
        C = np.array(e.functions["constraints"](place, np.zeros(e.n), p)[1]).reshape(e.l, e.n)[self.penalty > 0]
        n = e.dependent
        motions = np.linalg.svd(np.vstack([C[:, :n], np.zeros((n, n))]))[2][n - found.freedom :]
        ties = np.array(e.functions["ties_matrix"](place, p, s)).reshape(len(e.tied), e.n)[:, :n]
        _, sizes, rows = np.linalg.svd(np.vstack([ties @ motions.T, np.zeros((found.freedom,) * 2)]))
        moves = np.abs(rows[sizes <= _FREE] @ motions).max(axis=0, initial=0.0)
        return [c.name for c, part in zip(e.coordinates[:n], moves, strict=True) if part > _FREE]

    def forgotten(self) -> str:
        """Return a message that names the `undetermined` coordinates; empty if there are none.

        Those of bodies in space are left out: their position and attitude are where they start.
        """
        own = {f"{body}_{each}" for body in self._flying for each in ("x", "y", "z", "e0", "e1", "e2", "e3")}
        if not (free := [name for name in self.undetermined() if name not in own]):
            return ""
        named = free if len(free) <= _NAMED + 1 else [*free[:_NAMED], f"{len(free) - _NAMED} more"]
        return (
            f"no start value determines {', '.join(named)}: their guesses are used; to set one, give it "
            "independent=True, or tie() it to a start()"
        )

    def initialize_with(self, inputs: Mapping[str, float]) -> None:
        """Set these inputs and initialise."""
        for name, value in inputs.items():
            self.set(name, value)
        self.initialize()

    def step(self, communication_step: float, time: float | None = None) -> None:
        """Cover one communication step [s] with internal steps no longer than solver.step_size.

        `time` is the communication point where the step begins, if the caller keeps time; it must be the instance's.
        If the step cannot be made, raises InputError or StepError and keeps the state before it.
        """
        unit = self._unit
        if not isinstance(communication_step, (int, float, np.number)):
            h = communication_step
            raise InputError(
                f"{self.name}, t = {self.time:.6g} s: a communication step of {h} s; it must be above zero"
            )
        self._judged(unit.step(unit.time if time is None else time, communication_step))
        self._warn()

    def _warn(self) -> None:
        """Log the unread warning of the runtime, if there is one."""
        if warning := self._unit.warning():
            _LOGGER.warning("%s", warning)

    def _judged(self, outcome: int) -> None:
        if outcome != DONE:
            raise self._failure(outcome, moving=True)

    def _failure(self, outcome: int, moving: bool) -> AlfmuError:
        """Return the error for an outcome of the library; `moving` says whether the run had begun."""
        kinds = {REFUSED: InputError, OPEN: OpenError, UNHELD: AssemblyError, ENDED: StepError}
        return kinds.get(outcome, StepError if moving else AssemblyError)(self._unit.text)

    def _read(self) -> int:
        if not self.initialized:
            raise InputError(f"{self.name}: outputs are known after initialising")
        outcome = self._unit.read()
        self._judged(outcome)
        return outcome

    def read(self) -> NDArray[np.float64]:
        """Return all outputs, in the order of `outputs`, at this time and for the present inputs."""
        self._read()
        return np.array(self._unit.outputs)

    def read_inputs(self) -> NDArray[np.float64]:
        """Return the present inputs, in the order of `input_variables`."""
        return np.array([self._unit.get(self._references[v.name]) for v in self.input_variables])

    def run(
        self,
        times: NDArray[np.float64],
        inputs: Sequence[str],
        table: NDArray[np.float64],
        wanted: Sequence[str],
        progress: Callable[[int], bool] | None = None,
    ) -> tuple[NDArray[np.float64], BaseException | None]:
        """Make a whole run in one call, over communication points (k,) [s] with a table (k, inputs) of inputs.

        Returns the values (rows, wanted) at the communication points that were reached, and the error if these are
        not all. `progress` is called after each communication step; the run ends when it returns False or raises.
        """
        times, table = np.ascontiguousarray(times, float), np.ascontiguousarray(table, float)
        values = np.empty((len(times), len(wanted)))
        places = [[self._references[name] for name in names] for names in (inputs, wanted)]
        self.time = float(times[0])
        self.initialize_with(dict(zip(inputs, table[0], strict=True)))
        begin, rows, into = (x.ctypes.data for x in (times, table, values))
        run = Run(begin, len(times), places[0], rows, places[1], into, progress)
        made, outcome = self._unit.run(run)
        self._warn()
        error = run.raised[0] if run.raised else None
        if outcome not in (DONE, INTERRUPTED):
            error = self._failure(outcome, self.initialized)
        return values[:made], error

    # Degrees of freedom ------------------------------------------------------------------------------------------

    def mobility(self) -> Mobility:
        """Return degrees of freedom and redundant constraints, in general and at the present position."""
        return self._mobility()[0]

    def _mobility(self, rows: str = "in force") -> tuple[Mobility, NDArray[np.float64]]:
        """Return the mobility of rows, a word of `probe.COUNTED_ROWS`, and a nearby regular position (n,)."""
        outcome, found, place = mobility(self._unit, self.equations.n, rows)
        self._judged(outcome)
        return found, place

    def shared(self) -> list[str]:
        """Return outputs that are not unique, because redundant constraints share a load; `read` gives the least."""
        found, place = self._mobility()
        numbers = {"q": self.q, "u": self.driven, "p": self.memory["p"], "t": self.state[-1:]}
        return shared(self.equations, numbers, self.penalty > 0, place, self.equations.dependent - found.freedom)

    @property
    def penalty(self) -> NDArray[np.float64]:
        """alpha (l,) [kg or kg.m2 by row], settable while running; a constraint with zero is switched off.

        A constraint that is switched on again must be closed; its velocity becomes consistent at once (10), as in a
        plastic impact. Raises InputError otherwise, and keeps the old values.
        """
        found = np.empty(self.equations.l)
        self._scene.library.alfmu_penalties(self._unit.address, found.ctypes.data)
        return found

    @penalty.setter
    def penalty(self, alpha: ArrayLike) -> None:
        e, full = self.equations, np.array(alpha, float)
        replace(self._given, penalty=full.tolist()).checked(e.name, e.l)
        self._penalize(np.broadcast_to(full, (e.l,)))

    def _penalize(self, alpha: NDArray[np.float64]) -> None:
        alpha = np.ascontiguousarray(alpha, float)
        self._judged(self._scene.library.alfmu_penalize(self._unit.address, alpha.ctypes.data))

    # Counters and state ------------------------------------------------------------------------------------------

    @property
    def counters(self) -> Counters:
        """Work done and largest errors since initialisation."""
        counted, tally = self._counted(), dict(zip(TALLY, self.memory["tally"].astype(int).tolist(), strict=True))
        kernel, c = self.equations.kernel, Counters()
        covered, refused, beside = (tally[name] for name in ("covered", "refused", "beside"))
        errors = ("position_error", "velocity_error", "acceleration_error", "energy_error", "run_error", "drift")
        for name in errors:
            setattr(c, name, abs(float(counted[name])))
        patient = int(counted["patient_steps"])
        for tier, made in (*((tier, tally[tier]) for tier in TIERS), ("careful", patient)):
            if made:
                evaluations = 4 * made + (tier == TIERS[-1]) * len(MEAN) * tally["limits"]
                c.steps += made
                c.evaluations += evaluations
                c.multiplier_iterations += evaluations * kernel[tier].plan.iterations
                c.projection_iterations += 2 * made * kernel[tier].plan.corrections
        passes = int(self.memory["passes"].sum())

        def tried(
            name: str, tries: int, *, judged: int = 0, careful: int = 0, branch: str = "", limits: int = 0
        ) -> None:
            """Count attempts of a program, with the evaluations on both sides of positions where it takes limits."""
            if not tries:
                return
            program = kernel[name]
            # Careful explicit attempts, and those on the branch, evaluate once more to measure round-off.
            judging = careful * (program.nodes == 0) + judged
            evaluations = tries * program.evaluations + judging + passes * program.nodes
            evaluations += limits * 2 * kernel[branch].plan.side if limits else 0
            c.evaluations += evaluations
            c.multiplier_iterations += evaluations * program.plan.iterations
            c.projection_iterations += 2 * tries * program.plan.corrections

        tried("short", tally["short_tries"])
        tried("short_beside", tally["short_beside"], branch="short_beside", limits=tally["short_limits"])
        tried("stiff", tally["stiff_tries"])
        tried("regular", tally["regular_tries"], judged=tally["regular_tries"])
        how = {"judged": beside, "careful": tally["careful_tries"], "limits": tally["beside_limits"]}
        tried("method", tally["tries"] + beside, **how, branch="beside")
        c.steps += covered
        c.refused += refused
        c.patient = patient
        reads, quick, shared = (int(counted[name]) for name in ("reads", "quick_reads", "shared"))
        c.evaluations += reads - shared
        c.multiplier_iterations += (reads - quick) * kernel["instant"].plan.iterations
        c.multiplier_iterations += (quick - shared) * kernel["quick"].plan.iterations
        c.unconverged = int(counted["unconverged"])
        return c

    def _counted(self) -> dict[str, float]:
        raw = np.empty(len(_COUNTED) + len(TALLY) + 1)
        self._scene.library.alfmu_counts(self._unit.address, raw.ctypes.data)
        return {**dict(zip(_COUNTED, raw.tolist(), strict=False)), "shared": raw[-1]}

    def __reduce__(self) -> Never:
        """Refuse to be pickled or copied, as its memory belongs to this process."""
        raise InputError(
            f"{self.name}: an instance can be neither pickled nor copied; make one in each process by "
            "alfmu.Instance(), and carry its state there by save() and restore()"
        )

    def save(self) -> bytes:
        """Return the complete state, from which `restore` continues with the same bits."""
        return self._unit.save()

    def restore(self, state: bytes) -> None:
        """Continue from a state that `save` returned for this mechanism; raise InputError for any other bytes."""
        if self._unit.restore(state) != DONE:
            raise InputError(self._unit.text)
