"""From a mechanism to a loaded scene: derive, configure, survey, trace, load.

`Mechanism` - derive -> `Equations` - decided, surveyed -> `Configuration` - trace -> `Traced` - loaded -> `Scene`. No
stage changes its input, and each caches its results: runs of one mechanism share them if only numbers differ. One
dependency points back: `survey` starts the runtime before the programs of a scene are traced.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..equations import Configuration, Equations, derivation
from ..equations.evaluation import DENSE, symbols, with_tangents
from ..equations.interface import CHOICES, checked, default_settings, integrator, not_there, setting, variables_of
from ..equations.specialisation import ALL, specialised
from ..equations.types import Decision, Survey, configured
from ..kernel import DEFAULT, KERNELS, controlled, tables
from ..kernel.alternatives import formulations
from ..kernel.complete import complete
from ..kernel.form import Traced
from ..kernel.kinks import kinks_of_rates
from ..kernel.trace import traced, untraced
from ..method.implicit import RULES
from ..method.stepping import explicit_rule
from ..model.content import content
from ..model.errors import InputError
from ..model.kept import latest, once
from ..model.making import getting_ready
from ..model.mechanism import Mechanism
from ..model.settings import METHODS, Settings
from ..model.words import in_words
from .build import compiler
from .compiled import compiled_scene
from .library import Scene
from .probe import SINGULAR, Probe, survey
from .shipped import installed, lane_flags
from .stored import Start, constants, stored_decision, stored_scene, stored_start

UNRUBBED = ("trapezoidal", "generalized_alpha")
"""Methods of the index-3 form, whose multipliers are of position level; dry friction needs those of accelerations."""

STIFF = 20.0
"""Ratio of the fastest small motion to the slowest lasting one, above which a scene is stiff if the fastest does not
last: stability limits explicit steps to some 4 over the former, accuracy limits all steps to 0.3 over the latter, and
an implicit step costs two or three explicit ones."""

LASTS = 30.0
"""A small motion lasts if a run has at most this many of its time constants; with more it has decayed in a tenth of the
run."""

MOST_SCENES = 16
"""Number of cached scenes, shared by equations that differ in numbers only; large scenes are not cached."""

_DECISIONS = 1000
"""Number of cached decisions on the integrator for a mechanism, the latest."""

_TRACED = ("method", "input_order")
"""Settings that are fixed by tracing."""

_KEPT: OrderedDict[tuple[str, str], Equations] = OrderedDict()

_SCENES: OrderedDict[tuple[object, ...], tuple[object, Traced]] = OrderedDict()

# Derive ---------------------------------------------------------------------------------------------------------------


def derive(mechanism: Mechanism) -> Equations:
    """Return all equations of a mechanism, with names, units and every joint reaction; derived again only if the
    declaration has changed.

    Raises DeclarationError if the declaration has no equations: a body without a position, a joint that no coordinate
    can close, an expression with a foreign symbol.
    """
    with getting_ready():
        key = content(mechanism)
        if key is None:
            return derivation.derive(mechanism)
        return latest(_KEPT, (key, constants()), lambda: derivation.derive(mechanism))


# Configure ------------------------------------------------------------------------------------------------------------


def with_defaults(equations: Equations, values: Mapping[str, float | str]) -> Configuration:
    """Return the same equations with other defaults for parameters, start values, inputs and solver variables, cached
    by these values.

    Raises InputError if a name is unknown or a value out of bounds.
    """
    return equations.kept.latest(with_defaults, lambda: _with_defaults(equations, values), _key(values))


def _key(values: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return a key for values by name, of any types."""
    return tuple(sorted((name, type(value).__name__, repr(value)) for name, value in values.items()))


def _with_defaults(declared: Equations, values: Mapping[str, float | str]) -> Configuration:
    equations = configured(declared)
    found = variables_of(equations)
    known = {v.name: v for v in (*found.parameters, *found.inputs)}
    for name, value in values.items():
        if name in known:
            checked(equations.name, known[name], value)
        elif name not in {s.name for s in equations.switches} | set(CHOICES):
            names = [*(v.name for v in found.causal("input")), *known, *CHOICES]
            raise InputError(not_there(equations, name, names))
    own: dict[str, Any] = {setting(name): value for name, value in values.items() if setting(name) != name}
    Settings(**own).checked(equations.name, equations.l)
    before = default_settings(equations)
    own = {name: value for name, value in own.items() if value != getattr(before, name)}
    changing = [name for name in values if setting(name) == name]
    if not own and all(name in known and float(values[name]) == known[name].start for name in changing):
        return equations
    changed: dict[str, Any] = {
        field: [replace(v, start=float(values.get(v.name, v.start))) for v in getattr(equations, field)]
        for field in ("parameters", "starts", "start_rates", "compliances", "inputs")
    }
    changed["states"] = [replace(v, start=float(values.get(f"start.{v.name}", v.start))) for v in equations.states]
    changed["switches"] = [replace(s, start=bool(values.get(s.name, s.start))) for s in equations.switches]
    e = replace(equations, **changed, solver={**equations.solver, **own})
    same = all(getattr(default_settings(e), name) == getattr(before, name) for name in _TRACED)
    if same:
        return e
    return Configuration.of(untraced(e), decision=None, survey=e.survey.elsewhere)


def chosen(
    equations: Equations,
    values: Mapping[str, float | str],
    outputs: Sequence[str] | None,
    freeze: Sequence[str] | None,
) -> Equations:
    """Return the equations with these defaults and outputs only, cached, so that they are traced once."""
    if not values:
        return ready(equations, {}, outputs, freeze, DEFAULT)[0]
    asked = [None if names is None else tuple(names) for names in (outputs, freeze)]
    key = (*asked, *_key(values))
    return equations.kept.latest(chosen, lambda: specialised(with_defaults(equations, values), outputs, freeze), key)


def decided(equations: Equations) -> Configuration:
    """Return the configuration of equations with its integrator decided, and with the functions that this needs."""
    e = configured(equations)
    decision, stiffens = _decide(e)
    e = with_tangents(e) if decision.method in RULES or stiffens else e
    return e if decision == e.decision else replace(e, decision=decision)


def decision_of(equations: Equations) -> Decision:
    """Return the integrator for equations with their defaults."""
    return _decide(equations)[0]


def _decide(equations: Equations) -> tuple[Decision, bool]:
    """Return the decision, and whether a run may change to implicit steps."""
    formulation, known = default_settings(equations).formulation, formulations(equations)
    if formulation not in known:
        limit = f"solver.formulation {formulation} takes up to {DENSE} coordinates"
        if equations.slips:
            limit = f"solver.formulation {formulation} does not support constraints of velocities, such as a blade's"
        raise InputError(f"{equations.name}: {limit}; use {', '.join(known)}")
    chosen, decision = integrator(equations), _known(equations)
    undecided = chosen == "auto"
    if undecided:
        decision = _automatic(equations)
        chosen = decision.method
    elif decision is None or decision.method != chosen:
        decision = Decision(chosen)
    if chosen in RULES and equations.n > DENSE:
        raise InputError(f"{equations.name}: solver.method {chosen} takes up to {DENSE} coordinates; use explicit")
    if chosen in UNRUBBED and equations.frictions:
        limit = f"solver.method {chosen} does not support dry friction, which {equations.frictions[0].name} has"
        raise InputError(f"{equations.name}: {limit}; use {in_words([x for x in METHODS if x not in UNRUBBED])}")
    if stiffens := _may_stiffen(equations, chosen):
        note = "; implicit steps where stability limits explicit ones" * undecided
        decision = replace(decision, reason=decision.reason + note)
    return decision, stiffens


def _known(equations: Equations) -> Decision | None:
    """Return the decision of a configuration, if there is one."""
    return equations.decision if isinstance(equations, Configuration) else None


def _may_stiffen(equations: Equations, chosen: str) -> bool:
    """Return whether `auto` may change to implicit steps during a run: contacts become stiff when they touch, and other
    parameter values can make dampers or states stiff."""
    automatic = chosen == "explicit" and default_settings(equations).method == "auto"
    if not automatic or equations.n > DENSE:
        return False
    damped = equations.functions["f"].jac_sparsity(0, 1).nnz() > 0
    return damped or len(equations.states) > 0 or kinks_of_rates(equations, symbols(equations)).numel() > 0


def _automatic(equations: Equations) -> Decision:
    """Return the integrator that `auto` selects by the eigenvalues of small motions at the start, and the reason."""
    if equations.n > DENSE:
        return Decision("explicit", f"explicit: more than {DENSE} coordinates")
    probe = Probe.of(equations)
    if probe is None:
        return Decision("explicit", "explicit: there is no start with the default values")
    try:
        values = probe.spectrum()
    except SINGULAR:
        return Decision("explicit", "explicit: the augmented mass is singular at the start")
    if not values.size:
        return Decision("explicit", "explicit: small motions at the start are not finite")
    fastest = values[np.argmax(np.abs(values))]
    lasting = values[-values.real * equations.stop_time < LASTS]
    slow = max(2 * math.pi / equations.stop_time, min((abs(x) for x in lasting if abs(x) > 1e-3), default=0.0))
    seen = f"the fastest small motion at the start has {abs(fastest):.3g} 1/s, the slowest lasting one {slow:.3g} 1/s"
    if abs(fastest) > STIFF * slow and fastest not in lasting:
        return Decision("stiff", f"stiff: {seen}, and it decays")
    return Decision("explicit", f"explicit: {seen}")


def _decision(equations: Equations, values: Mapping[str, float | str]) -> Decision:
    """Return the integrator that `auto` selects for these values, and the reason."""

    def choose() -> Decision:
        e = with_defaults(equations, {**values, "solver.method": "auto"})
        return stored_decision(e, lambda: decision_of(e))

    return equations.kept.latest(_decision, choose, _key(values), _DECISIONS)


# Survey ---------------------------------------------------------------------------------------------------------------


def _surveyed(equations: Configuration, found: Survey) -> Configuration:
    """Return a configuration with its survey, and with a note in the descriptions of outputs that depend on shared
    loads."""
    if equations.survey.shared is not None:
        return replace(equations, survey=found)
    note = "; not unique: shared " + ("by compliances" if equations.compliances else "so that joints carry the least")
    concerned = found.shared or ()
    outputs = [replace(v, description=v.description + note * (v.name in concerned)) for v in equations.outputs]
    return replace(equations, outputs=outputs, survey=found)


# Trace ----------------------------------------------------------------------------------------------------------------


def prepared(equations: Equations, kernel: str = DEFAULT) -> Traced:
    """Return traced equations for the chosen kernel, cached; raise InputError if there is no such kernel.
    `alfmu.kernel.controlled.whole` adds the steps of programs from the cache.

    The oracle uses the equations of `vm`, as it starts and stores values in the same way.
    """
    if kernel not in KERNELS:
        raise InputError(f"{equations.name}: there is no kernel {kernel!r}; use one of {', '.join(KERNELS)}")
    constants()  # drops results for other constants
    e = _interpreted(equations)
    if kernel != "compiled" and not (kernel == "auto" and compiler()):
        return e
    known = equations.library if isinstance(equations, Traced) else None
    library = known or compiled_scene(e, packed(e))
    return equations.kept.latest(prepared, lambda: replace(e, library=library), library)


@once
def _interpreted(equations: Equations) -> Traced:
    with getting_ready():
        if not isinstance(equations, Traced):
            return _started(equations)
        decided(equations)  # refuses settings that this scene does not support
        return replace(equations, library=None) if equations.library else equations


def _started(equations: Equations) -> Traced:
    """Return traced equations; if the cache knows them, their programs have no steps."""
    made: list[Traced] = []

    def start() -> Start:
        e = decided(equations)
        made.append(_traced(_surveyed(e, survey(e)), equations.functions))
        return Start.of(made[0])

    found = stored_start(equations, start)
    if made:
        return made[0]
    e = _surveyed(Configuration.of(equations, decision=found.decision), found.survey)
    signatures = {**e.signatures, "seen": {"inputs": [], "outputs": [[found.seen, 1]], "matrices": 0}}
    if found.tangents:
        signatures["tangents"] = {"inputs": [], "outputs": [], "matrices": 0}
    return Traced.of(e, signatures=signatures, kernel=found.programs)


def _traced(configuration: Configuration, declared: Mapping[str, Any]) -> Traced:
    """Return a traced configuration; configurations of the same functions that differ only in numbers share the
    result."""
    e, settings = configuration, default_settings(configuration)
    rule = explicit_rule("explicit", settings.relative_tolerance)
    key = (
        id(declared),
        integrator(e),
        settings.method,
        settings.input_order,
        settings.branch,
        rule and rule.name,
        e.survey,
        constants(),
    )

    def trace() -> tuple[object, Traced]:
        # Caching the functions keeps their id unique.
        return declared, traced(e, controlled.programs)

    if e.n > DENSE:
        return trace()[1]
    _, scene = latest(_SCENES, key, trace, MOST_SCENES)
    same = "functions", "signatures", "kernel"
    found = Traced.of(e, **{field: getattr(scene, field) for field in same})
    found.kept.scene = scene.kept
    return found


def ready(
    equations: Equations,
    values: Mapping[str, float | str],
    outputs: Sequence[str] | None,
    freeze: Sequence[str] | None,
    kernel: str,
) -> tuple[Traced, dict[str, float | str]]:
    """Return the equations traced for a run with these values, and the values that remain to be set on an instance.

    Outputs, frozen parameters and the integrator are fixed by tracing. All other values are numbers of the instance, so
    that the same scene serves other numbers.
    """
    constants()
    own = dict(values)
    method = own.pop("solver.method", default_settings(equations).method)
    frozen = {p.name for p in equations.parameters if freeze and (list(freeze) == [ALL] or p.name in freeze)}
    folded = {name: own.pop(name) for name in frozen & own.keys()}
    e = chosen(equations, {**folded, "solver.method": method}, outputs, freeze)
    if method != "auto":
        return prepared(e, kernel), own
    decision, known = _decision(e, own), _known(e)
    if known is not None and known.method == decision.method:
        return prepared(e, kernel), own

    def by_decision() -> Traced:
        return prepared(Configuration.of(untraced(e), decision=decision), kernel)

    return e.kept.latest(ready, by_decision, (kernel, decision.method)), own


def retraced(equations: Equations, settings: Settings) -> Traced:
    """Return equations traced for the integrator and the order of inputs of these settings."""
    e, before = equations, default_settings(equations)
    wanted = {name: getattr(settings, name) for name in _TRACED if getattr(settings, name) != getattr(before, name)}
    if isinstance(e, Traced) and not wanted:
        return e

    def trace() -> Traced:
        if not wanted:
            return prepared(e)
        unmade = untraced(e)
        return prepared(replace(unmade, solver={**unmade.solver, **wanted}, decision=None), _kernel(e))

    return e.kept.latest(retraced, trace, tuple(sorted(wanted.items())))


def with_brakes(equations: Traced) -> Traced:
    """Return a scene traced again for its kernel, for redundant constraints that brake the motion."""
    e = untraced(equations)
    return prepared(replace(e, survey=replace(e.survey, brakes=True)), _kernel(equations))


def _kernel(equations: Equations) -> str:
    """Return the kernel for which equations are prepared."""
    return "compiled" if isinstance(equations, Traced) and equations.library else DEFAULT


# Load -----------------------------------------------------------------------------------------------------------------


@once
def packed(equations: Traced) -> bytes:
    """Return the scene file of traced equations, written once."""
    return stored_scene(equations, lambda: tables.packed(complete(equations)))


@once
def loaded(equations: Traced) -> Scene:
    """Return the scene of traced equations, packed and loaded once for all its instances."""
    scene = Scene(packed(equations), installed())
    if equations.library:
        scene.compiled_by(equations.library)
    return scene


@once
def loaded_in_lanes(equations: Traced) -> Scene:
    """Return the loaded scene of traced equations for a batch: compiled functions are compiled in lanes, too."""
    scene = loaded(equations)
    if library := library_in_lanes(equations):
        scene.compiled_by(library, in_lanes=True)
    return scene


def library_in_lanes(equations: Traced) -> Path | None:
    """Return the functions of a compiled scene in lanes; None if it is not compiled, or the processor has no lanes."""
    flags = lane_flags() if equations.library else []
    return compiled_scene(equations, packed(equations), flags) if flags else None
