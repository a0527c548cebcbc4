"""Table I of the paper: the particle on a circle at (rho, 0), iteration by iteration."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from oracles.particle import table
from scenes import derived, readings, started

from alfmu.method import formulations as method
from alfmu.studies.paper import QUICK, table_1

M, RHO, V, FX, FY = Fraction(3), Fraction(1, 2), Fraction(7, 5), Fraction(11, 4), Fraction(-2)
ALPHAS = [Fraction(10**2), Fraction(10**4), Fraction(10**6), Fraction(10**9)]


@pytest.mark.parametrize("alpha", ALPHAS, ids=lambda a: f"{float(a):.0e}")
@pytest.mark.parametrize("iterate", [method.classic, method.residual], ids=["classic", "residual"])
def test_iterates_are_the_closed_forms_exactly(iterate, alpha: Fraction) -> None:
    """a_i and lambda_i of (8), and of its residual form, in rational arithmetic: no tolerance at all."""
    mass = np.array([[M, 0], [0, M]], dtype=object)
    C = np.array([[Fraction(1), Fraction(0)]], dtype=object)
    xi, F = np.array([-(V**2) / RHO], dtype=object), np.array([FX, FY], dtype=object)
    penalty = np.array([[alpha]], dtype=object)
    H = method.augmented_mass(mass, C, penalty)
    assert H.tolist() == [[M + alpha, 0], [0, M]]
    for i in range(1, 6):
        a, lam, used, converged = iterate(
            mass,
            F,
            C,
            xi,
            penalty,
            lambda b: np.array([b[0] / H[0, 0], b[1] / H[1, 1]], dtype=object),
            np.array([Fraction(0)] * 2, dtype=object),
            np.array([Fraction(0)], dtype=object),
            i,
            lambda da, a: False,
        )
        assert (*a, *lam) == table(i, M, RHO, V, FX, FY, alpha)
        assert (used, converged) == (i, False)


@pytest.mark.parametrize("alpha", ALPHAS, ids=lambda a: f"{float(a):.0e}")
@pytest.mark.parametrize("i", [1, 2, 3])
def test_instance_shows_the_table(i: int, alpha: Fraction) -> None:
    """The same through an instance that stops after i iterations of `classic`.

    One rounding of a, about eps v^2 / rho, is magnified by alpha in lambda: that is what (8) as printed loses.
    """
    given = {"m": M, "rho": RHO, "start.angular_velocity": V / RHO, "force.x": FX, "force.y": FY}
    given |= {"solver.penalty": alpha, "solver.max_iterations": i}
    numbers = {k: int(x) if k == "solver.max_iterations" else float(x) for k, x in given.items()}
    r = readings(started(derived("particle_on_circle"), {"solver.formulation": "classic", **numbers}))
    ax, ay, lam = (float(x) for x in table(i, M, RHO, V, FX, FY, alpha))
    eps = np.finfo(float).eps
    loss = 8 * eps * float(V**2 / RHO) * (1 + float(alpha / M))
    assert r["monitor.iterations"] == i
    assert r["particle.ay"] == pytest.approx(ay, rel=4 * eps)
    assert abs(r["particle.ax"] - ax) <= loss
    assert abs(r["multiplier[1]"] - lam) <= loss * float(M)


def test_limits_and_rate() -> None:
    """a_x -> -v^2 / rho and lambda -> F_x + m v^2 / rho, the distance shrinking by m / (m + alpha) per iteration."""
    alpha = Fraction(1000)
    exact = -(V**2) / RHO, FX + M * V**2 / RHO
    gaps = [(ax - exact[0], lam - exact[1]) for ax, _, lam in (table(i, M, RHO, V, FX, FY, alpha) for i in (1, 2, 3))]
    for before, after in pairwise(gaps):
        assert [y / x for x, y in zip(before, after, strict=True)] == [M / (M + alpha)] * 2
    r = readings(started(derived("particle_on_circle"), {"m": 3.0, "rho": 0.5, "force.x": 2.75}))
    assert r["particle.ax"] == pytest.approx(-0.5, rel=1e-14)
    assert r["multiplier[1]"] == pytest.approx(2.75 + 1.5, rel=1e-14)


@pytest.mark.parametrize("i", [1, 2, 3])
def test_the_table_of_the_study_is_exact_where_the_penalty_is_the_mass(i: int) -> None:
    """Half of what is lacking is left by each iteration, and 2^-21 of the multipliers once was by taking off their
    redundant part."""
    iterates = table_1(QUICK).tables[1].rows
    row = next(x for x in iterates if x["alpha / m"] == 1.0 and x["iterations"] == i)
    assert row["multiplier [N], computed"] == pytest.approx(41.0 * (1 - 0.5**i), rel=1e-15)
    assert row["ax [m/s2], computed"] == pytest.approx(-18.0 + 20.5 * 0.5**i, rel=1e-15)
