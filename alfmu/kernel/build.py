"""Compile a scene's C into a shared library, kept in the user's cache folder under the hash of its content."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from ..equations import Equations
from ..model.errors import ExportError
from .compiled import Library
from .emit import sources
from .program import SUFFIX

__all__ = ["FLAGS", "build", "cache", "compiled", "compiler", "version"]

FLAGS = ("-fno-math-errno", "-ffp-contract=off", "-fPIC")
"""`-ffp-contract=off`: the same operations as in the virtual machine, so the same numbers."""


def compiler() -> list[str] | None:
    """The command of a C compiler: CC of the environment, the system's, or ziglang's; None where there is none."""
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return [found]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    return None


def cache() -> Path:
    """The folder where compiled kernels are kept."""
    from platformdirs import user_cache_path

    return user_cache_path("alfmu", appauthor=False)


def compiled(equations: Equations) -> Equations:
    """The same equations with their functions as a library, from the cache or built now.

    Several processes may build the same one at a time: each writes a file of its own, and moves it into place whole.
    Raises ExportError where there is no compiler, or where it fails.
    """
    e, command = equations, compiler()
    if command is None:
        raise ExportError(
            f"{e.name}: no C compiler found for a compiled kernel; install one (or `pip install ziglang`), "
            "or use --kernel vm"
        )
    files, workspace = sources(e)
    # On long straight-line code the higher level takes twice the time and gains nothing.
    flags = ["-O2" if len(files) == 1 else "-O1", *FLAGS]
    identity = "\0".join([*files, *command, version(command), *flags])
    name = f"kernel_{hashlib.sha256(identity.encode()).hexdigest()[:32]}"
    path = cache() / (name + SUFFIX)
    if not path.is_file():
        named = {f"kernel{i}.c": text for i, text in enumerate(files)}
        build(e.name, [*command, *flags], named, path, "use --kernel vm")
    e = replace(e, workspace=workspace)
    return replace(e, library=Library(path, e))


def build(scene: str, command: list[str], files: Mapping[str, str], path: Path, otherwise: str) -> None:
    """Compile files (headers among them) into the shared library at `path`; `otherwise` says what else can be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="alfmu_") as folder:
            for name, text in files.items():
                (Path(folder) / name).write_text(text, encoding="ascii")

            def compile_one(name: str) -> str:
                _run(scene, [*command, "-c", name, "-o", f"{name}.o"], folder, otherwise)
                return f"{name}.o"

            with ThreadPoolExecutor(os.cpu_count()) as pool:
                objects = list(pool.map(compile_one, (name for name in files if name.endswith(".c"))))
            _run(scene, [*command, "-shared", "-s", *objects, "-o", "kernel", "-lm"], folder, otherwise)
            partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
            shutil.copyfile(Path(folder) / "kernel", partial)
            partial.replace(path)
    except OSError as error:
        raise ExportError(f"{scene}: cannot build the kernel at {path} ({error.strerror}); {otherwise}") from error


def _run(scene: str, command: list[str], folder: str, otherwise: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["no message"])[0]
        raise ExportError(f"{scene}: the C compiler {command[0]} failed ({why}); {otherwise}")


def version(command: list[str]) -> str:
    try:
        return subprocess.run([*command, "--version"], capture_output=True, text=True, check=False).stdout
    except OSError as error:
        raise ExportError(
            f"the C compiler {command[0]} cannot be run ({error.strerror}); set CC, or unset it"
        ) from None
