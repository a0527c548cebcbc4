"""Words of messages about names and texts: which texts are allowed, which names were meant, how a value is shown."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

from .errors import DeclarationError

LONGEST = 200
"""Largest number of characters of a name: a file system has room for 255, of which an FMU's own files take some 30."""

_SHOWN = 5
"""Largest number of names that a message lists."""

_WIDEST = 60
"""Largest number of characters of a value in a message."""

_VOWELS = "aeiouAEIOU"

_MEANT = {
    **dict.fromkeys(("begin", "first"), "start"),
    **dict.fromkeys(("finish", "last", "tip"), "end"),
    "com": "center",
}
"""Names that other programs use for attributes, and the corresponding one."""

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def text(what: str, value: Any, longest: int | None = None) -> str:
    """Return a text that files and FMUs can hold; raise DeclarationError for any other value."""
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
    """Return a value as a message shows it: short, with its type if that is not obvious."""
    if hasattr(value, "is_symbolic"):  # of CasADi
        return f"the symbol {value}" if value.is_symbolic() else f"an expression ({type(value).__name__})"
    if isinstance(value, str):
        return repr(value if len(value) <= _WIDEST else f"{value[: _WIDEST - 3]}...")
    text = repr(value) if isinstance(value, bytes | int | float | complex | tuple | list | None) else ""
    kind = type(value).__name__
    return text if 0 < len(text) <= _WIDEST else f"{'an' if kind[0] in _VOWELS else 'a'} {kind}"


class Brief:
    """A base for dataclasses: a `repr` of one short line, with fields that differ from the defaults, symbols and parts
    by name."""

    def __repr__(self) -> str:
        said = []
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            default = field.default if field.default_factory is MISSING else field.default_factory()
            if field.repr and not (value is default or (type(value) is type(default) and value == default)):
                said.append(f"{field.name}={_brief(value)}")
        return f"{type(self).__name__}({', '.join(said)})"

    if not TYPE_CHECKING:  # type checkers report unknown attributes themselves

        def __getattr__(self, name: str) -> Any:
            raise AttributeError(no_attribute(self, name))


def _brief(value: Any) -> str:
    """Return a value in a `repr`."""
    if hasattr(value, "is_symbolic"):  # of CasADi
        plain = value.is_symbolic() or value.is_constant()
        return str(value) if plain else f"<{type(value).__name__}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_brief(each)}' for key, each in value.items())}}}"
    if isinstance(value, tuple | list):
        entries = [_brief(each) for each in value[:_SHOWN]] + ["..."] * (len(value) > _SHOWN)
        return f"({', '.join(entries)})"
    if isinstance(value, str | int | float | None):
        return shown(value) if isinstance(value, str) else repr(value)
    name = getattr(value, "name", None)
    if isinstance(value, Brief) and not isinstance(name, str):
        return repr(value)
    return name if isinstance(name, str) else shown(value)


def no_attribute(of: object, name: str, meant: str | None = None) -> str:
    """Return the message for an unknown attribute; `meant` is the intended one if known."""
    said = f"{type(of).__name__} {vars(of).get('name', '')}".strip() + f" has no attribute {name!r}"
    if name.startswith("_"):
        return said
    there = [each for each in dir(of) if not each.startswith("_")]
    meant = meant or _MEANT.get(name)
    found = [meant] if meant in there else nearest(name, there)
    return said + (f"; did you mean {in_words(found)}?" if found else "")


def nearest(name: object, names: Collection[str]) -> list[str]:
    """Return the likely intended names, the likeliest first; if a few end with `name`, only these."""
    ending = [each for each in names if re.search(rf"[._]{re.escape(str(name))}$", each)]
    if 0 < len(ending) <= _SHOWN:
        return ending
    by_case = {each.lower(): each for each in names}
    return [by_case[each] for each in difflib.get_close_matches(str(name).lower(), by_case, 3, 0.6)]


def there_is(name: object, names: Collection[str]) -> str:
    """Return a suggestion for an unknown name: similar names, or else a few of those that exist."""
    if meant := nearest(name, names):
        return f"did you mean {in_words(meant)}?"
    listed = list(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN + 1 else ""
    return f"it has {', '.join(listed[: _SHOWN if more else None]) or 'none'}{more}"


def some_like(pattern: str, names: Collection[str]) -> str:
    """Return a suggestion for a pattern that nothing matches; the name of a part suggests all of its variables."""
    whole = any(name.startswith(f"{pattern}.") for name in names)
    return f"did you mean {pattern}.*?" if whole else there_is(pattern, names)


def angle(value: float, digits: int = 3) -> str:
    """Return an angle [rad] as text, in radians and degrees."""
    return f"{value:.{digits}g} rad ({math.degrees(value):.{digits}g} degrees)"


def interval(low: float | None, high: float | None) -> str:
    """Return the range between two inclusive limits, None where there is none."""
    return f"[{-math.inf if low is None else low}, {math.inf if high is None else high}]"


def in_words(names: Collection[str], word: str = "or") -> str:
    """Join names for a sentence: a, b or c."""
    *most, last = names or [""]
    return f"{', '.join(most)} {word} {last}" if most else last


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Return a value with its unit, an angle in degrees, too."""
    plain = f"{value:.{digits}g}" if unit == "1" else f"{value:.{digits}g} {unit}"
    return f"{plain} ({math.degrees(value):.4g} deg)" if unit == "rad" and value else plain


def counted(count: int, of: str) -> str:
    """Return a number with its noun: 1 body, 2 bodies, 2 joints."""
    return f"{count} {of if count == 1 else f'{of[:-1]}ies' if of.endswith('y') else f'{of}s'}"
