"""The user's cache folder: scenes and compiled libraries, which take long to make, kept for other processes.

A file is called NAME_HASH.SUFFIX: NAME contains the hash of the file's sources, HASH the hash of its content. A damaged
file is removed and made again. When the folder exceeds its limit, the least recently used files are removed.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import re
import shutil
import tempfile
from collections import OrderedDict
from contextlib import suppress
from functools import cache
from pathlib import Path

from .errors import WriteError
from .files import write

VARIABLE = "ALFMU_CACHE"
"""The environment variable that moves the cache, or turns it off."""

LIMIT = 500_000_000
"""Size of the cache [bytes] above which files are removed: some 3000 scenes of mechanisms such as the five-bar."""

LEAST = 50_000
"""Size [bytes] that a file counts for at least, so that there are at most LIMIT / LEAST of them."""

_WRITERS = 10
"""Number of processes that may write to the cache at once without exceeding the limit."""

_COUNTED = OrderedDict[Path, int]()
"""Largest possible size of each folder [bytes]: its size when counted, and what `_WRITERS` processes have written since
if each wrote as much as this one. It grows (`stored._is_constant`)."""

_OFF = ("off", "0")

_LOGGER = logging.getLogger("alfmu")

_OWN = re.compile(r"(decision|kernel|runtime|scene|start)_[0-9a-f]{32}_[0-9a-f]{32}\.[a-z]+")
"""Names of the files that alfmu keeps; it touches no others."""


def is_off() -> bool:
    """Return whether the cache is disabled."""
    return os.environ.get(VARIABLE, "").lower() in _OFF


def folder() -> Path:
    """Return the cache folder, which need not exist; a folder of this process alone if the cache is off."""
    if is_off():
        return _own_folder()
    if given := os.environ.get(VARIABLE):
        return Path(given).expanduser().absolute()
    from platformdirs import user_cache_path

    return user_cache_path("alfmu", appauthor=False)


@cache
def _own_folder() -> Path:
    made = tempfile.mkdtemp(prefix="alfmu-")
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


def kept(name: str, suffix: str) -> Path | None:
    """Return the file of this name, or None; a damaged file is removed."""
    names: list[str] = []
    with suppress(OSError):
        names = [each for each in os.listdir(folder()) if each.startswith(f"{name}_") and each.endswith(suffix)]
    for path in map(folder().joinpath, sorted(names)):
        if whole(path) is not None:
            with suppress(OSError):
                os.utime(path)  # the time of its last use
            return path
        _LOGGER.debug("%s was damaged, and is removed", path)
        with suppress(OSError):
            path.unlink()
    return None


def whole(path: Path) -> bytes | None:
    """Return the content of a file; None if it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return content if path.stem.rpartition("_")[2] == _hash(content) else None


def keep(name: str, suffix: str, content: bytes) -> Path:
    """Write a file of this name and return its path; raise WriteError if that is not possible."""
    path = folder() / f"{name}_{_hash(content)}{suffix}"
    write(path, content)
    _bounded(path, len(content))
    return path


def remember(name: str, suffix: str, content: bytes) -> None:
    """Write a file of this name if that is possible."""
    try:
        keep(name, suffix, content)
    except WriteError as error:
        _LOGGER.debug("%s", error)


def entries() -> list[tuple[Path, os.stat_result]]:
    """Return the files of the cache with their sizes and times, the least recently used first."""
    found = []
    with suppress(OSError), os.scandir(folder()) as files:
        for each in files:
            with suppress(OSError):
                if _OWN.fullmatch(each.name):
                    found.append((Path(each.path), each.stat()))
    return sorted(found, key=lambda file: file[1].st_mtime)


def clear() -> None:
    """Remove all files of the cache."""
    for path, _ in entries():
        with suppress(OSError):
            path.unlink()


def _bounded(last: Path, size: int) -> None:
    """Remove the least recently used files until the rest is within the limit; the file `last`, of this size, stays.

    Files are counted again only if they may exceed the limit, as counting takes time in proportion to their number.
    """
    place = last.parent
    _COUNTED[place] = _COUNTED.get(place, LIMIT) + _WRITERS * max(size, LEAST)
    if _COUNTED[place] <= LIMIT:
        return
    known = [(path, max(about.st_size, LEAST)) for path, about in entries()]
    excess = sum(size for _, size in known) - LIMIT
    for path, size in known:
        if excess > 0 and path != last:
            with suppress(OSError):  # on Windows, a library that is in use
                path.unlink()
                excess -= size
    _COUNTED[place] = LIMIT + excess


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]
