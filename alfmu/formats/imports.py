"""Import mechanisms from files of other programs: formats, options, reports of ignored elements."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..model.errors import AlfmuWarning, InputError
from ..model.mechanism import Mechanism
from ..model.words import counted, shown
from .declared import declared, plain_name
from .linkage import Linkage
from .markup import Node, parsed

__all__ = ["Imported", "factory", "imported"]

_WIDTH = 116
"""Width of text in the generated Python file, in characters."""

_NAMED = 4
"""Number of names in a line on ignored elements."""


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
    """Coordinates that closing the loops moved, if far."""
    renamed: dict[str, str]
    """New names by kinds and old names."""
    _source: Callable[[str], str]

    def source(self, function: str | None = None) -> str:
        """Return the declaration as a Python file with a function of that name, by default that of the mechanism."""
        return self._source(function or self.mechanism.name)


def imported(path: str | Path, **options: Any) -> Imported:
    """Import an MJCF, SDF or URDF file: its mechanism, its ignored elements, and its declaration in Python.

    Options of all formats: `drives`, names of joints that get an input each, separated by commas (`all` for every hinge
    and slider). MJCF: `key`, the keyframe at the start; `contacts="leave"` ignores contacts. SDF: `model`, one of
    several; `contacts` as for MJCF. URDF: `base`, fixed (default) or floating. Raises InputError with file, line and
    element if something cannot be mapped.
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

    def mjcf(key: str = "", contacts: Literal["refuse", "leave"] = "refuse", drives: str = "") -> Mechanism:
        return made(key=key, contacts=contacts, drives=drives)

    def sdf(model: str = "", contacts: Literal["refuse", "leave"] = "refuse", drives: str = "") -> Mechanism:
        return made(model=model, contacts=contacts, drives=drives)

    def urdf(base: Literal["fixed", "floating"] = "fixed", drives: str = "") -> Mechanism:
        return made(base=base, drives=drives)

    factories: dict[str, Callable[..., Mechanism]] = {"mujoco": mjcf, "sdf": sdf, "robot": urdf}
    return factories[_format(root)]


def _format(root: Node) -> str:
    if root.tag not in ("mujoco", "sdf", "robot"):
        raise InputError(
            f"{root.file}, line {root.line}: the file begins with <{root.tag[:40]}>; alfmu reads <mujoco> (MJCF), "
            "<sdf> and <robot> (URDF)"
        )
    return root.tag


def _imported(path: Path, root: Node, options: dict[str, Any]) -> Imported:
    from . import mjcf, sdf, urdf

    formats: dict[str, tuple[str, Callable[..., Linkage], tuple[str, ...]]] = {
        "mujoco": ("MJCF", mjcf.read, ("key", "contacts")),
        "sdf": ("SDF", sdf.read, ("model", "contacts")),
        "robot": ("URDF", urdf.read, ("base",)),
    }
    called, read, takes = formats[_format(root)]
    drives = options.pop("drives", "")
    for name, value in options.items():
        if name not in takes:
            raise InputError(f"{path} has no option {shown(name)}; {called} takes {', '.join((*takes, 'drives'))}")
        if not isinstance(value, str):
            raise InputError(f"{path}: option {name} is {shown(value)}; give a text")
    linkage = read(root, **options)
    root.finish({node for nodes in linkage.left_out.values() for node in nodes})
    linkage.name = linkage.name or path.stem
    linkage.drive(drives)
    if not linkage.joints:
        root.fail("nothing in it moves: it has no joint with a coordinate")
    title = f"{' '.join(linkage.name.split())[:40]}, imported from {path.name[-40:]} ({called})"
    script, renamed, remarks, moved = declared(linkage, title)
    left = tuple(_line(what, nodes) for what, nodes in linkage.left_out.items() if nodes)
    warned = tuple(_line(what, nodes) for what, nodes in linkage.warned.items())
    notes = (*(_line(what, nodes) for what, nodes in linkage.noted.items()), *remarks)
    script.mechanism.documentation = _documentation(linkage, called, left, warned, notes, renamed)
    doc = "\n".join(
        [f"{title}.", *([""] if (warned or left or notes) else [])]
        + [textwrap.fill(f"Left out, and may matter: {each}", _WIDTH) for each in warned]
        + [textwrap.fill(f"Left out: {each}", _WIDTH) for each in left]
        + [textwrap.fill(f"Note: {each}", _WIDTH) for each in notes]
    )
    doc = doc.replace("\\", "/").replace('"', "'")
    return Imported(
        script.mechanism,
        left,
        warned,
        notes,
        moved,
        renamed,
        lambda function: script.text(plain_name(function), doc + "\n" * ("\n" in doc)),
    )


def _line(what: str, nodes: list[Node]) -> str:
    """Return a line on ignored elements, with some of their names."""
    names = [node.attributes["name"] for node in nodes if node.attributes.get("name")]
    lines = f"line {nodes[0].line}" if len(nodes) == 1 else f"{len(nodes)} from line {nodes[0].line}"
    shown_names = [" ".join(name.split())[:40] for name in names[:_NAMED]]
    more = ["..."] if len(names) > _NAMED else []
    return f"{what} ({', '.join([lines, *shown_names, *more])})"


def _documentation(
    linkage: Linkage,
    called: str,
    left: tuple[str, ...],
    warned: tuple[str, ...],
    notes: tuple[str, ...],
    renamed: dict[str, str],
) -> str:
    """Return the text for the FMU's documentation."""
    sizes = (
        counted(len(linkage.links), "body"),
        counted(len(linkage.joints), "joint"),
        f"{len(linkage.closures) + len(linkage.couplings)} more that close loops",
    )
    said = [f"# {linkage.name}", "", f"Imported from a file in {called}: {', '.join(sizes)}.", ""]
    for title, lines in (("Left out, and may matter", warned), ("Left out", left), ("Notes", notes)):
        if lines:
            said += [f"## {title}", "", *(f"- {each}" for each in lines), ""]
    if renamed:
        said += ["## Names", "", *(f"- {old} is called `{new}`" for old, new in renamed.items()), ""]
    return "\n".join(said)
