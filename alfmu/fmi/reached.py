"""C without what nothing in it uses."""

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence

_FUNCTION = re.compile(r"(?!typedef|enum|struct|union)[A-Za-z][^={}#;]*?\b(\w+)\([^={};]*\)\s*(\{|;)")
_DATA = re.compile(r"(?!typedef)(?:extern |static )?(?:const )?\w[\w \*]*?\b(\w+)(?:\[[^\]]*\])*\s*(?:=|;)")
_MACRO = re.compile(r"#define (\w+)")
_LITERAL = re.compile(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'')
_WORD = re.compile(r"\b[A-Za-z_]\w*\b")


def reached(text: str, public: Callable[[str], object]) -> list[tuple[str, str]]:
    """Return pieces of C, each with the name that it declares or defines, if any; without functions, constants and
    macros that public ones never use."""
    chunks = list(_chunks(text))
    owners: dict[str, list[int]] = defaultdict(list)
    named: list[str] = []
    for k, chunk in enumerate(chunks):
        found = _MACRO.match(chunk) or _FUNCTION.match(chunk) or _DATA.match(chunk)
        named.append(found[1] if found else "")
        if found:
            owners[found[1]].append(k)
    waiting = [k for k, each in enumerate(named) if not each or public(each)]
    kept = set(waiting)
    while waiting:
        for word in owners.keys() & _WORD.findall(chunks[waiting.pop()]):
            more = set(owners.pop(word)) - kept
            waiting += more
            kept |= more
    return [(named[k], chunks[k]) for k in sorted(kept)]


def undeclared(pieces: Sequence[tuple[str, str]], public: Collection[str] = ()) -> list[tuple[str, str]]:
    """Return pieces of C without declarations of functions that only these pieces use, and only behind the
    definitions, which become static. Declarations that begin with a macro stay."""
    declared = {
        k: name
        for k, (name, chunk) in enumerate(pieces)
        if name not in ("", *public) and re.match(r"(?![A-Z_]+ )\w.*\);\n\Z", chunk, re.DOTALL)
    }
    waiting, needless = set(declared.values()), set[str]()
    for k, (name, chunk) in enumerate(pieces):
        if k not in declared:
            needless |= waiting & {name}
            waiting.difference_update(_WORD.findall(chunk))
    return [
        (name, "static " + chunk if name in needless and not chunk.startswith("static") else chunk)
        for k, (name, chunk) in enumerate(pieces)
        if k not in declared or name not in needless
    ]


def _chunks(text: str) -> Iterator[str]:
    """Yield directives, and declarations and definitions at the top level."""
    chunk, depth = "", 0
    for line in text.splitlines(keepends=True):
        chunk += line
        if chunk.startswith("#"):
            whole = not line.endswith("\\\n")
        else:
            bare = _LITERAL.sub("", line) if '"' in line or "'" in line else line
            depth += bare.count("{") - bare.count("}")
            called = re.match(r"[A-Z_0-9]+\([^;{}]*\)$", chunk) and chunk.count("(") == chunk.count(")")
            whole = not depth and (bare.rstrip().endswith((";", "}")) or bool(called))
        if whole and (chunk.startswith("#") or not depth):
            yield chunk
            chunk = ""
