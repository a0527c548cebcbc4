"""Prepare the instance for a run: at its start values, or in an equilibrium."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..equations import Equations
from ..equations.specialisation import starting_at, without_steps
from ..equations.types import configured
from ..fmi.recipe import Recipe, of
from ..kernel import DEFAULT
from ..model.doubts import tell, tell_of_gravity
from ..model.errors import AlfmuError
from ..model.mechanism import Mechanism
from ..runtime import Instance
from ..runtime.pipeline import derive, ready, with_defaults
from ..simulation import by_name, instance, names_in, run
from ..simulation.result import Result, Signal
from .equilibria import Equilibrium
from .states import rest


@dataclass(frozen=True)
class Prepared:
    """The instance and remaining parameters at the start of a run."""

    unit: Instance
    left: Mapping[str, float | str]
    """Parameters not set yet."""
    stop_time: float
    interval: float
    facts: Mapping[str, Any]
    declared: Mechanism | None


def prepare(
    mechanism: str | Path | Mechanism | Equations | Recipe,
    parameters: Mapping[str, float | str],
    inputs: Mapping[str, Signal] | None = None,
    start: str | Equilibrium | None = None,
    outputs: Sequence[str] | None = None,
    freeze: Sequence[str] | None = None,
    kernel: str | None = None,
    kept: Sequence[str] = (),
    jacobian: bool = True,
) -> Prepared:
    """Return an instance that is not yet initialised, for arguments of `simulate`.

    Parameters in `kept` are never folded; without `jacobian` the outputs include no derivatives over a step.
    """
    given, declared = by_name(mechanism, "parameters", parameters), None
    if not (outputs is None or isinstance(outputs, str)):
        outputs = names_in(mechanism, "outputs", outputs)
    freeze = None if freeze is None else names_in(mechanism, "parameters to freeze", freeze)
    facts: dict[str, Any] = {}
    if isinstance(mechanism, Equations):
        equations = mechanism
        facts |= {"mechanism": equations.name, "options": equations.options}
    else:
        recipe = of(mechanism)
        declared = recipe.declared()
        tell_of_gravity(declared)
        equations, given = derive(declared), {**recipe.parameters, **given}
        outputs = recipe.outputs if outputs is None else outputs
        freeze, kernel = recipe.freeze if freeze is None else freeze, kernel or recipe.kernel
        start = start or recipe.start
        facts |= {"mechanism": str(recipe), "options": declared.options}
    kernel = kernel or DEFAULT
    if not jacobian:
        outputs = None if outputs is None else without_steps(outputs)
        equations = configured(equations)
        equations = replace(equations, jacobian=()) if equations.jacobian else equations
    if freeze is not None:
        freeze = [name for name in freeze if name not in kept]
    scene: Equations
    scene, left = ready(equations, given, outputs, freeze, kernel)
    if start not in (None, "declared"):
        found = rest(with_defaults(equations, given), start, inputs)
        scene, left = starting_at(with_defaults(scene, left), found.q, found.states, found.kept), {}
        facts["start"] = dict(found.coordinates)
    facts["parameters"] = given
    return Prepared(instance(scene, kernel), left, equations.stop_time, equations.interval, facts, declared)


def rest_of(recipe: Recipe) -> Equilibrium | None:
    """Return the equilibrium in which the FMU of a recipe starts; None if it starts at its start values."""
    if recipe.start == "declared":
        return None
    return rest(with_defaults(derive(recipe.declared()), recipe.parameters), recipe.start)


def simulated(found: Prepared, stop_time: float | None, communication_step: float | None, **how: Any) -> Result:
    """Run an instance; times that are None are the mechanism's own, `how` are arguments of `run`."""
    stop = found.stop_time if stop_time is None else stop_time
    step = found.interval if communication_step is None else communication_step
    result = run(found.unit, stop, step, parameters=found.left, facts=found.facts, declared=found.declared, **how)
    _tell_what_was_forgotten(found)
    return result


def _tell_what_was_forgotten(of: Prepared) -> None:
    """Warn once of coordinates that are undetermined at the start."""
    if of.unit.equations.kept.latest(_tell_what_was_forgotten, lambda: of) is not of:
        return
    with contextlib.suppress(AlfmuError):  # freedoms may be undefined where a run has ended
        if free := of.unit.forgotten():
            tell(f"{of.unit.name}: {free}")
