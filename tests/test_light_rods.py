"""A rod that hardly resists spin, on ball joints between heavy bodies: round-off of constraints must not drown it."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scenes import initialized

import alfmu

ROD = {"mass": 0.1, "center": (0.0, 0.0, -0.25), "relative": True}


def leg(spin: float, flies: bool, heavy: float = 72.0) -> alfmu.Mechanism:
    """A crank, a rod of 0.5 m and a heavy rocker, on the ground or on a heavy body that flies."""
    m = alfmu.Mechanism("leg")
    whole = {"mass": heavy, "inertia": (4.0, 3.0, 2.0), "position": (0.0, 0.0, 0.0), "attitude": (1.0, 0.0, 0.0, 0.0)}
    base = m.spatial_body("base", **whole) if flies else m.spatial_ground
    crank, rocker = (
        m.spatial_body(name, mass=mass, inertia=(0.02, 0.04, 0.03), center=(0.03, 0.0, -0.05), relative=True)
        for name, mass in (("crank", 1.0), ("rocker", heavy))
    )
    rod = m.spatial_body("rod", inertia=(0.1 * 0.5**2 / 12, 0.1 * 0.5**2 / 12, spin), **ROD)
    driven = m.coordinate("qa", "rad", independent=True, rate=2.0)
    m.spatial_revolute("A", base.at(0.0, 0.05, 0.0), crank.at(), axis=(0, 1, 0), coordinate=driven)
    m.spatial_revolute("B", base.at(0.05, 0.0, -0.5), rocker.at(), axis=(0, 1, 0), coordinate=m.coordinate("qb", "rad"))
    start = (math.cos(0.03), math.sin(0.03), 0.0, 0.0)
    e = [m.coordinate(f"e{k}", "1", start=x) for k, x in enumerate(start)]
    m.spherical("top", crank.at(0.1, 0.0, 0.0), rod.at(), coordinates=e)
    m.spherical("toe", rod.at(0.0, 0.0, -0.5), rocker.at(0.06, 0.0, 0.02))
    m.gravity(0.0, 0.0, -9.81)
    return m


def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Gaussian elimination of exact fractions."""
    rows = [[*map(Fraction, row), Fraction(x)] for row, x in zip(matrix.tolist(), right.tolist(), strict=True)]
    for k in range(len(rows)):
        pivot = max(range(k, len(rows)), key=lambda r: abs(rows[r][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for r in range(len(rows)):
            if r != k and rows[r][k]:
                factor = rows[r][k] / rows[k][k]
                rows[r] = [a - factor * b for a, b in zip(rows[r], rows[k], strict=True)]
    return np.array([float(row[-1] / row[k]) for k, row in enumerate(rows)])


@pytest.mark.parametrize(("spin", "flies", "digits"), [(1e-6, True, 1e-9), (1e-9, True, 1e-6), (1e-9, False, 1e-6)])
def test_accelerations_are_those_of_exact_arithmetic(spin: float, flies: bool, digits: float) -> None:
    """[M C'; C 0] with all digits; in double precision that system itself has errors of 9e-12, 4e-9 and 3e-8."""
    i = initialized(alfmu.Instance(leg(spin, flies)))
    e = i.equations
    for _ in range(3):
        for _ in range(5):
            i.step(0.02)
        i.read()
        M, C, F, xi = map(np.array, e.functions["dynamics"](i.q, i.v, i.driven, i.memory["p"], i.time))
        l, n = C.shape
        x = solved(np.block([[M, C.T], [C, np.zeros((l, l))]]), np.concatenate([F.ravel(), xi.ravel()]))
        exact = e.functions["readings"](i.q, i.v, x[:n], x[n:], i.driven, i.memory["p"], i.time)
        for output, value in zip(e.outputs, np.array(exact).ravel(), strict=True):
            if output.unit in ("rad/s2", "m/s2"):
                assert i.get(output.name) == pytest.approx(value, abs=digits), output.name
    assert i.get("monitor.distance") == 1.0
