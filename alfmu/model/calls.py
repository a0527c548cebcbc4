"""Check the arguments of declaring calls and explain a wrong call: what is missing, misspelt or of the wrong type.

Declarations check their arguments and explain mistakes. A mistake that they do not foresee raises one of Python's own
errors somewhere inside; this module turns it into a DeclarationError that names the part and the argument, based on the
type hints of the signature. A refused call leaves its mechanism unchanged.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, wraps
from typing import Any, ParamSpec, TypeVar

import casadi as ca
import numpy as np

from .errors import AlfmuError, DeclarationError, InputError
from .words import in_words, nearest, shown

_P = ParamSpec("_P")
_R = TypeVar("_R")
_C = TypeVar("_C", bound=type)

_RAW = (TypeError, AttributeError, ValueError, RuntimeError, LookupError, ArithmeticError, AssertionError)
"""Errors that Python, NumPy and CasADi raise for invalid arguments."""

_WORDS: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    str: "a text",
    bool: "True or False",
    ca.SX: "an expression",
    "Marker": "a point of a body in the plane, as BODY.at(x, y)",
    "SpatialMarker": "a point of a body in space, as BODY.at(x, y, z)",
    "Body": "a body, as body() and bar() return it",
    "SpatialBody": "a body in space, as spatial_body() returns it",
    "Joint": "a joint, as revolute() and prismatic() return it",
    "SpatialJoint": "a joint in space, as spatial_revolute() returns it",
    "SpatialFreedom": "one of its free motions, as JOINT.freedom(...)",
    "Spring": "a spring, as spring_damper() returns it",
    "Mechanism": "a Mechanism",
}
"""Description of each argument type in words; classes of the model are called by their names."""

_FORMS: dict[Any, str] = {Callable: "a function", Mapping: "numbers by their names, as {'name': 1.0}"}
"""Description of composite types."""

_COUNTS = {2: "two", 3: "three", 4: "four"}


def explained(function: Callable[_P, _R], kind: type[AlfmuError] = DeclarationError) -> Callable[_P, _R]:
    """Return the function with its low-level errors turned into AlfmuErrors of the given kind.

    The message names the call, the arguments given and the arguments it takes. After any error, a mechanism whose
    method it is, or which is its argument `m`, is restored to its previous state.
    """

    takes = _Takes(function)

    @wraps(function)
    def call(*given: _P.args, **named: _P.kwargs) -> _R:
        mechanism = named.get("m", given[0] if given and takes.own and function.__name__ != "__init__" else None)
        restore = mechanism._as_it_was() if hasattr(mechanism, "_as_it_was") else None
        try:
            return answered(given, named)
        except BaseException:
            if restore:
                restore()
            raise

    def answered(given: Sequence[Any], named: Mapping[str, Any]) -> _R:
        try:
            known = takes.known(given, named)
            takes.check(known, bool)
            found = function(*given, **named)
            takes.check(known, str)
        except AlfmuError:
            raise
        except _RAW as error:
            raise kind(takes.said(given, named, error)) from error
        return found

    return call


def asked(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the function `explained` with InputErrors, for functions that declare nothing."""
    return explained(function, InputError)


def declares(of: _C) -> _C:
    """Return the class with its constructor and its public methods wrapped by `explained`."""
    for name, function in [*vars(of).items()]:
        if inspect.isfunction(function) and (not name.startswith("_") or name == "__init__"):
            setattr(of, name, explained(function))
    return of


class _Takes:
    """The arguments of a function, without the mechanism it belongs to."""

    def __init__(self, function: Callable[..., Any]):
        parameters = inspect.signature(function).parameters
        self.function = function
        self.parameters = {name: p for name, p in parameters.items() if name not in ("self", "m")}
        self.own = len(parameters) - len(self.parameters)
        self.places = [name for name, p in self.parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
        self.more = any(p.kind is p.VAR_POSITIONAL for p in self.parameters.values())

    @cached_property
    def hints(self) -> dict[str, Any]:
        """Types of the arguments."""
        own = {name: hint for name, hint in self.function.__annotations__.items() if name != "return"}
        return typing.get_type_hints(types.SimpleNamespace(__annotations__=own), self.function.__globals__)

    @cached_property
    def plain(self) -> dict[type, list[str]]:
        """Return the arguments that are Boolean and those that are texts, which other values could be mistaken for."""
        return {
            kind: [name for name, hint in self.hints.items() if hint in (kind, kind | None)] for kind in (bool, str)
        }

    def known(self, given: Sequence[Any], named: Mapping[str, Any]) -> dict[str, Any]:
        """Return the given arguments by name."""
        return {**dict(zip(self.places, given[self.own :], strict=False)), **named}

    def check(self, known: Mapping[str, Any], kind: type) -> None:
        """Raise TypeError if a Boolean or text argument has another type."""
        for name in self.plain[kind]:
            if name in known and not _fits(known[name], self.hints[name]):
                raise TypeError(name)

    def said(self, given: Sequence[Any], named: Mapping[str, Any], error: Exception) -> str:
        """Return the explanation of a call that ended in one of Python's own errors."""
        call, known, count = (
            _called(self.function, given, named, self.own),
            self.known(given, named),
            len(given) - self.own,
        )
        if unknown := [name for name in named if name not in self.parameters]:
            meant = nearest(unknown[0], self.parameters)
            return f"{call} takes no {unknown[0]}; " + (f"did you mean {in_words(meant)}?" if meant else self.all())
        if lacking := [name for name in self.needed if name not in known]:
            return f"{call} lacks {in_words(lacking, 'and')}; {self.all()}"
        if count > len(self.places) and not self.more:
            by_name = [name for name in self.parameters if name not in self.places]
            how = f"; give {in_words(by_name, 'and')} by name" if by_name else ""
            places = in_words(self.places, "and") or "nothing"
            return f"{call} takes {places} in this order, and is given {count} values{how}"
        for name, value in known.items():
            if name in self.hints and not _fits(value, self.hints[name]):
                return f"{call}: {name} is {shown(value)}; give {_in_words(self.hints[name])}"
        text = str(error).strip().partition("\n")[0]
        return f"{call} cannot use its arguments ({type(error).__name__}: {text}); {self.all()}"

    @property
    def needed(self) -> list[str]:
        """Arguments without a default."""
        return [name for name, p in self.parameters.items() if p.default is p.empty and p.kind is not p.VAR_POSITIONAL]

    def all(self) -> str:
        """Return the arguments of the call in words."""
        beside = in_words([name for name in self.parameters if name not in self.needed], "and")
        return f"it takes {in_words(self.needed, 'and') or 'nothing'}" + f", and may take {beside}" * bool(beside)


def _called(function: Callable[..., Any], given: Sequence[Any], named: Mapping[str, Any], own: int) -> str:
    """Return the call with its mechanism and the name of its part."""
    owner = given[0] if given and own else None
    about = [*given[own : own + 1], *(named[x] for x in ("name", "of", "joint", "body") if x in named)]
    names = [x if isinstance(x, str) else getattr(x, "name", None) for x in about]
    of = next((f" of {x}" for x in names if isinstance(x, str) and x), "")
    if function.__name__ == "__init__":
        return f"{type(owner).__name__}()"
    name = getattr(owner, "name", getattr(owner, "mechanism", None))
    return (f"{name}: " if isinstance(name, str) else "") + f"{function.__name__}(){of}"


def _fits(value: Any, hint: Any) -> bool:
    """Return whether a value matches a type hint."""
    origin, of = typing.get_origin(hint), typing.get_args(hint)
    if hint in (Any, object):
        return True
    if origin is Callable:
        return callable(value)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, each) for each in of)
    if hint in (None, types.NoneType):
        return value is None
    if hint in (float, int):
        kinds = (int, np.integer) if hint is int else (int, float, np.number)
        return isinstance(value, kinds) and not isinstance(value, bool)
    if origin is not None and issubclass(origin, Sequence):
        if isinstance(value, str | bytes) or not isinstance(value, Sequence | np.ndarray | ca.SX):
            return False
        if isinstance(value, ca.SX) or not of:
            return True
        fixed = origin is tuple and of[-1] is not ...
        return (not fixed or len(value) == len(of)) and all(
            _fits(each, x) for each, x in zip(value, of if fixed else [of[0]] * len(value), strict=True)
        )
    kind = origin or hint
    return not isinstance(kind, type) or isinstance(value, kind)


def _in_words(hint: Any) -> str:
    """Return a type in words."""
    origin, of = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        words = [_in_words(each) for each in of if each is not types.NoneType]
        return in_words(list(dict.fromkeys(words))) + ", or leave it out" * (types.NoneType in of)
    if origin in _FORMS:
        return _FORMS[origin]
    if origin is tuple and of and of[-1] is not ...:
        count = _COUNTS.get(len(of), str(len(of)))
        return f"{count} of them, each {_in_words(of[0])}"
    if origin is not None and inspect.isclass(origin) and issubclass(origin, Sequence):
        return f"several, each {_in_words(of[0])}" if of else "several"
    return _WORDS.get(hint) or _WORDS.get(getattr(hint, "__name__", ""), f"a {getattr(hint, '__name__', hint)}")
