"""Files that are whole or not there at all, and folders for a while: all that the package leaves on a disk.

On Linux a file has no name until it is complete, so that nothing is left of it where the process is killed. Elsewhere,
and for the instant in which it takes the place of an older one, it stands beside that as `.alfmu-*.part`. Such a file,
and a folder `alfmu-scratch-*` among the temporary ones, is locked while it is used: one that a killed process left
behind is removed by the next that is made there, a minute later at the earliest. Windows has no such lock, and removes
none.
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

from .errors import WriteError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["atomic", "exclusive", "scratch", "write"]

_YOUNG = 60.0
"""Age [s] up to which what is not locked is taken as being made."""

_FOLDER = "alfmu-scratch-"
"""How names of folders for a while begin; eight characters follow."""

_OPENED = "/proc/self/fd"
"""Where a file without a name can be found, to give it one."""


@contextmanager
def atomic(path: str | Path) -> Iterator[BinaryIO]:
    """A file to write, which is there once the block is done, and not at all where it fails.

    Its folder is made. Links are followed, permissions of an older file kept; what is no regular file (a pipe, a
    device) is written as it is. Raises WriteError.
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
    """Write a file as a whole; see `atomic`."""
    with atomic(path) as file:
        file.write(content)


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder among the temporary ones, removed with all that is in it when the block is done."""
    _clear(Path(tempfile.gettempdir()), f"{_FOLDER}????????")
    with tempfile.TemporaryDirectory(prefix=_FOLDER, ignore_cleanup_errors=True) as folder:
        lock = os.open(folder, os.O_RDONLY) if fcntl else None
        try:
            if lock is not None:
                _lock(lock)
            yield Path(folder)
        finally:
            if lock is not None:
                os.close(lock)


@contextmanager
def exclusive(folder: Path) -> Iterator[bool]:
    """A folder of one's own as long as the block lasts, made where there is none; False where another process has it.

    A process that is killed leaves it free. Windows and some network drives have no such lock: it is always True there.
    Raises WriteError.
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
    """Whether a folder could be locked, or needs no lock; False where another process has it."""
    try:
        if descriptor is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # not on every network drive
        return True
    return True


@contextmanager
def _replacing(target: Path) -> Iterator[BinaryIO]:
    """A file that takes the place of a regular one, or of none."""
    mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
    if mode is not None and not os.access(target, os.W_OK):
        raise PermissionError(None, "it is there and may not be changed")
    _clear(target.parent, ".alfmu-*.part")
    partial = target.with_name(f".alfmu-{uuid.uuid4().hex}.part")
    try:
        nameless = _nameless(target.parent)
        with partial.open("xb") if nameless is None else open(nameless, "wb") as file:
            _lock(file.fileno())
            yield file
            file.flush()
            if mode is not None and hasattr(os, "fchmod"):
                os.fchmod(file.fileno(), mode)
            if nameless is not None:
                folder = os.open(target.parent, os.O_RDONLY)  # with a folder given, Python follows the link
                try:
                    os.link(f"{_OPENED}/{nameless}", partial.name, src_dir_fd=folder, dst_dir_fd=folder)
                finally:
                    os.close(folder)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def _nameless(folder: Path) -> int | None:
    """A new file in a folder, without a name; None where the system has no such files."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir(_OPENED):
        with suppress(OSError):
            return os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666)
    return None


def _lock(descriptor: int) -> None:
    """Show that a file or folder is in use, as long as it is open here."""
    if fcntl:
        with suppress(OSError):  # not on every network drive
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _clear(folder: Path, pattern: str) -> None:
    """Remove what killed processes of this user left in a folder."""
    for path in folder.glob(pattern) if fcntl else ():
        with suppress(OSError):
            if _abandoned(path):
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()


def _abandoned(path: Path) -> bool:
    """Whether no process uses a file or folder of this user; OSError where one does."""
    about = path.lstat()
    if about.st_uid != os.getuid() or time.time() - about.st_mtime < _YOUNG:
        return False
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.close(descriptor)
    return True
