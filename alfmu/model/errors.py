"""Errors that say which mechanism, what was measured, the limit, and what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..result import Result

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


class AlfmuError(Exception):
    """Base of every error that alfmu raises on purpose; its text is meant for the user."""

    result: Result | None = None
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
