"""The runtime's sine and cosine: against 40 digits, and in vectors."""

import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest
from mpmath import mp

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


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    if not (gcc := shutil.which("gcc")):
        pytest.skip("there is no gcc")
    folder = tmp_path_factory.mktemp("sine_cosine")
    (folder / "code.c").write_text(CODE)
    flags = ["-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared", "-Wall", "-Werror", "-Wno-psabi"]
    subprocess.run([gcc, *flags, f"-I{SOURCES / 'core'}", "code.c", "-o", "code.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "code.so"))

    def run(name, angles):
        x = np.ascontiguousarray(angles, float)
        made = np.empty((2, len(x)))
        getattr(library, name)(*(ctypes.c_void_p(a.ctypes.data) for a in (x, *made)), len(x))
        return made

    return run


def angles():
    """Angles of any size up to the largest that is reduced here, and those next to multiples of pi / 2, where either
    function is nearly zero."""
    random = np.random.default_rng(1)
    some = [random.uniform(-bound, bound, 1000) for bound in (1e-3, 4.0, 1e3, 1e6)]
    near = random.integers(-600_000, 600_000, 1000) * (math.pi / 2)
    return np.concatenate([*some, near, np.nextafter(near, 0.0), 10.0 ** random.uniform(-300, -3, 1000)])


def test_errors_are_below_a_unit_in_the_last_place(compiled):
    x = angles()
    found = compiled("alone", x)
    with mp.workdps(40):
        exact = [[f(mp.mpf(a)) for a in x.tolist()] for f in (mp.sin, mp.cos)]
        worst = max(
            float(abs(mp.mpf(a) - b)) / math.ulp(float(b))
            for numbers, known in zip(found.tolist(), exact, strict=True)
            for a, b in zip(numbers, known, strict=True)
        )
    assert worst < 0.8


def test_vectors_have_the_same_bits(compiled):
    x = angles()
    x[5::97] = 3e7  # left to the C library, with its neighbours
    np.testing.assert_array_equal(compiled("four", x).view(np.int64), compiled("alone", x).view(np.int64))


@pytest.mark.parametrize("name", ["alone", "four"])
def test_special_angles(compiled, name):
    sine, cosine = compiled(name, [0.0, -0.0, 1e300, math.inf, -math.inf, math.nan, math.pi, math.pi / 2])
    assert math.copysign(1.0, sine[0]) == 1.0
    assert math.copysign(1.0, sine[1]) == -1.0
    np.testing.assert_array_equal(cosine[:2], 1.0)
    assert sine[2] == pytest.approx(-0.8178819121159085, rel=1e-15)  # 40 digits
    assert np.isnan(sine[3:6]).all()
    assert np.isnan(cosine[3:6]).all()
    assert sine[6] == 1.2246467991473532e-16
    assert cosine[6] == -1.0
    assert sine[7] == 1.0
    assert cosine[7] == 6.123233995736766e-17
