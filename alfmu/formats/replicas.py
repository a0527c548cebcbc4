"""MJCF's <replicate>: copies of a part of the tree, each at the same pose from the one before, with numbered names;
and the names of <attach>, which have a prefix, and an end inside a <replicate>.

Elements of other sections that name replicated elements alone are replicated, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .markup import MOST, Node, Reading
from .poses import Array, quaternion, vector

_SECTIONS = ("tendon", "equality", "actuator", "contact")
"""Sections whose elements name others; tendons come first, as actuators and constraints name them."""

_NAMING = {
    f"{kind}{end}": kind for kind in ("body", "joint", "site", "geom", "tendon") for end in ("", "1", "2", "inparent")
} | {"slidersite": "site", "cranksite": "site", "refsite": "site", "sidesite": "site"}
"""Attributes that name elements, with the kinds of these."""

_KINDS = {"freejoint": "joint"}


Spend = Callable[[Node, int, int], None]
"""Counts elements and characters that are made for an element, and limits them."""


def replicated(root: Node, turn: Callable[[Sequence[float]], Array], spend: Spend) -> None:
    """Replace the children of all <replicate> elements by frames with copies; `turn` returns the rotation by Euler
    angles."""
    for world in root.all("worldbody"):
        _within(root, world, turn, spend)


def _within(root: Node, node: Node, turn: Callable[[Sequence[float]], Array], spend: Spend) -> None:
    for child in node.children:
        _within(root, child, turn, spend)
        if child.tag == "replicate":
            child.children = _copies(root, child, turn, spend)


def _copies(root: Node, node: Node, turn: Callable[[Sequence[float]], Array], spend: Spend) -> list[Node]:
    """Return a frame for each copy; names that refer to copies alone are replaced in all sections."""
    given = Reading(node)
    number, between = given.number("count"), given.text("sep", "")
    count = int(number)
    step, angles = vector(given.numbers("offset", 3, (0, 0, 0))), vector(given.numbers("euler", 3, (0, 0, 0)))
    at = np.zeros(3)
    size = sum(1 for _ in node.below())
    if not 1 <= count <= MOST // size or count != number:
        given.fail("count", f"count is {number:g}; give a number from 1 to {MOST // size}")
    names = names_in(node)
    ends = [f"{between}{i:0{len(str(count))}}" for i in range(count)]
    made = []
    for i, end in enumerate(ends):
        own = turn((i * angles).tolist())  # MuJoCo multiplies the angles, which is no product of rotations
        posed = {"pos": at, "quat": quaternion(own)}
        numbers = {name: " ".join(repr(float(x)) for x in value) for name, value in posed.items()}
        frame = Node("frame", numbers, node.file, node.line, node)
        frame.children = [_copy(child, frame, end, names, spend) for child in node.children]
        made.append(frame)
        at = at + own @ step
    for section in (x for tag in _SECTIONS for x in root.all(tag)):
        found: list[Node] = []
        for each in section.children:
            named = {_named(x, name) for x in each.below() for name in x.attributes} - {("", "")}
            if not named or not named <= names:
                found.append(each)
                continue
            found += [_copy(each, section, end, names, spend) for end in ends]
            names |= {(section.tag, each.attributes.get("name"))} if section.tag == "tendon" else set()
        section.children = found
    return made


def names_in(node: Node) -> set[tuple[str, str]]:
    """Return the kinds and names of an element and of those in it."""
    return {(_KINDS.get(x.tag, x.tag), x.attributes["name"]) for x in node.below() if "name" in x.attributes}


def named(root: Node, prefix: str, end: str, spend: Spend) -> None:
    """Put a prefix before, and an end after, all names of a model but those of its assets and default classes, which
    it alone uses."""
    for node in (x for part in root.children if part.tag not in ("asset", "default") for x in part.below()):
        for name, value in node.attributes.items():
            kind, of = _named(node, name) if node.tag != "attach" else ("", "")
            if (name == "name" and node.tag != "attach") or (kind and of != "world"):
                node.attributes[name] = prefix + value + end
                spend(node, 0, len(node.attributes[name]))
        if node.tag == "attach":
            node.attributes["prefix"] = prefix + dict.get(node.attributes, "prefix", "")
            node.end += end


def others(root: Node, names: set[tuple[str, str]]) -> list[Node]:
    """Remove and return elements of the other sections that name any but these elements, and tendons of them."""
    names, found = names | {("body", "world")}, list[Node]()
    for section in (x for tag in _SECTIONS for x in root.all(tag)):
        for each in section.children:
            if not {_named(x, name) for x in each.below() for name in x.attributes} - {("", "")} <= names:
                found.append(each)
            elif section.tag == "tendon":
                names = names | {("tendon", dict.get(each.attributes, "name", ""))}
        section.children = [each for each in section.children if each not in found]
    return found


def _named(node: Node, attribute: str) -> tuple[str, str]:
    """Return the kind and the name of the element that an attribute names."""
    kind = _NAMING.get(attribute, "")
    return kind, dict.get(node.attributes, attribute, "") if kind else ""


def _copy(node: Node, parent: Node, end: str, names: set[tuple[str, str]], spend: Spend) -> Node:
    """Return a copy of an element with `end` after its name, and after the names in `names` that it mentions."""
    changed = {
        name: value + end
        for name, value in node.attributes.items()
        if name == "name" or _named(node, name) in names
    }  # fmt: skip
    made = Node(node.tag, node.attributes | changed, node.file, node.line, parent, text=node.text, end=node.end + end)
    spend(node, 1, len(made.end) + sum(map(len, changed.values())))
    made.children = [_copy(child, made, end, names, spend) for child in node.children]
    return made
