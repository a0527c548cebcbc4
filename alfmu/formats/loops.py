"""Loops of a URDF in a file beside it: pairs of frames that coincide, as YAML with lists of names.

`closed_loop` lists pairs of links, `type` says for each whether their points coincide (3d) or their frames (6d),
`name_mot` lists joints with motors, and `joint_type` gives the joints in `joint_name` other freedoms: SPHERICAL, FIXED,
or UJOINT with the letters of two axes of the joint's frame.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ..model.errors import InputError
from .markup import content_of

KEYS = ("closed_loop", "type", "name_mot", "joint_name", "joint_type")

_LARGEST = 1_000_000
"""Largest size of a file [bytes]: those of robots with twenty loops have some kilobytes."""


def listed(path: Path) -> dict[str, Any]:
    """Return lists by their keys; raise InputError if the file has another form."""
    try:
        text = content_of(path, _LARGEST).decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path} cannot be read ({error})") from None
    plain = "\n".join(re.sub(r"(^|\s)#.*", "", line).rstrip() for line in text.splitlines())
    found = {}
    for part in re.split(r"\n(?=[A-Za-z_]\w*:)", "\n" + plain)[1:]:
        key, _, value = part.partition(":")
        if key in KEYS:
            items = re.split(r"\n\s*- ", value) if re.match(r"\s*- ", value.strip("\n")) or "\n- " in value else None
            found[key] = _flow(path, value) if items is None else [_flow(path, item) for item in items if item.strip()]
    return found


def _flow(path: Path, text: str) -> Any:
    """Return a name, or a list of these in brackets, up to two deep."""
    open_lists: list[list[Any]] = [[]]
    for word in re.findall(r"'[^']*'|\"[^\"]*\"|[\[\],]|[^\s\[\],'\"]+", text):
        if word == "[" and len(open_lists) < 3:
            open_lists.append([])
        elif word == "]" and len(open_lists) > 1:
            done = open_lists.pop()
            open_lists[-1].append(done)
        elif word in "[]":
            raise InputError(f"{path} has brackets that do not match; give lists of names, and of pairs of names")
        elif word != ",":
            open_lists[-1].append(word.strip("'\""))
    if len(open_lists) > 1 or len(open_lists[0]) != 1:
        raise InputError(
            f"{path} has {text.strip()[:40]!r} instead of a name or a list; give names in brackets, with commas"
        )
    return open_lists[0][0]
