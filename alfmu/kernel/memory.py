"""The memory of an instance: one array of numbers, whose fields have the same names in Python and in C (`layout.h`)."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..equations import Configuration
from ..method.inputs import memory_size
from .form import Traced

TIERS = ("quick", "careful", "branch")
"""Tiers of RK4 steps in the order of attempts; `branch` comes first near a singular position."""

Number = TypeVar("Number")


class SceneSettings(NamedTuple, Generic[Number]):
    """The first numbers of `k`.

    They are: largest penalty; tolerance of constraints and iterations; degrees of freedom; logarithm of the product of
    the pivots contributed by masses; logarithm of the product of all pivots below which a position may be singular;
    margin that counts as zero; least distance of positions beside a singular position; whether to continue on the
    branch there (`method.singular`); tolerances of a step with error control, the second also for lengths; one over the
    length of the mechanism, and over the size of its smallest loop; and tolerances over that of the integrator: of a
    short step, of an explicit step on the branch that replaces an implicit one, and of an implicit step that replaces
    an explicit one; 1 if limits are taken along the motion, 0 if along the direction stored after the scales; size to
    which redundant constraints agree.
    """

    alpha: Number
    tolerance: Number
    freedom: Number
    masses: Number
    regular: Number
    nothing: Number
    least_distance: Number
    continues: Number
    relative: Number
    absolute: Number
    absolute_length: Number
    inverse_length: Number
    inverse_loop: Number
    short: Number
    beside: Number
    stiff: Number
    along: Number
    agreed: Number


SETTINGS = SceneSettings._fields
"""Their names."""

CONTROL = ("step_size", "tier", "method")
"""Largest internal step [s]; first tier (0 quick, 1 careful); source of steps (0 the tiers, 1 the scene's integrator
with error control, 2 the same with fixed steps)."""

TALLY = (
    *(*TIERS, "limits", "short_tries", "short_beside", "short_limits"),
    *("stiff_tries", "regular_tries", "tries", "careful_tries", "covered", "refused", "beside", "beside_limits"),
)
"""Counters: internal steps by tier, limits taken; attempts of short steps, those on the branch, limits there; attempts
of implicit steps that replace explicit ones, and of explicit ones that replace implicit ones at regular positions; of
the scene's integrator: attempts, those with careful iterations, steps, rejected ones (also short ones), attempts on the
branch, limits there."""

PACE = (
    *("dt", "before", "refused", "fixed", "end", "last", "accepted", "floor", "careful"),
    *("short", "other_dt", "other_before", "other_refused"),
    *("stiff", "since", "patience"),
)
"""Numbers of step control (`method.stepping.judged`), then: length of all steps if fixed, else 0; end of the
communication step; length of the last accepted step in it, 0 before the first; whether the last one was accepted;
round-off in its error over the tolerance; number of further steps with careful iterations; whether the first three
belong to short steps, and the three numbers of the other kind of steps (0 if unknown); whether implicit steps replace
explicit ones, number of steps since the others were tried, and number before the next trial."""

SEEN = ("acceleration_error", "near", "trouble")
"""Last entries of `seen`: largest |Phi-ddot|, whether a limit must be read instead, trouble."""

NAMED: dict[str, tuple[str, ...]] = {
    "SETTINGS": SETTINGS,
    "CONTROL": CONTROL,
    "TALLY": TALLY,
    "PACE": PACE,
    "SEEN": SEEN,
}
"""Vectors whose entries have names in C too; SEEN counts from the end of the outputs."""

GROSS = 1e-6
"""Residual of a constraint, in units of its row [m, rad; per s], above which a projected step is rejected."""

TURN = np.pi
"""Largest rotation of a coordinate in an internal step [rad]; beyond it no method resolves the motion between."""


class Layout:
    """Addresses in the one array of doubles of an instance; every name maps to (offset, length).

    ========  ==========================================================================================
    z         state: q, v, unwrapped angles (outputs, counted angles), work, states x, time, and of the last step:
              trouble (number of failed checks), change (of accelerations in the last iteration, squared over
              their size; with error control the error over the tolerance), pivot (smallest of the augmented mass
              over alpha), near (number of stages too near a singular position; on the branch of those with a limit)
    after     the state after the current step
    begin     the state before the current communication step
    u, p, k   inputs; parameters; SETTINGS, the penalty of each constraint over alpha, one over the unit of each
              constraint, alpha over the scale of the pivot of each coordinate, and if constraints may have a
              compliance the least one over that of each; if redundant ones would brake, the matrix that replaces
              all penalties over alpha (`blajer.Method.hold`)
    dt        internal step [s]
    control   CONTROL
    tally     TALLY
    pace      PACE
    past      inputs at past communication points (`alfmu.method.inputs`), if the scene extrapolates them
    passes    iterations of Newton's method of an implicit integrator
    history   history of the integrator within a communication step
    seen      outputs at an instant, SEEN
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
            "k": len(SETTINGS) + 2 * e.l + e.n + len(e.compliances) + e.n * bool(e.l) + e.survey.brakes * e.l**2,
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
    """The memory of one instance: `memory["z"]` is a view into one array, `block`."""

    def __init__(self, layout: Layout, block: NDArray[np.float64] | None = None):
        self.layout: Layout = layout
        self.block: NDArray[np.float64] = np.zeros(layout.size) if block is None else block

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        offset, length = self.layout.fields[name]
        return self.block[offset : offset + length]
