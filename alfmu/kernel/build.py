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
from dataclasses import replace
from pathlib import Path

from ..equations import Equations
from ..errors import ExportError
from .compiled import Library
from .emit import source
from .program import SUFFIX

__all__ = ["cache", "compiled", "compiler"]

FLAGS = ("-O2", "-fno-math-errno", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared", "-s", "-w")
"""`-ffp-contract=off`: the same operations as in the virtual machine, so the same numbers."""

LONG = 20_000_000
"""Characters of source above which less optimisation is asked for."""


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
    text, workspace = source(e)
    identity = "\0".join([text, *command, _version(command), *FLAGS])
    name = f"kernel_{hashlib.sha256(identity.encode()).hexdigest()[:32]}"
    path = cache() / (name + SUFFIX)
    if not path.is_file():
        _build(e.name, command, text, path)
    e = replace(e, workspace=workspace)
    return replace(e, library=Library(path, e))


def _build(scene: str, command: list[str], text: str, path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="alfmu_") as folder:
            (Path(folder) / "kernel.c").write_text(text, encoding="ascii")
            flags = ["-O1" if flag == "-O2" and len(text) > LONG else flag for flag in FLAGS]
            made = Path(folder) / f"kernel{SUFFIX}"
            done = subprocess.run(
                [*command, *flags, "kernel.c", "-o", made.name, "-lm"],
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                why = (done.stderr.strip().splitlines() or ["no message"])[0]
                raise ExportError(f"{scene}: the C compiler {command[0]} failed ({why}); use --kernel vm")
            partial = path.with_name(f".{path.name}.{os.getpid()}.{id(text)}")
            shutil.copyfile(made, partial)
            partial.replace(path)
    except OSError as error:
        raise ExportError(f"{scene}: cannot build the kernel at {path} ({error.strerror}); use --kernel vm") from error


def _version(command: list[str]) -> str:
    try:
        return subprocess.run([*command, "--version"], capture_output=True, text=True, check=False).stdout
    except OSError as error:
        raise ExportError(
            f"the C compiler {command[0]} cannot be run ({error.strerror}); set CC, or unset it"
        ) from None
