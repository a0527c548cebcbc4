"""The runtime's sine and cosine, compiled from its header, to be called on arrays."""

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from alfmu.runtime.build import SOURCES

CODE = """
#include "sine_cosine.h"
SINE_COSINE_IN_LANES(in_lanes, 4)
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
