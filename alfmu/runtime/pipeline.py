"""From a mechanism to a loaded scene: derive, configure, survey, trace, load.

`Mechanism` - derive -> `Equations` - decided, surveyed -> `Configuration` - trace -> `Traced` - loaded -> `Scene`. No
stage changes what it is given, and each keeps its results: runs of one mechanism that differ in numbers alone share
them. One arrow points back: `survey` starts the runtime before the programs of a scene are traced.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from .shipped import installed
from .stored import Start, constants, stored_decision, stored_scene, stored_start

__all__ = [
    *("chosen", "decision_of", "derive", "loaded", "packed", "prepared", "ready", "retraced"),
    *("with_brakes", "with_defaults"),
]


UNRUBBED = ("trapezoidal", "generalized_alpha")
"""Methods of the index-3 form, whose multipliers are those of positions: dry friction takes those of accelerations."""

STIFF = 20.0
"""Ratio of the fastest small motion to the slowest that lasts, above which a scene is stiff if the fastest does not:
stability limits explicit steps to some 4 over the one, accuracy all steps to 0.3 over the other, and an implicit step
costs two or three explicit ones."""

LASTS = 30.0
"""Time constants in a run up to which a small motion lasts; one with more is gone after a tenth of it."""

MOST_SCENES = 16
"""Scenes that are kept for equations which differ from theirs in numbers alone; large ones take too much memory."""

_DECISIONS = 1000
"""Choices of the method of integration that are kept of a mechanism, the latest."""

_TRACED = ("method", "input_order")
"""Settings that a scene is traced with."""

_KEPT: OrderedDict[tuple[str, str], Equations] = OrderedDict()

_SCENES: OrderedDict[tuple[object, ...], tuple[object, Traced]] = OrderedDict()

# Derive ---------------------------------------------------------------------------------------------------------------


def derive(mechanism: Mechanism) -> Equations:
    """All equations of a mechanism, with names, units and every joint reaction; derived once as long as nothing of its
    declaration changes.

    Raises DeclarationError where the declaration has no equations: a body that nothing places, a joint that no
    coordinate can close, an expression with a foreign symbol.
    """
    with getting_ready():
        key = content(mechanism)
        if key is None:
            return derivation.derive(mechanism)
        return latest(_KEPT, (key, constants()), lambda: derivation.derive(mechanism))


# Configure ------------------------------------------------------------------------------------------------------------


def with_defaults(equations: Equations, values: Mapping[str, float | str]) -> Configuration:
    """The same equations with other defaults for parameters, start values, inputs and solver variables; made once for
    the same values.

    Raises InputError where a name is unknown or a value out of bounds.
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
    """The equations with these defaults and outputs alone, the same for the same: they are traced once."""
    if not values:
        return ready(equations, {}, outputs, freeze, DEFAULT)[0]
    asked = [None if names is None else tuple(names) for names in (outputs, freeze)]
    key = (*asked, *_key(values))
    return equations.kept.latest(chosen, lambda: specialised(with_defaults(equations, values), outputs, freeze), key)


def decided(equations: Equations) -> Configuration:
    """The configuration of equations with their decision, and with the functions that its method needs."""
    e = configured(equations)
    decision, stiffens = _decide(e)
    e = with_tangents(e) if decision.method in RULES or stiffens else e
    return e if decision == e.decision else replace(e, decision=decision)


def decision_of(equations: Equations) -> Decision:
    """The method of integration of equations with their defaults."""
    return _decide(equations)[0]


def _decide(equations: Equations) -> tuple[Decision, bool]:
    """The decision, and whether a run may go over to implicit steps on the way."""
    formulation, known = default_settings(equations).formulation, formulations(equations)
    if formulation not in known:
        limit = f"solver.formulation {formulation} takes up to {DENSE} coordinates"
        if equations.slips:
            limit = f"solver.formulation {formulation} is not there for constraints of velocities, such as a blade's"
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
        limit = f"solver.method {chosen} has no dry friction, which {equations.frictions[0].name} has"
        raise InputError(f"{equations.name}: {limit}; use {in_words([x for x in METHODS if x not in UNRUBBED])}")
    if stiffens := _may_stiffen(equations, chosen):
        note = "; implicit steps where stability keeps these short" * undecided
        decision = replace(decision, reason=decision.reason + note)
    return decision, stiffens


def _known(equations: Equations) -> Decision | None:
    """The decision of a configuration, if there is one."""
    return equations.decision if isinstance(equations, Configuration) else None


def _may_stiffen(equations: Equations, chosen: str) -> bool:
    """Whether `auto` may go over to implicit steps on the way: contacts are stiff once they touch, and other values of
    its parameters make a damper stiff, or what has states."""
    automatic = chosen == "explicit" and default_settings(equations).method == "auto"
    if not automatic or equations.n > DENSE:
        return False
    damped = equations.functions["f"].jac_sparsity(0, 1).nnz() > 0
    return damped or len(equations.states) > 0 or kinks_of_rates(equations, symbols(equations)).numel() > 0


def _automatic(equations: Equations) -> Decision:
    """The method that `auto` stands for, and why: by the eigenvalues of small motions at the start."""
    if equations.n > DENSE:
        return Decision("explicit", f"explicit: more than {DENSE} coordinates")
    probe = Probe.of(equations)
    if probe is None:
        return Decision("explicit", "explicit: the defaults have no start")
    try:
        values = probe.spectrum()
    except SINGULAR:
        return Decision("explicit", "explicit: the augmented mass is singular at the start")
    if not values.size:
        return Decision("explicit", "explicit: small motions at the start are not finite")
    fastest = values[np.argmax(np.abs(values))]
    lasting = values[-values.real * equations.stop_time < LASTS]
    slow = max(2 * math.pi / equations.stop_time, min((abs(x) for x in lasting if abs(x) > 1e-3), default=0.0))
    seen = f"the fastest small motion at the start has {abs(fastest):.3g} 1/s, the slowest that lasts {slow:.3g}"
    if abs(fastest) > STIFF * slow and fastest not in lasting:
        return Decision("stiff", f"stiff: {seen}, and it decays")
    return Decision("explicit", f"explicit: {seen}")


def _decision(equations: Equations, values: Mapping[str, float | str]) -> Decision:
    """The method that `auto` stands for where these values are set, and why."""

    def choose() -> Decision:
        e = with_defaults(equations, {**values, "solver.method": "auto"})
        return stored_decision(e, lambda: decision_of(e))

    return equations.kept.latest(_decision, choose, _key(values), _DECISIONS)


# Survey ---------------------------------------------------------------------------------------------------------------


def _surveyed(equations: Configuration, found: Survey) -> Configuration:
    """A configuration with its survey; descriptions of outputs say where redundant constraints share a load."""
    if equations.survey.shared is not None:
        return replace(equations, survey=found)
    note = "; not unique: shared " + ("by compliances" if equations.compliances else "so that joints carry the least")
    concerned = found.shared or ()
    outputs = [replace(v, description=v.description + note * (v.name in concerned)) for v in equations.outputs]
    return replace(equations, outputs=outputs, survey=found)


# Trace ----------------------------------------------------------------------------------------------------------------


def prepared(equations: Equations, kernel: str = DEFAULT) -> Traced:
    """Equations with what the chosen kernel runs, traced once, or by the cache; InputError where there is no such
    kernel. `alfmu.kernel.controlled.whole` has all steps of the programs.

    The oracle starts and keeps its values as `vm` does, so that it takes the same.
    """
    if kernel not in KERNELS:
        raise InputError(f"{equations.name}: there is no kernel {kernel!r}; use one of {', '.join(KERNELS)}")
    constants()  # so that results from others are forgotten
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
        decided(equations)  # which refuses settings that this scene has not
        return replace(equations, library=None) if equations.library else equations


def _started(equations: Equations) -> Traced:
    """Equations traced; with the heads of their programs alone where the cache knows them."""
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
    """A configuration traced; those of the same functions that differ in numbers alone share what is traced."""
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
        # The functions are kept, so that no others get their place.
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
    """The equations traced for a run with these values, and those of them that are left to set on an instance.

    What a scene is traced with is in it: outputs, frozen parameters, the method of integration. All else is a number
    of the instance, so that other numbers take the same scene.
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
    """Equations traced with the method of integration and the order of inputs that settings ask for."""
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
    """A scene traced again for its kernel, in which redundant constraints brake the motion."""
    e = untraced(equations)
    return prepared(replace(e, survey=replace(e.survey, brakes=True)), _kernel(equations))


def _kernel(equations: Equations) -> str:
    """The kernel that equations are prepared for."""
    return "compiled" if isinstance(equations, Traced) and equations.library else DEFAULT


# Load -----------------------------------------------------------------------------------------------------------------


@once
def packed(equations: Traced) -> bytes:
    """The scene file of traced equations, written once."""
    return stored_scene(equations, lambda: tables.packed(complete(equations)))


@once
def loaded(equations: Traced) -> Scene:
    """The scene of traced equations, packed and loaded once for all their instances."""
    scene = Scene(packed(equations), installed())
    if equations.library:
        scene.compiled_by(equations.library)
    return scene
