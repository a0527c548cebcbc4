"""The kernel against the oracle, stage by stage and on random states; and when it must hand over to it.

`DRAWS=100 pytest tests/test_kernel.py` draws so many random states of each mechanism; by default four.
"""

import numpy as np
import pytest
from pairs import draws
from scenes import by_rk4 as derived
from scenes import hinged, initialized, made, refused

import alfmu
from alfmu.equations import Configuration, Mobility
from alfmu.equations.types import Survey
from alfmu.kernel.trace import traced
from alfmu.model.settings import Settings
from alfmu.simulation import prepared, with_defaults
from alfmu.studies.cost import cost

SCENES = [
    ("five_bar", {}, {}),
    ("five_bar", {}, {"m2": 0.0}),
    ("four_bar", {}, {}),
    ("particle_on_circle", {}, {"g": 9.81}),
    *(("slider_crank", {"coordinates": c}, {"b": 0.1}) for c in ("absolute", "joint", "mixed", "natural")),
]
each_scene = pytest.mark.parametrize(
    ("name", "options", "parameters"), SCENES, ids=["-".join([n, *o.values(), *p]) for n, o, p in SCENES]
)


pytestmark = pytest.mark.usefixtures("quick_compiler")
"""Optimised code is judged in `test_compiled`."""

each_kernel = pytest.mark.parametrize("kernel", ["vm", "compiled"])


def pair(name, options, parameters, kernel="vm") -> tuple[alfmu.Instance, alfmu.Instance]:
    """The same start by the kernel and by the oracle."""
    equations = derived(name, **options)
    both = made(equations, kernel), made(equations, "oracle")
    for i in both:
        initialized(i, parameters)
    return both


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "parameters", "kernel"),
    [(*scene, ("vm", "compiled")[k % 2]) for k, scene in enumerate(SCENES)],  # the next but one compares both kernels
)
def test_one_step_and_what_is_read_equal_the_oracle_on_random_states(name, options, parameters, kernel):
    """Equal to round-off: 1e-12 of the largest entry, as both leave up to 1e-13 in each constraint."""
    random = np.random.default_rng(3)
    equations = derived(name, **options)
    prepared_once = prepared(equations, kernel)
    for _ in range(draws(4)):
        start = {"start.angle": random.uniform(0.3, 1.2), "start.angular_velocity": random.uniform(-3.0, 3.0)}
        fast, oracle = made(prepared_once, kernel), made(equations, "oracle")
        for i in (fast, oracle):
            for key, value in {**parameters, **start}.items():
                i.set(key, value)
            for v in i.input_variables:
                i.set(v.name, 0.7)
            i.initialize()
        kept = [v.name != "monitor.iterations" for v in fast.outputs]
        for _ in range(2):
            a, b = fast.read()[kept], oracle.read()[kept]
            assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()
            for i in (fast, oracle):
                i.step(0.01)
        assert np.abs(fast.q - oracle.q).max() <= 1e-12 * max(1.0, np.abs(oracle.q).max())
        assert np.abs(fast.v - oracle.v).max() <= 1e-12 * max(1.0, np.abs(oracle.v).max())
        assert fast.work == pytest.approx(oracle.work, abs=1e-12)
        assert fast.counters.patient == 0


@each_scene
def test_a_run_by_the_kernel_is_a_run_by_the_oracle(name, options, parameters):
    """One second; differences of round-off grow where positions are nearly singular, motion by motion."""
    equations = derived(name, **options)
    parameters = {**parameters, "start.angle": 0.4}
    runs = [alfmu.simulate(equations, 1.0, 0.02, parameters=parameters, kernel=k) for k in ("vm", "oracle")]
    angles = [n for n in runs[0].names if n.endswith((".angle", ".x", ".y")) and "force" not in n]
    for n in angles:
        assert np.abs(runs[0][n] - runs[1][n]).max() < 1e-10
    assert runs[0].counters.steps == runs[1].counters.steps == 50
    assert runs[0].counters.position_error <= 1e-13
    assert runs[0].counters.velocity_error <= 1e-13
    assert runs[0].counters.energy_error == pytest.approx(runs[1].counters.energy_error, rel=1e-4, abs=1e-12)
    assert runs[0].counters.unconverged <= runs[1].counters.unconverged


@pytest.mark.parametrize("distance", [1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9])
def test_near_a_singular_position_the_kernel_is_as_good_as_the_oracle_or_hands_over(distance):
    """Accelerations of the five-bar at th1 = distance, under gravity, where they are bounded."""
    for parameters in ({}, {"m2": 0.0}):
        kernel, oracle = pair("five_bar", {}, {**parameters, "start.angle": distance})
        names = [v.name for v in kernel.outputs]
        wanted = [i for i, n in enumerate(names) if n.endswith(("acceleration", ".ax", ".ay"))]
        a, b = kernel.read()[wanted], oracle.read()[wanted]
        # Limits are extrapolated from 0.03 rad, where round-off over the fourth power of the distance is 3e-10.
        limit = 1e-9 if kernel.get("monitor.singular") else 1e-10
        assert np.abs(a - b).max() <= limit * np.abs(b).max()


@each_scene
def test_compiled_functions_give_the_numbers_of_the_virtual_machine(name, options, parameters):
    """To round-off over 100 steps, quick, careful and the oracle's; equal to the last bit where the C library's
    functions are those that CasADi calls."""
    parameters = {**parameters, "start.angle": 0.4}
    runs = [
        alfmu.simulate(derived(name, **options), 2.0, 0.02, parameters=parameters, kernel=k) for k in ("vm", "compiled")
    ]
    assert np.abs(runs[0].values - runs[1].values).max() <= 1e-11 * np.abs(runs[0].values).max()
    assert runs[0].counters.steps == runs[1].counters.steps


@each_kernel
@pytest.mark.parametrize("steps", [1, 7, 8, 9, 64, 77, 1200])
def test_many_internal_steps_in_one_call_are_those_steps_to_the_last_bit(steps, kernel):
    equations = prepared(derived("slider_crank", coordinates="natural"), kernel)
    one, many = alfmu.Instance(equations), alfmu.Instance(equations)
    dt = 1 / 256  # exact in binary, so that no step differs from another
    for i in (one, many):
        initialized(i, {"start.angular_velocity": 4.0, "solver.method": "rk4", "solver.step_size": dt})
    many.step(steps * dt)
    for _ in range(steps):
        one.step(dt)
    assert many.counters.steps == one.counters.steps == steps
    assert np.array_equal(one.state, many.state)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "starts", "kernel"),
    [("rk4", False, "vm"), ("rk4", True, "compiled"), ("auto", False, "compiled"), ("auto", True, "vm")],
)
def test_what_is_read_at_a_communication_point_serves_the_next_step(way, starts, kernel):
    """A step begins with the evaluation that was read where nothing has changed since, and with the same numbers where
    it is made anew: after a state was restored, or an input set; where inputs differ, with other ones."""
    h, stages = (0.02, 4) if way == "rk4" else (0.005, 6)
    start = {"start.angle": -1.5, "start.angular_velocity": 2.0} if starts else {}
    e = prepared(with_defaults(derived("five_bar"), {"solver.method": way}), kernel)
    plain, restored, again, other = (alfmu.Instance(e) for _ in range(4))
    name = plain.input_variables[0].name
    for instance in (plain, restored, again, other):
        initialized(instance, start)
        instance.read()
    for k in range(60):
        restored.restore(restored.save())
        again.set(name, again.get(name))
        other.set(name, 1e-9 * (k + 1))
        for instance in (plain, restored, again, other):
            instance.step(h)
        assert restored.memory["z"].tobytes() == plain.memory["z"].tobytes() == again.memory["z"].tobytes(), k
        assert restored.read().tobytes() == plain.read().tobytes() == again.read().tobytes(), k
    assert not np.array_equal(other.q, plain.q)
    assert np.allclose(other.q, plain.q, rtol=0, atol=1e-6)
    shared = restored.counters.evaluations - plain.counters.evaluations
    if start:
        assert plain.counters.evaluations == stages * plain.counters.steps + 1
        assert shared == 60
    assert shared > 40


@pytest.mark.parametrize("changed", ["q", "u"])
def test_a_state_that_was_written_since_it_was_read_is_evaluated_anew(changed):
    """Positions and inputs that a caller writes into the memory count at the next step."""
    e = prepared(derived("five_bar"))
    found = []
    for reads in (True, False):
        instance = initialized(alfmu.Instance(e), {"start.angle": 1.2})
        state = instance.save()
        if reads:
            instance.read()
        else:
            instance.restore(state)
        if changed == "q":
            instance.q[:] *= 1 + 1e-9
        else:
            instance.memory["u"][:] = 0.5
        instance.step(e.step_size)
        found.append(instance.memory["z"].tobytes())
    assert found[0] == found[1]


def test_what_the_unrolled_loops_cannot_do_is_done_by_loops_that_converge():
    """A penalty of 100 masses needs more iterations than were unrolled: the numbers of the oracle.

    The last is 0.002 rad beside the singular position, where the iterations hardly resolve one direction of reactions.
    """
    parameters = {"solver.method": "rk4", "solver.penalty": 100.0, "solver.max_iterations": 50, "start.angle": 0.4}
    runs = [alfmu.simulate(derived("five_bar"), 0.5, 0.02, parameters=parameters, kernel=k) for k in ("vm", "oracle")]
    assert runs[0].counters.patient == 25
    kept = [n not in ("monitor.iterations", "monitor.distance") for n in runs[0].names]
    a, b = (r.values[:, kept] for r in runs)
    assert np.abs(a - b).max() <= 1e-11 * np.abs(b).max()


@pytest.mark.parametrize("kernel", ["vm", "oracle"])
def test_reactions_that_have_a_pole_are_as_large_by_small_penalties(kernel):
    """0.01 rad beside the pole of a driven four-bar, whose largest reaction is 204 N by the default penalty."""
    found = []
    for penalty in (0.0, 1e4):
        instance = made(derived("four_bar"), kernel)
        for name, value in {"solver.penalty": penalty, "solver.max_iterations": 50, "start.angle": 0.01}.items():
            instance.set(name, value)
        instance.initialize()
        instance.set("A.torque", 4.0)
        found.append([instance.get(v.name) for v in instance.outputs if ".force." in v.name])
    assert np.abs(found[0]).max() > 200
    assert np.abs(np.subtract(*found)).max() < 1e-12 * np.abs(found[0]).max()


@pytest.mark.parametrize("penalty", [1e4, 1e6, 1e10, 1e12])
def test_a_penalty_of_the_users_own_is_as_exact_by_the_kernel(penalty):
    """The quick step is for the default penalty; any other begins with the careful one, also after a restore."""
    kernel, oracle = pair("five_bar", {}, {"start.angle": 0.4, "solver.penalty": penalty})
    for i in (kernel, oracle):
        i.step(0.1)

    kept = [v.name != "monitor.iterations" for v in kernel.outputs]
    a, b = kernel.read()[kept], oracle.read()[kept]
    # A correction of 1e-7 (what one step leaves open) leaks its round-off, times penalty over mass, into the motion.
    assert np.abs(a - b).max() <= max(1e-12, 2.0**-52 * penalty * 1e-7) * np.abs(b).max()
    default = initialized(alfmu.Instance(kernel.equations), {"start.angle": 0.4})
    default.penalty = np.full(8, penalty)
    other = alfmu.Instance(kernel.equations)
    other.restore(default.save())
    for i in (default, other):
        i.step(0.1)
    assert np.array_equal(default.read(), other.read())


@pytest.mark.parametrize(
    "settings",
    [
        Settings(method="rk4", formulation="classic"),
        Settings(method="rk4", projection=False),
        Settings(method="rk4", max_iterations=1),
    ],
    ids=["classic", "no projection", "one iteration"],
)
def test_settings_beside_the_usual_ones_run_as_by_the_oracle(settings):
    both = [made(derived("five_bar"), kernel, settings) for kernel in ("vm", "oracle")]
    for i in both:
        initialized(i, {"start.angle": 0.4})
        i.step(0.1)
    kept = [v.name not in ("monitor.iterations", "monitor.distance") for v in both[0].outputs]
    a, b = (i.read()[kept] for i in both)
    # Classic iterations, and the first one of the residual form, lose digits to the penalty (1e8 masses) each stage.
    lost = 20 * 1e8 * 2.0**-52 if settings.projection is None else 1e-11
    assert np.abs(a - b).max() <= lost * np.abs(b).max()


@pytest.mark.parametrize("kernel", ["vm", "oracle"])
def test_penalties_by_row_too_small_for_the_iterations_are_refused(kernel):
    """Each of two passes gains mass / penalty of 1 kg / 100 kg at most, far from the limit of 1e-7."""
    instance = made(derived("five_bar"), kernel, Settings(method="rk4", penalty=[100.0] * 8, max_iterations=2))
    instance.set("start.angle", 0.4)
    with pytest.raises(alfmu.StepError, match=r"with solver.penalty 100 .* after 2 passes.*; use solver.penalty 0"):
        initialized(instance).read()


@each_kernel
@pytest.mark.parametrize("off", [None, 4])
def test_a_penalty_for_each_constraint_runs_by_the_kernel(kernel, off):
    """Three decades of penalties, and a constraint switched off by zero, equal the oracle."""
    alpha = np.geomspace(1e7, 1e10, 8)
    if off is not None:
        alpha[off] = 0.0
    settings = Settings(method="rk4", penalty=alpha)
    both = [made(derived("five_bar"), k, settings) for k in (kernel, "oracle")]
    for i in both:
        initialized(i, {"start.angle": 0.4})
        for _ in range(20):
            i.step(0.01)
    assert both[0].counters.patient == 0
    assert np.abs(both[0].state[:17] - both[1].state[:17]).max() < 1e-12
    kept = [v.name != "monitor.iterations" for v in both[0].outputs]
    a, b = (i.read()[kept] for i in both)
    assert np.abs(a - b).max() <= 1e-11 * np.abs(b).max()


@each_kernel
def test_a_step_that_neither_can_take_keeps_the_state(kernel):
    i = alfmu.Instance(prepared(derived("four_bar"), kernel))
    i.set("solver.method", "rk4")
    i.set("solver.step_size", 5.0)
    i.set("start.angle", 0.4)
    i.initialize()
    i.set("A.torque", 1e6)
    with refused(i, alfmu.StepError, match=r"four_bar, t = 5 s: .*reduce solver\.step_size"):
        i.step(5.0)


def test_only_what_the_scene_needs_is_traced():
    """Fewer operations without redundant rows to clear, without constraints, without work."""
    five = derived("five_bar")
    surveys = (Survey(Mobility(1, redundant, 1)) for redundant in (1, 0))
    with_rows, without = (cost(traced(Configuration.of(five, survey=survey))).outputs for survey in surveys)
    assert with_rows > without
    pendulum, *_ = hinged("pendulum", bar="rod", start=0.5, independent=True)
    equations = prepared(alfmu.derive(pendulum))
    assert cost(equations).step < 100
    by_rk4 = {"solver.method": "rk4"}
    result, judge = (alfmu.simulate(pendulum, 1.0, 0.01, parameters=by_rk4, kernel=k) for k in ("vm", "oracle"))
    assert result.counters.projection_iterations == 0
    assert np.abs(result["rod.angle"] - judge["rod.angle"]).max() < 1e-13


def test_the_oracle_can_be_had_back_from_traced_equations():
    fast = prepared(derived("four_bar"))
    assert prepared(fast).kernel is fast.kernel
    a, b = (alfmu.simulate(e, 0.2, 0.02, kernel="oracle") for e in (fast, derived("four_bar")))
    assert np.array_equal(a.values, b.values)


def test_the_oracle_says_that_it_has_rk4_alone():
    with pytest.raises(alfmu.InputError, match=r"four_bar: the oracle has no solver\.method explicit; use rk4"):
        alfmu.simulate("four_bar", 1.0, 0.1, parameters={"solver.method": "explicit"}, kernel="oracle")


def test_an_impact_by_the_kernel_is_that_of_the_oracle():
    """The coupler of a four-bar is let go, stopped, and caught again: velocity, and work with what was lost."""
    both = pair("four_bar", {}, {"start.angle": 0.7})
    for i in both:
        alpha = i.penalty
        i.penalty = np.r_[0.0, 0.0, alpha[2:]]
        i.v[1:] *= 0.5
        before = i.v.copy()
        i.penalty = alpha
    kernel, oracle = both
    assert np.abs(oracle.v - before).max() > 0.1
    assert np.abs(kernel.v - oracle.v).max() <= 1e-12 * np.abs(oracle.v).max()
    assert kernel.work == pytest.approx(oracle.work, abs=1e-12)


def test_an_unknown_kernel_is_refused():
    with pytest.raises(alfmu.InputError, match="no kernel 'magic'; use one of vm, compiled, auto, oracle"):
        alfmu.simulate("five_bar", 1.0, 0.1, kernel="magic")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flyball_governor", "flexible_four_bar", "end_stop"])
def test_stiff_scenes_run_by_the_kernel_as_by_the_oracle(name):
    """Forty of their own short steps, to 1e-12 of the largest place or angle."""
    e = derived(name)
    runs = [alfmu.simulate(e, 40 * e.step_size, 10 * e.step_size, kernel=k) for k in ("vm", "oracle")]
    kinds = ("force", "moment", "velocity", "acceleration")
    for n in runs[0].names:
        if n.endswith((".angle", ".x", ".y", ".z", ".position")) and not any(kind in n for kind in kinds):
            assert np.abs(runs[0][n] - runs[1][n]).max() <= 1e-12 * max(1.0, np.abs(runs[1][n]).max())
    assert [r.counters.steps for r in runs] == [40, 40]
    assert [r.counters.unconverged for r in runs] == [0, 0]
