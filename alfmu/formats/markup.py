"""Parse XML from untrusted files: no document types, no entities, limited size and depth, checked numbers.

Every attribute and element is either read, listed as harmless, or rejected with its line: a `Reading` records which
attributes were read, so that none is ignored silently.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Never, TypeVar
from xml.parsers import expat

from ..model.errors import InputError
from ..model.words import shown, there_is

LARGEST = 20_000_000
"""Largest size of a file [bytes]: descriptions of robots with hundreds of links have some hundred kilobytes."""

DEEPEST = 200
"""Largest depth of elements: in MJCF each link of a chain adds one."""

MOST = 200_000
"""Largest number of elements of a file."""

_UNKNOWN = "alfmu does not know the effect of {} on the motion; --option leave=unknown leaves it out"

_NAMESPACES = ("xmlns", "xsi:", "xml:")
"""Prefixes of attributes that belong to XML itself, not to a format."""

_LONGEST = 100_000
"""Largest number of values in an attribute."""

_GREATEST = 1e50
"""Largest size of a number: the fifth power of a length, as inertia has it, remains finite."""

_INCLUDED, _FILES = 8, 100
"""Largest depth of nested includes, and largest number of included files."""

T = TypeVar("T")

_FLAGS = {"true": True, "1": True, "false": False, "0": False}


class Attributes(dict[str, str]):
    """Attributes of an element, which record the names that were read, and those that are not known."""

    def __init__(self, given: Mapping[str, str]):
        super().__init__(given)
        self.taken: set[str] = set()
        self.unknown: set[str] = set()

    def __getitem__(self, name: str) -> str:
        self.taken.add(name)
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        self.taken.add(str(name))
        return super().__contains__(name)

    def get(self, name: str, default: str = "") -> str:  # type: ignore[override]
        self.taken.add(name)
        return super().get(name, default)


@dataclass(eq=False)
class Node:
    """An element of a file."""

    tag: str
    given: InitVar[Mapping[str, str]]
    file: Path
    line: int
    parent: Node | None = None
    children: list[Node] = field(default_factory=list)
    text: str = ""
    taken: bool = False
    """Whether the element was read."""
    end: str = ""
    """Text after the names of the model that an <attach> in a <replicate> brings."""

    def __post_init__(self, given: Mapping[str, str]) -> None:
        self.attributes = Attributes(given)

    @property
    def path(self) -> str:
        """The element's path from the root, with names in brackets."""
        name = self.attributes.get("name") or self.attributes.get("class", "")
        own = f"{self.tag}[{name[:60]}]" if name else self.tag
        return f"{self.parent.path}/{own}" if self.parent is not None else own

    @property
    def where(self) -> str:
        """File, line and path, as messages begin with them."""
        return f"{self.file}, line {self.line}: {self.path}"

    def fail(self, why: str) -> Never:
        """Reject the element."""
        raise InputError(f"{self.where}: {why}")

    def all(self, *tags: str) -> list[Node]:
        """Children with one of these tags."""
        found = [child for child in self.children if child.tag in tags]
        for child in found:
            child.taken = True
        return found

    def each(self) -> Iterator[Node]:
        """Yield all children, marked as read; the caller judges each by its tag."""
        for child in self.children:
            child.taken = True
            yield child

    def take(self) -> None:
        """Mark the element and its descendants as read."""
        for each in self.below():
            each.taken = True
            each.attributes.taken.update(each.attributes)
            each.attributes.unknown.clear()

    def unread(self, left: Container[Node]) -> Iterator[tuple[Node, str]]:
        """Yield elements that were not read, or have such attributes, and messages, recursively; `left` is ignored."""
        if self in left or self.tag == "plugin":
            return
        read = (self.attributes.taken | {"name"}) - self.attributes.unknown
        for name, value in self.attributes.items():
            if name not in read and not name.startswith(_NAMESPACES):
                yield self, f"{self.where}: " + _UNKNOWN.format(f'{name}="{value[:60]}" of <{self.tag}>')
        for child in self.children:
            if not child.taken:
                yield child, f"{child.where}: " + _UNKNOWN.format(f"<{child.tag[:60]}> in <{self.tag}>")
            else:
                yield from child.unread(left)

    def one(self, tag: str) -> Node | None:
        """Return the only child with a tag, None if there is none; raise InputError if several differ."""
        found = self.all(tag)
        if any(x.children or (x.text.strip(), x.attributes) != (found[0].text.strip(), found[0].attributes)
               for x in found[1:]):  # fmt: skip
            found[1].fail(f"<{tag}> is given twice; give one")
        return found[0] if found else None

    def need(self, tag: str) -> Node:
        """Return the only child with a tag; raise InputError if there is none."""
        return self.one(tag) or self.fail(f"it has no <{tag}>; give one")

    def add(self, tag: str, given: Mapping[str, str] | None = None, text: str = "") -> Node:
        """Add a child, as if the file contained it."""
        self.children.append(Node(tag, given or {}, self.file, self.line, self, text=text, taken=True))
        return self.children[-1]

    def below(self) -> Iterator[Node]:
        """Yield the element and its descendants."""
        yield self
        for child in self.children:
            yield from child.below()


class UnknownName(InputError):
    """A name is not defined; this follows if the element of that name was refused."""


class Reading:
    """The attributes of an element, or `given` attributes, some of them inherited; `done` marks unread ones."""

    def __init__(self, node: Node, given: Mapping[str, tuple[str, Node]] | None = None):
        self.node = node
        self._given = {name: (value, node) for name, value in node.attributes.items()} if given is None else given
        self._taken: set[str] = set()

    def has(self, name: str) -> bool:
        """Whether an attribute is given."""
        return name in self._given

    def text(self, name: str, default: str | None = None) -> str:
        """Return an attribute as text; raise InputError if it is missing and has no default."""
        self._taken.add(name)
        self.node.attributes.taken.add(name)
        if name in self._given:
            return self._given[name][0]
        if default is None:
            self.node.fail(f"it has no {name}; give one")
        return default

    def choice(self, name: str, known: Sequence[str], default: str | None = None) -> str:
        """Return one of several words."""
        found = self.text(name, default)
        if found not in known:
            self.fail(name, f"{name} is {shown(found)}; alfmu takes {' or '.join(known)}")
        return found

    def flag(self, name: str, default: bool) -> bool:
        """Return a Boolean, true or false."""
        return _FLAGS[self.choice(name, tuple(_FLAGS))] if self.has(name) else default

    def numbers(self, name: str, count: int | range, default: Sequence[float] | None = None) -> list[float]:
        """Return this number of finite values."""
        if not self.has(name) and default is not None:
            return list(default)
        return numbers(self._given.get(name, ("", self.node))[1], name, self.text(name), count)

    def limit(self, name: str, default: float) -> float:
        """Return one number, which may be infinite."""
        return numbers(self.node, name, self.text(name), 1, finite=False)[0] if self.has(name) else default

    def number(self, name: str, default: float | None = None) -> float:
        """Return one finite number."""
        return self.numbers(name, 1, None if default is None else (default,))[0]

    def positive(self, name: str, default: float | None = None) -> float:
        """Return a nonnegative number."""
        found = self.number(name, default)
        if found < 0:
            self.fail(name, f"{name} is {found:g}; it must not be negative")
        return found

    def fail(self, name: str, why: str) -> Never:
        """Reject an attribute, if it was given."""
        self._given.get(name, ("", self.node))[1].fail(why)

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """Reject attributes by name, each with the alternative; zero and false are allowed."""
        for name, instead in reasons.items():
            value = self.text(name, "")
            if any(word not in ("false", "auto", "none") and _value(word) != 0 for word in value.split()):
                self.fail(name, f'{name}="{value[:60]}" does not map: {instead}')

    def done(self, harmless: Sequence[str] = ()) -> None:
        """Mark attributes that were neither read nor harmless as not known."""
        self.node.attributes.taken.update(self._given)
        for name, (_, node) in self._given.items():
            if name not in self._taken and name not in harmless:
                node.attributes.unknown.add(name)


class Children(Reading):
    """The texts of the children of an element, read as attributes are."""

    def __init__(self, node: Node):
        super().__init__(node, {child.tag: (child.text.strip(), child) for child in node.children})

    def text(self, name: str, default: str | None = None) -> str:
        """Return the text of the only child with a tag."""
        child = self.node.need(name) if default is None else self.node.one(name)
        return child.text.strip() if child is not None and (self.has(name) or default is None) else str(default)

    def has(self, name: str) -> bool:
        """Whether a child is given; an empty one stands for the default, as in libsdformat."""
        _, child = self._given.get(name, ("", self.node))
        child.taken = True
        return child is not self.node and bool(child.text.strip() or child.children)

    def flag(self, name: str, default: bool) -> bool:
        """Return a Boolean, in upper or lower case."""
        said = self.text(name, str(default)).lower()
        return (
            _FLAGS[said] if said in _FLAGS else self.fail(name, f"<{name}> is {shown(said[:40])}; give true or false")
        )


def numbers(node: Node, what: str, text: str, count: int | range, finite: bool = True) -> list[float]:
    """Return this number of values from a text, by default finite ones; raise InputError with the line otherwise."""
    words = text.split()
    if len(words) > _LONGEST:
        node.fail(f"{what} has {len(words)} numbers; alfmu reads {_LONGEST}")
    found = [_value(word) for word in words]
    for word, value in zip(words, found, strict=True):
        if math.isnan(value) or (finite and math.isinf(value)) or "_" in word:
            node.fail(f"{what} has {shown(word[:40])}, which is no finite number")
        if finite and abs(value) > _GREATEST:
            node.fail(f"{what} has {shown(word[:40])}; alfmu reads numbers up to {_GREATEST:g}")
    if not (len(found) in count if isinstance(count, range) else len(found) == count):
        wanted = f"{count.start} to {count.stop - 1}" if isinstance(count, range) else str(count)
        node.fail(f"{what} has {len(found)} numbers; give {wanted}")
    return found


def by_name(nodes: Sequence[Node]) -> dict[str, Node]:
    """Return elements by their names; reject one without a name, or with the name of another."""
    found: dict[str, Node] = {}
    for each in nodes:
        name = each.attributes.get("name") or each.fail("it has no name; give one")
        if (other := found.setdefault(name, each)) is not each:
            each.fail(f"line {other.line} has an element of this name; names are used once")
    return found


def _value(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def parsed(path: str | Path) -> Node:
    """Return the root element of a file; raise InputError if it is missing, not XML, too large, or has a
    document type."""
    path = Path(path)
    content = content_of(path, LARGEST)
    try:
        return _tree(path, content)
    except InputError:
        # Exporters write comments that contain two dashes, which XML does not allow.
        plain = re.sub(rb"<!--.*?-->", lambda each: b"\n" * each[0].count(b"\n"), content, flags=re.DOTALL)
        if plain == content:
            raise
    return _tree(path, plain)


def content_of(path: Path, largest: int) -> bytes:
    """Return the content of a file of up to a size; raise InputError if it is missing or larger."""
    try:
        if not path.is_file():
            raise InputError(f"there is no file {path}")
        with path.open("rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from None
    if len(content) > largest:
        raise InputError(f"{path} has more than {largest / 1e6:g} MB; alfmu reads files like it up to that size")
    return content


def found_file(node: Node, name: str, where: Sequence[Path], allowed: Sequence[Path]) -> Path:
    """Return the path of a file that an element names: in a folder of `where`, inside an `allowed` folder."""
    paths = [(folder / name).resolve() for folder in where]
    inside = [path for path in paths if any(path.is_relative_to(folder) for folder in allowed)]
    if Path(name).is_absolute() or not inside:
        node.fail(
            f"{shown(name)} is outside the folder of the file; alfmu includes files in it alone, and in those of "
            "--option folders=FOLDER"
        )
    found = next((path for path in inside if path.is_file()), None)
    if found is None:
        node.fail(f"there is no file {shown(name)}; --option folders=FOLDER names other folders to look in")
    return found


class Includes:
    """Replaces <include> elements by those of other files; `elements` returns the replacement for such an element."""

    def __init__(self, node: Node, elements: Callable[[Includes, Node], Sequence[Node]]):
        self.elements = elements
        self._within: list[Path] = [node.file.resolve()]
        self._count = self._elements = self._characters = 0
        self._spend(node)
        self.replace(node)

    def spend(self, node: Node, elements: int, characters: int) -> None:
        """Count elements and characters that files and copies make; reject `node` if there are too many in all."""
        self._elements += elements
        self._characters += characters
        if self._elements > MOST or self._characters > LARGEST:
            node.fail(
                f"with included files, attached ones and copies there are more than {MOST} elements, or "
                f"{LARGEST / 1e6:g} million characters; give fewer, or shorter names"
            )

    def _spend(self, node: Node) -> None:
        for each in node.below():
            self.spend(node, 1, len(each.text) + sum(map(len, each.attributes.values())))

    def replace(self, node: Node) -> None:
        """Replace the <include> elements in an element."""
        children: list[Node] = []
        for child in node.children:
            if child.tag == "include":
                child.taken = True
                children += self.elements(self, child)
            else:
                children.append(child)
                if child.tag != "plugin":
                    self.replace(child)
        node.children = children

    def root(self, node: Node, name: str, where: Sequence[Path], allowed: Sequence[Path]) -> Node:
        """Return the root of the file that an element names, with its own includes replaced."""
        with self.inside(node, name, where, allowed) as root:
            return root

    @contextmanager
    def inside(self, node: Node, name: str, where: Sequence[Path], allowed: Sequence[Path]) -> Iterator[Node]:
        """Yield the same while files that it names in turn are read: none of them may be it, or one around it."""
        path = found_file(node, name, where, allowed)
        self._count += 1
        if path in self._within or len(self._within) > _INCLUDED or self._count > _FILES:
            node.fail(
                f"files include each other in a circle, more than {_INCLUDED} deep, or there are more than {_FILES}"
            )
        self.spend(node, 0, 0)  # Where all causes are collected, others follow the one of too much.
        root = parsed(path)
        self._spend(root)
        self._within.append(path)
        try:
            self.replace(root)
            yield root
        finally:
            self._within.pop()


def _tree(path: Path, content: bytes) -> Node:
    """Return the root element of a text."""
    parser, above, count = expat.ParserCreate(), Node("", {}, path, 0), itertools.count(1)
    path_to = [above]

    def refuse(what: str) -> Never:
        line = parser.CurrentLineNumber
        raise InputError(f"{path}, line {line}: the file has {what}, which alfmu does not read; leave it out")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(path_to) > DEEPEST:
            refuse(f"elements more than {DEEPEST} deep")
        if next(count) > MOST:
            refuse(f"more than {MOST} elements")
        parent = path_to[-1] if path_to[-1] is not above else None
        path_to.append(Node(tag, attributes, path, parser.CurrentLineNumber, parent))
        path_to[-2].children.append(path_to[-1])

    def add(text: str) -> None:
        path_to[-1].text += text

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: path_to.pop()
    parser.CharacterDataHandler = add
    parser.StartDoctypeDeclHandler = lambda *_: refuse("a document type (<!DOCTYPE>)")
    parser.EntityDeclHandler = lambda *_: refuse("an entity")
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        said = expat.errors.messages.get(error.code, "not well-formed")
        raise InputError(f"{path}, line {error.lineno}: this is no XML ({said})") from None
    except (ValueError, LookupError) as error:  # errors of encodings
        raise InputError(f"{path}: this is no XML that alfmu can read ({error})") from None
    return above.children[0]


def known(node: Node, name: str, there: Mapping[str, T], what: str) -> T:
    """Return the object of a name; reject an undefined name."""
    if name not in there:
        raise UnknownName(f"{node.where}: there is no {what} {shown(name)}; {there_is(name, list(there))}")
    return there[name]
