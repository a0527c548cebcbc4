"""Scenes in the cache folder, from which a mechanism starts and runs without tracing its equations again.

Three files belong to equations: the integrator, other results of tracing (`Start`), and the bytes of the scene. Their
names are fingerprints of everything that they depend on, so they are never out of date. A program may change constants
of alfmu while it runs: they count by their values.
"""

from __future__ import annotations

import hashlib
import json
import logging
import platform
import sys
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from importlib.metadata import version
from itertools import chain
from operator import is_
from pathlib import Path
from typing import Any, Self, TypeVar

from ..equations import Configuration, Equations, Mobility
from ..equations.evaluation import ARGUMENTS
from ..equations.types import Decision, Survey
from ..kernel.form import Plan, Program, Traced
from ..model.cache import is_off, kept, remember
from ..model.content import value_text
from ..model.kept import latest, outdate

_Made = TypeVar("_Made")

_WORTH = 0.05
"""Time [s] of a computation above which its result is stored."""

_MOST = 2**30
"""Largest size [bytes] of a file's unpacked content."""

_ROOMS = ("equations", "kernel", "method", "model", "runtime")
"""Rooms whose code scenes depend on."""

_DECIDING = ("runtime.pipeline", "runtime.probe")
"""Modules of `runtime` with constants on which scenes depend, besides those of the other rooms."""

_APART = ("equations.changes", "model.gallery", "model.sources")
"""Modules with constants on which no scene depends; they are loaded on demand."""

_LATER = ("functions", "signatures", "kept")
"""Fields of equations that do not affect a fingerprint: functions are added one by one, the others are derived."""

_FIELDS = [field.name for field in fields(Configuration) if field.name not in _LATER]

_SHARED = 200
"""Number of cached digests of fields and functions, for some four sets of equations."""

_DIGESTS: OrderedDict[int, tuple[Any, str]] = OrderedDict()

_LOGGER = logging.getLogger("alfmu")


@dataclass(frozen=True)
class Start:
    """Results of tracing a scene that are needed before its bytes."""

    decision: Decision
    survey: Survey
    programs: dict[str, Program]
    """Programs without their steps."""
    seen: int
    """Number of outputs readable at an instant."""
    tangents: bool
    """Whether the scene has the derivatives for implicit methods."""

    @classmethod
    def of(cls, e: Traced) -> Self:
        """Return the start of traced equations."""
        programs = {name: Program((), *_head(program)) for name, program in e.kernel.items()}
        seen = e.signatures["seen"]["outputs"][0][0]
        return cls(e.decision or Decision(""), e.survey, programs, seen, "tangents" in e.signatures)

    def written(self) -> bytes:
        """Return the start as bytes; see `read`."""
        programs = {name: [asdict(p.plan), *_head(p)[1:]] for name, p in self.programs.items()}
        return json.dumps({**asdict(self), "programs": programs}).encode()

    @classmethod
    def read(cls, content: bytes) -> Self:
        """Return the start written by `written`; raise ValueError, TypeError or KeyError for anything else."""
        data = json.loads(content)
        survey = data["survey"]
        survey["mobility"] = survey["mobility"] and Mobility(**survey["mobility"])
        survey["shared"] = None if survey["shared"] is None else tuple(survey["shared"])
        programs = {name: Program((), Plan(**plan), *more) for name, (plan, *more) in data["programs"].items()}
        return cls(Decision(**data["decision"]), Survey(**survey), programs, int(data["seen"]), bool(data["tangents"]))


def _head(program: Program) -> tuple[Any, ...]:
    return program.plan, program.rule, program.evaluations, program.nodes, program.history


def stored_decision(equations: Equations, make: Callable[[], Decision]) -> Decision:
    """Return the integrator for equations with their defaults, from the cache or decided now."""
    return _stored(
        *("decision", equations, make),
        *(lambda made: json.dumps(asdict(made)).encode(), lambda content: Decision(**json.loads(content))),
    )


def stored_start(equations: Equations, make: Callable[[], Start]) -> Start:
    """Return the start of equations without a decision, from the cache or made now."""
    return _stored("start", equations, make, Start.written, Start.read)


def stored_scene(equations: Traced, make: Callable[[], bytes]) -> bytes:
    """Return the scene file of traced equations, from the cache or made now."""
    return _stored("scene", equations, make, bytes, bytes)


def _stored(
    what: str,
    equations: Equations,
    make: Callable[[], _Made],
    written: Callable[[_Made], bytes],
    read: Callable[[bytes], _Made],
) -> _Made:
    """Return a result that follows from equations, from the cache or made now; a slow one is stored."""
    identity = None if is_off() else fingerprint(equations)
    if identity is None:
        return make()
    name = f"{what}_{identity}"
    if (found := _unpacked(kept(name, ".z"))) is not None:
        try:
            return read(found)
        except (ValueError, TypeError, KeyError) as error:
            _LOGGER.debug("%s in the cache cannot be read (%s); it is rebuilt", name, error)
    begin = time.perf_counter()
    made = make()
    if time.perf_counter() - begin > _WORTH:
        remember(name, ".z", zlib.compress(written(made), 1))
    return made


def _unpacked(path: Path | None) -> bytes | None:
    """Return the content of a file of the cache; None if there is none."""
    try:
        if path is not None:
            reader = zlib.decompressobj()
            content = reader.decompress(path.read_bytes(), _MOST)
            return content if reader.eof else None
    except (OSError, zlib.error) as error:
        _LOGGER.debug("%s cannot be read (%s)", path, error)
    return None


def fingerprint(equations: Equations) -> str | None:
    """Return a digest of everything on which a scene of these equations depends; None if it cannot be serialised."""
    e = equations
    known = [name for name in ARGUMENTS if name in e.functions]  # from which all others follow
    try:
        said = [_digest(getattr(e, name)) for name in _FIELDS if hasattr(e, name)]
        said += [f"{name} {_digest(e.functions[name])}" for name in known]
    except (TypeError, RuntimeError):
        return None
    return hashlib.sha256("\0".join([software(), constants(), *said]).encode()).hexdigest()[:32]


def _digest(value: Any) -> str:
    """Return a digest of a field or a function; cached if it cannot change and many equations may share it."""

    def made() -> tuple[Any, str]:
        text = value.serialize() if hasattr(value, "serialize") else value_text(value)
        return value, hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

    shared = isinstance(value, tuple) or hasattr(value, "serialize")
    return (latest(_DIGESTS, id(value), made, _SHARED) if shared else made())[1]


def constants() -> str:
    """Return a digest of the constants on which scenes depend; if one has changed, drop all cached results."""
    known = _constants()
    values = [space[name] for space, name in known.places]
    inside = chain.from_iterable(value.values() for value in values if type(value) is dict)
    every = [*values, *inside]
    if len(every) != len(known.values) or not all(map(is_, every, known.values)):
        if known.values:
            outdate()
        known.values[:] = every
        texts = {id(value): _text(value) for value in {id(value): value for value in values}.values()}
        known.digest = hashlib.sha256("\0".join(texts[id(value)] for value in values).encode()).hexdigest()
    return known.digest


@dataclass
class _Constants:
    """Places of constants in modules, and their values and digest when last read."""

    places: list[tuple[dict[str, Any], str]]
    values: list[Any]
    digest: str = ""


@cache
def _constants() -> _Constants:
    package = __package__.partition(".")[0]
    prefixes = tuple(f"{package}.{room}." for room in _ROOMS if room != "runtime")
    apart = {f"{package}.{name}" for name in _APART}
    names = {name for name in sys.modules if name.startswith(prefixes)} - apart
    names |= {f"{package}.{name}" for name in _DECIDING}
    spaces = [vars(sys.modules[name]) for name in sorted(names)]
    return _Constants([(space, name) for space in spaces for name in sorted(space) if _is_constant(space, name)], [])


def _is_constant(space: dict[str, Any], name: str) -> bool:
    """Return whether a name of a module is a constant: numbers, texts, or a collection of them.

    What grows in the course of a program is an `OrderedDict`.
    """
    value = space[name]
    plain = isinstance(value, int | float | str | tuple) or type(value) is dict
    return name.isupper() and (plain or (is_dataclass(value) and not isinstance(value, type)))


def _text(value: Any) -> str:
    try:
        return value_text(value)
    except TypeError:  # a table of functions, which count as code
        return type(value).__name__


@cache
def software() -> str:
    """Return a digest of the code that makes scenes, its dependencies and the kind of machine."""
    package = Path(__file__).parent.parent
    files = [path for room in _ROOMS for path in sorted((package / room).rglob("*.py"))]
    files += [*sorted(Path(__file__).parent.glob("alfmu-*")), *sorted(Path(__file__).parent.rglob("*.h"))]
    about = [version("casadi"), version("numpy"), platform.machine(), platform.system()]
    digest = hashlib.sha256(" ".join(about).encode())
    for path in files:
        digest.update(f"\0{path.relative_to(package)}\0".encode() + path.read_bytes())
    return digest.hexdigest()
