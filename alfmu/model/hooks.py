"""Functions of higher rooms that methods of a declaration or a result call; `alfmu` registers them, named as in
`alfmu.api`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

_FIND: list[Callable[[str], Callable[..., Any]]] = []


class Picture(Protocol):
    """The picture of a mechanism, as `alfmu.view.picture.Drawing` has it; notebooks show it."""

    def image(self) -> Any:
        """Return the picture as an image of Pillow."""

    def png(self, colors: int | None = None) -> bytes:
        """Return the picture as a PNG, the same bytes each time."""

    def svg(self) -> str:
        """Return the picture as an SVG, the same text each time."""

    def save(self, path: str | Path) -> None:
        """Write a `.png` or an `.svg`."""

    def _repr_svg_(self) -> str | None: ...
    def _repr_png_(self) -> bytes | None: ...


def hand_in(find: Callable[[str], Callable[..., Any]]) -> None:
    """Register how to find a function of a higher room by its name; `alfmu` does this on import."""
    _FIND[:] = [find]


def handed_in(name: str) -> Callable[..., Any]:
    """Return a registered function."""
    return _FIND[0](name)
