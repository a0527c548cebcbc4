"""Files that declare a mechanism, by their names."""

from __future__ import annotations

from pathlib import Path

LINKAGES = (".xml", ".urdf", ".sdf")
"""Endings of files of other programs that declare a mechanism (`alfmu.formats`)."""


def is_file(mechanism: object) -> bool:
    """Return whether the argument names a file that declares a mechanism, instead of a registered mechanism."""
    return isinstance(mechanism, str | Path) and str(mechanism).endswith((".py", *LINKAGES))
