"""Linearisations: A, B, C, D with names, eigenvalues and mode shapes, their files and plots."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from ..equations.specialisation import plain
from ..model.calls import asked
from ..model.errors import InputError, needs
from ..model.files import atomic, path_for, write
from ..model.units import rate_of
from ..model.words import counted, shown, some_like
from ..simulation.result import Signal
from .films import film
from .laws import moved_by_law
from .situation import Situation, Subject, Vector
from .small import Small, ordered, small_motions
from .states import states

if TYPE_CHECKING:
    import control
    import scipy.signal
    from matplotlib.figure import Figure

    from .equilibria import Equilibrium

Matrix = NDArray[np.float64]

AMPLITUDE = 0.25
"""Largest change of a coordinate in the film of a mode [rad, sizes]."""


@dataclass(frozen=True)
class Mode:
    """A mode dq = shape exp(eigenvalue t); of a complex pair, the eigenvalue with positive imaginary part."""

    eigenvalue: complex
    """[1/s]"""
    shape: Mapping[str, complex]
    """Changes of coordinates and states by name; the largest change of a coordinate is 1 [m or rad]."""

    @property
    def frequency(self) -> float:
        """Frequency of the vibration [Hz]; 0 if there is none."""
        return abs(self.eigenvalue.imag) / (2 * math.pi)

    @property
    def damping(self) -> float:
        """Damping ratio [1]: 0 undamped, 1 and more without vibration, negative if it grows."""
        size = abs(self.eigenvalue)
        return -self.eigenvalue.real / size + 0.0 if size else 0.0

    @property
    def time_constant(self) -> float:
        """Time [s] in which it decays by the factor e; negative if it grows, infinite if it is constant."""
        return -1 / self.eigenvalue.real if self.eigenvalue.real else math.inf

    def __repr__(self) -> str:
        return f"Mode({self.eigenvalue:.6g}, {self.frequency:.4g} Hz, damping {self.damping:.3g})"


@dataclass(frozen=True, eq=False)
class Linearization:
    """Small motions about a state: x' = A x + B u + x'0, y = y0 + C x + D u, with x, u, y changes from the state.

    `states` are independent coordinates NAME, their rates der(NAME), and states of the mechanism if it has any;
    `inputs` and `outputs` have their FMI names. An input that prescribes motion acts by its value, its rate and its
    acceleration; if the mechanism does not have these as inputs, they are named der(NAME) and der(NAME,2). Laws of time
    keep their values at the state.
    """

    mechanism: str
    time: float
    """Time of the state [s]."""
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    """Units of states, inputs and outputs by name."""
    values: Mapping[str, float]
    """Values of states, inputs and outputs at the state, by name."""
    drift: Vector
    """x' at the state (2f,): zero in equilibrium."""
    frictions: Mapping[str, str]
    """States of joints with dry friction, by name: "sticks" (fixed), "slides" (with its friction law), "held by
    others", "left out" (in an equilibrium, which is found without dry friction)."""
    notes: tuple[str, ...]
    situation: Situation = field(repr=False)
    small: Small = field(repr=False)

    def __repr__(self) -> str:
        sizes = [counted(len(getattr(self, f"{what}s")), what) for what in ("state", "input", "output")]
        return f"Linearization({self.mechanism!r}, t = {self.time:g} s, {', '.join(sizes)})"

    @property
    def at_rest(self) -> bool:
        """Whether the state is an equilibrium."""
        still = np.abs(self.drift).max(initial=0.0) <= 1e-9 * max(1.0, np.abs(self.A).max(initial=0.0))
        return bool(still) and not moved_by_law(self.situation, self.situation.state)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A [1/s], the slowest first."""
        return self.small.eigenvalues

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Modes, the slowest first, one for each pair of eigenvalues; along a motion those of the frozen state."""
        found_values, vectors = np.linalg.eig(self.A) if len(self.A) else (np.zeros(0), np.zeros((0, 0)))
        values, order = ordered(found_values.astype(complex))
        f = len(self.small.independent)
        names, found = [c.name for c in self.situation.coordinates], []
        for value, k in zip(values, order, strict=True):
            if value.imag < 0:
                continue
            shape = (self.small.S[: len(names)] @ vectors[:f, k]).astype(complex)
            size = (shape[np.argmax(np.abs(shape))] if len(shape) else 0.0) or 1.0
            others = dict(zip(self.states[2 * f :], (vectors[2 * f :, k] / size).tolist(), strict=True))
            found.append(Mode(complex(value), {**dict(zip(names, (shape / size).tolist(), strict=True)), **others}))
        return tuple(found)

    # Conversion ---------------------------------------------------------------------------------------------------

    def to_scipy(self) -> scipy.signal.StateSpace:
        """Return a `scipy.signal.StateSpace`; raise InputError if there is no input or no output, as SciPy
        needs both."""
        from scipy.signal import StateSpace

        if not (self.inputs and self.outputs):
            raise InputError(
                f"{self.mechanism}: a state space of SciPy needs inputs and outputs, and there are "
                f"{counted(len(self.inputs), 'input')} and {counted(len(self.outputs), 'output')}"
            )
        return StateSpace(self.A, self.B, self.C, self.D)

    def to_control(self) -> control.StateSpace:
        """Return a `control.StateSpace` of python-control, with `_` for dots in names. Needs `alfmu[control]`."""
        with needs("to_control() needs python-control", "control"):
            import control
        how = {x: [name.replace(".", "_") for name in getattr(self, x)] for x in ("states", "inputs", "outputs")}
        return control.ss(self.A, self.B, self.C, self.D, name=self.mechanism, remove_useless_states=False, **how)

    def as_data(self) -> dict[str, Any]:
        """Return all of it as data for JSON."""
        matrices = {name: getattr(self, name).tolist() for name in ("A", "B", "C", "D")}
        modes = [
            {
                "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
                "frequency": mode.frequency,
                "damping": mode.damping,
                "shape": {name: [x.real, x.imag] for name, x in mode.shape.items()},
            }
            for mode in self.modes
        ]
        names = {name: list(getattr(self, name)) for name in ("states", "inputs", "outputs", "notes")}
        known = {"mechanism": self.mechanism, "time": self.time, "at_rest": self.at_rest}
        more = {"units": dict(self.units), "values": dict(self.values), "drift": self.drift.tolist()}
        more |= {"frictions": dict(self.frictions)} if self.frictions else {}
        return {**known, **names, **more, **matrices, "modes": modes}

    @asked
    def save(self, path: str | Path) -> None:
        """Write all of it as `.json`, or matrices and names as `.mat` for MATLAB and GNU Octave."""
        save([self], path)

    # Display ------------------------------------------------------------------------------------------------------

    def lines(self) -> list[str]:
        """Return a table as lines of text."""
        state = ", ".join(
            f"{name} = {self.values[name] + 0.0:.6g} {self.units[name]}"
            + f" ({math.degrees(self.values[name]):.4g} deg)" * (self.units[name] == "rad" and self.values[name] != 0)
            for name in self.states
        )
        how = "at rest" if self.at_rest else "in motion, with coefficients frozen at this state"
        lines = [f"{self.mechanism}: linearised at t = {self.time:g} s, {how}", f"state: {state or 'none'}"]
        if self.inputs:
            lines += ["inputs: " + ", ".join(f"{x} = {self.values[x]:g} {self.units[x]}" for x in self.inputs)]
        if self.frictions:
            lines += ["dry friction: " + ", ".join(f"{name} {what}" for name, what in self.frictions.items())]
        lines += ["mode  eigenvalue [1/s]            frequency [Hz]  damping [1]  most in"] * bool(self.states)
        for k, mode in enumerate(self.modes):
            value = mode.eigenvalue
            text = f"{value.real + 0.0:.6g}" + f" +- {value.imag:.6g}i" * (value.imag > 0)
            largest = sorted(mode.shape, key=lambda name: -abs(mode.shape[name]))[:3]
            shown = ", ".join(f"{x} {_plainly(mode.shape[x])}" for x in largest if abs(mode.shape[x]) > 1e-6)
            lines += [f"{k + 1:4}  {text:<27} {mode.frequency:14.6g}  {mode.damping:11.4g}  {shown}"]
        sizes = ", ".join(f"{x} {'x'.join(map(str, getattr(self, x).shape))}" for x in "ABCD")
        return [*lines, f"matrices: {sizes}", *self.notes]

    @asked
    def plot(self, path: str | Path | None = None) -> Figure:
        """Return a matplotlib figure of the eigenvalues, and write it if a path is given. Needs `alfmu[plot]`."""
        return figure([self], path)

    @asked
    def film(
        self,
        path: str | Path,
        mode: int = 1,
        *,
        amplitude: float = AMPLITUDE,
        fps: float = 25.0,
    ) -> None:
        """Write a film of a mode, `.gif` or `.html`; `mode` counts from 1, the slowest. Loops stay closed.

        `amplitude` is the largest change of a coordinate [rad, lengths over the size of the mechanism]. A vibration is
        shown without its decay, in two seconds; a mode without vibration moves to its amplitude and back. Raises
        InputError if there is no such mode, or only the equations of the mechanism are known.
        """
        film(self, Path(path), mode, amplitude, fps)


def _plainly(x: complex) -> str:
    """Format an entry of a shape: a number if it is real, else magnitude and phase."""
    if abs(x.imag) <= 1e-6 * abs(x):
        return f"{x.real:.3g}"
    return f"{abs(x):.3g} at {math.degrees(math.atan2(x.imag, x.real)):.0f} deg"


@overload
def linearize(
    mechanism: Subject,
    at: str | float | Equilibrium = "start",
    *,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    outputs: Sequence[str] | None = None,
) -> Linearization: ...
@overload
def linearize(
    mechanism: Subject,
    at: Sequence[float],
    *,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    outputs: Sequence[str] | None = None,
) -> list[Linearization]: ...
def linearize(
    mechanism: Subject,
    at: str | float | Sequence[float] | Equilibrium = "start",
    *,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    outputs: Sequence[str] | None = None,
) -> Linearization | list[Linearization]:
    """Linearise a mechanism: A, B, C, D in independent coordinates, with inputs and outputs by their names in FMI.

    `mechanism` is a mechanism as for `simulate`, but no FMU; or an `Instance`, in its present state. `at` selects the
    state: "start", "equilibrium" (`Equilibria.nearest`, the one that a run would start in), an `Equilibrium`, a time
    [s] of the motion from the start, or several times, for which a list is returned. `parameters` sets parameters,
    start values and inputs by name, `inputs` gives inputs over time as `simulate` takes them. `outputs` are names or
    patterns of the outputs in C and D, None for all but monitors.

    A joint with dry friction is fixed while it sticks, and has its friction law while it slides; in an equilibrium
    friction is left out, as in `equilibrium`.

    Raises AlfmuError if a name or a value is invalid, and InputError at a singular position, where motions are not
    functions of independent coordinates.
    """
    at = at.tolist() if isinstance(at, np.ndarray) else at
    found: list[Linearization] = []
    for where in states(mechanism, at, parameters or {}, inputs or {}):
        found.append(linearized(where, outputs, found[-1].small.independent if found else ()))
    return found if isinstance(at, Sequence) and not isinstance(at, str) else found[0]


def linearized(where: Situation, outputs: Sequence[str] | None = None, wanted: Sequence[int] = ()) -> Linearization:
    """Return the linearisation of a situation about its state, in the wanted coordinates if these describe
    its motions."""
    e, s = where.equations, where.state
    mobility, _ = where.mobility(s.q)
    if mobility.freedom_here > mobility.freedom:
        raise InputError(
            f"{where.name}, t = {s.t:.6g} s: the position is singular, {mobility.freedom_here} motions begin there "
            f"instead of {mobility.freedom}, so that no independent coordinates describe them and small motions are "
            "not linear; start beside it, or name a time at which the motion is past it"
        )
    small = small_motions(where, mobility.freedom, wanted)
    names = [v.name for v in e.outputs]
    patterns = outputs if outputs is not None else where.source.outputs
    kept = _kept(where.name, names, patterns)
    own, more = [e.coordinates[i] for i in small.independent], e.states
    states = [*(c.name for c in own), *(f"der({c.name})" for c in own), *(x.name for x in more)]
    of_states = [*(c.unit for c in own), *(rate_of(c.unit) for c in own), *(x.unit for x in more)]
    units = dict(zip(states, of_states, strict=True))
    units |= {v.name: v.unit for v in small.driving} | {v.name: v.unit for v in (e.outputs[i] for i in kept)}
    now = np.concatenate([s.q[small.independent], s.v[small.independent], s.u[len(e.inputs) :]])
    values = {names[i]: float(small.readings[i]) for i in kept}
    values |= dict(zip(states, now.tolist(), strict=True))
    values |= {v.name: v.value for v in small.driving}
    drift = np.concatenate([s.v[small.independent], small.a[small.independent], small.rates])
    return Linearization(
        where.name,
        s.t,
        small.A,
        small.B,
        small.by_state[kept],
        small.by_input[kept],
        tuple(states),
        tuple(v.name for v in small.driving),
        tuple(names[i] for i in kept),
        units,
        values,
        drift,
        where.frictions,
        tuple(_notes(where, mobility.redundant)),
        where,
        small,
    )


def _notes(where: Situation, redundant: int) -> list[str]:
    notes = []
    if redundant:
        notes.append(
            f"{counted(redundant, 'redundant constraint')}: where they share a load, reactions and their rows of C "
            "and D are those by which joints carry the least"
        )
    if where.equations.switches:
        notes.append("locks and released joints stay as they are")
    if where.equations.timed:
        notes.append("prescribed motions are frozen at this instant: time stands still")
    if "sticks" in where.frictions.values():
        notes.append("a joint that sticks is held, as long as its load stays within its limit")
    return notes


def _kept(name: str, names: Sequence[str], patterns: Sequence[str] | None) -> list[int]:
    """Return indices of the outputs that match; raise InputError if a pattern matches none."""
    if patterns is None:
        return list(range(len(names)))
    if not isinstance(patterns, str) and not (
        isinstance(patterns, Sequence) and all(isinstance(x, str) for x in patterns)
    ):
        raise InputError(f"{name}: the outputs are {shown(patterns)}; give names or patterns in a list")
    patterns = [each for each in plain(patterns) if not each.startswith("monitor.")]
    for pattern in patterns:
        if not any(each == pattern or fnmatchcase(each, pattern) for each in names):
            raise InputError(f"{name} has no output {pattern!r} to linearise; {some_like(pattern, names)}")
    return [i for i, each in enumerate(names) if any(each == x or fnmatchcase(each, x) for x in patterns)]


# Files -------------------------------------------------------------------------------------------------------------


def save(found: Sequence[Linearization], path: str | Path) -> None:
    """Write linearisations as `.json` (one object, or a list of several) or as `.mat` (several along a third
    dimension).

    Raises InputError for another suffix, else WriteError.
    """
    path = path_for("linearisations", path)
    if path.suffix.lower() == ".json":
        data = [each.as_data() for each in found]
        write(path, (json.dumps(data[0] if len(data) == 1 else data, indent=1) + "\n").encode())
        return
    from scipy.io import savemat

    first = found[0]
    if any(each.states != first.states for each in found):
        raise InputError(
            f"{first.mechanism}: its independent coordinates change along the motion; save them as .json, as "
            f"{path.name} has the same ones at each time"
        )
    alone = 0 if len(found) == 1 else slice(None)

    def stacked(each: Sequence[Any]) -> NDArray[np.float64]:
        return np.stack([np.asarray(x, float) for x in each], axis=-1)[..., alone]

    matrices = {name: stacked([getattr(x, name) for x in found]) for name in "ABCD"}
    names = {each: np.array(getattr(first, each), dtype=object) for each in ("states", "inputs", "outputs")}
    values = {
        f"{short}0": stacked([[x.values[name] for name in getattr(first, each)] for x in found])
        for short, each in (("x", "states"), ("u", "inputs"), ("y", "outputs"))
    }
    drift, times = stacked([x.drift for x in found]), np.array([x.time for x in found])
    with atomic(path) as file:
        savemat(file, {**matrices, **names, **values, "dx0": drift, "time": times, "mechanism": first.mechanism})


@asked
def figure(found: Sequence[Linearization], path: str | Path | None = None) -> Figure:
    """Return a figure of the eigenvalues of linearisations, and write it if a path is given."""
    from ..view import eigenvalues, plot

    if not found:
        raise InputError("figure() is given no linearisation; give one or more")
    path = None if path is None else path_for("a plot", path)
    drawn = eigenvalues.figure([x.eigenvalues for x in found], [x.time for x in found], found[0].mechanism)
    if path is not None:
        plot.save(drawn, path, 150)
    return drawn
