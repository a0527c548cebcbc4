"""Errors that say which mechanism, what was measured, the limit, and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "AlfmuError",
    "AlfmuWarning",
    "AssemblyError",
    "DeclarationError",
    "ExportError",
    "InputError",
    "OpenError",
    "StepError",
    "WriteError",
]


class Rows(Protocol):
    """What a run had computed, as `alfmu.Result` has it."""

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
    """What a run had computed when this error ended it (`alfmu.Result`); None where none had begun."""


class AlfmuWarning(UserWarning):
    """Something that is allowed and yet looks like a mistake; its text is meant for the user."""


class DeclarationError(AlfmuError):
    """A mechanism is declared in a way that has no equations (unplaced body, name used twice, ...)."""


class AssemblyError(AlfmuError):
    """The loops of a mechanism cannot be closed, or its start values contradict each other."""


class InputError(AlfmuError):
    """What a user gave cannot be used: an unknown name, a value out of its bounds, a file of another form."""


class WriteError(AlfmuError, OSError):
    """A file cannot be written; nothing of it is left."""


class StepError(AlfmuError):
    """A step cannot be taken; the state before it is kept."""


class ExportError(AlfmuError):
    """An FMU cannot be built or is not what was expected."""


class OpenError(StepError):
    """A step after which constraints cannot be closed."""
