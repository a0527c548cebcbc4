"""Equations and scenes that were made already: runs of one mechanism that differ in numbers alone share them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any, TypeVar

from ..equations import Equations
from ..equations.derivation import derive
from ..equations.specialisation import ALL, specialised
from ..kernel import DEFAULT
from ..model.content import content
from ..model.mechanism import Mechanism
from ..model.settings import Settings
from .prepare import decided, prepared, with_defaults

_Made = TypeVar("_Made")

__all__ = ["chosen", "derived", "ready"]

_MOST = 8
"""Mechanisms whose equations are kept, and scenes of each: the latest."""

_DECISIONS = 1000
"""Choices of the method of integration that are kept of a mechanism, the latest."""

_KEPT: OrderedDict[str, Equations] = OrderedDict()
_LOCK = Lock()


def derived(mechanism: Mechanism) -> Equations:
    """The equations of a mechanism, derived once as long as nothing of its declaration changes."""
    key = content(mechanism)
    if key is None:
        return derive(mechanism)
    return _kept(_KEPT, key, lambda: derive(mechanism), _MOST)


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
        chosen, reason = _decided(equations, own | folded)
        e = replace(e, chosen=chosen, reason=reason)
    asked = [None if names is None else tuple(names) for names in (outputs, freeze)]
    key = (*asked, kernel, method, e.chosen, *sorted(folded.items()))
    scenes = equations.programs.setdefault("ready", OrderedDict())
    return _kept(scenes, key, lambda: prepared(specialised(e, outputs, freeze), kernel), _MOST), own


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
    known = equations.programs.setdefault("chosen", OrderedDict())
    key = (*asked, *sorted(values.items()))
    return _kept(known, key, lambda: specialised(with_defaults(equations, values), outputs, freeze), _MOST)


def _decided(equations: Equations, values: Mapping[str, float | str]) -> tuple[str, str]:
    """The method that `auto` stands for where these values are set, and why."""

    def choose() -> tuple[str, str]:
        e = decided(with_defaults(equations, {**values, "solver.method": "auto"}))
        return e.chosen, e.reason

    known = equations.programs.setdefault("decided", OrderedDict())
    return _kept(known, tuple(sorted(values.items())), choose, _DECISIONS)


def _kept(known: OrderedDict[Any, _Made], key: object, make: Callable[[], _Made], most: int) -> _Made:
    """What was made before for a key, or is made now; of all that is known, the latest stay."""
    with _LOCK:
        found = known.get(key)
    made = make() if found is None else found
    with _LOCK:
        known[key] = made
        known.move_to_end(key)
        while len(known) > most:
            known.popitem(last=False)
    return made
