"""Libraries of the runtime for other machines than this one: those that alfmu came with, others by zig."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..model.cache import keep, kept
from ..model.errors import ExportError
from ..model.files import scratch
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
    """The library of another platform, kept in the user's cache under a hash of its sources."""
    texts = [path.read_text(encoding="ascii") for path in (Path(build.__file__), *build.sources())]
    identity = hashlib.sha256("\0".join([name, *texts]).encode()).hexdigest()[:32]
    kept_as = f"runtime_{identity}", Path(file_name(name)).suffix
    if path := kept(*kept_as):
        return path
    try:
        with scratch() as folder:
            made = folder / file_name(name)
            build.build(name, made)
            return keep(*kept_as, made.read_bytes())
    except (OSError, RuntimeError) as error:
        where = {HERE: "", WEB: " for browsers"}.get(name, f" for {name}")
        otherwise = "install alfmu[compiler]" if name == WEB else "leave the platform out"
        raise ExportError(f"{scene}: the runtime{where} cannot be built ({error}); {otherwise}") from error
