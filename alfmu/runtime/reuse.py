"""Equations and scenes that were made already: runs of one mechanism that differ in numbers alone share them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..equations import Equations, derivation
from ..equations.interface import integrator
from ..equations.specialisation import ALL, specialised
from ..equations.types import Decision
from ..kernel import DEFAULT
from ..model.content import content
from ..model.kept import latest
from ..model.making import getting_ready
from ..model.mechanism import Mechanism
from ..model.settings import Settings
from .prepare import decided, prepared, with_defaults

__all__ = ["chosen", "derive", "ready"]

_DECISIONS = 1000
"""Choices of the method of integration that are kept of a mechanism, the latest."""

_KEPT: OrderedDict[str, Equations] = OrderedDict()


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
        return latest(_KEPT, key, lambda: derivation.derive(mechanism))


def ready(
    equations: Equations,
    values: Mapping[str, float | str],
    outputs: Sequence[str] | None,
    freeze: Sequence[str] | None,
    kernel: str,
) -> tuple[Equations, dict[str, float | str]]:
    """The equations traced for a run with these values, and those of them that are left to set on an instance.

    What a scene is traced with is in it: outputs, frozen parameters, the method of integration. All else is a number
    of the instance, so that other numbers take the same scene.
    """
    own = dict(values)
    method = own.pop("solver.method", equations.solver.get("method", Settings.method))
    frozen = {p.name for p in equations.parameters if freeze and (list(freeze) == [ALL] or p.name in freeze)}
    folded = {name: own.pop(name) for name in frozen & own.keys()}
    e = with_defaults(equations, {**folded, "solver.method": method})
    if method == "auto":
        e = replace(e, decision=_decided(equations, own | folded))
    asked = [None if names is None else tuple(names) for names in (outputs, freeze)]
    key = (*asked, kernel, method, integrator(e), *sorted(folded.items()))
    return equations.kept.latest(ready, lambda: prepared(specialised(e, outputs, freeze), kernel), key), own


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
    key = (*asked, *sorted(values.items()))
    return equations.kept.latest(chosen, lambda: specialised(with_defaults(equations, values), outputs, freeze), key)


def _decided(equations: Equations, values: Mapping[str, float | str]) -> Decision | None:
    """The method that `auto` stands for where these values are set, and why."""

    def choose() -> Decision | None:
        return decided(with_defaults(equations, {**values, "solver.method": "auto"})).decision

    return equations.kept.latest(_decided, choose, tuple(sorted(values.items())), _DECISIONS)
