"""Progress reports while a mechanism is prepared; the command line shows them if preparation takes long."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

Show = Callable[[], AbstractContextManager[Callable[[str], None]]]
"""Opens a display of names, and closes it when everything is made."""

_SHOW: ContextVar[Show | None] = ContextVar("show", default=None)
_TELL: ContextVar[Callable[[str], None] | None] = ContextVar("tell", default=None)


@contextmanager
def showing(show: Show) -> Iterator[None]:
    """Show the preparation inside this block with the given display."""
    token = _SHOW.set(show)
    try:
        yield
    finally:
        _SHOW.reset(token)


@contextmanager
def getting_ready() -> Iterator[None]:
    """Mark a stage of preparation; only the outermost one is shown."""
    show = _SHOW.get()
    if show is None or _TELL.get() is not None:
        yield
        return
    with show() as tell:
        token = _TELL.set(tell)
        try:
            yield
        finally:
            _TELL.reset(token)


def making(name: str) -> None:
    """Report the name of a function that is about to be made."""
    if (tell := _TELL.get()) is not None:
        tell(name)
