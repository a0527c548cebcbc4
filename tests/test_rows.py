"""Constraints written twice, in another order, in other units: the same motion; and which reactions are unique."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from fmpy import read_model_description
from pairs import ALL
from scenes import by_rk4, by_the_oracle, derived, initialized, made

import alfmu
from alfmu.equations.evaluation import ARGUMENTS, evaluable, shared, symbols
from alfmu.runtime.probe import row_units
from alfmu.simulation import prepared


@cache
def rewritten(case: str, name: str, coordinates: str) -> alfmu.Equations:
    """The same mechanism with rows picked in some order, each times a scale."""
    e = by_rk4(name, coordinates=coordinates)
    scales, order = CASES[case](e.l)
    S = ca.sparsify(ca.DM(np.eye(e.l)[order] * scales[:, None]))
    x, lam, functions = (
        symbols(e),
        ca.SX.sym("lam", len(order)),
        {n: e.functions[n] for n in ARGUMENTS if n in e.functions},
    )
    for name in ("Phi", "C", "xi", "gaps", "gaps_matrix"):
        arguments = [x[letter] for letter in ARGUMENTS[name]]
        functions[name] = shared(name, arguments, [S @ e.functions[name](*arguments)])
    letters = ARGUMENTS["readings"]
    before = [S.T @ lam if letter == "lam" else x[letter] for letter in letters]
    after = [lam if letter == "lam" else x[letter] for letter in letters]
    functions["readings"] = shared("readings", after, [e.functions["readings"](*before)])
    functions["shares"] = shared("shares", after, [S @ e.functions["shares"](*before)])  # a gradient by lam
    return evaluable(replace(e, rows=[e.rows[k] for k in order], functions=functions))


STEPS = {"oracle": 25, "vm": 200}
"""Of 0.005 s: a second of the kernel, an eighth of it of the oracle."""


def motion(e: alfmu.Equations, kernel: str, start: dict) -> np.ndarray:
    """Coordinates and reactions over a time."""
    names = [o.name for o in e.outputs if ".force" in o.name]
    i = initialized(made(e, kernel), start)
    rows = []
    for _ in range(STEPS[kernel]):
        i.step(0.005)
        rows.append([*i.q, *i.v] if len(rows) % 50 else [*i.q, *i.v, *map(i.get, names)])
    return rows


RANDOM = np.random.default_rng(1)
MILLI = 10 ** RANDOM.uniform(-3, 3, 16)
CASES = {
    "in millimetres": lambda l: (np.full(l, 1e3), list(range(l))),
    "in kilometres": lambda l: (np.full(l, 1e-3), list(range(l))),
    "each in its own unit": lambda l: (MILLI[:l], list(range(l))),
    "in another order": lambda l: (np.ones(l), list(range(l))[::-1]),
    "twice": lambda l: (np.ones(2 * l), [*range(l), *range(l)]),
    "all of it": lambda l: (np.resize(MILLI, 2 * l), [int(k) for k in RANDOM.permutation([*range(l), *range(l)])]),
}


MECHANISMS = [
    *(("slider_crank", coordinates) for coordinates in ("absolute", "joint", "mixed", "natural")),
    *((name, coordinates) for name in ("four_bar", "five_bar") for coordinates in ("mixed", "joint")),
]


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["oracle", "vm"])
@pytest.mark.parametrize(("name", "coordinates"), MECHANISMS)
def test_rows_repeated_permuted_and_in_other_units_leave_the_motion_alone(name, coordinates, kernel):
    """Coordinates within 1e-12 over 1 s at 0.005 s, through a singular position of four-bar and five-bar."""
    e = by_rk4(name, coordinates=coordinates)
    few = [list(CASES)[MECHANISMS.index((name, coordinates)) % 5], "all of it"]
    start = {} if name == "slider_crank" else {"start.angle": 0.4}
    start["solver.step_size"] = 0.005
    expected = motion(e, kernel, start)
    for case in few if kernel == "oracle" and not ALL else CASES:
        got = motion(rewritten(case, name, coordinates), kernel, start)
        worst = max(np.abs(np.array(a[: e.n]) - b[: e.n]).max() for a, b in zip(got, expected, strict=True))
        assert worst <= 1e-12, (case, worst)
        # Reactions of least norm are of the same constraints, in any units; written twice they share alike.
        reactions = np.abs(np.subtract(got[::50], expected[::50])).max() / np.abs(expected[::50]).max()
        assert reactions <= 1e-9, (case, reactions)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "coordinates", "unit"),
    [
        *(("slider_crank", coordinates, 1.0) for coordinates in ("absolute", "mixed")),
        ("slider_crank", "joint", 0.8),  # the length of the rod, which turns alone
        *((name, coordinates, 1.0) for name in ("four_bar", "five_bar") for coordinates in ("mixed", "joint")),
        ("n_four_bar", "natural", 1.0),
    ],
)
def test_the_unit_of_a_row_is_known(name, coordinates, unit):
    """One for all rows, which so cost nothing; that of a row written in another unit follows it to 1e-11."""
    e = by_rk4(name, coordinates=coordinates)
    given = {"l2": 0.8} if name == "slider_crank" else {}
    units = by_the_oracle(prepared(e), given).units
    assert units == pytest.approx(unit, rel=1e-11)
    assert len(set(units)) == 1
    other = by_the_oracle(prepared(rewritten("each in its own unit", name, coordinates)), given).units
    assert other == pytest.approx(MILLI[: e.l] * units, rel=1e-11)


def test_descriptions_say_which_reactions_are_unique(exported):
    described = {v.name: v.description for v in read_model_description(str(exported("five_bar"))).modelVariables}
    for joint in "ABCDEF":
        assert "not unique" in described[f"{joint}.force.x"]
        assert "not unique" not in described[f"{joint}.force.y"]
    for i in range(1, 9):
        assert ("not unique" in described[f"multiplier[{i}]"]) == bool(i % 2)
    described = {v.name: v.description for v in read_model_description(str(exported("four_bar"))).modelVariables}
    assert not any("not unique" in text for text in described.values())


@pytest.mark.slow
def test_uniqueness_follows_what_is_in_force():
    m = alfmu.load("five_bar")
    m.release("E")
    m.lock("B")
    i = initialized(alfmu.Instance(prepared(alfmu.derive(m))), {"start.angle": 0.7})
    assert "E.force.x" in i.shared()
    assert "E.force.y" not in i.shared()
    i.set("E.released", True)
    i.step(0.02)
    assert i.shared() == []


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("angle", [-1.0, -0.82, -0.8])
def test_a_circle_counts_over_its_radius_wherever_it_starts(angle: float, radius: float) -> None:
    i = initialized(alfmu.Instance(prepared(derived("particle_on_circle"))), {"start.angle": angle, "rho": radius})
    assert row_units(i.equations, i.memory["k"]) == pytest.approx([radius], rel=0.2)
