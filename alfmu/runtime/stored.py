"""Scenes in the cache folder: what starts and runs a mechanism without tracing its equations again.

Three files belong to equations: the method of integration, what else tracing finds (`Start`), and the bytes of the
scene. The name of each is a fingerprint of everything that it depends on, so that none is ever out of date.
"""

from __future__ import annotations

import hashlib
import json
import logging
import platform
import time
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self, TypeVar

from ..equations import Configuration, Equations, Mobility
from ..equations.evaluation import ARGUMENTS, EVALUATED
from ..equations.types import Decision, Survey
from ..kernel.form import Plan, Program, Traced
from ..model.cache import is_off, kept, remember
from ..model.content import told

__all__ = ["Start", "fingerprint", "software", "stored_decision", "stored_scene", "stored_start"]

_Made = TypeVar("_Made")

_WORTH = 0.05
"""Time [s] that something takes to make from which on it is kept."""

_MOST = 2**30
"""Size [bytes] of a file's content up to which it is unpacked."""

_ROOMS = ("equations", "kernel", "method", "model", "runtime")
"""Rooms whose code scenes depend on."""

_LATER = ("functions", "signatures", "kept")
"""Fields that a fingerprint leaves out: functions are added one by one, the rest follows from them."""

_FIELDS = [field.name for field in fields(Configuration) if field.name not in _LATER]

_LOGGER = logging.getLogger("alfmu")


@dataclass(frozen=True)
class Start:
    """What tracing decides and finds of a scene before there are bytes."""

    decision: Decision
    survey: Survey
    programs: dict[str, Program]
    """Without their steps."""
    seen: int
    """Length of what can be read at an instant."""
    tangents: bool
    """Whether the scene has the derivatives that implicit methods need."""

    @classmethod
    def of(cls, e: Traced) -> Self:
        """Return that of traced equations."""
        programs = {name: Program((), *_head(program)) for name, program in e.kernel.items()}
        seen = e.signatures["seen"]["outputs"][0][0]
        return cls(e.decision or Decision(""), e.survey, programs, seen, "tangents" in e.signatures)

    def written(self) -> bytes:
        """Return it as bytes; see `read`."""
        programs = {name: [asdict(p.plan), *_head(p)[1:]] for name, p in self.programs.items()}
        return json.dumps({**asdict(self), "programs": programs}).encode()

    @classmethod
    def read(cls, content: bytes) -> Self:
        """Return what `written` has written; raise ValueError, TypeError or KeyError if it is something else."""
        data = json.loads(content)
        survey = data["survey"]
        survey["mobility"] = survey["mobility"] and Mobility(**survey["mobility"])
        survey["shared"] = None if survey["shared"] is None else tuple(survey["shared"])
        programs = {name: Program((), Plan(**plan), *more) for name, (plan, *more) in data["programs"].items()}
        return cls(Decision(**data["decision"]), Survey(**survey), programs, int(data["seen"]), bool(data["tangents"]))


def _head(program: Program) -> tuple[Any, ...]:
    return program.plan, program.rule, program.evaluations, program.nodes, program.history


def stored_decision(equations: Equations, make: Callable[[], Decision]) -> Decision:
    """Return the method of integration of equations with their defaults, from the cache or decided now."""
    return _stored(
        *("decision", equations, make),
        *(lambda made: json.dumps(asdict(made)).encode(), lambda content: Decision(**json.loads(content))),
    )


def stored_start(equations: Equations, make: Callable[[], Start]) -> Start:
    """Return the start of equations that are not decided, from the cache or made now."""
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
    """Return something that follows from equations, from the cache or made now; it is kept if that takes long."""
    identity = None if is_off() else fingerprint(equations)
    if identity is None:
        return make()
    name = f"{what}_{identity}"
    if (found := _unpacked(kept(name, ".z"))) is not None:
        try:
            return read(found)
        except (ValueError, TypeError, KeyError) as error:
            _LOGGER.debug("%s in the cache cannot be read (%s); it is made again", name, error)
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
    """Return a digest of everything that a scene of these equations depends on; None if it has no text."""
    e = equations
    known = [name for name in dict.fromkeys([*ARGUMENTS, *EVALUATED]) if name in e.functions and name != "tangents"]
    try:
        said = [told(getattr(e, name)) for name in _FIELDS if hasattr(e, name)]
        said += [f"{name} {e.functions[name].serialize()}" for name in known]
    except (TypeError, RuntimeError):
        return None
    return hashlib.sha256("\0".join([software(), *said]).encode("utf-8", "surrogatepass")).hexdigest()[:32]


@cache
def software() -> str:
    """Return a digest of the code that makes scenes, with what it builds on and the kind of the machine."""
    package = Path(__file__).parent.parent
    files = [path for room in _ROOMS for path in sorted((package / room).rglob("*.py"))]
    files += [*sorted(Path(__file__).parent.glob("alfmu-*")), *sorted(Path(__file__).parent.rglob("*.h"))]
    about = [version("casadi"), version("numpy"), platform.machine(), platform.system()]
    digest = hashlib.sha256(" ".join(about).encode())
    for path in files:
        digest.update(f"\0{path.relative_to(package)}\0".encode() + path.read_bytes())
    return digest.hexdigest()
