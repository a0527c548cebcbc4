"""The singular benchmark: its files are its problems, its references are exact, and its verdicts are right."""

import re
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf
from oracles import ode
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from studies import rows, script

import alfmu
from alfmu.studies.tables import markdown

FOLDER = Path(__file__).parents[1] / "docs" / "singular_benchmark"
LONG = "n_four_bar_1000"
NAMES = ["particle", "five_bar", "five_bar_massless", "four_bar", "slider_crank", "n_four_bar_2", "n_four_bar_40"]
NAMES += ["bricard", "bennett", "kite", "stewart", "parallelogram_chain"]


@pytest.fixture(scope="module")
def benchmark():
    yield from script("singular_benchmark")


@pytest.fixture(scope="module")
def problems(benchmark):
    yield from script("_singular_problems")


@pytest.fixture(scope="module")
def codes(benchmark):
    yield from script("_singular_codes")


def exact(problem, reference):
    """Points (k, m, 3) of a table."""
    found = np.zeros((len(problem.times), len(problem.points), 3))
    for i, name in enumerate(problem.points):
        for j, axis in enumerate("xy" if problem.planar else "xyz"):
            found[:, i, j] = reference[f"{name}.{axis}"]
    return found


def alike(one, two) -> bool:
    """Whether two contents of JSON are the same but for round-off, which differs between processors."""
    if isinstance(one, dict) and isinstance(two, dict):
        return one.keys() == two.keys() and all(alike(one[key], two[key]) for key in one)
    if isinstance(one, list) and isinstance(two, list):
        return len(one) == len(two) and all(map(alike, one, two))
    if isinstance(one, float) and isinstance(two, float):
        return abs(one - two) <= 1e-14 * max(1.0, abs(two))
    return type(one) is type(two) and one == two


# Files ------------------------------------------------------------------------------------------------------------


def test_every_problem_has_its_files(problems):
    assert set(problems.PROBLEMS) == {*NAMES, LONG}
    assert {path.stem for path in FOLDER.glob("*.json")} == set(NAMES)
    assert {path.stem for path in FOLDER.glob("*.csv")} == {*problems.PROBLEMS, "results"}
    assert problems.loaded(LONG).bodies[2000].name == "crank1001"


@pytest.mark.parametrize("name", NAMES)
def test_files_are_the_problems_and_begin_the_exact_motion(problems, codes, name):
    """Trees, closures and starts agree with closed forms of the branch, and the first row with one step."""
    problem, tables = problems.loaded(name), problems.table(name)
    with mp.workdps(20):
        made, motion = problems.PROBLEMS[name]()
        assert alike(problems.plain(made), problems.plain(problem))
        assert len(tables) == len(problem.runs) == len(motion.starts)
        for run, table, (s, w) in zip(problem.runs, tables, motion.starts, strict=True):
            q, v, h = np.array(run.q), np.array(run.v), 1e-6
            there = codes.places(problem, np.array([q, q + h * v, q - h * v]))
            points, sides = np.split(there, [len(problem.points)], 1)
            lengths = [closure.length or 0.0 for closure in problem.seen]
            assert np.abs(np.linalg.norm(sides[:, 1::2] - sides[:, ::2], axis=2) - lengths).max() < 1e-10
            assert np.abs(points[0] - exact(problem, table)[0]).max() < 1e-15
            found = motion.derivatives([mpf(x) for x in s], [mpf(x) for x in w])[1]
            rates = [[float(x.x[1]) for x in point] for point in found]
            moved = (points[1] - points[2]) / (2 * h)
            assert np.abs(moved[:, : len(rates[0])] - rates).max() < 1e-8
        s, w = motion.starts[0]
        y = [mpf(x) for x in (*s, *w)]
        k, torque = len(s), problem.runs[0].torque

        def rate(y):
            return [*y[k:], *motion.rates(problem, torque, y[:k], y[k:])]

        y = problems.extrapolated(rate, y, mpf(problem.times[1]), 6)
        found = motion.derivatives(y[:k], y[k:])[1]
        far = [[float(x.x[0]) for x in point] for point in found]
        assert np.abs(exact(problem, tables[0])[1, :, : len(far[0])] - far).max() < 2e-6


def test_tables_are_those_of_unrelated_references(problems):
    """The pendulum of the five-bars in elliptic functions, and the slider-crank by another integrator."""
    for name, m2 in (("five_bar", 1.0), ("five_bar_massless", 0.0)):
        problem, (table,) = problems.loaded(name), problems.table(name)
        angles = Parallelogram(m2=m2).swing(0.0, 2.0, problem.times)[:, 0]
        assert np.abs(table["B.x"] - np.cos(angles)).max() < 2e-15
        assert np.abs(table["B.y"] - np.sin(angles)).max() < 2e-15
    problem, (table,) = problems.loaded("slider_crank"), problems.table("slider_crank")
    crank = SliderCrank(0.5, 0.5, aligned=True)
    angles = ode.motion(lambda t, x, v: crank.acceleration(x, v), float(np.pi / 4), 0.0, problem.times)[:, 0]
    assert np.abs(table["C.x"] - np.cos(angles)).max() < 1e-11


@pytest.mark.parametrize("name", [*NAMES[1:6], "parallelogram_chain", "kite"])
def test_poles_and_limits_are_those_of_the_exact_motion(problems, name):
    """A pole grows tenfold where the position is ten times nearer."""
    problem, motion = problems.PROBLEMS[name]()
    w, torque = [mpf(2), mpf(-3)][: len(motion.starts[0][0])], problem.runs[0].torque
    sizes = []
    for distance in (1e-3, 1e-4):
        s = [motion.singular + distance * x for x in w]
        parts = motion.derivatives(s, w, motion.rates(problem, torque, s, w))[0]
        sizes.append(np.nanmax(np.abs(problems.reactions(problem, parts, torque))))
    assert problem.reactions == ("pole" if sizes[1] > 5 * sizes[0] else "limit")


# Runs and verdicts ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["kite", pytest.param("bricard", marks=pytest.mark.slow)])
def test_alfmu_passes(benchmark, codes, problems, name):
    """The kite through its branch point, and a loop in space with a redundant constraint, at 1e-10."""
    problem, (table,) = problems.loaded(name), problems.table(name)
    found = codes.by_alfmu(problem)(problem.runs[0], 1e-10)
    branch = benchmark.branch_of(problem, problems.PROBLEMS[name]()[1])
    off = benchmark.errors(problem, found, table, branch)
    assert off["error [m]"] < 1e-11
    assert off["gap [m]"] < 1e-14
    assert benchmark.verdict(off, found.stopped) == "ok"
    if name == "kite":
        assert off["force error [N]"] < 1e-9


TIGHT = {"method": "stiff", "relative_tolerance": 1e-11, "absolute_tolerance": 1e-11}


@pytest.mark.slow
def test_a_pose_where_two_singular_values_vanish_is_passed_by_every_method_and_costs_no_digits(codes, problems):
    """Limits were taken from places 0.15 rad apart, which missed 5e-5 m by two methods and ended the others; velocities
    at places beside had lengths with another error each: 7e-7 J and 4e-9 m, whatever the tolerance."""
    problem, (table,) = problems.loaded("stewart"), problems.table("stewart")
    e = alfmu.derive(codes.declared(problem))
    usual = [({"method": "auto"}, 1e-7, 5e-5), ({"method": "rk4", "step_size": 5e-3}, 1e-7, 5e-5)]
    for given, near, lost in (*usual, ({"method": "order8"}, 1e-7, 5e-5), (TIGHT, 3e-10, 5e-8)):
        values = {f"solver.{name}": x for name, x in given.items()}
        result = alfmu.simulate(e, problem.stop, problem.every, parameters=values)
        for i, name in enumerate(problem.points):
            for axis in "xyz":
                assert np.abs(result[f"point{i}.{axis}"] - table[f"{name}.{axis}"]).max() < near, given
        assert np.ptp(result["monitor.energy"]) < lost, given  # J, of 30


def test_what_is_lost_is_told(benchmark, codes, problems):
    """Another branch, an open loop, a late motion, and one that stopped."""
    problem, (table,) = problems.loaded("five_bar"), problems.table("five_bar")
    branch = benchmark.branch_of(problem, problems.PROBLEMS["five_bar"]()[1])
    th = np.arctan2(table["B.y"], table["B.x"])
    q = np.column_stack([th, -th, th, -th])

    def verdict(q, stopped="", shift=0.0):
        there = codes.places(problem, q)
        there[:, -1] += shift
        found = codes.Found(there, None, 0.0)
        return benchmark.verdict(benchmark.errors(problem, found, table, branch), stopped)

    assert verdict(q) == "ok"
    assert verdict(np.roll(q, 1, 0)) == "inaccurate"
    assert verdict(q, shift=0.01) == "loops open"
    assert verdict(q * [1, 1, -1, 1]) == "left the branch"
    assert verdict(q, "too fast") == "stopped: too fast"
    assert benchmark.verdict({"error [m]": np.nan}, "") == "stopped: the state is NaN"


def test_equal_times_decide(benchmark):
    """A rival is compared with what alfmu reaches in the same time."""

    def row(code, seconds, error):
        return {"problem": "kite", "code": code, "seconds": seconds, "error [m]": error, "result": "ok"}

    found = benchmark.duel([row("alfmu", 1.0, 1e-6), row("alfmu", 2.0, 1e-9), row("SciPy", 1.5, 1e-5)], "kite")
    assert found["its error / alfmu's"] == pytest.approx(10.0)
    assert "faster" not in "".join(found)
    assert "SciPy: 1.0e-02" in str(benchmark.duel([row("alfmu", 1.0, 1e-6), row("SciPy", 0.1, 1e-2)], "kite"))


# The page ---------------------------------------------------------------------------------------------------------


def test_the_page_shows_the_results(benchmark):
    text, kept = (FOLDER / "index.md").read_text(encoding="utf-8"), rows(FOLDER, "results")
    assert {row["problem"] for row in kept} - {LONG} == set(NAMES)
    assert {row["code"] for row in kept} == set(benchmark.CODES)
    found = benchmark.read(FOLDER / "results.csv")
    for name in NAMES:
        line = [name, *(benchmark.cell(found, name, code) for code in benchmark.CODES)]
        assert markdown(["", *benchmark.CODES], [line]).splitlines()[-1] in text
        assert re.search(rf"`{name}`", text)
    assert "not installed" not in {row["result"] for row in kept}
