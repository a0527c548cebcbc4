"""Results that are made once: the latest of each function, as long as what they follow from lives."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from threading import Lock
from typing import Any, Protocol, TypeVar

__all__ = ["MOST", "Kept", "latest", "once"]

_Made = TypeVar("_Made")

MOST = 8
"""Results of one function that are kept at most: equations of mechanisms, and scenes of equations."""

_LOCK = Lock()


def latest(known: OrderedDict[Any, _Made], key: Hashable, make: Callable[[], _Made], most: int = MOST) -> _Made:
    """The result that is known for a key, or that is made now; the latest results stay known."""
    with _LOCK:
        found = known.get(key)
    made = make() if found is None else found
    with _LOCK:
        known[key] = made
        known.move_to_end(key)
        while len(known) > most:
            known.popitem(last=False)
    return made


class Kept:
    """Results that follow from one object, by the function that makes them and a key of its further arguments."""

    __slots__ = ("_known", "scene")

    def __init__(self) -> None:
        self._known: dict[Callable[..., Any], OrderedDict[Any, Any]] = {}
        self.scene: Kept = self
        """Results that do not depend on numbers; objects that differ in numbers alone may share them."""

    def of(self, function: Callable[..., Any]) -> OrderedDict[Any, Any]:
        """The results of a function, by key."""
        return self._known.setdefault(function, OrderedDict())

    def latest(
        self, function: Callable[..., Any], make: Callable[[], _Made], key: Hashable = None, most: int = MOST
    ) -> _Made:
        """The result of a function for a key, made where it is not kept."""
        return latest(self.of(function), key, make, most)


class _Keeps(Protocol):
    @property
    def kept(self) -> Kept: ...


_Keeper = TypeVar("_Keeper", bound=_Keeps)


def once(function: Callable[[_Keeper], _Made]) -> Callable[[_Keeper], _Made]:
    """The same function, whose result is kept with its argument."""

    @wraps(function)
    def found(keeper: _Keeper) -> _Made:
        return keeper.kept.latest(function, lambda: function(keeper))

    return found
