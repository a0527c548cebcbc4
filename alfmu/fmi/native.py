"""What is inside a native FMU: the C of the scene and the runtime, compiled for one platform or several."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..equations import Equations
from ..kernel.build import FLAGS, build, compiler, kept, version, whole
from ..model.errors import ExportError
from ..runtime import Instance

__all__ = ["OWN", "PLATFORMS", "checked", "content", "headers", "library", "may_brake", "platforms", "sources"]


@dataclass(frozen=True)
class Platform:
    """What a library is made for."""

    target: str
    """As zig names it."""
    suffix: str
    fmi3: str
    """Its folder in an FMU of FMI 3; that of FMI 2 is its name here."""


PLATFORMS = {
    "linux64": Platform("x86_64-linux-gnu.2.17", ".so", "x86_64-linux"),
    "win64": Platform("x86_64-windows-gnu", ".dll", "x86_64-windows"),
    "darwin64": Platform("x86_64-macos.11.0", ".dylib", "x86_64-darwin"),
    "aarch64-darwin": Platform("aarch64-macos.11.0", ".dylib", "aarch64-darwin"),
    "aarch64-linux": Platform("aarch64-linux-gnu.2.17", ".so", "aarch64-linux"),
}
"""Platforms that native FMUs can be compiled for."""

_HERE = {
    ("linux", "x86_64"): "linux64",
    ("linux", "aarch64"): "aarch64-linux",
    ("win32", "amd64"): "win64",
    ("darwin", "x86_64"): "darwin64",
    ("darwin", "arm64"): "aarch64-darwin",
}


def _own() -> str:
    import platform

    return _HERE.get((sys.platform, platform.machine().lower()), "")


OWN = _own()
"""This platform; empty where it is none of them."""

MOST = 200
"""Coordinates of a native FMU: the matrices of its start are dense."""


def checked(equations: Equations) -> None:
    """ExportError where a scene asks for what native FMUs do not have."""
    e, solver = equations, {"formulation": "residual", **equations.solver}
    if solver["formulation"] != "residual":
        what = f"solver.formulation {solver['formulation']}"
    elif e.n > MOST:
        what = f"more than {MOST} coordinates (here {e.n}; its start would take minutes)"
    else:
        return
    raise ExportError(f"{e.name}: a native FMU has no {what}; export it with --kind python, or without")


def may_brake(instance: Instance) -> bool:
    """Whether constraints that come into force may be redundant, so that they would stop the motion beside it."""
    e = instance.equations
    everything = np.ones(e.l, bool)
    return bool(e.switches) and instance._assembly.mobility(instance.oracle.p, instance.q, everything).redundant > 0


def sources() -> dict[str, str]:
    """The C files of the runtime by name, the same in every FMU."""
    folder = Path(__file__).parents[1] / "runtime"
    return {path.name: path.read_text(encoding="ascii") for path in sorted(folder.glob("*.[ch]"))}


def library(scene: str, platform: str) -> bytes:
    """The compiled library for a platform, from the user's cache where it has been built before."""
    command, files = _command(scene, platform), sources()
    flags = ["-O2", *FLAGS, "-std=c99", "-fvisibility=hidden", "-DNDEBUG"]
    identity = "\0".join([*files, *files.values(), *command, version(command), *flags])
    name, suffix = f"native_{hashlib.sha256(identity.encode()).hexdigest()[:32]}", PLATFORMS[platform].suffix
    command = [*command, *flags, f"-I{headers()}"]
    return content(scene, kept(name, suffix) or build(scene, command, files, name, suffix, "use --kind python"))


def content(scene: str, path: Path) -> bytes:
    """The bytes of a library in the cache, as they were built."""
    if (found := whole(path)) is None:
        raise ExportError(f"{scene}: the library {path} was damaged a moment ago; try again")
    return found


def platforms(scene: str, names: Iterable[str]) -> list[str]:
    """Names of platforms; `all` stands for every one, none for this one."""
    names = list(names) or [OWN]
    names = list(PLATFORMS) if names == ["all"] else names
    if unknown := [name for name in names if name not in PLATFORMS]:
        raise ExportError(
            f"{scene}: there is no platform {unknown[0]!r} for native FMUs; use {', '.join(PLATFORMS)} or all"
        )
    return names


def _command(scene: str, platform: str) -> list[str]:
    """The compiler: the system's where the platform is this one, zig for the others."""
    found = compiler() if platform == OWN else None
    if found is None and importlib.util.find_spec("ziglang"):
        found = [sys.executable, "-m", "ziglang", "cc"]
    if found is None:
        raise ExportError(
            f"{scene}: no C compiler found for {platform}; pip install ziglang"
            + (", or a C compiler" if platform == OWN else "")
        )
    return [*found, "-target", PLATFORMS[platform].target] if "ziglang" in found else found


def headers() -> Path:
    """Where the headers of FMI are."""
    import fmpy

    return Path(fmpy.__file__).parent / "c-code"
