"""Libraries of the runtime for other machines than this one: those that alfmu came with, others by zig."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..model.errors import ExportError
from ..model.files import write
from . import build
from .build import HERE, WEB, file_name

__all__ = ["library", "there"]


def there(name: str) -> Path:
    """Where the library of a platform, or of browsers, is if alfmu came with it."""
    return Path(build.__file__).with_name(file_name(name))


def library(name: str, scene: str) -> bytes:
    """The library of a platform, or of browsers, with which alfmu came or which zig builds now.

    Raises ExportError, on behalf of a scene, where it cannot be built.
    """
    return (there(name) if there(name).is_file() else _built(scene, name)).read_bytes()


def _built(scene: str, name: str) -> Path:
    """The library of another platform, kept in the user's cache under a hash of its sources and one of its own."""
    from platformdirs import user_cache_path

    texts = [path.read_text(encoding="ascii") for path in (Path(build.__file__), *build.sources())]
    identity = hashlib.sha256("\0".join([name, *texts]).encode()).hexdigest()[:32]
    path = user_cache_path("alfmu", appauthor=False) / f"runtime_{identity}{Path(file_name(name)).suffix}"
    proof = path.with_suffix(".sha256")
    if path.is_file() and proof.is_file() and proof.read_text() == hashlib.sha256(path.read_bytes()).hexdigest():
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        build.build(name, path)
        write(proof, hashlib.sha256(path.read_bytes()).hexdigest().encode())
    except (OSError, RuntimeError) as error:
        where = {HERE: "", WEB: " for browsers"}.get(name, f" for {name}")
        otherwise = "install alfmu[compiler]" if name == WEB else "leave the platform out"
        raise ExportError(f"{scene}: the runtime{where} cannot be built ({error}); {otherwise}") from error
    return path
