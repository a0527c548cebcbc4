"""Mechanisms by name or file: entry points of installed packages, or a user's own Python file."""

import inspect
import math
import os
import re
import runpy
import sys
import traceback
import typing
import warnings
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from ..model import gallery
from ..model.checks import casadi_function
from ..model.errors import AlfmuError, AlfmuWarning, DeclarationError, InputError
from ..model.mechanism import Mechanism
from ..model.sources import LINKAGES, is_file
from ..model.words import in_words, nearest, there_is

GROUP = "alfmu.mechanisms"
"""Entry-point group in which any package can register functions that return a Mechanism."""

_OWN = "alfmu.catalogue."
"""Package of alfmu's own mechanisms, in its folder `mechanisms`."""

Factory = Callable[..., Mechanism]

_ANY = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def mechanisms() -> list[str]:
    """Return names of all registered mechanisms, in alphabetical order."""
    return registered(GROUP)


def known() -> list[str]:
    """Return names of all mechanisms: registered ones, then those of the documentation's gallery."""
    own = mechanisms()
    return [*own, *(name for name in gallery.names() if name not in own)]


def registered(*groups: str) -> list[str]:
    """Return the names registered in groups of entry points, in alphabetical order."""
    return sorted({e.name for group in groups for e in entries(group)})


def entries(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group in all installed packages, read again only if folders of these changed."""
    return _read(group, tuple((path, _changed(path)) for path in sys.path))


@lru_cache(10)
def _read(group: str, places: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=group))


def _changed(path: str) -> int:
    """Return the time of the last change in a folder; 0 if there is none."""
    try:
        return os.stat(path or ".").st_mtime_ns
    except OSError:
        return 0


def load(mechanism: str | Path | Mechanism, **chosen: Any) -> Mechanism:
    """Return the mechanism of a name (`alfmu list`), of a Python file or of a file of another program, with its
    options.

    A Python file declares one: a function named like the file (or the only one annotated `-> Mechanism`), or a
    `Mechanism` object. MJCF (`.xml`), SDF and URDF files are read as `alfmu.imported` does, with the same options.
    Raises InputError if there is no such name, file, declaration or option, or if part of a file cannot be mapped.
    """
    if isinstance(mechanism, Mechanism):
        if chosen:
            raise InputError(f"{mechanism.name} is declared already and takes no options")
        return mechanism
    if not isinstance(mechanism, str | Path):
        kind = type(mechanism).__name__
        raise InputError(f"{mechanism} is of the type {kind}; give a name, a file or a Mechanism, not a {kind}")
    factory = _factory(mechanism)
    hints = _hints(mechanism, factory)
    takes = _taken(factory, hints)
    for name, value in chosen.items():
        if name not in takes:
            raise InputError(f"{mechanism} has no option {name!r}; {there_is(name, takes)}")
        if takes[name] and value not in takes[name]:
            raise InputError(f"{mechanism}: option {name} is {value!r}; use one of {', '.join(map(str, takes[name]))}")
        if hints.get(name) is int:
            chosen[name] = _whole(f"{mechanism}: option {name}", value)
    parameters = inspect.signature(factory).parameters
    if lacking := [k for k, p in parameters.items() if p.default is p.empty and p.kind not in _ANY and k not in chosen]:
        raise InputError(
            f"{mechanism}: {factory.__name__}() takes {lacking[0]}, which has no default; give it one, or say "
            f"--option {lacking[0]}=..."
        )
    declared = _guarded(mechanism, lambda: factory(**chosen))
    if not isinstance(declared, Mechanism):
        returned = "nothing" if declared is None else f"a {type(declared).__name__}, no Mechanism"
        raise InputError(f"{mechanism}: {factory.__name__}() returns {returned}; end it with `return m`, the mechanism")
    declared._choices = _in_words(takes, hints)
    declared.options = {**{k: p.default for k, p in parameters.items() if p.kind not in _ANY}, **chosen}
    readme = Path(inspect.getsourcefile(factory) or "").with_name("README.md")
    if readme.is_file() and not is_file(mechanism):
        declared.documentation = readme.read_text(encoding="utf-8")
    elif not is_file(mechanism) and str(mechanism) in gallery.names():
        declared.documentation = factory.__globals__["__doc__"]
    return declared


def options(mechanism: str | Path) -> dict[str, tuple[Any, ...]]:
    """Return the options of a mechanism: name -> its values (empty: any)."""
    factory = _factory(mechanism)
    return _taken(factory, _hints(mechanism, factory))


def _taken(factory: Factory, hints: dict[str, Any]) -> dict[str, tuple[Any, ...]]:
    return {
        name: typing.get_args(hints[name]) if typing.get_origin(hints.get(name)) is typing.Literal else ()
        for name in inspect.signature(factory).parameters
    }


def choices(mechanism: str | Path | Mechanism) -> dict[str, list[str]]:
    """Return the options of a mechanism, also of a loaded one: name -> its values, or a word for them."""
    if isinstance(mechanism, Mechanism):
        return mechanism._choices
    factory = _factory(mechanism)
    hints = _hints(mechanism, factory)
    return _in_words(_taken(factory, hints), hints)


def _in_words(takes: dict[str, tuple[Any, ...]], hints: dict[str, Any]) -> dict[str, list[str]]:
    """Return the values of options, or a word for them."""
    words = {int: "whole number", float: "number", str: "text"}
    return {
        name: list(map(str, values)) or [words.get(hints.get(name, object), "any")] for name, values in takes.items()
    }


def _hints(mechanism: str | Path, factory: Factory) -> dict[str, Any]:
    """Return types of the options, as annotated."""
    return _guarded(mechanism, lambda: typing.get_type_hints(factory))


def _whole(what: str, value: Any) -> int:
    """Return an integer, also from 10.0 or text of a command line or a file."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not number.is_integer():
        raise InputError(f"{what} is {value!r}; use a whole number")
    return int(number)


def _factory(mechanism: str | Path) -> Factory:
    if str(mechanism).endswith(".py"):
        return _from_file(Path(mechanism))
    if str(mechanism).endswith(LINKAGES):
        from ..formats import factory

        return factory(mechanism)
    for entry in entries(GROUP):
        if entry.name == str(mechanism):
            return _guarded(mechanism, entry.load)
    name = str(mechanism)
    if name in gallery.names():
        return gallery.factory(name)
    if name.endswith((".fmu", ".csv")):
        kind = "an FMU" if name.endswith(".fmu") else "a table"
        raise InputError(f"{name} is {kind}; give the mechanism instead, by its name or as a Python file")
    there = [f"{name}.py"] if Path(f"{name}.py").is_file() else nearest(name, known())
    said = f"did you mean {in_words(there)}? Use" if there else "use"
    raise InputError(
        f"there is no mechanism {name!r}; {said} one of {', '.join(mechanisms())}, a name of the gallery "
        "(`alfmu list`), or the path of a Python file that declares one"
    )


def _from_file(path: Path) -> Factory:
    names = executed(path)
    functions = {k: f for k, f in names.items() if inspect.isfunction(f) and f.__module__ == path.stem}
    if path.stem in functions:
        return functions[path.stem]
    annotated = [f for f in functions.values() if f.__annotations__.get("return") in (Mechanism, "Mechanism")]
    if len(annotated) == 1:
        return annotated[0]
    declared = list({id(m): m for m in names.values() if isinstance(m, Mechanism)}.values())
    if len(declared) == 1:
        return lambda: declared[0]
    what = f"write `def {path.stem}() -> Mechanism:`"
    if len(annotated) > 1 or len(declared) > 1:
        found = [f"{f.__name__}()" for f in annotated] or [m.name for m in declared]
        raise InputError(f"{path} declares several mechanisms, {', '.join(found)}; {what} for the one that is meant")
    if len(functions) == 1:
        what += f", or mark the one that is there: `def {next(iter(functions))}(...) -> Mechanism:`"
    raise InputError(f"{path} declares no mechanism; {what}")


def executed(path: Path) -> dict[str, Any]:
    """Run a user's Python file and return its names; raise InputError, with the line, if it is missing or fails."""
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    return _guarded(path, lambda: runpy.run_path(str(path), run_name=path.stem))


def _guarded(mechanism: str | Path, run: Callable[[], Any]) -> Any:
    """Run a user's code; add the line to errors in a user's file or in the package of a name."""
    try:
        with warnings.catch_warnings():
            # NumPy functions of symbols have different results in different versions of CasADi.
            warnings.filterwarnings("error", r"\s*casadi: a numpy function", FutureWarning)
            return run()
    except (Exception, SystemExit) as error:
        named = not str(mechanism).endswith(".py")
        if isinstance(error, AlfmuError | AlfmuWarning) and (named or not isinstance(error, DeclarationError)):
            raise
        frames = traceback.extract_tb(error.__traceback__)
        file = _place(frames, mechanism) if named else str(mechanism)
        lines = [f.lineno for f in frames if f.filename == file]
        line = int(getattr(error, "lineno", None) or (lines[-1] if lines else None) or 0)
        where = f"{file}, line {line}" if file and line else file or "its package does not load"
        if isinstance(error, DeclarationError):
            raise DeclarationError(f"{where}: {error}") from error
        where = f"{mechanism}: {where}" if named else where
        raise InputError(f"{where}: {_explained(error, file, line)}") from error


def _place(frames: traceback.StackSummary, name: str | Path) -> str:
    """Return the file, in the package that registers a name, nearest to the failure in its code; empty if none ran."""
    modules = [entry.module for entry in entries(GROUP) if entry.name == str(name)]
    packages = {module.removeprefix(_OWN).partition(".")[0] for module in modules}
    files = [f.filename for f in frames if packages & {Path(f.filename).stem, *Path(f.filename).parts}]
    return files[-1] if files else ""


def _explained(error: BaseException, file: str, line: int) -> str:
    """Return the message of Python or CasADi on a user's line, or advice for common errors with symbols."""
    said = str(error).strip().partition("\n")[0]
    if "truth value" in said:
        return (
            "an if, and, or, min or max asks whether an expression is true, which is known only when it runs; use "
            "ca.if_else(condition, a, b), ca.logic_and, ca.logic_or, ca.fmin or ca.fmax"
        )
    if "to_int" in said or re.search("'SX'.*as an integer|must be integers.*SX", said):
        return (
            "a symbol is not a whole number, and counts are fixed when a mechanism is declared; use an option, as in "
            f"def {Path(file).stem}(n: int = 3)"
        )
    of_symbols = casadi_function(file, line)
    if isinstance(error, FutureWarning) or (of_symbols and re.search("SX|casadi", said)):
        return f"functions of NumPy and of Python's math are not for symbols; use {of_symbols or 'those of CasADi'}"
    if isinstance(error, AttributeError | NameError) and error.name and "did you mean" not in said:
        names = dir(error.obj) if isinstance(error, AttributeError) else ()
        if meant := nearest(error.name, [name for name in names if not name.startswith("_")]):
            said += f"; did you mean {in_words(meant)}?"
    return f"{type(error).__name__}: {said}"
