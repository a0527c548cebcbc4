"""The functions of a scene as C: straight-line code, long ones in blocks of bounded length with loops for repetition.

Each function becomes `name(x, y, w)`: arrays of its arguments and of the nonzeros of its results, and a workspace for
values that pass from one block to the next. The code has no global state and allocates nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from ..equations import Equations
from .loops import blocks, c_function
from .program import CHOICE, TIERS, Layout, Program
from .stream import BINARY, UNARY, Instructions, Operations, number

__all__ = ["sources"]

BLOCK = 400
"""Operations in one C function of a long one; compilers take more than linear time for longer blocks."""

WHOLE = 2500
"""Operations up to which a function is not cut into blocks."""

UNIT = 2_000_000
"""Characters of source in one file, roughly; several are compiled at a time."""

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

_ATTEMPT = """
/* A step by the method of the scene; the caller judges its error, and takes the result over. */
EXPORT int alfmu_attempt(double *m, double dt)
{{
    m[{dt}] = dt;
    run_method(m, m + {workspace});
    return m[{trouble}] == 0.0;
}}
"""


def sources(equations: Equations) -> tuple[list[str], int]:
    """C files with all functions that run with numbers, and the length of the workspace behind an instance's memory."""
    e, layout = equations, Layout(equations)
    files, needed = [""], 0
    overwritten = _overwritten(e)
    for name in e.signatures:
        for text, workspace in _function(name, e.functions[name], overwritten[name], e.name):
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
        if "method" in e.kernel:
            calls += _ATTEMPT.format(**at)
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


def _function(name: str, f: ca.Function, kept: dict[int, int], scene: str) -> Iterator[tuple[str, int]]:
    """C of a function in one or several pieces, each with the length of the workspace that the function needs."""
    instructions = Instructions.of(f)
    instructions.check(scene, f.name())
    if len(instructions) > WHOLE:
        yield from blocks(name, Operations.of(instructions), kept, BLOCK)
    else:
        yield c_function(name, _statements(instructions)), 0


def _statements(instructions: Instructions) -> Iterator[str]:
    """Each instruction as a line of C."""
    made = 0
    names: list[str] = []
    for k, operation in enumerate(instructions.code.tolist()):
        first, second = (names[i] if i >= 0 else "" for i in instructions.operands[:, k].tolist())
        which, entry = instructions.place[:, k].tolist()
        names.append(f"v{made}")
        if operation == ca.OP_OUTPUT:
            yield f"y[{which}][{entry}] = {first};"
            continue
        if operation == ca.OP_CONST:
            text = number(float(instructions.constant[k]))
        elif operation == ca.OP_INPUT:
            text = f"x[{which}][{entry}]"
        else:
            text = (BINARY.get(operation) or UNARY[operation]).format(first, second)
        yield f"const double v{made} = {text};"
        made += 1


def _overwritten(e: Equations) -> dict[str, dict[int, int]]:
    """Arguments of functions, and their lengths, that some call writes a result over."""
    found: dict[str, dict[int, int]] = {name: {} for name in e.signatures}
    for program in e.kernel.values():
        for name, arguments, results in _flat(program["calls"]):
            lengths = e.signatures[name]["inputs"]
            found[name] |= {i: lengths[i] for i, key in enumerate(arguments) if key in results}
    return found


def _flat(calls: list[list]) -> Iterator[list]:
    """All calls, those of either choice too."""
    for call in calls:
        if call[0] == CHOICE:
            yield from _flat(call[2])
            yield from _flat(call[3])
        else:
            yield call
