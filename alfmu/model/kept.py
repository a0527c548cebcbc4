"""A cache of results: the latest of each function, for the lifetime of the object that they follow from."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from threading import Lock
from typing import Any, Protocol, TypeVar

_Made = TypeVar("_Made")

MOST = 8
"""Largest number of cached results of a function: equations of mechanisms, and scenes of equations."""

_LOCK = Lock()

_AGE = [0]


def latest(known: OrderedDict[Any, _Made], key: Hashable, make: Callable[[], _Made], most: int = MOST) -> _Made:
    """Return the cached result for a key, or make and cache it; only the `most` latest results are kept."""
    with _LOCK:
        found = known.get(key)
    made = make() if found is None else found
    with _LOCK:
        known[key] = made
        known.move_to_end(key)
        while len(known) > most:
            known.popitem(last=False)
    return made


def outdate() -> None:
    """Invalidate the cached results of every object, after a change of constants on which they depend."""
    _AGE[0] += 1


class Kept:
    """Results that follow from one object, by the function that makes them and a key of its further arguments."""

    __slots__ = ("_age", "_known", "scene")

    def __init__(self) -> None:
        self._age = _AGE[0]
        self._known: dict[Callable[..., Any], OrderedDict[Any, Any]] = {}
        self.scene: Kept = self
        """Results that do not depend on numbers; objects that differ in numbers alone may share them."""

    def of(self, function: Callable[..., Any]) -> OrderedDict[Any, Any]:
        """Return the cached results of a function, by key."""
        if self._age != _AGE[0]:
            self._known, self._age = {}, _AGE[0]
        return self._known.setdefault(function, OrderedDict())

    def latest(
        self, function: Callable[..., Any], make: Callable[[], _Made], key: Hashable = None, most: int = MOST
    ) -> _Made:
        """Return the result of a function for a key, computed if it is not cached."""
        return latest(self.of(function), key, make, most)


class _Keeps(Protocol):
    @property
    def kept(self) -> Kept: ...


_Keeper = TypeVar("_Keeper", bound=_Keeps)


def once(function: Callable[[_Keeper], _Made]) -> Callable[[_Keeper], _Made]:
    """Return the function with its result cached in its argument."""

    @wraps(function)
    def found(keeper: _Keeper) -> _Made:
        return keeper.kept.latest(function, lambda: function(keeper))

    return found
