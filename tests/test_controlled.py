"""Methods beside RK4 in the kernel: step control, linear algebra, steps against the oracle; runs, inputs, FMUs."""

import ctypes
import math
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from oracles.adaptive import Adaptive, Control, by_method
from oracles.parallelogram import Parallelogram
from scenes import derived, initialized, made

import alfmu
from alfmu import runtime
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.kernel.complete import complete
from alfmu.kernel.controlled import whole
from alfmu.kernel.form import Call
from alfmu.kernel.memory import PACE, Layout
from alfmu.method.inputs import Past
from alfmu.method.stepping import judged, landing, newton
from alfmu.model.settings import FIXED
from alfmu.runtime import compiled as build
from alfmu.runtime.pipeline import packed
from alfmu.simulation import prepared, run, with_defaults

pytestmark = pytest.mark.usefixtures("quick_compiler")
"""Optimised code is judged in `test_compiled`, also of these methods."""

each_kernel = pytest.mark.parametrize("kernel", ["vm", "compiled"])


def methods(*names: str, compiled: str) -> pytest.MarkDecorator:
    """Methods with the interpreted kernel, and one with the compiled one."""
    return pytest.mark.parametrize(("method", "kernel"), [(x, "compiled" if x == compiled else "vm") for x in names])


@cache
def scene(name: str, method: str, kernel: str, order: int) -> alfmu.Equations:
    """A mechanism with a method and an order of inputs in its kernel."""
    return prepared(with_defaults(derived(name), {"solver.method": method, "solver.input_order": order}), kernel)


def begun(name: str, method: str, kernel: str, order: int = 0, **given: float) -> alfmu.Instance:
    """An initialised instance with a method; names of variables with two underscores for the point."""
    return initialized(made(scene(name, method, kernel, order), kernel), **given)


def by_the_oracle(name: str, method: str, order: int = 0, **given: float) -> Adaptive:
    """The same on NumPy arrays: steps of the method from the oracle's accelerations."""
    return by_method(begun(name, "rk4", "oracle", order, **given), method, order)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), [("five_bar", "auto"), ("flyball_governor", "stiff")])
def test_an_error_that_is_no_number_is_refused(name, method):
    """In every program with error control: the largest of numbers leaves out those that are none."""
    e = complete(scene(name, method, "vm", 0))
    judged_by = [step for program in e.kernel.values() for step in program.steps if is_error(step)]
    assert len(judged_by) >= 2
    for step in judged_by:
        f = e.functions[step.function]
        known = [
            np.full(f.numel_in(i), math.nan if x in ("off_v", "dv") else 0.5) for i, x in enumerate(step.arguments)
        ]
        assert np.isnan(np.concatenate(known)).any()
        assert float(f(*known)[0]) == math.inf, step.function


def is_error(step: object) -> bool:
    return isinstance(step, Call) and step.function.endswith("_error") and step.results[0] == "error"


# Rules ------------------------------------------------------------------------------------------------------------


def numbers() -> np.ndarray:
    """Steps, errors before, refusals, steps that were made, errors, what is left: with every case of the rules."""
    random = np.random.default_rng(3)
    table = 10.0 ** random.uniform([-6, -4, 0, -6, -8, -6], [0, 1, 0, 0, 5, 1], (400, 6))
    table[:, 2] = random.integers(0, 2, 400)
    table[::3, 3] = table[::3, 0]  # not cut
    table[:8, 4] = np.nan, np.inf, 0.0, 1.0, 1e300, 1e-300, 1 + 1e-15, 1 - 1e-15
    table[8:12, 5] = table[8:12, 0] * [1.0, 1.5, 2.0, 1 + 1e-12]
    return table


@pytest.mark.parametrize("order", [5, 6, 8])
def test_step_control_in_the_kernel_is_that_of_numbers(order):
    """To the last bit."""
    x = ca.SX.sym("x", 6)
    dt, before, refused, step, error, left = ca.vertsplit(x)
    found = *judged(order, (dt, before, refused), step, error, ca.if_else), landing(dt, left, ca.if_else)
    rule = ca.Function("rule", [x], [ca.vertcat(*found)])
    accepted = 0
    for row in numbers():
        control = Control(order, 1.0)
        control.numbers[:] = row[:3]
        proposed = control.propose(row[5])
        expected = [control.judge(row[3], row[4]), *control.numbers, proposed]
        *after, said, proposed = np.array(rule(row)).ravel()
        assert [bool(said), *after, proposed] == expected
        accepted += expected[0]
    assert 100 < accepted < 300


def test_newtons_method_goes_on_as_long_as_it_gains():
    inf = float("inf")
    for change, before, converged, worth in [
        (1e-6, inf, True, False),
        (1.0, inf, False, True),
        (1e-2, 1.0, False, True),
        (1e-4, 1e-2, True, False),
        (0.5, 1.0, False, False),
        (1e-9, 1e-12, False, False),
        (float("nan"), 1.0, False, False),
    ]:
        assert [bool(x) for x in newton(change, before)] == [converged, worth]
        assert [bool(x) for x in newton(ca.DM(change), ca.DM(before), ca.if_else)] == [converged, worth]


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Callable[..., None]:
    """Factorises and solves."""
    command, place = build.compiler() or pytest.skip("no compiler"), tmp_path_factory.mktemp("linear")
    source = (
        '#include "linear.h"\n'
        "void both(int n, int s, int terms, const double *w, const double *const *parts, double *a,\n"
        "    double *o, const double *const *b, double *x)\n{\n"
        "    linear_factor(n, s, terms, w, parts, a, o);\n    linear_solve(n, s, a, o, b, x);\n}\n"
    )
    (place / "both.c").write_text(source)
    folder = Path(runtime.__file__).parent / "c" / "core"
    flags = ["-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", f"-I{folder}", "both.c", folder / "linear.c"]
    subprocess.run([*command, *flags, "-o", "both.so", "-lm"], cwd=place, check=True)
    return ctypes.CDLL(str(place / "both.so")).both


@pytest.mark.parametrize(("n", "s"), [(1, 1), (3, 1), (7, 5), (4, 2), (28, 5)])
def test_the_linear_algebra_of_the_runtime(both, n, s):
    """Against LAPACK, on matrices of blocks that need pivoting, to a small multiple of their condition."""
    random = np.random.default_rng(n * s)
    weights = random.standard_normal((2, s, s))
    parts = random.standard_normal((2, s, n, n))
    parts[:, :, 0, 0] = 0.0
    right, x = random.standard_normal((s, n)), np.zeros(n * s)
    a, order = np.zeros(((n * s), (n * s))), np.zeros(n * s)

    def pointers(arrays):
        return (ctypes.c_void_p * len(arrays))(*(each.ctypes.data for each in arrays))

    columns = [np.asfortranarray(block).ravel("F") for term in parts for block in term]
    arguments = [pointers(columns), a.ctypes, order.ctypes, pointers(list(right)), x.ctypes]
    arguments = [y if isinstance(y, ctypes.Array) else ctypes.c_void_p(y.data) for y in arguments]
    both(n, s, 2, ctypes.c_void_p(weights.ctypes.data), *arguments)
    matrix = np.einsum("tij,tirc->irjc", weights, parts).reshape(n * s, n * s)
    if n == s == 1:
        assert not np.isfinite(x).any()  # singular
        return
    expected = np.linalg.solve(matrix, right.ravel())
    assert np.abs(x - expected).max() <= 1e-14 * np.linalg.cond(matrix) * np.abs(expected).max()


# Steps ------------------------------------------------------------------------------------------------------------

GIVEN = {"slider_crank": {"start__angle": 0.4}, "five_bar": {"start__angle": 0.5}}
BOUNDS = {"explicit": 1e-13, "stiff": 1e-11, "trapezoidal": 1e-10, "generalized_alpha": 1e-10}
STEPS = [
    *((name, method) for name in GIVEN for method in BOUNDS),
    *(("end_stop", "explicit"), ("end_stop", "trapezoidal"), ("bennett", "stiff"), ("bennett", "generalized_alpha")),
    *(("flyball_governor", "explicit"), ("flyball_governor", "stiff")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), STEPS)
def test_a_step_is_that_of_the_oracle(name, method):
    """From the same state with the same length: state and work, and the error within what multiplier iterations leave.

    Where Newton's method decides when it stops, what it leaves counts too: in the index-3 form 1e-12 of positions, over
    the step in velocities.
    """
    length = 1e-4 if name == "flyball_governor" else 0.01
    given = {**GIVEN.get(name, {}), "solver__step_size": length}
    kernel, adaptive, fixed = begun(name, method, "vm", **given), by_the_oracle(name, method, **given), method in FIXED
    adaptive.fixed = length if fixed else None
    layout = kernel.layout
    for _ in range(3):
        t, y, made = kernel.time, kernel.state.copy(), kernel.counters.steps
        if not fixed:
            kernel.memory["pace"][PACE.index("dt")] = length
        kernel.step(length)
        assert kernel.counters.steps == made + 1
        adaptive.place(t, y[: layout.n], y[layout.n : 2 * layout.n], y[layout.work])
        q, v, _, work, _, _, error = adaptive.step(length)
        found = np.concatenate([kernel.q, kernel.v, [kernel.work]])
        expected = np.concatenate([q, v, [work]])
        assert np.abs(found - expected).max() <= BOUNDS[method] * (1 + np.abs(expected).max())
        if not fixed:
            assert kernel.memory["after"][layout.change] == pytest.approx(error, rel=1e-4, abs=1e-6)


@pytest.mark.slow
@methods("explicit", "order8", "stiff", "trapezoidal", compiled="explicit")
def test_communication_steps_of_any_length(kernel, method):
    """Steps, refused ones and evaluations are counted, and no step is a patient one."""
    i = begun("end_stop", method, kernel, solver__step_size=1e-3)
    for h in (0.1, 0.013, 0.5, 0.02):
        i.step(h)
    assert i.time == pytest.approx(0.633)
    assert i.counters.patient == 0
    tried = i.counters.steps + i.counters.refused
    assert tried >= 4
    assert i.counters.evaluations >= (2 if method == "trapezoidal" else 10) * tried
    if method in FIXED:
        assert i.counters.steps == 633
        assert i.counters.refused == 0


@pytest.mark.slow
@methods("explicit", "stiff", compiled="stiff")
def test_steps_are_refused_inside(kernel, method):
    """A first step much too long is made again shorter, as by the oracle."""
    i = begun("slider_crank", method, kernel, start__angle=0.4)
    adaptive = by_the_oracle("slider_crank", method, start__angle=0.4)
    i.memory["pace"][0] = adaptive.control.numbers[0] = 1.0
    i.step(1.0)
    adaptive.cover(1.0)
    expected = adaptive.counts["steps"], adaptive.counts["refused"], *adaptive.q
    assert (i.counters.steps, i.counters.refused, *i.q) == pytest.approx(expected, rel=1e-7)
    assert i.counters.refused >= 1


@pytest.mark.slow
@each_kernel
def test_the_kernel_passes_singular_positions(kernel):
    """From a start in one, through others, by steps on the branch; against the exact motion."""
    times = np.linspace(0.0, 9.0, 19)
    exact = Parallelogram(m4=None).driven(0.0, 2.0, times, 4.0)[:, 0]
    i = begun("four_bar", "explicit", kernel)
    i.set("A.torque", 4.0)
    for k in range(1, 19):
        i.step(times[k] - times[k - 1])
        assert abs(i.q[0] - exact[k]) <= 1e-5  # ten times the tolerance
    tries, careful, made, refused, beside, limits = i.memory["tally"][-6:]
    assert beside >= 10
    assert limits >= 10
    assert i.counters.steps == made
    # Each after one that was troubled, and with one more evaluation to see what round-off leaves, as careful tries have
    # it; outputs are read at the end of each of eighteen communication steps.
    assert tries >= made + refused
    assert i.counters.evaluations == 13 * (tries + beside) + careful + beside + 8 * limits + 18


@pytest.mark.slow
@each_kernel
def test_the_procedure_of_the_paper_takes_no_limits(kernel):
    """`solver.branch` = paper: no step is made on the branch, by whatever makes it."""
    i = begun("four_bar", "explicit", kernel, solver__branch="paper", start__angle=0.7)
    i.step(3.0)
    made, _, _, limits = i.memory["tally"][-4:]
    assert made >= 5
    assert limits == 0
    exact = Parallelogram(m4=None).swing(0.7, 2.0, np.array([0.0, 3.0]))[1, 0]
    assert abs(i.q[0] - exact) <= 1e-2


@pytest.mark.slow
@methods("stiff", "trapezoidal", "generalized_alpha", compiled="trapezoidal")
def test_implicit_methods_pass_singular_positions(kernel, method):
    """An explicit step on the branch leads past what they cannot judge; steps of 0.02 s err as their order has it."""
    i = begun("four_bar", method, kernel, start__angle=0.7)
    i.step(3.0)
    exact = Parallelogram(m4=None).swing(0.7, 2.0, np.array([0.0, 3.0]))[1, 0]
    assert abs(i.q[0] - exact) <= (1e-6 if method == "stiff" else 0.05)
    assert i.memory["tally"][-2] > 0
    assert i.counters.patient == 0


@pytest.mark.slow
@methods("explicit", "stiff", "generalized_alpha", compiled="stiff")
def test_what_is_saved_goes_on_to_the_last_bit(kernel, method):
    """By another instance, and by the same one after it went on."""
    i = begun("slider_crank", method, kernel, start__angle=0.4)
    for _ in range(3):
        i.step(0.07)
    state = i.save()
    i.step(0.31)
    expected, counters = i.read().copy(), i.counters
    other = alfmu.Instance(i.equations)
    for each in (other, i):
        each.restore(state)
        each.step(0.31)
        assert np.array_equal(each.read(), expected)
        assert each.counters == counters


def test_only_a_scene_with_the_method_has_it_in_its_kernel():
    """Its programs, its functions and its memory."""
    plain, inputs = whole(scene("four_bar", "rk4", "vm", 0)), scene("five_bar", "rk4", "vm", 2)
    stiff, explicit = (whole(scene("four_bar", method, "vm", 0)) for method in ("stiff", "explicit"))
    assert not {"method", "beside", "reach"} & plain.kernel.keys()
    assert "reach" in inputs.kernel
    assert {"method", "beside"} <= stiff.kernel.keys() & explicit.kernel.keys()
    assert "stiffness" in stiff.functions
    assert not {"stiffness", "reach"} & {*plain.functions, *explicit.functions}
    sizes = [len(packed(each)) for each in (plain, explicit, stiff)]
    assert sizes[0] < sizes[1]
    assert 1.2 * sizes[0] < sizes[2]


@pytest.mark.slow
def test_a_scene_may_run_by_another_method_than_its_own():
    """Then it is traced again."""
    ends = []
    for method in ("stiff", "explicit", "rk4"):
        i = alfmu.Instance(scene("slider_crank", "stiff", "vm", 0))
        i.set("start.angle", 0.4)
        i.set("solver.step_size", 0.001)
        i.set("solver.method", method)
        i.initialize()
        i.step(0.2)
        assert i.choices["solver.method"] == method
        ends.append(i.q.copy())
    assert np.abs(ends[1] - ends[0]).max() <= 1e-6
    assert np.abs(ends[2] - ends[0]).max() <= 1e-6


# Inputs -----------------------------------------------------------------------------------------------------------


def test_past_inputs_in_the_kernel_are_those_of_numbers():
    """To the last bit, points that are reached again included."""
    e = whole(scene("five_bar", "rk4", "vm", 2))
    reach, at = e.functions["reach"], e.functions["inputs"]
    count, random = len(e.inputs), np.random.default_rng(5)
    past, z = Past(count), np.zeros(reach.size1_in(0))
    for t in (0.0, 0.1, 0.15, 0.3, 0.3, 0.32, 0.15, 0.2, 0.05, 0.4, 0.41, 0.42):
        u = random.standard_normal(count)
        z[Layout(e).time] = t
        noted = np.array(reach(z, u, past.numbers)).ravel()
        past.reach(t, u)
        assert np.array_equal(noted, past.numbers)
        for later in (t, t + 0.03, t + 0.1):
            assert np.array_equal(np.array(at(past.numbers, later)).ravel(), past.at(later, 2))


def test_the_polynomial_goes_through_past_inputs():
    """Order 2 reproduces a parabola, order 1 a line, and fewer points a lower order."""
    past = Past(1)
    for t, known in ((0.0, 0), (0.1, 1), (0.25, 2), (0.3, 2)):
        past.reach(t, np.array([3 * t**2 - t + 1]))
        later = t + 0.07
        exact = {2: 3 * later**2 - later + 1, 0: 3 * t**2 - t + 1}
        if known in exact:
            assert past.at(later, 2) == pytest.approx([exact[known]], rel=1e-12)
        assert past.at(later, 0) == [3 * t**2 - t + 1]
    line = Past(1)
    for t in (0.0, 0.2):
        line.reach(t, np.array([2 - t]))
    assert line.at(0.3, 1) == pytest.approx([1.7], rel=1e-14)


@pytest.mark.slow
@methods("rk4", "explicit", "stiff", "trapezoidal", "generalized_alpha", compiled="explicit")
def test_inputs_are_extrapolated_by_the_kernel_as_by_the_oracle(kernel, method):
    """A torque sampled at communication points of different lengths; a saved state goes on to the last bit."""
    given = {"start__angle": 0.4, "solver__step_size": 0.01, "solver__relative_tolerance": 1e-9}
    lengths = (0.02, 0.035, 0.02, 0.05, 0.01, 0.03)

    def driven(i: alfmu.Instance) -> np.ndarray:
        for h in lengths:
            i.set("A.torque", np.cos(5 * i.time))
            i.step(h)
        return np.concatenate([i.q, i.v, [i.work]])

    if method == "rk4":
        expected = driven(begun("slider_crank", method, "oracle", 2, **given))
    else:
        adaptive = by_the_oracle("slider_crank", method, 2, **given)
        for h in lengths:
            adaptive.oracle.set("A.torque", np.cos(5 * adaptive.t))
            adaptive.cover(h)
        expected = np.concatenate([adaptive.q, adaptive.v, [adaptive.work]])
    i = begun("slider_crank", method, kernel, 2, **given)
    assert driven(i) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    held = begun("slider_crank", method, kernel, **given)
    assert np.abs(driven(held) - expected).max() > 1e-4
    state = i.save()
    after = driven(i)
    other = alfmu.Instance(i.equations)
    other.restore(state)
    assert np.array_equal(driven(other), after)


# FMUs -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@methods("explicit", "stiff", "generalized_alpha", compiled="stiff")
def test_an_fmu_gives_the_numbers_of_the_library(tmp_path, kernel, method):
    given = {"solver.method": method, "start.angle": 0.4}
    path = alfmu.export("slider_crank", tmp_path / "s.fmu", parameters=given, kind="python", kernel=kernel)
    assert validate(path) == []
    with Fmu(path) as fmu:
        through_fmi = run(fmu, 0.6, 0.1, {"A.torque": 0.5})
    library = alfmu.simulate("slider_crank", 0.6, 0.1, inputs={"A.torque": 0.5}, parameters=given, kernel=kernel)
    assert through_fmi.names == library.names
    assert np.array_equal(through_fmi.values, library.values)
