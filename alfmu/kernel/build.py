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
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from ..equations import Equations
from ..errors import ExportError
from .compiled import Library
from .emit import sources
from .program import SUFFIX

__all__ = ["cache", "compiled", "compiler"]

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
    identity = "\0".join([*files, *command, _version(command), *flags])
    name = f"kernel_{hashlib.sha256(identity.encode()).hexdigest()[:32]}"
    path = cache() / (name + SUFFIX)
    if not path.is_file():
        _build(e.name, [*command, *flags], files, path)
    e = replace(e, workspace=workspace)
    return replace(e, library=Library(path, e))


def _build(scene: str, command: list[str], files: list[str], path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="alfmu_") as folder:

            def compile_one(i: int) -> str:
                (Path(folder) / f"kernel{i}.c").write_text(files[i], encoding="ascii")
                _run(scene, [*command, "-c", f"kernel{i}.c", "-o", f"kernel{i}.o"], folder)
                return f"kernel{i}.o"

            with ThreadPoolExecutor(os.cpu_count()) as pool:
                objects = list(pool.map(compile_one, range(len(files))))
            _run(scene, [*command, "-shared", "-s", *objects, "-o", "kernel", "-lm"], folder)
            partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
            shutil.copyfile(Path(folder) / "kernel", partial)
            partial.replace(path)
    except OSError as error:
        raise ExportError(f"{scene}: cannot build the kernel at {path} ({error.strerror}); use --kernel vm") from error


def _run(scene: str, command: list[str], folder: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["no message"])[0]
        raise ExportError(f"{scene}: the C compiler {command[0]} failed ({why}); use --kernel vm")


def _version(command: list[str]) -> str:
    try:
        return subprocess.run([*command, "--version"], capture_output=True, text=True, check=False).stdout
    except OSError as error:
        raise ExportError(
            f"the C compiler {command[0]} cannot be run ({error.strerror}); set CC, or unset it"
        ) from None
