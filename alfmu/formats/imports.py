"""Import mechanisms from files of other programs: formats, options, reports of ignored elements."""

from __future__ import annotations

import os
import textwrap
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, Literal, get_args

from ..model.errors import AlfmuWarning, InputError
from ..model.mechanism import Mechanism
from ..model.words import counted, shown
from .declared import declared, plain_name
from .linkage import LEAVES, Linkage
from .markup import Node, parsed

_WIDTH = 116
"""Width of text in the generated Python file, in characters."""

_NAMED = 4
"""Number of names in a line on ignored elements."""


_COMMON = {
    "contacts": Literal["refuse", "leave"], "limits": Literal["stop", "inside", "ignore"],
    "inertia": Literal["refuse", "mean"], "leave": str, "drives": str,
}  # fmt: skip
"""Options of all formats with their values; the first value is the default, or the empty text."""

_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "mujoco": ("MJCF", {"key": str, "folders": str} | _COMMON),
    "sdf": ("SDF", {"model": str, "folders": str} | _COMMON),
    "robot": ("URDF", {"base": Literal["fixed", "floating"], "loops": str} | _COMMON),
}
"""Formats by the first element of a file: name and options."""


@dataclass(frozen=True)
class Imported:
    """A mechanism from a file of another program, its ignored elements, and its declaration in Python."""

    mechanism: Mechanism
    left_out: tuple[str, ...]
    """Ignored elements without effect on the motion, a line for each kind."""
    warnings: tuple[str, ...]
    """Ignored elements that may affect the motion: limits of joints, programs of plugins."""
    notes: tuple[str, ...]
    """Further remarks, such as loops that are open in the file."""
    moved: str
    """Coordinates that were moved far to close the loops, or that this leaves no motion."""
    renamed: dict[str, str]
    """New names by kind and old name."""
    _source: Callable[[str], str]

    def source(self, function: str | None = None) -> str:
        """Return the declaration as a Python file with a function of that name, by default that of the mechanism."""
        return self._source(function or self.mechanism.name)


def imported(path: str | Path, **options: Any) -> Imported:
    """Import an MJCF, SDF or URDF file: its mechanism, its ignored elements, and its declaration in Python.

    Options of all formats: `drives`, names of joints that get an input each, separated by commas (`all` for every hinge
    and slider); `limits`, whether limits of joints become end stops (`stop`, the default), within which joints
    start (`inside`), or are ignored (`ignore`); `contacts="leave"` leaves contacts out; `inertia="mean"` replaces
    moments of inertia that no body has by their mean; `leave`, kinds of other elements to leave out, although they
    affect the motion. MJCF: `key`, the keyframe at the start. SDF: `model`, one of several. Both: `folders` with
    included files and meshes, beside that of the file. URDF: `base`, fixed (default) or floating; `loops`, a file of
    loops beside it. Raises InputError with file, line and element of all that cannot be mapped.
    """
    return _imported(Path(path), parsed(path), options)


def factory(path: str | Path) -> Callable[..., Mechanism]:
    """Return a function that makes the mechanism of a file; its keyword arguments are the options of the format.

    It warns of ignored elements that may affect the motion.
    """
    root = parsed(path)

    def made(**options: Any) -> Mechanism:
        found = _imported(Path(path), root, dict(options))
        for each in found.warnings:
            warnings.warn(f"{path}: left out, and may matter: {each}", AlfmuWarning, stacklevel=2)
        if found.moved:
            warnings.warn(f"{path}: {found.moved}", AlfmuWarning, stacklevel=2)
        return found.mechanism

    kinds = _OPTIONS[_format(root)][1]
    made.__annotations__ = kinds | {"return": Mechanism}
    made.__signature__ = Signature(  # type: ignore[attr-defined]
        [Parameter(name, Parameter.KEYWORD_ONLY, default=(*get_args(kind), "")[0]) for name, kind in kinds.items()]
    )
    return made


def _format(root: Node) -> str:
    if root.tag not in _OPTIONS:
        raise InputError(
            f"{root.file}, line {root.line}: the file begins with <{root.tag[:40]}>; alfmu reads <mujoco> (MJCF), "
            "<sdf> and <robot> (URDF)"
        )
    return root.tag


def _imported(path: Path, root: Node, options: dict[str, Any]) -> Imported:
    from . import mjcf, sdf, urdf

    called, takes = _OPTIONS[_format(root)]
    given = {name: (*get_args(kind), "")[0] for name, kind in takes.items()} | options
    for name, value in given.items():
        if name not in takes:
            raise InputError(f"{path} has no option {shown(name)}; {called} takes {', '.join(takes)}")
        if not isinstance(value, str):
            raise InputError(f"{path}: option {name} is {shown(value)}; give a text")
        if (known := get_args(takes[name])) and value not in known:
            raise InputError(f"{path}: option {name} is {shown(value)}; give {' or '.join(known)}")
    if "folders" in given:
        given["folders"] = [(path.parent / each).resolve() for each in given["folders"].split(os.pathsep) if each]
    leaves = [each.strip() for each in given.pop("leave").split(",") if each.strip()]
    if unknown := [each for each in leaves if each not in LEAVES]:
        raise InputError(f"{path}: option leave is {shown(unknown[0])}; alfmu can leave out {', '.join(LEAVES)}")
    limits, drives, inertia = (given.pop(each) for each in ("limits", "drives", "inertia"))
    readers: dict[str, Callable[..., Any]] = {"mujoco": mjcf.File, "sdf": sdf.File, "robot": urdf.File}
    linkage: Linkage = readers[root.tag](root, **given, leaves=leaves).linkage
    linkage.stops, linkage.inside = limits != "ignore", limits == "inside"
    if not linkage.stops and linkage.limited:
        linkage.warn("limits of joints", *linkage.limited)
    linkage.balanced |= inertia == "mean"
    linkage.weigh()
    linkage.name = linkage.name or path.stem
    linkage.drive([each.strip() for each in drives.split(",") if each.strip()])
    for node, why in root.unread({node for nodes in linkage.left_out.values() for node in nodes}):
        if "unknown" in leaves:
            linkage.warn("unknown elements and attributes, left out by option", node)
        else:
            linkage.causes.append(why)
    if not linkage.joints and not linkage.causes:
        root.fail("nothing in it moves: it has no joint with a coordinate")
    linkage.judge()
    title = f"{' '.join(linkage.name.split())[:40]}, imported from {path.name[-40:]} ({called})"
    script, renamed, remarks, moved = declared(linkage, title)
    left, warned, notes = (
        tuple(_line(what, nodes) for what, nodes in kinds.items() if nodes)
        for kinds in (linkage.left_out, linkage.warned, linkage.noted)
    )
    notes = (*notes, *remarks)
    said = {"Left out, and may matter": warned, "Left out": left, "Note": notes}
    script.mechanism.documentation = _documentation(linkage, called, said, renamed)
    lines = [textwrap.fill(f"{what}: {each}", _WIDTH) for what, all_of in said.items() for each in all_of]
    doc = (
        "\n".join([f"{title}.", *[""][: len(lines)], *lines, *[""][: len(lines)]]).replace("\\", "/").replace('"', "'")
    )

    def source(function: str) -> str:
        return script.text(plain_name(function), doc)

    return Imported(script.mechanism, left, warned, notes, moved, renamed, source)


def _line(what: str, nodes: list[Node]) -> str:
    """Return a line on ignored elements, with some of their names."""
    names = [node.attributes["name"] for node in nodes if node.attributes.get("name")]
    lines = f"line {nodes[0].line}" if len(nodes) == 1 else f"{len(nodes)} from line {nodes[0].line}"
    shown_names = [" ".join(name.split())[:40] for name in names[:_NAMED]]
    more = ["..."] if len(names) > _NAMED else []
    return f"{what} ({', '.join([lines, *shown_names, *more])})"


def _documentation(linkage: Linkage, called: str, told: dict[str, tuple[str, ...]], renamed: dict[str, str]) -> str:
    """Return the text for the FMU's documentation."""
    sizes = (
        counted(len(linkage.links), "body"),
        counted(len(linkage.joints), "joint"),
        f"{len(linkage.closures) + len(linkage.couplings)} more that close loops",
    )
    said = [f"# {linkage.name}", "", f"Imported from a file in {called}: {', '.join(sizes)}.", ""]
    for title, lines in told.items():
        if lines:
            said += [f"## {'Notes' if title == 'Note' else title}", "", *(f"- {each}" for each in lines), ""]
    if renamed:
        said += ["## Names", "", *(f"- {old} is called `{new}`" for old, new in renamed.items()), ""]
    return "\n".join(said)
