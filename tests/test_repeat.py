"""Repetition in long functions: that it is found, becomes loops in C, and changes no bit of any number."""

import subprocess
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scenes import derived
from sines import by_instructions
from test_compiled import Functions

from alfmu.equations import Equations
from alfmu.equations.arrays import ArrayFunction, ArrayFunctions
from alfmu.equations.evaluation import elimination, elimination_order, with_functions
from alfmu.kernel import emit, loops
from alfmu.kernel.controlled import whole
from alfmu.kernel.form import Traced
from alfmu.kernel.repeat import Repeat, repeats
from alfmu.kernel.stream import Instructions, Operations
from alfmu.runtime import compiled as build
from alfmu.simulation import prepared

LONG = "weighted_evaluate", "weighted_iterate", "weighted_correct"

N = 60


def operations(f: ca.Function) -> Operations:
    return Operations.of(Instructions.of(f))


def source(f: ca.Function) -> str:
    """The C of a function as a long one."""
    return "".join(text for text, _ in loops.blocks(f.name(), operations(f), {}, emit.BLOCK))


def scene(*functions: ca.Function) -> Equations:
    """Equations with these functions alone."""
    empty = Traced.of(derived("particle_on_circle"), functions={}, signatures={})
    return with_functions(empty, {f.name(): f for f in functions})


def numbers(backend, e: Equations) -> dict[str, np.ndarray]:
    """Results of all functions, for the same arguments each time."""
    rng, found = np.random.default_rng(1), {}
    for name, signature in e.signatures.items():
        call = ArrayFunction(backend, name, {**signature, "matrices": 0, "outputs": shapes(signature)})
        results = call(*(rng.uniform(0.5, 1.5, size) for size in signature["inputs"]))
        found[name] = np.concatenate([y.copy().reshape(-1) for y in results])
    return found


def shapes(signature: dict) -> list:
    """Of the nonzeros of results."""
    return [[len(shape[3]), 1] if len(shape) > 2 else shape for shape in signature["outputs"]]


class Expected(ArrayFunctions):
    """CasADi, with the runtime's sines and cosines."""

    def bind(self, name: str, x: list[np.ndarray], y: list[np.ndarray]) -> Callable[[], None]:
        def run() -> None:
            for results, found in zip(y, by_instructions(self.equations.functions[name], x), strict=True):
                results[:] = found

        return run


def check(*functions: ca.Function) -> None:
    """The compiled functions give the numbers of CasADi."""
    e = scene(*functions)
    compiled, expected = numbers(Functions(e), e), numbers(Expected(e), e)
    for name in expected:
        assert np.array_equal(compiled[name], expected[name]), name


@pytest.fixture(autouse=True)
def long(monkeypatch):
    """Every function counts as long."""
    monkeypatch.setattr(emit, "WHOLE", 0)


def test_one_loop_for_the_same_of_each_entry():
    x, p = ca.SX.sym("x", N), ca.SX.sym("p")
    f = ca.Function("f", [x, p], [ca.vertcat(*(ca.sin(x[i]) * p + x[i] for i in range(N)))])
    assert repeats(operations(f)) == [Repeat(0, 4, N)]  # with the writing of the result
    text = source(f)
    assert text.count("for (") == 1
    assert "static" not in text
    assert f"k < {N}" in text
    assert "const Real *const x0 = x[0];" in text
    assert "[0 + 1 * k]" in text
    check(f)


def test_constants_that_differ_are_in_a_table():
    x = ca.SX.sym("x", N)
    f = ca.Function("f", [x], [ca.vertcat(*((x[i] + 0.1 * (i + 1) ** 2) * 7.5 for i in range(N)))])
    text = source(f)
    assert text.count("for (") == text.count("static const double") == 1
    assert text.count("7.5") == 1
    check(f)


def test_constants_of_all_kinds():
    x = ca.SX.sym("x", N)
    values = [ca.inf, -ca.inf, -0.25, 1e300, 5e-324]
    f = ca.Function("f", [x], [ca.vertcat(*(ca.fmin(x[i], values[i % 5]) + (i - 30.5) for i in range(N)))])
    assert "static const double" in source(f)
    check(f)


def test_entries_out_of_line_are_found_by_a_table():
    x, order = ca.SX.sym("x", N), np.random.default_rng(0).permutation(N).tolist()
    f = ca.Function("f", [x], [ca.vertcat(*(ca.cos(x[i]) * x[j] for i, j in enumerate(order)))])
    text = source(f)
    assert text.count("for (") == 1
    assert text.count("static const int") == 1
    check(f)


def test_values_that_pass_from_one_time_to_the_next():
    """Down a chain and back up, as a banded matrix is solved: the second loop reads what the first left, backwards."""
    x = ca.SX.sym("x", N)
    down, up = [x[0]], []
    for i in range(1, N):
        down.append(x[i] - down[-1] / (2 + x[i - 1]))
    for value in reversed(down):
        up.append(value if not up else value - up[-1] * 0.3)
    f = ca.Function("f", [x], [ca.vertcat(*reversed(up))])
    found = repeats(operations(f))
    assert len(found) >= 2
    assert sum(each.times * each.period for each in found) > 0.9 * len(operations(f))
    text = source(f)
    assert " - 1 * k]" in text or " - 2 * k]" in text
    assert len(text) < 6000
    check(f)


def test_values_that_pass_far_ahead():
    """Each time needs a value of three times ago."""
    x, made = ca.SX.sym("x", N), []
    for i in range(N):
        made.append(ca.sin(x[i]) if i < 3 else ca.sin(x[i]) + made[i - 3] * made[i - 1])
    check(f := ca.Function("f", [x], [made[-1] + made[-2]]))
    assert source(f).count("for (") == 1


@pytest.mark.parametrize("first", ["within", "before"])
def test_a_value_that_the_first_pass_alone_finds_in_itself(first):
    """A period of twelve parts has its indices in line, but for the first pass, which takes a value from elsewhere than
    all others: one of its own, or one from before the loop."""
    count, part = 600, 12
    x, p = ca.SX.sym("x", count), ca.SX.sym("p")
    before = [ca.tan(ca.exp(ca.sin(p * (i + 1.5)))) for i in range(part)]
    made, products = [], []
    for i in range(count):
        made.append(ca.sin(x[i]))
        block, place = divmod(i, part)
        own, other = made[part * block], before[0]
        if place < 9:
            factor = made[i - part] if block else before[place]
        else:
            factor = own if (block == 0) == (first == "within") else other
        products.append(made[i] * factor)
    f = ca.Function("f", [x, p], [ca.vertcat(*before), ca.vertcat(*products)])
    assert source(f).count("for (") > 1
    check(f)


def test_what_varies_in_a_period_is_part_of_it():
    """Two kinds of parts that alternate, and a third one in the middle."""
    x = ca.SX.sym("x", N)
    kinds = [lambda a: ca.sin(a) * a + 1, lambda a: ca.exp(a) / (a + 2), lambda a: ca.sqrt(ca.sqrt(a))]
    f = ca.Function("f", [x], [ca.vertcat(*(kinds[2 if i == 31 else i % 2](x[i]) for i in range(N)))])
    assert source(f).count("for (") == 2
    check(f)


def test_where_nothing_repeats_the_code_is_straight():
    rng, x = np.random.default_rng(0), ca.SX.sym("x", 5)
    binary = [lambda a, b: a + b, lambda a, b: a * b, lambda a, b: a - b, ca.fmin, ca.hypot]
    values = ca.vertsplit(x)
    for _ in range(900):
        i, j, k = rng.integers(len(values)), rng.integers(len(values)), rng.integers(len(binary))
        values.append(binary[k](values[i], ca.sin(values[j])))
    f = ca.Function("f", [x], [ca.vertcat(*values[-200:])])
    assert repeats(operations(f)) == []
    text = source(f)
    assert "for (" not in text
    assert text.count("extern Function f_") >= 2 * (len(operations(f)) // emit.BLOCK)
    check(f)


def test_a_result_may_be_written_over_an_argument():
    """As the calls of programs do it: both are one array."""
    x = ca.SX.sym("x", N)
    f = ca.Function("f", [x], [ca.vertcat(*(x[i] * x[i - 1] for i in range(N)))])
    values = np.linspace(1, 2, N)
    expected = np.array(f(values)).reshape(-1)
    Functions(scene(f), {"f": {0: N}}).bind("f", [values], [values])()
    assert np.array_equal(values, expected)


def test_arguments_that_are_written_over_are_known():
    e = whole(prepared(derived("n_four_bar")))
    found = emit._overwritten(e)
    assert found["weighted_place"] == {0: e.n}
    assert found["plain_iterate" if "plain_iterate" in found else "weighted_iterate"]
    assert found["sum"] == {}


@pytest.fixture(scope="module", params=["natural", "absolute"])
def chains(request) -> list[Equations]:
    """N-four-bars of 30 and of 60 loops, traced."""
    return [whole(prepared(derived("n_four_bar", loops=n, coordinates=request.param))) for n in (30, 60)]


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_chain_of_loops_gives_the_same_numbers(chains, monkeypatch):
    """Against CasADi and against straight-line code, to the last bit."""
    e = scene(*(chains[0].functions[name] for name in LONG))
    rolled = Functions(e)
    monkeypatch.setattr(loops, "repeats", lambda operations: [])
    straight = Functions(e)
    assert rolled.path != straight.path
    assert sum(map(len, rolled.files)) < sum(map(len, straight.files)) / 5
    assert 0 < rolled.spare < 2 * straight.spare
    found = [numbers(backend, e) for backend in (rolled, straight, Expected(e))]
    for name in LONG:
        assert np.isfinite(found[0][name]).any()
        for other in found[1:]:
            assert np.array_equal(found[0][name], other[name], equal_nan=True), name


@pytest.mark.slow
def test_the_c_of_a_chain_is_free_of_warnings(chains, tmp_path):
    if not (command := build.compiler()):
        pytest.skip("no compiler")
    texts = emit.compiled_code(scene(*chains[0].functions.values()), {}, "chain")
    assert any("for (" in text for text in texts)
    files = [f"chain{i}.c" for i in range(len(texts))]
    for name, text in zip(files, texts, strict=True):
        (tmp_path / name).write_text(text)
    for header in build.HEADERS:
        (tmp_path / header.name).write_text(header.read_text())
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", *files]
    done = subprocess.run([*command, *flags], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_c_of_a_chain_hardly_grows_with_it(chains):
    for name in LONG:
        few, many = (e.functions[name] for e in chains)
        assert many.n_instructions() > 1.9 * few.n_instructions()
        assert len(source(many)) < 1.15 * len(source(few)), name


@pytest.mark.slow
def test_long_scenes_are_eliminated_as_declared_where_that_costs_little():
    e = whole(prepared(derived("n_four_bar", loops=60, coordinates="natural")))
    assert elimination_order(e) == list(range(e.n))
    hub = ca.Sparsity.diag(100)
    hub = (
        hub
        + ca.Sparsity.triplet(100, 100, [0] * 100, range(100))
        + ca.Sparsity.triplet(100, 100, range(100), [0] * 100)
    )
    assert elimination(hub) != list(range(100))
    assert sorted(elimination(hub)) == list(range(100))
