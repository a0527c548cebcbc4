"""solver.method and its numbers, in the library and through fmpy: tolerances, orders, saved states, what is carried."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from oracles import flyball, ode
from oracles.end_stop import EndStop
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from scenes import derived, made, refused, sampled

import alfmu
from alfmu.equations.interface import default_settings
from alfmu.fmi.drive import Fmu
from alfmu.kernel.memory import SETTINGS
from alfmu.method.singular import LEAST_DISTANCE
from alfmu.model.settings import METHODS
from alfmu.simulation import prepared, with_defaults

FOUR_BAR = Parallelogram(m4=None)
GOVERNOR = np.loadtxt(Path(flyball.__file__).with_suffix(".csv"), delimiter=",", skiprows=1)
"""Time, and height of the slider with springs of 8e5 and of 8e7 N/m: by DOP853 in minimal coordinates."""


def chosen(name: str, method: str, kernel: str = "vm", **given: float | str) -> alfmu.Instance:
    """An initialised instance with a method."""
    given = {key.replace("__", "."): value for key, value in given.items()}
    i = made(with_defaults(derived(name), {"solver.method": method, **given}), kernel)
    i.initialize()
    return i


@pytest.mark.slow
@pytest.mark.parametrize("method", ["explicit", "stiff"])
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9])
def test_the_tolerance_is_held_through_singular_positions(method, tolerance):
    """Four-bar under 4 N.m from its singular start, 3 s: within ten times the tolerance, never off its branch."""
    i = chosen("four_bar", method, solver__relative_tolerance=tolerance)
    i.set("A.torque", 4.0)
    times = np.linspace(0.0, 3.0, 7)
    exact = FOUR_BAR.driven(0.0, 2.0, times, 4.0)[:, 0]
    for k in range(1, 7):
        i.step(times[k] - times[k - 1])
        assert abs(i.q[0] - exact[k]) <= 10 * tolerance
    assert i.counters.energy_error <= 100 * tolerance
    assert i.counters.refused <= 5


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_distance_of_places_has_a_wide_margin(factor):
    """Half and twice `LEAST_DISTANCE`: `stiff` at 1e-9 refuses as few steps through singular positions."""
    i = chosen("four_bar", "stiff", solver__relative_tolerance=1e-9)
    distance = i.memory["k"][SETTINGS.index("least_distance") :][:1]
    assert distance == LEAST_DISTANCE
    distance *= factor
    i.set("A.torque", 4.0)
    exact = FOUR_BAR.driven(0.0, 2.0, np.array([0.0, 3.0]), 4.0)[-1, 0]
    i.step(3.0)
    assert distance == factor * LEAST_DISTANCE
    assert abs(i.q[0] - exact) <= 1e-8
    assert i.counters.refused <= 5


@pytest.mark.slow
@pytest.mark.parametrize("method", ["explicit", "stiff"])
def test_the_tolerance_is_held_on_the_slider_crank(method):
    times = np.linspace(0.0, 2.0, 5)
    exact = SliderCrank().motion(np.pi / 4, 0.0, times)[:, 0]
    i = chosen("slider_crank", method, start__angle=np.pi / 4, start__angular_velocity=0.0)
    for k in range(1, 5):
        i.step(times[k] - times[k - 1])
        assert abs(i.get("crank.angle") - exact[k]) <= 1e-5


def test_short_communication_steps_do_not_restart_the_control():
    """Two hundred points in 4 s: about a step for each, and the step that is wanted is remembered."""
    i = chosen("four_bar", "explicit", start__angle=0.7)
    for _ in range(200):
        i.step(0.02)
    assert i.counters.steps <= 215
    assert i.time == pytest.approx(4.0)
    far = chosen("four_bar", "explicit", start__angle=0.7)
    far.step(4.0)
    assert far.counters.steps <= 80


@pytest.mark.slow
def test_order_8_at_fixed_steps():
    """Five-bar, 2 s from a regular start: 1e-7 rad at 0.1 s, and order 8 down to round-off."""
    linkage = Parallelogram()
    inertia, weight = float(linkage.inertia), float(linkage.weight)
    errors = []
    for step in (0.1, 0.05, 0.02):
        i = chosen("five_bar", "order8", start__angle=-0.7, solver__step_size=step, solver__tolerance=1e-15)
        times = np.arange(0.0, 2.0 + step / 2, step)
        exact = ode.motion(lambda t, x, v: -weight * np.cos(x) / inertia, -0.7, 2.0, times)[:, 0]
        worst = 0.0
        for k in range(1, len(times)):
            i.step(step)
            worst = max(worst, abs(i.q[0] - exact[k]))
        errors.append(worst)
    assert errors[0] < 1e-7
    assert errors[0] / errors[1] > 2**6.5
    assert errors[2] < 2e-12


@pytest.mark.slow
@pytest.mark.parametrize(("step", "bound"), [(0.1, 1e-7), (0.02, 1e-12)])
def test_order_8_over_the_run_of_the_paper(step, bound):
    """Five-bar, 20 s from its singular start: 1e-7 rad at 0.1 s, 1e-12 at 0.02 s, where round-off is what is left."""
    times = np.linspace(0.0, 20.0, 21)
    exact = Parallelogram().swing(0.0, 2.0, times)[:, 0]
    i = chosen("five_bar", "order8", "vm", solver__step_size=step)
    for k in range(1, len(times)):
        i.step(1.0)
        assert abs(i.q[0] - exact[k]) < bound
    assert i.counters.steps == round(20 / step)


@pytest.mark.slow
def test_masses_a_million_apart_at_default_settings():
    """Flywheel of 1000 kg, rod of 1 g, ram of 10 kg, 5 s out of reach of the stop (`test_end_stop` has impacts)."""
    away = EndStop(stop=10.0)
    times = np.linspace(0.0, 5.0, 6)
    exact = ode.solved(away.right_side, (-2.0, 2.0, 0.0), times, method="DOP853", rtol=1e-13, most=0.05)[:, 0]
    r = alfmu.simulate("end_stop", 5.0, 1.0, parameters={"stop": 10.0})
    assert np.abs(r["flywheel.angle"] - exact).max() < 1e-7


@pytest.mark.parametrize("method", ["trapezoidal", "generalized_alpha"])
def test_the_index_3_form_is_of_order_two_in_a_run(method):
    exact = FOUR_BAR.driven(0.0, 2.0, np.array([0.0, 1.0]), 4.0)[1, 0]
    errors = []
    for step in (0.01, 0.005):
        i = chosen("four_bar", method, "vm", solver__step_size=step)
        i.set("A.torque", 4.0)
        i.step(1.0)
        errors.append(abs(i.q[0] - exact))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_inputs_extrapolated_inside_a_communication_step_keep_the_order():
    """A smooth torque sampled at communication points: order 1 where it is held, 2 and 3 where it is extrapolated."""
    observed = []
    for order in (0, 1, 2):
        given = {"start__angle": -1.0, "start__angular_velocity": 0.0, "solver__input_order": order}
        errors = [sampled(chosen("four_bar", "rk4", "vm", **given), step) for step in (0.04, 0.02)]
        observed.append(np.log2(errors[0] / errors[1]))
    assert observed[0] == pytest.approx(1.0, abs=0.2)
    assert observed[1] == pytest.approx(2.0, abs=0.4)
    assert observed[2] >= 2.6


@pytest.mark.slow
def test_the_tolerance_of_fmi_is_honoured(built):
    path = built("four_bar", parameters={"solver.method": "explicit"})
    exact = FOUR_BAR.swing(0.0, 2.0, np.array([0.0, 2.0]))[1, 0]
    errors = []
    for tolerance in (1e-4, 1e-9):
        result = fmpy.simulate_fmu(
            str(path), stop_time=2.0, output_interval=1.0, relative_tolerance=tolerance, output=["link1.angle"]
        )
        errors.append(abs(result["link1.angle"][-1] - float(exact)))
    assert errors[1] <= 1e-8
    assert errors[0] > 10 * errors[1]


@pytest.mark.slow
def test_an_fmu_without_a_method_says_how_to_have_it(tmp_path):
    plain = alfmu.export("four_bar", tmp_path / "plain.fmu", kind="python", parameters={"solver.method": "rk4"})
    with Fmu(plain) as fmu:
        fmu.set("solver.method", "explicit")
        with pytest.raises(alfmu.StepError, match=r"use one of rk4, .*export with --set solver\.method=explicit"):
            fmu.initialize()


@pytest.mark.slow
def test_auto_says_what_it_chose_and_why(capsys):
    from alfmu.cli import main

    for name, expected in (("four_bar", "explicit"), ("flyball_governor", "stiff")):
        e = prepared(with_defaults(derived(name), {"solver.method": "auto"}), "oracle")
        assert (default_settings(e).method, e.decision.method) == ("auto", expected)
        assert e.decision.reason.startswith(f"{expected}: the fastest small motion at the start has ")
        again = prepared(e)
        assert (again.decision.method, again.decision.reason) == (expected, e.decision.reason)
    assert main(["info", "four_bar", "--all", "--set", "solver.method=auto"]) == 0
    assert "method of integration: explicit: the fastest small motion" in capsys.readouterr().out


@pytest.mark.slow
def test_what_cannot_be_is_refused():
    with pytest.raises(alfmu.InputError, match=r"solver\.method is 'euler'; use one of rk4, order8"):
        with_defaults(derived("four_bar"), {"solver.method": "euler"})
    i = alfmu.Instance(derived("four_bar"))
    i.set("solver.method", "stiff")
    with pytest.raises(alfmu.InputError, match="takes the augmented Lagrangian"):
        i.set("solver.formulation", "dae")
    i.initialize()
    assert i.choices["solver.method"] == "stiff"
    with pytest.raises(alfmu.InputError, match="takes up to 50 coordinates"):
        prepared(with_defaults(derived("n_four_bar", loops=25), {"solver.method": "stiff"}))
    assert set(METHODS) >= {"rk4", "explicit", "stiff", "auto"}


def test_a_tolerance_that_cannot_be_met_is_said():
    i = chosen("four_bar", "explicit", start__angle=0.7, solver__relative_tolerance=1e-13)
    i.step(0.01)
    i.set("A.torque", 1e300)
    with refused(i, alfmu.StepError, match=r"four_bar, t = 0\.\d+ s: no step however short meets the tolerance"):
        i.step(0.1)
    i.set("A.torque", 0.0)
    i.step(0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("tolerance", "most", "bound"), [(1e-4, 250, 3e-6), (1e-8, 700, 1e-8)])
def test_the_governor_in_few_steps(tolerance, most, bound):
    """Slider of the flyball governor (IFToMM A05) after 10 s, springs 8e5 N/m with 4e4 N.s/m: explicit methods need
    30000 steps for it."""
    i = chosen("flyball_governor", "stiff", "vm", solver__relative_tolerance=tolerance)
    i.step(10.0)
    assert GOVERNOR[-1, 0] == 10.0
    assert abs(i.get("slider.position") - GOVERNOR[-1, 1]) <= bound
    assert i.counters.steps <= most


@pytest.mark.slow
def test_a_stiffer_governor_takes_no_more_steps():
    """Stiffness 100 times: at most 1.2 times the steps, and as exact."""
    counts = []
    for column, stiffness in enumerate((8e5, 8e7), 1):
        i = chosen("flyball_governor", "stiff", "vm", solver__relative_tolerance=1e-6, stiffness=stiffness)
        i.step(10.0)
        counts.append(i.counters.steps)
        assert abs(i.get("slider.position") - GOVERNOR[-1, column]) <= 1e-6
    assert counts[1] <= 1.2 * counts[0]
