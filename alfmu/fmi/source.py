"""Self-contained C of a mechanism: one file with the runtime, the scene as constant tables, and its memory.

The runtime is that of every FMU, without the functions that this scene never calls, files, stdio, malloc, and
extensions of compilers. The files of `runtime/c/source` stand in place of those of the same name.
"""

from __future__ import annotations

import re
import struct
import zipfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from ..equations.interface import default_settings
from ..kernel.arrangement import KINDS, OPERANDS
from ..kernel.form import Traced
from ..kernel.scene import CALLS
from ..kernel.tables import FUNCTIONS, identified, packed_fixed
from ..model.errors import ExportError
from ..model.settings import internal_steps
from ..runtime import build
from ..runtime.library import DONE, Scene, Unit
from ..runtime.shipped import installed
from . import native
from .constants import Structure, literal, loaded, tables

__all__ = ["facts", "source"]

_OWN = build.SOURCES / "source"
_ABSENT = ("adaptive.c", "files.c", "message.c", "record.c", "resources.c", "robust.c", "text.c")
_LOADER = re.compile(r"scene(_functions|_programs|_reader|_tables)?\.c")
_SYSTEM = ("float", "limits", "math", "stdarg", "stdbool", "stddef", "stdint", "string")
_INSTANCE = 96
"""Numbers in whose place an Instance without messages fits on every machine."""

_TEXT = 256
"""Longest message of an FMU."""

MOST_ITERATIONS = 1000
"""Iterations of a loop without a fixed number: the largest solver.max_iterations."""

STATES = 2
"""States of an instance that an FMU has memory for."""


_RESERVED = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main abs acos
    acosh asin asinh atan atan2 atanh ceil copysign cos cosh erf exp expm1 fabs floor fmax fmin fmod free hypot log
    log1p malloc memcpy memset pow remainder sin sinh sqrt tan tanh""".split()  # noqa: SIM905
)
"""Names in C that a model may not have."""

_STEPS = 1000
"""Most internal steps of a communication step, if that of the default experiment has fewer."""


def source(equations: Traced, fmi: int = 0, guid: str = "") -> dict[str, str]:
    """Return C files of traced equations: those of an FMU of a version of FMI with this GUID, or plain C for 0."""
    if equations.name in _RESERVED:
        raise ExportError(f"{equations.name}: the model has a name of C; give the recipe another name")
    kept, name = Scene(identified(packed_fixed(equations), guid), installed()), equations.name
    scene = loaded(kept)
    scene.exchange = -1
    state = _state(kept, equations)
    steps = internal_steps(equations.interval, default_settings(equations).step_size)
    starts = bool(fmi or scene.own or scene.followed_count or scene.switches or scene.frictions or scene.brakes)
    start, start_size = ("", 0) if starts else _start(state)
    without = [*dict.fromkeys([*native.left_out(equations, derivatives=False, exchange=False), "ERROR_CONTROL"])]
    texts = _texts(fmi, [*without, *["START"] * (not starts)])
    used = _reached("".join(texts))
    wide = _lean(scene, set(_WORD.findall(used)))
    word = _word(scene)
    constants, size = tables(scene, "the_scene", fmi > 0, word // 8)
    length = kept.library.alfmu_length(kept.address, starts)
    place, message = length + _INSTANCE + (2 * _TEXT // 8 if fmi else 0), _TEXT if fmi else 8
    defined: dict[str, object] = {"NUMBERS": length, "MESSAGE": message, "HAS_START": int(starts)}
    defined |= {"INPUTS": max(scene.inputs, 1), "WORD": f"int{word}_t", "HAS_WIDE": int(wide)}
    defined |= {f"HAS_{each}": 0 for each in without}
    memory = f"{8 * place} bytes of memory an instance"
    if fmi:
        instance, saved = place + 160, len(state) // 8 + 8
        defined["ARENA"] = f"(INSTANCES * {instance} + {STATES} * {saved})"
        memory = f"{8 * (instance + STATES * saved)} bytes of memory for one instance and {STATES} states"
    head = [
        f"/* {name}: the mechanism and the runtime of alfmu in C99; generated.",
        f"   {size + start_size} bytes of constant tables, {memory}",
        f"   {_work(scene, equations, steps)} */",
        f"#ifndef MOST_STEPS\n#define MOST_STEPS {max(_STEPS, 2 * steps)}\n#endif",
        *["#ifndef INSTANCES\n#define INSTANCES 1 /* at the same time */\n#endif"] * (fmi > 0),
        "#if defined(__clang__)\n#pragma STDC FP_CONTRACT OFF\n#endif",
        "#if !defined(assert)\n#define assert(true) ((void)0)\n#endif",
        *(f"#include <{each}.h>" for each in _SYSTEM),
        *[f'#include "{name}.h"'] * (not fmi),
        *(f"#define {key} {number}" for key, number in defined.items()),
    ]
    text = _reached(texts[0] + constants + start + texts[1])
    if not fmi:
        text = _named(text, name)
    text = text if wide else _of_kinds(text, _kinds(scene))
    files = {f"{name}.c": "\n".join([*head, _prefixed(text, fmi) if fmi else text])}
    if not fmi:
        files |= {f"{name}.h": _header(kept, name, place), f"{name}_main.c": _example(kept, name, equations)}
    return files


def _named(text: str, name: str) -> str:
    """Return plain C with the name of the model, which nothing of the runtime has."""
    own = "|".join([name, *(each.replace("NAME", name) for each in set(re.findall(r"\bNAME_\w+", text)))])
    words = re.compile(rf'"(?:\\.|[^"\\])*"|\b(?:{own})\b')
    text = words.sub(lambda found: found[0] if found[0].startswith('"') else f"runtime_{found[0]}", text)
    return text.replace("NAME", name)


def facts(path: Path) -> list[str]:
    """Return what the C of a file or of an FMU says of its size and its work."""
    if path.suffix == ".c":
        text = path.read_text(encoding="ascii")
    else:
        with zipfile.ZipFile(path) as archive:
            text = archive.read(next(each for each in archive.namelist() if each.endswith(".c"))).decode()
    return [line.strip().removesuffix(" */") for line in text.partition("*/")[0].splitlines()[1:]]


def _lean(scene: Structure, words: set[str]) -> bool:
    """Leave out of a scene what the words of its C do not mention; return whether functions have wide places."""
    called = {getattr(scene, name) for name in FUNCTIONS if name in words}
    for program in scene.programs[: scene.program_count]:
        called |= {each for _, each, _ in _steps(scene, program.code[: program.words])}
    scene.registers, wide = scene.constant_count, False
    for k, f in enumerate(scene.functions[: scene.function_count]):
        if k in called:
            scene.registers, wide = max(scene.registers, f.registers), wide or bool(f.wide)
        else:
            f.inputs = f.outputs = f.words = f.results = 0
    if "normal" not in words:
        scene.normal = None
    scene.choice[scene.formulation].count = 1
    scene.lane_registers = 0
    return wide


def _kinds(scene: Structure) -> set[int]:
    """Return the kinds of operations of functions whose places are narrow."""
    found = set()
    for f in scene.functions[: scene.function_count]:
        at = 0
        while at < f.words:
            found.add(f.narrow[at])
            at += 2 + f.narrow[at + 1] * OPERANDS[KINDS[f.narrow[at]]]
    return found


def _of_kinds(text: str, kinds: set[int]) -> str:
    """Return C without the operations that no function has, but one of each number of operands."""

    def rows(found: re.Match[str]) -> str:
        lines = re.findall(r"X\((\d+), .*\)", found[2])
        own = [line for k, line in enumerate(re.findall(r"X\(\d+, .*\)", found[2])) if not k or int(lines[k]) in kinds]
        return found[1] + " \\\n\t".join(["", *own]) + "\n"

    return re.sub(r"(#define (?:BINARY|UNARY)_OPERATIONS\(X\))((?:.*\\\n)+.*\n)", rows, text)


def _word(scene: Structure) -> int:
    """Return the bits of the words of programs."""
    words = (word for program in scene.programs[: scene.program_count] for word in program.code[: program.words])
    return 16 if max(map(abs, words), default=0) < 2**15 else 32


def _state(scene: Scene, e: Traced) -> bytes:
    """Return the state after the start; ExportError where the default experiment cannot be made from there."""
    unit = Unit(scene)
    made = unit.initialize()
    state = unit.save()
    for k in range(round(e.stop_time / e.interval)):
        made = made or unit.step(k * e.interval, e.interval)
    if made != DONE:
        raise ExportError(
            f"{unit.text}; sources make steps of RK4 with fixed numbers of iterations, which have to serve for the "
            "default experiment: choose a shorter --set solver.step_size or --stop-time, or use --kind native"
        )
    return state


def _start(state: bytes) -> tuple[str, int]:
    """Return constants of the state after the start, and their bytes."""
    flags = struct.unpack_from(f"<{_FLAGS}i", state, _HEAD)
    numbers = struct.unpack(f"<{(len(state) - _NUMBERS) // 8}d", state[_NUMBERS:])
    text = f"static const double start_numbers[] = {{{', '.join(map(literal, numbers))}}};\n"
    own, choices = (", ".join(map(str, each)) for each in (flags[:-CHOICES], flags[-CHOICES:]))
    text += f"static const Flags start_flags = {{{own}, {{{choices}}}}};\n"
    return text, 8 * len(numbers) + 4 * _FLAGS


_HEAD, _FLAGS, _NUMBERS, CHOICES = 72, 14, 128, 3
"""In a saved state (step/state.c): where flags begin and how many there are, and where numbers begin."""


def _texts(fmi: int, without: list[str]) -> tuple[str, str]:
    """Return the runtime as C without these features, and behind it the functions of FMI or of plain C."""
    absent = {file for each in without if each in native.FEATURES for file in native.FEATURES[each].files} | {*_ABSENT}
    last = f"fmi{fmi}.c" if fmi else "plain.c"
    folders = [each for each in build.FOLDERS if each not in ("binding", *["fmi"] * (not fmi))]
    paths = {path.name: path for path in [*build.sources(folders), *_OWN.glob("*.[ch]")]}
    absent |= {"fmi2.c", "fmi3.c", "plain.c"} - {last} | {each for each in paths if _LOADER.fullmatch(each)}
    texts = {key: native.without_comments(path.read_text(encoding="ascii")) for key, path in paths.items()}
    texts = {key: native.featured(text, without) for key, text in texts.items() if key not in absent}
    texts["scene.h"] += "static const Scene the_scene;\n#define SCENE_OF(i) ((void)(i), &the_scene)\n"
    found: set[str] = set()

    def joined(names: list[str]) -> str:
        text = "".join(native.with_headers(texts[each], texts, found) for each in names)
        text = _EXTENSIONS.sub("0", re.sub(r"^#include <.*>\n", "", text, flags=re.MULTILINE))
        text = text.replace('__attribute__((visibility("default")))', "")
        return re.sub(r"(?<![\w>])(?!c->scene\b)(\w+(?:->\w+)*)->scene\b(?!\s*=[^=])", r"SCENE_OF(\1)", text)

    return joined([each for each in texts if each.endswith(".c") and each != last]), joined([last])


_EXTENSIONS = re.compile(r"\bdefined\((?:__GNUC__|__SSE2__|_M_X64|__GLIBC__)\)")
"""Conditions for extensions of compilers, none of which holds in sources."""


def _prefixed(text: str, fmi: int) -> str:
    """Return C with the prefix that FMI gives functions of models that are linked together."""
    macro = f"FMI{fmi}_FUNCTION_PREFIX"
    names = set(re.findall(rf"\b(fmi{fmi}[A-Z]\w+)\(", text)) | set(
        re.findall(r"^UNKNOWN\((\w+)\)", text, re.MULTILINE)
    )
    kinds = re.findall(r"^\w*(?:VALUES|VECTOR)\((\w+)\b", text, re.MULTILINE)
    names |= {f"fmi{fmi}{form}{kind}" for kind in kinds for form in ("Get", "Set")}
    lines = [f"#if defined({macro})", "#define JOINED(a, b) JOINED_(a, b)", "#define JOINED_(a, b) a##b"]
    lines += [f"#define {each} JOINED({macro}, {each})" for each in sorted(names)]
    return "\n".join([*lines, "#endif\n"]) + text


def _chunks(text: str) -> Iterator[str]:
    """Yield directives, and declarations and definitions at the top level."""
    chunk, depth = "", 0
    for line in text.splitlines(keepends=True):
        chunk += line
        if chunk.startswith("#"):
            whole = not line.endswith("\\\n")
        else:
            bare = re.sub(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'', "", line)
            depth += bare.count("{") - bare.count("}")
            whole = not depth and (bare.rstrip().endswith((";", "}")) or bool(re.match(r"[A-Z_0-9]+\(.*\)$", bare)))
        if whole and (chunk.startswith("#") or not depth):
            yield chunk
            chunk = ""


_FUNCTION = re.compile(r"(?!typedef|enum|struct|union)[A-Za-z][^={}#;]*?\b(\w+)\([^={};]*\)\s*(\{|;)")
_DATA = re.compile(r"(?:extern |static )?(?:const )?\w[\w \*]*?\b(\w+)(?:\[[^\]]*\])*\s*(?:=|;)")
_MACRO = re.compile(r"#define (\w+)")
_WORD = re.compile(r"\b[A-Za-z_]\w*\b")


def _reached(text: str) -> str:
    """Return C without the functions, constants and macros that nothing outside can reach; what is left is static."""
    chunks = list(_chunks(text))
    owners: dict[str, list[int]] = defaultdict(list)
    named: list[str] = []
    kept: set[int] = set()
    for k, chunk in enumerate(chunks):
        if chunk.startswith("#"):
            found = _MACRO.match(chunk)
        else:
            found = _FUNCTION.match(chunk) or (None if "typedef" in chunk[:8] else _DATA.match(chunk))
        known = found[1] if found else ""
        named.append(known)
        if known:
            owners[known].append(k)
    outside = re.compile(r"fmi[23][A-Z]\w*|NAME_\w+")
    waiting = [k for k, each in enumerate(named) if not each or outside.fullmatch(each)]
    while waiting:
        k = waiting.pop()
        if k in kept:
            continue
        kept.add(k)
        for word in _WORD.findall(chunks[k]):
            waiting += [each for each in owners.get(word, ()) if each not in kept]
    return "".join(_static(chunks[k], named[k], outside) for k in sorted(kept))


def _static(chunk: str, known: str, outside: re.Pattern[str]) -> str:
    if not known or chunk.startswith(("#", "static", "API")) or outside.fullmatch(known):
        return chunk
    return "static " + chunk.removeprefix("extern ")


_CALL, _CHOICE, _LOOP, _FACTOR, _SOLVE, _LEAST_NORM, _LANES = range(len(CALLS))


def _work(scene: Structure, e: Traced, steps: int) -> str:
    """Say how many operations a communication step of the default experiment takes: as a rule, and at most."""
    tiers, ends = ("quick", "careful", "branch_step"), ("instant_quick", "instant", "limit")
    every = {each: _operations(scene, getattr(scene, each)) for each in (*tiers, *ends)}
    usual = steps * every["quick"] + (every["instant_quick"] or every["instant"])
    step, reading = sum(every[each] for each in tiers), sum(every[each] for each in ends)
    most = f"{steps * step + reading} at most"
    if e.frictions or e.switches or e.leaps or scene.break_count:
        most = f"at events more: at most {step} in each of MOST_STEPS internal steps and {reading} for outputs"
    return f"a step of {e.interval:g} s (internal steps: {steps}): {usual} operations as a rule, {most}"


def _operations(scene: Structure, program: int) -> int:
    """Return the most operations of a program."""
    if program < 0:
        return 0
    kept = scene.programs[program]

    def of(times: int, function: int, own: int) -> int:
        if function < 0:
            return own
        f = scene.functions[function]
        return times * int(f.registers - scene.constant_count - sum(f.lengths[: f.inputs]))

    return sum(of(*each) for each in _steps(scene, kept.code[: kept.words]))


def _steps(scene: Structure, code: list[int]) -> Iterator[tuple[int, int, int]]:
    """Yield how often a program calls each function at most, or -1 and operations of linear algebra; of a choice both
    ways."""
    at = 0
    while at < len(code):
        what, c = code[at], at + 1
        if what == _CALL:
            f = scene.functions[code[c]]
            yield 1, code[c], 0
            at = c + 1 + f.inputs + f.outputs
        elif what in (_CHOICE, _LOOP):
            times = 1 if what == _CHOICE else code[c + 1] if code[c + 1] >= 0 else MOST_ITERATIONS
            at = c + 3 + code[c + 2] + (code[c + 1] if what == _CHOICE else 0)
            for each in _steps(scene, code[c + 3 : at]):
                yield each[0] * times, each[1], each[2] * times
        elif what == _FACTOR:
            side = code[c] * code[c + 1]
            yield 1, -1, side**3 // 3 + side**2
            at = c + 6 + code[c + 1] * code[c + 2]
        elif what == _SOLVE:
            yield 1, -1, 2 * (code[c] * code[c + 1]) ** 2
            at = c + 5 + code[c + 1]
        elif what == _LEAST_NORM:
            yield 1, -1, 60 * code[c] ** 3
            at = c + 4
        else:
            f = scene.functions[code[c + 1]]
            yield code[c], code[c + 1], 0
            at = c + 2 + code[c] * (f.inputs + f.outputs)


def _identifiers(scene: Scene, name: str) -> list[str]:
    """Return a name in C for each variable, none of them twice."""
    found: list[str] = []
    for variable in scene.names:
        base = made = re.sub(r"\W", "_", f"{name}_{variable}").upper()
        while made in found:
            made = f"{base}_{len(found)}"
        found.append(made)
    return found


def _header(scene: Scene, name: str, place: int) -> str:
    """Return the header of the functions in plain C."""
    guard = f"{name.upper()}_H"
    listed = "".join(
        f"    {each}, /* {kind} {variable} */\n"
        for each, kind, variable in zip(_identifiers(scene, name), scene.kinds, scene.names, strict=True)
    )
    return f"""/* {name}: the mechanism in C99; generated by alfmu. */

#ifndef {guard}
#define {guard}

/* An instance and its memory, all of which it takes. There may be any number of them. */
typedef struct {{
    double memory[{place}];
}} {name};

/* Variables: parameters, start values and text variables (numbers from 1 on), then inputs, then outputs. */
enum {{
{listed}    {name.upper()}_VARIABLES
}};

/* What functions return. REFUSED: a value or a call that cannot be; nothing has changed. Other numbers above zero: the
   step cannot be made; the state is that before it. */
enum {{ {name.upper()}_DONE, {name.upper()}_REFUSED }};

/* The instance at its default values; before the other functions. */
void {name}_init({name} *m);

/* A value in SI units: of a parameter or start value before the start, of an input at any time. */
int {name}_set({name} *m, int variable, double value);

/* The start of the run at a time [s]: constraints are closed, outputs are known from here on. */
int {name}_start({name} *m, double time);

/* A step of a length [s] with the present inputs, in internal steps of solver.step_size. */
int {name}_step({name} *m, double length);

/* A value now; NAN where it is not known. */
double {name}_get({name} *m, int variable);

/* The time of the state [s]. */
double {name}_time({name} *m);

#endif
"""


def _example(scene: Scene, name: str, e: Traced) -> str:
    """Return a program that prints the outputs over the default experiment."""
    names = _identifiers(scene, name)
    outputs = [names[k] for k, kind in enumerate(scene.kinds) if kind == "output"][:4]
    values = "".join(f", {name}_get(&m, {each})" for each in outputs)
    form = " ".join(["%.17g"] * (1 + len(outputs)))
    return f"""/* An example: the default experiment of {name}. cc -std=c99 -O2 {name}.c {name}_main.c -lm */

#include <stdio.h>

#include "{name}.h"

int main(void)
{{
    static {name} m;
    {name}_init(&m);
    if ({name}_start(&m, 0.0) != {name.upper()}_DONE)
        return 1;
    for (long k = 0; k < {round(e.stop_time / e.interval)}; k++) {{
        if ({name}_step(&m, {e.interval!r}) != {name.upper()}_DONE)
            return 1;
        printf("{form}\\n", {name}_time(&m){values});
    }}
    return 0;
}}
"""
