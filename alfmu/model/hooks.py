"""What methods of a declaration or a result call in rooms above: `alfmu` hands it in, by the names of `alfmu.api`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

__all__ = ["Picture", "hand_in", "handed_in"]

_FIND: list[Callable[[str], Callable[..., Any]]] = []


class Picture(Protocol):
    """The picture of a mechanism, as `alfmu.view.picture.Drawing` has it; notebooks show it."""

    def image(self) -> Any:
        """As an image of Pillow."""

    def png(self, colors: int | None = None) -> bytes:
        """As a PNG, the same bytes each time."""

    def svg(self) -> str:
        """As an SVG, the same text each time."""

    def save(self, path: str | Path) -> None:
        """Write a `.png` or an `.svg`."""

    def _repr_svg_(self) -> str | None: ...
    def _repr_png_(self) -> bytes | None: ...


def hand_in(find: Callable[[str], Callable[..., Any]]) -> None:
    """Say how a function of a room above is found by its name; `alfmu` does, when it is imported."""
    _FIND[:] = [find]


def handed_in(name: str) -> Callable[..., Any]:
    """A function that was handed in."""
    return _FIND[0](name)
