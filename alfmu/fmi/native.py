"""The C library of the runtime inside FMUs: libraries shipped with alfmu, and others that zig builds."""

import re
import zipfile
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from ..equations import Equations
from ..equations.evaluation import DENSE
from ..equations.interface import default_settings
from ..kernel.alternatives import formulations
from ..kernel.complete import complete
from ..kernel.exchange import obstacle
from ..kernel.form import Traced
from ..kernel.tables import number_of
from ..model.errors import ExportError
from ..model.settings import Settings
from ..runtime import build
from ..runtime.build import PLATFORMS, file_name
from ..runtime.embedding import with_scene
from ..runtime.pipeline import packed
from ..runtime.shipped import library, there
from .reached import reached, undeclared

WASM = "wasm32"
"""The platform of an FMU whose runtime is a component of WebAssembly, by the draft of FMI-LS-WASM."""

_LAYER = "org.modelica.fmi-ls-wasm"
_MANIFEST = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiLayeredStandardManifest xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name="{_LAYER}"
 fmi-ls:fmi-ls-version="0.1.0" fmi-ls:fmi-ls-description="FMI Layered Standard for WebAssembly"/>
"""


@dataclass(frozen=True)
class Feature:
    """A part of the runtime that only some scenes need."""

    what: str
    files: tuple[str, ...]
    """The files of this part. Without them, headers that other files include declare functions that do nothing."""
    needed: Callable[[Traced], object]


_KEPT = {"adjoint.h", "gradient.h", "interface_jacobian.h"}
"""Headers of `derivatives` that also serve a runtime without derivatives."""

FEATURES = {
    "FRICTION": Feature(
        "dry friction that follows from the load", ("friction.c", "friction_events.c"), lambda e: e.frictions
    ),
    "MOVING_INPUTS": Feature(
        "inputs that prescribe motion", ("driving_inputs.c", "input_derivatives.c"), lambda e: e.followed
    ),
    "LIMITS": Feature("limits at singular positions", ("way.c",), lambda e: e.l),
    "SWITCHES": Feature("Boolean inputs and impacts", ("topology.c",), lambda e: e.switches),
    "BREAKS": Feature(
        "forces, laws and rates with jumps or kinks", ("breaks.c",), lambda e: number_of(packed(e), "break_count")
    ),
    "LAWS": Feature("laws of motion that may jump", ("jumps.c",), lambda e: e.leaps),
    "PEAKS": Feature("peaks of outputs within a step", ("peaks.c",), lambda e: e.peaks),
    "ERROR_CONTROL": Feature("integrators with error control", ("adaptive.c",), lambda e: "method" in e.kernel),
    "MODEL_EXCHANGE": Feature(
        "Model Exchange", ("exchange.c", "model_exchange.c"), lambda e: not obstacle(complete(e))
    ),
    "INTERFACE_JACOBIAN": Feature("the interface Jacobian", ("interface_jacobian.c",), lambda e: e.jacobian),
    "DERIVATIVES": Feature(
        "directional derivatives",
        ("record.c", "instant_derivatives.c", *sorted({path.name for path in build.sources(["derivatives"])} - _KEPT)),
        lambda e: e.jacobian,
    ),
}
"""Parts of the runtime, by their names in C, that a native FMU omits if its scene does not need them."""


def left_out(equations: Traced, derivatives: bool = True, exchange: bool = True) -> list[str]:
    """Return the features that traced equations do not need, or that the arguments exclude."""
    asked, unasked = {"DERIVATIVES"} if derivatives else (), () if exchange else {"MODEL_EXCHANGE"}
    return [
        name
        for name, feature in FEATURES.items()
        if name not in asked and (name in unasked or not feature.needed(equations))
    ]


def checked(equations: Equations) -> None:
    """Raise ExportError if default settings of the equations are not available in FMUs."""
    e, chosen = equations, default_settings(equations)
    known = formulations(e)
    if chosen.formulation not in known:
        what = f"solver.formulation {chosen.formulation} of more than {DENSE} coordinates; use {', '.join(known)}"
    elif e.l and chosen.formulation != Settings.formulation and chosen.method not in ("auto", "rk4"):
        what = f"solver.method {chosen.method} with solver.formulation {chosen.formulation}; use solver.method rk4"
    else:
        return
    raise ExportError(f"{e.name}: an FMU has no {what}")


def sources(
    fmi: int, without: Container[str] = (), instead: Mapping[str, str] = MappingProxyType({})
) -> dict[str, str]:
    """Return the C files by name: one header, one file, and one for files of the system, without these features.

    They have no comments, and leave out `binding` and the functions of the other version of FMI. The texts `instead`
    replace those of files; for plain C (`fmi` 0) they contain `plain.c`, which comes last.
    """
    absent = {file for name, feature in FEATURES.items() if name in without for file in feature.files}
    paths = [path for path in build.sources(_FOLDERS) if path.name not in absent]
    files = {path.name: path.read_text(encoding="ascii") for path in paths} | dict(instead)
    files = {name: _without_comments(text).replace("#pragma once\n", "") for name, text in files.items()}
    headers = {name for name in files if name.endswith(".h")} - {_TYPES}
    text = "".join(f"#define WITHOUT_{name}\n" for name in FEATURES if name in without)
    text += _with_headers("".join(f'#include "{name}"\n' for name in sorted(headers)), files, set())
    own = [path.name for path in paths if path.suffix == ".c" and path.name not in _APART]
    system = {line for name in own for line in _SYSTEM.findall(files[name])}
    bodies = "".join(_INCLUDE.sub("", _SYSTEM.sub("", files[name])) for name in own)
    last = _with_headers(files[f"fmi{fmi}.c" if fmi else "plain.c"], files, set(headers))
    apart = _with_headers(files["files.c"], files, set(headers))
    found = {
        "alfmu.h": text,
        "files.c": apart.replace("#include <", f"{_HEADER}#include <", 1),
        "alfmu.c": "".join([_HEADER, *sorted(system), _hidden(bodies), last]),
    }
    if not instead:
        found["alfmu.c"] = _IN_SOURCES.sub("", found["alfmu.c"])
    for name in ("alfmu.h", "alfmu.c"):
        found[name] = _FEATURE.sub(lambda each: each[3 if each[1] in without else 2], found[name])
    return found


_HEADER = '#include "alfmu.h"\n'


def _hidden(text: str) -> str:
    """Return C whose functions are visible within the library only, for importers that compile it without options."""
    pragma = "#if defined(__GNUC__) && !defined(_WIN32)\n#pragma GCC visibility {}\n#endif\n"
    return pragma.format("push(hidden)") + text + pragma.format("pop")


def used(files: Mapping[str, str]) -> dict[str, str]:
    """Return the C files of an FMU without functions, constants and macros that nothing in them uses."""
    header, include, text = _used(files["alfmu.h"] + files["alfmu.c"], files["files.c"]).partition(_HEADER)
    return {**files, "alfmu.h": header, "alfmu.c": include + text}


@lru_cache(10)
def _used(text: str, by: str) -> str:
    """Return a text without what neither it nor another one uses."""
    apart = set(re.findall(r"\w+", by))
    pieces = reached(text, lambda name: name in apart or name.startswith(("fmi2", "fmi3")))
    return "".join(piece for _, piece in undeclared(pieces, apart))


_TYPES = "fmi.h"
"""Header with the types of FMI, left out because hosts that compile these files have their own."""

_FOLDERS = tuple(each for each in build.FOLDERS if each != "binding")
"""Folders of the runtime that an FMU needs."""

_APART = ("files.c", "fmi2.c", "fmi3.c")
"""Files that come last or apart, because system headers and the two versions of FMI share names."""

_FEATURE = re.compile(r"^#ifndef WITHOUT_(\w+)\n(.*?)^#else\n(.*?)^#endif\n", re.MULTILINE | re.DOTALL)
"""Matches the alternative declarations in a header, with its feature and without it."""

_IN_SOURCES = re.compile(r"^#ifdef IN_SOURCES\n.*?^#endif\n", re.MULTILINE | re.DOTALL)
"""Matches what only files of kind source have."""

_INCLUDE = re.compile(r'^#include "([^"]+)"\n', re.MULTILINE)
_SYSTEM = re.compile(r"^#include <[^>]+>\n", re.MULTILINE)


def _with_headers(text: str, headers: Mapping[str, str], there: set[str]) -> str:
    """Return a text with each header in place of its first inclusion."""

    def header(found: re.Match[str]) -> str:
        name = found[1]
        if name in there:
            return ""
        there.add(name)
        return _with_headers(headers[name], headers, there)

    return _INCLUDE.sub(header, text)


_COMMENT = re.compile(r"""("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')|/\*.*?\*/""", re.DOTALL)
"""A comment, or (as a group) a string or character literal."""


@lru_cache(200)  # more than there are files, of which all are read in turn
def _without_comments(text: str) -> str:
    """Return a text without comments and empty lines, indented by tabs, so that archives are smaller."""
    kept, end = list[str](), 0
    for found in _COMMENT.finditer(text):
        if not found[1]:
            kept.append(text[end : found.start()].rstrip(" \t"))
            end = found.end()
    made = []
    for line in " ".join([*kept, text[end:]]).splitlines():
        if bare := line.strip():
            margin = len(line) - len(line.lstrip())
            made.append("\t" * (margin // 4) + " " * (margin % 4) + bare + "\n")
    return "".join(made).lstrip()


def platforms(scene: str, names: Iterable[str]) -> list[str]:
    """Return names of platforms; by default those whose libraries are shipped, and every one for `all`."""
    names = list(names) or [name for name in PLATFORMS if there(name).is_file()]
    names = list(PLATFORMS) if names == ["all"] else names
    if unknown := [name for name in names if name not in PLATFORMS and name != WASM]:
        raise ExportError(
            f"{scene}: there is no platform {unknown[0]!r} for native FMUs; use {', '.join(PLATFORMS)}, {WASM} or all"
        )
    return names


def libraries(scene: str, names: Iterable[str], fmi: int = 0) -> dict[str, bytes]:
    """Return the library of each platform for a version of FMI or for Python (0), shipped with alfmu or built by
    zig."""
    return {name: library(name, scene, fmi) for name in names}


def component(name: str, scene: bytes) -> dict[str, bytes]:
    """Return the files by which an FMU runs as WebAssembly; the component contains the scene."""
    binary = with_scene(library(build.COMPONENT, name), scene)
    return {
        f"binaries/{build.COMPONENT}/{name}.wasm": binary,
        f"extra/{_LAYER}/manifest.xml": _MANIFEST.encode(),
    }


def libraries_in(path: Path, kind: str) -> dict[str, str]:
    """Return the platforms for which an FMU of a kind has the runtime, each with the version of glibc that it needs."""
    with zipfile.ZipFile(path) as archive:
        files = archive.namelist()

        def of(name: str, fmi3: str) -> str | None:
            if kind == "python":  # the folder `binaries` contains libraries of pythonfmu
                return next((each for each in files if each == f"resources/{file_name(name)}"), None)
            places = tuple(f"binaries/{each}/" for each in (name, fmi3))
            return next((each for each in files if each.startswith(places)), None)

        folders = {**{name: platform.fmi3 for name, platform in PLATFORMS.items()}, WASM: build.COMPONENT}
        there = {name: of(name, fmi3) for name, fmi3 in folders.items()}
        return {name: build.needed(archive.read(file)) for name, file in there.items() if file}
