"""What messages say of names and texts: what a text may be, which names were meant, how a value is shown."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterable
from typing import Any

from .errors import DeclarationError

__all__ = ["LONGEST", "in_words", "nearest", "shown", "text", "there_is"]

LONGEST = 200
"""Most characters of a name: a file system has room for 255, of which an FMU's own files take some 30."""

_SHOWN = 5
"""Names that a message lists."""

_WIDEST = 60
"""Characters of a value that a message shows."""

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def text(what: str, value: Any, longest: int | None = None) -> str:
    """A text that files and FMUs can hold; DeclarationError otherwise."""
    if not isinstance(value, str):
        raise DeclarationError(f"{what} is {shown(value)}; give a text")
    if bad := _NOT_XML.search(value):
        raise DeclarationError(
            f"{what} has the character {bad.group()!r} at place {bad.start() + 1}, which no FMU can hold; leave it out"
        )
    if longest is not None and len(value) > longest:
        raise DeclarationError(f"{what} has {len(value)} characters ({value:.20}...); give at most {longest}")
    return value


def shown(value: Any) -> str:
    """A value as a message shows it: short, and with its kind where that is not plain."""
    if hasattr(value, "is_symbolic"):  # of CasADi
        return f"the symbol {value}" if value.is_symbolic() else f"an expression ({type(value).__name__})"
    text = repr(value) if isinstance(value, str | bytes | int | float | complex | tuple | list | None) else ""
    return text if 0 < len(text) <= _WIDEST else f"a {type(value).__name__}"


def nearest(name: object, names: Iterable[str]) -> list[str]:
    """The names that somebody may have meant, the likeliest first."""
    by_case = {each.lower(): each for each in names}
    return [by_case[each] for each in difflib.get_close_matches(str(name).lower(), by_case, 3, 0.6)]


def there_is(name: object, names: Collection[str]) -> str:
    """What to say of a name that is none of these: what may have been meant, or else what there is, a handful."""
    if meant := nearest(name, names):
        return f"did you mean {in_words(meant)}?"
    listed = list(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN + 1 else ""
    return f"it has {', '.join(listed[: _SHOWN if more else None]) or 'none'}{more}"


def in_words(names: Collection[str]) -> str:
    """a, b or c"""
    *most, last = names
    return f"{', '.join(most)} or {last}" if most else last
