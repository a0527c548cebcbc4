"""A loaded scene as constant tables of C: the structures of `scene.h`, read from that header, with their values."""

from __future__ import annotations

import ctypes
import json
import math
import re
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any

from ..kernel import thresholds
from ..kernel.tables import NUMBERS, REALS
from ..runtime import build
from ..runtime.library import Scene

__all__ = ["Structure", "literal", "loaded", "tables"]

Structure = Any
"""An instance of one of the structures, by ctypes."""

_PLAIN: dict[str, Any] = {
    **{"int": ctypes.c_int, "int32_t": ctypes.c_int32, "uint16_t": ctypes.c_uint16, "unsigned": ctypes.c_uint},
    **{"size_t": ctypes.c_size_t, "ptrdiff_t": ctypes.c_ssize_t, "double": ctypes.c_double, "char": ctypes.c_char},
    **{"Type": ctypes.c_int, "Kind": ctypes.c_int, "Word": ctypes.c_int32},
}

_LENGTHS: dict[str, Callable[[Structure], int]] = {
    "Pattern.offsets": lambda x: x.columns + 1,
    "Function.lengths": lambda x: x.inputs + x.outputs,
    **dict.fromkeys(("Function.narrow", "Function.wide"), lambda x: x.words + x.results),
    "Scene.variables": lambda x: x.parameters + x.choices + x.inputs + x.switches + x.outputs + x.entries,
    "Scene.peak_parts": lambda x: 3 * x.peaks,
    "Scene.normal": lambda x: max(thresholds.TRIES, thresholds.RANKED) * x.n,
    **{
        name: attrgetter(count)
        for name, count in {
            **{"Choice.values": "count", "Switch.rows": "count", "Pattern.indices": "entries", "Program.code": "words"},
            **dict.fromkeys(("Envelope.place", "Envelope.first", "Envelope.start"), "size"),
            **{"Scene.choice": "choices", "Scene.switched": "switches", "Scene.friction": "frictions"},
            **{
                "Scene.impulse_rows": "impulses",
                "Scene.event_places": "event_count",
                "Scene.coordinates": "n",
                "Scene.readiness": "n",
            },
            **{"Scene.rows": "l", "Scene.angle_starts": "angles", "Scene.tied": "ties"},
            **{"Scene.break_levels": "break_count", "Scene.followed": "followed_count"},
            **{"Scene.limited": "limit_count", "Scene.leaps": "leap_count", "Scene.jacobian": "entries"},
            **{"Scene.constants": "constant_count", "Scene.functions": "function_count"},
            "Scene.programs": "program_count",
        }.items()
    },
}
"""Lengths of the arrays that fields point to; there is nothing behind other pointers."""


@cache
def _structures() -> tuple[dict[str, Any], dict[str, str]]:
    """Return the structures by name, and the type of what each pointer points to."""
    text = "".join((build.SOURCES / "core" / name).read_text(encoding="ascii") for name in ("linear.h", "scene.h"))
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    for macro, names, kind in (("SCENE_NUMBERS", NUMBERS, "int"), ("SCENE_REALS", REALS, "double")):
        fields = "".join(f"{kind} {name};" for name in names)
        text = re.sub(rf"#define NUMBER.*?\n\s*{macro}\(NUMBER\)\n#undef NUMBER", fields, text)
    made: dict[str, Any] = {}
    targets: dict[str, str] = {}
    for body, structure in re.findall(r"typedef struct \{(.*?)\} (\w+);", text, re.DOTALL):
        own: list[tuple[str, Any]] = []
        for found in re.finditer(r"(?:const\s+|struct\s+)*(\w+)\s+([^;]+);", body):
            base = found[1]
            for stars, name, size in re.findall(r"((?:\*|const\s+)*)(\w+)(?:\[(\d+)\])?", found[2]):
                type_of: Any = _PLAIN.get(base) or made.get(base)
                if "*" in stars:
                    targets[f"{structure}.{name}"] = base + " *const" * (stars.count("*") - 1)
                    if base == "char":
                        type_of = ctypes.c_char_p
                    if type_of is None:
                        type_of = ctypes.c_void_p
                    elif base != "char" or stars.count("*") > 1:
                        type_of = ctypes.POINTER(type_of)
                own.append((name, type_of * int(size) if size else type_of))
        made[structure] = type(structure, (ctypes.Structure,), {"_fields_": own})
    return made, targets


def literal(x: float) -> str:
    """Return a number in C."""
    return repr(x) if math.isfinite(x) else "NAN" if math.isnan(x) else "-INFINITY" if x < 0 else "INFINITY"


def loaded(scene: Scene) -> Structure:
    """Return the structure of a loaded scene."""
    return _structures()[0]["Scene"].from_address(scene.address)


def tables(scene: Structure, name: str, texts: bool, words: int) -> tuple[str, int]:
    """Return the scene as a constant of C of this name, and the bytes of its arrays; texts that only messages use are
    empty unless they are asked for; words of programs have so many bytes."""
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
            each = [below(x, f"{kind}.{part[0]}", getattr(x, part[0])) for part in x._fields_]
            return f"{{{', '.join(each)}}}"
        return str(x)

    def below(owner: Structure, field: str, x: Any) -> str:
        nonlocal size
        target = _structures()[1].get(field)
        if target is None or target == "char":
            return "0" if x is None else value(x, field)
        if field not in _LENGTHS or not x or not (count := _LENGTHS[field](owner)):
            return "0"
        items = [x[k] for k in range(count)]
        text = ", ".join(value(each, field) for each in items)
        text = f"static const {target} @[{count}] = {{{text}}};\n"
        if text not in arrays:
            size += (2 if target == "Word" and words == 2 else ctypes.sizeof(x._type_)) * count
            arrays[text] = f"table{len(arrays)}"
        return arrays[text]

    whole = value(scene, "")
    lines = [text.replace("@", made, 1) for text, made in arrays.items()]
    return "".join(lines) + f"static const Scene {name} = {whole};\n", size
