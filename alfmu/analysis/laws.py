"""Laws of time and signals in analyses: inputs that prescribe motion, and checks that prescribed motions are
at rest."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..equations.changes import signal_numbers
from ..model.errors import InputError
from ..model.motion import COEFFICIENTS
from ..model.units import rate_of
from ..model.words import counted
from .situation import Situation, State

RESTING = 1e-9
"""First and second rate [m/s, rad/s, m/s2, rad/s2] below which a prescribed motion is at rest; round-off of laws near 1
is 1e-15, and a nanometre per second is negligible."""


@dataclass(frozen=True)
class Driving:
    """An input of a linearisation: an input of the mechanism, or a derivative of a signal that is no input."""

    name: str
    unit: str
    value: float
    signal: int = -1
    """Index of its signal; -1 if it is not a signal."""
    level: int = 0
    """Order of the derivative of the signal: 0 value, 1 rate, 2 acceleration."""


def driving(where: Situation) -> list[Driving]:
    """Return inputs of the mechanism, followed by rates and accelerations of signals that are not inputs.

    Signals have their values in the present motion, not values set since.
    """
    e = where.equations
    found = [Driving(v.name, v.unit, float(x)) for v, x in zip(e.inputs, where.state.u, strict=False)]
    for k, (followed, begin) in enumerate(zip(e.followed, signal_numbers(e), strict=True)):
        own = e.inputs[followed.input]
        units = own.unit, rate_of(own.unit), rate_of(rate_of(own.unit))
        for level, unit in enumerate(units):
            value = float(where.p[begin + 1 + level] * (1, 1, 2)[level])
            if level <= followed.derivatives:
                found[followed.input + level] = Driving(e.inputs[followed.input + level].name, unit, value, k, level)
            else:
                found.append(Driving(f"der({own.name}{',2' * (level == 2)})", unit, value, k, level))
    return found


def held_still(where: Situation) -> tuple[Situation, list[str]]:
    """Return the situation with signals held constant, and the names of those that moved."""
    e, p, moved = where.equations, where.p.copy(), []
    for followed, begin in zip(e.followed, signal_numbers(e), strict=True):
        rates = p[begin + 2 : begin + 1 + COEFFICIENTS]
        if np.abs(rates).max() > RESTING:
            moved.append(e.inputs[followed.input].name)
        rates[:] = 0.0
    return replace(where, p=p), moved


def moved_by_law(where: Situation, state: State) -> str:
    """Return the name of a law of time or signal that prescribes motion in this state, for a message; empty if none
    does."""
    e = where.equations
    if not e.timed:
        return ""
    rates, seconds, kinetic, changing = (each.ravel() for each in where.change("moving", state))
    moving = where.held & ((np.abs(rates) > RESTING) | (np.abs(seconds) > RESTING))
    if moving.any():
        row = int(np.argmax(moving))
        name = e.rows[row].text
        return f"the law of {name} has a rate of {abs(rates[row]):.3g} and an acceleration of {abs(seconds[row]):.3g}"
    return f"{_carried(where, state)} by a law of time" if max(kinetic[0], changing[0]) > RESTING**2 else ""


def check_at_rest(where: Situation, state: State) -> None:
    """Raise InputError if a law of time prescribes motion in this state: there is no equilibrium then."""
    if moving := moved_by_law(where, state):
        raise InputError(
            f"{where.name}, t = {state.t:.6g} s: {moving}, so that nothing is at rest; name a time at which all laws "
            "stand still (their rates and accelerations are zero), or let an input prescribe the motion, which is held"
        )


def _carried(where: Situation, state: State) -> str:
    """Return the moving part if no coordinate moves, for a message."""
    e = where.equations
    y = where.value("readings", state, a=np.zeros(e.n), lam=np.zeros(e.l))
    kinds = ("vx", "vy", "vz", "ax", "ay", "az", "angular_velocity", "angular_acceleration")
    for variable, x in zip(e.outputs, y, strict=True):
        body, _, what = variable.name.partition(".")
        if what in kinds and abs(x) > RESTING:
            return f"{body} is carried ({variable.name} = {x:.3g} {variable.unit})"
    return "a body is carried"


def prescribed(where: Situation) -> Sequence[str]:
    """Return notes on laws of time and signals, if there are any."""
    e = where.equations
    if not e.timed:
        return ()
    names = [row.name for row, on in zip(e.rows, where.held, strict=True) if on and row.direction == "motion"]
    if not names:
        return ("places that depend on time or inputs are evaluated at this time and with these inputs",)
    each = "it counts as a constraint" if len(names) == 1 else "each counts as a constraint"
    return (f"{counted(len(names), 'motion')} by a law ({', '.join(names)}): {each}",)
