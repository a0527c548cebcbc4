"""Programs and functions of a scene file: the tiers, and programs for C only, joined if they run often."""

from __future__ import annotations

from dataclasses import replace

from ..equations.evaluation import DENSE
from ..equations.interface import default_settings
from ..model.making import getting_ready
from .controlled import whole
from .exchange import ACCELERATIONS, obstacle
from .form import Traced, called
from .joined import joined
from .lanes import laned
from .memory import Layout
from .shorten import alike
from .standalone import READ, standalone
from .trace import SHARING

FUNCTIONS = {
    **{
        name: name
        for name in (
            *("dynamics", "constraints", "energy", "closure", "guesses", "displacements", "pivots", "irregular"),
            *("sliding", "laws", "breaks", "state_rates"),
        )
    },
    **{"stops": "beyond", "place": "weighted_place", "bring": "weighted_return", "settle": "weighted_settle"},
    "margin": "margin_at",
}
"""Functions called by the runtime, by their names in C."""

HOT = ("quick", "instant_quick", "method", "short")
"""Programs with joined calls: they run in every step, as `instant` does if there is no `instant_quick`."""


def complete(equations: Traced) -> Traced:
    """Return traced equations with only the programs and functions of a scene file, in its order."""
    own = equations.kept.scene.latest(complete, lambda: _complete(whole(equations)))
    given = {name: getattr(own, name) for name in ("functions", "signatures", "kernel", "breaks")}
    return replace(equations, **given)


def _complete(equations: Traced) -> Traced:
    e = standalone(equations)
    handed = (*READ, *[ACCELERATIONS] * (not obstacle(e)))
    hot = HOT if "instant_quick" in e.kernel else (*HOT, "instant")
    if e.n > DENSE:
        return ordered(joined(e, hot, handed))
    # RK4 takes limits near singular positions in every step; other integrators have other programs there.
    steps = [] if "method" in e.kernel else ["branch"]
    fields, kernel = Layout(e).fields, e.kernel
    kernel = kernel | {name: laned(kernel[name], fields) for name in ("limit", *steps) if name in kernel}
    return ordered(joined(replace(e, kernel=kernel), hot, handed))


def smallest(equations: Traced) -> Traced:
    """Return traced equations with the programs and functions of the smallest scene: its programs call shared
    functions, and none has loops that stop on convergence.

    A step that needs more iterations fails. Programs for singular positions are included if `solver.branch` continues
    there.
    """
    with getting_ready():
        own = standalone(whole(equations))
        without = {"move", "close", "instant_patient", "limit_patient", *["impact"] * (not own.switches)}
        if default_settings(equations).branch != "continue":
            without |= {"branch", "limit"}
        kernel = {name: program for name, program in own.kernel.items() if name not in without}
        # Outputs of a quick step come from few calls; programs near singular positions share the functions of a pass.
        shared = {name for each, program in kernel.items() if each != "instant_quick" for name in called(program)}
        only = {name for program in kernel.values() for name in called(program)} - shared | {*SHARING}
        return ordered(joined(alike(replace(own, kernel=kernel)), ["instant_quick"], READ, only))


def ordered(e: Traced) -> Traced:
    """Return equations with only the functions of the scene, in the order of its file."""
    used = dict.fromkeys(name for each in e.kernel.values() for name in called(each))
    names = dict.fromkeys([*(name for name in FUNCTIONS.values() if name in e.signatures), *used])
    # Functions of similar lengths are alike, and archives refer to 32 kB before at most.
    functions = {name: e.functions[name] for name in sorted(names, key=lambda name: e.functions[name].n_instructions())}
    # The number of outputs determines the layout of the memory, whether or not a function computes them.
    signatures = {name: e.signatures[name] for name in (*names, "seen") if name in e.signatures}
    return replace(e, functions=functions, signatures=signatures)
