"""Programs as functions: the same numbers however they are built, built once, and never in an FMU."""

import zipfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scenes import derived

import alfmu
from alfmu.fmi.slave import FUNCTIONS, SCENE, loaded
from alfmu.kernel import fusion
from alfmu.kernel.fusion import program_function
from alfmu.kernel.order import in_runs
from alfmu.simulation import prepared


def motion(equations: alfmu.Equations) -> np.ndarray:
    """Everything that can be read over a second from a singular position, by steps on the branch and quick ones."""
    i = alfmu.Instance(equations)
    i.initialize()
    rows = [i.read()]
    for _ in range(50):
        i.step(0.02)
        rows.append(i.read())
    assert rows[0][-1] == 1  # a limit was read
    return np.array(rows)


@pytest.fixture
def unpacked(exported, tmp_path) -> Path:
    """The resources of an FMU of the five-bar."""
    with zipfile.ZipFile(exported("five_bar")) as archive:
        for name in (SCENE, FUNCTIONS):
            (tmp_path / name).write_bytes(archive.read(f"resources/{name}"))
    return tmp_path


def inside(function: ca.Function) -> list[str]:
    """Names of the functions that a function calls, directly or not."""
    return [f.name() for f in function.find_functions(9)]


def test_fused_functions_give_the_numbers_of_the_small_ones_to_the_last_bit(monkeypatch):
    fused = motion(prepared(derived("five_bar")))
    monkeypatch.setattr(fusion, "FLAT", 0)
    equations = prepared(derived("five_bar"))
    assert np.array_equal(motion(equations), fused)
    for name in equations.kernel:
        called = inside(program_function(equations, name))
        assert "fused" not in called
        assert "weighted_evaluate" in called or name == "quick"


def test_a_program_is_one_function_or_few():
    """What the step on the branch does in each stage and at each place beside it is fused once."""
    equations = prepared(derived("five_bar"))
    for name in ("quick", "careful", "instant"):
        assert program_function(equations, name).is_a("SXFunction")
    for name in ("branch", "limit"):
        found = program_function(equations, name).find_functions(9)
        names = [f.name() for f in found if f.is_a("SXFunction")]
        assert set(names) == {"fused", "together"}
        assert names.count("fused") < 24


@pytest.mark.parametrize("mechanism", ["five_bar", "flyball_governor", "n_four_bar"])
def test_operations_in_runs_give_the_same_numbers_to_the_last_bit(mechanism):
    """A result that is an argument or a constant included."""
    equations = prepared(derived(mechanism))
    x = [ca.SX.sym(f"x{i}", size) for i, size in enumerate(equations.signatures["dynamics"]["inputs"])]
    results = [*equations.functions["dynamics"](*x), x[0], ca.vertcat(2.0, x[0][0], 0.0)]
    f = ca.Function("f", x, results, {"cse": True})
    again = in_runs(f)
    numbers = [np.random.default_rng(0).uniform(0.5, 2.0, size) for size in map(f.nnz_in, range(len(x)))]
    for one, other in zip(f(*numbers), again(*numbers), strict=True):
        assert one.sparsity() == other.sparsity()
        assert np.array_equal(one.full(), other.full())
    assert changes(again) < changes(f) / 2


def changes(f: ca.Function) -> int:
    """How often an operation is not the one before it."""
    codes = [f.instruction_id(k) for k in range(f.n_instructions())]
    return sum(a != b for a, b in pairwise(codes))


def test_instances_of_the_same_equations_share_what_is_built(monkeypatch):
    equations = prepared(derived("five_bar"))
    first = motion(equations)
    assert set(equations.programs) == set(equations.kernel)  # all were wanted
    monkeypatch.setattr(fusion, "_Fusion", None)  # would fail
    assert np.array_equal(motion(equations), first)
    assert prepared(equations) is equations
    assert replace(equations, name="other").programs == {}


def test_an_exported_scene_builds_no_function(unpacked, monkeypatch):
    expected = motion(prepared(derived("five_bar")))
    monkeypatch.setattr(fusion, "_Fusion", None)  # would fail
    equations, _ = loaded(unpacked)
    assert set(equations.programs) == set(equations.kernel)
    assert not {"weighted_evaluate", "plain_evaluate"} & set(equations.functions)  # no small function is wanted
    assert np.array_equal(motion(equations), expected)


def test_instances_and_resets_of_an_fmu_share_its_functions(unpacked):
    (equations, _), (again, _) = loaded(unpacked), loaded(unpacked)
    assert again is equations
    one, other = alfmu.Instance(equations), alfmu.Instance(equations)
    for i, angle in ((one, 0.0), (other, 0.4)):
        i.set("start.angle", angle)
        i.initialize()
    before = other.save()
    one.step(0.1)
    assert other.save() == before
