"""Equations and scenes that were made already: runs of one mechanism that differ in numbers alone share them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from threading import Lock

from ..equations import Equations
from ..equations.derivation import derive
from ..equations.specialisation import ALL, specialised
from ..model.content import content
from ..model.mechanism import Mechanism
from ..model.settings import Settings
from .prepare import decided, prepared, with_defaults

__all__ = ["derived", "ready"]

_MOST = 8
"""Mechanisms whose equations and scenes are kept, the latest."""

_KEPT: OrderedDict[str, Equations] = OrderedDict()
_LOCK = Lock()


def derived(mechanism: Mechanism) -> Equations:
    """The equations of a mechanism, derived once as long as nothing of its declaration changes."""
    key = content(mechanism)
    if key is None:
        return derive(mechanism)
    with _LOCK:
        known = _KEPT.get(key)
    if known is None:
        known = derive(mechanism)
    with _LOCK:
        _KEPT[key] = known
        _KEPT.move_to_end(key)
        while len(_KEPT) > _MOST:
            _KEPT.popitem(last=False)
    return known


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
        chosen = _decided(equations, own | folded)
        e = replace(e, solver=chosen.solver, reason=chosen.reason)
        method = e.solver["method"]
    key: tuple[object, ...] = (
        None if outputs is None else tuple(outputs),
        None if freeze is None else tuple(freeze),
        kernel,
        method,
    )
    key += tuple(sorted(folded.items()))
    known = equations.programs.setdefault("ready", {})
    if key not in known:
        known[key] = prepared(specialised(e, outputs, freeze), kernel)
    return known[key], own


def _decided(equations: Equations, values: Mapping[str, float | str]) -> Equations:
    """The equations with the method that `auto` stands for where these values are set."""
    known = equations.programs.setdefault("decided", {})
    key = tuple(sorted(values.items()))
    if key not in known:
        known[key] = decided(with_defaults(equations, {**values, "solver.method": "auto"}))
    return known[key]
