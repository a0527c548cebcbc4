"""A loaded scene as constant tables of C: the structures of `scene.h`, read from that header, with their values."""

import ctypes
import json
import math
import re
from collections.abc import Container
from functools import cache
from typing import Any

from ..kernel import thresholds
from ..kernel.tables import NUMBERS, REALS
from ..runtime import build
from ..runtime.library import Scene

Structure = Any
"""An instance of one of the structures, by ctypes."""

_PLAIN: dict[str, Any] = {
    **{"int": ctypes.c_int, "int32_t": ctypes.c_int32, "unsigned": ctypes.c_uint},
    **{"uint8_t": ctypes.c_uint8, "uint16_t": ctypes.c_uint16},
    **{"size_t": ctypes.c_size_t, "ptrdiff_t": ctypes.c_ssize_t, "double": ctypes.c_double, "char": ctypes.c_char},
    **{"Type": ctypes.c_int, "Kind": ctypes.c_int, "Word": ctypes.c_int32},
}


@cache
def _structures() -> tuple[dict[str, Any], dict[str, tuple[str, str]]]:
    """Return the structures by name, and for each pointer the type and the number of its elements; the headers give
    this number in brackets in a comment behind the pointer."""
    text = "".join((build.SOURCES / "core" / name).read_text(encoding="ascii") for name in ("linear.h", "scene.h"))
    text = re.sub(r"/\* (\[[^\]]+\])?.*?\*/", r"\1", text, flags=re.DOTALL)
    for macro, names, kind in (("SCENE_NUMBERS", NUMBERS, "int"), ("SCENE_REALS", REALS, "double")):
        fields = "".join(f"{kind} {name};" for name in names)
        text = re.sub(rf"#define NUMBER.*?\n\s*{macro}\(NUMBER\)\n#undef NUMBER", fields, text)
    made: dict[str, Any] = {}
    targets: dict[str, tuple[str, str]] = {}
    for body, structure in re.findall(r"typedef struct \{(.*?)\} (\w+);", text, re.DOTALL):
        own: list[tuple[str, Any]] = []
        declared = re.findall(r"(?:const\s+|struct\s+)*(\w+)\s+([^;\]]+(?:\[\d+\])?);(?:\s*\[([^\]]+)\])?", body)
        for base, names, count in declared:
            for stars, name, size in re.findall(r"((?:\*|const\s+)*)(\w+)(?:\[(\d+)\])?", names):
                type_of: Any = _PLAIN.get(base) or made.get(base)
                if "*" in stars:
                    targets[f"{structure}.{name}"] = base + " *const" * (stars.count("*") - 1), count
                    if base == "char":
                        type_of = ctypes.c_char_p
                    if type_of is None:
                        type_of = ctypes.c_void_p
                    elif base != "char" or stars.count("*") > 1:
                        type_of = ctypes.POINTER(type_of)
                own.append((name, type_of * int(size) if size else type_of))
        made[structure] = type(structure, (ctypes.Structure,), {"_fields_": own})
    return made, targets


def _count(text: str, owner: Structure) -> int:
    """Return the value of a text, a sum of products of fields, thresholds and numbers."""

    def of(x: str) -> int:
        return int(x) if x.isdigit() else int(getattr(owner, x, 0) or getattr(thresholds, x, 0))

    return sum(math.prod(map(of, term.split(" * "))) for term in text.split(" + ") if term)


def literal(x: float) -> str:
    """Return a number in C."""
    return repr(x) if math.isfinite(x) else "NAN" if math.isnan(x) else "-INFINITY" if x < 0 else "INFINITY"


def loaded(scene: Scene) -> Structure:
    """Return the structure of a loaded scene."""
    return _structures()[0]["Scene"].from_address(scene.address)


def tables(scene: Structure, texts: bool, words: int, used: Container[str], without: Container[str]) -> tuple[str, int]:
    """Return the scene as a constant of C with the arrays `used` by the C, and their size in bytes.

    Texts that only messages use are empty unless `texts` is set; the words of programs have `words` bytes each. The C
    has no fields `without`.
    """
    arrays: dict[str, str] = {}
    size = ctypes.sizeof(scene)

    def value(x: object, field: str) -> str:
        nonlocal size
        if isinstance(x, bytes):
            kept = texts or field.rpartition(".")[2] in ("unit", "rate_unit", "guid")
            size += len(x) + 1 if kept else 0
            return json.dumps(x.decode() if kept else "", ensure_ascii=True)
        if isinstance(x, float):
            return literal(x)
        if isinstance(x, ctypes.Structure):
            kind = type(x).__name__
            names = (part[0] for part in x._fields_ if part[0] not in without)
            each = [below(x, f"{kind}.{name}", getattr(x, name)) for name in names]
            return f"{{{', '.join(each)}}}"
        return str(x)

    def below(owner: Structure, field: str, x: Any) -> str:
        nonlocal size
        target, count = _structures()[1].get(field, ("", ""))
        if not target or target == "char":
            return "0" if x is None else value(x, field)
        if not x or field.rpartition(".")[2] not in used or not (length := _count(count, owner)):
            return "0"
        text = ", ".join(value(each, field) for each in x[:length])
        text = f"static const {target} @[{length}] = {{{text}}};\n"
        if text not in arrays:
            size += (2 if target == "Word" and words == 2 else ctypes.sizeof(x._type_)) * length
            arrays[text] = f"table{len(arrays)}"
        return arrays[text]

    whole = value(scene, "")
    lines = [text.replace("@", made, 1) for text, made in arrays.items()]
    return "".join(lines) + f"static const Scene the_scene = {whole};\n", size
