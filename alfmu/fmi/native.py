"""The C library of the runtime inside FMUs: those that alfmu came with, others by zig."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..equations import Equations
from ..equations.evaluation import DENSE
from ..equations.interface import default_settings
from ..kernel.alternatives import formulations
from ..model.errors import ExportError
from ..model.settings import Settings
from ..runtime import build
from ..runtime.build import PLATFORMS, file_name
from ..runtime.shipped import library, there

__all__ = ["PLATFORMS", "checked", "file_name", "libraries", "libraries_in", "platforms", "sources"]


def checked(equations: Equations) -> None:
    """ExportError where a scene asks for what no FMU has."""
    e, chosen = equations, default_settings(equations)
    known = formulations(e)
    if chosen.formulation not in known:
        what = f"solver.formulation {chosen.formulation} of more than {DENSE} coordinates; use {', '.join(known)}"
    elif e.l and chosen.formulation != Settings.formulation and chosen.method not in ("auto", "rk4"):
        what = f"solver.method {chosen.method} with solver.formulation {chosen.formulation}; use solver.method rk4"
    else:
        return
    raise ExportError(f"{e.name}: an FMU has no {what}")


def sources(fmi: int) -> dict[str, str]:
    """The C files by name, the same in every FMU of a version: one header, and one file per folder of the runtime.

    They have no comments, and neither `binding` nor the functions of the other version of FMI.
    """
    files = {path.name: _without_comments(path.read_text(encoding="ascii")) for path in build.sources(_FOLDERS)}
    headers = {name for name in files if name.endswith(".h")} - {_TYPES}
    found = {"alfmu.h": _with_headers("".join(f'#include "{name}"\n' for name in sorted(headers)), files, set())}
    for folder in _FOLDERS:
        own = [path.name for path in build.sources([folder]) if path.suffix == ".c" and path.name not in _APART]
        system = {line for name in own for line in _SYSTEM.findall(files[name])}
        bodies = "".join(_INCLUDE.sub("", _SYSTEM.sub("", files[name])) for name in own)
        found[f"{folder}.c"] = "".join(['#include "alfmu.h"\n', *sorted(system), bodies])
    for name in ("files.c", f"fmi{fmi}.c"):
        text = _with_headers(files[name], files, set(headers))
        found[name] = text.replace("#include <", '#include "alfmu.h"\n#include <', 1)
    return found


_TYPES = "fmi.h"
"""Types of FMI, which hosts that compile these files have in headers of their own: in no header here."""

_FOLDERS = tuple(each for each in build.FOLDERS if each != "binding")
"""Folders of the runtime that an FMU needs."""

_APART = ("files.c", "fmi2.c", "fmi3.c")
"""Files that stay files of their own, as headers of the system and the two versions of FMI share names."""

_INCLUDE = re.compile(r'^#include "([^"]+)"\n', re.MULTILINE)
_SYSTEM = re.compile(r"^#include <[^>]+>\n", re.MULTILINE)


def _with_headers(text: str, headers: Mapping[str, str], there: set[str]) -> str:
    """A text with each header in place of its first inclusion."""

    def header(found: re.Match[str]) -> str:
        name = found[1]
        if name in there:
            return ""
        if not name.startswith("internal_"):  # which stand where declarations begin and end, each time
            there.add(name)
        return _with_headers(headers[name], headers, there)

    return _INCLUDE.sub(header, text)


_COMMENT = re.compile(r"""("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')|[ \t]*/\*.*?\*/""", re.DOTALL)
"""A comment with the space before it, or (as a group) what is none."""


def _without_comments(text: str) -> str:
    return re.sub(r"[ \t]*\n\s*\n|[ \t]+\n", "\n", _COMMENT.sub(lambda found: found[1] or " ", text)).lstrip()


def platforms(scene: str, names: Iterable[str]) -> list[str]:
    """Names of platforms: those that alfmu came with where none is asked for; `all` stands for every one."""
    names = list(names) or [name for name in PLATFORMS if there(name).is_file()]
    names = list(PLATFORMS) if names == ["all"] else names
    if unknown := [name for name in names if name not in PLATFORMS]:
        raise ExportError(
            f"{scene}: there is no platform {unknown[0]!r} for native FMUs; use {', '.join(PLATFORMS)} or all"
        )
    return names


def libraries(scene: str, names: Iterable[str]) -> dict[str, bytes]:
    """The library of each platform, with which alfmu came or which zig builds now."""
    return {name: library(name, scene) for name in names}


def libraries_in(path: Path, kind: str) -> dict[str, str]:
    """The platforms for which an FMU of a kind carries the runtime, with the version of glibc that it needs there."""
    with zipfile.ZipFile(path) as archive:
        files = archive.namelist()

        def of(name: str, fmi3: str) -> str | None:
            if kind == "python":  # its binaries are pythonfmu's
                return next((each for each in files if each == f"resources/{file_name(name)}"), None)
            folders = tuple(f"binaries/{each}/" for each in (name, fmi3))
            return next((each for each in files if each.startswith(folders)), None)

        there = {name: of(name, platform.fmi3) for name, platform in PLATFORMS.items()}
        return {name: build.needed(archive.read(file)) for name, file in there.items() if file}
