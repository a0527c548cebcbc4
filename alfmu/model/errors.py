"""Errors that name the mechanism, the measured value, the limit, and a remedy."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Rows(Protocol):
    """The rows computed by a run; `alfmu.Result` implements this."""

    @property
    def time(self) -> NDArray[np.float64]: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def values(self) -> NDArray[np.float64]: ...

    def __getitem__(self, name: str) -> NDArray[np.float64]: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[str]: ...
    def __contains__(self, name: object) -> bool: ...
    def to_csv(self, path: str | Path) -> None: ...


class AlfmuError(Exception):
    """Base of every error that alfmu raises on purpose; its text is meant for the user."""

    result: Rows | None = None
    """Results up to the error that ended the run (`alfmu.Result`); None if the run had not begun."""


class AlfmuWarning(UserWarning):
    """A warning about an allowed declaration that looks like a mistake; its text is meant for the user."""


class DeclarationError(AlfmuError):
    """A mechanism is declared in a way that has no equations (unplaced body, name used twice, ...)."""


class AssemblyError(AlfmuError):
    """The loops of a mechanism cannot be closed, or its start values contradict each other."""


class InputError(AlfmuError):
    """A user's input cannot be used: an unknown name, a value out of its bounds, a file in the wrong format."""


class LibraryError(AlfmuError, OSError):
    """The C library of this installation is missing, or was built from other sources than those of the package."""


class WriteError(AlfmuError, OSError):
    """A file cannot be written; no partial file is left behind."""


class StepError(AlfmuError):
    """A step failed; the state before it is unchanged."""


class ExportError(AlfmuError):
    """An FMU cannot be built or has unexpected contents."""


class OpenError(StepError):
    """A step failed because the constraints cannot be closed after it."""


@contextmanager
def collected() -> Iterator[list[str]]:
    """Collect the warnings that alfmu logs within the block, by any thread, instead of showing them."""
    said: list[str] = []

    def take(record: logging.LogRecord) -> bool:
        if record.levelno >= logging.WARNING:
            said.append(record.getMessage())
        return record.levelno < logging.WARNING

    logger = logging.getLogger("alfmu")
    logger.addFilter(take)
    try:
        yield said
    finally:
        logger.removeFilter(take)


@contextmanager
def needs(what: str, extra: str) -> Iterator[None]:
    """Raise InputError if the block imports a missing package of an extra; `what` names the feature that needs it."""
    try:
        yield
    except ImportError:
        raise InputError(f"{what}; install it with: pip install 'alfmu[{extra}]'") from None
