"""Compile a scene's C into a shared library in the user's cache folder (`model.cache`)."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ..kernel.complete import complete
from ..kernel.form import Traced
from ..kernel.tables import HEAD, machine_code
from ..model.cache import keep, kept, whole
from ..model.errors import ExportError
from ..model.files import scratch
from .build import compiler
from .stored import software

FLAGS = ("-fno-math-errno", "-ffp-contract=off", "-fPIC")
"""`-ffp-contract=off` prevents fused operations, so that results equal those of the interpreter."""

_LANES = ("-fno-trapping-math", "-Wno-psabi")
"""Further flags of functions in lanes, whose choices become vectors without branches."""

HEADERS = [Path(__file__).parent / "c" / "core" / name for name in ("baseline.h", "sine_cosine.h")]
"""The header that is included first, so that compiled scenes run wherever the runtime does, and the one of sines and
cosines, which are those of the interpreter."""

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
"""Suffix of shared libraries on this system."""


def compiled_scene(equations: Traced, scene: bytes, lanes: Sequence[str] = ()) -> Path:
    """Return the compiled functions of a scene file of these equations, from the cache or built now; functions in lanes
    with the flags for these (`lane_flags`).

    Raises ExportError without a compiler, or if it fails.
    """
    if (command := compiler()) is None:
        raise ExportError(
            f"{equations.name}: no C compiler found for a compiled kernel; install one (or `pip install ziglang`), "
            "or use --kernel vm"
        )
    # A scene determines its C, which is written, and its functions traced, only if it has to be compiled.
    digest = hashlib.sha256("\0".join([software(), *command, version(command), *lanes]).encode())
    digest.update(scene[HEAD:])
    name = f"kernel_{digest.hexdigest()[:32]}"
    return kept(name, SUFFIX) or _built(equations.name, command, machine_code(complete(equations), scene), name, lanes)


def _built(scene: str, command: list[str], files: list[str], name: str, lanes: Sequence[str] = ()) -> Path:
    """Return the library of a scene's C from the cache, or build it."""
    # An optimisation level in CC applies. On long straight-line code the higher one takes twice the time and gains
    # nothing, but for vectors: without it, calls of the C library take ten times as long after them.
    usual = "-O2" if len(files) == 1 or lanes else "-O1"
    level = [x for x in command if x.startswith("-O")] or [usual]
    flags = [*level, *FLAGS, *lanes, *_LANES * bool(lanes), "-include", HEADERS[0].name]
    named = {header.name: header.read_text(encoding="ascii") for header in HEADERS}
    named |= {f"kernel{i}.c": text for i, text in enumerate(files)}
    return build(scene, [*command, *flags], named, name, SUFFIX, "use --kernel vm")


def verified(scene: str, path: Path) -> bytes:
    """Return the content of a library in the cache; raise ExportError if it was modified."""
    if (content := whole(path)) is None:
        raise ExportError(f"{scene}: the library {path} was damaged a moment ago; try again")
    return content


def build(scene: str, command: list[str], files: Mapping[str, str], name: str, suffix: str, otherwise: str) -> Path:
    """Compile files, including headers, into a shared library in the cache; `otherwise` names the alternatives in an
    error."""
    try:
        with scratch() as folder:
            for each, text in files.items():
                (folder / each).write_text(text, encoding="ascii")

            def compile_one(each: str) -> str:
                return _run(scene, [*command, "-c", each], f"{each}.o", folder, otherwise)

            with ThreadPoolExecutor(os.cpu_count()) as pool:
                objects = list(pool.map(compile_one, (each for each in files if each.endswith(".c"))))
            linked = _run(scene, [*command, "-shared", "-s", *objects, "-lm"], "kernel", folder, otherwise)
            return keep(name, suffix, (folder / linked).read_bytes())
    except OSError as error:
        why = error.strerror or error
        raise ExportError(f"{scene}: cannot build the kernel ({why}); {otherwise}") from error


def _run(scene: str, command: list[str], made: str, folder: Path, otherwise: str) -> str:
    """Compile or link in a folder; return the name of the output file."""
    done = subprocess.run([*command, "-o", made], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode or not (folder / made).is_file():
        said = done.stderr.strip().splitlines() or ["no message" if done.returncode else "it writes no file"]
        raise ExportError(f"{scene}: the C compiler {command[0]} failed ({said[0]}); {otherwise}")
    return made


def version(command: list[str]) -> str:
    try:
        return subprocess.run([*command, "--version"], capture_output=True, text=True, check=False).stdout
    except OSError as error:
        raise ExportError(
            f"the C compiler {command[0]} cannot be run ({error.strerror}); set CC, or unset it"
        ) from None
