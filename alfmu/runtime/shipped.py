"""Libraries of the runtime: those in this installation, others built by zig."""

from __future__ import annotations

import hashlib
from ctypes import CDLL
from functools import cache
from pathlib import Path

from ..kernel import VERSION
from ..model.cache import keep, kept
from ..model.errors import ExportError, LibraryError
from ..model.files import scratch
from . import build
from . import library as binding
from .build import COMPONENT, HERE, WEB, file_name


@cache
def installed() -> CDLL:
    """Return the library that runs scenes on this machine.

    Raises LibraryError if there is none, or if it was not built from the sources of the package.
    """
    try:
        found = binding.library()
        version = found.alfmu_scene_version()
        why = f"its scenes have version {version}, and those of the package {VERSION}" if version != VERSION else ""
    except AttributeError as error:
        why = str(error)
    except OSError as error:
        raise LibraryError(str(error)) from None
    if why:
        built = Path(build.__file__)
        raise LibraryError(
            f"the library {built.with_name(file_name(HERE))} was built from other sources than those of the package "
            f"({why}); build it again: python {built}"
        )
    return found


def lane_flags() -> list[str]:
    """Return the compiler's flags for functions in lanes on this processor; none if it has no lanes."""
    return installed().alfmu_lane_flags().decode().split()


def there(name: str, fmi: int = 0) -> Path:
    """Return the path of the library of a platform for a version of FMI or for Python (0), or for browsers, if it is
    installed."""
    return Path(build.__file__).with_name(file_name(name, fmi))


def library(name: str, scene: str, fmi: int = 0) -> bytes:
    """Return the library of a platform for a version of FMI or for Python (0), or for browsers, installed or built now
    by zig.

    Raises ExportError, with the name of the scene, if it cannot be built.
    """
    path = there(name, fmi)
    return (path if path.is_file() else _built(scene, name, fmi)).read_bytes()


def _built(scene: str, name: str, fmi: int) -> Path:
    """Return the library of another platform from the user's cache, built if its sources changed."""
    own = sorted((build.SOURCES / "wasm").iterdir()) if name == COMPONENT else []
    texts = [path.read_text(encoding="ascii") for path in (Path(build.__file__), *build.sources(), *own)]
    identity = hashlib.sha256("\0".join([file_name(name, fmi), *texts]).encode()).hexdigest()[:32]
    kept_as = f"runtime_{identity}", Path(file_name(name)).suffix
    if path := kept(*kept_as):
        return path
    try:
        with scratch() as folder:
            build.build(name, folder, [fmi])
            return keep(*kept_as, (folder / file_name(name, fmi)).read_bytes())
    except (OSError, RuntimeError) as error:
        where = {HERE: "", WEB: " for browsers"}.get(name, f" for {name}")
        otherwise = "install alfmu[compiler]" if name == WEB else "leave the platform out"
        raise ExportError(f"{scene}: the runtime{where} cannot be built ({error}); {otherwise}") from error
