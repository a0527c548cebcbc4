"""Self-contained C of a mechanism: one file with the runtime, the scene as constant tables, and its memory.

The runtime is that of every FMU, without functions that this scene never calls, and without files, stdio, malloc and
compiler extensions. The files of `runtime/c/source` replace those of the same name.
"""

import ctypes
import logging
import re
import struct
import zipfile
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..equations.interface import default_settings
from ..kernel.arrangement import KINDS, NARROW_HEAD, OPERANDS
from ..kernel.complete import FUNCTIONS, smallest
from ..kernel.form import Call, Choice, Factor, Lanes, LeastNorm, Loop, Program, Routine, Steps, Traced, called, every
from ..kernel.shorten import shortened
from ..kernel.tables import PROGRAMS, identified, packed
from ..model.errors import ExportError
from ..model.settings import internal_steps
from ..runtime import build, pipeline
from ..runtime.library import DONE, Scene, Unit
from ..runtime.shipped import installed
from . import native
from .constants import Structure, literal, loaded, tables
from .reached import reached, undeclared

_LOGGER = logging.getLogger("alfmu")

_INSTANCE = 80
"""Size of an Instance without messages, in numbers: an upper bound, which the C checks on each machine."""

_TEXT = 256
"""Longest message of an FMU."""

MOST_ITERATIONS = 1000
"""Assumed iterations of a loop without a fixed number: the largest value of solver.max_iterations."""

STATES = 2
"""Number of saved states for which an FMU has memory."""

_RESERVED = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main abs acos
    acosh asin asinh atan atan2 atanh ceil copysign cos cosh erf exp expm1 fabs floor fmax fmin fmod free frexp hypot
    ldexp log log1p malloc memcpy memset pow remainder sin sinh sqrt tan tanh""".split()  # noqa: SIM905
)
"""C names that a model must not have."""

_STEPS = 1000
"""Largest number of internal steps of a communication step, unless twice that of the default experiment is more."""


def source(equations: Traced, fmi: int = 0, guid: str = "") -> dict[str, str]:
    """Return the C files of traced equations, for an FMU of version `fmi` with this GUID, or as plain C for 0."""
    if equations.name in _RESERVED:
        raise ExportError(f"{equations.name}: the model has a name of C; give the recipe another name")
    own, name = smallest(equations), equations.name
    kept = Scene(identified(packed(own, shares=True), guid), installed())
    scene = loaded(kept)
    scene.exchange = -1  # no Model Exchange
    unit, steps = Unit(kept), internal_steps(own.interval, default_settings(own).step_size)
    unit.initialize()
    state = unit.save()
    starts = bool(fmi or scene.own or scene.followed_count or scene.switches or scene.frictions or scene.brakes)
    start, start_size = ("", 0) if starts else _start(state)
    without = native.left_out(equations, derivatives=False, exchange=False)
    without = [*without, "ERROR_CONTROL", *["START"] * (not starts), *["LIMITS"] * ("limit" not in own.kernel)]
    header, *texts = _texts(fmi, without)
    used = {*re.findall(r"(?:->|\.)(\w+)", _reached("".join([header, *texts])))}
    run = _lean(scene, own, used)
    if kept.library.alfmu_share_places(kept.address) < 0:
        raise MemoryError
    _abbreviate(scene)
    work, kinds, forms = _measured(scene, own, run, steps)
    widest = max(abs(word) for each in scene.programs[: scene.program_count] for word in each.code[: each.words])
    functions = scene.functions[: scene.function_count]
    widest = max(widest, *(max(each.inputs, each.outputs, each.results, each.base) for each in functions))
    word = 16 if widest < 2**15 else 32
    left = ["compiled", "in_lanes", *["wide"] * ("wide" not in forms)]
    constants, size = tables(scene, fmi > 0, word // 8, used, left)
    length = kept.library.alfmu_length(kept.address, starts)
    place = length + _INSTANCE + (2 * _TEXT // 8 if fmi else 0)
    defined: dict[str, object] = {"NUMBERS": length, "MESSAGE": _TEXT if fmi else 8, "HAS_START": int(starts)}
    defined |= {"INPUTS": max(scene.inputs, 1), "WORD": f"int{word}_t", "HAS_WIDE": int("wide" in forms)}
    defined |= {"HAS_NARROW": int("narrow" in forms), "IN_SOURCES": 1}
    memory = f"{8 * place} bytes of memory an instance"
    if fmi:
        instance, saved = place + 160, len(state) // 8 + 8
        instance += 2 * saved * (fmi > 2)  # intermediate updates need two states of their own
        defined["ARENA"] = f"(INSTANCES * {instance} + SAVED_STATES * {saved})"
        defined["NO_MEMORY"] = _NO_MEMORY
        memory = f"{8 * (instance + STATES * saved)} bytes of memory for one instance and {STATES} states"
    head = [
        f"/* {name}: the mechanism and the runtime of alfmu in C99; generated.",
        f"   {size + start_size} bytes of constant tables, {memory}",
        f"   {work} */",
        f"#ifndef MOST_STEPS\n#define MOST_STEPS {max(_STEPS, 2 * steps)}\n#endif",
        *_HELD * (fmi > 0),
        "#if defined(__clang__)\n#pragma STDC FP_CONTRACT OFF\n#endif",
        "#if !defined(assert)\n#define assert(true) ((void)0)\n#endif",
        *(f"#include <{each}.h>" for each in _SYSTEM),
        *["#if defined(__unix__) || defined(__APPLE__) || defined(_WIN32)\n#include <fenv.h>\n#endif"] * (fmi > 0),
        *[f'#include "{name}.h"'] * (not fmi),
        *(f"#define {key} {number}" for key, number in defined.items()),
    ]
    if not any(isinstance(step, Lanes | Routine) for program in run.values() for step in every(program.steps)):
        texts = [each.replace("at = routine_run(i, at);", "return;") for each in texts]
    header = re.sub(rf"^\t[\w ]+\*(?:{'|'.join(left)});\n", "", header, flags=re.MULTILINE)
    if "wide" not in forms:
        texts = [_WIDE.sub("", each) for each in texts]
    text = _reached("".join([header, constants, start, *texts]))
    text = _prefixed(text, fmi) if fmi else _named(text, name)
    if "wide" not in forms:
        text = _OPERATION.sub(lambda row: row[0] if row[1] or int(row[2]) in kinds else "", text)
    files = {f"{name}.c": "\n".join([*head, text])}
    if not fmi:
        files |= {f"{name}.h": _header(kept, name, place), f"{name}_main.c": _example(kept, name, equations)}
    return files


_WIDE = re.compile(r"^#if HAS_WIDE\n.*?^#endif\n", re.MULTILINE | re.DOTALL)
"""Matches what functions with wide places need."""

_HELD = [
    "#ifndef INSTANCES\n#define INSTANCES 1 /* at the same time */\n#endif",
    f"#ifndef SAVED_STATES\n#define SAVED_STATES {STATES} /* at the same time */\n#endif",
    "#define IN_TEXT_(number) #number\n#define IN_TEXT(number) IN_TEXT_(number)",
]
_NO_MEMORY = (
    '"all memory is in use, that of " IN_TEXT(INSTANCES) " instances and " IN_TEXT(SAVED_STATES) " saved states; "'
    ' "free one, or compile the FMU with larger INSTANCES or SAVED_STATES"'
)
"""The message if all memory is in use."""

_SYSTEM = ("float", "limits", "math", "stdarg", "stdbool", "stddef", "stdint", "string")

_OPERATION = re.compile(r"(\(X\) \\\n\t)?\bX\((\d+), .*\)(?=[ \\]*\n)")
"""Matches an operation in a list of the interpreter, with its kind; the first one includes the head of the list."""


def facts(path: Path) -> list[str]:
    """Return the lines on size and work in the first comment of a C file, or of the C file in an FMU."""
    if path.suffix == ".c":
        text = path.read_text(encoding="ascii")
    else:
        with zipfile.ZipFile(path) as archive:
            text = archive.read(next(each for each in archive.namelist() if each.endswith(".c"))).decode()
    return [line.strip().removesuffix(" */") for line in text.partition("*/")[0].splitlines()[1:]]


# The scene ------------------------------------------------------------------------------------------------------------


def paced(e: Traced, fixed: bool) -> Traced:
    """Return equations with the internal step of sources, tried in the default experiment: their own one or, unless it
    is `fixed`, its half, quarter, ...; the first without a warning or, if there is none, the first that does not fail.

    Raise ExportError if there is none, with the reason of the complete scene if this fails, too. Log why the step is
    not their own one, and the warning that is left.
    """
    whole, first, found, left = default_settings(e).step_size, "", None, ""
    longest = min(whole, e.interval)
    for k in range(1 if fixed else _HALVINGS):
        tried = replace(e, solver={**e.solver, "step_size": longest / 2**k}) if k else e
        made, said = _ran(packed(smallest(tried), shares=True), e)
        first = first or said
        if made == DONE and not (said and found):
            found, left = tried, said
        if not said:
            break
    if found is None:
        # If RK4 fails with any number of iterations, the reason is another one.
        made, said = _ran(pipeline.packed(e), e)
        raise ExportError(
            f"{first if made == DONE else said}; sources make steps of RK4 with fixed numbers of iterations, which "
            f"have to serve for the default experiment: choose a shorter {'--set solver.step_size or ' * fixed}"
            "--stop-time, or use --kind native"
        )
    if found is not e:
        text = "%s: internal steps are %g s, chosen for the default experiment; with %g s, %s"
        _LOGGER.warning(text, e.name, default_settings(found).step_size, longest, first)
    if left:
        _LOGGER.warning("%s (the default experiment; plain C does not tell when it runs)", left)
    return found


_HALVINGS = 9
"""Number of internal steps that are tried, with the declared one."""


def _ran(scene: bytes, e: Traced) -> tuple[int, str]:
    """Return the outcome of the default experiment of a scene, and the reason of a failure or the warning."""
    unit = Unit(Scene(scene, installed()))
    made = unit.initialize()
    for k in range(round(e.stop_time / e.interval)):
        made = made or unit.step(k * e.interval, e.interval)
    return made, unit.text if made != DONE else unit.warning()


def _start(state: bytes) -> tuple[str, int]:
    """Return C constants with the state after the start, and their size in bytes."""
    flags = struct.unpack_from(f"<{_FLAGS}i", state, _HEAD)
    numbers = struct.unpack(f"<{(len(state) - _NUMBERS) // 8}d", state[_NUMBERS:])
    text = f"static const double start_numbers[] = {{{', '.join(map(literal, numbers))}}};\n"
    own, choices = (", ".join(map(str, each)) for each in (flags[:-_CHOICES], flags[-_CHOICES:]))
    text += f"static const Flags start_flags = {{{own}, {{{choices}}}}};\n"
    return text, 8 * len(numbers) + 4 * _FLAGS


_HEAD, _FLAGS, _NUMBERS, _CHOICES = 72, 14, 128, 3
"""Layout of a saved state (step/state.c): offset and number of flags, offset of numbers [bytes], number of choices."""


def _lean(scene: Structure, e: Traced, used: Container[str]) -> dict[str, Program]:
    """Remove functions and programs that the C does not use from a scene; return the programs that it runs."""
    run = {own: e.kernel[own] for name, own in PROGRAMS.items() if name in used and own in e.kernel}
    needed = {own for name, own in FUNCTIONS.items() if name in used}
    needed.update(name for program in run.values() for name in called(program))
    places = [f.inputs + f.outputs for f in scene.functions[: scene.function_count]]
    for name, program in zip(e.kernel, scene.programs[: scene.program_count], strict=True):
        program.words *= name in run
        _shorten(program, places)
    for name, f in zip(e.functions, scene.functions[: scene.function_count], strict=True):
        if name not in needed:
            f.inputs = f.outputs = f.words = f.results = 0
    scene.choice[scene.formulation].count = 1
    return run


def _shorten(program: Structure, places: Sequence[int]) -> None:
    """Replace the words of a program by fewer ones, in which repeated sequences stand once."""
    words = shortened(program.code[: program.words], places)
    for k, word in enumerate(words):
        program.code[k] = word
    program.words = len(words)


def _abbreviate(scene: Structure) -> None:
    """Write register numbers of functions with 8 bits if these suffice, relative to the first constant that a function
    reads.

    Constants of functions with many registers come last.
    """
    functions = [f for f in scene.functions[: scene.function_count] if f.narrow and (f.words or f.results)]
    count, places = scene.constant_count, [[*map(f.narrow.__getitem__, _places(f))] for f in functions]
    order = list(range(count))
    if not any(f.wide for f in scene.functions[: scene.function_count]):  # whose steps lead from constant to constant
        largest = [0] * count
        for f, own in zip(functions, places, strict=True):
            for place in {*own}.intersection(order):
                largest[place] = max(largest[place], f.registers)
        order.sort(key=largest.__getitem__)
        values = [scene.constants[k] for k in order]
        for k, value in enumerate(values):
            scene.constants[k] = value
    new = [*sorted(order, key=order.__getitem__), *range(count, scene.registers)]
    for f, own in zip(functions, places, strict=True):
        for k in _places(f):
            f.narrow[k] = new[f.narrow[k]]
        base = min([new[place] for place in own] or [0])
        words = f.narrow[: f.words + f.results]
        for k in _places(f):
            words[k] -= base
        if max(words, default=0) < 2**8:
            f.base, f.brief = base, (ctypes.c_uint8 * len(words))(*words)
            f.narrow = None


def _places(f: Structure) -> list[int]:
    """Return where the words and results of a narrow function are places."""
    found, at = list[int](), 0
    while at < f.words:
        end = at + NARROW_HEAD + f.narrow[at + 1] * OPERANDS[KINDS[f.narrow[at]]]
        found += range(at + 2, end)
        at = end
    return [*found, *range(f.words, f.words + f.results)]


def _measured(scene: Structure, e: Traced, run: Mapping[str, Program], steps: int) -> tuple[str, set[int], set[str]]:
    """Fit the registers of a lean scene to its functions. Return the line on its work, the kinds of operations, and
    the forms of functions."""
    costs = Counter[str]()
    kinds, forms = set[int](), set[str]()
    scene.registers = scene.constant_count
    for name, f in zip(e.functions, scene.functions[: scene.function_count], strict=True):
        if f.words or f.results:
            made = _operations(f)
            scene.registers = max(scene.registers, f.registers)
            forms.add("brief" if f.brief else "narrow" if f.narrow else "wide")
            costs[name], kinds = made.total(), kinds | {*made}
    scene.lane_registers = 0
    most = {key: _most(program.steps, costs) for key, program in run.items()}
    return _work(e, most, steps, bool(scene.break_count)), kinds, forms


def _operations(f: Structure) -> Counter[int]:
    """Return how many operations of each kind a function makes."""
    found, places, at, head = Counter[int](), f.brief or f.narrow or f.wide, 0, 2 if f.wide else NARROW_HEAD
    while at < f.words:
        found[places[at]] += places[at + 1]
        at += head + places[at + 1] * OPERANDS[KINDS[places[at]]]
    return found


def _work(e: Traced, every: Mapping[str, int], steps: int, breaks: bool) -> str:
    """Return a line with the usual and the largest number of operations in a communication step of the default
    experiment."""
    tiers, ends = ("quick", "careful", "branch"), ("instant_quick", "instant", "limit")
    usual = steps * every["quick"] + every.get("instant_quick", every["instant"])
    step, reading = (sum(every.get(each, 0) for each in programs) for programs in (tiers, ends))
    most = f"{steps * step + reading} at most"
    if e.frictions or e.switches or e.leaps or breaks:
        most = f"more at events: at most {step} in each of MOST_STEPS internal steps and {reading} for outputs"
    return f"a step of {e.interval:g} s (internal steps: {steps}): {usual} operations as a rule, {most}"


def _most(steps: Steps, costs: Mapping[str, int]) -> int:
    """Return an upper bound of the operations of steps; a choice counts both of its branches."""
    found = 0
    for step in steps:
        if isinstance(step, Call):
            found += costs[step.function]
        elif isinstance(step, Choice):
            found += _most((*step.nonzero, *step.zero), costs)
        elif isinstance(step, Loop):
            found += (step.most if isinstance(step.most, int) else MOST_ITERATIONS) * _most(step.body, costs)
        elif isinstance(step, Lanes):
            found += _most(step.calls, costs)
        else:
            side = step.side * step.count
            found += 60 * side**3 if isinstance(step, LeastNorm) else 2 * side**2
            found += side**3 // 3 if isinstance(step, Factor) else 0
    return found


# The text -------------------------------------------------------------------------------------------------------------


def _texts(fmi: int, without: list[str]) -> list[str]:
    """Return the C of the runtime without these features: headers, files, and the functions of FMI or of plain C."""
    own = {path.name: path.read_text(encoding="ascii") for path in (build.SOURCES / "source").glob("*.[ch]")}
    if fmi:
        del own["message.h"]
    else:
        own |= dict.fromkeys(("message.c", "text.c", "text.h"), "")
    texts = [*native.sources(fmi, without, own).values()]
    for pattern, instead in _INSTEAD.items():
        texts = [re.sub(pattern, instead, text, flags=re.MULTILINE) for text in texts]
    return texts


_INSTEAD = {
    r"^#include .*\n": "",
    r"\bdefined\((?:__GNUC__|__SSE2__|_M_X64|__GLIBC__)\)": "0",
    r'__attribute__\(\(visibility\("default"\)\)\)': "",
    r"\bcalloc\(": "memory_take(",
    r"\bmalloc\(": "memory_take(1, ",
    r"\bfree\(": "memory_give(",
    r"\bsnprintf\(": "write_text(",
    r"\bscene_of_fmu\(resources, why, why_size\)": "((void)resources, (Scene *)(void *)&the_scene)",
    r"\bscene_free\(c->scene\);": "",
    r"(?<![\w>])(?!c->scene\b)(\w+(?:->\w+)*)->scene\b(?!\s*=[^=])": r"SCENE_OF(\1)",
    r"^} Scene;$": "} Scene;\nstatic const Scene the_scene;\n#define SCENE_OF(i) ((void)(i), &the_scene)",
}
"""Replacements for headers, compiler extensions, memory allocation, files and loaded scenes, by pattern."""


def _named(text: str, name: str) -> str:
    """Return plain C with the name of the model; names of the runtime that collide with it get a prefix."""
    own = "|".join([name, *(each.replace("NAME", name) for each in set(re.findall(r"\bNAME_\w+", text)))])
    words = re.compile(rf'"(?:\\.|[^"\\])*"|\b(?:{own})\b')
    text = words.sub(lambda found: found[0] if found[0].startswith('"') else f"runtime_{found[0]}", text)
    return text.replace("NAME", name)


def _prefixed(text: str, fmi: int) -> str:
    """Return C whose FMI functions have the model's prefix, so that several models can be linked together."""
    macro = f"FMI{fmi}_FUNCTION_PREFIX"
    names = {*re.findall(rf"\b(?:UNKNOWN\()?(fmi{fmi}[A-Z]\w+)[()]", text)}
    for kind in re.findall(r"^\w*VALUES\((\w+)\b", text, re.MULTILINE):
        names |= {f"fmi{fmi}Get{kind}", f"fmi{fmi}Set{kind}"}
    [state] = re.findall(r"^SHARED_CALLS\(PASSED, (\w+),", text, re.MULTILINE)
    passed = re.findall(r"\b(?:X|PASSED|NEVER_PENDING|NO_VARIABLE)\((?![GS]et##TYPE)([\w#]*[a-z][\w#]*),", text)
    names |= {f"fmi{fmi}{each.replace('##', '').replace('STATE', state)}" for each in passed}
    lines = [f"#if defined({macro})", "#define JOINED(a, b) JOINED_(a, b)", "#define JOINED_(a, b) a##b"]
    lines += [f"#define {each} JOINED({macro}, {each})" for each in sorted(names)]
    return "\n".join([*lines, "#endif\n"]) + text


_OUTSIDE = re.compile(r"fmi[23][A-Z]\w*|NAME_\w+")
"""Matches public functions."""


def _reached(text: str) -> str:
    """Return C without unused functions, constants and macros; all others but the public ones become static."""
    made = []
    for name, chunk in undeclared(reached(text, _OUTSIDE.fullmatch)):
        if name and not chunk.startswith(("#", "static", "API")) and not _OUTSIDE.fullmatch(name):
            chunk = "static " + chunk.removeprefix("extern ")
        made.append(chunk)
    return "".join(made)


def _identifiers(scene: Scene, name: str) -> list[str]:
    """Return a unique C name for each variable."""
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

#ifdef __cplusplus
extern "C" {{
#endif

/* An instance and its memory, all of which it takes. There may be any number of them. */
typedef struct {{
    double memory[{place}];
}} {name};

/* Variables: parameters, start values and text variables (numbers from 1 on), then inputs, then outputs. */
enum {{
{listed}    {name.upper()}_VARIABLES
}};

/* Results of functions. REFUSED: the value or the call is invalid, and nothing has changed. Other numbers above zero:
   the step failed, and the state before it is kept. */
enum {{ {name.upper()}_DONE, {name.upper()}_REFUSED }};

/* {name}_init sets an instance to its default values; call it first. {name}_set sets a value in SI units:
   parameters and start values before the start, inputs at any time. {name}_start starts at a time [s] and closes the
   constraints; outputs are known from then on. {name}_step makes a step of a length [s] with the present inputs, in
   internal steps of solver.step_size. {name}_get returns a value, NAN if it is unknown; {name}_time the time [s]. */
void {name}_init({name} *m);
int {name}_set({name} *m, int variable, double value);
int {name}_start({name} *m, double time);
int {name}_step({name} *m, double length);
double {name}_get({name} *m, int variable);
double {name}_time({name} *m);

#ifdef __cplusplus
}}
#endif

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
