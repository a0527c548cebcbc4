"""The runtime's sine and cosine: against 40 digits, and in vectors."""

import math

import numpy as np
import pytest
from mpmath import mp
from sines import sine_cosine


def angles():
    """Angles of any size up to the largest that is reduced here, and those next to multiples of pi / 2, where either
    function is nearly zero."""
    random = np.random.default_rng(1)
    some = [random.uniform(-bound, bound, 1000) for bound in (1e-3, 4.0, 1e3, 1e6)]
    near = random.integers(-600_000, 600_000, 1000) * (math.pi / 2)
    return np.concatenate([*some, near, np.nextafter(near, 0.0), 10.0 ** random.uniform(-300, -3, 1000)])


def test_errors_are_below_a_unit_in_the_last_place():
    x = angles()
    found = sine_cosine(x)
    with mp.workdps(40):
        exact = [[f(mp.mpf(a)) for a in x.tolist()] for f in (mp.sin, mp.cos)]
        worst = max(
            float(abs(mp.mpf(a) - b)) / math.ulp(float(b))
            for numbers, known in zip(found.tolist(), exact, strict=True)
            for a, b in zip(numbers, known, strict=True)
        )
    assert worst < 0.8


def test_vectors_have_the_same_bits():
    x = angles()
    x[5::97] = 3e7  # left to the C library, with its neighbours
    np.testing.assert_array_equal(sine_cosine(x, "four").view(np.int64), sine_cosine(x).view(np.int64))


@pytest.mark.parametrize("how", ["alone", "four"])
def test_special_angles(how):
    sine, cosine = sine_cosine([0.0, -0.0, 1e300, math.inf, -math.inf, math.nan, math.pi, math.pi / 2], how)
    assert math.copysign(1.0, sine[0]) == 1.0
    assert math.copysign(1.0, sine[1]) == -1.0
    np.testing.assert_array_equal(cosine[:2], 1.0)
    assert sine[2] == pytest.approx(-0.8178819121159085, rel=1e-15)  # 40 digits
    assert np.isnan([sine[3:6], cosine[3:6]]).all()
    assert (sine[6], cosine[6]) == (1.2246467991473532e-16, -1.0)
    assert (sine[7], cosine[7]) == (1.0, 6.123233995736766e-17)
