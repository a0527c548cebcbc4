"""Error control where round-off is larger than what the tolerance allows."""

import re
from itertools import pairwise

import numpy as np
import pytest
from oracles import ode
from scenes import derived, initialized
from scipy.integrate import quad
from test_n_four_bar import Row

import alfmu
from alfmu.simulation import instance, with_defaults

L1, L2 = 0.5, 1.0


def coasting(masses, angle, speed):
    """Time at which a slider-crank without loads or weight comes to an angle: energy is kept, so that the time is the
    integral of sqrt(M(x) / 2 E) over the angle of its crank x."""

    def mass(x):
        m1, m2, m3 = masses
        sin = -L1 * np.sin(x) / L2
        cos = np.sqrt(1 - sin**2)
        turn = -L1 * np.cos(x) / (L2 * cos)
        end = -L1 * np.sin(x) - L2 * sin * turn
        centre = np.array([-L1 * np.sin(x) - L2 / 2 * sin * turn, L1 * np.cos(x) + L2 / 2 * cos * turn])
        return m1 * L1**2 / 3 + m2 * (centre @ centre + (L2 * turn) ** 2 / 12) + m3 * end**2

    full = mass(angle) * speed**2

    def time(x):
        stops = [angle, *(k * np.pi for k in range(1, 20) if angle < k * np.pi < x), x]
        near = [1e-4, 1e-3, 1e-2, 0.1]
        total = 0.0
        for a, b in pairwise(stops):
            inner = sorted({a, b, *(a + d for d in near if a + d < b), *(b - d for d in near if b - d > a)})
            for c, d in pairwise(inner):
                total += quad(lambda y: np.sqrt(mass(y) / full), c, d, epsabs=1e-15, epsrel=1e-13)[0]
        return total

    return time, lambda x: np.sqrt(full / mass(x))


def controlled(name, tolerance, values, **options):
    """An instance that controls its error."""
    values = {"solver.method": "explicit", "solver.relative_tolerance": tolerance, **values}
    return initialized(instance(with_defaults(derived(name, **options), values), "vm"))


@pytest.mark.slow
@pytest.mark.parametrize("masses", [(1.0, 1.0, 1e6), (1e-6, 1e-6, 1.0), (1e6, 1e6, 1.0)], ids=["a", "b", "reverse"])
@pytest.mark.parametrize("coordinates", ["absolute", "joint", "mixed", "natural"])
def test_masses_that_differ_by_a_million(coordinates, masses):
    """At the dead centres of a heavy slider its light crank whips round at a thousand rad/s within a microsecond."""
    values = {f"m{i}": m for i, m in enumerate(masses, 1)} | {"start.angular_velocity": 2.0, "g": 0.0}
    unit = controlled("slider_crank", 1e-9, values, coordinates=coordinates)
    for _ in range(50):
        unit.step(0.1)
    time, speed = coasting(masses, np.pi / 4, 2.0)
    angle = unit.get("crank.angle")
    assert abs(time(angle) - 5.0) * speed(angle) <= 1e-8
    assert unit.counters.evaluations <= 25_000


@pytest.mark.slow
@pytest.mark.parametrize("steps", ["even", "uneven"])
@pytest.mark.parametrize("tolerance", [1e-8, 1e-9])
def test_many_redundant_coordinates_through_singular_positions(tolerance, steps):
    unit = controlled("n_four_bar", tolerance, {}, coordinates="absolute", loops=2)
    uneven = np.concatenate([np.arange(100) * 0.02, 2 + np.arange(151) * 0.002])
    times = np.arange(101) * 0.1 if steps == "even" else uneven
    for a, b in pairwise(times):
        unit.step(b - a)
    exact = ode.motion(lambda t, th, w: Row(2).acceleration(th), np.pi / 2, -1.0, times)
    assert abs(unit.get("crank1.angle") - exact[-1, 0]) <= 2e-9
    if steps == "even":
        assert unit.counters.evaluations <= 12_000


def test_a_tolerance_that_cannot_be_had_is_said_once(caplog):
    values = {"m3": 1e6, "start.angular_velocity": 2.0, "g": 0.0}
    unit = controlled("slider_crank", 1e-13, values, coordinates="joint")
    for _ in range(50):
        unit.step(0.1)
    said = [each.getMessage() for each in caplog.records if "round-off" in each.getMessage()]
    assert len(said) == 1
    assert re.match(r"slider_crank, t = \S+ s: round-off causes .* solver\.relative_tolerance 1e-13 cannot", said[0])
    assert unit.counters.evaluations <= 35_000
    time, speed = coasting((1.0, 1.0, 1e6), np.pi / 4, 2.0)
    assert abs(time(unit.get("crank.angle")) - 5.0) * speed(unit.get("crank.angle")) <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "rk4"])
def test_forces_that_balance_each_other_leave_nothing_to_warn_of(method, caplog):
    """Pulled by 1e6 N at its dead centre, a slider-crank stays there; its accelerations and its work are round-off."""
    values = {"start.angle": 0.0, "start.angular_velocity": 0.0, "g": 0.0, "solver.method": method}
    r = alfmu.simulate("slider_crank", 1.0, 0.02, parameters=values, inputs={"slider.force": 1e6})
    assert r.counters.unconverged == 0
    assert not caplog.records
    assert r["monitor.step_error"].max() <= 1e-3
    assert np.abs(r["crank.angle"]).max() <= 1e-12


@pytest.mark.parametrize("name", ["five_bar", "four_bar"])
def test_short_fixed_steps_tell_how_far_a_singular_position_is(name, caplog):
    """At 1 ms places a quarter of a step apart are too close for that; nothing is patient, nothing is warned."""
    unit = initialized(instance(with_defaults(derived(name), {"solver.method": "rk4", "solver.step_size": 1e-3}), "vm"))
    nearest = 1.0
    for _ in range(2500):
        unit.step(1e-3)
        nearest = min(nearest, unit.get("monitor.distance"))
    assert nearest <= 1e-3
    assert unit.counters.patient == 0
    assert unit.counters.unconverged == 0
    assert not caplog.records


@pytest.mark.slow
def test_a_mechanism_that_rests_first_is_judged_when_it_moves(caplog):
    """Steps that are too long, after a second at rest under 1e6 N in which nothing is warned of."""
    unit = alfmu.Instance("slider_crank")
    unit.set("solver.method", "rk4")
    initialized(unit, {"start.angle": 0.0, "start.angular_velocity": 0.0, "g": 0.0, "slider.force": 1e6})
    for _ in range(50):
        unit.step(0.02)
    assert not caplog.records
    unit.set("slider.force", 0.0)
    unit.set("A.torque", 50.0)
    for _ in range(20):
        unit.step(0.02)
    assert "the energy balance is off" in caplog.records[0].getMessage()


def test_fixed_steps_that_are_too_long_are_warned_about(caplog):
    r = alfmu.simulate("slider_crank", 4.0, inputs={"A.torque": 5.0}, parameters={"solver.method": "rk4"})
    balance = r["monitor.energy"] - r["monitor.energy"][0] - r["monitor.work"]
    assert np.abs(balance).max() == pytest.approx(r.counters.energy_error)
    assert np.abs(balance).max() > 100.0
    assert r["monitor.step_error"].max() > 0.1
    said = [each.getMessage() for each in caplog.records]
    assert len(said) == 1
    assert re.match(r"slider_crank, t = \S+ s: the energy balance is off by .*solver\.method explicit", said[0])


@pytest.mark.parametrize("given", [{"solver.formulation": "classic"}, {"solver.branch": "paper"}])
def test_energy_that_the_procedure_of_the_paper_loses_is_no_matter_of_the_step_alone(given, caplog):
    given |= {"solver.method": "rk4", "start.angle": 0.0}
    alfmu.simulate("four_bar", 5.0, 0.02, inputs={"A.torque": 4.0}, parameters=given)
    said = [each.getMessage() for each in caplog.records if "the energy balance" in each.getMessage()]
    assert re.search(
        r"the energy balance .* near singular positions solver\.formulation residual with solver\.branch continue",
        said[0],
    )


@pytest.mark.slow
def test_a_good_run_warns_of_nothing_and_a_restored_one_says_it_again(caplog):
    alfmu.simulate("four_bar", 2.0)
    assert not caplog.records
    unit = initialized(alfmu.Instance("slider_crank"), {"solver.method": "rk4"})
    begin = unit.save()
    for _ in range(2):
        unit.set("A.torque", 5.0)
        for _ in range(200):
            unit.step(0.02)
        unit.restore(begin)
    assert len(caplog.records) == 2


def test_the_error_of_a_step_is_known_where_it_is_the_only_monitor():
    alone, complete = (
        alfmu.simulate(
            "slider_crank", 1.0, inputs={"A.torque": 2.0}, outputs=names, parameters={"solver.method": "rk4"}
        )
        for names in (["crank.angle", "monitor.step_error"], None)
    )
    assert alone.names[:2] == ("crank.angle", "monitor.step_error")
    assert alone["monitor.step_error"][1:].min() > 0
    assert alone["monitor.step_error"] == pytest.approx(complete["monitor.step_error"], rel=1e-6)
