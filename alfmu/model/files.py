"""Atomic files and temporary folders: everything that the package writes to a disk.

On Linux a file has no name until it is complete, so that nothing is left if the process is killed. On other systems,
and for the instant in which it replaces an older file, it is called `.alfmu-*.part` in the same folder. Such a file,
and a temporary folder `alfmu-scratch-*`, is locked while it is in use: those left behind by a killed process are
removed when the next one is made there, a minute later at the earliest. Windows has no such lock, and removes none.
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import InputError, WriteError
from .words import in_words

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_YOUNG = 60.0
"""Age [s] up to which an unlocked file is assumed to be under construction."""

_FOLDER = "alfmu-scratch-"
"""Prefix of the names of temporary folders; eight characters follow."""

_OPENED = "/proc/self/fd"
"""Folder with links to open files, through which an unnamed file gets a name."""


ENDS = {
    "a table": (".csv",),
    "a plot": (".png", ".svg", ".pdf"),
    "a drawing": (".png", ".svg"),
    "a film": (".gif", ".html"),
    "a page": (".html", ".htm"),
    "a report": (".html", ".md", ".svg", ".json"),
    "positions of rest": (".json",),
    "degrees of freedom": (".json",),
    "linearisations": (".json", ".mat"),
}
"""Suffixes of files, by their content."""


def path_for(content: str, path: str | Path) -> Path:
    """Return the path of a file with a content of `ENDS`. Raises InputError if its name has another suffix."""
    path = Path(path)
    if path.suffix.lower() not in ENDS[content]:
        raise InputError(f"{path}: the name of a file for {content} must end in {in_words(ENDS[content])}")
    return path


@contextmanager
def atomic(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file for writing that appears when the block ends, and does not appear if the block fails.

    Missing folders are made. Links are followed and the permissions of an older file are kept; a pipe or a device is
    written directly. Raises WriteError.
    """
    target = Path(os.path.realpath(path))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        special = target.exists() and not target.is_file()
        with target.open("wb") if special else _replacing(target) as file:
            yield file
    except OSError as error:
        if isinstance(error, WriteError):
            raise
        raise WriteError(f"cannot write {path} ({error.strerror or error})") from error


def write(path: str | Path, content: bytes) -> None:
    """Write a file atomically; see `atomic`."""
    with atomic(path) as file:
        file.write(content)


@contextmanager
def scratch() -> Iterator[Path]:
    """Make a temporary folder, removed with its content when the block ends."""
    _clear(Path(tempfile.gettempdir()), f"{_FOLDER}????????")
    with tempfile.TemporaryDirectory(prefix=_FOLDER, ignore_cleanup_errors=True) as folder:
        lock = os.open(folder, os.O_RDONLY) if fcntl else None
        try:
            _locked(lock)
            yield Path(folder)
        finally:
            if lock is not None:
                os.close(lock)


@contextmanager
def exclusive(folder: Path) -> Iterator[bool]:
    """Lock a folder for the duration of the block, made if missing; yield False if another process holds the lock.

    A killed process releases the lock. Windows and some network drives have no such lock: there the result is always
    True. Raises WriteError.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder, os.O_RDONLY) if fcntl else None
    except OSError as error:
        raise WriteError(f"cannot write into {folder} ({error.strerror or error})") from error
    try:
        yield _locked(lock)
    finally:
        if lock is not None:
            os.close(lock)


def _locked(descriptor: int | None) -> bool:
    """Lock a file or folder for as long as it is open here; return False if another process holds it."""
    try:
        if fcntl and descriptor is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # not supported on some network drives
        return True
    return True


@contextmanager
def _replacing(target: Path) -> Iterator[BinaryIO]:
    """Open a file that replaces a regular file, or makes a new one."""
    mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
    if mode is not None and not os.access(target, os.W_OK):
        raise PermissionError(None, "it is there and may not be changed")
    partial = target.with_name(f".alfmu-{uuid.uuid4().hex}.part")
    nameless = _nameless(target.parent)
    if nameless is None:  # which leaves files when a process is killed; to look for them takes 2 ms among 4000 files
        _clear(target.parent, ".alfmu-*.part")
    try:
        with partial.open("xb") if nameless is None else open(nameless, "wb") as file:
            _locked(file.fileno())
            yield file
            file.flush()
            if mode is not None and hasattr(os, "fchmod"):
                os.fchmod(file.fileno(), mode)
            if nameless is not None:
                folder = os.open(target.parent, os.O_RDONLY)  # with dir_fd given, Python follows the link
                try:
                    os.link(f"{_OPENED}/{nameless}", partial.name, src_dir_fd=folder, dst_dir_fd=folder)
                finally:
                    os.close(folder)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def _nameless(folder: Path) -> int | None:
    """Return a new nameless file in a folder; None if the system does not support them."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir(_OPENED):
        with suppress(OSError):
            return os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666)
    return None


def _clear(folder: Path, pattern: str) -> None:
    """Remove files that killed processes of this user left in a folder."""
    for path in folder.glob(pattern) if fcntl else ():
        with suppress(OSError):
            if _abandoned(path):
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()


def _abandoned(path: Path) -> bool:
    """Return whether no process uses a file or folder of this user; raise OSError if one does."""
    about = path.lstat()
    if about.st_uid != os.getuid() or time.time() - about.st_mtime < _YOUNG:
        return False
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.close(descriptor)
    return True
