"""The functions of a scene as C: straight-line code in blocks of bounded length, so that compile time stays linear.

Each function becomes `name(x, y, w)`: arrays of its arguments and of the nonzeros of its results, and a workspace for
values that pass from one block to the next. The code has no global state and allocates nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from ..equations import Equations
from ..errors import ExportError
from .program import CHOICE, TIERS, Layout, Program

__all__ = ["sources"]

BLOCK = 400
"""Operations in one C function of a long one; compilers take more than linear time for longer blocks."""

WHOLE = 2500
"""Operations up to which a function is not cut into blocks."""

UNIT = 2_000_000
"""Characters of source in one file, roughly; several are compiled at a time."""

_FUNCTIONS = (
    *("fabs", "floor", "ceil", "sqrt", "exp", "log", "expm1", "log1p", "erf", "sin", "cos", "tan", "asin", "acos"),
    *("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
)
"""Operations that have the name of a C function."""

_BINARY = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_LT: "{} < {}",
    ca.OP_LE: "{} <= {}",
    ca.OP_EQ: "{} == {}",
    ca.OP_NE: "{} != {}",
    ca.OP_AND: "{} && {}",
    ca.OP_OR: "{} || {}",
    ca.OP_IF_ELSE_ZERO: "{} ? {} : 0.0",
    ca.OP_POW: "pow({}, {})",
    ca.OP_CONSTPOW: "pow({}, {})",
    ca.OP_ATAN2: "atan2({}, {})",
    ca.OP_FMIN: "fmin({}, {})",
    ca.OP_FMAX: "fmax({}, {})",
    ca.OP_FMOD: "fmod({}, {})",
    ca.OP_REMAINDER: "remainder({}, {})",
    ca.OP_HYPOT: "hypot({}, {})",
    ca.OP_COPYSIGN: "copysign({}, {})",
}
_UNARY = {
    ca.OP_ASSIGN: "{}",
    ca.OP_NEG: "-{}",
    ca.OP_NOT: "!{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_SIGN: "({0} > 0.0) - ({0} < 0.0)",
    **{getattr(ca, f"OP_{name.upper()}"): f"{name}({{}})" for name in _FUNCTIONS},
}

_HEAD = """\
#include <math.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#if !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif
#if !defined(__GNUC__)
#define __attribute__(x)
#endif
typedef const double *const *Arguments;
typedef double *const *Results;
typedef void Function(Arguments, Results, double *);

"""

_CALL = """
EXPORT void alfmu_call(int i, Arguments x, Results y, double *w)
{
    functions[i](x, y, w);
}

"""

_DRIVER = """
/* Internal steps until one cannot be made; each by the first tier that can make it. */
static long advance(double *m, long steps, double dt)
{{
    long done;
    m[{dt}] = dt;
    for (done = 0; done < steps; done++) {{
        int tier = (int)m[{first}];
        for (;;) {{
            tiers[tier](m, m + {workspace});
            if (m[{trouble}] == 0.0)
                break;
            /* Near a singular position no step but that on the branch can be good. */
            if (tier == 2 || (tier == 1 && m[{near}] == 0.0))
                return done;
            tier = m[{near}] != 0.0 ? 2 : 1;
        }}
        memcpy(m + {z}, m + {after}, {size} * sizeof(double));
        m[{tally} + tier] += 1.0;
        if (tier == 2)
            m[{tally} + {tiers}] += m[{near}];
    }}
    return done;
}}

EXPORT long alfmu_advance(double *m, long steps, double dt)
{{
    return advance(m, steps, dt);
}}

/* A communication step in one go; 0, and nothing has changed, where that is not possible. */
EXPORT int alfmu_communicate(double *m, double start, double h)
{{
    double tally[{tiers} + 1], ratio;
    long steps;
    if (!(h > 0.0 && h < INFINITY && fabs(start - m[{time}]) <= 1e-6 * h + 1e-12 * fabs(start)))
        return 0;
    ratio = h / m[{step_size}] * (1 - 1e-12);
    if (!(ratio < 1e9))
        return 0;
    steps = ratio <= 1.0 ? 1 : (long)ceil(ratio);
    memcpy(m + {begin}, m + {z}, {size} * sizeof(double));
    memcpy(tally, m + {tally}, sizeof tally);
    m[{time}] = start;
    if (advance(m, steps, h / (double)steps) < steps) {{
        memcpy(m + {z}, m + {begin}, {size} * sizeof(double));
        memcpy(m + {tally}, tally, sizeof tally);
        return 0;
    }}
    m[{time}] = start + h;
    return 1;
}}

EXPORT int alfmu_read(double *m)
{{
    run_instant(m, m + {workspace});
    if (m[{seen_trouble} - 1] != 0.0)
        {limit}(m, m + {workspace});
    return m[{seen_trouble}] == 0.0;
}}
"""


def sources(equations: Equations) -> tuple[list[str], int]:
    """C files with all functions that run with numbers, and the length of the workspace behind an instance's memory."""
    e, layout = equations, Layout(equations)
    files, needed = [""], 0
    for name in e.signatures:
        for text, workspace in _function(name, e.functions[name], e.name):
            if len(files[-1]) > UNIT:
                files.append("")
            files[-1] += text
            needed = max(needed, workspace)
    calls = "".join(f"extern Function {name};\n" for name in e.signatures)
    names = ",\n    ".join(e.signatures)
    calls += f"static Function *const functions[] = {{\n    {names}}};\n{_CALL}"
    if e.kernel:
        places: dict[str, int] = {}
        for name, program in e.kernel.items():
            calls += _program(f"run_{name}", program, e, layout, needed, places)
        tiers = [tier for tier in TIERS if tier in e.kernel]
        listed = ", ".join(f"run_{tier}" for tier in tiers)
        calls += f"static void (*const tiers[])(double *, double *) = {{{listed}}};\n"
        at = {name: offset for name, (offset, _) in layout.fields.items()}
        at |= {
            "workspace": layout.size,
            "time": at["z"] + layout.time,
            "trouble": at["after"] + layout.trouble,
            "near": at["after"] + layout.near,
            "tiers": len(TIERS),
            "limit": "run_limit" if "limit" in e.kernel else "run_instant",
            "size": layout.fields["z"][1],
            "step_size": at["control"],
            "first": at["control"] + 1,
            "seen_trouble": at["seen"] + layout.fields["seen"][1] - 1,
        }
        calls += _DRIVER.format(**at)
        needed += sum(places.values())
    files[-1] += calls
    return [_HEAD + text for text in files], needed


def _program(name: str, program: Program, e: Equations, layout: Layout, workspace: int, places: dict[str, int]) -> str:
    """A step as calls on the memory m and the workspace w; `places` are the lengths of what passes between them."""
    offsets: dict[str, int] = {}
    top = workspace
    for key, length in places.items():
        offsets[key] = top
        top += length

    def pointer(key: str) -> str:
        return f"m + {layout.fields[key][0]}" if key in layout.fields else f"w + {offsets[key]}"

    def made(calls: list[list]) -> list[str]:
        nonlocal top
        lines = []
        for called, *rest in calls:
            if called == CHOICE:
                number, *ways = rest
                heads = f"if (*({pointer(number)}) != 0.0) {{", "} else {"
                for head, way in zip(heads, ways, strict=True):
                    lines += [head, *("    " + line for line in made(way))]
                lines.append("}")
                continue
            inputs, outputs = rest
            for key, shape in zip(outputs, e.signatures[called]["outputs"], strict=True):
                if key not in layout.fields and key not in offsets:
                    offsets[key], places[key] = top, shape[0]
                    top += shape[0]
            x, y = (", ".join(map(pointer, keys)) for keys in (inputs, outputs))
            lines += ["{", f"    const double *x[] = {{{x}}};", f"    double *y[] = {{{y}}};"]
            lines += [f"    {called}(x, y, w);", "}"]
        return lines

    body = "".join(f"    {line}\n" for line in made(program["calls"]))
    return f"static void {name}(double *m, double *w)\n{{\n{body}}}\n"


def _function(name: str, f: ca.Function, scene: str) -> Iterator[tuple[str, int]]:
    """C of a function in one or several pieces, each with the length of the workspace that the function needs."""
    operations = list(_operations(f, scene))
    if len(operations) > WHOLE:
        yield from _blocks(name, [operations[i : i + BLOCK] for i in range(0, len(operations), BLOCK)])
        return
    yield _block(name, [_statement(line, used, made) for line, used, made in operations]), 0


def _blocks(name: str, blocks: list[list]) -> Iterator[tuple[str, int]]:
    """A long function as a chain of blocks; what a later block needs goes through the workspace, places reused."""
    born = {made: b for b, block in enumerate(blocks) for _, _, made in block if made is not None}
    last: dict[int, int] = {}
    for b, block in enumerate(blocks):
        for _, used, _ in block:
            for value in used:
                if born[value] != b:
                    last[value] = b
    place: dict[int, int] = {}
    free: list[int] = []
    ending: list[list[int]] = [[] for _ in blocks]
    size = 0
    for b, block in enumerate(blocks):
        lines, loaded = [], set()
        for line, used, made in block:
            for value in used:
                if born[value] != b and value not in loaded:
                    loaded.add(value)
                    lines.append(_defined(value, f"w[{place[value]}]"))
            lines.append(_statement(line, used, made))
        for value in (made for _, _, made in block if made in last):
            if free:
                place[value] = free.pop()
            else:
                place[value], size = size, size + 1
            ending[last[value]].append(value)
            lines.append(f"w[{place[value]}] = v{value};")
        free += [place[value] for value in ending[b]]  # Only now: within a block no place is used twice.
        yield _block(f"{name}_{b}", lines), size
    names = [f"{name}_{b}" for b in range(len(blocks))]
    declared = "".join(f"extern Function {each};\n" for each in names)
    yield declared + _block(name, [f"{each}(x, y, w);" for each in names]), size


def _block(name: str, lines: list[str]) -> str:
    body = "".join(f"    {line}\n" for line in lines)
    head = f"__attribute__((noinline)) void {name}(Arguments x, Results y, double *w)"
    return f"extern Function {name};\n{head}\n{{\n    (void)x, (void)y, (void)w;\n{body}}}\n\n"


def _statement(line: str, used: list[int], made: int | None) -> str:
    text = line.format(*(f"v{i}" for i in used))
    return text if made is None else _defined(made, text)


def _defined(number: int, value: str) -> str:
    return f"const double v{number} = {value};"


def _operations(f: ca.Function, scene: str) -> Iterator[tuple[str, list[int], int | None]]:
    """Each operation as C with places for the values it uses, their numbers, and the number of the value it makes."""
    current: dict[int, int] = {}
    made = 0
    for k in range(f.n_instructions()):
        operation, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            yield f"y[{outputs[0]}][{outputs[1]}] = {{}};", [current[inputs[0]]], None
            continue
        if operation == ca.OP_CONST:
            text, used = _number(f.instruction_constant(k)), []
        elif operation == ca.OP_INPUT:
            text, used = f"x[{inputs[0]}][{inputs[1]}]", []
        elif operation in _BINARY:
            text, used = _BINARY[operation], [current[inputs[0]], current[inputs[1]]]
        elif operation in _UNARY:
            text, used = _UNARY[operation], [current[inputs[0]]]
        else:
            raise ExportError(f"{scene}: operation {operation} of {f.name()} has no C here; use --kernel vm")
        current[outputs[0]] = made
        yield text, used, made
        made += 1


def _number(value: float) -> str:
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return f"({value!r})" if value < 0 else repr(value)
