"""The functions of a scene as C: straight-line code, long ones in blocks of bounded length with loops for repetition.

Each function becomes `name(x, y, w)`: arrays of its arguments and of the nonzeros of its results, and a workspace for
values passed between blocks. The code has no global state and allocates nothing. Compiled with LANES, the same code
evaluates that many instances side by side: each number is a vector.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping

import casadi as ca
import numpy as np

from .form import Call, Traced, every
from .loops import ANGULAR, Angles, blocks, c_function, constant, expression, name_of
from .stream import BINARY, PLAIN, UNARY, Instructions, Operations

BLOCK = 400
"""Number of operations in one C function of a long one; compile time grows faster than linearly with it."""

WHOLE = 2500
"""Number of operations up to which a function is not divided into blocks."""

UNIT = 2_000_000
"""Approximate number of characters in a source file; several are compiled at a time."""

HEAD = """\
#include <math.h>
#include <string.h>

#include "sine_cosine.h"

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
#if defined(LANES) /* Numbers of that many instances side by side, each in a lane. */
typedef double Real __attribute__((vector_size(8 * LANES)));
#define REAL(x) ((x) - (Real){0.0})
#define EACH for (int lane = 0; lane < LANES; lane++)
#define OF(x) x[lane]
SINE_COSINE_IN_LANES(static inline, sine_cosine_of, LANES)
#else
typedef double Real;
static inline void sine_cosine_of(const Real *x, Real *s, Real *c) { sine_cosine(*x, s, c); }
#define REAL(x) (x)
#define EACH
#define OF(x) x
#endif
#define ONE(name, value) \
    static inline Real name(Real x) { Real z; EACH { const double a = OF(x); OF(z) = value; } return z; }
#define TWO(name, value) \
    static inline Real name(Real x, Real y) \
    { Real z; EACH { const double a = OF(x), b = OF(y); OF(z) = value; } return z; }
typedef const Real *const *Arguments;
typedef Real *const *Results;
typedef void Function(Arguments, Results, Real *);

"""


_OTHERS = "".join(
    f"{count}({name_of(code)}, {template.format('a', 'b')})\n"
    for count, table in (("ONE", UNARY), ("TWO", BINARY))
    for code, template in table.items()
    if code not in PLAIN and code not in ANGULAR
)
"""Operations other than arithmetic, as functions of numbers."""

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
"""Operations that may be nested in others: their results are doubles."""

_SHORT = 80
"""Largest length of a nested expression in characters."""


def compiled_code(equations: Traced, kept: Mapping[str, dict[int, int]], identity: str) -> list[str]:
    """Return C files with all functions, and a table of them for the scene of this identity.

    `kept` are further arguments of functions that results may overwrite, and their lengths.
    """
    e, files, spare, overwritten = equations, [""], 0, _overwritten(equations)
    for name in e.functions:
        for text, workspace in _function(name, e.functions[name], overwritten[name] | kept.get(name, {}), e.name):
            if len(files[-1]) > UNIT:
                files.append("")
            files[-1] += text
            spare = max(spare, workspace)
    names = list(e.functions)
    declared = "".join(f"extern Function {name};\n" for name in names)
    files[-1] += declared + _TABLE.format(
        names=",\n    ".join(names), count=len(names), spare=spare, identity=json.dumps(identity)
    )
    return [HEAD + _OTHERS + text for text in files]


def _function(name: str, f: ca.Function, kept: dict[int, int], scene: str) -> Iterator[tuple[str, int]]:
    """Yield the C of a function in one or several pieces, each with the workspace length of the function."""
    instructions = Instructions.of(f)
    instructions.check(scene, f.name())
    if len(instructions) > WHOLE:
        yield from blocks(name, Operations.of(instructions), kept, BLOCK)
    else:
        yield c_function(name, _statements(instructions, kept)), 0


def _statements(instructions: Instructions, kept: Iterable[int]) -> Iterator[str]:
    """Yield lines of C, in which short values used once are nested in the expression that uses them.

    Arguments in `kept` are read first, since results may overwrite them.
    """
    made = 0
    names: list[str] = []
    angles = Angles()
    which, entry = instructions.place
    first = (instructions.code == ca.OP_INPUT) & np.isin(which, list(kept))
    for i, j in dict.fromkeys(zip(which[first].tolist(), entry[first].tolist(), strict=True)):
        yield f"const Real x{i}_{j} = x[{i}][{j}];"
    uses = np.concatenate([*instructions.operands, instructions.operands[0, instructions.code == ca.OP_SQ]])
    single = np.bincount(uses[uses >= 0].astype(int), minlength=len(instructions)) == 1
    for k, operation in enumerate(instructions.code.tolist()):
        first, second = (names[i] if i >= 0 else "" for i in instructions.operands[:, k].tolist())
        which, entry = instructions.place[:, k].tolist()
        if operation == ca.OP_OUTPUT:
            names.append("")
            yield f"y[{which}][{entry}] = {first};"
            continue
        if operation == ca.OP_CONST:
            text = constant(float(instructions.constant[k]))
        elif operation == ca.OP_INPUT:
            text = f"x{which}_{entry}" if which in kept else f"x[{which}][{entry}]"
        elif operation in ANGULAR:
            yield from angles.lines(first)
            names.append(angles.name(operation, first))
            continue
        else:
            text = expression(operation, first, second)
            if single[k] and operation in _WITHIN and len(text) <= _SHORT:
                names.append(f"({text})")
                continue
        if operation == ca.OP_CONST or (operation == ca.OP_INPUT and (which in kept or single[k])):
            names.append(text)
            continue
        names.append(f"v{made}")
        yield f"const Real v{made} = {text};"
        made += 1


def _overwritten(e: Traced) -> dict[str, dict[int, int]]:
    """Return arguments of functions, and their lengths, that a call overwrites with a result."""
    found: dict[str, dict[int, int]] = {name: {} for name in e.functions}
    for program in e.kernel.values():
        for call in every(program.steps):
            if isinstance(call, Call):
                lengths = e.signatures[call.function]["inputs"]
                found[call.function] |= {i: lengths[i] for i, key in enumerate(call.arguments) if key in call.results}
    return found
