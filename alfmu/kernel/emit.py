"""The functions of a scene as C: straight-line code, long ones in blocks of bounded length with loops for repetition.

Each function becomes `name(x, y, w)`: arrays of its arguments and of the nonzeros of its results, and a workspace for
values that pass from one block to the next. The code has no global state and allocates nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import accumulate

import casadi as ca
import numpy as np

from ..equations import Equations
from .loops import blocks, c_function
from .program import CHOICE, FACTOR, LOOP, PACE, SOLVE, TIERS, Layout, Program
from .stream import BINARY, UNARY, Instructions, Operations, number

__all__ = ["HEAD", "ROUTINES", "compiled_code", "lengths", "sources", "written"]

BLOCK = 400
"""Operations in one C function of a long one; compilers take more than linear time for longer blocks."""

WHOLE = 2500
"""Operations up to which a function is not cut into blocks."""

UNIT = 2_000_000
"""Characters of source in one file, roughly; several are compiled at a time."""

HEAD = """\
#include <math.h>
#include <string.h>

#if defined(EXPORT) /* by whoever keeps these functions to itself */
#elif defined(_WIN32)
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

_TABLE = """
/* For `scene_compiled` of the runtime. */
EXPORT extern Function *const alfmu_functions[];
EXPORT extern const int alfmu_function_count, alfmu_spare;
EXPORT extern const char alfmu_scene[];
Function *const alfmu_functions[] = {{
    {names}}};
const int alfmu_function_count = {count}, alfmu_spare = {spare};
const char alfmu_scene[] = {identity};
"""

_WITHIN = (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG)
"""Operations that may stand within others: what they give is a double."""

_TWICE = (ca.OP_SQ, ca.OP_SIGN)
"""Operations that write their operand twice."""

_SHORT = 80
"""Characters of a value that stands within another one."""

_OFTEN = ("quick", "careful", "method", "instant", "reach")
"""Programs whose calls cost time."""

_BY_TABLE = """
/* A function called on places in the memory, behind which the workspace stands. */
static void call(Function *f, double *m, double *w, const int *at, int inputs, int results)
{{
    const double *x[{most}];
    double *y[{most}];
    for (int i = 0; i < inputs; i++)
        x[i] = m + at[i];
    for (int i = 0; i < results; i++)
        y[i] = m + at[inputs + i];
    f(x, y, w);
}}

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

{cover}/* A communication step in one go; 0, and nothing has changed, where that is not possible. */
EXPORT int alfmu_communicate(double *m, double start, double h)
{{
    double counted[{counted}], ratio;
    long steps, made;
    if (!(h > 0.0 && h < INFINITY && fabs(start - m[{time}]) <= 1e-6 * h + 1e-12 * fabs(start)))
        return 0;
    ratio = h / m[{step_size}] * (1 - 1e-12);
    if (!(ratio < 1e9))
        return 0;
    steps = ratio <= 1.0 ? 1 : (long)ceil(ratio);
    memcpy(m + {begin}, m + {z}, {size} * sizeof(double));
    memcpy(counted, m + {tally}, sizeof counted);
    m[{time}] = start;
    {reached}{covered}made = advance(m, steps, h / (double)steps) == steps;
    if (!made) {{
        memcpy(m + {z}, m + {begin}, {size} * sizeof(double));
        memcpy(m + {tally}, counted, sizeof counted);
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

_COVER = """\
/* Steps by the method of the scene up to an end, or so many tries; 0 where one could not be judged. */
EXPORT int alfmu_cover(double *m, double end, long tries)
{{
    m[{end}] = end;
    for (; m[{time}] < end && tries != 0; tries--) {{
        run_method(m, m + {workspace});
{beside}        if (m[{trouble}] != 0.0)
            return 0;
        if (m[{accepted}] != 0.0)
            memcpy(m + {z}, m + {after}, {size} * sizeof(double));
        m[m[{accepted}] != 0.0 ? {made} : {made} + 1] += 1.0;
    }}
    return 1;
}}

"""

_BESIDE = """\
        if (m[{trouble}] != 0.0) {{
            run_beside(m, m + {workspace});
            m[{made} + 2] += 1.0;
            m[{made} + 3] += m[{near}];
        }}
"""

_COVERED = """\
m[{last}] = 0.0;
    m[{fixed}] = m[{chosen}] == 2.0 ? h / (double)steps : 0.0;
    if (m[{chosen}] != 0.0)
        made = alfmu_cover(m, start + h, -1);
    else
        """

ROUTINES = """\
/* Factors of the matrix of s * s blocks (n, n) that are sums of the parts of their row (by columns), by weights of row
   and column: rows in `order`, L without its diagonal of ones below that of U. */
static void factor(int n, int s, int terms, const double *weights, const double *const *parts, double *a, double *order)
{
    const int size = n * s;
    for (int i = 0; i < s; i++)
        for (int j = 0; j < s; j++)
            for (int r = 0; r < n; r++) {
                double *row = a + (i * n + r) * size + j * n;
                for (int c = 0; c < n; c++)
                    row[c] = weights[i * s + j] * parts[i][c * n + r];
                for (int t = 1; t < terms; t++)
                    for (int c = 0; c < n; c++)
                        row[c] += weights[(t * s + i) * s + j] * parts[t * s + i][c * n + r];
            }
    for (int i = 0; i < size; i++)
        order[i] = i;
    for (int k = 0; k < size; k += 4) {
        /* Four columns, with the rows below. */
        const int end = k + 4 < size ? k + 4 : size;
        for (int p = k; p < end; p++) {
            int largest = p;
            for (int i = p + 1; i < size; i++)
                if (fabs(a[i * size + p]) > fabs(a[largest * size + p]))
                    largest = i;
            if (largest != p) {
                double kept = order[p];
                order[p] = order[largest];
                order[largest] = kept;
                for (int j = 0; j < size; j++) {
                    kept = a[p * size + j];
                    a[p * size + j] = a[largest * size + j];
                    a[largest * size + j] = kept;
                }
            }
            for (int i = p + 1; i < size; i++) {
                const double by = a[i * size + p] /= a[p * size + p];
                for (int j = p + 1; j < end; j++)
                    a[i * size + j] -= by * a[p * size + j];
            }
        }
        /* The same rows right of them, then what is left. */
        for (int p = k; p < end; p++)
            for (int i = p + 1; i < end; i++)
                for (int j = end; j < size; j++)
                    a[i * size + j] -= a[i * size + p] * a[p * size + j];
        if (end - k == 4)
            for (int i = end; i < size; i++) {
                const double *restrict u = a + k * size, *l = a + i * size + k;
                double *restrict row = a + i * size;
                const double l0 = l[0], l1 = l[1], l2 = l[2], l3 = l[3];
                for (int j = end; j < size; j++)
                    row[j] -= l0 * u[j] + l1 * u[j + size] + (l2 * u[j + 2 * size] + l3 * u[j + 3 * size]);
            }
    }
}

static void solve(int n, int s, const double *a, const double *order, const double *const *right, double *x)
{
    const int size = n * s;
    for (int i = 0; i < size; i++) {
        const int from = (int)order[i];
        double sum = right[from / n][from % n];
        for (int j = 0; j < i; j++)
            sum -= a[i * size + j] * x[j];
        x[i] = sum;
    }
    for (int i = size - 1; i >= 0; i--) {
        double sum = x[i];
        for (int j = i + 1; j < size; j++)
            sum -= a[i * size + j] * x[j];
        x[i] = sum / a[i * size + i];
    }
}

"""


def sources(equations: Equations) -> tuple[list[str], int]:
    """C files with all functions that run with numbers, and the length of the workspace behind an instance's memory."""
    files, needed, _ = written(equations, {})
    return files, needed


def written(equations: Equations, passed: Mapping[str, int]) -> tuple[list[str], int, dict[str, int]]:
    """What `sources` returns, and where in the workspace each value stands that programs hand on.

    `passed` are the lengths of values that somebody else puts there.
    """
    e, layout = equations, Layout(equations)
    files, needed = _files(_functions(e, {}))
    calls = "".join(f"extern Function {name};\n" for name in e.signatures)
    names = ",\n    ".join(e.signatures)
    calls += f"static Function *const functions[] = {{\n    {names}}};\n{_CALL}"
    places = dict(passed)
    if e.kernel:
        if FACTOR in _marks(e.kernel.get("method", {}).get("calls", [])):
            calls += ROUTINES
        if set(e.kernel) - set(_OFTEN):
            most = max(len(x) for s in e.signatures.values() for x in (s["inputs"], s["outputs"]))
            calls += _BY_TABLE.format(most=most)
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
            "chosen": at["control"] + 2,
            "made": at["tally"] + len(TIERS) + 1,
            "counted": at["past"] + layout.fields["past"][1] - at["tally"],
            **{name: at["pace"] + i for i, name in enumerate(PACE) if name in ("fixed", "end", "last", "accepted")},
        }
        by_method = "method" in e.kernel
        at["beside"] = _BESIDE.format(**at) * ("beside" in e.kernel)
        at["reached"] = f"run_reach(m, m + {layout.size});\n    " if "reach" in e.kernel else ""
        at |= {"cover": _COVER.format(**at) * by_method, "covered": _COVERED.format(**at) * by_method}
        calls += _DRIVER.format(**at)
    files[-1] += calls
    ends = [needed, *(needed + end for end in accumulate(places.values()))]
    return [HEAD + text for text in files], ends[-1], dict(zip(places, ends, strict=False))


def compiled_code(equations: Equations, kept: Mapping[str, dict[int, int]], identity: str) -> list[str]:
    """C files with all functions, and a table of them for the scene of this identity.

    `kept` are further arguments of functions that results may be written over, and their lengths.
    """
    files, spare = _files(_functions(equations, kept))
    names = list(equations.signatures)
    declared = "".join(f"extern Function {name};\n" for name in names)
    files[-1] += declared + _TABLE.format(
        names=",\n    ".join(names), count=len(names), spare=spare, identity=json.dumps(identity)
    )
    return [HEAD + text for text in files]


def _files(functions: Iterable[tuple[str, str, int]]) -> tuple[list[str], int]:
    """What `_functions` gives, in files of bounded length, and the workspace that they need."""
    files, needed = [""], 0
    for _, text, workspace in functions:
        if len(files[-1]) > UNIT:
            files.append("")
        files[-1] += text
        needed = max(needed, workspace)
    return files, needed


def lengths(equations: Equations) -> dict[str, int]:
    """Bytes of C of each function."""
    found = dict.fromkeys(equations.signatures, 0)
    for name, text, _ in _functions(equations, {}):
        found[name] += len(text)
    return found


def _functions(e: Equations, kept: Mapping[str, dict[int, int]]) -> Iterator[tuple[str, str, int]]:
    """The name of each function, and what `_function` gives of it; `kept` are arguments that others write over."""
    overwritten = _overwritten(e)
    for name in e.signatures:
        written_over = overwritten[name] | kept.get(name, {})
        for text, workspace in _function(name, e.functions[name], written_over, e.name):
            yield name, text, workspace


def _program(name: str, program: Program, e: Equations, layout: Layout, workspace: int, places: dict[str, int]) -> str:
    """A step as calls on the memory m and the workspace w; `places` are the lengths of what passes between them.

    What is seldom run finds its arguments by a table, which is far shorter than code that says where each is.
    """
    offsets: dict[str, int] = {}
    table: dict[tuple[int, ...], int] = {}
    top, short, size = workspace, name.removeprefix("run_") not in _OFTEN, 0
    for key, length in places.items():
        offsets[key] = top
        top += length

    def pointer(key: str) -> str:
        return f"m + {layout.fields[key][0]}" if key in layout.fields else f"w + {offsets[key]}"

    def place(key: str) -> int:
        return layout.fields[key][0] if key in layout.fields else layout.size + offsets[key]

    def made(calls: list[list]) -> list[str]:
        nonlocal top, size
        lines = []
        for called, *rest in calls:
            if called == CHOICE:
                number, *ways = rest
                heads = f"if (*({pointer(number)}) != 0.0) {{", "} else {"
                for head, way in zip(heads, ways, strict=True):
                    lines += [head, *("    " + line for line in made(way))]
                lines.append("}")
                continue
            if called == LOOP:
                number, times, again = rest
                limit = times if isinstance(times, int) else f"(long)*({pointer(times)})"
                lines.append(f"for (long i = {limit}; i > 0 && *({pointer(number)}) != 0.0; i--) {{")
                lines += ["    " + line for line in made(again)]
                lines.append("}")
                continue
            inputs, outputs, *sizes = rest
            for key, length in zip(outputs, _lengths(called, e, sizes), strict=True):
                if key not in layout.fields and key not in offsets:
                    offsets[key], places[key] = top, length
                    top += length
            if short and not sizes:
                at = tuple(map(place, [*inputs, *outputs]))
                if at not in table:
                    table[at], size = size, size + len(at)
                lines.append(f"call({called}, m, w, {name}_at + {table[at]}, {len(inputs)}, {len(outputs)});")
                continue
            x, y = (", ".join(map(pointer, keys)) for keys in (inputs, outputs))
            if called == FACTOR:
                n, s = sizes
                terms = (len(inputs) - 1) // s
                lines += ["{", f"    const double *x[] = {{{x}}};"]
                lines += [f"    factor({n}, {s}, {terms}, x[0], x + 1, {y});", "}"]
                continue
            if called == SOLVE:
                n, s = sizes
                lines += ["{", f"    const double *x[] = {{{x}}};"]
                lines += [f"    solve({n}, {s}, x[0], x[1], x + 2, {y});", "}"]
                continue
            lines += ["{", f"    const double *x[] = {{{x}}};", f"    double *y[] = {{{y}}};"]
            lines += [f"    {called}(x, y, w);", "}"]
        return lines

    body = "".join(f"    {line}\n" for line in made(program["calls"]))
    rows = ",\n    ".join(", ".join(map(str, at)) for at in table)
    entries = f"static const int {name}_at[] = {{\n    {rows}}};\n" if table else ""
    return f"{entries}static void {name}(double *m, double *w)\n{{\n{body}}}\n"


def _function(name: str, f: ca.Function, kept: dict[int, int], scene: str) -> Iterator[tuple[str, int]]:
    """C of a function in one or several pieces, each with the length of the workspace that the function needs."""
    instructions = Instructions.of(f)
    instructions.check(scene, f.name())
    if len(instructions) > WHOLE:
        yield from blocks(name, Operations.of(instructions), kept, BLOCK)
    else:
        yield c_function(name, _statements(instructions, kept)), 0


def _statements(instructions: Instructions, kept: Iterable[int]) -> Iterator[str]:
    """Lines of C, in which what is used once stands where it is used, as long as that is short.

    Arguments in `kept` are read first, since results may be written over them.
    """
    made = 0
    names: list[str] = []
    which, entry = instructions.place
    first = (instructions.code == ca.OP_INPUT) & np.isin(which, list(kept))
    for i, j in dict.fromkeys(zip(which[first].tolist(), entry[first].tolist(), strict=True)):
        yield f"const double x{i}_{j} = x[{i}][{j}];"
    uses = np.concatenate([*instructions.operands, instructions.operands[0, np.isin(instructions.code, _TWICE)]])
    single = np.bincount(uses[uses >= 0].astype(int), minlength=len(instructions)) == 1
    for k, operation in enumerate(instructions.code.tolist()):
        first, second = (names[i] if i >= 0 else "" for i in instructions.operands[:, k].tolist())
        which, entry = instructions.place[:, k].tolist()
        if operation == ca.OP_OUTPUT:
            names.append("")
            yield f"y[{which}][{entry}] = {first};"
            continue
        if operation == ca.OP_CONST:
            text = number(float(instructions.constant[k]))
        elif operation == ca.OP_INPUT:
            text = f"x{which}_{entry}" if which in kept else f"x[{which}][{entry}]"
        else:
            text = (BINARY.get(operation) or UNARY[operation]).format(first, second)
            if single[k] and operation in _WITHIN and len(text) <= _SHORT:
                names.append(f"({text})")
                continue
        if operation == ca.OP_CONST or (operation == ca.OP_INPUT and (which in kept or single[k])):
            names.append(text)
            continue
        names.append(f"v{made}")
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


def _lengths(name: str, e: Equations, sizes: list[int]) -> list[int]:
    """Lengths of the results of a call."""
    if name in (FACTOR, SOLVE):
        size = sizes[0] * sizes[1]
        return [size * size, size] if name == FACTOR else [size]
    return [shape[0] for shape in e.signatures[name]["outputs"]]


def _flat(calls: list[list]) -> Iterator[list]:
    """All calls of functions, those of either choice and in loops too."""
    for call in calls:
        if call[0] == CHOICE:
            yield from _flat(call[2])
            yield from _flat(call[3])
        elif call[0] == LOOP:
            yield from _flat(call[3])
        elif call[0] not in (FACTOR, SOLVE):
            yield call


def _marks(calls: list[list]) -> set[str]:
    """What else than calls of functions there is."""
    found = {call[0] for call in calls}
    return found.union(*(_marks(call[3]) for call in calls if call[0] == LOOP))
