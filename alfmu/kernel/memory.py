"""The memory of an instance: one array of numbers, whose fields have the same names in Python and in C (`layout.h`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..equations import Configuration
from ..method.inputs import memory_size
from .form import Traced

__all__ = ["CONTROL", "GROSS", "NAMED", "PACE", "SEEN", "SETTINGS", "TALLY", "TIERS", "TURN", "Layout", "Memory"]

TIERS = ("quick", "careful", "branch")
"""Steps in the order in which they are tried; `branch` at once where a position is nearly singular."""

SETTINGS = (
    *("alpha", "tolerance", "freedom", "masses", "regular", "nothing", "least_distance", "continues"),
    *("relative", "absolute", "absolute_length", "inverse_length", "short", "beside", "stiff"),
)
"""What `k` begins with. Degrees of freedom, logarithm of the product of the pivots that masses make, product of all
pivots below which a position may be singular, margin that is nothing, least distance of places beside a singular
position, whether to continue on the branch there (`method.singular`); tolerances of a step with error control, the
second one for lengths, too, one over the length of the mechanism, and over tolerances that of a short step, that of an
explicit step on the branch in place of an implicit one, and that of an implicit step in place of an explicit one."""

CONTROL = ("step_size", "tier", "method")
"""Largest internal step [s]; first tier (0 quick, 1 careful); what makes the steps (0 the tiers, 1 the method of the
scene with error control, 2 the same in steps of one length)."""

TALLY = (
    *(*TIERS, "limits", "short_tries", "short_beside", "short_limits"),
    *("stiff_tries", "regular_tries", "tries", "careful_tries", "covered", "refused", "beside", "beside_limits"),
)
"""Internal steps made by each tier, limits taken; tries of short steps, those of them on the branch, limits taken
there; tries of implicit steps in place of explicit ones, and of explicit ones in place of implicit ones where
constraints are regular; by the method of the scene: tries, those of them with careful iterations, steps made, refused
ones (short ones too), tries on the branch, limits taken there."""

PACE = (
    *("dt", "before", "refused", "fixed", "end", "last", "accepted", "floor", "careful"),
    *("short", "other_dt", "other_before", "other_refused"),
    *("stiff", "since", "patience"),
)
"""What step control remembers (`method.stepping.Control.numbers`); the length of all steps where they have one, else 0,
the end of the communication step, the length of the last step in it that was accepted, 0 before the first; whether the
last one was accepted; what round-off left of its error over the tolerance; steps that go on with careful iterations;
whether the first three are of short steps, and those of the method that is not in use (0 where none is known);
whether implicit steps are made in place of explicit ones, how many steps since the others were tried, and how many are
made before they are again."""

SEEN = ("acceleration_error", "near", "trouble")
"""What `seen` ends with: largest |Phi-ddot|, whether a limit has to be read instead, trouble."""

NAMED: dict[str, tuple[str, ...]] = {
    "SETTINGS": SETTINGS,
    "CONTROL": CONTROL,
    "TALLY": TALLY,
    "PACE": PACE,
    "SEEN": SEEN,
}
"""Vectors whose entries have names in C too; SEEN counts from its own beginning, the end of what is read."""

GROSS = 1e-6
"""Residue of a constraint, in units of its row [m, rad; per s], above which a projected step is refused."""

TURN = np.pi
"""Most that a coordinate in radians may turn in an internal step [rad]; beyond it no method sees what lies between."""


class Layout:
    """Where things stand in the one array of doubles of an instance; every name maps to (offset, length).

    ========  ==========================================================================================
    z         state: q, v, unwrapped angles (those that are read, those that count), work, states x, time, and from the
              last step: trouble (number of checks that failed), change (of accelerations in the last iteration,
              squared over their size; of a step with error control its error over the tolerance), pivot (smallest
              of the augmented mass over alpha), near (stages too near a singular position; in a step on the branch
              those in which a limit was taken)
    after     the state after a step under way
    begin     the state before a communication step under way
    u, p, k   inputs; parameters; SETTINGS, the penalty of each constraint over alpha, one over the unit of each
              constraint, alpha over the scale of the pivot of each coordinate, and where constraints may have a
              compliance the least one over that of each; where redundant ones would brake, what stands for all
              penalties over alpha (`oracle.Instance.hold`), a matrix
    dt        internal step [s]
    control   CONTROL
    tally     TALLY
    pace      PACE
    past      inputs at past communication points (`alfmu.method.inputs`), where the scene extrapolates them
    passes    of Newton's method, where the method is implicit
    history   what the method keeps from step to step inside a communication step
    seen      what can be read at an instant, SEEN
    ========  ==========================================================================================
    """

    def __init__(self, equations: Configuration):
        e, programs = equations, equations.kernel if isinstance(equations, Traced) else {}
        self.n: int = e.n
        self.l: int = e.l
        self.angles: int = len(e.wrapped) + len(e.counted)
        self.work: int = 2 * e.n + self.angles
        self.states: int = self.work + 1
        self.time: int = self.states + len(e.states)
        self.trouble: int = self.time + 1
        self.change: int = self.trouble + 1
        self.pivot: int = self.change + 1
        self.near: int = self.pivot + 1
        size = self.near + 1
        kept = max((program.history for program in programs.values()), default=0)
        lengths: dict[str, int] = {
            "z": size,
            "after": size,
            "begin": size,
            "u": len(e.inputs),
            "p": len(e.parameters) + len(e.held),
            "k": len(SETTINGS) + 2 * e.l + e.n + len(e.compliances) + e.survey.brakes * e.l**2,
            "dt": 1,
            "control": len(CONTROL),
            "tally": len(TALLY),
            "pace": len(PACE),
            "past": memory_size(len(e.inputs)) if "reach" in programs else 0,
            "passes": int(bool(kept)),
            "history": kept,
            "seen": e.signatures["seen"]["outputs"][0][0] if programs else 0,
        }
        self.fields: dict[str, tuple[int, int]] = {}
        self.size: int = 0
        for name, length in lengths.items():
            self.fields[name] = self.size, length
            self.size += length


class Memory:
    """The numbers of one instance: `memory["z"]` is a view into one array, `block`."""

    def __init__(self, layout: Layout, block: NDArray[np.float64] | None = None):
        self.layout: Layout = layout
        self.block: NDArray[np.float64] = np.zeros(layout.size) if block is None else block

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        offset, length = self.layout.fields[name]
        return self.block[offset : offset + length]
