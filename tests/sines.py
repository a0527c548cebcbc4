"""The runtime's sine and cosine, compiled from its header, and functions of CasADi with them."""

import ctypes
import operator
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from alfmu.runtime.build import SOURCES

CODE = """
#include "sine_cosine.h"
SINE_COSINE_IN_LANES(static inline, in_lanes, 4)
void alone(const double *x, double *s, double *c, int count)
{
    for (int k = 0; k < count; k++)
        sine_cosine(x[k], s + k, c + k);
}
void four(const double *x, double *s, double *c, int count)
{
    for (int k = 0; k < count; k += 4) {
        in_lanes_real angle, sine, cosine;
        memcpy(&angle, x + k, sizeof angle);
        in_lanes(&angle, &sine, &cosine);
        memcpy(s + k, &sine, sizeof sine);
        memcpy(c + k, &cosine, sizeof cosine);
    }
}
"""


@cache
def compiled() -> ctypes.CDLL:
    if not (gcc := shutil.which("gcc")):
        pytest.skip("there is no gcc")
    flags = ["-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared", "-Wall", "-Werror", "-Wno-psabi"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "code.c").write_text(CODE)
        subprocess.run([gcc, *flags, f"-I{SOURCES / 'core'}", "code.c", "-o", "code.so", "-lm"], cwd=folder, check=True)
        return ctypes.CDLL(str(folder / "code.so"))


def sine_cosine(angles: ArrayLike, how: str = "alone") -> NDArray[np.float64]:
    """Sines and cosines (2, count) of angles, one by one or in vectors of four."""
    x = np.ascontiguousarray(angles, float)
    made = np.empty((2, len(x)))
    getattr(compiled(), how)(*(ctypes.c_void_p(a.ctypes.data) for a in (x, *made)), len(x))
    return made


PLAIN: dict[int, Callable[..., float]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda x: x * x,
    ca.OP_TWICE: lambda x: 2.0 * x,
}
"""Arithmetic, of which Python and CasADi give the same bits, Python in a twentieth of the time."""


def by_instructions(f: ca.Function, x: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Nonzeros of the results of a function by CasADi; of one with sines and cosines, which are the runtime's, each
    instruction by CasADi, but sums and products by Python."""
    operations = list(map(f.instruction_id, range(f.n_instructions())))
    if not {ca.OP_SIN, ca.OP_COS} & {*operations}:
        found = f.call([ca.DM(f.sparsity_in(i), each) for i, each in enumerate(x)])
        return [np.array(each.nonzeros()) for each in found]
    x = [each.tolist() for each in x]
    numbers, results = [0.0] * f.sz_w(), [np.zeros(f.nnz_out(i)) for i in range(f.n_out())]
    for k, operation in enumerate(operations):
        made, given = f.instruction_output(k), f.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            results[made[0]][made[1]] = numbers[given[0]]
        elif operation == ca.OP_CONST:
            numbers[made[0]] = f.instruction_constant(k)
        elif operation == ca.OP_INPUT:
            numbers[made[0]] = x[given[0]][given[1]]
        elif operation in (ca.OP_SIN, ca.OP_COS):
            numbers[made[0]] = float(sine_cosine([numbers[given[0]]])[int(operation == ca.OP_COS)][0])
        elif operation in PLAIN:
            numbers[made[0]] = PLAIN[operation](*(numbers[i] for i in given))
        else:
            by = ca.DM.unary if len(given) == 1 else ca.DM.binary
            numbers[made[0]] = float(by(operation, *(numbers[i] for i in given)))
    return results
